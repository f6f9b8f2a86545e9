"""What a record can and cannot show of a model, before any fit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ... import _checks
from ..._options import (
    DISCRETISATIONS,
    INITIAL_STATES,
    INTERPOLATIONS,
    Discretisation,
    InitialState,
    Interpolation,
    Motion,
)
from ..._types import Array, ArrayLike, ComplexArray
from ..._units import common_unit
from ...exceptions import IdentificationError, StructureError
from ...modal.discretization import Hold
from ...modal.modal_form import ModalForm, imaginary
from ...systems.port_hamiltonian import modes
from ..data.experiments import as_experiments
from ..data.time_record import Record
from ..regression.modal_regressors import QUANTITIES
from ..uncertainty.fisher import Combination, Information, PortRecord, joint_information, model_information
from .excited_band import ExcitedBand, excited_band
from .plant_excitation import PlantExcitation, plant_excitation
from .remedy import input_remedy
from .report import Excitation
from .scan import Scan, representative, scan

_ALWAYS = 20  # modes that are judged however short the record, so that it is said how long it has to be
_MOST = 200  # modes beyond which singular values take minutes
_LONGEST = 100  # times the record: more is no advice
_SAME = 1e-9  # relative distance of frequencies that no record of any length tells apart in practice
_FASTEST = 1e6  # radians per step
_WANTED = 0.1  # relative standard error that a stronger input is to reach
_AT_ZERO = 0.05  # bins between a line and a zero that it drives


def excitation(
    data: Any,
    order: Any,
    *,
    dt: float | None = None,
    method: Discretisation = "exact",
    intersample: Interpolation = "zoh",
    initial_state: InitialState = "estimate",
    quantity: Motion = "velocity",
    noise_std: ArrayLike | None = None,
) -> Excitation | PlantExcitation:
    """Tell what a record can and cannot show of a model, and what input would show it.

    Evaluates the Fisher information: of `theta = (d, r, x(0))` at a lossless model of one port, or at such modes spread
    over the band of the input; of frequencies, damping, residues and feedthrough at any other.  Nothing is fitted.

    Parameters
    ----------
    data : control.TimeResponseData, data frame, pair (u, y), or list of these
        The records, as for `pem`; `(u, None)` where there is an input only.  Not modified.
    order : int, pair (d, r), ModalForm, PEMResult, or any linear system of continuous time
        Model at which to judge; or a number of modes n, whose frequencies may lie anywhere.
    dt : float, optional
        Time between samples; required with arrays.
    method : {'exact', 'midpoint', 'euler'}
        How the model meets the samples.
    intersample : {'zoh', 'foh'}
        Input between samples: held, or linear.
    initial_state : {'estimate', 'zero'}
        Whether the record may start in motion, so that the initial state is an unknown like the others.
    quantity : {'velocity', 'displacement', 'acceleration'}
        What is measured of the port of a lossless model.
    noise_std : float or array_like, shape (p,), optional
        Standard deviation of the noise of each output, for standard errors.  Default: the noise of a fitted result,
        with its colours and forces, or of what a given model leaves of the outputs.

    Returns
    -------
    Excitation or PlantExcitation
        Rank, blind combinations, bounds, excited band, and remedies; printed, it says them in words.  A lossless model
        of one port gives the first; one with losses, or with several inputs or outputs, the second.

    Raises
    ------
    StructureError
        If the data, the model or the options are not of this form, or the model leaves the range of doubles.
    IdentificationError
        If the record has less than two samples, or there are more modes than it can carry.

    Notes
    -----
    O(T n^2) time and O(T n) memory for one model; a number of modes is judged at about 40 frequencies.  Remedies are
    tried before they are named.  The singular values are those of the sensitivities themselves, not of their squares,
    so that combinations count as blind only at rounding level: max(T, 4n) eps.  The initial state enters as the modal
    state `x_l(0)`, with the free motion `sum_l Re(x_l(0) exp(-i d_l t))` at the output.  Where there are outputs it is
    fitted to them; without, the information is that at rest.  Of several records the information of `d` and `r` is that
    of all together, each with an initial state of its own; band and remedies are those of the longest.

    Examples
    --------
    One sine drives a zero of this chain, so that its weights cannot be learned:

    >>> import numpy as np, ph_control as phc
    >>> chain, t = phc.frenkel_kontorova(2), 0.01 * np.arange(1000)
    >>> report = phc.excitation((np.sin(t), None), chain, dt=0.01)
    >>> report.rank, len(report.names)
    (7, 8)
    >>> report.blind[0].words
    'r_1 and r_2 with the initial states of modes 1 and 2'
    >>> report.remedies[0][:53]
    'add a frequency near 1.6 rad/time to the input, or us'
    >>> phc.excitation((np.sin(t) + np.sin(1.6 * t), None), chain, dt=0.01).sufficient
    True

    With losses and two inputs:

    >>> motor = phc.modes([-0.05 + 1.0j, -0.2 + 3.0j], [[1.0], [0.5]], [[1.0, 0.3j], [0.2, 1.0]])
    >>> u = np.random.default_rng(0).standard_normal((2, 1000))
    >>> report = phc.excitation((u, None), motor, dt=0.1, noise_std=0.1)
    >>> report.sufficient, report.stderr["damping_ratios"].round(4)
    (True, array([0.0004, 0.0011]))
    """
    _checks.choice("method", method, DISCRETISATIONS)
    _checks.choice("intersample", intersample, INTERPOLATIONS)
    _checks.choice("initial_state", initial_state, INITIAL_STATES)
    _checks.choice("quantity", quantity, QUANTITIES)
    if not _checks.is_whole(order) and not _is_lossless_port(order):
        if quantity != "velocity":
            raise StructureError(
                f"quantity is {quantity!r}, which is asked of lossless modes of one port; of any other plant the "
                "outputs are those of the model: leave it out"
            )
        _refuse_other_hold(order, method, intersample)
        return plant_excitation(data, order, dt, (method, intersample), initial_state == "zero", noise_std)
    noise = np.nan if noise_std is None else float(_checks.real_array("noise_std", noise_std, 0))
    if noise <= 0:
        raise StructureError(f"noise_std is {noise:g}; it must be positive")
    records = _in_time(as_experiments(data, dt, output_needed=False))
    unit = common_unit(records, order)
    problems = [
        _problem(record, Hold(record.dt, method, intersample), initial_state == "zero", quantity) for record in records
    ]
    longest = max(range(len(problems)), key=lambda k: len(problems[k].u))
    problem, measured = problems[longest], [bool(record.observed.any()) for record in records]
    most = min(_MOST, max(_carried(problems), _ALWAYS))
    if _checks.is_whole(order):
        if order < 1:
            raise StructureError(f"order is {order}; a number of modes must be at least 1")
        _refuse_many(int(order), most, problems)
        return _of_order(problem, int(order), noise, unit)
    model = _model(order, method, intersample)
    _refuse_many(model.n, most, problems)
    _check_phases(problem, model.d)
    motions = [
        _free_motion(port_record, model) if known else (np.zeros(model.n, complex), np.nan)
        for port_record, known in zip(problems, measured, strict=True)
    ]
    amplitudes, deviation = motions[longest]
    if measured[longest] and noise_std is None:
        noise = float(np.ravel(getattr(order, "noise_variance", deviation**2))[0]) ** 0.5
    joint = None
    if len(problems) > 1:
        joint = joint_information(problems, model.d, model.r, [motion for motion, _ in motions])
        # the initial states are eliminated already
        problem = replace(problem, from_rest=True)
    return examine(problem, model.d, model.r, amplitudes, noise_std=noise, information=joint, time_unit=unit)


def examine(
    problem: PortRecord,
    d: Array,
    r: Array,
    amplitudes: ComplexArray,
    *,
    noise_std: float = np.nan,
    information: Information | None = None,
    scanned: Scan | None = None,
    time_unit: str | None = None,
) -> Excitation:
    """Judge a record at a model (n,) with frequencies ascending and modal initial states `amplitudes`.

    `information` spares the sensitivities where a fit has them already.
    """
    information = model_information(problem, d, r, amplitudes) if information is None else information
    band = excited_band(problem.u, problem.hold.h, time_unit)
    apparent = _apparent_frequencies(d, problem.hold)
    above = tuple(int(l) for l in np.flatnonzero(d * problem.hold.h >= np.pi)) if problem.hold.method == "exact" else ()
    report = Excitation(
        samples=len(problem.u),
        dt=problem.hold.h,
        method=problem.hold.method,
        from_rest=problem.from_rest,
        d=d.copy(),
        r=r.copy(),
        apparent=apparent,
        information=information,
        noise_std=noise_std,
        band=band,
        above_nyquist=above,
        unresolved=_unresolved(apparent, problem.bin),
        slow=tuple(int(l) for l in np.flatnonzero(apparent < problem.bin * (1 - 1e-9)) if l not in above),
        artefacts=_artefacts(problem, d, r, amplitudes, information),
        driven_zeros=_driven_zeros(d, r, band) if scanned is None else (),
        observed=len(problem.target),
        scan=scanned,
        remedies=(),
        time_unit=time_unit,
    )
    return replace(report, remedies=_remedies(report, problem, amplitudes))


def _carried(problems: list[PortRecord]) -> int:
    """Largest number of modes for which there are more samples than unknowns."""
    driven = any(problem.driven for problem in problems)
    each = 1 + driven + 2 * sum(not problem.from_rest for problem in problems)
    return max(0, (sum(problem.samples for problem in problems) - 1) // each)


def _refuse_many(n: int, most: int, problems: list[PortRecord]) -> None:
    """Refuse more modes than the records carry or than can be judged together in acceptable time and memory."""
    if n > most:
        samples = sum(problem.samples for problem in problems)
        raise IdentificationError(
            f"{_checks.shown(n)} modes are more than can be judged with {samples} observed samples; the largest number "
            f"here is {most}: ask for fewer, such as those of one band"
        )


def _in_time(records: tuple[Any, ...]) -> tuple[Record, ...]:
    """Refuse responses, which show every frequency they have points about."""
    if not isinstance(records[0], Record):
        raise StructureError(
            "the data are a frequency response; what an input shows is asked of records in time: pass (u, y) with dt"
        )
    return records


def _problem(record: Record, hold: Hold, from_rest: bool, quantity: str) -> PortRecord:
    """The data of a fit; without outputs, all of them are to be measured."""
    measured = bool(record.observed.any())
    observed = record.observed if measured else np.ones(record.samples, bool)
    y = record.y if measured else np.zeros(record.samples)
    return PortRecord(record.u, y, observed, hold, from_rest and record.driven, quantity, record.driven)


def _is_lossless_port(order: object) -> bool:
    """Whether a model is that of lossless modes of one port, which have parameters `d` and `r` of their own."""
    if isinstance(order, tuple | list):
        return True
    own = getattr(order, "modes", None)
    form = own if isinstance(own, ModalForm) else modes(order)
    return bool(form.is_lossless and form.nports == 1 and not len(form.rigid) and len(form.d))


def _refuse_other_hold(order: object, method: Discretisation, intersample: Interpolation) -> None:
    for name, value in (("method", method), ("intersample", intersample)):
        if (fitted := getattr(order, name, value)) != value:
            raise StructureError(f"the model was fitted with {name}={fitted!r}; pass that, or its modes alone")


def _model(order: object, method: Discretisation, intersample: Interpolation) -> ModalForm:
    """One-port oscillating modal form of whatever describes a model."""
    _refuse_other_hold(order, method, intersample)
    if isinstance(order, tuple | list):
        if len(order) != 2:
            raise StructureError(f"order has {len(order)} entries; give a number of modes, a pair (d, r), or a model")
        model = modes(*order)
    else:
        own = getattr(order, "modes", None)
        model = own if isinstance(own, ModalForm) else modes(order)
    if model.nports != 1 or len(model.rigid) or not len(model.d):
        raise StructureError(
            f"the model has {model.nports} ports, {len(model.rigid)} rigid-body modes and {len(model.d)} oscillating "
            "ones; expected one port, no rigid-body mode, and at least one that oscillates"
        )
    return model


def _check_phases(problem: PortRecord, d: Array) -> None:
    """Refuse modes that turn absurdly fast, or that an integration rule lets grow out of the range of doubles."""
    hold = problem.hold
    if d.max() * hold.h > _FASTEST:
        raise StructureError(
            f"the mode at {d.max():.3g} rad/time turns by {d.max() * hold.h:.3g} rad in a step of {hold.h:g}; allowed "
            f"is {_FASTEST:g}, and up to pi is seen: check the units of d and dt"
        )
    largest = hold.largest_phase(len(problem.u))
    if hold.method == "euler" and d.max() > (limit := float(hold.frequency_of(np.array([largest]))[0])):
        raise StructureError(
            f"Euler's rule lets the mode at {d.max():.4g} rad/time grow out of range within the record; allowed is "
            f"{limit:.4g}: use method='exact'"
        )


def _free_motion(problem: PortRecord, model: ModalForm) -> tuple[ComplexArray, float]:
    """Modal initial states that fit the outputs best, given the model, and the deviation of what is left."""
    n = model.n
    columns = problem.seen(problem.sensitivities(model.d, model.kappa, np.zeros(n, complex)))[:, n:]
    with np.errstate(over="ignore", invalid="ignore"):  # what leaves the range of doubles is refused
        residual = problem.target - columns[:, :n] @ model.kappa
        _checks.representable("the outputs of the model", residual * residual)
    amplitudes = np.zeros(2 * n)
    if not problem.from_rest:
        amplitudes = np.asarray(np.linalg.lstsq(columns[:, n:], residual, rcond=None)[0])
        residual = residual - columns[:, n:] @ amplitudes
    spare = len(residual) - (0 if problem.from_rest else 2 * n)
    return amplitudes[:n] + 1j * amplitudes[n:], float(np.sqrt(residual @ residual / spare)) if spare > 0 else np.nan


def _of_order(problem: PortRecord, n: int, noise: float, time_unit: str | None) -> Excitation:
    """Judge a record for n modes of equal residue, wherever they lie."""
    band = excited_band(problem.u, problem.hold.h, time_unit)
    d, scanned = representative(n, problem, band), scan(problem, n, band)
    return examine(problem, d, 1.0 / d, np.zeros(n, complex), noise_std=noise, scanned=scanned, time_unit=time_unit)


def _apparent_frequencies(d: Array, hold: Hold) -> Array:
    """Frequencies at which sampled modes are seen: warped by the method, folded at the Nyquist frequency."""
    high, low = hold.step(imaginary(-d)).phase
    return np.abs(np.remainder(high + low + np.pi, 2 * np.pi) - np.pi) / hold.h


def _unresolved(apparent: Array, bin_width: float) -> tuple[tuple[int, int], ...]:
    """Neighbouring modes closer than a bin."""
    order = np.argsort(apparent, kind="stable")
    close = np.flatnonzero(np.diff(apparent[order]) < bin_width * (1 - 1e-9))
    return tuple((int(min(order[k : k + 2])), int(max(order[k : k + 2]))) for k in close)


def _artefacts(
    problem: PortRecord, d: Array, r: Array, amplitudes: ComplexArray, information: Information
) -> tuple[Combination, ...]:
    """Combinations that Euler's rule shows and an exact hold does not."""
    if problem.hold.method != "euler":
        return ()
    exact = model_information(replace(problem, hold=Hold(problem.hold.h)), d, r, amplitudes)
    return exact.blind if exact.rank < information.rank else ()


