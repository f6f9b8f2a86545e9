"""Forces of a hammer: outside its contacts they are 0, and what the channel shows there is noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..._types import Array
from .time_record import CheckedData, InTime, is_long

_CLEAR = 100.0  # of the noise: the peak of a hit
_SEEN = 6.0  # of the noise: samples of a contact
_SHORT = 0.02  # of a record: all its contacts
_LEAST = 5  # samples of the ringing of a filter on either side of a contact
_NORMAL = 1.6449  # of the standard deviation: nine in ten values of normal noise are within


@dataclass(frozen=True, eq=False)
class Hits:
    """Recordings with the forces of hammers 0 outside contacts.

    Attributes
    ----------
    records : tuple
        All records, new where a force was changed.
    spreads : tuple of ndarray or None
        Standard deviation (m, T) of the noise that forces have in contacts, 0 elsewhere; None of records unchanged.
    noise, peak : float
        Standard deviation of the noise of the first such force, and its largest value.
    """

    records: tuple[Any, ...]
    spreads: tuple[Array | None, ...]
    noise: float
    peak: float

    @classmethod
    def of(cls, records: Sequence[CheckedData]) -> Hits | None:
        """Hits of hammers whose channels have noise; None if there are none, or records are long.

        A contact is where a force exceeds its noise by far, and as many samples again on either side; contacts are a
        small part of the record.  The median is the offset of the channel.  One pass over the inputs.
        """
        if is_long(records):
            return None
        sizes: list[tuple[float, float]] = []
        changed = [_changed(record, sizes) if isinstance(record, InTime) else (record, None) for record in records]
        if not sizes:
            return None
        return cls(tuple(record for record, _ in changed), tuple(spread for _, spread in changed), *sizes[0])

    @property
    def samples(self) -> int:
        """Number of samples of all contacts c."""
        return sum(int(np.sum(spread > 0)) for spread in self.spreads if spread is not None)

    @property
    def responses(self) -> int:
        """Numbers in the responses of the outputs of a record to each sample of its contacts, at most."""
        pairs = zip(self.records, self.spreads, strict=True)
        return max(int(np.sum(spread > 0)) * record.y.size for record, spread in pairs if spread is not None)

    def corrected(self, errors: Array) -> tuple[Any, ...]:
        """The records with errors (c,) added to the samples of their contacts, in units of their standard deviation."""
        records, done = [], 0
        for record, spread in zip(self.records, self.spreads, strict=True):
            if spread is not None:
                added, count = np.zeros(spread.shape), int(np.sum(spread > 0))
                added[spread > 0] = spread[spread > 0] * errors[done : done + count]
                record, done = replace(record, u=record.u + added.reshape(np.shape(record.u))), done + count
            records.append(record)
        return tuple(records)


def _changed(record: Any, sizes: list[tuple[float, float]]) -> tuple[Any, Array | None]:
    hits = [_of_contacts(row) for row in np.atleast_2d(np.asarray(record.u, float))]
    forces, spreads = (np.array([hit[k] for hit in hits]) for k in (0, 1))
    if not spreads.any():
        return record, None
    sizes += [(float(spread.max()), peak) for _, spread, peak in hits if spread.any()]
    return replace(record, u=forces.reshape(np.shape(record.u))), spreads


def _of_contacts(force: Array) -> tuple[Array, Array, float]:
    """Force that is 0 outside contacts, if there are any, with its noise within them and its peak."""
    beside = force - np.median(force)
    size = np.abs(beside)
    noise, peak = float(np.quantile(size, 0.9)) / _NORMAL, float(size.max())
    seen = size > _SEEN * noise
    if noise == 0 or peak < _CLEAR * noise or seen.sum() > _SHORT * len(force):
        return force, np.zeros(len(force)), peak
    starts, stops = np.flatnonzero(np.diff(seen.astype(int), prepend=0, append=0)).reshape(-1, 2).T
    width = max(_LEAST, int((stops - starts).max()))
    alone = np.zeros(len(force))
    for first, last in zip(np.maximum(starts - width, 0), stops + width, strict=True):
        alone[first:last] = beside[first:last]
    return alone, noise * (alone != 0), peak
