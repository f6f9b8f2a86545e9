"""From channels to a result: free residues, the structures that the data do not reject, parameters with errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ... import _checks
from ..._display import counted, p_value
from ..._types import Array, ArrayLike, ComplexArray, Indices, Mask, NDArray
from ..._units import common_unit
from ...exceptions import StructureError
from ...modal.discretization import Hold
from ...modal.modal_form import imaginary
from ..data.channels import Recording, ResponseMatrix, refuse_still, single
from ..data.frequency_record import FrequencyRecord
from ..data.parts import Difference, Signal
from ..data.quantities import checked_quantities
from ..data.time_record import Record
from ..diagnosis.changing_noise import changing_levels, findings_of
from ..diagnosis.coloured_noise import beside_coloured_noise, fitted_noise
from ..diagnosis.fitted_directions import FittedModel, directions_of
from ..diagnosis.hum import Tones, lines_in, tones_in, undriven
from ..diagnosis.nonlinearity import not_linear
from ..diagnosis.outliers import outliers, saturation
from ..diagnosis.unequal_noise import in_equal_noise
from ..diagnosis.verdict import CUT_SHORT, GOOD_FIT, WHITE, HypothesisTest, Outcome, slower_than_record
from ..excitation.excitation import examine
from ..innovations.forces import KINDS, beside_forces
from ..innovations.strong_forces import beside_strong_forces
from ..moves.free_fit import free_fit
from ..regression.free import FreeProjection, GivenResidues, Lateness, refine_free
from ..regression.free_prediction import FittedChannels, natural_jacobian
from ..regression.frequency_rows import FreeResponse
from ..regression.modal_regressors import output_weight
from ..regression.prediction import (
    FittedExperiment,
    ResponseBackground,
    joint_percent,
    pieces,
    shares_left,
    state_of,
)
from ..regression.time_rows import FreeRecord
from ..regression.tuning import TUNING
from ..search.channel_rows import is_short
from ..search.circumstances import HOLDS, REJECTED, Cause, Finding, sentence_of
from ..search.fitted_modes import FreeFit, feedthrough_of
from ..search.progress import Callback, reporter
from ..search.starting_poles import poles_of
from ..structure.constrained import StructuredFit, constrained
from ..structure.delayed import cost_of, with_delays
from ..structure.hypothesis_tests import LEVEL, choose, given_structure, likelihood_test, structure_tests
from ..structure.layout import POWERS, ChannelLayout, residue_of_unit_weight, weights_of
from ..uncertainty.fisher import PortRecord
from ..uncertainty.residual_data import without_peaks
from ..uncertainty.residual_tests import is_white, ljung_box
from .outputs_alone import are_alone, of_outputs_alone
from .pem_result import PEMResult
from .result import STRUCTURES, OrderRow, cut_short
from .scaled_shapes import ModeShapes, shape_errors

_MOST = 20, 40  # modes of records, and of responses, which may be those of networks
_SEEN = 2.0  # standard errors by which delays that a structure needs differ from 0
_NEARLY = 0.02  # of the likelihood ratio that rejects a structure: what delays may leave of it
_COUNTED = 400_000  # samples times unknowns up to which these are felt by the test of whiteness, and cheap
_WHOLE = 1e-6  # samples, or their share: what a dead time may differ from whole samples by
_HALF = 0.05  # of half a sample: what a delay may differ from it by
_OPPOSED = 0.7  # cosine of the angle within which a residue points against the force
_ROUNDS = 3  # of fits and of the noise of experiments in turn
_MOST_TONES = 20  # times that more tones are looked for
_SAME_LEVEL = 0.02  # mean difference of the logarithms of levels of noise that are the same
_SAME = 1.0  # difference of the BIC of models that are the same
_CERTAIN = 3.0  # standard errors beyond which a mode is said to grow

Channels = tuple[Recording, ...] | tuple[ResponseMatrix, ...]


@dataclass(frozen=True)
class Request:
    """What a fit is to assume: structure, driving points, quantities of the outputs, and the largest number of modes.

    `assumed` says whether the port is the one that one input and one output have by default, `coloured` whether noise
    of an output may be.
    """

    structure: str
    ports: tuple[tuple[int, int], ...]
    quantities: tuple[str, ...]
    most: int
    assumed: bool = False
    coloured: bool = True


@dataclass(frozen=True)
class Options:
    """Options of `pem`, checked.

    `moving` says whether records may start in motion, `weighted` whether weights were given, `reachable` whether modes
    without weight are left out, as from the controllable form.
    """

    order: int | str
    method: str
    intersample: str
    offset: bool | str
    max_order: int
    criterion: str
    callback: Callback | None
    moving: bool
    weighted: bool
    real_poles: int | str
    delay: Array | None
    input_delay: Array | None
    reachable: bool
    noise: str = "auto"

    @classmethod
    def checked(cls, channels: Channels, **options: Any) -> Options:
        """Check options, and signals that could not show anything."""
        order = options["order"]
        if not isinstance(order, str):
            order = _checks.whole_number("order", order, 1)
        elif order != "auto":
            raise StructureError(f"order is {order!r}; it must be 'auto' or a whole number of at least 1")
        _checks.flag_or_auto("offset", options["offset"])
        most, real_poles = options["max_order"], options["real_poles"]
        most = _MOST[isinstance(channels[0], ResponseMatrix)] if most is None else most
        most = _checks.whole_number("max_order", most, 1)
        if not isinstance(real_poles, str):
            real_poles = _checks.whole_number("real_poles", real_poles, 0)
        elif real_poles != "auto":
            raise StructureError(f"real_poles is {real_poles!r}; it must be 'auto' or a whole number of at least 0")
        late = {
            "delay": checked_delay(options["delay"], len(channels[0].output_labels)),
            "input_delay": checked_input_delay(options["input_delay"], channels),
        }
        reporter(most, options["callback"])
        refuse_still(channels, options["moving"])
        if options["method"] == "euler" and options["intersample"] == "auto":
            options["intersample"] = "zoh"
        return cls(**{**options, "order": order, "max_order": most, "real_poles": real_poles, **late})

    @property
    def largest(self) -> int:
        """Largest number of modes."""
        return self.max_order if isinstance(self.order, str) else self.order


def fit_channels(
    channels: Channels, request: Request, options: Options, start: ComplexArray | None = None,
    findings: tuple[Finding, ...] = (), order: int | str | None = None,
) -> PEMResult:  # fmt: skip
    """Fit free residues first, then the structure that is given, or the simplest that is not rejected.

    Outputs alone are those of a motion that decays, or of forces that nobody measured, as is likelier.
    """
    order = options.order if order is None else order

    def of_modes(most: int = options.max_order) -> PEMResult:
        limited = replace(options, max_order=min(most, options.max_order))
        return _of_modes_and_inputs(channels, request, limited, start, findings, order)

    if not are_alone(channels, request.structure, options):
        return of_modes()
    recordings = [data for data in channels if isinstance(data, Recording)]
    return of_outputs_alone(recordings, request, options, order, of_modes)


def _in_noise_of(noise: str, fit: FreeFit, orders: tuple[int, int]) -> FreeFit:
    """A fit in the noise that is given, or the likeliest; where hits act in a part of a record, noise may change."""
    records = [rows for rows in fit.projection.experiments if isinstance(rows, FreeRecord)]
    if any(rows.level is not None for rows in records):
        return fit
    if noise == "auto":
        if any(is_short(rows) for rows in records):
            return fit
        return beside_forces(fit, orders=orders)
    return beside_forces(fit, (noise,), certain=True, orders=orders) if noise in KINDS else fit


def _of_modes_and_inputs(
    channels: Channels, request: Request, options: Options, start: ComplexArray | None,
    findings: tuple[Finding, ...], order: int | str,
) -> PEMResult:  # fmt: skip
    """Fit free residues first, then the structure."""

    def search_in(channels: Channels) -> Callable[..., FreeFit]:
        return partial(
            free_fit, channels, quantities=request.quantities, intersample=options.intersample, offset=options.offset,
            max_order=options.max_order, criterion=options.criterion, weighted=options.weighted,
            real_poles=options.real_poles, method=options.method, delay=options.delay, input_delay=options.input_delay,
            white=options.noise in ("white", *KINDS), beside=partial(_in_noise_of, options.noise),
            reports=reporter(options.largest, options.callback),
        )  # fmt: skip

    resting = options.moving and begin_at_rest(channels)

    def searched(channels: Channels) -> _Searched:
        return _Searched(channels, *_beside_motion(search_in(channels), order, start, options.moving, resting))

    latest = searched(channels)
    try:
        latest = _beside_hum(latest, searched, isinstance(order, str))
        if options.noise in ("auto", "forces"):
            latest = replace(latest, free=beside_strong_forces(latest.free, order, options.max_order))
        latest = _beside_unequal_noise(latest, searched)
        if latest.free.beside is None:
            latest = _beside_changing_noise(latest, searched)
    except KeyboardInterrupt:
        latest = latest.cut
    search, moving = search_in(latest.channels), latest.moving
    free = replace(
        latest.free, findings=(*latest.findings, *latest.free.findings, *_about_order(latest.free, order, options))
    )

    def with_delay(late: Lateness) -> FreeFit:
        return search(order, start=start, moving=moving, delay=late.outputs, input_delay=late.inputs)

    result = under_either_hold(free, request, findings, with_delay)
    while options.reachable and result.success and 0 < np.sum(result.kappa > 0) < result.order:
        free = free if free.rival is None or free.intersample == result.intersample else free.rival
        free = _of_modes(free, imaginary(result.d[result.kappa > 0]))
        result = under_either_hold(free, request, findings)
    if free.beside is not None and options.noise == "auto" and _rejects(result, request.structure):
        # what such a model leaves is no noise, and its distance from the likeliest is no small one
        return _of_modes_and_inputs(channels, request, replace(options, noise="white"), start, findings, order)
    return result


def _rejects(result: PEMResult, structure: str) -> bool:
    """Whether the data reject the structure that was given."""
    return any(test.hypothesis == structure and test.p < LEVEL for test in result.tests)


@dataclass(frozen=True)
class _Searched:
    """Channels as they were searched, their fit, whether modes may move at first, and what was told of the channels."""

    channels: Channels
    free: FreeFit
    moving: bool
    findings: tuple[Finding, ...] = ()

    @property
    def cut(self) -> _Searched:
        """The same after an interruption."""
        return replace(self, free=replace(self.free, interrupted=True))


def _beside_hum(latest: _Searched, searched: Callable[[Channels], _Searched], automatic: bool) -> _Searched:
    """The fit beside tones in place of modes that neither decay nor are driven, where the criterion agrees.

    So it is with lines of the residuals, unless modes may be missing as their number is not `automatic`.
    """
    for _ in range(_MOST_TONES):
        free = latest.free
        more = free.projection.p.imag[undriven(free)]
        more = lines_in(free) if automatic and not len(more) else more
        if not len(more):
            break
        hums = Tones.of(latest.findings, latest.channels)
        tones = tones_in(free, np.append(hums.frequencies, more))
        for _ in range(_ROUNDS):
            again = searched(tones.taken_from(latest.channels))
            if again.free.interrupted:
                return latest.cut
            taken, tones = tones, tones_in(again.free, tones.frequencies)
            if tones.is_near(taken):
                break
        charge = taken.unknowns * float(np.log(free.projection.rows))
        saved = 0.5 * (free.criteria.bic - again.free.criteria.bic - charge)
        if saved <= 0:
            return latest
        latest = replace(again, findings=tuple(taken.findings(saved)))
    return latest


def _beside_unequal_noise(alone: _Searched, searched: Callable[[Channels], _Searched]) -> _Searched:
    """The fit to recordings in units in which their noise is the same, where that is likelier and the noise white."""
    latest, charge = alone, (len(alone.channels) - 1) * float(np.log(alone.free.projection.rows))
    for _ in range(_ROUNDS):
        alike = in_equal_noise(latest.channels, latest.free)
        if alike is None:
            break
        again = searched(alike)
        least = min(alone.free.criteria.bic - charge, latest.free.criteria.bic)
        if again.free.interrupted:
            return latest.cut
        if again.free.criteria.bic >= least:
            break
        latest = again
    # what modes that are missing leave says nothing of the noise
    if latest is alone or not _leaves_white_noise(latest.free):
        return alone
    units = tuple(getattr(channel, "unit", 1.0) for channel in latest.channels)
    gain = 0.5 * (alone.free.criteria.bic - latest.free.criteria.bic - charge)
    return replace(latest, findings=(*alone.findings, Finding(Cause.UNEQUAL_NOISE, units, gain)))


def _beside_changing_noise(alone: _Searched, searched: Callable[[Channels], _Searched]) -> _Searched:
    """The fit where each sample counts by the level of the noise in its span, where that is likelier."""
    latest = alone
    for _ in range(_ROUNDS):
        levels = changing_levels(latest.free)
        if levels is None or _same_levels(levels, latest.channels):
            break
        recordings = zip([data for data in latest.channels if isinstance(data, Recording)], levels, strict=True)
        again = searched(
            tuple(data.of_one_level if level is None else data.adjusted(level=level) for data, level in recordings)
        )
        if again.free.interrupted:
            return latest.cut
        latest = again
    if latest is alone:
        return alone
    findings = findings_of(latest.channels, 0.0)
    charge = sum(len(finding.values) - 2 for finding in findings) * float(np.log(alone.free.projection.rows))
    gain = 0.5 * (alone.free.criteria.bic - latest.free.criteria.bic - charge)
    if gain <= TUNING.sure:
        return alone
    return replace(latest, findings=(*alone.findings, *findings_of(latest.channels, gain)))


def _same_levels(levels: Sequence[Array | None], channels: Channels) -> bool:
    """Whether levels of noise are nearly those that recordings have."""
    known = [_level_of(channel) for channel in channels]
    return all(
        (new is None and old is None)
        or (new is not None and old is not None and np.mean(np.abs(np.log(new / old))) < _SAME_LEVEL)
        for new, old in zip(levels, known, strict=True)
    )  # fmt: skip


def _leaves_white_noise(free: FreeFit) -> bool:
    """Whether the noise that a fit leaves passes the Ljung-Box test of whiteness."""
    if free.beside is None:
        return is_white(free.projection)
    return ljung_box([row for errors in free.beside.errors for row in errors], TUNING.lags) >= TUNING.white


def _beside_motion(
    search: Callable[..., FreeFit], order: int | str, start: ComplexArray | None, moving: bool, resting: bool
) -> tuple[FreeFit, bool]:
    """The fit, and whether modes are in motion where records begin: of those at rest only where that explains more.

    Before a hammer hits, few samples show the motion there was, and what is unknown of it hides the residues.
    """
    free = search(order, start=start, moving=moving and not resting)
    if resting and free.order and not free.interrupted:
        other = search(free.order, start=free.projection.p, moving=True)
        if other.interrupted:
            return replace(free, interrupted=True), False
        if other.criteria.bic < free.criteria.bic:
            return search(order, start=start, moving=True), True
    return free, moving and not resting


def _about_order(free: FreeFit, order: int | str, options: Options) -> list[Finding]:
    """Say where a search ended at its largest order, or was given a larger one than the data show."""
    if isinstance(order, str):
        ended = free.order >= options.max_order and not (free.rounding or free.interrupted)
        return [Finding(Cause.LARGEST_ORDER, (float(free.order),), 0.0)] * ended
    pairs = free.order + int(np.sum(free.projection.p.imag == 0)) // 2
    fewer = pairs < order and (free.rounding or free.crowded)
    return [Finding(Cause.FEWER_MODES, (float(order), float(pairs)), 0.0)] * fewer


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


def checked_delay(value: Any, outputs: int) -> Array | None:
    """Check delays that were given, one for each output; None where they are left to the data."""
    if isinstance(value, str):
        _checks.choice("delay", value, ("auto",))
        return None
    delays = _checks.real_array("delay", value)
    if delays.shape not in ((), (outputs,)):
        raise StructureError(
            f"delay has shape {delays.shape}; it must be 'auto', a number, or one for each of the {outputs} outputs"
        )
    return np.broadcast_to(delays, outputs).copy()


def checked_input_delay(value: Any, channels: Channels) -> Array | None:
    """Check dead times that were given, one for each input, in whole samples; None where they are left to the data."""
    if isinstance(value, str):
        _checks.choice("input_delay", value, ("auto",))
        return None
    times, inputs = _checks.real_array("input_delay", value), len(channels[0].input_labels)
    if times.shape not in ((), (inputs,)):
        raise StructureError(
            f"input_delay has shape {times.shape}; it must be 'auto', a number, or one for each of the {inputs} inputs"
        )
    times = np.broadcast_to(times, inputs).copy()
    if not times.any():
        return times
    if inputs == 1:
        raise StructureError(f"input_delay is {times[0]:.6g} with one input; what all inputs have in common is a delay")
    if times.min() < 0:
        raise StructureError(f"input_delay has {times.min():.6g}; an input may act later than recorded, not earlier")
    for data in channels:
        if not isinstance(data, Recording):
            raise StructureError(
                "input_delay is of recordings in time; multiply a response by exp(1j omega input_delay) instead"
            )
        samples = times / data.dt
        worst = int(np.argmax(np.abs(samples - np.rint(samples))))
        if abs(samples[worst] - np.rint(samples[worst])) > _WHOLE * max(1.0, samples[worst]):
            raise StructureError(
                f"input_delay has {times[worst]:.6g}, {samples[worst]:.6g} samples of {data.dt:.6g}; it must be whole "
                "samples: round it, and leave the rest to delay"
            )
        if 2 * samples.max() > data.samples:
            raise StructureError(
                f"input_delay has {times.max():.6g}, {samples.max():.0f} samples of a record of {data.samples}; it may "
                "be half of a record at most"
            )
    return times


def begin_at_rest(channels: Channels) -> bool:
    """Tell whether all experiments are recordings that begin at rest, by what is seen of the outputs."""
    return all(isinstance(data, Recording) and data.begins_at_rest for data in channels)


WithDelay = Callable[[Lateness], FreeFit]  # searches in rows with these delays


def under_either_hold(
    free: FreeFit, request: Request, findings: tuple[Finding, ...] = (), with_delay: WithDelay | None = None
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
) -> tuple[_Chosen | None, PEMResult]:
    """Choose hold, delays and structure in the rows there are, and make the result; without a choice if interrupted.

    Where no structure stands under either hold, as neither is exact, the hold is the one under which shapes are more
    nearly real.
    """
    try:
        best = _Chosen(free, *_structure_of(free, request))
    except KeyboardInterrupt:
        return None, structured(replace(free, interrupted=True), request, findings)
    try:
        best = _of_either_hold(best, request)
        best = _with_delay(best, lambda: free.rival if best.free is free else free, request, with_delay)
    except KeyboardInterrupt:
        return None, cut_short(_result(*best.parts, request, _beside(findings, best.free)))
    return best, _result(*best.parts, request, _beside(findings, best.free))


@dataclass(frozen=True)
class _Chosen:
    """A free fit, the structure that was chosen for it, and the tests of all."""

    free: FreeFit
    fit: StructuredFit
    tests: tuple[HypothesisTest, ...]

    @property
    def parts(self) -> tuple[FreeFit, StructuredFit, tuple[HypothesisTest, ...]]:
        """All three."""
        return self.free, self.fit, self.tests


def _beside(findings: tuple[Finding, ...], free: FreeFit) -> tuple[Finding, ...]:
    """Findings of the data, those of the fit in place of others of the same cause."""
    anew = {finding.cause for finding in free.findings}
    return (*(finding for finding in findings if finding.cause not in anew), *free.findings)


def _of_either_hold(first: _Chosen, request: Request) -> _Chosen:
    """The structure under the hold with which it is simpler, or likelier; that the input is not held is a finding."""
    best = _under_likelier_hold(first, request)
    if best.free.intersample == "zoh" or first.free.rival is None:
        return best
    gain = _gain(best, first)
    if best is first:
        gain = 0.5 * (first.free.rival.criteria.bic - first.free.criteria.bic)
    hold = Finding(Cause.HOLD, (float(HOLDS.index("foh")),), float(gain))
    others = (finding for finding in best.free.findings if finding.cause is not Cause.HOLD)
    return replace(best, free=replace(best.free, findings=(*others, hold)))


def _under_likelier_hold(first: _Chosen, request: Request) -> _Chosen:
    """The structure under the hold with which it is simpler, or likelier."""
    free = first.free
    if request.structure == "free" or _stands(first, request) or free.rival is None:
        return first
    rival = replace(free.rival, findings=free.findings)
    if request.structure == "auto":
        simpler = STRUCTURES[: STRUCTURES.index(first.fit.structure)]
        chosen, tests = _tested(rival, request, simpler)
        stands = chosen.structure in simpler
        if not (stands or (first.fit.structure == "free" and _is_rather_held_as(rival, tests, free, first.tests))):
            return first
    second = _Chosen(rival, *_structure_of(rival, request))
    return second if request.structure == "auto" or _gain(second, first) > TUNING.sure else first


def _is_rather_held_as(
    rival: FreeFit, tests: tuple[HypothesisTest, ...], free: FreeFit, free_tests: tuple[HypothesisTest, ...]
) -> bool:
    """Whether inputs were rather held as in a rival fit, where no structure stands.

    With what is fed through they are the same model, and only shapes tell them apart.
    """
    preferred = free.criteria.bic - rival.criteria.bic
    if abs(preferred) > _SAME:
        return preferred > 0
    return _classical_cost(free, free_tests) - _classical_cost(rival, tests) > 2 * TUNING.sure


def _with_delay(
    best: _Chosen, other: Callable[[], FreeFit | None], request: Request, with_delay: WithDelay | None
) -> _Chosen:
    """The structure with delays of the outputs, where these explain more; those of whole samples are refined.

    `other` makes the fit with the inputs held otherwise.
    """
    free = best.free
    if not (free.delay_open and free.order and free.projection.inputs) or free.interrupted:
        return best
    late, stands = bool(free.delay.any()), _stands(best, request)
    if request.structure == "passive" or (stands and not late):
        return best
    if stands:
        return _refined(best, best.fit.hypothesis, request)
    hypothesis = "classical" if request.structure == "auto" else request.structure
    trials = [_delayed(fit, best, hypothesis, request, False) for fit in (free, other()) if fit is not None]
    trial = min((candidate for candidate in trials if candidate is not None), key=_cost, default=best)
    # what rejects a structure that is given, and free residues explain without a delay, shows none
    without = best if request.structure in ("auto", "free") else _freely(best, request)
    if trial is not best and _explains(trial, without):
        chosen = _searched_anew(trial.free, request, with_delay)
        likelier = _explains(chosen, without) and (_stands(chosen, request) or _gain(chosen, without) > TUNING.sure)
        if likelier and _is_late(chosen.fit):
            return chosen
    return _refined(best, "free", request) if late and best.fit.structure == "free" else best


def _is_late(fit: StructuredFit) -> bool:
    """Whether any delay differs from 0 by more than its errors allow."""
    return fit.delays is None or bool(np.any(np.abs(fit.delays.values) > _SEEN * fit.delay_errors))


def _freely(best: _Chosen, request: Request) -> _Chosen:
    """Free residues in place of a structure."""
    free = best.free
    return replace(best, fit=constrained(free.projection, _layout(free, request), "free", free.region))


def _searched_anew(late: FreeFit, request: Request, with_delay: WithDelay | None) -> _Chosen:
    """The structure in rows with delays, after a search in these: modes too many may have stood for the delay."""
    anew = late if with_delay is None else with_delay(Lateness(late.delay[_places(late)], late.input_delay))
    if anew.interrupted:
        raise KeyboardInterrupt
    anew = replace(anew, findings=late.findings, delay_gain=late.delay_gain).with_delay_open(True)
    return min((_in_rows_of(free, request) for free in (late, anew) if free.order), key=_cost)


def _explains(trial: _Chosen, best: _Chosen) -> bool:
    """Whether a structure with delays is likelier than the best without, or nearly so.

    Held and linear inputs are models of what goes on between samples, and of smooth inputs that come late free residues
    absorb a little of what is wrong with them.  That must not decide where delays explain nearly all that rejects the
    structure, of more than one mode.
    """
    if trial is best:
        return False
    refused = [test.likelihood_ratio for test in best.tests if test.hypothesis == trial.fit.hypothesis]
    spare = (best.fit.parameters - trial.fit.parameters) * float(np.log(trial.fit.projection.rows))
    several = np.sum(trial.fit.p.imag > 0) > 1
    nearly = spare > 0 and several and spare - 2 * _gain(trial, best) < _NEARLY * max([*refused, 0.0])
    return bool(_gain(trial, best) > TUNING.sure or nearly)


def _gain(trial: _Chosen, best: _Chosen) -> float:
    """By how much the criterion prefers a structure, as a log-likelihood."""
    return 0.5 * (_cost(best) - _cost(trial))


def _in_rows_of(free: FreeFit, request: Request) -> _Chosen:
    """The structure in rows with delays, which are refined with it."""
    first = _of_either_hold(_Chosen(free, *_structure_of(free, request)), request)
    if _stands(first, request) or request.structure != "auto":
        return _refined(first, first.fit.hypothesis, request)
    classical = _delayed(first.free, first, "classical", request, True)
    wider = _refined(first, "free", request) if first.fit.structure == "free" else first
    return min((candidate for candidate in (classical, wider) if candidate is not None), key=_cost)


def _delayed(free: FreeFit, best: _Chosen, hypothesis: str, request: Request, settled: bool) -> _Chosen | None:
    """A structure with delays, in the rows of a free fit."""
    layout = _layout(free, request)
    delayed = with_delays(free.projection, layout, hypothesis, free.region, _felt(free, request), settled=settled)
    if delayed is None or delayed.fit.delays is None:
        return None
    projection, late = delayed.free, _Chosen(free, delayed.fit, best.tests)
    gain = free.delay_gain if settled else _gain(late, best)
    now = replace(
        free, projection=projection, unknowns=projection.unknowns, delay=delayed.fit.delays.each, delay_gain=gain,
        held_otherwise=None, delay_open=True, findings=best.free.findings,
    )  # fmt: skip
    return replace(late, free=now)


def _refined(best: _Chosen, hypothesis: str, request: Request) -> _Chosen:
    """The same with delays that are no whole samples, and their errors; as it is where the data do not tell them."""
    refined = _delayed(best.free, best, hypothesis, request, True)
    if refined is None or refined.fit.delays is None:
        return best
    # free residues and what is fed through say the same for all delays within a sample
    return refined if np.all(refined.fit.delay_errors < np.pi * refined.fit.delays.step) else best


def _stands(best: _Chosen, request: Request) -> bool:
    """Whether the structure is one that is not rejected within the free model."""
    if request.structure == "auto":
        return best.fit.structure in STRUCTURES[:2]
    projection = best.free.projection
    unknowns = len(projection.x) + int(projection.shown.sum()) - projection.deficiency
    return likelihood_test(projection, best.fit, max(0, unknowns - best.fit.parameters)).p >= LEVEL


def _places(free: FreeFit) -> slice:
    """Where an output of the data is first among those of the projection."""
    return slice(None, None, len(free.channels[0].input_labels) if free.per_entry else 1)


def _cost(chosen: _Chosen) -> float:
    """BIC of a structure with its delays, for as many rows as the data have without them."""
    rows = sum(int(record.observed.sum()) for record in chosen.free.channels) * (1 + chosen.free.per_entry)
    cost = rows * cost_of(chosen.fit, chosen.free.scales)
    return cost + (
        0.0 if chosen.fit.delays else len(np.unique(chosen.free.delay[chosen.free.delay != 0])) * np.log(rows)
    )


def _felt(free: FreeFit, request: Request) -> Mask:
    """What is fed through in any case (outputs of the projection, inputs): to an accelerometer."""
    felt = np.array([quantity == "acceleration" for quantity in request.quantities])
    inputs = len(free.channels[0].input_labels)
    return felt.repeat(inputs)[:, None] if free.per_entry else felt[:, None].repeat(inputs, axis=1)


def _classical_cost(free: FreeFit, tests: tuple[HypothesisTest, ...]) -> float:
    """Criterion of the classical model of a fit, short of its unknowns; that of the fit itself where it has none."""
    return free.criteria.bic + sum(test.likelihood_ratio for test in tests if test.hypothesis == "classical")


def structured(free: FreeFit, request: Request, findings: tuple[Finding, ...] = ()) -> PEMResult:
    """Select the structure with the inputs held as they are."""
    return _result(free, *_structure_of(free, request), request, (*findings, *free.findings))


def _layout(free: FreeFit, request: Request) -> ChannelLayout:
    first = free.channels[0]
    return ChannelLayout(
        len(first.output_labels), len(first.input_labels), free.scales, request.quantities, request.ports,
        per_entry=free.per_entry,
    )  # fmt: skip


def _tested(
    free: FreeFit, request: Request, among: tuple[str, ...] | None = None
) -> tuple[StructuredFit, tuple[HypothesisTest, ...]]:
    """Choose the simplest structure that is not rejected, and return the tests of all, or of those `among` some."""
    tested = structure_tests(free.projection, _layout(free, request), free.region, among)
    return choose(tested), tested.tests


def _structure_of(free: FreeFit, request: Request) -> tuple[StructuredFit, tuple[HypothesisTest, ...]]:
    """Fit the structure that is given, or the simplest that is not rejected; return it with the tests made."""
    layout, given = _layout(free, request), request.structure
    if not free.states:
        return _without_modes(free), ()
    if given == "free" or free.interrupted:
        given = "free" if given == "auto" else given
        return constrained(free.projection, layout, given, free.region, 1 if free.interrupted else None), ()
    if given == "auto":
        return _tested(free, request)
    fit, test = given_structure(free.projection, layout, given, free.region)
    return fit, (test,)


def _without_modes(free: FreeFit) -> StructuredFit:
    """Make a fit without poles: what is fed through, and constants."""
    projection, entries = free.projection, (len(free.channels[0].output_labels), len(free.channels[0].input_labels))
    return StructuredFit(
        "free", "free", np.zeros(0, complex), np.zeros((0, *entries), complex), feedthrough_of(free), None, None,
        projection.loss, projection.unknowns, free.variance, projection, True, projection,
    )  # fmt: skip


# --- the request -----------------------------------------------------------------------------------------------------


def request_of(channels: Channels, structure: str, ports: Any, quantity: Any, options: Options) -> Request:
    """Check structure, ports and quantities against the channels."""
    outputs, inputs = channels[0].output_labels, channels[0].input_labels
    quantities = checked_quantities(quantity, outputs)
    if options.method != "exact" or options.reachable:
        structure = _lossless_port(structure, (len(outputs), len(inputs)), quantities, options)
    # a sensor of another kind has no power with the input
    assumed = ports is None and len(outputs) == len(inputs) == 1 and quantities != ("free",)
    pairs = ((0, 0),) if assumed else () if ports is None else _checks.port_pairs(ports, outputs, inputs)
    if structure == "passive" and not pairs:
        raise StructureError("structure='passive' needs driving points: name them, ports=[(output, input), ..]")
    return Request(structure, pairs, quantities, options.largest, assumed, options.noise in ("auto", "coloured"))


def _lossless_port(structure: str, shape: tuple[int, int], quantities: tuple[str, ...], options: Options) -> str:
    """Refuse options of the models of the paper for others; return the structure."""
    name, value = ("method", options.method) if options.method != "exact" else ("representation", "controllable")
    if structure not in ("auto", "lossless") or shape[0] != 1 or shape[1] > 1 or "free" in quantities:
        raise StructureError(
            f"{name}={value!r} is for lossless models of one input and one output; this fit has structure="
            f"{structure!r}, {shape[1]} inputs and {shape[0]} outputs ({', '.join(quantities)}): leave {name} out"
        )
    return "lossless"


def starting_poles(guess: Any, channels: Channels, options: Options) -> ComplexArray | None:
    """Poles to start from: those of a model, of positive imaginary part and real ones."""
    if guess is None:
        return None
    common_unit(list(channels), guess)
    poles = poles_of(guess)
    poles = poles if options.real_poles else poles[poles.imag > 0]
    count, given = int(np.sum(poles.imag > 0)), isinstance(options.order, int)
    if count > options.largest:
        allowed = f"{options.largest} of the order" if given else f"{options.largest} that 'auto' may take"
        raise StructureError(f"initial_guess has {count} modes, more than the {allowed}")
    fastest = float(poles.imag.max(initial=0.0))
    for data in channels:
        if isinstance(data, Recording):
            hold = Hold(data.dt, options.method)
            ceiling = float(hold.frequency_of(np.array([hold.largest_phase(data.samples)]))[0])
            if fastest > ceiling:
                raise StructureError(
                    f"initial_guess has a mode at {fastest:.6g} rad/time; what the data can show ends at {ceiling:.6g}"
                )
    return poles


# --- the result ------------------------------------------------------------------------------------------------------


def _result(
    free: FreeFit,
    fit: StructuredFit,
    tests: tuple[HypothesisTest, ...],
    request: Request,
    findings: tuple[Finding, ...],
) -> PEMResult:
    """The result of a fit, of one that is interrupted here without what is looked for beside the modes."""
    try:
        return _judged(free, fit, tests, request, findings)
    except KeyboardInterrupt:
        return _judged(replace(free, interrupted=True), fit, tests, request, findings)


def _judged(
    free: FreeFit,
    fit: StructuredFit,
    tests: tuple[HypothesisTest, ...],
    request: Request,
    findings: tuple[Finding, ...],
) -> PEMResult:
    """Parameters, experiments and judgement of a fit."""
    refused = any(test.p < LEVEL for test in tests if test.hypothesis == request.structure)
    if refused:
        # who insists on it gets the errors of what it leaves
        rows_to_spare = max(1, free.projection.rows - free.projection.unknowns)
        fit = replace(fit, variance=max(fit.variance, fit.loss / rows_to_spare))
    rounding = free.rounding and not refused
    rank = np.lexsort((np.abs(fit.p), fit.p.imag == 0))
    poles = fit.p[rank]
    residues = fit.residues[rank] * np.where(poles.imag == 0, 2.0, 1.0)[:, None, None]
    covariance = _covariance(fit, free, rank)
    measured = _in_data(fit, free)
    experiments = _experiments(measured, fit, free, rank, request.quantities)
    shapes, errors = _shapes(fit, free, request, poles, residues, covariance, experiments, rank)
    delays = 0 if fit.delays is None else fit.delays.count
    extra = fit.parameters - delays - (len(free.projection.x) + int(free.projection.shown.sum()))
    unknowns = free.unknowns + min(0, extra) + delays + len(free.scales)
    unknowns += sum(finding.cause is Cause.INPUT_DELAY for finding in free.findings)
    delay, delay_stderr = _delays(fit, free)
    predicted = [(experiment.record, experiment.predicted) for experiment in experiments]
    counts, variances = _variances(experiments, free)
    samples, known = int(counts.sum()), counts > 0
    loglik = float(-0.5 * np.sum(counts[known] * (np.log(2 * np.pi * variances[known]) + 1)))
    if free.noise or free.beside is not None:  # that of the innovations, less what a structure costs
        loglik = free.criteria.loglik - 0.5 * (fit.loss - free.projection.loss) / free.variance
    # as variances are divided by it, they are none of the unknowns
    spare = max(1, samples - (unknowns - len(free.scales)))
    single = residues.shape[1] == 1 and residues.shape[2] <= 1
    shown: Any = _squeezed(experiments, measured, fit, free, rank, request.quantities[0]) if single else experiments
    model = FittedModel(
        poles, residues, fit.feedthrough, covariance, delay, request.quantities, free.method, free.intersample
    )
    whiteness = 1.0 if rounding else _whiteness(experiments, shown if single else (), model, free.channels)
    if free.beside is not None:
        whiteness = ljung_box([row for errors in free.beside.errors for row in errors], TUNING.lags)
    findings = (
        *(_in_model(finding, experiments) for finding in findings), *_lateness(free, delay, delay_stderr),
        *_rejections(tests), *_reversed(free, request), *_saturated(experiments), *not_linear(free),
    )  # fmt: skip
    if whiteness >= WHITE and not (rounding or free.interrupted):
        findings = (*findings, *_outliers(experiments, free.channels, spare))
    blind = _what_is_blind(shown, poles, residues, request, free) if fit.point.deficiency else ""
    fitted = joint_percent(shares_left(predicted))
    noise_variance = (variances * samples / spare).reshape(fit.feedthrough.shape[: 1 + free.per_entry])
    filters = () if rounding else free.filters or free.noise
    evidence = _Evidence(free, tests, findings, fitted, whiteness, spare, refused, blind)
    return PEMResult(
        structure=fit.structure,
        poles=poles,
        residues=residues,
        feedthrough=fit.feedthrough,
        covariance=covariance,
        shapes=shapes.shapes,
        participation=shapes.participation,
        shape_stderr=errors,
        shapes_scaled=bool(shapes.scaled.all() and len(shapes.scaled)),
        ports=request.ports,
        quantities=request.quantities,
        noise_variance=noise_variance,
        experiments=shown,
        loss=float(np.exp(counts @ np.log(variances) / max(1, samples))),
        loglik=loglik,
        aic=2 * unknowns - 2 * loglik,
        bic=unknowns * float(np.log(samples)) - 2 * loglik,
        fit_percent=fitted,
        unknowns=unknowns,
        whiteness=whiteness,
        order_table=tuple(
            OrderRow(row.order, float(np.exp(-2 * row.loglik / samples - 1) / (2 * np.pi)), row.aic, row.bic,
                     _checks.readonly(np.abs(row.poles)))
            for row in free.order_table
        ),
        tests=tests,
        findings=findings,
        success=fit.converged and not free.interrupted,
        outcome=evidence.outcome,
        message=_message(evidence, poles, covariance, shapes, request.most),
        intersample="zoh" if free.per_entry else free.intersample,
        delay=delay,
        delay_stderr=delay_stderr,
        input_delay=free.input_delay,
        method=free.method,
        blind=bool(blind),
        noise=fitted_noise(experiments, noise_variance, filters, spare / samples)
        if free.beside is None
        else free.beside.model(free.channels[0].dt),
    )  # fmt: skip


def _covariance(fit: StructuredFit, free: FreeFit, rank: Indices) -> Array:
    """From the coordinates of the projection to those of a result, NaN for what leaves no trace."""
    n, projection = len(fit.p), fit.projection
    width, count = projection.shared.shape[0] if projection.shared.size else 0, len(free.scales)
    places = (2 * n + np.arange(width * count)).reshape(count, width).T
    scales = np.broadcast_to(free.scales, (width, count))
    inputs = 0 if not width else projection.inputs
    entries = fit.residues.shape[1:]

    def split(values: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Real and imaginary parts (n, p, m) and feedthrough (p, m) of numbers of the shared unknowns."""
        each = values.reshape(inputs, -1 if inputs else 2 * n, count)
        real, imag = (np.moveaxis(each[:, k * n : (k + 1) * n], 0, 2).reshape(n, *entries) for k in (0, 1))
        if each.shape[1] > 2 * n:
            return real, imag, each[:, 2 * n].T.reshape(entries)
        return real, imag, np.full(entries, -1 if values.dtype.kind in "iu" else 1, values.dtype)

    real, imag, through = split(places)
    order = np.concatenate([rank, n + rank, real[rank].ravel(), imag[rank].ravel(), through.ravel()]).astype(int)
    unit = [np.ones(2 * n), *(part.ravel() for part in (split(scales)[0], split(scales)[1], split(scales)[2]))]
    seen = split(projection.shown.astype(float))
    lost = np.concatenate([np.zeros(2 * n), *((part == 0).ravel() for part in (seen[0][rank], seen[1][rank], seen[2]))])
    given = fit.covariance if n else projection.covariance(fit.variance)
    J, inner = natural_jacobian(fit.p), given.copy()
    inner[: 2 * n] = J @ inner[: 2 * n]
    inner[:, : 2 * n] = inner[:, : 2 * n] @ J.T
    inner = 0.5 * (inner + inner.T)  # but for rounding
    size = np.concatenate(unit)
    twice = np.where(fit.p[rank].imag == 0, 2.0, 1.0).repeat(int(np.prod(entries)))
    size[2 * n :][: 2 * len(twice)] *= np.tile(twice, 2)  # a real pole has its residue in two halves
    if not inner.size:
        return np.full((len(order), len(order)), np.nan)
    covariance = inner[np.ix_(order, order)] * np.outer(size, size)
    # a structure may tell of residues that free ones do not show
    unknown = split(_blind(fit, free).astype(float))
    hidden = np.concatenate(
        [np.zeros(2 * n), *(part.ravel() for part in (unknown[0][rank], unknown[1][rank], unknown[2]))]
    )
    nothing = np.tile((fit.residues[rank] == 0).ravel(), 2)  # weights that are held at 0
    still = np.all(fit.residues[rank] == 0, axis=(1, 2)) & (np.diag(covariance)[:n] == 0)  # poles that leave no trace
    held = np.concatenate([np.tile(still, 2), nothing, np.zeros(through.size, bool)])
    absent = (order < 0) | ((lost > 0) & (np.diag(covariance) == 0)) | (hidden > 0) | held
    covariance[absent] = np.nan
    covariance[:, absent] = np.nan
    return covariance


