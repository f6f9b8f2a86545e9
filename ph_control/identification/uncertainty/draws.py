"""What a covariance says of a model: intervals, draws, and bands of responses computed from the draws.

Bands are percentiles over models drawn in `(d, r)`.  Near a pole the gain is no linear function of the frequency, not
even approximately: an error of `d` moves the pole across, and a linearised band is wrong there at any noise level.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.special import log_ndtr, ndtri_exp, stdtrit

from ... import _checks
from ..._frozen import Frozen, ReadOnlyMapping
from ..._types import Array, ArrayLike, ComplexArray, Mask
from ...exceptions import StructureError
from ...modal.modal_form import ModalForm, from_frequencies, imaginary
from ...modal.reactance import sum_with_twice_the_digits
from ...numerics import double_double as tf

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

    def ends(name: str, part: Callable[[Any], Any]) -> Array:
        return normal_interval(part(values[name]), part(errors[name]), level, lower=lower.get(name, -np.inf), dof=dof)

    return ReadOnlyMapping(
        {
            name: ends(name, np.real) + 1j * ends(name, np.imag) if np.iscomplexobj(value) else ends(name, np.real)
            for name, value in values.items()
        }
    )


def tail_of(level: Any) -> float:
    """Probability on either side of a two-sided interval of the given level."""
    return 0.5 * (1 - _checks.level("level", level))


def draw(
    mean: ArrayLike, covariance: ArrayLike, k: int, rng: Any = None, *, nonnegative: Any = None, positive: Any = None
) -> Array:
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


def draws_from(k: Any, rng: Any) -> tuple[int, np.random.Generator]:
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
    left, sigma, right = np.linalg.svd(factor[near], full_matrices=True)
    few = int((sigma > max(factor.shape) * _checks.EPS * sigma.max(initial=0.0)).sum())
    normals = left[:, :few] * sigma[:few]
    z = np.empty((count, factor.shape[1]))
    z[:, :few] = _inside(normals, slack[near], count, random)
    z[:, few:] = random.standard_normal((count, factor.shape[1] - few))
    return z @ (factor @ right.T).T


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
        at = _checks.real_array(name, points, 1)
        _checks.in_range(name, at)
        size = max(1, _BLOCK // max(1, at_once))
        return (at[k : k + size] for k in range(0, len(at), size))

    def _percentiles(self, tables: Iterator[Array], level: float) -> Array:
        """Ends of a band, shape (2, K), of tables (points, k) one after the other."""
        tail = tail_of(level)
        if not len(self):
            raise StructureError("there are no samples, so they have no percentiles; draw at least one")
        return np.concatenate([np.empty((2, 0)), *(_percentiles(table, tail) for table in tables)], axis=1)


@dataclass(frozen=True, eq=False, repr=False)
class ModeSamples(Draws):
    """Models drawn by `LosslessResult.sample` from the distribution of an estimate, and the bands of their responses.

    Attributes
    ----------
    d, r : ndarray, shape (k, n)
        Natural frequencies, rad per unit time, and weights: one draw a row, one mode of the estimate a column.  Where
        modes are close a row of `d` need not ascend.
    initial_state : ndarray, shape (k, s)
        Initial states that go with them; s is 0 where there are none.

    Notes
    -----
    `len(samples)` is k, `samples[i]` the modal form of draw i.  Bands are pointwise: at each frequency or instant
    alone they hold the given share of the draws, their ends interpolated between neighbouring draws.  Of the share
    beyond an end, `p = (1 - level)/2`, seeds differ by about `sqrt(p/k)`: 2.5 ± 0.5 % for 1000 draws and level 0.95.
    """

    d: Array
    r: Array
    initial_state: Array = field(default=None)  # type: ignore[arg-type]

    def __post_init__(self) -> None:
        d = _checks.real_array("d", self.d, 2)
        given = np.empty((len(d), 0)) if self.initial_state is None else self.initial_state
        for name, value in (("d", d), ("r", self.r), ("initial_state", given)):
            object.__setattr__(self, name, _checks.readonly(_checks.real_array(name, value, 2)))
            _checks.in_range(name, getattr(self, name))
        shapes = self.d.shape, self.r.shape, self.initial_state.shape
        if shapes[0] != shapes[1] or shapes[2][0] != shapes[0][0]:
            raise StructureError(f"d, r, initial_state have shapes {shapes}; expected (k, n), (k, n), (k, s)")
        if (self.d <= 0).any() or (self.r < 0).any():
            raise StructureError(f"the least of d is {self.d.min():.3g}, of r {self.r.min():.3g}; allowed > 0, >= 0")

    @property
    def natural_frequencies(self) -> Array:
        """Natural frequencies `d`, shape (k, n), rad per unit time."""
        return self.d

    def __getitem__(self, index: int) -> ModalForm:
        if not -len(self) <= _checks.whole_number("index", index) < len(self):
            raise IndexError(f"sample {index} of {len(self)}")
        return from_frequencies(self.d[index], self.r[index])

    @property
    def modes(self) -> Iterator[ModalForm]:
        """Modal forms of the draws, one after the other."""
        return (self[i] for i in range(len(self)))

    def freqresp(self, omega: ArrayLike) -> ComplexArray:
        """Frequency response of every draw.

        Parameters
        ----------
        omega : array_like, shape (K,)
            Angular frequencies, rad per unit time.

        Returns
        -------
        ndarray, shape (k, K)
            `G(i omega) = sum_l r_l d_l i omega / (d_l^2 - omega^2)`; infinite at a pole.

        Raises
        ------
        StructureError
            If `omega` is not a vector of finite numbers.

        Notes
        -----
        Exactly imaginary, and right to 1e-13 relative next to poles and zeros, as `ModalForm.freqresp`.  O(k K n).

        Examples
        --------
        >>> from ph_control import ModeSamples
        >>> samples = ModeSamples([[2.0], [3.0]], [[0.5], [0.5]])
        >>> len(samples), samples[1]
        (2, modes([3.0], [0.5]))
        >>> samples.freqresp([0.0, 1.0])
        array([[0.+0.j        , 0.+0.33333333j],
               [0.+0.j        , 0.+0.1875j    ]])
        """
        X = self._reactance(_checks.real_array("omega", omega, 1)).T
        return np.where(np.isinf(X), complex(np.inf, 0.0), imaginary(X))

    def magnitude_band(self, omega: ArrayLike, level: float = 0.95) -> Array:
        """Band of the gain: percentiles of `|G(i omega)|` over the draws.

        Parameters
        ----------
        omega : array_like, shape (K,)
            Angular frequencies, rad per unit time.
        level : float
            Share of the draws inside, between 0 and 1.

        Returns
        -------
        ndarray, shape (2, K)
            Lower and upper end.

        Raises
        ------
        StructureError
            If `omega` is not a vector of finite numbers, the level is not between 0 and 1, or there are no draws.

        Notes
        -----
        Where the draws have their pole on both sides of a frequency the upper end is large but finite: the gain at the
        distance from a pole that only `(1 - level)/2` of the draws fall below.  It is infinite where so many
        have a pole at that very frequency, as all do where `d` has no variance.  Across a zero the lower end dips
        towards 0 in the same way.  O(k K n); memory of O(k n) and a block.

        Examples
        --------
        >>> from ph_control import ModeSamples
        >>> samples = ModeSamples([[2.0], [2.0], [2.0]], [[0.9], [1.0], [1.1]])
        >>> samples.magnitude_band([1.0, 2.0], level=0.9)
        array([[0.60666667,        inf],
               [0.72666667,        inf]])
        """
        return self._band("omega", omega, lambda w: np.abs(self._reactance(w)), level)

    def phase_band(self, omega: ArrayLike, level: float = 0.95) -> Array:
        """Band of the phase, in degrees: one value where the sign is sure, from -90 to +90 where it is not.

        Parameters
        ----------
        omega, level
            As in `magnitude_band`.

        Returns
        -------
        ndarray, shape (2, K)
            (90, 90) or (-90, -90) where at most `(1 - level)/2` of the draws have the other sign, else (-90, 90).

        Raises
        ------
        StructureError
            As `magnitude_band`.

        Notes
        -----
        A lossless system answers a sine a quarter of a period ahead or behind, and nothing between.  Between a pole
        and a zero that is known exactly, however large the errors of the estimate: the band is open only where the
        draws have a pole or zero on both sides.  At a pole or zero itself the sign is that just above.

        Examples
        --------
        >>> from ph_control import ModeSamples
        >>> ModeSamples([[1.9], [2.0], [2.1], [2.2]], [[1.0]] * 4).phase_band([1.0, 2.0, 3.0])
        array([[ 90., -90., -90.],
               [ 90.,  90., -90.]])
        """
        # reactances only rise: above a zero they are positive, above a pole negative
        low, high = self._band(
            "omega", omega, lambda w: np.where((0 <= (X := self._reactance(w))) & (X < np.inf), 90.0, -90.0), level
        )
        return np.where([low < 90, high <= -90], -90.0, 90.0)

    def step_band(self, time: ArrayLike, level: float = 0.95) -> Array:
        """Band of the response to a unit step: percentiles of `sum_l r_l sin(d_l t)` over the draws.

        Parameters
        ----------
        time : array_like, shape (K,)
            Instants, in any order; before 0, when the step comes, the response is 0.
        level : float
            Share of the draws inside, between 0 and 1.

        Returns
        -------
        ndarray, shape (2, K)
            Lower and upper end.

        Raises
        ------
        StructureError
            If `time` is not a vector of finite numbers, the level is not between 0 and 1, or there are no draws.

        Notes
        -----
        The phase error of a mode grows with time: from about `t = 3/stderr(d)` on the band fills its whole amplitude.
        Each `d t` is formed to twice the digits, so each response is right to a few units in the last place of
        `sum r`.  O(k K n); memory of O(k n) and a block.

        Examples
        --------
        >>> from ph_control import ModeSamples
        >>> ModeSamples([[1.0]] * 3, [[0.9], [1.0], [1.1]]).step_band([0.0, 1.5707963], level=0.9)
        array([[0.  , 0.91],
               [0.  , 1.09]])
        """
        return self._band("time", time, lambda t: self._oscillations(t, self.r, np.sin), level)

    def impulse_band(self, time: ArrayLike, level: float = 0.95) -> Array:
        """Band of the response to a unit impulse: percentiles of `sum_l r_l d_l cos(d_l t)` over the draws.

        Parameters
        ----------
        time, level
            As in `step_band`.

        Returns
        -------
        ndarray, shape (2, K)
            Lower and upper end.

        Raises
        ------
        StructureError
            As `step_band`.

        Examples
        --------
        >>> from ph_control import ModeSamples
        >>> ModeSamples([[2.0]] * 3, [[0.9], [1.0], [1.1]]).impulse_band([0.0], level=0.9)
        array([[1.82],
               [2.18]])
        """
        return self._band("time", time, lambda t: self._oscillations(t, self.r * self.d, np.cos), level)

    def _band(self, name: str, points: ArrayLike, values: Callable[[Array], Array], level: float) -> Array:
        return self._percentiles(map(values, self._blocks(name, points, len(self))), level)

    def _reactance(self, w: Array) -> Array:
        """`G(i w)/i` of every draw, shape (K, k): at a pole infinite, and twice the digits where terms cancel."""
        x = w[:, None]
        value, weight = np.zeros((2, len(w), len(self)))
        infinite = np.zeros(value.shape, bool)
        for d, r in zip(self.d.T, self.r.T, strict=True):
            at_pole = np.abs(x) == d
            infinite |= at_pole & (r > 0)
            down, up = (np.where(at_pole, 1.0, d + sign * x) for sign in (-1, 1))
            # (d - w)(d + w) keeps the digits next to the pole; one factor after the other stays in range
            term = np.where(at_pole, 0.0, d * r * (x / up) / down)
            value += term
            weight += np.abs(term)
        i, j = np.nonzero((weight > 8 * np.abs(value)) & ~infinite)
        d, r = self.d[j].T, self.r[j].T
        value[i, j] = sum_with_twice_the_digits(d, tf.two_prod(d, r), w[i])
        return np.where(infinite, np.inf, value)

    def _oscillations(self, time: Array, amplitudes: Array, wave: np.ufunc) -> Array:
        """`sum_l amplitudes_l sin(d_l t)`, or cosines, of every draw, shape (K, k); 0 before 0."""
        value = np.zeros((len(time), len(self)))
        for d, amplitude in zip(self.d.T, amplitudes.T, strict=True):
            phase, rest = tf.two_prod(d, time[:, None])
            value += amplitude * (wave(phase) + rest * (np.cos(phase) if wave is np.sin else -np.sin(phase)))
        return np.where(time[:, None] < 0, 0.0, value)


def _percentiles(table: Array, tail: float) -> Array:
    """Percentiles of each row, shape (2, rows), between neighbours linear; between a number and infinity infinite."""
    place = (table.shape[1] - 1) * np.array([tail, 1 - tail])
    below, above = np.floor(place).astype(int), np.ceil(place).astype(int)
    table.partition(np.unique([below, above]), axis=1)
    low, high = table[:, below], table[:, above]
    with np.errstate(invalid="ignore"):
        between = low + (place - below) * (high - low)
    return np.where(low == high, low, between).T
