"""Mode shapes in universal files: data set 55, normal and complex modes at the nodes of a structure."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import _checks
from .._frozen import Frozen
from .._types import Array, ComplexArray
from .._units import SECONDS
from ..exceptions import FileFormatError, StructureError
from ..modal.general_form import from_vectors
from ..modal.modal_form import ModalForm
from .files import as_path, write_atomically

_NORMAL, _COMPLEX, _SECOND_ORDER = 2, 3, 7  # analysis types
_STRUCTURAL, _TRANSLATIONS, _COMPLEX_VALUES = 1, 2, 5  # model type, data characteristic, data type
_GENERAL, _DISPLACEMENT = 1, 8  # specific data types
_AXES = ("X", "Y", "Z", "RX", "RY", "RZ")
_PLACE = re.compile(r"(?:.*:)?(\d{1,10})([+-])([XYZ])")


@dataclass(frozen=True, eq=False)
class UniversalModes(Frozen):
    """Modes of a universal file; made by `read_uff`.

    Attributes
    ----------
    poles : ndarray of complex, shape (n,)
        One of each pair of conjugates, rad/s.
    shapes : ndarray of complex, shape (n, p)
        Mode shapes at the outputs.
    modal_a : ndarray of complex, shape (n,)
        Their scale: the receptance has the residues `shape shape^T / modal_a`, `modal_a = 2j Im p` with unit modal
        mass; 0 where the file has none.
    output_labels : tuple of str
        Nodes and directions, such as `'3+Z'`.
    time_unit : str
        's'.

    See Also
    --------
    read_uff, write_uff

    Examples
    --------
    See `write_uff`.
    """

    poles: ComplexArray
    shapes: ComplexArray
    modal_a: ComplexArray
    output_labels: tuple[str, ...]
    time_unit: str = "s"

    @property
    def natural_frequencies(self) -> Array:
        """Natural frequencies `|p|`, shape (n,), rad/s."""
        return np.abs(self.poles)

    @property
    def hertz(self) -> Array:
        """Natural frequencies in Hz, shape (n,)."""
        return np.asarray(self.natural_frequencies / (2 * np.pi))

    @property
    def damping_ratios(self) -> Array:
        """Damping ratios `-Re p / |p|`, shape (n,); 0 of rigid-body modes."""
        size = self.natural_frequencies
        return 0.0 - self.poles.real / np.where(size > 0, size, 1.0)

    @property
    def shapes_scaled(self) -> bool:
        """Whether the file tells the scale of all shapes."""
        return bool(self.modal_a.all())

    @property
    def modes(self) -> ModalForm:
        """Modal form of the receptance, from forces at all outputs to their displacements; of scaled shapes only."""
        if not self.shapes_scaled:
            raise StructureError(
                "the file tells no modal mass, so that the modes have no response; pass the participation of inputs, "
                "modes(found.poles, found.shapes, participation)"
            )
        return from_vectors(self.poles, self.shapes, self.shapes / self.modal_a[:, None])


def write_uff(
    result: Any,
    path: str | os.PathLike[str],
    *,
    places: Sequence[str] | Mapping[str, str] | None = None,
    overwrite: bool = False,
) -> None:
    r"""Write the poles and mode shapes of a fit to a universal file (UFF, UNV), one data set 55 a mode.

    Parameters
    ----------
    result : PEMResult or UniversalModes
        The modes.
    path : str or path-like
        The file, `.uff` or `.unv` by convention.
    places : list of str, or mapping, optional
        Node and direction of each output, `"3+Z"`, or `"3-Z"` for a sensor that points the other way; by label in a
        mapping.  Default: the labels, which are such places after `read_uff`.
    overwrite : bool, optional
        Whether a file of that name may be replaced.

    Raises
    ------
    StructureError
        If `result` is of another kind or has no modes, a place is no node and direction, or two outputs are at one.
    OutputExistsError
        If the file exists and `overwrite` is False, or it cannot be replaced.
    FileMissingError
        If the folder does not exist.

    See Also
    --------
    read_uff : reads such files.
    save : keeps the whole result, with every digit.

    Notes
    -----
    Complex eigenvalues in rad/s, taken for such where the time unit of the result is not known, and displacements at
    each node, 0 in directions that were not measured.  Where a driving point sets the scale, modal A is
    `2j Im p m` and modal B `-p` times that, with the modal mass m = 1 in the units of the result, else both are 0.
    Numbers have six digits.  Components are left out, as such data sets have none.  With a `'free'` output the data are
    called general, and no scale is read from them.  O(n p).

    Examples
    --------
    >>> import pathlib, tempfile, control as ct, numpy as np, ph_control as phc
    >>> poles, shapes = np.array([-0.1 + 10j, -0.2 + 20j]), np.array([[1.0, 0.5], [0.5, -1.0]])
    >>> f = np.arange(0.1, 5.0, 0.1)
    >>> plant = phc.modes(poles, shapes, shapes[:, :1] / (2j * poles.imag[:, None]))
    >>> data = ct.FrequencyResponseData(plant.freqresp(2 * np.pi * f), 2 * np.pi * f)
    >>> result = phc.pem(data, 2, structure="free", quantity="displacement", ports=[(0, 0)])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "modes.uff")
    ...     phc.write_uff(result, path, places=["1+Z", "2+Z"])
    ...     (found,) = phc.read_uff(path)
    >>> found.output_labels, found.damping_ratios.round(4), found.shapes.real.round(3).tolist()
    (('1+Z', '2+Z'), array([0.01, 0.01]), [[1.0, 0.5], [0.5, -1.0]])
    """
    target = as_path(path)
    if not hasattr(result, "shapes") or not hasattr(result, "output_labels"):
        raise StructureError(
            f"result is {_checks.shown(result)}; pass the result of a fit, or the UniversalModes that read_uff gave; "
            "pyuff writes frequency responses and recordings"
        )
    poles, shapes = np.asarray(result.poles, complex), np.asarray(result.shapes, complex)
    if not len(poles):
        raise StructureError("the result has no modes, and so nothing to write")
    seconds = SECONDS[result.time_unit or "s"]
    if isinstance(result, UniversalModes):
        scale = result.modal_a
    else:
        # the shapes are those of unit modal mass in the unit of time of the data
        scale = 2j * poles.imag * seconds if result.shapes_scaled else np.zeros(len(poles), np.complex128)
    nodes, columns, signs = _nodes_of(result.output_labels, places)
    vectors = np.zeros((len(poles), 3 * len(nodes)), np.complex128)
    vectors[:, columns] = shapes * signs
    kind = _GENERAL if "free" in getattr(result, "quantities", ()) else _DISPLACEMENT
    text = "".join(
        _data_set(l + 1, kind, pole, scale[l], vectors[l].reshape(-1, 3), nodes)
        for l, pole in enumerate(poles / seconds)
    )
    write_atomically(target, text, overwrite=overwrite)


def _nodes_of(labels: Sequence[str], places: Any) -> tuple[list[int], list[int], Array]:
    """Nodes, ascending, and for each output its column among three for each of these, and its sign."""
    each = _place_of_each(labels, places)
    if len(each) != len(labels):
        raise StructureError(f"places has {len(each)} entries for {len(labels)} outputs; give one for each")
    parts = [_PLACE.fullmatch(place) if isinstance(place, str) else None for place in each]
    for place, part in zip(each, parts, strict=True):
        if part is None:
            raise StructureError(
                f"{_checks.shown(place)} is not a node and translation direction; pass such as places=['3+Z', ..]"
            )
    known = [(int(part[1]), _AXES.index(part[3])) for part in parts if part]
    twice = next((k for k, node in enumerate(known) if node in known[:k]), None)
    if twice is not None:
        raise StructureError(
            f"outputs {labels[known.index(known[twice])]!r} and {labels[twice]!r} are both at {each[twice]!r}; give "
            "them different nodes, places=['3+Z', ..]"
        )
    nodes = sorted({node for node, _ in known})
    columns = [3 * nodes.index(node) + axis for node, axis in known]
    return nodes, columns, np.array([-1.0 if part and part[2] == "-" else 1.0 for part in parts])


def _place_of_each(labels: Sequence[str], places: Any) -> list[Any]:
    """Places of the outputs as they were given: by label in a mapping, in a list, or the labels themselves."""
    if isinstance(places, Mapping):
        unknown = [name for name in places if name not in labels]
        if unknown:
            raise StructureError(f"places names {unknown[0]!r}; the outputs are {', '.join(map(repr, labels))}")
        return [places.get(label, label) for label in labels]
    given = labels if places is None else places
    return list(given) if isinstance(given, list | tuple) else [given]


def _data_set(
    number: int, kind: int, pole: complex, modal_a: complex, vectors: ComplexArray, nodes: Sequence[int]
) -> str:
    """Data set of one mode."""
    lines = [f"{-1:6d}", f"{55:6d}", "mode shapes of ph_control", *["NONE"] * 4]
    lines += [_integers(_STRUCTURAL, _COMPLEX, _TRANSLATIONS, kind, _COMPLEX_VALUES, 3), _integers(2, 6, 1, number)]
    lines += [_reals(pole, modal_a, 0.0 - pole * modal_a)]
    for node, vector in zip(nodes, vectors, strict=True):
        lines += [_integers(node), _reals(*vector)]
    return "\n".join([*lines, f"{-1:6d}\n"])


def _integers(*values: int) -> str:
    return "".join(f"{value:10d}" for value in values)


def _reals(*values: complex) -> str:
    return "".join(f"{part:13.5E}" for value in values for part in (value.real, value.imag))


# --- reading ---------------------------------------------------------------------------------------------------------


def modes_in(data_sets: Sequence[Mapping[str, Any]], name: str) -> UniversalModes | None:
    """Normal and complex modes of data sets 55, or None where these hold other results."""
    try:
        modes = [mode for fields in data_sets for mode in _mode(fields)]
    except (KeyError, ValueError, TypeError, IndexError) as error:
        raise FileFormatError(f"{name} has a damaged mode shape ({type(error).__name__}); export it again") from None
    if not modes:
        return None
    places = sorted({place for _, _, shape in modes for place in shape})
    # directions that were not measured are 0 in the files
    places = [place for place in places if any(shape.get(place) for _, _, shape in modes)]
    poles, modal_a = (np.array([mode[k] for mode in modes], complex) for k in (0, 1))
    shapes = np.array([[shape.get(place, 0.0) for place in places] for _, _, shape in modes], complex)
    if not places or not all(np.isfinite(array).all() for array in (poles, shapes, modal_a)):
        raise FileFormatError(f"{name} has mode shapes that are not finite, or all 0; export them again")
    labels = tuple(f"{node}+{_AXES[axis]}" for node, axis in places)
    return UniversalModes(_checks.readonly(poles), _checks.readonly(shapes), _checks.readonly(modal_a), labels)


def _mode(fields: Mapping[str, Any]) -> Iterator[tuple[complex, complex, dict[tuple[int, int], complex]]]:
    """Pole, modal A and the shape by node and axis; nothing of a conjugate, or of another kind of result."""
    kind = int(fields["analysis_type"])
    if kind == _NORMAL:
        # a loss factor at the resonance has the effect of twice the damping ratio
        zeta = float(fields["modal_damp_vis"]) + float(fields["modal_damp_his"]) / 2
        pole = 2 * math.pi * float(fields["freq"]) * complex(-zeta, math.sqrt(1 - zeta**2))
        modal_a = 2j * pole.imag * float(fields["modal_m"])
    elif kind in (_COMPLEX, _SECOND_ORDER):
        pole, modal_a = complex(fields["eig"]), complex(fields["modal_a"])
    else:
        return
    if pole.imag < 0:
        return
    values = [np.asarray(fields[key]) for key in ("r1", "r2", "r3", "r4", "r5", "r6") if key in fields]
    nodes = [int(node) for node in fields["node_nums"]]
    shape = {(node, axis): complex(column[k]) for axis, column in enumerate(values) for k, node in enumerate(nodes)}
    # of velocities and accelerations the scale is not agreed
    yield pole, modal_a if int(fields["spec_data_type"]) == _DISPLACEMENT else 0j, shape