def _blind(fit: StructuredFit, free: FreeFit) -> Mask:
    """Which numbers of the shared unknowns free residues leave without a trace, if those of the structure do too."""
    if not fit.point.deficiency:
        return np.zeros(fit.projection.shared.shape, bool)
    if len(free.projection.p) == len(fit.p):
        return free.projection.blind
    # a pair of the free model may be two real poles under a structure
    return FreeProjection(free.projection.experiments, fit.p, free.projection.fed).blind


def _delays(fit: StructuredFit, free: FreeFit) -> tuple[Array, Array]:
    """Delay of each output and its standard error: NaN where it is known to a sample only, 0 where it was given."""
    places = _places(free)
    if fit.delays is not None:
        return fit.delays.each[places], fit.delay_errors[fit.delays.groups][places]
    late = np.broadcast_to(free.delay, free.scales.shape)[places]
    return late.copy(), np.where(late != 0, np.nan if free.delay_open else 0.0, 0.0)


def _lateness(free: FreeFit, delay: Array, errors: Array) -> tuple[Finding, ...]:
    """What is found of delays that are left to the data: one of all outputs, or of each."""
    labels = free.channels[0].output_labels
    if not (free.delay_open and delay.any()):
        return ()
    if np.ptp(delay) == 0:
        finding = Finding(Cause.DELAY, (float(delay[0]), float(errors[0])), free.delay_gain)
        return (finding, *_of_other_hold(free, float(delay[0]), float(errors[0])))
    each = zip(labels, delay.tolist(), errors.tolist(), strict=True)
    return tuple(Finding(Cause.DELAY, (late, error), free.delay_gain, label) for label, late, error in each if late)


