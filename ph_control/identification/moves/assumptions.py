"""What a fit assumes and what it leaves to the data, and the searches that this makes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..._options import Discretisation, Interpolation, InterpolationOrAuto
from ..._types import Array, ComplexArray
from ..data.channels import Recording
from ..growth.ending import end_of_search, finished, with_other_hold
from ..regression.free import Lateness
from ..regression.time_rows import FreeRecord
from ..search.channel_rows import Experiments, RowOptions, records_of
from ..search.fitted_modes import FreeFit, Orders, count_modes
from ..search.path import FreePath, Reports, SearchOptions

Anew = Callable[[Lateness, int, ComplexArray | None], FreeFit]  # search, or from poles, with delays and offsets

_HOPELESS = 0.2  # BIC for each sample by which a fit is less likely: residuals that are larger by a tenth


def alone(fit: FreeFit, orders: Orders, like: FreeFit | None = None) -> FreeFit:
    """Return a fit as it is, in white noise."""
    return fit


@dataclass(frozen=True, eq=False)
class Assumptions:
    """What a fit of modes to channels assumes, and what it leaves to the data.

    Attributes
    ----------
    quantities : sequence of str, optional
        Of each output 'displacement', 'velocity', 'acceleration', or 'free' for another sensor; 'free' by default.  An
        accelerometer feels the input at once; elsewhere what is fed through stays 0 unless it stands out.
    intersample : {'auto', 'zoh', 'foh'}
        Whether inputs are held or interpolated between samples; 'auto' takes the likelier.
    offset : bool or 'auto'
        Whether outputs have a constant of their own in each recording; 'auto' lets it drift where that explains more.
    moving : bool
        Whether the modes may be in motion where a recording begins.
    max_order : int
        Largest order that 'auto' looks at.
    criterion : {'bic', 'aicc', 'aic', 'holdout'}
        What chooses the order; 'holdout' is the error over the last third of each recording, or a third of the points
        of a response, of models fitted to the rest.
    reports : callable
        Called with a number of modes, to give what is called after each of their iterations: with its number, and the
        mean squared residual, of outputs in a common unit of noise.  On `KeyboardInterrupt` the best model so far is
        returned, if it has a mode.
    weighted : bool
        Whether the weights of responses are those of their noise.  If not, and the noise grows with the gain, the fit
        is repeated with the weights of the law of each entry, which is estimated.
    real_poles : int or 'auto'
        Number of real poles beside the modes; 'auto' takes that which the criterion prefers, see `with_real_poles`
        for those beside a number of modes that is given.
    delay : ndarray, shape (p,), optional
        Time by which each output comes later than the response to the inputs; by default whole samples of recordings
        where they explain more.
    input_delay : ndarray, shape (m,), optional
        Time by which each input acts later than recorded, in whole samples; by default, where `delay` is left to the
        data as well, of several inputs those that explain more.
    method : {'exact', 'midpoint', 'euler'}
        How the modes meet the samples.
    doubted : bool
        Whether lines of a response that are far larger than those about them may be left out, where the BIC prefers
        values of their own to modes that explain them.
    beside : callable
        Called with the first fit and the smallest and largest number of modes to look for, to give the fit in noise of
        another kind, and once more where white noise shows drifts or delays.
    white : bool
        Whether the noise of each output is taken as white.
    growing : bool
        Whether poles may grow.
    direct : bool
        Whether inputs may be fed through.
    """

    quantities: Sequence[str] | None = None
    intersample: InterpolationOrAuto = "auto"
    offset: bool | str = True
    moving: bool = True
    max_order: int = 40
    criterion: str = "bic"
    reports: Reports = lambda order: None
    weighted: bool = True
    real_poles: int | str = "auto"
    delay: Array | None = None
    input_delay: Array | None = None
    method: Discretisation = "exact"
    doubted: bool = True
    beside: Callable[..., FreeFit] = alone
    white: bool = False
    growing: bool = True
    direct: bool = True

    @property
    def drifting(self) -> bool:
        """Whether outputs may drift."""
        return self.offset == "auto"

    def inputs_may_be_late(self, channels: Experiments) -> bool:
        """Return whether each of several inputs may have a dead time of its own."""
        several = len(channels[0].input_labels) > 1 and isinstance(channels[0], Recording)
        return self.delay is None and self.input_delay is None and several


# how channels are fitted: to an order, under assumptions, from poles
Fit = Callable[[Experiments, int | str, Assumptions, ComplexArray | None], FreeFit]


@dataclass(frozen=True)
class Search:
    """Searches in any data: from some poles, up to a number of modes, all of them if not `automatic`."""

    assumptions: Assumptions
    begin: ComplexArray
    most: int
    automatic: bool

    @property
    def held(self) -> Interpolation | None:
        """How inputs are held between samples; None where the data tell."""
        return None if self.assumptions.intersample == "auto" else self.assumptions.intersample

    @property
    def orders(self) -> Orders:
        """Numbers of poles that are searched."""
        real = self.assumptions.real_poles
        return Orders(0 if self.automatic else self.most, self.most, real if isinstance(real, int) else None)

    @property
    def largest(self) -> int | None:
        """Most modes that real poles may become: beside given real poles the given ones."""
        if self.automatic:
            return self.assumptions.max_order
        return None if self.assumptions.real_poles in ("auto", 0) else self.most

    def path(
        self,
        channels: Experiments,
        late: Lateness | None = None,
        terms: int | None = None,
        hold: InterpolationOrAuto | None = None,
    ) -> FreePath:
        """Begin a path with the delays, offset and hold that are assumed, or with others."""
        given = self.assumptions
        if late is None:
            none = np.zeros(len(channels[0].output_labels)), np.zeros(len(channels[0].input_labels))
            late = Lateness(
                none[0] if given.delay is None else given.delay,
                none[1] if given.input_delay is None else given.input_delay,
            )
        terms = int(bool(given.offset)) if terms is None else terms
        return FreePath.of(
            channels,
            RowOptions(
                given.quantities, hold or given.intersample, terms, given.moving, given.method, late, given.direct
            ),
            SearchOptions(
                given.criterion, given.reports, given.real_poles, given.drifting and terms == 1, given.white,
                self.largest, given.growing,
            ),
        )  # fmt: skip

    @property
    def in_white_noise(self) -> Search:
        """The same search with noise taken as white."""
        return replace(self, assumptions=replace(self.assumptions, white=True))

    def along(self, path: FreePath, channels: Experiments, begin: ComplexArray | None = None) -> FreeFit:
        """Return the fit at the end of a path, which may begin with other poles."""
        begin = self.begin if begin is None else begin
        return end_of_search(path, begin, self.most, self.automatic, channels, either_hold=self.held is None)

    def from_poles(self, path: FreePath, channels: Experiments, p: ComplexArray, bic: float) -> FreeFit | None:
        """Return a rough fit with as many poles as some, about these; None if its BIC is no larger than another."""
        try:
            model = path.reweighted(path.model(p))
        except KeyboardInterrupt:
            if path.best is None:
                raise
            return finished(path, path.best, channels, interrupted=True)
        if path.bic(model) <= bic:
            return None
        path.best = model
        return end_of_search(path, p, count_modes(p), False, channels, either_hold=self.held is None, refined=False)

    def anew(self, fit: FreeFit, *, compared: bool = True) -> Anew:
        """Return what searches, or refines from poles, in the noise of a fit with other delays and offsets.

        Where outputs may drift, a search asks anew whether they have a constant.  What is `compared` with the fit is
        refined to the last digit only where it is not far less likely from the first.
        """
        limit = fit.criteria.bic / fit.criteria.samples + _HOPELESS if compared else np.inf

        def search_or_refine(late: Lateness, terms: int, start: ComplexArray | None) -> FreeFit:
            terms = max(terms, int(self.assumptions.drifting and start is None))
            path = self.path(fit.channels, late, terms, self.held or fit.intersample)
            path.whiten(fit.noise, path.power)
            if start is None:
                again = self.along(path, fit.channels)
            else:
                model = path.model(start)
                model = path.in_its_noise(model) if fit.noise else model
                refined = path.bic(model) <= limit * path.counts.sum()
                again = finished(path, model, fit.channels, self.automatic, refined=refined)
                if self.held is None and refined:
                    again = with_other_hold(path, again, model, fit.channels, self.automatic)
            if again.interrupted:
                raise KeyboardInterrupt
            return again.with_delay_open(fit.delay_open)

        return search_or_refine


def rows_as_in(
    fit: FreeFit, channels: Sequence[Recording], moving: bool = True, late: Lateness | None = None
) -> list[FreeRecord]:
    """Return the rows of recordings with hold, offset and method of a fit, and with some delays or none."""
    return records_of(channels, RowOptions(None, fit.intersample, fit.offset, moving, fit.method, late, fit.direct))
