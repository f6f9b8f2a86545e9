"""A search on its way: rows with the weights of their outputs, likelihood and criteria, the models so far."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ... import _checks
from ..._checks import EPS
from ..._types import Array, ComplexArray, Mask
from ..._units import feels_force
from ...exceptions import IdentificationError
from ..data.channels import Recording, ResponseMatrix
from ..regression.free import FreeProjection, Lateness, refine_free
from ..regression.frequency_rows import FreeResponse, log_weights
from ..regression.sections import PoleRegion, Sections
from ..regression.time_rows import FreeRecord, may_filter
from ..regression.tuning import TUNING
from ..regression.variable_projection import Interrupted, Progress
from ..uncertainty.residual_tests import all_white
from .channel_rows import Experiments, RowOptions, records_of, refuse_unmeasured, responses_of
from .fitted_modes import Criteria, FreeOrder, count_modes, count_real_poles, stands_out
from .free_search import FreeModel, FreeSearch, Records, Responses

Reports = Callable[[int], Progress | None]  # what reports the iterations for a number of modes, if anything

_STEPS = 15  # of a refinement on the way
_ROUNDS = 6  # of fit and variances in turn
_ROUGH = 1e-5  # relative decrease of the loss at which refinements on the way end
EXACT = 1e-13  # relative decrease of the loss at which the last refinement ends
_AGREED = 0.1  # of the criterion: less is gained where a model and its noise agree


@dataclass(frozen=True)
class SearchOptions:
    """How a search judges its models.

    Attributes
    ----------
    criterion : {'bic', 'aicc', 'aic', 'holdout'}
        What chooses the order.
    reports : callable
        Called with a number of modes, to give what is called after each of their iterations.
    real_poles : int or 'auto'
        Number of real poles beside the modes; 'auto' takes that which the criterion prefers.
    constant_open : bool
        Whether outputs need not have a constant.
    white : bool
        Whether the noise of each output is taken as white.
    largest : int or None
        Number of modes that pairs of real poles must not turn into more than.
    growing : bool
        Whether poles may grow.
    """

    criterion: str = "bic"
    reports: Reports = lambda order: None
    real_poles: int | str = "auto"
    constant_open: bool = False
    white: bool = False
    largest: int | None = None
    growing: bool = True


_DEFAULT = SearchOptions()


class FreePath:
    """The search in some data, with what each output is multiplied by so that its noise has variance 1.

    What is fed through `felt` entries (outputs, inputs of the rows) stays in any case.  `best` is a model that is known
    already, `noise` the innovations filters of the outputs in whose rows the search goes on.
    """

    def __init__(
        self, search: FreeSearch, felt: Mask, options: SearchOptions, best: FreeModel | None = None,
        noise: tuple[Array, ...] = (),
    ) -> None:  # fmt: skip
        self.felt, self.options, self.plain = felt, options, search.with_kinds(options.real_poles == "auto")
        self.table: dict[int, FreeOrder] = {}
        self.best = best  # so far
        self.seen: list[tuple[float, ComplexArray]] = []  # all so far: costs and poles
        self.shown: tuple[FreeModel, tuple[ComplexArray, Array]] | None = None  # the last model with its candidates
        self.separate = False  # whether a common denominator does not explain more than one mode after the other
        extent = np.zeros(len(felt))
        for rows in search.data:
            extent[rows.outputs] = np.maximum(extent[rows.outputs], rows.largest)
        extent = np.where(extent > 0, extent, extent.max())  # what is zero is so to the rounding of the others
        # real equations of each output, losses that are rounding, and the power of all
        counts = self._counted(self.plain)
        self.counts = np.maximum(counts, 1)
        self._exact = np.maximum(counts * (EPS * counts * extent) ** 2, np.finfo(float).tiny)
        self._rounded = self.plain.rounded(len(felt))
        self.search, self._missing = self.plain, np.ones(len(felt))
        self._first = search
        self.whiten(noise, self.power if best is None else best.losses)

    @cached_property
    def power(self) -> Array:
        """What there is of each output, beside no mode."""
        none = np.zeros(0, complex)
        return self._first.model(FreeProjection(self._first.rows(none), none)).losses

    @classmethod
    def of(
        cls, channels: Experiments, form: RowOptions, options: SearchOptions = _DEFAULT,
        best: FreeModel | None = None, noise: tuple[Array, ...] = (),
    ) -> FreePath:  # fmt: skip
        """Begin the search in channels, or what ends one whose best model is known."""
        first = channels[0]
        each = form.quantities or ["free"] * len(first.output_labels)
        felt = np.array([feels_force(quantity) for quantity in each])[:, None].repeat(len(first.input_labels), axis=1)
        if not isinstance(first, ResponseMatrix):
            recordings = [channel for channel in channels if isinstance(channel, Recording)]
            return cls(Records(records_of(recordings, form)), felt, options, best, noise)
        responses = [channel for channel in channels if isinstance(channel, ResponseMatrix)]
        search = Responses(responses_of(responses, each, None if form.late is None else form.late.outputs))
        refuse_unmeasured(first, np.concatenate([rows.outputs for rows in search.data]))
        return cls(search, felt.reshape(-1, 1), replace(options, constant_open=False), best)

    def elsewhere(
        self, search: FreeSearch, best: FreeModel | None = None, noise: tuple[Array, ...] = (), **changes: Any
    ) -> FreePath:
        """Begin a search in other rows with the same options but for some changes; its constants are known."""
        return FreePath(search, self.felt, replace(self.options, constant_open=False, **changes), best, noise)

    @property
    def delay(self) -> Array:
        """Time by which each output comes later than the response to the inputs."""
        delays = np.zeros(len(self.counts))
        for rows in self.search.data:
            if rows.inputs:
                delays[rows.outputs] = rows.delay_time
        return delays

    @property
    def input_delay(self) -> Array:
        """Time by which each input acts later."""
        delays = np.zeros(self.felt.shape[1])
        for rows in self.search.data:
            if isinstance(rows, FreeRecord) and rows.dead_samples is not None:
                delays[rows.acting] = rows.hold.h * rows.dead_samples
        return delays

    @property
    def lateness(self) -> Lateness:
        """Delays of outputs and inputs."""
        return Lateness(self.delay, self.input_delay)

    def _counted(self, search: FreeSearch) -> Array:
        """Real equations of each output in some rows."""
        counts = np.zeros(len(self.felt))
        for rows in search.data:
            counts[rows.outputs] += rows.samples
        return counts

    @property
    def innovations(self) -> tuple[Array, ...]:
        """Filters that made the rows, in which the noise is white; none where these are the data."""
        return self.search.innovations if isinstance(self.search, Records) else ()

    def floors_in(self, innovations: tuple[Array, ...]) -> Array:
        """Losses that are rounding: of numbers, or of outputs that were, through innovations filters."""
        powers = [float(b @ b) for b in innovations] or 1.0
        return np.asarray(np.maximum(self._exact, self._rounded * powers))

    @property
    def floors(self) -> Array:
        """Losses that are rounding in the present rows."""
        return self.floors_in(self.innovations)

    def drop_constants(self, losses: Array) -> None:
        """Go on with outputs that have no constant."""
        if isinstance(self.plain, Records) and isinstance(self.search, Records):
            self.plain, self.search = self.plain.without_constants(), self.search.without_constants()
        self.weigh(losses)

    def whiten(self, innovations: tuple[Array, ...], losses: Array) -> None:
        """Go on in rows in which noise with these innovations filters is white, and is what leaves these losses."""
        if not _same_filters(innovations, self.innovations):
            self.search = self.plain
            if isinstance(self.plain, Records) and innovations:
                self.search = self.plain.whitened(innovations)
            # filters cannot know their past at the beginning: losses are those of as many samples as in the data
            self._missing = self.counts / np.maximum(self._counted(self.search), 1)
        self.weigh(losses)

    def in_data(self, losses: Array) -> Array:
        """Losses of scaled rows in the units of the data, and of as many samples."""
        return losses / self.sizes**2 * self._missing

    def add_terms(self, rows: Sequence[FreeResponse]) -> None:
        """Take the terms of the backgrounds of other rows beside those there are."""
        for term in Responses(rows).terms:
            if isinstance(self.search, Responses):
                self.search = self.search.with_term(term)
        self.weigh(self.power)

    def weigh(self, losses: Array) -> None:
        """Give every output the weight of the variance that it is left with."""
        self.sizes, self.shown = np.sqrt(self.counts / np.maximum(losses, self.floors)), None
        self.scaled = self.search.scaled(self.sizes)

    def resume(self, model: FreeModel) -> None:
        """Give outputs the weights that a model has, where another was tried since then in the same rows."""
        other = model.sizes is not None and not np.array_equal(model.sizes, self.sizes)
        if other and _same_filters(model.innovations, self.innovations):
            self.sizes, self.shown = np.asarray(model.sizes), None
            self.scaled = self.search.scaled(self.sizes)

    def loglik(self, losses: Array, floors: Array | None = None) -> float:
        """Log-likelihood at the best variances, of losses above floors, by default those of the present rows."""
        variances = np.maximum(losses, self.floors if floors is None else floors) / self.counts
        return float(-0.5 * np.sum(self.counts * (np.log(2 * np.pi * variances) + 1))) + self._log_weights

    @cached_property
    def _log_weights(self) -> float:
        return log_weights(self.plain.data)

    def criteria(self, loglik: float, unknowns: int) -> Criteria:
        """Criteria of a model with so many unknowns beside the variances."""
        return Criteria.of(loglik, unknowns + len(self.counts), float(self.counts.sum()))

    def bic(self, model: FreeModel) -> float:
        """BIC of a model in noise of each output."""
        return self._criteria_of(model).bic

    def _criteria_of(self, model: FreeModel) -> Criteria:
        loglik = self.loglik(model.losses, self.floors_in(model.innovations))
        return self.criteria(loglik, self.search.unknowns_of(model.p))

    def cost(self, model: FreeModel) -> float:
        """Return the criterion that the order is chosen by, with noise of each output as coloured as it prefers."""
        cost = self._criteria_of(model).by_name(self.options.criterion)
        # what no mode explains yet is not taken for noise, nor is rounding
        if self.options.white or not (len(model.p) or model.innovations) or self.is_exact(model):
            return cost
        for count, noise in zip(self.counts, model.noise, strict=False):
            cost += float(noise.costs(int(count), self._price).min())
        return cost

    @property
    def _price(self) -> float:
        """What the criterion charges for a parameter."""
        return 2.0 if self.options.criterion in ("aic", "aicc") else float(np.log(self.counts.sum()))

    def stands_out(self, model: FreeModel, gain: float, unknowns: int) -> bool:
        """Whether noise would hardly let so many unknowns more explain as much of what a model leaves."""
        loss = float(np.sum(model.losses * self.sizes**2))
        return stands_out(gain, loss, int(self.counts.sum()), self.search.unknowns_of(model.p), unknowns)

    def gain(self, more: FreeModel, model: FreeModel) -> float:
        """Return by how much the criterion prefers a larger model, both in rows in which its own noise is white.

        Residues that are best in white noise are poor ones in coloured noise, whose criterion they say little of.
        """
        past = self.noise_filters(more)
        if self.search is not self.plain or not past or not isinstance(self.plain, Records):
            return self.cost(model) - self.cost(more)
        rows = self.plain.whitened(past).data
        counts, likelihood = np.zeros(len(self.counts)), []
        for record in rows:
            counts[record.outputs] += record.samples
        for p in (model.p, more.p):
            losses = np.maximum(FreeProjection(rows, p).losses, self.floors_in(past))
            likelihood.append(-0.5 * float(np.sum(counts * np.log(losses / counts))))
        unknowns = [self.search.unknowns_of(candidate.p) for candidate in (model, more)]
        first, second = (
            Criteria.of(each, count, float(counts.sum())).by_name(self.options.criterion)
            for each, count in zip(likelihood, unknowns, strict=True)
        )  # fmt: skip
        return first - second

    def noise_filters(self, model: FreeModel) -> tuple[Array, ...]:
        """Return of each output the innovations filter of the autoregression that the criterion prefers."""
        if self.options.white:
            return ()
        filters = [noise.innovations(int(count), self._price)
                   for count, noise in zip(self.counts, model.noise, strict=False)]  # fmt: skip
        if all(len(coefficients) == 1 for coefficients in filters):
            return ()
        return tuple(filters) if may_filter(self.plain.data, filters) else ()

    def in_its_noise(self, model: FreeModel) -> FreeModel:
        """Refine a model in rows in which its own noise is white, until both agree."""
        self.whiten(model.innovations, model.losses)
        for _ in range(_ROUNDS):
            past = self.noise_filters(model)
            if _same_filters(past, model.innovations):
                break
            foretold = [float(noise.variances.min()) for noise in model.noise]
            before = model
            self.whiten(past, model.losses * foretold)
            model = self.reweighted(self.model(model.p))
            if self.cost(before) - self.cost(model) < _AGREED:
                break
        return model

    @property
    def carried(self) -> int:
        """Largest number of modes for which there are more samples than unknowns."""
        none = self.search.unknowns(0)
        return max(0, int((self.counts.sum() - len(self.counts) - none) // (self.search.unknowns(1) - none)))

    def check(self, order: int) -> None:
        """Refuse more modes than the data can carry."""
        if order > self.carried:
            unknowns, samples = self.search.unknowns(order), int(self.counts.sum())
            have, need = "modes have" if order > 1 else "mode has", self.search.unknowns(1) + len(self.counts)
            remedy = f"the largest order for these data is {self.carried}"
            raise IdentificationError(
                f"{_checks.shown(order)} {have} {_checks.shown(unknowns)} unknowns in all channels, more than the "
                f"{samples} observed samples can carry; {remedy if self.carried else f'a mode needs at least {need}'}"
            )

    def region(self, p: ComplexArray) -> PoleRegion:
        """Say where poles may go from a start: pairs of real ones become no modes beyond the largest number."""
        region = self.scaled.region
        region = region if self.options.growing else replace(region, growth=min(region.growth, TUNING.slowest_growth))
        most = count_modes(p) + count_real_poles(p) // 2
        return (
            region
            if self.options.largest is None or most <= self.options.largest
            else replace(region, kinds_may_change=False)
        )

    def model(self, p: ComplexArray, rtol: float = _ROUGH) -> FreeModel:
        """Refine modes from a start, over the bins about them; outputs are weighted by what is left then."""
        rows, region, report = self.scaled.rows, self.region(p), self.report(max(1, count_modes(p)))
        try:
            projection = refine_free(rows, p, region, rtol, last=False, steps=_STEPS, progress=report)
        except Interrupted as cut:
            p = Sections.from_coordinates(cut.x).p
            self.judged(FreeProjection(rows(p), p))
            raise
        return self.judged(projection)

    def judged(self, projection: FreeProjection) -> FreeModel:
        """Enter modes with what they leave into the table, and return them."""
        model, n = self.scaled.model(projection), count_modes(projection.p)
        model = replace(model, losses=self.in_data(model.losses), sizes=self.sizes)
        criteria = self.criteria(self.loglik(model.losses), self.unknowns_of(projection.p))
        if n not in self.table or self.table[n].loglik < criteria.loglik:
            modes = projection.p.imag > 0
            poles = projection.p[modes][np.argsort(projection.d[modes])]
            self.table[n] = FreeOrder(**vars(criteria), order=n, poles=poles)
        cost = self.cost(model)
        self.seen.append((cost, projection.p))
        if self.best is None or cost < self.cost(self.best):
            self.best = model
        return model

    def unknowns_of(self, p: ComplexArray) -> int:
        """Unknowns of a model with these poles, and of the noise that the rows are made white by."""
        return self.search.unknowns_of(p) + sum(len(coefficients) - 1 for coefficients in self.innovations)

    def report(self, n: int) -> Progress | None:
        """Return what reports the iterations for n modes: their mean squared residual in a common unit of noise."""
        progress = self.options.reports(n)
        if progress is None:
            return None
        unit = float(np.exp(-2 * np.sum(self.counts * np.log(self.sizes)) / self.counts.sum()))
        return lambda iteration, loss: progress(iteration, unit * loss)

    def reweighted(self, model: FreeModel) -> FreeModel:
        """Refine a model with the weights of what it leaves, where these are others."""
        ratio = np.sqrt(self.counts / np.maximum(model.losses, self.floors)) / self.sizes
        if len(ratio) == 1 or np.ptp(np.log(ratio)) < 1e-3:
            return model
        self.weigh(model.losses)
        return self.model(model.p)

    @property
    def crowded(self) -> bool:
        """Whether poles are those of a common denominator, of modes that overlap."""
        return isinstance(self.search, Responses) and self.search.crowded

    def is_exact(self, model: FreeModel) -> bool:
        """Whether what is left of all outputs is rounding; where noise is foretold, that of numbers alone."""
        return bool(np.all(model.losses <= (self._exact if model.innovations else self.floors_in(()))))

    def is_white(self, model: FreeModel) -> bool:
        """Whether what is left of each output may be white noise."""
        outputs = []
        for output in range(len(self.counts)):
            parts: list[Array] = []
            if isinstance(self.search, Records):
                for record, residuals in zip(self.search.data, model.residuals, strict=True):
                    parts += [np.fft.irfft(row, record.length) for row in residuals[record.outputs == output]]
            else:
                for rows, residuals in zip(self.search.data, model.residuals, strict=True):
                    parts += [part for row in residuals[rows.outputs == output] for part in (row.real, row.imag)]
            outputs.append(parts)
        return all_white(outputs)

    def refined(
        self, p: ComplexArray, rtol: float, fed: Mask | None, known: FreeProjection | None = None
    ) -> FreeProjection:
        """Refine modes over all data, of which something may be `known` at some poles."""
        data, region, report = self.scaled.data, self.region(p), self.report(max(1, count_modes(p)))
        last = rtol <= EXACT
        return refine_free(lambda _: data, p, region, rtol, fed, last=last, progress=report, known=known)


def _same_filters(first: tuple[Array, ...], second: tuple[Array, ...]) -> bool:
    """Whether filters of all outputs are the same."""
    return len(first) == len(second) and all(np.array_equal(*pair) for pair in zip(first, second, strict=True))
