"""Calls of every public name with valid, odd and hostile arguments: each is answered right, or refused by name.

`python -m benchmarks.fuzz --calls 100000 --seed 1`; `--only K` makes call K of that seed again and shows where it
ends.  A call may raise an error of the package, or a TypeError for arguments that no signature has; it must not
raise anything else, warn of arithmetic, give NaN, change or keep what it was given, print, or take long.
"""

from __future__ import annotations

import argparse
import codecs
import contextlib
import copy
import dataclasses
import encodings
import importlib
import inspect
import io
import json
import mmap
import operator
import os
import pickle
import pkgutil
import re
import signal
import struct
import sys
import tempfile
import time
import traceback
import types
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import control as ct
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib import font_manager

import ph_control as phc

from . import fuzz_oracles, fuzz_scales
from .fuzz_values import Draw, hostile, pick, pool, written

SECONDS = 10  # of processor time, that one call may take
PORTION = 2000  # calls of one process
MEMORY = 6 << 30  # bytes that it may take

WRITING = {"show_progress"}  # names that are there to write on standard error
TOLD = (phc.IdentifiabilityWarning, phc.ResolutionWarning, phc.ConditioningWarning)

# what only the package makes: plain records of an answer, which nobody else fills in
ANSWERS = (
    "Bootstrap", "CanonicalMargins", "CasimirSplit", "Comparison", "EnergyBalance", "Excitation",
    "ExpressivePower", "FittedChannels", "FittedExperiment", "GradientResult", "KalmanDecomposition",
    "ModalSamples", "MorphismCheck", "Netlist", "OrderSelection", "PEMResult", "PassivityReport", "ResidualAnalysis",
    "ScaledCoefficients", "StructuralModes", "Symmetry", "Verdict", "UniversalModes", "FitTable", "ModeTracks",
    "OptimalDamping", "RecordingFitted", "ResponseBackground", "Stabilisation", "BaseMotion", "InputDesign",
    "PlantExcitation", "FittedParameters", "ModelUpdate", "NetlistFunction",
    "ModeComparison", "ChangeTest", "ControlChart",
)  # fmt: skip

# share of the calls, next to 1 for what takes less than a millisecond or so
SHARES = {
    "pem": 0.2, "prediction_error_fit": 0.02, "order_selection": 0.05, "compare": 0.2, "residual_analysis": 0.1,
    "gradient_descent": 0.1, "excitation": 0.2, "spectral_estimate": 0.5, "PEMResult.bootstrap": 0.005,
    "design_input": 0.05, "load": 3.0, "read_csv": 3.0, "read_frequency_csv": 2.0,
    "read_uff": 1.0, "read_touchstone": 1.0, "read_mat": 1.0, "read_frequency_mat": 1.0,
    "read_netlist": 2.0,
}  # fmt: skip
PICTURE = 0.02
COMMAND = 0.05

# where infinity, or NaN, is an answer: at poles, for margins that no loop has, for samples that are missing
INFINITE = re.compile(
    r"horner|evaluate|freqresp|__call__|margin|frequency_response|Symmetry|Verdict|is_even|is_odd|passivity|"
    r"[Oo]ptimal.?[Dd]amping|update_model|ModelUpdate|FittedParameters"
)
UNKNOWN = re.compile(
    r"margin|[Ee]xcitation|read_|load|FittedExperiment|FittedChannels|Result|[Cc]ompar|[Rr]esidual.?[Aa]nalysis|"
    r"pem|prediction_error_fit|gradient_descent|order_selection|OrderSelection|[Ss]tabilisation|fit_many|FitTable|ModeTracks|"
    r"[Bb]ase.?[Mm]otion|InputDesign|design_input|"
    r"update_model|ModelUpdate|FittedParameters|"
    r"PEMResult.changed|ModeComparison|ChangeTest|ControlChart"
)

REFUSALS = re.compile(
    r"unexpected keyword|unrecognized keyword|keyword not allowed|conflicting keywords|missing \d+ required|"
    r"positional argument|multiple values for|takes no (keyword )?arguments|takes from|takes exactly|"
    r"unsupported operand|bad operand|not supported between"
)

