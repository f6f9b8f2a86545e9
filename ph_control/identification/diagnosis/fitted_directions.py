"""The directions in which a fit has adapted to its data: what noise has along them is missing from the residuals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ... import _checks
from ..._types import Array, ComplexArray, Mask
from ...modal.discretization import Hold
from ..data.channels import Recording
from ..data.frequency_record import FrequencyRecord, InFrequency
from ..data.time_record import Record
from ..regression.free import by_poles
from ..regression.frequency_rows import modal_columns
from ..regression.time_rows import FreeRecord, RecordRows


@dataclass(frozen=True)
class Directions:
    """Derivatives of an output by what was fitted, one column each: to all experiments, and to this one alone."""

    shared: NDArray[Any]
    local: NDArray[Any]


def same_data(one: Any, other: Any) -> bool:
    """Whether two experiments are one."""
    if one is other:
        return True
    if isinstance(one, InFrequency) and isinstance(other, InFrequency):
        return np.array_equal(one.omega, other.omega) and np.array_equal(one.response, other.response, equal_nan=True)
    if not (isinstance(one, Record | Recording) and isinstance(other, Record | Recording)):
        return False
    return (
        one.samples == other.samples
        and one.driven == other.driven
        and abs(one.dt - other.dt) <= _checks.EPS * one.samples * one.dt
        and np.array_equal(one.u, other.u)
        and np.array_equal(one.y, other.y, equal_nan=True)
    )


def of_response(record: FrequencyRecord, d: Array, kappa: Array, weighted: Mask, quantity: str) -> Directions:
    """Of a frequency response, complex."""
    columns, slopes = modal_columns(d, record.omega, quantity)
    return Directions(np.concatenate([kappa[:, None] * slopes, columns[weighted]]).T, np.zeros((record.samples, 0)))


def of_record(
    record: Record, d: Array, kappa: Array, free: ComplexArray, weighted: Mask, moving: Mask, hold: Hold, quantity: str,
    offset: int,
) -> Directions:  # fmt: skip
    """Of a record in time, with free amplitudes at the output; O(T n), and as much memory.

    `weighted` are the modes whose residue is not held at 0, `moving` those whose free motion was estimated.
    """
    rows = RecordRows(record.u, record.y, record.observed, hold, quantity=quantity)
    # without an input the forced columns are 0
    by_d, forced, cosine, sine = np.split(rows.sensitivities(d, kappa, free), 4, axis=1)
    parts = [cosine[:, moving], sine[:, moving]] if free.any() else []
    parts.append(np.arange(float(record.samples))[:, None] ** np.arange(offset))
    return Directions(np.concatenate([by_d, forced[:, weighted]], axis=1), np.concatenate(parts, axis=1))


def of_damped_response(record: FrequencyRecord, p: ComplexArray, rho: ComplexArray, delay: float = 0.0) -> Directions:
    """Of a frequency response and damped modes with residues (n,), complex."""
    s, late = 1j * record.omega, np.exp(-1j * record.omega * delay)
    ahead, behind = late / (s - p[:, None]), late / (s - p[:, None].conj())
    slopes, mirrored = rho[:, None] * ahead**2 / late, rho.conj()[:, None] * behind**2 / late
    pairs = ((ahead, behind), (slopes, mirrored))
    columns = [part for one, other in pairs for part in (one + other, 1j * (one - other))]
    return Directions(np.concatenate(columns).T, np.zeros((record.samples, 0)))


def of_damped_record(
    record: Record, p: ComplexArray, rho: ComplexArray, free: ComplexArray, hold: Hold, offset: int, through: bool,
    delay: float = 0.0,
) -> Directions:  # fmt: skip
    """Of a record in time and damped modes with residues and free amplitudes (n,); O(T n), and as much memory."""
    u, everywhere, n = record.u[None], np.ones(record.samples, bool), len(p)
    whole = FreeRecord(u, 0 * u, everywhere, hold, offset=offset, through=through, driven=record.driven)
    rows = whole.delayed(delay)
    # what is not predicted depends on nothing
    columns = np.nan_to_num(rows.placed(np.concatenate(list(rows.at(p).blocks()), axis=1)))
    own, shared = rows.own_unknowns(n), rows.inputs * (2 * n + through)
    motion = np.concatenate([0.5 * free.real, 0.5 * free.imag])
    moved = by_poles(columns[own + shared : -1].T, rows, motion, rho[:, None])  # motions at the first sample, nearly
    return Directions(np.concatenate([columns[own : own + shared].T, moved], axis=1), columns[:own].T)
