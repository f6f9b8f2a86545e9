"""Every public name is documented in numpydoc form, and the documentation agrees with the signature."""

from __future__ import annotations

import ast
import builtins
import dataclasses
import inspect
import re
import textwrap
from collections.abc import Callable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import pytest

import ph_control as phc

# functions whose cost and accuracy one line of their body tells
COST_IS_PLAIN = {"symplectic_form", "is_symplectic", "is_hamiltonian_matrix", "modes"}

Section = dict[str, tuple[str, str]]  # entry -> its type, its description


def public_names() -> dict[str, Any]:
    return {name: getattr(phc, name) for name in phc.__all__}


def public_functions() -> dict[str, Callable[..., Any]]:
    return {name: value for name, value in public_names().items() if inspect.isfunction(value)}


def public_classes() -> dict[str, type]:
    return {name: value for name, value in public_names().items() if inspect.isclass(value)}


def members(cls: type) -> Iterator[tuple[str, Any]]:
    """Public attributes that a class of the package defines, or inherits from one, and that carry documentation."""
    ours = [vars(base) for base in reversed(cls.__mro__) if base.__module__.startswith("ph_control")]
    for name, value in {name: value for attributes in ours for name, value in attributes.items()}.items():
        documented = inspect.isfunction(value) or isinstance(value, classmethod | staticmethod | property)
        if not name.startswith("_") and (documented or isinstance(value, cached_property) or _is_view(value)):
            yield name, getattr(value, "__func__", value)


def _is_view(value: Any) -> bool:
    return type(value).__module__.startswith("ph_control") and hasattr(type(value), "__get__")


def public_methods() -> dict[str, tuple[type, Any]]:
    return {f"{c}.{name}": (cls, value) for c, cls in public_classes().items() for name, value in members(cls)}


# --- reading a docstring ---------------------------------------------------------------------------------------------


def sections(doc: str) -> dict[str, str]:
    """Text of each section; the part before the first heading is called 'Summary'."""
    pieces = re.split(r"^([A-Z][A-Za-z ]+)\n-{3,}\n", inspect.cleandoc(doc) + "\n", flags=re.M)
    return {"Summary": pieces[0], **dict(zip(pieces[1::2], pieces[2::2], strict=True))}


def entries(text: str) -> Section:
    """Entries `name, name : type` of a section, each with its indented description."""
    found: Section = {}
    names: list[str] = []
    for line in text.splitlines():
        if not line.strip():
            continue
        if line.startswith(" "):
            for name in names:
                found[name] = (found[name][0], (found[name][1] + " " + line.strip()).strip())
        else:
            head, _, kind = line.partition(" : ")
            names = [name.strip() for name in head.split(",")]
            found |= {name: (kind, "") for name in names}
    return found


def signature_names(function: Callable[..., Any], documented: Section) -> list[str]:
    """Parameters of a function; keywords, whose order says nothing, in the order of the documentation."""
    stars = {inspect.Parameter.VAR_POSITIONAL: "*", inspect.Parameter.VAR_KEYWORD: "**"}
    parameters = [p for p in inspect.signature(function).parameters.values() if p.name not in ("self", "cls")]
    keywords = [p.name for p in parameters if p.kind is inspect.Parameter.KEYWORD_ONLY]
    told = [name for name in documented if name in keywords]
    ordered = iter(told + [name for name in keywords if name not in told])
    return [next(ordered) if p.name in keywords else stars.get(p.kind, "") + p.name for p in parameters]


# --- what is wrong with it -------------------------------------------------------------------------------------------


def summary_complaints(doc: str | None) -> list[str]:
    if not doc or not doc.strip():
        return ["it has no docstring"]
    first = inspect.cleandoc(doc).split("\n\n")[0]
    return (
        []
        if "\n" not in first and first.rstrip("`)").endswith(".")
        else [f"its first line is not one sentence: {first!r}"]
    )


def parameter_complaints(documented: Section, wanted: list[str], *, ordered: bool = True) -> list[str]:
    if list(documented) != wanted if ordered else not set(wanted) <= set(documented):
        return [f"its parameters are {wanted}, documented are {list(documented)}"]
    found = []
    for name, (kind, description) in documented.items():
        if not description:
            found.append(f"{name} is not described")
        if re.match(r"(array_like|ndarray)", kind) and "shape" not in kind + description:
            found.append(f"{name} is an array without a shape")
    return found


