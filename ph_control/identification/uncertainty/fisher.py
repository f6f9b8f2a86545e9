"""Fisher information of a model at a record: what the outputs tell of `d`, `r` and the initial state.

With white output noise the information is `J^T J / sigma^2`, `J` the sensitivities of the output.  Their columns are
brought to unit length first, so that no verdict depends on units: `J^T J` is then a correlation matrix, and how far its
inverse exceeds 1 tells how much a parameter suffers from not knowing the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import qr

from ... import _checks
from ..._checks import EPS
from ..._frozen import Frozen
from ..._types import Array, ComplexArray, Mask
from ..._units import DERIVATIVES
from ...modal.discretization import Hold
from ...modal.modal_form import imaginary
from ..regression.elimination import eliminate, reduced
from ..regression.free import pole_derivatives
from ..regression.modal_regressors import SHORT, Kernel, SampledModes, output_weight
from ..regression.time_rows import FreeRecord

NEARLY_BLIND = 0.01  # singular value below which a combination counts: its errors are inflated a hundred times
_ROUNDED = 0.01  # relative difference of weights that are sorted as equal
_STATE = "(0)"  # end of the name of an initial state
_MINOR = 0.02  # weight below which a coefficient is not printed
_LARGEST_ROUNDING = 1e-3  # of a null vector: without a gap, what takes part in it counts as blind
_MANY = 8  # items of a list in a sentence
_TOGETHER = 1 << 12  # groups of samples whose states are worked out at a time
_LISTED = 6  # coefficients of a combination that are printed


@dataclass(frozen=True)
class Combination:
    """A direction in the parameters that the output does not show, or hardly.

    Attributes
    ----------
    parameters : tuple of str
        Names, heaviest first: `d_1`, `r_1`, `Re x_1(0)`, `Im x_1(0)`.
    coefficients : tuple of float
        Changes of these parameters, in their own units, that cancel in the output; the first is 1.
    weights : tuple of float
        Size of their parts in the output, the first 1, falling.
    inflation : float
        Factor by which errors along this direction exceed those of a parameter seen alone; `inf` where blind.

    Notes
    -----
    The order is by weight, and so does not depend on units; what is equal to a percent is in the order of the model.
    """

    parameters: tuple[str, ...]
    coefficients: tuple[float, ...]
    weights: tuple[float, ...]
    inflation: float

    @property
    def words(self) -> str:
        """The parameters in plain words, as in 'r_1 and r_2 with the initial states of modes 1 and 2'."""
        direct = [name for name in self.parameters if not name.endswith(_STATE)]
        moving = sorted({int(name[5 : -len(_STATE)]) for name in self.parameters if name.endswith(_STATE)})
        parts = [listed(direct)] if direct else []
        if moving:
            parts.append(f"the initial state{'s' * (len(moving) > 1)} of {named_modes(moving)}")
        return " with ".join(parts)

    def __str__(self) -> str:
        if len(self.parameters) == 1:
            return self.words
        components = zip(self.parameters, self.coefficients, self.weights, strict=True)
        terms = [f"{name} {value:+.3g}" for name, value, weight in components if weight >= _MINOR][:_LISTED]
        return f"{self.words} (in the ratio {', '.join(terms)})"


def listed(items: list[str] | list[int]) -> str:
    """Items with commas and an 'and', many of them cut short."""
    words = [str(item) for item in items]
    if len(words) > _MANY:
        words = [*words[: _MANY - 1], f"{len(words) - _MANY + 1} more"]
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]


def named_modes(numbers: list[int]) -> str:
    """Modes by their numbers, as in 'modes 1 and 2'."""
    return f"mode{'s' * (len(numbers) > 1)} {listed(numbers)}"


def parameter_names(n: int, from_rest: bool = False) -> tuple[str, ...]:
    """Names of `(d, r, Re x(0), Im x(0))`, modes counted from 1."""
    kinds = ("d_{}", "r_{}") if from_rest else ("d_{}", "r_{}", "Re x_{}" + _STATE, "Im x_{}" + _STATE)
    return tuple(kind.format(l + 1) for kind in kinds for l in range(n))


@dataclass(frozen=True, eq=False)
class Information(Frozen):
    """Fisher information for unit noise, factored: sensitivities `= U diag(singular_values) vectors diag(lengths)`.

    Attributes
    ----------
    names : tuple of str
        The P parameters.
    lengths : ndarray, shape (P,)
        Norm of each sensitivity; its inverse is the standard error of a parameter were all others known.
    singular_values : ndarray, shape (P,)
        Of the sensitivities scaled to unit length, descending; squared, the eigenvalues of the information then.
    vectors : ndarray, shape (P, P)
        Right singular vectors, one in each row.
    tolerance : float
        Relative size below which a singular value counts as 0: the larger side of the sensitivities times eps, because
        each column comes from a recursion over the samples, whose rounding grows with their number; more where outputs
        are small beside the states that they are the real parts of, as far above the band of the input.
    """

    names: tuple[str, ...]
    lengths: Array
    singular_values: Array
    vectors: Array
    tolerance: float

    @classmethod
    def of(cls, sensitivities: Array, names: tuple[str, ...], *, rows: int, sizes: Array | None = None) -> Information:
        """Factor sensitivities (N, P), or any matrix with the same Gram matrix, such as the R of their QR.

        `rows` is the number of samples they came from, `sizes` (P,) the norms of the states that the columns are the
        real parts of: what is small beside them is their rounding.
        """
        size = sensitivities.shape[1]
        tolerance = max(rows, size) * EPS
        lengths = np.linalg.norm(sensitivities, axis=0)
        _checks.representable("the sensitivities of the output", lengths)
        if sizes is not None:
            lengths = np.where(lengths > tolerance * sizes, lengths, 0.0)
            tolerance *= max(1.0, float(np.max(sizes[lengths > 0] / lengths[lengths > 0], initial=1.0)))
        scaled = np.where(lengths > 0, sensitivities, 0.0) / np.where(lengths > 0, lengths, 1.0)
        if len(scaled) > size:
            scaled = np.asarray(np.linalg.qr(scaled, mode="r"))
        padded = np.zeros((size, size))
        padded[: len(scaled)] = scaled
        _, sigma, vectors = np.linalg.svd(padded)
        return cls(names, lengths, sigma, vectors, tolerance)

    @cached_property
    def rank(self) -> int:
        """Number of independent combinations of parameters that the output shows."""
        return int(np.sum(self.singular_values > self.tolerance * self.singular_values.max(initial=0.0)))

    @property
    def deficiency(self) -> int:
        """Number of combinations that leave no trace."""
        return len(self.names) - self.rank

    @property
    def is_weak(self) -> bool:
        """Whether some combination is blind, or nearly."""
        return bool(self.deficiency or self.nearly_blind)

    @property
    def condition(self) -> float:
        """Condition number of the information in correlation form; `inf` where a combination is blind."""
        if self.deficiency or not self.names:
            return np.inf if self.names else 1.0
        return float((self.singular_values[0] / self.singular_values[-1]) ** 2)

    @cached_property
    def _blind_part(self) -> Array:
        """Norm of each parameter's component in the null space; 0 where that is rounding."""
        part = np.linalg.norm(self.vectors[self.rank :], axis=0)
        # a null vector is known to the tolerance over the distance to the next singular value
        gap = self.singular_values[self.rank - 1] / self.singular_values[0] if self.rank else 1.0
        rounding = float(np.clip(len(self.names) * self.tolerance / gap, np.sqrt(EPS), _LARGEST_ROUNDING))
        return _checks.readonly(np.where(part > rounding, part, 0.0))

    @cached_property
    def inflation(self) -> Array:
        """Factor by which not knowing the other parameters enlarges each standard error, shape (P,), >= 1."""
        kept = slice(0, self.rank)
        seen = np.linalg.norm(self.vectors[kept] / self.singular_values[kept, None], axis=0)
        return _checks.readonly(np.where(self._blind_part > 0, np.inf, seen))

    def stderr(self, noise_std: float) -> Array:
        """Cramer-Rao bounds on the standard errors, shape (P,); `inf` for parameters in a blind combination."""
        with np.errstate(divide="ignore"):
            return np.where(self._blind_part > 0, np.inf, noise_std * self.inflation / self.lengths)

    @property
    def blind_parameters(self) -> tuple[str, ...]:
        """Parameters that no number of such records determines."""
        return tuple(name for name, part in zip(self.names, self._blind_part, strict=True) if part > 0)

    @cached_property
    def blind(self) -> tuple[Combination, ...]:
        """A basis of the combinations that leave no trace, each of as few parameters as elimination gives."""
        null = self.vectors[self.rank :]
        if not null.size:
            return ()
        pivots = qr(null, mode="r", pivoting=True)[1][: len(null)]
        sparse = np.linalg.solve(null[:, pivots], null) * (self._blind_part > 0)
        combinations = [self._combination(v, np.inf) for v in sparse]
        return tuple(
            sorted(combinations, key=lambda combination: [self.names.index(name) for name in combination.parameters])
        )

    @cached_property
    def nearly_blind(self) -> tuple[Combination, ...]:
        """Combinations that are seen, with errors inflated more than a hundred times."""
        weak = [k for k in range(self.rank) if self.singular_values[k] < NEARLY_BLIND]
        return tuple(self._combination(self.vectors[k], 1.0 / float(self.singular_values[k])) for k in weak[::-1])

    def _combination(self, vector: Array, inflation: float) -> Combination:
        weight = np.abs(vector) / np.abs(vector).max()
        threshold = 1e-6 if np.isinf(inflation) else 0.1
        order = np.argsort(-np.rint(weight / _ROUNDED), kind="stable")
        order = order[weight[order] > threshold]
        # a parameter without any trace stands alone: it has no length to be held against others
        change = vector[order] / np.where(self.lengths[order] > 0, self.lengths[order], 1.0)
        names = tuple(self.names[k] for k in order)
        return Combination(names, tuple((change / change[0]).tolist()), tuple(weight[order].tolist()), inflation)


