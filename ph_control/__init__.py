"""Lossless (port-Hamiltonian) linear systems for python-control.

The public names are those of `__init__.pyi`, one a line; each is imported when it is first asked for.
"""

import re
from importlib import import_module
from pkgutil import get_data
from typing import Any

_LINES = get_data(__name__, "__init__.pyi").decode()
_MODULES = {name: module for module, name in re.findall(r"^from (\.[\w.]+) import (\w+) as ", _LINES, re.MULTILINE)}

__all__ = list(_MODULES)


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        found = globals()[name] = getattr(import_module(_MODULES[name], __name__), name)
        return found
    if name == "__version__":
        return _version()
    whole = f"{__name__}.{name}"
    try:
        if not name.startswith("_"):
            return import_module(whole)
    except ModuleNotFoundError as error:
        if error.name != whole:
            raise
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def _version() -> str:
    """Version of the installed distribution, which has it from pyproject.toml."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(__name__)
    except PackageNotFoundError:
        raise AttributeError(f"{__name__!r} is not installed, and only an installation has a version") from None


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
