"""Measurements of a file of any kind that is read."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..exceptions import StructureError
from .files import read_bytes, source_name
from .frequency_csv import COLUMNS, UNITS, are_labels_of_response, is_frequency_table, response_in, selected_channels
from .matlab_tables import read_frequency_mat, read_mat
from .tables.text_table import TextOptions, read_table
from .time_csv import recording_in
from .touchstone import is_touchstone, read_touchstone
from .universal_file import SUFFIXES, read_uff

_IN_TIME = ("input", "output", "time", "dt")
_IN_TEXT = ("header", "delimiter", "decimal", "skiprows", "comment")
_IN_FREQUENCY = (*COLUMNS, *UNITS, "weights")


def read_measurements(path: str | Path) -> Any:
    """Recording or frequency response of a file, with the defaults of its reader; of a universal file, a list."""
    found, _ = measured(path, {})
    return found if len(found) > 1 else found[0]


def measured(source: Any, options: Mapping[str, Any]) -> tuple[list[Any], Any]:
    """Recordings or frequency responses of a file, its kind told by its suffix, and weights if a column has them.

    `options` are those of all readers.  A text table is a frequency response where these or its labels say so.
    """
    name, given = source_name(source), {key: value for key, value in options.items() if value is not None}
    suffix, input, output = Path(name).suffix.casefold(), given.get("input"), given.get("output")
    if suffix in SUFFIXES:
        return read_uff(source, input=input or None, output=output), None
    if is_touchstone(name):
        columns, rows = ([one] if isinstance(one, str) else one or None for one in (input, output))
        network = read_touchstone(source, parameter=given.get("parameter", "Z"))
        return [selected_channels(network, columns, rows, name)], None
    if suffix != ".mat":
        return _in_table(source, given)
    if "frequency" not in given:
        return [read_mat(source, **{key: given[key] for key in (*_IN_TIME, "time_unit") if key in given})], None
    if output is None or "frequency_unit" not in given:
        raise StructureError(f"{name}: give --outputs, variables of the response, and --frequency-unit as well")
    unit = given["frequency_unit"]
    return [read_frequency_mat(source, given["frequency"], output, frequency_unit=unit)], None


def _in_table(source: Any, given: Mapping[str, Any]) -> tuple[list[Any], Any]:
    options = TextOptions(*(given.get(key) for key in _IN_TEXT))
    told, contrary = ([key for key in keys if key in given] for keys in (_IN_FREQUENCY, _IN_TIME))
    wanted = None if contrary else are_labels_of_response
    table = read_table(read_bytes(source), source_name(source), options, wanted)
    if told and contrary:
        raise StructureError(
            f"{told[0]}= is for frequency responses and {contrary[0]}= for recordings in time; give one"
        )
    if told or (not contrary and is_frequency_table(table)):
        columns, units = ({key: given.get(key) for key in keys} for keys in (COLUMNS, UNITS))
        data, weights = response_in(table, columns, units, given.get("weights"))
        return [data], weights
    return [recording_in(table, *(given.get(key) for key in (*_IN_TIME, "time_unit")))], None
