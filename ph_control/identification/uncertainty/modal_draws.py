"""Models drawn from the distribution of an estimate, and the bands of their responses."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from ... import _checks
from ..._types import Array, ArrayLike, ComplexArray, Numbers
from ...exceptions import StructureError
from ..regression.prediction import ResponseBackground
from .draws import Draws


@dataclass(frozen=True, eq=False, repr=False)
class ModalSamples(Draws):
    """Models drawn by `PEMResult.sample`, and the bands of their responses from each input to each output.

    Attributes
    ----------
    poles : ndarray of complex, shape (k, N)
        Those of positive imaginary part, then real ones: one draw a row, one pole of the estimate a column.
    residues : ndarray of complex, shape (k, N, p, m)
        At these poles.
    feedthrough : ndarray, shape (k, p, m)
        Responses at infinity.
    shapes : ndarray of complex, shape (k, n, p)
        Mode shapes, scaled as those of the result.
    background : ResponseBackground or None
        What bands of gain and phase have beside the modes: that of the estimate.
    delay : ndarray, shape (p,)
        Delay of each output, which bands of the phase and of responses in time have: that of the estimate.
    input_delay : ndarray, shape (m,)
        Dead time of each input, likewise.

    Notes
    -----
    `len(samples)` is k.  Bands are pointwise percentiles over the draws, their ends interpolated
    between neighbouring draws.  Of the share beyond an end, `p = (1 - level)/2`, seeds differ by about `sqrt(p/k)`.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> rng, plant = np.random.default_rng(0), phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]))
    >>> u = rng.standard_normal(400)
    >>> y = phc.forced_response(plant, 0.1 * np.arange(400), u, intersample="zoh").outputs
    >>> y = y + 0.01 * rng.standard_normal(400)
    >>> models = phc.pem((u, y), dt=0.1).sample(100, rng=1)
    >>> len(models), models.poles.shape, models.residues.shape
    (100, (100, 2), (100, 2, 1, 1))
    """

    poles: ComplexArray
    residues: ComplexArray
    feedthrough: Array
    shapes: ComplexArray
    background: ResponseBackground | None = None
    delay: Array = field(default_factory=lambda: np.zeros(1))
    input_delay: Array = field(default_factory=lambda: np.zeros(1))

    def __post_init__(self) -> None:
        for name, ndim in (("poles", 2), ("residues", 4), ("shapes", 3)):
            object.__setattr__(self, name, _complex_array(name, getattr(self, name), ndim))
        object.__setattr__(self, "feedthrough", _checks.real_array("feedthrough", self.feedthrough, 3))
        k, n, p, m = self.residues.shape
        modes = int(np.sum(self.poles[0].imag != 0)) if k and self.poles.size else self.shapes.shape[1]
        actual = self.poles.shape, self.feedthrough.shape, self.shapes.shape
        if actual != ((k, n), (k, p, m), (k, modes, p)):
            raise StructureError(
                f"poles, feedthrough, shapes have shapes {actual}; expected {(k, n)}, {(k, p, m)}, {(k, modes, p)}"
            )
        for name, count in (("delay", p), ("input_delay", m)):
            object.__setattr__(self, name, np.array(np.broadcast_to(getattr(self, name), count), float))
        super().__post_init__()

    @property
    def natural_frequencies(self) -> Array:
        """Natural frequencies `|p|` of the modes, shape (k, n), rad per unit time."""
        return np.abs(self.poles[:, : self.shapes.shape[1]])

    @property
    def d(self) -> Array:
        """Natural frequencies: `natural_frequencies`."""
        return self.natural_frequencies

    @property
    def damping_ratios(self) -> Array:
        """Damping ratios `-Re p / |p|` of the modes, shape (k, n)."""
        return -self.poles[:, : self.shapes.shape[1]].real / self.natural_frequencies

    def freqresp(self, omega: ArrayLike, output: int = 0, input: int = 0) -> ComplexArray:
        """Frequency response of every draw from an input to an output.

        Parameters
        ----------
        omega : array_like, shape (K,)
            Angular frequencies, rad per unit time.
        output, input : int
            Which ones, counted from 0.

        Returns
        -------
        ndarray of complex, shape (k, K)
            One draw a row; infinite at a pole.

        Raises
        ------
        StructureError
            If `omega` is no vector of finite numbers, or there is no such output or input.

        Examples
        --------
        >>> from ph_control import ModalSamples
        >>> samples = ModalSamples([[-0.1 + 1j]], [[[[0.5 + 0j]]]], [[[0.0]]], [[[1.0 + 0j]]])
        >>> samples.freqresp([0.0]).round(3)
        array([[0.099+0.j]])
        """
        tables = self._responses(omega, output, input)
        return np.concatenate([np.empty((0, len(self)), complex), *tables]).T

    def magnitude_band(self, omega: ArrayLike, level: float = 0.95, output: int = 0, input: int = 0) -> Array:
        """Band of the gain from an input to an output: percentiles of `|G(i omega)|` over the draws.

        Parameters
        ----------
        omega : array_like, shape (K,)
            Angular frequencies, rad per unit time.
        level : float
            Share of the draws inside, between 0 and 1.
        output, input : int
            Which ones, counted from 0.

        Returns
        -------
        ndarray, shape (2, K)
            Lower and upper end.

        Raises
        ------
        StructureError
            If `omega` is no vector of finite numbers, the level is not between 0 and 1, there is no such output or
            input, or there are no draws.

        Notes
        -----
        Where draws have a pole without losses on both sides of a frequency, the upper end is large but finite: the gain
        at the distance from a pole that only `(1 - level)/2` of them fall below.  It is infinite where so many have a
        pole at that very frequency.

        Examples
        --------
        >>> from ph_control import ModalSamples
        >>> draws = ModalSamples([[-0.1 + 1j]] * 2, [[[[0.5]]], [[[0.6]]]], [[[0.0]]] * 2, [[[1.0]]] * 2)
        >>> draws.magnitude_band([1.0], level=0.5).round(2)
        array([[5.27],
               [5.77]])
        """
        return self._percentiles(map(np.abs, self._responses(omega, output, input)), level)

    def phase_band(self, omega: ArrayLike, level: float = 0.95, output: int = 0, input: int = 0) -> Array:
        """Band of the phase from an input to an output, in degrees, about the direction of the mean.

        Parameters
        ----------
        omega, level, output, input
            As in `magnitude_band`.

        Returns
        -------
        ndarray, shape (2, K)
            Lower and upper end; they are within 180 degrees of a phase between -180 and 180.

        Raises
        ------
        StructureError
            As `magnitude_band`.

        Examples
        --------
        >>> from ph_control import ModalSamples
        >>> draws = ModalSamples([[-0.1 + 1j]] * 2, [[[[0.5]]], [[[0.6]]]], [[[0.0]]] * 2, [[[1.0]]] * 2)
        >>> draws.phase_band([1.0]).round(1)
        array([[-2.8],
               [-2.8]])
        """

        def degrees(G: ComplexArray) -> Array:
            sizes = np.abs(G)
            centre = np.angle(np.sum(G / np.where(sizes > 0, sizes, 1.0), axis=1, keepdims=True))
            return np.degrees(centre + np.angle(G * np.exp(-1j * centre)))

        return self._percentiles(map(degrees, self._responses(omega, output, input, above=True)), level)

    def step_band(self, time: ArrayLike, level: float = 0.95, output: int = 0, input: int = 0) -> Array:
        """Band of the response of an output to a unit step of an input: percentiles over the draws.

        Parameters
        ----------
        time : array_like, shape (K,)
            Instants, in any order; before 0, when the step comes, and while the delays last, the response is 0.
        level, output, input
            As in `magnitude_band`.

        Returns
        -------
        ndarray, shape (2, K)
            Lower and upper end.

        Raises
        ------
        StructureError
            As `magnitude_band`.

        Examples
        --------
        >>> from ph_control import ModalSamples
        >>> draws = ModalSamples([[-0.1 + 1j]] * 2, [[[[0.5]]], [[[0.6]]]], [[[0.0]]] * 2, [[[1.0]]] * 2)
        >>> draws.step_band([0.0]).round(2)
        array([[0.],
               [0.]])
        """

        def step(t: Array, p: ComplexArray) -> ComplexArray:
            return np.where(p == 0, t, np.expm1(p * t) / np.where(p == 0, 1.0, p))

        return self._percentiles(self._motions(step, time, output, input, self._entry(output, input)[1]), level)

    def impulse_band(self, time: ArrayLike, level: float = 0.95, output: int = 0, input: int = 0) -> Array:
        """Band of the response of an output to a unit impulse of an input, without what is fed through at once.

        Parameters
        ----------
        time, level, output, input
            As in `step_band`.

        Returns
        -------
        ndarray, shape (2, K)
            Lower and upper end.

        Raises
        ------
        StructureError
            As `magnitude_band`.

        Examples
        --------
        >>> from ph_control import ModalSamples
        >>> draws = ModalSamples([[-0.1 + 1j]] * 2, [[[[0.5]]], [[[0.6]]]], [[[0.0]]] * 2, [[[1.0]]] * 2)
        >>> draws.impulse_band([0.0], level=0.5).round(2)
        array([[1.05],
               [1.15]])
        """
        return self._percentiles(self._motions(lambda t, p: np.exp(p * t), time, output, input), level)

    def _entry(self, output: int, input: int) -> tuple[ComplexArray, Array]:
        """Residues (k, n) and feedthrough (k,) of an entry."""
        for name, value, count in zip(("output", "input"), (output, input), self.feedthrough.shape[1:], strict=True):
            if not 0 <= _checks.whole_number(name, value) < count:
                raise StructureError(f"{name} is {value}; these models have {count}, counted from 0")
        return self.residues[:, :, output, input], self.feedthrough[:, output, input]

    def _motions(
        self, of_mode: Callable[[Array, ComplexArray], ComplexArray], time: ArrayLike, output: int, input: int,
        through: Array | float = 0.0,
    ) -> Iterator[Array]:  # fmt: skip
        """Sums over the modes of their motions at instants (K, k), and what is fed `through`; 0 before they come."""
        residues, late = self._entry(output, input)[0], self.delay[output] + self.input_delay[input]

        def moved(t: Array, p: ComplexArray) -> Array:
            weights = np.where(p.imag == 0, 1, 2) * residues
            motion = np.sum((weights * of_mode(np.maximum(t - late, 0.0), p)).real, axis=-1)
            return np.where(t[..., 0] < late, 0.0, motion + through)

        return self._tables("time", time, moved)

    def _responses(self, omega: ArrayLike, output: int, input: int, above: bool = False) -> Iterator[ComplexArray]:
        """Responses of every draw at frequencies (K, k); infinite at a pole that is shown, or that just `above`."""
        residues, through = self._entry(output, input)

        def response(w: Array, p: ComplexArray) -> ComplexArray:
            least = 1j * np.maximum(_checks.EPS * np.abs(p), np.finfo(float).tiny)
            ahead, behind = (np.where(gap == 0, least, gap) for gap in (1j * w - p, 1j * w - p.conj()))
            terms = residues / ahead + (p.imag != 0) * residues.conj() / behind
            values = terms.sum(axis=-1) + through
            if self.background is not None:
                values = values + self.background.entry(output, input).response(w.ravel())[0, 0][:, None]
            late = self.delay[output] + self.input_delay[input]
            values = values * np.exp(-1j * late * w[..., 0])
            is_pole = np.any(((1j * w == p) | (1j * w == p.conj())) & (residues != 0), axis=-1)
            return np.where(is_pole & (not above), complex(np.inf, 0.0), values)

        return self._tables("omega", omega, response)

    def _tables(
        self, name: str, points: ArrayLike, values: Callable[[Array, ComplexArray], Numbers]
    ) -> Iterator[Numbers]:
        """Values at points (K, k), a block of points at a time."""
        return (values(block[:, None, None], self.poles) for block in self._blocks(name, points, self.poles.size))


def _complex_array(name: str, value: object, ndim: int) -> ComplexArray:
    """Check finite complex numbers of so many dimensions."""
    try:
        array = np.array(value, complex)
    except (TypeError, ValueError, OverflowError):
        raise StructureError(f"{name} does not hold complex numbers: {_checks.shown(value)}; pass an array") from None
    if array.ndim != ndim:
        raise StructureError(f"{name} has {array.ndim} dimensions (shape {array.shape}), expected {ndim}")
    _checks.finite(name, array)
    return array
