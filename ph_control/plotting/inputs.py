"""What a user may hand to a picture: systems of all kinds with their names, and models drawn around an estimate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import control as ct

from .. import _checks
from ..exceptions import StructureError
from ..modal.modal_form import ModalForm
from ..systems.port_hamiltonian import PortHamiltonian, ph

DRAWS = 300  # models of a band: seeds move its ends by 0.9 % of probability
_TITLE = 70  # letters that fit above a picture; the legend has the names as well


def as_systems(sysdata: Any, *, tabulated: bool = False) -> list[Any]:
    """Systems of one number of ports: lossless or not; of fits their models, and frequency responses on request."""
    systems = list(sysdata) if isinstance(sysdata, list | tuple) else [sysdata]
    if not systems:
        raise StructureError("the list of systems is empty; give at least one")
    systems = [_as_system(sys) for sys in systems]
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
    return systems


def _as_system(given: Any) -> Any:
    """Return the system itself, or that of a modal form or of the result of a fit."""
    if isinstance(given, ModalForm):
        return ph(given)
    inside = getattr(given, "system", None)
    return inside if isinstance(inside, PortHamiltonian) else given


def labels_of(sysdata: Any, systems: list[Any], label: str | Sequence[str] | None) -> list[str]:
    """Legend entries: those given, or the names of the systems that `as_systems` has made of `sysdata`."""
    if label is None:
        given = list(sysdata) if isinstance(sysdata, list | tuple) else [sysdata]
        names = [_name_of(one, sys) for one, sys in zip(given, systems, strict=True)]
        if len(names) == 1 and isinstance(systems[0], PortHamiltonian) and systems[0]._generic_name_check():
            return ["model"]
        # a system and what was sampled of it have the same name
        return [
            f"{name} (dt = {sys.dt})" if names.count(name) > 1 and sys.isdtime(strict=True) else name
            for name, sys in zip(names, systems, strict=True)
        ]
    labels = _checks.labels(label)
    if len(labels) != len(systems):
        raise StructureError(f"{len(labels)} labels for {len(systems)} systems; give one for each")
    return labels


def _name_of(given: Any, sys: Any) -> str:
    """Name of a system; a fit is called one, unless its system was named."""
    if given is not sys and hasattr(given, "experiments") and sys._generic_name_check():
        return f"fit ({sys.n} mode{'s' * (sys.n != 1)})"
    return str(sys.name)


def title_of(kind: str, systems: list[Any], relabelled: bool) -> str:
    """Title of a picture, with the names of its systems where they are few and have some."""
    named = [sys.name for sys in systems if not (relabelled or sys._generic_name_check())]
    title = f"{kind} of " + ", ".join(dict.fromkeys(named))
    return title if 0 < len(named) == len(systems) <= 3 and len(title) <= _TITLE else kind


def models_around(confidence: Any, sysdata: Any, systems: list[Any], *bands: str) -> list[Any]:
    """For each system the models drawn around it, or None: they have methods with the names `bands`.

    `confidence` belongs to the first system, a list to all of them, True to each of `sysdata` that is the result of a
    fit; such a result draws its models itself.
    """
    if confidence is True:
        everything = list(sysdata) if isinstance(sysdata, list | tuple) else [sysdata]
        confidence = [one if hasattr(one, "experiments") else None for one in everything]
        if not any(confidence):
            raise StructureError(
                "confidence is True, but none of the systems is the result of a fit; pass what pem gives, "
                "or confidence=result"
            )
    given = list(confidence) if isinstance(confidence, list | tuple) else [confidence]
    if len(given) > len(systems) or (len(given) < len(systems) and isinstance(confidence, list | tuple)):
        raise StructureError(
            f"confidence has {len(given)} entries for {len(systems)} systems; give one for each, None for those without"
        )
    found: list[Any] = []
    for sys, one in zip(systems, [*given, *[None] * (len(systems) - len(given))], strict=True):
        if one is None:
            found.append(None)
            continue
        if not sys.issiso():
            raise StructureError(f"bands are those of one port; {sys.name} has {sys.ninputs}")
        if not all(hasattr(one, band) for band in bands) and hasattr(one, "sample"):
            # the same picture each time
            one = one.sample(DRAWS, 0)
        if not all(hasattr(one, band) for band in bands):
            raise StructureError(
                f"confidence is a {type(one).__name__}; pass the result of pem, or models drawn by its sample(k)"
            )
        found.append(one)
    return found
