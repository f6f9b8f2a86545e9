"""Residual bootstrap: how the estimate scatters when the noise is drawn again from what the fit left over."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import ndtri

from ..._frozen import Frozen, ReadOnlyMapping
from ..._threads import on_one_thread
from ..._types import Array, ComplexArray, Indices, Mask, RandomSource, RealOrComplex
from ..._workers import check_workers, mapped
from ...exceptions import IdentificationError, StructureError
from ..data.channels import Recording
from ..diagnosis.hum import Tones
from ..diagnosis.noise_levels import levels_of, rounded_outputs
from ..regression.free import FreeProjection, GivenResidues, refine_free
from ..regression.frequency_rows import FreeResponse, terms_in
from ..regression.prediction import FittedChannels, ResponseBackground, halved, state_of
from ..regression.sections import PoleRegion
from ..regression.time_rows import FreeRecord
from ..search.channel_rows import RowOptions, experiments_of
from ..search.free_search import Responses
from ..search.path import FreePath
from ..structure.constrained import StructuredFit, constrained
from ..structure.coordinates import ChannelLayout, weights_of
from ..uncertainty.draws import draws_from, tail_of
from ..uncertainty.modal_draws import ModalSamples

if TYPE_CHECKING:
    from .pem_result import PEMResult

_EXACT = 1e-4  # of the noise variance: decrease of the sum of squares at which a refit takes its last step

# poles, residues, feedthrough, and of each experiment motions and offsets
_Estimate = tuple[ComplexArray, ComplexArray, Array, list[ComplexArray], list[Array]]
_KEYS = ("natural_frequencies", "d", "damping_ratios", "real_poles", "residues", "feedthrough")


@dataclass(frozen=True, eq=False)
class Bootstrap(Frozen):
    """Estimates from resampled noise; made by `PEMResult.bootstrap`.

    Attributes
    ----------
    poles : ndarray of complex, shape (k, N)
        Poles in the order of those of the result: a resample each row, NaN where the refit failed.
    residues : ndarray of complex, shape (k, N, p, m)
        At these poles.
    feedthrough : ndarray, shape (k, p, m)
        Responses at infinity.
    r : ndarray, shape (k, n)
        Weights of modes that have some, as `r` of the result; else (k, 0).
    initial_state : ndarray, shape (k, 2n + r), of several experiments (k, E, 2n + r)
        State at the first sample, of one input and one output in time; else (k, 0).
    offset : ndarray, shape (k, E), of several outputs (k, E, p)
        Constant added to each output in each experiment; 0 where none is estimated.
    failed : int
        Number of refits that did not converge, or ended with other kinds of poles.
    background : ResponseBackground or None
        What bands of gain and phase have beside the modes: that of the result.
    delay : ndarray, shape (p,)
        Delay of each output: that of the result, which refits keep.
    input_delay : ndarray, shape (m,)
        Dead time of each input, likewise.

    Notes
    -----
    `len(bootstrap)` is the number of refits that did converge; only these count below.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> rng, plant = np.random.default_rng(0), phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]))
    >>> u = rng.standard_normal(400)
    >>> y = phc.forced_response(plant, 0.1 * np.arange(400), u, intersample="zoh").outputs
    >>> y = y + 0.01 * rng.standard_normal(400)
    >>> again = phc.pem((u, y), dt=0.1).bootstrap(20, rng=1)
    >>> len(again), again.failed, again.poles.shape
    (20, 0, (20, 2))
    >>> again.stderr["natural_frequencies"].shape
    (2,)
    """

    poles: ComplexArray
    residues: ComplexArray
    feedthrough: Array
    r: Array
    initial_state: Array
    offset: Array
    failed: int
    background: ResponseBackground | None
    delay: Array
    input_delay: Array

    def __len__(self) -> int:
        return len(self.poles) - self.failed

    def __repr__(self) -> str:
        shares = ", ".join(f"{100 * share:.0f}" for share in self.active_share)
        weights = f"; weights held at 0 in {shares} %" * bool(shares)
        return f"Bootstrap({len(self.poles)} resamples of {self.poles.shape[1]} poles, {self.failed} failed{weights})"

    @property
    def _converged(self) -> Mask:
        return np.asarray(~np.isnan(self.poles).any(axis=1))

    @property
    def _mode_count(self) -> int:
        return int(np.sum(self.poles[self._converged][:1].imag != 0))

    @property
    def natural_frequencies(self) -> Array:
        """Natural frequencies of the modes, shape (k, n), rad per unit time."""
        return np.abs(self.poles[:, : self._mode_count])

    @property
    def d(self) -> Array:
        """Natural frequencies: `natural_frequencies`."""
        return self.natural_frequencies

    @property
    def active_share(self) -> Array:
        """Share of the resamples in which each weight was held at 0 by the constraint `r >= 0`, shape of `r`'s rows."""
        r = self.r[self._converged]
        return np.asarray((r == 0).mean(axis=0)) if len(self) else np.full(r.shape[1], np.nan)

    @property
    def damping_ratios(self) -> Array:
        """Damping ratios of the modes, shape (k, n)."""
        return -self.poles[:, : self._mode_count].real / self.natural_frequencies

    @property
    def real_poles(self) -> Array:
        """Real poles, shape (k, r)."""
        return np.asarray(self.poles[:, self._mode_count :].real)

    def _statistic(self, reduce: Callable[[Array], Array]) -> Mapping[str, RealOrComplex]:
        """Statistic of each parameter by its name, along the resamples; of complex ones of both parts."""
        statistics = {}
        optional = [name for name in ("r", "initial_state") if getattr(self, name).size]
        for name in (*_KEYS, "offset", *optional):
            draws = getattr(self, name)[self._converged]
            statistics[name] = reduce(draws.real) + 1j * reduce(draws.imag) if np.iscomplexobj(draws) else reduce(draws)
        return ReadOnlyMapping(statistics)

    @cached_property
    def stderr(self) -> Mapping[str, RealOrComplex]:
        """Standard deviation over the resamples, under keys of the result's `stderr`; NaN for fewer than two."""
        few = len(self) < 2
        return self._statistic(lambda draws: np.full(draws.shape[1:], np.nan) if few else np.std(draws, axis=0, ddof=1))

    def interval(self, level: float = 0.95) -> Mapping[str, RealOrComplex]:
        """Percentile intervals of the parameters.

        Parameters
        ----------
        level : float
            Share of the resamples inside, between 0 and 1.

        Returns
        -------
        mapping
            Arrays of shape (..., 2), lower and upper ends, under the keys of `stderr`.

        Raises
        ------
        StructureError
            If the level is not between 0 and 1, or no refit converged.

        Notes
        -----
        Ends are interpolated between neighbouring resamples; with k of them the share beyond an end is uncertain by
        about `sqrt(p/k)`, `p = (1 - level)/2`: 2.5 ± 1.1 % for 200 resamples and level 0.95.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> rng = np.random.default_rng(0)
        >>> plant, u = phc.ph(phc.modes(1.0, 1.0)), rng.standard_normal(300)
        >>> y = phc.forced_response(plant, 0.1 * np.arange(300), u, intersample="zoh").outputs
        >>> y = y + 0.1 * rng.standard_normal(300)
        >>> again = phc.pem((u, y), 1, dt=0.1, structure="lossless").bootstrap(20, rng=1)
        >>> (low, high), = again.interval()["natural_frequencies"]
        >>> bool(low < 1.0 < high)
        True
        """
        tail = tail_of(level)
        if not len(self):
            raise StructureError(f"none of {len(self.poles)} refits converged, so there are no percentiles")
        return self._statistic(lambda draws: np.moveaxis(np.quantile(draws, [tail, 1 - tail], axis=0), 0, -1))

    @property
    def samples(self) -> ModalSamples:
        """The models that were refitted, with the bands of their responses; shapes are those of their residues."""
        used, n = self._converged, self._mode_count
        shapes = self.residues[used][:, :n, :, 0] if self.residues.shape[3] else np.zeros((len(self), n, 0), complex)
        estimates = self.poles[used], self.residues[used], self.feedthrough[used]
        return ModalSamples(*estimates, shapes, self.background, self.delay, self.input_delay)


