"""Coloured noise as an autoregression, by which residuals are made white, and noise of an input beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from scipy.optimize import minimize_scalar

from ..._checks import EPS
from ..._types import Array, ComplexArray, RealOrComplex
from ..regression.modal_regressors import SampledModes
from ..regression.tuning import TUNING

_FORGOTTEN = 0.8, 0.9, 0.95, 0.98  # of the past of noise that wanders, after a sample, by a predictor
_TRUNCATED = 0.05  # of it, beyond which a filter ends
_RATIOS = np.geomspace(1e-4, 1e4, 9)  # of input noise, seen at the median of the bins, to output noise


def correlations(
    residuals: Sequence[ComplexArray], lengths: Sequence[int], most: int = TUNING.past_of_noise
) -> Array:  # fmt: skip
    """Sums of products of residuals, given by their transforms, with those 0, 1, ..., at `most` samples before."""
    most = max(0, min(most, min(lengths) // 4))
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


def wandering(products: Array, shortest: int) -> Iterator[tuple[Array, float]]:
    """Innovations filters of noise that wanders beside white noise, and what they leave relative to the residuals.

    Of `(1 - c / z) / (1 - a / z)` for some `c`, with the best `a`, as many samples as there are products; none whose
    past is longer than that, or which is slower than the `shortest` record.
    """
    most = len(products) - 1
    if most < 2 or products[0] <= 0:
        return
    slowest = float(np.exp(-2 * np.pi / shortest))
    for c in _FORGOTTEN:
        length = min(most, int(np.log(_TRUNCATED) / np.log(c)))
        g = np.asarray(c ** np.arange(length + 1), float)
        h = np.concatenate([np.zeros(1), g[:-1]])
        # squares of what `g - a h` leaves
        squares, crossed, shifted = (_filtered_products(products, x, y) for x, y in ((g, g), (g, h), (h, h)))
        a = min(crossed / shifted, slowest)
        if a > c:
            yield g - a * h, float((squares - 2 * a * crossed + a**2 * shifted) / products[0])


def _filtered_products(products: Array, x: Array, y: Array) -> float:
    """Sum of products of residuals through two filters."""
    lags = np.abs(np.arange(1 - len(x), len(x)))
    return float(np.correlate(x, y, "full") @ products[lags])


def foretold(products: Array) -> tuple[list[Array], Array]:
    """The coefficients of autoregressions of each order, and their variances relative to that of the residuals.

    By Levinson's and Durbin's recursion.
    """
    phi, variance = np.zeros(0), 1.0
    models, variances = [phi], [variance]
    if products[0] <= 0:
        return models, np.ones(1)
    r = products / products[0]
    for order in range(1, len(r)):
        reflection = (r[order] - phi @ r[order - 1 : 0 : -1]) / variance
        phi = np.append(phi - reflection * phi[::-1], reflection)
        variance *= 1 - reflection**2
        if not variance > 0:
            break
        models.append(phi)
        variances.append(variance)
    return models, np.array(variances)


def _oscillates(phi: Array, samples: int) -> bool:
    """Whether an autoregression has a peak as narrow as that of a mode in so many samples."""
    poles = np.roots(np.concatenate([[1.0], -phi]))
    radius = np.abs(poles[poles.imag > 0])
    return bool(np.any(radius > np.exp(-2 * np.pi / samples * TUNING.ringing_noise)))


def likeliest_ratio(unlikely: Callable[[float], float], gains: Array) -> tuple[float, float]:
    """The ratio of input to output noise of least negative log-likelihood, 0 where none is likelier, and this."""
    ratios = _RATIOS / float(np.median(gains))
    none, tried = unlikely(0.0), [unlikely(ratio) for ratio in ratios]
    best = int(np.argmin(tried))
    if tried[best] >= none:
        return 0.0, none
    ends = np.log(ratios[[max(0, best - 1), min(len(ratios) - 1, best + 1)]])
    minimum = minimize_scalar(lambda x: unlikely(np.exp(x)), bounds=ends, method="bounded", options={"xatol": 0.05})
    return float(np.exp(minimum.x)), float(minimum.fun)


def sampled_response(step: SampledModes, residues: RealOrComplex, through: float, phase: Array) -> ComplexArray:
    """Frequency response from sample to sample of modes with residues (n,), at some phases per step."""
    z, response = np.exp(1j * phase), np.full(len(phase), through, complex)
    for w, lam, b0, b1 in zip(residues, step.multiplier, step.b0, step.b1, strict=True):
        gain, mirrored = w * (b0 + b1 * z), np.conj(w) * (np.conj(b0) + np.conj(b1) * z)
        ahead = np.where(z == lam, EPS, z - lam)
        response += gain / ahead + mirrored / (z - np.conj(lam))
    return response