@dataclass(frozen=True, eq=False)
class PortRecord:
    """Input and output (T,) of a port, where the output was observed, and how lossless modes meet the samples."""

    u: Array
    y: Array
    observed: Mask
    hold: Hold
    from_rest: bool = False
    quantity: str = "velocity"
    driven: bool = True

    @property
    def samples(self) -> int:
        """Number of observed samples."""
        return int(self.observed.sum())

    @property
    def target(self) -> Array:
        """Observed outputs."""
        return self.seen(self.y)

    def seen(self, rows: Array) -> Array:
        """Rows at which the output was observed."""
        return rows if self.observed.all() else rows[self.observed]

    @property
    def bin(self) -> float:
        """Spacing of the discrete Fourier frequencies, rad per unit time."""
        return 2 * np.pi / (len(self.u) * self.hold.h)

    @property
    def largest_phase(self) -> float:
        """Largest phase per step of a mode."""
        return self.hold.largest_phase(len(self.u)) * (1 - 1e-9)

    def sensitivities(self, d: Array, kappa: Array, amplitudes: ComplexArray) -> Array:
        """Derivatives of the output, (T, 4n), by `(d, kappa)` and both parts of a motion `Re(a exp(-i d t))`.

        From the columns of modes with any residues, and their derivatives by the poles.
        """
        n, u = len(d), self.u[None]
        rows = FreeRecord(u, np.zeros(u.shape), np.ones(len(self.u), bool), self.hold)
        columns = np.concatenate(list(rows.evaluated(imaginary(d)).blocks()), axis=1).T
        motion, forced, slopes = columns[:, : 2 * n], columns[:, 2 * n : 4 * n], columns[:, 4 * n + 1 : -1]
        weight = 0.5 * output_weight(d, self.quantity).conj()
        by_kappa = weight.real * forced[:, :n] + weight.imag * forced[:, n:]
        power = DERIVATIVES[self.quantity] - 1.0
        own = 0.5 * np.concatenate([amplitudes.real, -amplitudes.imag])
        by_d = pole_derivatives(slopes, rows, own, (kappa * weight)[:, None])[:, :n] + kappa * power / d * by_kappa
        if self.quantity == "acceleration":
            by_kappa = by_kappa + self.u[:, None]
        return np.concatenate([by_d, by_kappa, 0.5 * motion[:, :n], -0.5 * motion[:, n:]], axis=1)


