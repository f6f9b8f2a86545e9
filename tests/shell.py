"""Lines of a shell, run in this process: pipes, standard input and output, `cat`, `>` and `echo $?`."""

from __future__ import annotations

import io
import os
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from ph_control.cli import main


@dataclass(frozen=True)
class Outcome:
    """Exit status and what was written to standard output and standard error."""

    status: int
    output: bytes
    error: str

    @property
    def out(self) -> str:
        """Standard output as text."""
        return self.output.decode()


@contextmanager
def streams(stdin: bytes) -> Iterator[tuple[io.BytesIO, io.StringIO]]:
    """Standard streams of their own, such as a process has."""
    before = sys.stdin, sys.stdout, sys.stderr
    output, error = io.BytesIO(), io.StringIO()
    sys.stdin = io.TextIOWrapper(io.BytesIO(stdin))
    sys.stdout = text = io.TextIOWrapper(output, encoding="utf-8", write_through=True)
    sys.stderr = error
    try:
        yield output, error
    finally:
        sys.stdin, sys.stdout, sys.stderr = before
        # the buffer is still asked for
        text.detach()


def run(*arguments: Any, stdin: bytes | str = b"") -> Outcome:
    """Run `ph-control` with these arguments."""
    content = stdin.encode() if isinstance(stdin, str) else stdin
    with streams(content) as (output, error):
        status = main([str(argument) for argument in arguments])
    return Outcome(status, output.getvalue(), error.getvalue())


def without_pictures(monkeypatch: Any) -> None:
    """Leave pictures empty, where others of the same command are drawn elsewhere: they take most of its time."""

    def empty(figure: Figure, file: Any, **options: Any) -> None:
        if hasattr(file, "write"):
            file.write(b"<svg/>")
        else:
            Path(file).write_bytes(b"")

    monkeypatch.setattr(Figure, "savefig", empty)


class Shell:
    """A folder in which lines are run one after the other."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.status = 0

    def line(self, line: str) -> Outcome:
        """Run a line; the status is that of the last command of a pipe."""
        line, _, target = line.partition(" > ")
        before = Path.cwd()
        os.chdir(self.folder)
        try:
            found, errors = Outcome(0, b"", ""), ""
            for command in line.split(" | "):
                found = self._command(shlex.split(command), found.output)
                errors += found.error
            if target:
                Path(target.strip()).write_bytes(found.output)
        finally:
            os.chdir(before)
        self.status = found.status
        return Outcome(found.status, b"" if target else found.output, errors)

    def _command(self, words: list[str], stdin: bytes) -> Outcome:
        if words[0] == "cat":
            return Outcome(0, b"".join(Path(name).read_bytes() for name in words[1:]), "")
        if words == ["echo", "$?"]:
            return Outcome(0, f"{self.status}\n".encode(), "")
        assert words[0] == "ph-control", words
        return run(*words[1:], stdin=stdin)
