"""What commands read: measurements, and models as documents of this package, matrices or coefficients."""

from __future__ import annotations

import io
import json
import re
import sys
from argparse import Namespace
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

import ph_control as phc

from ..exceptions import FileFormatError, NotLosslessError, PHControlError, StructureError
from .options import list_of_numbers
from .outcome import NoError, complain
from .outputs import check_files

_MATRICES = ("A", "B", "C", "D")


class Source(io.BytesIO):
    """Content of a file in memory, with its name for errors and titles."""

    def __init__(self, content: bytes, name: str) -> None:
        super().__init__(content)
        self.name = name


def opened(name: str) -> Source:
    """Content of a file, or of standard input for `-`."""
    from ..io.files import read_bytes

    if name != "-":
        return Source(read_bytes(name), name)
    if sys.stdin is None:
        raise StructureError("standard input is closed; name a file in place of -")
    if sys.stdin.isatty():
        complain("reading standard input from the terminal; it ends with Ctrl-D on a line of its own")
    content = read_bytes(getattr(sys.stdin, "buffer", sys.stdin))
    if not content.strip():
        raise FileFormatError("standard input is empty; the command before the pipe wrote nothing")
    return Source(content, "standard input")


# --- measurements ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Measurements:
    """Experiments, all in time or all in frequency; weights of the latter, if a column of them was named."""

    data: list[Any]
    weights: list[Any] | None
    in_time: bool

    @property
    def whole(self) -> Any:
        """Experiments as `pem` and `compare` take them."""
        return self.data if len(self.data) > 1 or self.weights is not None else self.data[0]

    @property
    def keywords(self) -> dict[str, Any]:
        """Weights as `pem` and `compare` take them."""
        return {} if self.weights is None else {"weights": self.weights}


def measurements(names: Sequence[str], options: Namespace) -> Measurements:
    """Read measurements; text tables hold frequency responses if the options or the labels say so."""
    from ..io.measurements import measured

    _refuse_contradictions(options)
    input = options.input if options.inputs is None else options.inputs
    given = {
        **vars(options), "input": False if options.no_input else input,
        "output": options.output if options.outputs is None else options.outputs,
        "time": False if options.no_time else options.time,
    }  # fmt: skip
    parts = [measured(opened(name), given) for name in names]
    data, weights = [recording for recordings, _ in parts for recording in recordings], [column for _, column in parts]
    in_time = hasattr(data[0], "time")
    if any(hasattr(recording, "time") != in_time for recording in data):
        raise StructureError("recordings in time and frequency responses do not go together; name those of one kind")
    if options.weights is not None and any(column is None for column in weights):
        raise StructureError("--weights names a column of a text table; these files have none")
    return Measurements(data, weights if options.weights is not None else None, in_time)


def _refuse_contradictions(options: Namespace) -> None:
    for option, other in (("input", "inputs"), ("output", "outputs"), ("input", "no_input"), ("time", "no_time"),
                       ("inputs", "no_input")):  # fmt: skip
        if getattr(options, option) is not None and getattr(options, other) not in (None, False):
            spelt = other.replace("_", "-")
            raise StructureError(f"--{option} and --{spelt} contradict each other; give only one")


# --- models ----------------------------------------------------------------------------------------------------------

_ADVICE = (
    "expected A, B, C (and D) of a state space, num and den of a transfer function, Q and B (and R, J, P, S, N) of a "
    "port-Hamiltonian system, or d and r of modes"
)
_AS_TEXT = (
    "a model as text is two lines, the numerator and the denominator, highest power first, such as 'num 1 0' and "
    "'den 1 0 4'"
)
_KNOWN = ("A", "B", "C", "D", "num", "den", "Q", "d", "r", "Ts", "dt")
_LOSSES = ("G", "J", "R", "P", "S", "N")  # of port-Hamiltonian systems, spelt exactly so
_MEANING = {"num": "num", "numerator": "num", "den": "den", "denominator": "den", "d": "d", "r": "r"}
_COMMENT = re.compile(r"[#%].*|//.*")
_NAMED = re.compile(r"([A-Za-z]\w*)\s*[:=,;\s]\s*(.*)")


