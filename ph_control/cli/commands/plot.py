"""Plot one or several models.

The suffix selects the format: .png, .svg or .pdf. bode, step, impulse and poles accept any linear system, modes and
energy passive systems, and fit the result of a fit (ph-control fit --result).

Examples
--------
  ph-control plot bode fitted.json --out bode.png
  ph-control plot bode fitted.json plant.mat --recording recording.csv --out both.pdf
  ph-control plot step result.json --band 0.95 --until 40 --out step.svg
  ph-control plot impulse --num 1,0 --den 1,0.1,4 --out impulse.png
  ph-control plot modes result.json --out modes.png
  ph-control plot poles fitted.json --hz --out poles.png
  ph-control plot energy fitted.json --recording recording.csv --out energy.png
  ph-control plot fit result.json --out fit.png
  cat fitted.json | ph-control plot bode - --out - --format svg > piped.svg
"""

from __future__ import annotations

import math
from argparse import Namespace
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import ph_control as phc

from ..._units import unit_for, with_unit
from ...exceptions import StructureError
from ..inputs import Model, labels_of, measurements, read_models
from ..options import Parser, add_labels, add_model, add_recording, add_written, pair, size, within
from ..outputs import check_files, check_place, conclude, deliver_picture, picture_format

if TYPE_CHECKING:
    from control import ControlPlot, TimeResponseData

USAGE = "KIND MODEL [MODEL ...] --out FILE [options]"

_TITLES = {
    "bode": "Bode plot", "step": "Step response", "impulse": "Impulse response", "modes": "Modes",
    "poles": "Poles and zeros",
}  # fmt: skip


def add_options(parser: Parser) -> None:
    """Declare the options."""
    parser.add_argument("kind", choices=tuple(_PICTURES), metavar="KIND", help=", ".join(_PICTURES))
    add_labels(parser)
    parser.add_argument("-o", "--out", required=True, metavar="FILE", help="plot to write; - for standard output")
    parser.add_argument("--format", metavar="NAME", help="png, svg or pdf (default: from the suffix)")
    parser.add_argument("--title", help="title of the plot")
    parser.add_argument("--hz", action="store_true", help="frequencies in Hz (bode, modes, poles)")
    parser.add_argument("--omega", type=pair, metavar="LOW,HIGH", help="limits of the frequency axis (bode)")
    parser.add_argument(
        "--until",
        type=within(float, 1e-300, 1e300),
        metavar="TIME",
        help="end of the time axis (step, impulse, energy)",
    )
    parser.add_argument(
        "--band", type=float, metavar="LEVEL", help="shade the confidence band of a fit at this level, such as 0.95"
    )
    parser.add_argument("--unit", help="unit of the response or energy")
    parser.add_argument("--experiment", type=int, metavar="N", help="experiment to plot (fit; default 1)")
    parser.add_argument("--size", type=size, metavar="WIDTH,HEIGHT", help="in inches")
    parser.add_argument(
        "--dpi", type=within(float, 10, 2400), default=150.0, help="dots per inch of a png (default 150)"
    )
    parser.add_argument("--recording", metavar="FILE", help="measurement (bode), or recorded input (energy)")
    add_recording(parser)
    add_model(parser)
    add_written(parser)


def run(options: Namespace) -> int:
    """Read, draw, write."""
    check_files(options, [*options.models, options.recording], [options.out])
    picture_format(options.out, options.format)
    draw, taken = _PICTURES[options.kind]
    for option in ("omega", "hz", "band", "recording", "until", "experiment"):
        if getattr(options, option) not in (None, False) and option not in taken:
            kinds = ", ".join(kind for kind, (_, others) in _PICTURES.items() if option in others)
            raise StructureError(f"--{option} has no meaning for {options.kind}; it is for {kinds}")
    models = read_models(options.models, options)
    options.time_unit = unit_for(options.time_unit, [model.content for model in models])
    labels = labels_of(models, options)
    if options.title is None and options.kind in _TITLES and len(labels) <= 3:
        options.title = f"{_TITLES[options.kind]} of {', '.join(labels)}"
    plot = draw(models, labels, options)
    deliver_picture(plot, options.out, options.overwrite, format=options.format, dpi=options.dpi, inches=options.size)
    return conclude(options, {"command": "plot", "kind": options.kind, "models": labels}, [options.out])


