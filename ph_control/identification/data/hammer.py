"""Forces of a hammer: outside its contacts they are 0, and what the channel shows there is noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..._types import Array
from .time_record import CheckedData, InTime, is_long

_CLEAR = 100.0  # of the noise: the peak of a hit
_SEEN = 6.0  # of the noise: samples of a contact
_SHORT = 0.02  # of a record: all its contacts
_LEAST = 5  # samples of the ringing of a filter on either side of a contact
_NORMAL = 1.6449  # of the standard deviation: nine in ten values of normal noise are within


def contacts_alone(records: Sequence[CheckedData]) -> tuple[tuple[Any, ...], float, float] | None:
    """Recordings with the forces of hammers 0 outside contacts; None if there is no such force with noise.

    Parameters
    ----------
    records : sequence of Record, Recording, FrequencyRecord or ResponseMatrix
        What was measured.

    Returns
    -------
    changed : tuple
        The records, new where they are changed.
    noise, peak : float
        Standard deviation of the noise of the first such force, and its largest value.

    Notes
    -----
    A contact is where a force exceeds its noise by far, and as many samples again on either side; contacts are a small
    part of the record.  The median is the offset of the channel.  One pass over the inputs, which are not long.
    """
    if is_long(records):
        return None
    sizes: list[tuple[float, float]] = []
    changed = [_changed(record, sizes) if isinstance(record, InTime) else record for record in records]
    return (tuple(changed), *sizes[0]) if sizes else None


def _changed(record: Any, sizes: list[tuple[float, float]]) -> Any:
    rows = np.atleast_2d(np.asarray(record.u, float))
    hits = [_of_contacts(row) for row in rows]
    if all(force is None for force, *_ in hits):
        return record
    sizes += [(noise, peak) for force, noise, peak in hits if force is not None]
    forces = np.array([row if force is None else force for row, (force, *_) in zip(rows, hits, strict=True)])
    return replace(record, u=forces.reshape(np.shape(record.u)))


def _of_contacts(force: Array) -> tuple[Array | None, float, float]:
    """Force that is 0 outside contacts, None if there are none, with its noise and peak."""
    beside = force - np.median(force)
    size = np.abs(beside)
    noise, peak = float(np.quantile(size, 0.9)) / _NORMAL, float(size.max())
    seen = size > _SEEN * noise
    if noise == 0 or peak < _CLEAR * noise or seen.sum() > _SHORT * len(force):
        return None, noise, peak
    starts, stops = np.flatnonzero(np.diff(seen.astype(int), prepend=0, append=0)).reshape(-1, 2).T
    width = max(_LEAST, int((stops - starts).max()))
    alone = np.zeros(len(force))
    for first, last in zip(np.maximum(starts - width, 0), stops + width, strict=True):
        alone[first:last] = beside[first:last]
    return alone, noise, peak
