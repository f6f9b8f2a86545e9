"""What the picture of a fit shows, as numbers: signals of one length, and the part of them to enlarge."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _checks
from ..analysis.spectral_estimate import gapped_array
from ..exceptions import StructureError

Array = NDArray[np.float64]

_FEW_PERIODS = 10  # that are seen in the whole record
_DETAIL_PERIODS = 8
_DETAIL_SAMPLES = (80, 1000)  # at least, if the record allows it, and where the strongest motion is slower than that


@dataclass(frozen=True)
class FitData:
    """Signals of one length, and the samples to enlarge."""

    time: Array
    measured: Array
    predicted: Array
    detail: slice | None

    @property
    def residual(self) -> Array:
        """What the prediction leaves."""
        return self.measured - self.predicted

    @property
    def residual_rms(self) -> float:
        """Root of its mean square."""
        return float(np.sqrt(np.nanmean(self.residual**2)))


def fit_data(time: ArrayLike, measured: ArrayLike, predicted: ArrayLike, detail: Any) -> FitData:
    """Check the signals of a fit and choose what to enlarge; the arguments are those of `fit_plot`."""
    t = _checks.real_array("the time", time, 1)
    y, p = gapped_array("the measured output", measured), gapped_array("the predicted output", predicted)
    if not len(t) == len(y) == len(p):
        raise StructureError(
            f"the time has {len(t)} samples, the measured output {len(y)} and the predicted output {len(p)}; "
            "they must be of one length"
        )
    if np.any(np.diff(t) <= 0):
        k = int(np.argmax(np.diff(t) <= 0))
        raise StructureError(
            f"the time does not increase: samples {k} and {k + 1} are at {t[k]:.9g} and {t[k + 1]:.9g}"
        )
    if not np.isfinite(y - p).any():
        raise StructureError("no sample has a measured and a predicted output; there is nothing to compare")
    if detail is None:
        return FitData(t, y, p, None)
    if isinstance(detail, str):
        _checks.choice("detail", detail, ("auto",))
        return FitData(t, y, p, strongest_part(y, y - p))
    return FitData(t, y, p, chosen_part(t, detail))


def percent(fit: float) -> str:
    """Text of a fit; never rounded up to a perfect one, nor wider than it can be read."""
    if 99.995 <= fit < 100.0:
        return "above 99.99 %"
    return f"{fit:.2f} %" if fit > -1e4 else f"{fit:.3g} %"


def strongest_part(measured: Array, residual: Array) -> slice | None:
    """A few periods of the strongest oscillation, where the residual is largest; None if the record has few itself."""
    known = np.isfinite(measured)
    signal = np.where(known, measured - np.mean(measured[known]), 0.0)
    periods = int(np.argmax(np.abs(np.fft.rfft(signal))))
    least, most = _DETAIL_SAMPLES
    if periods > _FEW_PERIODS:
        count = min(max(least, _DETAIL_PERIODS * len(signal) // periods), len(signal) // 3)
    elif 3 * most <= len(signal):
        count = most
    else:
        return None
    power = np.cumsum(np.concatenate([[0.0], np.nan_to_num(residual) ** 2]))
    start = int(np.argmax(power[count:] - power[:-count]))
    return slice(start, start + count)


def chosen_part(time: Array, detail: Any) -> slice:
    """Samples between the two instants that the user asked to see enlarged."""
    ends = _checks.real_array("detail", detail, 1)
    if len(ends) != 2:
        raise StructureError(f"detail has {len(ends)} entries; give the first and the last instant to enlarge")
    start, stop = (int(k) for k in (np.searchsorted(time, ends[0]), np.searchsorted(time, ends[1], side="right")))
    if stop - start < 2:
        raise StructureError(
            f"detail from {ends[0]:.6g} to {ends[1]:.6g} holds {max(0, stop - start)} samples of the record, which "
            f"reaches from {time[0]:.6g} to {time[-1]:.6g}; needed at least 2"
        )
    return slice(start, stop)
