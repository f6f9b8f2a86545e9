"""Results in files of earlier versions, in which lossless fits of one input and one output were of another class."""

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

_OUTCOMES = {
    "NOT described by a collocated lossless model": Outcome.NOT_DESCRIBED,
    "NOT a model: it does not respond to the input": Outcome.NOT_DESCRIBED,
}
_NOT_KEPT = (
    "active", "identifiability", "rank_deficiency", "starts", "n_iterations", "representation", "noise", "damped",
)  # fmt: skip


def lossless_parts(fields: Fields, experiments: Callable[..., Any]) -> dict[str, Any]:
    """Read what a lossless result has in another form; `experiments` reads the data."""
    system = system_from_dict(fields.nested("system"))
    fields.skip(*_NOT_KEPT)
    seen = np.setdiff1d(np.arange(system.n), fields.array("unseen", (None,)).astype(int))
    d, r, quantity = system.d[seen], system.r[seen], fields.text("quantity")
    if quantity not in POWERS:
        raise StructureError(f"quantity is {quantity!r}; it must be one of {', '.join(map(repr, POWERS))}")
    n, power, data = len(d), POWERS[quantity], experiments(fields, system.n)
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
            _without(experiment, seen, *error) for experiment, error in zip(data, errors, strict=True)
        ),
        "unknowns": int(np.isfinite(np.append(np.diag(every), offsets)).sum()) + 1,
        "outcome": _OUTCOMES.get(verdict)
        or next((outcome for outcome in Outcome if outcome.value == verdict), Outcome.DOUBTFUL),
    }


def _without(data: Any, seen: Any, initial_stderr: Any, offset_stderr: float) -> Any:
    """Keep the motions of the modes that the data show, with the sign of the upper poles, and their errors."""
    data = replace(data, offset_stderr=offset_stderr)
    if not len(data.initial_state):
        return data
    both = np.concatenate([seen, len(data.initial_state) // 2 + seen])
    return replace(
        data, initial_state=data.initial_state[both], initial_stderr=initial_stderr[both],
        free_amplitudes=data.free_amplitudes[seen].conj(),
    )  # fmt: skip
