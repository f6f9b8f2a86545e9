"""Outputs alone: a motion that decays, or one that forces keep up which nobody measured."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import chdtrc

from ..._display import counted
from ...exceptions import IdentificationError, StructureError
from ..data.channels import Recording
from ..diagnosis.hum import Tones, tones_near
from ..diagnosis.verdict import WHITE, HypothesisTest
from ..innovations.ambient import AmbientFit, ambient_fit
from ..innovations.noise_sections import NoiseSections
from ..search.circumstances import REJECTED, Finding
from ..search.progress import reporter
from ..structure.hypothesis_tests import LEVEL
from .ambient_result import ambient_result

if TYPE_CHECKING:
    from .modal_fit import Channels, Options, Request
    from .pem_result import PEMResult

_FEW_MODES = 4  # that are tried for a motion that may be no decay
_DECAYED = 4.0  # times the squares of the last quarter of a record in its first
_STILL = 3.0  # standard errors, or one over the record, that a decay rate of a tone may have
_ROUNDS = 3  # of tones that are seen once others are named

_Search = Callable[[Sequence[Recording]], AmbientFit | None]


def are_alone(channels: Channels, structure: str, options: Options) -> bool:
    """Whether the data are outputs without inputs or gaps, which unmeasured forces may have kept in motion."""
    alone = all(isinstance(data, Recording) and not data.u.any() and data.observed.all() for data in channels)
    steps = {data.dt for data in channels if isinstance(data, Recording)}
    if options.noise == "forces" and not alone and not any(getattr(data, "driven", True) for data in channels):
        raise StructureError(
            "noise='forces' of outputs alone needs the same outputs in all recordings, without missing samples: cut "
            "recordings where samples are missing, and fit set-ups of different sensors one by one"
        )
    lossless = structure == "lossless" or options.method != "exact"
    return alone and len(steps) == 1 and options.noise in ("auto", "forces") and not lossless


def of_outputs_alone(
    channels: list[Recording], request: Request, options: Options, order: int | str, of_modes: Callable[..., PEMResult]
) -> PEMResult:
    """Take the likelier of a motion that decays and of one that forces keep up; the former where its noise is white."""
    given = options.noise == "forces"
    decaying = not given and _decays(channels)
    result = None if given else of_modes() if decaying or order != "auto" else of_modes(_FEW_MODES)
    if result is not None and (result.whiteness >= WHITE or not result.success):
        return result
    count, real_poles = (value if isinstance(value, int) else None for value in (order, options.real_poles))
    search: _Search = partial(
        ambient_fit, order=count, real_poles=real_poles, max_order=options.max_order,
        criterion="bic" if options.criterion == "holdout" else options.criterion,
        reports=reporter(options.largest, options.callback),
    )  # fmt: skip
    fit = search(channels)
    if fit is None:
        if result is None:
            raise IdentificationError(_nothing_fits(channels, count, real_poles))
        return of_modes()
    if result is not None and _bic_of(result) <= fit.criteria.bic and not fit.minimum.interrupted:
        return result if decaying or order != "auto" else of_modes()
    gain = 0.0 if result is None else fit.criteria.loglik - result.loglik
    findings = list[Finding]()
    if order == "auto":
        fit, findings = _beside_tones(fit, channels, search)
    fit, tests = _of_structure(fit, request)
    findings += [
        Finding(REJECTED[test.hypothesis], (test.p, float(test.dof)), 0.5 * test.likelihood_ratio)
        for test in tests if test.p < LEVEL
    ]  # fmt: skip
    most = options.max_order if order == "auto" else None
    return ambient_result(channels, fit, request.quantities, gain, most, findings, tests)


def _nothing_fits(channels: Sequence[Recording], order: int | None, real_poles: int | None) -> str:
    lengths = ", ".join(str(data.samples) for data in channels)
    if order is None and real_poles is None:
        return (
            f"records of {lengths} samples are too short for a model of forces that nobody measured, or one of the "
            f"{counted(len(channels[0].y), 'output')} is a combination of others: leave that one out, record longer, "
            "or leave noise out"
        )
    wanted = [f"{count} {name}" for count, name in ((order, "modes"), (real_poles, "real poles")) if count is not None]
    return (
        f"records of {lengths} samples show no model of forces that nobody measured with {' and '.join(wanted)}: leave "
        "order and real_poles to the data, or record longer"
    )


def _bic_of(result: PEMResult) -> float:
    return result.bic if np.isfinite(result.bic) else np.inf


def _decays(channels: Sequence[Recording]) -> bool:
    """Whether outputs move far less in the last quarter of the records than in the first."""
    first = last = 0.0
    for data in channels:
        y = data.y - data.y.mean(axis=1, keepdims=True)
        size = np.maximum(np.sum(y**2, axis=1), np.finfo(float).tiny)
        part = max(1, data.samples // 4)
        first += float(np.sum(np.sum(y[:, :part] ** 2, axis=1) / size))
        last += float(np.sum(np.sum(y[:, -part:] ** 2, axis=1) / size))
    return first > _DECAYED * last


# --- shapes ----------------------------------------------------------------------------------------------------------


def _of_structure(fit: AmbientFit, request: Request) -> tuple[AmbientFit, list[HypothesisTest]]:
    """Take real shapes where these are asked for, or where the data do not reject them."""
    alike = len(fit.scales) > 1 and len(set(request.quantities)) == 1
    wanted = request.structure in ("auto", "classical")
    if not (wanted and alike and fit.order) or fit.minimum.interrupted:
        return fit, []
    real = fit.with_real_shapes()
    if real.minimum.interrupted:
        return replace(fit, minimum=replace(fit.minimum, interrupted=True)), []
    ratio, dof = max(0.0, 2 * (fit.criteria.loglik - real.criteria.loglik)), fit.unknowns - real.unknowns
    test = HypothesisTest("classical", ratio, dof, float(chdtrc(dof, ratio)))
    return real if request.structure == "classical" or test.p >= LEVEL else fit, [test]


# --- tones -----------------------------------------------------------------------------------------------------------


def _beside_tones(
    fit: AmbientFit, channels: Sequence[Recording], search: _Search
) -> tuple[AmbientFit, list[Finding]]:  # fmt: skip
    """The fit beside tones of machines, in place of modes that do not decay, where the criterion agrees."""
    findings = list[Finding]()
    for _ in range(_ROUNDS):
        still = _still(fit, channels)
        if fit.minimum.interrupted or not len(still):
            break
        known = Tones.of(findings, channels)
        step = channels[0].dt
        frequencies = np.append(known.frequencies, fit.noise.sections.root[still] / step)
        weights = 1.0 / (np.sqrt(_density_at(fit, frequencies * step, still)) * fit.scales)
        levelled = [data.y - mean[:, None] for data, mean in zip(channels, fit.means, strict=True)]
        tones = tones_near(frequencies, levelled, [weights] * len(channels), channels)
        again = search(tones.taken_from(channels))
        if again is None or again.minimum.interrupted:
            break
        charge = (tones.unknowns - known.unknowns) * float(np.log(fit.samples))
        saved = 0.5 * (fit.criteria.bic - again.criteria.bic - charge)
        if saved <= 0:
            break
        fit, findings = again, tones.findings(saved)
    return fit, findings


def _still(fit: AmbientFit, channels: Sequence[Recording]) -> np.ndarray:
    """Sections of modes that show no decay, or none that a record could show."""
    sections, longest = fit.noise.sections, max(data.samples for data in channels)
    modes = np.flatnonzero(sections.square > 0)
    if not len(modes):
        return modes
    errors = np.sqrt(np.maximum(np.diag(fit.evaluation.information_inverse())[modes], 0.0))
    return modes[sections.decay[modes] < np.maximum(_STILL * errors, 1.0 / longest)]


def _density_at(fit: AmbientFit, angles: np.ndarray, still: np.ndarray) -> np.ndarray:
    """Density (p,) of the outputs at some frequencies, the mean over these, without modes that are still."""
    noise: NoiseSections = fit.noise
    K = noise.K.copy()
    K[np.concatenate([2 * still, 2 * still + 1])] = 0.0
    H = np.eye(len(fit.scales)) + noise.outputs_of_states(np.exp(1j * angles)) @ K
    S = np.einsum("bij,jk,bik->bi", H, fit.evaluation.covariance, H.conj()).real
    return np.asarray(S.mean(axis=0))
