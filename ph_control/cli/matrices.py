"""Systems from named arrays, as `.mat` files and plain JSON hold them, and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..exceptions import FileFormatError, PHControlError, StructureError

_STEPS = ("ts", "dt", "sample_time", "sampletime")
_ADVICE = (
    "needed are A, B, C (and D) of a state space, num and den of a transfer function, Q and B of a port-Hamiltonian "
    "system, or d and r of modes"
)


def system_of(fields: Mapping[str, Any], source: str, name: str) -> Any:
    """System of arrays that have the usual names, in any case.

    A state space, a transfer function, a port-Hamiltonian system or modes; what is sampled is refused.
    """
    import control as ct

    from ..systems.port_hamiltonian import PortHamiltonian, modes

    known = _Lookup(fields, source)
    _refuse_sampled(known)
    try:
        if known.has("A", "B", "C"):
            A, B, C = known.matrix("A"), known.matrix("B", column=True), known.matrix("C")
            D = known.matrix("D") if known.has("D") else 0.0
            return ct.ss(A, B, C, D, name=name, remove_useless_states=False)
        if known.has("num", "den"):
            num, den = known.vector("num"), known.vector("den")
            if not den.any():
                raise FileFormatError(f"{source}: the denominator is zero; give the coefficients of a polynomial")
            return ct.tf(num, den, name=name)
        if known.has("Q", "B"):
            return PortHamiltonian(known.matrix("Q"), known.matrix("B", column=True), name=name)
        if known.has("d", "r"):
            return modes(known.vector("d"), known.vector("r"))
    except PHControlError:
        raise
    except (ValueError, TypeError, ct.ControlDimension) as error:
        raise FileFormatError(f"{source} holds no system: {error}; {_ADVICE}") from None
    raise FileFormatError(f"{source} holds {known.listing()}; {_ADVICE}")


class _Lookup:
    """Arrays by name: the exact one, else without regard to case."""

    def __init__(self, fields: Mapping[str, Any], source: str) -> None:
        # a structure such as that of struct(ss(...)) is looked into
        inner = [value for value in fields.values() if isinstance(value, Mapping)]
        self.fields = inner[0] if len(fields) == 1 and inner else fields
        self.source = source

    def has(self, *names: str) -> bool:
        return all(self._key(name) is not None for name in names)

    def spelling(self, name: str) -> str:
        return self._key(name) or name

    def _key(self, name: str) -> str | None:
        if name in self.fields:
            return name
        # d of modes is another thing than D of a state space
        same = [key for key in self.fields if key.casefold() == name.casefold() and name not in ("d", "r")]
        if len(same) > 1:
            raise FileFormatError(f"{self.source} has both {same[0]} and {same[1]}; keep the one that is {name}")
        return same[0] if same else None

    def array(self, name: str) -> Any:
        from .. import _checks

        key = self.spelling(name)
        value: Any = self.fields[key]
        return _checks.real_array(f"{self.source}: {key}", value.toarray() if hasattr(value, "toarray") else value)

    def vector(self, name: str) -> Any:
        array = self.array(name)
        if array.size == 0 or array.size != max(array.shape, default=1):
            raise FileFormatError(
                f"{self.source}: {name} has shape {array.shape}; needed is one row of numbers: systems with one input "
                "and one output"
            )
        return array.reshape(-1)

    def matrix(self, name: str, *, column: bool = False) -> Any:
        array = self.array(name)
        if array.ndim > 2:
            raise FileFormatError(f"{self.source}: {name} has shape {array.shape}; needed is a matrix")
        return array.reshape(-1, 1) if column and array.ndim == 1 else array

    def listing(self) -> str:
        names = list(self.fields)
        if not names:
            return "no arrays"
        return ", ".join(map(repr, names[:12])) + (f" and {len(names) - 12} more" if len(names) > 12 else "")


def _refuse_sampled(known: _Lookup) -> None:
    for step in filter(known.has, _STEPS):
        key = known.spelling(step)
        if known.fields[key] is None:
            continue
        value = known.array(step).reshape(-1)
        if value.size != 1 or value[0] != 0:
            shown = f"{value[0]:g}" if value.size else "empty"
            raise FileFormatError(
                f"{known.source} is a sampled system ({key} = {shown}), and a lossless model runs in continuous time; "
                "convert it first: in MATLAB by d2c, in Python by ph_control.ph with its method"
            )


def arrays_of(system: Any) -> dict[str, Any]:
    """Matrices of a state space."""
    return {key: getattr(system, key) for key in ("A", "B", "C", "D")}


def polynomials_of(system: Any) -> dict[str, Any]:
    """Coefficients of a transfer function with one input and one output."""
    if not system.issiso():
        raise StructureError(
            f"the system has {system.ninputs} inputs and {system.noutputs} outputs, and coefficients are those of one "
            "of each; use --to ss"
        )
    return {"num": system.num_list[0][0], "den": system.den_list[0][0]}


def modes_of(form: Any) -> dict[str, Any]:
    """Frequencies and weights of modes, where they are all there is."""
    if form.nports != 1 or len(form.rigid):
        raise StructureError("d and r alone do not tell a model of several ports, or with a pole at 0; write .json")
    return {"d": form.d, "r": form.r}
