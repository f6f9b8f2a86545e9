"""A function from physical parameters to a system, with names, bounds, relative steps, and a count of its calls."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ... import _checks
from ..._types import Array, ArrayLike, Mask
from ..._units import common_unit
from ...exceptions import StructureError
from ...systems.base import Convertible
from .physical_modes import PhysicalModes, modes_of_system

CALLS = 20  # of the function for each parameter, at most
_STEP = 1e-6  # of a parameter, where nothing is known of its error
_STEPS = 1e-8, 1e-4  # smallest and largest such step
_LEAST, _SMALL = 0.2, 1e-3  # part of a parameter that a step leaves, and of its scale, below which it may cross 0
_OF_ERROR = 0.02  # standard errors of a step


@dataclass(eq=False)
class ModelFunction:
    """A system as a function of parameters.

    Attributes
    ----------
    function : callable
        From an array (P,) to a system.
    names : tuple of str
        Of the parameters.
    start, lower, upper : ndarray, shape (P,)
        Where they start, and between what they are.
    outputs, inputs : int
        Channels that the system must have.
    slowest : float
        Rate below which data show none.
    time_unit : str or None
        Unit of time of the data: a system of another one is refused.
    """

    function: Callable[[Array], Convertible]
    names: tuple[str, ...]
    start: Array
    lower: Array
    upper: Array
    outputs: int = 0
    inputs: int = 0
    slowest: float = 1.0
    time_unit: str | None = None
    calls: int = 0
    best: Array | None = None
    _known: dict[bytes, PhysicalModes] = field(default_factory=dict)

    @classmethod
    def checked(
        cls,
        function: Callable[[Array], Convertible],
        parameters: ArrayLike | Mapping[str, float] | None,
        bounds: Sequence[ArrayLike] | None = None,
    ) -> ModelFunction:
        """Check a function, parameters to start from, and bounds.

        Parameters
        ----------
        function : callable
            From an array (P,) to a system.
        parameters : array_like, shape (P,), or mapping from name to value, or None
            Where to start; None takes the `values` of the function, as `read_netlist` gives them.
        bounds : pair of array_like, shape (P,) or numbers, optional
            Lower and upper bounds, numbers or (P,), as in `scipy.optimize.least_squares`.

        Returns
        -------
        ModelFunction

        Raises
        ------
        StructureError
            If one of them is not of this form.
        """
        if not callable(function):
            raise StructureError(
                f"model is {_checks.shown(function)}; it must be a function from parameters to a system"
            )
        names = tuple(getattr(function, "names", ()))
        if parameters is None:
            parameters = getattr(function, "values", None)
        if parameters is None:
            raise StructureError("a model needs parameters to start from: parameters=[..]")
        if isinstance(parameters, Mapping):
            names, parameters = tuple(map(str, parameters)), list(parameters.values())
        start = np.atleast_1d(_checks.real_array("parameters", parameters))
        if start.ndim != 1 or not start.size:
            raise StructureError(f"parameters have shape {start.shape}; they must be a vector of at least one number")
        if len(names) != len(start):
            names = tuple(f"theta[{k}]" for k in range(len(start)))
        lower, upper = _checked_bounds(bounds, names, start)
        return cls(function, names, start, lower, upper)

    @property
    def scale(self) -> Array:
        """Size of each parameter."""
        span = np.where(np.isfinite(self.upper - self.lower), self.upper - self.lower, 1.0)
        return np.where(self.start != 0, np.abs(self.start), np.where(span > 0, span, 1.0))

    @property
    def exhausted(self) -> bool:
        """Whether no calls are left for another set of derivatives."""
        return self.calls + len(self.start) > self.most

    @property
    def is_spent(self) -> bool:
        """Whether no calls are left."""
        return self.calls >= self.most

    @property
    def most(self) -> int:
        """How often the function may be called."""
        return CALLS * len(self.start)

    def inside(self, theta: Array) -> Array:
        """Parameters brought within their bounds."""
        return np.clip(theta, self.lower, self.upper)

    def stepped(self, theta: Array, step: Array) -> Array:
        """Parameters after a step in units of their scale, within their bounds.

        None changes its sign in one step unless it is small: stiffness and resistance stay positive.
        """
        moved = theta + self.scale * step
        across = (moved * theta < _LEAST * theta**2) & (np.abs(theta) > _SMALL * self.scale)
        return self.inside(np.where(across, _LEAST * theta, moved))

    def at_bound(self, theta: Array) -> Mask:
        """Which parameters are at a bound."""
        return (theta <= self.lower) | (theta >= self.upper)

    def may_move(self, theta: Array, slope: Array) -> Mask:
        """Which parameters are not at a bound that the slope (P,) of the loss pushes them across."""
        return np.asarray(~(((theta <= self.lower) & (slope > 0)) | ((theta >= self.upper) & (slope < 0))))

    def modes(self, theta: Array) -> PhysicalModes:
        """Modes of the system at some parameters."""
        key = theta.tobytes()
        if key not in self._known:
            self._known[key] = self._called(theta)
        return self._known[key]

    def neighbours(self, theta: Array, errors: Array | None = None) -> list[tuple[float, PhysicalModes]]:
        """Step of each parameter and the modes there; steps are a part of its standard error where that is known."""
        size = np.maximum(np.abs(theta), 1e-3 * self.scale)
        steps = _STEP * size
        if errors is not None:
            known = np.isfinite(errors) & (errors > 0)
            steps = np.where(known, np.clip(_OF_ERROR * np.where(known, errors, 0.0), *np.outer(_STEPS, size)), steps)
        steps = np.where(theta + steps > self.upper, -steps, steps)
        near = []
        for k, step in enumerate(steps.tolist()):
            moved = theta.copy()
            moved[k] += step
            near.append((float(moved[k] - theta[k]), self.modes(moved)))
        return near

    def opposite(self, theta: Array, near: Sequence[tuple[float, PhysicalModes]]) -> list[tuple[float, PhysicalModes]]:
        """The same with steps the other way, as far as bounds allow."""
        other = []
        for k, (step, model) in enumerate(near):
            moved = theta.copy()
            moved[k] -= step
            inside = self.lower[k] <= moved[k] <= self.upper[k]
            other.append((float(moved[k] - theta[k]), self.modes(moved)) if inside else (step, model))
        return other

    def _called(self, theta: Array) -> PhysicalModes:
        self.calls += 1
        sys = self.function(theta.copy())
        common_unit(self, sys)
        modes = modes_of_system(sys, self.slowest)
        shape = modes.feedthrough.shape
        if self.outputs and (shape[0] != self.outputs or (self.inputs and shape[1] != self.inputs)):
            raise StructureError(
                f"the model function returns a system of {shape[1]} inputs and {shape[0]} outputs; the data have "
                f"{self.inputs} inputs and {self.outputs} outputs: return those measured, sys[outputs, inputs]"
            )
        if not self.inputs:
            return PhysicalModes(modes.poles, modes.shapes, modes.participation[:, :0], modes.feedthrough[:, :0])
        return modes


def _checked_bounds(bounds: Sequence[ArrayLike] | None, names: tuple[str, ...], start: Array) -> tuple[Array, Array]:
    """Lower and upper bounds of each parameter; infinite without some."""
    if bounds is None:
        return np.full(len(start), -np.inf), np.full(len(start), np.inf)
    try:
        pair = [np.broadcast_to(np.asarray(bound, float), start.shape).copy() for bound in bounds]
    except (TypeError, ValueError):
        pair = []
    if len(pair) != 2 or any(np.isnan(bound).any() for bound in pair):
        raise StructureError(
            f"bounds are {_checks.shown(bounds)}; they must be a pair (lower, upper) of numbers, or of vectors "
            f"({len(start)},)"
        )
    lower, upper = pair
    wrong = np.flatnonzero(~((lower <= start) & (start <= upper) & (lower < upper)))
    if wrong.size:
        k = int(wrong[0])
        raise StructureError(
            f"{names[k]} starts at {start[k]:.6g}, outside of its bounds {lower[k]:.6g} to {upper[k]:.6g}"
        )
    return lower, upper
