"""The command line, `ph-control`: one module a command, and none of them is imported before it is asked for."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any

import ph_control as phc

from ..exceptions import StructureError, installed
from .options import Parser
from .outcome import EXIT_CODES, emit, guarded

_FILES = ("FILE", "MODEL", "RECORDING", "FOLDER")  # metavariables of arguments that are paths

COMMANDS = {
    "demo": "identify three known plants from simulated recordings",
    "fit": "identify a model from recordings or frequency responses",
    "fit-many": "identify a model from each of many recordings, and track the modes",
    "info": "show the modes and the structure of a model",
    "convert": "convert a model to another form or file format",
    "reduce": "reduce the number of states of a model",
    "netlist": "write a circuit of a model as SPICE text",
    "compare": "compare models with recordings",
    "plot": "plot models: bode, step, impulse, modes, poles, energy, fit",
}

_EPILOG = f"""Each command has its own help, with examples: ph-control fit --help. The file name - is
standard input or standard output. Existing files are replaced only with --overwrite. {EXIT_CODES}"""

_HELP = """Modes and port-Hamiltonian models from recordings, for python-control.

Examples
--------
  ph-control demo
  ph-control fit recording.csv --input force --output velocity --model fitted.json
  ph-control convert plant.mat - | ph-control info -
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command `ph-control`.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments; default those of the process.

    Returns
    -------
    int
        Exit status: 0 done; 1 negative answer, such as a system that is not lossless; 2 wrong usage, bad input, or
        an output that cannot be written; 3 internal error; 130 interrupted; 141 closed output pipe.  A message of
        one line on standard error gives the reason.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    if "matplotlib" not in sys.modules:
        # pictures go to files; a window system, or that of a notebook, may not be there
        os.environ["MPLBACKEND"] = "Agg"
    return guarded(lambda: _run(words), traceback="--traceback" in words[:1])


def _run(words: list[str]) -> int:
    if words[:1] == ["--print-completion"]:
        emit(_completion_script(words[1:]))
        return 0
    place = next((k for k, word in enumerate(words) if not word.startswith("-")), len(words))
    command: str = _parser().parse(words[: place + 1]).command
    module = _module(command)
    parser = Parser(module.__doc__, prog=f"ph-control {command}", usage=f"%(prog)s {module.USAGE}")
    module.add_options(parser)
    code: int = module.run(parser.parse(_plain(words[place + 1 :])))
    return code


def _completion_script(words: Sequence[str]) -> str:
    """Script for the shell that `words` names, with the options of all commands."""
    shtab = installed("shtab", "completion needs shtab", "pip install 'ph_control[completion]'")
    if len(words) != 1 or words[0] not in shtab.SUPPORTED_SHELLS:
        shells = ", ".join(shtab.SUPPORTED_SHELLS)
        raise StructureError(f"--print-completion takes the name of a shell, one of {shells}")
    parser = argparse.ArgumentParser(prog="ph-control", description="modes and port-Hamiltonian models")
    parser.add_argument("--version", action="version", version="")
    subparsers = parser.add_subparsers(dest="command")
    for command, text in COMMANDS.items():
        own = subparsers.add_parser(command, help=text, description=text)
        _module(command).add_options(own)
        for action in own._actions:
            if action.choices is None and str(action.metavar).upper() in _FILES:
                action.complete = shtab.FILE  # type: ignore[attr-defined]
    return str(shtab.complete(parser, shell=words[0])) + "\n"


def _module(command: str) -> Any:
    """Module of a command."""
    return import_module(f".commands.{command.replace('-', '_')}", __name__)


def _plain(words: list[str]) -> list[str]:
    """Arguments without `--`, after which names may begin with a dash: they name files in this folder."""
    place = words.index("--") if "--" in words else len(words)
    names = [f"./{word}" if word.startswith("-") and word != "-" else word for word in words[place + 1 :]]
    return words[:place] + names


def _parser() -> Parser:
    usage = "%(prog)s [--version] [--traceback] COMMAND ...\n       %(prog)s --print-completion {bash,zsh,fish,...}"
    parser = Parser(_HELP, _EPILOG, prog="ph-control", usage=usage)
    version = getattr(phc, "__version__", "(not installed)")
    parser.add_argument("--version", action="version", version=f"%(prog)s {version}")
    parser.add_argument("--traceback", action="store_true", help="show the Python traceback of an error")
    group = parser.add_argument_group("commands")
    group.description = "\n".join(f"{name:9} {text}" for name, text in COMMANDS.items())
    group.add_argument("command", choices=tuple(COMMANDS), metavar="COMMAND", help="one of the commands above")
    return parser
