"""`ph-control plot`: pictures of models."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from typing import Any

from .._units import unit_for, with_unit
from ..exceptions import StructureError
from .answers import emit_json
from .measurements import measurements
from .models import Model, read_models
from .options import (
    Parser,
    add_json,
    add_model,
    add_overwrite,
    add_recording,
    pair,
    positive,
    resolution,
    share,
    size,
    whole,
)
from .outcome import DONE, emit
from .outputs import check_outputs, deliver_picture, picture_format, refuse_both
from .sources import check_sources

USAGE = "KIND MODEL [MODEL ...] --out FILE [options]"

DESCRIPTION = """Draw models, several in one picture. The format is told by the suffix: .png, .svg, .pdf. Bode, step,
impulse and poles take systems that are not lossless too; fit takes the result of a fit (ph-control fit --result)."""

EXAMPLES = """
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

# which of the options that not every picture has a meaning for it has
_TAKEN = {
    "bode": ("omega", "hz", "band", "recording"),
    "step": ("until", "band"),
    "impulse": ("until", "band"),
    "modes": ("hz",),
    "poles": ("hz",),
    "energy": ("until", "recording"),
    "fit": ("experiment",),
}


_TITLES = {
    "bode": "Bode plot", "step": "Step response", "impulse": "Impulse response", "modes": "Modes",
    "poles": "Poles and zeros",
}  # fmt: skip


def add_options(parser: Parser) -> None:
    """Declare the options."""
    parser.add_argument("kind", choices=tuple(_TAKEN), metavar="KIND", help=", ".join(_TAKEN))
    parser.add_argument("models", nargs="*", metavar="MODEL", help="models, as ph-control info reads them")
    parser.add_argument("-o", "--out", required=True, metavar="FILE", help="picture to write; - for standard output")
    parser.add_argument("--format", metavar="NAME", help="png, svg, pdf (default: told by the suffix)")
    parser.add_argument(
        "--label", action="append", metavar="NAME", help="name of a model, in order (default: the file)"
    )
    parser.add_argument("--title", help="title of the picture")
    parser.add_argument("--hz", action="store_true", help="frequencies in Hz (bode, modes, poles)")
    parser.add_argument("--omega", type=pair, metavar="LOW,HIGH", help="ends of the frequency axis (bode)")
    parser.add_argument("--until", type=positive, metavar="TIME", help="end of the time axis (step, impulse, energy)")
    parser.add_argument(
        "--band", type=share, metavar="LEVEL", help="shade where this share of the models around a fit is, such as 0.95"
    )
    parser.add_argument("--unit", help="unit of the response, or of the energy")
    parser.add_argument("--experiment", type=whole, metavar="N", help="which of several experiments (fit; default 1)")
    parser.add_argument("--size", type=size, metavar="WIDTH,HEIGHT", help="in inches")
    parser.add_argument("--dpi", type=resolution, default=150.0, help="dots per inch of a png (default 150)")
    parser.add_argument("--recording", metavar="FILE", help="measurement to draw (bode), or input to use (energy)")
    add_recording(parser)
    add_model(parser)
    add_overwrite(parser)
    add_json(parser)


def run(options: Namespace) -> int:
    """Read, draw, write."""
    sources = [*options.models, *([options.recording] if options.recording else [])]
    check_sources(sources)
    check_outputs([options.out], sources, options.overwrite)
    refuse_both(options.json, [options.out])
    picture_format(options.out, options.format)
    _refuse_meaningless(options)
    models = read_models(options.models, options)
    options.time_unit = unit_for(options.time_unit, [model.content for model in models])
    labels = options.label or [model.label for model in models]
    if len(labels) != len(models):
        raise StructureError(f"{len(labels)} labels for {len(models)} models; give one --label for each")
    if options.title is None and options.kind in _TITLES and len(labels) <= 3:
        options.title = f"{_TITLES[options.kind]} of {', '.join(labels)}"
    plot = _PICTURES[options.kind](models, labels, options)
    deliver_picture(plot, options.out, options.overwrite, format=options.format, dpi=options.dpi, inches=options.size)
    if options.json:
        emit_json({"command": "plot", "kind": options.kind, "models": labels, "written": [options.out]})
    elif options.out != "-":
        emit(f"Written: {options.out}\n")
    return DONE


def _refuse_meaningless(options: Namespace) -> None:
    for option in ("omega", "hz", "band", "recording", "until", "experiment"):
        if getattr(options, option) not in (None, False) and option not in _TAKEN[options.kind]:
            kinds = ", ".join(kind for kind, taken in _TAKEN.items() if option in taken)
            raise StructureError(f"--{option} has no meaning for {options.kind}; it is for {kinds}")