def _of_other_hold(free: FreeFit, delay: float, error: float) -> tuple[Finding, ...]:
    """Name the other hold where all outputs come half a sample early, as a linear input does after one that is held."""
    other = "foh" if free.intersample == "zoh" else "zoh"
    half = (0.5 if other == "zoh" else -0.5) * getattr(free.channels[0], "dt", np.nan)
    if not abs(delay - half) < _HALF * abs(half) + 2 * np.nan_to_num(error):
        return ()
    return (Finding(Cause.HOLD, (float(HOLDS.index(other)),), free.delay_gain),)


def _in_data(fit: StructuredFit, free: FreeFit) -> FreeProjection:
    """The data as they were measured at a model, also at one that was fitted in other rows."""
    if free.measured is None:
        return fit.projection
    rows = free.measured.experiments
    if fit.delays is not None:
        rows = fit.delays.rows(rows)  # type: ignore[type-var]
    projection = FreeProjection(rows, fit.p, free.measured.fed)
    return GivenResidues(projection, fit.projection.shared)


def _experiments(
    projection: FreeProjection, fit: StructuredFit, free: FreeFit, rank: Indices, quantities: tuple[str, ...]
) -> tuple[FittedChannels, ...]:
    """Predictions, free motions, offsets and backgrounds of each experiment, from the rows of its outputs."""
    n, experiments = len(projection.p), []
    rows = iter(
        zip(
            projection.experiments,
            projection.own,
            projection.predictions(),
            range(len(projection.experiments)),
            strict=True,
        )
    )
    for channel in free.channels:
        p, m, outputs = len(channel.output_labels), len(channel.input_labels), len(free.scales)
        in_time = isinstance(channel, Recording)
        seen = channel.observed.reshape(outputs, -1).any(axis=1)
        remaining = int(seen.sum())
        predicted: NDArray[Any] = np.empty((outputs, channel.samples), float if in_time else complex)
        predicted[~seen] = np.nan
        motion, offsets, drifts = np.zeros((n, outputs), complex), np.zeros(outputs), np.zeros(outputs)
        terms = np.zeros((2, 5, outputs), complex)  # of the background, and their standard errors
        errors = np.full(outputs, np.nan)
        while remaining > 0:
            part, own, values, place = next(rows)
            which = part.outputs
            scale = free.scales[which] * getattr(part, "unit", 1.0)
            remaining -= len(which)
            if isinstance(part, FreeResponse):
                spread = np.array([np.diag(inner) for inner, _ in _own_spreads(projection, fit, place)]).T
                for term, *values_of in zip(part.terms, own, np.sqrt(np.maximum(spread, 0.0)), strict=True):
                    terms[:, term.power + 2, which] += (1j if term.turned else 1.0) * scale * np.array(values_of)
            residues = projection.residues[:, which] if n else np.zeros((0, len(which), m), complex)
            if isinstance(part, FreeRecord):
                motion[:, which] = 2 * scale * part.motion_at_start(projection.p, residues, own)[rank]
                offsets[which], drifts[which] = scale * part.offset_at_start(own)
                if part.offset:
                    errors[which] = scale * _roots(
                        [spread[-1, -1] for spread, _ in _own_spreads(projection, fit, place)]
                    )
                values = part.placed(values)
            if len(which) == outputs:
                predicted = np.multiply(values, scale[:, None], out=values)
            else:
                predicted[which] = values * scale[:, None]
            if in_time:
                predicted[which] += np.broadcast_to(channel.hum, predicted.shape)[which]
        if in_time:
            experiments.append(
                FittedChannels(
                    channel.original, motion, offsets, drifts, predicted, offset_stderr=errors,
                    noise_scale=channel.unit,
                )
            )  # fmt: skip
        else:
            nothing = np.zeros((n, 0), complex), np.zeros(p), np.zeros(p)
            coefficients, errors = terms.reshape(2, 5, p, m)
            background = ResponseBackground(coefficients, errors, quantities) if terms.any() else None
            experiments.append(FittedChannels(channel, *nothing, predicted.reshape(p, m, channel.samples), background))
    return tuple(experiments)


