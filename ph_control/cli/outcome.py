"""How a run ends: exit status, one line for every error, and never a traceback."""

from __future__ import annotations

import _thread
import io
import os
import re
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from ..exceptions import IdentifiabilityWarning, NotLosslessError, PHControlError, printable, shortened

DONE, NO, BAD, BROKEN, INTERRUPTED, UNREAD = 0, 1, 2, 3, 130, 141

EXIT_CODES = (
    "Exit status: 0 done, 1 negative answer (not passive, no model describes the data), 2 wrong usage or bad input, "
    "3 internal error, 130 interrupted."
)

# what messages of the library say in Python, as options
_SPOKEN = (
    (r"\(None, y\)", "--no-input"),
    (r"\b(input|time|header)=False", r"--no-\1"),
    (r"\b(header|offset|overwrite)=True", r"--\1"),
    (r"\buse Hz=False", "leave --hz out"),
    (r"\bseveral columns are passed as a list", "several columns need --inputs or --outputs"),
)
_KEYWORDS = (
    "input", "output", "time", "dt", "delimiter", "decimal", "order", "max_order", "method", "intersample",
    "initial_state", "offset", "quantity", "representation", "criterion", "frequency", "magnitude", "phase", "real",
    "imag", "frequency_unit", "magnitude_unit", "phase_unit", "weights", "header", "overwrite", "structure", "ports",
    "delay", "input_delay",
)  # fmt: skip
_KEYWORD = re.compile(rf"\b({'|'.join(_KEYWORDS)})=(?:'([^']*)'|([\w.+-]*\w)?)")


_OFTEN = 0.05  # seconds: reports that come sooner are not shown
_IN_LINES = 4.0  # between lines in a file or a pipe


class NoError(PHControlError):
    """The answer is no: a model is not lossless, or not passive, for the reasons given."""

    def __init__(self, source: str, violations: Sequence[str], missing: str = "lossless") -> None:
        self.violations, self.missing = tuple(violations), missing
        more = len(violations) - 1
        rest = f" (and {more} more; ph-control info lists them)" if more else ""
        so = "" if missing == "lossless" else ", so it has no port-Hamiltonian form"
        super().__init__(f"{source} is not {missing}{so}: {violations[0]}{rest}")


def in_shell_terms(text: str) -> str:
    """Text in which keywords of Python functions, as in `order='auto'`, are the options they are here."""
    for pattern, option in _SPOKEN:
        text = re.sub(pattern, option, text)
    return _KEYWORD.sub(lambda m: f"--{m[1].replace('_', '-')} {m[2] or m[3] or ''}".rstrip(), text)


def complain(message: str) -> None:
    """One line on standard error; where that is closed, nothing."""
    if sys.stderr is not None:
        with suppress(OSError, ValueError):
            print("ph-control: " + printable(shortened(" ".join(message.split()))), file=sys.stderr, flush=True)


class ProgressLine:
    """A line on standard error that tells how far long work is, and a bell that ends it.

    The line is shown where somebody watches: after each report, and each second in between, with the time so far.  With
    `always` it is also written to files and pipes, as a line of its own every few seconds.
    """

    def __init__(self, describe: Callable[[Any], str], timeout: float | None = None, *, always: bool = False) -> None:
        self.describe, self.timeout = describe, timeout
        self.expired = False
        self._in_place = sys.stderr is not None and sys.stderr.isatty()
        self._watched = self._in_place or (always and sys.stderr is not None)
        self._often, self._pause = (_OFTEN, 1.0) if self._in_place else (_IN_LINES, _IN_LINES)
        self._text, self._shown, self._start = "at work", 0.0, time.monotonic()
        self._over = threading.Event()
        tasks = [self._tick] * self._watched + [self._ring] * (timeout is not None)
        self._threads = [threading.Thread(target=task, daemon=True) for task in tasks]

    @property
    def callback(self) -> Callable[[Any], None] | None:
        """What to call after each step; nothing where nobody watches."""
        return self._report if self._watched else None

    def __enter__(self) -> ProgressLine:
        ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
        if ignored and self.timeout is not None and threading.current_thread() is threading.main_thread():
            # a shell has sent the process to the background, where the key is ignored; the bell must not be
            signal.signal(signal.SIGINT, signal.default_int_handler)
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        for thread in self._threads:
            thread.join()
        if self._in_place:
            _put("")

    def _report(self, progress: Any) -> None:
        self._text = self.describe(progress)
        if time.monotonic() - self._shown > self._often:
            self._show()

    def _show(self) -> None:
        self._shown = time.monotonic()
        bound = "" if self.timeout is None else f" of at most {self.timeout:g}"
        line = f"{self._text}, {self._shown - self._start:.0f}{bound} s"
        if self._in_place:
            _put(line)
        else:
            complain(line)

    def _tick(self) -> None:
        while not self._over.wait(1.0):
            if time.monotonic() - self._shown >= self._pause:
                self._show()

    def _ring(self) -> None:
        if not self._over.wait(self.timeout):
            self.expired = True
            _thread.interrupt_main()


