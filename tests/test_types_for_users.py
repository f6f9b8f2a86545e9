"""What an editor knows of the public names: types of results, and the texts that an option may have."""

from __future__ import annotations

import gc
import importlib
import inspect
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import pytest

import ph_control as phc

ROOT = Path(phc.__file__).resolve().parents[1]

# each type behind an arrow is that of the line, without modules and kinds of numbers
SCRIPT = """\
import ph_control as phc

data = phc.read_csv("recording.csv", decimal=",")
reveal_type(data)  # -> TimeResponseData
result = phc.pem(data, order=4, structure="classical", noise="white")
reveal_type(result)  # -> PEMResult
reveal_type(result.damping_ratios)  # -> ndarray
reveal_type(result.natural_frequencies)  # -> ndarray
reveal_type(result.shapes)  # -> ndarray
reveal_type(result.stderr)  # -> Mapping[str, ndarray]
reveal_type(result.findings)  # -> tuple[Finding, ...]
reveal_type(result.modes)  # -> ModalForm
reveal_type(result.system)  # -> StateSpace
reveal_type(result.noise)  # -> NoiseModel | None
reveal_type(result.predict(data))  # -> TimeResponseData
reveal_type(result.plot())  # -> ControlPlot
reveal_type(result.sample_systems(3))  # -> list[PortHamiltonian | StateSpace]
reveal_type(result.bootstrap().stderr)  # -> Mapping[str, ndarray]
reveal_type(result.compare(result))  # -> ModeComparison
reveal_type(phc.bode_plot(result.system))  # -> ControlPlot
reveal_type(phc.compare(data, result))  # -> Comparison
reveal_type(phc.read_frequency_csv("response.csv"))  # -> FrequencyResponseData
reveal_type(phc.fit_many(["a.csv", "b.csv"]).track())  # -> ModeTracks
plant = phc.ph(phc.modes([1.0, 2.0], [1.0, 0.5]))
reveal_type(plant)  # -> PortHamiltonian
reveal_type(plant.A)  # -> ndarray
reveal_type(plant.observable_form())  # -> ObservableHamiltonian
reveal_type(phc.reduce(plant, 1))  # -> PortHamiltonian
reveal_type(phc.step_response(plant))  # -> TimeResponseData
reveal_type(phc.step_response([plant, plant]))  # -> TimeResponseList
reveal_type(phc.margin(plant))  # -> tuple[float, float, float, float]
reveal_type(phc.stability_margins(plant, returnall=True)[0])  # -> ndarray
reveal_type(phc.passivity(plant).is_passive)  # -> bool
reveal_type(phc.compare(data, plant, result.system, dt=0.1))  # -> Comparison
reveal_type(phc.bode_plot(plant, confidence=result, ax=None))  # -> ControlPlot
reveal_type(phc.sample(plant, 0.1, name="sampled"))  # -> StateSpace

phc.pem(data, structure="clasical")  # error: arg-type
phc.reduce(plant, 1, method="balance")  # error: arg-type
phc.frenkel_kontorova(2, nmae="chain")  # error: call-arg
phc.couple(plant, plant, inputs=1.5)  # error: arg-type
phc.pem(data, ports="velocity", model=plant)  # error: arg-type
result.frequencies  # error: attr-defined
"""

# python-control has no annotations, but its classes are known all the same; functions are not looked into
SETTINGS = """\
[mypy]
mypy_path = {root}
ignore_missing_imports = True
[mypy-ph_control.*]
ignore_errors = True
[mypy-control.*]
follow_untyped_imports = True
ignore_errors = True
"""


