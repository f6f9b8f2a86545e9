"""Modal form of any linear system: poles on either side of the axis, sensors and actuators anywhere.

    G(s) = D + sum_l [ c_l b_l^T / (s - p_l) + conj(c_l b_l^T) / (s - conj(p_l)) ] + real poles + clusters

A matrix is split into modes by its real Schur form.  Poles that no well-conditioned transformation parts, of critical
damping for example, stay together in a block of that form: responses run through the block and keep their digits.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import cached_property
from itertools import pairwise
from typing import Any, NoReturn

import control as ct
import numpy as np
from scipy.linalg import block_diag, eigvals, schur, solve_sylvester
from scipy.linalg.lapack import dgebal
from slycot import ab08nd, mb03rd

from .. import _checks
from .._display import html_table, literal
from .._types import Array, ArrayLike, ComplexArray, RealOrComplex
from ..exceptions import NotLosslessError, StructureError
from ..numerics.double_double import Pair, add, exactly, product
from ..numerics.invariant_subspaces import equilibrated
from ..numerics.pole_residue import SAFETY, PoleResidueForm
from .foster_test import decide
from .modal_form import Cluster, ModalForm, from_frequencies

Mode = tuple[complex, RealOrComplex, RealOrComplex]  # pole, shape and participation

_CONDITION = 100.0  # of the transformations that part poles: what they may cost of the digits
_BLOCK = 1 << 14  # terms of responses that are computed together: what a cache holds
_REFINED = 500  # states of a system whose modes are corrected
_TOGETHER = 64  # entries of a Sylvester equation that is solved as one system
_SLIGHT = 1e-6  # corrections of eigenvectors that are small enough for their first order


def _only_lossless(name: str) -> Any:
    def refuse(self: GeneralModalForm) -> NoReturn:
        ratios = ", ".join(f"{zeta:.3g}" for zeta in self.damping_ratios[:3])
        raise NotLosslessError(
            [f"damping ratios {ratios}, .."],
            f"lossless modes have {name}, and these have damping ratios {ratios}, ..; all modes have "
            "natural_frequencies, damping_ratios, shapes, participation and residues",
        )

    return property(refuse)


class GeneralModalForm(ModalForm):
    """A system in modal coordinates whose poles may lie anywhere; made by `modes`.

    Parameters
    ----------
    poles : ndarray, shape (n,)
        One of each pair of conjugates, with a positive imaginary part, and the real ones.
    shapes, participation : ndarray, shapes (n, p) and (n, m)
        What each mode makes of the p outputs, and what m inputs make of it; the residue is `shape participation^T`.
    feedthrough : ndarray, shape (p, m)
        Response at infinity.
    clusters : sequence of Cluster
        Blocks of poles that are not parted.

    See Also
    --------
    ModalForm : that of lossless systems.
    """

    def __init__(
        self, poles: ComplexArray, shapes: ComplexArray, participation: ComplexArray, feedthrough: Array,
        clusters: Sequence[Cluster] = (),
    ) -> None:  # fmt: skip
        order = np.lexsort((poles.real, np.abs(poles)))
        self.__dict__.update(
            _poles=poles[order], _shapes=shapes[order], _participation=participation[order],
            feedthrough=feedthrough, clusters=tuple(clusters),
        )  # fmt: skip
        arrays = [self._poles, self._shapes, self._participation, self.feedthrough]
        for array in arrays + [matrix for block in self.clusters for matrix in (block.A, block.B, block.C)]:
            array.flags.writeable = False

    _poles: ComplexArray
    _shapes: ComplexArray
    _participation: ComplexArray

    d = nu = rigid = r = _only_lossless("d, nu, rigid, r")
    kappa, kappa_0, minimal = _only_lossless("kappa"), _only_lossless("kappa_0"), _only_lossless("minimal")

    def __reduce__(self) -> tuple[object, ...]:
        arrays = (self._poles, self._shapes, self._participation, self.feedthrough)
        return type(self), (*(array.copy() for array in arrays), self.clusters)

    @property
    def is_lossless(self) -> bool:
        """False: a lossless system has a `ModalForm` with frequencies and weights."""
        return False

    @property
    def n(self) -> int:
        """Number of modes: pairs of poles, and real poles."""
        return len(self.mode_poles)

    @property
    def noutputs(self) -> int:
        """Number of outputs."""
        return int(self.feedthrough.shape[0])

    @property
    def ninputs(self) -> int:
        """Number of inputs."""
        return int(self.feedthrough.shape[1])

    @property
    def nports(self) -> int:
        """Number of pairs of an input and an output."""
        return min(self.noutputs, self.ninputs)

    @cached_property
    def mode_poles(self) -> ComplexArray:
        """One pole of each mode: those of single modes by their size, then those in clusters."""
        cluster_poles = [block.poles for block in self.clusters]
        return _checks.readonly(np.concatenate([self._poles, *(p[p.imag >= 0] for p in cluster_poles)]))

    @property
    def poles(self) -> ComplexArray:
        """All poles, shape (N,): those of the lower half-plane, real ones, those of the upper; then those in clusters.

        The single ones are in the order of `residues`.
        """
        single, _, _ = self._both_halves
        return np.concatenate([single, *(block.poles for block in self.clusters)])

    @cached_property
    def _both_halves(self) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Poles, shapes and participation with those of the conjugates."""
        real = self._poles.imag == 0
        parts = self._poles, self._shapes, self._participation
        poles, shapes, participation = (
            np.concatenate([part[~real][::-1].conj(), part[real], part[~real]]) for part in parts
        )
        return poles, shapes, participation

    @cached_property
    def _fractions(self) -> tuple[ComplexArray, ComplexArray]:
        """Poles and, one row for each, the entries of their residues."""
        poles, c, b = self._both_halves
        return poles, (c[:, :, None] * b[:, None, :]).reshape(len(poles), self.noutputs * self.ninputs)

    @property
    def equations(self) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Numbers of `x' = p x + b u`, `y = Re(c x)` for the single modes, shapes (N,), (N, m) and (p, N)."""
        pairs = np.where(self._poles.imag == 0, 1.0, 2.0)[:, None]
        return self._poles, self._participation, (pairs * self._shapes).T

    @property
    def residues(self) -> ComplexArray:
        """Residue of each of `poles`, shape (N, p, m); refused where poles are not parted."""
        self._refuse_clusters("residues")
        _, shapes, participation = self._both_halves
        return shapes[:, :, None] * participation[:, None, :]

    @property
    def shapes(self) -> ComplexArray:
        """Mode shapes, shape (n, p); of modes in a cluster nearly parallel ones."""
        vectors = [np.linalg.eig(block.A) for block in self.clusters]
        cluster_shapes = [(block.C @ V).T[p.imag >= 0] for block, (p, V) in zip(self.clusters, vectors, strict=True)]
        return np.concatenate([self._shapes, *cluster_shapes])

    @property
    def participation(self) -> ComplexArray:
        """Participation of the inputs in each mode, shape (n, m); refused where poles are not parted."""
        self._refuse_clusters("participation")
        return self._participation

    def _refuse_clusters(self, what: str) -> None:
        if self.clusters:
            together = ", ".join(f"{p:.4g}" for p in self.clusters[0].poles)
            raise StructureError(
                f"poles {together} are not parted by a transformation of condition {_CONDITION:g}, so that their "
                f"{what} have no digits; responses and `clusters` have, and `single` is the form of all other modes"
            )

    @property
    def single(self) -> GeneralModalForm:
        """The form without its clusters."""
        return GeneralModalForm(self._poles, self._shapes, self._participation, self.feedthrough)

    def state_space(self) -> ct.StateSpace:
        """Real state space of the modes, block by block."""
        return ct.ss(*matrices_of(self), self.feedthrough)

    @cached_property
    def zeros(self) -> ComplexArray:
        """Invariant zeros, those of `state_space`; complex ones in exact pairs."""
        z = invariant_zeros(self.state_space())
        # quotients of a real pencil: the two of a pair are rounded apart
        upper, real = z[z.imag > 0], z[z.imag == 0]
        return np.sort_complex(np.concatenate([upper.conj(), real, upper]))

    def evaluate(self, s: ArrayLike) -> ComplexArray:
        """Transfer function at complex points, shape (p, m, N); `inf` at a pole, `D` at infinity, never NaN.

        Real at real points.
        """
        points = _checks.complex_points("the points", s)
        poles, residues = self._fractions
        out = np.empty((points.size, residues.shape[1]), complex)
        step = max(1, _BLOCK // max(1, len(poles)))
        for start in range(0, points.size, step):
            part = slice(start, start + step)
            with np.errstate(all="ignore"):
                gap = points[part, None] - poles
                inverse = 1.0 / gap
                beyond = ~np.isfinite(inverse)
                if beyond.any():  # at a pole, or at infinity
                    inverse[beyond] = 0.0
                out[part] = inverse @ residues
            if beyond.any():
                out[part][(beyond & np.isfinite(gap)) @ (residues != 0)] = np.inf
        out = out.T.reshape(self.noutputs, self.ninputs, -1) + self.feedthrough[:, :, None]
        for block in self.clusters:
            with np.errstate(all="ignore"):
                out += np.where(
                    np.isfinite(points), np.tensordot(block.triangular[2], block.states(points), axes=1), 0.0
                )
        out.imag[:, :, points.imag == 0] = 0.0  # terms of conjugate poles are rounded apart
        return np.where(np.isfinite(out), out, complex(np.inf, 0.0))

    def magnitude(self, s: ComplexArray) -> Array:
        """Bound of the sizes of what `evaluate` adds up at points, shape (N,)."""
        poles, c, b = self._both_halves
        weights = np.linalg.norm(c, axis=1) * np.linalg.norm(b, axis=1)
        with np.errstate(all="ignore"):
            size = (1 / np.abs(s[:, None] - poles)) @ weights + np.linalg.norm(self.feedthrough)
            for block in self.clusters:
                size += np.linalg.norm(block.states(s), axis=(0, 1)) * np.linalg.norm(block.C)
        return np.asarray(size, float)

    def __repr__(self) -> str:
        if self.clusters or self.feedthrough.any():
            return f"<ModalForm: {self.n} modes, {self.noutputs} outputs, {self.ninputs} inputs>"
        arrays = ",\n".join(literal(array) for array in (self._poles, self._shapes, self._participation))
        return f"modes(\n{arrays})"

    def _repr_latex_(self) -> str:
        return r"$$G(s) = D + \sum_l \frac{c_l b_l^\top}{s - p_l} + \frac{\bar c_l \bar b_l^\top}{s - \bar p_l}$$"

    def _repr_html_(self) -> str:
        rows = zip(range(1, self.n + 1), self.natural_frequencies, self.damping_ratios, strict=True)
        cells = [[f"{value:.7g}" for value in row] for row in rows]
        return self._repr_latex_() + html_table(["mode", "natural frequency", "damping ratio"], cells)


def invariant_zeros(sys: ct.StateSpace) -> ComplexArray:
    """Invariant zeros of a state space, by slycot with the room that many ports need, which is not its default.

    In the time of the poles and with inputs and outputs of one size, to which its tolerance refers.
    """
    n, m, p = sys.nstates, sys.ninputs, sys.noutputs
    if not n:
        return np.zeros(0, complex)
    rate, b, c = (_power_of_2(np.linalg.norm(M, axis=k)) for M, k in ((sys.A, None), (sys.B, 0), (sys.C, 1)))
    A, B, C, D = sys.A / rate, sys.B / b, sys.C / c[:, None], sys.D / c[:, None] / b * rate
    more = 3 * max(m, p)
    pencil = ab08nd(n, m, p, A, B, C, D, ldwork=max(m, p, n) + max(more, n + max(m, p)))
    count, first, second = pencil[0], pencil[8], pencil[9]
    if not count:
        return np.zeros(0, complex)
    return rate * eigvals(first[:count, :count], second[:count, :count]).astype(complex)


def _power_of_2(size: Any) -> Array:
    """The power of 2 next to each size, by which dividing rounds nothing; 1 for 0."""
    return np.asarray(np.exp2(np.round(np.log2(np.where(size > 0, size, 1.0)))))


def matrices_of(form: ModalForm) -> tuple[Array, Array, Array]:
    """Real matrices `A`, `B`, `C` of the modes, and of clusters where there are any, block by block."""
    A, B, C = real_matrices(*form.equations)
    A = block_diag(A, *(block.A for block in form.clusters))
    B = np.concatenate([B, *(block.B for block in form.clusters)])
    return A, B, np.hstack([C, *(block.C for block in form.clusters)])


def real_matrices(p: ComplexArray, b: ComplexArray, c: ComplexArray) -> tuple[Array, Array, Array]:
    """`A`, `B`, `C` of `x' = p x + b u`, `y = Re(c x)`: states are the real and imaginary parts, of real poles one."""
    even = 2 * np.arange(len(p))
    A = np.zeros((2 * len(p), 2 * len(p)))
    A[even, even] = A[even + 1, even + 1] = p.real
    A[even, even + 1], A[even + 1, even] = 0.0 - p.imag, p.imag
    B = np.stack([b.real, b.imag], axis=1).reshape(2 * len(p), b.shape[1])
    C = np.stack([c.real, 0.0 - c.imag], axis=2).reshape(len(c), 2 * len(p))
    kept = np.stack([p == p, p.imag != 0], axis=1).ravel()
    return A[np.ix_(kept, kept)], B[kept], C[:, kept]


# --- makers ------------------------------------------------------------------------------------------------------


def from_vectors(poles: ArrayLike, shapes: ArrayLike, participation: ArrayLike) -> ModalForm:
    """Check poles, shapes (n, p) and participation (n, m), and make a modal form, a lossless one of such residues."""
    p = np.atleast_1d(_checks.complex_points("the poles", poles))
    _checks.finite("the poles", p)
    c, b = (
        _checks.complex_matrix(name, np.reshape(value, (len(p), -1)) if np.ndim(value) < 2 else value, len(p))
        for name, value in (("shapes", shapes), ("participation", participation))
    )
    lower = np.flatnonzero(p.imag < 0)
    if lower.size:
        raise StructureError(
            f"pole {p[lower[0]]:.6g} is in the lower half-plane; give one of each pair of conjugates, that with a "
            "positive imaginary part"
        )
    real = p.imag == 0
    if np.any(c[real].imag != 0) or np.any(b[real].imag != 0):
        raise StructureError("shapes or participation of a real pole are complex; those of real poles are real")
    form = GeneralModalForm(p, c, b, np.zeros((c.shape[1], b.shape[1])))
    if not p.real.any() and c.shape == b.shape:
        exact = np.zeros(len(form.poles))
        with suppress(NotLosslessError):
            return decide(PoleResidueForm.simple(form.poles, form.residues, exact, exact, form.feedthrough)).modes
    return form


def with_damping(d: ArrayLike, r: ArrayLike, damping: ArrayLike) -> ModalForm:
    """Modes `kappa s / (s^2 + 2 zeta d s + d^2)`, `kappa = r d`, of one port, with the damping ratios `zeta`."""
    given, d = d, _checks.natural_frequencies(d)
    weights = _checks.residue_weights(r, len(d))
    zeta = _checks.real_array("damping", damping)
    if zeta.shape not in ((), d.shape):
        raise StructureError(f"damping has shape {zeta.shape}; it must be a number or one for each of {len(d)} modes")
    if not zeta.any():
        return from_frequencies(given, r)
    for name, array in (("d", d), ("r", weights), ("damping", zeta)):
        _checks.in_range(name, array)
    kappa = d * weights
    _checks.in_range("kappa = r d", kappa)
    zeta = np.broadcast_to(zeta, d.shape)
    square = (1.0 - zeta) * (1.0 + zeta)
    critical = np.abs(square) < _CONDITION**-2
    root = np.sqrt(np.abs(square))
    over, under = (square < 0) & ~critical, (square > 0) & ~critical
    p = d[under] * (-zeta[under] + 1j * root[under])
    # kappa p / (p - conj(p)), and of two real poles that with the smaller one from their product
    residue = kappa[under] * p / (2j * p.imag)
    fast = -d[over] * (zeta[over] + np.sign(zeta[over]) * root[over])
    slow = d[over] ** 2 / fast
    gain = kappa[over] / (fast - slow)
    poles = np.concatenate([p, fast, slow])
    weight = np.concatenate([residue, gain * fast, -gain * slow])
    blocks = [
        Cluster(x * np.array([[0.0, 1.0], [-1.0, -2.0 * z]]), np.array([[0.0], [k**0.5]]), np.array([[0.0, k**0.5]]))
        for x, z, k in zip(d[critical], zeta[critical], kappa[critical], strict=True)
    ]
    clusters = [Cluster(T, U.T @ block.B, block.C @ U) for block in blocks for T, U in [schur(block.A)]]
    return GeneralModalForm(poles, np.ones((len(poles), 1), complex), weight[:, None], np.zeros((1, 1)), clusters)


def from_state_space(sys: ct.StateSpace) -> GeneralModalForm:
    """Modes of a state space of continuous time."""
    return from_matrices(*(_checks.real_array(name, getattr(sys, name), 2) for name in "ABCD"))


def from_matrices(A: Array, B: Array, C: Array, D: Array) -> GeneralModalForm:
    """Split `C (s - A)^{-1} B + D` into modes, and into clusters where poles are not parted."""
    for name, matrix in (("A", A), ("B", B), ("C", C), ("D", D)):
        _checks.in_range(f"the state-space matrix {name}", matrix)
    if not len(A):
        return _of_single([], D, [])
    A, B, C = equilibrated(A, B, C)
    rounding = len(A) * _checks.EPS * float(np.linalg.norm(A))
    T, U = schur(A)
    T, X = _in_units_of_modes(T, U, rounding)
    T, X, sizes, _ = mb03rd(len(A), T, X, sort="C", pmax=_CONDITION)
    T, X = _in_units_of_modes(T, X, rounding)
    W = np.linalg.inv(X)
    inputs, outputs = W @ B, C @ X
    # what rounding of A makes of a real pole at 0
    noise = len(A) * _checks.EPS * np.sum((np.abs(W) @ np.abs(A)) * np.abs(X.T), axis=1)
    starts = np.concatenate([[0], np.cumsum(sizes)])
    parts = [slice(a, b) for a, b in pairwise(starts[: np.searchsorted(starts, len(A)) + 1])]
    single_modes, clusters = [], []
    for part in parts:
        mode = _single_mode(T[part, part], inputs[part], outputs[:, part], float(noise[part].max()))
        if mode is None:
            rounding = len(A) * _checks.EPS * float(np.prod([np.linalg.norm(M) for M in (W[part], A, X[:, part])]))
            block = _without_noise(T[part, part], rounding)
            clusters.append(Cluster(block, inputs[part].copy(), outputs[:, part].copy()))
        else:
            single_modes.append(mode)
    form = _of_single(single_modes, D, clusters)
    # shapes with a largest entry of 1; one that no output shows stays 0
    c = form._shapes
    lead = c[np.arange(len(c)), np.abs(c).argmax(axis=1)] if c.size else np.ones(len(c))
    lead = np.where(lead == 0, 1.0, lead)[:, None]
    return GeneralModalForm(form._poles, c / lead, form._participation * lead, D, clusters)


def _of_single(modes: Sequence[Mode], D: Array, clusters: Sequence[Cluster]) -> GeneralModalForm:
    """Modal form of modes one by one."""
    poles, c, b = zip(*modes, strict=True) if modes else ((), (), ())
    shapes = np.array(c, complex).reshape(len(modes), len(D))
    weights = np.array(b, complex).reshape(len(modes), len(D.T))
    return GeneralModalForm(np.array(poles, complex), shapes, weights, D, clusters)


def from_pole_residues(form: PoleResidueForm) -> GeneralModalForm:
    """Modes of poles with residues that stand out of their errors, each with the singular vectors of its residue.

    Poles that their errors do not tell from an axis lie on it.
    """
    if np.any(form.growth > SAFETY * form.growth_error):
        raise StructureError(
            "the system has repeated poles, which rounding of a sampled system scatters; give it in continuous time"
        )
    modes = []
    for pole, residue, error, reach in zip(
        form.poles, form.residues, SAFETY * form.residue_error, form.pole_error, strict=True
    ):
        if pole.imag < -reach:
            continue
        real = abs(pole.imag) <= reach
        U, s, Vh = np.linalg.svd(residue.real if real else residue)
        place = complex(0.0 if abs(pole.real) <= reach else pole.real, 0.0 if real else pole.imag)
        modes += [(place, U[:, k] * s[k], Vh[k]) for k in np.flatnonzero(s > error)]
    return _of_single(modes, form.feedthrough, [])


def refined(form: GeneralModalForm, A: Pair, B: Array, C: Array, D: Array) -> GeneralModalForm:
    """The form with modes corrected to first order by residuals of twice the digits, where they are not too many.

    `form` is that of `A`, with all states for its last inputs and outputs.  Single poles are then right to their own
    rounding as far as their condition allows, and clusters to that of their blocks.  `B`, `C` and `D` are those of all
    inputs and outputs.
    """
    size = len(A[0])
    poles, shapes, weights = form._both_halves
    blocks, n = [cluster.A for cluster in form.clusters], len(poles)
    ends = np.cumsum([n, *map(len, blocks)])
    if not 0 < size <= _REFINED or ends[-1] != size:
        return form
    parts = [slice(a, b) for a, b in pairwise(ends)]
    scale = dgebal(A[0], scale=1)[3]
    X = np.hstack([shapes[:, -size:].T, *(cluster.C[-size:] for cluster in form.clusters)]) / scale[:, None]
    W = np.vstack([weights[:, -size:], *(cluster.B[:, -size:] for cluster in form.clusters)]) * scale
    middle = np.diag(poles.astype(complex))
    middle = block_diag(middle, *blocks) if n else block_diag(*blocks).astype(complex)
    right_vectors, left_vectors = exactly(np.hstack([X.real, X.imag])), exactly(np.vstack([W.real, W.imag]))
    high, low = (part * scale / scale[:, None] for part in A)
    unit = _complex(product(left_vectors, right_vectors, 2), np.eye(size, dtype=complex))
    rest = _complex(product(left_vectors, product((high, low), right_vectors, 2), 2), middle) - unit @ middle
    try:
        turn = _turn(rest, poles, list(zip(parts, blocks, strict=True)))
    except np.linalg.LinAlgError:
        return form
    if not np.abs(unit).max() < _SLIGHT:
        return form
    X, W = (X + X @ turn) * scale[:, None], (W - unit @ W - turn @ W) / scale
    moved = np.where(poles == 0, 0.0, poles + np.diag(rest)[:n])
    kept, real = np.flatnonzero(poles.imag >= 0), poles.imag[poles.imag >= 0] == 0
    moved, columns, rows = moved[kept], X[:, kept], W[kept]
    moved, columns = np.where(real, moved.real, moved), np.where(real, columns.real, columns)
    rows = np.where(real[:, None], rows.real, rows)
    clusters = []
    for part, block in zip(parts, blocks, strict=True):
        T, U = schur(block + rest[part, part].real)
        T = _without_noise(T, 8 * len(T) * _checks.EPS * float(np.linalg.norm(T)))
        clusters.append(Cluster(T, U.T @ W[part].real @ B, C @ X[:, part].real @ U))
    return GeneralModalForm(moved, (C @ columns).T.copy(), rows @ B, D, clusters)


def _turn(rest: ComplexArray, poles: ComplexArray, blocks: list[tuple[slice, Array]]) -> ComplexArray:
    """Solution of `Z M - M Z = rest` off the blocks of `M`, those of poles and these; 0 where it is not small."""
    turn, n = np.zeros_like(rest), len(poles)
    with np.errstate(all="ignore"):
        turn[:n, :n] = rest[:n, :n] / (poles - poles[:, None])
    np.fill_diagonal(turn, 0.0)
    for part, T in blocks:
        away = poles[:, None, None] * np.eye(len(T)) - T
        turn[part, :n] = np.linalg.solve(away, rest[part, :n].T[:, :, None])[:, :, 0].T
        turn[:n, part] = -np.linalg.solve(away.transpose(0, 2, 1), rest[:n, part][:, :, None])[:, :, 0]
        for other, T2 in blocks:
            if other != part:
                turn[part, other] = _sylvester(-T, T2, rest[part, other])
    # a block moves as a whole, or not at all
    starts = np.concatenate([np.arange(n), [part.start for part, _ in blocks]]).astype(int)
    largest = np.maximum.reduceat(np.maximum.reduceat(np.abs(turn), starts, axis=0), starts, axis=1)
    sizes = np.diff([*starts, len(turn)])
    kept = np.repeat(np.repeat(largest < _SLIGHT, sizes, axis=0), sizes, axis=1)
    return np.where(kept, turn, 0.0)


def _sylvester(A: Array, B: Array, C: ComplexArray) -> ComplexArray:
    """Solution of `A Z + Z B = C`: of small blocks as one system, since LAPACK's is wrong for nearly defective ones."""
    if C.size > _TOGETHER:
        return np.asarray(solve_sylvester(A, B, C))
    together = np.kron(A, np.eye(len(B))) + np.kron(np.eye(len(A)), B.T)
    return np.asarray(np.linalg.solve(together, C.ravel()).reshape(C.shape), complex)


