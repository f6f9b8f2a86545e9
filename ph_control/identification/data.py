"""Measured records, checked once: the only form of data the identification sees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from control import TimeResponseData
from numpy.typing import NDArray

from .. import _checks
from ..exceptions import IdentificationError, StructureError

Array = NDArray[np.float64]

_LARGEST = 1e100  # of a signal whose squares are summed


@dataclass(frozen=True)
class Record:
    """One input and one output on a uniform grid; NaN outputs are missing samples."""

    time: Array
    dt: float
    u: Array
    y: Array
    input_label: str = "u"
    output_label: str = "y"

    @property
    def samples(self) -> int:
        """Number of instants T."""
        return len(self.time)

    @property
    def observed(self) -> NDArray[np.bool_]:
        """Where the output was measured."""
        return ~np.isnan(self.y)

    def as_response(self) -> TimeResponseData:
        """Return the record as python-control keeps one."""
        return TimeResponseData(
            self.time, self.y, inputs=self.u, issiso=True, input_labels=[self.input_label],
            output_labels=[self.output_label], title="Recording",
        )  # fmt: skip


def as_record(data: Any, dt: float | None = None, *, output_needed: bool = True) -> Record:
    """Make a `Record` of `(u, y)` with `dt`, or of a `control.TimeResponseData`; nothing of it is modified."""
    if isinstance(data, Record):
        return data
    if isinstance(data, TimeResponseData):
        return _from_response(data, dt)
    if not (isinstance(data, tuple | list) and len(data) == 2):
        raise StructureError(
            f"data is a {type(data).__name__}; pass a control.TimeResponseData, or the pair (u, y) together with dt"
        )
    if dt is None:
        raise StructureError("dt is missing: with arrays (u, y) give dt, the time between samples")
    step = _checks.sampling_step(dt)
    u = _signal("the input", data[0])
    if data[1] is None and not output_needed:
        y = np.full(len(u), np.nan)
    else:
        y = _signal("the output", data[1], missing=True)
    return _checked(step * np.arange(float(len(u))), step, u, y, "u", "y")


def _from_response(data: TimeResponseData, dt: float | None) -> Record:
    if data.ninputs == 0:
        raise StructureError(
            "the record has no input; pem needs one that varies (the free motion is estimated along with it)"
        )
    if data.ntraces > 1 or data.ninputs != 1 or data.noutputs != 1:
        raise StructureError(
            f"the record has {data.ninputs} inputs, {data.noutputs} outputs and {max(1, data.ntraces)} traces; "
            "needed one of each: select them before fitting"
        )
    time, step = _checks.time_vector(data.time, name="the time of the record")
    if len(time) > 1 and dt is not None and abs(_checks.sampling_step(dt) - step) > 0.01 * step:
        raise StructureError(f"dt = {dt:g} contradicts the time of the record, whose step is {step:.6g}; leave dt out")
    u = _signal("the input", np.reshape(data.u, -1))
    y = _signal("the output", np.reshape(data.y, -1), missing=True)
    labels = [
        names[0] if names else default for names, default in ((data.input_labels, "u"), (data.output_labels, "y"))
    ]
    return _checked(time, step, u, y, *labels)


def _signal(name: str, value: Any, *, missing: bool = False) -> Array:
    """A vector of numbers; a single column or row counts as one.  Masked outputs are missing."""
    if isinstance(value, np.ma.MaskedArray):
        if missing and value.dtype.kind in "biuf":
            value = np.where(np.ma.getmaskarray(value), np.nan, value.data)
        elif np.ma.getmaskarray(value).any():
            where = int(np.argmax(np.ma.getmaskarray(value).ravel()))
            raise StructureError(f"{name} is masked at sample {where}; every sample is needed")
    try:
        array = np.asarray(value, dtype=float) if np.asarray(value).dtype.kind in "biuf" else None
    except ValueError:
        array = None
    if array is None:
        array = _checks.real_array(name, value)
    if array.ndim == 2 and 1 in array.shape:
        array = array.ravel()
    if array.ndim != 1:
        raise StructureError(f"{name} has shape {array.shape}; needed one signal of shape (T,)")
    array = array.copy()
    if missing:
        infinite = np.isinf(array)
        if infinite.any():
            raise StructureError(
                f"{name} is infinite at sample {int(np.argmax(infinite))}; mark missing samples with NaN"
            )
    else:
        _checks.finite(name, array)
    return array


def _checked(time: Array, dt: float, u: Array, y: Array, input_label: str, output_label: str) -> Record:
    if len(u) != len(y):
        raise StructureError(f"the input has {len(u)} samples and the output {len(y)}; they must be of one length")
    if len(u) < 2:
        raise IdentificationError(f"the record has {len(u)} sample{'s' * (len(u) != 1)}; a fit needs at least 5")
    for name, signal in (("input", u), ("output", y)):
        size = float(np.nanmax(np.abs(signal), initial=0.0))
        if size and not 1 / _LARGEST < size < _LARGEST:
            raise StructureError(
                f"the {name} is of size {size:.3g}, and its square is near the end of the range of doubles; allowed is "
                f"{1 / _LARGEST:g} to {_LARGEST:g}: choose another unit"
            )
    for array in (time, u, y):
        _checks.readonly(array)
    return Record(time, dt, u, y, input_label, output_label)