def _driven_zeros(d: Array, r: Array, band: ExcitedBand) -> tuple[float, ...]:
    """Lines of the input on a zero of the model."""
    zeros = modes(d, r).zeros.imag if band.lines and (r > 0).all() and np.diff(d).all() else np.zeros(0)
    zeros = zeros[zeros > 0]
    return tuple(line for line in band.lines if (np.abs(zeros - line) < _AT_ZERO * band.bin).any())


def _remedies(report: Excitation, problem: PortRecord, amplitudes: ComplexArray) -> tuple[str, ...]:
    """What to change, each as an instruction, in the order in which to do it."""
    instructions = []
    if report.above_nyquist:
        instructions.append(f"sample with a step below {np.pi / report.d.max():.2g}")
    same = [(j, k) for j, k in report.unresolved if abs(report.d[j] - report.d[k]) <= _SAME * report.d[k]]
    for j, k in same:
        instructions.append(f"take modes {j + 1} and {k + 1}, of one frequency, as one")
    span = _needed_span(report, same)
    live = [
        name
        for combination in (*report.blind, *report.nearly_blind, *report.artefacts)
        for name in combination.parameters
    ]
    if any(report.r[int(name[2:]) - 1] > 0 for name in live if name[0] in "dr") and not same:
        missing = report.information.deficiency
        remedy = input_remedy(problem, report.d, report.r, amplitudes, report.band, missing=missing, lengthen=not span)
        instructions += [remedy] if remedy else []
    if span > _LONGEST * report.samples * report.dt:
        instructions.append(_instead_of_time(report, same))
    elif span:
        unit = report.time_unit or "time units"
        instructions.append(f"record for at least {span:.3g} {unit} ({int(np.ceil(span / report.dt))} samples)")
    elif report.observed < len(report.names) and not instructions:
        instructions.append(f"record at least {len(report.names) + 1} samples")
    if report.uncertain:
        worst = max(report._relative_error(name) for name in report.uncertain)
        instructions.append(
            f"use an input at least {worst / _WANTED:.2g} times as strong, for errors of a tenth of each parameter"
        )
    return tuple(instructions)


def _instead_of_time(report: Excitation, same: list[tuple[int, int]]) -> str:
    """What helps where no record that anybody would make is long enough."""
    close = [pair for pair in report.unresolved if pair not in same]
    if close:
        j, k = min(close, key=lambda pair: abs(report.apparent[pair[0]] - report.apparent[pair[1]]))
        return f"take modes {j + 1} and {k + 1} as one: recording longer does not help"
    return "subtract the mean or the trend in place of a mode that slow: recording longer does not help"


def _needed_span(report: Excitation, same: list[tuple[int, int]]) -> float:
    """Duration that resolves the closest modes, and shows a period of the slowest; 0 if the record does."""
    gaps = [abs(report.apparent[j] - report.apparent[k]) for j, k in report.unresolved if (j, k) not in same]
    gaps += [float(report.apparent[l]) for l in report.slow] if not report.sufficient else []
    gaps = [gap for gap in gaps if gap > 0]
    return 2 * np.pi / min(gaps) if gaps else 0.0
