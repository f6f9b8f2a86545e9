"""Completion of commands and options in a shell, written by shtab."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ..exceptions import MissingPackageError, StructureError

_FILES = ("FILE", "MODEL", "RECORDING", "FOLDER")  # metavariables of arguments that are paths


def completion_script(words: Sequence[str], commands: Mapping[str, str], module_of: Callable[[str], Any]) -> str:
    """Script for the shell that `words` names, with the options of all commands."""
    try:
        import shtab
    except ImportError:
        raise MissingPackageError(
            "completion needs shtab, which is not installed: pip install 'ph_control[completion]'"
        ) from None
    if len(words) != 1 or words[0] not in shtab.SUPPORTED_SHELLS:
        shells = ", ".join(shtab.SUPPORTED_SHELLS)
        raise StructureError(f"--print-completion takes the name of a shell, one of {shells}")
    parser = argparse.ArgumentParser(prog="ph-control", description="modes and port-Hamiltonian models")
    parser.add_argument("--version", action="version", version="")
    subparsers = parser.add_subparsers(dest="command")
    for command, text in commands.items():
        own = subparsers.add_parser(command, help=text, description=text)
        module_of(command).add_options(own)
        for action in own._actions:
            if action.choices is None and str(action.metavar).upper() in _FILES:
                action.complete = shtab.FILE  # type: ignore[attr-defined]
    return str(shtab.complete(parser, shell=words[0])) + "\n"
