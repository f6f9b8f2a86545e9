"""Frequency responses of modal tests beside their measurement: as a matrix of inputs and outputs, and mode by mode."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import control as ct
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike

from .. import _checks
from .._options import RESPONSE_INTERPOLATIONS, AxisScale, ResponseInterpolation
from .._types import Array, ComplexArray, Indices, Unpack
from .._units import unit_for
from ..analysis.spectral_estimate import hold_response, response_matrix_estimate, rests
from ..exceptions import StructureError
from ..modal.modal_form import ModalForm
from ..numerics.rational import poles as poles_of
from .inputs import as_measured, fit_name, measurements_of, recording_in, table_in, timebase
from .response_picture import (
    CARTESIAN,
    POLAR,
    Curve,
    DrawnResponses,
    FrequencyAxis,
    ResponseBand,
    Scale,
    band_of,
    draw_responses,
    is_logarithmic,
)
from .style import (
    DOTS,
    ZERO,
    AxesGiven,
    LineStyle,
    Look,
    checked_limits,
    frequency_axis,
    imaginary_is_turned,
    panels,
    plain,
    told_gain_units,
)

_MOST_OUTPUTS, _MOST_INPUTS, _WIDE = 9, 3, 3  # of one picture, and panels beside one another
_LINE = 1000  # frequencies of a curve, those of resonances and antiresonances apart
_TURN = np.tan(np.radians(np.linspace(-89.7, 89.7, 121)))  # about a pole, in half widths of its resonance
_NOTCH = 9  # frequencies on each side of an antiresonance
NARROWEST = 1e-6  # half width of a resonance beside its frequency, below which it counts as that of a lossless mode
_DECADES = 30.0  # ratio of natural frequencies beyond which their scale is logarithmic
_FOLDED = 20  # turns of the sampling frequency from which responses fold back
_FAR = 1e6  # times the highest of these: the response there is what is fed through
_FLOOR = 1e-3  # of the highest frequency, where a curve begins on an axis that begins at 0
_DRAWS = 300  # models of a band

_HEIGHTS = 2.8, 5.2  # of a figure, inches
_MARKED = 10  # decades of frequency, beyond which none is marked
_OFF = 8.0  # points from a ring to its frequency
_BESIDE = 0.05  # of the size of a curve: what tells how it bends at a ring
_ASLANT = 0.38  # sine of the angle from which on a text is beside its ring, or above it
_MARK: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 5.0, "markerfacecolor": "white", "zorder": 4}
ESTIMATED = "measured (spectral estimate)"
Parts = Literal["magnitude-phase", "real-imaginary"]
PARTS: dict[Parts, tuple[str, ...]] = {"magnitude-phase": POLAR, "real-imaginary": CARTESIAN}
MODEL_LINE: dict[str, Any] = {"color": "C0", "linewidth": 1.2, "zorder": 3}


def frf_plot(
    model: Any,
    data: object = None,
    *,
    outputs: Sequence[int | str] | None = None,
    inputs: Sequence[int | str] | None = None,
    omega_limits: ArrayLike | None = None,
    Hz: bool | None = None,
    segments: int = 8,
    intersample: ResponseInterpolation | None = None,
    confidence: bool = False,
    level: float = 0.95,
    time_unit: str | None = None,
    gain_unit: str | Sequence[str] | None = None,
    scale: AxisScale | None = None,
    parts: Parts = "magnitude-phase",
    negative_imaginary: bool | None = None,
    ax: AxesGiven = None,
    **style: Unpack[LineStyle],
) -> ct.ControlPlot:
    """Frequency responses of all inputs and outputs, with the measurement as dots beneath the model.

    Parameters
    ----------
    model : PEMResult, modal form or linear system
        Model of p outputs and m inputs; of a result the response of what was measured, on its background and with
        its delay.
    data : control.FrequencyResponseData, control.TimeResponseData, or list of them, optional
        Measurement to draw as dots: responses, or recordings, of which they are estimated; by default those that a
        result was fitted to.
    outputs, inputs : sequence of int or str, optional
        Which to draw, by number or name.  By default all, at most the first nine outputs and three inputs.
    omega_limits : array_like, shape (2,), optional
        Ends of the frequency axis, in its unit.
    Hz : bool, optional
        Frequency axis in Hz, which takes unknown times for seconds, or in rad per unit time.  By default in Hz where
        the unit of time is known, else in cycles per unit of time.
    segments : int
        Number of half-overlapping segments of each recording that the estimate averages.  An input that rests for nine
        tenths of it, as a hammer does, has one: the whole recording.
    intersample : {'zoh', 'foh', 'bandlimited'}, optional
        What the inputs of recordings did between samples; by default what the result says of it, or held.
    confidence : bool
        Whether to shade where the models lie that a result does not exclude, of 300 that it draws.
    level : float
        Share of these models inside the band, between 0 and 1.
    time_unit : str, optional
        Unit of time, for the labels; by default that of the model or the data.
    gain_unit : str or sequence of str, optional
        Unit of the responses, output over input, such as "m/s/N"; one for each output if they differ.  By default that
        of names such as "force [N]" where all have one, of the model or else of the measurement.
    scale : {'log', 'linear'}, optional
        Scale of the frequency axis.  By default logarithmic if the measured frequencies are, or if the axis spans more
        than two decades and the modes are not all in the upper part of evenly spaced frequencies.
    parts : {'magnitude-phase', 'real-imaginary'}
        What is drawn of each response; bands are those of magnitude and phase.
    negative_imaginary : bool, optional
        Whether the imaginary part is drawn with its sign changed, as is usual for impedances; by default where the
        unit of the response is the ohm, or volts over amperes, with any prefixes.
    ax : array of matplotlib.axes.Axes, shape (2p, m), optional
        Axes to draw on, magnitude above phase for each response.  By default a new figure.
    **style
        `title`, `grid`, `show_legend`, `legend_loc`, `rcParams` and, for the model, `color`, `linestyle`, `linewidth`.

    Returns
    -------
    control.ControlPlot
        `lines` and `axes` of shape (2p, m), each with the model, then the dots; of a single input or output in rows of
        three; `figure`, `legend`.

    Raises
    ------
    StructureError
        If the model has no response, the data are not of as many inputs and outputs, or a channel is not there.

    Notes
    -----
    Each resonance and antiresonance has frequencies of its own.  The phase is that of the quantity measured, continuous
    along the model; measured phases are within half a turn of it.

    Responses are estimated from recordings as cross spectra of outputs and inputs over spectra of the inputs (H1), all
    recordings together, and over the response of the hold.  What folds back from beyond the Nyquist frequency of a
    model in continuous time, and what it feeds through from sample to sample, is taken off first.  Of the hits that a
    result was fitted to, dots are its response and the estimate of what it leaves of the outputs: motion that lasts
    beyond the end of a recording would distort them.  Dots of a multiple coherence below one half are pale.

    O((n + K) p m) for K frequencies.

    Examples
    --------
    >>> import numpy as np, matplotlib.pyplot as plt, ph_control as phc
    >>> beam = phc.modes([-0.1 + 10j, -0.3 + 35j], [[1.0, 0.5], [1.0, -0.8]], [[0.2j], [0.1j]])
    >>> plot = phc.frf_plot(beam, gain_unit="m/N", time_unit="s")
    >>> plot.axes.shape, plot.axes[0, 0].get_ylabel(), plot.axes[1, 0].get_xlabel()
    ((2, 2), 'Magnitude [dB re 1 m/N]', 'Frequency [Hz]')
    >>> plt.close(plot.figure)
    """
    look = Look.of(style)
    _checks.choice("parts", parts, tuple(PARTS))
    numbers, units = frf_data(
        model, data, outputs=outputs, inputs=inputs, omega_limits=omega_limits, Hz=Hz, segments=segments,
        intersample=intersample, confidence=confidence, level=level, time_unit=time_unit, gain_unit=gain_unit,
        scale=scale,
    )  # fmt: skip
    drawing = Scale(negative_imaginary=imaginary_is_turned(negative_imaginary, units))
    with look.context():
        meaning = f"{parts.replace('-', ' above ')} of each response"
        drawn = draw_responses(numbers, look, ax, PARTS[parts], drawing, units, _WIDE, meaning)
        return drawn.finished(numbers.title, drawn.legend_of_all())


def nyquist_plot(
    model: Any,
    data: object = None,
    *,
    outputs: Sequence[int | str] | None = None,
    inputs: Sequence[int | str] | None = None,
    omega_limits: ArrayLike | None = None,
    Hz: bool | None = None,
    segments: int = 8,
    intersample: ResponseInterpolation | None = None,
    negative_imaginary: bool | None = None,
    time_unit: str | None = None,
    gain_unit: str | Sequence[str] | None = None,
    ax: AxesGiven = None,
    **style: Unpack[LineStyle],
) -> ct.ControlPlot:
    """Imaginary over real part of frequency responses, with the measurement as dots beneath the model.

    Parameters
    ----------
    model : PEMResult, modal form, linear system, or control.FrequencyResponseData
        Model of p outputs and m inputs, as in `frf_plot`; a measured response is drawn alone.
    data, outputs, inputs, omega_limits, Hz, segments, intersample
        As in `frf_plot`; frequencies are those of the curves.
    negative_imaginary : bool, optional
        Whether `-Im` points upwards, as is usual for impedances; by default where the unit of the response is the ohm,
        or volts over amperes, with any prefixes.
    time_unit, gain_unit
        As in `frf_plot`.
    ax : array of matplotlib.axes.Axes, optional
        Axes to draw on, one for each response.  By default a new figure.
    **style
        As in `frf_plot`.

    Returns
    -------
    control.ControlPlot
        `lines` and `axes` with a panel for each response: curve, then dots; `figure`, `legend`.

    Raises
    ------
    StructureError
        As `frf_plot`.

    Notes
    -----
    Only positive frequencies are drawn.  Both axes have one scale, so that a resistor beside a capacitor is half a
    circle.  Where the frequencies span more than a decade, rings on the curve mark powers of ten.  Next to poles on the
    imaginary axis the curve leaves the picture.

    Examples
    --------
    >>> import control as ct, matplotlib.pyplot as plt, ph_control as phc
    >>> cell = 0.01 + ct.tf([0.02], [0.1, 1.0])  # a resistor before another one beside a capacitor
    >>> plot = phc.nyquist_plot(cell, gain_unit="ohm", time_unit="s")
    >>> plot.axes[0, 0].get_xlabel(), plot.axes[0, 0].get_ylabel()
    ('Re [ohm]', '−Im [ohm]')
    >>> plt.close(plot.figure)
    """
    look = Look.of(style)
    if data is None and table_in(model) is not None:
        numbers, units = _table_alone(model, outputs, inputs, omega_limits, Hz, time_unit, gain_unit)
    else:
        numbers, units = frf_data(
            model, data, outputs=outputs, inputs=inputs, omega_limits=omega_limits, Hz=Hz, segments=segments,
            intersample=intersample, time_unit=time_unit, gain_unit=gain_unit,
        )  # fmt: skip
    scale = Scale(negative_imaginary=imaginary_is_turned(negative_imaginary, units))
    cells = numbers.cells(1)[0]
    with look.context():
        drawn = panels(look, ax, len(cells), (6.0, 4.6) if len(cells) == 1 else (3.4, 3.2))
        for k, (i, j) in enumerate(cells):
            axis = drawn.axes.flat[k]
            drawn.lines.flat[k] = _draw_curve(axis, numbers, i, j, look, scale)
            axis.set(xlabel=scale.label("real", units[i], False), ylabel=scale.label("imaginary", units[i], False))
            if len(cells) > 1:
                axis.set_title(plain(numbers.name(i, j)), loc="left", fontsize="small")
        if len(cells) == 1 and drawn.new:
            _fit_height(drawn.figure, drawn.axes[0, 0])
        title = numbers.title.replace("Frequency response", "Nyquist curve")
        return drawn.finished(title, drawn.legend_of_all())


# --- what may be drawn -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ModelSource:
    """Response of a model at frequencies, shape (p, m, N), and its poles of the upper half-plane."""

    response: Callable[[Array], ComplexArray]
    poles: ComplexArray
    shape: tuple[int, int]
    output_labels: list[str]
    input_labels: list[str]
    label: str
    nyquist: float = np.inf


def model_source(given: object) -> ModelSource:
    """Response of a result, a modal form, or a linear system."""
    if hasattr(given, "residues") and hasattr(given, "poles") and not isinstance(given, ModalForm | ct.lti.LTI):
        return _source_of_fractions(given)
    label = "model"
    if isinstance(given, ModalForm):
        shape = given.noutputs, given.ninputs
        names = _numbered("output", shape[0]), _numbered("input", shape[1])
        return ModelSource(lambda omega: given.evaluate(1j * omega), _upper(given.poles), shape, *names, label)
    if not isinstance(given, ct.StateSpace | ct.TransferFunction):
        raise StructureError(
            f"model is a {type(given).__name__}; pass what pem gives, a modal form, or a linear system of "
            "python-control"
        )
    discrete = given.isdtime(strict=True)
    step = timebase(given) if discrete else 0.0
    poles = poles_of(given)
    if discrete:
        poles = np.log(poles[poles != 0]) / step
    return ModelSource(
        lambda omega: given(np.exp(1j * omega * step) if discrete else 1j * omega, squeeze=False, warn_infinite=False),
        _upper(poles), (given.noutputs, given.ninputs), given.output_labels, given.input_labels, label,
        np.pi / step if discrete else np.inf,
    )  # fmt: skip


def _source_of_fractions(given: Any) -> ModelSource:
    """Response of poles, one of each pair, residues (n, p, m) and feedthrough (p, m)."""
    poles = np.atleast_1d(_checks.complex_points("the poles", given.poles))
    residues = np.asarray(given.residues, complex)
    residues = residues[:, None, None] if residues.ndim == 1 else residues
    if residues.ndim != 3 or len(residues) != len(poles):
        raise StructureError(
            f"residues have shape {residues.shape}; of {len(poles)} poles they have ({len(poles)}, p, m)"
        )
    if not residues.size:
        raise StructureError(
            "the model has no mode, or no input, as that of a free decay: it has no frequency response"
        )
    D = np.asarray(given.feedthrough, float).reshape(residues.shape[1:])
    flat, pairs = residues.reshape(len(poles), -1), poles.imag != 0

    def response(omega: Array) -> ComplexArray:
        s = 1j * omega[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            values = (1.0 / (s - poles)) @ flat + (1.0 / (s - poles[pairs].conj())) @ flat[pairs].conj()
        return as_measured(given, values.T.reshape(*residues.shape[1:], -1) + D[:, :, None], omega)

    names = _names_of(given, "output", len(D)), _names_of(given, "input", len(D.T))
    return ModelSource(response, _upper(poles), (len(D), len(D.T)), *names, fit_name(poles))


def _names_of(given: object, kind: str, count: int) -> list[str]:
    """Names of the channels of a result, as it or its data have them."""
    for source in (given, *measurements_of(given, None), getattr(given, "system", None)):
        for name in (f"{kind}_labels", f"{kind}_label"):
            labels = getattr(source, name, None)
            labels = [labels] if isinstance(labels, str) else labels
            if labels is not None and len(labels) == count:
                return list(labels)
    return _numbered(kind, count)


def _numbered(kind: str, count: int) -> list[str]:
    return [f"{'y' if kind == 'output' else 'u'}[{k}]" for k in range(count)]


def _upper(poles: Any) -> ComplexArray:
    """Poles of the upper half-plane, ascending by their natural frequencies; none at 0."""
    poles = np.asarray(poles, complex)
    poles = poles[(poles.imag >= 0) & (np.abs(poles) > 1e-9 * np.abs(poles).max(initial=0.0))]
    return np.asarray(poles[np.argsort(np.abs(poles), kind="stable")])


def measured_by(model: Any, data: object, source: ModelSource, segments: int, intersample: str | None) -> list[Curve]:
    """What was measured: responses as they are, one estimate of all recordings."""
    hold = getattr(model, "intersample", "zoh") if intersample is None else intersample
    _checks.choice("intersample", hold, RESPONSE_INTERPOLATIONS)
    _checks.whole_number("segments", segments, 1)
    responses, recordings = [], []
    for measurement in measurements_of(model, data):
        if (table := table_in(measurement)) is not None:
            _refuse_shape(table[1].shape[:2], source.shape)
            omega, values = table[0][table[0] > 0], table[1][:, :, table[0] > 0]
            responses.append(Curve("measured", omega, values, tabulated=True))
        else:
            u, y, step = recording_in(measurement)
            u = u if len(u) else np.zeros((source.shape[1], y.shape[1]))
            _refuse_shape((len(y), len(u)), source.shape)
            recordings.append((u, y, step))
    driven = [recording for recording in recordings if np.any(recording[0])]
    if driven:
        # a model in discrete time answers to samples, whatever is between them
        hold = hold if np.isinf(source.nyquist) else "bandlimited"
        omega, estimate, coherence = response_matrix_estimate(driven, segments, hold)
        unexplained = _residuals_of_hits(model, recordings) if data is None else []
        if unexplained:
            estimate = source.response(omega) + response_matrix_estimate(unexplained, segments, hold)[1]
        elif hold != "bandlimited" and len(omega):
            estimate = estimate - _folded(source, omega, driven[0][2], hold)
        driven = driven if len(omega) else []
    if driven:
        responses.append(Curve(ESTIMATED, omega, estimate, doubtful=coherence < 0.5, tabulated=True))
    elif recordings and data is not None:
        raise StructureError(
            "the recordings are free motions, or their inputs are constant, and show no frequency response; "
            "leave data out"
        )
    return responses


def _residuals_of_hits(fit: Any, recordings: Sequence[tuple[Array, Array, float]]) -> list[tuple[Array, Array, float]]:
    """Recordings of hits with what a fit leaves of their outputs; none where the inputs are not those of a hammer.

    Motion that lasts beyond the end of a recording is cut there, and its spectrum without a window is another one; of
    what the prediction leaves that is no matter.
    """
    residuals = []
    for experiment, (u, y, step) in zip(fit.experiments, recordings, strict=True):
        if np.any(u):
            predicted = np.asarray(experiment.predicted, float).reshape(y.shape)
            residuals.append((u, y - np.where(np.isnan(predicted), y, predicted), step))
    return residuals if all(rests(u) for u, _, _ in residuals) else []


def _folded(source: ModelSource, omega: Array, step: float, hold: str) -> ComplexArray:
    """What folds back on the response of a model from beyond the Nyquist frequency, under the response of the hold.

    What is fed through passes from sample to sample as it is.
    """
    turns = np.concatenate([np.arange(-_FOLDED, 0), np.arange(1, _FOLDED + 1)])
    beyond = omega + 2.0 * np.pi / step * turns[:, None]
    every = np.abs(beyond).ravel()
    through = source.response(_FAR * every.max(keepdims=True)).real
    above = source.response(every) - through
    above = np.where(beyond.ravel() < 0, above.conj(), above)
    held = (above * hold_response(beyond.ravel() * step, hold)).reshape(*above.shape[:2], *beyond.shape)
    own = hold_response(omega * step, hold)
    return np.asarray((held.sum(axis=2) + through * (1.0 - own)) / own)


def _refuse_shape(measured: tuple[int, ...], shape: tuple[int, int]) -> None:
    if tuple(measured) != tuple(shape):
        raise StructureError(
            f"the data have {measured[0]} outputs and {measured[1]} inputs, the model {shape[0]} and {shape[1]}; "
            "select the same ones"
        )


# --- numbers of the matrix -------------------------------------------------------------------------------------------


def frf_data(
    model: Any, data: object = None, *, outputs: Any = None, inputs: Any = None, omega_limits: Any = None,
    Hz: bool | None = None, segments: int = 8, intersample: str | None = None, confidence: bool = False,
    level: float = 0.95, time_unit: str | None = None, gain_unit: Any = None, scale: str | None = None,
) -> tuple[DrawnResponses, list[str | None]]:  # fmt: skip
    """Compute what `frf_plot` draws, of its arguments, and the unit of each output drawn."""
    _checks.flags(confidence=confidence)
    _checks.level("level", level)
    source = model_source(model)
    unit, unit_name = frequency_axis(Hz, unit_for(time_unit, model, data))
    measured = measured_by(model, data, source, segments, intersample)
    rows, columns = (
        chosen_channels(what, given, names, most)
        for what, given, names, most in (
            ("outputs", outputs, source.output_labels, _MOST_OUTPUTS),
            ("inputs", inputs, source.input_labels, _MOST_INPUTS),
        )
    )
    low, high = _limits(source, measured, omega_limits, unit)
    modes = np.abs(source.poles[source.poles.imag > 0])
    grid = measured[0].omega if measured else None
    logarithmic = is_logarithmic(scale, low, high, grid, modes)
    axis = FrequencyAxis(low if low > 0 else _FLOOR * high * logarithmic, high, unit, unit_name, logarithmic)
    chosen = np.ix_(rows, columns)

    def response(omega: Array) -> ComplexArray:
        return np.asarray(source.response(omega)[chosen])

    omega, sharp = _grid(source, axis, response)
    bands = _bands(model, omega, level, rows, columns) if confidence else {}
    curve = Curve(source.label, omega, response(omega), sharp, bands=bands)
    measured = [
        replace(dots, response=dots.response[chosen], doubtful=None if dots.doubtful is None else dots.doubtful[rows])
        for dots in measured
    ]
    parts = [
        text for text in (_share("outputs", rows, source.shape[0]), _share("inputs", columns, source.shape[1])) if text
    ]
    names = [source.output_labels[k] for k in rows], [source.input_labels[k] for k in columns]
    responses = DrawnResponses([curve], measured, axis, *names)
    title = "Frequency responses"
    if curve.response.size == len(omega):
        title = f"Frequency response, {responses.name(0, 0)}"
    units = gain_units(gain_unit, [source, *measurements_of(model, data)], source.shape, rows, columns)
    return replace(responses, title=title + (f" ({', '.join(parts)})" if parts else "")), units


def gain_units(
    given: object, sources: Sequence[Any], shape: tuple[int, int], rows: Indices, columns: Indices
) -> list[str | None]:
    """Unit of the responses of each output: as given, or as the names of the first of model and measurements tell."""
    if given is not None:
        return [given] * len(rows) if isinstance(given, str) else [*_checks.labels(given, len(rows), "outputs")]
    for source in sources:
        outputs, inputs = (getattr(source, name, None) or () for name in ("output_labels", "input_labels"))
        if (len(outputs), len(inputs)) == shape:
            units = told_gain_units([outputs[i] for i in rows], [inputs[j] for j in columns])
            if None not in units:
                return list(units)
    return [None] * len(rows)


def _bands(
    model: Any, omega: Array, level: float, rows: Indices, columns: Indices
) -> dict[tuple[int, int], ResponseBand]:
    """Bands of models drawn around a result, of each response drawn."""
    if not hasattr(model, "sample"):
        raise StructureError(
            f"confidence is True, but a {type(model).__name__} is not the result of a fit; leave it out"
        )
    models = model.sample(_DRAWS, 0)
    return {
        (i, j): band_of(models, omega, level, output=int(row), input=int(column))
        for i, row in enumerate(rows) for j, column in enumerate(columns)
    }  # fmt: skip


def chosen_channels(what: str, given: Any, names: Sequence[str], most: int | None = None) -> Indices:
    """Numbers of the channels asked for, by number or name; by default the first ones."""
    if given is None:
        return np.arange(len(names) if most is None else min(len(names), most))
    listed = [given] if isinstance(given, str) or np.ndim(given) == 0 else list(given)
    known = f"there are {len(names)}: {', '.join(names[:6])}{', ..' * (len(names) > 6)}"
    if not listed:
        raise StructureError(f"{what} is empty; {known}")
    numbers = []
    for channel in listed:
        if isinstance(channel, str) and channel in names:
            numbers.append(list(names).index(channel))
        elif _checks.is_whole(channel) and -len(names) <= channel < len(names):
            numbers.append(int(channel) % len(names))
        else:
            raise StructureError(f"{what} has {_checks.shown(channel)}; {known}, counted from 0")
    return np.array(numbers, np.intp)


def _share(what: str, chosen: Indices, count: int) -> str:
    """What a title says of channels that are left out."""
    if len(chosen) == count:
        return ""
    if len(chosen) > 1 and (np.diff(chosen) == 1).all():
        return f"{what} {chosen[0] + 1} to {chosen[-1] + 1} of {count}"
    return f"{len(chosen)} of {count} {what}"


def _limits(source: ModelSource, measured: list[Curve], given: object, unit: float) -> tuple[float, float]:
    """Ends of the axis: those given, those of tables, or of the poles as far as recordings reach."""
    if given is not None:
        low, high = checked_limits(given)
        return low * unit, high * unit
    tables = [curve.omega for curve in measured if curve.label != ESTIMATED and len(curve.omega)]
    d = np.abs(source.poles) if len(source.poles) else np.ones(1)
    low, high = 0.5 * d[0], (1.25 if d[-1] <= _DECADES * d[0] else 2.0) * d[-1]
    if not np.any(source.poles.imag):  # corners are seen from a decade below to a decade above
        low, high = 0.1 * d[0], 10.0 * d[-1]
    recorded = [curve.omega for curve in measured if len(curve.omega)]
    if tables:
        low, high = min(curve[0] for curve in tables), max(curve[-1] for curve in tables)
    elif recorded:
        first = min(curve[0] for curve in recorded)
        # below what was measured a lag is seen to be level
        low, high = (
            max(low, first if np.any(source.poles.imag) else 0.2 * first),
            min(high, max(curve[-1] for curve in recorded)),
        )
    high = min(high, source.nyquist)
    return (float(low), float(high)) if low < high else (0.5 * float(high), float(high))


def _grid(source: ModelSource, axis: FrequencyAxis, response: Callable[[Array], ComplexArray]) -> tuple[Array, Array]:
    """Frequencies of the curve, and those of peaks that are infinite or nearly so."""
    top = min(axis.high, source.nyquist)
    floor = axis.low if axis.low > 0 else _FLOOR * axis.high
    p = source.poles[source.poles.imag > 0]
    width = np.maximum(np.abs(p.real), NARROWEST * np.abs(p))
    around = (p.imag[:, None] + width[:, None] * _TURN).ravel()
    grid = np.unique(np.concatenate([axis.places(floor, top, _LINE), around[(around >= floor) & (around <= top)]]))
    # antiresonances, which have no pole to tell where they are
    size = np.abs(response(grid)).reshape(-1, len(grid))
    k = np.unique(np.nonzero((size[:, 1:-1] < size[:, :-2]) & (size[:, 1:-1] < size[:, 2:]))[1] + 1)
    share = np.linspace(0.0, 1.0, _NOTCH + 2)[1:-1]
    notches = [grid[k + s] + share[:, None] * (grid[k + s + 1] - grid[k + s]) for s in (-1, 0)]
    # a sample on a pole of the axis is infinite
    grid = np.setdiff1d(np.concatenate([grid, *(notch.ravel() for notch in notches)]), p.imag[p.real == 0])
    return grid, np.unique(p.imag[width <= NARROWEST * np.abs(p)])


# --- Nyquist curves -----------------------------------------------------------------------------------------------


def _table_alone(
    table: Any, outputs: Any, inputs: Any, limits: Any, Hz: bool | None, time_unit: str | None, gain_unit: Any
) -> tuple[DrawnResponses, list[str | None]]:
    """A measured response without a model."""
    omega, values = table_in(table) or (np.zeros(0), np.zeros((0, 0, 0), complex))
    unit, unit_name = frequency_axis(Hz, unit_for(time_unit, table))
    low, high = (omega[0], omega[-1]) if limits is None else np.multiply(checked_limits(limits), unit)
    names = [
        list(getattr(table, f"{kind}_labels", None) or [f"{letter}[{k}]" for k in range(count)])
        for kind, letter, count in zip(("output", "input"), "yu", values.shape, strict=False)
    ]
    rows, columns = (
        chosen_channels(what, given, some)
        for what, given, some in zip(("outputs", "inputs"), (outputs, inputs), names, strict=True)
    )
    measured = Curve("measured", omega, values[np.ix_(rows, columns)], tabulated=True)
    chosen = [names[0][k] for k in rows], [names[1][k] for k in columns]
    responses = DrawnResponses([], [measured], FrequencyAxis(float(low), float(high), unit, unit_name), *chosen)
    title = f"Nyquist curve, {responses.name(0, 0)}" if len(rows) == len(columns) == 1 else "Nyquist curves"
    title = title.replace(", u[0] to y[0]", "")
    units = gain_units(gain_unit, [table], values.shape[:2], rows, columns)
    return DrawnResponses([], [measured], responses.axis, *chosen, title), units


def _draw_curve(axis: Axes, numbers: DrawnResponses, i: int, j: int, look: Look, scale: Scale) -> list[Line2D]:
    """Curve of an entry, dots, and rings at powers of ten of the frequency; lines of the first two."""
    (real, imaginary), (real_dots, imaginary_dots) = zip(
        *(numbers.values(part, i, j, scale) for part in ("real", "imaginary")), strict=True
    )
    lines: list[Line2D] = []
    axis.axhline(0.0, **ZERO)
    axis.axvline(0.0, **ZERO)
    for k, (curve, x, y) in enumerate(zip(numbers.curves, real, imaginary, strict=True)):
        seen = curve.visible(numbers.axis)
        x, y = np.where(seen, x, np.nan), np.where(seen, y, np.nan)
        lines += axis.plot(x, y, label=plain(curve.label), **look.curve(k))
        _mark_decades(axis, numbers.axis, curve.omega, x, y, lines[-1].get_color())
    for curve, x, y in zip(numbers.measured, real_dots, imaginary_dots, strict=True):
        seen = (curve.omega >= numbers.axis.low) & (curve.omega <= numbers.axis.high) & ~curve.noisy(i)
        lines += axis.plot(x[seen], y[seen], label=plain(curve.label), rasterized=True, **{**DOTS, "markersize": 5.0})
        if not numbers.curves:
            _mark_decades(axis, numbers.axis, curve.omega, x, y, lines[-1].get_color())
    axis.set_aspect("equal", adjustable="datalim")
    axis.margins(0.13, 0.1)  # frequencies stand aside
    look.lattice(axis)
    return lines


def _fit_height(figure: Figure, axis: Axes) -> None:
    """Make a figure as high as what it shows."""
    width, _ = figure.get_size_inches()
    share = axis.dataLim.height / (axis.dataLim.width or 1.0)
    figure.set_size_inches(width, float(np.clip(1.5 + (width - 1.0) * 1.2 * share, *_HEIGHTS)))


def _mark_decades(axis: Axes, frequency: FrequencyAxis, omega: Array, x: Array, y: Array, colour: Any) -> None:
    low, high = max(frequency.low, omega[0]) / frequency.unit, min(frequency.high, omega[-1]) / frequency.unit
    if not low > 0:
        return
    powers = 10.0 ** np.arange(np.ceil(np.log10(low)), np.floor(np.log10(high)) + 1)
    if not 2 <= len(powers) <= _MARKED:
        return
    place = [np.interp(np.log(powers * frequency.unit), np.log(omega), values) for values in (x, y)]
    axis.plot(*place, color=colour, label="_", **_MARK)
    # where rings crowd, as at both ends of a curve, only the first of them is named
    reach = max(np.nanmax(x) - np.nanmin(x), np.nanmax(y) - np.nanmin(y)) or 1.0
    last = None
    for power, across, up in zip(powers, *place, strict=True):
        if np.isfinite(across + up) and (last is None or np.hypot(across - last[0], up - last[1]) > 0.1 * reach):
            last = (across, up)
            aside, above = _outward(x, y, last, _BESIDE * reach)
            axis.annotate(
                f"{power:g} {frequency.unit_name}", last, (_OFF * aside, _OFF * above), textcoords="offset points",
                fontsize="x-small", color="0.35", ha=_aligned(aside, "right", "left"),
                va=_aligned(above, "top", "bottom"),
            )  # fmt: skip


def _outward(x: Array, y: Array, place: tuple[float, float], near: float) -> tuple[float, float]:
    """Direction that leads away from a curve at a place of it, to where it does not bend."""
    known = np.isfinite(x + y)
    z, here = x[known] + 1j * y[known], complex(*place)
    k, apart = int(np.argmin(np.abs(z - here))), np.abs(z - here) > near
    before, after = np.flatnonzero(apart[:k]), k + np.flatnonzero(apart[k:])
    first, last = z[before[-1] if len(before) else 0], z[after[0] if len(after) else -1]
    chord = (last - first) / abs(last - first) if last != first else 1.0 + 0.0j
    side = ((here - first) * np.conj(chord)).imag  # of the chord, left of it positive
    normal = chord * (1j if side > 0 or (side == 0 and chord.real > 0) else -1j)
    return float(normal.real), float(normal.imag)


def _aligned(part: float, low: str, high: str) -> str:
    """Which side of a text is next to its place, of the part of its direction along one axis."""
    return "center" if abs(part) < _ASLANT else high if part > 0 else low