def work(problem: PortRecord, n: int) -> float:
    """Operations that the information of n modes takes: the QR factorisation of (T, 4n), and the SVD of its factor."""
    return 16.0 * n**2 * (len(problem.u) + 88.0 * n)


@np.errstate(over="ignore", invalid="ignore")  # what leaves the range of doubles is refused
def model_information(problem: PortRecord, d: Array, r: Array, amplitudes: ComplexArray) -> Information:
    """Information of `(d, r, x(0))` at a model, for unit noise; `x(0)` only where it is estimated.

    `amplitudes` (n,) are the modal states `x_l(0)`, whose real parts are the free motion at the output.
    """
    n, samples, h = len(d), len(problem.u), problem.hold.h
    jacobian = problem.seen(problem.sensitivities(d, r * d, amplitudes))
    J = in_weights(jacobian[:, : 2 * n if problem.from_rest else 4 * n], d, r)
    forced, free = _state_sizes(problem, d)
    forced = forced * np.abs(output_weight(d, problem.quantity))
    moving = r * d * forced + np.abs(amplitudes) * free
    sizes = [samples * h * moving + r * forced, d * forced] + ([] if problem.from_rest else [free, free])
    return Information.of(
        J, parameter_names(n, problem.from_rest), rows=len(problem.target), sizes=np.concatenate(sizes)
    )


