"""Results in files of versions before 0.3, in which lossless fits of one input and one output were of another class."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ...exceptions import StructureError
from ...io.codecs import system_from_dict
from ...io.json_format import Fields
from ..diagnosis.verdict import Outcome
from ..structure.layout import POWERS, residue_of_unit_weight
from .pem_result import PEMResult

_OUTCOMES = {
    "NOT described by a collocated lossless model": Outcome.NOT_DESCRIBED,
    "NOT a model: it does not respond to the input": Outcome.NOT_DESCRIBED,
}


def lossless_from_dict(fields: Fields, experiments: Callable[..., Any], order_table: Callable[..., Any]) -> PEMResult:
    """Read a lossless result; `experiments` and `order_table` read these parts."""
    system = system_from_dict(fields.nested("system"))
    seen = np.setdiff1d(np.arange(system.n), fields.array("unseen", (None,)).astype(int))
    d, r, quantity = system.d[seen], system.r[seen], fields.text("quantity")
    if quantity not in POWERS:
        raise StructureError(f"quantity is {quantity!r}; it must be one of {', '.join(map(repr, POWERS))}")
    n, power, data = len(d), POWERS[quantity], experiments(fields, system.n)
    driven = any(getattr(one.record, "driven", True) for one in data)
    per_weight = residue_of_unit_weight(d, power)
    residues = (per_weight * r).reshape(n, 1, 1)[:, :, : int(driven)]
    places = np.concatenate([seen, system.n + seen])
    known = 2 * system.n + sum(len(one.initial_state) for one in data)
    inner = fields.array("covariance", (known, known), finite=False)[np.ix_(places, places)]
    J, l = np.zeros((4 * n + 1, 2 * n)), np.arange(n)
    J[l, l] = 1.0
    for row, part in ((2 * n, per_weight.real), (3 * n, per_weight.imag)):
        J[row + l, l], J[row + l, n + l] = power * part * r / d, part
    if power == 2:
        J[-1] = np.concatenate([r, d])
    missing = np.isnan(np.diag(inner))
    covariance = J @ np.where(missing[:, None] | missing, 0.0, inner) @ J.T
    lost = np.concatenate([missing[:n], np.zeros(n, bool), missing[n:], missing[n:], [power == 2 and missing.any()]])
    covariance[lost] = covariance[:, lost] = np.nan
    kept = np.arange(len(covariance)) if driven else np.arange(2 * n)
    through = np.array([[float((r * d).sum()) if power == 2 else 0.0]])[:, : int(driven)]
    verdict = fields.text("verdict")
    outcome = _OUTCOMES.get(verdict) or next((one for one in Outcome if one.value == verdict), Outcome.DOUBTFUL)
    in_frequency = np.iscomplexobj(data[0].predicted)
    root = np.sqrt(r * d)
    return PEMResult(
        structure="lossless", poles=1j * d, residues=residues, feedthrough=through,
        covariance=covariance[np.ix_(kept, kept)], shapes=(root if driven else np.ones(n))[:, None].astype(complex),
        participation=(residues[:, 0] / np.where(root > 0, root, 1.0)[:, None]), shapes_scaled=driven,
        shape_stderr=np.full((n, 1), np.nan + 0j), ports=((0, 0),) * driven, quantities=(quantity,),
        noise_variance=np.full((1, 1) if in_frequency else (1,), fields.number("noise_variance")),
        experiments=tuple(_without(one, seen) for one in data), loss=fields.number("loss"),
        loglik=fields.number("loglik"), aic=fields.number("aic"), bic=fields.number("bic"),
        fit_percent=fields.number("fit_percent"), unknowns=int(np.isfinite(np.diag(inner)).sum()) + 1,
        whiteness=fields.number("whiteness"), order_table=order_table(fields), tests=(), findings=(),
        success=fields.flag("success"), outcome=outcome, message=fields.text("message"),
        intersample=fields.text("intersample"), method=fields.text("method"),
    )  # fmt: skip


def _without(data: Any, seen: Any) -> Any:
    """Keep the motions of the modes that the data show, with the sign of the upper poles."""
    if not len(data.initial_state):
        return data
    n = len(data.initial_state) // 2
    state = data.initial_state[np.concatenate([seen, n + seen])]
    return replace(data, initial_state=state, free_amplitudes=data.free_amplitudes[seen].conj())
