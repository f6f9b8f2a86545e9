"""Model updating: parameters of a computed model that bring its modes to fitted ones, weighted by their covariance.

    min  (m - m(theta))^T C^-1 (m - m(theta))

over frequencies, damping ratios, and residues or shapes of the modes that were fitted; nothing is expanded to degrees
of freedom that were not measured.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np
from scipy.linalg import block_diag
from scipy.special import chdtrc

from ... import _checks
from ..._display import Report, aligned, counted, p_value, to_its_error
from ..._frozen import Frozen
from ..._types import Array, ArrayLike, ComplexArray, Indices, Mask, NDArray
from ..._units import hertz_size
from ...exceptions import StructureError
from ...numerics.modal_assurance import mac
from ...systems.base import Convertible
from ..uncertainty.draws import normal_interval
from .fitted_parameters import FittedParameters, ParameterInformation, named_combination
from .model_function import ModelFunction
from .physical_modes import PhysicalModes, followed, paired

ModalQuantity = Literal["natural_frequencies", "damping_ratios", "residues", "shapes"]
_RANK = 1e-9  # of the largest eigenvalue of the correlations: a direction that the fit has fixed
_FIXED = 1.0  # standard errors: how far along such directions a model may be
_CURVED = 0.1  # of the distance along all others: the same, as the models of a structure are nearly a plane
_SETTLED = 1e-6  # of the sum of squares, whose standard deviation is at least 1: a decrease that is none
_ROUNDS = 19
_DAMPED = 1e-9  # damping ratio from which on a model has losses
_LEVEL = 0.05


@dataclass(frozen=True, eq=False, repr=False)
class ModelUpdate(Report, Frozen):
    """Updated parameters with errors, and the modes before and after; made by `update_model`.

    Attributes
    ----------
    fitted_parameters : FittedParameters
        Names, values, covariance, start, bounds.
    measured, before, after : ndarray, shape (n,)
        Natural frequencies of the fit, and of the model at the parameters at the start and at the end; NaN for a mode
        without a partner.  Rad per unit time.
    measured_stderr : ndarray, shape (n,)
        Standard errors of the first.
    measured_damping, damping_before, damping_after : ndarray, shape (n,)
        Damping ratios of the same.
    mac_before, mac_after : ndarray, shape (n,)
        Modal assurance of each pair; 1 of a single output.
    quantities : tuple of str
        What was compared.
    distance : float
        `(m - m(theta))^T C^-1 (m - m(theta))` at the end.
    dof : int
        Its degrees of freedom.
    p : float
        Probability of as much, if the model is right.
    success : bool
        Whether the minimum was reached.
    time_unit : str or None
        Unit of time of the fit.

    Examples
    --------
    See `update_model`.
    """

    fitted_parameters: FittedParameters
    measured: Array
    measured_stderr: Array
    before: Array
    after: Array
    measured_damping: Array
    damping_before: Array
    damping_after: Array
    mac_before: Array
    mac_after: Array
    quantities: tuple[str, ...]
    distance: float
    dof: int
    p: float
    success: bool
    time_unit: str | None = None

    @property
    def parameters(self) -> Array:
        """Updated parameters (P,)."""
        return self.fitted_parameters.values

    @property
    def stderr(self) -> Array:
        """Their standard errors (P,); infinite for what leaves no trace, NaN for what is held at a bound."""
        return self.fitted_parameters.stderr

    @property
    def correlations(self) -> Array:
        """Correlations (P, P) of the parameters."""
        return self.fitted_parameters.correlations

    def confidence_interval(self, level: float = 0.95) -> Array:
        """Confidence intervals of the parameters.

        Parameters
        ----------
        level : float
            Probability of each, between 0 and 1.

        Returns
        -------
        ndarray, shape (P, 2)
            Lower and upper ends.

        Raises
        ------
        StructureError
            If the level is not between 0 and 1.

        Examples
        --------
        See `update_model`.
        """
        return normal_interval(self.parameters, self.stderr, level)

    def __str__(self) -> str:
        """Parameters and modes, before and after."""
        fitted, unit = self.fitted_parameters, "1/time" if self.time_unit is None else "Hz"
        rows = [["parameter", "before", "after", "+-", "change [%]"]]
        for name, start, value, error in zip(fitted.names, fitted.start, fitted.values, fitted.stderr, strict=True):
            change = f"{100 * (value / start - 1):+.3g}" if start else "-"
            rows.append([name, f"{start:.6g}", to_its_error(value, error), to_its_error(error, error), change])
        modes = [["mode", f"measured [{unit}]", "+-", "before [%]", "after [%]", "MAC before", "MAC after"]]
        size = hertz_size(self.time_unit)
        for k, (mine, error) in enumerate(zip(self.measured, self.measured_stderr, strict=True)):
            apart = [f"{100 * (each[k] / mine - 1):+.3g}" for each in (self.before, self.after)]
            alike = [f"{each[k]:.3f}" for each in (self.mac_before, self.mac_after)]
            frequency = [to_its_error(mine / size, error / size), to_its_error(error / size, error / size)]
            modes.append([str(k + 1), *frequency, *apart, *alike])
        hidden = [f"  {named_combination(each, fitted.names)} leaves no trace in these modes" for each in fitted.hidden]
        return "\n".join([
            self._headline(), "", *aligned(rows), "", *aligned(modes), "",
            f"  distance {self.distance:.4g} of {self.dof} degrees of freedom, {p_value(self.p)}", *hidden,
        ])  # fmt: skip

    def _headline(self) -> str:
        kept = "agrees with" if self.p >= _LEVEL else "does NOT agree with"
        pairs = int(np.isfinite(self.after).sum())
        return f"{counted(len(self.parameters), 'parameter')}: the updated model {kept} {counted(pairs, 'fitted mode')}"


def update_model(
    f: Callable[[Array], Convertible], theta0: ArrayLike | Mapping[str, float], result: Any, *,
    bounds: Sequence[ArrayLike] | None = None, quantities: Sequence[ModalQuantity] | None = None,
    outputs: Any = None, modes: Any = None, prior: ArrayLike | None = None,
) -> ModelUpdate:  # fmt: skip
    """Parameters of a computed model that bring its modes to those of a fit, with errors.

    Parameters
    ----------
    f : callable
        Function from parameters, an array (P,), to a system with the outputs of the fit, or more.
    theta0 : array_like, shape (P,), or mapping from name to value
        Where the parameters start.
    result : PEMResult
        Fitted modes with their covariance, best of a fit with ``structure="free"``: `f` is the structure.
    bounds : pair of array_like, shape (P,) or numbers, optional
        Lower and upper bounds of the parameters, numbers or vectors (P,).
    quantities : sequence of {'natural_frequencies', 'damping_ratios', 'residues', 'shapes'}, optional
        What is compared.  Default: frequencies; of a model with losses damping ratios; residues where model and fit
        have the same inputs and the model has losses, and else shapes, of any scale.
    outputs : sequence of int or str, optional
        Which outputs of the model were measured, in the order of the fit; by default all, or those of the same labels.
    modes : sequence of int, optional
        Which modes of the fit are compared, counted from 0; all by default.
    prior : array_like, shape (P,), or float, optional
        Standard deviations of the parameters about `theta0`, as known beforehand: regularisation.  None without.

    Returns
    -------
    ModelUpdate
        Parameters with errors, frequencies and modal assurance before and after, and a test of the model.

    Raises
    ------
    StructureError
        If an argument is not of this form, or the fit has no modes; if it has a structure, such as classical damping,
        that the model has not.

    See Also
    --------
    pem : ``pem(data, model=f, parameters=theta0)`` fits the parameters to the record itself, which tells more.

    Notes
    -----
    `min (m - m(theta))^T C^-1 (m - m(theta))`, `C` the covariance of the fit: each frequency and residue counts by its
    error and correlations, those of shapes by `shape_stderr`.  Modes are paired by frequency and modal assurance at the
    measured outputs, anew after each step.  Gauss-Newton steps by differences, at most 20 calls of `f` for each
    parameter.  Where `p` is small the model does not agree with the modes, and errors are too small.

    A fit with real shapes has no errors of their phases, and moves its frequencies and damping ratios to suit: it says
    nothing of a model whose shapes are complex, though the data reject neither.  Such a model is refused.

    Examples
    --------
    >>> import control as ct, numpy as np, ph_control as phc
    >>> rng = np.random.default_rng(0)
    >>> def building(k):
    ...     K = np.diag([k[0] + k[1], k[1]]) - k[1] * np.array([[0.0, 1.0], [1.0, 0.0]])
    ...     return phc.from_second_order(np.eye(2), K, [0.0, 1.0], C=0.01 * K, sensors=[[1.0, 0.0]])
    >>> u = rng.standard_normal(3000)
    >>> y = phc.forced_response(building([70.0, 100.0]), 0.05 * np.arange(3000), u, intersample="zoh").outputs
    >>> result = phc.pem((u, y + 0.02 * y.std() * rng.standard_normal(y.shape)), 2, dt=0.05, quantity=["velocity"] * 2)
    >>> update = phc.update_model(building, {"k1": 100.0, "k2": 100.0}, result)
    >>> bool(np.all(np.abs(update.parameters - [70.0, 100.0]) < 4 * update.stderr))
    True
    """
    function = ModelFunction.checked(f, theta0, bounds)
    target = _FittedTarget.of(result, function, quantities, outputs, modes)
    spread = None
    if prior is not None:
        spread = np.broadcast_to(_checks.real_array("prior", prior), function.start.shape)
        if not np.all(spread > 0):
            raise StructureError(f"prior has {spread.min():.6g}; standard deviations must be positive")
    with np.errstate(all="ignore"):  # on the way parameters may be of any size
        return _updated(function, target, spread)


@dataclass(frozen=True)
class _FittedTarget:
    """Fitted modes, and what turns their distance from computed ones into numbers of variance 1."""

    poles: ComplexArray
    shapes: ComplexArray
    residues: ComplexArray
    covariance: Array  # of frequencies, damping ratios, real and imaginary parts of residues
    shape_stderr: ComplexArray
    quantities: tuple[str, ...]
    outputs: Indices
    time_unit: str | None
    structure: str

    @classmethod
    def of(cls, result: Any, function: ModelFunction, quantities: Any, outputs: Any, modes: Any) -> _FittedTarget:
        """Take what is compared from a fit, and check that the model has it."""
        for name in ("poles", "residues", "covariance", "shapes", "shape_stderr", "order"):
            if not hasattr(result, name):
                raise StructureError(f"result is {_checks.shown(result)}; it must be a fit by pem")
        if not result.order:
            raise StructureError("this fit has no modes to update a model by")
        N, n, (p, m) = len(result.poles), result.order, result.residues.shape[1:]
        some = np.arange(n) if modes is None else _places("modes", modes, n)
        function.slowest, function.time_unit = 1e-3 * float(np.abs(result.poles[:n]).min()), result.time_unit
        plant = function.function(function.start.copy())
        function.calls += 1
        measured = _measured_outputs(plant, result, outputs)
        alike = getattr(plant, "ninputs", 0) == m
        function.inputs = m if alike else 0
        computed = function.modes(function.start)
        lossy = bool(np.any(computed.damping[~computed.real] > _DAMPED))
        default = [
            "natural_frequencies",
            *["damping_ratios"] * lossy,
            "residues" if alike and lossy and m else "shapes",
        ]
        chosen = default if quantities is None else quantities
        if not isinstance(chosen, list | tuple) or not chosen:
            raise StructureError(
                f"quantities are {_checks.shown(quantities)}; pass a list of some of "
                f"{', '.join(get_args(ModalQuantity))}"
            )
        for name in chosen:
            _checks.choice("quantities", name, get_args(ModalQuantity))
        if "residues" in chosen and not (alike and m):
            raise StructureError(f"residues need the {m} inputs of the fit in the model as well; compare shapes")
        size = p * m
        places = np.concatenate([
            some, N + some, *(2 * N + part * N * size + (some[:, None] * size + np.arange(size)).ravel()
                              for part in (0, 1))
        ]).astype(int)  # fmt: skip
        return cls(
            result.poles[some], result.shapes[some], result.residues[some], result.covariance[np.ix_(places, places)],
            result.shape_stderr[some], tuple(chosen), measured, result.time_unit, result.structure,
        )  # fmt: skip

    def places(self, model: PhysicalModes) -> tuple[Indices, Array]:
        """Mode of a model for each fitted one, -1 for none, and the MAC of the pair."""
        some = np.flatnonzero(~model.real)
        shapes = model.shapes[some][:, self.outputs]
        places, _ = paired(np.abs(self.poles), self._motion, np.abs(model.poles[some]), shapes)
        places = np.where(places >= 0, some[places], -1) if len(some) else places
        alike = np.full(len(places), np.nan)
        for k in np.flatnonzero(places >= 0):
            alike[k] = mac(self._motion[[k]], model.shapes[places[[k]]][:, self.outputs])[0, 0]
        return places, alike

    @cached_property
    def _motion(self) -> ComplexArray:
        """Shapes in the units of the outputs, as those of a model are."""
        if not self.residues.shape[2]:
            return self.shapes
        return np.linalg.svd(self.residues, full_matrices=False)[0][:, :, 0]

    @cached_property
    def _tangents(self) -> list[ComplexArray]:
        """Of each shape an orthonormal basis of what is orthogonal to it."""
        return [np.linalg.svd(shape[:, None], full_matrices=True)[0][:, 1:] for shape in self._motion]

    def numbers(self, model: PhysicalModes, places: Indices) -> Array:
        """What is compared, of the modes of a model at some places; shapes as they are apart from the fitted ones."""
        apart = []
        shapes = zip(model.shapes[places][:, self.outputs], self._motion, self._tangents, strict=True)
        for shape, mine, tangent in shapes if "shapes" in self.quantities else ():
            along = np.vdot(mine, shape) / np.vdot(mine, mine).real
            apart.append(tangent.conj().T @ shape / (along if along else 1.0))
        return self._compared(model.poles[places], model.residues[places][:, self.outputs], apart)

    @cached_property
    def goal(self) -> Array:
        """The same of the fit."""
        return self._compared(self.poles, self.residues, [np.zeros(self._motion.shape[1] - 1)] * len(self.poles))

    def _compared(self, poles: ComplexArray, residues: ComplexArray, apart: Sequence[NDArray[Any]]) -> Array:
        """What is compared of poles (n,), residues (n, p, m), and what each shape is apart from the fitted one."""
        every = {
            "natural_frequencies": [np.abs(poles)], "damping_ratios": [-poles.real / np.abs(poles)],
            "residues": [residues.real.ravel(), residues.imag.ravel()],
            "shapes": [part for each in apart for part in (each.real, each.imag)],
        }  # fmt: skip
        return np.concatenate([part for name, parts in every.items() if name in self.quantities for part in parts])

    @cached_property
    def whitening(self) -> Array:
        """Rows that turn differences into numbers of variance 1; directions that the fit has fixed are left out."""
        return self._directions[0]

    def refuse_beyond(self, apart: Array) -> None:
        """Refuse differences along directions that the fit has fixed: those it has left say nothing of such a model."""
        free, fixed = (float(np.linalg.norm(rows @ apart)) for rows in self._directions)
        allowed = max(_FIXED, _CURVED * free)
        if fixed > allowed:
            raise StructureError(
                f"the modes of the updated model are {fixed:.3g} standard errors from all that a fit of structure "
                f"{self.structure!r} can be, and {allowed:.3g} is allowed: its errors hold along that structure only; "
                "update the model by a fit with structure='free'"
            )

    @cached_property
    def _directions(self) -> tuple[Array, Array]:
        """Rows for differences: those of variance 1, and those of none, in standard errors of what they combine."""
        n, size = len(self.poles), self.residues[0].size
        kept = np.concatenate([
            np.full(n, "natural_frequencies" in self.quantities), np.full(n, "damping_ratios" in self.quantities),
            np.full(2 * n * size, "residues" in self.quantities),
        ])  # fmt: skip
        C = self.covariance[np.ix_(kept, kept)]
        if "shapes" in self.quantities:
            C = block_diag(C, *(self._shape_covariance(k) for k in range(n)))
        known = np.isfinite(np.diag(C)) & (np.diag(C) > 0)
        deviations = np.sqrt(np.diag(C)[known])
        values, vectors = np.linalg.eigh(C[np.ix_(known, known)] / np.outer(deviations, deviations))
        shown = values > _RANK * values.max(initial=0.0)
        rows = np.zeros((len(values), len(C)))
        rows[:, known] = vectors.T / deviations
        return rows[shown] / np.sqrt(values[shown, None]), rows[~shown]

    def _shape_covariance(self, k: int) -> Array:
        """Covariance of what a fitted shape is apart from the true one, by the errors of its entries."""
        turned = self._motion[k] / np.where(self.shapes[k] == 0, 1.0, self.shapes[k])  # other units and scale
        size = np.abs(turned)
        errors = np.concatenate([size * self.shape_stderr[k].real, size * self.shape_stderr[k].imag])
        H = self._tangents[k].conj().T
        turn = np.block([[H.real, -H.imag], [H.imag, H.real]])
        return np.asarray((turn * errors**2) @ turn.T)


def _places(name: str, value: object, count: int) -> Indices:
    try:
        places = np.asarray(value)
    except (TypeError, ValueError):
        places = np.zeros(0)
    if places.ndim != 1 or not places.size or places.dtype.kind not in "iu" or len(np.unique(places)) < len(places):
        raise StructureError(f"{name} is {_checks.shown(value)}; it must be different whole numbers")
    if places.min() < 0 or places.max() >= count:
        raise StructureError(f"{name} names {int(places.max())}; there are 0 to {count - 1}")
    return places.astype(int)


def _measured_outputs(plant: Any, result: Any, outputs: Any) -> Indices:
    """Places of the outputs of a fit among those of a model."""
    count, labels = len(result.output_labels), list(getattr(plant, "output_labels", []))
    if outputs is not None:
        if isinstance(outputs, list | tuple) and all(isinstance(each, str) for each in outputs):
            outputs = [_checks.signal_number("output", each, labels) for each in outputs]
        places = _places("outputs", outputs, len(labels))
    elif len(labels) == count:
        places = np.arange(count)
    else:
        wanted = _checks.without_dots(result.output_labels)
        if not set(wanted) <= set(labels):
            raise StructureError(
                f"the model has {len(labels)} outputs and the fit {count}, of other labels; say which were measured: "
                "outputs=[..]"
            )
        places = np.array([labels.index(name) for name in wanted])
    if len(places) != count:
        raise StructureError(f"outputs names {len(places)} outputs of the model; the fit has {count}")
    return places


# --- the minimum -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _UpdateStep:
    """Parameters, the modes there, and the distance from the fit."""

    function: ModelFunction
    target: _FittedTarget
    theta: Array
    prior: Array | None

    @cached_property
    def model(self) -> PhysicalModes:
        """Modes of the model."""
        return self.function.modes(self.theta)

    @cached_property
    def pairs(self) -> tuple[Indices, Array]:
        """Places of the modes, and their MAC."""
        return self.target.places(self.model)

    @cached_property
    def residual(self) -> Array:
        """Fitted less computed numbers, in units of their errors; then what the parameters are from their prior."""
        return self._whitened(self.target.goal - self.target.numbers(self.model, self.pairs[0]), self.theta)

    def _whitened(self, apart: Array, theta: Array) -> Array:
        known = np.concatenate([[] if self.prior is None else (self.function.start - theta) / self.prior])
        return np.concatenate([self.target.whitening @ apart, known])

    @property
    def distance(self) -> float:
        """Sum of squares."""
        return float(self.residual @ self.residual)

    @cached_property
    def jacobian(self) -> Array:
        """Derivatives by relative changes of the parameters."""
        return self._slopes(self.function.neighbours(self.theta))

    @property
    def sharp(self) -> Array:
        """The same by differences to both sides where calls are left: what leaves no trace leaves none there."""
        near, function = self.function.neighbours(self.theta), self.function
        if function.calls + len(self.theta) > function.most:
            return self.jacobian
        return 0.5 * (self.jacobian + self._slopes(function.opposite(self.theta, near)))

    def _slopes(self, near: Sequence[tuple[float, PhysicalModes]]) -> Array:
        columns, known = [], self.target.numbers(self.model, self.pairs[0])
        for k, (step, model) in enumerate(near):
            moved = self.target.numbers(followed(self.model, model), self.pairs[0])
            theta = self.theta.copy()
            theta[k] += step
            change = self._whitened(known - moved, theta) - self._whitened(0 * known, self.theta)
            columns.append(change / step)
        return np.stack(columns, axis=1) * self.function.scale


def _updated(function: ModelFunction, target: _FittedTarget, prior: Array | None) -> ModelUpdate:
    """Gauss-Newton steps, halved where they lead up."""
    first = step = _UpdateStep(function, target, function.start, prior)
    if np.any(first.pairs[0] < 0):
        raise StructureError(
            f"the model has {int(np.sum(~first.model.real))} modes and the fit {len(target.poles)}: let the model have "
            "more, or name those to compare, modes=[..]"
        )
    success = False
    for _ in range(_ROUNDS):
        if function.exhausted:
            break
        free = _free(step)
        J = step.jacobian * free
        move = np.asarray(-np.linalg.lstsq(J, step.residual, rcond=1e-10)[0], float)
        better = _shortened(step, move)
        if better is None or step.distance - better.distance <= _SETTLED * max(1.0, step.distance):
            success = True
            step = step if better is None else better
            break
        step = better
    target.refuse_beyond(target.goal - target.numbers(step.model, step.pairs[0]))
    return _report(first, step, success)


def _free(step: _UpdateStep) -> Mask:
    """Which parameters are not pushed across a bound."""
    return step.function.may_move(step.theta, step.jacobian.T @ step.residual)


def _shortened(step: _UpdateStep, move: Array) -> _UpdateStep | None:
    """A step that leads down; None if there is none."""
    function, part = step.function, min(1.0, 0.5 / max(np.abs(move).max(initial=0.0), 1e-300))
    for _ in range(12):
        theta = function.stepped(step.theta, part * move)
        if function.is_spent or np.array_equal(theta, step.theta):
            return None
        trial = replace(step, theta=theta)
        try:
            if trial.distance < step.distance:
                return trial
        except (StructureError, np.linalg.LinAlgError):
            pass
        part *= 0.3
    return None


def _report(first: _UpdateStep, last: _UpdateStep, success: bool) -> ModelUpdate:
    function, target = first.function, first.target
    free = _free(last) if not function.is_spent else np.ones(len(function.start), bool)
    information = ParameterInformation.of(last.sharp, free)
    scale = np.outer(function.scale, function.scale)
    shown = free & information.seen
    covariance = np.where(np.outer(shown, shown), information.inverse, np.nan) * scale
    fitted = FittedParameters(
        function.names, last.theta.copy(), covariance, function.start, function.lower, function.upper,
        information.hidden, function.calls,
    )  # fmt: skip
    dof = max(0, len(last.residual) - information.rank)
    p = float(chdtrc(dof, last.distance)) if dof else 1.0
    views: Mapping[str, Any] = {
        name: each.model.poles[each.pairs[0]] for name, each in (("before", first), ("after", last))
    }
    size = {name: np.abs(poles) for name, poles in views.items()}
    n = len(target.poles)
    return ModelUpdate(
        fitted, np.abs(target.poles), np.sqrt(np.diag(target.covariance)[:n]), size["before"], size["after"],
        -target.poles.real / np.abs(target.poles), -views["before"].real / size["before"],
        -views["after"].real / size["after"], first.pairs[1], last.pairs[1], target.quantities, last.distance, dof, p,
        success, target.time_unit,
    )  # fmt: skip