@dataclass(frozen=True)
class Model:
    """What was read, and where from."""

    source: str
    label: str
    content: Any

    @property
    def is_result(self) -> bool:
        """Whether it is the result of a fit, data and uncertainty included."""
        return isinstance(self.content, phc.PEMResult)

    def lossless(self) -> phc.PortHamiltonian:
        """As `port_hamiltonian`; `NoError` if what other programs wrote has losses."""
        return self._of_this_package(lossless=True)

    def port_hamiltonian(self) -> phc.PortHamiltonian:
        """Object of this package that has the same transfer function, with losses or without; `NoError` if none has."""
        return self._of_this_package(lossless=False)

    def _of_this_package(self, *, lossless: bool) -> Any:
        from ..systems.base import LosslessSystem

        if self.is_result:
            return self.content.system
        if isinstance(self.content, phc.AffineHamiltonian):
            raise StructureError(
                f"{self.source} holds an AffineHamiltonian, whose output is a displacement: it has no port-Hamiltonian "
                "form, its derivative has; in Python: model.derivative()"
            )
        if isinstance(self.content, LosslessSystem | phc.ModalForm):
            return self.content
        try:
            return phc.ph(self.content, lossless=lossless)
        except NotLosslessError as error:
            raise NoError(self.source, error.violations, "lossless" if lossless else "passive") from None


def system_name_of(text: str) -> str:
    """Name that python-control accepts, for what is called so."""
    return re.sub(r"\W+", "_", text).strip("_") or "model"


def read_models(names: Sequence[str], options: Namespace) -> list[Model]:
    """Models of files, and the one of `--num` and `--den`; those of one label get their files for it."""
    models = [read_model(name) for name in names]
    if (options.num is None) != (options.den is None):
        raise StructureError("--num and --den belong together: give both, such as --num 1,0 --den 1,0,4")
    if options.num is not None:
        system = system_of({"num": options.num, "den": options.den}, "--num/--den", "model")
        models.append(Model("--num/--den", "tf", system))
    if not models:
        raise StructureError("no model given; name a file, or pass --num and --den")
    labels = [model.label for model in models]
    return [
        Model(model.source, model.source if labels.count(model.label) > 1 else model.label, model.content)
        for model in models
    ]


def source_and_target(options: Namespace, written: str) -> tuple[list[str], str]:
    """Files of a command that reads one model, if it is not given by coefficients, and writes another file."""
    sources, target = options.files[:-1], options.files[-1]
    wanted = int(options.num is None and options.den is None)
    if len(sources) != wanted:
        raise StructureError(
            (f"name the model and {written}" if wanted else f"with --num and --den, name {written} only")
            + f"; {len(options.files)} given"
        )
    check_files(options, sources, [target])
    return sources, target


def labels_of(models: Sequence[Model], options: Namespace) -> list[str]:
    """Labels that were given, or those of the models."""
    labels: list[str] = options.label or [model.label for model in models]
    if len(labels) != len(models):
        raise StructureError(f"{len(labels)} labels for {len(models)} models; give one --label for each")
    return labels


def read_model(name: str) -> Model:
    """Model of a file of any kind; its kind is told by its content."""
    from ..io.codecs import NETLISTS, restore
    from ..io.matlab import Elements, is_matlab, read_matlab

    source = opened(name)
    content = source.getvalue()
    if not content.strip():
        raise FileFormatError(f"{source.name} is empty; a model is JSON, a .mat file or a text with coefficients")
    label = Path(source.name).stem or source.name
    if Path(source.name).suffix.lower() in NETLISTS:
        return Model(source.name, label, phc.read_netlist(source, name=system_name_of(label)))
    fields: Any = None
    if is_matlab(content, source.name):
        fields = read_matlab(content, source.name)
        for key, value in fields.items():
            if key in _MATRICES and isinstance(value, Elements):
                raise FileFormatError(f"{source.name}: {key} is {value.kind}; a matrix is an array of numbers")
    elif content.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] != b"{":
        fields = coefficients_in(content, source.name)
    else:
        try:
            fields = json.loads(content)
        except (ValueError, RecursionError):
            fields = None
        if fields is None or "format" in fields or "data" in fields:
            return Model(source.name, label, restore(content, source.name))
    return Model(source.name, label, system_of(fields, source.name, system_name_of(label)))


