"""Show the modes of a model, and whether it is lossless, passive or neither.

Models are JSON files of this package, JSON or .mat files with fields such as A, B, C, D, and text files with numerator
and denominator of a transfer function. Exit status 1 if a model is not passive and so has no port-Hamiltonian form.

Examples
--------
  ph-control info fitted.json
  ph-control info plant.mat --json
  ph-control info --num 1,0 --den 1,0,4
  ph-control convert plant.mat - | ph-control info -
"""

from __future__ import annotations

from argparse import Namespace
from typing import Any

import ph_control as phc

from ..._display import counted
from ..._units import hertz_size, rate
from ..inputs import Model, read_models
from ..options import Parser, add_json, add_model
from ..outcome import DONE, NO, NoError, emit, in_shell_terms
from ..outputs import check_files, emit_json, fit_of, modes_of

USAGE = "MODEL [MODEL ...] [options]"


def add_options(parser: Parser) -> None:
    """Declare the options."""
    parser.add_argument("models", nargs="*", metavar="MODEL", help="model files; - for standard input")
    add_model(parser)
    add_json(parser)


def run(options: Namespace) -> int:
    """Describe each model."""
    check_files(options, options.models, [])
    answers = [_answer(model) for model in read_models(options.models, options)]
    if options.json:
        fields = [fields for fields, _ in answers]
        emit_json({"command": "info", **(fields[0] if len(fields) == 1 else {"models": fields})})
    else:
        emit("\n\n".join(text for _, text in answers) + "\n")
    return DONE if all("violations" not in fields or not fields["violations"] for fields, _ in answers) else NO


def _answer(model: Model) -> tuple[dict[str, object], str]:
    """What there is to say of a model, for machines and for people."""
    known: dict[str, Any] = {"source": model.source, "kind": type(model.content).__name__}
    if model.is_result:
        result = model.content
        return {**known, "lossless": result.structure == "lossless", **fit_of(result)}, in_shell_terms(result.summary())
    given = _foreign(model)
    try:
        # an affine system is what it is
        system = model.content if isinstance(model.content, phc.AffineHamiltonian) else model.port_hamiltonian()
    except NoError as error:
        text = "\n".join([f"{given}, NOT {error.missing}", *(f"  - {line}" for line in error.violations)])
        return {**known, "lossless": False, "violations": error.violations}, text
    known["lossless"] = bool(system.is_lossless)
    lines = [f"{given}, {'lossless' if system.is_lossless else 'with losses'}"] if given else []
    return {**known, **_fields_of(system), "violations": []}, "\n".join(lines + _lines(system))


def _foreign(model: Model) -> str:
    """What kind of system of python-control it is, and how large; nothing for those of this package."""
    from control import StateSpace, TransferFunction

    system = model.content
    if type(system) is StateSpace:
        kind = f"state space, {counted(system.nstates, 'state')}"
    elif type(system) is TransferFunction:
        kind = f"transfer function of degree {max(len(den) for row in system.den_list for den in row) - 1}"
    else:
        return ""
    return f"{model.source}: {kind}, {counted(system.ninputs, 'input')}, {counted(system.noutputs, 'output')}"


def _modes(system: phc.PortHamiltonian) -> tuple[phc.ModalForm, str | None]:
    """Modal form, and the unit of time."""
    return system if isinstance(system, phc.ModalForm) else system.modes, getattr(system, "time_unit", None)


def _fields_of(system: Any) -> dict[str, object]:
    form, unit = _modes(system)
    fields: dict[str, Any] = {"ports": form.nports, "states": 2 * form.n, "degrees_of_freedom": form.n}
    if system is not form:
        fields |= {"states": system.nstates, "degrees_of_freedom": system.n, "name": system.name}
        fields |= {"inputs": system.input_labels, "outputs": system.output_labels}
    if not _in_d_and_r(form):
        fields |= {"states": len(form.poles)} if system is form else {}
        damped = {"natural_frequencies": form.natural_frequencies, "damping_ratios": form.damping_ratios}
        hertz = form.natural_frequencies / hertz_size(unit) if unit else None
        return {**fields, "sensors": form.noutputs - form.nports, "time_unit": unit, "hertz": hertz, **damped}
    if isinstance(system, phc.PortHamiltonian):
        fields["canonical"] = bool(system.is_canonical)
    return {**fields, "time_unit": unit, "hertz": form.d / hertz_size(unit) if unit else None, **modes_of(form)}


def _lines(system: phc.PortHamiltonian) -> list[str]:
    form, unit = _modes(system)
    kind, ports = type(system).__name__, counted(form.nports, "port")
    if system is form:
        lines = [f"{kind}: {counted(form.n, 'mode')}, {ports}"]
    else:
        degrees = f"{counted(system.n, 'degree')} of freedom, {counted(system.nstates, 'state')}"
        lines = [
            f"{kind} {system.name}: {degrees}, {ports}",
            f"  inputs {', '.join(system.input_labels)}; outputs {', '.join(system.output_labels)}",
        ]
    if not _in_d_and_r(form):
        return lines + _damped_lines(system, form, unit)
    if isinstance(system, phc.PortHamiltonian):
        lines.append(f"  canonical (controllable and observable): {'yes' if system.is_canonical else 'no'}")
    head = f"d [{rate(unit)}]", f"f [{'Hz' if unit else '1/time'}]"
    lines.append(f"   mode   {head[0]:18}   {head[1]:15}   weight r          residue kappa")
    for l, (d, r, kappa) in enumerate(zip(form.d, form.r, form.kappa, strict=True), 1):
        row = f"  {l:5d}   {d:<18.10g}   {d / hertz_size(unit):<15.8g}   {_number(r)}   {_number(kappa)}"
        lines.append(row.rstrip())
    if len(form.rigid):
        lines.append(f"  pole at 0 with residue kappa_0 = {_number(form.kappa_0)}".rstrip())
    return lines


def _in_d_and_r(form: phc.ModalForm) -> bool:
    """Whether frequencies and weights tell everything."""
    from ...modal.general_form import GeneralModalForm

    return not isinstance(form, GeneralModalForm)


def _damped_lines(system: phc.PortHamiltonian, form: phc.ModalForm, unit: str | None) -> list[str]:
    """Losses and sensors of a system, and a table of natural frequencies and damping ratios."""
    lines = []
    if system is not form:
        more = system._beyond_lossless()
        lines.append(f"  {'lossless' if system.is_lossless else 'port-Hamiltonian with losses'}: {', '.join(more)}")
    head = f"[{rate(unit)}]", f"f [{'Hz' if unit else '1/time'}]"
    lines.append(f"   mode   natural frequency {head[0]:12} {head[1]:15}   damping ratio [%]")
    rows = zip(form.natural_frequencies, form.damping_ratios, strict=True)
    for l, (w, zeta) in enumerate(rows, 1):
        lines.append(f"  {l:5d}   {w:<30.10g} {w / hertz_size(unit):<15.8g}   {100 * zeta:.6g}")
    return lines


def _number(value: Any) -> str:
    from numpy import array2string, asarray, ndim

    return f"{value:<15.8g}" if ndim(value) == 0 else array2string(asarray(value), precision=6).replace("\n", "")