class Resampled:
    """The bootstrap of a result."""

    @on_one_thread
    def bootstrap(self: Any, k: int = 200, *, rng: RandomSource = None, workers: object = 1) -> Bootstrap:
        """Refit to resampled noise: errors that do not rest on a normal distribution, nor on noise of one level.

        Each time the residuals of every experiment are drawn anew, with replacement, added to its prediction, and the
        model is refined from the estimate, under the same structure.

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
            If `k`, `rng` or `workers` is not of this form, or the result has no poles.
        IdentificationError
            If the estimate is not a minimum of the loss, as after an interruption: refits would go elsewhere.

        Notes
        -----
        Residuals are centred and enlarged by `sqrt(N/(N - p))`, N equations and p parameters; they stay within their
        experiment and output, so that each keeps a noise level of its own, and missing outputs stay missing.  Those of
        a frequency response are drawn as complex numbers in units of their weights.  Within an experiment noise is
        taken to be independent and of one distribution: errors under coloured noise, or a level that changes along the
        record, are not seen; look at `residual_analysis` first.

        k times two to five iterations of O(T n^2), a small part of the fit itself for each.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> rng = np.random.default_rng(0)
        >>> plant, u = phc.ph(phc.modes(1.0, 1.0)), rng.standard_normal(500)
        >>> y = phc.forced_response(plant, 0.1 * np.arange(500), u, intersample="zoh").outputs
        >>> y = y + 0.1 * rng.standard_normal(500)
        >>> result = phc.pem((u, y), 1, dt=0.1)
        >>> again = result.bootstrap(50, rng=1)
        >>> bool(abs(again.stderr["natural_frequencies"][0] / result.stderr["d"][0] - 1) < 0.25)
        True
        """
        count, random = draws_from(k, rng)
        if count == 0:
            raise StructureError("k is 0; a bootstrap needs at least one resample, and 200 for standard errors")
        check_workers(workers)
        if not self.states:
            raise StructureError("this result has no poles, and there is nothing to refit")
        if self.is_ambient or (self.noise is not None and self.noise.forces is not None):
            raise StructureError(
                "forces that nobody measured come through this plant, and are noise of its likelihood: stderr and "
                "confidence_interval have them; a bootstrap resamples noise beside a known motion"
            )
        if not self.success:
            raise IdentificationError(
                "the estimate is not a minimum of its loss, as its refinement did not come to an end; refits would "
                "scatter about another model: fit again with initial_guess=result"
            )
        refit = _Refit.of(self)
        seeds = np.random.SeedSequence(int(random.integers(2**63))).spawn(count)
        estimates = list(mapped(refit, seeds, workers, tuple))
        missing = [np.full(np.shape(part), np.nan, np.asarray(part).dtype) for part in _arrays_of(self)]
        resamples = [_arrays_of(_with_estimate(self, *estimate)) if estimate else missing for estimate in estimates]
        poles, residues, through, r, states, offsets = (np.stack(parts) for parts in zip(*resamples, strict=True))
        failed = sum(not estimate for estimate in estimates)
        delays = self.delay, self.input_delay
        return Bootstrap(poles, residues, through, r, states, offsets, failed, self.background, *delays)


