"""What shapes a record beside the modes: when the input arrives, a constant or a drift of the sensor, coloured noise.

Left out of a model, each of these looks like modes that are not there.  A search therefore asks the likelihood which
of two explains more: one more mode, or a circumstance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from ..._checks import EPS
from ..._display import p_value, to_its_error
from ..._types import Array, ComplexArray, NDArray
from ..._units import hertz_size
from ..regression.modal_regressors import SampledModes
from ..regression.tuning import TUNING

_LISTED = 6  # values named one by one
_RATIOS = np.geomspace(1e-4, 1e4, 9)  # of input noise, seen at the median of the bins, to output noise


HOLDS = ("zoh", "foh")


class Cause(Enum):
    """What the data show beside lossless modes."""

    CONSTANT = "constant in the output"
    DRIFT = "drift of the output"
    HOLD = "hold of the input"
    DELAY = "delay of the input"
    COLOURED_NOISE = "coloured noise"
    INPUT_NOISE = "noise on the input"
    GAIN_NOISE = "noise that grows with the gain"
    LOSSES = "losses, or residues that no lossless model has"
    COMPLEX_SHAPES = "damping or sensors that classical damping does not explain"
    ACTIVITY = "energy that no passive model gives"
    SEVERAL_SHAPES = "residues of more than one shape"
    ONE_WAY = "responses that are not reciprocal"
    COLOURED_RESIDUALS = "residuals that are coloured"
    OUTLIERS = "values far out of the noise"
    SATURATION = "an output that stays at an end of its range"
    WILD_LINES = "lines of a response far out of all others"
    POLARITY = "a sensor that points against the force"
    HAMMER_NOISE = "noise of a hammer's force between its contacts"
    LARGEST_ORDER = "as many modes as the search may find"
    FEWER_MODES = "fewer modes than the order that was given"


REJECTED = {
    "lossless": Cause.LOSSES, "classical": Cause.COMPLEX_SHAPES, "passive": Cause.ACTIVITY,
    "rank one": Cause.SEVERAL_SHAPES, "reciprocal": Cause.ONE_WAY,
}  # fmt: skip  # what the data show where they reject a hypothesis


@dataclass(frozen=True)
class Finding:
    """A circumstance of the record, its size, and what it gains.

    Attributes
    ----------
    cause : Cause
        What it is.
    values : tuple of float
        Of a constant its value in each record; of a drift its change per unit time in each; of a delay the samples by
        which the output lags, or, where the model has it, the time and its standard error;
        of coloured noise the coefficients `phi` of `e_k = sum phi_j e_(k-j) + white`; of noise
        on the input its size over that of the input, and the standard deviation of the white noise beside it; of noise
        that grows with the gain its standard deviation over the gain, of each entry row by row; of a hold
        0 for an input that was held, 1 for a linear one; of a hypothesis that is rejected its p-value and degrees of
        freedom; of a real pole its rate, and the share that it explains of what the modes leave; of coloured residuals
        the ends of the band about the peak of their spectrum, rad per unit time, the density there over its geometric
        mean, and the share of their power; of outliers their places, counted from 0; of an output that
        stays at an end of its range how many samples do, and that end or both; of the noise of a hammer's force its
        standard deviation, and the peak of the force; of wild lines their frequencies, rad per unit time; of the
        largest order that order; of fewer modes the order that was given, and how many reproduce the data.
    gain : float
        How much the log-likelihood grows by it; of a hold, over the other one; 0 of outliers and ends of the range.
    output : str
        The output that shows it, of several channels; of a response with its input.
    experiment : int
        Which of several experiments has these outliers, or that range, counted from 0.
    """

    cause: Cause
    values: tuple[float, ...]
    gain: float
    output: str = ""
    experiment: int = 0


def beside_one_another(delay: int) -> tuple[slice, slice]:
    """Inputs and the outputs that come so many samples after them, or before."""
    early, late = slice(None, -abs(delay)), slice(abs(delay), None)
    return (early, late) if delay > 0 else (late, early)


# --- noise -----------------------------------------------------------------------------------------------------------


def correlations(residuals: Sequence[ComplexArray], lengths: Sequence[int]) -> Array:
    """Sums of products of residuals, given by their transforms, with those 0, 1, ... samples before."""
    most = max(0, min(TUNING.past_of_noise, min(lengths) // 4))
    products = np.zeros(most + 1)
    for residual, length in zip(residuals, lengths, strict=True):
        products += np.fft.irfft(np.abs(residual) ** 2, length)[: most + 1]
    return products


def autoregression(products: Array, shortest: int) -> tuple[list[Array], Array]:
    """Autoregressions of order 0, 1, ... that foretell residuals with these correlations, and what they leave.

    One that oscillates nearly as long as the `shortest` record is no noise but a mode that is missing, and foretells
    nothing.
    """
    models, variances = foretold(products)
    for order, phi in enumerate(models):
        if order and _oscillates(phi, shortest):
            variances[order] = variances[order - 1]
    return models, variances


def foretold(products: Array) -> tuple[list[Array], Array]:
    """The coefficients of autoregressions of each order, and their variances relative to that of the residuals.

    By Levinson's and Durbin's recursion.
    """
    phi, left = np.zeros(0), 1.0
    models, variances = [phi], [left]
    if products[0] <= 0:
        return models, np.ones(1)
    r = products / products[0]
    for order in range(1, len(r)):
        reflection = (r[order] - phi @ r[order - 1 : 0 : -1]) / left
        phi = np.append(phi - reflection * phi[::-1], reflection)
        left *= 1 - reflection**2
        if not left > 0:
            break
        models.append(phi)
        variances.append(left)
    return models, np.array(variances)


def _oscillates(phi: Array, samples: int) -> bool:
    """Whether an autoregression has a peak as narrow as that of a mode in so many samples."""
    poles = np.roots(np.concatenate([[1.0], -phi]))
    radius = np.abs(poles[poles.imag > 0])
    return bool(np.any(radius > np.exp(-2 * np.pi / samples * TUNING.broad_noise)))


def likeliest_ratio(unlikely: Callable[[float], float], gains: Array) -> tuple[float, float]:
    """The ratio of input to output noise of least negative log-likelihood, 0 where none is likelier, and that."""
    ratios = _RATIOS / float(np.median(gains))
    none, tried = unlikely(0.0), [unlikely(ratio) for ratio in ratios]
    best = int(np.argmin(tried))
    if tried[best] >= none:
        return 0.0, none
    ends = np.log(ratios[[max(0, best - 1), min(len(ratios) - 1, best + 1)]])
    found = minimize_scalar(lambda x: unlikely(np.exp(x)), bounds=ends, method="bounded", options={"xatol": 0.05})
    return float(np.exp(found.x)), float(found.fun)


def sampled_response(step: SampledModes, residues: NDArray[Any], through: float, phase: Array) -> ComplexArray:
    """Frequency response from sample to sample of modes with residues (n,), at some phases per step."""
    z, found = np.exp(1j * phase), np.full(len(phase), through, complex)
    for w, lam, b0, b1 in zip(residues, step.multiplier, step.b0, step.b1, strict=True):
        gain, mirrored = w * (b0 + b1 * z), np.conj(w) * (np.conj(b0) + np.conj(b1) * z)
        ahead = np.where(z == lam, EPS, z - lam)
        found += gain / ahead + mirrored / (z - np.conj(lam))
    return found


# --- in words --------------------------------------------------------------------------------------------------------


def sentence_of(finding: Finding, intersample: str, time_unit: str | None = None, removed: bool = False) -> str:
    """What a finding says, and what to do about it; frequencies in Hz where the unit of time is known.

    A delay is `removed` by the model, or left in the data.
    """
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
        return f"The input between samples was {between} ({certain} over the other)."
    if finding.cause is Cause.DELAY and removed:
        late, error = values
        which = repr(finding.output) if finding.output else "The output"
        unit = f" {time_unit}" if time_unit else " units of time"
        amount = f"{to_its_error(abs(late), error)}{unit}" + f" (+- {to_its_error(error, error)})" * (error > 0)
        return (
            f"{which} comes {amount} {'later' if late > 0 else 'earlier'} than the response to the input ({certain}); "
            "the delay is in predictions, and not in system."
        )
    if finding.cause is Cause.DELAY:
        samples = int(values[0])
        which, remedy = ("later", f"u[:-{samples}], y[{samples}:]") if samples > 0 else (
            "earlier", f"u[{-samples}:], y[:{samples}]"
        )  # fmt: skip
        return (
            f"The output comes {abs(samples)} sample{'s' * (abs(samples) != 1)} {which} than the response to the input "
            f"({certain}): the recording has a delay; fit {remedy}."
        )
    if finding.cause in REJECTED.values():
        hypothesis = next(name for name, cause in REJECTED.items() if cause is finding.cause)
        return f"The data show {finding.cause.value}: they reject {hypothesis!r} ({p_value(values[0])})."
    if finding.cause is Cause.POLARITY:
        return (
            f"The residues of {finding.output!r} at its driving point oppose the force in all modes: check the "
            "polarity of the sensor, or whether it is where the force acts."
        )
    if finding.cause is Cause.GAIN_NOISE:
        sizes = dict.fromkeys(f"{100 * one:.2g} %" for one in (min(values), max(values)))
        return (
            f"The noise grows with the gain, by {' to '.join(sizes)} of it ({certain}): each "
            "point is weighted by this estimate."
        )
    if finding.cause is Cause.COLOURED_NOISE:
        return (
            f"The noise is coloured ({certain}): an autoregression with the coefficient{'s' * (len(values) != 1)} "
            f"{shown} describes it. Standard errors assume white noise."
        )
    if finding.cause is Cause.COLOURED_RESIDUALS:
        low, high, size, share = values
        if time_unit:
            low, high = (one / hertz_size(time_unit) for one in (low, high))
        unit = "Hz" if time_unit else "rad per unit time"
        return (
            f"The residuals of {finding.output!r} are coloured ({certain}): {100 * share:.0f} % of their power lies "
            f"between {low:.4g} and {high:.4g} {unit}, at {size:.3g} times the mean density (geometric)."
        )
    if finding.cause is Cause.HAMMER_NOISE:
        noise, peak = values
        return (
            f"Outside the contacts of the hammer the force was set to 0: noise of {noise:.2g} beside a peak of "
            f"{peak:.3g}, as a force, would explain the outputs less well."
        )
    if finding.cause is Cause.SATURATION:
        where = f" in experiment {finding.experiment + 1}" * bool(finding.experiment)
        ends = " or ".join(f"{one:.6g}" for one in values[1:])
        return (
            f"{finding.output!r}{where} stays at {ends} for {values[0]:.0f} samples, the end of its range: a sensor or "
            "amplifier that saturates. Mark these samples with NaN, or repeat the test with less gain or force."
        )
    if finding.cause is Cause.WILD_LINES:
        where = f" of experiment {finding.experiment + 1}" * bool(finding.experiment)
        size = hertz_size(time_unit) if time_unit else 1.0
        listed = ", ".join(f"{one / size:.6g}" for one in values[:_LISTED]) + ", ..." * (len(values) > _LISTED)
        return (
            f"The response{where} was left out at {listed} {'Hz' if time_unit else 'rad per unit time'}: values there "
            "do not go with the modes that explain all others, as where an integrated signal is divided by a frequency "
            "of 0. Mark them with NaN."
        )
    if finding.cause is Cause.LARGEST_ORDER:
        return f"The search ended at max_order={values[0]:.0f}: there may be more modes; give a larger max_order."
    if finding.cause is Cause.FEWER_MODES:
        return (
            f"Of the {values[0]:.0f} modes of the order that was given {values[1]:.0f} reproduce the data to rounding; "
            "of others nothing is seen."
        )
    if finding.cause is Cause.OUTLIERS:
        which = f"Values of {finding.output!r}" + f" in experiment {finding.experiment + 1}" * bool(finding.experiment)
        return far_out(which, [str(int(one)) for one in values])
    if finding.output:
        return (
            f"The residuals of {finding.output!r} grow with the response, as with {100 * values[0]:.2g} % more input "
            f"({certain}): unmeasured forces, or noise on the recorded input, which makes residues "
            f"smaller, by {100 * values[0] ** 2 / (1 + values[0] ** 2):.2g} % for white inputs."
        )
    return (
        f"The recorded input has noise of about {100 * values[0]:.2g} % of its size ({certain}) that did not act on "
        "the plant: record the input with less noise, or pass the commanded input."
    )


def far_out(which: str, places: Sequence[str]) -> str:
    """That some values stand out of the noise, and what to do about it."""
    listed = ", ".join(places[:_LISTED]) + f" and {len(places) - _LISTED} more" * (len(places) > _LISTED)
    return (
        f"{which} far outside the noise (counted from 0): {listed}. If they are measurement errors, mark them with NaN."
    )
