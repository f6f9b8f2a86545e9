"""Mode shapes and participation of residue matrices, their scale and their standard errors.

    rho_l = c_l b_l^T        of each mode, c_l (outputs,) its shape, b_l (inputs,) its participation

In units of velocity and unit modal mass `rho_l 2j Im p_l / p_l^k` is `psi psi^T`, k = 0, 1, 2 for outputs that are
displacements, velocities and accelerations: a driving point, measured and excited at once, sets the scale of a shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..._types import Array, ComplexArray, Indices, Mask
from ..._units import DERIVATIVES

_ROUNDING = 32 * np.finfo(float).eps  # of the largest entry of a shape: what a singular value decomposition leaves

Ports = Sequence[tuple[int, int]]  # (output, input) of each driving point


def in_velocity_units(poles: ComplexArray, quantities: Sequence[str]) -> ComplexArray:
    """Factors (n, outputs) that make `psi psi^T` of residues: `2j Im p / p^k`."""
    power = np.array([DERIVATIVES[quantity] for quantity in quantities])
    return np.asarray(2j * poles.imag[:, None] / poles[:, None] ** power)


def velocity_unit_slopes(poles: ComplexArray, quantities: Sequence[str]) -> ComplexArray:
    """Derivatives (2, n, outputs) of these factors by sizes and damping ratios of the poles."""
    power, d, zeta = np.array([DERIVATIVES[name] for name in quantities]), np.abs(poles), -poles.real / np.abs(poles)
    moved = np.stack([poles / d, -d * (1 + 1j * zeta / np.sqrt(1 - zeta**2))])[..., None]
    relative = moved.imag / poles.imag[:, None] - power * moved / poles[:, None]
    return np.asarray(in_velocity_units(poles, quantities) * relative)


# --- shapes ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ModeShapes:
    """Shapes (n, p) and participation (n, m) of modes, and of which a driving point sets the scale.

    Residues of outputs of the first quantity are `shape participation^T`.
    """

    shapes: ComplexArray
    participation: ComplexArray
    scaled: Mask

    @classmethod
    def of(cls, poles: ComplexArray, residues: ComplexArray, quantities: Sequence[str], ports: Ports) -> ModeShapes:
        """Those of the rank-one matrices next to residues (n, p, m), in units of velocity.

        With driving points shapes are those of unit modal mass; where there is none the largest entry is 1.
        """
        factors = in_velocity_units(poles, quantities)
        c, b = _leading(residues * factors[:, :, None])
        scale, scaled = _scales(c, b, ports)
        return cls(_without_rounding(c * scale[:, None]), b / (scale * factors[:, 0])[:, None], scaled)


def _scales(c: ComplexArray, b: ComplexArray, ports: Ports) -> tuple[ComplexArray, Mask]:
    """Factors of shapes (n,), and whether a driving point sets them."""
    n = len(c)
    scale, scaled = np.ones(n, complex), np.zeros(n, bool)
    if ports:
        outputs, inputs = _sides(ports)
        # b = scale^2 c at all driving points, by least squares
        square = np.sum(c[:, outputs].conj() * b[:, inputs], axis=1)
        scaled = square != 0
        power = np.sum(np.abs(c[:, outputs]) ** 2, axis=1)
        scale[scaled] = np.sqrt(square[scaled] / power[scaled])
        scale = np.where((_largest(c[:, outputs])[1] * scale).real < 0, -scale, scale)
    peak = _largest(c)[1]
    return np.where(scaled, scale, 1.0 / np.where(peak == 0, 1.0, peak)), scaled


def _without_rounding(shapes: ComplexArray) -> ComplexArray:
    """Shapes (n, p) whose imaginary parts are 0 where they are rounding beside the largest entry."""
    largest = np.abs(shapes).max(axis=1, keepdims=True, initial=0.0)
    return np.where(np.abs(shapes.imag) <= _ROUNDING * largest, shapes.real, shapes)


def _sides(ports: Ports) -> tuple[list[int], list[int]]:
    outputs, inputs = (list(side) for side in zip(*ports, strict=True))
    return outputs, inputs


def _largest(rows: ComplexArray) -> tuple[Indices, ComplexArray]:
    """Place and value of the largest entry of each row."""
    places = np.abs(rows).argmax(axis=1)
    return places, np.take_along_axis(rows, places[:, None], 1)[:, 0]


def _leading(matrices: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """The nearest `c b^T` of matrices (n, p, m), `c` of unit length."""
    n, p, m = matrices.shape
    if not p or not m:
        return np.zeros((n, p), complex), np.zeros((n, m), complex)
    U, s, V = np.linalg.svd(matrices, full_matrices=False)
    return U[:, :, 0], s[:, :1] * V[:, 0]


# --- their standard errors -------------------------------------------------------------------------------------------


def shape_errors(
    poles: ComplexArray, residues: ComplexArray, quantities: Sequence[str], ports: Ports, covariances: Sequence[Array]
) -> ComplexArray:
    """Standard errors of real and imaginary parts of the shapes (n, p), by the delta method.

    `covariances` are those of `(d, zeta, Re rho, Im rho)` of each mode, residues (p, m) row by row.
    """
    errors = np.full(residues.shape[:2], complex(np.nan, np.nan))
    if not residues.shape[2]:
        return errors
    for l, covariance in enumerate(covariances):
        J = shape_jacobian(poles[l], residues[l], quantities, ports)
        variances = np.einsum("ij,jk,ik->i", J, covariance, J)
        parts = np.sqrt(np.maximum(variances, 0.0)).reshape(2, -1)
        errors[l] = parts[0] + 1j * parts[1]
    return errors


def blocks_of_modes(covariance: Array, residues: ComplexArray, n: int) -> list[Array]:
    """Covariances of `(d, zeta, Re rho, Im rho)` of the first n modes, of residues (count, p, m); 0 where not known."""
    count, size = len(residues), residues.size
    entries = np.arange(size).reshape(count, size // max(1, count))
    places = [[l, count + l, *(2 * count + entries[l]), *(2 * count + size + entries[l])] for l in range(n)]
    return [np.nan_to_num(covariance[np.ix_(indices, indices)]) for indices in places]


def shape_jacobian(pole: complex, residue: ComplexArray, quantities: Sequence[str], ports: Ports) -> Array:
    """Derivatives of real, then imaginary parts of a shape by `(d, zeta, Re rho, Im rho)`, (2p, 2 + 2 p m)."""
    p, m = residue.shape
    poles = np.array([pole])
    factor = in_velocity_units(poles, quantities)[0]
    K = residue * factor[:, None]
    dK = np.zeros((2 + 2 * p * m, p, m), complex)
    dK[:2] = residue * velocity_unit_slopes(poles, quantities)[:, 0, :, None]
    unit = (np.eye(p * m) * np.repeat(factor, m)).reshape(p * m, p, m)
    dK[2 : 2 + p * m], dK[2 + p * m :] = unit, 1j * unit
    # left singular vector, up to a factor that the scale takes out
    U, s, V = np.linalg.svd(K)
    u, b = U[:, 0], s[0] * V[0]
    others = np.append(s, np.zeros(p - len(s)))[1:p]
    along = (U[:, 1:].conj().T @ dK @ V[0].conj()) * s[0]
    back = u @ dK.conj() @ V[1 : len(s)].T  # conj of u^H dK v_j
    along[:, : back.shape[1]] += back * others[: back.shape[1]]
    with np.errstate(divide="ignore", invalid="ignore"):
        du = (along / (s[0] ** 2 - others**2)) @ U[:, 1:].T
    db = u.conj() @ dK + du.conj() @ K
    scale, _ = _scales(u[None], b[None], ports)
    shape, dshape = u * scale[0], du * scale[0]
    if ports and _scales(u[None], b[None], ports)[1][0]:
        outputs, inputs = _sides(ports)
        c, dc = u[outputs], du[:, outputs]
        top, below = np.sum(c.conj() * b[inputs]), np.sum(np.abs(c) ** 2)
        dtop = np.sum(dc.conj() * b[inputs] + c.conj() * db[:, inputs], axis=1)
        dbelow = 2 * np.sum((c.conj() * dc).real, axis=1)
        dshape += 0.5 * (dtop / top - dbelow / below)[:, None] * shape
    else:
        k = int(_largest(u[None])[0][0])
        dshape -= dshape[:, k : k + 1] * shape
    return np.concatenate([dshape.real, dshape.imag], axis=1).T
