"""Models as commands take them: documents of this package, matrices, and coefficients."""

from __future__ import annotations

import json
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ..exceptions import FileFormatError, NotLosslessError, StructureError
from ..io.matlab import is_matlab, read_matlab
from .coefficients import table_of_coefficients
from .matrices import system_of
from .options import system_name_of
from .outcome import NoError
from .sources import Source, opened


@dataclass(frozen=True)
class Model:
    """What was read, and where from."""

    source: str
    label: str
    content: Any

    @property
    def name(self) -> str:
        """Name that python-control accepts for a system."""
        return system_name_of(self.label)

    @property
    def is_result(self) -> bool:
        """Whether it is the result of a fit, data and uncertainty included."""
        return type(self.content).__name__ == "PEMResult"

    def lossless(self) -> Any:
        """Object of this package that has the same transfer function; `NoError` if none has."""
        from ..modal.modal_form import ModalForm
        from ..systems.affine import AffineHamiltonian
        from ..systems.base import LosslessSystem
        from ..systems.port_hamiltonian import ph

        if self.is_result:
            return self.content.system
        if isinstance(self.content, AffineHamiltonian):
            raise StructureError(
                f"{self.source} holds an AffineHamiltonian, whose output is a displacement: it has no port-Hamiltonian "
                "form, its derivative has; in Python: model.derivative()"
            )
        if isinstance(self.content, LosslessSystem | ModalForm):
            return self.content
        try:
            return ph(self.content)
        except NotLosslessError as error:
            raise NoError(self.source, error.violations) from None


def read_models(names: Sequence[str], options: Namespace) -> list[Model]:
    """Models of files, and the one of `--num` and `--den`."""
    found = [read_model(name) for name in names]
    if options.num is not None or options.den is not None:
        if options.num is None or options.den is None:
            raise StructureError("--num and --den belong together: give both, such as --num 1,0 --den 1,0,4")
        found.append(
            Model(
                "--num/--den",
                "tf",
                system_of({"num": options.num, "den": options.den}, "--num/--den", "model"),
            )
        )
    if not found:
        raise StructureError("no model given; name a file, or pass --num and --den")
    stems = [model.label for model in found]
    return [
        Model(model.source, model.source if stems.count(model.label) > 1 else model.label, model.content)
        for model in found
    ]


def read_model(name: str) -> Model:
    """Model of a file of any kind; its kind is told by its content."""
    source = opened(name)
    content = source.getvalue()
    if not content.strip():
        raise FileFormatError(f"{source.name} is empty; a model is JSON, a .mat file or a text with coefficients")
    return Model(source.name, source.stem, _content(source, content))


def _content(source: Source, content: bytes) -> Any:
    name = Model(source.name, source.stem, None).name
    if is_matlab(content, source.name):
        return system_of(read_matlab(content, source.name), source.name, name)
    if content.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] == b"{":
        return _of_json(content, source.name, name)
    return system_of(table_of_coefficients(content, source.name), source.name, name)


def _of_json(content: bytes, source: str, name: str) -> Any:
    from ..io.codecs import restore

    try:
        fields = json.loads(content)
    except (ValueError, RecursionError):
        # it says what is wrong, and where
        return restore(content, source)
    if isinstance(fields, dict) and "format" not in fields and "data" not in fields:
        return system_of(fields, source, name)
    return restore(content, source)
