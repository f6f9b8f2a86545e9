"""How a result is written to a file and comes back."""

from __future__ import annotations

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
from ..regression.modal_regressors import QUANTITIES
from ..regression.prediction import FittedExperiment
from ..search.circumstances import Cause, Finding
from ..search.formulation import REPRESENTATIONS
from ..search.path import Start
from ..search.response_noise import NoiseKind, NoiseLaw
from ..uncertainty.fisher import Information
from .result import OrderRow, PEMResult

_MODEL_NUMBERS = ("feedthrough", "noise_variance", "loss", "loglik", "fit_percent")
_NUMBERS = ("noise_variance", "loss", "loglik", "aic", "bic", "fit_percent", "whiteness")


def _to_dict(result: PEMResult) -> dict[str, Any]:
    table, starts, information = result.order_table, result.starts, result.identifiability
    return {
        "system": system_to_dict(result.system),
        "experiments": {str(k): _experiment_to_dict(one) for k, one in enumerate(result.experiments, start=1)},
        "covariance": result.covariance,
        "offset_stderr": result.offset_stderr,
        **{name: getattr(result, name) for name in _NUMBERS},
        "noise": {"kind": result.noise.kind.value, "floor": result.noise.floor, "share": result.noise.share},
        "active": list(result.active),
        "unseen": list(result.unseen),
        "identifiability": {
            "names": list(information.names),
            "lengths": information.lengths,
            "singular_values": information.singular_values,
            "vectors": information.vectors,
            "tolerance": information.tolerance,
        },
        "order_table": {
            "order": [row.order for row in table],
            "loss": [row.loss for row in table],
            "aic": [row.aic for row in table],
            "bic": [row.bic for row in table],
            "d": np.concatenate([np.zeros(0), *[row.d for row in table]]),
        },
        "starts": {
            "kind": [start.kind for start in starts],
            "loss": [start.loss for start in starts],
            "order": [len(start.d) for start in starts],
            "d": np.concatenate([np.zeros(0), *[start.d for start in starts]]),
        },
        "success": result.success,
        "verdict": result.verdict,
        "message": result.message,
        "n_iterations": result.n_iterations,
        "method": result.method,
        "intersample": result.intersample,
        "quantity": result.quantity,
        "representation": result.representation,
        "findings": {
            str(k): {"cause": one.cause.value, "values": np.array(one.values), "gain": one.gain}
            for k, one in enumerate(result.findings, start=1)
        },
        "tests": {str(k): dict(vars(one)) for k, one in enumerate(result.tests, start=1)},
        **({} if result.damped is None else {"damped": damped_to_dict(result.damped)}),
    }


def damped_to_dict(model: DampedModel) -> dict[str, Any]:
    """Fields of a damped model."""
    fields = {name: getattr(model, name) for name in (*_MODEL_NUMBERS, "poles", "residues", "covariance", "quantity")}
    fields |= {name: np.flatnonzero(getattr(model, name)).tolist() for name in ("damped", "negative")}
    if model.time_unit is not None:
        fields["time_unit"] = model.time_unit
    every = range(len(model.predicted))
    fields["experiments"] = {
        str(k + 1): {"predicted": model.predicted[k], "offset": offset, "free_amplitudes": free}
        for k, offset, free in zip(every, model.offsets, model.free_amplitudes, strict=True)
    }
    return fields


def _experiment_to_dict(one: FittedExperiment) -> dict[str, Any]:
    record = one.record
    if isinstance(record, Record):
        data: dict[str, Any] = {"time": record.time, "dt": record.dt, "input": record.u, "output": record.y}
        data["driven"] = record.driven
    else:
        data = {"omega": record.omega, "response": record.response, "weights": record.weights, "title": record.title}
    if record.time_unit is not None:
        data["time_unit"] = record.time_unit
    return {
        "record": data | {"input_label": record.input_label, "output_label": record.output_label},
        "initial_state": one.initial_state,
        "free_amplitudes": one.free_amplitudes,
        "offset": one.offset,
        "drift": one.drift,
        "predicted": one.predicted,
        "outliers": list(one.outliers),
    }


