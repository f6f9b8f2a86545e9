"""Picture of a loop over its gain: damping of each mode, and where the poles go in frequency and damping."""

from __future__ import annotations

from collections.abc import Sequence

import control as ct
import numpy as np
from matplotlib.axes import Axes
from scipy.optimize import linear_sum_assignment

from .. import _checks
from .._types import Array, ArrayLike, ComplexArray, Unpack
from .._units import unit_for
from ..controllers.damping_injection import damping_injection, feedback, plant
from ..exceptions import StructureError
from ..systems.port_hamiltonian import PortHamiltonian
from .inputs import subjects_of, title_of
from .style import AxesGiven, LineStyle, Look, frequency_axis, labelled, picture, plain_log_labels

_FACTORS = np.geomspace(1e-2, 1e2, 161)
_NAMED = 10  # modes that a legend names
_WIDE = 10.0  # ratio of natural frequencies beyond which their axis is logarithmic
_START: dict[str, object] = {"linestyle": "none", "marker": "x", "markersize": 6.0, "zorder": 3, "clip_on": False}
_CHOSEN: dict[str, object] = {"linestyle": "none", "marker": "o", "markersize": 5.0, "zorder": 4, "clip_on": False}


def damping_plot(
    sys: PortHamiltonian,
    controller: PortHamiltonian | ArrayLike,
    *,
    ports: Sequence[int | str] | None = None,
    factors: ArrayLike | None = None,
    Hz: bool = False,
    time_unit: str | None = None,
    ax: AxesGiven = None,
    **style: Unpack[LineStyle],
) -> ct.ControlPlot:
    """Damping of the modes of a loop over the strength of its controller, and the locus of its poles.

    Parameters
    ----------
    sys : PortHamiltonian
        The plant.
    controller : PortHamiltonian, float, or array_like of shape (k,) or (k, k)
        What is joined to its ports, as for `damping_injection`.
    ports : sequence of int or str, optional
        Ports of the plant, as for `damping_injection`.
    factors : array_like, shape (N,), optional
        What the controller is multiplied by, positive and ascending; of a tuned mass damper mass, stiffness and
        dashpot together.  Default: 0.01 to 100.
    Hz : bool
        Frequencies in Hz instead of rad per unit time.
    time_unit : str, optional
        Unit of time, for the labels; by default that of the plant, none where it is not known.
    ax : array of matplotlib.axes.Axes, shape (1, 2), optional
        Axes to draw on.  By default a new figure.
    **style
        `title`, `grid`, `show_legend`, `legend_loc`, `rcParams` and, for the curves, `color`, `linestyle`, `linewidth`,
        as in `control.root_locus_plot`.

    Returns
    -------
    control.ControlPlot
        `lines` and `axes` of shape (1, 2), `figure`, `legend`.  Left, the damping ratio of each mode over the factor;
        right, its damping ratio over its natural frequency, a cross at the least factor, a dot at 1.

    Raises
    ------
    StructureError
        If the controller gives energy or does not fit the ports, or a factor is not positive.

    Notes
    -----
    Modes are followed from factor to factor by the nearest pole.  What oscillates nowhere is left out, and a mode that
    ceases to oscillate runs at 100 %: of its two real poles one is followed.

    Examples
    --------
    >>> import ph_control as phc
    >>> import matplotlib.pyplot as plt
    >>> plot = phc.damping_plot(phc.spring_chain([1.0, 1.0], [2.0], ground=1.0), 1.0)
    >>> [axis.get_xlabel() for axis in plot.axes[0]]
    ['Factor of the controller', 'Natural frequency [rad/time]']
    >>> plt.close(plot.figure)
    """
    plant(sys)
    gain, _ = feedback(sys, controller, ports)
    scale = _FACTORS if factors is None else _checks.real_array("the factors", factors, 1)
    if not len(scale) or np.any(scale <= 0) or np.any(np.diff(scale) <= 0):
        raise StructureError("the factors must be positive and ascend, at least one of them")
    unit, unit_name = frequency_axis(Hz, unit_for(time_unit, sys))
    first, at_one, paths = _loci(sys, gain, ports, scale)
    moving = np.flatnonzero((paths.imag > 0).any(axis=0))
    moving = moving[np.argsort(np.abs(first[moving]))]
    look = Look.of(style)
    with look.context():
        drawn = picture(look, ax, (1, 2), (9.0, 3.8))
        ratio_axis, right = drawn.axes[0]
        drawn.lines[0, :] = [[], []]
        for k, column in enumerate(moving):
            p = np.where((paths[:, column].imag >= 0) & (paths[:, column] != 0), paths[:, column], np.nan)
            size, zeta = np.abs(p) / unit, -100 * p.real / np.abs(p)
            line = {**look.curve(k), "label": f"mode {k + 1}" if len(moving) <= _NAMED else None}
            drawn.lines[0, 0] += ratio_axis.semilogx(scale, zeta, **line)
            drawn.lines[0, 1] += right.plot(*_up_to_critical(size, zeta), **{**line, "label": None})
            color = drawn.lines[0, 1][-1].get_color()
            for pole, mark in ((first[column], _START), (at_one[column], _CHOSEN)):
                if pole.imag > 0:
                    right.plot(abs(pole) / unit, -100 * pole.real / abs(pole), color=color, **mark)
        ratio_axis.axvline(1.0, color="0.5", linewidth=0.8, linestyle="--")
        ratio_axis.set(xlabel="Factor of the controller", ylabel="Damping ratio [%]", ylim=(0, None))
        right.set(xlabel=labelled("Natural frequency", unit_name), ylabel="Damping ratio [%]", ylim=(0, None))
        _frequency_range(right, np.abs(paths[paths.imag > 0]) / unit)
        for factor, mark in ((scale[0], _START), (1.0, _CHOSEN)):
            right.plot([], [], color="0.4", label=f"factor {factor:g}", **mark | {"clip_on": True})
        for axis in (ratio_axis, right):
            look.lattice(axis)
        look.legend(right)
        title = title_of("Damping", subjects_of(sys, None), False)
        return drawn.finished(f"{title} over the gain", look.legend(ratio_axis))


