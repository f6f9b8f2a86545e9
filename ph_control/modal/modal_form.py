"""The core: lossless systems as lists of modes.

A mode is a pole `-i d` with one complex state `x' = -i d x + nu u` and the output `Re(d conj(nu) x)`; a
rigid-body mode is a pole at 0 with a real state.  Frequency responses, zeros and coefficients come from
these lists in O(n) per value.  `propagation.py` moves them through time.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from decimal import localcontext
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy.linalg import rsf2csf
from scipy.linalg.lapack import ztrtrs

from .. import _checks
from .._display import ShownModes
from .._types import Array, ArrayLike, ComplexArray
from ..exceptions import NotLosslessError, StructureError
from ..numerics import polynomials
from ..numerics.modal_assurance import mac
from ..numerics.polynomials import COEFFICIENT_LIMIT, WIDE, ScaledCoefficients, decimals
from .reactance import Reactance
from .zeros import many_port_zeros, one_port_zeros

_CHUNK = 1 << 20  # entries of a (frequency x mode) table held at once


@dataclass(frozen=True, eq=False)
class Cluster:
    """Poles that are not parted: the block `C (sI - A)^{-1} B` that they make, in real Schur form.

    Attributes
    ----------
    A, B, C : ndarray, shapes (k, k), (k, m), (p, k)
        Real matrices of the block.
    """

    A: Array
    B: Array
    C: Array

    @cached_property
    def triangular(self) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """The block with an upper triangular matrix."""
        T, U = rsf2csf(self.A, np.eye(len(self.A)))
        return T, U.conj().T @ self.B, self.C @ U

    @property
    def poles(self) -> ComplexArray:
        """Eigenvalues, as far as they are known; complex ones in exact pairs, as of any real matrix."""
        return np.linalg.eigvals(self.A).astype(complex)

    def states(self, s: ComplexArray) -> ComplexArray:
        """States `(s - T)^{-1} B` of `triangular` at points, shape (k, m, N), by substitution; not finite at a pole."""
        T, B, _ = self.triangular
        x = np.empty((len(T), B.shape[1], len(s)), complex)
        if len(s) < len(T):  # a few points one by one
            for j, point in enumerate(s):
                x[:, :, j], pole = ztrtrs(point * np.eye(len(T)) - T, B)
                x[:, :, j] = np.inf if pole else x[:, :, j]
            return x
        for k in range(len(T) - 1, -1, -1):
            x[k] = (B[k, :, None] + np.tensordot(T[k, k + 1 :], x[k + 1 :], axes=1)) / (s - T[k, k])
        return x


@dataclass(frozen=True, eq=False, repr=False)
class ModalForm(ShownModes):
    """A system in modal coordinates; made by `modes`.

    A lossless one has these attributes; for one port its transfer function is
    `sum_l kappa_l s / (s^2 + d_l^2) + kappa_0 / s`, `kappa_l = r_l d_l` (Foster).  Any other has poles, shapes and
    participation, and refuses what only lossless ones have; see `modes`.

    Attributes
    ----------
    d : ndarray, shape (n,)
        Natural frequencies in rad per unit time, positive, ascending.
    nu : ndarray, shape (n, m)
        Complex input weights, `nu_l = v_l + i v_{n+l}` with `v = S B`, for m ports.
    rigid : ndarray, shape (k, m)
        Real input weights of the rigid-body modes (poles at 0); usually empty.
    r : ndarray, shape (n,) or (n, m)
        `|nu|^2`; a vector for one port.  With `d` the paper's unique identification coordinates.

    Raises
    ------
    StructureError
        If `d` is not positive or not ascending, sizes do not fit, a number is not finite, or `r` is not `|nu|^2`.

    Notes
    -----
    Arrays given are copied, and those of the modal form locked.
    Compare two modal forms by their arrays; `==` compares identity.

    Examples
    --------
    >>> import ph_control as phc
    >>> chain = phc.modes([0.5, 2.0], [1.0, 0.25])
    >>> chain.kappa
    array([0.5, 0.5])
    >>> chain.freqresp([1.0])
    array([0.-0.5j])
    """

    d: Array
    nu: ComplexArray
    rigid: Array
    r: Array = field(default=None)  # type: ignore[arg-type]

    @np.errstate(over="ignore")
    def __post_init__(self) -> None:
        d = _checks.natural_frequencies(self.d)
        if np.any(d[1:] < d[:-1]):
            raise StructureError("d is not ascending; sort the natural frequencies, and the rows of nu with them")
        nu = _checks.complex_matrix("nu", self.nu, len(d))
        rigid = _checks.real_array("rigid", self.rigid, 2)
        if rigid.shape[1] != nu.shape[1]:
            raise StructureError(f"rigid has shape {rigid.shape}; with nu of shape {nu.shape} it needs as many columns")
        self._fill(d, nu, rigid, None if self.r is None else _weights_beside(nu, self.r))
        _checks.representable("the weights |nu|^2", self.r)

    clusters: ClassVar[tuple[Cluster, ...]] = ()

    @classmethod
    def _of(cls, d: Array, nu: ComplexArray, rigid: Array, r: Array | None = None) -> ModalForm:
        """Modal form of arrays of its own that need no check."""
        self = object.__new__(cls)
        self._fill(d, nu, rigid, r)
        return self

    def _fill(self, d: Array, nu: ComplexArray, rigid: Array, r: Array | None) -> None:
        if r is None:
            r = np.abs(nu) ** 2
            r = r[:, 0] if nu.shape[1] == 1 else r
        self.__dict__.update({"d": d, "nu": nu, "rigid": rigid, "r": r})
        for array in (d, nu, rigid, r):
            array.flags.writeable = False

    def __reduce__(self) -> tuple[object, ...]:
        return type(self)._of, (self.d.copy(), self.nu.copy(), self.rigid.copy(), self.r.copy())

    @property
    def n(self) -> int:
        """Number of degrees of freedom: oscillating and rigid-body modes."""
        return len(self.d) + len(self.rigid)

    @property
    def nports(self) -> int:
        """Number of ports m."""
        return int(self.nu.shape[1])

    @property
    def ninputs(self) -> int:
        """Number of inputs."""
        return self.nports

    @property
    def noutputs(self) -> int:
        """Number of outputs."""
        return self.nports

    @property
    def is_lossless(self) -> bool:
        """Whether all poles are on the imaginary axis, with the residues of a system that loses nothing."""
        return True

    @cached_property
    def feedthrough(self) -> Array:
        """Response at infinity, shape (p, m); 0 for a lossless system."""
        return _checks.readonly(np.zeros((self.nports, self.nports)))

    @property
    def equations(self) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Numbers of `x' = p x + b u`, `y = Re(c x)`, shapes (N,), (N, m) and (p, N); rigid bodies last."""
        p = imaginary(np.concatenate([-self.d, np.zeros(len(self.rigid))]))
        c = np.concatenate([self.d[:, None] * self.nu.conj(), self.rigid])
        return p, np.concatenate([self.nu, self.rigid]), c.T

    @property
    def mode_poles(self) -> ComplexArray:
        """Upper pole of each mode, shape (n,); of a lossless system `i d`, rigid-body modes left out."""
        return imaginary(self.d)

    @property
    def natural_frequencies(self) -> Array:
        """Size `|p|` of the poles of each mode, rad per unit time, shape (n,)."""
        return np.abs(self.mode_poles)

    @property
    def damping_ratios(self) -> Array:
        """Damping ratio `-Re p / |p|` of each mode, shape (n,); 1 for real poles, 0 for those at 0."""
        return 0.0 - self.mode_poles.real / np.where(self.mode_poles == 0, 1.0, self.natural_frequencies)

    @property
    def shapes(self) -> ComplexArray:
        """Mode shapes, shape (n, p): the part of each output in the motion of a mode, the largest 1."""
        lead = self.nu[np.arange(len(self.d)), np.abs(self.nu).argmax(axis=1)] if self.nu.size else np.ones(len(self.d))
        return self.nu / np.where(lead == 0, 1.0, lead)[:, None]

    @property
    def participation(self) -> ComplexArray:
        """Participation of the inputs in each mode, shape (n, m): the residue is `shape participation^T`."""
        peak = np.abs(self.nu).max(axis=1, initial=0.0)
        return 0.5 * (self.d * peak**2)[:, None] * self.shapes.conj()

    @property
    def residues(self) -> ComplexArray:
        """Residue matrix of each of `poles`, shape (N, p, m)."""
        upper = self.shapes[:, :, None] * self.participation[:, None, :]
        at_zero = self.rigid[:, :, None] * self.rigid[:, None, :]
        return np.concatenate([upper[::-1].conj(), at_zero, upper])

    @property
    def modal_mass(self) -> Array:
        """Mass of each mode, shape (n,), where input i is the force and output i the velocity of the same point.

        That of the motion of which the shape has the entry 1 at the point that moves most: `1/kappa` for one port, with
        proportional damping as without.  Infinite for a mode that no force reaches.
        """
        p, ports = self.mode_poles, slice(0, self.nports)
        driven = np.abs(self.shapes[:, ports] * self.participation[:, ports]).max(axis=1, initial=0.0)
        turning = np.where(p.imag == 0, 1.0, 2 * p.imag / np.where(p == 0, 1.0, np.abs(p)))
        with np.errstate(divide="ignore"):
            return 1.0 / (driven * turning)

    def mac(self, other: ModalForm) -> Array:
        """Modal assurance criterion `|c^H c'|^2 / (|c|^2 |c'|^2)` of the mode shapes of two forms, from 0 to 1.

        Parameters
        ----------
        other : ModalForm
            With as many outputs.

        Returns
        -------
        ndarray, shape (n, n')
            One row for each mode of this form, one column for each of the other.

        Raises
        ------
        StructureError
            If the other is not a `ModalForm`, or the numbers of outputs differ.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> frame = phc.ph(np.diag([4.0, 1.0, 1.0, 1.0]), np.eye(4)[:, 2:]).modes
        >>> frame.mac(frame)
        array([[1., 0.],
               [0., 1.]])
        """
        if not isinstance(other, ModalForm):
            raise StructureError(f"other is a {type(other).__name__}; it must be a ModalForm, as modes(sys) gives")
        return mac(self.shapes, other.shapes)

    @cached_property
    def kappa(self) -> Array:
        """Residues `kappa_l = r_l d_l` of the pole pairs, shape (n,) or (n, m): those of the diagonal of G."""
        return _checks.readonly((self.r.T * self.d).T)

    @cached_property
    def kappa_0(self) -> Array | float:
        """Residue of the pole at 0: a number for one port, an (m, m) matrix for more."""
        residue = self.rigid.T @ self.rigid
        return float(residue[0, 0]) if self.nports == 1 else _checks.readonly(residue)

    @property
    def poles(self) -> ComplexArray:
        """Poles `-i d, +i d` and 0 (once for each rigid-body mode), ascending imaginary part."""
        return imaginary(np.concatenate([-self.d[::-1], np.zeros(len(self.rigid)), self.d]))

    @cached_property
    def zeros(self) -> ComplexArray:
        """Zeros, all on the imaginary axis, ascending imaginary part.

        One port: 0, unless there is a pole, and `±i w` for the roots `w` of `sum_l kappa_l / (d_l^2 - w^2)`, one
        between two poles each (Foster: poles and zeros interlace), right to the last place or two; O(n^2).
        More ports: the eigenvalues of the skew dynamics compressed to where the output vanishes; O(n^3).
        A mode that no port reaches is a zero as well as a pole.
        """
        if self.nports == 1:
            w = one_port_zeros(self.d, self.kappa, float(self.kappa_0) if len(self.rigid) else None)
        else:
            w = many_port_zeros(self.d, self.nu, self.rigid)
        return _checks.readonly(imaginary(w))

    @cached_property
    def _symmetric_residues(self) -> tuple[Array, Array]:
        """Per mode `d Re(conj(nu_i) nu_j)` and `d Im(conj(nu_i) nu_j)`, shape (n, m, m)."""
        product = self.d[:, None, None] * self.nu.conj()[:, :, None] * self.nu[:, None, :]
        return product.real, product.imag

    def evaluate(self, s: ArrayLike) -> ComplexArray:
        """Transfer function at complex points.

        Parameters
        ----------
        s : array_like, shape (N,)
            Points of the complex plane.

        Returns
        -------
        ndarray, shape (m, m, N)
            `G(s)`; `inf` at a pole and beyond the range of doubles, 0 at infinity, never NaN.

        Raises
        ------
        StructureError
            If the points are not a vector of numbers.

        Notes
        -----
        O(n) per point and entry.  On the imaginary axis the values of a one-port are exactly imaginary and
        right to 5e-14 relative, as a rule to 1e-14, next to a pole and next to a zero alike: where terms cancel, the
        distance to the zero between the poles takes the place of the sum.  Of a zero itself some 30 digits are known,
        so that a value of less than 1e-15 of its terms has fewer digits.

        Examples
        --------
        >>> import ph_control as phc
        >>> phc.modes(1.0, 2.0).evaluate([1.0])
        array([[[1.+0.j]]])
        """
        points = _checks.complex_points("the points", s)
        regular = np.isfinite(points)
        on_axis = regular & (points.real == 0) & (self.nports == 1)
        if on_axis.all() and self.nports == 1:
            return self._on_axis(points.imag)[None, None]
        out = np.zeros((self.nports, self.nports, points.size), complex)
        if on_axis.any():
            out[0, 0, on_axis] = self._on_axis(points[on_axis].imag)
        elsewhere = np.flatnonzero(regular & ~on_axis)
        step = max(1, _CHUNK // max(1, self.n * self.nports))
        with np.errstate(over="ignore", invalid="ignore"):
            for start in range(0, len(elsewhere), step):
                part = elsewhere[start : start + step]
                out[:, :, part] = self._off_axis(points[part])
        return np.where(np.isfinite(out), out, complex(np.inf, 0.0))

    @cached_property
    def _reactance(self) -> Reactance:
        live = self.r > 0
        d, r = (self.d, self.r) if live.all() else (self.d[live], self.r[live])
        return Reactance(d, r, float(np.sum(self.rigid**2)))

    def _on_axis(self, w: Array) -> ComplexArray:
        values = imaginary(self._reactance(w))
        infinite = ~np.isfinite(values.imag)
        if infinite.any():
            values[infinite] = complex(np.inf, 0.0)
        return values

    def _off_axis(self, s: ComplexArray, integrated: bool = False) -> ComplexArray:
        """`sum (s alpha + d beta) / (s^2 + d^2)`; over `s` for outputs that commute, whose `sum beta / d` is 0."""
        alpha, beta = self._symmetric_residues
        x = s[:, None]
        at_pole = (x.real == 0) & (np.abs(x.imag) == self.d)
        # divided one factor after the other: their product may leave the range of doubles
        up, down = (np.where(at_pole, 1.0, x + sign * 1j * self.d) for sign in (1, -1))
        weights = (np.ones_like(x), -x / self.d) if integrated else (x, self.d)
        tables = (np.where(at_pole, 0.0, weight) / up / down for weight in weights)
        out = sum(np.tensordot(part, table.T, axes=(0, 0)) for part, table in zip((alpha, beta), tables, strict=True))
        residue, at_zero = (self.rigid.T @ self.rigid)[:, :, None], s == 0
        still = residue / np.where(at_zero, 1.0, s) / (np.where(at_zero, 1.0, s) if integrated else 1.0)
        # dividing 0 by the smallest numbers gives NaN
        out = out + np.where(residue != 0, still, 0.0)
        infinite = np.einsum("lij,kl->ijk", (alpha != 0) | (beta != 0), at_pole) | ((residue != 0) & at_zero)
        return np.where(infinite, complex(np.inf, 0.0), out)

    def freqresp(self, omega: ArrayLike) -> ComplexArray:
        """Frequency response `G(i omega)`.

        Parameters
        ----------
        omega : array_like
            Angular frequencies, rad per unit time; any shape for one port.

        Returns
        -------
        ndarray
            Shape of `omega` for one port, else (m, m, N).

        Raises
        ------
        StructureError
            If `omega` is not real and finite, or not a vector where there are several ports.

        Notes
        -----
        Accuracy and cost as for `evaluate`.

        Examples
        --------
        >>> import ph_control as phc
        >>> phc.modes(2.0, 0.5).freqresp([0.0, 1.0])
        array([0.+0.j        , 0.+0.33333333j])
        """
        w = _checks.real_array("omega", omega)
        siso = self.ninputs == self.noutputs == 1
        if not siso and w.ndim > 1:
            raise StructureError(f"omega has shape {w.shape}; for several ports it must be a vector")
        values = self.evaluate(imaginary(w.ravel()))
        return values[0, 0].reshape(w.shape) if siso else values

    def coefficients(self) -> tuple[Array, Array]:
        """Coefficients of the transfer function of a one-port, all of full relative accuracy.

        Returns
        -------
        a : ndarray, shape (2n,)
            `(a_0 .. a_{2n-1})` of the denominator `s^{2n} + sum a_i s^i`; odd ones are exactly 0.
        c : ndarray, shape (n,)
            `(c_1, c_3 .. c_{2n-1})`, with which the numerator is `sum c_{2k+1} s^{2(n-k)-1}`.

        Raises
        ------
        StructureError
            If there are several ports, or a coefficient exceeds the range of doubles; `scaled_coefficients` has them.

        Notes
        -----
        Products of `x + d_l^2` and `kappa_l`: every term is positive, so nothing cancels.  O(n^2).  The
        coefficients are right to the last places; how much the modes can be told from them is another question, see
        `from_coefficients`.

        Examples
        --------
        >>> import ph_control as phc
        >>> a, c = phc.modes([1.0, 2.0], [1.0, 1.0]).coefficients()
        >>> a, c
        (array([4., 0., 5., 0.]), array([3., 6.]))
        """
        plain = polynomials.plain_coefficients(self.d, self.r) if self.r.ndim == 1 and not len(self.rigid) else None
        if plain is not None:
            return plain
        a, c = self.scaled_coefficients()
        if not (a.fit_doubles and c.fit_doubles):
            raise StructureError(
                f"the coefficients of {self.n} modes from {self.d.min():.3g} to {self.d.max():.3g} rad/time exceed the "
                "range of doubles; scale time, use scaled_coefficients(), or work with d and r"
            )
        return a.to_doubles(), c.to_doubles()

    def scaled_coefficients(self) -> tuple[ScaledCoefficients, ScaledCoefficients]:
        """Coefficients of `coefficients`, with mantissas and exponents apart: nothing overflows.

        Returns
        -------
        a : ScaledCoefficients, shape (2n,)
            Of the denominator.
        c : ScaledCoefficients, shape (n,)
            Of the numerator.

        Raises
        ------
        StructureError
            If there are several ports.

        Notes
        -----
        Cost and accuracy as `coefficients`.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> a, c = phc.modes(np.arange(1.0, 501.0) ** 2, np.ones(500)).scaled_coefficients()
        >>> round(a.log10().max())
        4536
        """
        if self.nports != 1:
            raise StructureError(f"coefficients are those of a one-port; this system has {self.nports} ports")
        with localcontext(WIDE):
            d, still = decimals(self.d), decimals(self.rigid[:, 0])
            return polynomials.transfer_coefficients(
                np.append(0 * still, d * d), np.append(still * still, d * decimals(self.r))
            )

    @classmethod
    def from_coefficients(cls, a: ArrayLike, c: ArrayLike) -> ModalForm:
        """Modes from the coefficients of a transfer function: the way back from `coefficients`.

        Parameters
        ----------
        a : array_like, shape (2n,)
            `(a_0 .. a_{2n-1})`, odd ones 0, even ones positive.
        c : array_like, shape (n,)
            `(c_1, c_3 .. c_{2n-1})`.

        Returns
        -------
        ModalForm
            With n distinct frequencies.

        Raises
        ------
        StructureError
            If the sizes or signs are wrong, a frequency is repeated, or fewer than four digits of the frequencies
            survive the rounding of the coefficients; the message says how many.
        NotLosslessError
            If a residue is negative.

        Notes
        -----
        The roots and residues are those of the coefficients as given, right to the last place.  What limits `d` is
        the rounding of the coefficients: a relative error `eps` of each moves `d_l` by as much as
        `eps prod_{j != l} (d_l^2 + d_j^2)/|d_l^2 - d_j^2|`, which for frequencies spread over one decade is 1e-12 for
        10 modes, 4e-7 for 20 and hopeless from 25 on.  O(n^2) with a large constant.

        Examples
        --------
        >>> import ph_control as phc
        >>> phc.ModalForm.from_coefficients([4.0, 0.0, 5.0, 0.0], [3.0, 6.0])
        modes([1.0, 2.0], [1.0, 1.0])
        """
        even, odd = _checks.transfer_coefficients(a, c)
        with np.errstate(over="ignore"):
            # products are split into halves of their digits
            _checks.representable("products of these coefficients", 2.0**30 * even, 2.0**30 * odd)
        if len(even) == 0:
            return from_frequencies(np.zeros(0), np.zeros(0))
        with np.errstate(over="ignore", invalid="ignore"):
            fractions = polynomials.fractions_from_coefficients(even, odd[::-1])
        worst = np.inf if fractions is None else float((fractions[0][1] / fractions[0][0]).max())
        if fractions is None or not worst <= COEFFICIENT_LIMIT:
            carried = "no digit" if not worst < np.inf else f"{-np.log10(worst):.1f} digits"
            raise StructureError(
                f"the coefficients carry {carried} of the frequencies, needed {-np.log10(COEFFICIENT_LIMIT):.0f}: "
                "their rounding to doubles moves the roots of the denominator together, or off the imaginary axis; "
                "keep d and r, or zeros, poles and gain, instead of coefficients"
            )
        (d, _), (kappa, error) = fractions
        negative = kappa < -error
        if negative.any():
            pairs = zip(kappa[negative], d[negative], strict=True)
            raise NotLosslessError([f"residue {k:.6g} of the pole {w:.6g}i is negative" for k, w in pairs])
        return from_frequencies(d, np.maximum(kappa, 0.0) / d)

    @property
    def is_minimal(self) -> bool:
        """Whether every mode is reached and no frequency repeats: `minimal` would change nothing."""
        return self.minimal().n == self.n

    def minimal(self, *, rtol: float | None = None) -> ModalForm:
        """Merge equal frequencies and drop modes that no port reaches: the same transfer function.

        Parameters
        ----------
        rtol : float, optional
            Frequencies closer than `rtol * d` are one; residues below `rtol` times the largest are dropped.
            Default `8 n eps` for frequencies, and exact zeros only for residues.

        Returns
        -------
        ModalForm
            The minimal form; with m ports a frequency stays up to m times.

        Raises
        ------
        StructureError
            If `rtol` is no number from 0 to 1.

        Examples
        --------
        >>> import ph_control as phc
        >>> phc.modes([1.0, 1.0, 3.0], [0.25, 0.5, 0.0]).minimal()
        modes([1.0], [0.75])
        """
        from .error_bounds import separate
        from .minimal import minimal_of_exact

        known = minimal_of_exact(self) if rtol is None else None
        return separate(self, rtol=rtol).minimal() if known is None else known


def _weights_beside(nu: ComplexArray, r: ArrayLike) -> Array:
    """`r`, which is kept beside `nu` to the last bit, held against a change of one without the other."""
    weights = _checks.real_array("r", r)
    shape = nu.shape[:1] if nu.shape[1] == 1 else nu.shape
    if weights.shape != shape:
        raise StructureError(f"r has shape {weights.shape}; with nu of shape {nu.shape} it must be {shape}")
    if np.any(weights < 0):
        raise StructureError(f"r is negative: {weights.min():.6g}; weights are >= 0")
    size, root = np.abs(nu).reshape(shape), np.sqrt(weights)
    # compared as roots, whose squares may underflow
    if np.any(np.abs(size - root) > np.sqrt(_checks.EPS) * root + 2 * np.sqrt(_checks.TINY)):
        raise StructureError("r is not |nu|^2; change both or none")
    return weights


def imaginary(w: Array) -> ComplexArray:
    """`i w` with real parts exactly +0."""
    out = np.zeros(np.shape(w), complex)
    out.imag = w
    return out


def from_frequencies(d: ArrayLike, r: ArrayLike) -> ModalForm:
    """Check `(d, r)` of a one-port, sort them, and make a modal form."""
    frequencies = _checks.natural_frequencies(d)
    weights = _checks.residue_weights(r, len(frequencies))
    with np.errstate(over="ignore"):
        residues = frequencies * weights
    if np.count_nonzero((residues >= _checks.TINY) & (residues < np.inf)) < np.count_nonzero(weights):
        if np.isinf(residues).any():
            raise StructureError("a residue d r exceeds the range of doubles; scale the output or time")
        _checks.representable("the residues d r", residues, nonzero=weights > 0)
    if np.count_nonzero(frequencies[1:] < frequencies[:-1]):
        order = np.argsort(frequencies, kind="stable")
        frequencies, weights = frequencies[order], weights[order]
    return ModalForm._of(frequencies, np.sqrt(weights).astype(complex)[:, None], np.zeros((0, 1)), weights)
