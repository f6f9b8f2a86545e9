"""From recordings or response matrices to the damped modes, with any residues, that are most likely.

One mode after the other joins where it explains most of what is left of all channels together, all are refined
jointly, and each output counts by the variance of its own noise, which is estimated along with them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.stats import chi2
from scipy.stats import f as f_law

from ... import _checks
from ..._checks import EPS
from ..._frozen import Frozen
from ..._types import Array, ComplexArray, Indices, Mask, NDArray
from ...exceptions import IdentificationError, StructureError
from ...modal.discretization import Hold
from ..data.channels import Recording, ResponseMatrix
from ..data.parts import cut, is_long, searched_part, stages
from ..data.windowed import SharedErrors
from ..regression.elimination import orthogonal, without
from ..regression.free import Delays, FreeProjection, Lateness, refine_free
from ..regression.frequency_rows import FURTHER_TERMS, FreeResponse, Term
from ..regression.sections import PoleRegion, Sections
from ..regression.time_rows import FreeRecord
from ..regression.tuning import TUNING
from ..regression.variable_projection import Interrupted, Progress
from ..uncertainty.residual_tests import all_white, is_white, ljung_box
from .circumstances import Cause, Finding, correlations, foretold
from .criteria import Criteria, least_gain, past_of_noise, stands_out
from .dead_times import DeadTimeScan, numbers_of
from .free_search import FreeModel, FreeSearch, Records, Responses
from .held_out import foretelling_order
from .response_noise import ROUNDS, SETTLED, NoiseLaw, balanced, entry_laws
from .window_noise import in_weights, of_curvature, of_model

Experiments = Sequence[Recording] | Sequence[ResponseMatrix]
Place = tuple[int, int]  # an experiment and a line of it
Reports = Callable[[int], Progress | None]  # what reports the iterations for a number of modes, if anything

_STEPS = 15  # of a refinement on the way
_ROUNDS = 6  # of fit and variances in turn
_SETTLED = 1e-6  # relative change of the likelihood, over the samples
_ROUGH = 1e-5  # relative decrease of the loss at which refinements on the way end
_EXACT = 1e-13  # relative decrease of the loss at which the last refinement ends
_DECIDED = 0.01  # decrease, in variances of the noise, at which what belongs to the model beside poles can be told
_GROWING = 3.0  # standard errors of a decay rate beyond which a mode grows
_LARGE = 0.01  # of the power of all outputs: with less no mode is taken to grow
_MOSTLY = 0.5  # of the squares of outputs: lags that leave more of them say little of dead times
_MIMICS = 0.2  # damping ratio from which on modes may stand for a delay
_DELAYS_FROM = 20_000  # samples of each recording that delays are looked for in
_FASTEST = 0.8  # of the ceiling: faster real poles are none
_FEW_MODES = 5  # that few points of responses do not show beside a background
_ABOUT = 4  # lines on either side, whose median a wild line is so many times as large as
_WILD = 20.0
_HARDLY_MORE = 4.0  # times the squares that a fit without some lines leaves
_EXPLAINED = 0.5  # of a value at a line: what modes that explain it may leave
_FEW_WILD = 3  # lines, or a few in a thousand: more are no accident
_SWAPS = 6  # modes that are looked for elsewhere, at most
_SCANS = 3  # searches with the delays that the last one says
_LONGEST_DELAY = 24  # samples
_LAGS = 4  # of different rates, with which delays are looked for
_AGREED = 0.1  # of the criterion: less is gained where a model and its noise agree
_NO_NOISE = 1.0  # by which the logarithm of the variance falls where what was left is no noise, of any law
_SAME_ERRORS = 0.02  # relative change of the variances of lines
_SHORTEST_SPAN = 32  # samples of one level of noise that are searched
_LASTING = 0.05  # of a record: the part in which an input has to act


@dataclass(frozen=True)
class FreeOrder(Criteria):
    """The best model of an order on the way."""

    order: int
    poles: ComplexArray


@dataclass(frozen=True, eq=False)
class FreeFit(Frozen):
    """The most likely modes of any damping and residues.

    Attributes
    ----------
    projection : FreeProjection
        The linear problem at the minimum, over all data; its rows have variance 1.
    channels : tuple of Recording, or of ResponseMatrix
        The data.
    scales : ndarray, shape (outputs of the projection,)
        What one unit of each output of the projection is in the data: the standard deviation of its noise.
    order_table : tuple of FreeOrder
        The orders that were looked at.
    region : PoleRegion
        Where poles were looked for.
    unknowns : int
        Parameters of the model, without the variances.
    criteria : Criteria
        Likelihood, with the variances at their best, and what is made of it.
    rounding : bool
        Whether what is left of an output is rounding, and no noise.
    interrupted : bool
        Whether the search was ended before it had come to its end.
    findings : tuple of Finding
        What the data show beside the modes.
    held_otherwise : callable or None
        Refines these modes with the inputs held otherwise, if that is left to the data: see `rival`.
    measured : FreeProjection or None
        The linear problem of the data as they are, where its noise is coloured and rows were made in which it is white.
    delay : ndarray, shape (outputs of the projection,)
        Time by which each comes later than the response to the inputs, in its rows.
    input_delay : ndarray, shape (m,)
        Time by which each input acts later than the record says, in the rows.
    delay_gain : float
        Log-likelihood by which this explains more.
    delay_open : bool
        Whether the delay is left to the data.
    noise : tuple of ndarray
        Innovations filter of the noise of each output, with which these rows were made; none where the noise is white.
    crowded : bool
        Whether modes of responses overlap so much that they were found all at once, by a common denominator.
    beside : FittedNoise or None
        Noise that outputs share, or that comes through the plant, with which the minimum is a joint one.
    filters : tuple of ndarray
        Innovations filter of the noise of each output that residuals show afterwards; none where `noise` has it all.
    own_noise : tuple of ndarray
        Innovations filters of noise of each output that explains more than such noise does, where there is colour.
    """

    projection: FreeProjection
    channels: tuple[Any, ...]
    scales: Array
    order_table: tuple[FreeOrder, ...]
    region: PoleRegion
    unknowns: int
    criteria: Criteria
    rounding: bool
    interrupted: bool = False
    findings: tuple[Finding, ...] = ()
    held_otherwise: Callable[[], FreeFit] | None = None
    measured: FreeProjection | None = None
    delay: Array = field(default_factory=lambda: np.zeros(1))
    input_delay: Array = field(default_factory=lambda: np.zeros(1))
    delay_gain: float = 0.0
    delay_open: bool = False
    noise: tuple[Array, ...] = ()
    crowded: bool = False
    beside: Any = None
    filters: tuple[Array, ...] = ()
    own_noise: tuple[Array, ...] = ()

    @property
    def per_entry(self) -> bool:
        """Whether outputs of the projection are entries of a response matrix, `output * m + input`."""
        return isinstance(self.channels[0], ResponseMatrix)

    @property
    def windowed(self) -> bool:
        """Whether responses were estimated with a window."""
        return any(getattr(channel, "window", None) is not None for channel in self.channels)

    @property
    def intersample(self) -> str:
        """Behaviour of the inputs between samples; 'zoh' for response matrices, which have none."""
        rows = self.projection.experiments[0]
        return rows.hold.intersample if isinstance(rows, FreeRecord) else "zoh"

    @property
    def method(self) -> str:
        """Discretisation by which the modes meet the samples."""
        rows = self.projection.experiments[0]
        return rows.hold.method if isinstance(rows, FreeRecord) else "exact"

    @property
    def offset(self) -> int:
        """Terms of what outputs have beside the modes: none, a constant, or a constant and a drift."""
        return max(getattr(rows, "offset", 0) for rows in self.projection.experiments)

    @property
    def lateness(self) -> Lateness:
        """Delays of outputs and inputs."""
        return Lateness(self.delay, self.input_delay)

    @property
    def order(self) -> int:
        """Number of modes: pairs of complex poles."""
        return _modes(self.projection.p)

    @property
    def states(self) -> int:
        """Number of all poles."""
        return self.order + len(self.projection.p)

    @property
    def variance(self) -> float:
        """Variance of the rows of the projection that is not biased by the parameters."""
        rows = self.projection.rows
        return rows / max(1, rows - self.unknowns)

    def with_delay_open(self, is_open: bool) -> FreeFit:
        """The fit, and that under the other hold, with the delay left to the data or not."""
        return replace(self.with_rival(lambda rival: replace(rival, delay_open=is_open)), delay_open=is_open)

    @property
    def rival(self) -> FreeFit | None:
        """These modes refined with the inputs held otherwise, if that is left to the data; made when first needed."""
        return None if self.held_otherwise is None or self.interrupted else self.held_otherwise()

    def with_rival(self, change: Callable[[FreeFit], FreeFit]) -> FreeFit:
        """The fit with a change of that under the other hold."""
        made = self.held_otherwise
        return self if made is None else replace(self, held_otherwise=cache(lambda: change(made())))

    @cached_property
    def covariance(self) -> Array:
        """Covariance of imaginary and real parts of the poles, then of what is shared by outputs of the projection."""
        return self.projection.covariance(self.variance)


def feedthrough_of(fit: FreeFit) -> Array:
    """What is fed through in the units of the data, shape (p, m)."""
    feedthrough = fit.projection.feedthrough * fit.scales[:, None]
    return feedthrough.reshape(-1, len(fit.channels[0].input_labels)) if fit.per_entry else feedthrough


def free_fit(
    channels: Experiments,
    order: int | str = "auto",
    *,
    quantities: Sequence[str] | None = None,
    intersample: str = "auto",
    offset: bool | str = True,
    moving: bool = True,
    max_order: int = 40,
    criterion: str = "bic",
    reports: Reports = lambda order: None,
    start: ComplexArray | None = None,
    weighted: bool = True,
    real_poles: int | str = "auto",
    delay: Array | None = None,
    input_delay: Array | None = None,
    method: str = "exact",
    doubted: bool = True,
    beside: Callable[..., FreeFit] = lambda fit, orders: fit,
    white: bool = False,
) -> FreeFit:
    """Fit modes of any damping and residues to all channels, from nothing or from some poles.

    Parameters
    ----------
    channels : sequence of Recording, or of ResponseMatrix
        Experiments of the same inputs and outputs.
    order : int or 'auto'
        Number of modes; 'auto' takes that which the criterion prefers.
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
    reports : callable, optional
        Called with a number of modes, to give what is called after each of their iterations: with its number, and the
        mean squared residual, of outputs in a common unit of noise.  On `KeyboardInterrupt` the best model so far is
        returned, if it has a mode.
    start : ndarray of complex, optional
        Poles of positive imaginary part to start from, real parts NaN where they are not known.
    real_poles : int or 'auto'
        Number of real poles beside the modes; 'auto' takes that which the criterion prefers, see `_with_real_poles`
        for those beside a number of modes that is given.
    delay : ndarray, shape (p,), optional
        Time by which each output comes later than the response to the inputs; by default whole samples of recordings
        where they explain more.
    input_delay : ndarray, shape (m,), optional
        Time by which each input acts later than recorded, in whole samples; by default, where `delay` is left to the
        data as well, of several inputs those that explain more.
    weighted : bool
        Whether the weights of responses are those of their noise.  If not, and the noise grows with the gain, the fit
        is repeated with the weights of the law of each entry, which is estimated.
    method : {'exact', 'midpoint', 'euler'}
        How the modes meet the samples.
    doubted : bool
        Whether lines of a response that are far larger than those about them may be left out, where the BIC prefers
        values of their own to modes that explain them.
    beside : callable, optional
        Called with the first fit and the smallest and largest number of modes to look for, to give the fit in noise of
        another kind, and once more where white noise shows drifts or delays.
    white : bool
        Whether the noise of each output is taken as white.

    Returns
    -------
    FreeFit
        The minimum, its order table, and what belongs to it.

    Raises
    ------
    IdentificationError
        If there are fewer samples than unknowns.
    StructureError
        If an entry of the response matrices was measured in none of them.
    """
    changing = any(isinstance(channel, Recording) and len(channel.changes) for channel in channels)
    if changing or is_long(channels):
        how: dict[str, Any] = {
            "quantities": quantities, "moving": moving, "criterion": criterion, "reports": reports,
            "real_poles": real_poles, "method": method,
        }  # fmt: skip
        by_parts = _of_long if is_long(channels) else _in_changing_noise
        return by_parts(
            channels, order, intersample, offset, how, max_order=max_order, start=start, delay=delay,
            input_delay=input_delay,
        )  # fmt: skip

    automatic = not isinstance(order, int)
    if real_poles == "auto" and not automatic:
        again = partial(
            free_fit, channels, quantities=quantities, intersample=intersample, offset=offset, moving=moving,
            criterion=criterion, reports=reports, weighted=weighted, delay=delay, input_delay=input_delay,
            method=method, doubted=doubted, beside=beside, white=white,
        )  # fmt: skip
        fit = again(order, max_order=max_order, start=start, real_poles=0)
        return fit if start is not None else _with_real_poles(fit, int(order), max_order, again)
    shape = len(channels[0].output_labels), len(channels[0].input_labels)
    none = np.zeros(shape[0]), np.zeros(shape[1])
    given = Lateness(none[0] if delay is None else delay, none[1] if input_delay is None else input_delay)

    def path_for(
        channels: Experiments, terms: int = int(bool(offset)), hold: str = intersample, late: Lateness = given
    ) -> FreePath:
        return FreePath.of(
            channels, quantities, hold, terms, moving, criterion, reports, real_poles=real_poles, method=method,
            constant_open=offset == "auto" and terms == 1, late=late, white=white,
            largest=max_order if automatic else None,
        )  # fmt: skip

    windowed = [data for data in channels if isinstance(data, ResponseMatrix) and data.window is not None]
    if windowed and all(data.errors is None for data in windowed):
        channels = [in_weights(data) if weighted else of_curvature(data) for data in windowed]
    if doubted and isinstance(channels[0], ResponseMatrix) and not windowed:
        among = partial(
            free_fit, order=order, quantities=quantities, max_order=max_order, criterion=criterion, reports=reports,
            weighted=weighted, real_poles=real_poles, delay=delay, doubted=False,
        )  # fmt: skip
        return _of_responses([data for data in channels if isinstance(data, ResponseMatrix)], among, start)
    path = path_for(channels)
    path.check(1 if automatic else int(order))
    begin = np.zeros(0, complex) if start is None else np.asarray(start, complex)
    most = min(max_order, path.carried) if automatic else int(order)
    if automatic and criterion == "holdout":
        most, automatic = foretelling_order(channels, begin, most, path_for), False
    search = _Search(path_for, begin, most, automatic, None if intersample == "auto" else intersample)
    dead = delay is None and input_delay is None and shape[1] > 1 and isinstance(channels[0], Recording)
    late = _of_late_inputs(path_for(channels), channels, search, offset == "auto") if dead else None
    fit = late or search.along(path, channels)
    if weighted and start is None and not windowed:
        fit = _from_peaks(fit, path, search)
    if automatic and real_poles in ("auto", 0) and not fit.interrupted:
        fit = _of_few_lines(fit, path.of_few_lines(), min(max_order, path.carried))
    # what modes that are missing leave says nothing of the noise
    short = automatic and fit.order >= most
    orders = (0, min(max_order, path.carried)) if automatic else (most, most) if start is None else (0, 0)
    in_noise: Beside = (lambda fit: fit) if short else partial(beside, orders=orders)
    forced = fit if fit.interrupted else in_noise(fit)
    if forced.interrupted:
        return forced
    if forced.own_noise and automatic and not fit.noise:
        fit = _in_own_noise(fit, forced.own_noise, search, path)
    alone = fit.with_delay_open(delay is None)
    changed = _beside_all_else(alone, search, weighted, offset == "auto", dead)
    return changed if forced.beside is None else _in_likelier_rows(forced, changed, in_noise, offset == "auto")


def _in_own_noise(fit: FreeFit, filters: tuple[Array, ...], search: _Search, path: FreePath) -> FreeFit:
    """The fit that grows together with coloured noise of each output, if it is likelier."""
    path.whiten(filters, path.power)
    path.best = None
    again = search.along(path, fit.channels)
    return again if again.interrupted or again.criteria.bic < fit.criteria.bic else fit


def _in_likelier_rows(forced: FreeFit, changed: FreeFit, in_noise: Beside, drifting: bool) -> FreeFit:
    """The fit beside forces, in rows with drifts or delays if those that white noise shows explain more there too."""
    if changed.interrupted:
        return replace(forced, interrupted=True)
    if changed.offset > forced.offset or np.any(changed.delay != forced.delay):
        again = in_noise(changed)
        share = forced.projection.rows / again.projection.rows
        if again.criteria.bic * share < forced.criteria.bic - 2 * TUNING.sure:
            return again
    return _with_constants(forced) if drifting else forced


@dataclass(frozen=True)
class _Search:
    """A search along the paths of any data: from some poles, up to a number of modes, all of them if not `automatic`.

    `held` is how inputs are held between samples; where it is None the data tell.
    """

    path_for: Callable[..., FreePath]
    begin: ComplexArray
    most: int
    automatic: bool
    held: str | None

    def along(self, path: FreePath, channels: Experiments, begin: ComplexArray | None = None) -> FreeFit:
        """The fit at the end of a path, which may begin with other poles."""
        begin = self.begin if begin is None else begin
        return path.fit(begin, self.most, self.automatic, channels, either_hold=self.held is None)


def _beside_all_else(fit: FreeFit, search: _Search, weighted: bool, drifting: bool, dead: bool) -> FreeFit:
    """The fit with what its data show beside modes: noise that grows with gains of responses, or drifts and delays.

    Outputs may be `drifting`, and inputs may have `dead` times.
    """
    if fit.windowed and not (fit.interrupted or fit.rounding or weighted):
        try:
            return _in_noise_of_the_window(fit, search)
        except KeyboardInterrupt:
            return replace(fit, interrupted=True)
    # what crowded modes leave is no noise whose law could be told
    if fit.interrupted or fit.rounding or fit.crowded or (fit.per_entry and weighted) or not (fit.states or fit.noise):
        return fit
    try:
        if fit.per_entry:
            return _in_noise_of_the_gain(fit, search)
        return _beside_drifts_and_delays(fit, search, drifting, dead)
    except KeyboardInterrupt:
        return replace(fit, interrupted=True)


def _of_responses(
    responses: Sequence[ResponseMatrix], among: Callable[..., FreeFit], start: ComplexArray | None
) -> FreeFit:
    """The fit to responses, without lines that are wild, or in error, if they are better values of their own."""
    wild = [wild_lines(data) for data in responses]
    if any(map(len, wild)):
        return _with_or_without(wild, responses, among, start)
    return _without_errors(among(responses, start=start), responses, among)


def _with_real_poles(fit: FreeFit, order: int, max_order: int, again: Callable[..., FreeFit]) -> FreeFit:
    """The fit of a number of modes, pairs of real poles among them, with further real poles if these are likelier.

    They are looked for where modes alone leave what is no noise, or have no peak, as a pair of real poles has none.
    Modes that overlap may be fewer, as a search has them all at once.
    """
    if (
        fit.interrupted
        or fit.rounding
        or fit.beside is not None
        or not (_broad(fit.projection.p).any() or not is_white(fit.projection))
    ):
        return fit
    most = min(order, max_order)
    # first under the circumstances that there are
    same = {"delay": fit.delay, "input_delay": fit.input_delay, "intersample": fit.intersample}
    trial = again("auto", max_order=most, beside=lambda fit, orders: fit, **same)
    if trial.interrupted:
        return replace(fit, interrupted=True)
    if not _real(trial.projection.p) or trial.criteria.bic >= fit.criteria.bic:
        return fit
    wider = again("auto", max_order=most)
    real = _real(wider.projection.p)
    fewer = order - real // 2 - wider.order
    if wider.interrupted:
        return replace(fit, interrupted=True)
    if not real:
        return fit
    if fewer > 0 and not wider.crowded:
        wider = again(order - real // 2, max_order=max_order, real_poles=real, start=wider.projection.p)
    return wider if not wider.interrupted and wider.criteria.bic < fit.criteria.bic else fit


def _searches_anew(fit: FreeFit, search: _Search, drifting: bool) -> Anew:
    """Searches, or refinements from poles, in the noise of a fit with other delays and offsets.

    Where outputs may be `drifting`, a search asks anew whether they have a constant.
    """

    def anew(late: Lateness, terms: int, start: ComplexArray | None) -> FreeFit:
        terms = max(terms, int(drifting and start is None))
        path = search.path_for(fit.channels, terms, search.held or fit.intersample, late)
        path.whiten(fit.noise, path.power)
        if start is None:
            again = search.along(path, fit.channels)
        else:
            model = path.model(start)
            model = path.in_its_noise(model) if fit.noise else model
            again = path.finished(model, fit.channels, search.automatic)
        if again.interrupted:
            raise KeyboardInterrupt
        return again.with_delay_open(fit.delay_open)

    return anew


def _in_noise_of_the_window(fit: FreeFit, search: _Search) -> FreeFit:
    """The fit of responses estimated with a window, with the errors of its own model, until both agree."""
    refined, again = _anew_in_noise(fit, search)
    near, known = fit, False
    while True:
        for _ in range(ROUNDS):
            before = near
            near = refined(of_model(near), near.projection.p)
            if len(near.projection.p) == len(before.projection.p) and _agree(near, before):
                break
        judged = again(near.channels, near.projection.p, known)
        if judged.interrupted:
            raise KeyboardInterrupt
        if known or len(judged.projection.p) == len(near.projection.p):
            return judged
        # other modes leave other errors
        near, known = judged, True


def _agree(fit: FreeFit, before: FreeFit) -> bool:
    """Whether the errors of two fits are the same."""
    laws = [[channel.errors.covariances[:, :, 0].real for channel in each.channels] for each in (fit, before)]
    scales = [float(np.exp(np.mean([np.log(law).mean() for law in each]))) for each in laws]
    pairs = zip(*laws, strict=True)
    return all(np.max(np.abs(now / then * (scales[1] / scales[0]) - 1)) <= _SAME_ERRORS for now, then in pairs)


def _in_noise_of_the_gain(fit: FreeFit, search: _Search) -> FreeFit:
    """The fit of responses with the weights of the law of noise that each entry shows."""
    return _reweighted(fit, *_anew_in_noise(fit, search))


def _anew_in_noise(
    fit: FreeFit, search: _Search
) -> tuple[Callable[[Experiments, ComplexArray], FreeFit], Callable[[Experiments, ComplexArray, bool], FreeFit]]:
    """What refines the poles of responses, and what looks for others as well, in the noise of other channels."""

    def weighted_path(channels: Experiments) -> FreePath:
        path = search.path_for(channels)
        path.add_terms([rows for rows in fit.projection.experiments if isinstance(rows, FreeResponse)])
        return path

    def refined(channels: Experiments, p: ComplexArray) -> FreeFit:
        path = weighted_path(channels)
        path.weigh(path.model(p).losses)
        projection = path.refined(p, TUNING.rough, None)
        return replace(fit, projection=projection, channels=tuple(channels), scales=1.0 / path.sizes)

    def again(channels: Experiments, p: ComplexArray, known: bool) -> FreeFit:
        path = weighted_path(channels)
        model = path.model(p)
        if search.automatic and not known:
            model = path.chosen(path.cleaned(model).p, search.most, True)
        return path.finished(model, channels, search.automatic)

    return refined, again


def _with_or_without(
    wild: Sequence[Indices], channels: Experiments, among: Callable[..., FreeFit], start: ComplexArray | None
) -> FreeFit:
    """The fit to all lines of responses, or without those that are wild, if they are better values of their own."""
    calm = among(_without_lines(channels, wild), start=start)
    if not calm.interrupted:
        whole = among(channels, start=calm.projection.p)
        explained = whole.order <= calm.order and _explains(whole, calm, wild)
        if explained or not _is_likelier_without(whole, calm, wild):
            return whole
    return _leaving_out(calm, wild)


def _from_peaks(fit: FreeFit, path: FreePath, search: _Search) -> FreeFit:
    """The fit from the poles that responses show where all lines weigh the same, if that is likelier.

    Weighted by its gain, a response is equally large everywhere: its resonances do not stand out in a search for poles.
    """
    channels: Any = fit.channels
    if not fit.per_entry or fit.interrupted or fit.crowded or path.best is None or path.is_white(path.best):
        return fit
    if all(np.ptp(channel.weights[channel.observed]) == 0 for channel in channels):
        return fit
    alike = [replace(channel, weights=np.where(channel.observed, 1.0, channel.weights)) for channel in channels]
    p = search.along(search.path_for(alike), alike).projection.p
    other = search.along(search.path_for(channels), channels, p)
    return other if other.criteria.bic < fit.criteria.bic else fit


def wild_lines(response: ResponseMatrix) -> Indices:
    """Places of lines that are far larger than the lines about them in some entry, unless many are.

    In units of their standard errors, where the weights give these.
    """
    size = np.abs(response.response * np.sqrt(response.weights)).reshape(-1, response.samples)
    wild = np.zeros(response.samples, bool)
    for each in size:
        seen = np.flatnonzero(each == each)
        if len(seen) <= 2 * _ABOUT:
            continue
        padded = np.pad(each[seen], _ABOUT, mode="reflect")
        about = np.delete(np.lib.stride_tricks.sliding_window_view(padded, 2 * _ABOUT + 1), _ABOUT, axis=1)
        wild[seen] |= each[seen] > _WILD * np.median(about, axis=1)
    return np.flatnonzero(wild) if 0 < wild.sum() <= max(_FEW_WILD, _ABOUT * len(wild) // 1000) else np.zeros(0, int)


def _without_lines(channels: Experiments, lines: Sequence[Indices]) -> list[ResponseMatrix]:
    responses = []
    for channel, places in zip(channels, lines, strict=True):
        assert isinstance(channel, ResponseMatrix)
        response = channel.response.copy()
        response[..., places] = np.nan
        responses.append(replace(channel, response=response))
    return responses


def _explains(whole: FreeFit, calm: FreeFit, lines: Sequence[Indices]) -> bool:
    """Whether a fit to all lines explains the values at some, and fits all others hardly worse than one without these.

    Values of few digits next to a resonance may be off by more than the noise of all others, and still belong to it.
    There is no resonance at a frequency of 0.
    """
    if any(np.any(data.omega[far] == 0) for data, far in zip(whole.channels, lines, strict=True)):
        return False
    for rows, predicted in zip(whole.projection.experiments, whole.projection.predictions(), strict=True):
        if isinstance(rows, FreeResponse):
            far = lines[rows.experiment]
            if np.any(np.abs(rows.response - predicted)[:, far] > _EXPLAINED * np.abs(rows.response[:, far])):
                return False
    losses = []
    for fit in (whole, calm):
        losses.append(0.0)
        for rows, predicted in zip(fit.projection.experiments, fit.projection.predictions(), strict=True):
            if isinstance(rows, FreeResponse):
                others = calm.channels[rows.experiment]
                weights = np.where(others.observed, others.weights, 0.0).reshape(-1, others.samples)[rows.outputs]
                size = np.abs(rows.response - predicted) * fit.scales[rows.outputs, None]
                losses[-1] += float(np.nansum(weights * size**2))
    return losses[0] <= _HARDLY_MORE * losses[1]


def _without_errors(whole: FreeFit, channels: Sequence[ResponseMatrix], among: Callable[..., FreeFit]) -> FreeFit:
    """The fit without values that are errors of single lines, where these made a mode, or broadened one.

    A mode that only one line asks for has more unknowns than a value of its own.  Next to a resonance an error looks
    like damping, and residuals are not white: there a line is left out only if nothing else was wrong.
    """
    projection = whole.projection
    if whole.interrupted or whole.rounding or whole.crowded or not len(projection.p):
        return whole

    def leaving(places: Collection[Place], **how: Any) -> FreeFit:
        lines = [np.array(sorted(line for k, line in places if k == j), int) for j in range(len(channels))]
        try:
            calm = among(_without_lines(channels, lines), **how)
        except IdentificationError:  # the other lines do not carry the modes
            return whole
        likelier = not calm.interrupted and _is_likelier_without(whole, calm, lines)
        return _leaving_out(calm, lines) if likelier else whole

    single = _of_single_lines(whole, channels)
    if single:
        rest = np.delete(projection.p, list(single))
        return leaving(set(single.values()), start=rest) if len(set(single.values())) <= _FEW_WILD else whole
    if is_white(projection):
        return whole
    nearest = {
        (k, int(np.argmin(np.where(data.observed.any(axis=(0, 1)), np.abs(data.omega - d), np.inf))))
        for k, data in enumerate(channels) for d in projection.d[projection.p.imag > 0]
    }  # fmt: skip
    order: dict[str, int] = {"order": whole.order, "real_poles": _real(projection.p)}
    calm = leaving(nearest, **order, start=projection.p)
    if calm is whole or not is_white(calm.projection):
        return whole
    start = calm.projection.p
    fits = [leaving([each], **order, start=start) for each in sorted(nearest)]
    return min((fit for fit in fits if fit is not whole), key=_weighted_bic, default=whole)


def _of_single_lines(fit: FreeFit, channels: Sequence[ResponseMatrix]) -> dict[int, Place]:
    """Modes that the criterion takes for one line alone, each with its experiment and the line."""
    effects = _effects(fit.projection, channels)
    lines = [int(data.observed.sum()) for data in channels]
    places = {}
    for l in np.flatnonzero(fit.projection.p.imag > 0).tolist():
        k = int(np.argmax([part[l].max() for part in effects]))
        others = sum(float(part[l].sum()) for part in effects) - float(effects[k][l].max())
        if others < (2 + 2 * len(fit.scales)) * np.log(2 * sum(lines)):
            places[l] = (k, int(np.argmax(effects[k][l])))
    return places


def _effects(projection: FreeProjection, channels: Sequence[ResponseMatrix]) -> list[Array]:
    """Square of what each mode adds to each line of each experiment, all entries together, in units of the noise."""
    effects = [np.zeros((len(projection.p), data.samples)) for data in channels]
    for rows in projection.experiments:
        assert isinstance(rows, FreeResponse)
        ahead, behind = rows.peaks(projection.p)[:2]
        for output in rows.outputs.tolist():
            r = projection.residues[:, output, 0][:, None]
            size = np.abs((r * ahead + r.conj() * behind) * rows.weight) ** 2
            effects[rows.experiment][:, rows.observed] += size
    return effects


def _is_likelier_without(whole: FreeFit, calm: FreeFit, lines: Sequence[Indices]) -> bool:
    """Whether the BIC prefers values of their own at some lines to a fit to all."""
    return _weighted_bic(whole) > _weighted_bic(calm) + _cost_of_lines(whole, lines)


def _leaving_out(calm: FreeFit, lines: Sequence[Indices]) -> FreeFit:
    """The fit without some lines, with the finding that says so."""
    wild = [
        Finding(Cause.WILD_LINES, tuple(data.omega[places].tolist()), 0.0, experiment=k)
        for k, (data, places) in enumerate(zip(calm.channels, lines, strict=True)) if len(places)
    ]  # fmt: skip
    return replace(calm, findings=(*calm.findings, *wild))


def _cost_of_lines(whole: FreeFit, lines: Sequence[Indices]) -> float:
    """What it costs by the BIC to take the values at some lines as they are, in the noise of a fit to all lines.

    Two numbers for each value, and one at 0, where responses are real.
    """
    count, cost = 2 * sum(int(channel.observed.sum()) for channel in whole.channels), 0.0
    for channel, places in zip(whole.channels, lines, strict=True):
        variances = (whole.scales**2)[:, None] / channel.weights[..., places].reshape(len(whole.scales), -1)
        numbers = np.where(channel.omega[places] == 0, 1, 2) * np.log(count)
        cost += float(np.sum(2 * np.log(2 * np.pi * variances) + numbers))
    return cost


def _of_few_lines(fit: FreeFit, paths: Sequence[FreePath], most: int) -> FreeFit:
    """The fit to few points of responses at the poles that real shapes of damping that decouples ask for, if likelier.

    Where few points show as many residues of any phase, these are too many numbers for the criterion to grant.
    """
    best: FreeModel | None = None
    cost = np.inf
    try:
        for few in paths:
            model = few.significant(few.chosen(np.zeros(0, complex), most, True))
            if few.cost(model) < min(cost, fit.criteria.by_name(few.criterion)):
                best, cost, path = model, few.cost(model), few
        if best is None:
            return fit
        rows = [replace(response, classical=False) for response in path.search.data]
        free = FreePath(Responses(rows, False), path.felt, path.criterion, path.reports, None, 0)
        judged = free.finished(free.model(best.p), fit.channels)
    except KeyboardInterrupt:
        return replace(fit, interrupted=True)
    return replace(judged, order_table=tuple(path.table[n] for n in sorted(path.table)))


# --- long records ----------------------------------------------------------------------------------------------------


def _of_long(
    channels: Experiments, order: int | str, intersample: str, offset: bool | str, how: dict[str, Any], **options: Any
) -> FreeFit:
    """The fit to a part of long records, its modes refined over longer and longer ones, up to all samples."""
    part = [searched_part(channel, not how["moving"]) for channel in channels]
    parts = [cut(channel, span) for channel, span in zip(channels, part, strict=True)]
    fit = free_fit(parts, order, intersample=intersample, offset=offset, **how, **options)
    if fit.interrupted:
        return fit
    how |= {"noise": fit.noise, "largest": None if isinstance(order, int) else options["max_order"]}
    best, path = FreeModel(fit.projection, [], fit.projection.losses * fit.scales**2), None
    while path is None or any(
        span.stop - span.start < channel.samples for span, channel in zip(part, channels, strict=True)
    ):
        part = [next(stages(span, channel.samples), span) for span, channel in zip(part, channels, strict=True)]
        longer = [cut(channel, span) for channel, span in zip(channels, part, strict=True)]
        path = FreePath.of(longer, intersample=fit.intersample, offset=fit.offset, best=best, late=fit.lateness, **how)
        projection = path.refined(best.p, TUNING.rough, None)
        path.best = best = FreeModel(projection, [], path.in_data(projection.losses), path.search)
    whole = path.fit(best.p, len(best.p), False, channels, either_hold=intersample == "auto")
    whole = whole.with_rival(lambda rival: replace(rival, order_table=fit.order_table))
    return replace(
        whole, order_table=fit.order_table, findings=fit.findings, delay_gain=fit.delay_gain
    ).with_delay_open(fit.delay_open)


def _in_changing_noise(
    channels: Experiments, order: int | str, intersample: str, offset: bool | str, how: dict[str, Any], **options: Any
) -> FreeFit:
    """The fit to recordings whose noise changes: modes found in spans of one level, refined over all samples.

    Plants at rest before the recordings, which are in motion where others of the spans begin, are looked for in the
    noise of all of them.
    """
    recordings = [channel for channel in channels if isinstance(channel, Recording)]
    spans = [
        part for data in recordings for part in (_spans_of_one_level(data) if how["moving"] else [data.of_one_level])
    ]  # fmt: skip
    fit = free_fit(spans, order, intersample=intersample, offset=offset, **how, **options)
    how["noise"] = fit.noise
    path = FreePath.of(channels, intersample=fit.intersample, offset=fit.offset, late=fit.lateness, **how)
    path.table = {row.order: row for row in fit.order_table}
    model = FreeModel(fit.projection, [], path.power, path.search)
    if fit.interrupted:
        path.weigh(path.in_data(FreeProjection(path.scaled.data, fit.projection.p).losses))
        return replace(path.finished(model, channels, interrupted=True), interrupted=True)
    path.best = replace(model, losses=path.in_data(path.refined(fit.projection.p, TUNING.rough, None).losses))
    whole = path.fit(fit.projection.p, fit.order, False, channels, either_hold=intersample == "auto")
    return replace(whole, findings=fit.findings, delay_gain=fit.delay_gain).with_delay_open(fit.delay_open)


def _spans_of_one_level(recording: Recording) -> list[Recording]:
    """Recordings of the spans in which the noise of each output has one level, but for those too short to be searched.

    Spans end at different samples where outputs change by themselves.
    """
    ends = [0, *recording.changes.tolist(), recording.samples]
    return [
        cut(recording, slice(first, last)) for first, last in pairwise(ends)
        if last - first >= min(_SHORTEST_SPAN, max(np.diff(ends)))
    ]  # fmt: skip


# --- drifts and delays -----------------------------------------------------------------------------------------------

Beside = Callable[[FreeFit], FreeFit]
Anew = Callable[[Lateness, int, ComplexArray | None], FreeFit]  # search, or from poles, with delays and offsets


def _beside_drifts_and_delays(fit: FreeFit, search: _Search, drifting: bool, dead: bool) -> FreeFit:
    """The fit beside the drifts of outputs, where these may be `drifting`, and with the delays that are open.

    Inputs may have `dead` times of their own.
    """
    anew = _searches_anew(fit, search, drifting)
    level = _beside_drift(fit, anew) if drifting else fit
    late = level
    if fit.delay_open and not (dead and fit.input_delay.any()):
        late = (_with_dead_times(level, anew, search, drifting) if dead else None) or _on_time(level, anew)
    if not drifting:
        return late
    # poles that stand for a delay may hide a drift
    if late is not level and late.offset < 2:
        late = _beside_drift(late, _searches_anew(late, search, drifting) if late.input_delay.any() else anew)
    return _with_constants(late)


def _beside_drift(fit: FreeFit, anew: Anew) -> FreeFit:
    """The fit beside outputs that drift, where a line explains more than a slow mode or what is left."""
    records = [record for record in fit.projection.experiments if isinstance(record, FreeRecord)]
    slow = fit.projection.d < TUNING.damped_apart * min(record.bin for record in records)
    if not slow.any() and not any(_leans(*pair) for pair in zip(records, fit.projection.predictions(), strict=True)):
        return fit
    trial = anew(fit.lateness, 2, fit.projection.p[~slow])
    if trial.criteria.bic > fit.criteria.bic - 2 * TUNING.sure or _gain_of_drift(trial) < TUNING.sure:
        return fit
    again = anew(fit.lateness, 2, None)
    best = again if again.criteria.bic <= trial.criteria.bic else trial
    drifts = [
        float(slope) for rows, own in zip(best.projection.experiments, best.projection.own, strict=True)
        if isinstance(rows, FreeRecord) for slope in best.scales[rows.outputs] * own[-2] * rows.unit / rows.hold.h
    ]  # fmt: skip
    # slow poles may stand for a drift
    level = anew(fit.lateness, 1, fit.projection.p[~slow]) if slow.any() else fit
    gain = max(best.criteria.loglik - level.criteria.loglik, 0.5 * (fit.criteria.bic - best.criteria.bic))
    finding = Finding(Cause.DRIFT, tuple(drifts), gain)
    return replace(best, findings=(*fit.findings, finding), delay_gain=fit.delay_gain)


def _gain_of_drift(fit: FreeFit) -> float:
    """Log-likelihood by which the drifts of a fit explain more than constants, in noise as coloured as it leaves.

    Less half of what BIC charges.  Noise of slow colour leans by itself.
    """
    gain = 0.0
    for rows, own, predicted in zip(
        fit.projection.experiments, fit.projection.own, fit.projection.predictions(), strict=True
    ):
        if not isinstance(rows, FreeRecord):
            continue
        t, residuals = np.arange(float(rows.length)), rows.residuals(predicted)
        for residual, slope in zip(residuals, own[-2], strict=True):
            models, variances = foretold(correlations([np.fft.rfft(residual)], [rows.length]))
            past = np.concatenate([[1.0], -models[_order_of_noise(rows.samples, variances)]])
            seen = np.convolve(~rows.observed, np.ones(len(past)))[: rows.length] == 0
            seen[: len(past) - 1] = False
            lines = np.stack([np.convolve(x, past)[: rows.length][seen] for x in (np.ones(rows.length), t)])
            drifting = np.convolve(residual + slope * t, past)[: rows.length][seen]
            squares = [float(np.sum(without(drifting[:, None], orthogonal(lines[:k].T)[0]) ** 2)) for k in (1, 2)]
            if squares[1] > 0:
                gain += 0.5 * len(drifting) * float(np.log(squares[0] / squares[1]))
            gain -= 0.5 * float(np.log(max(rows.samples, 2)))
    return gain


def _with_constants(fit: FreeFit) -> FreeFit:
    """Return the fit with a finding of the constants of its outputs, if there are any."""
    if fit.offset != 1:
        return fit
    values = [
        float(value) for rows, own in zip(fit.projection.experiments, fit.projection.own, strict=True)
        for value in fit.scales[rows.outputs] * own[-1] * getattr(rows, "unit", 1.0)
    ]  # fmt: skip
    finding = Finding(Cause.CONSTANT, tuple(values), 0.5 * float(_evidence_of_constants(fit.projection)))
    return replace(fit, findings=(*fit.findings, finding))


def _evidence_of_constants(projection: FreeProjection) -> float:
    """How much the loss would grow without the constants of the outputs, in noise as slow as they are left with."""
    covariance, slowness = projection.covariance(1.0), _slowness(projection)
    triples = (
        (own[-1], inner[-1, -1], slow) for k, outputs in enumerate(projection.own) for own, (inner, _), slow in zip(
            outputs.T, projection.own_covariances(k, covariance, 1.0), slowness[k], strict=True
        )
    )  # fmt: skip
    return float(sum(value**2 / (variance * slow) for value, variance, slow in triples))


def _slowness(projection: FreeProjection) -> list[list[float]]:
    """Of each record and output how many times the variance of a mean is that in white noise, at least 1."""
    slowness = []
    for rows, predicted in zip(projection.experiments, projection.predictions(), strict=True):
        assert isinstance(rows, FreeRecord)
        each = []
        for residual in rows.residuals(predicted):
            models, variances = foretold(correlations([np.fft.rfft(residual)], [rows.length]))
            order = _order_of_noise(rows.samples, variances)
            each.append(max(1.0, float(variances[order] / (1 - models[order].sum()) ** 2)))
        slowness.append(each)
    return slowness


def _order_of_noise(samples: int, variances: Array) -> int:
    """The order of an autoregression that BIC prefers."""
    return int(np.argmin(samples * np.log(variances) + np.log(max(samples, 2)) * np.arange(len(variances))))


def _leans(rows: FreeRecord, predicted: NDArray[Any]) -> bool:
    """Whether a line explains some of what is left of outputs."""
    t = np.flatnonzero(rows.observed) - np.mean(np.flatnonzero(rows.observed))
    residuals = (rows.measured - predicted)[:, rows.observed]
    share = (residuals @ t) ** 2 / np.maximum(np.sum(residuals**2, axis=1) * (t @ t), np.finfo(float).tiny)
    return bool(np.any(-0.5 * len(t) * np.log1p(-np.minimum(share, 0.5)) > TUNING.likely))


def undelayed(fit: FreeFit) -> Lateness:
    """The delays of a fit without those of the outputs."""
    return replace(fit.lateness, outputs=np.zeros_like(fit.delay))


def _of_late_inputs(path: FreePath, channels: Experiments, search: _Search, drifting: bool) -> FreeFit | None:
    """The fit with inputs that act later, each by a time of its own, where a few lags already tell; None elsewhere.

    These have to explain most of the outputs.  The fit has to be likelier than what a search without dead times finds
    that begins with its poles and its noise, with one more mode at most: more of them would come to stand for dead
    times one by one.
    """
    rows = [record for record in path.plain.data if isinstance(record, FreeRecord)]
    proposed = _proposed_dead_times(rows, path.felt.shape[1], np.zeros(0, complex))
    if proposed is None:
        return None
    late_path = search.path_for(channels, late=_lateness_of(proposed.times, path.felt.shape[0]))
    late_rows = late_path.plain.data
    still, lagging = (FreeProjection(late_rows, p).losses for p in (np.zeros(0, complex), proposed.lags))
    if np.mean(lagging / np.maximum(still, np.finfo(float).tiny)) > _MOSTLY:
        return None
    late_path.whiten(proposed.noise, late_path.power)
    late = search.along(late_path, channels, np.append(search.begin, proposed.lags))
    try:
        late = late if late.interrupted else _in_best_dead_times(late, search, drifting)
    except KeyboardInterrupt:
        return replace(late, interrupted=True)
    if late.interrupted:
        return late
    path.whiten(late.noise, path.power)
    rival = replace(search, most=min(search.most, late.order + search.automatic))
    return _likelier_late(late, rival.along(path, channels, late.projection.p))


def _with_dead_times(fit: FreeFit, anew: Anew, search: _Search, drifting: bool) -> FreeFit | None:
    """The fit with inputs that act later, each by a time of its own, where that explains more; None elsewhere.

    Nothing is looked for where what is left shows nothing of the inputs, and no pole could stand for a dead time.
    """
    p = fit.projection.p
    mimics = -p.real > _MIMICS * np.abs(p)
    if fit.rounding or not (fit.noise or mimics.any() or _leaves_traces(fit.projection)):
        return None
    proposed = _proposed_dead_times(_of_fit(fit), len(fit.input_delay), p[~mimics]) if not mimics.all() else None
    if proposed is None:  # lags alone were looked at before
        return None
    late = anew(_lateness_of(proposed.times, len(fit.delay)), fit.offset, None)
    return _likelier_late(_in_best_dead_times(late, search, drifting), fit)


def _likelier_late(late: FreeFit, on_time: FreeFit) -> FreeFit | None:
    """A fit with dead times, and the findings that say so, where it is likelier than one without; None elsewhere."""
    if on_time.interrupted:
        return replace(late, interrupted=True)
    gain = 0.5 * (_criterion(on_time) - _criterion(late))
    if gain <= TUNING.sure:
        return None
    times = zip(late.channels[0].input_labels, late.input_delay.tolist(), strict=True)
    findings = (Finding(Cause.INPUT_DELAY, (time,), gain, label) for label, time in times if time)
    return replace(late, findings=(*on_time.findings, *findings), delay_gain=gain)


def _in_best_dead_times(fit: FreeFit, search: _Search, drifting: bool) -> FreeFit:
    """The fit with the dead times that are the likeliest for its slowest poles and its noise, and poles for these.

    Fast poles may stand for a part of a dead time.
    """
    for _ in range(_SCANS):
        before, slowest = _dead_samples(fit), fit.projection.p[np.argsort(np.abs(fit.projection.p))]
        trials = []
        for count in range(len(slowest), 0, -1):
            scan = _scan(_of_fit(fit), slowest[:count], len(before))
            dead = scan.refined(before, fit.noise)
            trials.append((scan.cost(dead), dead.samples, scan.p))
        if not trials:
            break
        _, samples, p = min(trials, key=lambda trial: trial[0])
        if np.array_equal(samples, before) and len(p) == len(slowest):
            break
        lateness = _lateness_of(fit.channels[0].dt * samples, len(fit.delay))
        again = _searches_anew(fit, search, drifting)(lateness, fit.offset, p)
        if _criterion(again) >= _criterion(fit):
            break
        fit = again
    return fit


def _lateness_of(times: Array, outputs: int) -> Lateness:
    """Delays that have these dead times of the inputs: what all inputs share is one of the outputs."""
    common = 0.0 if np.ptp(times) else float(times[0])
    return Lateness(np.full(outputs, common), times - common)


def _dead_samples(fit: FreeFit) -> Indices:
    """Samples by which each input acts later, with what all outputs are late by."""
    return np.asarray(np.rint((fit.input_delay + fit.delay.min()) / fit.channels[0].dt), int)


def _of_fit(fit: FreeFit) -> list[FreeRecord]:
    """The records of a fit without delays."""
    moving = any(rows.moving for rows in fit.projection.experiments)
    return _records(fit.channels, fit.intersample, fit.offset, moving, fit.method)


def _scan(rows: Sequence[FreeRecord], p: ComplexArray, inputs: int) -> DeadTimeScan:
    """Dead times of inputs for some poles."""
    count = sum(record.samples * len(record.outputs) for record in rows)
    return DeadTimeScan(rows, p, _longest_dead_time(rows), 0.5 * float(np.log(count)), inputs)


def _longest_dead_time(rows: Sequence[FreeRecord]) -> int:
    """Samples of the longest dead time that is looked for."""
    return min(_LONGEST_DELAY, min(record.length for record in rows) // 10)


@dataclass(frozen=True)
class _Proposal:
    """Times (m,) by which inputs act later, with the lags beside which they are likely, and the noise of these."""

    times: Array
    lags: ComplexArray
    noise: tuple[Array, ...]


def _proposed_dead_times(rows: Sequence[FreeRecord], inputs: int, p: ComplexArray) -> _Proposal | None:
    """Times by which inputs act later, that some modes and a few lags are likelier with by far than any without.

    A lag of second order looks like one of first order and a dead time: more lags without dead times have to be less
    likely as well.  None where there are no such times.
    """
    steps = [record.hold.h for record in rows]
    if inputs < 2 or np.ptp(steps) > EPS * max(steps) or is_short(rows[0]):
        return None
    start = np.zeros(inputs, int)
    slowest = 6.0 / min(record.length for record in rows)
    single = np.geomspace(3 * slowest, 0.5, _LAGS)[:, None]
    several = [*(single[:-1] * [1.0, 3.0]), *(np.geomspace(slowest, 0.5, count) for count in (3, 4, 6))]
    trials, least = [], np.inf
    for rates in (single, several):
        for lags in (-np.array(row, complex) / steps[0] for row in rates):
            scan = _scan(rows, np.append(p, lags), inputs)
            without, late = scan.likeliest(start)
            least = min(least, scan.cost(without))
            trials.append((scan.cost(late), late, lags))
        cost, late, lags = min(trials, key=lambda trial: trial[0])
        if cost > least - TUNING.likely:
            return None
    return _Proposal(np.asarray(steps[0] * late.samples), lags.astype(complex), late.noise)


def _criterion(fit: FreeFit) -> float:
    """BIC over the samples that the longest dead times leave to all fits, with these among the parameters."""
    rows = _records(fit.channels, fit.intersample, fit.offset, _of_fit(fit)[0].moving, fit.method, fit.lateness)
    most = _longest_dead_time(rows) * fit.channels[0].dt - float(fit.input_delay.max(initial=0.0))
    rows = [row.delayed(row.delay_time, 0.0, most) for row in rows]
    shown = Records(rows).whitened(fit.noise).data if fit.noise else rows
    counts = np.zeros(len(fit.scales))
    for row in shown:
        counts[row.outputs] += row.samples
    losses = np.maximum(FreeProjection(shown, fit.projection.p, fit.projection.fed).losses, np.finfo(float).tiny)
    whole = float(fit.projection.rows)
    loglik = -0.5 * whole / counts.sum() * float(counts @ np.log(losses / counts))
    return (fit.unknowns + numbers_of(_dead_samples(fit))) * float(np.log(whole)) - 2 * loglik


def _on_time(fit: FreeFit, anew: Anew) -> FreeFit:
    """The fit with outputs that come some samples after the inputs, or before, where the modes say so."""
    best, gain = fit, TUNING.likely
    for delay in likely_delays(fit):
        again = anew(replace(fit.lateness, outputs=delay), fit.offset, None)
        share = fit.projection.rows / again.projection.rows
        now = 0.5 * (fit.criteria.bic - again.criteria.bic * share)
        if now > gain and _responds(again):
            best, gain = replace(again, findings=fit.findings, delay_gain=now), now
            if again.order < fit.order and not _leaves_traces(again.projection):
                break
    # poles that were found in a wrong delay, or none, say little of the right one
    tried = {_samples_late(best)}
    for _ in range(_SCANS * (not best.rounding)):
        proposed = scanned_delays(best) - tried
        tried, before = tried | proposed, best
        for samples in sorted(proposed - {0}):
            delay = np.full(len(fit.scales), samples * fit.channels[0].dt)
            again = anew(replace(fit.lateness, outputs=delay), fit.offset, None)
            now = 0.5 * (fit.criteria.bic - again.criteria.bic * fit.projection.rows / again.projection.rows)
            # with noise that is modelled a delay is one more parameter; without, what else leaves traces may ask for it
            each = 0.5 * float(np.log(fit.projection.rows)) if again.noise else TUNING.likely
            if now > (each if best is fit else gain) and _responds(again):
                best, gain = replace(again, findings=fit.findings, delay_gain=now), now
        if best is before:
            break
    return best


def _responds(fit: FreeFit) -> bool:
    """Whether outputs are more than noise and free motions, which know no delay."""
    return bool(fit.states or np.any(fit.projection.feedthrough))


def likely_delays(fit: FreeFit) -> list[Array]:
    """Whole samples, as times, by which outputs of recordings may come after the inputs, for the poles there are.

    A delay turns the phase of residues; the first samples of a response determine it.  Heavily damped modes can be a
    rational approximation of it (Pade), which leaves white residuals: they are weighed against a delay without them.
    One delay of all outputs, or of each its own; the likeliest first.
    """
    if not fit.projection.inputs or not fit.order or isinstance(fit.channels[0], ResponseMatrix):
        return []
    some = [cut(recording, slice(0, min(recording.samples, _DELAYS_FROM))) for recording in fit.channels]
    step, count = some[0].dt, len(fit.scales)
    records = [
        replace(record, y=record.y / fit.scales[record.outputs, None])
        for record in _records(some, fit.intersample, fit.offset, True, fit.method, undelayed(fit))
    ]

    def late(samples: int, p: ComplexArray = fit.projection.p) -> FreeProjection:
        return FreeProjection([record.delayed(samples * step) for record in records], p)

    def of_all(samples: list[int]) -> list[Array]:
        return [np.full(count, step * lag) for lag in samples]

    mimicked = _mimicked_delays(late, fit.projection.p)
    if mimicked:
        return of_all(mimicked)
    if not _leaves_traces(late(0)):
        return []
    gains, each = {}, {}
    for delay in (0, *TUNING.delays):
        projection = late(delay)
        if projection.rows > 2 * projection.unknowns or not delay:
            gains[delay] = -0.5 * fit.projection.rows * float(np.log(projection.loss / projection.rows))
            each[delay] = projection.losses / projection.rows
    if fit.noise:  # what takes the place of a delay
        best = max(gains, key=lambda delay: gains[delay])
        return of_all([best] if best else [])
    # modes too many may stand for most of a delay; one sample more or less is what may be fed through
    likely = {delay for delay, gain in gains.items() if delay > 1 and gain > gains[0] - TUNING.likely}
    likely |= {1} & gains.keys() if likely else set()
    likely = (likely | {max(gains, key=lambda delay: gains[delay])}) - {0}
    common_delays = of_all(sorted(likely, key=lambda delay: -gains[delay]))
    tried = np.array(list(each))
    own = tried[np.argmin(np.stack([each[delay] for delay in tried.tolist()]), axis=0)]
    return [*common_delays, step * own] if np.ptp(own) else common_delays


def _mimicked_delays(late: Callable[[int, ComplexArray], FreeProjection], p: ComplexArray) -> list[int]:
    """Samples of the delays that heavily damped modes stand for, the likeliest first; none if these are likelier."""

    def bic(samples: int, p: ComplexArray) -> float:
        projection = late(samples, p)
        rows = projection.rows
        return float(rows * np.log(projection.loss / rows) + projection.unknowns * np.log(rows)) / rows

    light = p[-p.real < _MIMICS * np.abs(p)]
    if 0 < len(light) < len(p):
        values = {delay: bic(delay, light) for delay in TUNING.delays}
        best = min(values, key=lambda delay: values[delay])
        if best and values[best] < bic(0, p):
            # a sample may be fed through
            near = ({best - 1, best, best + 1} & set(TUNING.delays)) - {0}
            return sorted(near, key=lambda delay: values[delay])
    return []


def _samples_late(fit: FreeFit) -> int:
    """Whole samples by which the outputs of a fit come after its inputs."""
    return int(np.rint(np.median(fit.delay) / fit.channels[0].dt))


def scanned_delays(fit: FreeFit) -> set[int]:
    """Samples by which outputs may come after the inputs, for the poles and the noise there are, or a lag of any rate.

    Poles of a fit may stand for a part of a delay, which a lag cannot.  Nothing is looked for where what is left shows
    nothing of the inputs.
    """
    channels = fit.channels
    if isinstance(channels[0], ResponseMatrix) or not len(channels[0].input_labels) or fit.rounding or not (
        fit.noise or (fit.order and np.any(fit.projection.p.imag == 0) and _leaves_traces(fit.projection))
    ):  # fmt: skip
        return set()
    some = [cut(recording, slice(0, min(recording.samples, _DELAYS_FROM))) for recording in channels]
    shortest = min(recording.samples for recording in some)
    most = min(_LONGEST_DELAY, shortest // 10)
    records = _records(some, fit.intersample, fit.offset, True, fit.method, undelayed(fit))

    def scanned(p: ComplexArray) -> tuple[float, int]:
        """Squares that poles leave with the best delay, and this."""
        losses = []
        for samples in range(most + 1):
            late = [row.delayed(samples * row.hold.h, 0.0, most * row.hold.h) for row in records]
            rows = Records(late).whitened(fit.noise) if fit.noise else Records(late)
            losses.append(FreeProjection(rows.scaled(1.0 / fit.scales).data, p).loss)
        return min(losses), int(np.argmin(losses))

    rates = np.geomspace(20.0 / shortest, 0.5, _LAGS) / channels[0].dt
    proposed = {min(scanned(np.array([-rate + 0j])) for rate in rates)[1]}
    return proposed | {scanned(fit.projection.p)[1]} if fit.order else proposed


def _leaves_traces(projection: FreeProjection) -> bool:
    """Whether what is left of outputs is no white noise, or goes with an input some samples before or after."""
    most, p_values = max(map(abs, TUNING.delays)), []
    for rows, predicted in zip(projection.experiments, projection.predictions(), strict=True):
        if not isinstance(rows, FreeRecord):
            continue
        residuals = np.where(rows.observed, rows.measured - predicted, 0.0)
        p_values += [ljung_box([residual[rows.observed]], TUNING.lags) for residual in residuals]
        size = 2 * rows.length
        U, E = np.fft.rfft(rows.u[: rows.inputs], size), np.fft.rfft(residuals, size)
        products = np.fft.irfft(E[:, None] * U.conj(), size)[..., np.r_[-most : most + 1]]
        power = np.sum(residuals**2, axis=1)[:, None] * np.sum(rows.u[: rows.inputs] ** 2, axis=1) / rows.samples
        p_values += chi2.sf(products**2 / np.where(power > 0, power, np.inf)[..., None], 1).ravel().tolist()
    return bool(p_values) and min(p_values) * len(p_values) < TUNING.white


# --- noise that grows with the gain ----------------------------------------------------------------------------------


def _reweighted(
    first: FreeFit,
    refined: Callable[[Experiments, ComplexArray], FreeFit],
    again: Callable[[Experiments, ComplexArray, bool], FreeFit],
) -> FreeFit:
    """The fit repeated with the weights of the noise of its entries, until both agree; as it was, if that is constant.

    `refined` keeps the poles but for what the weights move them by; `again` looks for others as well, unless these are
    known.
    """
    laws, free = entry_laws(first.projection)
    if free and not any(law.share for law, _ in laws):
        return first
    # points of large gain, were they taken as equally sure, would draw the model through themselves
    weights, p, known = balanced([channel.response for channel in first.channels]), first.projection.p, False
    while True:
        for place in range(ROUNDS):
            before = weights
            near = refined(_with_weights(first.channels, weights), p)
            laws, _ = entry_laws(near.projection)
            if not any(law.share for law, _ in laws):
                return first
            weights, p = _inverse_variances(near, [law for law, _ in laws]), near.projection.p
            pairs = zip(weights, before, strict=True)
            if place and all(np.nanmax(np.abs(new / old - 1)) <= SETTLED for new, old in pairs):
                break
        judged = again(_with_weights(first.channels, weights), p, known)
        if known or judged.order == len(p):
            break
        # other modes leave other noise
        p, known = judged.projection.p, True
    finding = Finding(Cause.GAIN_NOISE, tuple(law.share for law, _ in laws), sum(gain for _, gain in laws))
    # constant noise, at the points of large gain that balanced weights leave free, may seem to grow
    more = float(np.log(judged.projection.rows)) * sum(1 for law, _ in laws if law.share)
    return replace(judged, findings=(finding,)) if _weighted_bic(judged) + more < _weighted_bic(first) else first


def _weighted_bic(fit: FreeFit) -> float:
    """BIC with the density of the noise where it has these weights: two real numbers at each point."""
    return fit.criteria.bic - 2 * sum(
        float(np.sum(np.log(channel.weights[channel.observed]))) for channel in fit.channels
    )


def _with_weights(channels: Sequence[ResponseMatrix], weights: Sequence[Array]) -> list[ResponseMatrix]:
    pairs = zip(channels, weights, strict=True)
    return [replace(channel, weights=np.where(channel.observed, each, 1.0)) for channel, each in pairs]


def _inverse_variances(fit: FreeFit, laws: Sequence[NoiseLaw]) -> list[Array]:
    """Weights (p, m, K) of each experiment by the laws of its entries, in the units of the data."""
    inverse_variances, projection = [], fit.projection
    for number, channel in enumerate(fit.channels):
        weights = np.ones((len(laws), channel.samples))
        for rows, predicted in zip(projection.experiments, projection.predictions(), strict=True):
            if isinstance(rows, FreeResponse) and rows.experiment == number:
                for output, gain in zip(rows.outputs.tolist(), np.abs(predicted), strict=True):
                    variance = laws[output].floor ** 2 + (laws[output].share * gain) ** 2
                    weights[output] = 1.0 / (fit.scales[output] ** 2 * np.where(np.isnan(gain), 1.0, variance))
        inverse_variances.append(weights.reshape(channel.response.shape))
    return inverse_variances


def orders_about(
    channels: Experiments, poles: ComplexArray, most: int, *, quantities: Sequence[str], intersample: str, offset: bool,
    moving: bool, method: str = "exact", late: Lateness | None = None,
) -> list[tuple[ComplexArray, ComplexArray]]:  # fmt: skip
    """Poles and residues (n, p, m) of ascending orders, one more mode each: to some poles, and from these to the most.

    Real poles stay, and are left out.
    Without inputs the residues are motions in the experiments.
    """
    channels = [cut(channel, searched_part(channel, not moving)) for channel in channels]
    path = FreePath.of(channels, quantities, intersample, offset, moving, method=method, late=late)
    orders = []
    for start, end in ((poles[poles.imag == 0], _modes(poles) - 1), (poles, min(most, path.carried))):
        model: FreeModel | None = path.reweighted(path.model(start))
        while model is not None:
            modes = model.p.imag > 0
            if modes.any():
                orders.append((model.p[modes], path.residues(model.projection, channels)[modes]))
            model = path.with_modes(model, _modes(model.p) + 1, False) if _modes(model.p) < end else None
    return orders


# --- data ------------------------------------------------------------------------------------------------------------


def _records(
    channels: Sequence[Recording], hold: str, offset: int, moving: bool, method: str = "exact",
    late: Lateness | None = None,
) -> list[FreeRecord]:  # fmt: skip
    records = list[FreeRecord]()
    for recording in channels:
        acting = np.flatnonzero(recording.u.any(axis=1))
        driven = len(acting) > 0
        options = {"offset": offset, "driven": driven, "moving": moving or not driven, "among": acting,
                   "unit": recording.unit}  # fmt: skip
        u = recording.u if driven and len(acting) == len(recording.u) else recording.u[acting]
        u = u if driven else np.broadcast_to(0.0, (1, recording.samples))
        records += FreeRecord.by_observation(
            u, recording.y, recording.observed, Hold(recording.dt, method, hold), recording.level, **options
        )
    if late is None:
        return records
    records = [rows.with_dead_times(late.inputs) for rows in records]
    return Delays.of_outputs(late.outputs).rows(records) if late.outputs.any() else records


def _responses(
    channels: Sequence[ResponseMatrix], quantities: Sequence[str], delay: Array | None = None
) -> list[FreeResponse]:
    """Entries grouped where weights, but for a factor, and points agree."""
    responses = list[FreeResponse]()
    for number, channel in enumerate(channels):
        entries = channel.response.reshape(-1, channel.samples)
        weights, observed = channel.weights.reshape(entries.shape), channel.observed.reshape(entries.shape)
        kinds = np.repeat(np.array(quantities), channel.response.shape[1])
        groups: dict[tuple[str, bytes, bytes], list[int]] = {}
        for e in np.flatnonzero(observed.any(axis=1)).tolist():
            shape = np.float32(np.where(observed[e], weights[e] / weights[e][observed[e]].mean(), 0.0)).tobytes()
            if channel.errors is not None:
                shape = str(e).encode()
            groups.setdefault((str(kinds[e]), observed[e].tobytes(), shape), []).append(e)
        for (kind, *_), members in groups.items():
            first, seen = members[0], observed[members[0]]
            scale = np.sqrt(weights[first] / weights[first][seen].mean())
            response = np.where(seen, entries[members], 0.0)
            output, source = divmod(first, channel.response.shape[1])
            white = None if channel.errors is None else channel.errors.factor(output, source, seen)
            rows = FreeResponse(
                channel.omega, response, scale, seen, kind, np.array(members), window=channel.window, white=white,
                shared_errors=_shared_errors(channel, first, seen), experiment=number,
            )  # fmt: skip
            responses.append(rows.on_background())
    if delay is None or not delay.any():
        return responses
    return Delays.of_outputs(delay.repeat(len(channels[0].input_labels))).rows(responses)


def _shared_errors(channel: ResponseMatrix, entry: int, seen: Mask) -> SharedErrors | None:
    """What an entry of several has in common with others."""
    inputs = channel.response.shape[1]
    law = None if channel.errors is None else channel.errors.law
    if channel.errors is None or law is None or channel.window is None or len(channel.response) * inputs < 2:
        return None
    place, lines = divmod(entry, inputs), channel.window.lines(channel.omega[seen])
    return SharedErrors.of(law, place, float(channel.errors.noise_ratio[place[0]]), lines)


def _refuse_unmeasured(matrix: ResponseMatrix, measured: Array) -> None:
    """Refuse an entry that no experiment measured: nothing is known of its residues."""
    rest = np.setdiff1d(np.arange(matrix.response[..., 0].size), measured)
    if rest.size:
        o, i = divmod(int(rest[0]), len(matrix.input_labels))
        more = f", and {rest.size - 1} more of {matrix.response[..., 0].size} responses" if rest.size > 1 else ""
        raise StructureError(
            f"the response of {matrix.output_labels[o]!r} to {matrix.input_labels[i]!r} was not measured at any "
            f"frequency{more}; fit the inputs and outputs that were measured with one another, data[outputs, inputs]"
        )


# --- the path --------------------------------------------------------------------------------------------------------


class FreePath:
    """The search in some data, with what each output is multiplied by so that its noise has variance 1.

    What is fed through `felt` entries (outputs, inputs of the rows) stays in any case.
    """

    def __init__(
        self, search: FreeSearch, felt: Mask, criterion: str = "bic", reports: Reports = lambda order: None,
        best: FreeModel | None = None, real_poles: int | str = "auto", noise: tuple[Array, ...] = (),
        constant_open: bool = False, white: bool = False, largest: int | None = None,
    ) -> None:  # fmt: skip
        self.constant_open = constant_open  # whether outputs need not have a constant
        self.white = white  # whether noise is taken as white
        self.largest = largest  # number of modes that pairs of real poles must not turn into more than
        self.real_poles, self.plain = real_poles, search.with_kinds(real_poles == "auto")
        self.felt, self.criterion, self.reports = felt, criterion, reports
        self.table: dict[int, FreeOrder] = {}
        self.best = best  # so far
        self.seen: list[tuple[float, ComplexArray]] = []  # all so far: costs and poles
        self._shown: tuple[FreeModel, tuple[ComplexArray, Array]] | None = None
        self.separate = False  # whether a common denominator does not explain more than one mode after the other
        extent = np.zeros(len(felt))
        for rows in search.data:
            extent[rows.outputs] = np.maximum(extent[rows.outputs], rows.largest)
        extent = np.where(extent > 0, extent, extent.max())  # what is zero is so to the rounding of the others
        # real equations of each output, losses that are rounding, and the power of all
        counts = self._counted(self.plain)
        self.counts = np.maximum(counts, 1)
        self.floors = np.maximum(counts * (EPS * counts * extent) ** 2, np.finfo(float).tiny)
        self.search, self._missing = self.plain, np.ones(len(felt))
        self.power = self.plain.model(FreeProjection(self.plain.rows(none := np.zeros(0, complex)), none)).losses
        self.whiten(noise, self.power if best is None else best.losses)

    @classmethod
    def of(
        cls, channels: Experiments, quantities: Sequence[str] | None, intersample: str, offset: int, moving: bool,
        criterion: str = "bic", reports: Reports = lambda order: None, best: FreeModel | None = None,
        real_poles: int | str = "auto", method: str = "exact", constant_open: bool = False,
        late: Lateness | None = None, noise: tuple[Array, ...] = (), white: bool = False, largest: int | None = None,
    ) -> FreePath:  # fmt: skip
        """The search in channels, or what ends one whose best model is known."""
        first = channels[0]
        each = quantities or ["free"] * len(first.output_labels)
        felt = np.array([quantity == "acceleration" for quantity in each])[:, None].repeat(
            len(first.input_labels), axis=1
        )
        if not isinstance(first, ResponseMatrix):
            held = "zoh" if intersample == "auto" else intersample
            recordings = [channel for channel in channels if isinstance(channel, Recording)]
            search: FreeSearch = Records(_records(recordings, held, offset, moving, method, late))
            return cls(search, felt, criterion, reports, best, real_poles, noise, constant_open, white, largest)
        responses = [channel for channel in channels if isinstance(channel, ResponseMatrix)]
        search = Responses(_responses(responses, each, None if late is None else late.outputs))
        _refuse_unmeasured(first, np.concatenate([rows.outputs for rows in search.data]))
        return cls(search, felt.reshape(-1, 1), criterion, reports, best, real_poles, largest=largest)

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

    # --- likelihood

    def _counted(self, search: FreeSearch) -> Array:
        """Real equations of each output in some rows."""
        counts = np.zeros(len(self.felt))
        for rows in search.data:
            counts[rows.outputs] += rows.samples
        return counts

    def drop_constants(self, losses: Array) -> None:
        """Go on with outputs that have no constant."""
        if isinstance(self.plain, Records) and isinstance(self.search, Records):
            self.plain, self.search = self.plain.without_constants(), self.search.without_constants()
        self.weigh(losses)

    def whiten(self, innovations: tuple[Array, ...], losses: Array) -> None:
        """Go on in rows in which noise with these innovations filters is white, and is what leaves these losses."""
        if not _same_filters(innovations, getattr(self.search, "innovations", ())):
            self.search = self.plain.whitened(innovations) if isinstance(self.plain, Records) and innovations else (
                self.plain
            )  # fmt: skip
            # filters cannot know their past at the beginning: losses are those of as many samples as in the data
            self._missing = self.counts / np.maximum(self._counted(self.search), 1)
        self.weigh(losses)

    def in_data(self, losses: Array) -> Array:
        """Losses of scaled rows in the units of the data, and of as many samples."""
        return losses / self.sizes**2 * self._missing

    def of_few_lines(self) -> list[FreePath]:
        """Searches for modes with real shapes among responses of few points, without and with a background."""
        if not isinstance(self.search, Responses) or self.search.shows_background(_FEW_MODES):
            return []
        if any(response.quantity == "free" for response in self.search.data):
            return []
        rows = [replace(response, classical=True) for response in self.search.data]
        return [
            FreePath(Responses(each, False), self.felt, self.criterion, self.reports, None, 0)
            for each in (rows, [response.beside_modes_outside() for response in rows])
        ]

    def add_terms(self, rows: Sequence[FreeResponse]) -> None:
        """Take the terms of the backgrounds of other rows beside those there are."""
        for term in Responses(rows).terms:
            if isinstance(self.search, Responses):
                self.search = self.search.with_term(term)
        self.weigh(self.power)

    def weigh(self, losses: Array) -> None:
        """Give every output the weight of the variance that it is left with."""
        self.sizes, self._shown = np.sqrt(self.counts / np.maximum(losses, self.floors)), None
        self.scaled = self.search.scaled(self.sizes)

    def loglik(self, losses: Array) -> float:
        """Log-likelihood at the best variances."""
        variances = np.maximum(losses, self.floors) / self.counts
        return float(-0.5 * np.sum(self.counts * (np.log(2 * np.pi * variances) + 1)))

    def criteria(self, loglik: float, unknowns: int) -> Criteria:
        """Criteria of a model with so many unknowns beside the variances."""
        return Criteria.of(loglik, unknowns + len(self.counts), float(self.counts.sum()))

    def cost(self, model: FreeModel) -> float:
        """What the order is chosen by: the criterion, with noise of each output as coloured as it prefers."""
        cost = self.criteria(self.loglik(model.losses), self.search.unknowns_of(model.p)).by_name(self.criterion)
        # what no mode explains yet is not taken for noise, nor is rounding
        if self.white or not (len(model.p) or model.innovations) or self.is_exact(model):
            return cost
        for count, noise in zip(self.counts, model.noise, strict=False):
            cost += past_of_noise(int(count), noise.variances, self._each)
        return cost

    @property
    def _each(self) -> float:
        """What the criterion charges for a parameter."""
        return 2.0 if self.criterion in ("aic", "aicc") else float(np.log(self.counts.sum()))

    def _stands_out(self, model: FreeModel, gain: float, unknowns: int) -> bool:
        """Whether noise would hardly let so many unknowns more explain as much of what a model leaves."""
        loss = float(np.sum(model.losses * self.sizes**2))
        return stands_out(gain, loss, int(self.counts.sum()), self.search.unknowns_of(model.p), unknowns)

    def gain(self, more: FreeModel, model: FreeModel) -> float:
        """By how much the criterion prefers a larger model, both in rows in which the noise of the larger one is white.

        Residues that are best in white noise are poor ones in coloured noise, whose criterion they say little of.
        """
        past = self._past_of_noise(more)
        if self.search is not self.plain or not past or not isinstance(self.plain, Records):
            return self.cost(model) - self.cost(more)
        rows = self.plain.whitened(past).data
        counts, likelihood = np.zeros(len(self.counts)), []
        for record in rows:
            counts[record.outputs] += record.samples
        for p in (model.p, more.p):
            losses = np.maximum(FreeProjection(rows, p).losses, self.floors)
            likelihood.append(-0.5 * float(np.sum(counts * np.log(losses / counts))))
        unknowns = [self.search.unknowns_of(candidate.p) for candidate in (model, more)]
        first, second = (
            Criteria.of(each, count, float(counts.sum())).by_name(self.criterion)
            for each, count in zip(likelihood, unknowns, strict=True)
        )  # fmt: skip
        return first - second

    def _past_of_noise(self, model: FreeModel) -> tuple[Array, ...]:
        """Of each output the innovations filter of the autoregression that the criterion prefers."""
        if self.white:
            return ()
        filters = [noise.innovations(int(count), self._each)
                   for count, noise in zip(self.counts, model.noise, strict=False)]  # fmt: skip
        return tuple(filters) if any(len(coefficients) > 1 for coefficients in filters) else ()

    def in_its_noise(self, model: FreeModel) -> FreeModel:
        """A model refined in rows in which its own noise is white, until both agree."""
        self.whiten(model.innovations, model.losses)
        for _ in range(_ROUNDS):
            past = self._past_of_noise(model)
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

    # --- models

    def region(self, p: ComplexArray) -> PoleRegion:
        """Where poles may go from a start: pairs of real ones become no modes that would be more than the largest."""
        region = self.scaled.region
        most = _modes(p) + _real(p) // 2
        return region if self.largest is None or most <= self.largest else replace(region, kinds_may_change=False)

    def model(self, p: ComplexArray, rtol: float = _ROUGH) -> FreeModel:
        """Modes refined from a start, over the bins about them; outputs are weighted by what is left then."""
        rows, region, report = self.scaled.rows, self.region(p), self.report(max(1, _modes(p)))
        try:
            projection = refine_free(rows, p, region, rtol, last=False, steps=_STEPS, progress=report)
        except Interrupted as cut:
            p = Sections.from_coordinates(cut.x).p
            self.judged(FreeProjection(rows(p), p))
            raise
        return self.judged(projection)

    def judged(self, projection: FreeProjection) -> FreeModel:
        """Modes with what they leave, entered into the table."""
        model, n = self.scaled.model(projection), _modes(projection.p)
        model = replace(model, losses=self.in_data(model.losses))
        criteria = self.criteria(self.loglik(model.losses), self._unknowns_of(projection.p))
        if n not in self.table or self.table[n].loglik < criteria.loglik:
            self.table[n] = FreeOrder(
                **vars(criteria),
                order=n,
                poles=projection.p[projection.p.imag > 0][np.argsort(projection.d[projection.p.imag > 0])],
            )
        cost = self.cost(model)
        self.seen.append((cost, projection.p))
        if self.best is None or cost < self.cost(self.best):
            self.best = model
        return model

    def _unknowns_of(self, p: ComplexArray) -> int:
        """Unknowns of a model with these poles, and of the noise that the rows are made white by."""
        return self.search.unknowns_of(p) + sum(
            len(coefficients) - 1 for coefficients in getattr(self.search, "innovations", ())
        )

    def report(self, n: int) -> Progress | None:
        """What reports the iterations for n modes: their mean squared residual in a common unit of noise."""
        progress = self.reports(n)
        if progress is None:
            return None
        unit = float(np.exp(-2 * np.sum(self.counts * np.log(self.sizes)) / self.counts.sum()))
        return lambda iteration, loss: progress(iteration, unit * loss)

    def residues(self, projection: FreeProjection, channels: Experiments) -> ComplexArray:
        """Residues in the units of the data, shape (n, p, m); without inputs motions in the experiments."""
        n, p, m = len(projection.p), len(channels[0].output_labels), len(channels[0].input_labels)
        if m:
            return np.asarray(projection.residues / self.sizes[:, None]).reshape(n, p, m)
        motions = np.zeros((n, p, len(channels)), complex)
        measured, done = np.cumsum([int(channel.observed.any(axis=-1).sum()) for channel in channels]), 0
        for rows, own in zip(projection.experiments, projection.own, strict=True):
            place = int(np.searchsorted(measured, done, side="right"))
            motions[:, rows.outputs, place] = (own[:n] + 1j * own[n : 2 * n]) / self.sizes[rows.outputs]
            done += len(rows.outputs)
        return motions

    def reweighted(self, model: FreeModel) -> FreeModel:
        """The same model with the weights of what it leaves."""
        ratio = np.sqrt(self.counts / np.maximum(model.losses, self.floors)) / self.sizes
        if len(ratio) == 1 or np.ptp(np.log(ratio)) < 1e-3:
            return model
        self.weigh(model.losses)
        return self.model(model.p)

    def candidates(self, model: FreeModel, every: bool = False) -> tuple[ComplexArray, Array]:
        """Poles that stand out of what is left, the strongest first, or `every`: gains of what does not are 0."""
        if self._shown is not None and self._shown[0] is model and not every:
            return self._shown[1]
        if self.crowded:  # none stands out by itself
            return np.zeros(0, complex), np.zeros(0)
        if isinstance(self.search, Responses) and self.search.classical:
            # beside modes that are missing nothing stands out of few points: all are doubted at the end
            return self.scaled.candidates(model)
        now, then = self.search.unknowns_of(model.p), self.search.unknowns_of(np.append(model.p, 1j))
        loss, samples = float(np.sum(model.losses * self.sizes**2)), int(self.counts.sum())
        least = 0.0 if every else least_gain(loss, samples, now, then - now)
        p, gains = self.scaled.candidates(model, least)
        shown = [stands_out(gain, loss, samples, now, then - now) for gain in gains.tolist()]
        gains = gains * np.array(shown, bool)
        if not every:
            self._shown = model, (p, gains)
        return p, gains

    def through_orders(self, start: ComplexArray, most: int) -> None:
        """Let modes join one by one from a start up to a number of them; the table has the best of each order.

        The path ends where the data are reproduced to rounding.
        """
        model: FreeModel | None = self.reweighted(self.model(start))
        while model is not None and _modes(model.p) < most and np.any(model.losses > self.floors):
            model = self.with_modes(model, _modes(model.p) + 1, False)

    def chosen(self, start: ComplexArray, most: int, automatic: bool) -> FreeModel:
        """The model of an order, or of that which the criterion prefers, with noise as coloured as it prefers."""
        if getattr(self.search, "innovations", ()):
            return self._joint(start, most, automatic)
        model = self._in_rows(start, most, automatic)
        # coloured noise would take over what a plant lacks that has too few poles, when their number is given; beside
        # modes with a peak it would take over the weak ones, though broad noise is no mode with a peak in any case
        peaks = bool(np.any((model.p.imag > 0) & ~_broad(model.p)))
        if peaks or not (automatic and self.real_poles in ("auto", 0) and self._coloured(model)):
            return model
        # noise of a model that is too small has what this lacks: in its rows others are looked for, and from nothing
        models = [self.in_its_noise(model)]
        if self.real_poles == "auto":
            models.append(self._in_rows(models[0].p, most, automatic))
        return min([*models, self._joint(start, most, automatic)], key=self.cost)

    def _coloured(self, model: FreeModel) -> bool:
        """Whether the criterion prefers coloured noise, of records in which something acts all along."""
        driven = isinstance(self.plain, Records) and all(
            record.inputs and not is_short(record) for record in self.plain.data
        )
        return driven and bool(self._past_of_noise(model)) and not np.any(model.losses <= self.floors)

    def _joint(self, start: ComplexArray, most: int, automatic: bool) -> FreeModel:
        """A model that has grown from a start with the noise that belongs to each step."""
        self.whiten((), self.power)
        model = self.grown(start, most, automatic, self.in_its_noise)
        self.whiten(model.innovations, model.losses)
        return self.in_its_noise(self.improved(model, most, automatic))

    def _in_rows(self, start: ComplexArray, most: int, automatic: bool) -> FreeModel:
        """The model of an order, or of that which the criterion prefers, in the noise of the present rows."""
        model = self.improved(self.grown(start, most, automatic), most, automatic)
        if not automatic and len(model.p) and not (self.is_exact(model) or self.is_white(model)):
            model = self.of_common_denominator(model, most, automatic) or model
        other = self.likelier(model, most) if automatic else None
        if other is not None:
            other = self.improved(self.grown(other.p, most, automatic), most, automatic)
            model = min(model, other, key=self.cost)
        return model

    def likelier(self, model: FreeModel, most: int) -> FreeModel | None:
        """A much likelier model of the plant that the search has come by, of so many modes at `most`, if there is one.

        Where what is left is no noise, as of plants that are not quite linear, the way of a search depends on rounding.
        """
        limit = self.cost(model) - TUNING.likelier * float(self.counts.sum())
        for cost, p in sorted(self.seen, key=lambda pair: pair[0]):
            if cost > limit:
                break
            if _modes(p) <= most and np.all(np.abs(p.real) <= TUNING.broadest * np.abs(p)):
                other = self.model(p)
                if self.is_sound(other) and self.vagueness(other).max(initial=0.0) <= 1:
                    return self.reweighted(other)
        return None

    def improved(self, model: FreeModel, most: int, automatic: bool) -> FreeModel:
        """A model with weak modes relocated and, of an order that is chosen, needless ones dropped."""
        best = self.relocated(model, automatic, most)
        return self.without_slow_noise(self.patched(self.pruned(best), most)) if automatic else best

    def without_slow_noise(self, model: FreeModel) -> FreeModel:
        """A model without its slow poles, where the criterion prefers noise of slow colour to these.

        In white noise such poles explain so much that none of them is ever the weakest, and the others are poor without
        them: these are compared in their own noise.
        """
        if self.search is not self.plain:
            return model
        slow = (np.abs(model.p) < TUNING.broad_noise * self.search.region.bin) & ~self._kept(model.p)
        if not slow.any() or self.is_exact(model) or not self._past_of_noise(model):
            return model
        fewer = self.reweighted(self.model(model.p[~slow]))
        costs = [self.cost(self.in_its_noise(candidate)) for candidate in (fewer, model)]
        chosen = fewer if costs[0] < costs[1] else model
        self.whiten((), chosen.losses)
        return chosen

    def grown(
        self, start: ComplexArray, most: int, automatic: bool,
        after: Callable[[FreeModel], FreeModel] = lambda model: model,
    ) -> FreeModel:  # fmt: skip
        """A model that modes join as long as the criterion prefers it; none is doubted, `after` changes each model."""
        model = after(self.reweighted(self.model(start)))
        best, missed = model, 0
        while missed < TUNING.patience and not self.is_exact(model):
            more = self.joined(model, most, automatic)
            if more is None:
                break
            model = after(more)
            if not automatic or self.cost(model) < self.cost(best):
                best, missed = model, 0
            else:
                missed += 1
        return best

    def joined(self, model: FreeModel, most: int, automatic: bool) -> FreeModel | None:
        """One more mode, or several, or one more real pole: what the criterion prefers."""
        more = self.with_modes(model, most, automatic) if _modes(model.p) < most else None
        lag = self.with_lag(model, most)
        if lag is not None and more is not None:
            return lag if self.cost(lag) <= self.cost(more) else more
        if more is None and automatic and self.candidates(model)[1].any():
            # what stands out only mends the shape of others: so it is where modes overlap
            more = self.of_common_denominator(lag or model, most, automatic)
        return more or lag

    @property
    def crowded(self) -> bool:
        """Whether poles are those of a common denominator, of modes that overlap."""
        return isinstance(self.search, Responses) and self.search.crowded

    def of_common_denominator(self, model: FreeModel, most: int, automatic: bool) -> FreeModel | None:
        """Modes that overlap found all at once, as many as the criterion wants, if they explain much more than a model.

        From there on modes may mend the shape of others, if they have to.
        """
        if self.separate or self.real_poles not in ("auto", 0) or not (
            isinstance(self.search, Responses) and self.search.share_poles
        ):  # fmt: skip
            return None
        plain, self.separate = self.search, True
        self.search = together = replace(self.search, crowded=True)
        self.weigh(model.losses)
        together = together.scaled(self.sizes)
        best, missed, count = model, 0, _modes(model.p) if automatic else most - 1
        while missed < TUNING.patience and (count < most or not automatic):
            count = min(most, count * 5 // 4 + 1) if automatic else count + 1
            p = together.of_common_denominator(count)
            if self.search.unknowns_of(p) >= self.counts.sum():
                break
            missed += 1
            if automatic or _modes(p) == most:
                more = self.judged(FreeProjection(self.scaled.data, p))
                best, missed = (more, 0) if self.cost(more) < self.cost(best) else (best, missed)
        if best is not model:
            best = self.reweighted(self.model(best.p))
            best = self.pruned(best) if automatic else best
        crowded, self.search = self.search, plain
        for term in FURTHER_TERMS:  # what may be no background, but one of further terms
            self.search = self.search.with_term(term)
        self.weigh(best.losses)
        apart = self.reweighted(self.cleaned(self.model(best.p))) if automatic else model
        if self.cost(best) < min(self.cost(apart), self.cost(model)) - _NO_NOISE * self.counts.sum():
            self.search = crowded
            self.weigh(best.losses)
            return best
        self.search = plain
        self.weigh(model.losses)
        return None

    def with_lag(self, model: FreeModel, most: int) -> FreeModel | None:
        """One more real pole, if the criterion prefers it; two may become a mode where there are not `most` yet."""
        given = self.real_poles != "auto"
        if given and _real(model.p) >= int(self.real_poles):
            return None
        if not given and not self.search.shows_background(len(model.p) + 1):
            return None
        pole, gain = self.scaled.lag(model.projection, yielding=not self.is_white(model))
        p = np.append(model.p, pole)
        if self.search.unknowns_of(p) >= self.counts.sum() or self.is_exact(model) or self.crowded:
            return None
        if not given and gain < TUNING.nearly_as_strong * self.candidates(model)[1].max(initial=0.0):
            return None
        joint, unknowns = self.search is not self.plain, self.search.unknowns_of(p) - self.search.unknowns_of(model.p)
        if not (given or joint or self._stands_out(model, gain, unknowns)):
            return None
        more = self.reweighted(self.model(p))
        if _modes(more.p) > most:
            return None
        return more if (_real(more.p) > _real(model.p) if given else self._prefers_lag(more, model)) else None

    def _prefers_lag(self, more: FreeModel, model: FreeModel) -> bool:
        """Whether the criterion prefers one more lag, unless it is at the border and stands for what is fed through."""
        if np.any(more.p[more.p.imag == 0].real < -_FASTEST * self.search.region.ceiling):
            return False
        if self.search is not self.plain:
            return True
        before, after = (float(np.sum(candidate.losses * self.sizes**2)) for candidate in (model, more))
        unknowns = self.search.unknowns_of(more.p) - self.search.unknowns_of(model.p)
        return self._stands_out(model, before - after, unknowns) and self.gain(more, model) > 2 * TUNING.sure

    def with_modes(self, model: FreeModel, most: int, automatic: bool) -> FreeModel | None:
        """One more mode, or several, that do not only mend the shape of others; if need be, and order, what does."""
        p, gains = self.candidates(model)
        if not (automatic or gains.any()):
            p, gains = self.candidates(model, every=True)
        if not len(p) or (automatic and not gains.any()):
            return None
        band = self.search.region.bin
        whole = _together(model.projection, p, gains, band, most - _modes(model.p))
        modal = (gains > 0) & (np.nan_to_num(np.abs(p.real)) <= TUNING.broadest * np.abs(p.imag))
        alone = automatic and len(self.counts) * max(1, model.projection.inputs) == 1
        if alone:
            needed = self.search.crowding + np.abs(model.projection.sigma)
            modal &= np.all(np.abs(p.imag[:, None] - model.p.imag) > needed, axis=1)
        sure = p[modal]
        # beside modes of one channel that are still wrong, others that stand out may be no more than their shadows
        trials = [whole[np.isin(whole, sure if p[0] in sure or not alone else [])] if automatic else whole]
        trials += [sure[k : k + 1] for k in range(min(TUNING.tried, len(sure)))]
        first: FreeModel | None = None
        for joining in trials:
            if len(joining):
                trial = self.model(np.append(model.p, joining))
                lags = int(np.sum(_broad(model.p)))
                sound = self.cleaned(trial, lags) if automatic else trial
                if len(sound.p) > len(model.p) and self.is_sound(sound, lags):
                    return self.reweighted(sound)
                first = first or trial
        return None if automatic or first is None else self.reweighted(first)

    def patched(self, model: FreeModel, most: int) -> FreeModel:
        """Modes that are close to others, or broad, where they leave white residuals and others do not."""
        more = model
        for _ in range(TUNING.patches):
            p, gains = self.candidates(more)
            if not gains.any() or _modes(more.p) >= most or self.is_exact(more) or self.is_white(more):
                break
            more = self.reweighted(self.model(np.append(more.p, p[0])))
        if more is model or not self.is_white(more):
            return model
        more = self.pruned(self.relocated(more, False, most))
        better = self.is_white(more) and self.cost(more) < self.cost(model)
        return more if better and not self.grows(more) else model

    def is_exact(self, model: FreeModel) -> bool:
        """Whether what is left of all outputs is rounding."""
        return bool(np.all(model.losses <= self.floors))

    def is_sound(self, model: FreeModel, lags: int = 0) -> bool:
        """Whether each mode is one of the plant: none mends the shape of another, is too broad, or grows unseen.

        So many as `lags` that have become pairs of complex poles may be broad.  Nothing is doubted of a model that
        reproduces the data to rounding.
        """
        if not len(model.p) or self.is_exact(model):
            return True
        broad = int(np.sum(_broad(model.p))) > lags
        return not patching(model.projection, self.search.crowding) and not broad and not self.grows(model)

    def cleaned(self, model: FreeModel, lags: int = 0) -> FreeModel:
        """A model without its modes that are none of the plant."""
        while len(model.p) and not self.is_sound(model, lags):
            projection = model.projection
            # what several channels see of a pair changes as others go
            alone = len(self.counts) * max(1, projection.inputs) == 1
            worst = patching(projection, self.search.crowding)[: None if alone else 1]
            if not worst:
                broad = np.where(
                    _broad(projection.p), np.abs(projection.sigma) / np.where(projection.d > 0, projection.d, 1.0), 0.0
                )
                worst = [int(np.argmax(broad) if broad.any() else np.argmin(projection.sigma))]
            model = self.model(np.delete(projection.p, worst))
        return model

    def growing(self, projection: FreeProjection, evidence: Callable[[], Array]) -> Mask:
        """Modes that grow and are broad, or no large part of any motion: they patch records that are not stationary."""
        growing = (projection.p.imag > 0) & (projection.sigma < -_GROWING * self.decay_errors(projection))
        if growing.any():
            large = _LARGE * float(np.sum(self.power * self.sizes**2))
            growing &= (projection.sigma < -TUNING.broadest * projection.d) | (evidence() < large)
        return growing

    def grows(self, model: FreeModel) -> bool:
        """Whether a model has modes as in `growing`."""
        return bool(self.growing(model.projection, lambda: self.evidence(model)).any())

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

    def relocated(self, model: FreeModel, sound: bool, most: int) -> FreeModel:
        """The weakest modes exchanged for what stands out of the rest, as long as that is likelier."""
        for _ in range(_SWAPS):
            p, gains = self.candidates(model)
            if not gains.any():
                break
            more = self.model(np.append(model.p, p[0]))
            weakest = int(np.argmin(self.evidence(more)))
            other = self.model(np.delete(more.p, weakest))
            gain = self.loglik(other.losses) - self.loglik(model.losses)
            # a mode may come in the place of a real pole
            if gain <= TUNING.sure or _modes(other.p) > max(most, _modes(model.p)):
                break
            if sound and not self.is_sound(other, int(np.sum(_broad(model.p)))):
                break
            model = self.reweighted(other)
        return model

    def evidence(self, model: FreeModel) -> Array:
        """How much the loss would grow without each mode."""
        return FreeProjection(self.scaled.rows(model.p), model.p).evidence

    def decay_errors(self, projection: FreeProjection) -> Array:
        """Standard errors of the decay rates."""
        n = len(projection.p)
        inner = projection.covariance(projection.loss / max(1, projection.rows - self.search.unknowns_of(projection.p)))
        return np.sqrt(np.maximum(np.diag(inner)[n : 2 * n], 0.0))  # rounding may make them negative

    def vagueness(self, model: FreeModel) -> Array:
        """Errors of the widths of peaks, in units of what a resonance may have: beyond, it patches a background."""
        allowed = TUNING.vague * np.maximum(np.abs(model.projection.sigma), self.search.region.bin)
        lag = (model.p.imag == 0) | (_broad(model.p) & self.search.kinds_may_change) | self.crowded
        return np.where(lag, 0.0, self.decay_errors(model.projection) / allowed)

    def pruned(self, model: FreeModel) -> FreeModel:
        """Modes dropped as long as the criterion gets better, or their widths are not known."""
        while len(model.p):
            vague = self.vagueness(model)
            evidence = np.where(self._kept(model.p), np.inf, self.evidence(model))
            weakest = int(np.argmax(vague)) if vague.max() > 1 else int(np.argmin(evidence))
            if vague.max() <= 1 and not np.isfinite(evidence[weakest]):
                break
            fewer = self.model(np.delete(model.p, weakest))
            if vague.max() <= 1 and self.cost(fewer) >= self.cost(model):
                break
            model = self.reweighted(fewer)
        return model

    def significant(self, model: FreeModel) -> FreeModel:
        """A model without modes that noise alone might show somewhere, the weakest dropped first."""
        each = self.search.unknowns(1) - self.search.unknowns(0)
        while len(model.p):
            evidence, loss = self.evidence(model), float(np.sum(model.losses * self.sizes**2))
            weakest, spare = int(np.argmin(evidence)), self.counts.sum() - self.search.unknowns_of(model.p)
            ratio = evidence[weakest] / loss * spare / each if loss > 0 else np.inf
            if spare > 0 and f_law.sf(ratio, each, spare) * self.counts.sum() < TUNING.by_chance:
                break
            model = self.model(np.delete(model.p, weakest))
        return model

    def _kept(self, p: ComplexArray) -> Mask:
        """Which poles stay in any case: the real ones of a number that was given."""
        given = self.real_poles != "auto"
        return (p.imag == 0) & (given and _real(p) <= int(self.real_poles))

    # --- the end

    def fit(
        self, start: ComplexArray, most: int, automatic: bool, channels: Sequence[Any], *, either_hold: bool
    ) -> FreeFit:
        """The last minimum of a search, and what makes that under the other hold.

        Residues and a feedthrough of one hold say what others say of the other.  So free models tell the two apart only
        where something is fed through: then the likelier comes first.  Of a search that is interrupted the best so far,
        if it has a mode.
        """
        fit: FreeFit | None = None
        try:
            if self.best is None:
                self.best = self.chosen(start, most, automatic)
                beside = self.beside_further_terms(most, automatic)
                if beside is not None:
                    return beside.fit(start, most, automatic, channels, either_hold=either_hold)
            fit = self.finished(self.best, channels, automatic)
            if not (either_hold and isinstance(self.plain, Records) and fit.states and fit.projection.inputs):
                return fit
            held_otherwise = cache(partial(self._held_otherwise, fit, self.best, self.plain, channels, automatic))
            fit = replace(fit, held_otherwise=held_otherwise)
            if fit.projection.fed is not None and not fit.projection.fed.any():
                return fit
            rival = held_otherwise()
        except KeyboardInterrupt:
            if fit is not None:
                return replace(fit, interrupted=True, held_otherwise=None)
            if self.best is None or not len(self.best.p):
                raise
            return self.finished(self.best, channels, interrupted=True)
        if fit.criteria.bic - rival.criteria.bic > 2 * TUNING.sure:
            return replace(rival, held_otherwise=cache(lambda: fit))
        return fit

    def _held_otherwise(
        self, fit: FreeFit, model: FreeModel, plain: Records, channels: Sequence[Any], automatic: bool
    ) -> FreeFit:
        """A fit refined with the inputs held otherwise."""
        kept = replace(model, projection=fit.projection)
        other = plain.held("foh" if fit.intersample == "zoh" else "zoh")
        path = FreePath(
            other, self.felt, self.criterion, self.reports, kept, self.real_poles, fit.noise, largest=self.largest
        )
        return replace(path.finished(kept, channels, automatic), order_table=fit.order_table)

    def finished(
        self, model: FreeModel, channels: Sequence[Any], automatic: bool = False, interrupted: bool = False
    ) -> FreeFit:
        """The last minimum; what is fed through only where it stands out, or has to be.

        Of an `automatic` order without modes that only the bins about them asked for.  Who interrupts wants an end:
        then the poles stay as they are.
        """
        self.whiten(model.innovations, model.losses)
        # the exact minimum is that of what remains; real and broad poles that are one too many are told at the minimum
        enough = _EXACT if automatic and np.any((model.p.imag == 0) | _broad(model.p)) else _DECIDED / self.counts.sum()
        near = None if interrupted else float(enough)
        projection, losses = self.settled(model.p, None, near)
        while automatic and (needless := self.needless(projection)) is not None:
            projection, losses = self.settled(np.delete(projection.p, needless), None, near)
        fed: Mask | None = None
        if projection.has_feedthrough and not self.felt.all():
            fed = self.felt | self.stands_out(projection)
            if not fed.all():
                projection, losses = self.settled(projection.p, fed, near, projection)
        # noise of slow colour hides a constant that is still the level of the output
        if self.constant_open and not (interrupted or model.innovations):
            projection, losses = self.without_needless_constants(projection, losses, fed, near)
        projection, losses = self.on_simplest_background(projection, losses, fed, near)
        if not interrupted:
            projection, losses = self.settled(projection.p, fed, _EXACT, projection)
        projection = projection.ascending()
        unknowns = self._unknowns_of(projection.p) - (0 if fed is None else int(np.sum(~fed)))
        table = tuple(self.table[n] for n in sorted(self.table))
        criteria = self.criteria(self.loglik(losses), unknowns)
        rounding = bool(np.any(losses <= self.floors))
        measured = FreeProjection(self.plain.scaled(self.sizes).data, projection.p, fed) if model.innovations else None
        return FreeFit(
            projection, tuple(channels), 1.0 / self.sizes, table, self.region(projection.p), unknowns, criteria,
            rounding, interrupted, measured=measured, noise=model.innovations, delay=self.delay,
            input_delay=self.input_delay, crowded=self.crowded,
        )  # fmt: skip

    def without_needless_constants(
        self, projection: FreeProjection, losses: Array, fed: Mask | None, rtol: float | None
    ) -> tuple[FreeProjection, Array]:
        """The minimum without constants of the outputs, unless these stand out; with what it leaves of the outputs.

        Beside an integrator, or what is nearly one, a constant is the same as its initial state, and its own error says
        nothing: what it explains is seen without it.
        """
        constants = sum(len(rows.outputs) for rows in self.search.data)
        least = max(2 * TUNING.likely, constants * np.log(projection.rows))
        weak = _evidence_of_constants(projection) < least
        if not weak and not np.any(np.abs(projection.p) < self.scaled.region.bin):
            return projection, losses
        kept = self.plain, self.search
        self.drop_constants(losses)
        level, level_losses = self.settled(projection.p, fed, rtol)
        if weak or 2 * (self.loglik(losses) - self.loglik(level_losses)) < least:
            return level, level_losses
        self.plain, self.search = kept
        self.weigh(losses)
        return projection, losses

    def beside_further_terms(self, most: int, automatic: bool) -> FreePath | None:
        """The search among responses on a background of further terms, where these explain more than real poles do."""
        if self.best is None or not isinstance(self.search, Responses) or not self.search.shows_background(0):
            return None
        if self.search.crowded:
            return None
        # of what is no background itself
        modes = self.best.p[(self.best.p.imag > 0) & ~_broad(self.best.p)]
        if len(modes) == len(self.best.p) and self.is_white(self.best):
            return None
        search = self.search
        for term in FURTHER_TERMS:
            search = search.with_term(term)
        path = FreePath(search, self.felt, self.criterion, self.reports, None, self.real_poles, largest=self.largest)
        path.weigh(self.best.losses)
        model = path.model(modes, TUNING.rough)
        projection, _ = path.on_simplest_background(model.projection, model.losses, None, None)
        limit = self.cost(self.best) - 2 * TUNING.sure
        remaining_terms = path.search.terms if isinstance(path.search, Responses) else []
        if not set(remaining_terms) - set(self.search.terms) or path.cost(path.judged(projection)) > limit:
            return None
        path.best = path.chosen(projection.p, most, automatic)
        return path if path.cost(path.best) <= limit else None

    def on_simplest_background(
        self, projection: FreeProjection, losses: Array, fed: Mask | None, rtol: float | None
    ) -> tuple[FreeProjection, Array]:
        """The minimum without the terms of the background that the criterion does not ask for."""
        while isinstance(self.search, Responses) and self.search.terms:
            variance = projection.rows / max(1, projection.rows - self.search.unknowns_of(projection.p))
            gains = term_gains(projection, variance)
            # what a parameter costs by the criterion, in squares of standard errors
            less, more = (self.criteria(0.0, k).by_name(self.criterion) for k in (0, 1))
            each = more - less
            excess = {term: gain - count * each for term, (gain, count) in gains.items()}
            weakest = min(excess, key=lambda term: excess[term])
            if excess[weakest] >= 0:
                break
            self.search = self.search.without_term(weakest)
            self.weigh(losses)
            projection, losses = self.settled(projection.p, fed, rtol)
        return projection, losses

    def settled(
        self, p: ComplexArray, fed: Mask | None, rtol: float | None, known: FreeProjection | None = None
    ) -> tuple[FreeProjection, Array]:
        """The minimum over all data, with the variances that belong to it; and the losses of outputs.

        To a decrease of the loss by `rtol` of itself; with None at the poles as they are.
        """
        before, alone = -np.inf, rtol is None or len(self.counts) == 1
        if rtol is None:
            projection = FreeProjection(self.scaled.data, p, fed)
        else:
            projection = self.refined(p, rtol if alone else TUNING.rough, fed, known)
        for _ in range(_ROUNDS):
            losses, sizes = self.in_data(projection.losses), self.sizes
            now = self.loglik(losses)
            self.weigh(losses)
            projection = projection.rescaled(self.scaled.data, self.sizes / sizes, fed)
            if rtol is not None and not alone:
                projection = self.refined(projection.p, rtol, fed, projection)
            if alone or now - before <= _SETTLED * max(1.0, abs(now)) / len(losses):
                break
            before = now
        return projection, losses

    def needless(self, projection: FreeProjection) -> int | None:
        """A mode that is none of the plant, or without which the criterion is better, of a minimum over all data."""
        n = len(projection.p)
        if not n:
            return None
        if self.growing(projection, lambda: projection.evidence).any():
            return int(np.argmin(projection.sigma))
        weakest = int(np.argmin(np.where(self._kept(projection.p), np.inf, projection.evidence)))
        if self._kept(projection.p)[weakest]:
            return None
        lost = 0.5 * projection.rows * float(np.log1p(projection.evidence[weakest] / projection.loss))
        with_it, without = (
            self.criteria(loglik, self.search.unknowns_of(p)).by_name(self.criterion)
            for loglik, p in ((0.0, projection.p), (-lost, np.delete(projection.p, weakest)))
        )
        return weakest if without <= with_it else None

    def refined(
        self, p: ComplexArray, rtol: float, fed: Mask | None, known: FreeProjection | None = None
    ) -> FreeProjection:
        """Modes refined over all data, of which something may be `known` at some poles."""
        data, region, report = self.scaled.data, self.region(p), self.report(max(1, _modes(p)))
        last = rtol <= _EXACT
        return refine_free(lambda _: data, p, region, rtol, fed, last=last, progress=report, known=known)

    def stands_out(self, projection: FreeProjection) -> Mask:
        """Which of all that may be fed through is more than its error shows."""
        n, width = len(projection.p), 2 * len(projection.p) + 1
        variance = projection.rows / max(1, projection.rows - self.search.unknowns_of(projection.p))
        variances = np.diag(projection.covariance(variance))[2 * n :]
        errors = np.sqrt(np.maximum(variances, 0.0))
        errors = errors.reshape(len(projection.feedthrough), projection.inputs, width)[:, :, -1]
        return np.asarray(np.abs(projection.feedthrough) > TUNING.fed_through * errors)


def term_gains(projection: FreeProjection, variance: float) -> dict[Term, tuple[float, int]]:
    """Squares of the terms of backgrounds of responses over their variances, and how many numbers each is, in all."""
    gains: dict[Term, tuple[float, int]] = {}
    covariance = projection.covariance(variance)
    for k, rows in enumerate(projection.experiments):
        if isinstance(rows, FreeResponse) and rows.terms:
            spread = np.array([np.diag(inner) for inner, _ in projection.own_covariances(k, covariance, variance)]).T
            squares = projection.own[k] ** 2 / np.where(spread > 0, spread, np.inf)
            for term, each in zip(rows.terms, squares, strict=True):
                gain, count = gains.get(term, (0.0, 0))
                gains[term] = gain + float(each.sum()), count + len(each)
    return gains


def _same_filters(first: tuple[Array, ...], second: tuple[Array, ...]) -> bool:
    """Whether filters of all outputs are the same."""
    return len(first) == len(second) and all(np.array_equal(*pair) for pair in zip(first, second, strict=True))


def is_short(rows: FreeRecord) -> bool:
    """Whether inputs act in a small part of a record, as hits do: their noise has no spectrum that lasts."""
    power = np.sum(rows.u**2, axis=0)
    return bool(np.sum(power) ** 2 < _LASTING * len(power) * np.sum(power**2))


def _modes(p: ComplexArray) -> int:
    """Number of pairs of complex poles."""
    return int(np.sum(p.imag > 0))


def _real(p: ComplexArray) -> int:
    """Number of real poles."""
    return int(np.sum(p.imag == 0))


def _broad(p: ComplexArray) -> Mask:
    """Which poles are those of modes without a peak."""
    return (p.imag > 0) & (np.abs(p.real) > TUNING.broadest * np.abs(p))


def patching(projection: FreeProjection, distance: float) -> list[int]:
    """The weaker mode of each pair that is too close, the closest first, no mode in two of them.

    Two modes that all channels see in different proportions may be as close as they like.
    """
    d, half_width = projection.d, np.abs(projection.sigma)
    apart = np.abs(d[:, None] - d) / (distance + half_width[:, None] + half_width)
    apart[~_alike(projection)] = np.inf
    lag = (projection.p.imag == 0) | _broad(projection.p)
    apart[lag] = apart[:, lag] = np.inf
    np.fill_diagonal(apart, np.inf)
    weaker, taken = list[int](), set[int]()
    for place in np.argsort(apart, axis=None, kind="stable")[: np.count_nonzero(apart < 1)].tolist():
        pair = divmod(place, len(d))
        if not taken & set(pair):
            taken |= set(pair)
            # of a pair that mends one peak the broader is the patch
            weaker.append(max(reversed(pair), key=lambda k: half_width[k]))
    return weaker


def _alike(projection: FreeProjection) -> Mask:
    """Which pairs of modes have the same shape in all channels, by the modal assurance criterion."""
    n = len(projection.p)
    shapes = projection.residues.reshape(n, -1)
    if not projection.inputs:
        shapes = np.concatenate([own[:n] + 1j * own[n : 2 * n] for own in projection.own], axis=1)
    if shapes.shape[1] == 1:
        return np.ones((n, n), bool)
    power = np.sum(np.abs(shapes) ** 2, axis=1)
    products = np.outer(power, power)
    return np.abs(shapes.conj() @ shapes.T) ** 2 >= TUNING.same_shape * np.where(products > 0, products, 1.0)


def _together(projection: FreeProjection, p: ComplexArray, gains: Array, width: float, most: int) -> ComplexArray:
    """Candidates that may join at once: the strongest, and those nearly as strong far from it and from one another."""
    chosen = [complex(p[0])]
    for pole, gain in zip(p[1:].tolist(), gains[1:].tolist(), strict=True):
        if len(chosen) == most or gain < TUNING.nearly_as_strong * gains[0] or not gain:
            break
        others = np.append(projection.p, chosen)
        apart = TUNING.together_apart * width + np.nan_to_num(np.abs(others.real)) + abs(pole.real)
        if np.all(np.abs(others.imag - pole.imag) > apart):
            chosen.append(pole)
    return np.array(chosen)