def coefficients_in(content: bytes, name: str) -> dict[str, list[float]]:
    """Named lists of numbers in a text: a line for each, or a column for each under a header."""
    coefficients: dict[str, list[float]] = {}
    for place, key, text in _named_texts(content, name):
        meaning = _MEANING.get(key.casefold(), "")
        if not meaning or meaning in coefficients:
            wrong = "there twice" if meaning else "not known"
            raise FileFormatError(f"{name}, {place}: {key!r} is {wrong}; {_AS_TEXT}")
        try:
            coefficients[meaning] = list_of_numbers(text)
        except ValueError as error:
            raise FileFormatError(f"{name}, {place}: {error}; {_AS_TEXT}") from None
    return coefficients


def _named_texts(content: bytes, name: str) -> list[tuple[str, str, str]]:
    """Place, name and text of each list; two lines without names are num and den."""
    from ..io.tables.text_table import text_lines

    numbered = [(k, _COMMENT.sub("", line).strip(" ")) for k, line in enumerate(text_lines(content, name), 1)]
    lines = [(k, line) for k, line in numbered if line.strip()]
    if not lines:
        raise FileFormatError(f"{name} holds only comments; {_AS_TEXT}")
    header = [word.strip('"') for word in re.split(r"[,;\s]+", lines[0][1].strip())]
    if len(header) > 1 and all(word.casefold() in _MEANING for word in header):
        # a tab at the start of a line is an empty field, and the shorter of the columns ends earlier
        rows = [re.split(r"[,;\t]", line) if re.search(r"[,;\t]", line) else line.split() for _, line in lines[1:]]
        columns = [",".join(column).rstrip(", \t") for column in zip_longest(*rows, fillvalue="")]
        if len(columns) != len(header):
            raise FileFormatError(f"{name} has {len(columns)} columns below {len(header)} names; correct it")
        return [(f"column {key}", key, text) for key, text in zip(header, columns, strict=True)]
    if len(lines) != 2:
        recording = "; ph-control fit reads recordings" * (len(lines) > 2)
        raise FileFormatError(f"{name} has {len(lines)} line{'s' * (len(lines) != 1)} of text; {_AS_TEXT}{recording}")
    texts = []
    for default, (k, line) in zip(("num", "den"), lines, strict=True):
        named = _NAMED.fullmatch(line.strip())
        texts.append((f"line {k}", named[1], named[2]) if named else (f"line {k}", default, line))
    return texts


def system_of(fields: Mapping[str, Any], source: str, name: str) -> Any:
    """System of arrays that have the usual names, in any case.

    A state space, a transfer function, a port-Hamiltonian system or modes; what is sampled is refused.
    """
    import control as ct

    # a structure such as that of struct(ss(...)) is looked into
    inner = [value for value in fields.values() if isinstance(value, Mapping)]
    fields = inner[0] if len(fields) == 1 and inner else fields
    arrays = _Arrays(fields, source, {
        known: key for known in _KNOWN if (key := _spelling(fields, known, source)) is not None
    })  # fmt: skip
    for step in {"Ts", "dt"} & set(arrays.spelt):
        if fields[arrays.spelt[step]] is not None and arrays.array(step).any():
            raise FileFormatError(
                f"{source} is a sampled system ({arrays.spelt[step]} = {arrays.array(step).flat[0]:g}), and a lossless "
                "model runs in continuous time; convert it first: in MATLAB by d2c, in Python by ph_control.ph with "
                "its method"
            )
    try:
        system = _system_in(arrays, name)
    except PHControlError:
        raise
    except (ValueError, TypeError, ct.ControlDimension) as error:
        raise FileFormatError(f"{source} holds no system: {error}; {_ADVICE}") from None
    if system is not None:
        return system
    listed = ", ".join(map(repr, [*fields][:12])) + f" and {len(fields) - 12} more" * (len(fields) > 12)
    raise FileFormatError(f"{source} holds {listed or 'no arrays'}; {_ADVICE}")


