"""What a model of any kind says of a measured frequency response."""

from __future__ import annotations

from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray

from ...exceptions import StructureError
from ...modal.modal_form import ModalForm
from ...systems.base import LosslessSystem
from ...systems.port_hamiltonian import ph
from ..data.frequency_record import FrequencyRecord
from ..diagnosis.fitted_directions import Directions
from ..fit.result import PEMResult
from ..regression.frequency_rows import modal_columns
from .simulation import Simulation, fitted_directions, one_port, own_place, refuse_unknown_model

ComplexArray = NDArray[np.complex128]

_ROUNDING = 1e-9  # relative: a frequency at the Nyquist frequency may round beyond it


def respond_to(model: Any, label: str, record: FrequencyRecord) -> Simulation:
    """Response of a `PEMResult`, a system of this package, or a linear system at the frequencies of a record."""

    def nothing() -> Directions:
        return Directions(*np.zeros((2, record.samples, 0)))

    if isinstance(model, PEMResult):
        place = own_place(model, record)
        if place is not None:
            return Simulation(model.experiments[place].predicted, lambda: fitted_directions(model, place), True)
        live = model.r > 0
        _refuse_poles(label, record, np.isin(record.omega, model.d[live]))
        columns, _ = modal_columns(model.d[live], record.omega, model.quantity)
        return Simulation(np.asarray(model.modes.kappa[live] @ columns), nothing)
    system = ph(model) if isinstance(model, ModalForm) else model
    if not isinstance(system, LosslessSystem):
        refuse_unknown_model(system, label)
    one_port(label, system.ninputs, system.noutputs, "response")
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        response = np.asarray(system.horner(_places(system, label, record), warn_infinite=False))[0, 0]
    _refuse_poles(label, record, ~np.isfinite(response))
    return Simulation(response, nothing)


def _places(system: ct.StateSpace | ct.TransferFunction, label: str, record: FrequencyRecord) -> ComplexArray:
    """Where a transfer function is its frequency response."""
    if not system.isdtime(strict=True):
        return np.asarray(1j * record.omega, complex)
    if isinstance(system.dt, bool):
        raise StructureError(
            f"model {label!r} is discrete-time with an unspecified step, so that its response has no frequencies in "
            "rad per unit of time; give it a dt"
        )
    nyquist = np.pi / system.dt
    if record.omega[-1] > nyquist * (1 + _ROUNDING):
        raise StructureError(
            f"model {label!r} is discrete-time with dt = {system.dt:g}, and says nothing above its Nyquist frequency "
            f"{nyquist:.6g}; the response reaches {record.omega[-1]:.6g}: leave these points out"
        )
    turned: ComplexArray = np.exp(1j * record.omega * system.dt)
    return turned


def _refuse_poles(label: str, record: FrequencyRecord, infinite: NDArray[np.bool_]) -> None:
    """Refuse a model that is infinite at a point that was measured."""
    points = np.flatnonzero(infinite & record.observed)
    if len(points):
        k = int(points[0])
        raise StructureError(
            f"model {label!r} has a pole at omega = {record.omega[k]:.6g}, point {k} of the response: it is infinite "
            "there, and no finite measurement agrees with that; mark the point as missing with NaN to leave it out"
        )
