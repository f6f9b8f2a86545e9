"""How a result is written to a file and comes back: field by field, each as its type says."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields as fields_of
from dataclasses import is_dataclass, replace
from enum import Enum
from types import NoneType, UnionType
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np

from ..._options import DISCRETISATIONS, INTERPOLATIONS, STRUCTURES
from ..._types import Array
from ..._units import DERIVATIVES, SECONDS
from ...exceptions import StructureError
from ...io.codecs import Codec, system_from_dict
from ...io.json_format import Fields
from ..data.channels import Kind, Recording, ResponseMatrix
from ..data.frequency_record import FrequencyRecord, LineErrors
from ..data.time_record import InTime, Record
from ..diagnosis.verdict import Outcome
from ..parameters.fitted_parameters import FittedParameters
from ..regression.modal_regressors import QUANTITIES
from ..regression.prediction import FittedChannels, FittedExperiment, ResponseBackground
from ..structure.coordinates import residue_of_unit_weight
from ..structure.parametric import PARAMETRIC
from ..uncertainty.noise_model import NoiseModel
from .pem_result import PEMResult
from .result import OrderRow

_KEYS = {"u": "input", "y": "output", "outcome": "verdict"}  # fields under another name in a document
_WORDS = {
    "method": DISCRETISATIONS, "intersample": INTERPOLATIONS, "quantity": QUANTITIES,
    "time_unit": SECONDS, "structure": (*STRUCTURES, PARAMETRIC),
}  # fmt: skip
# older files do not have them, or they are left out where there is nothing to say
_MAY_LACK = {
    "drift", "output", "experiment", "findings", "tests", "time_unit", "title", "method", "blind",
    "initial_stderr", "offset_stderr", "noise_scale", "resting", "delay", "delay_stderr", "input_delay", "background",
    "window", "blocks", "errors", "noise", "colours", "forces", "cross", "states", "apart",
    "fitted_parameters",
}  # fmt: skip
_MAY_BE_NAN = {
    "covariance", "offset_stderr", "initial_stderr", "y", "response", "shape_stderr", "delay_stderr",
    "lower", "upper",
}  # fmt: skip

# the length of each array, None where the file decides it; of places in a list, how many there are
Shapes = Mapping[str, tuple[int | None, ...]]
Fitted = FittedExperiment | FittedChannels


# --- by the types of fields ------------------------------------------------------------------------------------------


def _written(thing: Any, *apart: str) -> dict[str, object]:
    """Fields of an object as a document holds them, but for some; what is None is left out."""
    hints = get_type_hints(type(thing))
    values = {
        field.name: getattr(thing, field.name) for field in fields_of(thing) if field.init and field.name not in apart
    }
    return {
        _KEYS.get(name, name): _plain(value, _is_of_objects(hints[name]))
        for name, value in values.items() if value is not None
    }  # fmt: skip


def _plain(value: Any, of_objects: bool) -> Any:
    if isinstance(value, Enum):
        return value.value
    if of_objects:
        return _counted(map(_written, value))
    if is_dataclass(value):
        return _written(value)
    if isinstance(value, np.ndarray) and value.dtype == bool:
        return np.flatnonzero(value).tolist()
    return list(value) if isinstance(value, tuple) else value


def _is_of_objects(hint: Any) -> bool:
    return get_origin(hint) is tuple and is_dataclass(get_args(hint)[0])


def _counted(things: Iterable[dict[str, object]]) -> dict[str, object]:
    """Objects under the names '1', '2', and so on."""
    return {str(k): members for k, members in enumerate(things, start=1)}


def _all_of(fields: Fields) -> list[Fields]:
    """Objects under these names."""
    objects: list[Fields] = []
    while str(len(objects) + 1) in fields:
        objects.append(fields.nested(str(len(objects) + 1)))
    return objects


def _read(kind: Any, fields: Fields, lengths: Shapes | None = None, /, **known: Any) -> Any:
    """An object of some kind, with what is known of it already."""
    hints = get_type_hints(kind)
    for field in fields_of(kind):
        key = _KEYS.get(field.name, field.name)
        if field.init and field.name not in known and (key in fields or field.name not in _MAY_LACK):
            known[field.name] = _value(
                fields, key, field.name, hints[field.name], (lengths or {}).get(field.name, (None,))
            )
    return kind(**known)


def _value(fields: Fields, key: str, name: str, hint: Any, shape: tuple[int | None, ...]) -> Any:
    if get_origin(hint) is UnionType:
        hint = next(alternative for alternative in get_args(hint) if alternative is not NoneType)
    if get_origin(hint) is np.ndarray:
        kind = get_args(get_args(hint)[1])[0]
        if kind is np.bool_:
            return np.isin(np.arange(shape[0] or 0), _places(fields, key, shape[0]))
        return (fields.complex_array if kind is np.complex128 else fields.array)(
            key, shape, finite=name not in _MAY_BE_NAN
        )
    if get_origin(hint) is not tuple:
        return _scalar(fields, key, name, hint)
    kind = get_args(hint)[0]
    if kind is int:
        return _places(fields, key, shape[0])
    if kind is float:
        return tuple(fields.array(key, (None,)).tolist())
    return (
        tuple(fields.texts(key)) if kind is str else tuple(_read(kind, entry) for entry in _all_of(fields.nested(key)))
    )


def _scalar(fields: Fields, key: str, name: str, kind: Any) -> Any:
    if is_dataclass(kind):
        return _read(kind, fields.nested(key))
    if kind in (float, int, bool):
        if kind is float:
            return float(fields.array(key, (), finite=name not in _MAY_BE_NAN))
        readers: dict[type, Callable[[str], Any]] = {int: fields.integer, bool: fields.flag}
        return readers[kind](key)
    text = fields.text(key)
    allowed = _allowed_texts(name, kind) or (text,)
    if text not in allowed:
        raise StructureError(f"{key} is {text!r}; it must be one of {', '.join(map(repr, allowed))}")
    return text if get_origin(kind) is Literal else kind(text)


def _allowed_texts(name: str, kind: Any) -> Sequence[str]:
    """Texts that a field may have, by its type or its name; none where it may have any."""
    if get_origin(kind) is Literal:
        return get_args(kind)
    return [member.value for member in kind] if issubclass(kind, Enum) else tuple(_WORDS.get(name, ()))


def _places(fields: Fields, name: str, count: int | None = None) -> tuple[int, ...]:
    """Whole numbers, as places in a list of so many."""
    values = fields.array(name, (None,))
    if (values != np.rint(values)).any() or (values < 0).any():
        raise StructureError(f"{name} does not hold whole numbers >= 0")
    if count is not None and (values >= count).any():
        raise StructureError(f"{name} names number {int(values.max())}; there are 0 to {count - 1}")
    return tuple(values.astype(int).tolist())


# --- a result --------------------------------------------------------------------------------------------------------


def _table(rows: Iterable[Any], *names: str) -> dict[str, object]:
    """Columns of rows that have frequencies each, these one after the other."""
    columns: dict[str, Any] = {name: [getattr(row, name) for row in rows] for name in names}
    return columns | {"d": np.concatenate([np.zeros(0), *[row.d for row in rows]])}


def _order_table(fields: Fields) -> tuple[OrderRow, ...]:
    table = fields.nested("order_table")
    orders = _places(table, "order")
    numbers = [table.array(name, (len(orders),)).tolist() for name in ("loss", "aic", "bic")]
    return tuple(OrderRow(*row) for row in zip(orders, *numbers, _split(table, orders), strict=True))


def _split(table: Fields, orders: tuple[int, ...]) -> list[Array]:
    """Frequencies of each row."""
    return np.split(table.array("d", (sum(orders),)), np.cumsum(orders))[:-1]


# --- its experiments, and its damped model ---------------------------------------------------------------------------


def _experiments(fields: Fields, n: int, records: Sequence[Kind] = (), states: int | None = None) -> tuple[Fitted, ...]:
    """Experiments of a fit of n poles and some states, of records that are known or stored with them."""
    states = 2 * n if states is None else states
    inner = fields.nested("experiments")
    known = [_experiment(inner.nested(str(k)), n, states, record) for k, record in enumerate(records, start=1)]
    experiments = tuple(
        known or (_experiment(entry, n, states, _record(entry.nested("record"))) for entry in _all_of(inner))
    )
    if not experiments:
        raise StructureError("there are no experiments; a fit has at least one")
    return experiments


def _record(fields: Fields) -> Kind:
    """Data of one input and output, or of several channels."""
    in_time, single = "time" in fields, "output_label" in fields
    samples = len(fields.array("time" if in_time else "omega", (None,)))
    p, m = ((), ()) if single else ((len(fields.texts(f"{side}_labels")),) for side in ("output", "input"))
    entries = (*p, *m, samples)
    shapes: Shapes = {"u": (*m, samples), "y": (*p, samples), "response": entries, "weights": entries}
    kinds = (Record, FrequencyRecord) if single else (Recording, ResponseMatrix)
    known: dict[str, Any] = {}
    if "errors" in fields:
        size = ((1, 1) if single else (*p, *m)) + (None, samples)
        known["errors"] = _read(LineErrors, fields.nested("errors"), {"covariances": size, "relations": size})
    return _read(kinds[not in_time], fields, shapes, **known)


def _experiment(fields: Fields, n: int, states: int, record: Kind) -> Fitted:
    in_time, single = isinstance(record, InTime), isinstance(record, Record | FrequencyRecord)
    # damped modes do not predict a response where nothing was measured
    predicted = (fields.array if in_time else fields.complex_array)("predicted", record.measured.shape, finite=False)
    # forces that nobody measured leave no state to begin with
    moving = single and len(fields.array("initial_state", (None,))) > 0
    shapes: Shapes = {"initial_state": (states * moving,), "free_amplitudes": (n * in_time,)}
    if not single:
        p = len(record.output_labels)
        shapes = {"free_amplitudes": (n, p * in_time), "offsets": (p,), "drifts": (p,)}
    fields.skip("outliers")  # of older files; findings have them now
    known = {"record": record, "predicted": predicted}
    if "background" in fields:
        size = (5, 1, 1) if single else (5, *record.measured.shape[:2])
        sizes: Shapes = {"coefficients": size, "stderr": size}
        known["background"] = _read(ResponseBackground, fields.nested("background"), sizes)
    return _read(FittedExperiment if single else FittedChannels, fields, shapes, **known)


def _to_dict(result: PEMResult, *apart: str) -> dict[str, object]:
    rows, columns = np.triu_indices(len(result.covariance))
    return (
        _written(result, "experiments", "order_table", "ports", "noise")
        | _noise_to_dict(result.noise)
        | {
            "covariance": result.covariance[rows, columns],
            "experiments": _counted(_written(experiment, *apart) for experiment in result.experiments),
            "order_table": _table(result.order_table, "order", "loss", "aic", "bic"),
            "ports": {"output": [o for o, _ in result.ports], "input": [i for _, i in result.ports]},
        }
    )


def _noise_to_dict(noise: NoiseModel | None) -> dict[str, object]:
    """The noise without the matrices of the plant, which a result enters again."""
    if noise is None:
        return {}
    written = _written(noise, "states")
    if noise.apart and noise.states is not None:
        written |= {"step": noise.states[0], "seen": noise.states[1]}
    return {"noise": written}


def _noise(fields: Fields, outputs: int) -> NoiseModel | None:
    """The noise of a result; None where older files have none."""
    if "noise" not in fields:
        return None
    inner = fields.nested("noise")
    shapes: Shapes = {
        "covariance": (outputs, outputs), "colours": (outputs, None), "forces": (None, None), "cross": (None, outputs),
    }  # fmt: skip
    states = None
    if "step" in inner:
        step = inner.array("step", (None, None))
        states = step, inner.array("seen", (outputs, len(step)))
    return _read(NoiseModel, inner, shapes, states=states)


def _modal_from_dict(fields: Fields, records: Sequence[Kind] = ()) -> PEMResult:
    poles = fields.complex_array("poles", (None,))
    n, modes = len(poles), int(np.sum(poles.imag != 0))
    experiments = _experiments(fields, n, records, n + modes)
    outputs, inputs = len(experiments[0].record.output_labels), len(experiments[0].record.input_labels)
    size = 2 * n + (2 * n + 1) * outputs * inputs
    ports = fields.nested("ports")
    per_entry = isinstance(experiments[0].record, ResponseMatrix | FrequencyRecord)
    shapes: Shapes = {
        "residues": (n, outputs, inputs), "feedthrough": (outputs, inputs),
        "shapes": (modes, outputs), "shape_stderr": (modes, outputs), "participation": (modes, inputs),
        "noise_variance": (outputs, inputs) if per_entry else (outputs,),
        "delay": (outputs,), "delay_stderr": (outputs,), "input_delay": (inputs,),
    }  # fmt: skip
    pairs = zip(_places(ports, "output", outputs), _places(ports, "input", inputs), strict=True)
    rows, columns = np.triu_indices(size)
    covariance = np.empty((size, size))
    covariance[rows, columns] = covariance[columns, rows] = fields.array("covariance", (len(rows),), finite=False)
    return _read(
        PEMResult, fields, shapes, experiments=experiments, ports=tuple(pairs), covariance=covariance,
        order_table=_order_table(fields), noise=_noise(fields, outputs), fitted_parameters=_parameters(fields),
    )  # fmt: skip


def _parameters(fields: Fields) -> FittedParameters | None:
    """Parameters of a model function; None of other fits."""
    if "fitted_parameters" not in fields:
        return None
    inner = fields.nested("fitted_parameters")
    count = len(inner.texts("names"))
    vector: tuple[int | None, ...] = (count,)
    shapes: Shapes = {
        "values": vector, "start": vector, "lower": vector, "upper": vector, "covariance": (count, count),
        "hidden": (None, count),
    }  # fmt: skip
    return _read(FittedParameters, inner, shapes)


def _from_dict(fields: Fields) -> PEMResult:
    if "poles" in fields:
        return _modal_from_dict(fields)
    return _read(PEMResult, fields, order_table=_order_table(fields), **_lossless_parts(fields, _experiments))


CODECS = {
    "PEMResult": Codec(PEMResult, _to_dict, _from_dict),
    "DampedResult": Codec(PEMResult, _to_dict, _modal_from_dict),  # of older files
}


# --- files of earlier versions, in which lossless fits of one input and one output were of another class --------------

_OUTCOMES = {
    "NOT described by a collocated lossless model": Outcome.NOT_DESCRIBED,
    "NOT a model: it does not respond to the input": Outcome.NOT_DESCRIBED,
}
_NOT_KEPT = (
    "active", "identifiability", "rank_deficiency", "starts", "n_iterations", "representation", "noise", "damped",
)  # fmt: skip


def _lossless_parts(fields: Fields, experiments: Callable[..., Any]) -> dict[str, object]:
    """Read what a lossless result has in another form; `experiments` reads the data."""
    system = system_from_dict(fields.nested("system"))
    fields.skip(*_NOT_KEPT)
    seen = np.setdiff1d(np.arange(system.n), fields.array("unseen", (None,)).astype(int))
    d, r, quantity = system.d[seen], system.r[seen], fields.text("quantity")
    if quantity not in DERIVATIVES:
        raise StructureError(f"quantity is {quantity!r}; it must be one of {', '.join(map(repr, DERIVATIVES))}")
    n, power, data = len(d), DERIVATIVES[quantity], experiments(fields, system.n)
    driven = any(getattr(experiment.record, "driven", True) for experiment in data)
    per_weight = residue_of_unit_weight(d, power)
    residues = (per_weight * r).reshape(n, 1, 1)[:, :, : int(driven)]
    places = np.concatenate([seen, system.n + seen])
    known = 2 * system.n + sum(len(experiment.initial_state) for experiment in data)
    every = fields.array("covariance", (known, known), finite=False)
    inner = every[np.ix_(places, places)]
    J, l = np.zeros((4 * n + 1, 2 * n)), np.arange(n)
    J[l, l] = 1.0
    for row, part in ((2 * n, per_weight.real), (3 * n, per_weight.imag)):
        J[row + l, l], J[row + l, n + l] = power * part * r / d, part
    if power == 2:
        J[-1] = np.concatenate([r, d])
    missing = np.isnan(np.diag(inner))
    covariance = J @ np.where(missing[:, None] | missing, 0.0, inner) @ J.T
    covariance = 0.5 * (covariance + covariance.T)  # but for rounding
    lost = np.concatenate([missing[:n], np.zeros(n, bool), missing[n:], missing[n:], [power == 2 and missing.any()]])
    covariance[lost] = covariance[:, lost] = np.nan
    kept = np.arange(len(covariance)) if driven else np.arange(2 * n)
    noise, verdict = fields.number("noise_variance"), fields.text("verdict")
    in_frequency = np.iscomplexobj(data[0].predicted)
    states = np.split(np.sqrt(np.diag(every))[2 * system.n :], len(data))  # of responses none
    offsets = fields.array("offset_stderr", (len(data),), finite=False)
    errors = zip(states, offsets.tolist(), strict=True)
    root = np.sqrt(r * d)
    return {
        "structure": "lossless",
        "poles": 1j * d,
        "residues": residues,
        "feedthrough": np.array([[float((r * d).sum()) if power == 2 else 0.0]])[:, : int(driven)],
        "covariance": covariance[np.ix_(kept, kept)],
        "shapes": (root if driven else np.ones(n))[:, None].astype(complex),
        "participation": residues[:, 0] / np.where(root > 0, root, 1.0)[:, None],
        "shape_stderr": np.full((n, 1), np.nan + 0j),
        "shapes_scaled": driven,
        "ports": ((0, 0),) * driven,
        "quantities": (quantity,),
        "noise": None,
        "noise_variance": np.full((1, 1) if in_frequency else (1,), noise),
        "experiments": tuple(
            _without_hidden(experiment, seen, *error) for experiment, error in zip(data, errors, strict=True)
        ),
        "unknowns": int(np.isfinite(np.append(np.diag(every), offsets)).sum()) + 1,
        "outcome": _OUTCOMES.get(verdict)
        or next((outcome for outcome in Outcome if outcome.value == verdict), Outcome.DOUBTFUL),
    }


def _without_hidden(data: Any, seen: Any, initial_stderr: Any, offset_stderr: float) -> Any:
    """Keep the motions of the modes that the data show, with the sign of the upper poles, and their errors."""
    data = replace(data, offset_stderr=offset_stderr)
    if not len(data.initial_state):
        return data
    both = np.concatenate([seen, len(data.initial_state) // 2 + seen])
    return replace(
        data, initial_state=data.initial_state[both], initial_stderr=initial_stderr[both],
        free_amplitudes=data.free_amplitudes[seen].conj(),
    )  # fmt: skip