@dataclass(frozen=True)
class _Arrays:
    """Arrays of a file by their usual names; `spelt` tells how these are written there."""

    fields: Mapping[str, Any]
    source: str
    spelt: Mapping[str, str]

    def array(self, known: str) -> Any:
        """Array of real numbers."""
        from .. import _checks

        return _checks.real_array(f"{self.source}: {self.spelt[known]}", self.fields[self.spelt[known]])

    def vector(self, known: str) -> Any:
        """Row of numbers, which others are refused for."""
        given = self.array(known)
        if given.size == 0 or given.size != max(given.shape, default=1):
            raise FileFormatError(
                f"{self.source}: {known} has shape {given.shape}; expected one row of numbers: systems with one input "
                "and one output"
            )
        return given.reshape(-1)

    def port(self) -> Any:
        """Matrix B, of one column where it is a vector."""
        given = self.array("B")
        return given.reshape(-1, 1) if given.ndim == 1 else given


def _system_in(arrays: _Arrays, name: str) -> Any:
    """System of the first kind of which there are all arrays, or None."""
    import control as ct

    array, vector, fields, spelt = arrays.array, arrays.vector, arrays.fields, set(arrays.spelt)
    if "Q" in spelt and ("G" in fields or ("A" not in spelt and "B" in spelt and "R" in fields)):
        return _with_losses(fields, array("Q"), arrays.port() if "B" in spelt else None, arrays.source, name)
    if {"A", "B", "C"} <= spelt:
        D = array("D") if "D" in spelt else 0.0
        return ct.ss(array("A"), arrays.port(), array("C"), D, name=name, remove_useless_states=False)
    if {"num", "den"} <= spelt:
        if not vector("den").any():
            raise FileFormatError(f"{arrays.source}: the denominator is zero; give the coefficients of a polynomial")
        return ct.tf(vector("num"), vector("den"), name=name)
    if {"Q", "B"} <= spelt:
        return phc.PortHamiltonian(array("Q"), arrays.port(), name=name)
    if {"d", "r"} <= spelt:
        return phc.modes(vector("d"), vector("r"))
    return None


def _with_losses(fields: Mapping[str, Any], Q: Any, B: Any, source: str, name: str) -> Any:
    """Port-Hamiltonian system of its structure matrices; `B` is the port matrix where there is no `G`."""
    from .. import _checks

    def matrix(key: str) -> Any:
        given = _checks.real_array(f"{source}: {key}", fields[key])
        return given.reshape(-1, 1) if key in "GP" and given.ndim == 1 else given

    parts = {key: matrix(key) for key in _LOSSES if key in fields}
    G = parts.pop("G", B)
    sensors = None
    if "sensor_rows" in fields:
        rows = _checks.real_array(f"{source}: sensor_rows", fields["sensor_rows"], 2)
        through = fields.get("sensor_feedthrough", [[0.0] * G.shape[1]] * len(rows))
        sensors = rows, _checks.real_array(f"{source}: sensor_feedthrough", through, 2)
    names = {key: fields[key] for key in ("inputs", "outputs", "states") if isinstance(fields.get(key), list)}
    own = fields.get("name")
    return phc.DissipativePortHamiltonian(
        Q, G, **parts, sensors=sensors, name=own if isinstance(own, str) else name, **names
    )


def _spelling(fields: Mapping[str, object], known: str, source: str) -> str | None:
    """How a name is written here: exactly so, or in another case, but for d of modes, which is not D."""
    if known in fields:
        return known
    same = [key for key in fields if key.casefold() == known.casefold() and known not in ("d", "r")]
    if len(same) > 1:
        raise FileFormatError(f"{source} has both {same[0]} and {same[1]}; keep the one that is {known}")
    return same[0] if same else None