def _around(models: Sequence[Model], options: Namespace) -> dict[str, Any]:
    """Bands around the models that are results of fits."""
    if options.band is None:
        return {}
    if not any(model.is_result for model in models):
        raise StructureError("--band is drawn around results of fits; pass a file of ph-control fit --result")
    return {"confidence": [model.content if model.is_result else None for model in models], "level": options.band}


def _drawn(models: Sequence[Model]) -> list[Any]:
    """Systems of the models; of a fit that to the quantity that was measured."""
    return [model.content.observed_system if model.is_result else model.content for model in models]


def _bode(models: list[Model], labels: list[str], options: Namespace) -> Any:
    from ..plotting.bode_plot import bode_plot

    data = measurements([options.recording], options).data[0] if options.recording else None
    return bode_plot(
        [model.content for model in models], data=data, omega_limits=options.omega, Hz=options.hz, label=labels,
        title=options.title, gain_unit=options.unit, time_unit=options.time_unit, **_around(models, options),
    )  # fmt: skip


def _transient(models: list[Model], labels: list[str], options: Namespace) -> Any:
    from ..plotting import time_plot as time_plots

    draw = time_plots.step_plot if options.kind == "step" else time_plots.impulse_plot
    return draw(
        _drawn(models), options.until, label=labels, title=options.title, output_unit=options.unit,
        time_unit=options.time_unit, **_around(models, options),
    )  # fmt: skip


def _modes(models: list[Model], labels: list[str], options: Namespace) -> Any:
    from ..plotting.mode_plot import modes_plot

    given = [model.content if model.is_result else model.lossless() for model in models]
    return modes_plot(
        given, Hz=options.hz, label=labels, title=options.title, gain_unit=options.unit, time_unit=options.time_unit
    )


def _poles(models: list[Model], labels: list[str], options: Namespace) -> Any:
    from ..plotting.mode_plot import pole_zero_plot

    given = _drawn(models)
    return pole_zero_plot(given, Hz=options.hz, label=labels, title=options.title, time_unit=options.time_unit)


def _energy(models: list[Model], labels: list[str], options: Namespace) -> Any:
    from ..analysis.energy import energy_balance
    from ..plotting.energy_plot import energy_plot
    from ..systems.port_hamiltonian import full_port_hamiltonian

    systems = [full_port_hamiltonian(model.lossless()) for model in models]
    for model, system in zip(models, systems, strict=True):
        if not system.nstates:
            raise StructureError(f"{model.source} has no modes, so it stores no energy; there is nothing to draw")
    responses = [_driven(system, options) for system in systems]
    balances = [energy_balance(response, system) for response, system in zip(responses, systems, strict=True)]
    what = "a recorded input" if options.recording else "a unit step"
    return energy_plot(
        balances, label=labels if len(labels) > 1 else None, time_unit=options.time_unit, energy_unit=options.unit,
        title=options.title or f"Energy of {', '.join(labels)} under {what}",
    )  # fmt: skip


def _driven(system: Any, options: Namespace) -> Any:
    """Response from rest, with states, to the recorded input or to a unit step."""
    import numpy as np

    from ..analysis.time_response import forced_response, step_response

    if options.recording is None:
        time = step_response(system, options.until).time
        return forced_response(system, time, np.ones((system.ninputs, len(time))), return_states=True)
    found = measurements([options.recording], options)
    if not found.in_time or found.data[0].ninputs != system.ninputs:
        raise StructureError(
            f"{options.recording} has no recorded input for the {system.ninputs} of the model, which supplies the "
            "energy; name another, or leave --recording out for a unit step"
        )
    record = found.data[0]
    count = len(record.time) if options.until is None else int(np.sum(record.time - record.time[0] <= options.until))
    if count < 2:
        raise StructureError(f"--until {options.until:g} leaves {count} sample of the recording; name a later end")
    found = forced_response(
        system, record.time[:count], record.inputs[..., :count], return_states=True, intersample="zoh"
    )
    return with_unit(found, record.time_unit)


def _fit(models: list[Model], labels: list[str], options: Namespace) -> Any:
    if len(models) != 1 or not models[0].is_result:
        raise StructureError("fit draws one result of a fit; pass the file of ph-control fit --result")
    result = models[0].content
    place, count = options.experiment or 1, len(result.experiments)
    if not 1 <= place <= count:
        raise StructureError(f"--experiment is {place}; there are {count}, counted from 1: name one")
    given = {"title": options.title, "time_unit": options.time_unit, "output_unit": options.unit}
    return result.plot(place - 1, **{key: value for key, value in given.items() if value is not None})


_PICTURES = {
    "bode": _bode, "step": _transient, "impulse": _transient, "modes": _modes, "poles": _poles, "energy": _energy,
    "fit": _fit,
}  # fmt: skip
