"""The passive model next to a system or a fit: poles as they are, residues moved as little as can be."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import control as ct
import numpy as np
from scipy.linalg import block_diag

from .. import _checks
from .._options import PORT_KINDS, PortKind
from .._threads import on_one_thread
from .._types import Array, ArrayLike, ComplexArray
from .._units import DERIVATIVES, with_unit
from ..analysis.passivity import PassivityReport, passivity
from ..exceptions import ConditioningWarning, StructureError
from ..modal.general_form import real_matrices
from ..modal.positive_real import Split, split_axis
from ..numerics.rational import state_space
from ..systems.base import Convertible, inherited_names
from ..systems.passive_form import equations, joined, lossless_parts, minimal_part
from ..systems.port_hamiltonian import PortHamiltonian, ph
from .interior_point import Closest, FixedPoles, closest_passive

Metric = Literal["covariance", "h2"]
Weight = Metric | tuple[Array, Array]  # frequencies and the weights there

_ACTIVE = 1e-12  # of its size: what a feedthrough that cannot move may lack of passivity
_RIDGE = 1e-13  # of the largest: least information on what moves
_STEADY = (0.1, 0.3, 1.0, 3.0)  # standard errors of damping ratios that growing poles may get: the cheapest is taken


@on_one_thread
def nearest_passive(
    sys_or_result: Any, *, weight: Metric | tuple[ArrayLike, ArrayLike] | None = None, kind: PortKind = "immittance"
) -> PortHamiltonian | ct.StateSpace:
    """Find the passive model next to a system or a fit, with the same poles.

    Parameters
    ----------
    sys_or_result : control.StateSpace, control.TransferFunction, or PEMResult
        Stable system with as many outputs as inputs, output k being the port variable of input k; or a fit with driving
        points (`ports`), of one input and one output without.
    weight : {'covariance', 'h2'} or (omega, weights), optional
        What "next" means.  'covariance', the default of a fit: `(theta - theta_0)^T C^-1 (theta - theta_0)`, `C` that
        of its residues and feedthrough for given poles, so that the data object to the model least.  'h2', the default
        of a system: the squared H2 norm of the difference, without a change of `D`.  Frequencies in rad per unit time
        and weights, shape (K,): the sum of `(weight |difference|_F)^2` over them, `D` moving too.
    kind : {'immittance', 'scattering'}
        Impedance, admittance or mobility, `G + G^H >= 0`; or scattering matrix, `S^H S <= I`.

    Returns
    -------
    PortHamiltonian, or control.StateSpace of a scattering matrix
        Passive by the exact test of `passivity`.  Its `cost` is the squared distance in the metric above: that of a
        covariance is twice the log-likelihood that the fit loses, for given poles; 0 of what was passive before.

    Raises
    ------
    StructureError
        If a system has poles in the right half-plane or an active feedthrough that cannot move, or a fit has no ports.

    Notes
    -----
    Passive models with given poles are a convex cone, the image of positive semidefinite matrices by the lemma of
    Kalman, Yakubovich and Popov.  An interior-point method finds the closest point of it: `cost` exceeds the least one
    by at most 1e-8 of it, unless rounding asks for more room.  Of a system residues move with the inputs of the modes
    as they are, which keeps its order; of a fit all entries move, and sensors with the ports that they are correlated
    with.  Growing poles of a fit cross the axis, by what costs least of a few steps, and the cost is with that.  Poles
    on the imaginary axis keep the positive semidefinite part of their residues.  About 15 steps of O(n^3 m^2), up to
    some hundred states O(n^4 m^2); a scattering matrix has twice the ports.

    Examples
    --------
    >>> import control as ct, ph_control as phc
    >>> active = ct.tf([1.0, -0.1, 0.0], [1.0, 0.4, 2.1, 0.4, 1.0])
    >>> phc.passivity(active).is_passive
    False
    >>> model = phc.nearest_passive(active)
    >>> phc.passivity(model).is_passive, bool(0 < model.cost < ct.norm(active, 2) ** 2)
    (True, True)
    """
    _checks.choice("kind", kind, PORT_KINDS)
    fitted = hasattr(sys_or_result, "covariance") and hasattr(sys_or_result, "residues")
    given = _weight(weight, "covariance" if fitted else "h2")
    if given == "covariance" and not fitted:
        raise StructureError("weight='covariance' is for fits; a system has none: pass 'h2' or (omega, weights)")
    if not fitted:
        return _of_system(sys_or_result, given, kind)
    system = sys_or_result.system
    if isinstance(system, PortHamiltonian) and system.is_lossless:
        # its poles stay on the axis, where an immittance is passive as it is, and no scattering matrix can be
        return _unchanged(sys_or_result) if kind != "scattering" else _of_system(system, given, kind)
    return _of_fit(sys_or_result, given, kind)


def _weight(weight: Metric | tuple[ArrayLike, ArrayLike] | None, default: Metric) -> Weight:
    if weight is None or isinstance(weight, str):
        return default if weight is None else _checks.choice("weight", weight, get_args(Metric))
    if not isinstance(weight, tuple | list) or len(weight) != 2:
        raise StructureError(
            f"weight is {_checks.shown(weight)}; pass 'covariance', 'h2', or a pair (omega, weights) of arrays"
        )
    parts = zip(("omega", "weights"), weight, strict=True)
    omega, values = (np.atleast_1d(_checks.real_array(name, array)) for name, array in parts)
    if omega.ndim != 1 or omega.shape != values.shape or not len(omega) or omega.min() < 0 or values.min() < 0:
        raise StructureError(
            f"the weight has frequencies of shape {omega.shape} and values of shape {values.shape}, the least "
            f"{min(omega.min(initial=0), values.min(initial=0)):.3g}; expected one shape (K,), and none negative"
        )
    return omega, values


# --- systems ------------------------------------------------------------------------------------------------------


def _of_system(sys: Convertible, weight: Weight, kind: PortKind) -> ct.StateSpace:
    report = passivity(sys, kind)
    _refuse_unstable(report)
    plain = state_space(sys)
    if report.is_passive:
        return _passive_model(sys, plain, kind, 0.0)
    scattering = kind == "scattering"
    A, B, C, D = (np.array(getattr(plain, name), float) for name in "ABCD")
    split, m = split_axis(A, B, C), len(D)
    if scattering and split.axis:
        raise StructureError(
            f"the scattering matrix has a pole on the imaginary axis, at {split.axis[0][0]:.4g} rad per unit time: "
            "no residue makes it passive; fit it again with poles in the left half-plane"
        )
    A, B, C = minimal_part(*split.rest, m)
    axis, lost = _positive_axis(split)
    closest = Closest(C, D, 0.0, np.zeros(0))
    if len(A):
        family = FixedPoles(A, B, scattering)
        closest = closest_passive(family, C, D, _covariance(family, C, D, weight))
    names = inherited_names(plain, {}, "inputs", "outputs")
    A, B, C = _with_axis((A, B, closest.C), axis, m)
    model = ct.ss(A, B, C, closest.D, **names)
    return _passive_model(model, model, kind, closest.distance + (np.inf if lost else 0.0))


def _refuse_unstable(report: PassivityReport) -> None:
    if len(report.unstable):
        raise StructureError(
            f"the system has {len(report.unstable)} poles in the right half-plane, the first at "
            f"{report.unstable[0]:.4g}, and poles are kept; fit it again with stable poles"
        )


def _passive_model(sys: Convertible, plain: ct.StateSpace, kind: PortKind, cost: float) -> ct.StateSpace:
    """The model as it is given away, judged by the exact test."""
    if kind == "scattering":
        model = ct.ss(plain)
        if cost and not passivity(model, kind).is_passive:
            raise StructureError("rounding hides whether the model is passive; give it in better scaled states")
    else:
        with warnings.catch_warnings():
            # a model that touches the bound may lose digits, far beyond those that were given up
            warnings.simplefilter("ignore" if cost else "default", ConditioningWarning)
            model = ph(sys)
    model.cost = cost
    return model


def _positive_axis(split: Split) -> tuple[list[tuple[float, ComplexArray]], bool]:
    """Residues on the axis without what is not positive semidefinite, and whether something was."""
    residues, lost = [], False
    for w, K in split.axis:
        if not np.isfinite(K).all():
            raise StructureError(
                f"the pole on the imaginary axis at {w:.4g} rad per unit time is not simple, so that no residue makes "
                "it passive"
            )
        hermitian = 0.5 * (K + K.conj().T)
        values, U = np.linalg.eigh(hermitian)
        kept = (U * np.maximum(values, 0.0)) @ U.conj().T
        lost = lost or bool(np.linalg.norm(kept - K) > 1e-8 * np.linalg.norm(K))
        if values[-1] > 0:
            residues.append((w, np.asarray(kept, complex)))
    return residues, lost


def _with_axis(
    rest: tuple[Array, Array, Array], axis: list[tuple[float, ComplexArray]], m: int
) -> tuple[Array, Array, Array]:
    if not axis:
        return rest
    (A, B, C), (own, into, out, _) = rest, equations(joined(lossless_parts(axis, m), np.zeros((0, m))))
    return block_diag(A, own), np.vstack([B, into]), np.hstack([C, out])


def _covariance(family: FixedPoles, C: Array, D: Array, weight: Weight) -> Array | None:
    """Inverse of the metric of the entries of `C` and `D`; None of the H2 norm, in which `D` does not move."""
    m, n = C.shape
    if isinstance(weight, str):
        _refuse_active_feedthrough(D, family.scattering)
        return None
    omega, values = weight
    seen = values[:, None, None] * np.concatenate(
        [family.states(omega), np.broadcast_to(np.eye(m), (len(omega), m, m))], axis=1
    )
    rows = seen.transpose(0, 2, 1).reshape(-1, n + m)
    inverse = _inverse(np.real(rows.conj().T @ rows))
    return _blocks(inverse[:n, :n], inverse[n:, n:], m, inverse[:n, n:])


def _h2_covariance(family: FixedPoles, m: int) -> Array:
    """Inverse of the metric of the H2 norm, in which a feedthrough does not move."""
    return _blocks(_inverse(ct.lyap(family.A, family.B @ family.B.T)), np.zeros((m, m)), m)


def _inverse(information: Array) -> Array:
    """Inverse of an information matrix, in which nothing is quite unknown."""
    scale = np.sqrt(np.diag(information))
    scale = np.where(scale > 0, scale, 1.0)
    values, U = np.linalg.eigh(information / scale / scale[:, None])
    return np.asarray((U / np.maximum(values, _RIDGE * values[-1])) @ U.T / scale / scale[:, None], float)


def _blocks(by_C: Array, by_D: Array, m: int, cross: Array | None = None) -> Array:
    """Covariance of all rows of `C`, then of `D`, of that of one row."""
    eye = np.eye(m)
    corner = np.kron(eye, np.zeros((len(by_C), m)) if cross is None else cross)
    return np.block([[np.kron(eye, by_C), corner], [corner.T, np.kron(eye, by_D)]])


def _refuse_active_feedthrough(D: Array, scattering: bool) -> None:
    size = float(np.linalg.norm(D, 2)) if D.size else 0.0
    lack = size - 1 if scattering else -float(np.linalg.eigvalsh(0.5 * (D + D.T))[0])
    if lack > _ACTIVE * max(size, float(scattering)):
        what = "a singular value above 1" if scattering else "a negative eigenvalue of (D + D^T)/2"
        raise StructureError(
            f"the feedthrough D is active, by {lack:.3g} ({what}), and the H2 norm of a change of D is infinite: pass "
            "weight=(omega, weights), with which D moves too"
        )


# --- fits ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _PortMap:
    """Linear map from the residues and feedthrough of a fit to `C` and `D` of its ports, in real modal states."""

    family: FixedPoles
    map: Array

    def split(self, theta: Array) -> tuple[Array, Array]:
        """`C` and `D` of residues and feedthrough."""
        n, m = self.family.B.shape
        moved = self.map @ theta
        return moved[: m * n].reshape(m, n), moved[m * n :].reshape(m, m)


def _of_fit(result: Any, weight: Weight, kind: PortKind) -> ct.StateSpace:
    fit, cost = passive_fit(result, weight, kind)
    model = fit.observed_system if kind == "scattering" else fit.system
    if cost or kind == "scattering":
        return _passive_model(model, model, kind, cost)
    return _unchanged(result)


def _unchanged(result: Any) -> PortHamiltonian:
    """The model of a fit that is passive as it is."""
    model = ph(result.system)
    model.cost = 0.0
    return with_unit(model, result.time_unit)


def passive_fit(result: Any, weight: Weight, kind: PortKind) -> tuple[Any, float]:
    """A fit with passive residues and feedthrough, and its squared distance."""
    if (result.poles.real < 0).all():
        return _moved(result, weight, kind, 0.0)
    fits, refusal = [], None
    for steady in _STEADY:
        try:
            fits.append(_moved(result, weight, kind, steady))
        except StructureError as refused:
            refusal = refused
    if refusal is not None and not fits:
        raise refusal
    return min(fits, key=lambda candidate: candidate[1])


def _moved(result: Any, weight: Weight, kind: PortKind, steady: float) -> tuple[Any, float]:
    """The fit of poles that decay by so many standard errors, made passive."""
    pairs = _driving_points(result, kind)
    start, covariance, cost = _decaying(result, steady)
    ports = _ports_of(start, pairs, kind)
    theta = _parameters(start)
    C, D = ports.split(theta)
    if weight != "covariance":
        metric_inverse = _covariance(ports.family, C, D, weight)
        moved = _inverse(_h2_covariance(ports.family, len(D)) if metric_inverse is None else metric_inverse)
        covariance = np.linalg.pinv(ports.map.T @ moved @ ports.map, rcond=_RIDGE, hermitian=True)
    closest = closest_passive(ports.family, C, D, ports.map @ covariance @ ports.map.T)
    theta = theta + covariance @ (ports.map.T @ closest.force)
    structure = "free" if kind == "scattering" else "passive"
    return replace(_with(start, theta), structure=structure, ports=pairs), cost + closest.distance


def _decaying(result: Any, steady: float) -> tuple[Any, Array, float]:
    """The fit with poles that decay, the covariance of its residues and feedthrough for given poles, and the cost.

    Growing poles cross the axis by so many standard errors, and all else follows by its correlation.
    """
    n, C = len(result.poles), np.nan_to_num(np.asarray(result.covariance, float))
    d, zeta = np.abs(result.poles), -result.poles.real / np.abs(result.poles)
    wanted = np.maximum(zeta, steady * np.minimum(np.sqrt(np.diag(C)[n : 2 * n]), 1.0))
    theta, growing = _parameters(result), np.flatnonzero(zeta <= 0)
    held = n + growing
    cost = 0.0
    if len(growing):
        if not np.all(wanted[growing] > 0):
            raise StructureError(
                f"the fit has a pole at {result.poles[growing[0]]:.4g}, which does not decay and has no standard "
                "error: fit it with structure='passive'"
            )
        force = np.linalg.solve(C[np.ix_(held, held)], wanted[growing] - zeta[growing])
        moved = C[:, held] @ force
        cost = float(force @ (wanted[growing] - zeta[growing]))
        d, zeta = d + moved[:n], np.maximum(zeta + moved[n : 2 * n], wanted)
        theta = theta + moved[2 * n :]
        poles = d * (-zeta + 1j * np.sqrt(1 - zeta**2))
        result = replace(_with(result, theta), poles=poles)
    return result, _conditional(C, 2 * n), cost


def _with(result: Any, theta: Array) -> Any:
    """The fit with other residues and feedthrough."""
    size = result.residues.size
    residues = (theta[:size] + 1j * theta[size : 2 * size]).reshape(result.residues.shape)
    return replace(result, residues=residues, feedthrough=theta[2 * size :].reshape(result.feedthrough.shape))


def _driving_points(result: Any, kind: PortKind) -> tuple[tuple[int, int], ...]:
    _, p, m = result.residues.shape
    pairs = tuple(result.ports)
    if not pairs and p == m and (kind == "scattering" or p == 1):
        pairs = tuple((k, k) for k in range(m))
    if sorted(i for _, i in pairs) != list(range(m)) or not m:
        raise StructureError(
            f"the fit has {len(pairs)} driving points for {m} inputs; every input needs its output: fit with "
            "ports=[(output, input), ..]"
        )
    return tuple(sorted(pairs, key=lambda port: port[1]))


def _ports_of(result: Any, pairs: tuple[tuple[int, int], ...], kind: PortKind) -> _PortMap:
    poles, (n, p, m) = np.asarray(result.poles, complex), result.residues.shape
    A, B, _ = real_matrices(
        np.repeat(poles, m), np.tile(np.eye(m), (n, 1)).astype(complex), np.zeros((1, n * m), complex)
    )
    size = n * p * m
    rows = np.zeros((m, 2 * n * m, 2 * size + p * m))
    through = np.zeros((m, m, 2 * size + p * m))
    for k, (output, _) in enumerate(pairs):
        power = 0 if kind == "scattering" else 1 - DERIVATIVES[result.quantities[output]]
        factor = 2 * poles**power  # outputs are Re(c x)
        for l in range(n):
            for i in range(m):
                entry, state = (l * p + output) * m + i, 2 * (l * m + i)
                rows[k, state, [entry, size + entry]] = factor[l].real, -factor[l].imag
                rows[k, state + 1, [entry, size + entry]] = -factor[l].imag, -factor[l].real
        if kind == "scattering" or result.quantities[output] in ("velocity", "free"):
            for i in range(m):
                through[k, i, 2 * size + output * m + i] = 1.0
    width = rows.shape[2]
    return _PortMap(
        FixedPoles(A, B, kind == "scattering"), np.concatenate([rows.reshape(-1, width), through.reshape(-1, width)])
    )


def _parameters(result: Any) -> Array:
    rho = result.residues.ravel()
    return np.concatenate([rho.real, rho.imag, result.feedthrough.ravel()])


def _conditional(covariance: Array, known: int) -> Array:
    """Covariance of what comes after the first numbers, for given ones; 0 of what was held."""
    C = covariance
    first, rest, cross = C[:known, :known], C[known:, known:], C[known:, :known]
    scale = np.sqrt(np.maximum(np.diag(first), 0.0))
    scale = np.where(scale > 0, scale, 1.0)
    inverse = np.linalg.pinv(first / scale / scale[:, None], hermitian=True) / scale / scale[:, None]
    return np.asarray(rest - cross @ inverse @ cross.T, float)
