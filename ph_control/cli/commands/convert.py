"""Convert a port-Hamiltonian model to another form or file format.

The suffix selects the format: .json, .mat (A, B, C, D, with losses also Q, G, J, R, P, S, N; or num, den), .txt or .csv
(coefficients of the transfer function, or modes). Standard output is JSON. Exit status 1 if the model has no
port-Hamiltonian form.

Examples
--------
  ph-control convert plant.mat plant.json
  ph-control convert fitted.json fitted.mat
  ph-control convert fitted.json coefficients.txt
  ph-control convert fitted.json modes.csv --to modes
  ph-control convert --num 1,0 --den 1,0,4 oscillator.json --name oscillator
  ph-control convert fitted.json companion.mat --to ch
  cat fitted.json | ph-control convert - - --to tf
"""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import Any

import ph_control as phc

from ...exceptions import StructureError
from ..inputs import Model, read_models, source_and_target, system_name_of
from ..options import Parser, add_files, add_written, system_name
from ..outputs import conclude, deliver, strict

USAGE = "MODEL FILE [options]"

FORMS = {
    "ph": "port-Hamiltonian", "modes": "d and r", "ch": "controllable canonical", "oh": "observable canonical",
    "tf": "transfer function", "ss": "A, B, C, D",
}  # fmt: skip
FORMATS = ("json", "mat", "txt", "csv")


def add_options(parser: Parser) -> None:
    """Declare the options."""
    add_files(parser, "file")
    listed = "; ".join(f"{form}: {meaning}" for form, meaning in FORMS.items())
    parser.add_argument(
        "--to", choices=tuple(FORMS), help=f"form ({listed}); default: unchanged, or ph; tf for text files"
    )
    parser.add_argument("--format", choices=FORMATS, help="file format (default: from the suffix)")
    parser.add_argument("--name", type=system_name, help="name of the converted system")
    add_written(parser)


def run(options: Namespace) -> int:
    """Read, convert, write."""
    sources, target = source_and_target(options, "the file to write")
    kind = options.format or format_of(target)
    (model,) = read_models(sources, options)
    form = options.to or ("tf" if kind in ("txt", "csv") else None)
    made = _converted(model, form, options.name)
    deliver(encoded(made, form, kind), target, options.overwrite)
    answer = {"command": "convert", "source": model.source, "form": options.to or _form_of(made), "format": kind}
    return conclude(options, answer, [target])


def format_of(target: str) -> str:
    """Format of a file, told by its suffix."""
    if target == "-":
        return "json"
    suffix = Path(target).suffix.lstrip(".").lower()
    if suffix not in FORMATS:
        raise StructureError(f"{target} has no known suffix; end its name in .{', .'.join(FORMATS)}, or pass --format")
    return suffix


def _form_of(made: Any) -> str:
    from control import TransferFunction

    from ...modal.general_form import GeneralModalForm

    forms: dict[type, str] = {
        phc.ModalForm: "modes", GeneralModalForm: "modes", phc.ControllableHamiltonian: "ch",
        phc.ObservableHamiltonian: "oh", TransferFunction: "tf", phc.AffineHamiltonian: "affine",
    }  # fmt: skip
    return forms.get(type(made), "ph")


def _converted(model: Model, form: str | None, name: str | None) -> Any:
    """Object of the wanted form, or of its own."""
    if isinstance(model.content, phc.AffineHamiltonian) and form in (None, "ss"):
        system: Any = model.content
    else:
        system = model.port_hamiltonian()
    if isinstance(system, phc.ModalForm) and (form not in (None, "modes") or name is not None):
        # modes have no name, and no matrices
        system = phc.ph(system, name=system_name_of(model.label))
    if form == "modes" or isinstance(system, phc.ModalForm):
        return phc.modes(system)
    makers: dict[str | None, Any] = {"ph": phc.ph, "ch": phc.ch, "oh": phc.oh, "tf": phc.tf}
    made = makers[form](system, name=system.name) if form in makers else system
    return made if name is None else made.copy(name)


def encoded(made: Any, form: str | None, kind: str) -> str | bytes:
    """Content of the file."""
    from ...io.codecs import dissipative_to_dict, document_of
    from ...io.matlab import matlab_of

    form_made = _form_of(made)
    if form_made == "tf":
        arrays = _polynomials(made)
    elif form_made == "modes" and kind != "json":
        if not made.is_lossless:
            raise StructureError("modes with damping are kept in JSON; write .json, or the matrices by --to ss")
        if made.nports != 1 or len(made.rigid):
            raise StructureError("d and r alone do not tell a model of several ports, or with a pole at 0; write .json")
        arrays = {"d": made.d, "r": made.r}
    elif form == "ss" or kind != "json":
        arrays = {key: getattr(made, key) for key in "ABCD"}
        if form != "ss" and kind == "mat" and isinstance(made, phc.DissipativePortHamiltonian):
            arrays |= {key: value for key, value in dissipative_to_dict(made).items() if key != "time_unit"}
    else:
        return document_of(made)
    if kind == "json":
        return strict(arrays, indent=None)
    return matlab_of(arrays) if kind == "mat" else _text(arrays, " " if kind == "txt" else ",")


def _polynomials(system: Any) -> dict[str, object]:
    """Coefficients of a transfer function with one input and one output."""
    if not system.issiso():
        raise StructureError(
            f"the system has {system.ninputs} inputs and {system.noutputs} outputs, and coefficients are those of one "
            "of each; use --to ss"
        )
    return {"num": system.num_list[0][0], "den": system.den_list[0][0]}


def _text(arrays: dict[str, Any], separator: str) -> str:
    """Lines of coefficients, or columns of modes, each number with the shortest digits that give it again."""
    if "A" in arrays:
        raise StructureError(
            "texts hold the coefficients of a transfer function (--to tf) or modes (--to modes); write a .json or .mat "
            "file"
        )
    named = [[key, *(repr(float(x)) for x in values)] for key, values in arrays.items()]
    rows = zip(*named, strict=True) if "d" in arrays else named
    return "".join(separator.join(row) + "\n" for row in rows)
