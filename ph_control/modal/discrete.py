"""From a sampled lossless system back to continuous time: the inverse of each discretisation, pole by pole.

A rule of stepping maps a pole `s` to `lambda` and multiplies its residue by a factor; both are inverted here.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .. import _checks
from .._types import Mask
from ..exceptions import NotLosslessError, StructureError
from ..numerics.pole_residue import SAFETY, PoleResidueForm
from .discretization import INTERSAMPLE, Hold, check_method


def sampling_rule(sys: Any, method: str | None, intersample: str) -> Hold:
    """How a discrete-time system was sampled, or why they do not tell the continuous one."""
    if method is None:
        raise NotLosslessError(
            [
                f"the system is discrete-time (dt = {sys.dt}), expected continuous time; pass the method by which it "
                "was sampled: ph(sys, method='exact'), 'midpoint' or 'euler'"
            ]
        )
    check_method(method)
    _checks.choice("intersample", intersample, INTERSAMPLE)
    if method == "euler" and intersample == "foh":
        raise StructureError("method='euler' uses the input at the start of each step only; intersample must be 'zoh'")
    if isinstance(sys.dt, bool):
        raise StructureError(f"dt of the system is {sys.dt}; a sampling step in seconds is needed to go back")
    return Hold(_checks.sampling_step(sys.dt), method, intersample)


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
    return PoleResidueForm(s, residues, pole_error, residue_error, growth, growth_error, gain, feedthrough)


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
