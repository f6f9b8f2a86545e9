"""What a covariance says of a model: intervals, draws, and bands of responses computed from the draws.

Bands are percentiles over models drawn from that distribution.  Near a pole the gain is no linear function of the
frequency, not even approximately: an error of `d` moves the pole across, and a linearised band is wrong there at any
noise level.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from scipy.special import log_ndtr, ndtri_exp, stdtrit

from ... import _checks
from ..._frozen import Frozen, ReadOnlyMapping
from ..._types import Array, ArrayLike, Mask, RandomSource, RealOrComplex
from ...exceptions import StructureError

_MOST = 10**9  # draws
_BLOCK = 1 << 17  # entries of a (point x sample) table held at once
_ROUNDS = 100  # of k draws each, before a sampler that needs no luck takes over
_SWEEPS = 100  # of that sampler; a start in the worst corner is forgotten after a third of them
_OUT_OF_REACH = 40.0  # standard deviations that no draw ever takes


def normal_interval(
    value: ArrayLike, stderr: ArrayLike, level: float, *, lower: ArrayLike = -np.inf, dof: float = np.inf
) -> Array:
    """Two-sided confidence interval of estimates with known standard errors.

    Parameters
    ----------
    value, stderr : array_like, shape (...)
        Estimates and their standard errors: NaN for what was held, infinite for what is not known at all.
    level : float
        Probability of the interval, between 0 and 1.
    lower : array_like, shape (...)
        Where an interval is cut off, because the parameter cannot be less.
    dof : float
        Degrees of freedom of the noise variance, for Student's t; the normal distribution by default.

    Returns
    -------
    ndarray, shape (..., 2)
        Lower and upper ends; NaN where `stderr` is.

    Raises
    ------
    StructureError
        If the level is not between 0 and 1.

    Notes
    -----
    Cutting off does not change how often the interval covers a parameter that respects the bound.  O(1) each.

    Examples
    --------
    >>> from ph_control.identification.uncertainty.draws import normal_interval
    >>> normal_interval([1.0, 0.1], [0.1, 0.1], 0.95, lower=0.0).round(3)
    array([[0.804, 1.196],
           [0.   , 0.296]])
    """
    centre, half = np.asarray(value, float), -stdtrit(dof, tail_of(level)) * np.asarray(stderr, float)
    ends = np.stack(np.broadcast_arrays(centre - half, centre + half), axis=-1)
    return np.maximum(ends, np.asarray(lower, float)[..., None])


def intervals(
    values: Mapping[str, Any], errors: Mapping[str, Any], level: float, lower: Mapping[str, float], dof: float
) -> ReadOnlyMapping:
    """Confidence intervals of estimates by name; of complex ones those of real and imaginary parts."""

    def ends(name: str, part: Callable[[RealOrComplex], RealOrComplex]) -> Array:
        return normal_interval(part(values[name]), part(errors[name]), level, lower=lower.get(name, -np.inf), dof=dof)

    return ReadOnlyMapping(
        {
            name: ends(name, np.real) + 1j * ends(name, np.imag) if np.iscomplexobj(value) else ends(name, np.real)
            for name, value in values.items()
        }
    )


def tail_of(level: object) -> float:
    """Probability on either side of a two-sided interval of the given level."""
    return 0.5 * (1 - _checks.level("level", level))


def draw(
    mean: ArrayLike, covariance: ArrayLike, k: int, rng: RandomSource = None, *, nonnegative: ArrayLike | None = None,
    positive: ArrayLike | None = None,
) -> Array:  # fmt: skip
    """Draw from a normal distribution restricted to what the parameters may be.

    Parameters
    ----------
    mean : array_like, shape (N,)
        Estimate; it respects the restrictions.
    covariance : array_like, shape (N, N)
        Its covariance, singular or not; rows and columns of NaN belong to components that are held at their mean.
    k : int
        Number of draws.
    rng : numpy.random.Generator or int, optional
        Random numbers, or a seed of them; fresh ones by default.
    nonnegative, positive : array_like of bool, shape (N,), optional
        Components that cannot be negative, and those that stay above the last digit of their mean.

    Returns
    -------
    ndarray, shape (k, N)
        Independent draws, one a row.

    Raises
    ------
    StructureError
        If `k` or `rng` is wrong.

    Notes
    -----
    The covariance is scaled to correlations and factored by its eigenvectors; eigenvalues at rounding level are
    directions without variance.  Draws that violate a restriction are drawn again, which is exact; only the restricted
    components within 40 standard deviations of their bound take part.  What is missing after 100 k draws, as with
    weights of which only the sum is known, comes from Gibbs chains: one for each, 100 sweeps from a draw that was
    accepted, along the principal axes of these components and along each component alone, every move an exact draw
    from a normal distribution on an interval.  O(N^3 + k N^2), and O(k q^2) a round or sweep with q such components.

    Examples
    --------
    >>> from ph_control.identification.uncertainty.draws import draw
    >>> x = draw([0.1, 5.0], [[1.0, 0.5], [0.5, 1.0]], 1000, 0, nonnegative=[True, False])
    >>> x.shape, bool(x[:, 0].min() >= 0)
    ((1000, 2), True)
    """
    centre, (count, random) = np.asarray(mean, float), draws_from(k, rng)
    weak, strict = (np.asarray(False if mask is None else mask) for mask in (nonnegative, positive))
    bound = np.where(strict, _checks.EPS * centre, np.where(weak, 0.0, -np.inf))
    free, scale, factor = _factor(np.asarray(covariance, float))
    slack = (centre[free] - bound[free]) / scale
    draws = np.repeat(centre[None, :], count, axis=0)
    draws[:, free] = np.maximum(centre[free] + scale * _correlated(factor, slack, count, random), bound[free])
    return draws


def draws_from(k: object, rng: RandomSource) -> tuple[int, np.random.Generator]:
    """Check how many draws are wanted, and from where."""
    return _checks.whole_number("k", k, 0, _MOST), _checks.random_generator(rng)


def _factor(covariance: Array) -> tuple[Mask, Array, Array]:
    """Which components vary, their standard deviations (N,), and `F` (N, p) with `F F^T` their correlation."""
    variance = np.diag(covariance)
    free = (variance > 0) & np.isfinite(variance)
    scale = np.sqrt(variance[free])
    correlation = covariance[np.ix_(free, free)] / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
    kept = values > len(values) * _checks.EPS * values.max(initial=0.0)
    return free, scale, vectors[:, kept] * np.sqrt(values[kept])


def _correlated(factor: Array, slack: Array, count: int, random: np.random.Generator) -> Array:
    """Draws `F z` with `z` standard normal, restricted to `F z + slack >= 0`."""
    near = slack < _OUT_OF_REACH
    # coordinates of z, turned so that the restricted components depend on the first few alone
    U, sigma, Vh = np.linalg.svd(factor[near], full_matrices=True)
    few = int((sigma > max(factor.shape) * _checks.EPS * sigma.max(initial=0.0)).sum())
    normals = U[:, :few] * sigma[:few]
    z = np.empty((count, factor.shape[1]))
    z[:, :few] = _inside(normals, slack[near], count, random)
    z[:, few:] = random.standard_normal((count, factor.shape[1] - few))
    return z @ (factor @ Vh.T).T


def _inside(normals: Array, slack: Array, count: int, random: np.random.Generator) -> Array:
    """Standard normal vectors with `normals @ z + slack >= 0`: drawn again, or by `_gibbs`."""
    size = normals.shape[1]
    accepted, batch = np.empty((0, size)), max(count, 256)
    for _ in range(_ROUNDS if count else 0):
        z = random.standard_normal((batch, size))
        accepted = np.concatenate([accepted, z[(z @ normals.T + slack >= 0).all(axis=1)]])
        if len(accepted) >= count:
            return accepted[:count]
    starts = accepted if len(accepted) else np.zeros((1, size))
    chosen = random.integers(len(starts), size=count - len(accepted))
    return np.concatenate([accepted, _gibbs(normals, slack, starts[chosen], random)])


def _gibbs(normals: Array, slack: Array, z: Array, random: np.random.Generator) -> Array:
    """Gibbs chains from the rows of `z`, side by side: moves along the axes and along each restricted component."""
    alone = np.linalg.pinv(normals).T
    directions = np.concatenate([np.eye(z.shape[1]), alone / np.linalg.norm(alone, axis=1, keepdims=True)])
    slopes = directions @ normals.T
    for _ in range(_SWEEPS if len(z) else 0):
        room = np.maximum(z @ normals.T + slack, 0.0)
        for direction, slope in zip(directions, slopes, strict=True):
            with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
                reach = -room / slope
            low = np.where(slope > 0, reach, -np.inf).max(axis=1)
            high = np.where(slope < 0, reach, np.inf).min(axis=1)
            step = _normal_between(low, high, -z @ direction, random)
            z = z + step[:, None] * direction
            room = np.maximum(room + step[:, None] * slope, 0.0)
    return z


def _normal_between(low: Array, high: Array, centre: Array, random: np.random.Generator) -> Array:
    """Normal numbers of variance 1 around `centre`, between `low` and `high`."""
    a, b = low - centre, high - centre
    # in the lower tail, where the logarithm of the distribution function keeps its digits
    flipped = a + b > 0
    a, b = np.where(flipped, -b, a), np.where(flipped, -a, b)
    u = random.random(len(a))
    bottom, top = log_ndtr(a), log_ndtr(b)
    with np.errstate(divide="ignore", invalid="ignore"):
        x = ndtri_exp(top + np.log(u + (1 - u) * np.exp(bottom - top)))
        # on an interval so short the density is constant, and the distribution function has no digits for it
        x = np.where((b - a) * (1 + np.maximum(np.abs(a), np.abs(b))) < _checks.EPS**0.5, a + u * (b - a), x)
    return np.clip(np.where(flipped, -x, x) + centre, low, high)


class Draws(Frozen):
    """Models drawn from the distribution of an estimate, and percentiles over them."""

    @property
    def natural_frequencies(self) -> Array:
        """Natural frequencies, shape (k, n), rad per unit time."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"{type(self).__name__}({len(self)} draws of {self.natural_frequencies.shape[1]} modes)"

    def __len__(self) -> int:
        return len(self.natural_frequencies)

    def _blocks(self, name: str, points: ArrayLike, at_once: int) -> Iterator[Array]:
        """Points in turn, so many of them that tables with these entries at each stay small."""
        grid = _checks.real_array(name, points, 1)
        _checks.in_range(name, grid)
        size = max(1, _BLOCK // max(1, at_once))
        return (grid[k : k + size] for k in range(0, len(grid), size))

    def _percentiles(self, tables: Iterator[Array], level: float) -> Array:
        """Ends of a band, shape (2, K), of tables (points, k) one after the other."""
        tail = tail_of(level)
        if not len(self):
            raise StructureError("there are no samples, so they have no percentiles; draw at least one")
        return np.concatenate([np.empty((2, 0)), *(_percentiles(table, tail) for table in tables)], axis=1)


def _percentiles(table: Array, tail: float) -> Array:
    """Percentiles of each row, shape (2, rows), between neighbours linear; between a number and infinity infinite."""
    place = (table.shape[1] - 1) * np.array([tail, 1 - tail])
    below, above = np.floor(place).astype(int), np.ceil(place).astype(int)
    table.partition(np.unique([below, above]), axis=1)
    low, high = table[:, below], table[:, above]
    with np.errstate(invalid="ignore"):
        between = low + (place - below) * (high - low)
    return np.where(low == high, low, between).T
