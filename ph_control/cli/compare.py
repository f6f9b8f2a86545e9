"""`ph-control compare`: models held against recordings."""

from __future__ import annotations

from argparse import Namespace
from typing import Any

from ..exceptions import StructureError
from .answers import emit_json
from .measurements import measurements
from .models import Model, read_models
from .options import Parser, add_json, add_meeting, add_model, add_overwrite, add_recording, percentage, whole
from .outcome import DONE, NO, complain, emit
from .outputs import check_outputs, check_pictures, deliver_picture, refuse_both
from .sources import check_sources

USAGE = "RECORDING MODEL [MODEL ...] [options]"

DESCRIPTION = """Hold models, fitted or not, lossless or not, against recordings or frequency responses: how many
percent of what was measured each explains. A fit to the recording that a model was made from flatters it; use
another one."""

EXAMPLES = """
  ph-control compare fresh.csv fitted.json plant.mat
  ph-control compare fresh.csv fitted.json --plot comparison.png
  ph-control compare fresh.csv fitted.json --recording second.csv --json
  ph-control compare fresh.csv fitted.json --at-least 90
  cat fresh.csv | ph-control compare - fitted.json --label fitted
"""


def add_options(parser: Parser) -> None:
    """Declare the options."""
    parser.add_argument("first", metavar="RECORDING", help="table of measurements; - for standard input")
    parser.add_argument("models", nargs="*", metavar="MODEL", help="models, as ph-control info reads them")
    parser.add_argument("--recording", action="append", default=[], metavar="FILE", help="one more experiment")
    parser.add_argument(
        "--label", action="append", metavar="NAME", help="name of a model, in order (default: the file)"
    )
    parser.add_argument("--at-least", type=percentage, metavar="PERCENT", help="exit status 1 if the best fit is below")
    add_meeting(parser, ("estimate", "zero", "fitted"))
    parser.add_argument("--plot", metavar="FILE", help="measured and simulated outputs, and the errors (png, svg, pdf)")
    parser.add_argument("--experiment", type=whole, default=1, metavar="N", help="which of several to draw (default 1)")
    add_recording(parser)
    add_model(parser)
    add_overwrite(parser)
    add_json(parser)


def run(options: Namespace) -> int:
    """Compare, print, draw."""
    names = [options.first, *options.recording]
    check_sources([*names, *options.models])
    check_outputs([options.plot], [*names, *options.models], options.overwrite)
    refuse_both(options.json, [options.plot])
    check_pictures([options.plot])
    if not 1 <= options.experiment <= len(names):
        raise StructureError(f"--experiment is {options.experiment}; there are {len(names)}, counted from 1: name one")
    models = read_models(options.models, options)
    found = _compared(names, models, options)
    if options.plot is not None:
        deliver_picture(found.plot(options.experiment - 1), options.plot, options.overwrite)
    if options.json:
        emit_json(_answer(found, models, options))
    elif options.plot != "-":
        emit(f"{found}\n" + (f"\nWritten: {options.plot}\n" if options.plot else ""))
    best = float(found.fit_percent.max())
    if options.at_least is None or best >= options.at_least:
        return DONE
    complain(f"the best fit is {best:.2f} %, below the {options.at_least:g} % of --at-least")
    return NO


def _compared(names: list[str], models: list[Model], options: Namespace) -> Any:
    from ..identification.validation.comparison import compare

    data = measurements(names, options)
    labels = options.label or [model.label for model in models]
    return compare(
        data.data if len(names) > 1 or data.weights is not None else data.data[0],
        *(model.content for model in models),
        method=options.method,
        intersample=options.intersample,
        initial_state=options.initial_state,
        offset=options.offset,
        labels=labels,
        **data.keywords,
    )


def _answer(found: Any, models: list[Model], options: Namespace) -> dict[str, Any]:
    rows = zip(models, found.labels, found.fit_percent, found.rms_error, found.own_record, strict=True)
    return {
        "command": "compare",
        "output": found.output_label,
        "best": found.best,
        "models": [
            {"label": label, "source": model.source, "fit_percent": fit, "rms_error": error, "own_record": own}
            for model, label, fit, error, own in rows
        ],
        "experiments": [
            {"samples": one.record.samples, "fit_percent": one.fit_percent, "rms_error": one.rms_error}
            for one in found.experiments
        ],
        "written": [options.plot] if options.plot else [],
    }