def _arrays_of(result: PEMResult) -> tuple[RealOrComplex, ...]:
    """What a bootstrap has of each estimate."""
    r = result.r if result._has_weights else np.zeros(0)
    states = result.initial_states if result._moves_as_state else (np.zeros(0),)
    state = states[0] if len(states) == 1 else np.array(states)
    return result.poles, result.residues, result.feedthrough, r, state, result.offsets


def _with_estimate(
    result: PEMResult, poles: ComplexArray, residues: ComplexArray, through: Array, motions: list[ComplexArray],
    offsets: list[Array],
) -> PEMResult:  # fmt: skip
    """The result with another estimate."""
    lossless = result.structure == "lossless" and result._has_weights
    r = weights_of(poles, residues[:, 0, 0], result.quantity) if lossless else None
    experiments: Any = []
    data: Any
    for data, motion, offset in zip(result.experiments, motions, offsets, strict=True):
        if isinstance(data, FittedChannels):
            data = replace(data, free_amplitudes=motion[:, : data.free_amplitudes.shape[1]], offsets=offset)
        elif len(data.initial_state):
            state = state_of(poles, motion[:, 0], result.quantity, r)
            data = replace(data, initial_state=state, free_amplitudes=motion[:, 0], offset=float(offset[0]))
        experiments.append(data)
    return replace(result, poles=poles, residues=residues, feedthrough=through, experiments=tuple(experiments))


