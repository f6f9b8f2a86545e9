"""Noise that is not white beside damped modes: its spectrum at each output, and the fit where it has been whitened."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from ..._types import Array
from ..data.channels import Recording
from ..regression.elimination import orthogonal, without
from ..regression.free import FreeProjection, GivenResidues, input_places, pole_derivatives, refine_free
from ..regression.modal_regressors import SampledModes
from ..regression.prediction import FittedChannels
from ..regression.spectral_rows import ChannelSpectra, FreeWindow
from ..regression.time_rows import FreeRecord, may_filter
from ..regression.tuning import TUNING
from ..search.channel_rows import is_short
from ..search.findings import Cause, Finding
from ..search.fitted_modes import Criteria, FreeFit
from ..search.whitening import foretold, likeliest_ratio, sampled_response
from ..uncertainty.noise_model import NoiseModel
from ..uncertainty.residual_tests import is_white

_LONGEST = 64  # samples of the past that noise may depend on
_SAMPLES_EACH = 20  # of the residuals for each of them
_LEAST = 0.1  # of the noise about a mode that is taken to be left beside what was fitted there
_TOLD = 10.0  # log-likelihood by which noise of a kind has to explain more than white noise
_ASTRAY = 4.0  # times the squares left beside the modes, at which these were left for the sake of what is no noise
_GRID = 4096  # frequencies of a spectrum
_NEGLIGIBLE = 1e-6  # of the largest coefficient of an innovations filter: less at its end is a rounding of the fit
_EXACT = 1e-13  # relative decrease of the loss at which a refinement ends


@dataclass(frozen=True)
class OutputNoise:
    """Noise of an output: its `innovations` filter, which leaves white noise of variance 1; and what it is like."""

    innovations: Array
    finding: Finding | None


def beside_coloured_noise(free: FreeFit) -> FreeFit:
    """The fit with findings on its residuals; where these are coloured, refined in rows whitened by their filters.

    A search leaves rows that are white but where noise comes through the modes, or depends on more of its past than an
    order is weighed against.  The innovations filter of an output takes inputs and outputs of any modes to inputs and
    outputs of the same modes.
    Of a free motion the rows stay as they are, and of responses all.  They also stay where the input acts in a small
    part of a record, or modes would be lost, begin to grow, or grow twice as fast: what hits leave of an input known at
    its samples only, or what no linear model explains, has no spectrum that all of the record shares.
    """
    projection = free.projection if free.measured is None else GivenResidues(free.measured, free.projection.shared)
    records = [record for record in projection.experiments if isinstance(record, FreeRecord)]
    if len(records) < len(projection.experiments) or not free.states or free.rounding:
        return free
    noise = noise_of(replace(free, projection=projection), records)
    findings = tuple(output.finding for output in noise if output.finding is not None)
    if not findings:
        return free
    free = replace(free, findings=(*free.findings, *findings))
    if any(is_short(record) for record in records):
        return free
    filters = tuple(output.innovations for output in noise)
    through = any(finding.cause is Cause.INPUT_NOISE for finding in findings)
    if free.noise and not through and is_white(free.projection):
        return free
    free = replace(free, filters=filters)
    if not (projection.inputs and may_filter(records, filters)):
        return free
    return _whitened(free, projection, [row for record in records for row in record.filtered(filters)])


def _whitened(free: FreeFit, projection: FreeProjection, rows: Sequence[FreeRecord]) -> FreeFit:
    """The fit refined in rows of white noise, with its likelihood there, if the BIC is smaller.

    As it is where modes are lost, begin to grow, or grow twice as fast.
    """
    refined = refine_free(lambda _: rows, projection.p, free.region, _EXACT, projection.fed)
    if len(refined.p) != len(projection.p) or np.any(refined.p.real > 2 * np.maximum(projection.p.real, 0.0)):
        return free
    measured = FreeProjection(projection.experiments, refined.p, projection.fed)
    if measured.loss > _ASTRAY * projection.loss:
        return free
    counts, samples = np.zeros((2, len(free.scales)))
    for record in rows:
        counts[record.outputs] += record.samples
    for plain in measured.experiments:
        samples[plain.outputs] += plain.samples
    sizes = np.sqrt(counts / refined.losses)
    deviations = free.scales / (sizes * np.abs([b[0] for b in free.filters]))  # of the innovations
    loglik = -float(np.sum(samples * (np.log(deviations) + 0.5 * np.log(2 * np.pi) + 0.5)))
    more = sum(len(b) - 1 for b in free.filters) - sum(len(b) - 1 for b in free.noise)
    criteria = Criteria.of(loglik, free.unknowns + more + len(samples), float(samples.sum()))
    if criteria.bic >= free.criteria.bic:
        return replace(free, filters=())
    rows = [record.in_units(float(sizes[record.outputs[0]])) for record in rows]
    return replace(
        free, projection=FreeProjection(rows, refined.p, projection.fed), measured=measured, noise=free.filters,
        filters=(), criteria=criteria, unknowns=free.unknowns + more,
    )  # fmt: skip


def noise_of(free: FreeFit, records: Sequence[FreeRecord]) -> list[OutputNoise]:
    """Noise of each output, from its residuals in all records.

    An autoregression of the order that AIC prefers, or noise that comes through the modes as the input does, where BIC
    prefers that.  What was fitted took its part of the noise about the modes, which counts as if it were there.
    """
    projection, count = free.projection, len(free.scales)
    powers: list[list[tuple[Array, int]]] = [[] for _ in range(count)]
    gains: list[list[Array]] = [[] for _ in range(count)]
    for rows, predicted, shares in zip(
        records, projection.predictions(), _shares_left(projection, records), strict=True
    ):
        residuals = rows.residuals(predicted)
        of_inputs = _gains(projection, rows)
        for output, residual, share, gain in zip(rows.outputs.tolist(), residuals, shares, of_inputs, strict=True):
            powers[output].append((np.abs(np.fft.rfft(residual)) ** 2 / share, rows.length))
            gains[output].append(gain)
    labels, step = free.channels[0].output_labels, records[0].hold.h
    return [_noise(*each, step) for each in zip(powers, gains, labels, free.scales.tolist(), strict=True)]


def _noise(
    powers: Sequence[tuple[Array, int]], gains: Sequence[Array], label: str, scale: float, step: float
) -> OutputNoise:
    """Noise of an output, of its residuals' powers at all bins of records of so many samples."""
    shortest, total = min(length for _, length in powers), sum(length for _, length in powers)
    most = max(1, min(_LONGEST, shortest // 4, total // _SAMPLES_EACH))
    products = np.sum([np.fft.irfft(periodogram, length)[: most + 1] for periodogram, length in powers], axis=0)
    models, variances = foretold(products)
    likelier = -0.5 * total * np.log(variances)
    order = int(np.argmax(likelier - np.arange(len(variances))))
    past = np.concatenate([[1.0], -models[order]])
    innovations = past / np.sqrt(max(variances[order] * products[0] / total, np.finfo(float).tiny))
    finding, least = None, _TOLD
    if (gain := float(likelier[order])) - order > least:
        finding = Finding(Cause.COLOURED_RESIDUALS, _band(past, step), gain, label)
        least = max(_TOLD, gain - 0.5 * order * float(np.log(total)))
    power = np.concatenate([periodogram[1 : (length + 1) // 2] / length for periodogram, length in powers])
    through = np.concatenate(
        [squared_gain[1 : (length + 1) // 2] for squared_gain, (_, length) in zip(gains, powers, strict=True)]
    )
    if not np.median(through) > 0:
        return OutputNoise(innovations, finding)

    def unlikely(ratio: float) -> float:
        size = 1 + ratio * through
        return float(np.sum(np.log(size)) + len(power) * np.log(np.mean(power / size)))

    ratio, level = likeliest_ratio(unlikely, through)
    if ratio and (gain := unlikely(0.0) - level) > least:
        beside = float(np.sqrt(np.mean(power / (1 + ratio * through))))
        finding = Finding(Cause.INPUT_NOISE, (float(np.sqrt(ratio)) * beside, scale * beside), gain, label)
        pairs = zip(gains, powers, strict=True)
        products = np.sum(
            [np.fft.irfft(1 + ratio * squared_gain, length)[: most + 1] for squared_gain, (_, length) in pairs], axis=0
        )
        models, variances = foretold(products)
        past = np.concatenate([[1.0], -models[-1]])
        innovations = past / (beside * np.sqrt(variances[-1] * products[0] / len(powers)))
    return OutputNoise(innovations, finding)


def _band(past: Array, step: float) -> tuple[float, float, float, float]:
    """Band of half the peak of a spectrum, its density there over the geometric mean, and its share of the power."""
    density = np.abs(np.fft.rfft(past, 2 * _GRID)) ** -2.0
    peak, low = int(np.argmax(density)), density < 0.5 * density.max()
    first = int(np.flatnonzero(np.append(True, low[:peak]))[-1])
    last = peak + int(np.flatnonzero(np.append(low[peak:], True))[0])
    unit = np.pi / (_GRID * step)
    share = float(density[first:last].sum() / density.sum())
    return unit * first, unit * min(last, _GRID), float(density[peak]), share


def _gains(projection: FreeProjection, rows: FreeRecord) -> Array:
    """Sum over inputs of squared gain times mean square of the input, (q, bins), of each output of a record."""
    squared_gains = np.zeros((len(rows.outputs), rows.length // 2 + 1))
    phase = np.asarray(2 * np.pi / rows.length * np.arange(squared_gains.shape[1]), float)
    step = SampledModes.of(rows.hold, projection.p)  # a delay changes no gain
    for u, i in zip(rows.u[: rows.inputs], rows.acting.tolist(), strict=True):
        for k, o in enumerate(rows.outputs.tolist()):
            gain = sampled_response(step, projection.residues[:, o, i], float(projection.feedthrough[o, i]), phase)
            squared_gains[k] += np.mean(u**2) * np.abs(gain) ** 2
    return squared_gains


def fitted_noise(
    experiments: Sequence[FittedChannels], variances: Array, filters: Sequence[Array], share: float
) -> NoiseModel | None:  # fmt: skip
    """Noise of the outputs (p,) of records, of residuals with innovations filters; None of responses.

    White noise has the `variances` of the residuals, innovations the mean square of what the filter leaves over
    `share`, that which a fit leaves of the noise on average.
    """
    steps = [data.record.dt for data in experiments if isinstance(data.record, Recording)]
    if not steps:
        return None
    filters = [b[: int(np.flatnonzero(np.abs(b) > _NEGLIGIBLE * np.abs(b).max())[-1]) + 1] for b in filters]
    order = max((len(b) - 1 for b in filters), default=0)
    variances, colours = variances.copy(), np.zeros((len(variances), order))
    for output, b in enumerate(filters if order else ()):
        if len(b) == 1:
            continue
        colours[output, : len(b) - 1] = -b[1:] / b[0]
        remaining = [
            lfilter(b / b[0], 1.0, data.measured[output] - data.predicted[output])[len(b) - 1 :] / data.noise_scale
            for data in experiments
        ]
        known = np.concatenate(remaining)
        known = known[~np.isnan(known)]
        if len(known):
            variances[output] = np.mean(known**2) / share
    return NoiseModel(np.diag(variances), steps[0], colours if order else None)


# --- what a fit leaves of the noise ----------------------------------------------------------------------------------


def _shares_left(projection: FreeProjection, records: Sequence[FreeRecord]) -> list[Array]:
    """Of the noise of each record and output (q, bins), the share that a fit leaves on average: 1 less the leverage."""
    shares = [np.ones((len(record.outputs), record.length // 2 + 1)) for record in records]
    for outputs in {tuple(record.outputs.tolist()) for record in records}:
        places = [k for k, record in enumerate(records) if tuple(record.outputs.tolist()) == outputs]
        windows = [_about(replace(records[k], outputs=np.arange(len(outputs))), projection) for k in places]
        for k, window, taken in zip(places, windows, _leverages(FreeProjection(windows, projection.p)), strict=True):
            shares[k][:, window.bins] = np.maximum(_LEAST, 1 - taken)
    return shares


def _about(record: FreeRecord, projection: FreeProjection) -> FreeWindow:
    """Window of the bins about the modes in which the fit has absorbed part of the noise."""
    spectra = ChannelSpectra.of(record)
    reach = np.minimum(TUNING.half_width * (1 + np.abs(projection.p.real) / record.bin), TUNING.thinned).astype(int)
    centres = np.rint(spectra.place(projection.p.imag)).astype(int).tolist()
    bins = np.unique(np.concatenate([np.arange(c - r, c + r + 1) for c, r in zip(centres, reach, strict=True)]))
    return FreeWindow(spectra, bins[(bins >= 1) & (bins <= spectra.last)])


def _leverages(near: FreeProjection) -> list[Array]:
    """Of each record and output (q, bins) the diagonal of the projection on what was fitted, the mean of both parts."""
    n, own, shared, slopes = len(near.p), list[Array](), list[Array](), list[Array]()
    for window, mine in zip(near.experiments, near.own, strict=True):
        columns, place = next(iter(window.evaluated(near.p).blocks())).T, input_places(window, n)
        basis = orthogonal(columns[:, : 2 * n])[0]
        every = np.zeros((len(columns), len(near.shared)))
        every[:, place] = columns[:, 2 * n : 2 * n + len(place)]
        moved = columns[:, 2 * n + len(place) : columns.shape[1] - len(window.outputs)]
        each = [pole_derivatives(moved, window, mine[:, o], near.residues[:, o]) for o in window.outputs]
        own.append(basis)
        shared.append(without(every, basis))
        slopes.append(np.stack([without(slope, basis) for slope in each]))
    ends = np.cumsum([len(basis) for basis in own])[:-1]
    joint = orthogonal(np.concatenate(shared))[0]
    by_output = np.stack([without(slope, joint) for slope in np.concatenate(slopes, axis=1)])
    poles = orthogonal(by_output.reshape(-1, 2 * n))[0].reshape(*by_output.shape[:2], -1)
    taken = np.split(np.sum(poles**2, axis=2) + np.sum(joint**2, axis=1), ends, axis=1)
    rows = [part + np.sum(basis**2, axis=1) for part, basis in zip(taken, own, strict=True)]
    return [0.5 * (each[:, : each.shape[1] // 2] + each[:, each.shape[1] // 2 :]) for each in rows]
