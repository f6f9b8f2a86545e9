"""From a minimum to a result: modes sorted, parameters and their errors in the user's terms, and a judgement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..._types import Array, NDArray
from ..._units import common_unit
from ...modal.modal_form import ModalForm
from ...systems.port_hamiltonian import PortHamiltonian
from ..data.frequency_record import FrequencyRecord
from ..data.parts import Signal
from ..data.time_record import Record
from ..diagnosis.circumstance_tests import NOISE, circumstances_of
from ..diagnosis.damping import REFUSED, beside, contradiction, is_crowded, lossless_test, sentence, standing_out
from ..diagnosis.fitted_directions import Directions, of_record, of_response
from ..diagnosis.outliers import outliers, without
from ..diagnosis.verdict import SOUND, WHITE, FitVerdict, HypothesisTest
from ..excitation.excitation import examine_fit
from ..regression.prediction import FittedExperiment, joint_percent, shares_left, state_from_amplitudes
from ..regression.time_rows import RecordRows
from ..regression.tuning import TUNING
from ..regression.variable_projection import LAST, Problem, Projection, refine
from ..search.circumstances import HOLDS, Cause, Finding, is_contrary, meeting, sentence_of, worth_telling
from ..search.criteria import criteria, criteria_of
from ..search.modal_search import FreeFit, Reports
from ..search.response_noise import NoiseLaw, record_law
from ..uncertainty.covariance import uncertainty
from ..uncertainty.fisher import Information, information_at, listed
from ..uncertainty.residual_data import without_peaks
from ..uncertainty.residual_tests import ljung_box
from .damped_result import DampedModel
from .lossless_result import LosslessResult
from .modal_fit import Asked, structured

Records = tuple[Record, ...] | tuple[FrequencyRecord, ...]

_EVIDENT = 10.0  # log-likelihood by which errors of measurement have to explain more than damping
_COUNTED = 400_000  # samples times unknowns up to which these are felt by the test of whiteness, and cheap


@dataclass(frozen=True)
class Fit:
    """Data, problem and minimum; the order that was asked for."""

    records: Records
    problem: Problem
    found: Any
    order: int
    order_given: bool
    at_limit: bool
    most: int
    free: FreeFit | None = None
    damped: DampedModel | None = None
    tests: tuple[HypothesisTest, ...] = ()
    examined: bool = False
    law: NoiseLaw | None = None
    criterion: str = "bic"
    reports: Reports = lambda order: None


@dataclass(frozen=True)
class Conclusion:
    """A result, the damped modes that contradict it, and what the data do not show, if anything, in a sentence."""

    result: LosslessResult
    free: FreeFit | None
    blind: str


def conclude(fit: Fit, method: str, intersample: str, quantity: str, representation: str) -> Conclusion:
    """Make the result of a fit."""
    followed = fit.found.followed
    if followed is not None and followed.plain and not (fit.examined or fit.found.interrupted):
        fit = _examined(fit, fit.found.end.projection.ascending, True, (), (), quantity)
    problem, found = fit.problem, fit.found
    at: Projection = found.end.projection.ascending
    n = len(at.d)
    modes = _modes(at, fit.order)
    experiments = _experiments(fit.records, at, modes, quantity)
    estimated = uncertainty(at, fit.order, quantity)
    noiseless = at.loss <= found.floor
    whiteness = 1.0 if noiseless else _whiteness(experiments, at)
    weights = [
        one.record.weights[one.record.observed] for one in experiments if isinstance(one.record, FrequencyRecord)
    ]
    fitted = joint_percent(shares_left([(one.record, one.predicted) for one in experiments]))
    held = ~at.free
    contradicted = sentence(fit.damped) if fit.damped else ""
    findings = circumstances_of(found.posed.findings, at, experiments, 1.0 if contradicted else whiteness)
    spare = problem.samples - problem.unknowns(n)
    if not noiseless:
        scaled = [
            one.residuals * np.sqrt(one.record.weights) if isinstance(one.record, FrequencyRecord) else one.left
            for one in experiments
        ]
        found_out = outliers(scaled, spare)
        experiments = tuple(replace(one, outliers=k) for one, k in zip(experiments, found_out, strict=True))
    if not (fit.examined or noiseless or found.interrupted):
        doubtful = whiteness < WHITE or (held.any() and problem.driven) or is_crowded(at)
        fit = _examined(fit, at, bool(doubtful), findings, [one.outliers for one in experiments], quantity)
        if fit.found is not found:
            return conclude(fit, method, fit.found.posed.intersample, quantity, representation)
        contradicted = sentence(fit.damped) if fit.damped else ""
    if contradicted:
        findings = tuple(one for one in findings if one.cause not in NOISE)
    law = record_law(fit.records, estimated.variance, fit.law)
    information = information_at(at)
    figures = criteria(problem, at.loss, n)
    # a mode held at 0 in a frequency response has no trace left: that is the constraint's doing, not the input's
    blind = set(information.blind_parameters) - {f"d_{l + 1}" for l in np.flatnonzero(held)}
    unit = common_unit(list(fit.records))
    finding = _finding(at, information, estimated.variance, unit) if n and (blind or not information.deficiency) else ""
    named = any(is_contrary(one, intersample) for one in findings)
    refused = next((one for one in fit.tests if one.p < REFUSED), None)
    verdict = FitVerdict(
        n=n,
        order=fit.order,
        spare=spare,
        fit_percent=fitted,
        active=tuple(int(l) for l in np.flatnonzero(held)) if problem.driven else (),
        blind=finding if n and information.deficiency else "",
        remark=finding if n and not information.deficiency else "",
        whiteness=whiteness,
        converged=found.end.converged,
        noiseless=noiseless,
        at_limit=fit.at_limit,
        order_given=fit.order_given,
        from_rest=any(isinstance(one, RecordRows) and one.from_rest for one in problem.experiments),
        silent=not at.kappa.any(),
        reversed_sign=n > 0 and not (named or at.kappa.any()) and at.asks_for_negative_residues_only(),
        drifting=tuple(int(l) for l in np.flatnonzero(at.d < problem.bin * (1 - 1e-6)) if held[l]),
        interrupted=found.interrupted,
        driven=problem.driven,
        contradiction=contradicted,
        refused=refused,
        quantity=quantity,
        in_time=isinstance(problem.experiments[0], RecordRows),
        alike=bool(weights) and fit.law is None and all(np.ptp(one) == 0 for one in weights),
        share=law.share,
        circumstances=tuple(sentence_of(one, intersample) for one in findings if worth_telling(one, intersample)),
        explained=refused is None and any(one.cause in NOISE for one in findings),
        named=named,
        outliers=tuple(one.outliers for one in experiments),
    )
    result = LosslessResult(
        system=_named_system(modes, fit.records[0]),
        experiments=experiments,
        covariance=estimated.covariance,
        offset_stderr=estimated.offsets,
        noise_variance=estimated.variance,
        noise=law,
        loss=at.loss / problem.samples,
        loglik=figures.loglik,
        aic=figures.aic,
        bic=figures.bic,
        fit_percent=verdict.fit_percent,
        active=verdict.active,
        unseen=tuple(range(n, fit.order)),
        identifiability=information,
        whiteness=verdict.whiteness,
        order_table=found.rows,
        starts=found.starts,
        success=found.end.converged and not found.interrupted,
        outcome=verdict.outcome,
        message=verdict.message(),
        n_iterations=found.iterations,
        method=method,
        intersample=intersample,
        quantity=quantity,
        representation=representation,
        findings=findings,
        tests=fit.tests,
        damped=fit.damped,
    )
    # next to a crowded pair damped modes were looked for, too, and need not contradict it
    sound = fit.free is not None and fit.free.order >= n and verdict.outcome in SOUND
    return Conclusion(result, None if sound else fit.free, verdict.blind)


def _examined(
    fit: Fit, at: Projection, doubtful: bool, findings: Sequence[Finding], far: Sequence[tuple[int, ...]],
    quantity: str,
) -> Fit:  # fmt: skip
    """The fit with what contradicts it, and then at the minimum next to the frequencies of the plant.

    From elsewhere lossless modes do not come there: they mimic its damping, or flee from a residue whose sign they
    cannot have.  Where another arrival of the input explains the record, it is a fit with this one that is tested.
    Samples far out of the noise do not speak against it where errors in them explain more than damped modes do, nor do
    fewer damped modes that leave more.
    """
    posed, followed, problem = fit.found.posed, fit.found.followed, fit.problem
    tested = at if posed.searched is None else fit.found.explained
    noise = next((one for one in findings if one.cause in NOISE), None)
    test = lossless_test(tested.problem, tested, noise)
    fit = replace(fit, tests=() if test is None else (test,), examined=True)
    refused = test is not None and test.p < REFUSED
    if not (refused or followed is not None or (doubtful and noise is None and posed.searched is None)):
        return fit
    held = posed.searched is None and ("hold" in posed.open or any(one.cause is Cause.HOLD for one in findings))
    order = fit.order if fit.order_given else None
    free = contradiction(
        problem, at, fit.records, order=order, most=fit.most, followed=followed, either_hold=held,
        criterion=fit.criterion, reports=fit.reports,
    )  # fmt: skip
    if free is None:
        return fit
    if free.interrupted:
        return replace(fit, free=free, found=replace(fit.found, interrupted=True))
    model = _damped_model(free, quantity)
    chosen = problem if free.intersample == posed.intersample or not held else meeting(problem, free.intersample)
    # a mode with damping may show at a single point: what it has more than one without is not charged for
    damped = criteria(problem, model.loss * problem.samples, model.order).bic
    if refused and followed is None and posed.searched is None and any(far):
        spared, bic = _beside_errors(at, far)
        if spared is not None and spared.p >= REFUSED and damped - bic > 2 * _EVIDENT:
            return replace(fit, tests=(spared,))
    fewer = order is None and followed is None and model.order < len(at.d)
    if fewer and damped > criteria(problem, at.loss, len(at.d)).bic:
        return fit
    fit = replace(fit, damped=model, free=free)
    if held:
        known = tuple(one for one in posed.findings if one.cause is not Cause.HOLD)
        posed = replace(posed, problem=chosen, open=posed.open - {"hold", "arrival"})
        gain = 0.5 * (free.rival.criteria.bic - free.criteria.bic) if free.rival else 0.0
        hold = Finding(Cause.HOLD, (float(HOLDS.index(posed.intersample)),), gain)
        fit = replace(fit, problem=chosen, found=replace(fit.found, posed=replace(posed, findings=(*known, hold))))
    if chosen is problem and (followed is not None or not (model.damped.any() or model.negative.any())):
        return fit
    d = beside(model.natural_frequencies, at.d, order)
    end = refine(chosen, np.sort(d), rtol=posed.rtol if followed is not None and followed.plain else LAST)
    end = replace(end, iterations=fit.found.end.iterations + end.iterations)
    return replace(fit, found=replace(fit.found, end=end), order=order or len(d), at_limit=False)


def _damped_model(free: FreeFit, quantity: str) -> DampedModel:
    """Damped modes beside a lossless fit, and what of them stands out."""
    result = structured(free, Asked("free", (), (quantity,)))
    none = np.zeros(result.order, bool)
    found = DampedModel(result, none, none)
    damped, negative = standing_out(found, free)
    return replace(found, damped=damped, negative=negative)


def _beside_errors(at: Projection, far: Sequence[tuple[int, ...]]) -> tuple[HypothesisTest | None, float]:
    """The test of a lossless fit without some samples, and the BIC with an error of its own in each of them."""
    spared = without(at.problem, far)
    end = refine(spared, at.d, rtol=LAST).projection
    errors = at.problem.samples - spared.samples
    bic = criteria_of(at.problem.samples, end.loss, at.problem.unknowns(len(at.d)) + errors).bic
    return lossless_test(spared, end), bic


def _modes(at: Projection, order: int) -> ModalForm:
    """Modal form, with placeholders for modes that the data do not show; r = 1 where no input shows it."""
    d = at.d
    r = at.kappa / d if at.problem.driven else np.ones(len(d))
    # distinct, above those that the data show
    pads = d.max(initial=0.0) * (2.0 + np.arange(float(order - len(d))))
    return ModalForm._of(
        np.concatenate([d, pads]), np.sqrt(np.concatenate([r, 0 * pads])).astype(complex)[:, None], np.zeros((0, 1))
    )


def _experiments(records: Records, at: Projection, modes: ModalForm, quantity: str) -> tuple[FittedExperiment, ...]:
    found: list[FittedExperiment] = []
    every: tuple[Record | FrequencyRecord, ...] = records
    for k, (record, rows, predicted) in enumerate(zip(every, at.problem.experiments, at.predicted(), strict=True)):
        if isinstance(record, FrequencyRecord):
            found.append(FittedExperiment(record, np.zeros(0), np.zeros(0, complex), 0.0, predicted))
            continue
        terms = rows.offset if isinstance(rows, RecordRows) else 0
        own, amplitudes = at.own[k], np.pad(at.amplitudes(k), (0, modes.n - len(at.d)))
        state = state_from_amplitudes(modes, amplitudes, quantity)
        offset = float(own[-1]) if terms else 0.0
        drift = float(own[-2]) / record.dt if terms > 1 else 0.0
        found.append(FittedExperiment(record, state, amplitudes, offset, predicted, drift))
    return tuple(found)


def _whiteness(experiments: tuple[FittedExperiment, ...], at: Projection) -> float:
    """Of the residuals in time; neighbouring points of a response follow one another as samples do.

    What was fitted is missing from the residuals; short records feel that, and are asked again if they look coloured.
    """
    parts: list[Signal] = []
    for one in experiments:
        in_time = isinstance(one.record, Record)
        parts += [one.left] if in_time else [without_peaks(part) for part in _in_parts(one, one.residuals)]
    p = ljung_box(parts, TUNING.lags)
    n, samples = len(at.d), sum(one.record.samples for one in experiments)
    unknowns = 2 * n + max(rows.own_unknowns(n) for rows in at.problem.experiments)
    if p >= TUNING.surely_white or samples * unknowns > _COUNTED:
        return p
    shared: list[Array] = []
    local: list[Array] = []
    for one, rows in zip(experiments, at.problem.experiments, strict=True):
        found = _directions(one, rows, at)
        shared += _in_parts(one, found.shared)
        local += _in_parts(one, found.local)
    return ljung_box(parts, TUNING.lags, shared=shared, local=local)


def _in_parts(one: FittedExperiment, values: NDArray[Any]) -> list[Array]:
    """Values (T, ...) of a record as they are; of a response their real and imaginary parts, weighted."""
    if isinstance(one.record, Record):
        return [values]
    scaled = values * np.sqrt(one.record.weights).reshape(-1, *(1,) * (values.ndim - 1))
    return [scaled.real, scaled.imag]


def _directions(one: FittedExperiment, rows: Any, at: Projection) -> Directions:
    d, kappa, weighted = at.d, at.kappa, at.free
    if isinstance(one.record, FrequencyRecord):
        return of_response(one.record, d, kappa, weighted, rows.quantity)
    moving = weighted if at.problem.structured else np.ones(len(d), bool)
    free = one.free_amplitudes[: len(d)]
    return of_record(one.record, d, kappa, free, weighted, moving, rows.hold, rows.quantity, rows.offset)


def _finding(at: Projection, information: Information, variance: float, unit: str | None) -> str:
    """What the data do not show, in sentences."""
    if len(at.problem.experiments) == 1 and isinstance(at.problem.experiments[0], RecordRows):
        one = at.problem.experiments[0]
        if one.driven and one.quantity == "velocity" and not one.offset and at.free.any():
            if not information.is_weak and one.hold.method != "euler":
                return ""
            finding = examine_fit(at, information, float(np.sqrt(variance)), unit)
            return finding.message if finding.blind or finding.artefacts else ""
    if not information.deficiency or not at.problem.driven:
        return ""
    named = listed(list(information.blind_parameters))
    return (
        f"{information.deficiency} combination{'s' * (information.deficiency != 1)} of the parameters {named} "
        "leave no trace in these data, so they are not determined; use an input with more frequencies."
    )


def _named_system(modes: ModalForm, record: Record | FrequencyRecord) -> PortHamiltonian:
    """System with the labels of the record; python-control takes no dots in names."""
    labels = (record.input_label.replace(".", "_"), record.output_label.replace(".", "_"))
    return PortHamiltonian._from_modes(modes, inputs=[labels[0]], outputs=[labels[1]])
