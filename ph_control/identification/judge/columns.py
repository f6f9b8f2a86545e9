"""Mistakes in the choice of columns: the same one twice, or input and output exchanged."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from ..._types import Array
from ..data.channels import Recording
from ..data.time_record import blocks
from ..search.findings import Cause, Finding

_SAME = 1e-12  # share of the power by which two columns may differ, as rounding in print makes them
_BROAD = 0.4  # flatness of the spectrum of a test signal
_RESONANT = 4.0  # times flatter than what answers to it
_BLOCKS = 16  # of a record, over which its spectrum is averaged


def same_columns(records: Sequence[object]) -> list[Finding]:
    """Pairs of channels that are the same in all recordings, up to a factor."""
    recordings = [record for record in records if isinstance(record, Recording)]
    if not recordings or len(recordings) < len(records):
        return []
    labels = (*recordings[0].input_labels, *recordings[0].output_labels)
    products = np.zeros((len(labels), len(labels)))
    for record in recordings:
        for part in blocks(record.samples, len(labels)):
            signals = np.concatenate([record.u[:, part], record.y[:, part]])
            signals = signals[:, np.isfinite(signals).all(axis=0)]
            products += signals @ signals.T
    powers = np.diag(products)
    findings = []
    for j, k in combinations(range(len(labels)), 2):
        if powers[j] > 0 and powers[k] > 0:
            factor = products[j, k] / powers[j]
            if powers[k] - factor * products[j, k] <= _SAME * powers[k]:
                findings.append(Finding(Cause.SAME_COLUMNS, (float(factor),), 0.0, f"{labels[j]!r} and {labels[k]!r}"))
    return findings


def swapped_columns(records: Sequence[object]) -> list[Finding]:
    """Input and output of recordings of one each, where the output is broad and the input resonates."""
    findings = []
    for record in records:
        if isinstance(record, Recording) and len(record.u) == len(record.y) == 1 and np.isfinite(record.y).all():
            into, out = _flatness(record.u[0]), _flatness(record.y[0])
            if out > max(_BROAD, _RESONANT * into):
                names = f"{record.input_labels[0]!r}"
                findings.append(Finding(Cause.SWAPPED, (into, out), 0.0, names))
    return findings if len(findings) == len(records) else []


def _flatness(signal: Array) -> float:
    """Geometric over arithmetic mean of the spectrum, 1 for white noise; averaged over blocks."""
    length = len(signal) // _BLOCKS
    if length < 8:
        return 0.1  # neither broad nor resonant
    blocks = (signal - signal.mean())[: _BLOCKS * length].reshape(_BLOCKS, length) * np.hanning(length)
    spectrum = np.mean(np.abs(np.fft.rfft(blocks, axis=1)[:, 1:-1]) ** 2, axis=0)
    if not spectrum.all():
        return 0.0
    return float(np.exp(np.mean(np.log(spectrum))) / np.mean(spectrum))
