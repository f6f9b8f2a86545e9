"""Noise of responses that grows with the gain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..._types import Array, ComplexArray
from ..data.channels import ResponseMatrix
from ..growth.choosing import chosen
from ..growth.ending import finished
from ..growth.growing import cleaned
from ..regression.frequency_rows import FreeResponse
from ..regression.tuning import TUNING
from ..search.channel_rows import Experiments
from ..search.circumstances import Cause, Finding
from ..search.fitted_modes import FreeFit
from ..search.path import FreePath
from .assumptions import Search
from .response_noise import ROUNDS, SETTLED, NoiseLaw, balanced, entry_laws


def in_noise_of_the_gain(first: FreeFit, search: Search) -> FreeFit:
    """Repeat a fit with the weights of the noise of its entries, until both agree; as it was, if that is constant."""
    refits = Refits(first, search)
    laws, free = entry_laws(first.projection)
    if free and not any(law.share for law, _ in laws):
        return first
    # points of large gain, were they taken as equally sure, would draw the model through themselves
    weights, p, known = balanced([channel.response for channel in first.channels]), first.projection.p, False
    while True:
        for place in range(ROUNDS):
            before = weights
            near = refits.refined(_with_weights(first.channels, weights), p)
            laws, _ = entry_laws(near.projection)
            if not any(law.share for law, _ in laws):
                return first
            weights, p = _inverse_variances(near, [law for law, _ in laws]), near.projection.p
            pairs = zip(weights, before, strict=True)
            if place and all(np.nanmax(np.abs(new / old - 1)) <= SETTLED for new, old in pairs):
                break
        judged = refits.again(_with_weights(first.channels, weights), p, known)
        if known or judged.order == len(p):
            break
        # other modes leave other noise
        p, known = judged.projection.p, True
    finding = Finding(Cause.GAIN_NOISE, tuple(law.share for law, _ in laws), sum(gain for _, gain in laws))
    # constant noise, at the points of large gain that balanced weights leave free, may seem to grow
    more = float(np.log(judged.projection.rows)) * sum(1 for law, _ in laws if law.share)
    return replace(judged, findings=(finding,)) if weighted_bic(judged) + more < weighted_bic(first) else first


@dataclass(frozen=True)
class Refits:
    """A fit to responses, repeated in the noise of other weights."""

    fit: FreeFit
    search: Search

    def refined(self, channels: Experiments, p: ComplexArray) -> FreeFit:
        """Keep the poles but for what the weights move them by."""
        path = self._path(channels)
        path.weigh(path.model(p).losses)
        projection = path.refined(p, TUNING.rough, None)
        return replace(self.fit, projection=projection, channels=tuple(channels), scales=1.0 / path.sizes)

    def again(self, channels: Experiments, p: ComplexArray, known: bool) -> FreeFit:
        """Look for other poles as well, unless these are known."""
        path = self._path(channels)
        model = path.model(p)
        if self.search.automatic and not known:
            model = chosen(path, cleaned(path, model).p, self.search.most, True)
        return finished(path, model, channels, self.search.automatic)

    def _path(self, channels: Experiments) -> FreePath:
        path = self.search.path(channels)
        path.add_terms([rows for rows in self.fit.projection.experiments if isinstance(rows, FreeResponse)])
        return path


def weighted_bic(fit: FreeFit) -> float:
    """Return the BIC with the density of the noise where it has these weights: two real numbers at each point."""
    return fit.criteria.bic - 2 * sum(
        float(np.sum(np.log(channel.weights[channel.observed]))) for channel in fit.channels
    )


def _with_weights(channels: Sequence[ResponseMatrix], weights: Sequence[Array]) -> list[ResponseMatrix]:
    pairs = zip(channels, weights, strict=True)
    return [replace(channel, weights=np.where(channel.observed, each, 1.0)) for channel, each in pairs]


def _inverse_variances(fit: FreeFit, laws: Sequence[NoiseLaw]) -> list[Array]:
    """Return weights (p, m, K) of each experiment by the laws of its entries, in the units of the data."""
    inverse_variances, projection = [], fit.projection
    for number, channel in enumerate(fit.channels):
        weights = np.ones((len(laws), channel.samples))
        for rows, predicted in zip(projection.experiments, projection.predictions(), strict=True):
            if isinstance(rows, FreeResponse) and rows.experiment == number:
                for output, gain in zip(rows.outputs.tolist(), np.abs(predicted), strict=True):
                    variance = laws[output].floor ** 2 + (laws[output].share * gain) ** 2
                    weights[output] = 1.0 / (fit.scales[output] ** 2 * np.where(np.isnan(gain), 1.0, variance))
        inverse_variances.append(weights.reshape(channel.response.shape))
    return inverse_variances
