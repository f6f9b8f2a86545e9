"""Identify a model from recordings or frequency responses with any number of inputs and outputs.

Several files are several experiments with one plant. By default the model has the simplest structure that the data do
not reject: lossless, classical, passive or free. Exit status 1 if no model describes the data.

Examples
--------
  ph-control fit recording.csv --input force --output velocity
  ph-control fit recording.csv --order 2 --model fitted.json --plot fit.png
  ph-control fit first.csv second.csv --offset
  ph-control fit decay.csv --no-input --quantity displacement
  ph-control fit recording.csv --inputs force --outputs velocity --ports velocity:force
  ph-control fit recording.csv --structure lossless
  ph-control fit shaker.csv --order 2 --model fitted.json --overwrite
  cat recording.csv | ph-control fit - --input force --output velocity --order 2 --json
  ph-control fit recording.csv --order 2 --model - | ph-control plot bode - --out bode.svg
"""

from __future__ import annotations

import argparse
from argparse import Namespace
from math import inf
from pathlib import Path
from typing import Any

import ph_control as phc

from ..._options import (
    CRITERIA,
    INITIAL_STATES,
    NOISE_KINDS,
    QUANTITIES,
    REPRESENTATIONS,
    RESPONSE_INTERPOLATIONS,
    SENSOR_QUANTITIES,
    STRUCTURE_CHOICES,
)
from ...exceptions import IdentificationError, StructureError
from ..inputs import measurements, read_model, system_name_of
from ..options import Parser, add_meeting, add_recording, add_written, order, system_name, within
from ..outcome import DONE, INTERRUPTED, NO, NoError, ProgressLine, complain, emit, in_shell_terms
from ..outputs import (
    check_files,
    check_place,
    conclude,
    deliver,
    deliver_picture,
    fit_of,
    is_described,
    picture_format,
)

USAGE = "RECORDING [RECORDING ...] [options]"


def add_options(parser: Parser) -> None:
    """Declare the options."""
    parser.add_argument(
        "recordings", nargs="+", metavar="RECORDING", help="tables of measurements; - for standard input"
    )
    add_recording(parser)
    add_fitted(parser)
    out = parser.add_argument_group("output")
    out.add_argument("--model", metavar="FILE", help="model (JSON); - for standard output, instead of the summary")
    out.add_argument("--result", metavar="FILE", help="complete result with uncertainty and data (JSON)")
    out.add_argument("--report", metavar="FILE", help="summary, tables and plots on one page (html)")
    out.add_argument("--plot", metavar="FILE", help="measurement, prediction and residual (png, svg, pdf)")
    out.add_argument("--bode", metavar="FILE", help="Bode plot of model and measurement (png, svg, pdf)")
    out.add_argument("--experiment", type=int, default=1, metavar="N", help="experiment to plot (default 1)")
    out.add_argument("--name", type=system_name, help="name of the model (default: that of the recording)")
    add_written(out)


def add_fitted(parser: Parser) -> None:
    """What is fitted, and how."""
    model = parser.add_argument_group("the model")
    model.add_argument("--order", type=order, default="auto", metavar="N", help="number of modes, or auto (default)")
    model.add_argument(
        "--real-poles", type=order, default="auto", metavar="N",
        help="number of real poles, as of lags, beside the modes, or auto (default); alone with --order 0",
    )  # fmt: skip
    model.add_argument(
        "--noise", choices=NOISE_KINDS, default="auto", help="what is beside the response to the inputs (default auto)"
    )
    model.add_argument("--max-order", type=int, default=20, metavar="N", help="largest order of auto (default 20)")
    model.add_argument(
        "--criterion", choices=CRITERIA, default="bic", help="criterion that auto minimises (default bic)"
    )
    model.add_argument(
        "--structure", choices=STRUCTURE_CHOICES, default="auto",
        help="assumption about losses and sensors (default auto: the simplest that the data do not reject)",
    )  # fmt: skip
    model.add_argument(
        "--ports", type=ports, metavar="LIST", help="driving points as output:input, such as y1:u1,y2:u2"
    )
    model.add_argument(
        "--quantity", type=quantities, metavar="LIST",
        help=f"{', '.join(QUANTITIES)}, for all outputs or for each (default: from the file, its labels or units, "
        "else velocity)",
    )  # fmt: skip
    add_meeting(model, INITIAL_STATES, "whichever fits better", RESPONSE_INTERPOLATIONS)
    model.add_argument(
        "--no-offset", dest="offset", action="store_false",
        help="no offset (default: an offset or a drift if the data show it)",
    )  # fmt: skip
    parser.set_defaults(offset="auto")
    model.add_argument(
        "--delay", type=delays, default="auto", metavar="LIST",
        help="time by which all outputs, or each of them, come later than the response to the inputs (default auto: "
        "estimated where the data show it)",
    )  # fmt: skip
    model.add_argument(
        "--input-delay", type=delays, default="auto", metavar="LIST",
        help="dead time of each of several inputs, in whole samples (default auto: estimated where the data show it)",
    )  # fmt: skip
    model.add_argument(
        "--representation", choices=REPRESENTATIONS, default="observable",
        help="allow free motion of modes with zero weight (observable, default) or not (controllable)",
    )  # fmt: skip
    model.add_argument("--guess", metavar="MODEL", help="initial model, instead of the search")
    model.add_argument("--seed", type=within(int, 0, inf), metavar="N", help="seed of random starts (default: fixed)")
    model.add_argument(
        "--timeout", type=within(float, 1e-3, 1e9), metavar="SECONDS", help="stop after this time, keep the best model"
    )
    model.add_argument(
        "--watch-progress", action="store_true",
        help="tell the progress every few seconds also where standard error is no terminal",
    )  # fmt: skip
    model.add_argument("--workers", type=int, default=1, metavar="N", help="processes, -1 for all cores (default 1)")