def _variances(experiments: Sequence[FittedChannels], free: FreeFit) -> tuple[Array, Array]:
    """Number of real residuals of each output or entry, and the mean square of these, in the same noise."""
    counts: Any = 0
    losses: Any = 0.0
    for data, channel in zip(experiments, free.channels, strict=True):
        known = data.record.observed & ~np.isnan(data.predicted)
        counts = counts + known.sum(axis=-1) * (1 + free.per_entry)
        if isinstance(data.record, ResponseMatrix) and data.record.errors is not None:
            losses = losses + np.nansum(np.abs(data.record.in_noise(data.residuals)) ** 2, axis=-1)
            continue
        if (level := _level_of(channel)) is not None:
            residuals = np.where(known, data.residuals / level, 0.0)
            losses = losses + np.sum(residuals**2, axis=-1) / data.noise_scale**2
            continue
        for weights, _, residuals in pieces([(data.record, data.predicted)]):
            losses = losses + np.sum(weights * np.abs(residuals) ** 2, axis=-1) / data.noise_scale**2
    divisor = np.maximum(np.ravel(counts), 1)
    return np.ravel(counts), np.maximum(np.ravel(losses), np.finfo(float).tiny * divisor) / divisor


def _level_of(channel: Any) -> Array | None:
    """Level of the noise of a recording (p, T), None where it does not change."""
    level: Array | None = getattr(channel, "level", None)
    return level


