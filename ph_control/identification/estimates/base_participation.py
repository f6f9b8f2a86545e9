"""Participation factors and effective masses of a structure that was shaken at its base, from a fit."""

from __future__ import annotations

from typing import Any

import numpy as np

from ... import _checks
from ..._frozen import ReadOnlyMapping
from ..._types import Array, ArrayLike
from ...exceptions import StructureError
from ...structures.base_motion import BaseMotion
from .scaled_shapes import in_velocity_units, velocity_unit_slopes


def base_motion(model: Any, masses: ArrayLike | None = None) -> BaseMotion:
    """Return participation factors and effective masses of the modes under a motion of the base.

    Parameters
    ----------
    model : PEMResult, or PortHamiltonian of `from_second_order(base=..)`
        Fit of accelerations of the ground (inputs) to accelerations of a structure on it (outputs), absolute or
        relative; or a computed structure, whose `base_motion` is returned.
    masses : array_like, shape (p,) or (m, p), optional
        Mass at each output that moves with the ground in the direction of each input: masses of the storeys, 0 for a
        sensor of another direction.  Of an output that is the base shear, as a force, it is 1 and all others 0.

    Returns
    -------
    BaseMotion
        `contributions` of each mode to each output, always; `effective_masses` and `participation_factors` with
        `masses`, else NaN; `stderr` of all.

    Raises
    ------
    StructureError
        If there is no motion of the base, an output is of no known quantity, or masses do not fit the outputs.

    Notes
    -----
    A structure with damping that keeps its modes apart answers the ground with the relative acceleration
    `-sum_l psi_l s^2 / (s^2 + 2 zeta_l d_l s + d_l^2)`, `psi_l = phi_l (phi_l^T M 1)`, and the absolute one is 1 more.
    So the residue of an output that was differentiated k times (`quantity`) is `-psi_l p_l^k / (2j Im p_l)`, whose real
    part is taken; other damping adds an imaginary one.  The effective mass `(phi_l^T M 1)^2` is `sum_o m_o psi_lo`.
    Their sum over all modes is the moving mass; it is no constraint of the fit, and so a test of it.  Where storeys
    have no sensor, or modes were not found, the sum lacks them.  Masses count as known.  O(k^2 p^2 m).

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> K = 400 * np.array([[2.0, -1.0], [-1.0, 1.0]])
    >>> frame = phc.from_second_order(
    ...     np.eye(2), K, base=[1, 1], C=0.001 * K, sensors={"acceleration": np.eye(2)}, modes=2
    ... )
    >>> rng, t = np.random.default_rng(0), 0.02 * np.arange(1500)
    >>> ground = rng.standard_normal(1500)
    >>> floors = phc.forced_response(frame, t, ground).outputs[1:] + 0.05 * rng.standard_normal((2, 1500))
    >>> fit = phc.pem((ground, floors), 2, dt=0.02, quantity="acceleration", structure="classical")
    >>> fitted = phc.base_motion(fit, masses=[1.0, 1.0])
    >>> fitted.effective_masses[:, 0].round(2), frame.base_motion.effective_masses[:, 0].round(2)
    (array([1.9 , 0.11]), array([1.89, 0.11]))
    >>> bool(abs(fitted.total[0] - 2.0) < 3 * fitted.stderr["total"][0])
    True
    """
    if not hasattr(model, "experiments"):
        if getattr(model, "base_motion", None) is None or not isinstance(model.base_motion, BaseMotion):
            raise StructureError(
                f"the model is a {type(model).__name__} without a motion of its base; pass a fit to accelerations of "
                "the ground, or what from_second_order(M, K, base=..) returns"
            )
        return model.base_motion
    return _of_fit(model, masses)


def _of_fit(result: Any, masses: ArrayLike | None) -> BaseMotion:
    n, (p, m) = result.order, result.residues.shape[1:]
    if not m or not n:
        raise StructureError(f"the fit has {m} inputs and {n} modes; the ground is an input, and masses are of modes")
    unknown = [name for name, kind in zip(result.output_labels, result.quantities, strict=True) if kind == "free"]
    if unknown:
        raise StructureError(
            f"output {unknown[0]!r} is of no known quantity; fit with quantity='acceleration', or what was measured"
        )
    weights = _weights(masses, m, p)
    contributions, J = _contributions(result)
    known = ~np.isnan(np.diag(result.covariance))
    inner = np.where(known[:, None] & known, result.covariance, 0.0)
    lost = np.any(J[:, ~known], axis=1).reshape(n, p, m)
    errors = np.where(lost, np.nan, _deviations(J, inner).reshape(n, p, m))
    by_mass = np.einsum("io,loik->ilk", weights, J.reshape(n, p, m, -1))
    covariance = by_mass @ inner @ np.swapaxes(by_mass, 1, 2)
    if np.any(lost & (weights.T != 0)):
        covariance = np.full_like(covariance, np.nan)
    effective = np.einsum("io,loi->li", weights, contributions)
    mass_errors = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2).T, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        factors = np.sqrt(np.where(effective >= 0, effective, np.nan))
        factor_errors = 0.5 * mass_errors / factors
    stderr = {
        "natural_frequencies": result.stderr["natural_frequencies"], "contributions": errors,
        "effective_masses": mass_errors, "participation_factors": factor_errors,
        "total": np.sqrt(np.maximum(covariance.sum(axis=(1, 2)), 0.0)),
    }  # fmt: skip
    return BaseMotion(
        np.array(result.natural_frequencies), contributions, effective, factors, weights.sum(axis=1), covariance,
        ReadOnlyMapping(stderr),
    )  # fmt: skip


def _weights(masses: ArrayLike | None, inputs: int, outputs: int) -> Array:
    """Check masses (p,) or (m, p); NaN where there are none."""
    if masses is None:
        return np.full((inputs, outputs), np.nan)
    given = _checks.real_array("masses", masses)
    if given.shape not in ((outputs,), (inputs, outputs)) or np.any(given < 0) or not given.any():
        raise StructureError(
            f"masses are {_checks.shown(masses)}; they must be at least 0 and not all 0, shape ({outputs},), one for "
            f"each output, or ({inputs}, {outputs}), by inputs"
        )
    _checks.in_range("masses", given)
    return np.array(np.broadcast_to(given, (inputs, outputs)), float)


def _contributions(result: Any) -> tuple[Array, Array]:
    """Contributions (n, p, m), and their derivatives (n p m, K) by what `PEMResult.covariance` is of."""
    n, count, (p, m) = result.order, len(result.poles), result.residues.shape[1:]
    poles, rho = result.poles[:n], result.residues[:n]
    factor = -in_velocity_units(poles, result.quantities)
    by_d, by_zeta = -velocity_unit_slopes(poles, result.quantities)
    values = (rho * factor[:, :, None]).real
    J = np.zeros((n, p, m, len(result.covariance)))
    l = np.arange(n)
    J[l, :, :, l] = (rho * by_d[:, :, None]).real
    J[l, :, :, count + l] = (rho * by_zeta[:, :, None]).real
    places = np.arange(result.residues.size).reshape(result.residues.shape)[:n]
    mode, output, source = np.indices((n, p, m))
    J[mode, output, source, 2 * count + places] = factor.real[:, :, None]
    J[mode, output, source, 2 * count + result.residues.size + places] = -factor.imag[:, :, None]
    return np.asarray(values), J.reshape(n * p * m, -1)


def _deviations(J: Array, covariance: Array) -> Array:
    return np.asarray(np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", J, covariance, J), 0.0)))
