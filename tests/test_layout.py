"""The folders of the package are in one order: a file imports from its own folder, the root and lower folders only.

The page on the architecture and its picture show the folders as they are.
"""

from __future__ import annotations

import ast
import functools
import gc
import re
import runpy
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "ph_control"

# low to high; what lies in the package itself is below all folders
ORDER = (
    "", "numerics", "symplectic", "modal", "systems", "structures", "equivalence", "analysis", "reduction",
    "controllers", "plotting", "io.tables", "io", "circuits", "identification.data", "identification.regression",
    "identification.uncertainty", "identification.parameters", "identification.search",
    "identification.growth", "identification.moves",
    "identification.innovations", "identification.diagnosis", "identification.structure",
    "identification.excitation", "identification.estimates", "identification.change",
    "identification.fit", "identification.many", "identification.validation", "cli", "cli.commands",
)  # fmt: skip

DOCS = PACKAGE.parent / "docs"
PAGE = (DOCS / "architecture.md").read_text(encoding="utf-8")

FILES = 12  # in a folder, at most

# each shows itself by a function of a folder above, which it imports when it is called
PICTURES = {"plotting", "identification.validation"}


TESTS = Path(__file__).resolve().parent

# tests of numerics, each of which imports what it tests
NUMERICS = {
    "test_coefficients", "test_coordinates", "test_discretization", "test_general_form", "test_graphs",
    "test_innovations", "test_lapack", "test_margins", "test_modal_assurance", "test_predictor_states",
    "test_propagation", "test_reachability", "test_reactance", "test_realization", "test_reduction",
    "test_regressors", "test_residuals", "test_samples", "test_shared_poles", "test_solver", "test_spectrum",
    "test_structures", "test_symplectic", "test_triangle", "test_twofloat", "test_uncertainty",
}  # fmt: skip

# other tests that import modules of the package; all the rest use public names, and the command line
INTERNALS = {
    "test_bootstrap", "test_channels", "test_cli_models", "test_contradiction", "test_data", "test_excitation",
    "test_plots", "test_system_plots", "test_windowed_responses",
}  # fmt: skip


def _tree(source: str) -> ast.Module:
    """Syntax of a source, of so many objects that the collector of garbage takes longer than the parser."""
    gc.disable()
    try:
        return ast.parse(source)
    finally:
        gc.enable()


@functools.cache
def _said(file: Path) -> tuple[list[tuple[ast.Import | ast.ImportFrom, str]], list[str]]:
    """Imports of a file, with the names of the functions around them, and its classes."""
    tree = _tree(file.read_text(encoding="utf-8"))
    return _imports(tree), [node.name for node, _ in _statements(tree) if isinstance(node, ast.ClassDef)]


@functools.cache
def imports(package: Path) -> list[tuple[str, str, str]]:
    """`(module, imported module, function around the import)` of every import inside a package."""
    known = {_name(file, package) for file in package.rglob("*.py")}
    found = []
    for file in sorted(package.rglob("*.py")):
        name = _name(file, package)
        inside = name.split(".") if file.stem == "__init__" and name else name.split(".")[:-1]
        for node, around in _said(file)[0]:
            found += [(name, target, around) for target in _targets(node, inside, package.name, known)]
    return found


def _name(file: Path, package: Path) -> str:
    parts = file.relative_to(package).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _statements(tree: ast.AST, around: str = "") -> Iterator[tuple[ast.AST, str]]:
    """Every statement inside, with the name of the function around it."""
    for node in ast.iter_child_nodes(tree):
        if not isinstance(node, ast.expr):  # which holds no statements
            yield node, around
            yield from _statements(node, node.name if isinstance(node, ast.FunctionDef) else around)


def _imports(tree: ast.AST) -> list[tuple[ast.Import | ast.ImportFrom, str]]:
    return [(node, around) for node, around in _statements(tree) if isinstance(node, ast.Import | ast.ImportFrom)]


def _targets(node: ast.Import | ast.ImportFrom, inside: list[str], root: str, known: set[str]) -> list[str]:
    if isinstance(node, ast.Import):
        paths = [alias.name.split(".") for alias in node.names]
        return [".".join(path[1:]) for path in paths if path[0] == root]
    path = inside[: len(inside) - node.level + 1] if node.level else []
    path = path + (node.module.split(".") if node.module else [])
    if not node.level:
        if path[0] != root:
            return []
        path = path[1:]
    whole = [".".join([*path, alias.name]) for alias in node.names]
    return [target if target in known else ".".join(path) for target in whole]


def folder(module: str) -> str:
    """Folder of a module: two names deep in `identification`, one elsewhere, '' for what lies in the package itself."""
    parts = module.split(".")
    if parts[0] == "identification":
        return ".".join(parts[:2])
    return parts[0] if parts[0] in ORDER else ""


def violations(found: list[tuple[str, str, str]]) -> list[str]:
    """One sentence for every import of a folder above, but for those with which `plot` and `report` show an object."""
    wrong = []
    for module, target, around in found:
        here, there = folder(module), folder(target)
        if not module or module == "__main__" or (here.startswith("cli") and not target):
            continue  # the first collects the public names, the second starts the command line, which uses these names
        if not target:
            wrong.append(f"{module} imports the package itself")
        elif here not in ORDER or there not in ORDER:
            wrong.append(f"{module} imports {target}: a folder that is not in ORDER")
        elif ORDER.index(there) > ORDER.index(here) and not (around.endswith(("plot", "report")) and there in PICTURES):
            wrong.append(f"{module} imports {target}, from a folder above")
    return wrong


def existing_folders() -> list[str]:
    """Folders of the package that hold modules, by their path in it."""
    folders = {str(file.parent.relative_to(PACKAGE)) for file in PACKAGE.rglob("*.py") if file.name != "__init__.py"}
    return sorted(folders - {"."})


