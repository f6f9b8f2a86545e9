"""Modal identification and port-Hamiltonian models for python-control.

The public names are those of `__init__.pyi`, one a line; each is imported when it is first asked for.
"""

from typing import Any

import lazy_loader

_public_name, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    return _version() if name == "__version__" else _public_name(name)


def _version() -> str:
    """Version of the installed distribution, which has it from pyproject.toml."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(__name__)
    except PackageNotFoundError:
        raise AttributeError(f"{__name__!r} is not installed, and only an installation has a version") from None