def _residuals(experiment: FittedChannels, channel: Any) -> dict[str, Signal]:
    """Residuals by label of the output, or of the entry of a response, where they are weighted; of those measured.

    Where the noise of the `channel` changes they are in units of its level.
    """
    outputs, inputs = experiment.record.output_labels, experiment.record.input_labels
    if isinstance(experiment.record, Recording):
        seen = np.flatnonzero(experiment.record.observed.any(axis=1)).tolist()
        if (level := _level_of(channel)) is not None:
            return {outputs[k]: experiment.residuals[k] / level[k] for k in seen}
        return {outputs[k]: Difference(experiment.measured[k], experiment.predicted[k]) for k in seen}
    residuals = experiment.record.in_noise(experiment.residuals)
    entries = [
        (f"{o}:{i}", row)
        for o, rows in zip(outputs, residuals, strict=True)
        for i, row in zip(inputs, rows, strict=True)
    ]
    return {label: row for label, row in entries if not np.isnan(row).all()}


def _rows(experiment: FittedChannels, channel: Any) -> list[Signal]:
    """Real residuals of each output, or real and imaginary parts of those of each entry of a response.

    Of a response without its peaks: a few points at a resonance outweigh all others, and alone look white.
    """
    residuals = list(_residuals(experiment, channel).values())
    if isinstance(experiment.record, Recording):
        return residuals
    return [without_peaks(part) for row in residuals for part in (row[:].real, row[:].imag)]


