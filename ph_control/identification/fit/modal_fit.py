"""A fit from top to bottom: the search for poles, the structure that stands, and the judgement of both.

The result holds the numbers of the structure, and the judgement of these.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np

from ... import _checks
from ..._heartbeat import reporter
from ..._types import ComplexArray
from ...exceptions import StructureError
from ...modal.modal_form import imaginary
from ..data.channels import Channels, Recording
from ..diagnosis.alternatives import Searched, beside_disturbances, within_rounding
from ..diagnosis.coloured_noise import beside_coloured_noise, fitted_noise
from ..diagnosis.verdict import WHITE
from ..estimates.estimates import Estimates
from ..innovations.forces import KINDS, MOST_MISSING, beside_forces
from ..moves.assumptions import alone
from ..moves.drifts import with_constants
from ..moves.free_fit import free_fit, free_refinement, late_fit
from ..parameters.fitted_parameters import FittedParameters
from ..regression.free import FreeProjection, Lateness, refine_free
from ..regression.time_rows import FreeRecord
from ..regression.tuning import TUNING
from ..search.channel_rows import is_short
from ..search.findings import Cause, Finding
from ..search.fitted_modes import FreeFit, Orders
from ..structure.choice import Choice, Request
from ..structure.hypothesis_tests import is_refused
from ..structure.late_outputs import WithDelay, under_hold_and_delays
from ..structure.late_responses import with_shown_delay
from ..uncertainty.noise_model import NoiseModel
from ..uncertainty.residual_tests import is_white
from .judgement import Evidence, message_of
from .options import Options
from .outputs_alone import are_alone, of_outputs_alone
from .pem_result import PEMResult
from .result import OrderRow, cut_short

_NEARLY = 0.98  # of the fastest growth
_CLEAR = 0.2  # gain in the BIC for each sample: residuals that are smaller by a tenth


def fit_channels(
    channels: Channels, request: Request, options: Options, start: ComplexArray | None = None,
    findings: tuple[Finding, ...] = (), order: int | str | None = None,
) -> PEMResult:  # fmt: skip
    """Fit free residues first, then the structure that is given, or the simplest that is not rejected.

    Outputs alone are those of a motion that decays, or of forces that nobody measured, as is likelier.
    """
    order = options.order if order is None else order
    _refuse_gaps(channels, options.noise)

    def of_modes() -> PEMResult:
        return _of_modes_and_inputs(channels, request, options, start, findings, order)

    if request.function is not None or not are_alone(channels, request.structure, options):
        return of_modes()
    recordings = [data for data in channels if isinstance(data, Recording)]
    return of_outputs_alone(recordings, request, options, order, of_modes)


def _refuse_gaps(channels: Channels, noise: str) -> None:
    """Refuse many missing samples beside inputs in noise that is given and that outputs share: it has no likelihood."""
    if noise not in KINDS:
        return
    driven = [data for data in channels if isinstance(data, Recording) and data.u.any()]
    share = max((float(np.mean(~data.observed, axis=1).max()) for data in driven), default=0.0)
    if share > MOST_MISSING:
        raise StructureError(
            f"{100 * share:.0f} % of the samples of an output are missing, and noise={noise!r} allows for "
            f"{100 * MOST_MISSING:.0f} %: cut recordings where samples are missing, into a list, or leave noise out"
        )


def _of_modes_and_inputs(
    channels: Channels, request: Request, options: Options, start: ComplexArray | None,
    findings: tuple[Finding, ...], order: int | str,
) -> PEMResult:  # fmt: skip
    """Search for poles with free residues, beside all that disturbs them; then choose the structure, and judge it."""
    assumptions = _assumptions(request, options)

    def search_in(channels: Channels) -> Callable[..., FreeFit]:
        return partial(free_fit, channels, **assumptions)

    def searched(channels: Channels) -> Searched:
        simple = replace(options.plain(channels), max_order=1, real_poles=0)
        of_mode = _assumptions(request, simple)
        return _beside_motion(channels, order, start, options, assumptions, of_mode)

    def refined(channels: Channels, like: Searched, p: ComplexArray) -> Searched:
        free = free_refinement(channels, like.free, p, moving=like.moving, **assumptions)
        return Searched(channels, free, like.moving)

    automatic, certain = isinstance(order, str), options.noise in KINDS
    latest = searched(channels)
    if not options.is_plain:
        latest = within_rounding(latest, refined)
        latest = beside_disturbances(latest, searched, refined, automatic, certain)
    search, moving = search_in(latest.channels), latest.moving

    def with_delay(late: Lateness) -> FreeFit:
        # that outputs come late is no sign of forces where there was none of these before
        more: dict[str, Any] = {} if latest.free.beside is not None or options.noise in KINDS else {"beside": alone}
        if not latest.free.direct:
            more |= {"direct": False, "intersample": latest.free.intersample}
        return search(order, start=start, moving=moving, delay=late.outputs, input_delay=late.inputs, **more)

    free = latest.free
    if options.delay is None and request.function is None and request.structure != "passive":
        free = with_shown_delay(free, request.quantities, with_delay)
    free = replace(
        free, findings=(*latest.findings, *free.findings, *_about_order(free, order, options), *_about_growth(free))
    )
    result = _structured(free, request, findings, with_delay)
    while options.reachable and result.success and 0 < np.sum(result.kappa > 0) < result.order:
        free = free if free.rival is None or free.intersample == result.intersample else free.rival
        free = _of_modes(free, imaginary(result.d[result.kappa > 0]))
        result = _structured(free, request, findings)
    given = request.function is None and options.noise == "auto"
    if free.beside is not None and given and is_refused(request.structure, result.tests):
        # what such a model leaves is no noise, and its distance from the likeliest is no small one
        try:
            return _of_modes_and_inputs(channels, request, replace(options, noise="white"), start, findings, order)
        except KeyboardInterrupt:
            return cut_short(result)
    return result


# --- the search ------------------------------------------------------------------------------------------------------


def _assumptions(request: Request, options: Options) -> dict[str, Any]:
    """What a search is to assume."""
    return {
        "quantities": request.quantities, "intersample": options.intersample, "offset": options.offset,
        "max_order": options.max_order, "criterion": options.criterion, "weighted": options.weighted,
        "real_poles": options.real_poles, "method": options.method, "delay": options.delay,
        "input_delay": options.input_delay, "white": options.is_plain or options.noise in ("white", *KINDS),
        "beside": alone if options.is_plain else partial(_in_noise_of, options.noise, request.structure),
        "reports": reporter(options.largest, options.callback),
    }  # fmt: skip


def _in_noise_of(noise: str, structure: str, fit: FreeFit, orders: Orders, like: FreeFit | None = None) -> FreeFit:
    """A fit in the noise that is given, in that of a kind `like` another, or the likeliest.

    Where inputs of lags act in a part of a record, noise may rather change.  Through a plant that is given as lossless
    forces that nobody measured would make motion without end.
    """
    records = [rows for rows in fit.projection.experiments if isinstance(rows, FreeRecord)]
    if any(rows.level is not None for rows in records):
        return fit
    if like is not None and like.beside is not None:
        return beside_forces(fit, like.beside.kinds, certain=True, orders=orders, like=like)
    if noise == "auto":
        if not fit.order and any(is_short(rows) for rows in records):
            return fit
        return beside_forces(fit, KINDS[:1] if structure == "lossless" else KINDS, orders=orders)
    return beside_forces(fit, (noise,), certain=True, orders=orders) if noise in KINDS else fit


def _beside_motion(
    channels: Channels,
    order: int | str,
    start: ComplexArray | None,
    options: Options,
    assumptions: dict[str, Any],
    of_mode: dict[str, Any],
) -> Searched:
    """The fit, and whether modes are in motion where records begin: of those at rest only where that explains more.

    Before an input first changes, few samples show the motion there was, and what is unknown of it hides the residues.
    """
    resting = _at_rest(channels, options) if options.moving else None
    if resting is None:
        free = free_fit(channels, order, start=start, moving=options.moving, **assumptions)
        return Searched(channels, free, options.moving)
    moving = cache(partial(free_fit, channels, order, start=start, moving=True, **assumptions))
    sure = None if options.is_plain else _surely_in_motion(channels, order, resting, moving, assumptions, of_mode)
    if sure is not None:
        return sure
    still = Searched(resting, free_fit(resting, order, start=start, moving=False, **assumptions), False)
    p, pushed = still.free.projection.p, _is_pushed(resting)
    if still.free.interrupted or not (len(p) or pushed):
        return still
    # beside a constant what an input holds looks like a motion of the right size
    least = 2 * TUNING.likely * pushed
    if not len(p):
        free = moving()
        return Searched(channels, free, True) if free.gain_over(still.free) > least else still
    other = free_refinement(channels, still.free, p, moving=True, **assumptions)
    if other.interrupted:
        return still.cut
    # beside a drift an integrator does not rest; what leaves rounding alone needs no noise
    drifts = pushed and still.free.offset > 1 and p.real.max() >= 0
    if other.gain_over(still.free) <= least and not drifts and other.rounding <= still.free.rounding:
        return still
    free = moving()
    if not (free.interrupted or free.rounding) and other.gain_over(free) > 0:
        free = _as_searched(other, free, assumptions)
    return Searched(channels, free, True)


def _surely_in_motion(
    channels: Channels, order: int | str, resting: tuple[Recording, ...], moving: Callable[[], FreeFit],
    assumptions: dict[str, Any], of_mode: dict[str, Any],
) -> Searched | None:  # fmt: skip
    """The fit in motion where that of one mode is far likelier: a search for what stands for a motion takes long.

    Or where a late lag explains all beside inputs that lasted: no integrator is held by these.
    That at rest where it is likelier from the same poles, and no more is to be found: both leave white noise.  None
    where neither is so; what it cut if interrupted.
    """
    begun = late_fit(channels, order, moving=True, **assumptions) if _is_pushed(resting) else None
    if begun is None:
        rough = free_fit(resting, 1, moving=False, **of_mode)
        if rough.interrupted:
            return Searched(resting, rough, False)
        if not len(rough.projection.p):
            return None
        begun = free_refinement(channels, rough, rough.projection.p, moving=True, **of_mode)
        if not begun.interrupted and begun.gain_over(rough) <= max(2 * TUNING.likely, _CLEAR * rough.projection.rows):
            return None
    if begun.interrupted:
        return Searched(channels, begun, True)
    free = moving()
    p = free.projection.p
    if free.interrupted or not len(p):
        return Searched(channels, free, True)
    other = free_refinement(resting, free, p, moving=False, **assumptions)
    if other.interrupted:
        return Searched(channels, free, True).cut
    gain = free.gain_over(other)
    if gain <= 0 and free.leaves_white_noise and other.leaves_white_noise:
        return Searched(resting, _as_searched(other, free, assumptions), False)
    return Searched(channels, free, True) if gain > 2 * TUNING.likely else None


def _is_pushed(resting: Sequence[Recording]) -> bool:
    """Whether inputs held the plant before recordings that begin at rest."""
    return any(np.any(data.steady) for data in resting)


def _as_searched(refined: FreeFit, searched: FreeFit, assumptions: dict[str, Any]) -> FreeFit:
    """A fit that was refined, with the order table of a search, and the finding of constants that data chose."""
    stated = with_constants(refined) if assumptions["offset"] == "auto" else refined
    return replace(stated, order_table=searched.order_table)


def _at_rest(channels: Channels, options: Options) -> tuple[Recording, ...] | None:
    """Recordings that all begin at rest, with inputs from what these were before; None of others.

    What such inputs hold outputs at is a part of the constant.
    """
    resting = list[Recording]()
    for data in channels:
        inputs = data.inputs_at_rest if isinstance(data, Recording) else None
        if inputs is None or not isinstance(data, Recording):
            return None
        data = data.adjusted(steady=data.steady + data.unit * inputs)
        if options.offset is False and np.any(data.steady):
            return None
        resting.append(data)
    return tuple(resting)


def _about_order(free: FreeFit, order: int | str, options: Options) -> list[Finding]:
    """Say where a search ended at its largest order, or was given a larger one than the data show."""
    if isinstance(order, str):
        ended = free.order >= options.max_order and not (free.rounding or free.interrupted)
        return [Finding(Cause.LARGEST_ORDER, (float(free.order),), 0.0)] * ended
    pairs = free.order + int(np.sum(free.projection.p.imag == 0)) // 2
    fewer = pairs < order and (free.rounding or free.crowded)
    return [Finding(Cause.FEWER_MODES, (float(order), float(pairs)), 0.0)] * fewer


def _about_growth(free: FreeFit) -> list[Finding]:
    """Say where poles grow as much over a recording as they may."""
    growth = free.projection.p.real / free.region.bin
    # an integrator may come to where poles that should not grow may
    if free.per_entry or not np.any(growth > _NEARLY * TUNING.fastest_growth):
        return []
    factor = float(np.exp(2 * np.pi * TUNING.fastest_growth))
    return [Finding(Cause.FASTEST_GROWTH, (float(np.max(free.projection.p.real)), factor), 0.0)]


def _of_modes(free: FreeFit, p: ComplexArray) -> FreeFit:
    """The minimum next to some modes alone, in the rows of a fit of more."""
    experiments, fed = free.projection.experiments, free.projection.fed
    projection = refine_free(lambda _: experiments, p, free.region, fed=fed)
    measured = free.measured and FreeProjection(free.measured.experiments, projection.p, fed)
    loglik = free.criteria.loglik - 0.5 * projection.rows * float(np.log(projection.loss / free.projection.loss))
    return replace(
        free, projection=projection, measured=measured, unknowns=projection.unknowns, held_otherwise=None,
        criteria=replace(free.criteria, loglik=loglik),
    )  # fmt: skip


# --- the structure ---------------------------------------------------------------------------------------------------


def _structured(
    free: FreeFit, request: Request, findings: tuple[Finding, ...], with_delay: WithDelay | None = None
) -> PEMResult:
    """Select the structure under the hold that the data prefer; where noise is coloured, in rows of white noise.

    Free residues and a feedthrough are the same models under either hold; only structures tell the two apart.  So it is
    with delays of the outputs that are left to the data.
    """
    best, result = _chosen(free, request, findings, with_delay)
    if result.whiteness >= WHITE or not result.success or free.beside is not None or not request.coloured:
        return result
    late = best is not None and best.free.delay_open and bool(best.free.delay.any())
    free = best.free if best is not None and late else free
    try:
        if result.structure != "free" and not free.noise and is_white(free.projection):
            return result  # noise is what is beside the free model, whatever a structure leaves
        whitened = beside_coloured_noise(free)
        if whitened is free:
            return result
    except KeyboardInterrupt:
        return cut_short(result)
    whitened = replace(whitened, held_otherwise=free.held_otherwise).with_rival(beside_coloured_noise)
    return _chosen(whitened, request, findings)[1]


def _chosen(
    free: FreeFit, request: Request, findings: tuple[Finding, ...], with_delay: WithDelay | None = None
) -> tuple[Choice | None, PEMResult]:
    """Choose hold, delays and structure in the rows there are, and make the result; without a choice if interrupted.

    Where no structure stands under either hold, as neither is exact, the hold is the one under which shapes are more
    nearly real.
    """
    try:
        best = Choice.of(free, request)
    except KeyboardInterrupt:
        cut = Choice.of(replace(free, interrupted=True), request)
        return None, _judged(cut, request, (*findings, *free.findings))
    try:
        best = _of_more_modes(under_hold_and_delays(best, request, with_delay), request)
        return best, _judged(best, request, _beside(findings, best.free))
    except KeyboardInterrupt:
        return None, cut_short(_judged(best, request, _beside(findings, best.free)))


def _of_more_modes(best: Choice, request: Request) -> Choice:
    """The structure of more of the modes that the search looked at, as long as it stands and is likelier.

    Free residues are as many as there are entries, numbers of a shape as many as channels: of weak modes of many
    channels the criterion may grant the one and not the other.
    """
    while (wider := _of_a_mode_more(best, request)) is not None:
        if not wider.stands(request) or wider.cost() >= best.cost():
            break
        best = wider
    return best


def _of_a_mode_more(best: Choice, request: Request) -> Choice | None:
    """The structure of a mode more; None where free residues gain less of it than any shape is charged for."""
    free, table = best.free, {row.order: row for row in best.free.order_table}
    now, more = table.get(free.order), table.get(free.order + 1)
    channels = len(free.channels[0].output_labels), len(free.channels[0].input_labels)
    is_open = free.order < request.most and free.beside is None and np.prod(channels) > 1 and best.stands(request)
    if now is None or more is None or not is_open:
        return None
    if 2 * (more.loglik - now.loglik) < (2 + max(channels)) * np.log(free.projection.rows):
        return None
    real = free.projection.p.imag == 0
    return Choice.of(_of_modes(free, np.append(more.poles, free.projection.p[real])), request)


def _beside(findings: tuple[Finding, ...], free: FreeFit) -> tuple[Finding, ...]:
    """Findings of the data, those of the fit in place of others of the same cause."""
    anew = {finding.cause for finding in free.findings}
    return (*(finding for finding in findings if finding.cause not in anew), *free.findings)


def _judged(choice: Choice, request: Request, findings: tuple[Finding, ...]) -> PEMResult:
    """The result of a choice with a judgement; as of an interrupted fit if it is interrupted here."""
    try:
        return _result(Estimates(choice, request), findings)
    except KeyboardInterrupt:
        cut = replace(choice, free=replace(choice.free, interrupted=True))
        return _result(Estimates(cut, request), findings)


def _result(estimates: Estimates, findings: tuple[Finding, ...]) -> PEMResult:
    """Parameters, experiments and judgement of a fit."""
    free, fit, request, likelihood = estimates.free, estimates.fit, estimates.request, estimates.likelihood
    evidence = Evidence.of(estimates, findings)
    shapes, shape_stderr = estimates.shapes
    delay, delay_stderr = estimates.delays
    return PEMResult(
        structure=fit.structure,
        poles=estimates.poles,
        residues=estimates.residues,
        feedthrough=fit.feedthrough,
        covariance=estimates.covariance,
        shapes=shapes.shapes,
        participation=shapes.participation,
        shape_stderr=shape_stderr,
        shapes_scaled=bool(shapes.scaled.all() and len(shapes.scaled)),
        ports=request.ports,
        quantities=request.quantities,
        noise_variance=likelihood.noise_variance,
        experiments=estimates.shown,
        loss=likelihood.loss,
        loglik=likelihood.loglik,
        aic=likelihood.aic,
        bic=likelihood.bic,
        fit_percent=estimates.fit_percent,
        unknowns=likelihood.unknowns,
        whiteness=evidence.whiteness,
        order_table=_order_table(estimates),
        tests=estimates.tests,
        findings=evidence.findings,
        success=fit.converged and not free.interrupted,
        outcome=evidence.outcome,
        message=message_of(evidence),
        intersample="zoh" if free.per_entry else free.intersample,
        delay=delay,
        delay_stderr=delay_stderr,
        input_delay=free.input_delay,
        method=free.method,
        blind=bool(evidence.blind),
        noise=_noise(estimates),
        fitted_parameters=_parameters(estimates),
    )


def _parameters(estimates: Estimates) -> FittedParameters | None:
    """Parameters of a system function, with the variance of the rows."""
    physical = estimates.fit.physical
    return physical and replace(physical, covariance=_checks.readonly(estimates.fit.variance * physical.covariance))


def _order_table(estimates: Estimates) -> tuple[OrderRow, ...]:
    """Loss and criteria of each order that was tried."""
    samples = estimates.likelihood.samples
    return tuple(
        OrderRow(row.order, float(np.exp(-2 * row.loglik / samples - 1) / (2 * np.pi)), row.aic, row.bic,
                 _checks.readonly(np.abs(row.poles)))
        for row in estimates.free.order_table
    )  # fmt: skip


def _noise(estimates: Estimates) -> NoiseModel | None:
    """Noise of the outputs at the samples; None of frequency responses."""
    free, likelihood = estimates.free, estimates.likelihood
    if free.beside is not None:
        return free.beside.model(free.channels[0].dt)
    filters = () if estimates.rounding else free.filters or free.noise
    return fitted_noise(
        estimates.experiments, likelihood.noise_variance, filters, likelihood.spare / likelihood.samples
    )
