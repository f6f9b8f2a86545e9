"""Recordings and frequency responses as commands take them."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ..exceptions import FileFormatError, PHControlError, StructureError
from .sources import Source, opened

_IN_TIME = ("input", "output", "time", "dt", "no_input", "no_time")
_IN_FREQUENCY = (
    "frequency", "magnitude", "phase", "real", "imag", "frequency_unit", "magnitude_unit", "phase_unit", "weights"
)  # fmt: skip
_HEAD = 65536  # bytes that tell the labels


@dataclass(frozen=True)
class Measurements:
    """Experiments, all in time or all in frequency; weights of the latter, if a column of them was named."""

    data: list[Any]
    weights: list[Any] | None
    in_time: bool

    @property
    def keywords(self) -> dict[str, Any]:
        """Weights as `pem` and `compare` take them."""
        return {} if self.weights is None else {"weights": self.weights}


def measurements(names: Sequence[str], options: Namespace) -> Measurements:
    """Read tables; they hold frequency responses if the options or the labels say so."""
    sources = [opened(name) for name in names]
    for source in sources:
        if source.getvalue()[:64].lstrip()[:1] == b"{":
            raise FileFormatError(
                f"{source.name} holds JSON, perhaps a model, and a table of measurements is needed; ph-control info "
                "shows models"
            )
    told = [option for option in _IN_FREQUENCY if getattr(options, option) is not None]
    contrary = [option for option in _IN_TIME if getattr(options, option) not in (None, False)]
    if told and contrary:
        raise StructureError(
            f"{_spelt(told[0])} is for frequency responses and {_spelt(contrary[0])} for recordings in time; give one "
            "of them"
        )
    if told or (not contrary and all(_is_response(source, options) for source in sources)):
        return _responses(sources, options)
    return Measurements([_recording(source, options) for source in sources], None, True)


def _spelt(option: str) -> str:
    return "--" + option.replace("_", "-")


def _layout(options: Namespace) -> dict[str, Any]:
    return {"header": options.header, "delimiter": options.delimiter, "decimal": options.decimal}


def _is_response(source: Source, options: Namespace) -> bool:
    """Whether the labels of a table are those of a frequency response."""
    from ..io.frequency_csv import is_frequency_table
    from ..io.text_table import read_table

    head = source.getvalue()[:_HEAD]
    if len(head) == _HEAD:
        head = head.rpartition(b"\n")[0]
    try:
        return is_frequency_table(read_table(Source(head, source.name), **_layout(options)))
    except PHControlError:
        # told when it is read as a whole
        return False


def _recording(source: Source, options: Namespace) -> Any:
    from ..io.time_csv import read_csv

    for role in ("input", "time"):
        if getattr(options, f"no_{role}") and getattr(options, role) is not None:
            raise StructureError(f"--{role} and --no-{role} contradict one another; give one of them")
    return read_csv(
        source,
        input=False if options.no_input else options.input,
        output=options.output,
        time=False if options.no_time else options.time,
        dt=options.dt,
        time_unit=options.time_unit,
        **_layout(options),
    )


def _responses(sources: list[Source], options: Namespace) -> Measurements:
    from ..io.frequency_csv import UNITS, response_in
    from ..io.text_table import read_table

    columns = {role: getattr(options, role) for role in _IN_FREQUENCY[:5]}
    units = {name: getattr(options, name) for name in UNITS}
    found = [response_in(read_table(source, **_layout(options)), columns, units, options.weights) for source in sources]
    weights = None if options.weights is None else [each for _, each in found]
    return Measurements([data for data, _ in found], weights, False)