def _around(models: Sequence[Model], options: Namespace) -> dict[str, Any]:
    """Bands around the models that are results of fits."""
    if options.band is None:
        return {}
    if not any(model.is_result for model in models):
        raise StructureError("--band is drawn around results of fits; pass a file of ph-control fit --result")
    return {"confidence": [model.content if model.is_result else None for model in models], "level": options.band}


def _bode(models: list[Model], labels: list[str], options: Namespace) -> ControlPlot:
    data = measurements([options.recording], options).whole if options.recording else None
    return phc.bode_plot(
        [model.content for model in models], data=data, omega_limits=options.omega, Hz=options.hz, label=labels,
        title=options.title, gain_unit=options.unit, time_unit=options.time_unit, **_around(models, options),
    )  # fmt: skip


def _transient(models: list[Model], labels: list[str], options: Namespace) -> ControlPlot:
    draw = phc.step_plot if options.kind == "step" else phc.impulse_plot
    return draw(
        [model.content for model in models], options.until, label=labels, title=options.title,
        output_unit=options.unit, time_unit=options.time_unit, **_around(models, options),
    )  # fmt: skip


def _modes(models: list[Model], labels: list[str], options: Namespace) -> ControlPlot:
    given = [model.content if model.is_result else model.port_hamiltonian() for model in models]
    return phc.modes_plot(
        given, Hz=options.hz, label=labels, title=options.title, gain_unit=options.unit, time_unit=options.time_unit
    )


def _poles(models: list[Model], labels: list[str], options: Namespace) -> ControlPlot:
    given = [model.content for model in models]
    return phc.pole_zero_plot(given, Hz=options.hz, label=labels, title=options.title, time_unit=options.time_unit)


def _energy(models: list[Model], labels: list[str], options: Namespace) -> ControlPlot:
    from ...systems.port_hamiltonian import full_port_hamiltonian

    systems = [full_port_hamiltonian(model.port_hamiltonian()) for model in models]
    for model, system in zip(models, systems, strict=True):
        if not system.nstates:
            raise StructureError(f"{model.source} has no modes, so it stores no energy; there is nothing to draw")
    balances = [phc.energy_balance(_driven(system, options), system) for system in systems]
    what = "a recorded input" if options.recording else "a unit step"
    return phc.energy_plot(
        balances, label=labels if len(labels) > 1 else None, time_unit=options.time_unit, energy_unit=options.unit,
        title=options.title or f"Energy of {', '.join(labels)} under {what}",
    )  # fmt: skip


def _driven(system: phc.PortHamiltonian, options: Namespace) -> TimeResponseData:
    """Response from rest, with states, to the recorded input or to a unit step."""
    import numpy as np

    if options.recording is None:
        time = phc.step_response(system, options.until).time
        return phc.forced_response(system, time, np.ones((system.ninputs, len(time))), return_states=True)
    recordings = measurements([options.recording], options)
    record = recordings.data[0]
    if not recordings.in_time or record.ninputs != system.ninputs:
        raise StructureError(
            f"{options.recording} has no recorded input for the {system.ninputs} of the model, which supplies the "
            "energy; name another, or leave --recording out for a unit step"
        )
    end = math.inf if options.until is None else options.until
    count = int(np.sum(record.time - record.time[0] <= end))
    if count < 2:
        raise StructureError(f"--until {end:g} leaves {count} sample of the recording; name a later end")
    time, inputs = record.time[:count], record.inputs[..., :count]
    return with_unit(phc.forced_response(system, time, inputs, return_states=True, intersample="zoh"), record.time_unit)


def _fit(models: list[Model], labels: list[str], options: Namespace) -> ControlPlot:
    if len(models) != 1 or not models[0].is_result:
        raise StructureError("fit draws one result of a fit; pass the file of ph-control fit --result")
    result = models[0].content
    place = check_place(1 if options.experiment is None else options.experiment, len(result.experiments))
    given = {"title": options.title, "time_unit": options.time_unit, "output_unit": options.unit}
    return result.plot(place, **{key: value for key, value in given.items() if value is not None})


# how each is drawn, and which of the options it takes that not every picture has a meaning for
_PICTURES = {
    "bode": (_bode, ("omega", "hz", "band", "recording")),
    "step": (_transient, ("until", "band")),
    "impulse": (_transient, ("until", "band")),
    "modes": (_modes, ("hz",)),
    "poles": (_poles, ("hz",)),
    "energy": (_energy, ("until", "recording")),
    "fit": (_fit, ("experiment",)),
}
