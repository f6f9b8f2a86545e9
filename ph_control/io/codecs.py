"""Models to JSON and back."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO, TextIO

import numpy as np

from .._types import SystemNames
from .._units import checked_unit, with_unit
from ..exceptions import FileFormatError, StructureError
from ..modal.general_form import GeneralModalForm
from ..modal.modal_form import Cluster, ModalForm
from ..systems.affine import AffineHamiltonian
from ..systems.canonical_forms import ControllableHamiltonian, ObservableHamiltonian
from ..systems.dissipative import DissipativePortHamiltonian
from ..systems.port_hamiltonian import PortHamiltonian
from .files import as_path, read_bytes, source_name, write_atomically
from .json_format import Fields, compose, decompose

_MOST_PORTS = 1 << 14  # of a document, which may tell any number of a model without modes


@dataclass(frozen=True)
class Codec:
    """How one kind of object becomes the fields of a document, and comes back.

    `to_dict` may give arrays (real or complex) and nested dicts; `from_dict` takes every field, checked.
    """

    type: type
    to_dict: Callable[[Any], dict[str, object]]
    from_dict: Callable[[Fields], Any]


def _modes_to_dict(modes: ModalForm) -> dict[str, object]:
    return {"ports": modes.nports, "d": modes.d, "nu": modes.nu, "rigid": modes.rigid, "r": modes.r}


def _modes_from_dict(fields: Fields) -> ModalForm:
    ports = fields.integer("ports")
    if not 1 <= ports <= _MOST_PORTS:
        raise StructureError(f"ports is {ports}; a model has at least one port, and at most {_MOST_PORTS}")
    d = fields.array("d", (None,))
    nu = fields.complex_array("nu", (len(d), ports))
    rigid = fields.array("rigid", (None, ports))
    r = fields.array("r", (len(d),) if ports == 1 else (len(d), ports))
    return ModalForm(d, nu, rigid, r)


def system_to_dict(system: PortHamiltonian) -> dict[str, object]:
    """Fields of a system: its names, and its matrices or its modes, whichever it was made of."""
    names = system._names() | ({"time_unit": system.time_unit} if system.time_unit else {})
    if system._given is None:
        return {**names, "modes": _modes_to_dict(system.modes)}
    return {**names, "Q": system.Q, "B": system.B}


def system_from_dict(fields: Fields) -> PortHamiltonian:
    """Restore the system of `system_to_dict`."""
    names = _names_from_dict(fields)
    unit = checked_unit(fields.text("time_unit")) if "time_unit" in fields else None
    if "modes" in fields:
        return with_unit(PortHamiltonian._from_modes(_modes_from_dict(fields.nested("modes")), **names), unit)
    return with_unit(PortHamiltonian(fields.array("Q", (None, None)), fields.array("B", (None, None)), **names), unit)


def _names_from_dict(fields: Fields) -> SystemNames:
    inputs, outputs, states = (fields.texts(key) for key in ("inputs", "outputs", "states"))
    return {"inputs": inputs, "outputs": outputs, "states": states, "name": fields.text("name")}


def _parameters_to_dict(system: Any) -> dict[str, object]:
    """Fields of a canonical form."""
    return {**system._names(), "d": system.d, "v": system.v}


def _parameters_codec(kind: type[Any]) -> Codec:
    def restore(fields: Fields) -> Any:
        return kind(fields.array("d", (None,)), fields.array("v", (None,)), **_names_from_dict(fields))

    return Codec(kind, _parameters_to_dict, restore)


def _affine_to_dict(system: AffineHamiltonian) -> dict[str, object]:
    return {**system._names(), "Q": system.Q, "B": system.C.T.copy()}


def _affine_from_dict(fields: Fields) -> AffineHamiltonian:
    matrices = (fields.array(key, (None, None)) for key in "QB")
    return AffineHamiltonian(*matrices, **_names_from_dict(fields))


def dissipative_to_dict(system: DissipativePortHamiltonian) -> dict[str, object]:
    """Fields of a system with losses: its names, structure matrices and sensors."""
    parts = {name: getattr(system, name) for name in "QGJRPSN"}
    rows, through = system.sensors
    sensors = {"sensor_rows": rows, "sensor_feedthrough": through} if len(rows) else {}
    return system._names() | parts | sensors | ({"time_unit": system.time_unit} if system.time_unit else {})


def _dissipative_from_dict(fields: Fields) -> DissipativePortHamiltonian:
    Q, N = (fields.array(key, (None, None)) for key in "QN")
    # of a gain, which has no states, only N tells the number of ports
    n, m = len(Q), len(N)
    J, R, S = (fields.array(key, (size, size)) for key, size in (("J", n), ("R", n), ("S", m)))
    G, P = (fields.array(key, (n, m)) for key in "GP")
    sensors = None
    if "sensor_rows" in fields:
        sensors = fields.array("sensor_rows", (None, n)), fields.array("sensor_feedthrough", (None, m))
    unit = checked_unit(fields.text("time_unit")) if "time_unit" in fields else None
    system = DissipativePortHamiltonian(Q, G, R=R, P=P, S=S, N=N, J=J, sensors=sensors, **_names_from_dict(fields))
    return with_unit(system, unit)


def _general_to_dict(form: GeneralModalForm) -> dict[str, object]:
    single = form.single
    clusters = {str(k): {"A": cluster.A, "B": cluster.B, "C": cluster.C} for k, cluster in enumerate(form.clusters, 1)}
    return {
        "outputs": form.noutputs, "inputs": form.ninputs, "poles": single.mode_poles, "shapes": single.shapes,
        "participation": single.participation, "feedthrough": form.feedthrough, "clusters": clusters,
    }  # fmt: skip


def _general_from_dict(fields: Fields) -> GeneralModalForm:
    sizes = fields.integer("outputs"), fields.integer("inputs")
    if not all(0 <= size <= _MOST_PORTS for size in sizes):
        raise StructureError(f"{sizes[0]} outputs and {sizes[1]} inputs; of each there are at most {_MOST_PORTS}")
    p, m = sizes
    poles = fields.complex_array("poles", (None,))
    shapes = fields.complex_array("shapes", (len(poles), p))
    participation = fields.complex_array("participation", (len(poles), m))
    if (poles.imag < 0).any() or any(part[poles.imag == 0].imag.any() for part in (shapes, participation)):
        raise StructureError("a pole is in the lower half-plane, or shapes or participation of a real one are complex")
    clusters = []
    kept = fields.nested("clusters")
    for k in range(1, len(kept.content) + 1):
        block = kept.nested(str(k))
        A = block.array("A", (None, None))
        B, C = block.array("B", (len(A), m)), block.array("C", (p, len(A)))
        if A.shape != (len(A), len(A)) or np.tril(A, -2).any() or (np.diag(A, -1)[1:] * np.diag(A, -1)[:-1]).any():
            raise StructureError(f"A of cluster {k} is no real Schur form")
        clusters.append(Cluster(A, B, C))
    return GeneralModalForm(poles, shapes, participation, fields.array("feedthrough", (p, m)), clusters)


# how each kind is written, or the module above this one that tells it, imported when the kind is first met
_CODECS: dict[str, Codec | str] = {
    "PortHamiltonian": Codec(PortHamiltonian, system_to_dict, system_from_dict),
    "ModalForm": Codec(ModalForm, _modes_to_dict, _modes_from_dict),
    "GeneralModalForm": Codec(GeneralModalForm, _general_to_dict, _general_from_dict),
    "ControllableHamiltonian": _parameters_codec(ControllableHamiltonian),
    "ObservableHamiltonian": _parameters_codec(ObservableHamiltonian),
    "DissipativePortHamiltonian": Codec(DissipativePortHamiltonian, dissipative_to_dict, _dissipative_from_dict),
    "AffineHamiltonian": Codec(AffineHamiltonian, _affine_to_dict, _affine_from_dict),
    "PEMResult": "ph_control.identification.fit.serialization",
    "DampedResult": "ph_control.identification.fit.serialization",
}
_KINDS = {"LosslessResult": "PEMResult"}  # classes under another name in documents

NETLISTS = (".cir", ".net", ".sp")
# the command that writes files of suffixes in which other programs expect something else
_WRITERS = dict.fromkeys((".mat", ".csv", ".txt"), "convert") | dict.fromkeys(NETLISTS, "netlist")


def _codec(kind: str) -> Codec | None:
    return import_module(entry).CODECS[kind] if isinstance(entry := _CODECS.get(kind), str) else entry


def save(obj: Any, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write a model to a JSON file.

    Parameters
    ----------
    obj : PortHamiltonian, ControllableHamiltonian, ObservableHamiltonian, AffineHamiltonian, ModalForm or PEMResult
        The model.
    path : str or path-like
        The file, `.json` by convention.
    overwrite : bool, optional
        Whether a file of that name may be replaced.

    Raises
    ------
    OutputExistsError
        If the file exists and `overwrite` is False or it is read-only, or the path is a folder, a device, a pipe or a
        socket.  Nothing is written then.
    FileMissingError
        If the folder does not exist.
    StructureError
        If the object is of another kind, or holds what `load` would refuse, or the path cannot be the name of a file
        or is that of a MATLAB or text file or a netlist, such as `.mat`, `.csv` or `.cir`, which this would not be.
    PermissionError
        If the folder cannot be written.

    Notes
    -----
    Every number comes back bit by bit, with all names; a system made from modes stays one.  The file appears whole
    or not at all; one that is replaced keeps its permissions.  The page Files of the documentation describes it.

    Examples
    --------
    >>> import pathlib, tempfile, ph_control as phc
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "model.json")
    ...     phc.save(phc.modes([1.0, 3.0], [0.5, 0.25]), path)
    ...     phc.load(path)
    modes([1.0, 3.0], [0.5, 0.25])
    """
    write_atomically(document_path(path), document_of(obj), overwrite=overwrite)


