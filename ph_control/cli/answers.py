"""Answers for machines: strict JSON with numbers in full."""

from __future__ import annotations

import json
import math
from typing import Any

from .outcome import emit


def strict(value: Any, indent: int | None = 2) -> str:
    """JSON of arrays, tuples and complex numbers (`[re, im]`); null where a number is not finite."""
    from ..io.json_format import plain

    return json.dumps(plain(value, lambda number: None), indent=indent, allow_nan=False) + "\n"


def emit_json(answer: dict[str, Any]) -> None:
    """Print an answer."""
    emit(strict(answer))


def modes_of(form: Any) -> dict[str, Any]:
    """Fields of a modal form."""
    return {
        "d": form.d,
        "frequency": form.d / (2 * math.pi),
        "r": form.r,
        "kappa": form.kappa,
        "kappa_0": form.kappa_0 if len(form.rigid) else 0.0,
    }


def fit_of(result: Any) -> dict[str, Any]:
    """Fields of the result of a fit."""
    from ..identification.fit.report import residue_errors

    return {
        "verdict": result.verdict,
        "described": is_described(result),
        "message": result.message,
        "order": result.order,
        "fit_percent": result.fit_percent,
        "findings": [
            {"cause": one.cause.value, "values": list(one.values), "gain": one.gain} for one in result.findings
        ],
        "time_unit": result.time_unit,
        "hertz": None if result.time_unit is None else result.hertz,
        **modes_of(result.modes),
        "stderr": {**result.stderr, "kappa": residue_errors(result)},
        "noise_std": result.noise.floor,
        "loss": result.loss,
        "loglik": result.loglik,
        "aic": result.aic,
        "bic": result.bic,
        "whiteness": result.whiteness,
        "active": result.active,
        "unseen": result.unseen,
        "rank_deficiency": result.rank_deficiency,
        "success": result.success,
        "iterations": result.n_iterations,
        "method": result.method,
        "intersample": result.intersample,
        "quantity": result.quantity,
        "representation": result.representation,
        "tests": [dict(vars(one)) for one in result.tests],
        "damped": None if result.damped is None else _damped_of(result.damped),
        "experiments": [_experiment_of(one) for one in result.experiments],
        "order_table": [
            {"order": row.order, "loss": row.loss, "aic": row.aic, "bic": row.bic, "d": row.d}
            for row in result.order_table
        ],
    }


def _damped_of(model: Any) -> dict[str, Any]:
    return {
        "order": model.order,
        "fit_percent": model.fit_percent,
        "natural_frequencies": model.natural_frequencies,
        "hertz": None if model.time_unit is None else model.hertz,
        "damping_ratios": model.damping_ratios,
        "residues": model.residues,
        "feedthrough": model.feedthrough,
        "stderr": dict(model.stderr),
        "noise_std": math.sqrt(model.noise_variance),
        "loss": model.loss,
        "loglik": model.loglik,
        "damped": model.damped.tolist(),
        "negative": model.negative.tolist(),
    }


def _experiment_of(one: Any) -> dict[str, Any]:
    record = one.record
    return {
        "title": record.title,
        "input": record.input_label,
        "output": record.output_label,
        "samples": record.samples,
        "missing": int((~record.observed).sum()),
        "step": getattr(record, "dt", None),
        "fit_percent": one.fit_percent,
        "initial_state": one.initial_state,
        "offset": one.offset,
        "drift": one.drift,
    }


def is_described(result: Any) -> bool:
    """Whether the verdict leaves a model standing."""
    return bool(result.order) and result.outcome.leaves_a_model