def _complex(pair: Pair, less: ComplexArray) -> ComplexArray:
    """`(a + i b) (c + i d)` of the four blocks of `[a; b] [c, d]`, less a matrix, both with the digits of pairs."""
    (rr, ri), (ir, ii) = ([(high, low) for high, low in zip(*row, strict=True)] for row in zip(
        *([np.split(block, 2, axis=1) for block in np.split(part, 2)] for part in pair), strict=True
    ))  # fmt: skip
    real, imag = add(rr, (-ii[0], -ii[1])), add(ri, ir)
    none = np.zeros(less.shape)
    (a, b), (c, d) = add(real, (-less.real, none)), add(imag, (-less.imag, none))
    return (a + b) + 1j * (c + d)


def _without_noise(block: Array, noise: float) -> Array:
    """Block with real poles of 0 in place of what rounding has made of them, as of rigid-body modes."""
    below = np.concatenate([[0.0], np.diag(block, -1), [0.0]])
    still = (np.abs(np.diag(block)) <= noise) & (below[:-1] == 0) & (below[1:] == 0)
    cleared = block.copy()
    cleared[np.diag_indices_from(block)] = np.where(still, 0.0, np.diag(block))
    return cleared


def _in_units_of_modes(T: Array, X: Array, rounding: float) -> tuple[Array, Array]:
    """`T` and `X`, `A X = X T`, with states in units in which both halves of each 2 x 2 block of `T` are alike in size.

    Modes far slower or faster than others have blocks that are out of scale, and are no less sure.  Poles that nearly
    coincide, or are 0 but for rounding, have such blocks by nature: they stay.
    """
    units = np.ones(len(T))
    for k in np.flatnonzero(np.diag(T, -1)):
        up, down = abs(T[k, k + 1]), abs(T[k + 1, k])
        if np.sqrt(up) * np.sqrt(down) * _CONDITION >= abs(T[k, k]) and min(up, down) > _CONDITION * rounding:
            units[k + 1] = 2.0 ** round(0.5 * np.log2(down / up))  # a power of 2 rounds nothing
    return T * units / units[:, None], X * units


def _single_mode(block: Array, b: Array, c: Array, noise: float) -> Mode | None:
    """Pole, shape and participation of a block of one mode; None if it is of more, or two that nearly coincide."""
    if len(block) == 1:
        return complex(block[0, 0] if abs(block[0, 0]) > noise else 0.0), c[:, 0], b[0]
    up, down = block[0, 1], block[1, 0]
    if len(block) > 2 or up * down >= 0 or max(abs(up / down), abs(down / up)) > _CONDITION**2:
        return None
    turn = np.sqrt(abs(up)) * np.sqrt(abs(down))
    return complex(block[0, 0], turn), c[:, 0] * up + 1j * turn * c[:, 1], 0.5 * (b[0] / up - 1j * b[1] / turn)
