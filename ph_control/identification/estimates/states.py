"""Experiments of one input and one output without dimensions for these, with their initial states and errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..._types import Array
from ..data.channels import Recording, single
from ..data.frequency_record import FrequencyRecord
from ..regression.free_prediction import FittedChannels
from ..regression.modal_regressors import output_weight
from ..regression.prediction import FittedExperiment, state_of
from ..structure.layout import POWERS, residue_of_unit_weight, weights_of
from .fitted_structure import FittedStructure, roots


def squeezed(structure: FittedStructure, experiments: Sequence[FittedChannels]) -> tuple[FittedExperiment, ...]:
    """Experiments of one input and one output without dimensions for these, with their initial states."""
    fit, rank, quantity = structure.fit, structure.rank, structure.request.quantities[0]
    r = None
    if fit.structure == "lossless" and fit.residues.shape[2] == 1 and bool(np.all(fit.p.imag > 0)):
        r = weights_of(fit.p[rank], fit.residues[rank, 0, 0], quantity)
    shown = []
    errors = _state_errors(structure, r is not None)
    for data, error in zip(experiments, errors, strict=True):
        record = single(data.record)
        if isinstance(record, FrequencyRecord):
            nothing = np.zeros(0), np.zeros(0, complex), 0.0
            shown.append(FittedExperiment(record, *nothing, data.predicted[0, 0], background=data.background))
            continue
        motion = data.free_amplitudes[:, 0]
        # among several experiments a free motion has an input of 0
        record = replace(record, time=record.clock, driven=bool(record.u.any()))
        shown.append(FittedExperiment(
            record, state_of(fit.p[rank], motion, quantity, r), motion, float(data.offsets[0]), data.predicted[0],
            float(data.drifts[0]), initial_stderr=error, offset_stderr=float(data.offset_stderr[0]),
            noise_scale=data.noise_scale,
        ))  # fmt: skip
    return tuple(shown)


def _state_errors(structure: FittedStructure, lossless: bool) -> list[Array]:
    """Standard errors of the initial state in each experiment of one input and one output; NaN if it began at rest.

    Of lossless modes, `q + i p = conj(a) / (c d sqrt(r))` with the motion `a` and the weight `c` of the state in the
    output; else the state is the motion.
    """
    projection, fit, free, rank = structure.measured, structure.fit, structure.free, structure.rank
    n, scale, state_errors, rows = len(fit.p), float(free.scales[0]), [], 0
    size = 2 * n if lossless else int(np.sum(np.where(fit.p.imag == 0, 1, 2)))
    for data in free.channels:
        seen = bool(data.observed.any()) and isinstance(data, Recording)
        moving = seen and projection.experiments[rows].moving and n > 0
        if not moving:
            state_errors.append(np.full(size * isinstance(data, Recording), np.nan))
        elif lossless:
            state_errors.append(data.unit * _modal_state_errors(structure, rows))
        else:
            ((spread, _),) = structure.own_spreads(rows)
            each = 2 * scale * roots(np.diag(spread)[: 2 * n].reshape(2, n).T)[rank]
            state_errors.append(data.unit * each[np.stack([np.ones(n, bool), fit.p[rank].imag != 0], axis=1)])
        rows += int(data.observed.any())
    return state_errors


def _modal_state_errors(structure: FittedStructure, rows: int) -> Array:
    """Standard errors of `(q, p)` of lossless modes, in some of the rows."""
    projection, fit, quantity = structure.measured, structure.fit, structure.request.quantities[0]
    scale, ((spread, crossed),) = float(structure.free.scales[0]), structure.own_spreads(rows)
    n, power, d = len(fit.p), POWERS[quantity], np.abs(fit.p)
    own, shared = projection.own[rows][:, 0], projection.shared[:, 0]
    per_weight = residue_of_unit_weight(d, power)
    r = (scale * (shared[:n] + 1j * shared[n : 2 * n]) / per_weight).real
    shown = r > 0
    gain = 1.0 / (output_weight(d, quantity)[0] * d * np.sqrt(np.where(shown, r, 1.0)))
    motion = 2 * scale * (own[:n] - 1j * own[n : 2 * n])
    state, l, width = gain * motion, np.arange(n), 2 * n + len(shared)
    T = np.zeros((n, width + len(own)), complex)
    T[l, l] = state / d * ((0.0, -1.0, -2.0)[power] + 0.5 * power)
    T[l, 2 * n + l] = -0.5 * state / np.where(shown, r, 1.0) * scale * (1 / per_weight).real
    T[l, 3 * n + l] = -0.5 * state / np.where(shown, r, 1.0) * scale * (1j / per_weight).real
    T[l, width + l], T[l, width + n + l] = 2 * scale * gain, -2j * scale * gain
    joint = np.block([[fit.covariance, crossed.T], [crossed, spread]])
    both = np.concatenate([T.real, T.imag])
    errors = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", both, joint, both), 0.0)).reshape(2, n)
    return np.where(shown, errors, np.nan)[:, structure.rank].ravel()
