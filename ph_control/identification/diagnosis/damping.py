"""What contradicts a collocated lossless model: damping, or residues of a sign that such a model does not have.

A lossless model is one of the damped ones with residues of any phase.  What a first step to these would gain is always
asked, which costs next to nothing; where that is more than chance, or the fit is doubtful for other reasons, they are
fitted to the same data.  What is said of them has to stand out of the noise, and they have to explain what the lossless
modes do not.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import fdtrc
from scipy.stats import norm

from ..._types import Array, Mask
from ..data.experiments import as_channels
from ..data.time_record import LONG
from ..regression.free import FreeRows, first_step
from ..regression.frequency_rows import FreeResponse, FrequencyRows
from ..regression.spectral_rows import ChannelSpectra, FreeWindow
from ..regression.time_rows import FreeRecord, RecordRows
from ..regression.variable_projection import Problem, Projection
from ..search.circumstances import Finding, noise_size
from ..search.criteria import preference
from ..search.formulation import DampedModes
from ..search.free_search import Channels
from ..search.modal_search import FreeFit, FreePath, Reports
from ..search.steps import Step, crowds, more_than_noise
from ..uncertainty.fisher import listed, named_modes
from .verdict import HypothesisTest

_ERRORS = 4.0  # standard errors beyond which something is said, with one mode
_EVIDENT = 100.0  # energy of a mode in units of the noise: below, its shape is not judged
_CROWDED = 0.5  # basins between modes of a lossless model that look like one with damping
_MOST = 20
_IN_TIME = 128  # samples up to which all are asked; of longer records the bins about the modes
_BROAD = 0.5  # bins: half-width of a peak that many lossless modes would mimic
_PLAIN = 10.0  # standard errors, and a bin: decay rate of a mode that leaves no doubt, where all decay
_ALONE = 0.9  # of the power about a peak, which a pair of lossless modes does not leave to one with damping
_PAST = 2  # lossless modes more than damped ones before the two are compared
REFUSED = 1e-3  # probability below which a hypothesis is refused


def sentence(model: Any) -> str:
    """What of the damped modes contradicts a lossless collocated model."""
    causes, parts = [], []
    ratios, errors = model.damping_ratios, model.stderr["damping_ratios"]
    decaying, growing = model.damped & (ratios > 0), model.damped & (ratios < 0)
    if decaying.any():
        parts.append(f"damping ratios of {_listed(ratios, errors, decaying)}")
        causes.append("the plant loses energy" if model.residues.any() else "the motion decays")
    if growing.any():
        parts.append(f"negative damping ratios of {_listed(ratios, errors, growing)}")
        causes.append("modes grow, so that energy is fed in")
    weights, weight_errors = model.weights
    if model.negative.any() and not np.any(weights > _ERRORS * weight_errors):
        parts.append("negative residues only")
        causes.append("the polarity of the sensor is reversed, or displacement and acceleration are mixed up")
    elif model.negative.any():
        parts.append(f"residues of opposite sign ({_modes(model.negative)} negative)")
        causes.append("the sensor is not at the actuator")
    if not parts:
        return ""
    return f"With {' and '.join(parts)}, {model.fit_percent:.1f} % would be explained: {', and '.join(causes)}."


def _modes(which: Mask) -> str:
    return named_modes((np.flatnonzero(which) + 1).tolist())


def _listed(values: Array, errors: Array, which: Mask) -> str:
    shown = [f"{100 * values[k]:.2g} +- {100 * errors[k]:.1g} %" for k in np.flatnonzero(which)]
    return f"{listed(shown)} ({_modes(which)})"


# --- the test --------------------------------------------------------------------------------------------------------


def lossless_test(problem: Problem, at: Projection, noise: Finding | None = None) -> HypothesisTest | None:
    """A lossless fit against decay of either sign and residues of any phase, by the best first step towards these.

    The law is that of Fisher, for noise that is white, or as found; where it is stronger about the modes than
    elsewhere, it counts as it is there.  None where there is no mode, and where there are too few samples.
    """
    n, quantity = len(at.d), _quantity(problem)
    spare = problem.samples - free_unknowns(problem, n)
    if not n or spare < 1 or at.loss <= 0 or _is_of_euler(problem):
        return None
    p = (1j * at.d).astype(complex)
    shared, directions = _lossless_directions(at, quantity)
    through = quantity == "acceleration"
    rows: list[FreeRows] = []
    for one in problem.experiments:
        if isinstance(one, FrequencyRows):
            rows.append(FreeResponse.of(one))
        if not isinstance(one, RecordRows):
            continue
        if _IN_TIME < len(one.u) <= LONG and one.complete and not one.from_rest and one.offset < 2:
            about = FreeWindow.about(ChannelSpectra.of(FreeRecord.of(one, through)), p.imag)
            rows.append(replace(about, counts=noise_size(noise, one, at, about.bins) ** -0.5))
        else:
            rows.append(FreeRecord.of(one, through))
    gain, left, dof, fitted = first_step(rows, p, shared, directions)
    near = sum(one.samples for one in rows) - fitted
    if not dof or near < 1:
        return None
    spare = spare if noise is None else near
    variance = max((at.loss - gain) / spare if noise is None else 0.0, left / near, np.finfo(float).tiny)
    ratio = (spare + dof) * float(np.log1p(gain / variance / spare))
    return HypothesisTest("lossless", ratio, dof, float(fdtrc(dof, spare, gain / variance / dof)))


def _lossless_directions(at: Projection, quantity: str) -> tuple[Array, Array]:
    """Residues and feedthrough of a lossless model, and the directions of `(poles, these)` in which it may move."""
    d, kappa = at.d, at.kappa
    n, unit = len(d), np.eye(len(d))
    none = np.zeros((n, n))
    if not at.problem.driven:
        return np.zeros(0), np.concatenate([unit, none])
    power, through = {"velocity": 1, "displacement": 0, "acceleration": 2}[quantity], quantity == "acceleration"
    size = (1j * d) ** power / (2j * d)
    fed = np.ones((int(through), 1))
    along = np.concatenate([np.diag(size.real), np.diag(size.imag), fed * np.ones(n)])
    shared = along @ kappa
    # the size of a residue turns with the frequency: of an accelerometer this is no other weight, as D stays
    turning = np.concatenate([along[: 2 * n] * (power - 1) * kappa / d, fed * np.zeros(n)])
    by_frequency = np.concatenate([unit, none, turning])
    by_weight = np.concatenate([none, none, along])
    return shared, np.concatenate([by_frequency, by_weight], axis=1)


# --- the diagnosis ---------------------------------------------------------------------------------------------------


def contradiction(
    problem: Problem, at: Projection, records: Sequence[Any], *, order: int | None, most: int = _MOST,
    followed: DampedModes | None = None, either_hold: bool = False, criterion: str,
    reports: Reports,
) -> FreeFit | None:  # fmt: skip
    """The damped modes that explain what a lossless fit leaves, or None where there is none.

    With an `order` these are that many, the strongest; None takes those that the data speak for.  `followed` are modes
    that the search found already.
    """
    if problem.samples <= 2 * free_unknowns(problem, 1) or at.loss <= 0 or _is_of_euler(problem):
        return None
    path, known = FreePath.over(problem, criterion, reports), np.zeros(0, complex)
    if followed is not None and order is None:
        known = followed.model.p
        if followed.problem is problem and followed.path.criterion == criterion:
            path, path.reports, path.best = followed.path, reports, followed.model
    most = len(known) or min(path.carried, order or most)
    found = path.fit(known, most, order is None, as_channels(list(records)), either_hold=either_hold)
    return found if found.order else None


def free_unknowns(problem: Problem, n: int) -> int:
    """Parameters of n damped modes: those of lossless ones, a decay rate and a phase for each, and a feedthrough."""
    return problem.unknowns(n) + n + (n + 1) * problem.driven


def _is_of_euler(problem: Problem) -> bool:
    """Whether the modes grow by the method that made the data, whatever the plant does."""
    return any(isinstance(one, RecordRows) and one.hold.method == "euler" for one in problem.experiments)


def _quantity(problem: Problem) -> str:
    return next(one.quantity for one in problem.experiments if isinstance(one, RecordRows | FrequencyRows))


def beside(damped: Array, lossless: Array, order: int | None) -> Array:
    """Frequencies of damped modes; with those of lossless ones that are farthest from them, if more are asked for."""
    missing = 0 if order is None else order - len(damped)
    if missing < 0:
        return lossless
    distance = np.min(np.abs(lossless[:, None] - damped), axis=1)
    return np.concatenate([damped, lossless[np.argsort(-distance)][:missing]])


def is_crowded(at: Projection) -> bool:
    """Whether modes are closer than the data resolve: two of them, nearly equal and opposite, mimic a decay."""
    return len(at.d) > 1 and bool(np.min(np.diff(np.sort(at.d))) < _CROWDED * at.problem.bin)


def standing_out(model: Any, free: FreeFit) -> tuple[Mask, Mask]:
    """Which damping ratios of damped modes, and which of their weights below 0, stand out of the noise."""
    bound = float(norm.isf(norm.sf(_ERRORS) / max(1, model.order)))
    p = free.projection.p
    modes = np.lexsort((np.abs(p), p.imag == 0))[: model.order]
    evident = free.projection.evidence[modes] > _EVIDENT * free.variance
    weights, errors = model.weights
    negative = (weights < -bound * errors) & (weights < -0.5 * np.abs(model.complex_weights))
    return evident & (np.abs(model.damping_ratios) > bound * model.stderr["damping_ratios"]), evident & negative


# --- while modes are looked for --------------------------------------------------------------------------------------


class DampingWatch:
    """Ends a search for lossless modes that would only mimic the width of a few damped ones.

    Where a `lossless` model is asked for, not before these are better than all of its path.
    """

    def __init__(self, problem: Problem, over: Callable[[list[Step]], bool] | None, lossless: bool) -> None:
        self._problem, self._over, self._lossless = problem, over, lossless
        self._records = [one for one in problem.experiments if isinstance(one, RecordRows)]
        self._silent = not self._records or _is_of_euler(problem)
        self._asked = 0  # order at which damped modes were last looked for
        self._found: DampedModes | None = None
        self._broad: bool | None = None

    def __call__(self, path: list[Step]) -> bool:
        """Whether a path is over, or has gone beyond the number of damped modes that are better than all of it."""
        if self._over is None or self._over(path):
            return self._over is not None
        self._look(path)
        if self._found is not None and self._found.plain:
            return True
        past = self._found is not None and len(path[-1].d) >= len(self._found.model.p) + _PAST
        return past and self._is_better(path)

    def decided(self, path: list[Step]) -> DampedModes | None:
        """Damped modes that are better than all of a path that has come to its end."""
        if self._found is None:
            self._look(path)
        if not self._is_better(path) or self._found is None:
            return None
        return self._found

    def _look(self, path: list[Step]) -> None:
        """Look for damped modes where the path gives reason to, at orders that double."""
        step = path[-1]
        if self._silent or self._found is not None or len(step.d) < 2 * self._asked:
            return
        if self._suspects(step):
            self._asked, self._found = len(step.d), self._damped

    @cached_property
    def _search(self) -> FreePath:
        return FreePath.over(self._problem)

    @cached_property
    def _damped(self) -> DampedModes | None:
        """Damped modes from nothing, if any has a decay rate that stands out of the noise."""
        found = self._search.grown(np.zeros(0, complex), min(self._search.carried, _MOST), True)
        decays = np.any(np.abs(found.at.sigma) > _ERRORS * self._search.decay_errors(found.at))
        if not decays:
            return None
        found, plain = self._search.improved(found, _MOST, True), False
        if len(found.p) and not self._lossless:
            # what has no losses decays within its error, and of modes too close to be told apart by less than a bin
            sigma, errors = found.at.sigma, self._search.decay_errors(found.at)
            fast = sigma > np.maximum(_PLAIN * errors, self._problem.bin)
            plain = bool(np.all(sigma > _ERRORS * errors) and fast.any()) and self._search.is_white(found)
        return DampedModes(self._problem, self._search, found, plain)

    def _is_better(self, path: list[Step]) -> bool:
        """Whether damped modes were found that are better than the whole path; they are forgotten if not."""
        problem = self._problem
        if self._found is None or self._found.plain:
            return self._found is not None
        # a few coefficients of coloured noise may explain what many damped modes would
        if self._found.cost >= min(preference(problem, step, "bic") for step in path):
            self._found = None
        return self._found is not None

    def _suspects(self, step: Step) -> bool:
        """Whether one more mode would stand beside a single peak, or that of the first strongest mode is broad."""
        if not len(step.d) or not len(step.candidates):
            return False
        beside = crowds(step, self._problem)
        if not (beside or self._broad is not False) or not more_than_noise(self._problem, step):
            return False
        if self._broad is None:
            strongest = float(step.d[int(np.argmax(step.weights))])
            self._broad = any(_half_width(one, strongest) > _BROAD * one.bin for one in self._records)
        nearest = float(step.d[int(np.argmin(np.abs(step.d - step.candidates[0])))])
        return self._broad or (beside and any(_half_width(one, nearest) > 0 for one in self._records))


def _half_width(record: RecordRows, d: float) -> float:
    """Half-width of the peak near a frequency, if one damped mode makes nearly all of it; else 0."""
    spectrum = ChannelSpectra.of(FreeRecord.of(record))
    half_width, share = Channels.of(spectrum).peak(spectrum.Y, float(spectrum.place(np.array([d]))[0]))
    return half_width if share > _ALONE else 0.0
