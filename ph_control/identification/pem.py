"""Prediction-error fitting: the public call, the forward path over orders, the verdict."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _checks
from ..exceptions import IdentifiabilityWarning, IdentificationError, StructureError
from ..modal import ModalForm
from ..propagation import INTERSAMPLE, METHODS
from ..systems import PortHamiltonian
from .data import Record, as_record
from .regressors import Hold
from .result import OrderRow, PEMResult, ljung_box, state_from_amplitudes
from .solver import Problem, Projection, refine
from .start import Screen
from .uncertainty import covariance_of, in_user_parameters
from .validation import fit_percent
from .verdict import Verdict

Array = NDArray[np.float64]

_PATIENCE = 3  # orders without a better BIC before the forward path ends


@dataclass(frozen=True)
class Progress:
    """What a callback is told after each iteration."""

    order: int
    max_order: int
    iteration: int
    loss: float


def pem(
    data: Any,
    order: int | str = "auto",
    *,
    dt: float | None = None,
    method: str = "exact",
    intersample: str = "zoh",
    initial_state: str = "estimate",
    max_order: int = 20,
    callback: Callable[[Progress], Any] | None = None,
) -> PEMResult:
    """Fit a lossless model to a recording, by prediction-error minimisation.

    Finds `d`, `r >= 0` and the initial state that minimise the squared output error of a port-Hamiltonian model.
    With white output noise this is the maximum-likelihood estimate.  No starting guess is needed.

    Parameters
    ----------
    data : control.TimeResponseData, or pair (u, y) of array_like, shape (T,) each
        One input and one output on a uniform grid; NaN outputs are missing samples.  Not modified.
    order : int or 'auto'
        Number of modes n; 'auto' takes the one with the smallest BIC.
    dt : float, optional
        Time between samples; needed with arrays.
    method : {'exact', 'midpoint', 'euler'}
        How the model meets the samples; 'exact' for real recordings, the others for data made by such an integrator.
    intersample : {'zoh', 'foh'}
        Input between samples: held, or linear.
    initial_state : {'estimate', 'zero'}
        Whether the record may start in motion.
    max_order : int
        Largest order tried by 'auto'.
    callback : callable, optional
        Called as `callback(progress)` after each iteration, `progress` with `order`, `max_order`, `iteration`, `loss`.

    Returns
    -------
    PEMResult
        Model, uncertainty, quality and a verdict; see `PEMResult.summary`.

    Raises
    ------
    StructureError
        If the data or options are not of this form.
    IdentificationError
        If the record cannot carry the order, has no signal, or its input shows nothing.

    Warns
    -----
    IdentifiabilityWarning
        If some combination of weights and initial states leaves no trace in the output.

    Notes
    -----
    Given `d` the prediction is linear in the rest: variable projection with the exact Jacobian.  The loss has many
    minima in `d`, about `2 pi / (T dt)` wide, so modes are added one by one, each where a local fit around the bins of
    the Fourier transform explains most of what is left, and all are refined jointly.  O(T n^2) an iteration.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> plant = phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]))
    >>> rng = np.random.default_rng(0)
    >>> t, u = 0.1 * np.arange(1000), rng.standard_normal(1000)
    >>> y = phc.forced_response(plant, t, u).outputs + 0.01 * rng.standard_normal(1000)
    >>> result = phc.pem((u, y), dt=0.1)
    >>> result.d.round(3)
    array([0.5, 2. ])
    """
    _checks.choice("method", method, METHODS)
    _checks.choice("intersample", intersample, INTERSAMPLE)
    _checks.choice("initial_state", initial_state, ("estimate", "zero"))
    record = as_record(data, dt)
    problem = Problem(
        record.u, record.y, record.observed, Hold(record.dt, method, intersample), initial_state == "zero"
    )
    largest = _check_order(problem, order, max_order)
    _check_signals(problem, record)
    screen = Screen(problem)
    path = _forward_path(problem, screen, largest, order == "auto", callback)
    place = int(np.argmin([stage.row.bic for stage in path])) if order == "auto" else len(path) - 1
    chosen = path[place] = _reseat(problem, screen, path[place])
    asked = chosen.row.order if order == "auto" else largest
    at_limit = order == "auto" and chosen.row.order == max_order
    return _result(problem, record, chosen, path, asked, at_limit, order != "auto")


@dataclass(frozen=True)
class _Stage:
    """One order of the forward path."""

    d: Array
    row: OrderRow
    iterations: int
    converged: bool


def _check_order(problem: Problem, order: int | str, max_order: int) -> int:
    """Largest order to try."""
    observed = len(problem.target)
    unknowns = problem.unknowns
    carried = max(0, (observed - 1) // unknowns)
    for name, value in (("order", order), ("max_order", max_order)):
        whole = isinstance(value, int | np.integer) and not isinstance(value, bool) and value >= 1
        if not (whole or (name == "order" and value == "auto")):
            allowed = "'auto' or a whole number >= 1" if name == "order" else "a whole number >= 1"
            raise StructureError(f"{name} is {value!r}; it must be {allowed}")
    if carried == 0:
        raise IdentificationError(
            f"the record has {observed} observed output samples; one mode alone has {unknowns} unknowns, so "
            f"at least {unknowns + 1} are needed"
        )
    if order == "auto":
        return int(min(max_order, carried))
    if int(order) > carried:
        raise IdentificationError(
            f"order {order} has {unknowns * int(order)} unknowns, more than the {observed} observed samples can carry; "
            f"the largest order for this record is {carried}"
        )
    return int(order)


def _check_signals(problem: Problem, record: Record) -> None:
    if not problem.target.any():
        raise IdentificationError("the output is zero throughout the record; there is nothing to model")
    if np.all(record.u == record.u[0]) and not (problem.from_rest and record.u[0] != 0):
        raise IdentificationError(
            f"the input is constant ({record.u[0]:g}) throughout the record: a lossless model answers it like a free "
            "motion, so no weight r can be told from the initial state; record with an input that varies, or pass "
            "initial_state='zero' if a step was applied to a plant at rest"
        )


def _forward_path(
    problem: Problem, screen: Screen, largest: int, automatic: bool, callback: Callable[[Progress], Any] | None
) -> list[_Stage]:
    """Add one mode at a time and refine all; with `automatic`, stop when BIC has ceased to improve."""
    current = problem.project(np.zeros(0))
    path = [_stage(problem, current, 0, True)]
    floor = _rounding_floor(problem)
    # what the BIC does not feel is left to the last polish
    stop = min(1e-4, 0.1 / len(problem.target))
    for order in range(1, largest + 1):
        if current.loss <= floor:
            break
        start = np.append(current.d, screen.strongest(_full_residual(problem, current)))

        def report(iteration: int, loss: float, order: int = order) -> None:
            if callback is not None:
                callback(Progress(order, largest, iteration, loss / len(problem.target)))

        refined = refine(problem, start, rtol=stop, progress=report)
        current = refined.projection
        path.append(_stage(problem, current, refined.iterations, refined.converged))
        best = min(range(len(path)), key=lambda k: path[k].row.bic)
        if automatic and order - best >= _PATIENCE:
            break
    return path


def _full_residual(problem: Problem, projection: Projection) -> Array:
    residual = np.zeros(len(problem.y))
    residual[problem.observed] = projection.residual
    return residual


def _reseat(problem: Problem, screen: Screen, stage: _Stage) -> _Stage:
    """Move modes whose weight is held at 0 to where they explain more, if there is such a place.

    A mode taken early, when others were still missing, may have ended in a wrong basin; the constraint shows it.
    """
    best = refine(problem, stage.d, rtol=1e-15)
    iterations = stage.iterations + best.iterations
    tried: set[float] = set()
    while held := [float(d) for d in best.projection.d[~best.projection.free[: len(stage.d)]] if float(d) not in tried]:
        tried.add(held[0])
        others = problem.project(best.projection.d[best.projection.d != held[0]])
        start = np.append(others.d, screen.strongest(_full_residual(problem, others)))
        trial = refine(problem, start, rtol=1e-9)
        iterations += trial.iterations
        if len(start) == len(stage.d) and trial.projection.loss < (1 - 1e-6) * best.projection.loss:
            best, tried = trial, set()
    return _stage(problem, best.projection, iterations, best.converged)


def _rounding_floor(problem: Problem) -> float:
    """Loss below which residuals are rounding: in recursions run in doubles, errors grow with the samples."""
    samples = len(problem.target)
    return float(samples * (_checks.EPS * samples * np.max(np.abs(problem.target))) ** 2)


def _stage(problem: Problem, projection: Projection, iterations: int, converged: bool) -> _Stage:
    n = len(projection.d)
    _, aic, bic = _criteria(problem, projection.loss, n)
    row = OrderRow(n, projection.loss / len(problem.target), aic, bic, np.sort(projection.d))
    return _Stage(projection.d, row, iterations, converged)


def _criteria(problem: Problem, loss: float, n: int) -> tuple[float, float, float]:
    """Gaussian log-likelihood at the best noise variance, AIC and BIC; the noise variance counts as a parameter."""
    samples = len(problem.target)
    parameters = problem.unknowns * n + 1
    variance = max(loss / samples, np.finfo(float).tiny)
    loglik = -0.5 * samples * (np.log(2 * np.pi * variance) + 1)
    return loglik, 2 * parameters - 2 * loglik, parameters * np.log(samples) - 2 * loglik


def _result(
    problem: Problem, record: Record, chosen: _Stage, path: list[_Stage], order: int, at_limit: bool, order_given: bool
) -> PEMResult:
    """Sort the modes, convert to `(d, r, initial state)`, and judge."""
    best = refine(problem, chosen.d, rtol=1e-15)
    at = best.projection
    n = len(at.d)
    rank = np.argsort(at.d)
    d, coefficients = at.d[rank], at.coefficients
    kappa, alpha, beta = (coefficients[k * n : (k + 1) * n][rank] for k in range(3))
    free = at.full_jacobian()[1][n : 2 * n][rank]
    covariance, variance = covariance_of(at, rank)
    pads = _placeholders(d, order - n)
    modes = ModalForm(
        np.concatenate([d, pads]),
        np.sqrt(np.concatenate([kappa / d, 0 * pads])).astype(complex)[:, None],
        np.zeros((0, 1)),
    )
    amplitudes = np.concatenate([alpha + 1j * beta, 0j * pads])
    predicted = at.regressors.columns() @ coefficients
    residuals = record.y - predicted
    loglik, aic, bic = _criteria(problem, at.loss, n)
    noiseless = at.loss <= _rounding_floor(problem)
    verdict = Verdict(
        n=n,
        order=order,
        spare=len(problem.target) - problem.unknowns * n,
        fit_percent=fit_percent(problem.target, at.residual),
        active=tuple(int(l) for l in np.flatnonzero(~free)),
        deficiency=at.rank_deficiency,
        whiteness=1.0 if noiseless else ljung_box(residuals, min(20, len(problem.target) // 5)),
        converged=best.converged,
        noiseless=noiseless,
        at_limit=at_limit,
        order_given=order_given,
        from_rest=problem.from_rest,
        silent=not kappa.any(),
        reversed_sign=at.asks_for_negative_residues_only,
        drifting=tuple(int(l) for l in np.flatnonzero(d < problem.bin * (1 - 1e-6)) if not free[l]),
    )
    if verdict.deficiency:
        warnings.warn(verdict.blind, IdentifiabilityWarning, stacklevel=3)
    return PEMResult(
        system=_named_system(modes, record),
        initial_state=state_from_amplitudes(modes, amplitudes),
        free_amplitudes=amplitudes,
        covariance=in_user_parameters(covariance, modes, amplitudes, free, n),
        noise_variance=variance,
        loss=at.loss / len(problem.target),
        loglik=loglik,
        aic=aic,
        bic=bic,
        fit_percent=verdict.fit_percent,
        active=verdict.active,
        unseen=tuple(range(n, order)),
        rank_deficiency=verdict.deficiency,
        whiteness=verdict.whiteness,
        order_table=tuple(stage.row for stage in path),
        success=best.converged,
        verdict=verdict.headline,
        message=verdict.message(),
        n_iterations=best.iterations + sum(stage.iterations for stage in path),
        method=problem.hold.method,
        intersample=problem.hold.intersample,
        record=record,
        predicted=predicted,
        residuals=residuals,
    )


def _named_system(modes: ModalForm, record: Record) -> PortHamiltonian:
    """System with the labels of the record; python-control takes no dots in names."""
    labels = (record.input_label.replace(".", "_"), record.output_label.replace(".", "_"))
    return PortHamiltonian._from_modes(modes, inputs=[labels[0]], outputs=[labels[1]])


def _placeholders(d: Array, count: int) -> Array:
    """Frequencies for modes that the record does not show: distinct, above those it does."""
    return d.max(initial=0.0) * (2.0 + np.arange(float(count)))


prediction_error_fit = pem
