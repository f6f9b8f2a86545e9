"""Reduce the number of states of a model; the reduced model is port-Hamiltonian.

The suffix selects the format: .json, .mat, .txt or .csv. For the result of a fit, its model is reduced. Exit status 1
if the model is not passive.

Examples
--------
  ph-control reduce fitted.json small.json --order 2
  ph-control reduce plant.mat band.mat --band 0,1.5
  ph-control reduce --num 2,4,3 --den 1,3,4,2 --tolerance 0.1 --method balanced -
"""

from __future__ import annotations

from argparse import Namespace

import numpy as np

import ph_control as phc

from ..._options import REDUCTIONS
from ..inputs import read_models, source_and_target
from ..options import Parser, add_files, add_written, pair
from ..outputs import conclude, deliver
from .convert import FORMATS, encoded, format_of

USAGE = "MODEL FILE [options]"


def add_options(parser: Parser) -> None:
    """Declare the options."""
    add_files(parser, "file")
    parser.add_argument("--order", type=int, metavar="N", help="maximum number of states")
    parser.add_argument(
        "--tolerance",
        type=float,
        metavar="X",
        help="maximum error relative to the largest gain; uses the fewest states",
    )
    parser.add_argument(
        "--band", type=pair, metavar="LOW,HIGH", help="natural frequencies to keep, in rad per unit time"
    )
    parser.add_argument("--method", choices=REDUCTIONS, default="modal", help="reduction method (default: modal)")
    parser.add_argument("--format", choices=FORMATS, help="file format (default: from the suffix)")
    add_written(parser)


def run(options: Namespace) -> int:
    """Read, reduce, write."""
    sources, target = source_and_target(options, "the file to write")
    kind = options.format or format_of(target)
    (model,) = read_models(sources, options)
    given = phc.ph(model.port_hamiltonian())
    small = phc.reduce(
        given, options.order, tolerance=options.tolerance, band=options.band, method=options.method
    )  # fmt: skip
    deliver(encoded(small, "tf" if kind in ("txt", "csv") else None, kind), target, options.overwrite)
    bound = small.error_bound if small.error_bound is not None and np.isfinite(small.error_bound) else None
    answer = {"command": "reduce", "source": model.source, "method": options.method, "states": small.nstates}
    error = "unbounded" if bound is None else f"{bound:.4g}"
    text = f"{given.nstates} states reduced to {small.nstates}, largest difference {error}"
    return conclude(options, {**answer, "error_bound": bound}, [target], text)
