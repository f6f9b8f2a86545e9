"""What a user may hand to a picture: systems of all kinds with their names, and models drawn around an estimate."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import control as ct
import numpy as np

from .. import _checks
from .._display import counted, counted_poles
from .._types import Array, ComplexArray
from ..exceptions import StructureError
from ..modal.general_form import GeneralModalForm
from ..modal.modal_form import ModalForm
from ..numerics.rational import LinearSystem
from ..systems.base import in_normal_form
from ..systems.port_hamiltonian import ph

_DRAWS = 300  # models of a band: seeds move its ends by 0.9 % of probability
_UNNAMED = re.compile(r"sys\[\d+\]")  # what python-control calls a system without a name
_TITLE = 70  # letters that fit above a picture; the legend has the names as well


@dataclass(frozen=True)
class Subject:
    """A system to draw: as it was given, as a linear system, and its name in the legend."""

    given: Any
    system: Any
    label: str

    @property
    def lossless(self) -> bool:
        """Whether poles and zeros are known to be on the imaginary axis."""
        return in_normal_form(self.system)


def as_list(given: object, what: str = "") -> list[Any]:
    """One thing or several, as a list; of `what` there must be one at least."""
    if what and isinstance(given, list | tuple) and not given:
        raise StructureError(f"the list of {what} is empty; give at least one")
    return list(given) if isinstance(given, list | tuple) else [given]


def is_fit(given: object) -> bool:
    """Whether this is the result of a fit, which has experiments and the models of a band."""
    return hasattr(given, "experiments") and hasattr(given, "confidence_interval")


def as_measured(given: object, response: ComplexArray, omega: Array) -> ComplexArray:
    """Response (p, m, K) of a model as it was measured: of a result on its background, and with its delays.

    Of a fit to responses that were estimated with a window, what the window makes of it.
    """
    if getattr(given, "window", None) is not None and hasattr(given, "estimated_response"):
        response = given.estimated_response(omega)
    background = getattr(given, "background", None)
    if background is not None:
        response = response + background.response(omega)
    late = lateness_of(given)
    return response * np.exp(-1j * np.multiply.outer(late, omega)) if late.any() else response


def lateness_of(given: object) -> Array:
    """Time (p, m) by which outputs answer late to inputs: of a result its delays, (1, 1) and 0 of anything else."""
    outputs, inputs = (np.asarray(getattr(given, name, np.zeros(1)), float) for name in ("delay", "input_delay"))
    return np.add.outer(outputs, inputs)


def measurements_of(model: Any, data: object) -> list[Any]:
    """Measurements that were given, or else those that a result was fitted to."""
    if data is None:
        return [getattr(experiment, "record", experiment) for experiment in getattr(model, "experiments", ())]
    return as_list(data)


def table_in(measurement: Any) -> tuple[Array, ComplexArray] | None:
    """Frequencies and response (p, m, K) of a measurement over frequency; None of others."""
    if not (hasattr(measurement, "omega") and (hasattr(measurement, "frdata") or hasattr(measurement, "response"))):
        return None
    response = np.asarray(measurement.frdata if hasattr(measurement, "frdata") else measurement.response, complex)
    return np.asarray(measurement.omega, float), response[None, None] if response.ndim == 1 else response


def recording_in(measurement: Any) -> tuple[Array, Array, float]:
    """Inputs (m, N), none of a free motion, outputs (p, N) and time step of a recording."""
    recorded = all(hasattr(measurement, name) for name in ("u", "y", "dt"))
    if not (isinstance(measurement, ct.TimeResponseData) or recorded):
        raise StructureError(
            f"data hold a {type(measurement).__name__}; pass control.FrequencyResponseData, control.TimeResponseData, "
            "or a list of them"
        )
    step = _checks.time_vector(measurement.t)[1] if isinstance(measurement, ct.TimeResponseData) else measurement.dt
    y = np.asarray(measurement.y, float)
    u = np.zeros(0) if measurement.u is None else np.asarray(measurement.u, float)
    return u.reshape(-1, y.shape[-1]), y.reshape(-1, y.shape[-1]), float(step)


def subjects_of(sysdata: Any, label: str | Sequence[str] | None, *, tabulated: bool = False) -> list[Subject]:
    """Systems of one number of ports; of fits their models, and frequency responses where `tabulated` allows them."""
    given = as_list(sysdata, "systems")
    systems = [_inside(thing) for thing in given]
    kinds = (ct.StateSpace, ct.TransferFunction, *([ct.FrequencyResponseData] if tabulated else []))
    for sys in systems:
        if not isinstance(sys, kinds):
            what = "frequency response; give" if tabulated else "poles; give"
            raise StructureError(
                f"a {type(sys).__name__} has no {what} LTI systems of python-control, PortHamiltonian systems, modal "
                "forms" + (" or frequency response data" if tabulated else "")
            )
    shapes = [(sys.noutputs, sys.ninputs) for sys in systems]
    if len(set(shapes)) > 1:
        raise StructureError(f"the systems differ in (outputs, inputs): {shapes}; draw them in pictures of their own")
    labels = _names(given, systems) if label is None else _checks.labels(label, len(systems), "systems")
    return [Subject(*parts) for parts in zip(given, systems, labels, strict=True)]


def _inside(given: Any) -> Any:
    """Linear system of what is to be drawn: of a fit that from the inputs to what was measured."""
    if isinstance(given, ModalForm):
        return given.state_space() if isinstance(given, GeneralModalForm) else ph(given)
    if not is_fit(given):
        return given
    # where both are the same, that of the ports has its poles on the axis to the last digit
    same = given.structure == "lossless" and set(given.quantities) == {"velocity"}
    return given.system if same else given.observed_system


def _names(given: list[Any], systems: list[Any]) -> list[str]:
    """Names of systems, all different; a fit is called one, unless its system was named."""
    names = [
        given_name(sys) or (fit_name(source.poles) if is_fit(source) else _kind(sys))
        for source, sys in zip(given, systems, strict=True)
    ]
    # a system has the name of what it was sampled, reduced or drawn from
    names = [
        f"{name} (dt = {sys.dt})" if names.count(name) > 1 and sys.isdtime(strict=True) else name
        for name, sys in zip(names, systems, strict=True)
    ]
    sizes = [getattr(sys, "nstates", None) for sys in systems]
    names = [
        f"{name} ({counted(size, 'state')})" if size and _differs(name, names, sizes) else name
        for name, size in zip(names, sizes, strict=True)
    ]
    return [f"{name} #{names[: k + 1].count(name)}" if names.count(name) > 1 else name for k, name in enumerate(names)]


def fit_name(poles: ComplexArray) -> str:
    """What a fit with these poles, one of each pair, is called in legends."""
    modes = int(np.sum(poles.imag != 0))
    return f"fit ({', '.join(counted_poles(modes, len(poles) - modes))})"


def _kind(sys: object) -> str:
    return "response" if isinstance(sys, ct.FrequencyResponseData) else "model"


def _differs(name: str, names: list[str], sizes: list[int | None]) -> bool:
    """Whether systems of this name are of different sizes."""
    return len({size for other, size in zip(names, sizes, strict=True) if other == name}) > 1


def given_name(sys: Any) -> str | None:
    """Name that a system was given, without what python-control adds to it, as in `plant$sampled`; None without one."""
    name = re.sub(r"(?<=.)(\$[a-z]+)+$", "", str(sys.name))
    return None if _UNNAMED.fullmatch(name) else name


def timebase(sys: LinearSystem) -> float:
    """Sampling time of a discrete-time system; 1 where it is unspecified, as python-control takes it."""
    return 1.0 if sys.dt is True else float(sys.dt)


def title_of(kind: str, subjects: list[Subject], relabelled: bool) -> str:
    """Title of a picture, with the names of its systems where they are few and have some."""
    names = [] if relabelled else [given_name(subject.system) for subject in subjects]
    named = [name for name in names if name]
    title = f"{kind} of " + ", ".join(dict.fromkeys(named))
    return title if 0 < len(named) == len(subjects) <= 3 and len(title) <= _TITLE else kind


def models_around(confidence: object, subjects: list[Subject], *bands: str) -> list[Any]:
    """For each system the models drawn around it, or None: they have methods with the names `bands`.

    `confidence` belongs to the first system, a list to all of them, True to each that is the result of a fit.
    """
    given = as_list(confidence)
    if confidence is True:
        given = [subject.given if is_fit(subject.given) else None for subject in subjects]
        if not any(given):
            raise StructureError(
                "confidence is True, but none of the systems is the result of a fit; pass what pem gives, "
                "or confidence=result"
            )
    elif not isinstance(confidence, list | tuple):
        given += [None] * (len(subjects) - 1)
    if len(given) != len(subjects):
        raise StructureError(
            f"confidence has {len(given)} entries for {len(subjects)} systems; give one for each, None for those "
            "without"
        )
    return [
        None if source is None else _models(source, subject.system, bands)
        for source, subject in zip(given, subjects, strict=True)
    ]


def _models(given: Any, sys: Any, bands: tuple[str, ...]) -> Any:
    if not sys.issiso():
        raise StructureError(
            f"bands are those of one input and one output; {sys.name} has {sys.ninputs} and {sys.noutputs}: leave "
            "confidence out, or draw frf_plot(result, confidence=True)"
        )
    # the same picture each time
    models = given.sample(_DRAWS, 0) if is_fit(given) else given
    if not all(hasattr(models, band) for band in bands):
        raise StructureError(
            f"confidence is a {type(models).__name__}; pass the result of pem, or models drawn by its sample(k)"
        )
    return models
