"""`ph-control fit`: a model from measurements."""

from __future__ import annotations

import sys
from argparse import Namespace
from math import sqrt
from pathlib import Path
from typing import Any

from ..exceptions import StructureError
from .answers import emit_json, fit_of, is_described
from .measurements import Measurements, measurements
from .options import (
    INTERSAMPLE,
    Parser,
    add_json,
    add_meeting,
    add_overwrite,
    add_recording,
    order,
    seed,
    system_name,
    system_name_of,
    whole,
)
from .outcome import DONE, INTERRUPTED, NO, NoError, complain, emit, in_shell_terms
from .outputs import check_outputs, check_pictures, deliver, deliver_picture, refuse_both
from .sources import check_sources

USAGE = "RECORDING [RECORDING ...] [options]"

DESCRIPTION = """Identify a lossless model from recordings of one input and one output, or from frequency
responses. Several files are several experiments with one plant. Exit status 1 if no such model describes the data."""

EXAMPLES = """
  ph-control fit recording.csv --input force --output velocity
  ph-control fit recording.csv --order 2 --model fitted.json --plot fit.png
  ph-control fit first.csv second.csv --offset
  ph-control fit decay.csv --no-input --quantity displacement
  ph-control fit shaker.csv --order 2 --model fitted.json --overwrite
  cat recording.csv | ph-control fit - --input force --output velocity --order 2 --json
  ph-control fit recording.csv --order 2 --model - | ph-control plot bode - --out bode.svg
"""

CRITERIA = ("bic", "aicc", "aic", "holdout")
QUANTITIES = ("velocity", "displacement", "acceleration")
REPRESENTATIONS = ("observable", "controllable")


def add_options(parser: Parser) -> None:
    """Declare the options."""
    parser.add_argument(
        "recordings", nargs="+", metavar="RECORDING", help="tables of measurements; - for standard input"
    )
    add_recording(parser)
    model = parser.add_argument_group("the model")
    model.add_argument("--order", type=order, default="auto", metavar="N", help="number of modes, or auto (default)")
    model.add_argument("--max-order", type=whole, default=20, metavar="N", help="largest order of auto (default 20)")
    model.add_argument("--criterion", choices=CRITERIA, default="bic", help="what auto minimises (default bic)")
    model.add_argument("--quantity", choices=QUANTITIES, default="velocity", help="what was measured of the port")
    add_meeting(model, ("estimate", "zero"), ("auto", *INTERSAMPLE))  # type: ignore[arg-type]
    model.add_argument(
        "--no-offset", dest="offset", action="store_false",
        help="estimate no constant (default: one, or one that drifts, where the data show it)",
    )  # fmt: skip
    parser.set_defaults(offset="auto")
    model.add_argument(
        "--representation", choices=REPRESENTATIONS, default="observable",
        help="whether modes without weight may move (observable, default) or not",
    )  # fmt: skip
    model.add_argument("--guess", metavar="MODEL", help="model to start from, in place of the search")
    model.add_argument("--seed", type=seed, metavar="N", help="seed of further starts (default: always the same)")
    model.add_argument(
        "--workers", type=whole, default=1, metavar="N", help="processes for them, -1 for all (default 1)"
    )
    out = parser.add_argument_group("what is written")
    out.add_argument("--model", metavar="FILE", help="the model (JSON); - for standard output, in place of the summary")
    out.add_argument("--result", metavar="FILE", help="the whole result, uncertainty and residuals too (JSON)")
    out.add_argument("--plot", metavar="FILE", help="measured, predicted and residual (png, svg, pdf)")
    out.add_argument("--bode", metavar="FILE", help="Bode picture of the model and the measurement (png, svg, pdf)")
    out.add_argument("--experiment", type=whole, default=1, metavar="N", help="which of several to draw (default 1)")
    out.add_argument("--name", type=system_name, help="name of the model (default: that of the recording)")
    add_overwrite(out)  # type: ignore[arg-type]
    add_json(out)  # type: ignore[arg-type]


