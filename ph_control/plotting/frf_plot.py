"""Frequency responses of modal tests beside their measurement: as a matrix of inputs and outputs, and mode by mode."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import control as ct
import numpy as np
from matplotlib.ticker import MaxNLocator, MultipleLocator
from numpy.typing import ArrayLike

from .. import _checks
from .._display import counted
from .._types import Array, ComplexArray, Indices, Mask
from .._units import parted, unit_for
from ..analysis.spectral_estimate import INTERSAMPLE, hold_response, response_matrix_estimate
from ..exceptions import StructureError
from ..modal.modal_form import ModalForm
from ..numerics.rational import poles as poles_of
from .bode_data import band_of, decibels, degrees_from
from .inputs import as_measured, measurements_of, recording_in, table_in, timebase
from .style import (
    BAND,
    DOTS,
    LineStyle,
    Look,
    checked_limits,
    frequency_axis,
    gain_label,
    labelled,
    picture,
    plain,
    told_gain_units,
)

if TYPE_CHECKING:
    from typing_extensions import Unpack

_MOST_OUTPUTS, _MOST_INPUTS, _WIDE = 9, 3, 3  # of one picture, and panels beside one another
_LINE = 1000  # frequencies of a curve, those of resonances and antiresonances apart
_TURN = np.tan(np.radians(np.linspace(-89.7, 89.7, 121)))  # about a pole, in half widths of its resonance
_NOTCH = 9  # frequencies on each side of an antiresonance
NARROWEST = 1e-6  # half width of a resonance beside its frequency, below which it counts as that of a lossless mode
_DECADES = 30.0  # ratio of natural frequencies beyond which their scale is logarithmic
_BEYOND = 45.0  # degrees beyond a turn of the phase in which measured ones stay beside the model
_DEEPEST = 0.02  # share of a curve in its antiresonances that may leave the picture
_FOLDED = 20  # turns of the sampling frequency from which responses fold back
_FAR = 1e6  # times the highest of these: the response there is what is fed through
_LETTERS = 34  # of the name of a panel
_DRAWS = 300  # models of a band
_CUTS = np.arange(-360.0, 0.0, 45.0) + 45.0

MODEL_LINE: dict[str, Any] = {"color": "C0", "linewidth": 1.2, "zorder": 3}
_PALE: dict[str, Any] = {**DOTS, "color": "0.8", "zorder": 2.1}


def frf_plot(
    model: Any,
    data: Any = None,
    *,
    outputs: Sequence[int | str] | None = None,
    inputs: Sequence[int | str] | None = None,
    omega_limits: ArrayLike | None = None,
    Hz: bool | None = None,
    segments: int = 8,
    intersample: str | None = None,
    confidence: bool = False,
    level: float = 0.95,
    time_unit: str | None = None,
    gain_unit: str | Sequence[str] | None = None,
    ax: Any = None,
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
    Each resonance and antiresonance has frequencies of its own.  The phase is that of the quantity measured, and its
    turn begins where the model has the fewest; measured phases are those next to the model, so that none jumps by a
    turn where the model does not.  Frequencies are to a logarithmic scale if the modes span more than a factor of 30.

    Responses are estimated from recordings as cross spectra of outputs and inputs over spectra of the inputs (H1), all
    recordings together, and over the response of the hold.  What folds back from beyond the Nyquist frequency of a
    model in continuous time, and what it feeds through from sample to sample, is taken off first.  Dots of a multiple
    coherence below one half are pale.

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
    numbers = frf_data(
        model, data, outputs=outputs, inputs=inputs, omega_limits=omega_limits, Hz=Hz, segments=segments,
        intersample=intersample, confidence=confidence, level=level, time_unit=time_unit,
    )  # fmt: skip
    units = _gain_units(gain_unit, numbers)
    look = Look.of(style)
    cells, shape = numbers.cells(1 if ax is not None else _WIDE)
    rows, columns = shape
    size = (max(6.4, 3.5 * columns), 0.9 + (3.4 if rows == 1 else 2.3 if rows <= 3 else 1.6) * rows)
    with look.context():
        drawn = picture(
            look, ax, (2 * rows, columns), size, height_ratios=[1.6, 1.0] * rows, sharex=True,
            meaning="magnitude above phase of each response",
        )  # fmt: skip
        for k, (i, j) in enumerate(cells):
            row, column = divmod(k, columns)
            pair = drawn.axes[2 * row : 2 * row + 2, column]
            for part, lines in enumerate(_draw_response(pair, numbers, i, j, look)):
                drawn.lines[2 * row + part, column] = lines
            if column == 0:
                short = rows > 1
                unit = _checks.unit_text(units[numbers.outputs[i]])
                pair[0].set_ylabel((f"dB re 1 {plain(unit)}" if unit else "dB") if short else gain_label(unit or None))
                pair[1].set_ylabel("deg" if short else "Phase [deg]")
            # those below may have no panel
            if k + columns >= len(cells):
                pair[1].set_xlabel(labelled("Frequency", numbers.unit_name))
                pair[1].tick_params(labelbottom=True)
        for k in range(len(cells), rows * columns):
            for row in (2 * (k // columns), 2 * (k // columns) + 1):
                drawn.axes[row, k % columns].set_visible(False)
                drawn.lines[row, k % columns] = []
        return drawn.finished(numbers.title, drawn.legend_of_all())


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


def model_source(given: Any) -> ModelSource:
    """Response of a result, a modal form, or a linear system."""
    if hasattr(given, "residues") and hasattr(given, "poles") and not isinstance(given, ModalForm | ct.lti.LTI):
        return _source_of_fractions(given)
    label = "model"
    if hasattr(given, "observed_system"):
        label, given = f"fit ({counted(len(given.d), 'mode')})", given.observed_system
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
            found = (1.0 / (s - poles)) @ flat + (1.0 / (s - poles[pairs].conj())) @ flat[pairs].conj()
        return as_measured(given, found.T.reshape(*residues.shape[1:], -1) + D[:, :, None], omega)

    names = _names_of(given, "output", len(D)), _names_of(given, "input", len(D.T))
    return ModelSource(response, _upper(poles), (len(D), len(D.T)), *names, f"fit ({counted(len(poles), 'mode')})")


def _names_of(given: Any, kind: str, count: int) -> list[str]:
    """Names of the channels of a result, as it or its data have them."""
    for one in (given, *measurements_of(given, None), getattr(given, "system", None)):
        for name in (f"{kind}_labels", f"{kind}_label"):
            found = getattr(one, name, None)
            found = [found] if isinstance(found, str) else found
            if found is not None and len(found) == count:
                return list(found)
    return _numbered(kind, count)


def _numbered(kind: str, count: int) -> list[str]:
    return [f"{'y' if kind == 'output' else 'u'}[{k}]" for k in range(count)]


def _upper(poles: Any) -> ComplexArray:
    """Poles of the upper half-plane, ascending by their natural frequencies; none at 0."""
    poles = np.asarray(poles, complex)
    poles = poles[(poles.imag >= 0) & (np.abs(poles) > 1e-9 * np.abs(poles).max(initial=0.0))]
    return np.asarray(poles[np.argsort(np.abs(poles), kind="stable")])


@dataclass(frozen=True)
class MeasuredMatrix:
    """Measured responses (p, m, K) at `omega`, NaN where there is none; `doubtful` (p, K) ones are mostly noise."""

    omega: Array
    response: ComplexArray
    doubtful: Mask
    label: str
    recorded: bool = False


def measured_by(
    model: Any, data: Any, source: ModelSource, segments: int, intersample: str | None
) -> list[MeasuredMatrix]:
    """What was measured: responses as they are, one estimate of all recordings."""
    hold = getattr(model, "intersample", "zoh") if intersample is None else intersample
    _checks.choice("intersample", hold, INTERSAMPLE)
    _checks.whole_number("segments", segments, 1)
    responses, recordings = [], []
    for one in measurements_of(model, data):
        if (table := table_in(one)) is not None:
            _refuse_shape(table[1].shape[:2], source.shape)
            omega, values = table[0][table[0] > 0], table[1][:, :, table[0] > 0]
            responses.append(MeasuredMatrix(omega, values, np.zeros(values.shape[::2], bool), "measured"))
        else:
            u, y, step = recording_in(one)
            u = u if len(u) else np.zeros((source.shape[1], y.shape[1]))
            _refuse_shape((len(y), len(u)), source.shape)
            recordings.append((u, y, step))
    driven = [one for one in recordings if np.any(one[0])]
    if driven:
        # a model in discrete time answers to samples, whatever is between them
        hold = hold if np.isinf(source.nyquist) else "bandlimited"
        omega, found, coherence = response_matrix_estimate(driven, segments, hold)
        if hold != "bandlimited" and len(omega):
            found = found - _folded(source, omega, driven[0][2], hold)
        driven = driven if len(omega) else []
    if driven:
        responses.append(MeasuredMatrix(omega, found, coherence < 0.5, "measured (spectral estimate)", recorded=True))
    elif recordings and data is not None:
        raise StructureError(
            "the recordings are free motions, or their inputs are constant, and show no frequency response; "
            "leave data out"
        )
    return responses


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


def _refuse_shape(found: tuple[int, ...], shape: tuple[int, int]) -> None:
    if tuple(found) != tuple(shape):
        raise StructureError(
            f"the data have {found[0]} outputs and {found[1]} inputs, the model {shape[0]} and {shape[1]}; select the "
            "same ones"
        )


# --- numbers of the matrix -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class FRFData:
    """Responses to draw, shape (p, m, N) at `omega`, and the measured ones; phases turn from `cut` on, in degrees."""

    omega: Array
    response: ComplexArray
    measured: list[MeasuredMatrix]
    beside: list[ComplexArray]
    outputs: Indices
    output_labels: list[str]
    input_labels: list[str]
    low: float
    high: float
    logarithmic: bool
    even: Mask
    bounded: Mask
    cut: float
    unit: float
    unit_name: str
    label: str
    title: str
    bands: dict[tuple[int, int], tuple[Array, Array]]
    band_label: str
    gain_units: list[str] | list[None]

    def cells(self, wide: int) -> tuple[list[tuple[int, int]], tuple[int, int]]:
        """Responses in the order of their panels, and the shape of these: a single row or column is folded."""
        p, m = self.response.shape[:2]
        every = [(i, j) for i in range(p) for j in range(m)]
        if min(p, m) > 1:
            return every, (p, m)
        columns = min(len(every), wide) if wide > 1 else m
        # no row of a single panel where two rows of two hold them
        columns = 2 if len(every) == 4 and wide > 1 else columns
        return every, (-(-len(every) // columns), columns)

    def phase(self, i: int, j: int) -> Array:
        """Degrees from `cut` on, NaN where they jump by a turn."""
        phase = degrees_from(self.cut, self.response[i, j])
        return np.where(np.abs(np.diff(phase, prepend=phase[:1])) > 180.0, np.nan, phase)

    def phase_band(self, i: int, j: int) -> Array:
        """Ends of the band of phases beside the curve, shape (2, N)."""
        phase = self.phase(i, j)
        off = self.bands[i, j][1] - phase
        low = np.mod(off[0] + 180.0, 360.0) - 180.0
        return np.asarray(phase + np.stack([low, low + off[1] - off[0]]))

    def measured_phase(self, k: int, i: int, j: int) -> Array:
        """Degrees of measured responses, those within half a turn of the model, unless these leave the picture."""
        model, values = self.beside[k][i, j], self.measured[k].response[i, j]
        usable = np.isfinite(values) & (values != 0) & np.isfinite(model) & (model != 0)
        ratio = np.where(usable, values, 1.0) * np.where(usable, model, 1.0).conj()
        phase = degrees_from(self.cut, model) + np.degrees(np.angle(ratio))
        phase = np.where(phase < self.cut - _BEYOND, phase + 360.0, phase)
        return np.where(usable, np.where(phase > self.cut + 360.0 + _BEYOND, phase - 360.0, phase), np.nan)

    @cached_property
    def turn(self) -> tuple[float, float]:
        """Ends of the phases of all panels, a little beyond whole quarters of a turn."""
        p, m = self.response.shape[:2]
        cells = [(i, j) for i in range(p) for j in range(m)]
        phases = [self.phase(i, j) for i, j in cells]
        phases += [self.measured_phase(k, i, j) for k in range(len(self.measured)) for i, j in cells]
        every = np.concatenate(phases)
        every = every[np.isfinite(every)] if np.isfinite(every).any() else np.zeros(1)
        low, high = 90.0 * np.floor((every.min() + 15.0) / 90.0), 90.0 * np.ceil((every.max() - 15.0) / 90.0)
        return float(min(low, high - 90.0)) - 20.0, float(high) + 20.0

    def levels(self, i: int, j: int) -> tuple[float, float]:
        """Decibels that a picture must hold: of the model all but the deepest antiresonances and infinite peaks."""
        curve = decibels(self.response[i, j])
        even, peaks = curve[self.even & np.isfinite(curve)], curve[self.bounded & np.isfinite(curve)]
        kept = [np.quantile(even, [_DEEPEST, 1.0])] if len(even) else []
        kept += [peaks.max(keepdims=True)] if len(peaks) else []
        for one in self.measured:
            size = decibels(one.response[i, j])[(one.omega >= self.low) & (one.omega <= self.high)]
            size = size[np.isfinite(size)]
            kept += [np.quantile(size, [0.005, 1.0])] if len(size) else []
        ends = np.concatenate(kept) if kept else np.zeros(1)
        margin = 3.0 + 0.05 * float(np.ptp(ends))
        return float(ends.min()) - margin, float(ends.max()) + margin


def frf_data(
    model: Any, data: Any = None, *, outputs: Any = None, inputs: Any = None, omega_limits: Any = None,
    Hz: bool | None = None, segments: int = 8, intersample: str | None = None, confidence: bool = False,
    level: float = 0.95, time_unit: str | None = None,
) -> FRFData:  # fmt: skip
    """Compute what `frf_plot` draws, of its arguments."""
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
    d = np.abs(source.poles)
    inside = d[(d >= low) & (d <= high)]
    logarithmic = len(inside) > 0 and bool(inside[-1] > _DECADES * inside[0])
    chosen = np.ix_(rows, columns)

    def response(omega: Array) -> ComplexArray:
        return np.asarray(source.response(omega)[chosen])

    grid, even, bounded = _grid(source, low, high, logarithmic, response)
    values = response(grid)
    measured = [MeasuredMatrix(a.omega, a.response[chosen], a.doubtful[rows], a.label, a.recorded) for a in measured]
    parts = [
        text for text in (_share("outputs", rows, source.shape[0]), _share("inputs", columns, source.shape[1])) if text
    ]
    names = [source.input_labels[k] for k in columns], [source.output_labels[k] for k in rows]
    title = (
        "Frequency responses, magnitude above phase" if values.shape[:2] != (1, 1)
        else f"Frequency response, {_named(names[0][0], names[1][0], False)}"
    )  # fmt: skip
    return FRFData(
        grid, values, measured, [response(one.omega) for one in measured], rows,
        names[1], names[0], low, high,
        logarithmic, even, bounded, _phase_cut(values[:, :, even]), unit, unit_name, source.label,
        title + (f" ({', '.join(parts)})" if parts else ""),
        _bands(model, grid, level, rows, columns) if confidence else {}, f"{100 * level:g} % band",
        _told_units([source, *measurements_of(model, data)], source.shape, rows, columns),
    )  # fmt: skip


def _told_units(
    sources: Sequence[Any], shape: tuple[int, int], rows: Indices, columns: Indices
) -> list[str] | list[None]:
    """Unit of the responses of each output, of the first of model and measurements whose names tell those of all."""
    for one in sources:
        outputs, inputs = (getattr(one, name, None) or () for name in ("output_labels", "input_labels"))
        if (len(outputs), len(inputs)) == shape:
            told = told_gain_units([outputs[i] for i in rows], [inputs[j] for j in columns])
            if None not in told:
                return told
    return [None] * len(rows)


def _bands(
    model: Any, omega: Array, level: float, rows: Indices, columns: Indices
) -> dict[tuple[int, int], tuple[Array, Array]]:
    """Ends of the decibels and degrees of models drawn around a result, shapes (2, N), of each response drawn."""
    if not hasattr(model, "sample"):
        raise StructureError(
            f"confidence is True, but a {type(model).__name__} is not the result of a fit; leave it out"
        )
    models, found = model.sample(_DRAWS, 0), {}
    for i, row in enumerate(rows):
        for j, column in enumerate(columns):
            band = band_of(models, omega, level, output=int(row), input=int(column))
            found[i, j] = band.magnitude, band.phase
    return found


def chosen_channels(what: str, given: Any, names: Sequence[str], most: int | None = None) -> Indices:
    """Numbers of the channels asked for, by number or name; by default the first ones."""
    if given is None:
        return np.arange(len(names) if most is None else min(len(names), most))
    listed = [given] if isinstance(given, str) or np.ndim(given) == 0 else list(given)
    known = f"there are {len(names)}: {', '.join(names[:6])}{', ..' * (len(names) > 6)}"
    if not listed:
        raise StructureError(f"{what} is empty; {known}")
    found = []
    for one in listed:
        if isinstance(one, str) and one in names:
            found.append(list(names).index(one))
        elif _checks.is_whole(one) and -len(names) <= one < len(names):
            found.append(int(one) % len(names))
        else:
            raise StructureError(f"{what} has {_checks.shown(one)}; {known}, counted from 0")
    return np.array(found, np.intp)


def _share(what: str, chosen: Indices, count: int) -> str:
    """What a title says of channels that are left out."""
    if len(chosen) == count:
        return ""
    if len(chosen) > 1 and (np.diff(chosen) == 1).all():
        return f"{what} {chosen[0] + 1} to {chosen[-1] + 1} of {count}"
    return f"{len(chosen)} of {count} {what}"


def _limits(source: ModelSource, measured: list[MeasuredMatrix], given: Any, unit: float) -> tuple[float, float]:
    """Ends of the axis: those given, those of tables, or of the modes as far as recordings reach."""
    if given is not None:
        low, high = checked_limits(given)
        return low * unit, high * unit
    tables = [one.omega for one in measured if not one.recorded and len(one.omega)]
    d = np.abs(source.poles) if len(source.poles) else np.ones(1)
    low, high = 0.5 * d[0], (1.25 if d[-1] <= _DECADES * d[0] else 2.0) * d[-1]
    recorded = [one.omega for one in measured if len(one.omega)]
    if tables:
        low, high = min(one[0] for one in tables), max(one[-1] for one in tables)
    elif recorded:
        low, high = max(low, min(one[0] for one in recorded)), min(high, max(one[-1] for one in recorded))
    high = min(high, source.nyquist)
    return (float(low), float(high)) if low < high else (0.5 * float(high), float(high))


def _grid(
    source: ModelSource, low: float, high: float, logarithmic: bool, response: Callable[[Array], ComplexArray]
) -> tuple[Array, Mask, Mask]:
    """Frequencies of the curves, which of them lie evenly, and which off peaks that are infinite or nearly so."""
    top = min(high, source.nyquist)
    floor = low if low > 0 else 1e-3 * high
    even = np.geomspace(floor, top, _LINE) if logarithmic else np.linspace(floor, top, _LINE)
    p = source.poles[source.poles.imag > 0]
    width = np.maximum(np.abs(p.real), NARROWEST * np.abs(p))
    around = (p.imag[:, None] + width[:, None] * _TURN).ravel()
    grid = np.unique(np.concatenate([even, around[(around >= floor) & (around <= top)]]))
    # antiresonances, which have no pole to tell where they are
    size = np.abs(response(grid)).reshape(-1, len(grid))
    k = np.unique(np.nonzero((size[:, 1:-1] < size[:, :-2]) & (size[:, 1:-1] < size[:, 2:]))[1] + 1)
    share = np.linspace(0.0, 1.0, _NOTCH + 2)[1:-1]
    notches = [grid[k + s] + share[:, None] * (grid[k + s + 1] - grid[k + s]) for s in (-1, 0)]
    # a sample on a pole of the axis is infinite
    grid = np.setdiff1d(np.concatenate([grid, *(one.ravel() for one in notches)]), p.imag[p.real == 0])
    sharp = p.imag[width <= NARROWEST * np.abs(p)]
    near = np.zeros(len(grid), bool)
    for w in sharp:
        near |= np.abs(grid - w) < 0.01 * w
    return grid, np.isin(grid, even) & ~near, ~near


def _phase_cut(response: ComplexArray) -> float:
    """Where the turn of the phases begins, in degrees: where the curves have the fewest, of about equals at -180."""
    usable = np.isfinite(response) & (response != 0)
    angle = np.degrees(np.angle(response[usable]))
    if not len(angle):
        return -180.0
    near = [np.count_nonzero(np.abs(np.mod(angle - cut + 180.0, 360.0) - 180.0) < 30.0) for cut in _CUTS]
    fewest = min(near)
    allowed = [cut for cut, count in zip(_CUTS, near, strict=True) if count <= fewest + 0.01 * len(angle)]
    return float(min(allowed, key=lambda cut: abs(cut + 180.0)))


def _gain_units(given: Any, numbers: FRFData) -> dict[int, str | None]:
    """Unit of the responses of each output, by its number."""
    if given is None:
        return dict(zip(map(int, numbers.outputs), numbers.gain_units, strict=True))
    if isinstance(given, str):
        return dict.fromkeys(map(int, numbers.outputs), given)
    units = _checks.labels(given, len(numbers.outputs), "outputs")
    return dict(zip(map(int, numbers.outputs), units, strict=True))


def _named(source: str, sensor: str, single: bool) -> str:
    """What a panel is called: without units, and without the only input where the name would not fit."""
    source, sensor = (parted(one)[0] for one in (source, sensor))
    name = f"{source} to {sensor}"
    name = sensor if single and len(name) > _LETTERS else name
    return name if len(name) <= _LETTERS else name[: _LETTERS - 1] + "…"


# --- drawing ---------------------------------------------------------------------------------------------------------


def _draw_response(pair: Any, numbers: FRFData, i: int, j: int, look: Look) -> list[list[Any]]:
    """Magnitude and phase of one response, and their scales; lines of both."""
    gain, angle = pair
    lines: list[list[Any]] = [[], []]
    frequency = numbers.omega / numbers.unit
    curve = {"label": plain(numbers.label), **MODEL_LINE, **look.line}
    for row, values in enumerate((decibels(numbers.response[i, j]), numbers.phase(i, j))):
        lines[row] += pair[row].plot(frequency, values, **curve)
    if numbers.bands:
        for axis, ends in zip(pair, (numbers.bands[i, j][0], numbers.phase_band(i, j)), strict=True):
            axis.fill_between(frequency, *ends, label=numbers.band_label, color=lines[0][0].get_color(), **BAND)
    for k, one in enumerate(numbers.measured):
        seen = (one.omega >= numbers.low) & (one.omega <= numbers.high) & np.isfinite(one.response[i, j])
        for row, values in enumerate((decibels(one.response[i, j]), numbers.measured_phase(k, i, j))):
            for which, style, label in (
                (seen & ~one.doubtful[i], DOTS, one.label), (seen & one.doubtful[i], _PALE, "coherence below 0.5")
            ):  # fmt: skip
                if which.any():
                    once = label if k == 0 or label != numbers.measured[0].label else "_"
                    at = one.omega[which] / numbers.unit
                    lines[row] += pair[row].plot(at, values[which], label=plain(once), rasterized=True, **style)
    gain.set_ylim(*numbers.levels(i, j))
    gain.yaxis.set_major_locator(MaxNLocator(nbins=5, steps=[1, 2, 4, 5, 10]))
    angle.set_ylim(*numbers.turn)
    quarters = numbers.response.shape[:2] == (1, 1) and numbers.turn[1] - numbers.turn[0] < 405.0
    angle.yaxis.set_major_locator(MultipleLocator(90.0 if quarters else 180.0))
    angle.yaxis.set_minor_locator(MultipleLocator(90.0))
    for axis in pair:
        axis.set_xscale("log" if numbers.logarithmic else "linear")
        axis.set_xlim(numbers.omega[0] / numbers.unit, numbers.high / numbers.unit)
        look.lattice(axis, minor="both" if numbers.logarithmic else "y")
    if numbers.response.shape[:2] != (1, 1):
        name = _named(numbers.input_labels[j], numbers.output_labels[i], numbers.response.shape[1] == 1)
        gain.set_title(plain(name), loc="left", fontsize="small", pad=2.0)
    return lines