@pytest.fixture
def checked(request: pytest.FixtureRequest, tmp_path: Path) -> list[tuple[int, str]]:
    """Number and text of each line that mypy says of the script; a cache from one run to the next spares most of it."""
    api = pytest.importorskip("mypy.api", reason="types are checked by mypy, which is not installed")
    cache = getattr(request.config, "cache", None)
    folder = cache.mkdir("types_for_users") if cache else tmp_path / "cache"
    (tmp_path / "script.py").write_text(SCRIPT, encoding="utf-8")
    (tmp_path / "mypy.ini").write_text(SETTINGS.format(root=ROOT), encoding="utf-8")
    depth, threshold = sys.getrecursionlimit(), gc.get_threshold()
    options = ["--config-file", str(tmp_path / "mypy.ini"), "--cache-dir", str(folder), "--hide-error-context"]
    try:
        said, complaint, _ = api.run([*options, "--no-error-summary", str(tmp_path / "script.py")])
    finally:
        sys.setrecursionlimit(depth)
        gc.set_threshold(*threshold)
    assert complaint == ""
    return [(int(line), text) for line, text in re.findall(r"script\.py:(\d+): (.*)", said)]


def plain(kind: str) -> str:
    """Type without the modules of its parts, and arrays without what they are of."""
    kind = re.sub(r"\b(?:\w+\.)+(?=\w)", "", kind)
    inside = r"\[(?:[^\[\]]|\[(?:[^\[\]]|\[[^\[\]]*\])*\])*\]"
    return re.sub(rf"ndarray{inside}", "ndarray", kind)


@pytest.mark.slow
def test_results_and_wrong_options_are_known_before_the_program_runs(checked):
    revealed = {line: plain(text.split('"')[1]) for line, text in checked if "Revealed type" in text}
    refused = {line: text.rpartition("[")[2].rstrip("]") for line, text in checked if text.startswith("error")}
    lines = list(enumerate(SCRIPT.splitlines(), start=1))
    assert revealed == {line: text.split("# -> ")[1] for line, text in lines if "# -> " in text}
    assert refused == {line: text.split("# error: ")[1] for line, text in lines if "# error: " in text}


def test_a_type_is_compared_without_modules_and_kinds_of_numbers():
    array = "numpy.ndarray[tuple[Any, ...], numpy.dtype[numpy.floating[numpy._typing._64Bit]]]"
    assert plain(f"typing.Mapping[builtins.str, {array}]") == "Mapping[str, ndarray]"


def public_calls() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Public functions, and the methods that public classes document."""
    for name in phc.__all__:
        thing = getattr(phc, name)
        if inspect.isfunction(thing):
            yield name, thing
        elif inspect.isclass(thing):
            for key, method in inspect.getmembers(thing, inspect.isfunction):
                if not key.startswith("_") and method.__module__.startswith(phc.__name__):
                    yield f"{name}.{key}", method


def documented_texts(function: Callable[..., Any]) -> dict[str, set[str]]:
    """Texts that the section Parameters allows of each: what stands between braces."""
    lines = re.findall(r"^(\w+(?:, \w+)*) : (.*\{[\"'].*)$", inspect.getdoc(function) or "", flags=re.M)
    return {
        name: set(re.findall(r"[\"']([^\"']+)[\"']", re.findall(r"\{.*?\}", text)[0]))
        for names, text in lines
        for name in names.split(", ")
        if name in inspect.signature(function).parameters
    }


def literal_texts(kind: Any) -> set[str]:
    """Texts of all literal types inside a type."""
    if get_origin(kind) is Literal:
        return {text for text in get_args(kind) if isinstance(text, str)}
    return {text for part in get_args(kind) for text in literal_texts(part)}


def annotated_texts(function: Callable[..., Any], name: str) -> set[str]:
    """Texts that the annotation of a parameter allows."""
    module = importlib.import_module(function.__module__)
    return literal_texts(eval(function.__annotations__[name], vars(module)))


def test_options_have_the_types_that_their_documentation_lists():
    allowed = {
        f"{call}, {name}": (texts, annotated_texts(function, name))
        for call, function in public_calls()
        for name, texts in documented_texts(function).items()
        if name != "time_unit"  # which may be spelt otherwise
    }
    assert len(allowed) > 50
    assert {where: pair for where, pair in allowed.items() if pair[0] != pair[1]} == {}


def test_tables_tell_what_each_quantity_and_structure_is():
    options = importlib.import_module("ph_control._options")
    assert set(options.QUANTITIES) == set(options.SENSOR_QUANTITIES)
    given = [name for name, hypothesis in options.HYPOTHESES.items() if not hypothesis.structure]
    assert options.STRUCTURES == (*given, "free")
