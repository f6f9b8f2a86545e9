"""Compare models of any kind with recordings or frequency responses.

The output is the fit of each model in percent. Use a recording that was not used for the identification of the models;
otherwise the fit is optimistic.

Examples
--------
  ph-control compare fresh.csv fitted.json plant.mat
  ph-control compare fresh.csv fitted.json --plot comparison.png
  ph-control compare fresh.csv fitted.json --recording second.csv --json
  ph-control compare fresh.csv fitted.json --at-least 90
  ph-control compare fresh.csv fitted.json --horizon 1
  ph-control compare machine.csv machine.json --inputs u1,u2 --outputs y1,y2
  cat fresh.csv | ph-control compare - fitted.json --label fitted
"""

from __future__ import annotations

from argparse import Namespace

import ph_control as phc

from ..inputs import labels_of, measurements, read_models
from ..options import Parser, add_labels, add_meeting, add_model, add_recording, add_written
from ..outcome import DONE, NO, complain
from ..outputs import check_files, check_place, conclude, deliver_picture, picture_format

USAGE = "RECORDING MODEL [MODEL ...] [options]"


def add_options(parser: Parser) -> None:
    """Declare the options."""
    parser.add_argument("first", metavar="RECORDING", help="table of measurements; - for standard input")
    add_labels(parser)
    parser.add_argument("--recording", action="append", default=[], metavar="FILE", help="additional experiment")
    parser.add_argument("--at-least", type=float, metavar="PERCENT", help="exit status 1 if the best fit is lower")
    add_meeting(parser, ("estimate", "zero", "fitted"), "as in the fits, else held")
    parser.add_argument("--horizon", type=int, metavar="STEPS", help="predict so many steps ahead, do not simulate")
    parser.add_argument("--plot", metavar="FILE", help="measured and simulated outputs, and the errors (png, svg, pdf)")
    parser.add_argument("--experiment", type=int, default=1, metavar="N", help="experiment to plot (default 1)")
    add_recording(parser)
    add_model(parser)
    add_written(parser)


def run(options: Namespace) -> int:
    """Compare, print, draw."""
    names = [options.first, *options.recording]
    check_files(options, [*names, *options.models], [options.plot])
    if options.plot is not None:
        picture_format(options.plot)
    place = check_place(options.experiment, len(names))
    models = read_models(options.models, options)
    data = measurements(names, options)
    comparison = phc.compare(
        data.whole, *(model.content for model in models), method=options.method, intersample=options.intersample,
        initial_state=options.initial_state, offset=options.offset, labels=labels_of(models, options),
        horizon=options.horizon, **data.keywords,
    )  # fmt: skip
    if options.plot is not None:
        deliver_picture(comparison.plot(place), options.plot, options.overwrite)
    numbers = comparison.fit_percent, comparison.rms_error, comparison.own_record, comparison.output_fit_percent
    rows = zip(models, comparison.labels, *numbers, strict=True)
    answer = {
        "command": "compare",
        "output": comparison.output_label,
        "best": comparison.best,
        "models": [
            {
                "label": label, "source": model.source, "fit_percent": fit, "rms_error": error, "own_record": own,
                "outputs": dict(zip(comparison.output_labels, each, strict=True)),
            }
            for model, label, fit, error, own, each in rows
        ],
        "experiments": [
            {"samples": part.record.samples, "fit_percent": part.fit_percent, "rms_error": part.rms_error}
            for part in comparison.experiments
        ],
        "horizon": comparison.horizon,
    }  # fmt: skip
    conclude(options, answer, [options.plot], f"{comparison}\n")
    best = float(comparison.fit_percent.max())
    if options.at_least is None or best >= options.at_least:
        return DONE
    complain(f"the best fit is {best:.2f} %, below the {options.at_least:g} % of --at-least")
    return NO
