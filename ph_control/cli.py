"""The command line: argparse over public functions."""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from . import demo
from .exceptions import IdentifiabilityWarning, OutputExistsError, PHControlError, StructureError
from .files import load, save
from .identification.formulation import Progress
from .identification.pem import pem
from .identification.result import PEMResult
from .modal import ModalForm
from .propagation import INTERSAMPLE, METHODS
from .recordings import read_csv
from .systems import PortHamiltonian


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command `ph-control`.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments; default those of the process.

    Returns
    -------
    int
        Exit status: 0 done, 1 an error that the message on standard error explains, 2 wrong usage.
    """
    arguments = _parser().parse_args(argv)
    # pictures go to files; a window system may not be there
    import matplotlib

    matplotlib.use("Agg")
    try:
        with warnings.catch_warnings():
            # the summary says it
            warnings.simplefilter("ignore", IdentifiabilityWarning)
            arguments.run(arguments)
    except (PHControlError, OSError) as error:
        print(f"ph-control: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\nph-control: interrupted; nothing was written", file=sys.stderr)
        return 130
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="ph-control", description="Lossless (port-Hamiltonian) models from recordings, for python-control."
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {_version()}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    run = commands.add_parser("demo", help="identify two known plants from noisy recordings, compare with the truth")
    run.add_argument("--folder", type=Path, help="new or empty folder for what it makes (default: a new one here)")
    run.add_argument("--seed", type=int, default=0, help="seed of input and noise (default 0)")
    run.set_defaults(run=_demo)

    fit = commands.add_parser("fit", help="identify a model from a recording")
    fit.add_argument("recording", type=Path, metavar="RECORDING", help="text table: comma, semicolon or white space")
    fit.add_argument("--input", type=_column, help="column of the input, by name or number from 0")
    fit.add_argument("--output", type=_column, help="column of the output, by name or number from 0")
    fit.add_argument("--time", type=_column, help="column of the time, by name or number from 0")
    fit.add_argument("--dt", type=float, help="time between samples, where the table has no time column")
    fit.add_argument("--delimiter", help="what separates the columns (default: found out)")
    fit.add_argument("--decimal", choices=(".", ","), help="decimal mark (default: found out)")
    fit.add_argument("--no-header", action="store_true", help="the first row holds numbers already")
    fit.add_argument("--order", type=_order, default="auto", help="number of modes, or auto (default)")
    fit.add_argument("--max-order", type=int, default=20, help="largest order that auto tries (default 20)")
    fit.add_argument(
        "--method",
        choices=METHODS,
        default="exact",
        help="exact (default); midpoint and euler for data made by such an integrator only",
    )
    fit.add_argument("--intersample", choices=INTERSAMPLE, default="zoh", help="input between samples: held or linear")
    fit.add_argument("--initial-state", choices=("estimate", "zero"), default="estimate", help="state at the start")
    fit.add_argument("--model", type=Path, help="write the model here (JSON)")
    fit.add_argument("--result", type=Path, help="write the whole result, uncertainty and residuals too (JSON)")
    fit.add_argument("--plot", type=Path, help="write a picture of measured, predicted and residual (png, pdf, svg)")
    fit.add_argument("--bode", type=Path, help="write a Bode picture of the model and a spectral estimate")
    fit.add_argument("--overwrite", action="store_true", help="replace files that exist")
    fit.set_defaults(run=_fit)

    info = commands.add_parser("info", help="show what a saved model is")
    info.add_argument("model", type=Path, metavar="MODEL", help="JSON file written by fit, demo or save")
    info.set_defaults(run=_info)
    return parser


def _version() -> str:
    try:
        return version("ph_control")
    except PackageNotFoundError:
        return "(not installed)"


def _column(text: str) -> str | int:
    return int(text) if text.isascii() and text.isdigit() else text


def _order(text: str) -> str | int:
    if text == "auto":
        return text
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is neither 'auto' nor a whole number") from None


def _demo(arguments: argparse.Namespace) -> None:
    folder = arguments.folder or _new_folder(Path("ph_control_demo"))
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise OutputExistsError(f"{folder} exists and is not an empty folder; name another one, or leave --folder out")
    folder.mkdir(parents=True, exist_ok=True)
    demo.run(folder, arguments.seed, print)
    print(f"All of it is in {folder.resolve()}")
    print(f"Next: ph-control fit {folder / 'chain.csv'} --model my_model.json --plot my_fit.png")


def _new_folder(wanted: Path) -> Path:
    candidate, number = wanted, 1
    while candidate.exists():
        number += 1
        candidate = wanted.with_name(f"{wanted.name}-{number}")
    return candidate


def _fit(arguments: argparse.Namespace) -> None:
    pictures = [path for path in (arguments.plot, arguments.bode) if path is not None]
    _check_outputs(arguments.recording, [arguments.model, arguments.result, *pictures], arguments.overwrite)
    _check_pictures(pictures)
    data = read_csv(
        arguments.recording, input=arguments.input, output=arguments.output, time=arguments.time, dt=arguments.dt,
        delimiter=arguments.delimiter, decimal=arguments.decimal, header=False if arguments.no_header else None,
    )  # fmt: skip
    result = pem(
        data,
        arguments.order,
        method=arguments.method,
        intersample=arguments.intersample,
        initial_state=arguments.initial_state,
        max_order=arguments.max_order,
        callback=_progress_line if sys.stderr.isatty() else None,
    )
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr)
    print(result.summary())
    _write(arguments, result)


def _write(arguments: argparse.Namespace, result: PEMResult) -> None:
    from .plots import bode_plot

    written = []
    if arguments.model is not None:
        save(result.system, arguments.model, overwrite=arguments.overwrite)
        written.append(arguments.model)
    if arguments.result is not None:
        result.save(arguments.result, overwrite=arguments.overwrite)
        written.append(arguments.result)
    if arguments.plot is not None:
        result.plot().figure.savefig(arguments.plot, dpi=150)
        written.append(arguments.plot)
    if arguments.bode is not None:
        bode_plot(result.system, data=result.record.as_response(), label="identified model").figure.savefig(
            arguments.bode, dpi=150
        )
        written.append(arguments.bode)
    if written:
        print("\nWritten: " + ", ".join(map(str, written)))


def _check_outputs(recording: Path, paths: list[Path | None], overwrite: bool) -> None:
    """Refuse before the fit what would fail after it."""
    named = [path for path in paths if path is not None]
    for path in named:
        if path.exists() and recording.exists() and path.samefile(recording):
            raise OutputExistsError(f"{path} is the recording itself, which is never overwritten; name another file")
        if path.exists() and not path.is_file():
            raise OutputExistsError(f"{path} is not a regular file; name another one")
        if path.exists() and not overwrite:
            raise OutputExistsError(f"{path} exists; name another file, or pass --overwrite to replace it")
        if not path.resolve().parent.is_dir():
            raise StructureError(f"{path} cannot be written: its folder does not exist; make it first")
    if len({path.resolve() for path in named}) < len(named):
        raise StructureError("two of the output files have the same name; give each its own")


def _check_pictures(paths: list[Path]) -> None:
    from matplotlib.backend_bases import FigureCanvasBase

    formats = FigureCanvasBase.get_supported_filetypes()
    for path in paths:
        if path.suffix.lstrip(".").lower() not in formats:
            raise StructureError(
                f"{path} has no known picture format; end its name in one of .{', .'.join(sorted(formats))}"
            )


def _progress_line(progress: Progress) -> None:
    print(
        f"\r\033[Korder {progress.order} of at most {progress.max_order}, iteration {progress.iteration}, "
        f"rms residual {np.sqrt(progress.loss):.4g}",
        end="",
        file=sys.stderr,
        flush=True,
    )


def _info(arguments: argparse.Namespace) -> None:
    found = load(arguments.model)
    if isinstance(found, PEMResult):
        print(found.summary())
        return
    print("\n".join(_describe(found)))


def _describe(found: PortHamiltonian | ModalForm) -> list[str]:
    form = found if isinstance(found, ModalForm) else found.modes
    lines = [f"{type(found).__name__}: {form.n} modes, {form.nports} port{'s' * (form.nports != 1)}"]
    if isinstance(found, PortHamiltonian):
        lines[0] = (
            f"PortHamiltonian {found.name}: {found.n} degrees of freedom, {found.nstates} states, "
            f"{found.ninputs} port{'s' * (found.ninputs != 1)}"
        )
        lines.append(f"  inputs {', '.join(found.input_labels)}; outputs {', '.join(found.output_labels)}")
        lines.append(f"  canonical (controllable and observable): {'yes' if found.is_canonical else 'no'}")
    lines.append("   mode   d [rad/time]         cycles/time       r                 kappa")
    for l in range(len(form.d)):
        lines.append(
            f"  {l + 1:5d}   {form.d[l]:<18.10g}   {form.d[l] / 2 / np.pi:<15.8g}   "
            f"{_number(form.r[l])}   {_number(form.kappa[l])}"
        )
    if len(form.rigid):
        lines.append(f"  pole at 0 with residue kappa_0 = {_number(form.kappa_0)}")
    return lines


def _number(value: Any) -> str:
    return f"{value:<15.8g}" if np.ndim(value) == 0 else np.array2string(np.asarray(value), precision=6)


if __name__ == "__main__":
    sys.exit(main())
