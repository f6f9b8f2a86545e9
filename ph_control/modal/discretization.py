"""Discretisation: how a mode `x' = p x + u` meets the samples of its input, for any complex pole `p`.

One step is `x_{k+1} = lambda x_k + b_0 u_k + b_1 u_{k+1}`.  For the exact solution its numbers are, with `z = h p`,

    lambda = e^z,   int_0^1 e^{z t} dt = phi_1(z),   int_0^1 (1 - t) e^{z t} dt = phi_2(z),

and derivatives by the pole are the same integrals with a factor `t`: of one sign for real `z`, so that quadrature loses
no digits.  What is here is the only home of these numbers, and of those of the midpoint rule and of Euler's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from .. import _checks
from .._options import DISCRETISATIONS, INTERPOLATIONS, Discretisation, Interpolation
from .._types import Array, ComplexArray, Mask
from ..exceptions import NotLosslessError, StructureError
from ..numerics import double_double as tf
from ..numerics.exponential import one_step
from ..numerics.pole_residue import SAFETY, PoleResidueForm
from ..numerics.rational import LinearSystem

_LARGEST_GROWTH = 1e50  # of a mode over a record, where the method makes modes grow
_DEAD = -1e6  # logarithm of a multiplier that is 0: any power of it is 0, but the power 0

_NEAR = 3.0  # up to here integrals by quadrature, from here on by formulas that divide by z
# the quadrature of 10 points is right to 1e-18 there
_nodes, _weights = np.polynomial.legendre.leggauss(10)
_T = 0.5 * (_nodes + 1.0)
_MOMENTS = 0.5 * _weights[:, None] * np.stack([1.0 - _T, _T, _T * (1.0 - _T), _T**2], axis=1)


@dataclass(frozen=True)
class Multipliers:
    """Multipliers of modes in one time step, `lambda = exp(growth + i phase)`, shapes (N,).

    The phase is a pair of doubles, so that high powers keep it.
    """

    growth: Array
    phase: tf.Pair

    def powers(self, k: Array) -> ComplexArray:
        """`lambda^k` for integers k, shape (N, len(k))."""
        rotation = tf.cis_multiples(self.phase, k)
        return rotation * np.exp(np.multiply.outer(self.growth, k)) if self.growth.any() else rotation

    @property
    def multiplier(self) -> ComplexArray:
        """The numbers `lambda`, shape (N,)."""
        return self.powers(np.ones(1))[:, 0]


@dataclass(frozen=True)
class DiscreteModes(Multipliers):
    """One time step of all modes: `x_{k+1} = lambda x_k + b0 u_k + b1 u_{k+1}`, `y = Re(c x)`.

    Shapes: `b0`, `b1` (N, m); `c` (p, N).
    """

    b0: ComplexArray
    b1: ComplexArray
    c: ComplexArray


class MatrixStep(NamedTuple):
    """One time step of a block of states, `x_{k+1} = (F + rest) x_k + held u_k + risen (u_{k+1} - u_k)`.

    `rest` is what the rounding of `F` leaves: without it the errors of many short steps add up.
    """

    F: Array
    rest: Array
    held: Array
    risen: Array


@dataclass(frozen=True)
class Hold:
    """Rule by which continuous modes are sampled: step, method, and behaviour of the input between samples.

    Attributes
    ----------
    h : float
        Time between samples.
    method : {'exact', 'midpoint', 'euler'}
        Exact solution; implicit midpoint rule, input at the middle of the step, `(1 + z/2)/(1 - z/2)`; explicit Euler,
        `1 + z`.
    intersample : {'zoh', 'foh'}
        Input held, or interpolated linearly.

    Raises
    ------
    StructureError
        By the methods, if Euler's rule is to interpolate, or the midpoint rule has no step for a pole at `2/h`.

    Notes
    -----
    Right to a few roundings for any `|h p|` up to 1e9 and beyond, next to 0 and next to whole turns as well, where
    `phi_1` vanishes; the product `h p` is formed with twice the digits.

    Examples
    --------
    >>> import numpy as np
    >>> from ph_control.modal.discretization import Hold
    >>> hold = Hold(0.1, "exact", "foh")
    >>> now, then = hold.weights(np.array([-2.0 + 30.0j]))
    >>> hold.multiplier(np.array([-2.0])).round(6)
    array([0.818731+0.j])
    """

    h: float
    method: Discretisation = "exact"
    intersample: Interpolation = "zoh"

    def multiplier(self, p: ComplexArray) -> ComplexArray:
        """Factor `lambda` of the state in one step, shape of `p`."""
        z, rest = self._turn(p)
        if self.method == "exact":
            return np.asarray(np.exp(z) * np.exp(rest))
        if self.method == "midpoint":
            return np.asarray(((1.0 + 0.5 * z) + 0.5 * rest) * self._inverse(z))
        return (1.0 + z) + rest

    def log_multiplier(self, p: ComplexArray) -> tuple[Array, tf.Pair]:
        """Logarithm of `lambda`: its real part, and its imaginary part as a pair of doubles."""
        p = np.asarray(p, complex)
        if self.method == "exact":
            return self.h * p.real, tf.two_prod(p.imag, np.full(p.shape, self.h))
        # as far as the long double of the platform reaches
        h = np.longdouble(self.h if self.method == "euler" else 0.5 * self.h)
        x, y = h * p.real, h * p.imag
        with np.errstate(divide="ignore", over="ignore"):
            if self.method == "euler":
                growth, phase = 0.5 * np.log1p(x * (2 + x) + y * y), np.arctan2(y, 1 + x)
            else:
                growth = 0.5 * np.log1p(4 * x / ((1 - x) ** 2 + y * y))
                phase = np.arctan2(2 * y, (1 - x) * (1 + x) - y * y)
        high = phase.astype(float)
        return np.maximum(growth.astype(float), _DEAD), (high, (phase - high).astype(float))

    def weights(self, p: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Weights of `u_k` and `u_{k+1}` in one step of `x' = p x + u`, shape of `p` each."""
        if (self.method, self.intersample) == ("exact", "zoh"):
            z, rest = self._turn(p)
            return self.h * phi_1(z, rest), np.zeros_like(z)
        return self.weights_and_derivatives(p)[:2]

    def weights_and_derivatives(self, p: ComplexArray) -> tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray]:
        """Both `weights` and the derivatives of both by the pole, shape of `p` each."""
        z, rest = self._turn(p)
        h = self.h
        if self.method == "exact":
            later, now, later_slope, now_slope = _integrals(z, rest)
            if self.intersample == "zoh":
                zero = np.zeros_like(z)
                return h * phi_1(z, rest), zero, h * h * now, zero
            return h * now, h * later, h * h * now_slope, h * h * later_slope
        if self.method == "midpoint":
            inverse = self._inverse(z)
            return *self._split(h * inverse), *self._split(0.5 * h * h * inverse**2)
        return *self._split(np.full_like(z, h)), *self._split(np.zeros_like(z))

    def late_weights(self, p: ComplexArray, late: float) -> tuple[ComplexArray, ComplexArray]:
        """Weights in one step of what a state was a part of a step before, and their derivatives by the pole.

        Parameters
        ----------
        p : ndarray of complex, shape (n,)
            Poles of `x' = p x + u`.
        late : float
            Part of a step, between 0 and 1, by which the state is seen late; steps are exact.

        Returns
        -------
        weights, slopes : ndarray of complex, shape (3, n)
            Of `u_(k-1)`, `u_k` and `u_(k+1)` in `x((k+1-late) h) = lambda x((k-late) h) + ..`.

        Notes
        -----
        Between the two instants lie the end of one interval between samples and the beginning of the next.

        Examples
        --------
        >>> import numpy as np
        >>> from ph_control.modal.discretization import Hold
        >>> Hold(1.0).late_weights(np.array([0.0 + 0j]), 0.25)[0].real.ravel()
        array([0.25, 0.75, 0.  ])
        """
        early, h = 1.0 - late, self.h
        end, start = replace(self, h=late * h), replace(self, h=early * h)
        turn, (before, now, before_slope, now_slope) = start.multiplier(p), end.weights_and_derivatives(p)
        first, then, first_slope, then_slope = start.weights_and_derivatives(p)
        if self.intersample == "foh":
            # of the line through two samples a part: what it is at the ends of the part mixes both
            before, now = late * before, early * before + now
            before_slope, now_slope = late * before_slope, early * before_slope + now_slope
            first, then = first + late * then, early * then
            first_slope, then_slope = first_slope + late * then_slope, early * then_slope
        slope = early * h * turn
        weights = np.stack([turn * before, turn * now + first, then])
        slopes = np.stack([turn * before_slope, turn * now_slope + first_slope, then_slope])
        return weights, slopes + slope * np.stack([before, now, np.zeros_like(now)])

    def log_derivative(self, p: ComplexArray) -> ComplexArray:
        """Derivative of `log lambda` by the pole."""
        p = np.asarray(p, complex)
        if self.method == "exact":
            return np.full(p.shape, complex(self.h))
        z = self.h * p
        return self.h / ((1.0 - 0.5 * z) * (1.0 + 0.5 * z) if self.method == "midpoint" else 1.0 + z)

    def pole(self, multiplier: ComplexArray) -> ComplexArray:
        """Pole in continuous time of a multiplier: the slowest of those that the samples do not tell apart."""
        if self.method == "midpoint":
            return np.asarray(2.0 / self.h * (multiplier - 1.0) / (multiplier + 1.0))
        return np.asarray((multiplier - 1.0 if self.method == "euler" else np.log(multiplier)) / self.h)

    def step(self, p: ComplexArray, b: ComplexArray | None = None, c: ComplexArray | None = None) -> DiscreteModes:
        """One step of `x' = p x + b u`, `y = Re(c x)`; without `b` or `c` a unit input of every mode, a sum of all."""
        b = np.ones((len(p), 1), complex) if b is None else b
        now, then = (weight[:, None] for weight in self.weights(p))
        c = np.ones((1, len(p)), complex) if c is None else c
        return DiscreteModes(*self.log_multiplier(p), now * b, then * b, c)

    def frequency_of(self, phase: Array) -> Array:
        """Natural frequency of the undamped mode that turns by `phase` (rad) in one step."""
        if self.method == "midpoint":
            return 2.0 / self.h * np.tan(0.5 * phase)
        return np.tan(phase) / self.h if self.method == "euler" else phase / self.h

    def largest_phase(self, samples: int) -> float:
        """Largest phase per step of an undamped mode; Euler's rule makes it grow, and it must not overflow."""
        if self.method == "euler":
            return float(np.arccos(np.exp(-np.log(_LARGEST_GROWTH) / samples)))
        return float(np.pi)

    def step_of_matrices(self, A: Array, B: Array) -> MatrixStep:
        """One step of `x' = A x + B u`, whose eigenvalues may coincide."""
        n, h = len(B), self.h
        zero = np.zeros_like(B)
        if self.method == "euler":
            self._check_interpolation()
            return MatrixStep(np.eye(n) + h * A, np.zeros_like(A), h * B, zero)
        if self.method == "midpoint":
            try:
                both = np.linalg.solve(
                    np.eye(n) - 0.5 * h * A, np.concatenate([np.eye(n) + 0.5 * h * A, h * B], axis=1)
                )
            except np.linalg.LinAlgError:
                raise self._no_step() from None
            held = both[:, n:]
            return MatrixStep(both[:, :n], np.zeros_like(A), held, zero if self.intersample == "zoh" else 0.5 * held)
        with np.errstate(over="ignore", invalid="ignore"):
            (F, rest), (held, _), (risen, _) = one_step(A, B, h)
        return MatrixStep(F, rest, held, zero if self.intersample == "zoh" else risen)

    def _turn(self, p: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """`h p` with twice the digits."""
        p = np.asarray(p, complex)
        parts = p.reshape(-1).view(float)
        high, low = tf.two_prod(parts, np.full(parts.shape, self.h))
        return high.view(complex).reshape(p.shape), low.view(complex).reshape(p.shape)

    def _inverse(self, z: ComplexArray) -> ComplexArray:
        if np.any(z == 2.0):
            raise self._no_step()
        return 1.0 / (1.0 - 0.5 * z)

    def _no_step(self) -> StructureError:
        return StructureError(
            f"the midpoint rule has no step for an unstable pole at 2/h = {2 / self.h:.6g}; use method='exact'"
        )

    def _split(self, weight: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Shares of `u_k` and `u_{k+1}` in what a rule makes of the input at the middle, or at the start."""
        if self.method == "euler":
            self._check_interpolation()
        return (weight, np.zeros_like(weight)) if self.intersample == "zoh" else (0.5 * weight, 0.5 * weight)

    def _check_interpolation(self) -> None:
        if self.intersample == "foh":
            raise StructureError(
                "method='euler' uses the input at the start of each step only, so intersample must be 'zoh'; "
                "use method='exact' or 'midpoint' for interpolated inputs"
            )


_OTHER_NAMES = {
    "tustin": ("midpoint", "foh"),
    "bilinear": ("midpoint", "foh"),
    "zoh": ("exact", "zoh"),
    "foh": ("exact", "foh"),
}


def check_method(method: object) -> Discretisation:
    """Check the name of a rule of stepping; those of python-control are explained."""
    if isinstance(method, str) and method in _OTHER_NAMES:
        rule, hold = _OTHER_NAMES[method]
        raise StructureError(f"method is {method!r}; here that is method={rule!r} with intersample={hold!r}")
    return _checks.choice("method", method, DISCRETISATIONS)


def phi_1(z: ComplexArray, rest: ComplexArray | float = 0.0) -> ComplexArray:
    """`(e^z - 1)/z` at `z + rest`, to a few roundings also near 0 and near whole turns."""
    # not expm1, whose complex version loses digits in some releases of numpy
    safe = np.where(z == 0, 1.0, z)
    slow = np.abs(z.real) <= 1.0
    half, low = 0.5 * np.where(slow, safe, 1.0), 0.5 * np.where(slow, rest, 0.0)
    value = np.exp(half) * np.exp(low) * (np.sinh(half) + low * np.cosh(half)) / half
    if not slow.all():
        value = np.where(slow, value, (np.exp(z) * np.exp(rest) - 1.0) / safe)
    return np.where(z == 0, 1.0, value)


def _integrals(z: ComplexArray, rest: ComplexArray) -> tuple[ComplexArray, ...]:
    """Integrals of `e^{z t}` over [0, 1] with the factors `1 - t`, `t`, `t (1 - t)` and `t^2`.

    These are `phi_2`, `phi_1'` and their derivatives.
    """
    near = np.abs(z) < _NEAR
    if near.all():
        return tuple((np.exp(np.multiply.outer(z, _T)) @ _MOMENTS).T)
    far, turn = np.where(near, _NEAR, z), np.where(near, 0.0, rest)
    end, mean = np.exp(far) * np.exp(turn), phi_1(far, turn)
    late, early = (mean - 1.0) / far, (end - mean) / far
    by_quotients = late, early, (early - late) / far, (end - 2.0 * early) / far
    by_points = (np.exp(np.multiply.outer(np.where(near, z, 0.0), _T)) @ _MOMENTS).T
    return tuple(np.where(near, summed, divided) for summed, divided in zip(by_points, by_quotients, strict=True))


# --- back to continuous time: the inverse of each discretisation, pole by pole ------------------------------------


def sampling_rule(sys: LinearSystem, method: Discretisation | None, intersample: Interpolation) -> Hold:
    """Check how a discrete-time system was sampled."""
    if method is None:
        raise NotLosslessError(
            [
                f"the system is discrete-time (dt = {sys.dt}), expected continuous time; pass the method by which it "
                "was sampled: ph(sys, method='exact'), 'midpoint' or 'euler'"
            ]
        )
    check_method(method)
    _checks.choice("intersample", intersample, INTERPOLATIONS)
    if isinstance(sys.dt, bool):
        raise StructureError(f"dt of the system is {sys.dt}; a sampling step in seconds is needed to go back")
    hold = Hold(_checks.sampling_step(sys.dt), method, intersample)
    if method == "euler":
        hold._check_interpolation()
    return hold


@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def continuous(form: PoleResidueForm, hold: Hold) -> PoleResidueForm:
    """Poles and residues in continuous time of a system that was sampled by a rule, with their errors."""
    keep, h = _inside(form, hold.method), hold.h
    z = form.poles[keep]
    s = hold.pole(z)
    rate = 1 / np.abs(z * hold.log_derivative(s))
    now, then = hold.weights(s)
    factor = now + z * then
    residues = form.residues[keep] / factor[:, None, None]
    size = 1 / np.abs(factor)
    pole_error = form.pole_error[keep] * rate
    # the factor moves with the pole
    residue_error = form.residue_error[keep] * size + h * pole_error * np.abs(residues).max(axis=(1, 2), initial=0.0)
    through = np.sum(residues * then[:, None, None], axis=0).real
    feedthrough = form.feedthrough - through
    rounding = SAFETY * (float(np.sum(residue_error * np.abs(then))) + _checks.EPS * float(np.abs(through).sum()))
    if np.max(np.abs(feedthrough), initial=0.0) <= rounding:
        feedthrough = np.zeros_like(feedthrough)
    growth, growth_error = (part[keep] * rate * size for part in (form.growth, form.growth_error))
    gain = form.gain / h
    return PoleResidueForm(
        s, residues, pole_error, residue_error, growth, growth_error, gain, feedthrough, feedthrough_error=rounding
    )


def _inside(form: PoleResidueForm, method: str) -> Mask:
    """Which poles come from a pole in continuous time; the others must not be seen."""
    z = form.poles
    radius = SAFETY * form.pole_error
    lost = np.zeros(z.shape, bool)
    if method == "exact":
        lost |= (np.abs(z) <= radius) | ((z.real < 0) & (np.abs(z.imag) <= radius))
    if method == "midpoint":
        lost |= np.abs(z + 1) <= radius
    seen = np.abs(form.residues).max(axis=(1, 2), initial=0.0) > SAFETY * form.residue_error
    offending = z[lost & seen]
    if offending.size:
        raise NotLosslessError(
            [
                f"pole {p.real:.6g}{p.imag:+.6g}i of the sampled system comes from no frequency below that of Nyquist: "
                "with method='" + method + "' these lie on the unit circle, apart from -1"
                for p in offending
            ]
        )
    return ~lost
