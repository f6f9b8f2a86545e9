"""Stability margins: exact for lossless loops, those of python-control for all others.

A lossless loop `L(i w) = i X(w)` stays on the imaginary axis, so it never meets the negative real one: no gain brings
unity negative feedback to the limit of stability.  Its reactance `X` rises from every pole to the next, so it takes the
values 1 and -1 once each between two poles, where the phase is +90 and -90 degrees.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from typing import Any, Literal, TypeAlias, get_args, overload

import control as ct
import numpy as np

from .. import _checks
from .._types import Array, ArrayLike
from ..exceptions import PHControlError, StructureError
from ..modal.modal_form import ModalForm
from ..numerics.rational import transfer_function
from ..systems.affine import AffineHamiltonian
from ..systems.base import Convertible, in_normal_form
from ..systems.port_hamiltonian import PortHamiltonian, ph

Loop: TypeAlias = Convertible | ct.FrequencyResponseData | Sequence[ArrayLike]
Method = Literal["best", "poly", "frd"]
Margins = tuple[float, float, float, float, float, float]
AllMargins = tuple[Array, Array, Array, Array, Array, Array]


def margin(*args: Loop | ArrayLike) -> tuple[float, float, float, float]:
    """Gain and phase margin of a loop, and where they are.

    Parameters
    ----------
    *args
        A system of one port, `margin(sys)`, or a frequency response, `margin(mag, phase, omega)`, as for
        `control.margin`.

    Returns
    -------
    gm, pm : float
        Gain margin, and phase margin in degrees.
    wcg, wcp : float
        Frequencies that go with them, rad per unit time; NaN for a margin that is infinite.

    Raises
    ------
    StructureError
        If the arguments are not of this form, or a coefficient is not finite; a ValueError.

    See Also
    --------
    stability_margins : with the distance from -1, and with all crossings.

    Notes
    -----
    Cost and accuracy as `stability_margins`.

    Examples
    --------
    >>> import ph_control as phc
    >>> gm, pm, wcg, wcp = phc.margin(phc.ph(phc.modes(1.0, 1.0)))
    >>> gm, pm, wcg, round(wcp, 6)
    (inf, 90.0, nan, 1.618034)
    """
    gm, pm, _, wpc, wgc, _ = stability_margins(args[0] if len(args) == 1 else args)
    return gm, pm, wpc, wgc


@overload
def stability_margins(
    sysdata: Loop, returnall: Literal[False] = ..., epsw: float = ..., method: Method = ...
) -> Margins: ...
@overload
def stability_margins(
    sysdata: Loop, returnall: Literal[True], epsw: float = ..., method: Method = ...
) -> AllMargins: ...
def stability_margins(
    sysdata: Loop, returnall: bool = False, epsw: float = 0.0, method: Method = "best"
) -> Margins | AllMargins:
    """Margins of a loop under unity negative feedback, infinite where no change of gain or phase is too much.

    Parameters
    ----------
    sysdata : system, or (mag, phase, omega)
        Loop transfer function of one port, or its frequency response, as for `control.stability_margins`.
    returnall : bool
        All crossings as arrays instead of the least margins.
    epsw : float
        Frequencies up to this one are not returned.
    method : {'best', 'poly', 'frd'}
        'best' is exact for lossless loops; the others are those of python-control for all.

    Returns
    -------
    gm, pm, sm : float, or ndarray of shapes (K,), (L,), (M,) with `returnall`
        Gain margin, phase margin in degrees, and least distance of the Nyquist plot from -1.
    wpc, wgc, wms : float, or ndarray of shapes (K,), (L,), (M,) with `returnall`
        Frequencies of each, rad per unit time; NaN for a margin that is infinite.

    Raises
    ------
    StructureError
        If the arguments are not of this form, or a coefficient is not finite; a ValueError.

    See Also
    --------
    margin

    Notes
    -----
    A loop is taken as lossless if it is a `PortHamiltonian`, `ControllableHamiltonian`, `ObservableHamiltonian`,
    `ModalForm`, or any continuous-time system of which `ph` makes one.  Then the gain margin is infinite and the
    distance from -1 is 1, at each zero of the loop; without a positive zero, at 0 or at infinity, where it is
    approached.  The gain crossings are right to n roundings, with 90 degrees to spare on either side: -90, as
    python-control counts it, where the phase is +90.  The phase margin returned alone is the +90 at the lowest
    frequency that has it.  Loops of several ports are left to python-control, which refuses them.

    O(n^2) for the crossings, O(n^3) for the zeros.

    Examples
    --------
    >>> import ph_control as phc
    >>> gm, pm, sm, wpc, wgc, wms = phc.stability_margins(phc.frenkel_kontorova())
    >>> gm, pm, sm
    (inf, 90.0, 1.0)
    >>> gm, pm, sm, wpc, wgc, wms = phc.stability_margins(phc.frenkel_kontorova(), returnall=True)
    >>> gm, pm, sm, wms.round(6)
    (array([], dtype=float64), array([-90.,  90., -90.,  90.]), array([1.]), array([1.]))
    """
    _checks.flags(returnall=returnall)
    epsw = float(_checks.real_array("epsw", epsw, 0))
    _checks.choice("method", method, get_args(Method))
    loop = _lossless(sysdata) if method == "best" else None
    if loop is None:
        return _quietly(ct.stability_margins, sysdata, returnall=returnall, epsw=epsw, method=method)
    margins = _all_margins(loop, epsw)
    return margins if returnall else _least(*margins)


def _polynomials(loop: Any) -> Any:
    """Transfer function of a state space of one port; anything else as it is."""
    return transfer_function(loop) if isinstance(loop, ct.StateSpace) and loop.issiso() else loop


def _lossless(loop: Any) -> ModalForm | None:
    """Minimal modal form of a lossless loop of one port; None for what python-control is to judge."""
    if isinstance(loop, ModalForm):
        return loop.minimal() if loop.nports == 1 else None
    lti = isinstance(loop, ct.StateSpace | ct.TransferFunction)
    # that of an affine system is not the loop, but its derivative
    if not lti or not loop.issiso() or loop.isdtime(strict=True) or isinstance(loop, AffineHamiltonian):
        return None
    if isinstance(loop, PortHamiltonian) and not in_normal_form(loop):
        return None
    try:
        system = loop if isinstance(loop, PortHamiltonian) else ph(loop, lossless=True)
    except PHControlError:
        return None
    return system.modes.minimal()


def _quietly(ask: Callable[..., Any], *loop: Any, **options: object) -> Any:
    """Answer of python-control, which prints what it raises, and looks for the roots of infinity without end."""
    try:
        for part in loop:
            _refuse_infinite(part)
        with redirect_stdout(None), np.errstate(all="ignore"):
            return ask(*map(_polynomials, loop), **options)
    except StructureError:
        raise
    except (ValueError, TypeError, ArithmeticError, LookupError) as error:
        given = ", ".join(map(_checks.type_of, loop))
        raise StructureError(f"python-control has no margins of this loop ({given}): {error}") from None


def _refuse_infinite(part: Any) -> None:
    """Refuse a loop, or a response, with numbers that are not finite."""
    if isinstance(part, ct.StateSpace):
        numbers = [part.A, part.B, part.C, part.D]
    elif isinstance(part, ct.TransferFunction):
        numbers = [array for table in (part.num_list, part.den_list) for row in table for array in row]
    else:
        numbers = [part.frdata if isinstance(part, ct.FrequencyResponseData) else part]
    for array in map(np.asarray, numbers):
        if array.dtype.kind in "fc":
            _checks.finite("a number of the loop", array)


def _all_margins(loop: ModalForm, epsw: float) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Every margin with its frequency, in the order of `control.stability_margins`."""
    none = np.zeros(0)
    wgc, pm = gain_crossings(loop)
    zeros = loop.zeros.imag
    wms = zeros[zeros > max(epsw, 0.0)]
    if not len(wms):
        # the infimum is that of the ends of the axis
        wms = np.array([np.inf if len(loop.rigid) or epsw > 0 else 0.0])
    kept = wgc > epsw
    return none, pm[kept], np.ones(len(wms)), none, wgc[kept], wms


