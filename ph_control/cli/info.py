"""`ph-control info`: what a model is, and whether it is lossless."""

from __future__ import annotations

from argparse import Namespace
from typing import Any

from .._units import hertz_size, rate
from .answers import emit_json, fit_of, modes_of
from .models import Model, read_models
from .options import Parser, add_json, add_model
from .outcome import DONE, NO, NoError, emit, in_shell_terms
from .sources import check_sources

USAGE = "MODEL [MODEL ...] [options]"

DESCRIPTION = """Show what a model is: its modes, and whether it is lossless. Models are JSON files written by this
package or with fields such as A, B, C, D, .mat files with such variables, and texts with the numerator and the
denominator of a transfer function. Exit status 1 if a model is not lossless."""

EXAMPLES = """
  ph-control info fitted.json
  ph-control info plant.mat --json
  ph-control info --num 1,0 --den 1,0,4
  ph-control convert plant.mat - | ph-control info -
"""


def add_options(parser: Parser) -> None:
    """Declare the options."""
    parser.add_argument("models", nargs="*", metavar="MODEL", help="model files; - for standard input")
    add_model(parser)
    add_json(parser)


def run(options: Namespace) -> int:
    """Describe each model."""
    check_sources(options.models)
    answers = [_answer(model) for model in read_models(options.models, options)]
    if options.json:
        fields = [fields for fields, _ in answers]
        emit_json({"command": "info", **fields[0]} if len(fields) == 1 else {"command": "info", "models": fields})
    else:
        emit("\n\n".join(text for _, text in answers) + "\n")
    return DONE if all(fields["lossless"] for fields, _ in answers) else NO


def _answer(model: Model) -> tuple[dict[str, Any], str]:
    """What there is to say of a model, for machines and for people."""
    if model.is_result:
        fields = {"source": model.source, "kind": "PEMResult", "lossless": True, **fit_of(model.content)}
        return fields, in_shell_terms(model.content.summary())
    kind = type(model.content).__name__
    foreign = kind in ("StateSpace", "TransferFunction")
    given = f"{model.source}: {_kind_of(model.content)}" if foreign else ""
    try:
        found = _seen(model)
    except NoError as error:
        fields = {"source": model.source, "kind": kind, "lossless": False, "violations": error.violations}
        return fields, "\n".join([f"{given}, NOT lossless", *(f"  - {line}" for line in error.violations)])
    lines = _lines(found)
    return {
        "source": model.source, "kind": kind, "lossless": True, **_fields_of(found), "violations": []
    }, "\n".join([f"{given}, lossless", *lines] if given else lines)  # fmt: skip


def _kind_of(system: Any) -> str:
    """What kind of system it is, and how large."""
    ports = f"{_counted(system.ninputs, 'input')}, {_counted(system.noutputs, 'output')}"
    if hasattr(system, "A"):
        return f"state space, {_counted(system.nstates, 'state')}, {ports}"
    return f"transfer function of degree {_degree(system)}, {ports}"


def _degree(system: Any) -> int:
    return max(len(den) for row in system.den_list for den in row) - 1


def _seen(model: Model) -> Any:
    """Object with modes; an affine system is what it is."""
    from ..systems.affine import AffineHamiltonian

    return model.content if isinstance(model.content, AffineHamiltonian) else model.lossless()


def _fields_of(found: Any) -> dict[str, Any]:
    form = getattr(found, "modes", found)
    fields = {
        "ports": form.nports,
        "states": getattr(found, "nstates", 2 * form.n),
        "degrees_of_freedom": getattr(found, "n", form.n),
    }
    if hasattr(found, "input_labels"):
        fields |= {"name": found.name, "inputs": found.input_labels, "outputs": found.output_labels}
    if hasattr(found, "is_canonical"):
        fields["canonical"] = bool(found.is_canonical)
    unit = getattr(found, "time_unit", None)
    fields |= {"time_unit": unit, "hertz": form.d / hertz_size(unit) if unit else None}
    return {**fields, **modes_of(form)}


def _lines(found: Any) -> list[str]:
    form = getattr(found, "modes", found)
    ports = _counted(form.nports, "port")
    lines = [f"{type(found).__name__}: {_counted(form.n, 'mode')}, {ports}"]
    if hasattr(found, "input_labels"):
        degrees = f"{_counted(found.n, 'degree')} of freedom, {_counted(found.nstates, 'state')}"
        lines = [
            f"{type(found).__name__} {found.name}: {degrees}, {ports}",
            f"  inputs {', '.join(found.input_labels)}; outputs {', '.join(found.output_labels)}",
        ]
    if hasattr(found, "is_canonical"):
        lines.append(f"  canonical (controllable and observable): {'yes' if found.is_canonical else 'no'}")
    unit = getattr(found, "time_unit", None)
    head = f"d [{rate(unit)}]", f"f [{'Hz' if unit else '1/time'}]"
    lines.append(f"   mode   {head[0]:18}   {head[1]:15}   weight r          residue kappa")
    for l in range(len(form.d)):
        lines.append(
            f"  {l + 1:5d}   {form.d[l]:<18.10g}   {form.d[l] / hertz_size(unit):<15.8g}   "
            f"{_number(form.r[l])}   {_number(form.kappa[l])}".rstrip()
        )
    if len(form.rigid):
        lines.append(f"  pole at 0 with residue kappa_0 = {_number(form.kappa_0)}".rstrip())
    return lines


def _number(value: Any) -> str:
    from numpy import array2string, asarray, ndim

    return f"{value:<15.8g}" if ndim(value) == 0 else array2string(asarray(value), precision=6).replace("\n", "")


def _counted(number: int, noun: str) -> str:
    """Number and noun, plural where it must be."""
    return f"{number} {noun}{'s' * (number != 1)}"
