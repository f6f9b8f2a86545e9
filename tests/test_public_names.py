"""The public names are imported when first asked for, and nobody who uses them notices."""

from __future__ import annotations

import ast
import importlib
import json
import re
from pathlib import Path

import pytest
from scripts import run
from slow import slowly

import ph_control as phc

PACKAGE = Path(phc.__file__).parent
STUB = ast.parse((PACKAGE / "__init__.pyi").read_text(encoding="utf-8"))


def in_a_new_process(folder, code):
    done = run(folder, "-c", code)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_what_a_type_checker_reads_is_what_python_finds():
    stated = {
        alias.asname: (node.module, alias.name)
        for node in STUB.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert sorted(stated) == phc.__all__ and len(stated) > 80
    for name, (module, original) in stated.items():
        # without `as` of the same name a stub keeps what it imports to itself
        assert original == name
        assert getattr(phc, name) is getattr(importlib.import_module(f"ph_control.{module}"), name)
    others = [node for node in STUB.body if not isinstance(node, ast.ImportFrom)]
    assert [ast.unparse(node) for node in others[1:]] == ["__version__: str"] and ast.get_docstring(STUB)


def test_the_import_of_the_package_imports_none_of_its_modules(tmp_path):
    code = "import sys, ph_control; print([name for name in sys.modules if name.startswith('ph_control.')])"
    assert in_a_new_process(tmp_path, code) == "[]\n"


@pytest.mark.slow
def test_a_name_imports_what_it_needs(tmp_path):
    code = """if True:
        import sys, ph_control as phc
        assert "ph" not in vars(phc)
        phc.ph
        assert "ph_control.systems.port_hamiltonian" in sys.modules
        late = ("ph_control.identification", "ph_control.plotting")
        print([name for name in sys.modules if name.startswith(late)])
    """
    assert in_a_new_process(tmp_path, code) == "[]\n"


@pytest.mark.slow
@pytest.mark.parametrize("order", ["sorted(modules, reverse=True)", *slowly("sorted(modules)")])
def test_modules_may_be_imported_in_any_order_and_hide_no_public_name(tmp_path, order):
    code = f"""if True:
        import importlib, pkgutil, types, ph_control as phc
        modules = [found.name for found in pkgutil.walk_packages(phc.__path__, "ph_control.")]
        for name in {order}:
            importlib.import_module(name)
        print([name for name in phc.__all__ if isinstance(getattr(phc, name), types.ModuleType)])
    """
    assert in_a_new_process(tmp_path, code) == "[]\n"


@pytest.mark.slow
def test_the_names_are_listed_before_they_are_imported_and_a_star_import_gives_these_and_no_other(tmp_path):
    code = """if True:
        import json, ph_control
        listed, before = dir(ph_control), set(dir())
        from ph_control import *
        print(json.dumps([listed, sorted(set(dir()) - before)]))
    """
    listed, imported = json.loads(in_a_new_process(tmp_path, code))
    assert set(phc.__all__) == {name for name in listed if not name.startswith("__")}
    assert set(imported) - {"before", "listed"} == set(phc.__all__)


@pytest.mark.parametrize("name", ["wiliamson", "_wiliamson", "__wrapped__", "no such name"])
def test_a_name_that_is_not_there_is_an_attribute_error(name):
    with pytest.raises(AttributeError, match=re.escape(name)):
        getattr(phc, name)
    assert not hasattr(phc, name)


@pytest.mark.slow
def test_results_and_pickles_are_read_where_nothing_was_asked_for_yet(tmp_path):
    """In a process that has not imported what makes them."""
    make = """if True:
        import pathlib, pickle
        import numpy as np, ph_control as phc
        u = np.random.default_rng(0).standard_normal(200)
        system = phc.ph(phc.modes([1.0], [0.5]))
        response = phc.forced_response(system, 0.1 * np.arange(200), u, intersample="zoh")
        result = phc.pem(response, 1)
        result.save("fit.json")
        pathlib.Path("pickled").write_bytes(pickle.dumps([system, phc.ph]))
        print(type(system).__name__, phc.ph.__name__, result.d[0].hex(), result.loss.hex())
    """
    read = """if True:
        import pathlib, pickle, sys
        system, ph = pickle.loads(pathlib.Path("pickled").read_bytes())
        assert not any(name.startswith("ph_control.identification") for name in sys.modules)
        import ph_control as phc
        result = phc.load("fit.json")
        print(type(system).__name__, ph.__name__, result.d[0].hex(), result.loss.hex())
        assert isinstance(result, phc.PEMResult)
        phc.save(result, "again.json")
    """
    assert in_a_new_process(tmp_path, make) == in_a_new_process(tmp_path, read)
    assert (tmp_path / "fit.json").read_text() == (tmp_path / "again.json").read_text()
