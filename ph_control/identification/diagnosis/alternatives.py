"""Searches in recordings as they would be without what disturbs them: hum, or noise of other levels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..._types import Array, ComplexArray
from ..data.channels import Channels, Recording
from ..data.time_record import is_long
from ..regression.tuning import TUNING
from ..search.findings import Cause, Finding
from ..search.fitted_modes import FreeFit
from .hum import Tones, lines_in, tones_in, undriven
from .noise_levels import changing_levels, findings_of, in_equal_noise, level_of, records_of

_REWEIGHTINGS = 16  # of rounded outputs by what is predicted of them
_UNMOVED = 3e-3  # steps of rounding: what a reweighting may move predictions by at the end
_ROUNDS = 3  # of fits and of the noise of experiments in turn
_MOST_TONES = 20  # times that more tones are looked for
_MUCH = 0.2  # of the power that is left: a line where modes may be missing
_SAME_LEVEL = 0.02  # mean difference of the logarithms of levels of noise that are the same


@dataclass(frozen=True)
class Searched:
    """Channels as they were searched, their fit, whether modes may move at first, and findings about the channels."""

    channels: Channels
    free: FreeFit
    moving: bool
    findings: tuple[Finding, ...] = ()

    @property
    def cut(self) -> Searched:
        """The same after an interruption."""
        return replace(self, free=replace(self.free, interrupted=True))

    @property
    def bic(self) -> float:
        """BIC of the fit."""
        return self.free.criteria.bic

    def charge(self, unknowns: int) -> float:
        """What the BIC charges for so many unknowns."""
        return unknowns * float(np.log(self.free.projection.rows))


Search = Callable[[Channels], Searched]
Refine = Callable[[Channels, Searched, ComplexArray], Searched]


def beside_disturbances(
    alone: Searched, search: Search, refine: Refine, automatic: bool, certain: bool = False
) -> Searched:
    """Search beside each disturbance in turn, as long as the criterion agrees; what was last where interrupted.

    Parameters
    ----------
    alone : Searched
        A search in the channels as they were measured.
    search : callable
        Makes such a search in other channels.
    refine : callable
        Fits some poles to other channels, under the circumstances of a fit.
    automatic : bool
        Whether the number of modes is left to the data.
    certain : bool
        Whether noise that outputs share is given, and not found.
    """
    latest = alone
    try:
        latest = _beside_hum(latest, search, refine, automatic)
        latest = _beside_unequal_noise(latest, search, refine, automatic)
        beside = latest.free.beside
        if beside is not None and (certain or beside.is_coloured):
            return latest
        # loud samples are few, which makes outputs look correlated
        return _beside_changing_noise(latest, search, refine)
    except KeyboardInterrupt:
        return latest.cut


def within_rounding(latest: Searched, refine: Refine) -> Searched:
    """The fit by the likelihood of outputs that were rounded to steps larger than their noise.

    That of half a step is the same error in many successive samples, and not another in each.
    """
    free, rounded = latest.free, latest.free.projection.within_rounding
    other = free.exact or free.noise or free.beside is not None or free.interrupted
    if other or not rounded.any() or is_long(latest.channels):
        return latest
    again, predicted = latest, _predicted(latest)
    for _ in range(_REWEIGHTINGS):
        again = refine(tuple(data.before_rounding(outputs, rounded) for data, outputs in predicted), latest,
                       again.free.projection.p)  # fmt: skip
        if again.free.interrupted:
            return latest.cut
        before, predicted = predicted, _predicted(again)
        if all(_agree(data, now, then) for (data, now), (_, then) in zip(predicted, before, strict=True)):
            break
    named = [
        Finding(Cause.ROUNDED, (float(data.steps[k] * data.unit), float(_values(data.original.y[k]))), 0.0, name, e)
        for e, (data, _) in enumerate(predicted) for k, name in enumerate(data.output_labels)
        if rounded[k] and data.steps[k]
    ]  # fmt: skip
    free = replace(again.free, rounding=True, order_table=free.order_table)
    return replace(again, free=free, findings=(*latest.findings, *named))


def _agree(data: Recording, now: Array, then: Array) -> bool:
    """Whether two predictions of the outputs of a recording differ by a small part of the steps that these have."""
    known = data.steps > 0
    moved = np.abs(now - then)[known] / (data.unit * data.steps[known])[:, None]
    return bool(np.nanmax(moved, initial=0.0) < _UNMOVED)


def _values(y: Array) -> int:
    """Number of different values of an output."""
    return len(np.unique(y[np.isfinite(y)]))


def _predicted(latest: Searched) -> list[tuple[Recording, Array]]:
    """Recordings with the outputs (p, T) that a fit predicts in their units, NaN where it predicts none."""
    free = latest.free
    recordings = [channel for channel in latest.channels if isinstance(channel, Recording)]
    predicted = [np.full(data.y.shape, np.nan) for data in recordings]
    for place, record, outputs in records_of(free.projection, latest.channels):
        sizes = free.scales[record.outputs, None] * record.unit
        predicted[place][record.outputs] = record.placed(outputs) * sizes
    return list(zip(recordings, predicted, strict=True))


def _settled(
    alone: Searched, search: Search, proposed: Callable[[Searched], Channels | None],
    is_better: Callable[[Searched, Searched], bool] = lambda again, latest: True,
) -> Searched:  # fmt: skip
    """Search in the channels that each fit proposes, until it proposes none, or a search is no better, or is cut."""
    latest = alone
    for _ in range(_ROUNDS):
        channels = proposed(latest)
        if channels is None:
            break
        again = search(channels)
        if again.free.interrupted:
            return latest.cut
        if not is_better(again, latest):
            break
        latest = again
    return latest


def _beside_hum(latest: Searched, search: Search, refine: Refine, automatic: bool) -> Searched:
    """The fit beside tones in place of modes that neither decay nor are driven, where the criterion agrees.

    So it is with lines of the residuals; where the number of modes is not `automatic`, and some may be missing, with
    lines that have much of their power, if what is left beside them is white.  Once the modes that there are agree,
    others are looked for, which tones may have hidden.
    """

    def gain(again: Searched, taken: Tones) -> float:
        """Return the log-likelihood that a fit beside tones gains."""
        return 0.5 * (latest.bic - again.bic - latest.charge(taken.unknowns))

    for _ in range(_MOST_TONES):
        free = latest.free
        still = undriven(free)
        more, driven = free.projection.p.imag[still], np.delete(free.projection.p, still)
        doubted = not (automatic or len(more))
        more = more if len(more) else lines_in(free, _MUCH if doubted else 0.0)
        if not len(more):
            break
        hums = Tones.of(latest.findings, latest.channels)
        tones = tones_in(free, np.append(hums.frequencies, more))
        for _ in range(_ROUNDS):
            again = refine(tones.taken_from(latest.channels), latest, driven)
            if again.free.interrupted:
                return latest.cut
            taken, tones = tones, tones_in(again.free, tones.frequencies)
            if tones.is_near(taken):
                break
        if automatic and gain(again, taken) <= 0:  # of a number that is given a mode is missing yet
            break
        again = search(again.channels)
        if again.free.interrupted:
            return latest.cut
        if gain(again, taken) <= 0 or (doubted and not again.free.leaves_white_noise):
            break
        latest = replace(again, findings=tuple(taken.findings(gain(again, taken))))
    return latest


def _beside_unequal_noise(alone: Searched, search: Search, refine: Refine, automatic: bool) -> Searched:
    """The fit to recordings in units in which their noise is the same, where that is likelier.

    The units are settled with the poles that there are before others are looked for.
    """
    charge = alone.charge(len(alone.channels) - 1)

    def in_settled_units(latest: Searched) -> Channels | None:
        """Return recordings in units that the poles of a fit agree with."""
        channels = in_equal_noise(latest.channels, latest.free)
        proposed = channels
        for _ in range(_ROUNDS):
            if proposed is None:
                break
            channels = proposed
            again = refine(channels, latest, latest.free.projection.p)
            if again.free.interrupted:
                raise KeyboardInterrupt
            proposed = in_equal_noise(channels, again.free)
        return channels

    latest = _settled(
        alone, search, in_settled_units, lambda again, latest: again.bic < min(alone.bic - charge, latest.bic)
    )
    if latest.free.interrupted:
        return latest
    # what modes leave that may be missing says nothing of the noise
    if latest is alone or not (automatic or latest.free.leaves_white_noise):
        return alone
    units = tuple(getattr(channel, "unit", 1.0) for channel in latest.channels)
    gain = 0.5 * (alone.bic - latest.bic - charge)
    return replace(latest, findings=(*alone.findings, Finding(Cause.UNEQUAL_NOISE, units, gain)))


def _beside_changing_noise(alone: Searched, search: Search, refine: Refine) -> Searched:
    """The fit where each sample counts by the level of the noise in its span, where that is likelier.

    So it has to be with the poles that there are before others are looked for.
    """

    def likelier_levels(latest: Searched) -> Channels | None:
        """Return recordings with other levels, which the poles of the first fit have to ask for."""
        channels = _in_their_levels(latest)
        if channels is None or latest is not alone:
            return channels
        again = refine(channels, alone, alone.free.projection.p)
        if again.free.interrupted:
            raise KeyboardInterrupt
        return channels if again.bic < alone.bic else None

    latest = _settled(alone, search, likelier_levels)
    if latest is alone or latest.free.interrupted:
        return latest
    findings = findings_of(latest.channels, 0.0)
    gain = 0.5 * (alone.bic - latest.bic - alone.charge(sum(len(finding.values) - 2 for finding in findings)))
    if gain <= TUNING.sure:
        return alone
    return replace(latest, findings=(*alone.findings, *findings_of(latest.channels, gain)))


def _in_their_levels(latest: Searched) -> Channels | None:
    """Recordings with the levels of noise that a fit shows; None where it shows none, or those that they have."""
    levels = changing_levels(latest.free)
    if levels is None or _same_levels(levels, latest.channels):
        return None
    recordings = zip([data for data in latest.channels if isinstance(data, Recording)], levels, strict=True)
    return tuple(data.of_one_level if level is None else data.adjusted(level=level) for data, level in recordings)


def _same_levels(levels: Sequence[Array | None], channels: Channels) -> bool:
    """Whether levels of noise are nearly those that recordings have."""
    known = [level_of(channel) for channel in channels]
    return all(
        (new is None and old is None)
        or (new is not None and old is not None and np.mean(np.abs(np.log(new / old))) < _SAME_LEVEL)
        for new, old in zip(levels, known, strict=True)
    )  # fmt: skip
