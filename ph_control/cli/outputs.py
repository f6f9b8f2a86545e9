"""What a command writes: files that appear whole or not at all, or standard output."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..exceptions import FileMissingError, OutputExistsError, StructureError
from .outcome import emit, emit_bytes


def check_outputs(outputs: Sequence[str | None], sources: Sequence[str], overwrite: bool) -> None:
    """Refuse before the work what would fail after it."""
    named = [name for name in outputs if name is not None]
    if named.count("-") > 1:
        raise StructureError("- stands more than once for standard output; name a file for all but one")
    files = [Path(name) for name in named if name != "-"]
    for path in files:
        _check(path, [Path(source) for source in sources if source != "-"], overwrite)
    if len({path.resolve() for path in files}) < len(files):
        raise StructureError("two of the output files have the same name; give each its own")


def _check(path: Path, sources: list[Path], overwrite: bool) -> None:
    try:
        exists = path.exists()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise StructureError(f"{str(path)[:60]!r} cannot be the name of a file: {reason}; choose another") from None
    if exists and any(source.exists() and path.samefile(source) for source in sources):
        raise OutputExistsError(f"{path} is one of the inputs, which are never overwritten; name another file")
    if exists and not path.is_file():
        raise OutputExistsError(f"{path} is not a regular file; name another one")
    if exists and not overwrite:
        raise OutputExistsError(f"{path} exists; name another file, or pass --overwrite to replace it")
    if exists and not path.stat().st_mode & 0o222:
        raise OutputExistsError(f"{path} is read-only; make it writable, or name another file")
    if not path.resolve().parent.is_dir():
        raise FileMissingError(f"{path} cannot be written: its folder does not exist; make it first")


def refuse_both(json: bool, outputs: Sequence[str | None]) -> None:
    """Refuse two things on one standard output."""
    if json and "-" in outputs:
        raise StructureError("--json and - both want standard output; name a file in place of -")


def deliver(content: str | bytes, name: str, overwrite: bool) -> None:
    """Write a file, or standard output for `-`."""
    if name != "-":
        from ..io.files import write_atomically

        write_atomically(Path(name), content, overwrite=overwrite)
    elif isinstance(content, str):
        emit(content)
    else:
        emit_bytes(content)


# --- pictures --------------------------------------------------------------------------------------------------------


def check_pictures(outputs: Sequence[str | None]) -> None:
    """Refuse names that tell no format a picture can have."""
    for name in outputs:
        if name is not None:
            picture_format(name)


def picture_format(name: str, wanted: str | None = None) -> str:
    """Format of a picture: that asked for, or that of the suffix of its name."""
    from matplotlib.backend_bases import FigureCanvasBase

    formats = sorted(FigureCanvasBase.get_supported_filetypes())
    if wanted is None and name == "-":
        raise StructureError("standard output has no suffix to tell the format of a picture; pass --format png")
    found = (wanted or Path(name).suffix.lstrip(".")).lower()
    if found not in formats:
        raise StructureError(f"{name} has no known picture format; end its name in one of .{', .'.join(formats)}")
    return found


def deliver_picture(
    plot: Any, name: str, overwrite: bool, *, format: str | None = None, dpi: float = 150,
    inches: tuple[float, float] | None = None,
) -> None:  # fmt: skip
    """Write the figure of a plot, the same bytes for the same figure, and close it."""
    import matplotlib.pyplot as plt

    kind = picture_format(name, format)
    stamp = {"svg": "Date", "svgz": "Date", "pdf": "CreationDate", "ps": "CreationDate", "eps": "CreationDate"}
    if inches is not None:
        plot.figure.set_size_inches(*inches)
    with io.BytesIO() as buffer, plt.rc_context({"svg.hashsalt": "ph_control"}):
        plot.figure.savefig(
            buffer, format=kind, dpi=dpi, metadata={stamp[kind]: None} if kind in ("svg", "svgz", "pdf") else None
        )
        plt.close(plot.figure)
        deliver(buffer.getvalue(), name, overwrite)
