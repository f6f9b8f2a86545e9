"""Measurements of a file of any kind that is read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .frequency_csv import COLUMNS, UNITS, is_frequency_table, response_in
from .matlab_tables import read_mat
from .text_table import read_table
from .time_csv import recording_in
from .touchstone import is_touchstone, read_touchstone
from .universal_file import SUFFIXES, read_uff


def read_measurements(path: str | Path) -> Any:
    """Recording or frequency response of a file, its kind told by suffix and labels, with the defaults of its reader.

    A universal file may hold several; a text table is a frequency response where its labels say so.
    """
    suffix = Path(path).suffix.casefold()
    if suffix in SUFFIXES:
        return read_uff(path)
    if is_touchstone(str(path)):
        return read_touchstone(path)
    if suffix == ".mat":
        return read_mat(path)
    table = read_table(path, None, None, None)
    if is_frequency_table(table):
        return response_in(table, dict.fromkeys(COLUMNS), dict.fromkeys(UNITS))[0]
    return recording_in(table, None, None, None, None, None)
