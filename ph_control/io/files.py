"""Files: their content, and new content that appears whole or not at all."""

from __future__ import annotations

import os
import platform
import re
import secrets
import shutil
import stat
import time
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

from .. import _checks
from ..exceptions import FileFormatError, FileMissingError, OutputExistsError, PHControlError, StructureError, printable

_HOST = f"{zlib.crc32(platform.node().encode()):08x}"
_TEMPORARY = re.compile(r"\.ph_control-(?:([0-9a-f]{8})-)?[0-9a-f]{16}\.tmp")  # the host, and what makes it unique
_DAY = 86400.0  # longer than any file is written


def as_path(name: Any) -> Path:
    """Path of what the caller gave as the name of a file; what no file can be called is refused."""
    try:
        path = Path(name)
        if not name:
            raise TypeError  # it would be the working folder
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


def source_name(source: object) -> str:
    """Name of what is read, for errors and titles: that of the file, also of one that is open already."""
    name = getattr(source, "name", "the stream") if hasattr(source, "read") else source
    return printable(os.fsdecode(name) if isinstance(name, bytes) else str(name), one_line=True)


def read_bytes(source: object) -> bytes:
    """Content of a file: of that name, or open already, for bytes or for text."""
    if hasattr(source, "read"):
        try:
            content = source.read()
        except ValueError as error:  # closed, open for writing only, or of another encoding
            raise StructureError(
                f"{source_name(source)} cannot be read: {error}; pass its name, or open it for reading, as bytes best"
            ) from error
        if isinstance(content, str):
            try:
                return content.encode(errors="surrogateescape")
            except UnicodeEncodeError:
                raise FileFormatError(f"{source_name(source)} holds halves of characters; open it as bytes") from None
        if not isinstance(content, bytes | bytearray | memoryview):
            raise StructureError(f"{source_name(source)} gives {_checks.shown(content)}; its read must give bytes")
        return bytes(content)
    path = as_path(source)
    name = source_name(path)
    if path.is_dir():
        raise FileFormatError(f"{name} is a folder; pass the file in it")
    try:
        return path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        raise FileMissingError(
            f"there is no file {name} (looked from {Path.cwd()}); check its name and folder"
        ) from None
    except OSError as error:
        raise StructureError(f"{name} cannot be read: {error.strerror or error}; check its permissions") from error


def refuse_unwritable(path: Path, overwrite: bool) -> None:
    """Refuse a path that cannot be written, and a file that must not be overwritten."""
    _checks.flags(overwrite=overwrite)
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
    stream, temporary = _temporary_file(target.parent, target)
    try:
        try:
            stream.write(content.encode() if isinstance(content, str) else content)
            stream.flush()
            os.fsync(stream.fileno())
            if fcntl is None:
                stream.close()  # what is open cannot be renamed there
            # somebody else may have made it in the meantime
            refuse_unwritable(target, overwrite)
            if target.exists():
                shutil.copymode(target, temporary)
            # still locked, so that nobody takes it for abandoned
            os.replace(temporary, target)
        finally:
            stream.close()
    except PHControlError:
        raise
    except OSError as error:
        # the caller knows the name of the file, not that of the temporary one
        raise OSError(error.errno, error.strerror, str(target)) from None
    finally:
        with suppress(OSError):
            temporary.unlink()
    _remove_abandoned(target.parent)


def _temporary_file(folder: Path, target: Path) -> tuple[BinaryIO, Path]:
    """New file for the content of another, open and locked, and its name."""
    while True:
        name = folder / f".ph_control-{_HOST}-{secrets.token_hex(8)}.tmp"
        try:
            # not tempfile: its files are private, this one shall have the permissions of any new file
            stream = open(name, "xb")
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(target)) from None
        # between opening and locking another process may have taken it for abandoned
        if not _locked(stream.fileno()) or os.fstat(stream.fileno()).st_nlink:
            return stream, name
        stream.close()


def _locked(descriptor: int) -> bool:
    """Lock an open file, which the death of its process ends; False where that cannot be or another one has it."""
    if fcntl is None:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _remove_abandoned(folder: Path) -> None:
    """Remove temporary files whose processes were killed while they wrote."""
    with suppress(OSError), os.scandir(folder) as entries:
        names = [(entry.path, match[1]) for entry in entries if (match := _TEMPORARY.fullmatch(entry.name))]
        for path, host in names:
            with suppress(OSError):
                _remove_if_abandoned(path, host == _HOST)


def _remove_if_abandoned(path: str, of_this_host: bool) -> None:
    """Remove a temporary file that nobody writes: by its lock on this host, else by its age."""
    status = os.lstat(path)
    own = stat.S_ISREG(status.st_mode) and (fcntl is None or status.st_uid == os.getuid())
    if not own or not (time.time() - status.st_mtime > _DAY or (of_this_host and fcntl is not None)):
        return
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0))
    try:
        if fcntl is not None and not _locked(descriptor):
            return
        if fcntl is not None:
            os.unlink(path)  # while it is locked
    finally:
        os.close(descriptor)
    if fcntl is None:
        os.unlink(path)  # what another process has open stays