@np.errstate(over="ignore", invalid="ignore")
def joint_information(
    problems: Sequence[PortRecord], d: Array, r: Array, states: Sequence[ComplexArray]
) -> Information:
    """Information of `(d, r)` in several records together; initial states are unknown where they may move."""
    n, samples = len(d), sum(len(problem.target) for problem in problems)
    parts = []
    for problem, amplitudes in zip(problems, states, strict=True):
        J = problem.seen(problem.sensitivities(d, r * d, amplitudes))
        parts.append(_of_modes(J[:, : 2 * n] if problem.from_rest else J, n, samples))
    return Information.of(in_weights(np.concatenate(parts), d, r), parameter_names(n, True), rows=samples)


def _of_modes(jacobian: Array, n: int, samples: int) -> Array:
    """Sensitivities to the first 2n parameters with all others unknown: what is left below the factor of the others."""
    own = jacobian.shape[1] - 2 * n
    ordered = np.concatenate([jacobian[:, 2 * n :], jacobian[:, : 2 * n]], axis=1)
    return eliminate(reduced(np.asfortranarray(ordered)), own, samples).below


def _state_sizes(problem: PortRecord, d: Array) -> tuple[Array, Array]:
    """Norms of the complex modal states, driven by the input and free; outputs are their real parts."""
    kernel = Kernel(SampledModes.of(problem.hold, imaginary(d)))
    weight = np.abs(kernel.weight)
    pieces = kernel.pieces(problem.u[None], _TOGETHER, False)
    size = np.sqrt(SHORT * sum(np.sum(np.abs(states.driven[0]) ** 2, axis=1) for states in pieces))
    driven = size * problem.hold.h / np.where(weight > 0, weight, 1.0)
    if problem.hold.intersample == "foh":
        driven += problem.hold.h * np.linalg.norm(problem.u)
    return driven, np.full(len(d), np.sqrt(problem.samples))


def in_weights(jacobian: Array, d: Array, r: Array) -> Array:
    """Sensitivities to `(d, r, ...)` from those to `(d, kappa, ...)`, with `kappa = r d`."""
    n = len(d)
    J = np.array(jacobian)
    J[:, :n] += r * jacobian[:, n : 2 * n]
    J[:, n : 2 * n] *= d
    return J
