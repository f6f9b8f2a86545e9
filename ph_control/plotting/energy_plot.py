"""Pictures of energy: stored along a response and supplied to it, and where over frequency a system takes it in."""

from __future__ import annotations

from collections.abc import Sequence

import control as ct

from .. import _checks
from .._types import Unpack
from .._units import rate, unit_for
from ..analysis.energy import EnergyBalance
from ..analysis.passivity import PassivityReport
from ..exceptions import StructureError
from .inputs import as_list
from .style import ZERO, AxesGiven, LineStyle, Look, extremes, labelled, picture, plain

_REACH = 30.0  # times the first and the last frequency of interest
_LEVELS = {
    "immittance": ("Smallest eigenvalue\nof (G + G$^H$)/2", 0.0), "scattering": ("Largest singular value of S", 1.0)
}  # fmt: skip


def energy_plot(
    balance: EnergyBalance | Sequence[EnergyBalance],
    *,
    time_unit: str | None = None,
    energy_unit: str | None = None,
    label: str | Sequence[str] | None = None,
    ax: AxesGiven = None,
    **style: Unpack[LineStyle],
) -> ct.ControlPlot:
    r"""Energy stored along a response and supplied to it, and the difference below.

    Parameters
    ----------
    balance : EnergyBalance, or list of them
        What `energy_balance` gives.
    time_unit, energy_unit : str, optional
        Units, for the labels; by default of time that of the response, none where it is not known.
    label : str or sequence of str, optional
        Names of the balances for the legend, if there are several.
    ax : array of matplotlib.axes.Axes, shape (2, 1), optional
        Axes to draw on.  By default a new figure.
    **style
        `title`, `grid`, `show_legend`, `legend_loc`, `rcParams` and, for the curves, `color`, `linestyle`, `linewidth`,
        as in `control.time_response_plot`.

    Returns
    -------
    control.ControlPlot
        `lines` and `axes` of shape (2, 1), `figure`, `legend`.  Above, for each balance the stored and the supplied
        energy, and the dissipated one of a system with losses; below what was stored and lost since the first instant
        less what was supplied.

    Raises
    ------
    StructureError
        If `balance` is not an `EnergyBalance`, or the labels are not one for each.

    Notes
    -----
    The difference has a scale of its own: for an exact response it is rounding, a part in 1e-15 of the energy.  Long
    records are drawn by the extremes of short bins, which gives the same picture.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> import matplotlib.pyplot as plt
    >>> sys, t = phc.frenkel_kontorova(), np.linspace(0.0, 30.0, 601)
    >>> plot = phc.energy_plot(phc.energy_balance(phc.forced_response(sys, t, np.sin(t)), sys))
    >>> [axis.get_ylabel() for axis in plot.axes[:, 0]]
    ['Energy', 'Stored less\nsupplied']
    >>> plt.close(plot.figure)
    """
    balances = as_list(balance, "balances")
    for energies in balances:
        if not isinstance(energies, EnergyBalance):
            raise StructureError(f"this is a {type(energies).__name__}; pass what energy_balance(response, sys) gives")
    names = _checks.labels([""] * len(balances) if label is None else label, len(balances), "balances")
    look = Look.of(style)
    with look.context():
        drawn = picture(look, ax, (2, 1), (6.4, 4.6), sharex=True, height_ratios=[2.0, 1.0])
        above, below = drawn.axes[:, 0]
        drawn.lines[:, 0] = [[], []]
        for k, (energies, name) in enumerate(zip(balances, names, strict=True)):
            stored, supplied = {"color": f"C{2 * k}"}, {"color": f"C{2 * k + 1}", "linestyle": "--"}
            prefix = f"{name}: " if name else ""
            lost = {"color": f"C{2 * k + 1}", "linestyle": ":", "linewidth": 1.4}
            dissipated = (above, energies.dissipated, f"{prefix}dissipated since the start", lost)
            for axis, energy, text, line in (
                (above, energies.stored, f"{prefix}stored", {**stored, "linewidth": 1.4}),
                (above, energies.supplied, f"{prefix}supplied since the start", {**supplied, "linewidth": 1.4}),
                *[dissipated] * bool(energies.dissipated.any()),
                (below, energies.defect, name, {**stored, "linewidth": 1.0}),
            ):
                curves = axis.plot(*extremes(energies.time, energy), label=plain(text), **{**line, **look.line})
                drawn.lines[int(axis is below), 0] += curves
        for axis in (above, below):
            axis.axhline(0.0, **ZERO)
            axis.set_xlim(min(each.time[0] for each in balances), max(each.time[-1] for each in balances))
            look.lattice(axis)
        above.set_ylabel(labelled("Energy", energy_unit))
        lossy = any(energies.dissipated.any() for energies in balances)
        time = labelled("Time", unit_for(time_unit, balances))
        rest = "Stored + lost\nless supplied" if lossy else "Stored less\nsupplied"
        below.set(xlabel=time, ylabel=labelled(rest, energy_unit))
        return drawn.finished("Energy balance")


def passivity_plot(report: PassivityReport, *, ax: AxesGiven = None, **style: Unpack[LineStyle]) -> ct.ControlPlot:
    """Smallest eigenvalue of `(G + G^H) / 2`, or largest singular value of `S`, with the active bands shaded.

    Parameters
    ----------
    report : PassivityReport
        What `passivity` gives.
    ax : array of matplotlib.axes.Axes, shape (1, 1), optional
        Axes to draw on.  By default a new figure.
    **style
        `title`, `grid`, `show_legend`, `legend_loc`, `rcParams` and, for the curve, `color`, `linestyle`, `linewidth`.

    Returns
    -------
    control.ControlPlot
        `lines` and `axes` of shape (1, 1), `figure`.

    Raises
    ------
    StructureError
        If `report` is not a `PassivityReport`, or the system is unstable.

    Notes
    -----
    Some thousand frequencies, dense at resonances: O(n) each.  The part of poles on the axis, which adds nothing beside
    them, is left out.

    Examples
    --------
    >>> import control as ct, ph_control as phc
    >>> import matplotlib.pyplot as plt
    >>> plot = phc.passivity(ct.tf([1.0, 1.0], [1.0, 0.2, 1.0])).plot()
    >>> plot.axes[0, 0].get_xlabel()
    'Frequency [rad/time]'
    >>> plt.close(plot.figure)
    """
    if not isinstance(report, PassivityReport):
        raise StructureError(f"this is a {type(report).__name__}; pass what passivity(sys) gives")
    look = Look.of(style)
    name, bound = _LEVELS[report.kind]
    omega, values = report.curve(_REACH)
    with look.context():
        drawn = picture(look, ax, (1, 1), (6.4, 3.2))
        axis = drawn.axes[0, 0]
        drawn.lines[0, 0] = axis.semilogx(omega, values, **{"linewidth": 1.4, **look.line})
        axis.axhline(bound, **ZERO)
        for low, high in report.bands:
            axis.axvspan(max(low, omega[0]), min(high, omega[-1]), color="C3", alpha=0.15, linewidth=0)
        axis.set_xlim(omega[0], omega[-1])
        axis.set_xlabel(labelled("Frequency", rate(report.time_unit)))
        axis.set_ylabel(name)
        look.lattice(axis)
        return drawn.finished(str(report).splitlines()[0].capitalize())