@dataclass(frozen=True)
class _Refit:
    """What every resample starts from: data whose noise has variance 1, the estimate, predictions, noise to draw."""

    rows: list[Any]
    poles: ComplexArray
    fed: Mask
    layout: ChannelLayout
    region: PoleRegion
    structure: str
    predictions: list[RealOrComplex]
    noise: list[RealOrComplex]
    places: list[int]  # of the experiments among those of the result
    experiment_count: int

    @classmethod
    def of(cls, result: PEMResult) -> _Refit:
        """Make it of a result."""
        channels: Any = result._channels
        rounded = list[Mask]()
        if isinstance(channels[0], Recording):
            scales = [experiment.noise_scale for experiment in result.experiments]
            without_tones = Tones.of(result.findings, channels).taken_from(channels)
            levels = levels_of(result.findings, channels)
            adjustments = zip(without_tones, scales, levels, strict=True)
            channels = [channel.adjusted(scale, level=level) for channel, scale, level in adjustments]
            rounded = rounded_outputs(result.findings, channels)
            channels = [
                channel.before_rounding(np.atleast_2d(experiment.predicted), outputs) if outputs.any() else channel
                for channel, experiment, outputs in zip(channels, result.experiments, rounded, strict=True)
            ]
        terms = int(np.isfinite(result.stderr["offset"]).any())
        terms += any(
            np.any(getattr(experiment, "drifts", getattr(experiment, "drift", 0.0)))
            for experiment in result.experiments
            if not (experiment.resting and np.any(result.poles == 0))  # that of inputs before the record
        )
        options = RowOptions(
            result.quantities, result.intersample, terms, result._moving, result.method, result._lateness
        )
        path = FreePath.of(channels, options)
        if isinstance(path.search, Responses):
            path.search = replace(path.search, data=_with_background(path.search.data, result))
        path.weigh(path.counts * np.ravel(result.noise_variance))
        rows, per_entry = list(path.scaled.data), not isinstance(path.scaled.data[0], FreeRecord)
        p, m = result.feedthrough.shape
        layout = ChannelLayout(p, m, 1.0 / path.sizes, result.quantities, result.ports, per_entry=per_entry)
        fed = path.felt | (result.feedthrough.reshape(path.felt.shape) != 0) if m else path.felt
        projection = FreeProjection(rows, result.poles, fed)
        halves = halved(result.poles, result.residues)
        fixed = GivenResidues(
            projection,
            layout.joined(halves, result.feedthrough, projection.has_feedthrough) if m else projection.shared,
        )
        # residuals are smaller than the noise by the parameters that were fitted to it
        variance = np.exp(np.mean(np.log(np.maximum(result.noise_variance, np.finfo(float).tiny))))
        factor = np.sqrt(variance / max(result.loss, np.finfo(float).tiny))
        predictions, noise, places = fixed.predictions(), [], experiments_of(rows, channels).tolist()
        for record, predicted, place in zip(rows, predictions, places, strict=True):
            residuals = _scaled_residuals(record, (_measured_outputs(record) - predicted)[:, record.observed])
            noise.append(factor * (residuals - residuals.mean(axis=1, keepdims=True)))
            if rounded:  # what is left of these says nothing of their noise
                steps = rounded[place][record.outputs]
                noise[-1][steps] = ndtri((np.arange(residuals.shape[1]) + 0.5) / residuals.shape[1])
        return cls(
            rows, result.poles, fed, layout, path.search.region, result.structure, predictions, noise, places,
            len(channels),
        )  # fmt: skip

    def __call__(self, seed: np.random.SeedSequence) -> _Estimate | tuple[()]:
        """Estimate from the noise of one seed; nothing where that is not reached."""
        random, rows = np.random.default_rng(seed), []
        for record, predicted, noise in zip(self.rows, self.predictions, self.noise, strict=True):
            output = np.where(record.observed, predicted, 0.0)
            drawn = np.stack([random.choice(values, len(values)) for values in noise])
            output[:, record.observed] += _unscaled_residuals(record, drawn)
            rows.append(
                replace(record, y=output, scale=None)
                if isinstance(record, FreeRecord)
                else replace(record, response=output)
            )
        return self.fitted(rows)

    def fitted(self, rows: list[Any]) -> _Estimate | tuple[()]:
        """Estimate from some rows, refined from that of the result."""
        samples = sum(record.samples for record in rows)
        try:
            projection = refine_free(lambda _: rows, self.poles, self.region, _EXACT / samples, self.fed)
            fit = constrained(projection, self.layout, self.structure, self.region)
        except (np.linalg.LinAlgError, RuntimeError):  # of a decomposition that does not converge
            return ()
        rank = np.lexsort((np.abs(fit.p), fit.p.imag == 0))
        poles = fit.p[rank]
        if not fit.converged or not np.array_equal(poles.imag == 0, self.poles.imag == 0):
            return ()
        residues = fit.residues[rank] * np.where(poles.imag == 0, 2.0, 1.0)[:, None, None]
        motions, offsets = self._motions_and_offsets(fit, rank)
        return poles, residues, fit.feedthrough, motions, offsets

    def _motions_and_offsets(self, fit: StructuredFit, rank: Indices) -> tuple[list[ComplexArray], list[Array]]:
        """Free motions (N, outputs) and constants of each experiment."""
        projection, count = fit.projection, len(self.layout.scales)
        motions = [np.zeros((len(rank), count), complex) for _ in range(self.experiment_count)]
        offsets = [np.zeros(count) for _ in range(self.experiment_count)]
        for record, own, place in zip(projection.experiments, projection.own, self.places, strict=True):
            if isinstance(record, FreeRecord):
                scale = self.layout.scales[record.outputs] * record.unit
                motion = record.motion_at_start(projection.p, projection.residues[:, record.outputs], own)[rank]
                motions[place][:, record.outputs] = 2 * scale * motion
                constants = record.offset_at_start(own)[0] - projection.held_outputs(record)
                offsets[place][record.outputs] = scale * constants
        return motions, offsets


