"""The directions in which a fit has adapted to its data: what noise has along them is missing from the residuals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ... import _checks
from ..._options import Discretisation, Interpolation
from ..._types import Array, ComplexArray, RealOrComplex
from ...modal.discretization import Hold
from ..data.channels import Recording
from ..data.frequency_record import InFrequency
from ..data.time_record import Record
from ..regression.free import pole_derivatives
from ..regression.frequency_rows import FreeResponse, terms_in
from ..regression.spectral_rows import stacked
from ..regression.time_rows import FreeRecord


@dataclass(frozen=True)
class Directions:
    """Derivatives of an output by what was fitted, one column each: to all experiments, and to this one alone."""

    shared: RealOrComplex
    local: RealOrComplex


@dataclass(frozen=True)
class FittedModel:
    """What the directions of a fit depend on, under the names of a `PEMResult`, which may stand for it."""

    poles: ComplexArray
    residues: ComplexArray
    feedthrough: Array
    covariance: Array
    delay: Array
    quantities: tuple[str, ...]
    method: Discretisation
    intersample: Interpolation


def directions_of(data: Any, model: Any) -> Directions:
    """Directions in which a model of one input and one output was fitted to one of its experiments."""
    if isinstance(data.record, InFrequency):
        return _of_response(data, model)
    return _of_record(data, model)


def same_data(experiment: object, other: object) -> bool:
    """Whether two experiments hold the same data."""
    if experiment is other:
        return True
    if isinstance(experiment, InFrequency) and isinstance(other, InFrequency):
        return np.array_equal(experiment.omega, other.omega) and np.array_equal(
            experiment.response, other.response, equal_nan=True
        )
    if not (isinstance(experiment, Record | Recording) and isinstance(other, Record | Recording)):
        return False
    return (
        experiment.samples == other.samples
        and experiment.driven == other.driven
        and abs(experiment.dt - other.dt) <= _checks.EPS * experiment.samples * experiment.dt
        and np.array_equal(experiment.u, other.u)
        and np.array_equal(experiment.y, other.y, equal_nan=True)
    )


def _of_response(data: Any, result: Any) -> Directions:
    """Directions of a fit of one input and one output to a frequency response, complex, with its background."""
    record, p = data.record, result.poles
    rho = result.residues[:, 0, 0] * np.where(p.imag == 0, 0.5, 1.0)
    terms = () if data.background is None else terms_in(data.background.coefficients)
    every = np.ones(record.samples)
    rows = FreeResponse(
        record.omega, record.response[None], every, every > 0, result.quantities[0], terms=terms, window=record.window
    )
    peaks = rows.peaks(p)
    slopes = stacked((rho[:, None] * peaks.slopes[0], rho.conj()[:, None] * peaks.slopes[1]))
    late = np.exp(-1j * record.omega * result.delay[0])
    columns = late * np.concatenate([slopes, stacked((peaks.pole_term, peaks.conjugate_term))])
    return Directions(columns.T @ _tangent(result)[: len(columns)], (late * rows.background).T)


def _of_record(data: Any, result: Any) -> Directions:
    """Directions of a fit of one input and one output to a record in time; O(T n), and as much memory."""
    record, p, n = data.record, result.poles, len(result.poles)
    # a real pole has two halves; without an input there are no residues
    rho = result.residues[:, 0].sum(axis=1) * np.where(p.imag == 0, 0.5, 1.0)
    hold, offset = Hold(record.dt, result.method, result.intersample), int(np.isfinite(data.offset_stderr))
    offset += data.drift != 0
    everywhere, u = np.ones(record.samples, bool), record.u[None]
    through = bool(result.feedthrough.any())
    whole = FreeRecord(u, 0 * u, everywhere, hold, offset=offset, through=through, driven=record.driven)
    rows = whole.delayed(float(result.delay[0]))
    # what is not predicted depends on nothing
    columns = np.nan_to_num(rows.placed(np.concatenate(list(rows.evaluated(p).blocks()), axis=1)))
    own, shared = rows.own_unknowns(n), rows.inputs * (2 * n + through)
    motion = 0.5 * np.concatenate([data.free_amplitudes.real, data.free_amplitudes.imag])
    # motions at the first sample, nearly
    moved = pole_derivatives(columns[own + shared : -1].T, rows, motion, rho[:, None])
    # by real, then imaginary parts of the poles, the residues, and what is fed through
    every = np.concatenate([moved[:, n:], moved[:, :n], columns[own : own + shared].T], axis=1)
    moves = data.free_amplitudes.any() or not record.driven
    return Directions(every @ _tangent(result)[: every.shape[1]], columns[:own].T if moves else columns[2 * n : own].T)


def _tangent(result: Any) -> Array:
    """Basis of the directions that the structure allows, in real and imaginary parts of poles and residues, and D."""
    n, p = len(result.poles), result.poles
    d, zeta = np.abs(p), -p.real / np.where(p == 0, 1.0, np.abs(p))
    known = ~np.isnan(np.diag(result.covariance))
    covariance = np.where(known[:, None] & known, result.covariance, 0.0)
    sizes = np.sqrt(np.maximum(np.diag(covariance), 0.0))  # rounding may leave less than nothing
    scale = np.where(sizes > 0, sizes, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    basis = scale[:, None] * vectors[:, values > len(values) * _checks.EPS * values.max(initial=0.0)]
    turn, l = np.sqrt(np.maximum(1 - zeta**2, 0.0)), np.arange(n)
    J = np.zeros((len(basis), len(basis)))
    J[l, l], J[l, n + l] = -zeta, -d
    J[n + l, l] = turn
    J[n + l, n + l] = np.where(turn > 0, -d * zeta / np.where(turn > 0, turn, 1.0), 0.0)
    rest = np.arange(2 * n, len(basis))
    half = np.append(np.tile(np.where(p.imag == 0, 0.5, 1.0), 2), np.ones(max(0, len(rest) - 2 * n)))[: len(rest)]
    J[rest, rest] = half
    moved = J @ basis
    lengths = np.linalg.norm(moved, axis=0)
    return np.asarray(moved / np.where(lengths > 0, lengths, 1.0))
