"""Write a circuit with the transfer function of a model, as SPICE text.

Inductors, capacitors and resistors for a model that is lossless or has classical damping; controlled sources for any
passive one with --form state-space. Elements of a fit of one port have standard errors in the answer of --json. The
transfer function is the admittance (voltage in, current out) unless --kind impedance. All commands also accept netlists
(.cir, .net, .sp) as models. Exit status 1 if the model has no port-Hamiltonian form.

Examples
--------
  ph-control netlist fitted.json circuit.cir
  ph-control netlist plant.mat ladder.cir --form cauer1 --kind impedance
  ph-control netlist --num 1,0 --den 1,0,4 -
"""

from __future__ import annotations

from argparse import Namespace

import ph_control as phc

from ..._options import CIRCUIT_FORMS, IMMITTANCES
from ..inputs import read_models, source_and_target
from ..options import Parser, add_files, add_written
from ..outputs import conclude, deliver

USAGE = "MODEL FILE [options]"


def add_options(parser: Parser) -> None:
    """Declare the options."""
    add_files(parser, "netlist")
    parser.add_argument(
        "--form", choices=CIRCUIT_FORMS,
        help="form of a lossless one-port, or controlled sources for any passive model (default: one resonator for "
        "each mode)",
    )  # fmt: skip
    parser.add_argument(
        "--kind",
        choices=IMMITTANCES,
        default="admittance",
        help="meaning of the transfer function (default: admittance)",
    )
    add_written(parser)


def run(options: Namespace) -> int:
    """Read, synthesize, write."""
    sources, target = source_and_target(options, "the netlist")
    (model,) = read_models(sources, options)
    system = model.content if model.is_result else model.port_hamiltonian()
    circuit = phc.netlist(system, options.form, kind=options.kind)
    deliver(circuit.spice(), target, options.overwrite)
    elements = [
        {"name": element.name, "nodes": element.nodes, "value": element.value, "stderr": element.stderr}
        for element in circuit.elements
    ]
    answer = {"command": "netlist", "source": model.source, "form": circuit.form, "kind": circuit.kind}
    return conclude(options, {**answer, "elements": elements}, [target])