def _from_dict(fields: Fields) -> PEMResult:
    system = system_from_dict(fields.nested("system"))
    n = system.n
    experiments = _experiments(fields.nested("experiments"), n)
    size = 2 * n + sum(len(one.initial_state) for one in experiments)
    return PEMResult(
        system=system,
        experiments=experiments,
        covariance=fields.array("covariance", (size, size), finite=False),
        offset_stderr=fields.array("offset_stderr", (len(experiments),), finite=False),
        noise=_noise(fields),
        noise_variance=fields.number("noise_variance"),
        loss=fields.number("loss"),
        loglik=fields.number("loglik"),
        aic=fields.number("aic"),
        bic=fields.number("bic"),
        fit_percent=fields.number("fit_percent"),
        whiteness=fields.number("whiteness"),
        active=_modes(fields, "active", n),
        unseen=_modes(fields, "unseen", n),
        identifiability=_information(fields.nested("identifiability")),
        order_table=_order_table(fields.nested("order_table")),
        starts=_starts(fields.nested("starts")),
        success=fields.flag("success"),
        verdict=fields.text("verdict"),
        message=fields.text("message"),
        n_iterations=fields.integer("n_iterations"),
        method=_one_of(fields, "method", METHODS),
        intersample=_one_of(fields, "intersample", INTERSAMPLE),
        quantity=_one_of(fields, "quantity", QUANTITIES),
        representation=_one_of(fields, "representation", REPRESENTATIONS),
        findings=_findings(fields.nested("findings")) if "findings" in fields else (),
        tests=_tests(fields.nested("tests")) if "tests" in fields else (),
        damped=_damped(fields.nested("damped"), experiments) if "damped" in fields else None,
    )


def _tests(fields: Fields) -> tuple[HypothesisTest, ...]:
    found: list[HypothesisTest] = []
    while str(len(found) + 1) in fields:
        one = fields.nested(str(len(found) + 1))
        numbers = one.number("likelihood_ratio"), one.integer("dof"), one.number("p")
        found.append(HypothesisTest(one.text("hypothesis"), *numbers))
    return tuple(found)


def _damped(fields: Fields, fitted: tuple[FittedExperiment, ...]) -> DampedModel:
    poles = fields.complex_array("poles", (None,))
    n, inner = len(poles), fields.nested("experiments")
    parts = [inner.nested(str(k)) for k in range(1, len(fitted) + 1)]
    in_time = isinstance(fitted[0].record, Record)
    return DampedModel(
        poles=poles,
        residues=fields.complex_array("residues", (n,)),
        covariance=fields.array("covariance", (4 * n + 1, 4 * n + 1), finite=False),
        **{name: fields.number(name) for name in _MODEL_NUMBERS},
        free_amplitudes=tuple(one.complex_array("free_amplitudes", (n if in_time else 0,)) for one in parts),
        offsets=tuple(one.number("offset") for one in parts),
        predicted=tuple(
            one.array("predicted", (known.record.samples,))
            if in_time
            else one.complex_array("predicted", (known.record.samples,), finite=False)
            for one, known in zip(parts, fitted, strict=True)
        ),
        damped=np.isin(np.arange(n), _modes(fields, "damped", n)),
        negative=np.isin(np.arange(n), _modes(fields, "negative", n)),
        quantity=_one_of(fields, "quantity", QUANTITIES),
        time_unit=_one_of(fields, "time_unit", tuple(SECONDS)) if "time_unit" in fields else None,
    )


def _noise(fields: Fields) -> NoiseLaw:
    """Law of the noise; older files tell only of one variance."""
    if "noise" not in fields:
        return NoiseLaw(NoiseKind.CONSTANT, float(np.sqrt(fields.number("noise_variance"))))
    inner = fields.nested("noise")
    kind = NoiseKind(_one_of(inner, "kind", tuple(one.value for one in NoiseKind)))
    return NoiseLaw(kind, inner.number("floor"), inner.number("share"))


def _findings(fields: Fields) -> tuple[Finding, ...]:
    found: list[Finding] = []
    while (key := str(len(found) + 1)) in fields:
        inner = fields.nested(key)
        cause = Cause(_one_of(inner, "cause", tuple(one.value for one in Cause)))
        found.append(Finding(cause, tuple(inner.array("values", (None,)).tolist()), inner.number("gain")))
    return tuple(found)