def _whiteness(
    experiments: Sequence[FittedChannels], single: Sequence[Any], model: FittedModel, channels: Sequence[Any]
) -> float:
    """p-value of white residuals; of `single` input and output with what was fitted, which is missing from them.

    Short records feel that, and are asked again if they look coloured.
    """
    rows = [row for pair in zip(experiments, channels, strict=True) for row in _rows(*pair)]
    p = ljung_box(rows, TUNING.lags)
    samples = sum(experiment.record.samples for experiment in single)
    if not single or p >= TUNING.surely_white or samples * len(model.covariance) > _COUNTED:
        return p
    directions = [directions_of(experiment, model) for experiment in single]
    shared, local = (
        [
            part
            for experiment, channel, values in zip(single, channels, each, strict=True)
            for part in _in_rows(experiment.record, channel, values)
        ]
        for each in ([direction.shared for direction in directions], [direction.local for direction in directions])
    )
    return ljung_box(rows, TUNING.lags, shared=shared, local=local)


def _in_rows(record: Any, channel: Any, values: NDArray[Any]) -> list[Array]:
    """Directions (T, k) of a record as its residuals are; of a response their real and imaginary parts, weighted."""
    if isinstance(record, Record):
        level = _level_of(channel)
        return [values if level is None else values / level[0][:, None]]
    if record.errors is None:
        scaled = values * np.sqrt(record.weights)[:, None]
    else:
        scaled = np.nan_to_num(record.errors.whitened(0, 0, np.where(record.observed, values.T, np.nan))).T
    return [scaled.real, scaled.imag]


def _saturated(experiments: Sequence[FittedChannels]) -> list[Finding]:
    """Outputs of recordings that stay at an end of their range."""
    every = [
        (k, experiment.record) for k, experiment in enumerate(experiments) if isinstance(experiment.record, Recording)
    ]
    ends = [
        (k, name, saturation(row))
        for k, record in every
        for name, row in zip(record.output_labels, record.y, strict=True)
    ]
    return [Finding(Cause.SATURATION, (float(count), *of), 0.0, name, k) for k, name, (count, of) in ends if count]