OPERATIONS: dict[str, Callable[..., Any]] = {
    "repr": repr, "str": str, "copy": copy.copy, "deepcopy": copy.deepcopy, "==": operator.eq, "!=": operator.ne,
    "pickle": lambda x: pickle.loads(pickle.dumps(x)), "html": lambda x: getattr(x, "_repr_html_", str)(),
    "latex": lambda x: getattr(x, "_repr_latex_", str)(), "bool": bool,
}  # fmt: skip
OPERATORS: dict[str, Callable[..., Any]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv, "@": operator.matmul,
    "r+": lambda x, y: y + x, "r*": lambda x, y: y * x, "neg": lambda x, y: -x, "[]": operator.getitem,
    "feedback": lambda x, y: x.feedback(y), "append": lambda x, y: x.append(y),
}  # fmt: skip


class Hang(BaseException):
    """A call took longer than it may."""


@dataclasses.dataclass(frozen=True)
class Target:
    """One thing to call: its name, the class whose object it needs, and how it is reached."""

    name: str
    owner: str  # public class, or empty for functions
    call: Callable[..., Any]
    kind: str  # function, method, property, operation, operator, oracle or command
    share: float = 1.0
    foreign: bool = False  # whether python-control reads the arguments: they are valid ones then


@dataclasses.dataclass
class Finding:
    """What one call did that none may."""

    call: int
    name: str
    kind: str
    place: str
    text: str

    @property
    def group(self) -> tuple[str, str, str]:
        return self.name, self.kind, self.place


# --- what there is to call -----------------------------------------------------------------------------------------


@cache
def targets() -> tuple[Target, ...]:
    """Everything public."""
    found = []
    for name in phc.__all__:
        value = getattr(phc, name)
        if not inspect.isclass(value):
            share = PICTURE if name.endswith("_plot") else SHARES.get(name, 1.0)
            found.append(Target(name, "", value, "function", share))
        elif not issubclass(value, BaseException):
            found += _of_class(name, value)
    for share, oracles in ((0.02, fuzz_oracles.ORACLES), (0.5, fuzz_scales.ORACLES)):
        found += [Target(f"exact {name}", "", check, "oracle", share) for name, check in oracles.items()]
    found += [Target(f"ph-control {name}", "", _command, "command", COMMAND) for name in COMMANDS]
    return tuple(found)


def _of_class(name: str, value: type) -> Iterator[Target]:
    if name not in ANSWERS:
        yield Target(name, "", value, "function")
    seen = set()
    for base in value.__mro__:
        inherited = not base.__module__.startswith("ph_control")
        if inherited and base is not ct.StateSpace:
            continue
        for key, member in vars(base).items():
            if key.startswith("_") or key in seen or key in ("updfcn", "outfcn"):  # python-control calls those two
                continue
            seen.add(key)
            if inherited and key not in FROM_CONTROL:
                continue
            foreign = issubclass(value, ct.StateSpace) and hasattr(ct.StateSpace, key) and key not in OURS
            share = PICTURE if key in ("plot", "bode_plot") else SHARES.get(f"{name}.{key}", 0.3)
            if isinstance(member, classmethod | staticmethod):
                yield Target(f"{name}.{key}", "", getattr(value, key), "function", share)
            elif isinstance(member, types.FunctionType):
                yield Target(f"{name}.{key}", name, member, "method", share, foreign)
            elif hasattr(member, "__get__"):
                yield Target(f"{name}.{key}", name, operator.attrgetter(key), "property", 0.1)
    for key, operation in OPERATIONS.items():
        yield Target(f"{name}: {key}", name, operation, "operation", 0.1)
    if issubclass(value, ct.StateSpace) or hasattr(value, "__matmul__") or hasattr(value, "__getitem__"):
        for key, operation in OPERATORS.items():
            yield Target(f"{name}: {key}", name, operation, "operator", 0.05)


