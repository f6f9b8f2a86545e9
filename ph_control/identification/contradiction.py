"""What contradicts a collocated lossless model: damping, or residues of a sign that such a model does not have.

Looked into where a fit is doubtful only.  Damped modes with residues of either sign are fitted to the same data; what
is said of them has to stand out of the noise, and they have to explain what the lossless modes do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from .. import _checks
from .damped import DampedProjection
from .damped_search import DampedSearch, Records, Responses, damped_data
from .experiment import Experiment
from .frequency_rows import FrequencyRows
from .prediction import fit_percent
from .search import mode_energies
from .solver import Problem, Projection
from .whiteness import ljung_box

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Data = Records | Responses

_ERRORS = 4.0  # standard errors beyond which something is said, with one mode
_EVIDENT = 100.0  # energy of a mode in units of the noise: below, its shape is not judged
_APART = 3.0  # basins between modes, their half-widths added: what is closer mends the shape of a peak
_NEARLY_NONE = 1e-3  # basins: a decay rate that is none, and keeps off the poles
_CROWDED = 0.5  # basins between modes of a lossless model that look like one with damping
_BROADEST = 0.2  # damping ratio of what still counts as a mode
_PATIENCE = 3  # orders without a better criterion before the path ends
_MOST = 20
_TRIED = 3  # candidates for one more mode
_MUCH = 0.25  # part of the loss that has to go, if what is left is not white
_HALF = 50.0  # percent that have to be explained, if what is left is not white
_WHITE = 1e-3
_LAGS = 20
_FILLINGS = 20  # rounds in which missing outputs are foretold


@dataclass(frozen=True, eq=False)
class Contradiction:
    """Modes of a plant that loses energy, or whose sensor is not at its actuator.

    Attributes
    ----------
    natural_frequencies : ndarray, shape (n,)
        In rad per unit time, ascending.
    damping_ratios : ndarray, shape (n,)
        Decay rate over natural frequency; negative where a mode grows.
    stderr : ndarray, shape (n,)
        Standard errors of the damping ratios.
    residues : ndarray, shape (n,)
        Weights `kappa` of either sign; 0 without an input.
    residue_stderr : ndarray, shape (n,)
        Their standard errors.
    fit_percent : float
        What these modes explain.
    damped, negative : ndarray of bool, shape (n,)
        Which damping ratios and which negative residues stand out of the noise.
    """

    natural_frequencies: Array
    damping_ratios: Array
    stderr: Array
    residues: Array
    residue_stderr: Array
    fit_percent: float
    damped: NDArray[np.bool_]
    negative: NDArray[np.bool_]

    def __post_init__(self) -> None:
        for array in (
            self.natural_frequencies, self.damping_ratios, self.stderr, self.residues, self.residue_stderr,
            self.damped, self.negative,
        ):  # fmt: skip
            _checks.readonly(array)

    @property
    def signs(self) -> NDArray[np.intp]:
        """Signs of the residues."""
        return np.sign(self.residues).astype(np.intp)

    def __str__(self) -> str:
        causes, parts = [], []
        decaying, growing = self.damped & (self.damping_ratios > 0), self.damped & (self.damping_ratios < 0)
        if decaying.any():
            parts.append(f"damping ratios of {_listed(self.damping_ratios, self.stderr, decaying)}")
            causes.append("the plant loses energy" if self.residues.any() else "the motion decays")
        if growing.any():
            parts.append(f"negative damping ratios of {_listed(self.damping_ratios, self.stderr, growing)}")
            causes.append("modes grow, so that energy is fed in")
        if self.negative.any() and not np.any(self.residues > _ERRORS * self.residue_stderr):
            parts.append("negative residues only")
            causes.append("the polarity of the sensor is reversed, or displacement and acceleration are mixed up")
        elif self.negative.any():
            parts.append(f"residues of opposite sign ({_modes(self.negative)} negative)")
            causes.append("the sensor is not at the actuator")
        return f"With {' and '.join(parts)}, {self.fit_percent:.1f} % would be explained: {', and '.join(causes)}."


def _modes(which: NDArray[np.bool_]) -> str:
    numbers = [str(k + 1) for k in np.flatnonzero(which)]
    return f"mode{'s' * (len(numbers) > 1)} {_joined(numbers)}"


def _joined(items: Sequence[str]) -> str:
    return " and ".join([", ".join(items[:-1]), items[-1]]) if len(items) > 1 else items[0]


def _listed(values: Array, errors: Array, which: NDArray[np.bool_]) -> str:
    shown = [f"{100 * values[k]:.2g} +- {100 * errors[k]:.1g} %" for k in np.flatnonzero(which)]
    return f"{_joined(shown)} ({_modes(which)})"


# --- the diagnosis ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Model:
    """Damped modes and what they leave."""

    at: DampedProjection
    left: list[ComplexArray]
    loss: float


def contradiction(
    problem: Problem, at: Projection, *, order: int | None, doubtful: bool, most: int = _MOST
) -> Contradiction | None:
    """What contradicts a lossless fit, or None if nothing stands out.

    With an `order` the modes told of are that many, the strongest; None takes those that the data speak for.  Unless
    the fit is `doubtful` for other reasons, nothing is searched for before the modes found show something themselves.
    """
    if problem.samples <= 2 * _unknowns(problem, 1) or at.loss <= 0 or _is_of_euler(problem):
        return None
    # what foretells missing outputs is the model itself, so that it is fitted to the measured ones alone
    search = DampedSearch(problem, damped_data(problem, _filled(problem, at)))
    if not doubtful and not _decays(problem, search, at.d):
        return None
    model = _path(problem, search, _starts(problem, at), order, most)
    model = _settled(problem, search, model)
    if not len(model.at.d) or not _explains(problem, search, model, at):
        return None
    strong = _strongest(search, model, order)
    found = _significant(problem, search, model, strong)
    return replace(found, fit_percent=_fit_percent(problem, search, model)) if _any(found) else None


def _decays(problem: Problem, search: DampedSearch, d: Array) -> bool:
    """Whether a first step away from no damping would be a significant one for any mode (a score test)."""
    n, none = len(d), np.full(len(d), _NEARLY_NONE * problem.bin)
    at = DampedProjection(search.data.rows(d, none), d, none)
    residual, J = at.condensed
    inverse = np.linalg.pinv(J)
    step = -(inverse @ residual)[n:]
    variance = at.loss / max(1, at.rows - _unknowns(problem, n))
    errors = np.sqrt(variance * np.sum(inverse[n:] ** 2, axis=1))
    return bool(np.any(np.abs(step) > _bound(n) * errors))


def _bound(n: int) -> float:
    """Standard errors beyond which something is said of n modes: as improbable for all as `_ERRORS` for one."""
    return float(norm.isf(norm.sf(_ERRORS) / max(1, n)))


def _is_of_euler(problem: Problem) -> bool:
    """Whether the modes grow by the method that made the data, whatever the plant does."""
    return any(isinstance(one, Experiment) and one.hold.method == "euler" for one in problem.experiments)


def is_crowded(at: Projection) -> bool:
    """Whether modes are closer than the data resolve: two of them, nearly equal and opposite, mimic a decay."""
    return len(at.d) > 1 and bool(np.min(np.diff(np.sort(at.d))) < _CROWDED * at.problem.bin)


def _any(found: Contradiction) -> bool:
    return bool(found.damped.any() or found.negative.any())


def _unknowns(problem: Problem, n: int) -> int:
    """Parameters of n damped modes: those of lossless ones, and a decay rate for each."""
    return problem.unknowns(n) + n


def _criterion(problem: Problem, model: _Model) -> float:
    """BIC of a damped model."""
    n = len(model.at.d)
    loss = max(model.loss / problem.samples, np.finfo(float).tiny)
    return float(problem.samples * np.log(loss) + _unknowns(problem, n) * np.log(problem.samples))


def _filled(problem: Problem, at: Projection) -> list[Array | None] | None:
    if all(one.complete for one in problem.experiments if isinstance(one, Experiment)):
        return None
    return [np.asarray(one) for one in at.predicted()]


# --- the path --------------------------------------------------------------------------------------------------------


def _model(search: DampedSearch, d: Array) -> _Model:
    at = search.refined(d)
    left = search.data.left(at)
    return _Model(at, left, search.data.loss(left))


def _starts(problem: Problem, at: Projection) -> Array:
    """Modes of the lossless fit that may be modes of the plant: not held, and apart from stronger ones."""
    kept: list[float] = []
    for k in np.argsort(-mode_energies(at)):
        d = float(at.d[k])
        if at.free[k] and all(abs(d - other) > _APART * problem.bin for other in kept):
            kept.append(d)
    return np.array(kept)


def _path(problem: Problem, search: DampedSearch, start: Array, order: int | None, most: int) -> _Model:
    """Modes join one at a time; the best by the BIC of those that have at least as many as were asked for."""
    wanted = order or 0
    best = current = _sound(search, _model(search, start))
    missed = 0
    while missed < _PATIENCE and len(current.at.d) < max(most, wanted):
        short = len(current.at.d) < wanted
        more = _joined_by_one(problem, search, current, demanding=not short)
        if more is None:
            break
        current = more
        if short or _criterion(problem, current) < _criterion(problem, best):
            best, missed = current, 0
        else:
            missed += 1
    return best


def _closest(at: DampedProjection, band: float) -> tuple[float, int]:
    """How far, in units of what is demanded, the closest pair is apart, and the weaker mode of it."""
    d, half_width = at.d, np.abs(at.sigma)
    if len(d) < 2:
        return np.inf, 0
    apart = np.abs(d[:, None] - d) / (_APART * band + half_width[:, None] + half_width)
    np.fill_diagonal(apart, np.inf)
    first, second = np.unravel_index(np.argmin(apart), apart.shape)
    # of a pair that mends one peak the broader is the patch
    weaker = first if half_width[first] > half_width[second] else second
    return float(apart[first, second]), int(weaker)


def _is_sound(search: DampedSearch, model: _Model) -> bool:
    at = model.at
    return bool(_closest(at, search.band.bin)[0] >= 1 and np.all(np.abs(at.sigma) <= _BROADEST * at.d))


def _sound(search: DampedSearch, model: _Model) -> _Model:
    """A model without the modes that only mend the shape of others."""
    while len(model.at.d) and not _is_sound(search, model):
        distance, weaker = _closest(model.at, search.band.bin)
        if distance >= 1:
            weaker = int(np.argmax(np.abs(model.at.sigma) / model.at.d))
        model = _model(search, np.delete(model.at.d, weaker))
    return model


def _joined_by_one(problem: Problem, search: DampedSearch, model: _Model, demanding: bool) -> _Model | None:
    """One more mode, away from those that are there; if nothing else is left, what is not even that."""
    at = model.at
    candidates, _ = search.data.ranked(model.left)
    needed = _APART * search.band.bin + np.abs(at.sigma)
    distant = [float(d) for d in candidates if np.all(np.abs(d - at.d) > needed)]
    first: _Model | None = None
    for d in distant[:_TRIED]:
        trial = _model(search, np.append(at.d, d))
        if _is_sound(search, trial):
            return trial
        first = trial if first is None else first
    return None if demanding else first


def _settled(problem: Problem, search: DampedSearch, model: _Model) -> _Model:
    """Missing outputs foretold by the model itself, in turn with its refinement."""
    data = search.data
    if not isinstance(data, Records) or all(one.experiment.complete for one in data.spectra):
        return model
    for _ in range(_FILLINGS):
        before = model.at.d
        predicted = [np.fft.irfft(one.Y - left, one.length) for one, left in zip(data.spectra, model.left, strict=True)]
        search.data = data = Records([one.experiment for one in data.spectra], predicted)
        model = _model(search, before)
        if np.all(np.abs(model.at.d - before) < 1e-4 * problem.bin):
            break
    return model


def _strongest(search: DampedSearch, model: _Model, order: int | None) -> NDArray[np.bool_]:
    """Which modes to tell of."""
    at = model.at
    chosen = np.ones(len(at.d), bool)
    if order is not None and order < len(at.d):
        chosen[np.argsort(-_evidence(search, model), kind="stable")[order:]] = False
    return chosen


# --- what stands out -------------------------------------------------------------------------------------------------


def _evidence(search: DampedSearch, model: _Model) -> Array:
    """How much the loss would grow without each mode."""
    at = model.at
    rows = search.data.rows(at.d, at.sigma)
    loss = DampedProjection(rows, at.d, at.sigma).loss
    without = [DampedProjection(rows, np.delete(at.d, k), np.delete(at.sigma, k)).loss for k in range(len(at.d))]
    return np.array(without) - loss


def _significant(problem: Problem, search: DampedSearch, model: _Model, strong: NDArray[np.bool_]) -> Contradiction:
    """Parameters of the modes that are told of, and which of them stand out."""
    at, n = model.at, len(model.at.d)
    # missing outputs, foretold by the model, leave nothing and tell nothing
    observed = 1.0 - _share_missing(problem)
    variance = at.loss / max(1.0, observed * at.rows - _unknowns(problem, n))
    errors = np.sqrt(np.diag(at.covariance(variance)) / observed)
    errors = np.concatenate([errors, np.zeros(3 * n - len(errors))])
    evident = _evidence(search, model) > _EVIDENT * variance
    bound = _bound(n)
    damped = evident & (np.abs(at.sigma) > bound * errors[n : 2 * n])
    negative = evident & (at.kappa < -bound * errors[2 * n :]) if problem.driven else np.zeros(n, bool)
    rank = np.argsort(at.d)[strong[np.argsort(at.d)]]
    return Contradiction(
        at.d[rank], (at.sigma / at.d)[rank], (errors[n : 2 * n] / at.d)[rank],
        at.kappa[rank] if problem.driven else np.zeros(len(rank)), errors[2 * n :][rank], 0.0,
        damped[rank], negative[rank],
    )  # fmt: skip


def _share_missing(problem: Problem) -> float:
    records = [one for one in problem.experiments if isinstance(one, Experiment)]
    total = sum(len(one.u) for one in records)
    return 1.0 - sum(one.samples for one in records) / total if total else 0.0


def _explains(problem: Problem, search: DampedSearch, model: _Model, at: Projection) -> bool:
    """Whether damped modes explain what lossless ones leave, rather than a little more of something else."""
    n = len(at.d)
    lossless = problem.samples * np.log(at.loss / problem.samples) + problem.unknowns(n) * np.log(problem.samples)
    if _criterion(problem, model) >= lossless:
        return False
    if _left_white(search, model):
        return True
    better = len(model.at.d) < n or model.loss < (1 - _MUCH) * at.loss
    return better and _fit_percent(problem, search, model) > _HALF


def _left_white(search: DampedSearch, model: _Model) -> bool:
    data = search.data
    if isinstance(data, Records):
        parts = [
            np.where(one.experiment.observed, error, np.nan)
            for one, error in zip(data.spectra, data.errors(model.left), strict=True)
        ]
    else:
        parts = [part for one in model.left for part in (one.real, one.imag)]
    return ljung_box(parts, _LAGS) >= _WHITE


def _fit_percent(problem: Problem, search: DampedSearch, model: _Model) -> float:
    data = search.data
    if isinstance(data, Records):
        records = [one.experiment for one in data.spectra]
        errors = zip(data.errors(model.left), records, strict=True)
        left = np.concatenate([error[one.observed] for error, one in errors])
        return fit_percent(np.concatenate([one.target for one in records]), left)
    responses = [one for one in problem.experiments if isinstance(one, FrequencyRows)]
    measured = np.concatenate([one.record.response[one.record.observed] for one in responses])
    return fit_percent(
        measured, np.concatenate([left / one.scale for one, left in zip(responses, model.left, strict=True)])
    )
