"""What the data show beside the modes of a fit: the circumstances that its search met, and what noise there is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..data.time_record import LONG
from ..regression.prediction import FittedExperiment
from ..regression.time_rows import RecordRows
from ..regression.tuning import TUNING
from ..regression.variable_projection import Projection
from ..search.circumstances import Cause, Finding, autoregression, correlations, input_noise, input_size
from ..uncertainty.residual_tests import ljung_box

_TOLD = 10.0  # log-likelihood by which noise of a kind has to explain more than white noise

NOISE = (Cause.COLOURED_NOISE, Cause.INPUT_NOISE)  # with which residuals that are not white are no reason for doubt


def circumstances_of(
    met: Sequence[Finding], at: Projection, experiments: Sequence[FittedExperiment], whiteness: float
) -> tuple[Finding, ...]:
    """Findings of a fit, with the sizes of constants and drifts; `met` are those of the search."""
    found = [replace(one, values=_sizes(one, experiments)) for one in met]
    if whiteness < TUNING.white and len(at.d) and not any(one.cause is Cause.DELAY for one in met):
        found += _noise(at, experiments)
    return tuple(found)


def _sizes(finding: Finding, experiments: Sequence[FittedExperiment]) -> tuple[float, ...]:
    if finding.cause is Cause.CONSTANT:
        return tuple(one.offset for one in experiments)
    return tuple(one.drift for one in experiments) if finding.cause is Cause.DRIFT else finding.values


def _noise(at: Projection, experiments: Sequence[FittedExperiment]) -> list[Finding]:
    """Noise on the input, or coloured noise, where either explains what is left."""
    records = [one for one in at.problem.experiments if isinstance(one, RecordRows)]
    if len(records) < len(experiments) or not all(one.complete for one in records):
        return []
    # of long records a part
    records = [replace(one, u=one.u[:LONG], y=one.y[:LONG], observed=one.observed[:LONG]) for one in records]
    left = [one.left[:LONG] for one in experiments]
    lengths, transforms = [len(one) for one in left], [np.fft.rfft(one) for one in left]
    models, variances = autoregression(correlations(transforms, lengths), min(lengths))
    gains = -0.5 * sum(lengths) * np.log(variances)
    order = int(np.argmax(gains - 0.5 * np.log(sum(lengths)) * np.arange(len(gains))))
    coloured, (deviation, beside, of_input) = float(gains[order]), input_noise(records, at.d)
    if of_input > max(coloured, _TOLD):
        return [Finding(Cause.INPUT_NOISE, (deviation / input_size(records), beside), of_input)]
    if order and coloured > _TOLD:
        past = np.concatenate([[1.0], -models[order]])
        if ljung_box([np.convolve(one, past, mode="valid") for one in left], TUNING.lags) >= TUNING.white:
            return [Finding(Cause.COLOURED_NOISE, tuple(models[order].tolist()), coloured)]
    return []