def document_path(path: str | os.PathLike[str]) -> Path:
    """Path of a document that is to be written; suffixes of other formats are refused."""
    target = as_path(path)
    writer = _WRITERS.get(target.suffix.lower())
    if writer is not None:
        raise StructureError(
            f"{target} would hold JSON, which a {target.suffix} file does not; end its name in .json, and write other "
            f"formats by `ph-control {writer} {target.stem}.json {target.name}`"
        )
    return target


def document_of(obj: Any) -> str:
    """Text that `save` writes."""
    # the class itself: a subclass would come back as its base
    kind = _KINDS.get(type(obj).__name__, type(obj).__name__)
    codec = _codec(kind)
    if codec is None or type(obj) is not codec.type:
        raise StructureError(
            f"an object of type {type(obj).__name__} cannot be saved, only {', '.join(_CODECS)}; "
            "a passive system of another type can be converted with ph(sys), any other with modes(sys), as "
            "save(modes(sys), path); a fit is saved with its data by result.save(path)"
        )
    text = compose(kind, codec.to_dict(obj))
    try:
        restore(text.encode(), type(obj).__name__)
    except FileFormatError as error:
        raise StructureError(
            f"this {type(obj).__name__} cannot be saved, because it could not be loaded: {error}"
        ) from None
    return text


