"""Poles and residues of any linear system, each with an honest bound of its error.

Three routes, one result: from state space by the blocks of a Schur form, from polynomials by their roots,
from zeros and poles by products.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import schur
from scipy.linalg.lapack import ztrtrs

from .. import _checks
from .._types import Array, ComplexArray, Indices, Mask
from ..exceptions import NotLosslessError, StructureError
from .graphs import components
from .invariant_subspaces import SAFETY, balanced, clusters, eigenvalues_of, invariant_block, reordered, schur_form
from .polynomials import COEFFICIENT_LIMIT, fractions_from_coefficients

_PARALLEL = np.sqrt(_checks.EPS)  # eigenvectors that nearly coincide are those of a Jordan block


@dataclass(frozen=True)
class PoleResidueForm:
    """Poles (N,), residue matrices (N, p, m), error bounds of both (N,), feedthrough (p, m).

    `growth` (N,) is the coefficient of `1/(s - pole)^2`, or what stands for it in a higher pole: 0 where it is simple.
    `gain` is the size that residues could have if nothing cancelled.  `resolvents` are those of the matrices that the
    form was made of.
    """

    poles: ComplexArray
    residues: ComplexArray
    pole_error: Array
    residue_error: Array
    growth: Array
    growth_error: Array
    gain: float
    feedthrough: Array
    resolvents: tuple[Resolvent, ...] = ()
    feedthrough_error: float = 0.0

    @classmethod
    def simple(
        cls, poles: ComplexArray, residues: ComplexArray, pole_error: Array, residue_error: Array, feedthrough: Array
    ) -> PoleResidueForm:
        """Form of poles that are known to be simple."""
        none, gain = np.zeros(len(poles)), float(np.abs(residues).max(initial=0.0))
        return cls(poles, residues, pole_error, residue_error, none, none, gain, feedthrough)

    def error(self, points: ComplexArray) -> Array:
        """Bound of the errors of values at points, (N,)."""
        away = np.abs(points[:, None] - self.poles)
        moved = self.residue_error + np.linalg.norm(self.residues, axis=(1, 2)) * self.pole_error / away
        return np.asarray(SAFETY * np.sum(moved / away, axis=1) + self.feedthrough_error, float)

    def check_range(self) -> None:
        """Refuse numbers that left the range of doubles."""
        errors = self.pole_error, self.residue_error, self.growth, self.growth_error
        _checks.representable("the poles and residues of the system", self.poles, self.residues, *errors)
        _checks.in_range("the list of residues", np.abs(self.residues))


class Resolvent(NamedTuple):
    """`outputs (s - T)^{-1} inputs` of a triangular matrix, which is known up to `backward`."""

    T: ComplexArray
    inputs: ComplexArray
    outputs: ComplexArray
    backward: float

    @classmethod
    def of(cls, A: Array, B: Array, C: Array) -> Resolvent:
        """Resolvent of `C (s - A)^{-1} B`, with the backward error of the Schur form of `A`."""
        T, Z = schur_form(A)
        return cls(T, Z.conj().T @ B, C @ Z, len(A) * _checks.EPS * float(np.linalg.norm(A)))

    def evaluate(self, points: ComplexArray) -> tuple[ComplexArray, Array]:
        """Values at points, (N, p, m), and first-order bounds of their errors, (N,).  O(n^2) a point."""
        n = len(self.T)
        into = np.empty((len(points), n, self.inputs.shape[1]), complex)
        out = np.empty((len(points), n, len(self.outputs)), complex)
        if not (self.inputs.size and self.outputs.size):
            return np.zeros((len(points), len(self.outputs), self.inputs.shape[1]), complex), np.zeros(len(points))
        for k, s in enumerate(points):
            shifted = s * np.eye(n) - self.T
            into[k] = ztrtrs(shifted, self.inputs)[0]
            out[k] = ztrtrs(shifted, self.outputs.T, trans=1)[0]
        return self.outputs @ into, self.backward * np.linalg.norm(into, axis=(1, 2)) * np.linalg.norm(out, axis=(1, 2))


# --- state space -----------------------------------------------------------------------------------------------


def from_state_space(A: Array, B: Array, C: Array, D: Array, rest: float = 0.0) -> PoleResidueForm:
    """Poles and residues of `C (sI - A)^{-1} B + D`, with bounds for a backward error `n eps ||A||` of the balanced A.

    Modes are first taken apart, each pole alone or, where eigenvectors nearly coincide, each cluster of poles as one
    block.  So no rank decides what ports see: a part that none does has a residue of zero within its bound.  Only at
    `rest`, the pole of rigid bodies, ranks tell the Jordan chains: 0, or 1 in discrete time.
    """
    A, B, C = _connected(A, B, C)
    count, label = components(A != 0)
    parts = [np.flatnonzero(label == k) for k in range(count)]
    # parts that do not act on one another have units and rounding errors of their own
    forms = [_from_coupled_states(A[np.ix_(part, part)], B[part], C[:, part], D, rest) for part in parts]
    return _joined(forms, [form.residues for form in forms], D) if forms else _static(D)


def _joined(forms: list[PoleResidueForm], residues: list[ComplexArray], feedthrough: Array) -> PoleResidueForm:
    """One form with the poles of all, which have these residues in it."""
    names = "poles", "pole_error", "residue_error", "growth", "growth_error"
    together: dict[str, Any] = {name: np.concatenate([getattr(form, name) for form in forms]) for name in names}
    resolvents = tuple(part for form in forms for part in form.resolvents)
    gain = max(form.gain for form in forms)
    return PoleResidueForm(
        residues=np.concatenate(residues), gain=gain, feedthrough=feedthrough, resolvents=resolvents, **together
    )


def _from_coupled_states(A: Array, B: Array, C: Array, D: Array, rest: float) -> PoleResidueForm:
    A, B, C = balanced(A, B, C)
    _checks.representable("the balanced state-space matrices", A, B, C)
    given = Resolvent.of(A, B, C)
    resolvent, sizes = _rest_first(given, rest)
    blocks = _spectral_blocks(resolvent, sizes, rest)
    residue_error = _residue_errors(blocks, resolvent.backward, B, C)
    errors = [
        _block_errors(block, resolvent.backward / block.separation, error)
        for block, error in zip(blocks, residue_error, strict=True)
    ]
    pole_error, growth, growth_error = np.array(errors).T
    poles = np.array([block.center for block in blocks])
    residues = np.array([block.outputs @ block.inputs for block in blocks])
    gain = float(np.linalg.norm(B) * np.linalg.norm(C))
    return PoleResidueForm(poles, residues, pole_error, residue_error, growth, growth_error, gain, D, (given,))


def _connected(A: Array, B: Array, C: Array) -> tuple[Array, Array, Array]:
    """Leave out the states that no path of non-zero entries joins to an input and to an output."""
    forward = _reached(A != 0, (B != 0).any(axis=1))
    live = np.flatnonzero(forward & _reached((A != 0).T, (C != 0).any(axis=0)))
    return A[np.ix_(live, live)], B[live], C[:, live]


def _reached(links: Mask, start: Mask) -> Mask:
    """Which nodes a walk along `links` (to row, from column) reaches from those at the start."""
    reached = start
    while True:
        grown = reached | links[:, reached].any(axis=1)
        if (grown == reached).all():
            return grown
        reached = grown


def _static(D: Array) -> PoleResidueForm:
    none = np.zeros(0)
    return PoleResidueForm.simple(none.astype(complex), np.zeros((0, *D.shape), complex), none, none, D)


@dataclass(frozen=True)
class _Block:
    """The part `outputs (s - center - N)^{-1} inputs` of a transfer function, with k poles around a center.

    `separation` is the cosine between the left and the right invariant subspace, 1 for a normal matrix: what a
    perturbation of `A` may be divided by to bound the motion of the center.
    """

    center: complex
    N: ComplexArray
    outputs: ComplexArray
    inputs: ComplexArray
    separation: float
    index: int  # power of `N` that is zero
    known: float = np.inf  # a bound of the error of its residue


def _spectral_blocks(resolvent: Resolvent, sizes: list[int], rest: float) -> list[_Block]:
    """One block for all eigenvalues at `rest`; else one for each, or for several that rounding does not tell apart."""
    T, to_modes, from_modes, backward = resolvent
    still = sum(sizes)
    values, left_vectors, right_vectors, overlap, separation = eigenvalues_of(T)
    # the eigenvalues of a Jordan block of size k scatter by eps^(1/k)
    radius = np.minimum(SAFETY * backward / separation, 4 * _checks.EPS**0.25 * np.linalg.norm(T))
    blocks = []
    if still:
        block = _joint_block(T, to_modes, from_modes, np.arange(still))
        N = np.triu(T[:still, :still], 1)
        # the residue is the integral along a circle around all that is at rest, and nothing else
        size = 0.5 * float(np.min(np.abs(values[still:] - rest), initial=2 * np.linalg.norm(T))) or 1.0
        circle = rest + size * np.exp(1j * np.pi * (np.arange(4) + 0.5) / 4)
        known = size * float(np.mean(resolvent.evaluate(circle)[1]))
        blocks.append(_Block(complex(rest), N, block.outputs, block.inputs, block.separation, len(sizes), known))
    for group in clusters(values[still:], radius[still:]):
        group = group + still
        l = group[0]
        if len(group) > 1 or separation[l] <= len(T) * _PARALLEL:
            # vectors of coinciding eigenvalues are not biorthogonal, and those of a Jordan block parallel
            blocks.append(_joint_block(T, to_modes, from_modes, group))
        else:
            inputs = left_vectors[None, :, l].conj() @ to_modes / overlap[l]
            outputs = from_modes @ right_vectors[:, [l]]
            blocks.append(_Block(values[l], np.zeros((1, 1), complex), outputs, inputs, separation[l], 1))
    return blocks


def _rest_first(resolvent: Resolvent, rest: float) -> tuple[Resolvent, list[int]]:
    """Bring the eigenvalues `rest` of a Schur form to its top, exactly; also the sizes of the steps of their chains.

    Rounding scatters the eigenvalues of Jordan chains, and takes those of several apart at random; the dimensions of
    the kernels of `T - rest` and of its powers remain.
    """
    T, inputs, outputs, backward = resolvent
    size = float(np.linalg.norm(T))
    near = np.flatnonzero(np.abs(np.diag(T) - rest) <= 4 * _checks.EPS**0.25 * size)
    m = len(near)
    if m == 0:
        return resolvent, []
    S, Q, _ = reordered(T, near)
    V, remainder = np.eye(m, dtype=complex), S[:m, :m] - rest * np.eye(m)
    sizes: list[int] = []
    low = high = SAFETY * backward
    while len(remainder):
        _, sigma, Wh = np.linalg.svd(remainder)
        # what is no more than the error of the steps before may be 0: the widest gap tells
        ladder = np.concatenate([[size], np.maximum(sigma, backward), [backward]])
        least, most = int(np.sum(sigma > high)), int(np.sum(sigma > low))
        rank = least + int(np.argmax(ladder[least : most + 1] / ladder[least + 1 : most + 2]))
        if rank == len(remainder):
            break
        high *= max(1.0, size / sigma[rank - 1]) if rank else 1.0
        W = np.roll(Wh.conj().T, len(remainder) - rank, axis=1)
        V[:, sum(sizes) :] = V[:, sum(sizes) :] @ W
        sizes.append(len(remainder) - rank)
        W = W[:, sizes[-1] :]
        remainder = W.conj().T @ remainder @ W
    k = sum(sizes)
    if k == 0:
        return resolvent, []
    remainder, W = schur(remainder, output="complex") if k < m else (remainder, remainder)
    V[:, k:] = V[:, k:] @ W
    S[:, :m] = S[:, :m] @ V
    S[:m] = V.conj().T @ S[:m]
    # a step maps into those before it
    step = np.concatenate([np.repeat(np.arange(len(sizes)), sizes), np.full(m - k, len(sizes))])
    exact = np.where(step[:, None] < step, S[:m, :m], 0.0) + rest * np.eye(m)
    exact[k:, k:] = remainder + rest * np.eye(m - k)
    backward = max(backward, float(np.linalg.norm(S[:m, :m] - exact)))
    S[:m, :m] = exact
    Q[:, :m] = Q[:, :m] @ V
    return Resolvent(S, Q.conj().T @ inputs, outputs @ Q, backward), sizes


def _joint_block(T: ComplexArray, B: ComplexArray, C: ComplexArray, group: Indices) -> _Block:
    """Block of a cluster of eigenvalues, about the place of the pole that ports see."""
    part = invariant_block(T, group)
    outputs, inputs, values = C @ part.columns, part.rows @ B, np.diag(part.T)
    center = values.mean()
    N = part.T - center * np.eye(len(group))
    # a single visible pole r/(s - p) among hidden ones has the moments r, r (p - center): move the center to it
    residue, moment = outputs @ inputs, outputs @ N @ inputs
    size = np.vdot(residue, residue).real
    shift = np.vdot(residue, moment) / size if size > 0 else 0.0
    if abs(shift) > np.abs(values - center).max():
        shift = 0.0
    return _Block(center + shift, N - shift * np.eye(len(group)), outputs, inputs, part.separation, len(group))


def _residue_errors(blocks: list[_Block], backward: float, B: Array, C: Array) -> Array:
    """First-order bounds: the backward error tilts each block towards the others, more the nearer they are."""
    center = np.array([block.center for block in blocks])
    separation = np.array([block.separation for block in blocks])
    spread = np.array([np.linalg.norm(block.N) for block in blocks])
    count = np.array([len(block.N) for block in blocks])
    index = np.array([block.index for block in blocks])
    error = backward / separation
    out_error = np.full(len(blocks), _checks.EPS * np.linalg.norm(C))
    in_error = np.full(len(blocks), _checks.EPS * np.linalg.norm(B))
    for j, other in enumerate(blocks):
        gap = center - other.center
        # modes at the same place mix freely: only their sum is used, so they do not disturb one another
        apart = np.abs(gap) > SAFETY * (error + error[j])
        resolvent = np.linalg.inv(np.where(apart, gap, 1.0)[:, None, None] * np.eye(count[j]) - other.N)
        x, y = other.outputs @ resolvent, resolvent @ other.inputs
        # X -> (c_i + N_i) X - X (c_j + N_j) is inverted by a series that ends where powers of N_i do
        for power in range(index.max()):
            reached = apart & (power < index)
            out_error += np.where(reached, spread**power * np.linalg.norm(x, axis=(1, 2)) * error[j], 0.0)
            in_error += np.where(reached, spread**power * np.linalg.norm(y, axis=(1, 2)) * backward, 0.0)
            x, y = x @ resolvent, resolvent @ y
    in_error = in_error / separation
    out_size = np.array([np.linalg.norm(block.outputs) for block in blocks])
    in_size = np.array([np.linalg.norm(block.inputs) for block in blocks])
    return np.minimum(out_error * in_size + out_size * in_error + out_error * in_error, [b.known for b in blocks])


def _block_errors(block: _Block, pole_error: float, residue_error: float) -> tuple[float, float, float]:
    """Error of the pole; and of the coefficients of its higher powers, the one that stands out most, with its error."""
    spread = float(np.linalg.norm(block.N))
    if spread == 0.0:
        return pole_error, 0.0, 0.0
    size = float(np.linalg.norm(block.outputs) * np.linalg.norm(block.inputs))
    residue = float(np.linalg.norm(block.outputs @ block.inputs))
    # what ranks have put at rest is there
    if residue > residue_error and np.diag(block.N).any():
        moved = pole_error + (residue_error * spread + size * pole_error) / residue
    else:
        moved = pole_error
    moments = []
    x = spread * block.inputs
    for power in range(1, len(block.N) + 1):
        x = block.N @ x / spread
        moments.append((float(np.linalg.norm(block.outputs @ x)), residue_error * spread + power * size * pole_error))
    return moved, *max(moments, key=lambda moment: moment[0] - SAFETY * moment[1])


# --- polynomials and zero-pole-gain ------------------------------------------------------------------------------


def from_polynomials(num: Array, den: Array) -> PoleResidueForm:
    """Poles and residues of `num/den` (descending powers), in a time scaled to the size of the poles.

    Simple poles on the axis are found with twice the digits, any others by a companion form.
    """
    num, den = np.trim_zeros(num, "f"), np.trim_zeros(den, "f")
    if len(den) == 0:
        raise StructureError("the denominator is zero; a transfer function needs a non-zero denominator")
    if len(num) > len(den):
        raise NotLosslessError(
            [
                f"the transfer function is improper: numerator of degree {len(num) - 1} over degree {len(den) - 1}, "
                "expected less"
            ]
        )
    while len(num) and num[-1] == 0 and den[-1] == 0:
        num, den = num[:-1], den[:-1]
    if len(num) and (exact := _on_the_axis(num, den)) is not None:
        return exact
    order = len(den) - 1
    scale = _time_scale(den)
    powers = scale ** -np.arange(order + 1.0)
    top = den[0]
    den = den / top * powers
    num = np.concatenate([np.zeros(order + 1 - len(num)), num]) / top * powers
    feedthrough, num = num[0], (num - num[0] * den)[1:]
    D = np.array([[feedthrough]])
    A = scale * np.eye(order, k=-1)
    A[:1] = -scale * den[1:]
    _checks.representable("the coefficients of the transfer function", D, A, num)
    if order == 0 or not num.any():
        return _static(D)
    _checks.in_range("the transfer function in the unit of its poles", np.append(A, num))
    form = from_state_space(A, np.eye(order)[:, :1] * scale, num[None, :], D)
    return replace(form, resolvents=())


def _time_scale(den: Array) -> np.float64:
    """Power of two near the geometric mean of the non-zero roots."""
    nonzero = np.flatnonzero(den)
    first, last = nonzero[0], nonzero[-1]
    if first == last:
        return np.float64(1.0)
    mean = (np.log2(np.abs(den[last])) - np.log2(np.abs(den[first]))) / (last - first)
    return np.float64(2.0) ** np.round(mean)


def _on_the_axis(num: Array, den: Array) -> PoleResidueForm | None:
    """Form with twice the digits if the denominator is even, or that times `s`, with simple roots on the axis."""
    order, still = len(den) - 1, 1 - len(den) % 2
    P, c = den[::-1] / den[0], num[::-1] / den[0]
    if P[1 - still :: 2].any() or P[still::2].min() <= 0 or order < 2 or len(num) > order:
        return None
    if not (np.isfinite(P).all() and np.isfinite(c).all()):
        return None
    fractions = fractions_from_coefficients(P[still:-1:2], c[0::2], c[1::2])
    if fractions is None or np.max(fractions[0][1] / fractions[0][0]) > COEFFICIENT_LIMIT:
        return None
    (d, d_error), (even, even_error), (odd, odd_error) = fractions
    upper = 0.5 * (odd - 1j * even / d) / (1j * d) ** still
    error = 0.5 * (odd_error + even_error / d) / d**still + np.abs(upper) * d_error / d
    at_zero = c[:still] / P[still]
    # coefficients may be rounded more than once
    poles, residues = np.concatenate([[0.0] * still, 1j * d, -1j * d]), np.concatenate([at_zero, upper, upper.conj()])
    pole_error = 2 * order * np.concatenate([[0.0] * still, d_error, d_error])
    residue_error = 2 * order * np.concatenate([_checks.EPS * np.abs(at_zero), error, error])
    return PoleResidueForm.simple(poles, residues[:, None, None], pole_error, residue_error, np.zeros((1, 1)))


def from_zeros_poles(z: ComplexArray, p: ComplexArray, gain: float) -> PoleResidueForm:
    """Poles and residues of `gain prod(s - z) / prod(s - p)`, by products: no polynomial is formed."""
    zeros, poles = list(z), list(p)
    if len(zeros) > len(poles):
        raise NotLosslessError([f"the system is improper: {len(zeros)} zeros over {len(poles)} poles, expected less"])
    close = 8 * max(1, len(poles)) * _checks.EPS
    for zero in tuple(zeros):
        match = [pole for pole in poles if abs(pole - zero) <= close * abs(zero)]
        if match:
            zeros.remove(zero)
            poles.remove(match[0])
    z, p = np.array(zeros, complex), np.array(poles, complex)
    D = np.array([[gain if len(z) == len(p) else 0.0]])
    if gain == 0 or len(p) == 0:
        return _static(D)
    gaps = p[:, None] - p
    near = (np.abs(gaps) <= close * np.abs(p)[:, None]) & ~np.eye(len(p), dtype=bool)
    # of a repeated pole this leaves the coefficient of its highest power
    gaps[near | np.eye(len(p), dtype=bool)] = 1.0
    from_zeros = p[:, None] - z
    # zeros and poles in turn, so that long products neither over- nor underflow
    ratio = np.concatenate([from_zeros, np.ones((len(p), len(p) - len(z)))], axis=1) / gaps
    residues = gain * np.prod(ratio, axis=1)
    sizes = np.abs(z / np.where(from_zeros == 0, 1.0, from_zeros)).sum(axis=1) + np.abs(p / gaps).sum(axis=1)
    size = np.abs(residues)
    error = _checks.EPS * (2 * len(p) + sizes) * size
    growth, growth_error = (np.where(near.any(axis=1), part, 0.0) for part in (size, error))
    pole_error = _checks.EPS * np.abs(p)
    return PoleResidueForm(p, residues[:, None, None], pole_error, error, growth, growth_error, float(size.max()), D)


def from_fractions(num: list[list[Array]], den: list[list[Array]]) -> PoleResidueForm:
    """One form from the polynomials of the entries; the poles that they share are not merged."""
    entries = [[from_polynomials(*pair) for pair in zip(*rows, strict=True)] for rows in zip(num, den, strict=True)]
    if len(entries) == len(entries[0]) == 1:
        return entries[0][0]
    flat = [entry for row in entries for entry in row]
    p, m = len(entries), len(entries[0])
    residues = []
    for place, entry in enumerate(flat):
        block = np.zeros((len(entry.poles), p, m), complex)
        block[:, place // m, place % m] = entry.residues[:, 0, 0]
        residues.append(block)
    return _joined(flat, residues, np.array([entry.feedthrough[0, 0] for entry in flat]).reshape(p, m))
