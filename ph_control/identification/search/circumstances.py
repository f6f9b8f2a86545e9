"""What shapes a record beside the modes: when the input arrives, a constant or a drift of the sensor, coloured noise.

Left out of a model, each of these looks like modes that are not there.  A search therefore asks the likelihood which
of two explains more: one more mode, or a circumstance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from ...modal.modal_form import imaginary
from ..regression.modal_regressors import output_weight
from ..regression.time_rows import Experiment
from ..regression.variable_projection import Problem, Projection

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_MOST = 4  # past samples of coloured noise: few, so that no mode passes for noise
_RATIOS = np.geomspace(1e-4, 1e4, 33)  # of input noise, seen at the median of the bins, to output noise


HOLDS = ("zoh", "foh")


class Cause(Enum):
    """What the data show beside lossless modes."""

    CONSTANT = "constant in the output"
    DRIFT = "drift of the output"
    HOLD = "hold of the input"
    DELAY = "delay of the input"
    COLOURED_NOISE = "coloured noise"
    INPUT_NOISE = "noise on the input"


@dataclass(frozen=True)
class Finding:
    """A circumstance of the record, its size, and what it gains.

    Attributes
    ----------
    cause : Cause
        What it is.
    values : tuple of float
        Of a constant its value in each record; of a drift its change per unit time in each; of a delay the samples by
        which the output lags; of coloured noise the coefficients `phi` of `e_k = sum phi_j e_(k-j) + white`; of noise
        on the input its standard deviation over that of the input; of a hold 0 for an input that was held, 1 for a
        linear one.
    gain : float
        How much the log-likelihood grows by it; of a hold, over the other one.
    """

    cause: Cause
    values: tuple[float, ...]
    gain: float


# --- problems that differ in a circumstance --------------------------------------------------------------------------


def changed(problem: Problem, change: Callable[[Experiment], Experiment]) -> Problem:
    """The problem with each record changed; frequency responses stay."""
    rows = tuple(change(one) if isinstance(one, Experiment) else one for one in problem.experiments)
    return replace(problem, experiments=rows)


def beside(problem: Problem, terms: int) -> Problem:
    """With a constant (1), or a constant and a drift (2), in every output."""
    return changed(problem, lambda one: replace(one, offset=terms))


def meeting(problem: Problem, intersample: str) -> Problem:
    """With another behaviour of the input between samples."""
    return changed(problem, lambda one: replace(one, hold=replace(one.hold, intersample=intersample)))


def delayed(problem: Problem, samples: int) -> Problem:
    """With outputs that come so many samples after the inputs; those without an input of their own are left out."""

    def shifted(one: Experiment) -> Experiment:
        if not one.driven or not samples:
            return one
        early, late = slice(None, -abs(samples)), slice(abs(samples), None)
        u, y = (early, late) if samples > 0 else (late, early)
        return replace(one, u=one.u[u], y=one.y[y], observed=one.observed[y], from_rest=one.from_rest and samples > 0)

    return changed(problem, shifted)


# --- noise -----------------------------------------------------------------------------------------------------------


def autoregression(residuals: Sequence[ComplexArray], lengths: Sequence[int]) -> tuple[list[Array], Array]:
    """Autoregressions of order 0, 1, ... that foretell residuals, given by their transforms, and what these leave.

    The coefficients of each order, and its variance relative to that of the residuals (Levinson and Durbin).
    """
    most = max(0, min(_MOST, min(lengths) // 4))
    products = np.zeros(most + 1)
    for residual, length in zip(residuals, lengths, strict=True):
        products += np.fft.irfft(np.abs(residual) ** 2, length)[: most + 1]
    phi, left = np.zeros(0), 1.0
    models, variances = [phi], [left]
    if products[0] <= 0:
        return models, np.ones(1)
    r = products / products[0]
    for order in range(1, most + 1):
        reflection = (r[order] - phi @ r[order - 1 : 0 : -1]) / left
        phi = np.append(phi - reflection * phi[::-1], reflection)
        left *= 1 - reflection**2
        if not left > 0:
            break
        models.append(phi)
        variances.append(left)
    return models, np.array(variances)


def input_noise(at: Projection) -> tuple[float, float]:
    """Standard deviation of noise on the input that would explain the residual, and the gain in log-likelihood.

    Such noise comes out of the plant: its power in each bin goes with the squared gain of the model there (Whittle).
    """
    powers, gains = [], []
    for one, predicted in zip(at.problem.experiments, at.predicted(), strict=True):
        if not (isinstance(one, Experiment) and one.driven and one.complete):
            continue
        length = len(one.u)
        bins = np.arange(1, (length + 1) // 2)
        powers.append(np.abs(np.fft.rfft(one.y - predicted)[bins]) ** 2 / length)
        gains.append(np.abs(_response(one, at.d, at.kappa, 2 * np.pi * bins / length)) ** 2)
    if not powers:
        return 0.0, 0.0
    power, gain = np.concatenate(powers), np.concatenate(gains)
    middle = float(np.median(gain))
    if not (middle > 0 and np.all(power > 0)):
        return 0.0, 0.0

    def level(ratio: float) -> float:
        return float(np.mean(power / (1 + ratio * gain)))

    def unlikely(ratio: float) -> float:
        return float(np.sum(np.log1p(ratio * gain)) + len(power) * np.log(level(ratio)))

    tried = np.array([unlikely(ratio / middle) for ratio in _RATIOS])
    best = int(np.argmin(tried))
    ends = np.log(_RATIOS[[max(0, best - 1), min(len(_RATIOS) - 1, best + 1)]] / middle)
    ratio = float(np.exp(minimize_scalar(lambda x: unlikely(np.exp(x)), bounds=ends, method="bounded").x))
    return float(np.sqrt(ratio * level(ratio))), unlikely(0.0) - unlikely(ratio)


def _response(one: Experiment, d: Array, kappa: Array, phase: Array) -> ComplexArray:
    """Frequency response from sample to sample at some phases per step."""
    step, z = one.hold.step(imaginary(-d)), np.exp(1j * phase)
    weight = kappa * output_weight(d, one.quantity)[0]
    found = np.full(len(phase), kappa.sum() if one.quantity == "acceleration" else 0.0, complex)
    for w, lam, b0, b1 in zip(weight, step.multiplier, step.b0[:, 0], step.b1[:, 0], strict=True):
        gain, mirrored = w * (b0 + b1 * z), np.conj(w) * (np.conj(b0) + np.conj(b1) * z)
        found += 0.5 * (gain / (z - lam) + mirrored / (z - np.conj(lam)))
    return found


# --- in words --------------------------------------------------------------------------------------------------------


def is_contrary(finding: Finding, intersample: str) -> bool:
    """Whether the fit is not one under this circumstance."""
    held = finding.cause is Cause.HOLD and HOLDS[int(finding.values[0])] != intersample
    return held or finding.cause is Cause.DELAY


def worth_telling(finding: Finding, intersample: str) -> bool:
    """Whether a finding is news: not that an input was held, as by default."""
    default = finding.cause is Cause.HOLD and finding.gain >= SURE and HOLDS[int(finding.values[0])] == "zoh"
    return not (default and intersample == "zoh")


def sentence_of(finding: Finding, intersample: str) -> str:
    """What a finding says, and what to do about it."""
    values, certain = finding.values, f"log-likelihood + {finding.gain:.3g}"
    shown = ", ".join(f"{value:.3g}" for value in values[:4]) + ", ..." * (len(values) > 4)
    if finding.cause is Cause.CONSTANT:
        return f"The output has a constant of {shown} beside the modes ({certain}), estimated along with them."
    if finding.cause is Cause.DRIFT:
        return f"The output drifts by {shown} per unit time ({certain}), estimated along with the modes."
    if finding.cause is Cause.HOLD:
        preferred = HOLDS[int(values[0])]
        between = "held" if preferred == "zoh" else "linear"
        if preferred != intersample:
            return f"The data show an input that was {between} between samples ({certain}): intersample={preferred!r}."
        if finding.gain < SURE:
            return f"These data cannot tell an input held between samples from a linear one; it was taken as {between}."
        return f"The input between samples was {between} ({certain} over the other)."
    if finding.cause is Cause.DELAY:
        samples = int(values[0])
        which, remedy = ("after", f"u[:-{samples}], y[{samples}:]") if samples > 0 else (
            "before", f"u[{-samples}:], y[:{samples}]"
        )  # fmt: skip
        return (
            f"The output comes {abs(samples)} sample{'s' * (abs(samples) != 1)} {which} what the input would cause "
            f"({certain}): a delay of the recording; fit {remedy}."
        )
    if finding.cause is Cause.COLOURED_NOISE:
        return (
            f"The noise is coloured ({certain}): an autoregression with the coefficient{'s' * (len(values) != 1)} "
            f"{shown} describes it. Standard errors take it as white."
        )
    return (
        f"The input as recorded has noise of about {100 * values[0]:.2g} % of its size ({certain}), which the plant "
        "did not feel: record the input with less noise, or command it."
    )


SURE = 3.0  # log-likelihood by which one hold is told from the other
