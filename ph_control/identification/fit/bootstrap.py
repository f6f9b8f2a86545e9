"""Residual bootstrap: how the estimate scatters when the noise is drawn again from what the fit left over."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ... import _checks
from ..._frozen import Frozen, ReadOnlyMapping
from ..._threads import on_one_thread
from ..._types import Array, Mask, NDArray
from ..._workers import check_workers, mapped
from ...exceptions import IdentificationError, StructureError
from ...modal.modal_form import ModalForm
from ..data.time_record import Record
from ..regression.frequency_rows import FrequencyRows
from ..regression.prediction import state_from_amplitudes
from ..regression.time_rows import RecordRows
from ..regression.variable_projection import Problem, Projection, Rows, refine
from ..search.formulation import rows_of
from ..uncertainty.draws import ModeSamples, draws_from, tail_of

_OFF = 0.3  # standard errors by which an estimate may miss the minimum of its loss
_EXACT = 1e-4  # of the noise variance: decrease of the sum of squares at which a refit takes its last step


@dataclass(frozen=True, eq=False)
class Bootstrap(Frozen):
    """Estimates from resampled noise; made by `LosslessResult.bootstrap`.

    Attributes
    ----------
    d, r : ndarray, shape (k, n)
        Natural frequencies, ascending in each row, and their weights: one resample a row, NaN where the refit failed.
    initial_state : ndarray, shape (k, s)
        Initial states of all records, one after the other; s is 0 for frequency responses.
    offset : ndarray, shape (k, E)
        Constant added to the output of each of the E experiments; 0 where none is estimated.
    active : ndarray of bool, shape (k, n)
        Whether the weight was held at 0 by the constraint `r >= 0`.
    failed : int
        Number of refits that did not converge.

    Notes
    -----
    `len(bootstrap)` is the number of refits that did converge; only these count below.
    """

    d: Array
    r: Array
    initial_state: Array
    offset: Array
    active: Mask
    failed: int

    def __len__(self) -> int:
        return len(self.d) - self.failed

    def __repr__(self) -> str:
        held = ", ".join(f"{100 * share:.0f}" for share in self.active_share)
        return (
            f"Bootstrap({len(self.d)} resamples of {self.d.shape[1]} modes, {self.failed} failed; "
            f"weights held at 0 in {held or '-'} %)"
        )

    @property
    def _kept(self) -> Mask:
        return np.asarray(~np.isnan(self.offset).any(axis=1))

    def _statistic(self, of: Callable[[Array], Array], *shape: int) -> Mapping[str, Array]:
        """Statistic of each parameter by its name; NaN for what never changed."""
        found = {}
        for name in ("d", "r", "initial_state", "offset"):
            draws = getattr(self, name)[self._kept]
            known = (draws != draws[:1]).any(axis=0)
            values = np.full((draws.shape[1], *shape), np.nan)
            if known.any():
                values[known] = of(draws[:, known])
            several = name == "initial_state" and len(values) > 2 * self.d.shape[1]
            found[name] = values.reshape(-1, 2 * self.d.shape[1], *shape) if several else values
        return ReadOnlyMapping(found)

    @property
    def active_share(self) -> Array:
        """Share of the resamples in which each weight was held at 0, shape (n,)."""
        return np.asarray(self.active[self._kept].mean(axis=0)) if len(self) else np.full(self.d.shape[1], np.nan)

    @cached_property
    def stderr(self) -> Mapping[str, Array]:
        """Standard deviation over the resamples: d, r, initial_state, offset; NaN for what never changed."""
        return self._statistic(lambda draws: np.std(draws, axis=0, ddof=1))

    def interval(self, level: float = 0.95) -> Mapping[str, Array]:
        """Percentile intervals of the parameters.

        Parameters
        ----------
        level : float
            Share of the resamples inside, between 0 and 1.

        Returns
        -------
        mapping
            Arrays of shape (..., 2), lower and upper ends, under the keys of `stderr`; NaN for what never changed.

        Raises
        ------
        StructureError
            If the level is not between 0 and 1, or no refit converged.

        Notes
        -----
        Ends are interpolated between neighbouring resamples; with k of them the share beyond an end is uncertain by
        about `sqrt(p/k)`, `p = (1 - level)/2`: 2.5 ± 1.1 % for 200 resamples and level 0.95.  O(k s).

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> rng = np.random.default_rng(0)
        >>> plant, u = phc.ph(phc.modes(1.0, 1.0)), rng.standard_normal(300)
        >>> y = phc.forced_response(plant, 0.1 * np.arange(300), u, intersample="zoh").outputs
        >>> y = y + 0.1 * rng.standard_normal(300)
        >>> (low, high), = phc.pem((u, y), 1, dt=0.1).bootstrap(50, rng=1).interval()["d"]
        >>> bool(low < 1.0 < high)
        True
        """
        tail = tail_of(level)
        if not len(self):
            raise StructureError(f"none of {len(self.d)} refits converged, so there are no percentiles")
        return self._statistic(lambda draws: np.quantile(draws, [tail, 1 - tail], axis=0).T, 2)

    @property
    def samples(self) -> ModeSamples:
        """The models that were refitted, with the bands of their responses."""
        return ModeSamples(self.d[self._kept], self.r[self._kept], self.initial_state[self._kept])


class Resampled:
    """The bootstrap of a result that is the minimum of a problem."""

    @on_one_thread
    def bootstrap(self: Any, k: int = 200, *, rng: Any = None, workers: Any = 1) -> Bootstrap:
        """Refit to resampled noise: errors that do not rest on a normal distribution, nor on one noise level for all.

        Each time the residuals of every experiment are drawn anew, with replacement, added to its prediction, and the
        model is refined from the estimate.

        Parameters
        ----------
        k : int
            Number of resamples.
        rng : numpy.random.Generator or int, optional
            Random numbers, or a seed of them; fresh ones by default.
        workers : int, executor, Dask client or map-like callable
            Number of processes for the refits, -1 for all, or what runs them; the result does not depend on it.

        Returns
        -------
        Bootstrap
            The estimates, their standard errors, percentile intervals and bands.

        Raises
        ------
        StructureError
            If `k`, `rng` or `workers` is not of this form.
        IdentificationError
            If the estimate is not a minimum of the loss, as after an interruption, or where the frequencies were
            taken from elsewhere because the record contradicts the model: refits would scatter about another one.

        Notes
        -----
        Residuals are centred and enlarged by `sqrt(N/(N - p))`, N equations and p parameters; they stay within their
        experiment, so that each keeps a noise level of its own, and missing outputs stay missing.  Those of a frequency
        response are drawn as complex numbers in units of their weights.  Within an experiment noise is taken to be
        independent and of one distribution: errors under coloured noise, or a level that changes along the record, are
        not seen; look at `residual_analysis` first.  Refits stay in the minimum of the estimate and sort their modes
        by frequency.  Of a weight at or near 0 no bootstrap gives the right distribution: its draws pile up at 0, about
        half of them if the estimate itself is held there; `active_share` tells which are concerned.

        k times two to five iterations of O(T n^2), a small part of the fit itself for each.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> rng = np.random.default_rng(0)
        >>> plant, u = phc.ph(phc.modes(1.0, 1.0)), rng.standard_normal(500)
        >>> y = phc.forced_response(plant, 0.1 * np.arange(500), u, intersample="zoh").outputs
        >>> y = y + 0.1 * rng.standard_normal(500)
        >>> result = phc.pem((u, y), 1, dt=0.1)
        >>> again = result.bootstrap(100, rng=1)
        >>> bool(abs(again.stderr["d"][0] / result.stderr["d"][0] - 1) < 0.2)
        True
        """
        count, random = draws_from(k, rng)
        if count == 0:
            raise StructureError("k is 0; a bootstrap needs at least one resample, and 200 for standard errors")
        check_workers(workers)
        refit = _Refit.of(self)
        at = refit.problem.project(refit.start)
        _refuse_off_minimum(at, self.noise_variance)
        seeds = np.random.SeedSequence(int(random.integers(2**63))).spawn(count)
        found = list(mapped(refit, seeds, workers, tuple))
        # NaN where a refit did not converge
        nothing = tuple(np.full(part.shape, 0 if part.dtype == bool else np.nan) for part in refit.estimate(at))
        d, r, state, offset, active = (
            np.stack(parts) for parts in zip(*(one or nothing for one in found), strict=True)
        )
        return Bootstrap(d, r, state, offset, active.astype(bool), failed=sum(not one for one in found))


def _refuse_off_minimum(at: Projection, variance: float) -> None:
    """Refuse an estimate from which refits would go elsewhere; of noise-free data the minimum is not told."""
    if at.loss <= at.problem.rounding or not len(at.d):
        return
    scale = np.sqrt(np.diag(at.gram))
    scale = np.where(scale > 0, scale, 1.0)
    slope = at.gradient / scale
    curvature = np.linalg.pinv(at.gram / np.outer(scale, scale), rcond=len(scale) * _checks.EPS, hermitian=True)
    off = float(np.sqrt(max(0.0, float(slope @ curvature @ slope)) / variance))
    if off > _OFF:
        raise IdentificationError(
            f"the estimate is not a minimum of its loss: the frequencies are {off:.2g} standard errors from one, "
            f"allowed {_OFF:g}; refits would scatter about another model: fit again from initial_guess=result.system, "
            "or see in result.message what contradicts the model"
        )


@dataclass(frozen=True)
class _Refit:
    """What every resample starts from: the problem, the estimate, its predictions, and the noise to draw from."""

    problem: Problem
    modes: ModalForm
    shown: int
    quantity: str
    predicted: tuple[NDArray[Any], ...]
    noise: tuple[NDArray[Any], ...]

    @classmethod
    def of(cls, result: Any) -> _Refit:
        """Make it of a `PEMResult`."""
        # residuals are smaller than the noise by the parameters that were fitted to it
        factor = np.sqrt(result.noise_variance / result.loss) if result.loss > 0 else 1.0
        problem = problem_of(result)
        noise = []
        for rows, one in zip(problem.experiments, result.experiments, strict=True):
            left = one.residuals[one.record.observed] * _scale(rows)
            noise.append(factor * (left - left.mean()))
        predicted = tuple(one.predicted for one in result.experiments)
        shown = result.order - len(result.unseen)
        return cls(problem, result.modes, shown, result.quantity, predicted, tuple(noise))

    def __call__(self, seed: np.random.SeedSequence) -> tuple[NDArray[Any], ...]:
        """Estimate from the noise of one seed; nothing where that is not reached."""
        random = np.random.default_rng(seed)
        rows = tuple(
            _with_output(one, predicted, random.choice(noise, len(noise)))
            for one, predicted, noise in zip(self.problem.experiments, self.predicted, self.noise, strict=True)
        )
        try:
            end = refine(replace(self.problem, experiments=rows), self.start, rtol=_EXACT / self.problem.samples)
        except (np.linalg.LinAlgError, RuntimeError):  # of a decomposition or of nnls that does not converge
            return ()
        return self.estimate(end.projection) if end.converged else ()

    @property
    def start(self) -> Array:
        """Frequencies of the estimate, without those that the data do not show."""
        return self.modes.d[: self.shown]

    def estimate(self, at: Projection) -> tuple[NDArray[Any], ...]:
        """Frequencies, weights, states, offsets, and what is held; modes that the data do not show stay as they are."""
        m, n, at = self.shown, self.modes.n, at.ascending
        d, r, active = self.modes.d.copy(), self.modes.r.copy(), np.zeros(n, bool)
        d[:m] = at.d
        if self.problem.driven:
            r[:m], active[:m] = at.kappa / at.d, ~at.free
        modes = ModalForm._of(d, np.sqrt(r).astype(complex)[:, None], np.zeros((0, 1)))
        states, offsets = [np.zeros(0)], np.zeros(len(at.own))
        for k, (rows, own) in enumerate(zip(self.problem.experiments, at.own, strict=True)):
            if not isinstance(rows, RecordRows):
                continue
            states.append(state_from_amplitudes(modes, np.pad(at.amplitudes(k), (0, n - m)), self.quantity))
            offsets[k] = own[-1] if rows.offset else 0.0
        return d, r, np.concatenate(states), offsets, active


def problem_of(result: Any) -> Problem:
    """Problem that a `PEMResult` is the minimum of, made again from what the result says of itself."""
    driven = [one for one in result.experiments if isinstance(one.record, Record) and one.record.driven]
    # an estimate of a free motion that is exactly 0 does not occur
    rest = bool(driven) and not any(one.free_amplitudes.any() for one in driven)
    offset = int(np.isfinite(result.offset_stderr).any())
    rows = [
        rows_of(
            one.record, result.method, result.intersample, result.quantity, from_rest=rest,
            offset=offset + (one.drift != 0),
        )
        for one in result.experiments
    ]  # fmt: skip
    return Problem(tuple(rows), structured=result.representation == "controllable")


def _scale(rows: Rows) -> Array | float:
    """Factor that makes the residuals of an experiment alike."""
    return rows.scale if isinstance(rows, FrequencyRows) else 1.0


def _with_output(rows: Any, predicted: NDArray[Any], noise: NDArray[Any]) -> Any:
    """The experiment with other noise on its prediction, at the points that were observed."""
    record = rows if isinstance(rows, RecordRows) else rows.record
    output = np.where(record.observed, predicted, np.nan)
    output[record.observed] += noise / _scale(rows)
    return replace(rows, y=output) if record is rows else replace(rows, record=replace(record, response=output))