def keywords_of(options: Namespace) -> dict[str, Any]:
    """What is fitted, as `pem` takes it."""
    guess = None
    if options.guess is not None:
        try:
            guess = read_model(options.guess).lossless()
        except NoError as error:
            # status 1 is said of the fit, not of what it starts from
            raise StructureError(f"--guess: {error}") from None
    same = (
        "order", "method", "intersample", "initial_state", "offset", "quantity", "representation", "criterion",
        "max_order", "structure", "ports", "delay", "input_delay", "real_poles", "noise",
    )  # fmt: skip
    return {name: getattr(options, name) for name in same} | {"initial_guess": guess, "rng": options.seed}


def delays(text: str) -> str | float | list[float]:
    """Delay of all outputs, or one of each between commas; or auto."""
    if text == "auto":
        return text
    try:
        times = [float(word) for word in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no delay; write auto, 0, 0.05 or 0.05,0.06") from None
    return times[0] if len(times) == 1 else times


def ports(text: str) -> list[tuple[str | int, str | int]]:
    """Pairs of an output and an input between commas, each with a colon between: labels, or numbers from 0."""
    pairs = [word.strip().rpartition(":") for word in text.split(",")]
    if not all(output and input for output, _, input in pairs):
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of ports; write for example y1:u1,y2:u2")
    return [(_label(output), _label(input)) for output, _, input in pairs]


def _label(text: str) -> str | int:
    return int(text) if text.isdecimal() else text


def quantities(text: str) -> str | list[str]:
    """One quantity, or several between commas."""
    words = [word.strip() for word in text.split(",")]
    wrong = [word for word in words if word not in SENSOR_QUANTITIES]
    if wrong:
        raise argparse.ArgumentTypeError(f"{wrong[0]!r} is none of {', '.join(map(repr, SENSOR_QUANTITIES))}")
    return words[0] if len(words) == 1 else words


def run(options: Namespace) -> int:
    """Fit, print, write."""
    from ...identification.diagnosis.verdict import Outcome
    from ...io.codecs import document_path

    outputs = [options.model, options.result, options.report, options.plot, options.bode]
    check_files(options, [*options.recordings, options.guess], outputs)
    for name in filter(None, (options.model, options.result)):
        document_path(name)
    for name in filter(None, (options.plot, options.bode)):
        picture_format(name)
    place = check_place(options.experiment, len(options.recordings))
    result, expired = _fitted(options)
    first = options.recordings[0]
    result.system.name = options.name or system_name_of("" if first == "-" else Path(first).stem)
    interrupted = result.outcome is Outcome.INTERRUPTED
    silent = "-" in outputs
    if not (silent or options.json):
        emit(in_shell_terms(result.summary()) + "\n" * (1 + any(outputs)))
    _write(result, place, options)
    conclude(options, {"command": "fit", **fit_of(result), "interrupted": interrupted}, outputs)
    described = is_described(result)
    if silent and not described:
        complain(f"the verdict is: {result.verdict}; fit without - to read why")
    if interrupted:
        why = "the time of --timeout is up" if expired else "interrupted"
        complain(f"{why}; this is the best model found until then")
        return INTERRUPTED
    return DONE if described else NO


def _fitted(options: Namespace) -> tuple[phc.PEMResult, bool]:
    """The result, and whether time was up."""
    recordings, keywords = measurements(options.recordings, options), keywords_of(options)
    watch, result = ProgressLine(str, options.timeout, always=options.watch_progress), None
    try:
        with watch:
            result = phc.pem(
                recordings.whole, keywords.pop("order"), **keywords, workers=options.workers, callback=watch.callback,
                **recordings.keywords,
            )  # fmt: skip
    except KeyboardInterrupt:
        if result is None and watch.expired:
            raise IdentificationError(
                f"no model was found in {options.timeout:g} s; allow more by --timeout, or give --order or --structure"
            ) from None
        if result is None or not watch.expired:
            raise
    return result, watch.expired


def _write(result: phc.PEMResult, place: int, options: Namespace) -> None:
    """Write what was asked for."""
    from ...identification.validation.html_report import page_of
    from ...io.codecs import document_of

    if options.model is not None:
        # what is not port-Hamiltonian is kept by its modes
        kept = result.system if isinstance(result.system, phc.PortHamiltonian) else phc.modes(result.system)
        deliver(document_of(kept), options.model, options.overwrite)
    if options.result is not None:
        deliver(document_of(result), options.result, options.overwrite)
    if options.report is not None:
        deliver(page_of(result, f"Identification report: {result.system.name}"), options.report, options.overwrite)
    if options.plot is not None:
        deliver_picture(result.plot(place), options.plot, options.overwrite)
    if options.bode is not None:
        record: Any = result.experiments[place].record
        shown: Any = result if result.residues.shape[1:] == (1, 1) else result.observed_system
        single = shown is result and getattr(record, "driven", True)
        picture = phc.bode_plot(shown, data=record.as_response() if single else None, label="identified model")
        deliver_picture(picture, options.bode, options.overwrite)