def _experiments(fields: Fields, n: int) -> tuple[FittedExperiment, ...]:
    found: list[FittedExperiment] = []
    while str(len(found) + 1) in fields or not found:
        found.append(_experiment(fields.nested(str(len(found) + 1)), n))
    return tuple(found)


def _experiment(fields: Fields, n: int) -> FittedExperiment:
    inner = fields.nested("record")
    record = _record(inner) if "time" in inner else _response(inner)
    in_time = isinstance(record, Record)
    take = fields.array if in_time else fields.complex_array
    return FittedExperiment(
        record,
        fields.array("initial_state", (2 * n if in_time else 0,)),
        fields.complex_array("free_amplitudes", (n if in_time else 0,)),
        fields.number("offset"),
        take("predicted", (record.samples,)),
        fields.number("drift") if "drift" in fields else 0.0,
        _samples(fields, record.samples) if "outliers" in fields else (),
    )


def _samples(fields: Fields, count: int) -> tuple[int, ...]:
    found = _whole(fields.array("outliers", (None,)), "outliers")
    if (found >= count).any():
        raise StructureError(f"outliers name sample {int(found.max())}; the samples are 0 to {count - 1}")
    return tuple(found.tolist())


def _record(fields: Fields) -> Record:
    time = fields.array("time", (None,))
    return Record(
        time,
        fields.number("dt"),
        fields.array("input", (len(time),)),
        fields.array("output", (len(time),), finite=False),
        fields.text("input_label"),
        fields.text("output_label"),
        fields.flag("driven"),
        time_unit=_unit(fields),
    )


def _response(fields: Fields) -> FrequencyRecord:
    omega = fields.array("omega", (None,))
    return FrequencyRecord(
        omega,
        fields.complex_array("response", (len(omega),), finite=False),
        fields.array("weights", (len(omega),)),
        fields.text("input_label"),
        fields.text("output_label"),
        fields.text("title"),
        _unit(fields),
    )


def _unit(fields: Fields) -> str | None:
    """Unit of time of a record; older files tell none."""
    return _one_of(fields, "time_unit", tuple(SECONDS)) if "time_unit" in fields else None


def _information(fields: Fields) -> Information:
    names = tuple(fields.texts("names"))
    size = len(names)
    return Information(
        names,
        fields.array("lengths", (size,)),
        fields.array("singular_values", (size,)),
        fields.array("vectors", (size, size)),
        fields.number("tolerance"),
    )


def _starts(fields: Fields) -> tuple[Start, ...]:
    kinds = fields.texts("kind")
    loss = fields.array("loss", (len(kinds),))
    orders = _whole(fields.array("order", (len(kinds),)), "order")
    d = np.split(fields.array("d", (int(orders.sum()),)), np.cumsum(orders)[:-1])
    return tuple(Start(*one) for one in zip(kinds, loss.tolist(), d, strict=True)) if kinds else ()


def _order_table(fields: Fields) -> tuple[OrderRow, ...]:
    orders = _whole(fields.array("order", (None,)), "order")
    loss, aic, bic = (fields.array(name, (len(orders),)) for name in ("loss", "aic", "bic"))
    d = np.split(fields.array("d", (int(orders.sum()),)), np.cumsum(orders)[:-1])
    return tuple(
        OrderRow(*row) for row in zip(orders.tolist(), loss.tolist(), aic.tolist(), bic.tolist(), d, strict=True)
    )


def _modes(fields: Fields, name: str, n: int) -> tuple[int, ...]:
    found = _whole(fields.array(name, (None,)), name)
    if (found >= n).any():
        raise StructureError(f"{name} names mode {int(found.max())}; the modes are 0 to {n - 1}")
    return tuple(found.tolist())


def _whole(values: NDArray[np.float64], name: str) -> NDArray[np.intp]:
    if (values != np.rint(values)).any() or (values < 0).any():
        raise StructureError(f"{name} does not hold whole numbers >= 0")
    return values.astype(np.intp)


def _one_of(fields: Fields, name: str, allowed: tuple[str, ...]) -> str:
    found = fields.text(name)
    if found not in allowed:
        raise StructureError(f"{name} is {found!r}; it must be one of {', '.join(map(repr, allowed))}")
    return found


CODEC = Codec(PEMResult, _to_dict, _from_dict)