def load(path: str | os.PathLike[str] | BinaryIO | TextIO) -> Any:
    """Read a model that `save` has written.

    Parameters
    ----------
    path : str, path-like, or file object open for reading
        The file.

    Returns
    -------
    PortHamiltonian, ControllableHamiltonian, ObservableHamiltonian, AffineHamiltonian, ModalForm or PEMResult
        What was saved, bit by bit.

    Raises
    ------
    FileFormatError
        If the file is not JSON, damaged, cut short, of another program, of a newer schema or of an unknown kind,
        or if its values are not a valid model.  The message says which, and where.
    FileMissingError
        If there is no such file.

    Notes
    -----
    Every field is checked: present, of its type and shape, finite, and valid as a whole; nothing in the file is
    ever executed.  A checksum finds changed digits.

    Examples
    --------
    See `save`.
    """
    return restore(read_bytes(path), source_name(path))


def restore(content: bytes, name: str) -> Any:
    """Object of a document; `name` is its file, for the errors."""
    kind, fields = decompose(content, name)
    codec = _codec(kind)
    if codec is None:
        raise FileFormatError(f"{name} holds a {kind!r}; this version of ph_control reads {str([*_CODECS])[1:-1]}")
    try:
        restored = codec.from_dict(fields)
    except FileFormatError:
        raise
    except ValueError as error:
        raise FileFormatError(f"{name} holds no valid {kind}: {error}") from None
    fields.done()
    return restored