# of those that python-control gives to every system: what analyses it
OURS = ("horner", "poles", "zeros")
FROM_CONTROL = ("dcgain", "damp", "frequency_response", "sample", "bandwidth", "to_pandas", "issiso")


# --- arguments -----------------------------------------------------------------------------------------------------

STYLE = ("title", "grid", "show_legend", "legend_loc", "rcParams", "color", "linestyle", "linewidth")
NAMES = ("name", "inputs", "outputs", "states")
ALIASES = {"forced_response": ("T", "U", "X0"), "step_response": ("T", "X0"), "impulse_response": ("T",)}
PICTURES = {
    "PEMResult.plot": "fit_plot", "Comparison.plot": "compare_plot", "ResidualAnalysis.plot": "residual_plot",
    "EnergyBalance.plot": "energy_plot", "OrderSelection.plot": "order_plot", "OptimalDamping.plot": "damping_plot",
    "Stabilisation.plot": "stabilisation_plot",
}  # fmt: skip


@cache
def _parameters(call: Callable[..., Any]) -> tuple[inspect.Parameter, ...]:
    return tuple(inspect.signature(call).parameters.values())


def arguments(target: Target, draw: Draw, attack: float) -> tuple[list[Any], dict[str, Any]]:
    """Arguments of a call, valid but for one or two."""
    rng, owner = draw.rng, target.name
    positional: list[Any] = []
    named: dict[str, Any] = {}
    names: list[Any] = []
    for parameter in _parameters(target.call)[target.kind == "method" :]:
        key = parameter.name
        if parameter.kind is parameter.VAR_KEYWORD:
            for extra in _collected(owner, key):
                if draw.knows(extra, "names" if extra in NAMES else owner) and rng.random() < 0.06:
                    named[extra] = draw(extra, "names" if extra in NAMES else owner)
                    names.append(extra)
        elif parameter.kind is parameter.VAR_POSITIONAL:
            for _ in range(draw.knows(key, owner) and int(rng.choice([1, 1, 2]))):
                names.append(len(positional))
                positional.append(draw(key, owner))
        elif parameter.default is parameter.empty:
            names.append(len(positional))
            positional.append(draw(key, owner) if draw.knows(key, owner) else 1.0)
        elif draw.knows(key, owner) and rng.random() < _likely(owner, key):
            if parameter.kind is not parameter.KEYWORD_ONLY and len(positional) == len(names) and not named:
                names.append(len(positional))
                positional.append(draw(key, owner))
            else:
                names.append(key)
                named[key] = draw(key, owner)
    if names and rng.random() < attack and not target.foreign:
        for _ in range(int(rng.choice([1, 1, 1, 2]))):
            place = names[int(rng.integers(len(names)))]
            store: Any = positional if isinstance(place, int) else named
            given = [p.name for p in _parameters(target.call)[target.kind == "method" :]]
            name = given[min(place, len(given) - 1)] if isinstance(place, int) else place
            value = hostile(rng, store[place], name)
            if _harmless(name, value):
                store[place] = value
    if rng.random() < 0.01 * (attack > 0) and not target.foreign:
        named["no_such_keyword"] = 1
    return positional, named


def _likely(owner: str, key: str) -> float:
    """How often an argument with a default is given: always where a call is about nothing else."""
    always = {
        "ph": ("B",),
        "affine": ("B",),
        "ch": ("v",),
        "oh": ("v",),
        "modes": ("r",),
        "forced_response": ("timepts",),
    }
    if key in always.get(owner, ()) or key == "dt":
        return 0.8
    return 0.4 if key in ("order", "initial_state", "inputs", "timepts", "measured", "predicted", "max_order") else 0.2


def _collected(owner: str, key: str) -> tuple[str, ...]:
    if owner in PICTURES:
        extra = tuple(p.name for p in _parameters(getattr(phc, PICTURES[owner])))
        return tuple(name for name in extra if name not in ("kwargs", "style", "experiment", "criterion")) + STYLE
    if owner == "order_selection":
        return ("method", "intersample", "offset", "quantity", "representation", "rng", "workers")
    if key in ("style", "kwargs"):
        return STYLE + ("ax", "time_unit", "label") * (key == "kwargs")
    return ALIASES.get(owner, ()) if key == "aliases" else NAMES