def _outliers(experiments: Sequence[FittedChannels], channels: Sequence[Any], spare: int) -> list[Finding]:
    """Values that stand out of the noise of all others of their output and experiment."""
    every = [
        (label, k, row) for k, pair in enumerate(zip(experiments, channels, strict=True))
        for label, row in _residuals(*pair).items()
    ]  # fmt: skip
    pairs = zip(every, outliers([row for *_, row in every], spare), strict=True)
    return [Finding(Cause.OUTLIERS, tuple(map(float, far)), 0.0, label, k) for (label, k, _), far in pairs if far]


def _shapes(
    fit: StructuredFit, free: FreeFit, request: Request, poles: ComplexArray, residues: ComplexArray, covariance: Array,
    experiments: tuple[FittedChannels, ...], rank: Indices,
) -> tuple[ModeShapes, ComplexArray]:  # fmt: skip
    """Shapes with their standard errors: of residues, or of a free motion."""
    n, (_, p, m) = int(np.sum(poles.imag != 0)), residues.shape
    count, size = len(poles), residues.size
    poles, residues = poles[:n], residues[:n]
    # a port that was not named holds only where the structure does
    ports = () if request.assumed and fit.structure == "free" else request.ports
    if m:
        shapes = ModeShapes.of(poles, residues, request.quantities, ports)
        entries = np.arange(n * p * m).reshape(n, p * m)
        places = [[l, count + l, *(2 * count + entries[l]), *(2 * count + size + entries[l])] for l in range(n)]
        blocks = [np.nan_to_num(covariance[np.ix_(indices, indices)]) for indices in places]
        return shapes, shape_errors(poles, residues, request.quantities, ports, blocks)
    motions = np.stack([experiment.free_amplitudes[:n] for experiment in experiments], axis=2)
    shapes = ModeShapes.of(poles, motions, request.quantities, ())
    shapes = ModeShapes(shapes.shapes, np.zeros((n, 0), complex), shapes.scaled)
    return shapes, shape_errors(
        poles, motions, request.quantities, (), _motion_covariances(_in_data(fit, free), fit, free, rank)[:n]
    )


def _roots(variances: ArrayLike) -> Array:
    """Standard errors; NaN where so little is shown that rounding leaves less than nothing."""
    each = np.asarray(variances, float)
    return np.sqrt(np.where(each >= 0, each, np.nan))


def _own_spreads(projection: FreeProjection, fit: StructuredFit, experiment: int) -> list[tuple[Array, Array]]:
    """Covariance of what belongs to an experiment, for each output, and with the poles and shared unknowns of it."""
    every = fit.covariance if len(fit.p) else projection.covariance(fit.variance)
    return projection.own_covariances(experiment, every, fit.variance)


def _motion_covariances(projection: FreeProjection, fit: StructuredFit, free: FreeFit, rank: Indices) -> list[Array]:
    """Covariance of `(d, zeta, Re, Im of the free motions)` of each mode, outputs by experiments, of a free motion."""
    n, count, runs = len(fit.p), len(free.scales), len(free.channels)
    J, inner = natural_jacobian(fit.p), fit.covariance[: 2 * n, : 2 * n]
    measured = np.cumsum([int(data.observed.any(axis=-1).sum()) for data in free.channels])
    size, done = count * runs, 0
    covariances = [np.zeros((2 + 2 * size, 2 + 2 * size)) for _ in range(n)]
    for l, total in enumerate(covariances):
        total[:2, :2] = J[[l, n + l]] @ inner @ J[[l, n + l]].T
    for k, rows in enumerate(projection.experiments):
        place = int(np.searchsorted(measured, done, side="right"))
        done += len(rows.outputs)
        for output, (spread, with_poles) in zip(rows.outputs.tolist(), _own_spreads(projection, fit, k), strict=True):
            scale = 2 * free.scales[output] * getattr(rows, "unit", 1.0)
            for l, total in enumerate(covariances):
                both = [2 + output * runs + place, 2 + size + output * runs + place]
                total[np.ix_(both, both)] = scale**2 * spread[np.ix_([l, n + l], [l, n + l])]
                total[np.ix_(both, [0, 1])] = scale * with_poles[[l, n + l], : 2 * n] @ J[[l, n + l]].T
                total[np.ix_([0, 1], both)] = total[np.ix_(both, [0, 1])].T
    return [covariances[l] for l in rank.tolist()]


# --- one input and one output ----------------------------------------------------------------------------------------


def _squeezed(
    experiments: Sequence[FittedChannels], measured: FreeProjection, fit: StructuredFit, free: FreeFit, rank: Indices,
    quantity: str,
) -> tuple[FittedExperiment, ...]:  # fmt: skip
    """Experiments of one input and one output without dimensions for these, with their initial states."""
    r = None
    if fit.structure == "lossless" and fit.residues.shape[2] == 1 and bool(np.all(fit.p.imag > 0)):
        r = weights_of(fit.p[rank], fit.residues[rank, 0, 0], quantity)
    squeezed = []
    errors = _state_errors(measured, fit, free, rank, quantity, r is not None)
    for data, error in zip(experiments, errors, strict=True):
        record = single(data.record)
        if isinstance(record, FrequencyRecord):
            nothing = np.zeros(0), np.zeros(0, complex), 0.0
            squeezed.append(FittedExperiment(record, *nothing, data.predicted[0, 0], background=data.background))
            continue
        motion = data.free_amplitudes[:, 0]
        # among several experiments a free motion has an input of 0
        record = replace(record, time=record.clock, driven=bool(record.u.any()))
        squeezed.append(FittedExperiment(
            record, state_of(fit.p[rank], motion, quantity, r), motion, float(data.offsets[0]), data.predicted[0],
            float(data.drifts[0]), initial_stderr=error, offset_stderr=float(data.offset_stderr[0]),
            noise_scale=data.noise_scale,
        ))  # fmt: skip
    return tuple(squeezed)


def _state_errors(
    projection: FreeProjection, fit: StructuredFit, free: FreeFit, rank: Indices, quantity: str, lossless: bool
) -> list[Array]:
    """Standard errors of the initial state in each experiment of one input and one output; NaN if it began at rest.

    Of lossless modes, `q + i p = conj(a) / (c d sqrt(r))` with the motion `a` and the weight `c` of the state in the
    output; else the state is the motion.
    """
    n, scale, state_errors, rows = len(fit.p), float(free.scales[0]), [], 0
    size = 2 * n if lossless else int(np.sum(np.where(fit.p.imag == 0, 1, 2)))
    for data in free.channels:
        seen = bool(data.observed.any()) and isinstance(data, Recording)
        moving = seen and projection.experiments[rows].moving and n > 0
        if not moving:
            state_errors.append(np.full(size * isinstance(data, Recording), np.nan))
        else:
            ((spread, crossed),) = _own_spreads(projection, fit, rows)
            if not lossless:
                each = 2 * scale * _roots(np.diag(spread)[: 2 * n].reshape(2, n).T)[rank]
                errors = each[np.stack([np.ones(n, bool), fit.p[rank].imag != 0], axis=1)]
            else:
                errors = _modal_state_errors(projection, fit, rows, spread, crossed, rank, scale, quantity)
            state_errors.append(data.unit * errors)
        rows += int(data.observed.any())
    return state_errors


def _modal_state_errors(
    projection: FreeProjection, fit: StructuredFit, rows: int, spread: Array, crossed: Array, rank: Indices,
    scale: float, quantity: str,
) -> Array:  # fmt: skip
    """Standard errors of `(q, p)` of lossless modes."""
    n, power, d = len(fit.p), POWERS[quantity], np.abs(fit.p)
    own, shared = projection.own[rows][:, 0], projection.shared[:, 0]
    per_weight = residue_of_unit_weight(d, power)
    r = (scale * (shared[:n] + 1j * shared[n : 2 * n]) / per_weight).real
    shown = r > 0
    gain = 1.0 / (output_weight(d, quantity)[0] * d * np.sqrt(np.where(shown, r, 1.0)))
    motion = 2 * scale * (own[:n] - 1j * own[n : 2 * n])
    state, l, width = gain * motion, np.arange(n), 2 * n + len(shared)
    T = np.zeros((n, width + len(own)), complex)
    T[l, l] = state / d * ((0.0, -1.0, -2.0)[power] + 0.5 * power)
    T[l, 2 * n + l] = -0.5 * state / np.where(shown, r, 1.0) * scale * (1 / per_weight).real
    T[l, 3 * n + l] = -0.5 * state / np.where(shown, r, 1.0) * scale * (1j / per_weight).real
    T[l, width + l], T[l, width + n + l] = 2 * scale * gain, -2j * scale * gain
    joint = np.block([[fit.covariance, crossed.T], [crossed, spread]])
    both = np.concatenate([T.real, T.imag])
    errors = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", both, joint, both), 0.0)).reshape(2, n)
    return np.where(shown, errors, np.nan)[:, rank].ravel()


