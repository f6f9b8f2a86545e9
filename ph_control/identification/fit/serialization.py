"""How a result is written to a file and comes back.

A table names the fields of a class and how each is read; writing needs no more than the names.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._units import SECONDS
from ...exceptions import StructureError
from ...io.codecs import Codec, system_from_dict, system_to_dict
from ...io.json_format import Fields
from ...modal.discretization import INTERSAMPLE, METHODS
from ..data.frequency_record import FrequencyRecord
from ..data.time_record import Record
from ..diagnosis.damped_model import DampedModel, HypothesisTest
from ..diagnosis.verdict import Outcome
from ..regression.modal_regressors import QUANTITIES
from ..regression.prediction import FittedExperiment
from ..search.circumstances import Cause, Finding
from ..search.formulation import REPRESENTATIONS
from ..search.path import Start
from ..search.response_noise import NoiseKind, NoiseLaw
from ..uncertainty.fisher import Information
from .result import OrderRow, PEMResult

Reader = Callable[[Fields, str], Any]


# --- readers of one field --------------------------------------------------------------------------------------------


def _array(*shape: int | None, kind: type = float, finite: bool = True) -> Reader:
    """Array of that shape; None stands for a length that the file decides."""
    take = Fields.complex_array if kind is complex else Fields.array
    return lambda fields, name: take(fields, name, shape, finite=finite)


def _one_of(allowed: Iterable[str]) -> Reader:
    def read(fields: Fields, name: str) -> str:
        found = fields.text(name)
        if found not in allowed:
            raise StructureError(f"{name} is {found!r}; it must be one of {', '.join(map(repr, allowed))}")
        return found

    return read


def _member(kind: type[Enum]) -> Reader:
    named = {str(one.value): one for one in kind}
    return lambda fields, name: named[_one_of(named)(fields, name)]


def _places(count: int | None = None) -> Reader:
    """Whole numbers, as places in a list of so many."""

    def read(fields: Fields, name: str) -> tuple[int, ...]:
        values = fields.array(name, (None,))
        if (values != np.rint(values)).any() or (values < 0).any():
            raise StructureError(f"{name} does not hold whole numbers >= 0")
        if count is not None and (values >= count).any():
            raise StructureError(f"{name} names number {int(values.max())}; there are 0 to {count - 1}")
        return tuple(values.astype(int).tolist())

    return read


def _marks(count: int) -> Reader:
    """Flags, of which the file holds the places that are set."""
    return lambda fields, name: np.isin(np.arange(count), _places(count)(fields, name))


def _values(fields: Fields, name: str) -> tuple[float, ...]:
    return tuple(fields.array(name, (None,)).tolist())


def _if_there(read: Reader, otherwise: Any) -> Reader:
    """Field that older files do not have, or that is left out where there is nothing to say."""
    return lambda fields, name: read(fields, name) if name in fields else otherwise


def _object(read: Callable[[Fields], Any]) -> Reader:
    return lambda fields, name: read(fields.nested(name))


def _numbered(read: Callable[[Fields], Any]) -> Reader:
    """Objects under the names '1', '2', and so on."""

    def read_all(fields: Fields, name: str) -> tuple[Any, ...]:
        inner = fields.nested(name)
        found: list[Any] = []
        while str(len(found) + 1) in inner:
            found.append(read(inner.nested(str(len(found) + 1))))
        return tuple(found)

    return read_all


def _read(fields: Fields, readers: dict[str, Reader]) -> dict[str, Any]:
    return {name: read(fields, name) for name, read in readers.items()}


def _written(thing: Any, names: Iterable[str]) -> dict[str, Any]:
    """Fields of an object as a document holds them; what is None is left out."""
    found = {}
    for name in names:
        value = getattr(thing, name)
        if isinstance(value, Enum):
            value = value.value
        elif isinstance(value, np.ndarray) and value.dtype == bool:
            value = np.flatnonzero(value).tolist()
        elif isinstance(value, tuple):
            value = list(value)
        if value is not None:
            found[name] = value
    return found


def _counted(things: Iterable[dict[str, Any]]) -> dict[str, Any]:
    return {str(k): one for k, one in enumerate(things, start=1)}


# --- tables: the fields of each class --------------------------------------------------------------------------------

_UNIT = _if_there(_one_of(SECONDS), None)
_TEST: dict[str, Reader] = {
    "hypothesis": Fields.text, "likelihood_ratio": Fields.number, "dof": Fields.integer, "p": Fields.number
}  # fmt: skip
_NOISE: dict[str, Reader] = {"kind": _member(NoiseKind), "floor": Fields.number, "share": Fields.number}
_FINDING: dict[str, Reader] = {"cause": _member(Cause), "values": _values, "gain": Fields.number}
_LABELS: dict[str, Reader] = {"input_label": Fields.text, "output_label": Fields.text, "time_unit": _UNIT}


def _information(size: int) -> dict[str, Reader]:
    return {
        "lengths": _array(size),
        "singular_values": _array(size),
        "vectors": _array(size, size),
        "tolerance": Fields.number,
    }


def _experiment(n: int, samples: int, in_time: bool) -> dict[str, Reader]:
    return {
        "initial_state": _array(2 * n if in_time else 0),
        "free_amplitudes": _array(n if in_time else 0, kind=complex),
        "offset": Fields.number,
        "predicted": _array(samples, kind=float if in_time else complex),
        "drift": _if_there(Fields.number, 0.0),
        "outliers": _if_there(_places(samples), ()),
    }


def _damped_model(n: int) -> dict[str, Reader]:
    numbers = ("feedthrough", "noise_variance", "loss", "loglik", "fit_percent")
    return {
        **dict.fromkeys(numbers, Fields.number),
        "residues": _array(n, kind=complex),
        "covariance": _array(4 * n + 1, 4 * n + 1, finite=False),
        "damped": _marks(n),
        "negative": _marks(n),
        "quantity": _one_of(QUANTITIES),
        "time_unit": _UNIT,
    }


def _result(n: int, size: int, experiments: int) -> dict[str, Reader]:
    numbers = ("noise_variance", "loss", "loglik", "aic", "bic", "fit_percent", "whiteness")
    return {
        "covariance": _array(size, size, finite=False),
        "offset_stderr": _array(experiments, finite=False),
        **dict.fromkeys(numbers, Fields.number),
        "active": _places(n),
        "unseen": _places(n),
        "success": Fields.flag,
        "verdict": _member(Outcome),
        "message": Fields.text,
        "n_iterations": Fields.integer,
        "method": _one_of(METHODS),
        "intersample": _one_of(INTERSAMPLE),
        "quantity": _one_of(QUANTITIES),
        "representation": _one_of(REPRESENTATIONS),
    }


# --- a result --------------------------------------------------------------------------------------------------------


def _to_dict(result: PEMResult) -> dict[str, Any]:
    found = _written(result, _result(0, 0, 0)) | {
        "system": system_to_dict(result.system),
        "experiments": _counted(map(_experiment_to_dict, result.experiments)),
        "noise": _written(result.noise, _NOISE),
        "identifiability": _written(result.identifiability, ("names", *_information(0))),
        "order_table": _table(result.order_table, ("order", "loss", "aic", "bic")),
        "starts": _table(result.starts, ("kind", "loss")) | {"order": [len(start.d) for start in result.starts]},
        "findings": _counted(_written(one, _FINDING) for one in result.findings),
        "tests": _counted(_written(one, _TEST) for one in result.tests),
    }
    return found if result.damped is None else found | {"damped": _damped_to_dict(result.damped)}


def _from_dict(fields: Fields) -> PEMResult:
    system = system_from_dict(fields.nested("system"))
    n = system.n
    experiments = _numbered(lambda inner: _experiment_from_dict(inner, n))(fields, "experiments")
    if not experiments:
        raise StructureError("there are no experiments; a fit has at least one")
    size = 2 * n + sum(len(one.initial_state) for one in experiments)
    table = fields.nested("order_table")
    orders = _places()(table, "order")
    numbers = [table.array(name, (len(orders),)).tolist() for name in ("loss", "aic", "bic")]
    starts = fields.nested("starts")
    kinds = starts.texts("kind")
    losses, sizes = starts.array("loss", (len(kinds),)).tolist(), _places()(starts, "order")
    given = _read(fields, _result(n, size, len(experiments)))
    # older files tell of one variance only
    constant = NoiseLaw(NoiseKind.CONSTANT, float(np.sqrt(given["noise_variance"])))
    outcome = given.pop("verdict")
    return PEMResult(
        system=system,
        experiments=experiments,
        **given,
        outcome=outcome,
        noise=_if_there(_object(lambda inner: NoiseLaw(**_read(inner, _NOISE))), constant)(fields, "noise"),
        identifiability=_information_from_dict(fields.nested("identifiability")),
        order_table=tuple(OrderRow(*row) for row in zip(orders, *numbers, _split(table, orders), strict=True)),
        starts=tuple(Start(*one) for one in zip(kinds, losses, _split(starts, sizes), strict=True)),
        findings=_if_there(_numbered(lambda inner: Finding(**_read(inner, _FINDING))), ())(fields, "findings"),
        tests=_if_there(_numbered(lambda inner: HypothesisTest(**_read(inner, _TEST))), ())(fields, "tests"),
        damped=_if_there(_object(lambda inner: _damped_from_dict(inner, experiments)), None)(fields, "damped"),
    )


def _table(rows: Iterable[Any], names: tuple[str, ...]) -> dict[str, Any]:
    """Columns of rows that have frequencies each, these one after the other."""
    columns: dict[str, Any] = {name: [getattr(row, name) for row in rows] for name in names}
    return columns | {"d": np.concatenate([np.zeros(0), *[row.d for row in rows]])}


def _split(table: Fields, orders: tuple[int, ...]) -> list[NDArray[np.float64]]:
    """Frequencies of each row."""
    return np.split(table.array("d", (sum(orders),)), np.cumsum(orders))[:-1]


def _information_from_dict(fields: Fields) -> Information:
    names = tuple(fields.texts("names"))
    return Information(names, **_read(fields, _information(len(names))))


# --- its experiments, and its damped model ---------------------------------------------------------------------------


def _experiment_to_dict(one: FittedExperiment) -> dict[str, Any]:
    record = one.record
    if isinstance(record, Record):
        data = {"time": record.time, "dt": record.dt, "input": record.u, "output": record.y, "driven": record.driven}
    else:
        data = {"omega": record.omega, "response": record.response, "weights": record.weights, "title": record.title}
    return {"record": data | _written(record, _LABELS)} | _written(one, _experiment(0, 0, True))


def _experiment_from_dict(fields: Fields, n: int) -> FittedExperiment:
    inner = fields.nested("record")
    in_time = "time" in inner
    record = _record(inner) if in_time else _response(inner)
    return FittedExperiment(record, **_read(fields, _experiment(n, record.samples, in_time)))


def _record(fields: Fields) -> Record:
    time = fields.array("time", (None,))
    u, y = fields.array("input", (len(time),)), fields.array("output", (len(time),), finite=False)
    return Record(time, fields.number("dt"), u, y, driven=fields.flag("driven"), **_read(fields, _LABELS))


def _response(fields: Fields) -> FrequencyRecord:
    omega = fields.array("omega", (None,))
    response = fields.complex_array("response", (len(omega),), finite=False)
    weights = fields.array("weights", (len(omega),))
    return FrequencyRecord(omega, response, weights, title=fields.text("title"), **_read(fields, _LABELS))


def _damped_to_dict(model: DampedModel) -> dict[str, Any]:
    parts = zip(model.predicted, model.offsets, model.free_amplitudes, strict=True)
    return _written(model, ("poles", *_damped_model(0))) | {
        "experiments": _counted(
            {"predicted": predicted, "offset": offset, "free_amplitudes": free} for predicted, offset, free in parts
        )
    }


def _damped_from_dict(fields: Fields, fitted: tuple[FittedExperiment, ...]) -> DampedModel:
    poles = fields.complex_array("poles", (None,))
    n, inner = len(poles), fields.nested("experiments")
    in_time = isinstance(fitted[0].record, Record)
    parts = []
    for k, one in enumerate(fitted, start=1):
        predicted = _array(one.record.samples, kind=float if in_time else complex, finite=in_time)
        readers = {
            "free_amplitudes": _array(n if in_time else 0, kind=complex), "offset": Fields.number,
            "predicted": predicted,
        }  # fmt: skip
        parts.append(_read(inner.nested(str(k)), readers))
    free, offsets, predictions = (tuple(part[name] for part in parts) for name in readers)
    return DampedModel(
        poles=poles, free_amplitudes=free, offsets=offsets, predicted=predictions, **_read(fields, _damped_model(n))
    )


CODEC = Codec(PEMResult, _to_dict, _from_dict)