def _harmless(name: str, value: Any) -> bool:
    """Whether a value asks for no more than an answer: not for processes, files that are there, or years of work."""
    if name in ("workers", "epochs", "max_order", "timepts_num", "omega_num"):
        try:
            return bool(-1 < float(value) < 50) and (name != "workers" or float(value) <= 1)
        except OverflowError:  # an integer of hundreds of digits is as many processes as there are fits
            return name != "workers"
        except Exception:
            return True
    if name == "callback":  # its own errors pass
        return not callable(value)
    if name == "path":
        return not isinstance(value, str | bytes) or not os.path.isabs(value)
    return True


def unknown_parameters() -> list[str]:
    """Parameters that have no default and no valid values here."""
    return sorted(
        f"{target.name}({parameter.name})"
        for target in targets() if target.kind in ("function", "method")
        for parameter in _parameters(target.call)[target.kind == "method" :]
        if parameter.default is parameter.empty
        if parameter.kind not in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL)
        if not Draw(np.random.default_rng(0)).knows(parameter.name, target.name)
    )  # fmt: skip


# --- commands ------------------------------------------------------------------------------------------------------

COMMANDS = ("info", "convert", "netlist", "fit", "compare", "plot")
_OPTIONS = (
    "--json", "--to", "ss", "tf", "ch", "oh", "ph", "modes", "--order", "1", "2", "auto", "--dt", "0.1", "--input", "u",
    "0", "--output", "y", "--offset", "--num", "1,0", "--den", "1,0,4", "nan", "1e999", "-1", "--kind", "bode", "step",
    "--no-input", "--no-time", "--quantity", "displacement", "--max-order", "--header", "--delimiter", ";", "--weights",
    "--frequency-unit", "Hz", "out.json", "out.mat", "out.csv", "out.txt", "out.png", "--overwrite", "--save", "x",
    "--level", "0.9", "--name", "é", "--decimal", ",",
)  # fmt: skip


def _command(words: list[str]) -> int:
    from ph_control.cli import main

    code = main(words)
    if code not in range(0, 5) and code != 130:
        raise AssertionError(f"exit status {code}")
    return code


def words_of(command: str, rng: Any) -> list[str]:
    kinds = {"fit": ["csv", "frequency"], "compare": ["csv", "json", "mat"]}.get(
        command, ["json", "mat", "csv", "json"]
    )
    files = [written(rng, pick(rng, kinds)) for _ in range(int(rng.choice([1, 1, 2])))]
    extra = [pick(rng, _OPTIONS) for _ in range(int(rng.integers(0, 4)))]
    found = [command, *(str(file) for file in files if not isinstance(file, io.IOBase)), *extra]
    # a fit of damaged numbers may look for twenty modes
    return [*found, "--max-order", "2"] if command == "fit" else found


# --- one call ------------------------------------------------------------------------------------------------------


def fingerprint(value: Any, depth: int = 0) -> Any:
    """What of an argument a call must not change."""
    if isinstance(value, np.ndarray):
        content = list(map(id, value.flat)) if value.dtype.hasobject else value.tobytes()
        mask = np.ma.getmaskarray(value).tobytes() if isinstance(value, np.ma.MaskedArray) else b""
        return value.shape, str(value.dtype), value.flags.writeable, content, mask
    if isinstance(value, dict):
        return [(key, fingerprint(item, depth + 1)) for key, item in value.items()]
    if isinstance(value, list | tuple | set) and depth < 6:
        return type(value).__name__, [fingerprint(item, depth + 1) for item in value]
    if isinstance(value, phc.ModalForm):
        return [fingerprint(part) for part in (value.d, value.nu, value.rigid, value.r)]
    if isinstance(value, ct.TimeResponseData):
        return [fingerprint(part) for part in (value.t, value.y, value.u, value.x)]
    if isinstance(value, phc.ControllableHamiltonian | phc.ObservableHamiltonian):
        return [fingerprint(part) for part in (value.d, value.v)]  # matrices may lie out of the range of doubles
    if isinstance(value, ct.StateSpace) and value.nstates < 20:
        return [fingerprint(np.asarray(part)) for part in (value.A, value.B, value.C, value.D)]
    if isinstance(value, ct.FrequencyResponseData):
        return [fingerprint(part) for part in (value.frdata, value.omega)]
    if isinstance(value, int | float | complex | str | bytes):
        return type(value).__name__, repr(value) if not isinstance(value, int) else value
    if hasattr(value, "tocsr"):
        return fingerprint(value.data) if hasattr(value, "data") else None
    return id(value)


