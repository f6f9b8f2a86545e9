"""What a fitted model says of a record: its output from a state, and the state that fits its outputs best.

The same for damped modes and recordings of several channels: their outputs, and the motions that fit these best.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from ... import _checks
from ..._display import Report
from ..._frozen import Frozen
from ..._types import Array, ComplexArray, Indices, NDArray, RealOrComplex
from ..._units import DERIVATIVES
from ...exceptions import StructureError
from ...modal.discretization import Hold
from ...modal.modal_form import ModalForm, from_frequencies
from ..data.channels import Recording, ResponseMatrix
from ..data.frequency_record import FrequencyRecord, InFrequency
from ..data.time_record import Record, blocks
from .free import FreeProjection
from .modal_regressors import output_weight
from .time_rows import WHOLE, FreeRecord, change_seldom

_POWERS = range(-2, 3)  # of s, in a background
Experiment = TypeVar("Experiment")
Pairs = Sequence[tuple[Any, RealOrComplex]]  # records, and what a model predicts of each


class FittedData(Report, Frozen):
    """What a fit says of one experiment: its record, and the outputs that it predicts."""

    record: Any
    predicted: RealOrComplex

    @property
    def measured(self) -> RealOrComplex:
        """Outputs of the record; NaN where missing."""
        return np.asarray(self.record.measured)

    @property
    def residuals(self) -> NDArray[Any]:
        """What the prediction leaves; NaN where an output is missing."""
        return np.asarray(self.measured - self.predicted)

    @property
    def fit_percent(self) -> float:
        """`100 (1 - norm(residual) / norm(output - mean))`, in the scale of the weights; of outputs the square mean."""
        return joint_percent(shares_left([(self.record, self.predicted)]))


@dataclass(frozen=True, eq=False)
class ResponseBackground(Frozen):
    """What a fit of frequency responses has beside modes and feedthrough, `sum_k coefficients[k + 2] s^k`, `s = j w`.

    Only terms that the criterion asks for are there, each with a parameter of its own; all others are 0.  `predicted`
    and pictures of a result contain them, its systems do not.

    Attributes
    ----------
    coefficients : ndarray of complex, shape (5, p, m)
        Of `s^-2` to `s^2`, of each output and input.
    stderr : ndarray of complex, shape (5, p, m)
        Standard errors of their real and imaginary parts; 0 where there is no term.
    quantities : tuple of str
        What each output is, as in the result.
    constant, slope : ndarray of complex, shape (p, m)
        Coefficients of `1` and `s`.
    lower_residual, upper_residual : ndarray, shape (p, m)
        What modes below and above the band leave, `lower_residual / s^2 + upper_residual` of a displacement.

    Examples
    --------
    A coil in series with what resonates:

    >>> import control as ct, numpy as np, ph_control as phc
    >>> s, rng = 1j * np.linspace(0.1, 3.0, 200), np.random.default_rng(0)
    >>> noise = 1e-3 * (rng.standard_normal(200) + 1j * rng.standard_normal(200))
    >>> result = phc.pem(ct.frd(s / (s**2 + 0.04 * s + 1) + 0.05 * s + noise, s.imag), 1, structure="free")
    >>> result.background.slope.real.round(3), result.background.stderr[3].real.round(3)
    (array([[0.05]]), array([[0.]]))
    """

    coefficients: ComplexArray
    stderr: ComplexArray
    quantities: tuple[str, ...]

    @property
    def constant(self) -> ComplexArray:
        """Constant of each entry, shape (p, m): of fixtures or losses; a real one is `feedthrough` of the result.

        Of a displacement it is here, and is what modes above the band leave as well.
        """
        return self.coefficients[2]

    @property
    def slope(self) -> ComplexArray:
        """Coefficient of `s` of each entry, shape (p, m): of an impedance the inductance in series, if it is real."""
        return self.coefficients[3]

    @property
    def lower_residual(self) -> Array:
        """What modes below the band leave, `lower_residual / s^2` of a displacement, shape (p, m).

        The reciprocal of a mass; of an acceleration it is `feedthrough` of the result, and 0 here.
        """
        return self._of_displacement(-2)

    @property
    def upper_residual(self) -> Array:
        """What modes above the band leave, the constant of a displacement, shape (p, m): a reciprocal stiffness."""
        return self._of_displacement(0)

    def _of_displacement(self, power: int) -> Array:
        powers = [power + DERIVATIVES[quantity] for quantity in self.quantities]
        none = np.zeros(self.coefficients.shape[2])
        return np.stack([
            self.coefficients[_POWERS.index(k), output].real if k in _POWERS else none
            for output, k in enumerate(powers)
        ])  # fmt: skip

    def response(self, omega: Array) -> ComplexArray:
        """Values at frequencies; terms that are infinite at 0 are left out there.

        Parameters
        ----------
        omega : array_like, shape (K,)
            Frequencies, rad per unit time.

        Returns
        -------
        ndarray of complex, shape (p, m, K)
            What is added to the response of modes and feedthrough.

        Raises
        ------
        StructureError
            If the frequencies are no vector of finite numbers, or they or the values are out of range.

        Examples
        --------
        >>> import control as ct, numpy as np, ph_control as phc
        >>> s, rng = 1j * np.linspace(0.1, 3.0, 200), np.random.default_rng(0)
        >>> noise = 1e-3 * (rng.standard_normal(200) + 1j * rng.standard_normal(200))
        >>> coil = s / (s**2 + 0.04 * s + 1) + 0.05 * s + noise
        >>> result = phc.pem(ct.frd(coil, s.imag), 1, structure="free")
        >>> result.background.slope.real.round(3), result.background.response([2.0]).round(2)
        (array([[0.05]]), array([[[0.+0.1j]]]))
        """
        points = _checks.real_array("omega", omega, 1)
        _checks.in_range("omega", points)
        s = 1j * points
        values = np.zeros((*self.coefficients.shape[1:], len(s)), complex)
        with np.errstate(all="ignore"):
            for k, factor in zip(_POWERS, self.coefficients, strict=True):
                if factor.any():
                    values += factor[..., None] * np.where(s == 0, float(k == 0), np.where(s == 0, 1.0, s) ** k)
        _checks.representable("values of the background", values)
        return values

    def entry(self, output: int, input: int) -> ResponseBackground:
        """Take the background of one output and input.

        Parameters
        ----------
        output, input : int
            Numbers of them, from 0.

        Returns
        -------
        ResponseBackground
            The same terms with arrays of shape (5, 1, 1).

        Raises
        ------
        StructureError
            If there is no such output or input.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> terms = np.arange(10.0).reshape(5, 2, 1) + 0j
        >>> phc.ResponseBackground(terms, 0 * terms, ("velocity", "velocity")).entry(1, 0).slope
        array([[7.+0.j]])
        """
        outputs, inputs = self.coefficients.shape[1:]
        row = _checks.whole_number("output", output, 0, outputs - 1)
        column = _checks.whole_number("input", input, 0, inputs - 1)
        part = np.s_[:, row : row + 1, column : column + 1]
        return ResponseBackground(self.coefficients[part], self.stderr[part], (self.quantities[row],))


@dataclass(frozen=True, eq=False, repr=False)
class FittedExperiment(FittedData):
    """What a fit by `pem` says of one experiment.

    Attributes
    ----------
    record : Record or FrequencyRecord
        The data.
    initial_state : ndarray, shape (2n + r,), or (0,) for a frequency response
        State at the first sample of `system` for a lossless model, else of `observed_system`.
    free_amplitudes : ndarray of complex, shape (n + r,)
        Free motion at the output of each mode and real pole, `Re(amplitude exp(p t))`.
    offset : float
        Constant that is added to the output, of one that drifts its value at the first sample; 0 if not estimated.
    predicted : ndarray, shape (T,)
        Predicted output; complex for a frequency response.
    drift : float
        Change of that constant per unit time; 0 if it was not estimated.
    background : ResponseBackground, optional
        What a frequency response has beside the modes.
    initial_stderr : ndarray, shape of `initial_state`
        Standard errors of the initial state; NaN where it was not estimated.
    offset_stderr : float
        Standard error of the offset; NaN if it was not estimated.
    noise_scale : float
        Standard deviation of its noise, beside the root of the `noise_variance` of the result.
    resting : bool
        Whether it begins at rest, held by inputs that are not 0: so its motion has no errors of its own.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> rng, plant = np.random.default_rng(0), phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]))
    >>> u = rng.standard_normal(400)
    >>> y = phc.forced_response(plant, 0.1 * np.arange(400), u, intersample="zoh").outputs
    >>> y = y + 0.01 * rng.standard_normal(400)
    >>> (experiment,) = phc.pem((u, y), dt=0.1).experiments
    >>> experiment.predicted.shape, experiment.initial_state.shape
    ((400,), (4,))
    """

    record: Record | FrequencyRecord
    initial_state: Array
    free_amplitudes: ComplexArray
    offset: float
    predicted: RealOrComplex
    drift: float = 0.0
    background: ResponseBackground | None = None
    initial_stderr: Array = field(default_factory=lambda: np.zeros(0))
    offset_stderr: float = np.nan
    noise_scale: float = 1.0
    resting: bool = False

    def __str__(self) -> str:
        """Say how much there is of it, and how well it is fitted."""
        return f"{self.record.samples} samples, fit {self.fit_percent:.2f} %"


def pieces(pairs: Pairs) -> Iterator[tuple[Array, RealOrComplex, RealOrComplex]]:
    """Weights, measured values and residuals block by block; all 0 where a value is missing."""
    for record, predicted in pairs:
        for part in blocks(record.samples, predicted[..., 0].size):
            measured, values = np.asarray(record.measured[..., part]), predicted[..., part]
            observed = record.observed[..., part] & ~np.isnan(values)  # late outputs begin before what is known
            weights = record.weights[..., part] if isinstance(record, InFrequency) else 1.0
            residuals = np.where(observed, measured - values, 0.0)
            yield np.where(observed, weights, 0.0), np.where(observed, measured, 0.0), residuals


def shares_left(pairs: Pairs) -> Array:
    """Weighted norm of the residual over that of `output - mean`, of each output or entry in all experiments.

    An output that only rounds about its mean is held against its own size; NaN where nothing was measured.
    """
    unit: Any = 0.0
    worst: Any = 0.0
    heaviest = count = total = sums = residual_squares = squares = about = 0.0
    for weights, measured, residuals in pieces(pairs):
        unit, worst = (
            np.maximum(size, np.abs(values).max(axis=-1, initial=0.0))
            for size, values in ((unit, measured), (worst, residuals))
        )
        heaviest = max(heaviest, float(weights.max(initial=0.0)))
    # in units of the largest, so that squares stay in the range of doubles
    unit, worst = (np.where(size > 0, size, 1.0) for size in (unit, worst))
    for weights, measured, residuals in pieces(pairs):
        share, y = weights / (heaviest or 1.0), measured / unit[..., None]
        count, total = count + (share > 0).sum(axis=-1), total + share.sum(axis=-1)
        sums, squares = sums + np.sum(share * y, axis=-1), squares + np.sum(share * np.abs(y) ** 2, axis=-1)
        residual_squares = residual_squares + np.sum(share * np.abs(residuals / worst[..., None]) ** 2, axis=-1)
    mean = np.asarray(sums / np.where(np.asarray(total) > 0, total, 1.0))[..., None]
    for weights, measured, _ in pieces(pairs):
        share = weights / (heaviest or 1.0)
        about = about + np.sum(share * np.abs(measured / unit[..., None] - mean) ** 2, axis=-1)
    size = np.sqrt(np.where(about <= _checks.EPS**2 * count, squares, about))
    return np.where(size > 0, np.sqrt(residual_squares) / np.where(size > 0, size, 1.0) * (worst / unit), np.nan)


def joint_percent(shares: Array) -> float:
    """Fit of all outputs in per cent, from the unexplained share of each."""
    known = np.asarray(shares)[~np.isnan(shares)]
    return 100.0 * (1.0 - unit_norm(known, 1.0) / float(np.sqrt(known.size))) if known.size else np.nan


def unit_norm(error: RealOrComplex, unit: float) -> float:
    """Norm in a unit, also of numbers whose squares leave the range of doubles."""
    largest = float(np.max(np.abs(error), initial=0.0))
    return float(np.linalg.norm(error / largest)) * (largest / unit) if largest else 0.0


def state_of(poles: ComplexArray, motion: ComplexArray, quantity: str, r: Array | None = None) -> Array:
    """State (2n + r,) of free motions at the output; of lossless modes with weights `r` in Williamson coordinates.

    There it is 0 where `r` is.
    """
    if r is not None:
        gain = output_gain(from_frequencies(poles.imag, r), quantity)
        x = np.where(gain == 0, 0.0, motion.conj() / np.where(gain == 0, 1.0, gain))
        return np.concatenate([x.real, x.imag])
    kept = np.stack([poles == poles, poles.imag != 0], axis=1)
    return np.stack([motion.real, motion.imag], axis=1)[kept]


def output_gain(modes: ModalForm, quantity: str) -> ComplexArray:
    """Free motion at the output, conjugate to that of the upper pole, of a unit of each state `q + i p`."""
    return np.asarray(modes.d * modes.nu[:, 0].conj() * output_weight(modes.d, quantity))


def chosen_experiment(experiments: Sequence[Experiment], place: Any) -> Experiment:
    """One of several by its number."""
    whole = isinstance(place, int | np.integer) and not isinstance(place, bool)
    if not (whole and 0 <= place < len(experiments)):
        raise StructureError(f"experiment is {place!r}; the experiments are counted from 0 to {len(experiments) - 1}")
    return experiments[place]


@dataclass(frozen=True, eq=False, repr=False)
class FittedChannels(FittedData):
    """What a fit by `pem` says of one experiment of several inputs or outputs.

    Attributes
    ----------
    record : Recording or ResponseMatrix
        The data.
    free_amplitudes : ndarray of complex, shape (n, p)
        Free motion of each mode at each output, `Re(amplitude exp(p t))`; (n, 0) for a frequency response.
    offsets, drifts : ndarray, shape (p,)
        Constant that is added to each output, and its change per unit time; 0 if not estimated.
    predicted : ndarray, shape (p, T) or (p, m, K)
        Predicted outputs, NaN where they depend on inputs before the record; complex for a frequency response.
    background : ResponseBackground, optional
        What a frequency response has beside the modes.
    offset_stderr : ndarray, shape (p,)
        Standard errors of the offsets; NaN where none was estimated.
    noise_scale : float
        Standard deviation of its noise, beside the root of the `noise_variance` of the result.
    resting : bool
        Whether it begins at rest, held by inputs that are not 0: so its motion has no errors of its own.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> rng, plant = np.random.default_rng(0), phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]))
    >>> u = rng.standard_normal(400)
    >>> y = phc.forced_response(plant, 0.1 * np.arange(400), u, intersample="zoh").outputs
    >>> y = np.stack([y, 2 * y]) + 0.01 * rng.standard_normal((2, 400))
    >>> (experiment,) = phc.pem((u, y), dt=0.1).experiments
    >>> experiment.predicted.shape, experiment.free_amplitudes.shape
    ((2, 400), (2, 2))
    """

    record: Recording | ResponseMatrix
    free_amplitudes: ComplexArray
    offsets: Array
    drifts: Array
    predicted: RealOrComplex
    background: ResponseBackground | None = None
    offset_stderr: Array = field(default_factory=lambda: np.full(1, np.nan))
    noise_scale: float = 1.0
    resting: bool = False

    def __post_init__(self) -> None:
        errors = np.broadcast_to(self.offset_stderr, np.shape(self.offsets))
        object.__setattr__(self, "offset_stderr", np.array(errors, float))
        super().__post_init__()

    def __str__(self) -> str:
        """Say how much there is of it, and how well it is fitted."""
        return f"{self.record.samples} samples of {len(self.predicted)} outputs, fit {self.fit_percent:.2f} %"

    @property
    def unexplained(self) -> Array:
        """`|residual|^2 / |output - mean|^2` of each output, shape (p,), or entry, (p, m); NaN without samples."""
        return shares_left([(self.record, self.predicted)]) ** 2


def natural_jacobian(p: ComplexArray) -> Array:
    """Derivatives of natural frequencies and damping ratios by imaginary and real parts of poles, shape (2n, 2n)."""
    n, w, x = len(p), p.imag, np.where(p == 0, -(np.finfo(float).tiny ** 0.25), p.real)
    d = np.hypot(x, w)
    J, k = np.zeros((2 * n, 2 * n)), np.arange(n)
    J[k, k], J[k, n + k] = w / d, x / d
    J[n + k, k], J[n + k, n + k] = x * w / d**3, -(w**2) / d**3
    return J


def halved(p: ComplexArray, residues: ComplexArray) -> ComplexArray:
    """Residues (n, q, m) beside those of conjugate poles: of real poles, which are their own, half of each."""
    return np.where(p.imag == 0, 0.5, 1.0)[:, None, None] * residues


def predicted_outputs(
    p: ComplexArray, residues: ComplexArray, through: Array, u: Array, hold: Hold, delay: Array | None = None,
    input_delay: Array | None = None, *, lasting: bool = False,
) -> Array:  # fmt: skip
    """Outputs (q, T) of modes with poles (n,), residues (n, q, m) and feedthrough (q, m), from zero; O(T n (m + q)).

    Each may come later by a `delay` (q,); where it is negative the last input lasts.  Each input may act later by an
    `input_delay` (m,): then outputs are the sums of those of inputs that act together.  Before the record inputs are 0,
    or `lasting` at their first values.
    """
    if input_delay is not None and input_delay.any() and len(u):
        q = residues.shape[1]
        own, together = np.zeros(q) if delay is None else delay, np.zeros((q, u.shape[1]))
        for late in np.unique(input_delay):
            which = input_delay == late
            together += predicted_outputs(
                p, residues[:, :, which], through[:, which], u[which], hold, own + late, lasting=lasting
            )
        return together
    if delay is not None and delay.any():
        outputs = np.empty((len(delay), u.shape[1]))
        for late in np.unique(delay):
            which = delay == late
            outputs[which] = _late_outputs(p, residues[:, which], through[which], u, hold, float(late), lasting)
        return outputs
    return _late_outputs(p, residues, through, u, hold, 0.0, lasting)


def _late_outputs(
    p: ComplexArray, residues: ComplexArray, through: Array, u: Array, hold: Hold, delay: float, lasting: bool
) -> Array:
    """Outputs that come later by the same time."""
    outputs = residues.shape[1]
    if not len(u):
        return np.zeros((outputs, u.shape[1]))
    early = max(0, -int(np.floor(delay / hold.h + WHOLE)))
    u = np.concatenate([u, np.repeat(u[:, -1:], early, axis=1)], axis=1) if early else u
    y = np.zeros((outputs, u.shape[1]))
    seen, among = np.ones(u.shape[1], bool), np.arange(outputs)
    rows = FreeRecord(u, y, seen, hold, moving=lasting, outputs=among, known_lasting=lasting)
    rows = rows.delayed(delay + early * hold.h)
    each = np.moveaxis(halved(p, residues), 2, 0)
    shared = np.concatenate([each.real, each.imag, through.T[:, None]], axis=1).reshape(-1, outputs)
    return np.asarray(rows.evaluated(p).predict(shared, np.zeros((rows.own_unknowns(len(p)), outputs)))[:, early:])


def unknown_samples(delay: Array, dt: float, u: Array | None = None) -> Indices:
    """First samples of each output that depend on inputs before the record.

    None of a record whose inputs `u` (m, T) do not change in as many samples, or change seldom: they have lasted.
    """
    first = np.maximum(np.ceil(delay / dt - WHOLE), 0).astype(int)
    most = int(first.max(initial=0))
    lasting = u is not None and bool(len(u)) and (not np.ptp(u[:, : most + 1], axis=1).any() or change_seldom(u, most))
    return np.zeros_like(first) if lasting else first


def moved_freely(p: ComplexArray, motion: ComplexArray, hold: Hold, samples: int, first: Indices) -> Array:
    """Outputs (q, samples) of free motions (n, q), which before a `first` sample have the size that they have there.

    What inputs before a record have done to an output that comes late is no free motion before it has come, and a fast
    one would have been very large.
    """
    step, samples_from_start = hold.step(p), np.arange(float(samples))
    powers = step.powers(samples_from_start)
    if not first.any():
        return np.asarray((motion.T @ powers).real)
    held = np.abs(step.powers(first.astype(float))).T[..., None]
    sizes = np.where(samples_from_start < first[:, None, None], held, np.abs(powers))
    return np.asarray((motion.T[..., None] * sizes * np.exp(1j * np.angle(powers))).real.sum(axis=1))


def estimated_motion(
    p: ComplexArray, record: Recording, forced: Array, hold: Hold, offset: bool, delay: Array
) -> Array:
    """Free motion, and constant, fitted to the outputs without their forced part, at all samples, (q, T)."""
    nothing, first = np.zeros((1, record.samples)), unknown_samples(delay, hold.h, record.u)
    observed = record.observed & (np.arange(record.samples) >= first[:, None])
    residual = np.where(observed, record.y - forced, 0.0)
    rows = FreeRecord.by_observation(nothing, residual, observed, hold, offset=int(offset), driven=False)
    motion = np.zeros(residual.shape)
    for group in rows:
        projection = FreeProjection([replace(group, outputs=np.arange(len(group.outputs)))], p)
        motion[group.outputs] = projection.predictions()[0]
        unknown = first[group.outputs]
        if unknown.any():
            own, n = projection.own[0], len(p)
            before = moved_freely(p, 2 * (own[:n] + 1j * own[n : 2 * n]), hold, int(unknown.max()), unknown)
            before += own[-1][:, None] if offset else 0.0
            some = np.arange(before.shape[1])
            motion[group.outputs, : len(some)] = np.where(
                some < unknown[:, None], before, motion[group.outputs, : len(some)]
            )
    return motion