def _put(line: str) -> None:
    """Put a line in the place of the last one on standard error."""
    print(f"\r\033[K{printable(line, one_line=True)}", end="", file=sys.stderr, flush=True)


def emit(content: str | bytes) -> None:
    """Write to standard output at once, so that an error of it is met here and not at the end of the process."""
    if sys.stdout is None:
        return
    try:
        if isinstance(content, str):
            sys.stdout.write(printable(content))
        elif sys.stdout.isatty():
            raise PHControlError(
                "standard output is a terminal, and this output is binary: redirect it, or name a file"
            )
        else:
            sys.stdout.flush()
            sys.stdout.buffer.write(content)
        sys.stdout.flush()
    except OSError as error:
        # what is left goes nowhere: at its end the interpreter would try again
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            raise
        raise PHControlError(
            f"standard output cannot be written: {error.strerror or error}; send it elsewhere"
        ) from None


def _show_warning(message: Warning | str, category: type[Warning], *where: object, **more: object) -> None:
    # what the data do not show stands in the summary of the fit; what others warn of, such as pyparsing of how
    # matplotlib calls it, is not for whoever runs a command
    own = category.__module__ == IdentifiabilityWarning.__module__
    if own and not issubclass(category, IdentifiabilityWarning):
        complain(f"warning: {in_shell_terms(str(message))}")


def guarded(run: Callable[[], int], *, traceback: bool = False) -> int:
    """Exit status of a run, whatever happens in it."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # labels that the encoding of the terminal does not have are shown by their numbers
            stream.reconfigure(errors="backslashreplace")
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = _show_warning
        try:
            code = _code_of(run)
            # what the parser has printed is still on its way
            emit("")
            return code
        except BrokenPipeError:
            return UNREAD
        except KeyboardInterrupt:
            complain("interrupted; no file is written in part")
            return INTERRUPTED
        except Exception as error:
            if traceback:
                raise
            code, message = _status_and_message(error)
            complain(message)
            return code


def _code_of(run: Callable[[], int]) -> int:
    """Exit status of a run; the parser ends it after help and after wrong usage."""
    try:
        return run()
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else DONE


def _status_and_message(error: Exception) -> tuple[int, str]:
    """Exit status and message of an error."""
    if isinstance(error, NotLosslessError) and error.is_refusal:
        return NO, in_shell_terms(str(error))
    if isinstance(error, NotLosslessError):
        error = NoError("the system", error.violations)
    if isinstance(error, PHControlError):
        return NO if isinstance(error, NoError) else BAD, in_shell_terms(str(error))
    if isinstance(error, OSError):
        place = f"{error.filename}: " if error.filename else ""
        return BAD, f"{place}{error.strerror or error}; check the name, the permissions and the space left"
    if isinstance(error, MemoryError):
        return BAD, "not enough memory for this; use less data, or a lower order"
    return BROKEN, (
        f"error of the program: {type(error).__name__}: {error}; this should not happen: please report it with the "
        "command, and the output of ph-control --traceback COMMAND ..."
    )
