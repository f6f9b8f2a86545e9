"""What a command reads: files, or standard input."""

from __future__ import annotations

import io
import sys
from collections.abc import Sequence
from pathlib import Path

from ..exceptions import FileFormatError, StructureError
from .outcome import complain


class Source(io.BytesIO):
    """Content of a file in memory, with its name for errors and titles."""

    def __init__(self, content: bytes, name: str) -> None:
        super().__init__(content)
        self.name = name

    @property
    def stem(self) -> str:
        """Name without folder and suffix."""
        return Path(self.name).stem or self.name


def check_sources(names: Sequence[str]) -> None:
    """Refuse to read standard input twice."""
    if list(names).count("-") > 1:
        raise StructureError("- stands more than once for standard input, which can be read once; name a file")


def opened(name: str) -> Source:
    """Content of a file, or of standard input for `-`."""
    from ..io.files import read_bytes

    if name != "-":
        return Source(read_bytes(name), name)
    if sys.stdin is None:
        raise StructureError("standard input is closed; name a file in place of -")
    if sys.stdin.isatty():
        complain("reading standard input from the terminal; it ends with Ctrl-D on a line of its own")
    stream = getattr(sys.stdin, "buffer", sys.stdin)
    content = read_bytes(stream)
    if not content.strip():
        raise FileFormatError("standard input is empty; the command before the pipe wrote nothing")
    return Source(content, "standard input")
