"""From channels to a result: free residues, the structures that the data do not reject, parameters with errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ... import _checks
from ..._display import counted, p_value
from ..._types import Array, ComplexArray, Indices, NDArray
from ...exceptions import IdentificationError, StructureError
from ...modal.discretization import INTERSAMPLE
from ...modal.modal_form import ModalForm
from ..data.channels import Recording, ResponseMatrix, single
from ..data.frequency_record import FrequencyRecord
from ..data.parts import Difference, Signal, cut, searched_part
from ..data.quantities import checked_quantities
from ..diagnosis.coloured_noise import beside_coloured_noise
from ..diagnosis.outliers import outliers, saturation
from ..diagnosis.verdict import CUT_SHORT, GOOD_FIT, WHITE, HypothesisTest, Outcome, slower_than_record
from ..regression.free import FreeProjection, GivenResidues
from ..regression.free_prediction import FittedChannels, natural_jacobian
from ..regression.prediction import FittedExperiment, Pairs, joint_percent, pieces, shares_left
from ..regression.tuning import TUNING
from ..search.circumstances import REJECTED, Cause, Finding, sentence_of, worth_telling
from ..search.formulation import Callback, reporter
from ..search.modal_search import FreeFit, FreePath, feedthrough_of, free_fit
from ..structure.constrained import StructuredFit, constrained
from ..structure.hypothesis_tests import LEVEL, choose, structure_tests
from ..structure.layout import ChannelLayout
from ..uncertainty.residual_tests import ljung_box
from .damped_result import DampedResult
from .result import STRUCTURES, OrderRow, PEMResult, cut_short
from .scaled_shapes import ModeShapes, shape_errors

_BEGINNING = 1 << 15  # numbers of a part of a record that is asked for real poles
_CERTAIN = 3.0  # standard errors beyond which a mode is said to grow

Channels = tuple[Recording, ...] | tuple[ResponseMatrix, ...]


@dataclass(frozen=True)
class Asked:
    """What is asked of a fit of damped modes."""

    structure: str
    ports: tuple[tuple[int, int], ...]
    quantities: tuple[str, ...]
    assumed: bool = False  # whether the ports are those that a lossless fit takes for granted


@dataclass(frozen=True)
class Options:
    """Options of `pem` that fits of either kind have."""

    order: int | str
    intersample: str
    offset: bool | str
    max_order: int
    criterion: str
    callback: Callback | None
    moving: bool  # whether records may start in motion
    weighted: bool  # whether weights were given
    real_poles: int | str = "auto"


def fit_channels(
    channels: Channels, asked: Asked, options: Options, start: ComplexArray | None = None,
    findings: tuple[Finding, ...] = (),
) -> DampedResult:  # fmt: skip
    """Free residues first, then the structure that is asked for, or the simplest that is not rejected."""
    _refuse_still(channels)
    order, offset = options.order, options.offset
    wanted = order if isinstance(order, str) else _checks.whole_number("order", order, 1)
    if isinstance(wanted, str) and wanted != "auto":
        raise StructureError(f"order is {wanted!r}; it must be 'auto' or a whole number of at least 1")
    _checks.choice("intersample", options.intersample, ("auto", *INTERSAMPLE))
    if not isinstance(offset, str) or offset != "auto":
        _checks.flags(offset=offset)
    most = _checks.whole_number("max_order", options.max_order, 1)
    checked_real_poles(options.real_poles)
    search = partial(
        free_fit, channels, quantities=asked.quantities, intersample=options.intersample, offset=offset,
        max_order=most, criterion=options.criterion, weighted=options.weighted,
        real_poles=options.real_poles,
        reports=reporter(most if isinstance(wanted, str) else wanted, options.callback),
    )  # fmt: skip
    # before a hammer hits, few samples show the motion there was, and what is unknown of it hides the residues
    resting = options.moving and begin_at_rest(channels)
    free = search(wanted, start=start, moving=options.moving and not resting)
    if resting and free.order and not free.interrupted:
        other = search(free.order, start=free.projection.p, moving=True)
        if other.criteria.bic < free.criteria.bic:
            free = search(wanted, start=start, moving=True)
    return under_either_hold(free, asked, findings)


def shows_real_poles(channels: Channels, asked: Asked, options: Options) -> bool:
    """Whether the beginning of each record has real poles beside its modes, or is asked for them."""
    if options.real_poles != "auto" or options.order != "auto":
        return options.real_poles not in ("auto", 0)
    _refuse_still(channels)
    parts: Any = [cut(one, searched_part(one, not options.moving, _BEGINNING)) for one in channels]
    path = FreePath.of(
        parts, asked.quantities, options.intersample, int(bool(options.offset)), options.moving
    )  # fmt: skip
    try:
        # a first look, which most plants without real poles end with
        if not path.carried or not np.any(path.grown(np.zeros(0, complex), options.max_order, True).p.imag == 0):
            return False
        found = free_fit(
            parts, quantities=asked.quantities, intersample=options.intersample, offset=options.offset,
            moving=options.moving, max_order=options.max_order, criterion="bic",
        )  # fmt: skip
    except IdentificationError:
        return False
    if found.interrupted and not np.any(found.projection.p.imag == 0):
        raise KeyboardInterrupt
    return bool(np.any(found.projection.p.imag == 0))


def checked_real_poles(value: int | str) -> int | str:
    """Check the number of real poles that is asked for."""
    if isinstance(value, str):
        return _checks.choice("real_poles", value, ("auto",))
    return _checks.whole_number("real_poles", value, 0)


def begin_at_rest(channels: Channels) -> bool:
    """Whether all experiments are recordings that begin at rest, by what is seen of the outputs."""
    return all(isinstance(one, Recording) and one.begins_at_rest for one in channels)


def under_either_hold(free: FreeFit, asked: Asked, findings: tuple[Finding, ...] = ()) -> DampedResult:
    """The structure of a fit, with the inputs held as it tells; in rows of white noise where that of the data is not.

    Free residues and a feedthrough are the same models under either hold; only structures tell the two apart.
    """
    found = _under_either_hold(free, asked, findings)
    if found.whiteness >= WHITE or not found.success:
        return found
    try:
        whitened = beside_coloured_noise(free)
        if whitened is free:
            return found
        rival = None if free.rival is None else beside_coloured_noise(free.rival)
    except KeyboardInterrupt:
        return cut_short(found)
    return _under_either_hold(replace(whitened, rival=rival), asked, findings)


def _under_either_hold(free: FreeFit, asked: Asked, findings: tuple[Finding, ...]) -> DampedResult:
    """The same in the rows there are.

    Where no structure stands under either hold, as neither is exact, it is the one under which shapes are more nearly
    real.
    """
    try:
        first = _structure_of(free, asked)
    except KeyboardInterrupt:
        return structured(replace(free, interrupted=True), asked, findings)
    anew = {one.cause for one in free.findings}
    findings = (*(one for one in findings if one.cause not in anew), *free.findings)
    settled = STRUCTURES[:2] if asked.structure == "auto" else ("free",)
    if free.rival is None or first[0].structure in settled:
        return _result(free, *first, asked, findings)
    try:
        if asked.structure == "auto":
            simpler = STRUCTURES[: STRUCTURES.index(first[0].structure)]
            chosen, tests = _tested(free.rival, asked, simpler)
            gain = _classical_cost(free, first[1]) - _classical_cost(free.rival, tests)
            if chosen.structure not in simpler and (first[0].structure != "free" or gain <= 2 * TUNING.sure):
                return _result(free, *first, asked, findings)
        second = _structure_of(free.rival, asked)
    except KeyboardInterrupt:
        return cut_short(_result(free, *first, asked, findings))
    if asked.structure == "auto":
        return _result(free.rival, *second, asked, findings)
    found, other = _result(free, *first, asked, findings), _result(free.rival, *second, asked, findings)
    return other if other.loglik > found.loglik + TUNING.sure else found


def _classical_cost(free: FreeFit, tests: tuple[HypothesisTest, ...]) -> float:
    """Criterion of the classical model of a fit, short of its unknowns; that of the fit itself where it has none."""
    return free.criteria.bic + sum(one.likelihood_ratio for one in tests if one.hypothesis == "classical")


def structured(free: FreeFit, asked: Asked, findings: tuple[Finding, ...] = ()) -> DampedResult:
    """The same with the inputs held as they are."""
    return _result(free, *_structure_of(free, asked), asked, (*findings, *free.findings))


def _layout(free: FreeFit, asked: Asked) -> ChannelLayout:
    first = free.channels[0]
    return ChannelLayout(
        len(first.output_labels), len(first.input_labels), free.scales, asked.quantities, asked.ports,
        per_entry=free.per_entry,
    )  # fmt: skip


def _tested(
    free: FreeFit, asked: Asked, among: tuple[str, ...] | None = None
) -> tuple[StructuredFit, tuple[HypothesisTest, ...]]:
    """The simplest structure that is not rejected, and the tests of all, or of those `among` some."""
    found = structure_tests(free.projection, _layout(free, asked), free.region, among)
    return choose(found), found.tests


def _structure_of(free: FreeFit, asked: Asked) -> tuple[StructuredFit, tuple[HypothesisTest, ...]]:
    """The structure that is asked for, or the simplest that is not rejected, and the tests of all."""
    layout = _layout(free, asked)
    if not free.order:
        return _without_modes(free), ()
    if asked.structure == "auto" and free.interrupted:
        return constrained(free.projection, layout, "free", free.region), ()
    if asked.structure == "auto":
        return _tested(free, asked)
    return constrained(free.projection, layout, asked.structure, free.region, 1 if free.interrupted else None), ()


def _refuse_still(channels: Channels) -> None:
    """Refuse outputs that are zero, and inputs whose response cannot be told from a free motion."""
    for k, label in enumerate(channels[0].output_labels):
        values = [one.y[k] if isinstance(one, Recording) else one.response[k] for one in channels]
        if not any(np.any((one != 0) & (one == one)) for one in values):
            raise IdentificationError(f"output {label!r} is zero throughout; there is nothing to model: leave it out")
    recordings = [one for one in channels if isinstance(one, Recording)]
    for k, label in enumerate(channels[0].input_labels if recordings else ()):
        if all(np.all(one.u[k] == one.u[k, 0]) for one in recordings):
            raise IdentificationError(
                f"input {label!r} is constant in every experiment, so that no response to it can be told from a free "
                "motion: leave it out, or pass (None, y) if nothing drove the outputs"
            )


def _without_modes(free: FreeFit) -> StructuredFit:
    """A fit without modes: what is fed through, and constants."""
    at, entries = free.projection, (len(free.channels[0].output_labels), len(free.channels[0].input_labels))
    none = np.zeros((0, *entries), complex)
    return StructuredFit(
        "free",
        "free",
        np.zeros(0, complex),
        none,
        feedthrough_of(free),
        None,
        None,
        at.loss,
        at.unknowns,
        free.variance,
        at,
        True,
        at,
    )


# --- what is asked ---------------------------------------------------------------------------------------------------


def asked_of(channels: Channels, structure: str, ports: Any, quantity: Any) -> Asked:
    """What is asked of a fit to these channels, checked."""
    outputs, inputs = channels[0].output_labels, channels[0].input_labels
    quantities = checked_quantities(quantity, outputs)
    # a sensor of another kind has no power with the input
    assumed = ports is None and len(outputs) == len(inputs) == 1 and quantities != ("free",)
    pairs = ((0, 0),) if assumed else () if ports is None else _checks.port_pairs(ports, outputs, inputs)
    if structure == "passive" and not pairs:
        raise StructureError("structure='passive' needs driving points: name them, ports=[(output, input), ..]")
    return Asked(structure, pairs, quantities, assumed)


def starting_poles(guess: Any) -> ComplexArray | None:
    """Poles to start from."""
    if guess is None:
        return None
    if isinstance(guess, PEMResult):
        return np.asarray(guess.poles)
    form = guess if isinstance(guess, ModalForm) else getattr(guess, "modes", None)
    if not isinstance(form, ModalForm):
        raise StructureError(
            f"initial_guess is a {type(guess).__name__}; for damped modes pass a result, a ModalForm or a system"
        )
    poles = np.asarray(form.mode_poles)
    return poles[poles.imag > 0]


# --- the result ------------------------------------------------------------------------------------------------------


def _result(
    free: FreeFit, fit: StructuredFit, tests: tuple[HypothesisTest, ...], asked: Asked, findings: tuple[Finding, ...]
) -> DampedResult:
    """The result of a fit, of one that is interrupted here without what is looked for beside the modes."""
    try:
        return _judged(free, fit, tests, asked, findings)
    except KeyboardInterrupt:
        return _judged(replace(free, interrupted=True), fit, tests, asked, findings)


def _judged(
    free: FreeFit, fit: StructuredFit, tests: tuple[HypothesisTest, ...], asked: Asked, findings: tuple[Finding, ...]
) -> DampedResult:
    """Parameters, experiments and judgement of a fit."""
    rank = np.lexsort((np.abs(fit.p), fit.p.imag == 0))
    poles = fit.p[rank]
    modes = int(np.sum(poles.imag != 0))
    residues = fit.residues[rank] * np.where(poles.imag == 0, 2.0, 1.0)[:, None, None]
    covariance = _covariance(fit, free, rank)
    experiments = _experiments(_in_data(fit, free), free, rank)
    shapes, errors = _shapes(fit, free, asked, poles, residues, covariance, experiments, rank)
    extra = fit.parameters - (len(free.projection.x) + int(free.projection.shown.sum()))
    unknowns = free.unknowns + min(0, extra) + len(free.scales)
    predicted = [(one.record, one.predicted) for one in experiments]
    counts, losses = _losses(predicted, free.per_entry)
    floor = np.maximum(losses, np.finfo(float).tiny * np.maximum(counts, 1))
    known = counts > 0
    variances = floor / np.maximum(counts, 1)
    loglik = float(-0.5 * np.sum(counts[known] * (np.log(2 * np.pi * variances[known]) + 1)))
    if free.noise:  # that of the innovations, less what a structure costs
        loglik = free.criteria.loglik - 0.5 * (fit.loss - free.projection.loss) / free.variance
    samples = int(counts.sum())
    spare = max(1, samples - unknowns)
    rows = [row for one in experiments for row in _rows(one)]
    whiteness = 1.0 if free.rounding else ljung_box(rows, TUNING.lags)
    fitted = joint_percent(shares_left(predicted))
    told = (one for one in findings if one.cause is not Cause.HOLD)  # of lossless models
    findings = (*told, *(_rejection(one) for one in tests if one.hypothesis in REJECTED and one.p < LEVEL))
    findings = (*findings, *_saturated(experiments))
    if whiteness >= WHITE and not (free.rounding or free.interrupted):
        findings = (*findings, *_outliers(experiments, spare))
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    errors_of_decay = np.append(spread[len(poles) :][:modes] * np.abs(poles[:modes]), spread[modes : len(poles)])
    growing = np.flatnonzero(poles.real > _CERTAIN * errors_of_decay)
    length = max((one.dt * one.samples for one in free.channels if isinstance(one, Recording)), default=np.inf)
    slow = np.flatnonzero(np.abs(poles[:modes]) * length < 2 * np.pi * (1 - 1e-6))
    single = residues.shape[1] == 1 and residues.shape[2] <= 1
    shown = tuple(_squeezed(one, poles) for one in experiments) if single else experiments
    far = any(one.cause is Cause.OUTLIERS for one in findings)
    outcome = _outcome(free, fitted, whiteness, spare, far)
    return DampedResult(
        structure=fit.structure,
        poles=poles,
        residues=residues,
        feedthrough=fit.feedthrough,
        covariance=covariance,
        shapes=shapes.shapes,
        participation=shapes.participation,
        shape_stderr=errors,
        shapes_scaled=bool(shapes.scaled.all() and len(shapes.scaled)),
        ports=asked.ports,
        quantities=asked.quantities,
        noise_variance=(variances * samples / spare).reshape(fit.feedthrough.shape[: 1 + free.per_entry]),
        experiments=shown,
        loss=float(fit.loss / samples),
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
        outcome=outcome,
        message=_message(free, growing, slow, tests, findings, shapes, fitted, whiteness, outcome),
        intersample="zoh" if free.per_entry else free.intersample,
    )  # fmt: skip


def _covariance(fit: StructuredFit, free: FreeFit, rank: Indices) -> Array:
    """From the coordinates of the projection to those of a result, NaN for what leaves no trace."""
    n, at = len(fit.p), fit.projection
    width, count = at.shared.shape[0] if at.shared.size else 0, len(free.scales)
    places = (2 * n + np.arange(width * count)).reshape(count, width).T
    scales = np.broadcast_to(free.scales, (width, count))
    inputs = 0 if not width else at.inputs
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
    seen = split(at.shown.astype(float))
    lost = np.concatenate([np.zeros(2 * n), *((part == 0).ravel() for part in (seen[0][rank], seen[1][rank], seen[2]))])
    given = fit.covariance if n else at.covariance(fit.variance)
    J, inner = natural_jacobian(fit.p), given.copy()
    inner[: 2 * n] = J @ inner[: 2 * n]
    inner[:, : 2 * n] = inner[:, : 2 * n] @ J.T
    inner = 0.5 * (inner + inner.T)  # but for rounding
    size = np.concatenate(unit)
    twice = np.where(fit.p[rank].imag == 0, 2.0, 1.0).repeat(int(np.prod(entries)))
    size[2 * n :][: 2 * len(twice)] *= np.tile(twice, 2)  # a real pole has its residue in two halves
    if not inner.size:
        return np.full((len(order), len(order)), np.nan)
    found = inner[np.ix_(order, order)] * np.outer(size, size)
    # a structure may tell of residues that no experiment shows
    absent = (order < 0) | ((lost > 0) & (np.diag(found) == 0))
    found[absent] = np.nan
    found[:, absent] = np.nan
    return found


def _in_data(fit: StructuredFit, free: FreeFit) -> FreeProjection:
    """The data as they were measured at a model, also at one that was fitted in other rows."""
    if free.measured is None:
        return fit.projection
    at = FreeProjection(free.measured.experiments, fit.p, free.measured.fed)
    return GivenResidues(at, fit.projection.shared)


def _experiments(at: FreeProjection, free: FreeFit, rank: Indices) -> tuple[FittedChannels, ...]:
    """Predictions, free motions and offsets of each experiment, from the rows of its outputs."""
    n, found = len(at.p), []
    rows = iter(zip(at.experiments, at.own, at.predictions() if n else [None] * len(at.experiments), strict=True))
    for one in free.channels:
        p, m, outputs = len(one.output_labels), len(one.input_labels), len(free.scales)
        in_time = isinstance(one, Recording)
        seen = one.observed.reshape(outputs, -1).any(axis=1)
        left = int(seen.sum())
        predicted: NDArray[Any] = np.empty((outputs, one.samples), float if in_time else complex)
        predicted[~seen] = np.nan
        motion, offsets, drifts = np.zeros((n, outputs), complex), np.zeros(outputs), np.zeros(outputs)
        while left > 0:
            part, own, values = next(rows)
            which = part.outputs
            scale = free.scales[which]
            left -= len(which)
            terms = getattr(part, "offset", 0)
            if part.moving:
                motion[:, which] = 2 * scale * (own[:n] + 1j * own[n : 2 * n])[rank]
            offsets[which] = scale * own[-1] if terms else 0.0
            drifts[which] = scale * own[-2] / one.dt if terms > 1 else 0.0
            if values is None:
                predicted[which] = offsets[which, None]
            elif len(which) == outputs:
                predicted = np.multiply(values, scale[:, None], out=values)
            else:
                predicted[which] = values * scale[:, None]
        if in_time:
            found.append(FittedChannels(one, motion, offsets, drifts, predicted))
        else:
            nothing = np.zeros((n, 0), complex), np.zeros(p), np.zeros(p)
            found.append(FittedChannels(one, *nothing, predicted.reshape(p, m, one.samples)))
    return tuple(found)


def _losses(predicted: Pairs, per_entry: bool) -> tuple[Array, Array]:
    """Real residuals, and sums of their weighted squares, of each output or entry."""
    counts = sum(record.observed.sum(axis=-1) * (1 + per_entry) for record, _ in predicted)
    losses = sum(np.sum(weights * np.abs(left) ** 2, axis=-1) for weights, _, left in pieces(predicted))
    return np.ravel(counts), np.ravel(losses)


def _left(one: FittedChannels) -> dict[str, Signal]:
    """Residuals by label of the output, or of the entry of a response, where they are weighted; of those measured."""
    outputs, inputs = one.record.output_labels, one.record.input_labels
    if isinstance(one.record, Recording):
        seen = np.flatnonzero(one.record.observed.any(axis=1)).tolist()
        return {outputs[k]: Difference(one.measured[k], one.predicted[k]) for k in seen}
    left = one.residuals * np.sqrt(one.record.weights)
    entries = [
        (f"{o}:{i}", row) for o, rows in zip(outputs, left, strict=True) for i, row in zip(inputs, rows, strict=True)
    ]
    return {label: row for label, row in entries if not np.isnan(row).all()}


def _rows(one: FittedChannels) -> list[Signal]:
    """Real residuals of each output, or real and imaginary parts of those of each entry of a response."""
    left = list(_left(one).values())
    return left if isinstance(one.record, Recording) else [part for row in left for part in (row[:].real, row[:].imag)]


def _saturated(experiments: Sequence[FittedChannels]) -> list[Finding]:
    """Outputs of recordings that stay at an end of their range."""
    every = [(k, one.record) for k, one in enumerate(experiments) if isinstance(one.record, Recording)]
    ends = [(k, name, saturation(row)) for k, one in every for name, row in zip(one.output_labels, one.y, strict=True)]
    return [Finding(Cause.SATURATION, (float(count), *of), 0.0, name, k) for k, name, (count, of) in ends if count]


def _outliers(experiments: Sequence[FittedChannels], spare: int) -> list[Finding]:
    """Values that stand out of the noise of all others of their output and experiment."""
    every = [(label, k, row) for k, one in enumerate(experiments) for label, row in _left(one).items()]
    pairs = zip(every, outliers([row for *_, row in every], spare), strict=True)
    return [Finding(Cause.OUTLIERS, tuple(map(float, far)), 0.0, label, k) for (label, k, _), far in pairs if far]


def _shapes(
    fit: StructuredFit, free: FreeFit, asked: Asked, poles: ComplexArray, residues: ComplexArray, covariance: Array,
    experiments: tuple[FittedChannels, ...], rank: Indices,
) -> tuple[ModeShapes, ComplexArray]:  # fmt: skip
    """Shapes with their standard errors: of residues, or of a free motion."""
    n, (_, p, m) = int(np.sum(poles.imag != 0)), residues.shape
    count, size = len(poles), residues.size
    poles, residues = poles[:n], residues[:n]
    # a port that was not told stands only where the structure does
    ports = () if asked.assumed and fit.structure == "free" else asked.ports
    if m:
        shapes = ModeShapes.of(poles, residues, asked.quantities, ports)
        entries = np.arange(n * p * m).reshape(n, p * m)
        places = [[l, count + l, *(2 * count + entries[l]), *(2 * count + size + entries[l])] for l in range(n)]
        blocks = [np.nan_to_num(covariance[np.ix_(one, one)]) for one in places]
        return shapes, shape_errors(poles, residues, asked.quantities, ports, blocks)
    motions = np.stack([one.free_amplitudes[:n] for one in experiments], axis=2)
    shapes = ModeShapes.of(poles, motions, asked.quantities, ())
    shapes = ModeShapes(shapes.shapes, np.zeros((n, 0), complex), shapes.scaled)
    return shapes, shape_errors(poles, motions, asked.quantities, (), _motion_covariances(fit, free, rank)[:n])


def _motion_covariances(fit: StructuredFit, free: FreeFit, rank: Indices) -> list[Array]:
    """Covariance of `(d, zeta, Re, Im of the free motions)` of each mode, outputs by experiments."""
    n, at, count, runs = len(fit.p), fit.projection, len(free.scales), len(free.channels)
    J = natural_jacobian(fit.p)
    found = []
    inner = fit.covariance[: 2 * n, : 2 * n]
    place, left = -1, 0
    by: dict[int, list[tuple[int, int, Array, Array]]] = {l: [] for l in range(n)}
    for k, rows in enumerate(at.experiments):
        while left <= 0:
            place += 1
            left = int(free.channels[place].observed.any(axis=-1).sum())
        left -= len(rows.outputs)
        for o, (spread, by_poles) in zip(rows.outputs.tolist(), at.motions(k), strict=True):
            scale = 2 * free.scales[o]
            for l in range(n):
                both = [l, n + l]
                by[l].append((o, place, scale**2 * spread[np.ix_(both, both)], scale * by_poles[both]))
    for l in rank.tolist():
        size = count * runs
        total = np.zeros((2 + 2 * size, 2 + 2 * size))
        along = np.zeros((2 + 2 * size, 2 * n))
        along[:2] = J[[l, n + l]]
        for o, e, spread, slope in by[l]:
            both = [2 + o * runs + e, 2 + size + o * runs + e]
            along[both] = slope
            total[np.ix_(both, both)] += spread * free.variance
        found.append(total + along @ inner @ along.T)
    return found


def _squeezed(one: FittedChannels, poles: ComplexArray) -> Any:
    """An experiment of one input and one output as one of a lossless fit."""
    kept_of = np.stack([poles == poles, poles.imag != 0], axis=1)
    kept = single(one.record)
    if isinstance(kept, FrequencyRecord):
        return FittedExperiment(kept, np.zeros(0), np.zeros(0, complex), 0.0, one.predicted[0, 0])
    motion = one.free_amplitudes[:, 0]
    state = np.stack([motion.real, motion.imag], axis=1)[kept_of]
    # among several experiments a free motion has an input of 0
    kept = replace(kept, time=kept.clock, driven=bool(kept.u.any()))
    return FittedExperiment(kept, state, motion, float(one.offsets[0]), one.predicted[0], float(one.drifts[0]))


# --- the judgement ---------------------------------------------------------------------------------------------------


def _rejection(test: HypothesisTest) -> Finding:
    return Finding(REJECTED[test.hypothesis], (test.p, float(test.dof)), 0.5 * test.likelihood_ratio)


def _outcome(free: FreeFit, fitted: float, whiteness: float, spare: int, far: bool) -> Outcome:
    if free.interrupted:
        return Outcome.INTERRUPTED
    if not free.order:
        return Outcome.NOTHING
    if whiteness < WHITE:
        return Outcome.COLOURED if fitted >= GOOD_FIT else Outcome.DOUBTFUL
    if far:
        return Outcome.DOUBTFUL
    return Outcome.CONSISTENT if spare >= 20 or free.rounding else Outcome.UNJUDGED


def _message(
    free: FreeFit, growing: Indices, slow: Indices, tests: tuple[HypothesisTest, ...], findings: tuple[Finding, ...],
    shapes: ModeShapes, fitted: float, whiteness: float, outcome: Outcome,
) -> str:  # fmt: skip
    """What the judgement rests on, in sentences."""
    if outcome is Outcome.NOTHING:
        return "Nothing to model: no mode improves the BIC."
    parts = [CUT_SHORT] * (outcome is Outcome.INTERRUPTED)
    if outcome is Outcome.DOUBTFUL:
        why = "some values are far out of the noise"
        if whiteness < WHITE:
            why = f"the fit is {fitted:.0f} %, less than {GOOD_FIT:.0f} %, and what is left is no white noise"
        parts.append(f"Doubtful, as {why}.")
        if whiteness < WHITE and not any(len(one.input_labels) for one in free.channels):
            parts.append(
                "This is no free decay if forces that were not measured, such as wind or traffic, act all along: "
                "record a decay or the forces, or use a program for ambient excitation."
            )
    unit = free.channels[0].time_unit
    told = [one for one in findings if worth_telling(one, free.intersample)]
    parts += [sentence_of(one, free.intersample, unit, removed=True) for one in told]
    kept = [one for one in tests if one.p >= LEVEL and one.dof]
    if kept:
        parts.append("Not rejected: " + ", ".join(f"{one.hypothesis} ({p_value(one.p)})" for one in kept) + ".")
    if len(growing):
        grow = "grows" if len(growing) == 1 else "grow"
        parts.append(f"{counted(len(growing), 'pole')} {grow}: {', '.join(map(str, growing + 1))}.")
    if len(slow):
        parts.append(slower_than_record(slow.tolist()))
    if shapes.shapes.shape[1] > 1:
        parts.append(
            "Mode shapes are those of unit modal mass."
            if shapes.scaled.all()
            else "Mode shapes are unscaled, as no driving point was named: the largest entry is 1."
        )
    if free.rounding:
        parts.append("The data are reproduced to rounding.")
    elif whiteness < WHITE:
        left = "something is left unexplained"
        if free.measured is not None:
            left = "errors and tests are those of noise with their spectrum"
        parts.append(f"The residuals are not white (Ljung-Box {p_value(whiteness)}): {left}.")
    else:
        more = ": the model explains the data" * (outcome is not Outcome.DOUBTFUL)
        parts.append(f"The residuals are white{more}.")
    return " ".join(parts)
