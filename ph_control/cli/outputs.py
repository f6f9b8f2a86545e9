"""What commands write: answers as JSON, and files that appear whole or not at all, or standard output."""

from __future__ import annotations

import io
import json
import math
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..exceptions import OutputExistsError, StructureError
from .outcome import DONE, emit

if TYPE_CHECKING:
    from control import ControlPlot

    import ph_control as phc

# --- answers ---------------------------------------------------------------------------------------------------------

_FIT = (
    "verdict", "message", "order", "structure", "fit_percent", "time_unit", "loss", "loglik", "aic", "bic", "whiteness",
    "success", "intersample", "method", "quantity", "blind", "d", "natural_frequencies", "damping_ratios", "real_poles",
)  # fmt: skip
_MODAL = (
    "poles", "residues", "feedthrough", "shapes", "participation", "shapes_scaled", "phase_collinearity",
    "noise_variance", "quantities", "delay", "input_delay",
)  # fmt: skip


def strict(value: object, indent: int | None = 2) -> str:
    """JSON of arrays, tuples and complex numbers (`[re, im]`); null where a number is not finite."""
    from ..io.json_format import plain

    return json.dumps(plain(value, lambda number: None), indent=indent, allow_nan=False) + "\n"


def emit_json(answer: dict[str, object]) -> None:
    """Print an answer."""
    emit(strict(answer))


def conclude(options: Namespace, answer: dict[str, Any], files: Sequence[str | None], text: str = "") -> int:
    """Say what was done and written: as JSON or as text, but for text where a file is standard output."""
    written = [name for name in files if name not in (None, "-")]
    if options.json:
        emit_json({**answer, "written": written})
    elif "-" not in files:
        emit(text + "\n" * bool(text and written) + f"Written: {', '.join(filter(None, written))}\n" * bool(written))
    return DONE


def modes_of(form: Any) -> dict[str, object]:
    """Fields of a modal form."""
    kappa_0 = form.kappa_0 if len(form.rigid) else 0.0
    return {"d": form.d, "frequency": form.d / (2 * math.pi), "r": form.r, "kappa": form.kappa, "kappa_0": kappa_0}


def fit_of(result: phc.PEMResult) -> dict[str, object]:
    """Fields of the result of a fit."""
    answer = {
        **_fields(result, *_FIT),
        "described": is_described(result),
        "findings": [
            {**_fields(finding, "values", "gain", "output", "experiment"), "cause": finding.cause.value}
            for finding in result.findings
        ],
        "frequency": result.d / (2 * math.pi),
        "hertz": None if result.time_unit is None else result.hertz,
        "stderr": dict(result.stderr),
        "tests": [dict(vars(test)) for test in result.tests],
        "experiments": [_experiment_of(experiment) for experiment in result.experiments],
        "order_table": [_fields(row, "order", "loss", "aic", "bic", "d") for row in result.order_table],
    }
    inputs, outputs = result.input_labels, result.output_labels
    ports = [f"{outputs[o]}:{inputs[i]}" for o, i in result.ports]
    answer |= _fields(result, *_MODAL) | {"inputs": inputs, "outputs": outputs, "ports": ports}
    if "r" in result.stderr:
        answer |= _fields(result, "r", "kappa")
    return answer


def _fields(thing: object, *names: str) -> dict[str, object]:
    return {name: getattr(thing, name) for name in names}


def _experiment_of(experiment: Any) -> dict[str, object]:
    record = experiment.record
    missing = int((~record.observed).sum())
    moved = {name: getattr(experiment, name) for name in ("initial_state", "offset", "drift", "offsets", "drifts")
             if hasattr(experiment, name)}  # fmt: skip
    return moved | {
        "title": record.title, "samples": record.samples, "missing": missing, "step": getattr(record, "dt", None),
        "fit_percent": experiment.fit_percent,
    }  # fmt: skip


def is_described(result: phc.PEMResult) -> bool:
    """Whether the verdict leaves a model standing."""
    return len(result.poles) > 0 and result.outcome.leaves_a_model


# --- files -----------------------------------------------------------------------------------------------------------


def check_files(options: Namespace, sources: Sequence[str | None], outputs: Sequence[str | None]) -> None:
    """Refuse before the work what would fail after it: files that cannot be written, and streams used twice."""
    from ..io.files import as_path, refuse_unwritable

    for names, stream in ((sources, "input, which can be read once"), (outputs, "output")):
        if list(names).count("-") > 1:
            raise StructureError(f"- stands more than once for standard {stream}; name a file for all but one")
    if options.json and "-" in outputs:
        raise StructureError("--json and - both want standard output; name a file in place of -")
    read, written = ([as_path(name) for name in names if name not in (None, "-")] for names in (sources, outputs))
    for path in written:
        if path.exists() and any(source.exists() and path.samefile(source) for source in read):
            raise OutputExistsError(f"{path} is one of the inputs, which are never overwritten; name another file")
        refuse_unwritable(path, getattr(options, "overwrite", False))
    if len({path.resolve() for path in written}) < len(written):
        raise StructureError("two of the output files have the same name; give each its own")


def deliver(content: str | bytes, name: str, overwrite: bool) -> None:
    """Write a file, or standard output for `-`."""
    if name == "-":
        emit(content)
    else:
        from ..io.files import write_atomically

        write_atomically(Path(name), content, overwrite=overwrite)


def check_place(place: int, count: int) -> int:
    """Index of the experiment that is asked for by its number."""
    if not 1 <= place <= count:
        raise StructureError(f"--experiment is {place}; there are {count}, counted from 1: name one")
    return place - 1


# --- pictures --------------------------------------------------------------------------------------------------------


def picture_format(name: str, wanted: str | None = None) -> str:
    """Format of a picture: that asked for, or that of the suffix of its name."""
    from matplotlib.backend_bases import FigureCanvasBase

    formats = sorted(FigureCanvasBase.get_supported_filetypes())
    if wanted is None and name == "-":
        raise StructureError("standard output has no suffix to tell the format of a picture; pass --format png")
    format = (wanted or Path(name).suffix.lstrip(".")).lower()
    if format not in formats:
        raise StructureError(f"{name} has no known picture format; end its name in one of .{', .'.join(formats)}")
    return format


def deliver_picture(
    plot: ControlPlot, name: str, overwrite: bool, *, format: str | None = None, dpi: float = 150,
    inches: tuple[float, float] | None = None,
) -> None:  # fmt: skip
    """Write the figure of a plot, the same bytes for the same figure, and close it."""
    import matplotlib.pyplot as plt

    kind = picture_format(name, format)
    # the time of drawing, which these formats tell
    stamp = {"svg": {"Date": None}, "svgz": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind)
    if inches is not None:
        plot.figure.set_size_inches(*inches)
    with io.BytesIO() as buffer, plt.rc_context({"svg.hashsalt": "ph_control"}):
        plot.figure.savefig(buffer, format=kind, dpi=dpi, metadata=stamp)
        plt.close(plot.figure)
        deliver(buffer.getvalue(), name, overwrite)
