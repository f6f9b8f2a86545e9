"""How a result is written to a file and comes back."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._documents import Fields
from ..exceptions import StructureError
from ..files import Codec, register, system_from_dict, system_to_dict
from ..propagation import INTERSAMPLE, METHODS
from .data import Record
from .result import OrderRow, PEMResult

_NUMBERS = ("noise_variance", "loss", "loglik", "aic", "bic", "fit_percent", "whiteness")


def _to_dict(result: PEMResult) -> dict[str, Any]:
    record, table = result.record, result.order_table
    return {
        "system": system_to_dict(result.system),
        "initial_state": result.initial_state,
        "free_amplitudes": result.free_amplitudes,
        "covariance": result.covariance,
        **{name: getattr(result, name) for name in _NUMBERS},
        "active": list(result.active),
        "unseen": list(result.unseen),
        "rank_deficiency": result.rank_deficiency,
        "order_table": {
            "order": [row.order for row in table],
            "loss": [row.loss for row in table],
            "aic": [row.aic for row in table],
            "bic": [row.bic for row in table],
            "d": np.concatenate([np.zeros(0), *[row.d for row in table]]),
        },
        "success": result.success,
        "verdict": result.verdict,
        "message": result.message,
        "n_iterations": result.n_iterations,
        "method": result.method,
        "intersample": result.intersample,
        "record": {
            "time": record.time,
            "dt": record.dt,
            "input": record.u,
            "output": record.y,
            "input_label": record.input_label,
            "output_label": record.output_label,
        },
        "predicted": result.predicted,
    }


def _from_dict(fields: Fields) -> PEMResult:
    system = system_from_dict(fields.nested("system"))
    n = system.n
    record = _record(fields.nested("record"))
    predicted = fields.array("predicted", (record.samples,))
    return PEMResult(
        system=system,
        initial_state=fields.array("initial_state", (2 * n,)),
        free_amplitudes=fields.complex_array("free_amplitudes", (n,)),
        covariance=fields.array("covariance", (4 * n, 4 * n), finite=False),
        **{name: fields.number(name) for name in _NUMBERS},
        active=_modes(fields, "active", n),
        unseen=_modes(fields, "unseen", n),
        rank_deficiency=fields.integer("rank_deficiency"),
        order_table=_order_table(fields.nested("order_table")),
        success=fields.flag("success"),
        verdict=fields.text("verdict"),
        message=fields.text("message"),
        n_iterations=fields.integer("n_iterations"),
        method=_one_of(fields, "method", METHODS),
        intersample=_one_of(fields, "intersample", INTERSAMPLE),
        record=record,
        predicted=predicted,
        residuals=record.y - predicted,
    )


def _record(fields: Fields) -> Record:
    time = fields.array("time", (None,))
    return Record(
        time,
        fields.number("dt"),
        fields.array("input", (len(time),)),
        fields.array("output", (len(time),), finite=False),
        fields.text("input_label"),
        fields.text("output_label"),
    )


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


register(Codec("PEMResult", PEMResult, _to_dict, _from_dict))
