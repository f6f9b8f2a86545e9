"""General constant structure: `z' = J Q z + B u` with any skew `J`, brought to the normal form.

An invertible `J` becomes canonical in Darboux coordinates.  The kernel of a singular one holds Casimirs: linear
functions of the state that the motion conserves whatever the energy, and that only the ports can change.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .. import _checks
from .._display import counted
from .._frozen import Frozen
from .._types import Array, ArrayLike, Mask
from ..exceptions import StructureError
from ..numerics import definiteness as _definite
from ..numerics.graphs import components
from .forms_and_williamson import skew_normal_form


class _Planes(NamedTuple):
    """`J = sum_l sigma_l (a_l b_l^T - b_l a_l^T)`, orthonormal columns, the rest of which spans the kernel.

    `sizes` are all singular values, with those that count as zero.
    """

    sigma: Array
    a: Array
    b: Array
    kernel: Array
    sizes: Array

    def to_canonical(self) -> Array:
        """`T` with `T J T^T` canonical."""
        return (np.concatenate([self.a, self.b], axis=1) / np.sqrt(np.tile(self.sigma, 2))).T

    def from_canonical(self) -> Array:
        """Columns that undo `to_canonical` on the range of `J`."""
        return np.concatenate([self.a, self.b], axis=1) * np.sqrt(np.tile(self.sigma, 2))


@dataclass(frozen=True, eq=False)
class CasimirSplit(Frozen):
    """A system with a singular structure matrix, its Casimirs split off; made by `split_casimirs`.

    Attributes
    ----------
    Q : ndarray, shape (2m, 2m)
        Hamiltonian matrix in the new coordinates: `ph(Q, B)` has the transfer function of the original.
    B : ndarray, shape (2m, number of ports)
        Input matrix in the new coordinates.
    T : ndarray, shape (2m, N)
        New coordinates of an old state, `T z`.  The rows of the added cyclic positions are zero.
    rank : int
        Rank of `J`; `m` is half of it, and one more for each driven Casimir.
    casimirs : ndarray, shape (N - rank, N)
        Orthonormal rows `k` with `J k^T = 0`: the Casimirs are `casimirs @ z`, the driven ones first.
    driven : ndarray of bool, shape (N - rank,)
        Which of them the ports change; the others keep their initial value for ever.

    Notes
    -----
    A driven Casimir `c' = B_c u` becomes the momentum of an added position `q_c' = dH/dc`, on which nothing depends.
    A Casimir that no port drives stays what it was at the start and is set to 0 here: another value would only add a
    constant force.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> J = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    >>> split = phc.split_casimirs(np.diag([1.0, 1.0, 3.0]), [0.0, 1.0, 0.0], J)
    >>> split.rank, split.casimirs, split.driven
    (2, array([[0., 0., 1.]]), array([False]))
    """

    Q: Array
    B: Array
    T: Array
    rank: int
    casimirs: Array
    driven: Mask

    def __str__(self) -> str:
        return self.report()

    def report(self) -> str:
        """Describe in words what was split off.

        Returns
        -------
        str
            A few lines: rank, kernel, each Casimir with its coefficients and its fate, the size of the result.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> J = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
        >>> print(phc.split_casimirs(np.eye(3), [0.0, 1.0, 0.0], J).report())
        structure matrix of size 3 and rank 2: 1 degree of freedom and 1 Casimir
        c_1 = z_3: no port drives it; it keeps its initial value, set to 0
        port-Hamiltonian system with 1 degree of freedom
        """
        size = self.casimirs.shape[1]
        lines = [
            f"structure matrix of size {size} and rank {self.rank}: {counted(self.rank // 2, 'degree')} of freedom "
            f"and {counted(len(self.driven), 'Casimir')}"
        ]
        for k, (row, driven) in enumerate(zip(self.casimirs, self.driven, strict=True), start=1):
            fate = (
                "driven by the ports; it becomes the momentum of an added cyclic position"
                if driven
                else "no port drives it; it keeps its initial value, set to 0"
            )
            lines.append(f"c_{k} = {_linear(row)}: {fate}")
        lines.append(f"port-Hamiltonian system with {counted(len(self.Q) // 2, 'degree')} of freedom")
        return "\n".join(lines)


def darboux(J: ArrayLike) -> Array:
    """Darboux coordinates: bring any invertible skew matrix to the canonical symplectic form.

    Parameters
    ----------
    J : array_like, shape (2n, 2n)
        Skew-symmetric structure matrix, as in `z' = J Q z + B u`.

    Returns
    -------
    ndarray, shape (2n, 2n)
        `T` with `T J T^T = [[0, I], [-I, 0]]`: in the coordinates `T z` the structure is canonical.

    Raises
    ------
    StructureError
        If `J` is not square, even and skew-symmetric (up to `1000 * 2n * eps` of its size), or is singular: then it has
        Casimirs, which `split_casimirs` splits off.

    Notes
    -----
    An orthogonal matrix, its rows divided by the roots of the singular values of `J`: the condition number of `T` is
    the root of that of `J`, the smallest possible.  Singular means a singular value below `8 * 2n * eps` times the
    largest, among variables that `J` couples; those that it does not couple are treated apart.  Cost O(n^3);
    `T J T^T` is canonical up to `n eps` times the condition number of `J`.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> J = np.array([[0.0, 4.0], [-4.0, 0.0]])
    >>> T = phc.darboux(J)
    >>> T @ J @ T.T
    array([[ 0.,  1.],
           [-1.,  0.]])
    """
    return _invertible(_planes(_structure_matrix(J))).to_canonical()


def normal_form(Q: ArrayLike, B: ArrayLike, J: ArrayLike) -> tuple[Array, Array]:
    """Q and B of `z' = J Q z + B u`, `y = B^T Q z` in the coordinates `darboux(J) z`, Q exactly symmetric."""
    structure = _structure_matrix(J)
    energy, ports = _energy_and_ports(Q, B, len(structure))
    planes = _invertible(_planes(structure))
    return _congruent(energy, planes.from_canonical()), planes.to_canonical() @ ports


def split_casimirs(Q: ArrayLike, B: ArrayLike, J: ArrayLike) -> CasimirSplit:
    """Split the Casimirs off `z' = J Q z + B u`, `y = B^T Q z` with any constant skew `J`.

    Parameters
    ----------
    Q : array_like, shape (N, N)
        Hamiltonian matrix, symmetric positive semidefinite; `N` may be odd.
    B : array_like, shape (N,) or (N, m)
        Input matrix.
    J : array_like, shape (N, N)
        Skew-symmetric structure matrix, singular or not.

    Returns
    -------
    CasimirSplit
        The system in normal form, with the same transfer function, and the Casimirs; `print` it.

    Raises
    ------
    StructureError
        If the matrices do not fit, or are not what their names say.

    Notes
    -----
    Orthogonal coordinates of the range and the kernel of `J`; on the range those of `darboux`.  The kernel is turned so
    that as few Casimirs as possible are driven: as many as `K^T B` has rank, `K` a basis of the kernel.  An entry of
    `K^T B` is zero if it is below `8 N eps` times what the port does to the variables of that Casimir, whatever it does
    to others.  O(N^3).

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> J = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    >>> split = phc.split_casimirs(np.diag([1.0, 1.0, 3.0]), [0.0, 1.0, 2.0], J)
    >>> split.driven, split.casimirs
    (array([ True]), array([[0., 0., 1.]]))
    >>> split.Q, split.B.T
    (array([[1., 0., 0., 0.],
           [0., 0., 0., 0.],
           [0., 0., 1., 0.],
           [0., 0., 0., 3.]]), array([[0., 0., 1., 2.]]))
    """
    structure = _structure_matrix(J)
    energy, ports = _energy_and_ports(Q, B, len(structure))
    planes = _planes(structure)
    casimirs, driven = _driven_first(planes.kernel, ports)
    momenta = casimirs[driven]
    x, back = planes.to_canonical(), planes.from_canonical()
    half, cyclic = len(x) // 2, np.zeros_like(momenta)
    T = np.concatenate([x[:half], cyclic, x[half:], momenta])
    columns = np.concatenate([back[:, :half], cyclic.T, back[:, half:], momenta.T], axis=1)
    return CasimirSplit(_congruent(energy, columns), T @ ports, T, 2 * half, casimirs, driven)


def _structure_matrix(J: ArrayLike) -> Array:
    """Check a structure matrix: square and skew."""
    array = _checks.real_array("J", J, 2)
    rows, columns = array.shape
    if rows != columns:
        raise StructureError(f"J is not square: its shape is {array.shape}; it must be (N, N), of the size of Q")
    _checks.in_range("J", array)
    return _checks.skew_matrix("J", array)


def _energy_and_ports(Q: ArrayLike, B: ArrayLike, size: int) -> tuple[Array, Array]:
    """Check `Q` and `B` for a structure matrix of a given size, which may be odd."""
    energy = _checks.real_array("Q", Q)
    if energy.shape != (size, size):
        raise StructureError(f"Q has shape {energy.shape}; with J of shape ({size}, {size}) it must be the same")
    return _definite.hamiltonian_matrix(energy, even=False), _checks.port_matrix(B, size)


def _planes(J: Array) -> _Planes:
    """Normal form of `J`, group by group of variables that it couples, in the order of the variables."""
    count, label = components(J != 0)
    unit, none = np.eye(len(J)), np.zeros((len(J), 0))
    forms = [(np.zeros(0), none, none, none, np.zeros(0))]
    for k in range(count):
        group = np.flatnonzero(label == k)
        values, left_vectors, right_vectors = skew_normal_form(J[np.ix_(group, group)])
        a, b = unit[:, group] @ left_vectors, unit[:, group] @ right_vectors
        zero = int(np.sum(values <= 8 * len(group) * _checks.EPS * values.max(initial=0.0)))
        pairs = slice(zero, len(values))
        kernel = np.concatenate([a[:, :zero], b[:, :zero], a[:, len(values) :], b[:, len(values) :]], axis=1)
        sizes = np.append(values, np.zeros(len(group) - 2 * len(values)))
        forms.append((values[pairs], a[:, pairs], b[:, pairs], kernel, sizes))
    return _Planes(*(np.concatenate(parts, axis=-1) for parts in zip(*forms, strict=True)))


def _invertible(planes: _Planes) -> _Planes:
    size, kernel = planes.kernel.shape
    if kernel:
        raise StructureError(
            f"J is singular: its singular values range from {planes.sizes.min():.3g} to {planes.sizes.max():.3g} "
            f"(below {8 * size * _checks.EPS:.1e} of the largest they count as 0); rank {size - kernel} of {size}, "
            f"kernel of dimension {kernel}: so many Casimirs, which split_casimirs(Q, B, J) splits off"
        )
    return planes


def _driven_first(kernel: Array, ports: Array) -> tuple[Array, Mask]:
    """Rows of Casimirs, turned so that the first ones take all that the ports do to the kernel."""
    size, count = kernel.shape
    zero = 8 * size * _checks.EPS
    ports = ports / _largest(ports, axis=0)
    reached = kernel.T @ ports
    # against the rounding of the variables in each Casimir, whatever a port does to others
    reached[np.abs(reached) <= zero * ((kernel != 0).T @ np.abs(ports))] = 0.0
    unit = _largest(reached, axis=1)
    U, gain, _ = np.linalg.svd(reached / unit)
    rank = int(np.sum(gain > zero))
    driven = np.arange(count) < rank
    if rank in (0, count):
        return kernel.T.copy(), driven
    still = U[:, rank:] / unit
    still = still / _largest(still, axis=0)
    # large rows first: then Householder reflections keep the digits of each row, however small
    order = np.argsort(-np.abs(still).max(axis=1), kind="stable")
    turn = np.empty((count, count))
    turn[order], _ = np.linalg.qr(still[order], mode="complete")
    return np.roll(turn, rank, axis=1).T @ kernel.T, driven


def _largest(M: Array, axis: int) -> Array:
    """Largest size along an axis, 1 where all are 0; kept as an axis of length 1."""
    size = np.abs(M).max(axis=axis, initial=0.0, keepdims=True)
    return np.where(size > 0, size, 1.0)


def _congruent(Q: Array, columns: Array) -> Array:
    """`columns^T Q columns`, exactly symmetric."""
    M = columns.T @ Q @ columns
    return 0.5 * (M + M.T)


def _linear(row: Array) -> str:
    """A linear function of z in words, its negligible terms left out."""
    shown = np.flatnonzero(np.abs(row) > 1e-9 * np.max(np.abs(row)))
    text = ""
    for k in shown[:6]:
        size = "" if abs(row[k]) == 1 else f"{abs(row[k]):.4g} "
        sign = (" - " if row[k] < 0 else " + ") if text else ("-" if row[k] < 0 else "")
        text += f"{sign}{size}z_{k + 1}"
    return text + (f" + {len(shown) - 6} more" if len(shown) > 6 else "")