def _least(
    gm: Array, pm: Array, sm: Array, wpc: Array, wgc: Array, wms: Array
) -> tuple[float, float, float, float, float, float]:
    """Least margins of a lossless loop; where all have the same size, that of a phase of -90 degrees."""
    inside = np.flatnonzero(pm > 0)
    least, crossing = (float(pm[inside[0]]), float(wgc[inside[0]])) if len(inside) else (np.inf, np.nan)
    return np.inf, least, float(sm[0]), np.nan, crossing, float(wms[0])


def gain_crossings(loop: ModalForm) -> tuple[Array, Array]:
    """Frequencies where a lossless loop has gain 1, and the phase margin there in degrees.

    Parameters
    ----------
    loop : ModalForm
        Minimal, of one port.

    Returns
    -------
    omega : ndarray, shape (2n,), or (2n + 1,) with a pole at 0
        Ascending.
    pm : ndarray, shape of `omega`
        90 where the phase is -90 degrees, -90 where it is +90.

    Notes
    -----
    Bisection of the doubles between two poles, at most 64 steps whatever the scale; O(n) a step and crossing.

    Examples
    --------
    >>> import ph_control as phc
    >>> from ph_control.analysis.margins import gain_crossings
    >>> gain_crossings(phc.modes(1.0, 1.0))
    (array([0.61803399, 1.61803399]), array([-90.,  90.]))
    """
    d, rigid = loop.d, len(loop.rigid) > 0
    if not len(d) and not rigid:
        return np.zeros(0), np.zeros(0)
    # beyond the last pole the gain is at most 1 from this distance on
    end = d.max(initial=0.0) + float(loop.kappa.sum() + loop.kappa_0)
    edges = np.concatenate([[0.0], d, [np.nextafter(end, np.inf)]])
    low, high = edges[:-1], edges[1:]
    # from -infinity above a pole, or 0, to infinity below the next, or 0 at the end
    up, down = slice(0, -1), slice(0 if rigid else 1, None)
    low, high = np.concatenate([low[up], low[down]]), np.concatenate([high[up], high[down]])
    level = np.concatenate([np.ones(len(d)), -np.ones(len(low) - len(d))])
    omega = _where_reactance_is(loop, level, low, high)
    order = np.argsort(omega, kind="stable")
    return omega[order], -90.0 * level[order]


def _where_reactance_is(loop: ModalForm, level: Array, low: Array, high: Array) -> Array:
    """Double next to where the rising reactance takes each level, between two poles each."""
    # positive doubles are in the order of their bits
    below, above = low.view(np.int64), high.view(np.int64)
    while (above - below > 1).any():
        middle = below + (above - below) // 2
        rising = _reactance(loop, middle.view(float)) < level
        below, above = np.where(rising, middle, below), np.where(rising, above, np.maximum(middle, below + 1))
    ends = np.stack([below.view(float), above.view(float)])
    error = np.abs([_reactance(loop, end) - level for end in ends])
    omega: Array = np.where(error[0] <= error[1], ends[0], ends[1])
    return omega


def _reactance(loop: ModalForm, omega: Array) -> Array:
    """`L(i omega)/i`; infinite at a pole.

    Terms may cancel, by which a crossing moves no further than by the rounding of its terms: where they are large, the
    reactance rises as steeply.
    """
    w = omega[:, None]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        value = np.sum(loop.kappa * (w / (loop.d + w)) / (loop.d - w), axis=1)
        if len(loop.rigid):
            value = value - loop.kappa_0 / omega
    return np.where(np.isfinite(value), value, np.inf)
