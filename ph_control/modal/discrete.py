"""From a sampled lossless system back to continuous time: the inverse of each discretisation, pole by pole.

A rule of stepping maps a pole `s` to `lambda` and multiplies its residue by a factor; both are inverted here.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _checks
from ..exceptions import NotLosslessError, StructureError
from ..numerics.pole_residue import SAFETY, PoleResidueForm
from .propagation import INTERSAMPLE, METHODS, phi_functions

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


def sampling_rule(sys: Any, method: str | None, intersample: str) -> tuple[float, str, str]:
    """Step, method and hold of a discrete-time system, or why they do not tell the continuous one."""
    if method is None:
        raise NotLosslessError(
            [
                f"the system is discrete-time (dt = {sys.dt}), needed continuous time; pass the method by which it was "
                "sampled: ph(sys, method='exact'), 'midpoint' or 'euler'"
            ]
        )
    check_method(method)
    _checks.choice("intersample", intersample, INTERSAMPLE)
    if method == "euler" and intersample == "foh":
        raise StructureError("method='euler' uses the input at the start of each step only; intersample must be 'zoh'")
    if isinstance(sys.dt, bool):
        raise StructureError(f"dt of the system is {sys.dt}; a sampling step in seconds is needed to go back")
    return _checks.sampling_step(sys.dt), method, intersample


_OTHER_NAMES = {
    "tustin": ("midpoint", "foh"),
    "bilinear": ("midpoint", "foh"),
    "zoh": ("exact", "zoh"),
    "foh": ("exact", "foh"),
}


def check_method(method: Any) -> str:
    """Check the name of a rule of stepping; those of python-control are explained."""
    if isinstance(method, str) and method in _OTHER_NAMES:
        rule, hold = _OTHER_NAMES[method]
        raise StructureError(f"method is {method!r}; here that is method={rule!r} with intersample={hold!r}")
    return _checks.choice("method", method, METHODS)


@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def continuous(form: PoleResidueForm, h: float, method: str, intersample: str) -> PoleResidueForm:
    """Poles and residues in continuous time of a system that was sampled by a rule, with their errors."""
    keep = _inside(form, method)
    z = form.poles[keep]
    s: ComplexArray
    rate: Array
    if method == "exact":
        s, rate = np.asarray(np.log(z) / h, complex), 1 / (h * np.abs(z))
    elif method == "midpoint":
        s, rate = 2 / h * (z - 1) / (z + 1), 4 / h / np.abs(z + 1) ** 2
    else:
        s, rate = (z - 1) / h, np.full(z.shape, 1 / h)
    now, then = _input_factors(s, h, method, intersample)
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
    return PoleResidueForm(
        s,
        residues,
        pole_error,
        residue_error,
        form.growth[keep] * rate * size,
        form.growth_error[keep] * rate * size,
        form.gain / h,
        feedthrough,
    )


def _inside(form: PoleResidueForm, method: str) -> NDArray[np.bool_]:
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


def _input_factors(s: ComplexArray, h: float, method: str, intersample: str) -> tuple[ComplexArray, ComplexArray]:
    """What one step makes of the input at its start and at its end, as in `propagation.input_weights`."""
    if method == "euler":
        return np.full(s.shape, h, complex), np.zeros(s.shape, complex)
    if method == "midpoint":
        weight = h / (1 - 0.5 * h * s)
        return (weight, 0 * weight) if intersample == "zoh" else (0.5 * weight, 0.5 * weight)
    phi_1, phi_2 = phi_functions(h * s)
    return (h * phi_1, 0 * phi_1) if intersample == "zoh" else (h * (phi_1 - phi_2), h * phi_2)
