"""Noise that outputs share, or that comes through the plant, beside measured inputs: whether it does, and the fit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import compress, islice

import numpy as np
from scipy.special import chdtrc

from ..._types import Array, ComplexArray, Mask
from ..data.channels import Recording, bridged
from ..regression.free import ROUNDED, FreeProjection
from ..regression.sections import Sections
from ..regression.time_rows import FreeRecord
from ..regression.tuning import TUNING
from ..search.channel_rows import experiments_of
from ..search.findings import Cause, Finding
from ..search.fitted_modes import Criteria, FreeFit, Orders
from ..search.predictor_states import PredictorStates, likeliest, predictors_of, signals_of
from ..search.whitening import autoregression
from ..uncertainty.noise_model import NoiseModel
from ..uncertainty.residual_tests import ljung_box
from .joint import JointProjection, Quadratic
from .minimum import Experiment, InnovationsModel, LikelihoodEvaluation, Minimum, Problem, followed
from .missing_mode import missing_mode
from .noise_sections import NoiseSections
from .subspace import in_sections

Start = tuple[Problem, InnovationsModel]  # the data, and a model without forces

KINDS = ("correlated", "forces")
AS_FITTED = Orders()  # poles are known
MOST_MISSING = 0.1  # of the samples of an output: beyond that errors would be those of values that nobody measured
_LEVEL = 1e-3  # probability that white noise of its own at each output looks as if there were more to it
_SCREEN = 0.05  # of the score test that comes before, whose law holds for long records
_HINT = 0.25  # of what the BIC asks for, which one step promises at least
_NOTED = 0.5  # of that for each mode, which residuals in a window about one promise
_SURE = 10.0  # log-likelihood beyond that of the criterion, as states that no force moves are seen in any way
_UNKNOWNS = 600  # at most,
_NUMBERS = 1 << 28  # and those of a Jacobian: a few seconds a step
_SPARE = 4  # samples of all outputs for each unknown
_LEAST_DECAY = 0.05  # bins: noise through a pole that decays more slowly never settles
_STEPS = 40
_SINGULAR = 1e-3  # smallest eigenvalue of the correlations: outputs so nearly alike leave no covariance to weigh by
_FAR = 0.1  # logarithm of the ratio of variances for each output, by which noise of outputs is hopeless
_LONGEST_PAST = 64  # samples that noise of an output may depend on
_ROUGH, _FEW = 1.0, 12  # tolerance and steps of a minimisation on the way
_ROWS = 300  # of a covariance of the past of outputs and inputs
_LAGS = 3  # of forces, at most
_RATES = 0.05, 0.4  # of these, for each sample, that are tried
_COLOURS = (0.1, 0.1), (0.1, 0.4), (0.5, 0.4)  # rates and parts that a minimisation begins with
_ROUNDS = 5  # of a fit, and of missing samples in its noise, in turn
_SETTLED = 0.02  # of the prediction errors: change of missing samples
_CLOSE = 3  # models that are refined before the criterion chooses
_MOST = 0.9  # of what outputs see of noise: by so much it is that of one of them
_HEAVY = 0.7  # damping ratio above which a lag, and noise of another, may look like a mode


@dataclass(frozen=True, eq=False)
class FittedNoise:
    """Noise of a fit in innovations form, in units of the data.

    Attributes
    ----------
    sections : NoiseSections
        What it comes through; without gains where it is white.
    covariance : ndarray, shape (p, p)
        Of the innovations.
    unknowns : int
        Numbers of it beyond the variance of each output.
    errors : tuple of ndarray
        Prediction errors (p, T) of each experiment.
    """

    sections: NoiseSections
    covariance: Array
    unknowns: int
    errors: tuple[Array, ...]

    @classmethod
    def of(cls, evaluation: LikelihoodEvaluation, scales: Array) -> FittedNoise:
        """The noise of an evaluation in rows that are `1 / scales` times the data."""
        noise, p = evaluation.point.noise, len(scales)
        coloured = evaluation.problem.coloured
        sections = noise.moved(noise.sections, scales[:, None] * noise.C, noise.K / scales)
        errors = tuple(
            np.fft.irfft(errors, experiment.samples) * (np.sqrt(experiment.samples) * scales[:, None])
            for experiment, errors in zip(evaluation.problem.experiments, evaluation.errors, strict=True)
        )
        unknowns = p * (p - 1) // 2 + (noise.unknowns if coloured else 0)
        return cls(sections, evaluation.covariance * np.outer(scales, scales), unknowns, errors)

    def model(self, step: float) -> NoiseModel:
        """The noise at samples of a step."""
        A, C, K, covariance = self.sections.A, self.sections.C, self.sections.K, self.covariance
        if not self.is_coloured:
            return NoiseModel(covariance, step)
        return NoiseModel(
            covariance, step, forces=K @ covariance @ K.T, cross=K @ covariance, states=(A, C), apart=True
        )

    @property
    def kinds(self) -> Sequence[str]:
        """Which of the kinds it is."""
        return KINDS[-1:] if self.is_coloured else KINDS[:1]

    @property
    def is_coloured(self) -> bool:
        """Whether it comes through the plant."""
        return bool(self.sections.K.any())

    @cached_property
    def whiteness(self) -> float:
        """p-value of white prediction errors."""
        return ljung_box([row for errors in self.errors for row in errors], TUNING.lags)

    @cached_property
    def correlations(self) -> Array:
        """Correlations (p, p) of the innovations."""
        return _correlations(self.covariance)


def beside_forces(
    free: FreeFit, kinds: Sequence[str] = KINDS, certain: bool = False, orders: Orders = AS_FITTED,
    like: FreeFit | None = None,
) -> FreeFit:  # fmt: skip
    """The fit in noise that outputs share, or that comes through the plant, where white noise is far less likely.

    Parameters
    ----------
    free : FreeFit
        Fit in white noise, or in that of each output.
    kinds : sequence of {'correlated', 'forces'}
        What is looked for.
    certain : bool
        Whether the last of the `kinds` is taken as given, and not tested.
    orders : Orders
        Numbers of poles that are looked for.
    like : FreeFit, optional
        Fit beside forces whose poles and noise the search begins with.

    Returns
    -------
    FreeFit
        Without `beside` where the test of probability 1e-3 does not object to noise of each output, or where the
        record does not allow the likelihood: responses, more than a tenth of the samples of an output missing, poles
        that do not decay, more unknowns than 600.  Fewer missing samples have their likeliest values.
    """
    try:
        fitted = _beside_forces(free, kinds, certain, orders, like)
    except KeyboardInterrupt:
        return replace(free, interrupted=True)
    if fitted.beside is None:
        return fitted
    kinds = fitted.beside.kinds
    return fitted.with_rival(lambda rival: _beside_forces(rival, kinds, True))


def _beside_forces(
    free: FreeFit, kinds: Sequence[str], certain: bool, orders: Orders = AS_FITTED, like: FreeFit | None = None
) -> FreeFit:
    rows = _rows(free)
    if rows is None:
        return free
    rows = _as_predicted(free, rows, orders)
    start, white = _in_white_noise(free, rows)
    if white is not None and np.linalg.eigvalsh(_correlations(white.covariance)).min() < _SINGULAR:
        return free
    alone = _alone(free, rows, white)
    foretold = _Predictors(free, rows, orders)
    best = _in_shared_noise(white, alone, certain, foretold) if white is not None and "correlated" in kinds else None
    if "forces" in kinds:
        begun = _like(like, free, rows)
        hints = certain or _hints_at_forces(foretold, alone, best.evaluation if best else white)
        rival = None if certain else white
        forced = _forced(start, foretold, rival, begun) if hints else _hidden_by_slow_poles(foretold, alone)
        if forced is not None and (certain or _shows_forces(free, rows, forced, best)):
            best = forced
    if best is None or not np.isfinite(best.evaluation.cost):
        return free
    best = _with_likeliest_samples(best)
    among = None if _margin(best, free) else white
    excess, filters = (np.inf, ()) if certain else _own_noise(best.evaluation, among)
    likelier = excess <= 0
    # where the number of modes is open, those that inputs drive beside forces may still be the likeliest
    kept = not likelier or (orders.are_open and best.evaluation.problem.coloured and not _doubtful(best))
    fitted = _in_noise(free, best, alone, certain) if kept else free
    return replace(fitted, own_noise=filters, own_likelier=likelier)


def _in_white_noise(
    free: FreeFit, rows: Sequence[FreeRecord]
) -> tuple[Start, LikelihoodEvaluation] | tuple[None, None]:  # fmt: skip
    """The fit as a start, and its likelihood in white noise; None twice where there is none."""
    start = _start(free, rows, free.projection.p)
    if start is not None:
        white = replace_colour(start[0], False).evaluated(start[1])
        if np.isfinite(white.cost):
            return start, white
    return None, None


def _in_shared_noise(
    white: LikelihoodEvaluation, alone: float, certain: bool, foretold: _Predictors
) -> Minimum | None:  # fmt: skip
    """The minimum in noise that outputs share, if that is far likelier than noise of each, or `certain`.

    Noise of each output may hide modes.
    """
    outputs = white.p
    if outputs == 1 or not (certain or _are_correlated(white)):
        return None
    shared = followed(white.problem, white.point, steps=_STEPS)
    if not certain and not _is_likelier(alone, shared.evaluation.cost, outputs * (outputs - 1) // 2):
        return None
    others = [followed(*_without_gain(begin), _ROUGH, _FEW) for begin in foretold.starts]
    best = min([shared, *others], key=lambda end: end.evaluation.bic)
    return best if best is shared else followed(best.evaluation.problem, best.evaluation.point, steps=_STEPS)


def _without_gain(begin: Start) -> Start:
    """A start without forces."""
    problem, point = begin
    noise = point.noise
    return replace_colour(problem, False), replace(point, noise=noise.moved(noise.sections, noise.C, 0 * noise.K))


def _forced(
    start: Start | None, foretold: _Predictors, white: LikelihoodEvaluation | None, begun: Start | None
) -> Minimum | None:  # fmt: skip
    """The minimum beside forces: with the same modes, or with those that the BIC prefers of so many.

    In white noise modes more than there are stand for what forces do, and weak ones are hidden by it: so the search
    begins with the poles of predictors as well.  None where there is nothing to begin with.  One of the starts may have
    `begun` beside forces.
    """
    given = [None if start is None else _damped(foretold, start), *foretold.starts, begun]
    ends = [followed(*begin, _ROUGH, _FEW) for begin in given if begin is not None]
    if not ends:
        return None
    best = min(ends, key=lambda end: end.evaluation.bic)
    best = followed(best.evaluation.problem, best.evaluation.point, steps=_STEPS)
    excess = 0.0 if white is None else _own_noise(best.evaluation, white)[0]
    best = _of_likelier_sections(_with_lags(best, best.evaluation.bic + min(excess, 0.0)), foretold.orders)
    wandering = _through_lags_alone(foretold, limit=best.evaluation.bic)
    if wandering is None or wandering.evaluation.bic + _margin(wandering, foretold.free) >= best.evaluation.bic:
        return best
    return _of_likelier_sections(wandering, foretold.orders)


def _of_likelier_sections(best: Minimum, orders: Orders) -> Minimum:
    """The minimum without modes or real poles that stood for noise, where the orders are open."""
    if not orders.are_open:
        return best
    best = _of_fewer_modes(best)
    return _of_undriven_lags(best) if orders.real_poles is None else best


def _with_lags(best: Minimum, limit: float = np.inf) -> Minimum:
    """The minimum with lags that noise alone comes through, as long as the BIC falls: forces need not be white.

    None is looked for where the BIC is not likely to fall below some `limit`.
    """
    problem = best.evaluation.problem
    while len(best.evaluation.point.noise.lags) < _LAGS and _promises_lag(best.evaluation, limit):
        starts = (_lag_before(best.evaluation, rate, part) for rate, part in _COLOURS)
        end = min((followed(problem, start, _ROUGH, _FEW) for start in starts), key=lambda end: end.evaluation.bic)
        end = followed(problem, end.evaluation.point, steps=_STEPS)
        growth = max(0.0, float(best.evaluation.point.poles.real.max(initial=0.0)))
        if end.evaluation.bic >= best.evaluation.bic or np.any(end.evaluation.point.poles.real > growth):
            break  # through a pole that grows beside a zero, as fast, comes hardly any noise
        best = end
    return best


def _hidden_by_slow_poles(foretold: _Predictors, alone: float) -> Minimum | None:
    """The minimum in noise through lags alone, that only slow poles may have hidden; None without such poles."""
    if not _slow(foretold).any():
        return None
    return _through_lags_alone(foretold, foretold.bic_alone(alone) + TUNING.wandering)


def _through_lags_alone(foretold: _Predictors, limit: float = np.inf) -> Minimum | None:
    """The minimum in noise that comes through lags alone, as of sensors that wander; None where none is promised.

    Poles as slow as a record may stand for such noise: of an open number they are left out as well.
    """
    p, rows, slow = foretold.free.projection.p, foretold.rows, _slow(foretold)
    ends, by_speed = list[Minimum](), np.argsort(np.abs(p))
    for dropped in range(min(int(slow.sum()), len(p) - 1) + 1):
        start = _start(foretold.free, rows, np.delete(p, by_speed[:dropped]))
        if start is None:
            continue
        problem, point = start
        outputs = len(point.noise.C)
        noise = replace(point.noise, C=np.zeros((outputs, 0)), K=np.zeros((0, outputs)), apart=True)
        begin = replace(point, noise=noise)
        white = followed(problem, begin, _ROUGH, _FEW)
        if _is_hopeless(white.evaluation, limit) or not _promises_lag(white.evaluation, limit):
            continue
        # in white noise poles that are kept may become as slow as those that were dropped
        unmoved = Minimum(problem.evaluated(begin), converged=False, steps=0)
        ends += [_with_lags(each, limit) for each in (white, unmoved)]
        if 1 < outputs <= _LAGS:
            starts = [_each_wandering(white.evaluation, rate, part) for rate, part in _COLOURS]
            ends += [followed(problem, start, _ROUGH, _FEW) for start in starts]
    wandering = [end for end in ends if len(end.evaluation.point.noise.lags)]
    if not wandering:
        return None
    best = min(wandering, key=lambda end: end.evaluation.bic + _margin(end, foretold.free))
    return followed(best.evaluation.problem, best.evaluation.point, steps=_STEPS)


def _margin(end: Minimum, free: FreeFit) -> float:
    """What the BIC may be larger by, negative, in noise that wanders in place of slow poles.

    Integrals of inputs look like such noise, and the more so the more inputs there are.
    """
    point = end.evaluation.point
    return -TUNING.wandering if point.noise.apart and len(point.poles) < len(free.projection.p) else 0.0


def _each_wandering(white: LikelihoodEvaluation, rate: float, part: float) -> InnovationsModel:
    """The model with a lag for each output, of whose errors a part is foretold by past ones."""
    noise = white.point.noise
    for size, along in zip(np.sqrt(np.diag(white.covariance)), np.eye(white.p), strict=True):
        noise = _before(noise, rate, part, size, along)
    return replace(white.point, noise=noise)


def _before(noise: NoiseSections, rate: float, part: float, size: float, along: Array) -> NoiseSections:
    """The noise with a lag more before innovations of some size along a direction, of a rate for each sample."""
    return noise.with_lag(rate / noise.step, size * along, part * np.exp(-rate) / size * along)


def _slow(foretold: _Predictors) -> Mask:
    """Poles that a record may show as noise that wanders; none of a number that is given."""
    p = foretold.free.projection.p
    return np.asarray((np.abs(p) < TUNING.damped_apart * foretold.rows[0].bin) & foretold.orders.are_open)


def _promises_lag(evaluation: LikelihoodEvaluation, limit: float) -> bool:
    """Whether one step of the gains of a lag promises some of what the BIC asks for, or of what a `limit` does."""
    problem, outputs = evaluation.problem, evaluation.p
    needed = max(2 * outputs * np.log(problem.samples * outputs), evaluation.bic - limit)
    for rate in _RATES:
        begun = problem.evaluated(_lag_before(evaluation, rate, 0.0))
        if not np.isfinite(begun.cost):
            continue
        numbers = problem.numbers_before_shared(begun.point.noise) - outputs + np.arange(outputs)
        others = np.setdiff1d(np.arange(len(begun.normal[1])), numbers)
        if begun.promised(numbers, others) > _HINT * needed:
            return True
    return False


def _is_hopeless(evaluation: LikelihoodEvaluation, limit: float) -> bool:
    """Whether no noise of each output makes residuals so likely that other poles could bring the BIC below a limit."""
    values = evaluation.values
    cost, _ = _autoregressions(evaluation, float(np.log(values)))
    return cost + evaluation.unknowns * float(np.log(values)) > limit + TUNING.hopeless * values


def _lag_before(evaluation: LikelihoodEvaluation, rate: float, part: float) -> InnovationsModel:
    """The model with a lag more before the strongest innovations, of which past errors foretell a part."""
    values, vectors = np.linalg.eigh(evaluation.covariance)
    lag = _before(evaluation.point.noise, rate, part, np.sqrt(values[-1]), vectors[:, -1])
    return replace(evaluation.point, noise=lag)


def _damped(foretold: _Predictors, start: Start) -> Start:
    """A start whose modes decay within the record: in white noise those that forces move seem to decay more slowly.

    From modes that hardly decay no step of the gains leads to a predictor that forgets.
    """
    problem, point = start
    sections = _decaying(point.noise.sections, foretold.rows[0].bin)
    return _beside(foretold.free, foretold.rows, sections, None, problem.fed) or start


def _decaying(sections: Sections, least: float) -> Sections:
    """Sections none of which decays more slowly than at a rate."""
    decay = np.maximum(sections.decay, least)
    rates = np.maximum(sections.rates, least)
    return Sections.from_coordinates(np.concatenate([decay, decay**2 + sections.square, rates]))


@dataclass(frozen=True, eq=False)
class _Predictors:
    """Models to begin with, of a smallest to a largest number of modes, that predict best from the past of records."""

    free: FreeFit
    rows: Sequence[FreeRecord]
    orders: Orders

    @cached_property
    def _ranked(self) -> list[tuple[float, int, PredictorStates]]:
        """Predictors, those of the smallest BIC first; none where modes are known."""
        signals = signals_of(self.rows, len(self.free.scales)) if self.orders.most else None
        if signals is None:
            return []
        samples = sum(each.shape[1] for each in signals)
        return likeliest(predictors_of(signals, len(self.free.scales), _ROWS), samples, self.orders.states)

    @property
    def bic(self) -> float:
        """Smallest BIC, infinite if there is none."""
        return self._ranked[0][0] if self._ranked else np.inf

    def bic_alone(self, alone: float) -> float:
        """The BIC of the fit in noise of each output, of which twice the negative log-likelihood is given."""
        return alone + (self.free.unknowns + len(self.free.scales)) * float(np.log(_samples(self.rows)))

    @cached_property
    def starts(self) -> list[Start]:
        """Models of the likeliest predictors that have as many modes."""
        return list(islice(self.models(), _CLOSE))

    def models(self) -> Iterator[Start]:
        """Models of predictors that have as many modes, those of the smallest BIC first."""
        for _, size, predictor in self._ranked:
            noise = in_sections(*predictor.model(size), self.rows[0].hold.h, self.orders)
            if noise is None or not self.orders.admit(noise.sections.p):
                continue
            start = _beside(self.free, self.rows, noise.sections, noise, self._fed(size, predictor))
            if start is not None:
                yield start

    def _fed(self, states: int, predictor: PredictorStates) -> Mask | None:
        """What is fed through beside states: all, where present inputs foretell more than chance, or as was fitted."""
        fed = predictor.feeds_through(states, _samples(self.rows) // predictor.outputs)
        return None if fed else self.free.projection.fed


def _beside(
    free: FreeFit, rows: Sequence[FreeRecord], sections: Sections, noise: NoiseSections | None, fed: Mask | None
) -> Start | None:
    """The data and a model with some sections: what is driven as in white noise, and a noise, or no forces.

    None where the likelihood would take too long.
    """
    if not _is_feasible(rows, sections, len(free.scales)):
        return None
    projection = FreeProjection(rows, sections.p, fed, sections)
    experiments = in_bins(projection, free.channels)
    if experiments is None or projection.deficiency:
        return None
    problem = Problem(experiments, projection.excited_unknowns, fed=fed)
    begun = initial_noise(projection, rows[0].hold.h) if noise is None else noise
    model = InnovationsModel(begun, projection.shared, tuple(projection.own))
    return problem, model if noise is None else problem.driven_best(model)


def _shows_forces(free: FreeFit, rows: Sequence[FreeRecord], forced: Minimum, shared: Minimum | None) -> bool:
    """Whether the same modes without forces are far less likely, and all others by the BIC."""
    point = forced.evaluation.point
    start = _start(free, rows, point.poles)
    if start is None or not np.isfinite(forced.evaluation.cost):
        return False
    p, more = len(free.scales), point.noise.unknowns
    if shared is None:
        evaluation = replace_colour(start[0], False).evaluated(start[1])
        white, more = _alone(replace(free, noise=()), rows, evaluation), more + p * (p - 1) // 2
    else:
        white = followed(replace_colour(start[0], False), start[1], steps=_STEPS).evaluation.cost
    charge = more * float(np.log(forced.evaluation.problem.samples * p))
    gain = white - forced.evaluation.cost
    return gain > charge + 2 * _SURE and _is_likelier(white, forced.evaluation.cost, more)


def _own_noise(best: LikelihoodEvaluation, white: LikelihoodEvaluation | None) -> tuple[float, tuple[Array, ...]]:
    """By how much the BIC is larger in autoregressive noise of each output, and the innovations filters of that.

    It is the noise that a plant fitted in white noise leaves, or one fitted beside forces.  No filters where it is so
    much less likely that other poles make no difference.
    """
    problem, noise, p = best.problem, best.point.noise, best.p
    charge = float(np.log(problem.samples * p))
    unknowns = p * (p - 1) // 2 + (noise.unknowns if problem.coloured else 0)
    cost, filters = min(
        (_autoregressions(each, charge) for each in (white, best) if each is not None), key=lambda pair: pair[0]
    )
    excess = cost - best.cost - unknowns * charge
    return excess, filters if excess <= _FAR * problem.samples * p else ()


def _autoregressions(evaluation: LikelihoodEvaluation, charge: float) -> tuple[float, tuple[Array, ...]]:
    """Twice the negative log-likelihood of autoregressive noise of each output, with a charge, and its filters."""
    problem = evaluation.problem
    samples, shortest = problem.samples, min(experiment.samples for experiment in problem.experiments)
    most = min(_LONGEST_PAST, shortest // 4)
    products = np.zeros((evaluation.p, most + 1))
    for experiment, noise in zip(problem.experiments, evaluation.disturbances, strict=True):
        # without the constant, which slow noise can hardly be told from
        power = np.abs(noise) ** 2 * experiment.moving
        products += np.fft.irfft(power, experiment.samples)[:, : most + 1] * experiment.samples
    cost, filters = 0.0, list[Array]()
    for product in products:
        models, variances = autoregression(product, shortest)
        size = np.log(variances * product[0] / samples) + 1 + np.log(2 * np.pi)
        costs = samples * size + charge * np.arange(len(variances))
        cost += float(costs.min())
        filters.append(np.concatenate([[1.0], -models[int(np.argmin(costs))]]))
    return cost, tuple(filters)


def _of_fewer_modes(best: Minimum) -> Minimum:
    """The minimum without modes that stood for the noise, as long as the BIC falls."""
    while len(best.evaluation.point.noise.sections.x) > 2:
        fewer = [_without(best, k) for k in _doubtful(best)]
        if not fewer:
            break
        nearly = min(fewer, key=lambda minimum: minimum.evaluation.bic).evaluation
        likeliest = followed(nearly.problem, nearly.point, steps=_STEPS)
        likeliest = _with_lags(likeliest, best.evaluation.bic)
        if likeliest.evaluation.bic >= best.evaluation.bic:
            break
        best = likeliest
    return best


def _of_undriven_lags(best: Minimum) -> Minimum:
    """The minimum with first-order states that noise alone comes through in place of real poles, as the BIC falls."""
    while len(best.evaluation.point.noise.lags) < _LAGS:
        ends = [_driven_anew(best, noise) for noise in _undriven(best.evaluation.point.noise)]
        if not ends:
            break
        nearly = min(ends, key=lambda end: end.evaluation.bic).evaluation
        undriven = followed(nearly.problem, nearly.point, steps=_STEPS)
        if undriven.evaluation.bic >= best.evaluation.bic:
            break
        best = undriven
    return best


def _undriven(noise: NoiseSections) -> Iterator[NoiseSections]:
    """The noise where inputs do not drive the first-order section, or a pole of a heavily damped one."""
    k = noise.pairs
    if noise.apart:
        return
    if len(noise.sections.rates) and k:
        yield replace(noise, sections=Sections.from_coordinates(noise.sections.x[: 2 * k]), lags=noise.rates)
    heavy = noise.sections.decay > _HEAVY * np.sqrt(np.maximum(noise.sections.product, 0.0))
    for section in np.flatnonzero(heavy).tolist():
        yield from (noise.of_two_lags(section, driven) for driven in (0, 1))


def _doubtful(best: Minimum) -> list[int]:
    """Sections whose residues are few standard errors large: at most what the BIC charges for them."""
    evaluation = best.evaluation
    point, problem = evaluation.point, evaluation.problem
    covariance = evaluation.information_inverse()
    active, n = problem.active, len(point.poles)
    first = problem.numbers_before_shared(point.noise)
    numbers = np.full(active.shape, -1)
    numbers[active] = first + np.arange(int(active.sum()))
    charge = float(np.log(problem.samples * evaluation.p))
    inputs = problem.inputs
    width, doubtful = len(active) // inputs, []
    for k, places in enumerate(point.noise.sections.places.tolist()):
        rows = [width * i + part * n + place for i in range(inputs) for place in set(places) for part in (0, 1)]
        these = numbers[rows].ravel()
        values, these = point.shared[rows].ravel()[these >= 0], these[these >= 0]
        inner = covariance[np.ix_(these, these)]
        size = float(values @ np.linalg.pinv(inner, rcond=1e-10, hermitian=True) @ values)
        of_noise = 0 if point.noise.apart else 4 * evaluation.p
        if size < (2 + len(these) + of_noise) * charge:
            doubtful.append(k)
    return doubtful


def _without(best: Minimum, section: int) -> Minimum:
    """The minimum without a section."""
    noise = best.evaluation.point.noise
    k = len(noise.sections.decay)
    kept = np.delete(np.arange(len(noise.sections.x)), [section, k + section])
    states = np.arange(noise.states)
    states = states if noise.apart else np.delete(states, [2 * section, 2 * section + 1])
    fewer = replace(
        noise, sections=Sections.from_coordinates(noise.sections.x[kept]), C=noise.C[:, states], K=noise.K[states],
        references=np.delete(noise.references, section),
    )  # fmt: skip
    return _driven_anew(best, fewer)


def _driven_anew(best: Minimum, noise: NoiseSections) -> Minimum:
    """The minimum with other sections, what inputs drive of them as in white noise to begin with."""
    problem = best.evaluation.problem
    driven = FreeProjection(problem.rows, noise.sections.p, problem.fed, noise.sections)
    problem = Problem(problem.experiments, driven.excited_unknowns, problem.coloured, problem.fed)
    # the gains of others need not make a predictor
    noise = noise.that_forgets(best.evaluation.covariance)
    begin = problem.driven_best(InnovationsModel(noise, driven.shared, tuple(driven.own)))
    return followed(problem, begin, _ROUGH, _FEW)


def replace_colour(problem: Problem, coloured: bool) -> Problem:
    """The same data with noise that comes through the plant, or not."""
    return Problem(problem.experiments, problem.active, coloured, problem.fed)


def _rows(free: FreeFit) -> Sequence[FreeRecord] | None:
    """Rows of the data as they are; None where they do not allow the likelihood.

    In place of few missing samples are predictions, with lines from residual to residual: something to begin with.
    """
    if free.per_entry or free.rounding or free.interrupted or not free.states or free.method != "exact":
        return None
    projection = free.projection if free.measured is None else free.measured
    rows = [record for record in projection.experiments if isinstance(record, FreeRecord)]
    if not projection.inputs or len(rows) < len(projection.experiments):
        return None
    if any(np.mean(~record.observed) > MOST_MISSING for record in rows):
        return None
    if all(record.complete for record in rows):
        return rows
    filled = [
        record.filled_with(predicted + bridged(np.where(record.observed, record.measured - predicted, np.nan)))
        for record, predicted in zip(rows, projection.predictions(), strict=True)
    ]
    places = experiments_of(rows, free.channels)
    return [part for place in np.unique(places) for part in _together(list(compress(filled, places == place)))]


def _together(parts: Sequence[FreeRecord]) -> Sequence[FreeRecord]:
    """Outputs of an experiment that were observed at different samples in one record, where they are as late."""
    first = parts[0]
    if any((part.delay, part.late, part.length) != (first.delay, first.late, first.length) for part in parts[1:]):
        return parts
    y, outputs = np.concatenate([part.measured for part in parts]), np.concatenate([part.outputs for part in parts])
    missing = np.concatenate([part.filled for part in parts if part.filled is not None])
    order = np.argsort(outputs)
    return [
        replace(
            first, y=y[order], outputs=outputs[order], filled=missing[order], scale=None, steps=None, whole_record=None
        )
    ]


def _with_likeliest_samples(best: Minimum) -> Minimum:
    """The minimum with the likeliest values in place of missing samples, in its noise and for its model."""
    for _ in range(_ROUNDS):
        problem = _completed(best.evaluation)
        if problem is None:
            break
        best = followed(problem, best.evaluation.point, steps=_STEPS)
    return best


def _as_predicted(free: FreeFit, rows: Sequence[FreeRecord], orders: Orders) -> Sequence[FreeRecord]:
    """Rows with the values in place of missing samples that are likeliest by the predictors that are made from them."""
    for _ in range(_ROUNDS if any(part.filled is not None for part in rows) else 0):
        start = next(_Predictors(free, rows, orders).models(), None)
        problem = None if start is None else _completed(start[0].evaluated(start[1]))
        if problem is None:
            break
        rows = problem.rows
    return rows


def _completed(evaluation: LikelihoodEvaluation) -> Problem | None:
    """The data with the likeliest values in place of missing samples; None where they are hardly others."""
    experiments, moved = list[Experiment](), 0.0
    problem, noise, sizes = evaluation.problem, evaluation.point.noise, np.sqrt(np.diag(evaluation.covariance))
    for experiment, errors in zip(problem.experiments, evaluation.errors, strict=True):
        if experiment.missing is None:
            experiments.append(experiment)
            continue
        change = np.zeros(experiment.missing.shape)
        errors = np.fft.irfft(errors, experiment.samples) * np.sqrt(experiment.samples)
        change[experiment.missing] = noise.likeliest_change(errors, evaluation.covariance, experiment.missing)
        moved = max(moved, float(np.sum((change / sizes[:, None]) ** 2) / experiment.missing.sum()))
        parts = [part.filled_with(part.measured + change[part.outputs]) for part in experiment.rows]
        experiments.append(Experiment.of_rows(parts))
    if not moved > _SETTLED**2:
        return None
    return Problem(experiments, problem.active, problem.coloured, problem.fed)


def _start(free: FreeFit, rows: Sequence[FreeRecord], p: ComplexArray) -> Start | None:
    """The data and a model of some poles without forces; None where the likelihood would take too long.

    So it is where the data tell modes that hardly decay from those that do: noise through them never settles.
    """
    original, least = Sections.of(p), _LEAST_DECAY * rows[0].bin
    sections = _decaying(original, least)
    if np.any(-sections.p.real < 0.5 * least):
        return None
    begin = _beside(free, rows, sections, None, free.projection.fed)
    if begin is not None and np.any(sections.x != original.x):
        before, after = (FreeProjection(rows, each.p, free.projection.fed).loss for each in (original, sections))
        if after > (1 + 2 * TUNING.sure / _samples(rows)) * before:
            return None
    return begin


def _like(like: FreeFit | None, free: FreeFit, rows: Sequence[FreeRecord]) -> Start | None:
    """The data and a model with the poles and the noise of a fit beside forces, with as many of each, if it is one."""
    if like is None or like.beside is None or not like.beside.is_coloured:
        return None
    noise, scales, present = like.beside.sections, free.scales, Sections.of(free.projection.p)
    as_many = len(present.rates) == len(noise.sections.rates) and noise.sections.keeps_kinds(present)
    if not as_many or noise.step != rows[0].hold.h:
        return None
    noise = noise.moved(noise.sections, noise.C / scales[:, None], noise.K * scales)
    return _beside(free, rows, noise.sections, noise, like.projection.fed)


def _samples(rows: Sequence[FreeRecord]) -> int:
    """Samples of all outputs."""
    return sum(record.samples * len(record.outputs) for record in rows)


def _is_feasible(rows: Sequence[FreeRecord], sections: Sections, outputs: int) -> bool:
    """Whether the likelihood takes no more than seconds a step, and samples are many enough for its unknowns."""
    size, count = _unknowns(rows, sections, outputs), _samples(rows)
    return size <= _UNKNOWNS and size * count <= _NUMBERS and count >= _SPARE * size


def _unknowns(rows: Sequence[FreeRecord], sections: Sections, outputs: int) -> int:
    """Numbers of a model, at most."""
    n, inputs = len(sections.p), max(record.inputs for record in rows)
    own = sum(record.own_unknowns(n) * len(record.outputs) for record in rows)
    return len(sections.x) * (1 + 2 * outputs) + inputs * (2 * n + 1) * outputs + own


def in_bins(projection: FreeProjection, channels: Sequence[Recording]) -> list[Experiment] | None:
    """Records in Fourier bins, each with all outputs; None where some were not measured, or outputs begin apart."""
    experiments, rows = [], list(projection.experiments)
    for channel in channels:
        parts = list[FreeRecord]()
        while sum(len(part.outputs) for part in parts) < len(channel.output_labels):
            part = rows.pop(0) if rows else None
            if not isinstance(part, FreeRecord) or not part.complete:
                return None
            parts.append(part)
        if len({part.length for part in parts}) > 1:
            return None
        experiments.append(Experiment.of_rows(parts))
    return experiments


def initial_noise(projection: FreeProjection, step: float) -> NoiseSections:
    """Noise without forces, on sections whose states outputs see as they see the modes that inputs drive."""
    sections = projection.sections
    k, outputs = len(sections.decay), projection.shared.shape[1]
    shapes = np.linalg.svd(projection.residues, full_matrices=False)[0][:, :, 0]
    slow, fast = sections.places.T
    overdamped = (slow != fast)[:, None]
    C = np.zeros((outputs, 2 * k + len(sections.rates)))
    C[:, 0 : 2 * k : 2] = np.where(overdamped, shapes[slow].real + shapes[fast].real, shapes[fast].real).T
    C[:, 1 : 2 * k : 2] = np.where(overdamped, shapes[slow].real - shapes[fast].real, shapes[fast].imag).T
    C[:, 2 * k :] = shapes[sections.single].real.T
    return NoiseSections(sections, step, np.sqrt(np.abs(sections.square)), C, np.zeros(C.shape[::-1]))


def _alone(free: FreeFit, rows: Sequence[FreeRecord], white: LikelihoodEvaluation | None) -> float:
    """Twice the negative log-likelihood of noise of each output alone, in the units of the rows."""
    if free.noise or white is None:
        samples = _samples(rows) // len(free.scales)
        return -2 * (free.criteria.loglik + samples * float(np.sum(np.log(free.scales))))
    return float(white.problem.samples * np.sum(np.log(np.diag(white.covariance)) + 1 + np.log(2 * np.pi)))


def _are_correlated(white: LikelihoodEvaluation) -> bool:
    """Whether residuals of different outputs go together at the same sample."""
    determinant = np.linalg.slogdet(_correlations(white.covariance))[1]
    return bool(chdtrc(white.p * (white.p - 1) // 2, -white.problem.samples * determinant) < _SCREEN)


def _correlations(covariance: Array) -> Array:
    sizes = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(sizes, sizes))


def _hints_at_forces(foretold: _Predictors, alone: float, white: LikelihoodEvaluation | None) -> bool:
    """Whether one step of the gains, all other numbers moving along, promises some of what the BIC asks for.

    Where the residuals about no mode are unlike white noise, or poles leave no likelihood, a predictor has to be
    likelier than the fit in noise of each output `alone`, too.
    """
    predicts = foretold.bic_alone(alone)
    if white is None:
        return foretold.bic < predicts
    problem, noise = white.problem, white.point.noise
    charge = noise.unknowns * float(np.log(problem.samples * white.p))
    evaluation = replace_colour(problem, True).evaluated(white.point)
    # what was fitted leaves errors that look like forces: that costs another pass
    if not all(
        ratio > _HINT * charge and chdtrc(noise.K.size, ratio) < _SCREEN
        for ratio in (_score(evaluation, allowing=allowing) for allowing in (False, True))
    ):
        return False
    return missing_mode(white, _NOTED * charge / max(1, noise.pairs)) is not None or foretold.bic < predicts


def _score(evaluation: LikelihoodEvaluation, *, allowing: bool) -> float:
    """Twice the log-likelihood that one step of the gains promises beside white noise, all others moving along.

    Beyond what it promises in white noise itself, if `allowing` for what was fitted: numbers as the motion in which a
    record begins leave errors that look as if noise came through modes that last as long as the record.
    """
    noise = evaluation.point.noise
    first, end = len(noise.x) + noise.C.size, evaluation.problem.numbers_before_shared(noise)
    others = np.append(np.arange(len(noise.x)), np.arange(end, len(evaluation.normal[1])))

    def chance(among: Array) -> Array:
        return evaluation.expected_slope_of_gains(others, among).ravel()

    return evaluation.promised(np.arange(first, end), others, chance if allowing else None)


def _is_likelier(before: float, after: float, more: int) -> bool:
    """Whether so many numbers more gain what they hardly do by chance."""
    return bool(np.isfinite(after) and chdtrc(more, max(0.0, before - after)) < _LEVEL)


def _in_noise(free: FreeFit, best: Minimum, alone: float, certain: bool) -> FreeFit:
    """The fit in a noise, and what is told of it."""
    evaluation = best.evaluation
    point, samples, p = evaluation.point, evaluation.problem.samples, len(free.scales)
    noise = FittedNoise.of(evaluation, free.scales)
    if np.linalg.eigvalsh(noise.correlations).min() < _SINGULAR:
        return free
    projection = FreeProjection(evaluation.problem.rows, point.poles, evaluation.problem.fed, point.noise.sections)
    unknowns = projection.unknowns + noise.unknowns
    joint = JointProjection.of(projection, point.shared, Quadratic.of(best), unknowns)
    # what foretells the rounding of outputs is no likelier for that
    floors = np.maximum(1.0, ROUNDED * projection.rounded / (samples * np.diag(evaluation.covariance)))
    loglik = -0.5 * evaluation.cost - samples * float(np.sum(np.log(free.scales * np.sqrt(floors))))
    criteria = Criteria.of(loglik, unknowns + p, float(samples * p))
    if not certain and free.criteria.bic <= criteria.bic + _margin(best, free) and (free.noise or noise.is_coloured):
        return free
    finding = _finding(free, noise, evaluation, 0.5 * (alone - evaluation.cost))
    of_noise = (
        Cause.COLOURED_NOISE, Cause.INPUT_NOISE, Cause.COLOURED_RESIDUALS, Cause.FORCES, Cause.CORRELATED_NOISE,
    )  # fmt: skip
    others = tuple(each for each in free.findings if each.cause not in of_noise)
    return replace(
        free, projection=joint, unknowns=unknowns, criteria=criteria, findings=(*others, finding), measured=None,
        noise=(), beside=noise, delay_open=free.delay_open and bool(free.delay.any()),
    )  # fmt: skip


def _finding(free: FreeFit, noise: FittedNoise, evaluation: LikelihoodEvaluation, gain: float) -> Finding:
    """What is told of the noise: of forces their share of each output, or which outputs share noise."""
    labels = free.channels[0].output_labels
    if noise.sections.apart:
        seen = noise.sections.C**2 / np.diag(noise.covariance)[:, None]
        alone = [label for label, of_it in zip(labels, seen, strict=True) if np.all(of_it > _MOST * seen.sum(axis=0))]
        return Finding(Cause.SLOW_NOISE, tuple(noise.sections.lags.tolist()), gain, next(iter(alone), ""))
    if noise.is_coloured:
        squares, noises = np.zeros((2, len(labels)))
        for experiment, disturbance in zip(evaluation.problem.experiments, evaluation.disturbances, strict=True):
            moving = experiment.counts * experiment.moving
            squares += np.abs(experiment.Y) ** 2 @ moving
            noises += np.abs(disturbance) ** 2 @ moving
        return Finding(Cause.FORCES, tuple(np.sqrt(noises / squares).tolist()), gain)
    apart = np.triu(noise.correlations, 1)
    a, b = np.unravel_index(int(np.argmax(np.abs(apart))), apart.shape)
    return Finding(Cause.CORRELATED_NOISE, (float(apart[a, b]),), gain, f"{labels[a]}, {labels[b]}")
