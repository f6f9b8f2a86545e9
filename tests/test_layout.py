"""The modules form one chain: each imports only those before it, at module level and inside functions alike."""

from __future__ import annotations

import ast
import graphlib
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "ph_control"

# low to high; a package counts as one place
ORDER = (
    "exceptions", "_checks", "_units", "_frozen", "_definite", "_display", "_twofloat", "_lapack", "_graphs",
    "_instants", "coefficients", "reduction", "symplectic", "semidefinite", "casimirs", "zeros", "reactance", "modal",
    "conditioning", "reachability", "propagation", "partial_fractions", "discrete", "lossless", "lossless_system",
    "_forms", "systems", "canonical_forms", "affine_system", "realization", "lifting", "pairs", "morphisms", "filters",
    "isomorphism", "equivalence", "groupoids", "companion", "motion", "sampling", "response", "margins", "models",
    "spectra", "_sysdata", "bode", "drawing", "fit_data", "energy", "fit_plots", "plots", "validation_plots",
    "transients", "time_plots", "mode_data", "mode_plots", "_documents", "_tables", "recordings", "frequency_tables",
    "files", "identification", "result_plots", "demo", "cli",
)  # fmt: skip

# the package itself collects the public names, and python -m starts the command line: nothing imports these two
TOP = ("__init__", "__main__")


def imported_modules(package: Path) -> dict[str, set[str]]:
    """Every module of a package, as `a` or `a.b`, with the modules of the same package that it imports anywhere.

    A stub, where there is one, stands for its module: it says what is imported late.
    """
    files = {_module_name(file, package): file for file in sorted([*package.rglob("*.py"), *package.rglob("*.pyi")])}
    return {name: _imports(name, file, package.name, set(files)) for name, file in files.items()}


def _module_name(file: Path, package: Path) -> str:
    parts = file.relative_to(package).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" and len(parts) > 1 else parts)


def _imports(name: str, file: Path, root: str, known: set[str]) -> set[str]:
    inside = [] if name == "__init__" else name.split(".")
    if file.stem != "__init__":
        inside = inside[:-1]
    found: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                path = alias.name.split(".")
                if path[0] == root:
                    found.add(".".join(path[1:]) or "__init__")
        elif isinstance(node, ast.ImportFrom):
            path = [*inside[: len(inside) - node.level + 1]] if node.level else []
            path += node.module.split(".") if node.module else []
            if not node.level:
                if path[0] != root:
                    continue
                path = path[1:]
            for alias in node.names:
                target = ".".join([*path, alias.name])
                found.add(target if target in known else ".".join(path) or "__init__")
    return found - {name}


def violations(imports: dict[str, set[str]], order: tuple[str, ...]) -> list[str]:
    """One sentence for every module without a place and every import that goes up, or round in a circle."""
    place = {name: k for k, name in enumerate(order)} | {name: len(order) for name in TOP}
    found = []
    for module, targets in imports.items():
        here = module.split(".")[0]
        if here not in place:
            found.append(f"{module} has no place in the import order; put {here!r} into ORDER of {Path(__file__).name}")
            continue
        for target in sorted(targets):
            there = target.split(".")[0]
            if there not in place:
                continue  # reported as a module of its own
            if here != there and place[there] >= place[here]:
                found.append(f"{module} imports {target}, which is not below it; a module may import only lower ones")
    try:
        graphlib.TopologicalSorter(imports).prepare()
    except graphlib.CycleError as error:
        found.append("imports go round in a circle: " + " <- ".join(error.args[1]))
    return found


def test_every_module_imports_only_lower_ones():
    assert violations(imported_modules(PACKAGE), ORDER) == []


def test_modules_are_imported_by_name_in_three_places_only():
    """The public names, the codecs of files, and the canonical forms as methods: all when they are asked for."""
    found = {file.stem for file in PACKAGE.rglob("*.py") if "import_module" in file.read_text(encoding="utf-8")}
    assert found == {"__init__", "files", "_forms"}


def test_the_known_imports_of_the_package_are_seen():
    """Guards the reader of the imports: were it blind, the test above would pass on anything."""
    imports = imported_modules(PACKAGE)
    assert {"exceptions", "_checks"} <= set(imports)
    assert imports["_checks"] == {"exceptions"}
    assert imports["modal"] == {"_checks", "_display", "coefficients", "exceptions", "reactance", "zeros"}
    assert {"modal", "systems", "response"} <= imports["__init__"]


def _package(folder: Path, **modules: str) -> Path:
    package = folder / "pkg"
    for name, source in modules.items():
        file = package.joinpath(*name.split("__in__")).with_suffix(".py")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(source, encoding="utf-8")
    return package


@pytest.mark.parametrize(
    "statement",
    [
        "from . import high",
        "from .high import thing",
        "from pkg.high import thing",
        "import pkg.high",
        "def f():\n    from .high import thing",
        "class A:\n    def f(self):\n        import pkg.high as h",
        "try:\n    from .high import thing\nexcept ImportError:\n    pass",
        "if TYPE_CHECKING:\n    from .high import thing",
    ],
)
def test_an_import_that_goes_up_is_reported_wherever_it_stands(tmp_path, statement):
    package = _package(tmp_path, __init__="", low=statement, high="thing = 1")
    (found,) = violations(imported_modules(package), ("low", "high"))
    assert found.startswith("low imports high, ")
    assert violations(imported_modules(package), ("high", "low")) == []


@pytest.mark.parametrize("statement", ["from . import thing", "from pkg import thing", "def f():\n    import pkg"])
def test_no_module_imports_the_names_that_the_package_collects(tmp_path, statement):
    package = _package(tmp_path, __init__="thing = 1", low=statement)
    (found,) = violations(imported_modules(package), ("low",))
    assert found.startswith("low imports __init__, ")


def test_an_import_that_goes_down_is_allowed(tmp_path):
    package = _package(tmp_path, __init__="from .high import f", low="import os", high="from . import low\nf = 1")
    assert violations(imported_modules(package), ("low", "high")) == []


def test_the_modules_of_a_package_count_as_one_place_but_must_not_go_round(tmp_path):
    sources = {"low": "x = 1", "part__in__a": "from .b import y\nfrom ..low import x", "part__in____init__": ""}
    straight = _package(tmp_path / "straight", **sources, part__in__b="y = 1")
    assert imported_modules(straight)["part.a"] == {"part.b", "low"}
    assert violations(imported_modules(straight), ("low", "part")) == []
    assert len(violations(imported_modules(straight), ("part", "low"))) == 1

    circle = _package(tmp_path / "circle", **sources, part__in__b="def f():\n    from . import a")
    (found,) = violations(imported_modules(circle), ("low", "part"))
    assert "circle" in found and "part.a" in found and "part.b" in found


def test_a_new_module_must_be_given_a_place(tmp_path):
    package = _package(tmp_path, low="x = 1", novelty="from .low import x")
    (found,) = violations(imported_modules(package), ("low",))
    assert found == "novelty has no place in the import order; put 'novelty' into ORDER of test_layout.py"