def run(options: Namespace) -> int:
    """Fit, print, write."""
    outputs = [options.model, options.result, options.plot, options.bode]
    check_sources(options.recordings + [options.guess] * (options.guess is not None))
    check_outputs(outputs, [*options.recordings, *([options.guess] if options.guess else [])], options.overwrite)
    refuse_both(options.json, outputs)
    check_pictures([options.plot, options.bode])
    if not 1 <= options.experiment <= len(options.recordings):
        raise StructureError(
            f"--experiment is {options.experiment}; there are {len(options.recordings)}, counted from 1: name one"
        )
    result = _fitted(measurements(options.recordings, options), options)
    result.system.name = options.name or _name_of(options.recordings[0])
    from ..identification.diagnosis.verdict import Outcome

    interrupted = result.outcome is Outcome.INTERRUPTED
    silent = "-" in outputs
    if not (silent or options.json):
        emit(in_shell_terms(result.summary()) + "\n")
    written = _write(result, options)
    if options.json:
        emit_json({"command": "fit", **fit_of(result), "interrupted": interrupted, "written": written})
    elif written and not silent:
        emit("\nWritten: " + ", ".join(written) + "\n")
    described = is_described(result)
    if silent and not described:
        complain(f"the verdict is: {result.verdict}; fit without - to read why")
    if interrupted:
        complain("interrupted; this is the best model found until then")
        return INTERRUPTED
    return DONE if described else NO


def _fitted(found: Measurements, options: Namespace) -> Any:
    from ..identification.fit.pem import pem

    guess = None
    if options.guess is not None:
        from .models import read_model

        try:
            guess = read_model(options.guess).lossless()
        except NoError as error:
            # status 1 is said of the fit, not of what it starts from
            raise StructureError(f"--guess: {error}") from None
    watched = sys.stderr is not None and sys.stderr.isatty()
    try:
        return pem(
            found.data if len(found.data) > 1 or found.weights is not None else found.data[0],
            options.order,
            method=options.method,
            intersample=options.intersample,
            initial_state=options.initial_state,
            offset=options.offset,
            quantity=options.quantity,
            representation=options.representation,
            initial_guess=guess,
            criterion=options.criterion,
            max_order=options.max_order,
            workers=options.workers,
            rng=options.seed,
            callback=_progress_line if watched else None,
            **found.keywords,
        )
    finally:
        if watched:
            print("\r\033[K", end="", file=sys.stderr, flush=True)


def _name_of(recording: str) -> str:
    """Name of the model, such as python-control accepts."""
    return system_name_of("" if recording == "-" else Path(recording).stem)


def _progress_line(progress: Any) -> None:
    print(
        f"\r\033[Korder {progress.order} of at most {progress.max_order}, iteration {progress.iteration}, "
        f"rms residual {sqrt(progress.loss):.4g}",
        end="",
        file=sys.stderr,
        flush=True,
    )


def _write(result: Any, options: Namespace) -> list[str]:
    """Write what was asked for; names of the files."""
    from ..io.codecs import document_of

    for name, thing in ((options.model, result.system), (options.result, result)):
        if name is not None:
            deliver(document_of(thing), name, options.overwrite)
    if options.plot is not None:
        deliver_picture(result.plot(options.experiment - 1), options.plot, options.overwrite)
    if options.bode is not None:
        deliver_picture(_bode(result, options.experiment - 1), options.bode, options.overwrite)
    return [name for name in (options.model, options.result, options.plot, options.bode) if name not in (None, "-")]


def _bode(result: Any, experiment: int) -> Any:
    from ..plotting.bode_plot import bode_plot

    record = result.experiments[experiment].record
    data = record.as_response() if getattr(record, "driven", True) else None
    return bode_plot(result, data=data, label="identified model")