def named_folders(page: str) -> list[str]:
    """Folders in the first column of a table."""
    return re.findall(r"^\| `([a-z_/]+)/` \|", page, flags=re.M)


def test_every_folder_imports_only_from_lower_ones():
    assert violations(imports(PACKAGE)) == []


def test_a_folder_has_few_files():
    folders = {file.parent for file in PACKAGE.rglob("*.py")}
    counts = {str(one.relative_to(PACKAGE)): len({*one.glob("*.py")} - {one / "__init__.py"}) for one in folders}
    assert {name: count for name, count in counts.items() if count > FILES} == {}


def test_no_two_classes_have_one_name():
    names = [name for file in PACKAGE.rglob("*.py") for name in _said(file)[1]]
    assert sorted(set(names)) == sorted(names)


def test_every_folder_is_in_the_order_and_says_what_is_inside():
    for file in PACKAGE.rglob("__init__.py"):
        name = _name(file, PACKAGE)
        assert name == "identification" or (folder(name) in ORDER and (not name or folder(name))), name
        assert ast.get_docstring(_tree(file.read_text(encoding="utf-8"))), name


def test_the_page_on_the_architecture_names_every_folder_and_no_other():
    assert sorted(named_folders(PAGE)) == existing_folders()


def test_every_file_on_the_page_exists():
    files = re.findall(r"`([a-z_/]+\.pyi?)`", PAGE)
    assert "exceptions.py" in files
    assert [name for name in files if not (PACKAGE / name).is_file()] == []


def test_the_picture_has_every_folder_and_is_what_its_script_draws():
    drawing = runpy.run_path(str(DOCS / "architecture.py"))
    boxes = [name.replace(".", "/") for name in drawing["FOLDERS"] if name != PACKAGE.name]
    assert sorted(boxes) == existing_folders()
    in_order = [name.replace(".", "/") for name in ORDER if name.replace(".", "/") in boxes]
    assert boxes == in_order[::-1]
    assert (DOCS / "architecture.svg").read_text(encoding="utf-8") == drawing["picture"]()


def imported_modules(source: str) -> set[str]:
    """Modules of the package, but for the entry of the command line, that a source imports anywhere."""
    found = set()
    for node, _ in _imports(_tree(source)):
        names = [alias.name for alias in node.names]
        if isinstance(node, ast.Import):
            found |= {name for name in names if name.startswith("ph_control.")}
        elif node.module == "ph_control":
            found |= {name for name in names if name.startswith("_") or (PACKAGE / name).is_dir()} - {"cli"}
        elif node.module and node.module.startswith("ph_control.") and (node.module, names) != CLI:
            found.add(node.module)
    return found


CLI = ("ph_control.cli", ["main"])


def test_tests_use_public_names():
    sources = {file.stem: file.read_text(encoding="utf-8") for file in TESTS.glob("*.py")}
    # to read the syntax of all takes long
    suspects = {name for name, source in sources.items() if "from ph_control" in source or "ph_control." in source}
    found = {name for name in suspects if imported_modules(sources[name])}
    assert found == NUMERICS | INTERNALS
    assert len(INTERNALS) <= 10


@pytest.mark.parametrize(
    "statement",
    [
        "from ph_control.io import files",
        "from ph_control.cli import main, fit",
        "from ph_control import _checks",
        "from ph_control import identification",
        "import ph_control.modal.zeros as zeros",
        "def f():\n    from ph_control.modal.zeros import one_port_zeros",
    ],
)
def test_a_test_that_imports_a_module_is_noticed(statement):
    assert imported_modules(statement)
    assert not imported_modules(
        "import ph_control as phc\nfrom ph_control import pem, cli\nfrom ph_control.cli import main"
    )


def test_modules_are_imported_by_name_in_three_places_only():
    """The codec of a fit in a file, the commands of the command line, and packages that need not be installed."""
    found = {file.stem for file in PACKAGE.rglob("*.py") if "import_module" in file.read_text(encoding="utf-8")}
    assert found == {"codecs", "__init__", "exceptions"}


def test_the_known_imports_of_the_package_are_seen():
    """Guards the reader of the imports: were it blind, the tests above would pass on anything."""
    found = imports(PACKAGE)
    assert ("_checks", "exceptions", "") in found
    assert ("modal.modal_form", "modal.zeros", "") in found
    assert ("analysis.energy", "plotting.energy_plot", "plot") in found


@pytest.mark.parametrize(
    "statement",
    [
        "from ..plotting import style",
        "from ..plotting.style import thing",
        "from pkg.plotting.style import thing",
        "import pkg.plotting.style",
        "def f():\n    from ..plotting.style import thing",
        "class A:\n    def f(self):\n        import pkg.plotting.style as h",
        "try:\n    from ..plotting.style import thing\nexcept ImportError:\n    pass",
        "if TYPE_CHECKING:\n    from ..plotting.style import thing",
    ],
)
def test_an_import_that_goes_up_is_reported_wherever_it_stands(tmp_path, statement):
    package = tmp_path / "pkg"
    sources = {
        "__init__": "", "modal/__init__": "", "modal/a": statement, "plotting/__init__": "", "plotting/style": "thing=1"
    }  # fmt: skip
    for name, source in sources.items():
        file = package / f"{name}.py"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(source, encoding="utf-8")
    assert violations(imports(package)) == ["modal.a imports plotting.style, from a folder above"]


def test_only_a_plot_method_may_draw_with_what_is_above():
    assert violations([("modal.a", "plotting.style", "plot"), ("plotting.b", "modal.a", "")]) == []
    assert len(violations([("modal.a", "cli.options", "plot"), ("modal.a", "", ""), ("new.a", "modal.a", "")])) == 3
