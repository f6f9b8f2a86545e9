"""Frequency responses estimated from records."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import control as ct
import numpy as np
from scipy import signal

from .. import _checks
from .._options import RESPONSE_INTERPOLATIONS, ResponseInterpolation
from .._types import Array, ComplexArray, Mask, SystemNames, Unpack
from .._units import common_unit, with_unit
from ..exceptions import StructureError
from .spectral_window import hold_response

_INPUT_FLOOR = 1e-6  # of the largest input power: 60 dB below it a bin holds the leakage of its neighbours
_SHORTEST = 8  # samples in a segment


class SpectralEstimate(ct.FrequencyResponseData):
    """Frequency response estimated from a record; made by `spectral_estimate`.

    A `control.FrequencyResponseData` of continuous time that remembers how far to trust it.

    Parameters
    ----------
    response : ndarray of complex, shape (N,)
        Estimated response.
    omega : ndarray, shape (N,)
        Angular frequencies, rad per unit time.
    coherence : ndarray, shape (N,)
        Part of the output power that is linear in the input, 0 to 1.
    segments : int
        Number of segments averaged.
    step : float
        Time between samples.
    window : pair (name, N), or None
        Window of the segments, and their samples; `pem` takes it from here.
    intersample : {'zoh', 'foh', 'bandlimited'}
        What the input did between samples.
    **names
        `name`, `inputs`, `outputs` as for `control.frd`.

    Examples
    --------
    >>> import numpy as np, control as ct, ph_control as phc
    >>> u = np.random.default_rng(0).standard_normal(1000)
    >>> estimate = phc.spectral_estimate(ct.TimeResponseData(0.1 * np.arange(1000), 3 * u, inputs=u, issiso=True))
    >>> estimate.segments, bool(np.allclose(estimate.coherence, 1))
    (8, True)
    """

    def __init__(
        self, response: ComplexArray, omega: Array, coherence: Array, segments: int, step: float,
        window: tuple[str, int] | None = None, intersample: str = "zoh", **names: Unpack[SystemNames],
    ) -> None:  # fmt: skip
        super().__init__(response, omega, dt=0, **names)
        self.coherence, self.segments, self.step = _checks.readonly(coherence), segments, step
        self.window, self.intersample = window, intersample

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__dict__.update(state)
        _checks.readonly(self.coherence)

    def __getitem__(self, key: Any) -> SpectralEstimate:
        """The entry that is selected, with all that is known of the estimate."""
        entry = super().__getitem__(key)
        names = {"inputs": entry.input_labels, "outputs": entry.output_labels}
        estimate = SpectralEstimate(
            entry.frdata, entry.omega, self.coherence, self.segments, self.step, self.window, self.intersample, **names
        )
        return with_unit(estimate, getattr(self, "time_unit", None))

    @property
    def nyquist(self) -> float:
        """Highest frequency that the record can show, `pi / step`, rad per unit time."""
        return float(np.pi / self.step)

    @property
    def relative_error(self) -> Array:
        """Standard deviation of the response relative to its size, shape (N,), by the coherence.

        That of the noise only: `sqrt((1 - c) / (2 c segments))`.  NaN for one segment, which tells nothing of it.
        """
        if self.segments < 2:
            return np.full(self.coherence.shape, np.nan)
        c = np.clip(self.coherence, np.finfo(float).tiny, 1.0)
        return np.sqrt((1.0 - c) / (2.0 * c * self.segments))


def spectral_estimate(
    data: ct.TimeResponseData, *, segments: int = 8, intersample: ResponseInterpolation = "zoh",
    **names: Unpack[SystemNames],
) -> SpectralEstimate:  # fmt: skip
    """Estimate a frequency response from a record of one input and one output.

    Parameters
    ----------
    data : control.TimeResponseData
        Record of T equally spaced samples.  NaN outputs are missing samples.
    segments : int
        Number of segments, each overlapping the next by half, to average over.  More segments: less noise and
        less frequency resolution.
    intersample : {'zoh', 'foh', 'bandlimited'}
        What the input did between samples: held, linear, or without any content beyond the Nyquist frequency.
    **names
        `name`, `inputs`, `outputs` as for `control.frd`; by default those of the record.

    Returns
    -------
    SpectralEstimate
        A `control.FrequencyResponseData` at the bins `2 pi k / (segment length * step)`, `k >= 2` and below the
        Nyquist frequency, that hold input power, with `coherence`, `relative_error`, `nyquist`.

    Raises
    ------
    StructureError
        If the record is not one of one input and one output, is not equally spaced, has NaN in its input, an input
        that is constant in all segments, or too few samples for them.

    Notes
    -----
    H1 estimator: cross spectrum over input spectrum, Hann window, mean of each segment removed.  Segments do not reach
    across missing samples.  Bins with less than 1e-6 of the largest input power are left out: leakage fills them.

    The response of a held ('zoh') or interpolated ('foh') input is divided by that of the hold, so that the phase of
    a lossless system is ±90 degrees up to the Nyquist frequency.  What folds back from beyond it remains in the
    magnitude: near the Nyquist frequency the estimate lies off the continuous-time response even without noise, mostly
    above it.

    A lossless mode never forgets, so a segment also shows the motion it began with: near a resonance the estimate is
    blunt, to about two bins on each side, and the coherence drops.  It is for looking, not for fitting.

    O(T log T).

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> mode = phc.ph(phc.modes(1.0, 1.0))
    >>> u = np.random.default_rng(1).standard_normal(4096)
    >>> estimate = phc.spectral_estimate(phc.forced_response(mode, 0.2 * np.arange(4096), u, intersample="zoh"))
    >>> G = estimate.complex[np.argmin(np.abs(estimate.omega - 3.0))]
    >>> bool(abs(G / mode(3j) - 1) < 0.05)
    True
    """
    u, y, step = _record(data)
    _checks.choice("intersample", intersample, RESPONSE_INTERPOLATIONS)
    _checks.signal_names(names, inputs=1, outputs=1)
    length = _segment_length(len(u), segments)
    pieces = [(u[None, part], y[None, part]) for part in _seen_segments(y, length)]
    omega, response, coherence = _estimate(pieces, step, intersample, impact=False)
    if not len(omega):
        raise StructureError(
            f"the input of the record is constant in all {len(pieces)} segments, or nearly so, and excites no "
            "frequency but 0; use fewer segments"
        )
    inherited = {"name": data.sysname, "inputs": data.input_labels, "outputs": data.output_labels}
    given = {key: value for key, value in inherited.items() if value} | {**names}
    estimate = SpectralEstimate(
        response[0, 0], omega, coherence[0], len(pieces), step, ("hann", length), intersample, **given
    )
    return with_unit(estimate, common_unit(data))


def _record(data: object) -> tuple[Array, Array, float]:
    """Input, output (NaN where missing) and step of a record."""
    if not isinstance(data, ct.TimeResponseData):
        raise StructureError(
            f"data is a {type(data).__name__}; pass a record as control.TimeResponseData(time, outputs, inputs=inputs)"
        )
    if data.u is None or data.ninputs != 1 or data.noutputs != 1 or data.ntraces > 1:
        raise StructureError(
            f"data have {data.ninputs} inputs, {data.noutputs} outputs and {max(1, data.ntraces)} traces; expected "
            "one of each: select first"
        )
    time, step = _checks.time_vector(data.t, name="the time of the record")
    u = _checks.real_array("the input of the record", data.u.reshape(-1))
    if len(time) < _SHORTEST:
        raise StructureError(f"the record has {len(time)} samples; a spectral estimate needs at least {_SHORTEST}")
    if np.ptp(u) <= len(u) * _checks.EPS * np.max(np.abs(u)):
        raise StructureError(f"the input of the record is constant ({u[0]:.6g}); it excites no frequency but 0")
    y = _checks.real_array("the output of the record", data.y.reshape(-1), missing=True)
    _checks.in_range("the input of the record", u, _checks.SMALLEST_SQUARED)
    _checks.in_range("the output of the record", y[~np.isnan(y)], _checks.SMALLEST_SQUARED)
    return u, y, step


def _segment_length(samples: int, segments: object) -> int:
    """Longest even length with which `segments` half-overlapping segments fit."""
    half = samples // (_checks.whole_number("segments", segments, 1) + 1)
    if 2 * half < _SHORTEST:
        raise StructureError(
            f"{segments} segments of a record of {samples} samples have {2 * half} samples each, expected {_SHORTEST}; "
            f"use at most {2 * samples // _SHORTEST - 1} segments"
        )
    return 2 * half


def _seen_segments(y: Array, length: int) -> list[slice]:
    """Segments of this length, each overlapping the next by half, that do not reach across missing samples."""
    edges = np.flatnonzero(np.diff(np.isfinite(y), prepend=False, append=False))
    longest = int(np.diff(edges)[::2].max(initial=0))
    if longest < length:
        raise StructureError(
            f"the longest stretch of the output without missing samples has {longest} samples, a segment {length}; "
            "use more segments, or fill the gaps"
        )
    starts = [range(*stretch, length // 2) for stretch in zip(edges[0::2], edges[1::2] - length + 1, strict=True)]
    return [slice(start, start + length) for stretch in starts for start in stretch]


# --- several channels ------------------------------------------------------------------------------------------------


def response_matrix_estimate(
    records: Sequence[tuple[Array, Array, float]], segments: int, intersample: str
) -> tuple[Array, ComplexArray, Array]:
    """Frequencies (K,), responses (p, m, K) and multiple coherence (p, K) of records `(u (m, T), y (p, T), step)`.

    H1 estimator, all records together: cross spectra of outputs and inputs times the inverse of the spectra of the
    inputs, of Hann windows; of inputs that rest for nine tenths of a record, as those of hammers, of the whole record
    as it is.  Segments with NaN in an output are left out of it; NaN is what remains unknown, where inputs hold too
    little power or move alike.
    """
    steps = {step for _, _, step in records}
    if len(steps) > 1:
        raise StructureError(f"the records have steps {', '.join(f'{step:g}' for step in sorted(steps))}; expected one")
    step, shortest = steps.pop(), min(u.shape[1] for u, _, _ in records)
    impact = all(rests(u) for u, _, _ in records)
    length = shortest if impact else _segment_length(shortest, segments)
    gap = length if impact else length // 2
    places = [(u, y, range(0, u.shape[1] - length + 1, gap)) for u, y, _ in records]
    pieces = [(u[:, k : k + length], y[:, k : k + length]) for u, y, starts in places for k in starts]
    return _estimate(pieces, step, intersample, impact)


def _estimate(
    pieces: Sequence[tuple[Array, Array]], step: float, intersample: str, impact: bool
) -> tuple[Array, ComplexArray, Array]:
    """As `response_matrix_estimate`, of pieces of records of one length."""
    spectra = [_segment_spectra(u, y, impact) for u, y in pieces]
    Suu, Syu, Syy = (np.moveaxis(np.sum(segments, axis=0), -1, 0) for segments in zip(*spectra, strict=True))
    omega = 2.0 * np.pi * np.arange(len(Suu)) / (pieces[0][0].shape[1] * step)
    power = np.einsum("kpii->kpi", Suu).real
    # inputs that never moved while an output was seen
    present = power.max(axis=0) > 0
    Suu = Suu + np.where(present, 0.0, power.max())[..., None] * np.eye(power.shape[-1])
    sizes = np.linalg.eigvalsh(Suu)[..., 0]
    known = sizes > _INPUT_FLOOR * sizes[1:].max(axis=0)
    # the window spreads the mean that each segment lost over the first two bins; the last is real by construction
    known[[0, -1] if impact else [0, 1, -1]] = False
    kept = known.any(axis=1)
    omega, Suu, Syu, Syy, known = omega[kept], Suu[kept], Syu[kept], Syy[kept], known[kept]
    # G Suu = Syu
    Suu = np.where(known[..., None, None], Suu, np.eye(Suu.shape[-1]))
    response = np.linalg.solve(np.swapaxes(Suu, 2, 3), Syu[..., None])[..., 0]
    explained = np.sum(response * Syu.conj(), axis=2).real
    coherence = np.clip(explained / np.where(Syy > 0, Syy, 1.0), 0.0, 1.0)
    hold = hold_response(omega * step, intersample)
    response = np.where(known[..., None] & present, response / hold[:, None, None], np.nan)
    return omega, np.moveaxis(response, 0, -1), coherence.T


def rests(u: Array) -> bool:
    """Whether the inputs are at rest for nine tenths of a record."""
    return bool(np.mean((np.abs(u) > 0.01 * np.max(np.abs(u))).any(axis=0)) < 0.1)


def _segment_spectra(u: Array, y: Array, whole: bool) -> tuple[ComplexArray, ComplexArray, Array]:
    """Spectra (p, m, m, K) of the inputs, (p, m, K) of outputs and inputs, (p, K) of outputs; 0 of those with gaps."""
    seen: Mask = np.logical_not(np.isnan(y).any(axis=1))
    y = np.where(seen[:, None], y, 0.0)
    if not whole:
        window = signal.get_window("hann", u.shape[1])
        # what the mean of a constant input rounds would pass for its motion
        still = np.ptp(u, axis=1) <= u.shape[1] * _checks.EPS * np.max(np.abs(u), axis=1)
        u = np.where(still[:, None], 0.0, u)
        u, y = ((signal - signal.mean(axis=1, keepdims=True)) * window for signal in (u, y))
    U, Y = np.fft.rfft(u), np.fft.rfft(y)
    return seen[:, None, None, None] * (U[:, None] * U[None].conj()), Y[:, None] * U[None].conj(), np.abs(Y) ** 2