def raised(function: Callable[..., Any]) -> tuple[set[str], bool]:
    """Names of the exceptions that a function itself raises, and whether it validates its input."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    names, validates = set(), False
    for node in ast.walk(tree):
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) and isinstance(node.exc.func, ast.Name):
            names.add(node.exc.func.id)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            owner = node.func.value
            checks = isinstance(owner, ast.Name) and owner.id == "_checks" and node.func.attr != "readonly"
            validates = validates or checks
    return names, validates


def raises_complaints(function: Callable[..., Any], parts: dict[str, str]) -> list[str]:
    documented = entries(parts.get("Raises", ""))
    kinds = {name: _exception(name) for name in documented}
    found = [f"{name} under Raises is no exception" for name, kind in kinds.items() if kind is None]
    found += [f"it does not say when {name} is raised" for name, (_, text) in documented.items() if not text]
    names, validates = raised(function)
    if validates and not documented:
        found.append("it validates its input but has no Raises")
    for name in sorted(names):
        kind = _exception(name)
        if kind and not any(known and issubclass(kind, known) for known in kinds.values()):
            found.append(f"it raises {name} but Raises does not say so")
    return found


def _exception(name: str) -> type[BaseException] | None:
    kind = getattr(phc, name, getattr(builtins, name, None))
    return kind if inspect.isclass(kind) and issubclass(kind, BaseException) else None


def function_complaints(function: Callable[..., Any]) -> list[str]:
    """Everything that a documented function or method must have, whatever its cost."""
    found = summary_complaints(function.__doc__)
    if not function.__doc__:
        return found
    parts = sections(function.__doc__)
    documented = entries(parts.get("Parameters", "")) | entries(parts.get("Other Parameters", ""))
    found += parameter_complaints(documented, signature_names(function, documented))
    answer = inspect.signature(function).return_annotation
    if answer is inspect.Signature.empty:
        found.append("its return type is not annotated")
    elif (answer not in (None, "None")) != ("Returns" in parts):
        found.append(
            f"it returns {answer}, but its docstring has {'a' if 'Returns' in parts else 'no'} section Returns"
        )
    found += raises_complaints(function, parts)
    return found + example_complaints(parts)


def example_complaints(parts: dict[str, str]) -> list[str]:
    """An example of its own, or the name of a documented function whose example shows it: "See `name`."."""
    text = parts.get("Examples", "")
    referred = re.match(r"\s*See `(\w+)`", text)
    shown = getattr(phc, referred[1], None) if referred else None
    return [] if ">>>" in text or (shown and ">>>" in (shown.__doc__ or "")) else ["it has no example"]


def shown_by_a_function(parts: dict[str, str]) -> bool:
    """Whether the first line of a result names a function or method with an example: "made by `pem`"."""
    for name in re.findall(r"`([\w.]+)`", parts["Summary"].split("\n")[0]):
        maker: Any = phc
        for part in name.split("."):
            maker = getattr(maker, part, None)
        if ">>>" in (maker.__doc__ or ""):
            return True
    return False


def class_complaints(cls: type) -> list[str]:
    found = summary_complaints(cls.__doc__)
    parts = sections(cls.__doc__ or "")
    documented = entries(parts.get("Parameters", "")) | entries(parts.get("Attributes", ""))
    if dataclasses.is_dataclass(cls):
        fields = [field.name for field in dataclasses.fields(cls) if not field.name.startswith("_")]
        found += parameter_complaints(documented, fields, ordered=False)
    elif "__init__" in vars(cls):
        arguments = entries(parts.get("Parameters", ""))
        found += parameter_complaints(arguments, signature_names(cls.__init__, arguments))
    return found if dataclasses.is_dataclass(cls) and shown_by_a_function(parts) else found + example_complaints(parts)


def method_complaints(cls: type, name: str, member: Any) -> list[str]:
    # what python-control documents need not be repeated where it is overridden, and attributes take no arguments
    inherited = any(name in vars(base) for base in cls.__mro__[1:])
    if not inspect.isfunction(member) or inherited:
        return summary_complaints(member.__doc__)
    return function_complaints(member)


# --- the package -----------------------------------------------------------------------------------------------------


def test_the_public_names_are_functions_and_classes_of_this_package():
    assert {"ph", "modes", "williamson"} <= set(public_functions())
    assert {"PortHamiltonian", "ModalForm", "PHControlError"} <= set(public_classes())
    assert {"PortHamiltonian.hamiltonian", "PortHamiltonian.Q", "ModalForm.zeros"} <= set(public_methods())
    assert set(public_names()) == set(public_functions()) | set(public_classes())
    assert {value.__module__.split(".")[0] for value in public_names().values()} == {"ph_control"}


def test_the_reference_lists_every_public_name_once():
    page = (Path(__file__).parents[1] / "docs" / "reference.md").read_text(encoding="utf-8")
    listed = re.findall(r"^   (\w+)$", page, flags=re.M)
    assert sorted(listed) == sorted(public_names()), "docs/reference.md lists the public names, grouped by task"


def test_the_package_says_what_it_is():
    assert summary_complaints(phc.__doc__) == []


@pytest.mark.variants
@pytest.mark.parametrize("name", public_functions())
def test_a_public_function_is_documented(name):
    assert function_complaints(public_functions()[name]) == []


@pytest.mark.parametrize("name", sorted(set(public_functions()) - COST_IS_PLAIN))
def test_a_public_function_states_its_cost_or_accuracy(name):
    assert len(sections(public_functions()[name].__doc__ or "").get("Notes", "")) > 20


@pytest.mark.parametrize("name", public_classes())
def test_a_public_class_is_documented(name):
    assert class_complaints(public_classes()[name]) == []


@pytest.mark.variants
@pytest.mark.parametrize("name", public_methods())
def test_a_public_method_or_attribute_is_documented(name):
    cls, member = public_methods()[name]
    assert method_complaints(cls, name.split(".")[1], member) == []


# --- the checker sees what is wrong ----------------------------------------------------------------------------------


def _good(a, b=1, **names) -> float:
    """Do one thing.

    Parameters
    ----------
    a : array_like, shape (n,)
        First.
    b : int
        Second, as in `c`.
    **names
        As for `control.ss`.

    Returns
    -------
    float

    Raises
    ------
    StructureError
        If `a` is empty.

    Examples
    --------
    >>> 1 + 1
    2
    """
    if not a:
        raise phc.StructureError("a is empty")
    return float(b)


def _spoiled(old: str, new: str) -> Callable[..., Any]:
    def function(a, b=1, **names) -> float:
        return 0.0

    assert old in _good.__doc__
    function.__doc__ = _good.__doc__.replace(old, new)
    return function


def test_a_well_documented_function_has_no_complaints():
    assert function_complaints(_good) == []
    assert function_complaints(_spoiled(">>> 1 + 1", "See `ph`.")) == []


@pytest.mark.parametrize(
    "old, new, complaint",
    [
        ("Do one thing.", "Do one thing\n    and another.", "not one sentence"),
        ("Do one thing.", "Do one thing", "not one sentence"),
        ("    b : int\n        Second, as in `c`.\n", "", "its parameters are"),
        ("b : int", "c : int", "its parameters are"),
        ("**names", "names", "its parameters are"),
        ("        Second, as in `c`.\n", "", "b is not described"),
        (", shape (n,)", "", "a is an array without a shape"),
        ("Returns\n    -------\n    float", "", "no section Returns"),
        ("StructureError", "StructuralError", "no exception"),
        ("        If `a` is empty.", "", "does not say when"),
        (">>> 1 + 1", "1 + 1", "no example"),
        (">>> 1 + 1", "See `nothing`.", "no example"),
    ],
)
def test_each_omission_is_found(old, new, complaint):
    (found,) = function_complaints(_spoiled(old, new))
    assert complaint in found


def test_positional_parameters_keep_their_order_and_keywords_may_be_grouped():
    def function(a, b, *, c, d, e) -> None: ...

    def complaints(*names: str) -> list[str]:
        documented = {name: ("float", "Known.") for name in names}
        return parameter_complaints(documented, signature_names(function, documented))

    assert complaints("a", "b", "c", "d", "e") == complaints("a", "b", "e", "c", "d") == []
    for wrong in ("bacde", "acbde", "abcd", "abcdef"):
        assert len(complaints(*wrong)) == 1


def test_a_missing_docstring_is_found():
    assert summary_complaints(None) == ["it has no docstring"]
    assert function_complaints(lambda: None)[0] == "it has no docstring"


def test_an_exception_that_is_raised_or_checked_for_must_be_documented():
    def raises(a) -> None:
        raise StructureError("no")  # noqa: F821

    def validates(a) -> None:
        _checks.real_array("a", a)  # noqa: F821

    def locks(a) -> None:
        _checks.readonly(a)  # noqa: F821

    assert raises_complaints(raises, {}) == ["it raises StructureError but Raises does not say so"]
    assert raises_complaints(raises, {"Raises": "StructureError\n    Always."}) == []
    # the documented root of an error covers it
    assert raises_complaints(raises, {"Raises": "PHControlError\n    Always."}) == []
    assert raises_complaints(validates, {}) == ["it validates its input but has no Raises"]
    assert raises_complaints(locks, {}) == []


def test_fields_of_a_result_must_all_be_documented():
    @dataclasses.dataclass
    class Result:
        """Result of `pem`.

        Attributes
        ----------
        d : float
            Known.
        """

        d: float

    assert class_complaints(Result) == []
    Wider = dataclasses.make_dataclass("Wider", ["r", "d"])
    Wider.__doc__ = Result.__doc__
    assert class_complaints(Wider) == ["its parameters are ['r', 'd'], documented are ['d']"]


def test_a_result_needs_an_example_or_the_name_of_a_function_that_has_one():
    Result = dataclasses.make_dataclass("Result", [])
    for made, complaints in (("", ["it has no example"]), (" of `pem`", []), (" of `nothing`", ["it has no example"])):
        Result.__doc__ = f"Result{made}."
        assert class_complaints(Result) == complaints


def test_a_class_that_users_make_needs_an_example():
    class Machine:
        """Machine."""

    assert class_complaints(Machine) == ["it has no example"]
