"""Modes of a test one by one: their shapes over the sensors, how shapes compare, and their circles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import control as ct
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike
from scipy.special import ndtri

from .. import _checks
from .._options import ResponseInterpolation
from .._types import Array, ComplexArray, Indices, Unpack
from .._units import DERIVATIVES, parted, unit_for
from ..exceptions import StructureError
from ..numerics.modal_assurance import aligned_shapes, mac, phase_collinearity
from .frf_plot import (
    MODEL_LINE,
    NARROWEST,
    ModelSource,
    chosen_channels,
    measured_by,
    model_source,
)
from .response_picture import Curve
from .style import (
    DOTS,
    ZERO,
    AxesGiven,
    FrameStyle,
    LineStyle,
    Look,
    frequency_axis,
    labelled,
    panels,
    picture,
    plain,
    told_gain_units,
)

Direction = Literal["x", "y", "z", "-x", "-y", "-z"]

if TYPE_CHECKING:
    from matplotlib.artist import Artist

_MOST = 12  # modes of one picture
_IN_CELLS = 12  # modes of which a matrix has room for numbers
_COLLINEAR = 0.99  # beyond which the imaginary part of a shape is as thin as its line
_NAMED = 12  # sensors that an axis has room to name
_BUBBLE = 220.0  # area of the largest entry of a shape, in points squared
_VIEW = np.radians([-60.0, 25.0])  # azimuth and elevation from which positions in space are seen
_DISPLACED = 1 / 7  # largest displacement of a wire frame, of its size
_AT_NODE = 1e-6  # of that size within which a sensor is at a node
_CIRCLE = 4.0  # half widths of a resonance of which its circle is drawn


def shape_plot(
    shapes: Any,
    positions: ArrayLike | None = None,
    *,
    directions: Direction | Sequence[Any] | None = None,
    nodes: ArrayLike | None = None,
    lines: ArrayLike | None = None,
    modes: Sequence[int] | None = None,
    poles: ArrayLike | None = None,
    level: float = 0.95,
    time_unit: str | None = None,
    position_label: str | None = None,
    position_unit: str | None = None,
    shape_unit: str | None = None,
    ax: AxesGiven = None,
    **style: Unpack[LineStyle],
) -> ct.ControlPlot:
    """Mode shapes over the positions of the sensors, a panel for each mode.

    Parameters
    ----------
    shapes : PEMResult, ModalForm, or array_like, shape (n, p)
        Mode shapes, or what has them; a result is drawn with intervals.
    positions : array_like, shape (p,), (p, 2) or (p, 3), optional
        Where the sensors are, along a line, in a plane or in space; by default their numbers.
    directions : {'x', 'y', 'z', '-x', '-y', '-z'}, or sequence of p of these or of vectors, optional
        Which way each sensor points, with positions in a plane or in space: the structure is drawn as it moves.
    nodes : array_like, shape (k, 2) or (k, 3), optional
        Points of the wire frame, among them those with a sensor; by default the positions, each once.
    lines : array_like of int, shape (l, 2), optional
        Pairs of nodes, counted from 0, that the wire frame joins.
    modes : sequence of int, optional
        Which, counted from 0 by natural frequency; by default all, at most the first twelve.
    poles : array_like, shape (n,), optional
        Poles of the modes of an array, rad per unit time, for the titles.
    level : float
        Probability of the intervals of a result, between 0 and 1.
    time_unit : str, optional
        Unit of time, for the titles; by default that of the result.
    position_label, position_unit, shape_unit : str, optional
        Name and unit of the positions, unit of the shapes.
    ax : array of matplotlib.axes.Axes, optional
        Axes to draw on, one for each mode.  By default a new figure.
    **style
        `title`, `grid`, `show_legend`, `legend_loc`, `rcParams` and, for the shapes, `color`, `linestyle`, `linewidth`.

    Returns
    -------
    control.ControlPlot
        `lines` and `axes` with a panel for each mode, in rows of three; `figure`, `legend`.

    Raises
    ------
    StructureError
        If there are no shapes, positions or poles are not as many, there is no such mode, or the wire frame is not of
        this form.

    Notes
    -----
    Drawn is the real part of each shape, turned so that it is as large as can be, the largest entry positive.  The
    modal phase collinearity (MPC) `|c^T c|^2 / (c^H c)^2` says how much that leaves out: 1 if all sensors move in phase
    or opposed; below 0.99 the imaginary part is dotted.  Intervals are those of the real part, as if the errors of real
    and imaginary parts were independent.

    Of a result of one output and several inputs, as of a roving hammer, the shapes are those over the inputs, since a
    force moves the sensor as much as one at the sensor moves that place; there are no intervals.

    In a plane or in space the area of each mark is that of the entry squared, filled where it is positive and hollow
    where it is negative; there are no intervals.  With `directions` or `lines` the structure is drawn at rest and, over
    it, displaced by the shape, the largest displacement a seventh of its size.  A node without a sensor does not move.
    Sensors in a plane without directions move across it.  Of floors that move as a whole, and other nodes that follow
    sensors, pass the shapes of all nodes: `shapes @ T` for displacements `T` (p, k) of the nodes per output.

    Examples
    --------
    >>> import numpy as np, matplotlib.pyplot as plt, ph_control as phc
    >>> x = np.linspace(0, 1, 6)
    >>> plot = phc.shape_plot([np.sin(np.pi * x), np.sin(2 * np.pi * x)], x, poles=[-0.1 + 10j, -0.8 + 40j],
    ...                       position_label="Position", position_unit="m", time_unit="s")
    >>> [axis.get_title(loc="left") for axis in plot.axes.flat], plot.axes[0, 0].get_xlabel()
    (['1.592 Hz, 1.00 %', '6.367 Hz, 2.00 %'], 'Position [m]')
    >>> plt.close(plot.figure)
    """
    if not isinstance(position_label, str | None):
        raise StructureError(f"position_label is {_checks.shown(position_label)}; it must be a text")
    table = shape_table(shapes, poles=poles, level=level, time_unit=time_unit)
    chosen = chosen_channels("modes", modes, [f"mode {k}" for k in range(len(table.shapes))], _MOST)
    places = _places(positions, table.shapes.shape[1])
    look = Look.of(style)
    flat = places.shape[1] == 1
    frame = None if directions is nodes is lines is None else wire_frame(places, directions, nodes, lines)
    with look.context():
        drawn = panels(look, ax, len(chosen), (3.1, 2.3 if flat else 2.7 if frame is None else 3.3))
        for k, l in enumerate(chosen):
            axis = drawn.axes.flat[k]
            if flat:
                drawn.lines.flat[k] = _draw_along_line(axis, places[:, 0], table, int(l), look)
                axis.set(
                    xlabel=labelled(
                        position_label or (table.places if positions is None else "Position"), position_unit
                    )
                )
                axis.set_ylabel(labelled("Mode shape", shape_unit))
                if positions is None:
                    _name_sensors(axis, table.labels)
            elif frame is not None:
                drawn.lines.flat[k] = _draw_frame(axis, frame, table.shapes[l].real, look)
                if frame.nodes.shape[1] == 2:
                    axis.set(xlabel=labelled("x", position_unit), ylabel=labelled("y", position_unit))
            else:
                drawn.lines.flat[k] = _draw_in_plane(axis, places, table.shapes[l].real, look)
                if places.shape[1] == 2:
                    axis.set(xlabel=labelled("x", position_unit), ylabel=labelled("y", position_unit))
            axis.set_title(table.titles[l], loc="left")
            axis.set_title(f"MPC {table.collinearity[l]:.3f}", loc="right", fontsize="small", color="0.35")
        return drawn.finished("Mode shapes" + _share_of(chosen, len(table.shapes)), drawn.legend_of_all())


def mac_plot(
    shapes: Any,
    other: object = None,
    *,
    label: Sequence[str] | None = None,
    time_unit: str | None = None,
    ax: AxesGiven = None,
    **style: Unpack[FrameStyle],
) -> ct.ControlPlot:
    """Modal assurance criterion of all pairs of mode shapes, as a matrix of grey cells.

    Parameters
    ----------
    shapes, other : PEMResult, ModalForm, or array_like, shape (n, p)
        Mode shapes of the same outputs, or what has them; by default the first are compared with themselves.
    label : sequence of two str, optional
        What the shapes are called, for the axes.
    time_unit : str, optional
        Unit of time, for the axes; by default that of the results.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on.  By default a new figure.
    **style
        `title`, `grid`, `show_legend`, `legend_loc`, `rcParams`.

    Returns
    -------
    control.ControlPlot
        `lines` and `axes` of shape (1, 1); the lines are the image, whose array is the criterion; `figure`.

    Raises
    ------
    StructureError
        If there are no shapes, or not of the same number of outputs.

    Notes
    -----
    `|c^H c'|^2 / (|c|^2 |c'|^2)`: 1 for shapes that are a multiple of each other, 0 for orthogonal ones.  Up to twelve
    modes have their numbers in the cells.  With few sensors different shapes look alike.

    O(n n' p).

    Examples
    --------
    >>> import numpy as np, matplotlib.pyplot as plt, ph_control as phc
    >>> plot = phc.mac_plot([[1.0, 1.0], [1.0, 0.0]])
    >>> plot.lines[0, 0][0].get_array().data.round(3)
    array([[1. , 0.5],
           [0.5, 1. ]])
    >>> plt.close(plot.figure)
    """
    rows = shape_table(shapes, time_unit=time_unit)
    columns = rows if other is None else shape_table(other, time_unit=time_unit)
    values = mac(rows.shapes, columns.shapes)
    names = ["", ""] if label is None else _checks.labels(label, 2, "sets of shapes")
    look = Look.of(style, FrameStyle)
    n, k = values.shape
    side = float(np.clip(0.42 * max(n, k), 2.4, 7.0))
    with look.context():
        drawn = picture(look, ax, (1, 1), (1.9 + side * k / max(n, k), 1.2 + side * n / max(n, k)))
        axis = drawn.axes[0, 0]
        image = axis.imshow(values, cmap="Greys", vmin=0.0, vmax=1.0, aspect="equal", interpolation="nearest")
        drawn.lines[0, 0] = [image]
        axis.figure.colorbar(image, ax=axis, label="MAC", shrink=0.9)
        size = "small" if max(n, k) <= _IN_CELLS // 2 else "x-small"
        if max(n, k) <= _IN_CELLS:
            for (i, j), value in np.ndenumerate(values):
                colour = "white" if value > 0.55 else "black"
                axis.text(j, i, f"{value:.2f}", ha="center", va="center", fontsize=size, color=colour)
        for table, name, side_of in ((columns, names[1], axis.xaxis), (rows, names[0], axis.yaxis)):
            count = len(table.ticks)
            step = -(-count // 24)
            rotation = 90 if count > 6 and side_of is axis.xaxis else 0
            side_of.set_ticks(np.arange(0, count, step), table.ticks[::step], fontsize="small", rotation=rotation)
            side_of.set_label_text(labelled(f"Mode of {name}" if name else "Mode", table.unit_name))
        axis.grid(False)
        return drawn.finished("Modal assurance criterion")


def circle_plot(
    model: Any,
    data: object = None,
    *,
    modes: Sequence[int] | None = None,
    output: int | str | None = None,
    input: int | str | None = None,
    Hz: bool | None = None,
    segments: int = 8,
    intersample: ResponseInterpolation | None = None,
    time_unit: str | None = None,
    gain_unit: str | None = None,
    ax: AxesGiven = None,
    **style: Unpack[LineStyle],
) -> ct.ControlPlot:
    """Nyquist curves of the model near each resonance, with the measured points there.

    Parameters
    ----------
    model, data
        As in `frf_plot`.
    modes : sequence of int, optional
        Which, counted from 0 by natural frequency; by default all that are damped, at most the first twelve.
    output, input : int or str, optional
        Whose response to draw; by default of each mode that in which it counts most.
    Hz, segments, intersample, time_unit, gain_unit
        As in `frf_plot`.
    ax : array of matplotlib.axes.Axes, optional
        Axes to draw on, one for each mode.  By default a new figure.
    **style
        As in `frf_plot`.

    Returns
    -------
    control.ControlPlot
        `lines` and `axes` with a panel for each mode, in rows of three: curve, measured points, and a cross where the
        natural frequency is; `figure`, `legend`.

    Raises
    ------
    StructureError
        As `frf_plot`, or if the model has no such mode, or the mode has no damping, so that its circle is a line.

    Notes
    -----
    Each curve reaches over four half widths `|Re p|` on both sides of the resonance.  Beside the other modes that of a
    single one is a circle, of diameter `|rho / Re p|` for its residue `rho`.

    O((n + K) p m) for K frequencies.

    Examples
    --------
    >>> import numpy as np, matplotlib.pyplot as plt, ph_control as phc
    >>> mode = phc.modes([-0.1 + 10j], [[1.0]], [[0.2j]])
    >>> plot = phc.circle_plot(mode, time_unit="s")
    >>> plot.axes[0, 0].get_title(loc="left")
    '1.592 Hz, 1.00 %'
    >>> plt.close(plot.figure)
    """
    source = model_source(model)
    measured = measured_by(model, data, source, segments, intersample)
    unit, unit_name = frequency_axis(Hz, unit_for(time_unit, model, data))
    look = Look.of(style)
    circles = [mode_circle(source, measured, l, output, input) for l in _modes_to_draw(modes, source)]
    with look.context():
        drawn = panels(look, ax, len(circles), (3.0, 3.0))
        for k, circle in enumerate(circles):
            axis = drawn.axes.flat[k]
            drawn.lines.flat[k] = _draw_circle(axis, circle, look)
            size = circle.natural_frequency / unit
            axis.set_title(f"{size:.4g} {unit_name}, {100 * circle.damping_ratio:.2f} %", loc="left")
            if source.shape != (1, 1):
                name = plain(f"{circle.input_label} to {circle.output_label}")
                axis.text(0.03, 0.03, name, transform=axis.transAxes, fontsize="x-small", color="0.35")
            channels = [circle.output_label], [circle.input_label]
            unit_shown = told_gain_units(*channels)[0] if gain_unit is None else gain_unit
            axis.set(xlabel=labelled("Real part", unit_shown), ylabel=labelled("Imaginary part", unit_shown))
        return drawn.finished("Nyquist curve at each resonance", drawn.legend_of_all())


# --- numbers of shapes -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ShapeTable:
    """Mode shapes (n, p), turned to real parts as large as can be, half intervals of these, and what modes are called.

    Half intervals are NaN where no error is known.  `titles` have frequency and damping, `ticks` the frequency in
    `unit_name`, or numbers where there is none.
    """

    shapes: ComplexArray
    reach: Array
    collinearity: Array
    titles: list[str]
    ticks: list[str]
    unit_name: str | None
    labels: list[str] | None
    places: str
    interval: str


def shape_table(
    given: object, *, poles: ArrayLike | None = None, level: float = 0.95, time_unit: str | None = None
) -> ShapeTable:  # fmt: skip
    """Numbers of `shape_plot` and `mac_plot`: those of a result or a modal form, or an array and its poles."""
    _checks.level("level", level)
    source = getattr(given, "modes", given) if not hasattr(given, "shapes") else given
    shapes_given = getattr(source, "shapes", given)
    c, places, names = _checked_shapes(shapes_given), "Sensor", "output_labels"
    moved = over_inputs(given)
    if moved is not None:
        c, places, names = moved, "Input", "input_labels"
    unit = unit_for(time_unit, given)
    if poles is None:
        d, zeta = (getattr(source, name, None) for name in ("natural_frequencies", "damping_ratios"))
    else:
        p = _checks.complex_points("the poles", poles)
        _checks.finite("the list of poles", p)
        d, zeta = np.abs(p), -p.real / np.where(p == 0, 1.0, np.abs(p))
    if d is not None and len(d) != len(c):
        raise StructureError(f"there are {len(d)} poles for {len(c)} shapes; give one for each")
    shapes, turn = aligned_shapes(c)
    reach = np.full(c.shape, np.nan)
    errors = getattr(source, "stderr", {}).get("shapes") if hasattr(source, "stderr") else None
    if errors is not None and moved is None:
        errors = np.asarray(errors, complex)
        reach = float(ndtri(0.5 + 0.5 * level)) * np.hypot(turn.real * errors.real, turn.imag * errors.imag)
    numbers = [str(k + 1) for k in range(len(c))]
    titles, ticks, name = [f"Mode {number}" for number in numbers], numbers, None
    if d is not None:
        size, name = frequency_axis(None, unit)
        ticks = [f"{frequency / size:.4g}" for frequency in d]
        ratios = [""] * len(c) if zeta is None else [f", {100 * ratio:.2f} %" for ratio in zeta]
        titles = [f"{tick} {name}{ratio}" for tick, ratio in zip(ticks, ratios, strict=True)]
    labels = getattr(given, names, None)
    labels = list(labels) if labels is not None and len(labels) == c.shape[1] else None
    interval = f"{100 * level:g} % interval"
    return ShapeTable(shapes, reach, phase_collinearity(c), titles, ticks, name, labels, places, interval)


def over_inputs(given: Any) -> ComplexArray | None:
    """Shapes over the places of the forces (n, m), of a result of one output and several inputs."""
    quantities = getattr(given, "quantities", None)
    if quantities is None or len(quantities) > 1 or given.participation.shape[1] < 2:
        return None
    b, p = given.participation, given.poles[: len(given.participation)]
    return np.asarray(b * (2j * p.imag / p ** DERIVATIVES[quantities[0]])[:, None])


def _checked_shapes(given: object) -> ComplexArray:
    try:
        c = np.array(given, dtype=complex)
    except (TypeError, ValueError, OverflowError):
        raise StructureError(
            f"shapes are a {type(given).__name__}; pass a result, a modal form, or an array of shapes (modes, sensors)"
        ) from None
    if c.ndim != 2 or not c.size:
        raise StructureError(f"shapes have shape {c.shape}; expected (modes, sensors), one of each at least")
    _checks.finite("shapes", c)
    return c


def _places(positions: ArrayLike | None, sensors: int) -> Array:
    """Positions (p, 1), (p, 2) or (p, 3); by default the numbers of the sensors from 1 on."""
    if positions is None:
        return np.arange(1.0, sensors + 1.0)[:, None]
    places = _checks.real_array("positions", positions)
    places = places[:, None] if places.ndim == 1 else places
    if places.ndim != 2 or len(places) != sensors or not 1 <= places.shape[1] <= 3:
        raise StructureError(
            f"positions have shape {np.shape(positions)}; those of {sensors} sensors have ({sensors},), ({sensors}, 2) "
            f"or ({sensors}, 3)"
        )
    return places


def _share_of(chosen: Indices, count: int) -> str:
    return "" if len(chosen) == count else f" ({len(chosen)} of {count})"


# --- wire frames -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class WireFrame:
    """Nodes (k, 2) or (k, 3), pairs (l, 2) of them, and their displacements (k, 2 or 3, p) per unit of each sensor."""

    nodes: Array
    lines: Indices
    motion: Array

    @property
    def measured(self) -> Indices:
        """Nodes with a sensor."""
        return np.flatnonzero(np.any(self.motion, axis=(1, 2)))

    def displaced(self, shape: Array) -> Array:
        """Nodes where a shape takes them, the largest displacement a seventh of the size."""
        moved = self.motion @ shape
        largest = float(np.linalg.norm(moved, axis=1).max(initial=0.0))
        size = float(np.ptp(self.nodes, axis=0).max()) or 1.0
        return np.asarray(self.nodes + moved * (_DISPLACED * size / largest if largest else 0.0))


def wire_frame(places: Array, directions: Any, nodes: Any, lines: ArrayLike | None) -> WireFrame:
    """Wire frame of sensors at `places` (p, 2) or (p, 3)."""
    if places.shape[1] == 1:
        raise StructureError(
            "a wire frame needs positions in a plane or in space, of shape (sensors, 2) or (sensors, 3)"
        )
    # each once, in the order of the sensors
    first = np.sort(np.unique(places, axis=0, return_index=True)[1])
    points = places[first] if nodes is None else _checks.real_array("nodes", nodes, 2)
    if points.shape[1] != places.shape[1] or not len(points):
        raise StructureError(f"nodes have shape {points.shape}; with these positions they have (k, {places.shape[1]})")
    pairs = _checked_lines(lines, len(points))
    if places.shape[1] == 2 and directions is None:  # across the plane
        places, points = (np.column_stack([plane, np.zeros(len(plane))]) for plane in (places, points))
        directions = "z"
    ways = _checked_directions(directions, *places.shape)
    far = np.linalg.norm(places[:, None] - points, axis=2)
    nearest, size = far.argmin(axis=1), float(np.ptp(points, axis=0).max())
    lost = np.flatnonzero(far.min(axis=1) > _AT_NODE * size)
    if len(lost):
        raise StructureError(
            f"sensor {lost[0]}, counted from 0, at {places[lost[0]].tolist()} is at no node; the nearest is "
            f"{points[nearest[lost[0]]].tolist()}"
        )
    motion = np.zeros((*points.shape, len(places)))
    for node in np.unique(nearest):
        sensors = np.flatnonzero(nearest == node)
        # directions need not be orthogonal
        motion[node][:, sensors] = np.linalg.pinv(ways[sensors])
    return WireFrame(points, pairs, motion)


def _checked_lines(lines: Any, count: int) -> Indices:
    if lines is None:
        return np.zeros((0, 2), np.intp)
    pairs = _checks.real_array("lines", lines, 2)
    if pairs.shape[1] != 2 or (pairs != np.round(pairs)).any() or (pairs < 0).any() or (pairs >= count).any():
        raise StructureError(f"lines are {_checks.shown(pairs)}; give pairs of nodes, from 0 to {count - 1}")
    return pairs.astype(np.intp)


def _checked_directions(given: Any, sensors: int, dimensions: int) -> Array:
    """Unit vectors (p, d) of the sensors."""
    if given is None:
        raise StructureError("positions are in space; say with directions, such as 'x', which way the sensors point")
    listed = [given] * sensors if isinstance(given, str) else list(given)
    known = {sign + name: factor * row for name, row in zip("xyz"[:dimensions], np.eye(dimensions), strict=True)
             for sign, factor in (("", 1.0), ("+", 1.0), ("-", -1.0))}  # fmt: skip
    if len(listed) != sensors:
        raise StructureError(f"there are {len(listed)} directions for {sensors} sensors; give one for each")
    ways = np.zeros((sensors, dimensions))
    for k, way in enumerate(listed):
        if isinstance(way, str):
            ways[k] = known[_checks.choice("directions", way, tuple(known))]
            continue
        vector = _checks.real_array(f"direction {k}", way, 1)
        if len(vector) != dimensions or not np.any(vector):
            raise StructureError(f"direction {k} is {_checks.shown(way)}; give {dimensions} numbers, not all 0")
        ways[k] = vector / np.linalg.norm(vector)
    return ways


# --- numbers of a circle ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ModeCircle:
    """Response of one output to one input near a resonance: of the model, at its natural frequency, and measured."""

    natural_frequency: float
    damping_ratio: float
    response: ComplexArray
    at_resonance: complex
    measured: ComplexArray
    label: str
    output_label: str
    input_label: str


def mode_circle(
    source: ModelSource, measured: list[Curve], mode: int, output: int | str | None, input: int | str | None
) -> ModeCircle:
    """Numbers of one panel of `circle_plot`."""
    p = source.poles[mode]
    d, width = float(abs(p)), float(abs(p.real))
    if width <= NARROWEST * d:
        raise StructureError(
            f"mode {mode} has the damping ratio {width / d:.2g}; without damping its Nyquist curve is a line, not a "
            "circle"
        )
    turn = np.tan(np.linspace(-np.arctan(_CIRCLE), np.arctan(_CIRCLE), 181))
    omega = p.imag + width * turn
    omega = omega[(omega > 0) & (omega <= source.nyquist)]
    every = source.response(omega)
    i, j = _entry(every, output, input, source)
    near = [curve.response[i, j, np.abs(curve.omega - p.imag) <= _CIRCLE * width] for curve in measured]
    dots = np.concatenate([np.zeros(0, complex), *near])
    return ModeCircle(
        d, -float(p.real) / d, every[i, j], complex(source.response(np.array([p.imag]))[i, j, 0]),
        dots[np.isfinite(dots)], source.label, source.output_labels[i], source.input_labels[j],
    )  # fmt: skip


def _entry(
    every: ComplexArray, output: int | str | None, input: int | str | None, source: ModelSource
) -> tuple[int, int]:
    """Output and input of the widest curve near a resonance, beside what is asked for."""
    rows = chosen_channels("output", output, source.output_labels)
    columns = chosen_channels("input", input, source.input_labels)
    reach = np.abs(every - every.mean(axis=2, keepdims=True)).max(axis=2)[np.ix_(rows, columns)]
    i, j = np.unravel_index(int(reach.argmax()), reach.shape)
    return int(rows[i]), int(columns[j])


def _modes_to_draw(given: object, source: ModelSource) -> Indices:
    """Numbers of the modes: those asked for, or the first twelve that are damped and oscillate."""
    p = source.poles
    if given is not None:
        return chosen_channels("modes", given, [f"mode {k}" for k in range(len(p))])
    modes = np.flatnonzero((p.imag > 0) & (np.abs(p.real) > NARROWEST * np.abs(p)))[:12]
    if not len(modes):
        raise StructureError("no mode of the model oscillates with damping: there is no circle to draw")
    return modes


# --- drawing ---------------------------------------------------------------------------------------------------------


def _draw_along_line(axis: Axes, places: Array, table: ShapeTable, l: int, look: Look) -> Sequence[Artist]:
    """Real part over positions, with intervals, and the imaginary part where there is one to speak of."""
    order = np.argsort(places, kind="stable")
    x, c, reach = places[order], table.shapes[l][order], table.reach[l][order]
    axis.axhline(0.0, **ZERO)
    curve: dict[str, Any] = {"label": "real part", "marker": "o", "markersize": 4.0, **MODEL_LINE, **look.line}
    lines = axis.plot(x, c.real, **curve)
    if table.collinearity.min() < _COLLINEAR:
        dotted: dict[str, Any] = {"color": "0.45", "linestyle": ":", "marker": "s", "markersize": 2.5, "linewidth": 1.0}
        lines += axis.plot(x, c.imag, label="imaginary part", zorder=2, **dotted)
    known = np.isfinite(reach)
    if known.any():
        bars: dict[str, Any] = {"fmt": "none", "ecolor": lines[0].get_color(), "capsize": 2.5, "elinewidth": 1.0}
        axis.errorbar(x[known], c.real[known], yerr=reach[known], zorder=2.5, label=table.interval, **bars)
    size = float(np.abs(c).max()) or 1.0
    # intervals of a shape that is not known do not hide it
    top = 1.12 * max(size, min(float(np.max(np.abs(c.real) + np.where(known, reach, 0.0))), 3.0 * size))
    axis.set_ylim(-top, top)
    look.lattice(axis)
    return lines


def _name_sensors(axis: Axes, labels: list[str] | None) -> None:
    """Ticks at sensors: their names without units, where these are few and short."""
    labels = None if labels is None else [parted(label)[0] for label in labels]
    if labels is not None and len(labels) <= _NAMED and max(map(len, labels)) <= 12:
        rotation = 90 if sum(map(len, labels)) > 24 else 0
        places = np.arange(1, len(labels) + 1)
        axis.set_xticks(places, [plain(label) for label in labels], fontsize="small", rotation=rotation)
    else:
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))


def _draw_in_plane(axis: Axes, places: Array, shape: Array, look: Look) -> Sequence[Artist]:
    """A mark at each sensor, its area that of the entry squared; positions in space are seen from above."""
    x, y = places.T if places.shape[1] == 2 else _seen(places)
    axis.plot(x, y, linestyle="none", marker=".", markersize=3.0, color="0.5", zorder=2, label="_")
    area = _BUBBLE * (shape / (np.abs(shape).max() or 1.0)) ** 2
    colour = look.line.get("color", MODEL_LINE["color"])
    marks = []
    for which, face, name in ((shape >= 0, colour, "positive"), (shape < 0, "none", "negative")):
        marks.append(
            axis.scatter(x[which], y[which], s=area[which], facecolor=face, edgecolor=colour, zorder=3, clip_on=False)
        )
        # of one size in the legend
        axis.scatter([], [], s=0.2 * _BUBBLE, facecolor=face, edgecolor=colour, label=name)
    axis.set_aspect("equal", adjustable="datalim")
    axis.margins(0.15)
    look.lattice(axis)
    if places.shape[1] == 3:
        axis.set_xticklabels([])
        axis.set_yticklabels([])
        _draw_directions(axis)
    return marks


def _draw_frame(axis: Axes, frame: WireFrame, shape: Array, look: Look) -> Sequence[Artist]:
    """The structure at rest and displaced, with a mark at each sensor; lines of both."""
    flat = frame.nodes.shape[1] == 2
    drawn: list[Artist] = []
    curve = {**MODEL_LINE, "linewidth": 1.4, **look.line}
    rest: dict[str, Any] = {"color": "0.7", "linewidth": 0.9, "zorder": 2}
    for nodes, name, style in ((frame.nodes, "at rest", rest), (frame.displaced(shape), "mode shape", curve)):
        x, y = nodes.T if flat else _seen(nodes)
        ends = np.pad(np.stack([x, y])[:, frame.lines], ((0, 0), (0, 0), (0, 1)), constant_values=np.nan)
        drawn += axis.plot(*ends.reshape(2, -1), label=name, **style)
        dots: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 3.5}
        axis.plot(x[frame.measured], y[frame.measured], label="_", **{**style, **dots})
    axis.set_aspect("equal", adjustable="datalim")
    axis.margins(0.08)
    if flat:
        look.lattice(axis)
    else:
        axis.set(xticks=[], yticks=[])
        _draw_directions(axis)
    return drawn


def _seen(points: Array) -> tuple[Array, Array]:
    """Points of space as they are seen from a corner, from above."""
    turn, up = _VIEW
    ahead = points[:, 0] * np.cos(turn) + points[:, 1] * np.sin(turn)
    return points[:, 1] * np.cos(turn) - points[:, 0] * np.sin(turn), points[:, 2] * np.cos(up) - ahead * np.sin(up)


def _draw_directions(axis: Axes) -> None:
    """Where x, y and z point, in a corner."""
    for name, x, y in zip("xyz", *_seen(np.eye(3)), strict=True):
        arrow: dict[str, Any] = {"arrowstyle": "-", "color": "0.35", "linewidth": 0.8}
        axis.annotate(
            name, (0.1, 0.1), (0.1 + 0.09 * x, 0.1 + 0.09 * y), "axes fraction", arrowprops=arrow, fontsize="x-small",
            color="0.35", ha="center", va="center",
        )  # fmt: skip


def _draw_circle(axis: Axes, circle: ModeCircle, look: Look) -> Sequence[Artist]:
    response = circle.response
    lines = axis.plot(response.real, response.imag, label=plain(circle.label), **{**MODEL_LINE, **look.line})
    if len(circle.measured):
        lines += axis.plot(circle.measured.real, circle.measured.imag, label="measured", **{**DOTS, "markersize": 5.0})
    cross: dict[str, Any] = {"linestyle": "none", "marker": "+", "markersize": 10.0, "color": "C3", "zorder": 4}
    resonance = circle.at_resonance
    lines += axis.plot([resonance.real], [resonance.imag], label="resonance", **cross)
    axis.set_aspect("equal", adjustable="datalim")
    axis.margins(0.08)
    axis.locator_params(axis="x", nbins=3)  # small responses have long labels
    look.lattice(axis)
    return lines