# --- the judgement ---------------------------------------------------------------------------------------------------


def _in_model(finding: Finding, experiments: Sequence[FittedChannels]) -> Finding:
    """A finding of constants or drifts with the values that the model has."""
    if finding.cause not in (Cause.CONSTANT, Cause.DRIFT):
        return finding
    each = [experiment.offsets if finding.cause is Cause.CONSTANT else experiment.drifts for experiment in experiments]
    kept = [
        values[experiment.record.observed.any(axis=-1)] for values, experiment in zip(each, experiments, strict=True)
    ]
    return replace(finding, values=tuple(np.concatenate(kept).tolist()))


def _reversed(free: FreeFit, request: Request) -> list[Finding]:
    """Sensors at driving points that point against the force, by the residues of all modes in units of velocity."""
    projection, findings = free.projection, list[Finding]()
    if not (projection.inputs and free.order) or projection.deficiency:
        return findings
    residues, _ = _layout(free, request).split(projection.shared, len(projection.p))
    modes, labels = projection.p.imag > 0, free.channels[0].output_labels
    for output, driven in request.ports:
        power = POWERS.get(request.quantities[output])
        if power is not None:
            along = residues[modes, output, driven] * projection.p[modes] ** (1 - power)
            if np.all(along.real < -_OPPOSED * np.abs(along)):
                findings.append(Finding(Cause.POLARITY, (), 0.0, labels[output]))
    return findings


def _rejections(tests: tuple[HypothesisTest, ...]) -> list[Finding]:
    """What the data object to structures that they reject."""
    return [
        Finding(REJECTED[test.hypothesis], (test.p, float(test.dof)), 0.5 * test.likelihood_ratio)
        for test in tests if test.hypothesis in REJECTED and test.p < LEVEL
    ]  # fmt: skip


@dataclass(frozen=True)
class _Evidence:
    """What the judgement of a fit rests on.

    `fitted` is in per cent, `whiteness` the p-value of white residuals, `spare` the number of samples beyond that of
    the unknowns; `refused` says whether the data reject the structure that was given, and `blind` what the inputs do
    not show.
    """

    free: FreeFit
    tests: tuple[HypothesisTest, ...]
    findings: tuple[Finding, ...]
    fitted: float
    whiteness: float
    spare: int
    refused: bool
    blind: str

    def shows(self, cause: Cause) -> bool:
        """Whether there is a finding of a cause."""
        return any(finding.cause is cause for finding in self.findings)

    @property
    def outcome(self) -> Outcome:
        """The judgement; values far out of the noise and blind parameters cast doubt."""
        if self.free.interrupted:
            return Outcome.INTERRUPTED
        if not self.free.states:
            return Outcome.NOTHING
        if self.refused:
            near = self.fitted >= GOOD_FIT or self.whiteness >= WHITE
            return Outcome.DOUBTFUL if near else Outcome.NOT_DESCRIBED
        if self.whiteness < WHITE:
            return Outcome.COLOURED if self.fitted >= GOOD_FIT else Outcome.DOUBTFUL
        if self.blind or self.shows(Cause.OUTLIERS):
            return Outcome.DOUBTFUL
        return Outcome.CONSISTENT if self.spare >= 20 or self.free.rounding else Outcome.UNJUDGED


def _what_is_blind(
    experiments: Any, poles: ComplexArray, residues: ComplexArray, request: Request, free: FreeFit
) -> str:  # fmt: skip
    """Say what the inputs do not show, and of one record which input would."""
    data = experiments[0]
    if len(experiments) == 1 and isinstance(data, FittedExperiment) and np.all(poles.imag) and len(residues[0, 0]):
        record, n = data.record, len(poles)
        if isinstance(record, Record) and "free" not in request.quantities:
            hold = Hold(record.dt, free.method, free.intersample)
            y = np.where(record.observed, record.y, 0.0)
            rest = not data.free_amplitudes.any()
            port = PortRecord(record.u, y, record.observed, hold, rest, request.quantities[0], record.driven)
            shown = examine(port, np.abs(poles), np.ones(n), data.free_amplitudes.conj(), time_unit=record.time_unit)
            if shown.information.is_weak:
                return f"The record {shown.headline}. {shown.message}"
    return (
        "The inputs do not show the residues: others, with other initial motions, give the same outputs. Record with "
        "inputs of more frequencies, independent of one another; phc.excitation says which."
    )


def _message(evidence: _Evidence, poles: ComplexArray, covariance: Array, shapes: ModeShapes, most: int) -> str:
    """What the judgement rests on, in sentences."""
    free, outcome = evidence.free, evidence.outcome
    if outcome is Outcome.NOTHING:
        return "Nothing to model: no mode improves the BIC."
    parts = [CUT_SHORT] * (outcome is Outcome.INTERRUPTED)
    parts += [evidence.blind] * bool(evidence.blind)
    if outcome is Outcome.NOT_DESCRIBED:
        parts.append(f"With a fit of {evidence.fitted:.0f} % a model of this structure does not describe the data.")
    elif outcome is Outcome.DOUBTFUL and not evidence.blind:
        parts += _doubts(evidence, most)
    parts += [sentence_of(finding, free.intersample, free.channels[0].time_unit) for finding in evidence.findings]
    kept = [f"{test.hypothesis} ({p_value(test.p)})" for test in evidence.tests if test.p >= LEVEL and test.dof]
    if kept:
        parts.append(f"Not rejected: {', '.join(kept)}.")
    parts += _about_poles(poles, covariance, free)
    if shapes.shapes.shape[1] > 1:
        parts.append(
            "Mode shapes are those of unit modal mass."
            if shapes.scaled.all()
            else "Mode shapes are unscaled, as no driving point was named: the largest entry is 1."
        )
    return " ".join([*parts, _about_residuals(evidence)])


def _doubts(evidence: _Evidence, most: int) -> list[str]:
    """Why a fit is doubtful, and what may be done about it; `most` is the largest number of modes that was allowed."""
    if not (evidence.whiteness < WHITE and evidence.fitted < GOOD_FIT):
        outlying = evidence.shows(Cause.OUTLIERS)
        why = "some values are far out of the noise" if outlying else "the data reject the structure that was given"
        return [f"Doubtful, as {why}."]
    sentences = [
        f"Doubtful, as the fit is {evidence.fitted:.0f} %, less than {GOOD_FIT:.0f} %, and what is left is no white "
        "noise."
    ]
    if evidence.free.order == most and not evidence.shows(Cause.LARGEST_ORDER):
        sentences.append(f"A model of more than {counted(most, 'mode')} may fit better.")
    if not any(len(channel.input_labels) for channel in evidence.free.channels):
        sentences.append(
            "This is no free decay if forces that were not measured, such as wind or traffic, act all along: "
            "noise='forces' takes it as such, of recordings without missing samples and without a given structure."
        )
    return sentences


def _about_poles(poles: ComplexArray, covariance: Array, free: FreeFit) -> list[str]:
    """Say which poles grow, and which modes are slower than the longest record."""
    modes, sentences = int(np.sum(poles.imag != 0)), list[str]()
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    errors = np.append(spread[len(poles) :][:modes] * np.abs(poles[:modes]), spread[modes : len(poles)])
    growing = np.flatnonzero(poles.real > _CERTAIN * errors)
    if len(growing):
        grow = "grows" if len(growing) == 1 else "grow"
        sentences.append(f"{counted(len(growing), 'pole')} {grow}: {', '.join(map(str, growing + 1))}.")
    lengths = (channel.dt * channel.samples for channel in free.channels if isinstance(channel, Recording))
    slow = np.flatnonzero(np.abs(poles[:modes]) * max(lengths, default=np.inf) < 2 * np.pi * (1 - 1e-6))
    if len(slow):
        sentences.append(slower_than_record(slow.tolist()))
    return sentences


def _about_residuals(evidence: _Evidence) -> str:
    """Say whether what is left is white, or why this cannot be told."""
    if evidence.outcome is Outcome.UNJUDGED:
        return f"There are only {counted(evidence.spare, 'sample')} more than unknowns, too few to judge the model."
    if evidence.free.rounding and evidence.whiteness == 1:
        return "The data are reproduced to rounding."
    if evidence.whiteness < WHITE:
        remark = "something is left unexplained"
        if evidence.free.measured is not None:
            remark = "errors and tests are those of noise with their spectrum"
        return f"The residuals are not white (Ljung-Box {p_value(evidence.whiteness)}): {remark}."
    return f"The residuals are white{': the model explains the data' * (evidence.outcome is not Outcome.DOUBTFUL)}."
