"""Has the plant changed: the score test of a new record at the parameters of an old fit.

The score is in units of the errors of these parameters, and so is the step that it asks for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import chdtrc

from ... import _checks
from ..._checks import EPS
from ..._display import Report, aligned, p_value, starred, with_error
from ..._frozen import Frozen
from ..._options import TESTED_PARAMETERS
from ..._types import Array, Indices, Mask
from ..._units import common_unit, hertz_size, rate
from ...exceptions import StructureError
from ..data.channels import Recording
from ..data.experiments import one_recording
from ..estimates.sensitivities import (
    CORRELATED,
    Sensitivities,
    known_parameters,
    noise_of,
    root_of_covariance,
    without_others,
)
from ..regression.tuning import TUNING
from ..uncertainty.residual_tests import ljung_box
from .mode_comparison import holm, two_sided
from .unmeasured_forces import sensitivities_of

_SHOWN = 1e-9  # of the largest information: a direction with less leaves no trace in the new record

_SPARE = 10  # samples beyond the unknowns, at least


@dataclass(frozen=True, eq=False)
class Score(Frozen):
    """Score (q,) and information (q, q) in units in which old errors are independent and of size 1.

    `directions` (k, q) are the parameters that are looked at, by these units.
    """

    score: Array
    information: Array
    directions: Array

    def spectrum(self) -> tuple[Array, Array, Mask]:
        """Eigenvalues and vectors of the information, and which leave a trace."""
        return _spectrum(self.information)

    def step(self) -> tuple[Array, Array, Mask]:
        """Change (k,) of the parameters by one step, a square root of its covariance (k, j), and whether it is seen."""
        values, vectors, shown = self.spectrum()
        seen = self.directions @ vectors[:, shown]
        change = seen @ (vectors[:, shown].T @ self.score / values[shown])
        root = seen * np.sqrt(1.0 + 1.0 / values[shown])
        hidden = np.linalg.norm(self.directions @ vectors[:, ~shown], axis=1)
        sizes = np.linalg.norm(self.directions, axis=1)
        return change, root, hidden <= np.sqrt(EPS) * sizes

    def standardised(self, mean: Array, spread: Array) -> tuple[Array, int]:
        """Score less that of a mean (q,), in units in which its covariance `F + F P F` is the identity, and its rank.

        `F` is the information and `P` the covariance (q, q) of the parameters that it is held against.
        """
        F = self.information
        values, vectors, shown = _spectrum(F + F @ spread @ F)
        kept = vectors[:, shown]
        return kept @ (kept.T @ (self.score - F @ mean) / np.sqrt(values[shown])), int(shown.sum())


def _spectrum(matrix: Array) -> tuple[Array, Array, Mask]:
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return values, vectors, values > _SHOWN * max(float(values.max(initial=0.0)), np.finfo(float).tiny)


@dataclass(frozen=True, eq=False, repr=False)
class ChangeTest(Report, Frozen):
    """Score test of a new record at the parameters of a fit; made by `PEMResult.changed`.

    True in a condition where `p` is below `level`: ``if result.changed(record): ...``.

    Attributes
    ----------
    statistic : float
        `z^T cov(z)^-1 z` of the score z; chi-square if nothing has changed.
    dof : int
        Its degrees of freedom.
    p : float
        Probability of as much by chance.
    level : float
        Probability of a false alarm, at which `p` and `mode_p` are judged.
    parameters : {'all', 'poles'}
        What was tested: poles, residues and feedthrough, or poles only.
    natural_frequencies : ndarray, shape (n,)
        Those of the fit, rad per unit time.
    frequency_shift, frequency_shift_stderr : ndarray, shape (n,)
        Change of each that one step from the old parameters estimates, and its standard error, which has the errors of
        both records; NaN where the frequency was not estimated.
    damping_shift, damping_shift_stderr : ndarray, shape (n,)
        The same of the damping ratios.
    real_poles, real_pole_shift, real_pole_shift_stderr : ndarray, shape (r,)
        Real poles of the fit, and the same of them.
    frequency_p, damping_p, real_pole_p : ndarray, shapes (n,), (n,) and (r,)
        Probability of each such shift by chance, each by itself.
    mode_statistic, mode_p : ndarray, shape (n + r,)
        Statistic of the tested parameters of each mode, then of each real pole, whatever the others do, and its
        probability by chance, adjusted for so many tests by the method of Holm.
    mode_dof : ndarray of int, shape (n + r,)
        Degrees of freedom of each.
    noise_ratio : ndarray, shape (p,)
        Standard deviation of what the record leaves of each output, over that of the fit; NaN after a fit to a
        frequency response.
    whiteness : float
        p-value of the Ljung-Box test on that: small where the noise is another one, or the change larger than the step
        reaches; then the level of the test does not hold exactly.
    score : ndarray, shape (q,)
        Score of the tested parameters, in units in which their old errors are independent and of size 1.
    information : ndarray, shape (q, q)
        Information of the new record, in these units.
    pole_directions : ndarray, shape (2 (n + r), q)
        Sizes and damping ratios of the poles by these units.
    time_unit : str or None
        Unit of time of the data.

    Examples
    --------
    See `PEMResult.changed`.
    """

    statistic: float
    dof: int
    p: float
    level: float
    parameters: str
    natural_frequencies: Array
    frequency_shift: Array
    frequency_shift_stderr: Array
    damping_shift: Array
    damping_shift_stderr: Array
    real_poles: Array
    real_pole_shift: Array
    real_pole_shift_stderr: Array
    frequency_p: Array
    damping_p: Array
    real_pole_p: Array
    mode_statistic: Array
    mode_dof: Indices
    mode_p: Array
    noise_ratio: Array
    whiteness: float
    score: Array
    information: Array
    pole_directions: Array
    time_unit: str | None

    def __bool__(self) -> bool:
        return self.changed

    @property
    def changed(self) -> bool:
        """Whether the record rejects the old parameters."""
        return bool(self.p < self.level)

    @property
    def modes(self) -> Indices:
        """Modes that have changed, from 0 by their frequencies; numbers from n on are real poles."""
        return np.flatnonzero(self.mode_p < self.level)

    @property
    def hertz(self) -> Array:
        """Natural frequencies of the fit in Hz; where `time_unit` is not known, as if it were the second."""
        return _checks.readonly(self.natural_frequencies / hertz_size(self.time_unit))

    def _headline(self) -> str:
        said = "changed" if self.changed else "no change seen"
        return f"{said}: chi-square {self.statistic:.4g} with {self.dof} degrees of freedom, {p_value(self.p)}"

    def __str__(self) -> str:
        """Headline, a line for each mode and real pole, and what is left; stars mark what has changed."""
        unit = "1/time" if self.time_unit is None else "Hz"
        lines = [self._headline()]
        n = len(self.natural_frequencies)
        if n:
            head = ["mode", unit, "shift %", "+-", "damping shift %", "+-", "chi-square", "dof", "p"]
            lines += aligned([head, *(self._mode_cells(l) for l in range(n))])
        if len(self.real_poles):
            head = ["real pole", rate(self.time_unit).replace("rad", "1"), "shift %", "+-", "chi-square", "dof", "p"]
            lines += aligned([head, *(self._pole_cells(l) for l in range(len(self.real_poles)))])
        ratios = ", ".join(f"{ratio:.3g}" for ratio in self.noise_ratio)
        lines.append(f"  noise over that of the fit: {ratios}; whiteness {p_value(self.whiteness)}")
        return "\n".join(lines)

    def _mode_cells(self, l: int) -> list[str]:
        d = self.natural_frequencies[l]
        shift, error = 100 * self.frequency_shift[l] / d, 100 * self.frequency_shift_stderr[l] / d
        damping, damping_error = 100 * self.damping_shift[l], 100 * self.damping_shift_stderr[l]
        return [str(l + 1), f"{self.hertz[l]:.6g}", *with_error(shift, error), *with_error(damping, damping_error),
                *self._test_cells(l)]  # fmt: skip

    def _pole_cells(self, l: int) -> list[str]:
        pole, size = self.real_poles[l], 100 / max(abs(self.real_poles[l]), np.finfo(float).tiny)
        shift, error = size * self.real_pole_shift[l], size * self.real_pole_shift_stderr[l]
        tested = self._test_cells(len(self.natural_frequencies) + l)
        return [str(l + 1), f"{pole:.6g}", *with_error(shift, error), *tested]

    def _test_cells(self, l: int) -> list[str]:
        return [f"{self.mode_statistic[l]:.4g}", str(self.mode_dof[l]), starred(self.mode_p[l], self.level)]


def score_test(result: Any, data: object, parameters: str, level: float, dt: float | None) -> ChangeTest:
    """Test the parameters of a result on a new record."""
    _checks.choice("parameters", parameters, TESTED_PARAMETERS)
    level = _checks.level("level", level)
    record = _new_record(result, data, dt)
    tested = _tested(result, parameters)
    directions = root_of_covariance(result.covariance, tested)
    sensitivities = sensitivities_of(result, record)
    _refuse_short(sensitivities)
    covariance, rest = noise_of(result, sensitivities)[:2]
    normal, gradient = sensitivities.products(np.asarray(np.linalg.inv(covariance)))
    normal, gradient = without_others(normal, gradient, sensitivities.places, tested)
    if not normal.any():
        raise StructureError(
            "the record shows none of the parameters of the fit, as where no input varies: there is nothing to test; "
            "record while something moves the plant"
        )
    score, information = directions.T @ gradient, directions.T @ normal @ directions
    return _judged(result, record, (parameters, level), Score(score, information, directions), tested, rest, covariance)


def _new_record(result: Any, data: object, dt: float | None) -> Recording:
    """The new record in the channels of a result."""
    fitted = result.experiments[0].record
    step = getattr(fitted, "dt", None) if dt is None else dt
    if isinstance(data, tuple) and len(data) == 2 and data[1] is None:
        raise StructureError("the record has no outputs to test the fit on; pass the pair (u, y)")
    record = one_recording(data, step, len(result.output_labels))
    inputs, outputs = len(result.input_labels), len(result.output_labels)
    if (len(record.u), len(record.y)) != (inputs, outputs):
        raise StructureError(
            f"the record has {len(record.u)} inputs and {len(record.y)} outputs; the fit has {inputs} and {outputs}"
        )
    common_unit(record, result)
    return replace(record, input_labels=result.input_labels, output_labels=result.output_labels)


def _tested(result: Any, parameters: str) -> Indices:
    """Places (k,) of the tested parameters among those of the covariance."""
    known = known_parameters(result.covariance)
    places = known[known < 2 * len(result.poles)] if parameters == "poles" else known
    if not len(places):
        raise StructureError(
            "the fit has no parameter with a standard error, and there is nothing to hold a record against; "
            f"it was judged {result.verdict!r}"
        )
    return places


def _refuse_short(sensitivities: Sensitivities) -> None:
    seen, unknowns = int(sensitivities.observed.sum()), len(sensitivities.places)
    if seen < unknowns + _SPARE:
        raise StructureError(
            f"the record has {seen} observed samples of outputs, and a test of this fit has {unknowns} unknowns in it: "
            f"at least {unknowns + _SPARE} samples are needed"
        )


def _judged(
    result: Any, record: Recording, request: tuple[str, float], score: Score, places: Indices, rest: Array,
    covariance: Array,
) -> ChangeTest:  # fmt: skip
    """The test of a score of the parameters at some places (k,)."""
    parameters, level = request
    values, vectors, shown = score.spectrum()
    along = vectors[:, shown].T @ score.score
    statistic = float(np.sum(along**2 / (values[shown] * (1.0 + values[shown]))))
    dof = int(shown.sum())
    change, root, seen = score.step()
    n, count, size = result.order, len(result.poles), len(result.covariance)
    shift, error = np.full(size, np.nan), np.full(size, np.nan)
    shift[places] = np.where(seen, change, np.nan)
    error[places] = np.where(seen, np.linalg.norm(root, axis=1), np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        p = two_sided(np.where(error > 0, shift / error, np.nan))
    sign = np.where(result.real_poles > 0, 1.0, -1.0)
    tests = [_of_mode(places, change, root, result, l) for l in range(count)]
    statistics, dofs = (np.array([test[k] for test in tests], float) for k in (0, 1))
    directions = np.zeros((2 * count, score.directions.shape[1]))
    of_poles = places < 2 * count
    directions[places[of_poles]] = score.directions[of_poles]
    return ChangeTest(
        statistic=statistic, dof=dof, p=float(chdtrc(dof, statistic)) if dof else np.nan, level=level,
        parameters=parameters, natural_frequencies=result.natural_frequencies,
        frequency_shift=shift[:n], frequency_shift_stderr=error[:n],
        damping_shift=shift[count : count + n], damping_shift_stderr=error[count : count + n],
        real_poles=result.real_poles, real_pole_shift=sign * shift[n:count], real_pole_shift_stderr=error[n:count],
        frequency_p=p[:n], damping_p=p[count : count + n], real_pole_p=p[n:count],
        mode_statistic=statistics, mode_dof=dofs.astype(int),
        mode_p=holm(np.where(dofs > 0, chdtrc(np.maximum(dofs, 1), statistics), np.nan)),
        noise_ratio=_noise_ratio(result, covariance),
        whiteness=ljung_box(_parts(rest, covariance), TUNING.lags), score=score.score, information=score.information,
        pole_directions=directions, time_unit=common_unit(record, result),
    )  # fmt: skip


def _of_mode(places: Indices, change: Array, root: Array, result: Any, l: int) -> tuple[float, int]:
    """Statistic and degrees of freedom of the parameters of a mode."""
    count, entries = len(result.poles), int(np.prod(result.residues.shape[1:]))
    which = np.isin(places, (l, count + l))
    for part in range(2):
        first = 2 * count + (part * count + l) * entries
        which |= (places >= first) & (places < first + entries)
    own, value = root[which], change[which]
    sizes = np.linalg.norm(own, axis=1)
    own, value = own[sizes > 0] / sizes[sizes > 0, None], value[sizes > 0] / sizes[sizes > 0]
    if not len(own):
        return 0.0, 0
    U, s, _ = np.linalg.svd(own, full_matrices=False)
    kept = s > np.sqrt(CORRELATED) * s[0]
    return float(np.sum((U[:, kept].T @ value / s[kept]) ** 2)), int(kept.sum())


def _noise_ratio(result: Any, covariance: Array) -> Array:
    if result.noise is None:
        return np.full(len(covariance), np.nan)
    before = np.diag(result.noise.covariance)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(before > 0, np.sqrt(np.diag(covariance) / np.where(before > 0, before, 1.0)), np.nan)


def _parts(rest: Array, covariance: Array) -> list[Array]:
    """What is left, as series that are independent of one another."""
    return list(np.linalg.solve(np.linalg.cholesky(covariance), rest))