def _unwarned(value: Any) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fingerprint(value)


def arrays_in(value: Any, depth: int = 0) -> Iterator[Any]:
    """Numbers of an answer."""
    if isinstance(value, np.ndarray | float | complex | np.number):
        yield value
    elif isinstance(value, ct.TimeResponseData):
        yield from (part for part in (value.t, value.y, value.x, value.u) if part is not None)
    elif isinstance(value, ct.FrequencyResponseData):
        yield from (value.frdata, value.omega)
    elif isinstance(value, ct.TransferFunction):
        yield from (row for part in (value.num_list, value.den_list) for line in part for row in line)
    elif isinstance(value, ct.StateSpace):
        if value.nstates < 12:
            yield from (value.A, value.B, value.C, value.D)
    elif isinstance(value, dict | types.MappingProxyType) and depth < 3:
        for item in value.values():
            yield from arrays_in(item, depth + 1)
    elif isinstance(value, list | tuple) and depth < 3:
        for item in value:
            yield from arrays_in(item, depth + 1)
    elif dataclasses.is_dataclass(value) and not isinstance(value, type) and depth < 2:
        for field in dataclasses.fields(value):
            yield from arrays_in(getattr(value, field.name, None), depth + 1)


def _place(error: BaseException) -> str:
    """Last line of the package on the way to an error."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if f"ph_control{os.sep}" in frame.filename
              and "benchmarks" not in frame.filename]  # fmt: skip
    if not frames:
        return ""
    last = frames[-1]
    return f"{last.filename.rpartition('ph_control' + os.sep)[2]}:{last.lineno} {last.name}"


def _file_call(target: Target) -> bool:
    return target.name in ("load", "save", "PEMResult.save") or target.name.startswith("read_")


def _allowed(target: Target, error: Exception) -> bool:
    if isinstance(error, phc.PHControlError | MemoryError):  # what needs more memory than there is may say so
        return True
    if isinstance(error, TypeError) and REFUSALS.search(str(error)):
        return True
    if target.kind == "operator" or target.name.endswith((": ==", ": !=")):
        return True  # python-control, or numpy, was asked by one of the sides
    if isinstance(error, NotImplementedError) and "margin" in target.name:
        return True  # that of python-control for several inputs
    if isinstance(error, OSError) and _file_call(target):
        return True
    return target.foreign and not isinstance(error, ArithmeticError | AttributeError | LookupError)


def _alarm(*_: Any) -> None:
    raise Hang


@contextlib.contextmanager
def _limit(seconds: int) -> Iterator[None]:
    if not hasattr(signal, "setitimer"):
        yield
        return
    before = signal.signal(signal.SIGPROF, _alarm)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def _settings() -> Any:
    state = np.random.get_state()  # noqa: NPY002
    return np.geterr(), state[2], state[1][:4].tolist(), dict(np.get_printoptions())


class Session:
    """Calls of one seed, one after the other; each depends on the seed and its number only."""

    def __init__(self, seed: int, attack: float = 0.6) -> None:
        self.seed, self.attack = seed, attack
        self.findings: list[Finding] = []
        self.counts: Counter[str] = Counter()
        self.seconds: Counter[str] = Counter()
        self.answered = 0
        self.number = 0
        shares = np.array([target.share for target in targets()])
        self.edges = np.cumsum(shares / shares.sum())

    def run(self, first: int, last: int, tell: Callable[[int], Any] = lambda number: None) -> None:
        """Calls `first` to `last - 1`; what comes from another call is counted, too."""
        for number in range(first, last):
            tell(number)
            self.one(number)

    def one(self, number: int) -> None:
        """Call number `number`, and some of what its answer offers."""
        self.number = number
        rng = np.random.default_rng([self.seed, number])
        target = targets()[min(int(np.searchsorted(self.edges, rng.random())), len(self.edges) - 1)]
        attack = self.attack if rng.random() < 0.85 else 0.0
        draw = Draw(rng)
        thing = pick(rng, pool(target.owner)) if target.owner else None
        answer = self.attempt(target, draw, thing, attack)
        name = type(answer).__name__
        if name in _members() and not target.name.startswith(name) and rng.random() < 0.5:
            for _ in range(3):
                draw = Draw(rng)
                draw.n = getattr(answer, "n", draw.n)
                self.attempt(pick(rng, _members()[name]), draw, answer, attack if rng.random() < 0.3 else 0.0)
        if plt.get_fignums():
            plt.close("all")

    def attempt(self, target: Target, draw: Draw, thing: Any, attack: float) -> Any:
        """Make one call, note what it does that it must not, and return its answer if it has one."""
        positional, named = self._drawn(target, draw, thing, attack)
        before = _unwarned([positional, named])
        settings = _settings()
        self.counts[target.name] += 1
        out, answer, numbers, start = io.StringIO(), None, [], time.process_time()
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            try:
                with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out), _limit(SECONDS):
                    answer = target.call(*positional, **named)
                    numbers = [] if target.kind in ("operator", "command") else list(arrays_in(answer))
                self.answered += 1
            except Hang as error:
                self._note(target, "hang", _place(error), f"more than {SECONDS} s")
            except Exception as error:
                if not _allowed(target, error):
                    self._note(target, type(error).__name__, _place(error), str(error), error)
        for warning in told:
            if not issubclass(warning.category, TOLD):
                where = f"{warning.filename.rpartition('ph_control' + os.sep)[2]}:{warning.lineno}"
                if not (self._documented(target, warning) or (target.foreign and "ph_control" not in warning.filename)):
                    self._note(target, warning.category.__name__, where, str(warning.message))
        if out.getvalue() and target.kind != "command" and target.name not in WRITING:
            self._note(target, "printed", "", out.getvalue())
        if _unwarned([positional, named]) != before:
            self._note(target, "changed an argument", "", "")
        if _settings() != settings:
            self._note(target, "changed global state", "", "")
        self._examine(target, numbers, positional, named)
        self.seconds[target.name] += time.process_time() - start
        return answer

    def _drawn(self, target: Target, draw: Draw, thing: Any, attack: float) -> tuple[list[Any], dict[str, Any]]:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if target.kind == "command":
                return [words_of(target.name.split()[1], draw.rng)], {}
            if target.kind == "oracle":
                return [draw.rng], {}
            if target.kind == "property" or (target.kind == "operation" and "=" not in target.name):
                return [thing], {}
            if target.kind in ("operation", "operator"):
                other: Any = pick(draw.rng, [draw.any_system(), 2.0, thing, 0])
                return [thing, hostile(draw.rng, other, "other") if draw.rng.random() < attack else other], {}
            positional, named = arguments(target, draw, attack)
            return ([thing, *positional] if target.owner else positional), named

    @staticmethod
    def _documented(target: Target, warning: warnings.WarningMessage) -> bool:
        """Whether a warning is that of python-control about what it was asked for, or a figure that lies about."""
        text = str(warning.message)
        return "ph_control" not in warning.filename and (
            "the padding frequency" in text
            or "More than 20 figures" in text
            or target.kind == "operator"
            or "PendingDeprecation" in text
        )

    def _examine(self, target: Target, answer: list[Any], positional: list[Any], named: dict[str, Any]) -> None:
        given = [
            array for array in [*positional, *named.values()]
            if isinstance(array, np.ndarray) and array.flags.writeable and array.size
        ]  # fmt: skip
        own = positional[0] if target.kind in ("property", "operation", "method") else None
        for array in answer:
            numbers = np.asarray(array)
            if numbers.dtype.kind not in "fc":
                continue
            infinite = np.isinf(numbers)
            if target.foreign:
                break
            if np.any(np.isnan(numbers) & ~infinite) and not UNKNOWN.search(target.name) and not _has_gaps(positional):
                self._note(target, "NaN", "", "")
                break
            if infinite.any() and not INFINITE.search(target.name) and not UNKNOWN.search(target.name) and own is None:
                self._note(target, "infinite", "", "")
                break
            if isinstance(array, np.ndarray) and array.flags.writeable is not None and own is None and any(
                np.may_share_memory(array, other) for other in given
            ):  # fmt: skip
                self._note(target, "keeps an argument", "", "")
                break

    def _note(self, target: Target, kind: str, place: str, text: str, error: Exception | None = None) -> None:
        self.findings.append(Finding(self.number, target.name, kind, place, " ".join(text.split())[:200]))
        if error is not None and SHOWN:
            traceback.print_exception(error)


SHOWN: list[bool] = []  # whether errors are shown in full


def _has_gaps(values: list[Any]) -> bool:
    """Whether samples are missing in what was given, which makes them missing in the answer."""
    parts = [part for value in values for part in (value if isinstance(value, list | tuple) else [value])]
    arrays = [getattr(part, "y", getattr(part, "frdata", part)) for part in parts]
    return any(isinstance(one, np.ndarray) and one.dtype.kind in "fc" and np.isnan(one).any() for one in arrays)


@cache
def _members() -> dict[str, list[Target]]:
    found: dict[str, list[Target]] = {}
    for target in targets():
        if target.owner and target.share > 0.04:
            found.setdefault(target.owner, []).append(target)
    return found


# --- many calls ----------------------------------------------------------------------------------------------------


def table(findings: list[Finding], seed: int) -> str:
    """One line for each kind of finding, most frequent first."""
    groups: dict[tuple[str, str, str], list[Finding]] = {}
    for finding in findings:
        groups.setdefault(finding.group, []).append(finding)
    lines = [f"{'times':>5}  {'call':<36} {'what':<22} {'where':<44} again with"]
    for (name, kind, place), found in sorted(groups.items(), key=lambda item: -len(item[1])):
        lines.append(
            f"{len(found):5d}  {name:<36} {kind:<22} {place:<44} --seed {seed} --only {found[0].call}\n"
            f"       {found[0].text}"
        )
    return "\n".join(lines)


def warm_up() -> None:
    """Load what is loaded late, make the objects of the pools, and draw a picture."""
    for module in pkgutil.walk_packages(phc.__path__, "ph_control."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    for target in targets():
        if target.owner:
            pool(target.owner)
    # codecs and fonts may lie where nobody may look
    for codec in pkgutil.iter_modules(encodings.__path__):
        with contextlib.suppress(ImportError, LookupError):
            codecs.lookup(codec.name)
    font = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
    font_manager.findfont = font_manager.fontManager.findfont = lambda *_, **__: str(font)
    font_manager.fontManager._find_fonts_by_props = lambda *_, **__: [str(font)]
    plt.figure().suptitle(r"$\omega_1$").figure.canvas.draw()
    plt.close("all")
    session = Session(0, attack=0.0)
    for number, target in enumerate(targets()):
        draw = Draw(np.random.default_rng(number))
        with contextlib.suppress(Exception):
            session.attempt(target, draw, pick(draw.rng, pool(target.owner)) if target.owner else None, 0.0)
        plt.close("all")


def _unprivileged() -> None:
    """Nobody's rights, and no more memory than a call may need."""
    import resource

    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if os.getuid() == 0:
        os.setgroups([])
        os.setgid(65534)
        os.setuid(65534)


