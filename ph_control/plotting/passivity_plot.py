"""Picture of where a system takes in energy and where it gives energy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import control as ct

from ..analysis.passivity import PassivityReport
from ..exceptions import StructureError
from .style import ZERO, LineStyle, Look, labelled, picture

if TYPE_CHECKING:
    from typing_extensions import Unpack

_REACH = 30.0  # times the first and the last frequency of interest
_LEVELS = {
    "immittance": ("Smallest eigenvalue\nof (G + G$^H$)/2", 0.0), "scattering": ("Largest singular value of S", 1.0)
}  # fmt: skip


def passivity_plot(report: PassivityReport, *, ax: Any = None, **style: Unpack[LineStyle]) -> ct.ControlPlot:
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
        If `report` is none, or the system is unstable.

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
        axis.set_xlabel(labelled("Frequency", "rad/time"))
        axis.set_ylabel(name)
        look.lattice(axis)
        return drawn.finished(str(report).splitlines()[0].capitalize())
