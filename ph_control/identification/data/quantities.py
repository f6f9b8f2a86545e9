"""What outputs measure: told by the data, by their labels and units, or by the caller."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from ... import _checks
from ..._display import counted, first_of
from ..._options import QUANTITIES
from ...exceptions import StructureError
from ...io.tables.columns import is_time_label

_QUANTITY_OF_WORD = {word: name for name, quantity in QUANTITIES.items() for word in quantity.words}
_UNITS = tuple((re.compile(quantity.units), name) for name, quantity in QUANTITIES.items())
_BY_FORCE = re.compile(r"/\(?(?:[kM]?N(?:\*?m)?|lbf)\)?$")


def quantity_of_label(label: str) -> str | None:
    """Quantity that the words of a label and its unit tell, or None; one that they contradict each other in is refused.

    `Accel (g)`, `x_vel [mm/s]`, `(m/s^2)/N` tell; `ch 3`, `y[0]`, `out (V)` do not.
    """
    bare = _checks.without_unit(label)
    unit = label.strip()[len(bare) :].strip(" []()/") if bare else ""
    words = re.findall(r"[^\W\d_]+", re.sub(r"([a-z])([A-Z])", r"\1 \2", bare))
    named = {_QUANTITY_OF_WORD[word.casefold()] for word in words if word.casefold() in _QUANTITY_OF_WORD}
    simple = _BY_FORCE.sub("", unit.replace(" ", "").replace("·", "*")).strip("()")
    measured = next((quantity for pattern, quantity in _UNITS if pattern.fullmatch(simple)), None)
    named |= set() if measured is None else {measured}
    if len(named) > 1:
        raise StructureError(
            f"the label {label!r} suggests both {' and '.join(sorted(named))}; pass quantity, or rename the output"
        )
    return named.pop() if named else None


def _tells(label: str) -> bool:
    """Whether a label tells a quantity; one that contradicts itself was fitted as it was given."""
    try:
        return quantity_of_label(label) is not None
    except StructureError:
        return True


def quantity_of(data: object) -> Any:
    """Quantity of each output by its label, where the data or the labels state it; else 'velocity', as of a port."""
    quantities: dict[str, str] = {}
    silent: list[str] = []
    for experiment in data if isinstance(data, list | tuple) else [data]:
        stated = getattr(experiment, "quantity", None)
        if not isinstance(stated, dict):  # a data frame may have a column of that name
            by_label = {label: quantity_of_label(label) for label in _output_labels(experiment)}
            stated = {label: quantity for label, quantity in by_label.items() if quantity is not None}
            silent += [label for label in by_label if label not in stated]
        for label, quantity in stated.items():
            if quantities.setdefault(label, quantity) != quantity:
                raise StructureError(
                    f"output {label!r} is {quantities[label]} in one experiment and {quantity} in another; pass "
                    "quantity, or give the outputs different labels"
                )
    unknown = [label for label in silent if label not in quantities]
    if quantities and unknown:
        label, quantity = next(iter(quantities.items()))
        raise StructureError(
            f"the quantity of output {unknown[0]!r} is unknown ({label!r} is {quantity}); pass "
            f"quantity={{{unknown[0]!r}: ...}} with one of {', '.join(map(repr, QUANTITIES))}"
        )
    return quantities or "velocity"


def ports_of(data: object, quantity: object) -> list[tuple[str, str]] | None:
    """Driving points (output, input) that the data state, less outputs of quantity 'free'; None if there are none."""
    stated = [getattr(experiment, "ports", None) for experiment in (data if isinstance(data, list | tuple) else [data])]
    pairs = dict.fromkeys(pair for ports in stated if isinstance(ports, list) for pair in ports if _is_pair(pair))
    free = [label for label, kind in quantity.items() if kind == "free"] if isinstance(quantity, dict) else []
    driving_points = [(output, input) for output, input in pairs if quantity != "free" and output not in free]
    return driving_points or None


def _is_pair(pair: object) -> bool:
    return isinstance(pair, tuple) and len(pair) == 2 and all(isinstance(label, str) for label in pair)


def _output_labels(data: object) -> list[str]:
    labels = getattr(data, "output_labels", None)
    if isinstance(labels, list | tuple):
        return [label for label in labels if isinstance(label, str)]
    label = getattr(data, "output_label", None)
    if isinstance(label, str):
        return [label]
    columns = [str(column) for column in getattr(data, "columns", ())]
    signals = [column for column in columns if not is_time_label(column)]
    return signals[1:] if len(signals) == 2 else []  # of more, which one is the output is still to be asked


def checked_quantities(quantity: object, labels: Sequence[str]) -> tuple[str, ...]:
    """One quantity for each output, of one for all, a sequence, or a mapping by label, which the labels complete."""
    if isinstance(quantity, str):
        each: Any = [quantity] * len(labels)
    elif isinstance(quantity, dict):
        label_of = {name: _checks.label_named(name, labels) for name in quantity}
        unknown = [name for name, label in label_of.items() if label is None]
        if unknown:
            raise StructureError(f"quantity names {unknown[0]!r}; the outputs are {', '.join(map(repr, labels))}")
        given = {label_of[name]: value for name, value in quantity.items()}
        each = [given.get(label) or quantity_of_label(label) or "velocity" for label in labels]
    else:
        each = list(quantity) if isinstance(quantity, tuple | list | np.ndarray) else [quantity]
    if len(each) != len(labels):
        raise StructureError(
            f"quantity has {len(each)} entries for {counted(len(labels), 'output')}; give one for each, or one"
        )
    return tuple(_checks.choice("quantity", kind, tuple(QUANTITIES)) for kind in each)


def measured_by(quantities: Sequence[str], labels: Sequence[str]) -> str:
    """What each output was taken to measure, in words; a velocity that no label tells was given, or is the default."""
    if set(quantities) == {"velocity"}:
        return "velocity" if all(map(_tells, labels)) else "velocity, as given or by default"
    if len(set(quantities)) == 1:
        return quantities[0]
    outputs = {
        quantity: [label for label, q in zip(labels, quantities, strict=True) if q == quantity]
        for quantity in QUANTITIES
    }
    return "; ".join(
        f"{quantity} of {first_of([*map(repr, names)], 6)}" for quantity, names in outputs.items() if names
    )