def _up_to_critical(size: Array, zeta: Array) -> tuple[Array, Array]:
    """Frequencies and damping ratios with a point of 100 % where a mode ceases to oscillate, or begins to."""
    real = zeta == 100
    ends = np.flatnonzero(real[1:] != real[:-1]) + 1
    last = np.where(real[ends], size[ends - 1], size[ends])  # where it still oscillates
    return np.insert(size, ends, last), np.insert(zeta, ends, 100.0)


def _frequency_range(axis: Axes, sizes: Array) -> None:
    """Ends of the axis about all that oscillates, beyond a decade of it on a logarithmic scale."""
    low, high = float(sizes.min(initial=np.inf)), float(sizes.max(initial=0.0))
    if high > _WIDE * low > 0:
        axis.set_xscale("log")
        axis.set_xlim(low / 1.25, 1.25 * high)
        plain_log_labels(axis)
    else:
        axis.set_xlim(0, 1.05 * high or None)


def _loci(
    sys: PortHamiltonian, gain: ArrayLike, ports: Sequence[int | str] | None, scale: Array
) -> tuple[Array, Array, ComplexArray]:
    """Poles at the least factor, at 1, and at all, (N, poles), each column one pole that moves."""
    every = np.union1d(scale, [1.0])
    rows = [damping_injection(sys, factor * gain, ports=ports).poles() for factor in every]
    for k in range(1, len(rows)):
        distance = np.abs(rows[k - 1][:, None] - rows[k])
        rows[k] = rows[k][linear_sum_assignment(distance)[1]]
    paths = _upper_together(np.array(rows))
    return paths[0], paths[np.searchsorted(every, 1.0)], paths[np.isin(every, scale)]


def _upper_together(paths: ComplexArray) -> ComplexArray:
    """Exchange conjugates from where a pair oscillates again, so that its upper pole stays in one column."""
    upper = np.zeros(paths.shape[1])
    for k, row in enumerate(paths):
        for column in np.flatnonzero((row.imag < 0) & (upper > 0)):
            twin = int(np.argmin(np.abs(row - row[column].conj())))
            if upper[twin] <= 0:
                pair = np.array([column, twin])
                paths[k:, pair] = paths[k:, pair[::-1]]
        upper = np.where(paths[k].imag == 0, upper, np.sign(paths[k].imag))
    return paths
