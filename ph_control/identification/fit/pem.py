"""Prediction-error fitting: the public call, and the way from data to a result."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ... import _checks
from ..._threads import on_one_thread
from ..._types import Array
from ..._workers import check_workers
from ...exceptions import IdentifiabilityWarning, StructureError
from ...modal.discretization import METHODS
from ..data.channels import Recording, ResponseMatrix
from ..data.experiments import as_channels, as_measured
from ..data.hammer import contacts_alone
from ..data.parts import GLANCE, is_long, stages
from ..data.quantities import checked_quantities, ports_of, quantity_of
from ..data.time_record import LONG
from ..diagnosis.circumstance_tests import NOISE
from ..diagnosis.damping import REFUSED, DampingWatch, beside, lossless_test
from ..diagnosis.verdict import Outcome
from ..regression.tuning import TUNING
from ..regression.variable_projection import LAST, Problem, Projection, refine
from ..search.circumstances import Cause, Finding
from ..search.criteria import CRITERIA, HELD_OUT, criteria, preference, significant
from ..search.formulation import REPRESENTATIONS, Callback, DampedModes, Formulation, Records, reporter
from ..search.modal_search import likely_delays
from ..search.order_selection import held_out_losses
from ..search.path import Start, prune, reseat, restart, stop_of
from ..search.response_noise import reweighted
from ..search.steps import Report, Search, Step
from .conclusion import Conclusion, Fit, conclude
from .damped_result import DampedResult
from .modal_fit import (
    Options,
    asked_of,
    begin_at_rest,
    checked_real_poles,
    fit_channels,
    shows_real_poles,
    starting_poles,
    under_either_hold,
)
from .result import STRUCTURES, OrderRow, PEMResult, cut_short


@on_one_thread
def pem(
    data: Any,
    order: int | str = "auto",
    *,
    dt: Any = None,
    method: str = "exact",
    intersample: str = "auto",
    initial_state: str = "estimate",
    offset: bool | str = "auto",
    quantity: Any = None,
    representation: str = "observable",
    initial_guess: Any = None,
    weights: Any = None,
    criterion: str = "bic",
    max_order: int = 20,
    workers: Any = 1,
    rng: Any = None,
    callback: Callback | None = None,
    structure: str = "auto",
    ports: Any = None,
    real_poles: int | str = "auto",
    delay: Any = "auto",
) -> PEMResult:
    """Fit modes and real poles to recordings or frequency responses, by prediction-error minimisation.

    Finds natural frequencies, damping ratios, time constants and residues, with what belongs to each experiment, that
    minimise the squared output error: with white output noise, of each output its own, the maximum-likelihood estimate.
    No starting guess is needed.  The model is the simplest that the data do not reject, from lossless to free.

    Parameters
    ----------
    data : control.TimeResponseData, control.FrequencyResponseData, data frame, pair (u, y), or list of these
        Inputs and outputs on a uniform grid, or frequency responses; several experiments in a list, each with its own
        length, step and initial state.  Signals of several channels have one row each, (m, T) and (p, T); experiments
        may have different channels, matched by their labels, or their places where there are none.  `(None, y)` is a
        free motion.  NaN outputs are missing samples.  Not modified.
    order : int or 'auto'
        Number of modes n; 'auto' takes the one that `criterion` prefers.
    dt : float, or sequence of float, one for each experiment, optional
        Time between samples; required with arrays.
    method : {'exact', 'midpoint', 'euler'}
        Discretisation of the model; 'exact' for real recordings, the others for data made by such an integrator,
        which a lossless model is fitted to.
    intersample : {'auto', 'zoh', 'foh'}
        Input between samples: held, or linear; 'auto' takes what the data prefer, where they cannot tell that with
        which the structure is simpler or shapes are more nearly real, and else 'zoh'.
    initial_state : {'estimate', 'zero'}
        Whether the records may start in motion.
    offset : bool or 'auto'
        Whether a constant is added to the output of each record, and estimated; 'auto' adds one, or one that drifts,
        where that explains more than a slow mode does.
    quantity : {'velocity', 'displacement', 'acceleration', 'free'}, or sequence or dict of these, optional
        Measured quantity: of all outputs, of each, or by label; 'free' is any other sensor.  Default: what the data
        give by an attribute `quantity`, a dict as `read_uff` gives it, or by labels and units such as `Accel (g)`;
        'velocity' where no output has such a label.
    representation : {'observable', 'controllable'}
        Whether a mode without weight may still move at the output, as in the observable form, or not, as in every state
        of the controllable one; of lossless models of one input and output.
    initial_guess : pair (d, r), ModalForm, PEMResult, or system of this package, optional
        Model to start from, in place of the search; with a given order, modes are added to it if it has fewer.
    weights : array_like, shape (K,) or (p, m, K), or list of these, optional
        What the squared error at each frequency of a response counts; by default all the same, unless the residuals
        show that the noise grows with the gain: then by the law of the noise of each response that is estimated,
        `noise` in a lossless result, among the `findings` of a damped one.
    criterion : {'bic', 'aicc', 'aic', 'holdout'}
        What 'auto' minimises; 'holdout' is the error over the last third of each record, of models fitted to the rest.
    max_order : int
        Largest order tried by 'auto'.
    workers : int, executor, Dask client or map-like callable
        Number of processes for further starts, -1 for all, or what runs them; the result does not depend on it.
    rng : numpy.random.Generator or int, optional
        Seeds of further starts; always the same by default.
    callback : callable, optional
        Called as `callback(progress)` after each iteration, `progress` with `order`, `max_order`, `iteration`, `loss`.
        If it raises `StopIteration`, or on `KeyboardInterrupt`, the best model so far is returned, and says so.
    structure : {'auto', 'lossless', 'classical', 'passive', 'free'}
        What is assumed: no losses and sensors at the actuators; damping that the real modes of the lossless plant
        decouple; a plant that gives no energy; nothing.  'auto' takes the simplest that is not rejected at 5 %.
    ports : list of (output, input), or mapping from output to input, optional
        Driving points, where an output is measured where and along which an input acts: labels, or numbers from 0.
        They set the scale of mode shapes.  Default: what the data give by an attribute `ports`, as `read_uff` does;
        one input and output are taken for one.
    real_poles : int or 'auto'
        Number of real poles beside the modes, as of a lag, a motor or an RC circuit; 'auto' takes that which
        `criterion` prefers, and none beside a number of modes that is given.  A lossless model has none.
    delay : 'auto', or float, or sequence of float, one for each output
        Time by which outputs come later than the response to the inputs, or earlier where it is negative: that of an
        anti-aliasing filter, of sampling one channel after the other, or dead time.  'auto' estimates one of all
        outputs, or one of each, where a structure or the first samples of the answer show it.

    Returns
    -------
    LosslessResult or DampedResult
        Model, standard errors, order table, residuals and a verdict: of one input and output that losses do not show
        in, or that were fitted as lossless, a `LosslessResult`.

    Raises
    ------
    StructureError
        If the data or options are not of this form.
    IdentificationError
        If the record is too short for a mode, or its signals cannot show one.

    Warns
    -----
    IdentifiabilityWarning
        If the input leaves combinations of parameters undetermined.

    Notes
    -----
    Given the frequencies, the residues `kappa = r d >= 0` and what belongs to each experiment solve a linear problem;
    only `d` is refined (variable projection, Levenberg-Marquardt).  The loss has many minima in `d`, each about
    `2 pi / (T dt)` wide, so modes are added one by one, each where a local fit around the bins of the Fourier transform
    explains most of the residual, and all are refined jointly.  Where the residual still exceeds noise,
    modes are relocated and a few other paths are tried.  O(T n^2) an iteration; memory does not grow with T n.

    A mode that is not significant among all the places where noise could have shown one is dropped from an automatic
    choice.  Parts of one record given as two experiments have two initial states to estimate.

    The force of a hammer counts as 0 outside its contacts where that explains the outputs better than the noise that
    its channel shows there; `findings` say so, and the records of the result have that force.

    Examples
    --------
    >>> import control as ct, numpy as np, ph_control as phc
    >>> plant = phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]))
    >>> rng = np.random.default_rng(0)
    >>> t, u = 0.1 * np.arange(1000), rng.standard_normal(1000)
    >>> y = phc.forced_response(plant, t, u, intersample="zoh").outputs + 0.01 * rng.standard_normal(1000)
    >>> result = phc.pem((u, y), dt=0.1)
    >>> result.d.round(3)
    array([0.5, 2. ])

    A damped structure, two inputs and three outputs, the first of which is a driving point:

    >>> poles, shapes = [-0.01 + 1j, -0.02 + 2j], rng.standard_normal((2, 3))
    >>> frame = phc.modes(poles, shapes, shapes[:, :2]).state_space()
    >>> u = rng.standard_normal((2, 1000))
    >>> y = ct.forced_response(ct.c2d(frame, 0.1), t, u).outputs
    >>> result = phc.pem((u, y + 0.1 * rng.standard_normal(y.shape)), dt=0.1, structure="free", ports=[(0, 0)])
    >>> result.order, result.shapes.shape, result.shapes_scaled
    (2, (2, 3), True)
    """
    _checks.choice("criterion", criterion, CRITERIA)
    _checks.choice("structure", structure, ("auto", *STRUCTURES))
    quantity = quantity_of(data) if quantity is None else quantity
    ports = ports_of(data, quantity) if ports is None else ports
    alone = structure in ("auto", "lossless") and quantity != "free" and isinstance(delay, str)
    take = as_measured if alone else as_channels
    records: Any = take(data, dt, weights=weights)
    several = isinstance(records[0], Recording | ResponseMatrix)
    if not several and not isinstance(quantity, str):
        (quantity,) = checked_quantities(quantity, records[0].output_labels)
    options = Options(
        order,
        intersample,
        offset,
        max_order,
        criterion,
        callback,
        initial_state == "estimate",
        weights is not None,
        checked_real_poles(real_poles),
        delay,
    )
    fit = partial(
        _fitted, options=options, method=method, initial_state=initial_state, quantity=quantity,
        representation=representation, initial_guess=initial_guess, workers=workers, rng=rng, structure=structure,
        ports=ports,
    )  # fmt: skip
    hits = contacts_alone(records)
    if hits is None:
        return fit(records)
    quiet, *sizes = hits
    found = fit(quiet, (Finding(Cause.HAMMER_NOISE, tuple(sizes), 0.0),))
    if not found.order or found.outcome is Outcome.INTERRUPTED:
        return found
    # what the channel shows between hits may be a force
    other = fit(records, options=replace(options, order=found.order))
    if other.outcome is Outcome.INTERRUPTED or other.loglik <= found.loglik:
        return found
    return fit(records) if order == "auto" else other


def _fitted(
    records: Any, findings: tuple[Finding, ...] = (), *, options: Options, method: str, initial_state: str,
    quantity: Any, representation: str, initial_guess: Any, workers: Any, rng: Any, structure: str, ports: Any,
) -> PEMResult:  # fmt: skip
    """The fit to checked records, with what was found of them before."""
    several = isinstance(records[0], Recording | ResponseMatrix)
    if several or quantity == "free":
        _refuse_lossless_options(structure, method, representation)
        _checks.choice("initial_state", initial_state, ("estimate", "zero"))
        channels = records if several else as_channels(list(records))
        asked = asked_of(channels, structure, ports, quantity)
        return fit_channels(channels, asked, options, starting_poles(initial_guess), findings)
    if ports is not None:
        _checks.port_pairs(ports, records[0].output_labels, max((one.input_labels for one in records), key=len))
    check_workers(workers)
    random = None if rng is None else _checks.random_generator(rng)
    posed = Formulation.of(
        records, method=method, intersample=options.intersample, initial_state=initial_state, offset=options.offset,
        quantity=quantity, representation=representation,
    )  # fmt: skip
    posed = replace(posed, findings=findings)
    guess = posed.guess(initial_guess)
    largest = posed.largest_order(options.order, options.max_order, guess)
    posed.check_signals()
    damped = structure == "auto" and method == "exact"
    if damped and options.real_poles:
        channels = as_channels(list(records))
        asked = asked_of(channels, "auto", ports, quantity)
        if shows_real_poles(channels, asked, options):
            return fit_channels(channels, asked, options, starting_poles(initial_guess), findings)
    asking = LosslessSearch(options, largest, guess, damped, workers, random, representation, quantity, method)
    found = asking.concluded(posed)
    try:
        other = _instead(found, records, options, ports) if damped else None
    except KeyboardInterrupt:
        return cut_short(found.result)
    if other is not None:
        return other
    if found.blind:
        warnings.warn(found.blind, IdentifiabilityWarning, stacklevel=4)  # the line that calls the decorated function
    return found.result


def _instead(found: Conclusion, records: Records, options: Options, ports: Any) -> DampedResult | None:
    """Damped modes in place of a lossless model that they reject; None where it stands."""
    result, free, automatic = found.result, found.free, options.order == "auto"
    # the test of a long record is that of all of it, where no damped modes were looked for
    refused = any(one.p < REFUSED for one in result.tests)
    undescribed = automatic and free is None and refused and result.outcome is Outcome.NOT_DESCRIBED
    # lossless modes of an order that was given too low need not settle, which says nothing of damping
    settled = result.success or (automatic and result.outcome is not Outcome.INTERRUPTED)
    if free is None and not (settled and (undescribed or (is_long(records) and refused))):
        return None
    if free is not None and not (settled or free.interrupted):
        return None
    whole = free is not None and all(a.samples == b.samples for a, b in zip(free.channels, records, strict=True))
    channels = free.channels if free is not None and whole else as_channels(list(records))
    asked = asked_of(channels, "auto", ports, result.quantity)
    # the noise may grow with the gain of damped modes, too; before a hammer hits, a motion is hardly seen
    responses = isinstance(channels[0], ResponseMatrix)
    anew = not whole or (not options.weighted if responses else options.moving and begin_at_rest(channels))
    known = free is not None and (not automatic if responses else not whole)
    start = free.projection.p if free is not None and known else None
    if free is None or (anew and not free.interrupted):
        damped = fit_channels(channels, asked, options, start, result.findings)
    else:
        damped = under_either_hold(free, asked, result.findings)
        # residues of any phase may be those of a delay, which was looked for beside lossless modes only
        if automatic and damped.structure == "free" and not free.interrupted and likely_delays(free):
            other = fit_channels(channels, asked, options, start, result.findings)
            damped = other if any(one.cause is Cause.DELAY for one in other.findings) else damped
    stands = damped.structure == "lossless" or (undescribed and damped.bic > result.bic)
    return None if stands else damped


def _refuse_lossless_options(structure: str, method: str, representation: str) -> None:
    """Refuse what only fits of lossless models of one input and output have."""
    options = {
        "method": (method, METHODS), "representation": (representation, REPRESENTATIONS),
    }  # fmt: skip
    for name, (value, allowed) in options.items():
        _checks.choice(name, value, allowed)
    refused = [(name, value, allowed[0]) for name, (value, allowed) in options.items() if value != allowed[0]]
    if refused:
        name, value, instead = refused[0]
        what = f"structure={structure!r}"
        if structure in ("auto", "lossless"):
            what = "several inputs or outputs, or an output that is 'free'"
        raise StructureError(
            f"{name}={value!r} is for lossless models of one input and one output, and this fit has {what}: use "
            f"{name}={instead!r}"
        )


@dataclass(frozen=True)
class LosslessSearch:
    """How a lossless model of one input and one output is looked for.

    `damped` says whether damped modes may take its place; `largest` is the order that is asked for, or the largest.
    """

    options: Options
    largest: int
    guess: Array
    damped: bool
    workers: Any
    random: Any
    representation: str
    quantity: str
    method: str

    @property
    def automatic(self) -> bool:
        """Whether a criterion chooses the order."""
        return self.options.order == "auto"

    def concluded(self, posed: Formulation) -> Conclusion:
        """The result for all records; of a part of long ones where modes are damped."""
        records = posed.records
        if self.damped and any(one.samples > GLANCE for one in records):
            # a part shows losses as well, which take the longer to imitate by lossless modes, the longer the record
            fit = self._fit(posed.over(posed.searched_parts(GLANCE), records))
            found = self._conclusion(fit)
            if found.free is not None or fit.found.interrupted:
                return found
        parts = posed.searched_parts(LONG)
        searched = posed.over(parts, records)
        fit = self._fit(searched)
        hold = fit.found.posed.intersample
        try:
            found = self._conclusion(fit)
            if searched is posed or fit.found.interrupted or (self.damped and found.free is not None):
                return found
            fit = _on_all(replace(fit, damped=found.result.damped), records, parts)
            return self._conclusion(fit, hold)
        except KeyboardInterrupt:
            return self._conclusion(replace(fit, found=replace(fit.found, interrupted=True)), hold)

    def _conclusion(self, fit: Fit, hold: str = "") -> Conclusion:
        return conclude(fit, self.method, hold or fit.found.posed.intersample, self.quantity, self.representation)

    def _fit(self, posed: Formulation) -> Fit:
        """The minimum that a search ends in."""
        found: Found | None = None
        law, options = None, self.options
        try:
            found = self._found(posed)
            left = len(found.all_d) and found.end.projection.loss > found.floor
            if not options.weighted and posed.of_equal_weights and left:
                posed, found, law = reweighted(posed, found, self._found)
        except KeyboardInterrupt:
            found = self._cut_short(posed) if found is None else replace(found, interrupted=True)
        at_limit = self.automatic and len(found.d) == options.max_order
        # what an interrupted search had not come to is not absent from the data
        wanted = len(found.d) if self.automatic or found.interrupted else self.largest
        if law is None:
            posed = found.posed
        return Fit(
            posed.records, posed.problem, found, wanted, not self.automatic, at_limit, self.largest, law=law,
            criterion=options.criterion, reports=reporter(self.largest, options.callback),
        )  # fmt: skip

    def _found(self, posed: Formulation, start: Array | None = None) -> Found:
        """Search, selection, and the last refinement."""
        criterion, guess = self.options.criterion, self.guess if start is None else start
        floor, report = posed.problem.rounding, reporter(self.largest, self.options.callback, posed.problem.samples)

        def watch(problem: Problem) -> DampingWatch:
            over = stop_of(lambda step: preference(problem, step, criterion))
            return DampingWatch(problem, over if self.automatic else None, not self.damped)

        found = posed.path(
            guess, self.largest, report=report, together=not self.automatic and posed.search.affords_batches,
            watch=watch,
        )  # fmt: skip
        posed, path, followed = found.posed, found.steps, found.damped
        problem, search = posed.problem, posed.search
        place = len(path) - 1
        if self.automatic:
            values = [preference(problem, step, criterion) for step in path]
            if criterion == "holdout":
                orders = [len(step.d) for step in path]
                values = list(held_out_losses(posed, guess, orders, HELD_OUT, self.workers)[1])
            place = int(np.argmin(values))
        starts = [_start("guess" if len(guess) else "forward", path[place], problem.samples)]
        d = path[place].d
        if followed is not None:
            d = beside(followed.model.at.d, d, None if self.automatic else len(d))
        else:
            path[place], more = self._second_thoughts(search, path, place, posed.rtol, floor, report)
            starts += more
            d = path[place].d
        # a lossless model that will not be asked for need not be exact
        last = posed.rtol if followed is not None and followed.plain else LAST
        end = refine(search.problem, np.sort(d), rtol=last, progress=report(len(d)))
        all_d = end.projection.d if place else path[-1].d
        if self.automatic and followed is None:
            end = significant(search.problem, end, lambda d: refine(search.problem, d, rtol=LAST))
        explained = end.projection
        if posed.searched is not None:
            end = refine(problem, explained.d, rtol=LAST)
        rows = tuple(_row(problem, step) for step in path)
        iterations = sum(step.iterations for step in path) + end.iterations
        return Found(end, rows, tuple(starts), iterations, False, floor, all_d, posed, followed, explained)

    def _cut_short(self, posed: Formulation) -> Found:
        """The modes that a search had come to; the interruption goes on if there are none."""
        path = posed.so_far(self.largest)
        problem, steps = path.posed.problem, path.steps
        step = steps[-1]
        if self.automatic:
            step = min(steps, key=lambda one: criteria(problem, one.loss, len(one.d)).bic)
        # who interrupts wants an end: one step, unobserved
        end = replace(refine(problem, step.d, rtol=LAST, max_iterations=1), converged=False)
        rows, starts = tuple(_row(problem, one) for one in steps), (_start("forward", step, problem.samples),)
        iterations = sum(one.iterations for one in steps)
        at = end.projection
        return Found(end, rows, starts, iterations, True, problem.rounding, at.d, path.posed, None, at)

    def _second_thoughts(
        self, search: Search, path: list[Step], place: int, rtol: float, floor: float,
        report: Callable[[int], Report | None],
    ) -> tuple[Step, list[Start]]:  # fmt: skip
        """A better minimum where the first is doubtful, and what was tried."""
        step, largest = path[place], self.largest
        starts: list[Start] = []
        better = reseat(search, step, rtol, floor, report)
        if better is not step:
            starts.append(_start("re-seated", better, search.problem.samples))
            step = better
        given = not self.automatic and len(step.d) == largest and step.loss > floor
        if given and (step.held.any() or search.unconvinced(step)):
            pruned = prune(search, step, search.problem.carried, rtol=rtol, floor=floor)
            if len(pruned.d) == largest and pruned.loss < (1 - TUNING.better) * step.loss:
                starts.append(_start("pruned", pruned, search.problem.samples))
                step = replace(pruned, iterations=step.iterations + pruned.iterations)
        from_nothing = not len(path[0].d)
        if given and from_nothing and step.loss > floor and search.unconvinced(step):
            others = restart(search, path[0], largest, rtol=rtol, floor=floor, rng=self.random, workers=self.workers)
            starts += [_start("random", other, search.problem.samples) for other in others]
            best = min(others, key=lambda other: other.loss)
            if len(best.d) == largest and best.loss < (1 - TUNING.better) * step.loss:
                step = replace(best, iterations=step.iterations + best.iterations)
        return step, starts


def _on_all(fit: Fit, records: Records, parts: Sequence[slice]) -> Fit:
    """Modes of parts of long records, refined over longer and longer ones, up to all samples; and tested there."""
    found, part = fit.found, list(parts)
    posed, end = found.posed, found.end
    while any(one.stop - one.start < record.samples for one, record in zip(part, records, strict=True)):
        part = [next(stages(one, record.samples), one) for one, record in zip(part, records, strict=True)]
        posed = posed.over(part, records)
        end = refine(posed.problem, end.projection.d, rtol=TUNING.rough)
    end = refine(posed.problem, end.projection.d, rtol=LAST)
    noise = next((one for one in found.posed.findings if one.cause in NOISE), None)
    test = lossless_test(posed.problem, end.projection, noise)
    all_found = replace(
        found, end=end, posed=posed, floor=posed.problem.rounding, all_d=end.projection.d, followed=None,
        explained=end.projection, iterations=found.iterations + end.iterations,
    )  # fmt: skip
    tests = () if test is None else (test,)
    return replace(fit, records=records, problem=posed.problem, found=all_found, tests=tests, examined=True)


@dataclass(frozen=True)
class Found:
    """The minimum that the search ended in, and how it came there; `all_d` has the modes that were dropped as noise.

    `explained` is the minimum under the circumstances in which the modes were found.
    """

    end: Any
    rows: tuple[OrderRow, ...]
    starts: tuple[Start, ...]
    iterations: int
    interrupted: bool
    floor: float
    all_d: Array
    posed: Formulation
    followed: DampedModes | None = None
    explained: Projection | None = None

    @property
    def d(self) -> Array:
        """Frequencies, shape (n,), in the order found."""
        return np.asarray(self.end.projection.d)


def _start(kind: str, step: Step, samples: int) -> Start:
    return Start(kind, step.loss / samples, _checks.readonly(np.sort(step.d)))


def _row(problem: Problem, step: Step) -> OrderRow:
    found = criteria(problem, step.loss, len(step.d))
    d = _checks.readonly(np.sort(step.d))
    return OrderRow(len(d), step.loss / problem.samples, found.aic, found.bic, d)


prediction_error_fit = pem