def _with_background(rows: Sequence[FreeResponse], result: PEMResult) -> list[FreeResponse]:
    """Responses on the background of a result."""
    parts = [
        experiment.background.coefficients.reshape(5, -1) for experiment in result.experiments if experiment.background
    ]
    through = result.feedthrough.ravel() != 0
    responses = []
    for response in rows:
        terms = terms_in(np.concatenate([np.zeros((5, 1)), *(part[:, response.outputs] for part in parts)], axis=1))
        responses.append(
            replace(response, terms=terms, through=response.through or bool(through[response.outputs].any()))
        )
    return responses


def _measured_outputs(rows: Any) -> RealOrComplex:
    """Outputs (q, T) in the scale of the rows."""
    return np.asarray(rows.measured if isinstance(rows, FreeRecord) else rows.response)


def _unscaled_residuals(rows: Any, drawn: RealOrComplex) -> RealOrComplex:
    """Residuals as large as they are in the rows."""
    if isinstance(rows, FreeRecord):
        return drawn if rows.level is None else drawn * rows.level[rows.observed]
    return np.asarray(rows.out_of_rows(drawn))


def _scaled_residuals(rows: Any, residuals: RealOrComplex) -> RealOrComplex:
    """Residuals made alike, of all observed values."""
    if isinstance(rows, FreeRecord):
        return residuals if rows.level is None else residuals / rows.level[rows.observed]
    return np.asarray(rows.in_rows(residuals))
