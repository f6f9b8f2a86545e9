"""Files: their content, and new content that appears whole or not at all."""

from __future__ import annotations

import os
import secrets
import shutil
from contextlib import suppress
from pathlib import Path
from typing import Any

from .. import _checks
from ..exceptions import FileFormatError, FileMissingError, OutputExistsError, PHControlError, StructureError


def as_path(name: Any) -> Path:
    """Path of what the caller gave as the name of a file; what no file can be called is refused."""
    try:
        path = Path(name)
    except TypeError:
        raise StructureError(
            f"path is {_checks.shown(name)}; it must be the name of a file, as a string or pathlib.Path"
        ) from None
    try:
        os.stat(path)
    except (FileNotFoundError, NotADirectoryError, PermissionError):
        pass
    except (OSError, ValueError) as error:  # too long, or with characters that the system does not allow
        reason = getattr(error, "strerror", None) or error
        raise StructureError(
            f"{str(path)[:80]!r} cannot be the name of a file: {reason}; choose another name"
        ) from None
    return path


def source_name(source: Any) -> str:
    """Name of what is read, for errors and titles: that of the file, also of one that is open already."""
    return str(getattr(source, "name", "the stream") if hasattr(source, "read") else source)


def read_bytes(source: Any) -> bytes:
    """Content of a file: of that name, or open already, for bytes or for text."""
    if hasattr(source, "read"):
        try:
            content = source.read()
        except ValueError as error:  # closed, open for writing only, or of another encoding
            raise StructureError(
                f"{source_name(source)} cannot be read: {error}; pass its name, or open it for reading, as bytes best"
            ) from error
        return content.encode() if isinstance(content, str) else bytes(content)
    path = as_path(source)
    if path.is_dir():
        raise FileFormatError(f"{path} is a folder; pass the file in it")
    try:
        return path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        raise FileMissingError(
            f"there is no file {path} (looked from {Path.cwd()}); check its name and folder"
        ) from None


def refuse_unwritable(path: Path, overwrite: bool) -> None:
    """Refuse a path that cannot be written, and a file that must not be overwritten."""
    if path.is_dir():
        raise OutputExistsError(f"{path} is a folder; pass the name of a file in it")
    if path.exists() and not path.is_file():
        # renaming a file to it would put the file in the place of the device
        raise OutputExistsError(f"{path} is not a regular file, but a device, a pipe or a socket; choose another name")
    if path.exists() and not path.stat().st_mode & 0o222:
        raise OutputExistsError(f"{path} is read-only; make it writable, or choose another name")
    if not overwrite and os.path.lexists(path):
        raise OutputExistsError(f"{path} exists already; choose another name, or pass overwrite=True to replace it")
    if not path.parent.is_dir():
        raise FileMissingError(f"the folder {path.parent} does not exist; make it first")


def write_atomically(path: Path, content: str | bytes, *, overwrite: bool) -> None:
    """Write a file so that its name shows the old content or all of the new, never a part.

    The content goes to a temporary file in the same folder, reaches the disk, and then takes the name, and with it the
    permissions of a file that it replaces.
    """
    refuse_unwritable(path, overwrite)
    # through a symbolic link the file it points at is replaced, not the link
    target = path.resolve()
    refuse_unwritable(target, overwrite)
    temporary = target.with_name(f".ph_control-{secrets.token_hex(8)}.tmp")
    try:
        # not tempfile: its files are private, this one shall have the permissions of any new file
        with open(temporary, "xb") as stream:
            stream.write(content.encode() if isinstance(content, str) else content)
            stream.flush()
            os.fsync(stream.fileno())
        # somebody else may have made it in the meantime
        refuse_unwritable(target, overwrite)
        if target.exists():
            shutil.copymode(target, temporary)
        os.replace(temporary, target)
    except PHControlError:
        raise
    except OSError as error:
        # the caller knows the name of the file, not that of the temporary one
        raise OSError(error.errno, error.strerror, str(target)) from None
    finally:
        with suppress(OSError):
            temporary.unlink()