def portion(seed: int, first: int, last: int) -> dict[str, Any]:
    """Calls in a process of their own; where it dies or stands still, that is a finding, and the next goes on."""
    folder = tempfile.mkdtemp(dir=".")
    os.chmod(folder, 0o777)
    result = os.path.join(folder, "result.json")
    shared = mmap.mmap(-1, 8)
    child = os.fork()
    if not child:
        code = 1
        try:
            os.chdir(folder)
            _unprivileged()
            with open(os.devnull) as nothing:
                os.dup2(nothing.fileno(), 0)
            session = Session(seed)
            session.run(first, last, lambda number: shared.__setitem__(slice(0, 8), struct.pack("q", number)))
            found = {"findings": [dataclasses.asdict(one) for one in session.findings], "counts": session.counts,
                     "answered": session.answered, "seconds": session.seconds}  # fmt: skip
            with open("result.json", "w") as file:
                json.dump(found, file)
            code = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    at, since, ended = first, time.monotonic(), (0, 0)
    while not ended[0]:
        ended = os.waitpid(child, os.WNOHANG)
        now = struct.unpack("q", shared[:])[0]
        if now != at:
            at, since = now, time.monotonic()
        if time.monotonic() - since > 10 * SECONDS and not ended[0]:
            os.kill(child, signal.SIGKILL)
        time.sleep(0.05)
    if ended[1]:
        here = max(first, struct.unpack("q", shared[:])[0])
        lost = Finding(here, "a process", f"ended by {ended[1]}", "", "killed, crashed or stood still")
        rest = portion(seed, here + 1, last) if here + 1 < last else nothing
        return rest | {"findings": [dataclasses.asdict(lost), *rest["findings"]]}
    with open(result) as file:
        return dict(json.load(file))


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fuzz", description=__doc__.splitlines()[0])
    parser.add_argument("--calls", type=int, default=10_000, help="numbers of calls; what answers offer comes on top")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first call")
    parser.add_argument("--only", type=int, help="make this one call again, and show its error in full")
    parser.add_argument("--write", metavar="FILE", help="write the findings there after each portion")
    parser.add_argument("--times", action="store_true", help="show what the time is spent on")
    options = parser.parse_args(words)
    start, here = time.monotonic(), os.getcwd()
    counts: Counter[str] = Counter()
    findings: list[Finding] = []
    seconds: Counter[str] = Counter()
    answered = 0
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        os.chmod(folder, 0o777)
        os.chdir(folder)
        try:
            warm_up()
            if options.only is not None:
                SHOWN.append(True)
                session = Session(options.seed)
                session.one(options.only)
                print(table(session.findings, options.seed))
                return int(bool(session.findings))
            for first in range(options.first, options.first + options.calls, PORTION):
                last = min(first + PORTION, options.first + options.calls)
                found = portion(options.seed, first, last)
                counts.update(found["counts"])
                seconds.update(found["seconds"])
                answered += found["answered"]
                findings += [Finding(**one) for one in found["findings"]]
                with open(os.path.join(here, options.write), "w") if options.write else io.StringIO() as file:
                    file.write(table(findings, options.seed))
                passed = time.monotonic() - start
                print(f"{sum(counts.values())} calls, {len(findings)} findings, {passed:.0f} s", file=sys.stderr)
        finally:
            os.chdir(here)
    print(f"{sum(counts.values())} calls of {len(counts)} names, {answered} answered, {len(findings)} findings in "
          f"{len({one.group for one in findings})} groups, {time.monotonic() - start:.0f} s")  # fmt: skip
    if options.times:
        for name, spent in seconds.most_common(25):
            print(f"{name:<40} {spent:8.2f} s of the processor, {1e3 * spent / counts[name]:8.2f} ms a call")
    if findings:
        print(table(findings, options.seed))
    return int(bool(findings))


if __name__ == "__main__":
    sys.exit(main())
