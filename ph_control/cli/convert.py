"""`ph-control convert`: a model in another form or file format."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import Any

from ..exceptions import StructureError
from ..io.matlab import matlab_of
from .answers import emit_json, strict
from .coefficients import columns_of, rows_of
from .matrices import arrays_of, modes_of, polynomials_of
from .models import Model, read_models
from .options import Parser, add_json, add_model, add_overwrite, system_name
from .outcome import DONE, emit
from .outputs import check_outputs, deliver, refuse_both
from .sources import check_sources

USAGE = "MODEL FILE [options]"

DESCRIPTION = """Turn a lossless model into another form, and into another file format, which is told by the suffix:
.json, .mat (A, B, C, D; or num, den), .txt and .csv (coefficients of the transfer function, or modes). Standard output
gets JSON. Exit status 1 if the model is not lossless."""

EXAMPLES = """
  ph-control convert plant.mat plant.json
  ph-control convert fitted.json fitted.mat
  ph-control convert fitted.json coefficients.txt
  ph-control convert fitted.json modes.csv --to modes
  ph-control convert --num 1,0 --den 1,0,4 oscillator.json --name oscillator
  ph-control convert fitted.json companion.mat --to ch
  cat fitted.json | ph-control convert - - --to tf
"""

FORMS = {
    "ph": "port-Hamiltonian", "modes": "d and r", "ch": "controllable canonical", "oh": "observable canonical",
    "tf": "transfer function", "ss": "A, B, C, D",
}  # fmt: skip
FORMATS = ("json", "mat", "txt", "csv")


def add_options(parser: Parser) -> None:
    """Declare the options."""
    parser.add_argument(
        "files", nargs="+", metavar="FILE",
        help="the model and the file to write; - for standard input and output",
    )  # fmt: skip
    add_model(parser)
    listed = "; ".join(f"{form}: {meaning}" for form, meaning in FORMS.items())
    parser.add_argument("--to", choices=tuple(FORMS), help=f"form ({listed}); default: as it is, or ph; tf for texts")
    parser.add_argument("--format", choices=FORMATS, help="format of the file (default: told by its suffix)")
    parser.add_argument("--name", type=system_name, help="name of the system that is written")
    add_overwrite(parser)
    add_json(parser)


def run(options: Namespace) -> int:
    """Read, convert, write."""
    sources, target = options.files[:-1], options.files[-1]
    wanted = int(options.num is None and options.den is None)
    if len(sources) != wanted:
        raise StructureError(
            ("name the model and the file to write" if wanted else "with --num and --den, name the file to write only")
            + f"; {len(options.files)} given"
        )
    check_sources(sources)
    check_outputs([target], sources, options.overwrite)
    refuse_both(options.json, [target])
    kind = options.format or _format_of(target)
    (model,) = read_models(sources, options)
    form = options.to or ("tf" if kind in ("txt", "csv") else None)
    made = _converted(model, form, options.name)
    deliver(_encoded(made, form, kind), target, options.overwrite)
    if options.json:
        answer = {"command": "convert", "source": model.source, "form": options.to or _form_of(made), "format": kind}
        emit_json({**answer, "written": [target]})
    elif target != "-":
        emit(f"Written: {target}\n")
    return DONE


def _format_of(target: str) -> str:
    if target == "-":
        return "json"
    suffix = Path(target).suffix.lstrip(".").lower()
    if suffix not in FORMATS:
        raise StructureError(
            f"{target} has no known suffix; end its name in one of .{', .'.join(FORMATS)}, or pass --format"
        )
    return suffix


def _form_of(made: Any) -> str:
    names = {"ModalForm": "modes", "ControllableHamiltonian": "ch", "ObservableHamiltonian": "oh"}
    names |= {"TransferFunction": "tf", "AffineHamiltonian": "affine"}
    return names.get(type(made).__name__, "ph")


def _converted(model: Model, form: str | None, name: str | None) -> Any:
    """Object of the wanted form, or of its own."""
    from ..modal.modal_form import ModalForm
    from ..systems import canonical_forms
    from ..systems.affine import AffineHamiltonian
    from ..systems.port_hamiltonian import modes, ph
    from ..systems.transfer_function import tf

    if isinstance(model.content, AffineHamiltonian) and form in (None, "ss"):
        return _renamed(model.content, name)
    found = model.lossless()
    if isinstance(found, ModalForm) and (form not in (None, "modes") or name is not None):
        # modes have no name, and no matrices
        found = ph(found, name=model.name)
    if form == "modes" or isinstance(found, ModalForm):
        return modes(found)
    makers: dict[str, Any] = {"ph": ph, "ch": canonical_forms.ch, "oh": canonical_forms.oh, "tf": tf}
    made = makers[form](found, name=found.name) if form in makers else found
    return _renamed(made, name)


def _renamed(system: Any, name: str | None) -> Any:
    return system if name is None else system.copy(name)


def _encoded(made: Any, form: str | None, kind: str) -> str | bytes:
    """Content of the file."""
    from ..io.codecs import document_of

    found = _form_of(made)
    if found == "tf":
        arrays = polynomials_of(made)
    elif found == "modes" and kind != "json":
        arrays = modes_of(made)
    elif form == "ss" or kind != "json":
        arrays = arrays_of(made)
    else:
        return document_of(made)
    if kind == "mat":
        return matlab_of(arrays)
    return strict(arrays, indent=None) if kind == "json" else _text(arrays, kind)


def _text(arrays: dict[str, Any], kind: str) -> str:
    separator = " " if kind == "txt" else ","
    if "num" in arrays:
        return rows_of(arrays, separator)
    if "d" in arrays:
        return columns_of(arrays, separator)
    raise StructureError(
        "texts hold the coefficients of a transfer function (--to tf) or modes (--to modes); write a .json or .mat file"
    )
