"""The result of a fit: the numbers of its structure, and the judgement of these."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ... import _checks
from ..diagnosis.coloured_noise import fitted_noise
from ..estimates.estimates import Estimates
from ..judge.evidence import Evidence
from ..judge.verdict_message import message_of
from ..parameters.fitted_parameters import FittedParameters
from ..search.findings import Finding
from ..structure.choice import Choice, Request
from ..uncertainty.noise_model import NoiseModel
from .pem_result import PEMResult
from .result import OrderRow


def judged(choice: Choice, request: Request, findings: tuple[Finding, ...]) -> PEMResult:
    """The result of a choice with a judgement; as of an interrupted fit if it is interrupted here."""
    try:
        return _result(Estimates(choice, request), findings)
    except KeyboardInterrupt:
        cut = replace(choice, free=replace(choice.free, interrupted=True))
        return _result(Estimates(cut, request), findings)


def _result(estimates: Estimates, findings: tuple[Finding, ...]) -> PEMResult:
    """Parameters, experiments and judgement of a fit."""
    free, fit, request, likelihood = estimates.free, estimates.fit, estimates.request, estimates.likelihood
    evidence = Evidence.of(estimates, findings)
    shapes, shape_stderr = estimates.shapes
    delay, delay_stderr = estimates.delays
    return PEMResult(
        structure=fit.structure,
        poles=estimates.poles,
        residues=estimates.residues,
        feedthrough=fit.feedthrough,
        covariance=estimates.covariance,
        shapes=shapes.shapes,
        participation=shapes.participation,
        shape_stderr=shape_stderr,
        shapes_scaled=bool(shapes.scaled.all() and len(shapes.scaled)),
        ports=request.ports,
        quantities=request.quantities,
        noise_variance=likelihood.noise_variance,
        experiments=estimates.shown,
        loss=likelihood.loss,
        loglik=likelihood.loglik,
        aic=likelihood.aic,
        bic=likelihood.bic,
        fit_percent=estimates.fit_percent,
        unknowns=likelihood.unknowns,
        whiteness=evidence.whiteness,
        order_table=_order_table(estimates),
        tests=estimates.tests,
        findings=evidence.findings,
        success=fit.converged and not free.interrupted,
        outcome=evidence.outcome,
        message=message_of(evidence),
        intersample="zoh" if free.per_entry else free.intersample,
        delay=delay,
        delay_stderr=delay_stderr,
        input_delay=free.input_delay,
        method=free.method,
        blind=bool(evidence.blind),
        noise=_noise(estimates),
        fitted_parameters=_parameters(estimates),
    )


def _parameters(estimates: Estimates) -> FittedParameters | None:
    """Parameters of a system function, with the variance of the rows."""
    physical = estimates.fit.physical
    return physical and replace(physical, covariance=_checks.readonly(estimates.fit.variance * physical.covariance))


def _order_table(estimates: Estimates) -> tuple[OrderRow, ...]:
    """Loss and criteria of each order that was tried."""
    samples = estimates.likelihood.samples
    return tuple(
        OrderRow(row.order, float(np.exp(-2 * row.loglik / samples - 1) / (2 * np.pi)), row.aic, row.bic,
                 _checks.readonly(np.abs(row.poles)))
        for row in estimates.free.order_table
    )  # fmt: skip


def _noise(estimates: Estimates) -> NoiseModel | None:
    """Noise of the outputs at the samples; None of frequency responses."""
    free, likelihood = estimates.free, estimates.likelihood
    if free.beside is not None:
        return free.beside.model(free.channels[0].dt)
    filters = () if estimates.rounding else free.filters or free.noise
    return fitted_noise(
        estimates.experiments, likelihood.noise_variance, filters, likelihood.spare / likelihood.samples
    )
