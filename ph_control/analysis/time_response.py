"""Time responses of port-Hamiltonian systems on modal coordinates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import wraps
from inspect import signature
from typing import Any, TypeVar, cast, overload

import control as ct
import numpy as np
from control import TimeResponseData
from control.timeresp import TimeResponseList
from numpy.typing import ArrayLike

from .. import _checks
from .._options import DISCRETISATIONS, INTERPOLATIONS, Discretisation, Interpolation
from .._types import Array, ComplexArray
from ..exceptions import StructureError
from ..modal.discretization import Hold
from ..modal.modal_form import imaginary
from ..numerics.rational import LinearSystem
from ..systems.base import Convertible, LosslessSystem, in_normal_form
from .other_systems import MOST_INSTANTS, as_system, check_exact, held, instants_of, responding
from .time_grid import default_time_vector
from .trajectories import check_finite, trajectory

_ALIASES = {
    "T": "timepts", "U": "inputs", "X0": "initial_state", "return_x": "return_states", "T_num": "timepts_num",
    "input": "input_indices", "output": "output_indices",
}  # fmt: skip

Response = TypeVar("Response", bound=Callable[..., Any])


def _with_aliases(response: Response) -> Response:
    """Let a function take the short names that python-control has for its arguments."""
    known = signature(response)
    names = [name for name in known.parameters if name != "aliases"]

    @wraps(response)
    def call(*args: Any, **options: Any) -> Any:
        for short in [key for key in options if key not in names]:
            name = _ALIASES.get(short)
            if name not in names:
                raise TypeError(f"unrecognized keyword: {short!r}")
            if name in options or name in names[: len(args)]:
                raise TypeError(f"multiple values for {name!r}: also given as {short!r}")
            options[name] = options.pop(short)
        squeeze = known.bind(*args, **options).arguments.get("squeeze")
        if squeeze is not None:
            _checks.flags(squeeze=squeeze)
        return response(*args, **options)

    return cast(Response, call)


@overload
def forced_response(sysdata: Sequence[Convertible], *args: Any, **kwargs: Any) -> TimeResponseList: ...
@overload
def forced_response(
    sysdata: Convertible, timepts: ArrayLike | None = ..., inputs: ArrayLike = ..., initial_state: ArrayLike = ...,
    transpose: bool = ..., return_states: bool | None = ..., squeeze: bool | None = ..., *,
    method: Discretisation = ..., intersample: Interpolation = ..., **aliases: ArrayLike | None,
) -> TimeResponseData: ...  # fmt: skip
@_with_aliases
def forced_response(
    sysdata: Convertible,
    timepts: ArrayLike | None = None,
    inputs: ArrayLike = 0.0,
    initial_state: ArrayLike = 0.0,
    transpose: bool = False,
    return_states: bool | None = None,
    squeeze: bool | None = None,
    *,
    method: Discretisation = "exact",
    intersample: Interpolation = "foh",
    **aliases: ArrayLike | None,
) -> TimeResponseData | TimeResponseList:
    """Response to an input signal and an initial state.

    Parameters
    ----------
    sysdata : PortHamiltonian, ControllableHamiltonian, ObservableHamiltonian, AffineHamiltonian, or list of them
        System to simulate.  Any other `StateSpace` or `TransferFunction` is simulated by python-control.
    timepts : array_like, shape (T,)
        Equally spaced instants; default as in `step_response`.
    inputs : array_like, shape (T,) or (m, T), or a number
        Input at these instants; shape (T, m) with `transpose`.
    initial_state : array_like, shape (2n,), or a number
        State `z` at the first instant.
    transpose : bool
        Time along the first axis of inputs and outputs.
    return_states, squeeze : bool, optional
        As in `control.forced_response`.  States are computed when first looked at, or at once with
        `return_states=True`; with `return_states=False` the response has none.  Unless it is given,
        the inputs of the response cannot be written: the states may still be made of them.
    method : {'exact', 'midpoint', 'euler'}
        Exact solution, implicit midpoint rule (symplectic), or explicit Euler (not lossless: energy grows).
    intersample : {'foh', 'zoh'}
        Input between samples: interpolated linearly, as `control.forced_response` does, or held, as a
        digital-to-analogue converter does.  Euler's rule takes the input at the start of each step, either way.
    **aliases
        `T`, `U`, `X0`, `return_x` for `timepts`, `inputs`, `initial_state`, `return_states`.

    Returns
    -------
    control.TimeResponseData, or control.TimeResponseList for a list of systems
        With the attribute `rule`: step, method and what the input did between samples.

    Raises
    ------
    StructureError
        If the system is none of these, the instants are not equally spaced, or sizes do not fit.
    TypeError
        If a keyword is unknown, or an argument is given twice, under both of its names.

    Notes
    -----
    Blocks of samples as matrix products, modal states carried between them: O(T (block + n)) for the outputs, with
    blocks of about `sqrt(180 n)` samples, and O(T n^2) for the states.  The phase of each mode is kept to twice the
    digits, so the error after 1e5 steps is below 1e-12 of the largest output.  'zoh' and 'foh' are
    exact hold equivalents.

    States of a canonical form have ten digits of their largest value or more: where doubles have not, decimal numbers
    of many digits take their place.  Where these would take too long, a `ConditioningWarning` tells the digits, and
    without any the record is refused.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> sys = phc.ph(phc.modes(1.0, 1.0))
    >>> t = np.linspace(0, 2 * np.pi, 5)
    >>> phc.forced_response(sys, t, 1.0).outputs.round(12) + 0.0
    array([ 0.,  1.,  0., -1.,  0.])

    A list of systems has a list of responses:

    >>> responses = phc.forced_response([sys, phc.ph(phc.modes(2.0, 1.0))], t, 1.0)
    >>> len(responses), responses[1].outputs.shape
    (2, (5,))
    """

    def run(sys: LosslessSystem, t: Array) -> TimeResponseData:
        u = _input_signal(inputs, sys.ninputs, t.size, transpose)
        problem = _Problem(sys, t, u, initial_state, method, intersample)
        u.flags.writeable = return_states is not None  # states that are still to come are made of it
        return _Response(
            None if return_states is False else problem.states, sys, t, problem.rule, problem.outputs(), inputs=u,
            issiso=sys.issiso(), output_labels=sys.output_labels, input_labels=sys.input_labels,
            title="Forced response for " + sys.name, transpose=transpose, return_x=bool(return_states),
            squeeze=squeeze, sysname=sys.name, trace_types=["forced"], plot_inputs=True,
        )  # fmt: skip

    def of_other(sys: LinearSystem, t: Array) -> TimeResponseData:
        u = _input_signal(inputs, sys.ninputs, t.size, transpose)
        return responding(
            ct.forced_response, held(sys, t, intersample), t, u.T if transpose else u,
            _initial_state(initial_state, sys.nstates), transpose=transpose, return_states=return_states,
            squeeze=squeeze,
        )  # fmt: skip

    return _each(sysdata, run, of_other, method, timepts, None)


@overload
def step_response(sysdata: Sequence[Convertible], *args: Any, **kwargs: Any) -> TimeResponseList: ...
@overload
def step_response(
    sysdata: Convertible, timepts: ArrayLike | None = ..., initial_state: ArrayLike = ...,
    input_indices: int | None = ..., output_indices: int | None = ..., timepts_num: int | None = ...,
    transpose: bool = ..., return_states: bool = ..., squeeze: bool | None = ..., *,
    method: Discretisation = ..., intersample: Interpolation = ..., **aliases: ArrayLike | None,
) -> TimeResponseData: ...  # fmt: skip
@_with_aliases
def step_response(
    sysdata: Convertible,
    timepts: ArrayLike | None = None,
    initial_state: ArrayLike = 0.0,
    input_indices: int | None = None,
    output_indices: int | None = None,
    timepts_num: int | None = None,
    transpose: bool = False,
    return_states: bool = False,
    squeeze: bool | None = None,
    *,
    method: Discretisation = "exact",
    intersample: Interpolation = "zoh",
    **aliases: ArrayLike | None,
) -> TimeResponseData | TimeResponseList:
    """Response to a unit step at each input.

    Parameters
    ----------
    sysdata : PortHamiltonian, ControllableHamiltonian, ObservableHamiltonian, AffineHamiltonian, or list of them
        System to simulate.  Any other `StateSpace` or `TransferFunction` is simulated by python-control.
    timepts : array_like, shape (T,), or a number
        Equally spaced instants, or the last one.  By default 20 samples in the shortest period and 3 of the
        longest; where that would be more than 20 000 samples, a `ResolutionWarning` names the modes not shown.
        A number you give, the last instant or how many, is yours: no warning follows from it.
    initial_state : array_like, shape (2n,), or a number
        State `z` at the first instant.
    input_indices, output_indices : int, optional
        Show this input or output only.
    timepts_num : int, optional
        Number of instants.
    transpose, return_states : bool
        As in `control.step_response`.
    squeeze : bool, optional
        As there.
    method : {'exact', 'midpoint', 'euler'}
        As in `forced_response`.
    intersample : {'zoh', 'foh'}
        As in `forced_response`.
    **aliases
        `T`, `T_num`, `X0`, `input`, `output`, `return_x` for `timepts`, `timepts_num`, `initial_state`,
        `input_indices`, `output_indices`, `return_states`.

    Returns
    -------
    control.TimeResponseData, or control.TimeResponseList for a list of systems

    Raises
    ------
    StructureError, TypeError
        As `forced_response`.

    Notes
    -----
    Cost and accuracy as `forced_response`.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> sys = phc.ph(phc.modes(2.0, 1.0))
    >>> response = phc.step_response(sys, np.linspace(0, 1, 101))
    >>> bool(np.allclose(response.outputs, np.sin(2 * response.time)))
    True
    """

    def run(sys: LosslessSystem, t: Array) -> TimeResponseData:
        def drive(port: int) -> tuple[Array, ArrayLike]:
            return np.eye(sys.ninputs)[:, port, None] * np.ones(t.size), initial_state

        layout = _TraceLayout(input_indices, output_indices, transpose, squeeze, return_states)
        return _traces(sys, t, drive, "Step", layout, method, intersample)

    def of_other(sys: LinearSystem, t: Array) -> TimeResponseData:
        _checks.choice("intersample", intersample, INTERPOLATIONS)
        picked = _chosen("input", input_indices, sys.ninputs), _chosen("output", output_indices, sys.noutputs)
        return responding(
            ct.step_response, sys, t, _initial_state(initial_state, sys.nstates), *picked, transpose=transpose,
            return_states=return_states, squeeze=squeeze,
        )  # fmt: skip

    return _each(sysdata, run, of_other, method, timepts, timepts_num)


@overload
def impulse_response(sysdata: Sequence[Convertible], *args: Any, **kwargs: Any) -> TimeResponseList: ...
@overload
def impulse_response(
    sysdata: Convertible, timepts: ArrayLike | None = ..., input_indices: int | None = ...,
    output_indices: int | None = ..., timepts_num: int | None = ..., transpose: bool = ...,
    return_states: bool = ..., squeeze: bool | None = ..., *, method: Discretisation = ..., **aliases: ArrayLike | None,
) -> TimeResponseData: ...  # fmt: skip
@_with_aliases
def impulse_response(
    sysdata: Convertible,
    timepts: ArrayLike | None = None,
    input_indices: int | None = None,
    output_indices: int | None = None,
    timepts_num: int | None = None,
    transpose: bool = False,
    return_states: bool = False,
    squeeze: bool | None = None,
    *,
    method: Discretisation = "exact",
    **aliases: ArrayLike | None,
) -> TimeResponseData | TimeResponseList:
    """Response to a unit impulse at each input: the free motion from `z = B e_j`.

    Parameters
    ----------
    sysdata, timepts, input_indices, output_indices, timepts_num, transpose, return_states, squeeze, method, **aliases
        As in `step_response`.

    Returns
    -------
    control.TimeResponseData, or control.TimeResponseList for a list of systems

    Raises
    ------
    StructureError, TypeError
        As `forced_response`.

    Notes
    -----
    For one port `y(t) = sum_l kappa_l cos(d_l t) + kappa_0`.  Cost and accuracy as `forced_response`.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> sys = phc.ph(phc.modes(2.0, 1.0))
    >>> response = phc.impulse_response(sys, np.linspace(0, 1, 101))
    >>> bool(np.allclose(response.outputs, 2 * np.cos(2 * response.time)))
    True
    """

    def run(sys: LosslessSystem, t: Array) -> TimeResponseData:
        def drive(port: int) -> tuple[Array, ArrayLike]:
            return np.zeros((sys.ninputs, t.size)), sys.B[:, port]

        layout = _TraceLayout(input_indices, output_indices, transpose, squeeze, return_states)
        return _traces(sys, t, drive, "Impulse", layout, method, "zoh")

    def of_other(sys: LinearSystem, t: Array) -> TimeResponseData:
        picked = _chosen("input", input_indices, sys.ninputs), _chosen("output", output_indices, sys.noutputs)
        return responding(
            ct.impulse_response, sys, t, *picked, transpose=transpose, return_states=return_states, squeeze=squeeze
        )

    return _each(sysdata, run, of_other, method, timepts, timepts_num)


@overload
def initial_response(sysdata: Sequence[Convertible], *args: Any, **kwargs: Any) -> TimeResponseList: ...
@overload
def initial_response(
    sysdata: Convertible, timepts: ArrayLike | None = ..., initial_state: ArrayLike = ...,
    output_indices: int | None = ..., timepts_num: int | None = ..., transpose: bool = ...,
    return_states: bool = ..., squeeze: bool | None = ..., *, method: Discretisation = ..., **aliases: ArrayLike | None,
) -> TimeResponseData: ...  # fmt: skip
@_with_aliases
def initial_response(
    sysdata: Convertible,
    timepts: ArrayLike | None = None,
    initial_state: ArrayLike = 0.0,
    output_indices: int | None = None,
    timepts_num: int | None = None,
    transpose: bool = False,
    return_states: bool = False,
    squeeze: bool | None = None,
    *,
    method: Discretisation = "exact",
    **aliases: ArrayLike | None,
) -> TimeResponseData | TimeResponseList:
    """Free motion from an initial state.

    Parameters
    ----------
    sysdata, timepts, initial_state, output_indices, timepts_num, transpose, return_states, squeeze, method, **aliases
        As in `step_response`.

    Returns
    -------
    control.TimeResponseData, or control.TimeResponseList for a list of systems

    Raises
    ------
    StructureError, TypeError
        As `forced_response`.

    Notes
    -----
    Cost and accuracy as `forced_response`.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> sys = phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0])
    >>> response = phc.initial_response(sys, np.linspace(0, 1, 101), [0.0, 1.0])
    >>> bool(np.allclose(response.outputs, np.cos(2 * response.time)))
    True
    """

    def run(sys: LosslessSystem, t: Array) -> TimeResponseData:
        picked, single = _selected("output", output_indices, sys.noutputs)
        problem = _Problem(sys, t, np.zeros((sys.ninputs, t.size)), initial_state, method, "zoh")
        return _Response(
            problem.states, sys, t, problem.rule, problem.outputs()[picked], issiso=sys.issiso() or single,
            output_labels=sys.output_labels[picked],
            title="Initial response for " + sys.name, transpose=transpose,
            return_x=bool(return_states), squeeze=squeeze, sysname=sys.name, trace_types=["initial"],
        )  # fmt: skip

    def of_other(sys: LinearSystem, t: Array) -> TimeResponseData:
        picked = _chosen("output", output_indices, sys.noutputs)
        return responding(
            ct.initial_response, sys, t, _initial_state(initial_state, sys.nstates), picked, transpose=transpose,
            return_states=return_states, squeeze=squeeze,
        )  # fmt: skip

    return _each(sysdata, run, of_other, method, timepts, timepts_num)


Run = Callable[[Any, Array], TimeResponseData]


def _each(
    sysdata: Convertible | Sequence[Convertible], run: Run, of_other: Run, method: Discretisation,
    timepts: ArrayLike | None, samples: int | None,
) -> TimeResponseData | TimeResponseList:  # fmt: skip
    """Run one system, or each of a list on common instants: those of the package, or others."""
    listed = sysdata if isinstance(sysdata, list | tuple) else [sysdata]
    if not listed:
        raise StructureError("the list of systems is empty; give at least one")
    systems = [as_system(sys) for sys in listed]
    others = [not isinstance(sys, LosslessSystem) for sys in systems]
    if any(others):
        check_exact(method)
    known = [sys for sys, other in zip(systems, others, strict=True) if not other]
    t = _instants(known, timepts, samples) if known else instants_of(systems, timepts, samples)
    runs = [of_other if other else run for other in others]
    responses = [each(sys, t if len(systems) == 1 else t.copy()) for each, sys in zip(runs, systems, strict=True)]
    return TimeResponseList(responses) if listed is sysdata else responses[0]


def _visible(sys: LosslessSystem) -> ComplexArray:
    """Poles that show in a response, one of each pair."""
    if in_normal_form(sys):
        return imaginary(sys.modes.d[sys.modes.nu.any(axis=1)])
    poles = sys.modes.mode_poles
    return poles[poles != 0]


def _instants(systems: list[LosslessSystem], timepts: ArrayLike | None, samples: int | None) -> Array:
    if timepts is not None and (isinstance(timepts, list | tuple) or np.ndim(timepts) > 0):
        return _checks.real_array("the time vector", timepts, 1)
    tfinal = None if timepts is None else _checks.sampling_step(timepts, name="the last instant")
    if samples is not None:
        _checks.whole_number("timepts_num", samples, 2, MOST_INSTANTS)
    visible = [_visible(sys) for sys in systems]
    return default_time_vector(np.concatenate(visible), tfinal, samples)


@dataclass(frozen=True)
class _TraceLayout:
    """Inputs and outputs of a response that are shown, and the order and number of its axes as in python-control."""

    input: object
    output: object
    transpose: bool
    squeeze: bool | None
    return_states: bool


def _traces(
    sys: LosslessSystem, t: Array, drive: Callable[[int], tuple[Array, ArrayLike]], kind: str, layout: _TraceLayout,
    method: Discretisation, intersample: Interpolation,
) -> TimeResponseData:  # fmt: skip
    """Responses to one input at a time, as python-control lays them out."""
    rows, one_output = _selected("output", layout.output, sys.noutputs)
    shown, one_input = _selected("input", layout.input, sys.ninputs)
    ports = range(sys.ninputs)[shown]
    problems = [_Problem(sys, t, *drive(port), method, intersample) for port in ports]
    y = np.stack([problem.outputs()[rows] for problem in problems], axis=1)
    drives = [problem.u[shown] if kind == "Step" else np.zeros_like(problem.u[shown]) for problem in problems]
    return _Response(
        lambda: np.stack([problem.states() for problem in problems], axis=1), sys, t, problems[0].rule, y,
        inputs=np.stack(drives, axis=1), issiso=sys.issiso() or (one_output and one_input),
        output_labels=sys.output_labels[rows], input_labels=sys.input_labels[shown],
        title=f"{kind} response for {sys.name}", transpose=layout.transpose, return_x=bool(layout.return_states),
        squeeze=layout.squeeze, sysname=sys.name, trace_labels=[f"From {sys.input_labels[port]}" for port in ports],
        trace_types=[kind.lower()] * len(ports), plot_inputs=False,
    )  # fmt: skip


def _selected(kind: str, index: object, count: int) -> tuple[slice, bool]:
    """Which inputs or outputs to show, and whether one was chosen: a number, or a list of one as python-control."""
    if index is None:
        return slice(None), False
    chosen = index[0] if isinstance(index, list | tuple) and len(index) == 1 else index
    if not (isinstance(chosen, int | np.integer) and 0 <= chosen < count):
        raise StructureError(f"{kind}_indices is {index!r}; it must be one number from 0 to {count - 1}")
    return slice(int(chosen), int(chosen) + 1), True


def _chosen(kind: str, index: object, count: int) -> int | None:
    """The number of an input or output to show; None for all."""
    picked, single = _selected(kind, index, count)
    return picked.start if single else None


def _input_signal(inputs: ArrayLike, ports: int, samples: int, transpose: bool) -> Array:
    u = _checks.real_array("the input", inputs)
    if u.ndim == 0:
        return np.full((ports, samples), float(u))
    if transpose and u.ndim == 2:
        u = u.T
    if u.ndim == 1 and ports == 1:
        u = u[None, :]
    if u.shape != (ports, samples):
        wanted = f"({samples},) or (1, {samples})" if ports == 1 else f"({ports}, {samples})"
        wanted = f"{wanted[:-1]}), transposed" if transpose else wanted
        raise StructureError(f"the input has shape {np.shape(inputs)}; with {samples} instants it must be {wanted}")
    return u


def _initial_state(value: ArrayLike, size: int) -> Array:
    z = _checks.real_array("the initial state", value)
    if z.ndim == 0:
        return np.full(size, float(z))
    if z.shape not in ((size,), (size, 1)):
        raise StructureError(f"the initial state has shape {z.shape}; the system has {size} states")
    return z.ravel()


class _Problem:
    """One input and one initial state for one system; outputs and states are separate work."""

    def __init__(
        self,
        sys: LosslessSystem,
        t: Array,
        u: Array,
        initial_state: ArrayLike,
        method: Discretisation,
        intersample: Interpolation,
    ) -> None:  # fmt: skip
        _checks.choice("method", method, DISCRETISATIONS)
        _checks.choice("intersample", intersample, INTERPOLATIONS)
        # Euler's rule takes the input at the start of a step, whatever it does until the next
        hold, h = "zoh" if method == "euler" else intersample, _checks.time_step(t) or 1.0
        self.sys, self.u, self.rule = sys, u, Hold(h, method, hold)
        self.z0 = _initial_state(initial_state, sys.nstates)

    def outputs(self) -> Array:
        """Outputs, shape (m, T)."""
        return self._solved(False)[0]

    def states(self) -> Array:
        """States, shape (2n, T)."""
        states = self._solved(True)[1]
        return np.zeros((self.sys.nstates, self.u.shape[1])) if states is None else states

    def _solved(self, states: bool) -> tuple[Array, Array | None]:
        with np.errstate(over="ignore", invalid="ignore"):
            y, z = trajectory(self.sys, self.u, self.z0, self.rule, states=states)
        growth = float(np.hypot(1.0, self.rule.h * self.sys.modes.natural_frequencies.max(initial=0.0)))
        check_finite(y, z, growth if self.rule.method == "euler" else 1.0, self.rule)
        return y, z


class _Response(TimeResponseData):
    """Response whose states are made when first looked at; without a function for them it has none."""

    def __init__(
        self, compute: Callable[[], Array] | None, sys: LosslessSystem, t: Array, rule: Hold, y: Array,
        **described: Any,
    ) -> None:  # fmt: skip
        self._compute: Callable[[], Array] | None = None
        self._states: Array | None = None
        self.rule = rule
        # of one sample, since all given to it is copied; no rows rather than no states, on which `states` fails
        first = slice(None, 1)
        u = described.pop("inputs", None)
        super().__init__(t[first], y[..., first], y[:0, ..., first], None if u is None else u[..., first], **described)
        self.t, self.y, self.u, self.x = t, y, u, y[:0]
        if compute is not None:
            self._compute, self.nstates, self.state_labels = compute, sys.nstates, list(sys.state_labels)
            if self.return_x:
                self.x  # noqa: B018  # asked for

    @property
    def x(self) -> Array | None:
        """States as computed."""
        if self._compute is not None:
            self._states, self._compute = self._compute(), None
        return self._states

    @x.setter
    def x(self, value: Array | None) -> None:
        self._states, self._compute = value, None

    def __copy__(self) -> _Response:
        other = object.__new__(type(self))
        other.__dict__.update(self.__dict__)
        return other

    def __getstate__(self) -> dict[str, object]:
        self.x  # noqa: B018  # a function cannot be pickled, what it gives can
        return self.__dict__
