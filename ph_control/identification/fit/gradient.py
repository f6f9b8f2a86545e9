"""Gradient descent on the parameters of the observable form: the learning scheme of the paper, to compare with.

In the operator `delta = (z - 1)/h` of Euler's rule the observable form is

    y = sum_l kappa_l delta/(delta^2 + d_l^2) u  +  sum_k s_k(0) delta^{k-1} / prod_l (delta^2 + d_l^2) impulse,

so the output and its derivatives come from resonators `1/(delta^2 + d^2)` alone, one after the other for the initial
state: nothing is lost where frequencies meet, as they do while descending.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, get_args

import control as ct
import numpy as np
from scipy.signal import lfilter

from ... import _checks
from ..._display import Report
from ..._frozen import Frozen
from ..._types import Array, ArrayLike, Mask, RandomSource
from ...exceptions import IdentificationError, StructureError
from ...modal.modal_form import from_frequencies
from ...systems.canonical_forms import ObservableHamiltonian, oh
from ...systems.port_hamiltonian import PortHamiltonian, ph
from ..data.experiments import as_record
from ..data.time_record import Record
from ..uncertainty.state_coordinates import observable_state

Parameters = Literal["natural", "unique"]
Optimizer = Literal["plain", "adam"]
SimulatedState = Literal["fitted", "final", "zero"]

_MOST = 10**9  # steps
_SLOWEST = 1e-3  # turn (rad) of the slowest mode over the record: slower ones are not told from a pole at 0
_MOMENTUM, _MEMORY, _FLOOR = 0.9, 0.999, 1e-8  # what Kingma and Ba recommend for Adam


@dataclass(frozen=True, eq=False, repr=False)
class GradientResult(Report, Frozen):
    """Result of `gradient_descent`: the parameters with the smallest loss on the way.

    Attributes
    ----------
    parameters : {'natural', 'unique'}
        Coordinates that were descended in.
    d : ndarray, shape (n,)
        Natural frequencies; ascending for 'unique'.
    v : ndarray, shape (2n,)
        Input vector; for 'unique' `(sqrt(r), 0)`.
    r : ndarray, shape (n,)
        Weights `v_l^2 + v_{n+l}^2` in the order of `d`.
    initial_state : ndarray, shape (2n,)
        State of `observable_form` at the first sample.
    loss_history : ndarray, shape (epochs + 1,)
        Mean squared error before each step and after the last; shorter where it left the range of doubles.
    validation_history : ndarray, shape (epochs + 1,), or None
        Mean squared error on the validation record, with the same parameters.
    best_epoch : int
        Steps after which the loss was smallest.
    diverged : bool
        Whether the loss left the range of doubles.
    stable_rate : float
        Learning rate beyond which plain steps leave a minimum with the curvature found here: 2 over the largest
        eigenvalue of the Gauss-Newton matrix.
    message : str
        What happened, in sentences.
    record : Record
        The data.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> u = np.random.default_rng(0).standard_normal(100)
    >>> y = phc.forced_response(phc.ph(phc.modes(1.0, 0.5)), 0.1 * np.arange(100), u, method="euler").outputs
    >>> result = phc.gradient_descent((u, y), 1, dt=0.1, epochs=20, initial_guess=([1.1], [0.5, 0.0], [0.0, 0.0]))
    >>> result.loss_history.shape, result.best_epoch, result.diverged
    ((21,), 20, False)
    """

    parameters: str
    d: Array
    v: Array
    r: Array
    initial_state: Array
    loss_history: Array
    validation_history: Array | None
    best_epoch: int
    diverged: bool
    stable_rate: float
    message: str
    record: Record

    def __str__(self) -> str:
        """Say how far the descent came, and what happened."""
        return f"{len(self.d)} modes, mean squared error {self.loss:.4g} after {self.best_epoch} steps\n{self.message}"

    @property
    def loss(self) -> float:
        """Mean squared error of the parameters kept."""
        return float(self.loss_history[self.best_epoch])

    @cached_property
    def system(self) -> PortHamiltonian:
        """Port-Hamiltonian system with the same transfer function."""
        return ph(from_frequencies(self.d, self.r))

    @cached_property
    def observable_form(self) -> ObservableHamiltonian:
        """Observable form that `initial_state` is a state of."""
        return oh(self.d, self.v)

    def predict(self, u: ArrayLike, *, initial_state: ArrayLike | SimulatedState = "fitted") -> ct.TimeResponseData:
        """Output of the learned observable form by Euler's rule.

        Parameters
        ----------
        u : array_like, shape (T,)
            Inputs, with the step of the record that was learned from.
        initial_state : array_like, shape (2n,), or {'fitted', 'final', 'zero'}
            State of `observable_form` at the first sample: the learned one, the one after the last sample of the
            record, rest, or another.

        Returns
        -------
        control.TimeResponseData

        Raises
        ------
        StructureError
            If the input or the state is not of this form.

        Examples
        --------
        See `gradient_descent`.
        """
        past = np.zeros(0)
        start = self.initial_state
        if isinstance(initial_state, str):
            _checks.choice("initial_state", initial_state, get_args(SimulatedState))
            past = self.record.u if initial_state == "final" else past
            start = 0.0 * start if initial_state == "zero" else start
        else:
            start = _vector("initial_state", initial_state, 2 * len(self.d))
        new = as_record((u, None), self.record.dt, output_needed=False)
        forced, free = columns(self.d, np.concatenate([past, new.u]), new.dt)
        y = (self.r * self.d) @ forced + start @ free
        return ct.TimeResponseData(
            new.time, y[len(past) :], inputs=new.u, issiso=True, input_labels=[self.record.input_label],
            output_labels=[self.record.output_label], title="Prediction",
        )  # fmt: skip


def gradient_descent(
    data: object,
    order: int,
    *,
    dt: float | None = None,
    parameters: Parameters = "natural",
    optimizer: Optimizer = "plain",
    learning_rate: float = 0.1,
    epochs: int = 500,
    initial_guess: Any = None,
    validation: object = None,
    rng: RandomSource = None,
) -> GradientResult:
    """Learn a lossless model by gradient descent, as the paper does; a reference, use `pem` for work.

    Descends on the mean squared error of the output of the observable form `oh(d, v)`, integrated by Euler's rule from
    an initial state that is learned too.  The gradient is that of the whole record, and exact.

    Parameters
    ----------
    data : control.TimeResponseData, or pair (u, y) of array_like, shape (T,) each
        One input and one output on a uniform grid; NaN outputs are missing samples.  Not modified.
    order : int
        Number of modes n.
    dt : float, optional
        Time between samples; required with arrays.
    parameters : {'natural', 'unique'}
        Coordinates: `(d, v)`, or `(d, r)` with `r >= 0`, sorted so that `d` ascends.  Steps that leave `d > 0` or
        `r >= 0` are projected back.
    optimizer : {'plain', 'adam'}
        Steps of `learning_rate` times the gradient, or those of Adam, which are about `learning_rate` long in each
        parameter whatever the size of the gradient.
    learning_rate : float
        As above.
    epochs : int
        Number of steps.
    initial_guess : sequence (d, v, s0) or (d, r, s0), optional
        Where to start; `s0` of shape (2n,) is a state of `oh(d, v)`.  Default: random, of the size of the signals.
    validation : control.TimeResponseData, or pair (u, y), optional
        What follows on `data`, with the same step, for `validation_history`.
    rng : numpy.random.Generator or int, optional
        For the random start.

    Returns
    -------
    GradientResult

    Raises
    ------
    StructureError
        If the data or options are not of this form.
    IdentificationError
        If the record cannot carry the order, or its output is zero.

    Notes
    -----
    O(T n^2) a step.  What is found depends on the start and on the rate; `pem` needs neither.  The loss has many minima
    in `d`, and its curvature grows with the square of the amplitude and of the length of the record, and for n > 1 with
    high powers of time in the initial state.  For the recordings of the paper plain steps are stable at the true
    parameters only for rates below 0.0067 (chain, n = 2) and about 0.001 (circuit, n = 5), where the paper names 0.02
    and 0.1; those make sense as steps of Adam.  The descent also depends on units: choose that of time such that the
    frequencies are about 1.  Plain descent in `v` is descent in `r` with `4 r` times the rate: it only scales each pair
    `(v_l, v_{n+l})`, so a weight that starts near 0 stays there for long.

    Data of Euler's rule are not those of a lossless system.  A real recording should be fitted by `pem`.

    Examples
    --------
    >>> import numpy as np
    >>> import ph_control as phc
    >>> u = np.random.default_rng(0).standard_normal(100)
    >>> y = phc.forced_response(phc.ph(phc.modes(1.0, 0.5)), 0.1 * np.arange(100), u, method="euler").outputs
    >>> start = ([1.1], [0.3], [0.0, 0.0])
    >>> result = phc.gradient_descent((u, y), 1, dt=0.1, parameters="unique", learning_rate=0.2, initial_guess=start)
    >>> result.d.round(3), result.r.round(3)
    (array([1.]), array([0.5]))
    >>> ahead = result.predict(u[:10], initial_state="final")
    """
    _checks.choice("parameters", parameters, get_args(Parameters))
    _checks.choice("optimizer", optimizer, get_args(Optimizer))
    if not (_checks.is_number(learning_rate) and 0 < learning_rate < float(np.finfo(float).max)):
        raise StructureError(f"learning_rate is {_checks.shown(learning_rate)}; it must be a positive number")
    rate, steps = float(learning_rate), _checks.whole_number("epochs", epochs, 1, _MOST)
    record = as_record(data, dt)
    n = _order(record, _checks.whole_number("order", order, 1))
    validation_record = None if validation is None else as_record(validation, record.dt)
    if validation_record is not None and not validation_record.observed.any():
        raise StructureError("the validation record has no outputs to compare the model with; pass (u, y) with outputs")
    problem = EulerProblem.of(record, validation_record, n, parameters == "natural")
    start = _random_start(problem, rng) if initial_guess is None else _checked_start(problem, initial_guess)
    best, losses, validations = _descend(problem, start, rate, steps, optimizer == "adam")
    best_epoch = int(np.argmin(losses))
    d, r, s0 = problem.split(best.theta)
    ascending = np.arange(n) if problem.natural else np.argsort(d, kind="stable")
    d, r = d[ascending], r[ascending]
    v = best.theta[n : 3 * n].copy() if problem.natural else np.append(np.sqrt(r), np.zeros(n))
    # 2 over the largest eigenvalue of `2/T J J^T`
    size = float(np.linalg.norm(best.jacobian, 2)) if np.isfinite(best.jacobian).all() else np.inf
    stable_rate = int(problem.training.sum()) / size**2 if size else np.inf
    return GradientResult(
        parameters=parameters, d=d, v=v, r=r, initial_state=s0.copy(), loss_history=losses,
        validation_history=None if validation_record is None else validations, best_epoch=best_epoch,
        diverged=len(losses) <= steps, stable_rate=stable_rate, record=record,
        message=_message(problem, losses, best_epoch, steps, stable_rate if optimizer == "plain" else None, d, r),
    )  # fmt: skip


# --- the descent -------------------------------------------------------------------------------------------------


def _descend(problem: EulerProblem, theta: Array, rate: float, epochs: int, adam: bool) -> tuple[Point, Array, Array]:
    """Best point, and the losses on both records, of so many steps, or of those until the loss is not finite."""
    adam_steps = _AdamSteps(len(theta)) if adam else None
    losses: list[float] = []
    validations: list[float] = []
    best: Point | None = None
    # a descent that diverges leaves the range of doubles: seen in the loss, and reported
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(epochs + 1):
            point = problem.evaluated(theta)
            if not (np.isfinite(point.loss) and np.isfinite(point.gradient).all()):
                break
            losses.append(point.loss)
            validations.append(point.validation)
            if best is None or point.loss < best.loss:
                best = point
            step = adam_steps.step(point.gradient) if adam_steps else point.gradient
            theta = problem.projected(theta - rate * step)
    if best is None:
        raise StructureError(
            "the loss of the initial guess exceeds the range of doubles; start with smaller frequencies or states"
        )
    return best, np.array(losses), np.array(validations)


class _AdamSteps:
    """Steps of Adam: the mean of the gradients over the root of the mean of their squares."""

    def __init__(self, size: int) -> None:
        self.mean, self.square, self.count = np.zeros(size), np.zeros(size), 0

    def step(self, gradient: Array) -> Array:
        """Step for a rate of 1."""
        self.count += 1
        self.mean += (1 - _MOMENTUM) * (gradient - self.mean)
        self.square += (1 - _MEMORY) * (gradient**2 - self.square)
        mean, square = self.mean / (1 - _MOMENTUM**self.count), self.square / (1 - _MEMORY**self.count)
        return mean / (np.sqrt(square) + _FLOOR)


def _message(
    problem: EulerProblem, losses: Array, best_epoch: int, epochs: int, stable_rate: float | None, d: Array, r: Array
) -> str:
    best, power = losses[best_epoch], float(np.var(problem.y[problem.training])) or 1.0
    sentences = [
        f"{len(losses) - 1} steps of {epochs}: mean squared error {losses[0]:.3g} at the start, {best:.3g} at best "
        f"({float(f'{100 * best / power:.2g}'):g} % of the variance of the output)."
    ]
    choice = f"The parameters after step {best_epoch} are kept"
    if len(losses) <= epochs:
        sentences.append(
            f"The descent diverged: after step {len(losses)} the loss left the range of doubles. {choice}."
        )
    elif best_epoch < epochs:
        sentences.append(f"{choice}; the loss was {losses[-1]:.3g} at the end.")
    if stable_rate is not None:
        sentences.append(f"Near the parameters kept plain steps are stable for learning rates below {stable_rate:.2g}.")
    for name, at_bound in (("d at its lower bound", d <= problem.slowest), ("r at 0", r == 0)):
        if at_bound.any():
            modes = ", ".join(str(l + 1) for l in np.flatnonzero(at_bound))
            sentences.append(f"Mode{'s' * int(at_bound.sum() > 1)} {modes} ended with {name}.")
    return " ".join(sentences)


# --- where to start, and what is allowed -----------------------------------------------------------------------------


def _random_start(problem: EulerProblem, rng: RandomSource) -> Array:
    """Random parameters of the size of the signals.

    Frequencies up to twice the mean frequency of the output, weights in the ratio of the signals, and modes that
    together move as much as the output does.
    """
    random = _checks.random_generator(rng)
    n, u, y = problem.n, problem.u[: problem.samples], problem.y[: problem.samples]
    size, drive = np.sqrt(np.mean(y**2)), np.sqrt(np.mean(u**2))
    mean = np.linalg.norm(np.diff(y)) / problem.h / np.linalg.norm(y)
    d = np.sort(random.uniform(0.1, 2.0, n)) * max(mean, problem.slowest)
    v = random.standard_normal(2 * n) * np.sqrt(size / drive / (2 * n) if drive else 1.0)
    velocity, position = random.standard_normal((2, n)) * size / np.sqrt(n)
    motion, _ = observable_state(d, velocity + 1j * position)
    return np.concatenate([d, v if problem.natural else weights_of(v), motion])


def _checked_start(problem: EulerProblem, guess: Any) -> Array:
    """Checked parameters from `(d, v or r, s0)`."""
    name = "v" if problem.natural else "r"
    if isinstance(guess, str) or not hasattr(guess, "__len__") or len(guess) != 3:
        raise StructureError(f"initial_guess is not a triple; give (d, {name}, s0), s0 a state of oh(d, v)")
    n = problem.n
    d, s0 = _vector("d of the initial guess", guess[0], n), _vector("s0 of the initial guess", guess[2], 2 * n)
    _checks.natural_frequencies(d)
    if problem.natural:
        p = _vector("v of the initial guess", guess[1], 2 * n)
    else:
        p = _checks.residue_weights(guess[1], n)
    return problem.projected(np.concatenate([d, p, s0]))


def _vector(name: str, value: ArrayLike, size: int) -> Array:
    array = np.atleast_1d(_checks.real_array(name, value))
    if array.shape != (size,):
        raise StructureError(f"{name} has shape {array.shape}; with this order it must be ({size},)")
    return array


def _order(record: Record, order: int) -> int:
    observed = int(record.observed.sum())
    if 4 * order >= observed:
        raise IdentificationError(
            f"order {_checks.shown(order)} has {_checks.shown(4 * order)} unknowns, more than the {observed} observed "
            f"samples can carry; the largest order for this record is {max(0, (observed - 1) // 4)}"
        )
    if not record.y[record.observed].any():
        raise IdentificationError("the output is zero throughout the record; there is nothing to model")
    return order


# --- the output by Euler's rule, and its derivatives by the parameters ------------------------------------------------


def _resonator_response(d: float, h: float, x: Array) -> tuple[Array, Array]:
    """`1/(delta^2 + d^2) x` and `delta/(delta^2 + d^2) x` from rest: parts of `1/(delta + i d) x`."""
    w = lfilter([0.0, h], [1.0, complex(-1.0, h * d)], x)
    return w.imag / -d, w.real


def columns(d: Array, u: Array, h: float) -> tuple[Array, Array]:
    """Signals of which the output is a sum: forced `delta/(delta^2 + d_l^2) u`, shape (n, T); free, shape (2n, T).

    Free signal k is the output from `s(0) = e_k`: `delta^{k-1} / prod (delta^2 + d_l^2)` of an impulse.
    """
    n = len(d)
    forced = np.array([_resonator_response(frequency, h, u)[1] for frequency in d])
    impulse = np.zeros(len(u))
    impulse[0] = 1.0
    # one resonator after the other, the first before the step of delay that the others have
    w = lfilter([1.0], [1.0, complex(-1.0, h * d[0])], impulse)
    position, velocity = [w.imag / -d[0]], [w.real]
    for frequency in d[1:]:
        for signals, signal in zip((position, velocity), _resonator_response(frequency, h, position[-1]), strict=True):
            signals.append(signal)
    # delta^2 times the last position is the one before it less d^2 times itself, and so on
    links = np.diag(np.ones(n - 1), -1) - np.diag(d**2)
    rows = [np.eye(n)[-1]]
    for _ in range(n - 1):
        rows.append(rows[-1] @ links)
    free = np.empty((2 * n, len(u)))
    free[0::2], free[1::2] = np.array(rows) @ np.array(position), np.array(rows) @ np.array(velocity)
    return forced, free


@dataclass(frozen=True)
class Point:
    """Parameters, their loss on both records, and the derivative of the output by each, shape (parameters, T)."""

    theta: Array
    loss: float
    validation: float
    gradient: Array
    jacobian: Array


@dataclass(frozen=True)
class EulerProblem:
    """A record, what follows on it, and the coordinates to descend in: `theta = (d, v or r, s0)`."""

    u: Array
    y: Array
    training: Mask
    validation: Mask
    samples: int
    h: float
    n: int
    natural: bool

    @classmethod
    def of(cls, record: Record, validation_record: Record | None, n: int, natural: bool) -> EulerProblem:
        """Put the two records behind one another; missing outputs count in neither."""
        u, y = record.u, record.y
        if validation_record is not None:
            u, y = np.append(u, validation_record.u), np.append(y, validation_record.y)
        observed, training = ~np.isnan(y), np.arange(len(u)) < record.samples
        return cls(
            u, np.where(observed, y, 0.0), observed & training, observed & ~training, record.samples, record.dt, n,
            natural,
        )  # fmt: skip

    @property
    def slowest(self) -> float:
        """Lower bound of the natural frequencies."""
        return _SLOWEST / (self.samples * self.h)

    @property
    def split_places(self) -> tuple[int, int]:
        """Where the second and third part of the parameters start."""
        return self.n, 3 * self.n if self.natural else 2 * self.n

    def split(self, theta: Array) -> tuple[Array, Array, Array]:
        """Frequencies, weights `r`, and initial state."""
        d, p, s0 = np.split(theta, self.split_places)
        return d, weights_of(p) if self.natural else p, s0

    def projected(self, theta: Array) -> Array:
        """Nearest parameters of a port-Hamiltonian system."""
        d, p, s0 = np.split(theta, self.split_places)
        return np.concatenate([np.maximum(d, self.slowest), p if self.natural else np.maximum(p, 0.0), s0])

    def evaluated(self, theta: Array) -> Point:
        """Loss, exact gradient and Jacobian: O(T n^2)."""
        d, r, s0 = self.split(theta)
        forced, free = columns(d, self.u, self.h)
        motion = s0 @ free
        error = (r * d) @ forced + motion - self.y
        loss, validation = (_mean_square(error[mask]) for mask in (self.training, self.validation))
        record = slice(self.samples)
        forced, free, motion = forced[:, record], free[:, record], motion[record]
        by_d = np.empty((self.n, self.samples))
        for l in range(self.n):
            second_response, _ = _resonator_response(d[l], self.h, r[l] * d[l] * forced[l] + motion)
            by_d[l] = r[l] * forced[l] - 2 * d[l] * second_response
        by_p = d[:, None] * forced
        if self.natural:
            v = theta[self.n : 3 * self.n]
            by_p = 2 * v[:, None] * np.concatenate([by_p, by_p])
        jacobian = np.concatenate([by_d, by_p, free])
        counted = self.training[record]
        gradient = 2 * jacobian @ (error[record] * counted) / counted.sum()
        return Point(theta, loss, validation, gradient, jacobian * counted)


def weights_of(v: Array) -> Array:
    """Weights `r` of an input vector."""
    n = len(v) // 2
    return v[:n] ** 2 + v[n:] ** 2


def _mean_square(error: Array) -> float:
    return float(error @ error) / len(error) if len(error) else 0.0
