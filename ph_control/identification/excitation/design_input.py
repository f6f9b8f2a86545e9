"""The input of a test that shows what it is made for best: its spectrum, a signal of it, and what that will show.

The signal is a sum of sines with a low peak factor: phases by rounds of clipping.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from ... import _checks
from ..._display import Report, counted
from ..._frozen import Frozen, ReadOnlyMapping
from ..._types import Array, ArrayLike, ComplexArray, Indices
from ..._units import rate
from ...exceptions import StructureError
from ...modal.discretization import Hold
from ..uncertainty.fisher import Information, listed
from ..uncertainty.noise_model import NoiseModel
from .optimal_spectrum import SpectrumProblem
from .planned_plant import PlannedPlant, pole_tables, positive_for_each, standard_errors
from .plant_information import line_sensitivities, plant_information

Purpose = Literal[
    "damping_ratios", "natural_frequencies", "poles", "real_poles", "time_constants", "residues", "feedthrough"
]

_FEWEST = 8  # samples of a record
_ON_THE_WAY = (2, 4, 8, 16, 32, 64)  # updates of the spectra that are tried where peaks are limited
_ALIKE = 1e-6  # relative difference of the ratios of powers of inputs that are what was assumed
_TRIAL = 0.2  # of the effort for the signal, while spectra are compared
_LOWEST_POWER = 1e-6  # of an input: lines with less are left out of the signal

# phases of a signal with a low peak factor
_ROUNDS = 800  # of clipping, from each start
_WORK = 8e6  # samples of all rounds from a start, of a long signal
_FEWEST_ROUNDS = 60
_STARTS = 3  # sets of phases: Schroeder's, and random ones
_CLIP = (0.70, 0.98)  # of the peak that is kept, in the first and the last round


@dataclass(frozen=True, eq=False, repr=False)
class InputDesign(Report, Frozen):
    """Input of a test, made by `design_input`.

    Attributes
    ----------
    signal : ndarray, shape (m, T)
        Inputs at the samples; each is a sum of sines at Fourier frequencies of the record.
    dt : float
        Time between samples.
    frequencies : ndarray, shape (K,)
        Fourier frequencies with power, ascending, rad per unit time.
    spectrum : ndarray, shape (m, K)
        Mean power of each input at each of them; the sum over a row is `rms**2`.
    optimal_spectrum : ndarray, shape (m, K)
        That of the least criterion with the same `rms` of each input; without a limit of the peak it is that of the
        signal.
    for_ : str
        What the input makes known best.
    stderr : mapping
        Predicted standard errors of a fit with unknown free motion, under the keys of `PEMResult.stderr`:
        'natural_frequencies', 'hertz', 'damping_ratios', 'real_poles', 'time_constants', 'residues', 'feedthrough',
        and 'poles'; those of complex numbers are complex, of real and imaginary part.
    criterion : float
        Sum of squared standard errors of `for_`, relative to their values, that the spectrum reaches in a steady state.
    least_criterion : float
        The least of all spectra with the same `rms` of each input, that of `optimal_spectrum`.
    rms, peak, peak_factor : ndarray, shape (m,)
        Root mean square and largest value of each input, and the ratio `peak / rms`.
    input_labels : tuple of str
        Names of the inputs.
    values : mapping
        The quantities that `stderr` has errors of, of the model.
    time_unit : str or None
        Unit of time of the model, where it is known.

    Examples
    --------
    See `design_input`.
    """

    signal: Array
    dt: float
    frequencies: Array
    spectrum: Array
    optimal_spectrum: Array
    for_: str
    stderr: Mapping[str, Any]
    criterion: float
    least_criterion: float
    input_labels: tuple[str, ...]
    values: Mapping[str, Any]
    time_unit: str | None = None

    @property
    def samples(self) -> int:
        """Number of samples T."""
        return int(self.signal.shape[1])

    @property
    def time(self) -> Array:
        """Instants of the samples, shape (T,), from 0."""
        return self.dt * np.arange(float(self.samples))

    @property
    def rms(self) -> Array:
        """Root mean square of each input, shape (m,)."""
        return np.asarray(np.sqrt(np.mean(self.signal**2, axis=1)))

    @property
    def peak(self) -> Array:
        """Largest absolute value of each input, shape (m,)."""
        return np.asarray(np.abs(self.signal).max(axis=1))

    @property
    def peak_factor(self) -> Array:
        """Largest absolute value of each input over its root mean square, shape (m,)."""
        return self.peak / self.rms

    def __str__(self) -> str:
        lines = counted(int(np.sum(self.spectrum.any(axis=0))), "line")
        factors = listed([f"{factor:.3g}" for factor in self.peak_factor])
        return f"input of {self.samples} samples for {self.for_.replace('_', ' ')}: {lines}, peak factor {factors}"

    def summary(self) -> str:
        """Report for people: the signal of each input, and the standard errors to expect.

        Returns
        -------
        str
            Several lines, at most 120 characters wide.

        Notes
        -----
        O(K) on top of what was computed before.

        Examples
        --------
        >>> import ph_control as phc
        >>> plant = phc.modes([1.0, 2.0], [1.0, 0.5], damping=0.01)
        >>> design = phc.design_input(plant, 2000, 0.5, peak=1.0, noise_std=0.1)
        >>> print(design.summary().splitlines()[0])
        Input for damping ratios: 2000 samples, step 0.5
        """
        unit = rate(self.time_unit)
        lines = [f"Input for {self.for_.replace('_', ' ')}: {counted(self.samples, 'sample')}, step {self.dt:.6g}"]
        for name, row, rms, peak in zip(self.input_labels, self.spectrum, self.rms, self.peak, strict=True):
            band = self.frequencies[row > _LOWEST_POWER * row.sum()]
            lines.append(
                f"  {name}: {counted(len(band), 'line')} between {band[0]:.4g} and {band[-1]:.4g} {unit}, rms "
                f"{rms:.4g}, peak {peak:.4g}"
            )
        return "\n".join([*lines, *pole_tables(self.values, self.stderr, self.time_unit, "to expect")])


def design_input(
    model: Any,
    samples: int,
    dt: float,
    *,
    rms: ArrayLike | None = None,
    peak: ArrayLike | None = None,
    band: tuple[float, float] | None = None,
    for_: Purpose = "damping_ratios",
    noise_std: ArrayLike | None = None,
) -> InputDesign:
    """Design the input of a test, so that some quantities of a plant become known best.

    Parameters
    ----------
    model : PEMResult, ModalForm, pair (d, r), or any linear system of continuous time
        What is known of the plant so far, as from a short first test.
    samples : int
        Number of samples T of the test.
    dt : float
        Time between samples, in the unit of time of the model.
    rms, peak : float or array_like, shape (m,), optional
        Largest root mean square and largest absolute value of the inputs; at least one of them.
    band : pair (low, high), optional
        Frequencies that may have power, rad per unit time; by default all below the Nyquist frequency.
    for_ : {'damping_ratios', 'natural_frequencies', 'poles', 'real_poles', 'time_constants', 'residues', 'feedthrough'}
        What is to be known well: the sum of squared standard errors relative to the values is made least.
    noise_std : float or array_like, shape (p,), optional
        Standard deviation of the white noise of each output.  By default the `noise` of a fitted result, with its
        correlation, colours and unmeasured forces.

    Returns
    -------
    InputDesign
        Signal, spectrum, peak factor and predicted standard errors.

    Raises
    ------
    StructureError
        If an argument is not of its form, there is neither `rms` nor `peak`, the noise is not known, the plant grows or
        has nothing of what is to be known, or the band does not show it.

    See Also
    --------
    excitation : what a given input shows.

    Notes
    -----
    The information `F = sum_k T P_k Re(D_k^H S_k^{-1} D_k)` is linear in the powers `P_k` of the lines, `D_k` being the
    derivatives of the frequency response and `S_k` the spectrum of the noise, so that `trace(W F^{-1} W^T)` is convex
    in them: a multiplicative update ends within a relative 1e-3 of the least value.  What
    is unknown is what the `structure` of a result leaves free; of a system all residues, of any phase.  Delays count as
    known.  The lines are those of one period of the record; of several inputs each has every m-th line to itself, so
    that their answers do not mix.

    The signal has the phases of the lowest peak that rounds of clipping have found.  Where the peak is limited, spectra
    on the way from the even one to the optimum are tried as well, and that whose signal promises the least errors at
    its peak is taken: the optimum has few lines, whose sum has a high peak.  The predicted errors are those of
    the signal itself from an unknown initial motion, as `pem` estimates it, not of the steady state.  They hold where
    the model does: the lines lie on the flanks of the resonances, and a model whose frequencies are wrong by more than
    a half-width puts them elsewhere.  A `band`, or a test in two steps, is safer then.

    O(K P^2) for each of some hundred updates, K lines and P unknowns, and O(T log T) for each of some 6000 signals: 1 s
    for three modes and 4000 samples.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> plant = phc.modes([1.0, 2.5], [1.0, 0.3], damping=0.005)
    >>> design = phc.design_input(plant, 4000, 0.5, peak=1.0, noise_std=0.5)
    >>> design.signal.shape, float(np.abs(design.signal).max().round(6))
    ((1, 4000), 1.0)
    >>> white = np.random.default_rng(0).standard_normal(4000)
    >>> white = white / np.abs(white).max()
    >>> other = phc.excitation((white, None), plant, dt=0.5, noise_std=0.5)
    >>> bool(np.all(design.stderr["damping_ratios"] < 0.2 * other.stderr["damping_ratios"]))
    True
    """
    _checks.choice("for_", for_, get_args(Purpose))
    samples, dt = _checks.whole_number("samples", samples, _FEWEST), _checks.sampling_step(dt)
    plant = PlannedPlant.of(model)
    limits = _Limits.of(rms, peak, plant.inputs)
    noise = plant.noise_at(dt, noise_std)
    if noise is None:
        raise StructureError("the noise is not known: give noise_std, the standard deviation of that of each output")
    _refuse_growth(plant)
    hold = Hold(dt, plant.method, plant.intersample)
    wanted = _wanted(plant, for_)
    lines = _Lines.of(samples, dt, band, plant.inputs)
    problem = _problem(plant, lines, hold, noise, wanted, limits.power)
    _refuse_unseen(problem, plant, for_)
    optimum = problem.solved()
    signal = lines.signals(_spectrum_for(problem, lines, limits, optimum), limits)
    power, sizes = lines.powers(signal), np.mean(signal**2, axis=1)
    # the powers of several inputs may turn out in another ratio
    alike = np.ptp(sizes / problem.power) <= _ALIKE * np.max(sizes / problem.power)
    optimum = optimum * (sizes / problem.power)[lines.inputs]
    problem = replace(problem, power=sizes)
    optimum = optimum if alike else problem.solved()
    frequencies, spectrum, optimal = lines.by_inputs(power, optimum)
    information = plant_information(plant, [signal], [hold], noise)
    return InputDesign(
        signal, dt, frequencies, spectrum, optimal, for_, plant.unknowns.stderr(information),
        problem.judged(power).value, problem.judged(optimum).value, plant.input_labels, ReadOnlyMapping(plant.values),
        plant.time_unit,
    )  # fmt: skip


@dataclass(frozen=True)
class _Limits:
    """Limits of root mean square and peak of the inputs, shape (m,), infinite where there is none."""

    rms: Array
    peak: Array

    @classmethod
    def of(cls, rms: ArrayLike | None, peak: ArrayLike | None, inputs: int) -> _Limits:
        if rms is None and peak is None:
            raise StructureError("neither rms nor peak is given; give the largest value of one of them, or of both")
        return cls(*(_limit(name, value, inputs) for name, value in (("rms", rms), ("peak", peak))))

    @property
    def has_peak(self) -> bool:
        """Whether the peak of some input is limited."""
        return bool(np.isfinite(self.peak).any())

    @property
    def power(self) -> Array:
        """Powers in the ratio that the limits allow, shape (m,); a peak is taken for that of a signal of factor 1."""
        return np.asarray(np.minimum(self.rms, self.peak) ** 2)

    def scaled(self, signal: Array, i: int) -> Array:
        """Signal as large as the limits of an input allow."""
        size = min(self.rms[i] / float(np.sqrt(np.mean(signal**2))), self.peak[i] / float(np.abs(signal).max()))
        return np.asarray(size * signal)


def _limit(name: str, value: ArrayLike | None, inputs: int) -> Array:
    if value is None:
        return np.full(inputs, np.inf)
    limit = positive_for_each(name, value, inputs, "inputs")
    _checks.in_range(name, limit)
    return limit


@dataclass(frozen=True)
class _Lines:
    """Fourier frequencies `bins` (K,) of a record that may have power, and the input of each."""

    samples: int
    dt: float
    bins: Indices
    inputs: Indices

    @classmethod
    def of(cls, samples: int, dt: float, band: Any, inputs: int) -> _Lines:
        low, high = (0.0, np.inf) if band is None else _checks.band(band)
        spacing = 2 * np.pi / (samples * dt)
        bins = np.arange(1, (samples - 1) // 2 + 1)
        bins = bins[(bins * spacing >= low * (1 - 1e-9)) & (bins * spacing <= high * (1 + 1e-9))]
        if len(bins) < 2 * inputs:
            raise StructureError(
                f"{counted(len(bins), 'Fourier frequency')} of {samples} samples lie in the band, {spacing:.4g} rad "
                f"per unit time apart; {2 * inputs} are needed, two for each input: widen the band, or take more "
                "samples"
            )
        return cls(samples, dt, bins, np.arange(len(bins)) % inputs)

    @property
    def omega(self) -> Array:
        """Frequencies, rad per unit time."""
        return np.asarray(self.bins * 2 * np.pi / (self.samples * self.dt), float)

    def signals(self, power: Array, limits: _Limits, effort: float = 1.0) -> Array:
        """Signals (m, T) with the powers (K,) of the lines, as large as the limits of the inputs allow."""
        signals = []
        for i in range(len(limits.rms)):
            mine = (self.inputs == i) & (power > _LOWEST_POWER * power[self.inputs == i].sum())
            share = power[mine] / power[mine].max()
            signals.append(limits.scaled(_low_peak_multisine(share, self.bins[mine], self.samples, effort), i))
        return np.stack(signals)

    def powers(self, signal: Array) -> Array:
        """Mean powers (K,) of the lines in signals (m, T), each in the input that it belongs to."""
        transform = np.fft.rfft(signal)[self.inputs, self.bins] / self.samples
        power = 2 * np.abs(transform) ** 2
        total = np.bincount(self.inputs, power)[self.inputs]
        return np.asarray(np.where(power > 0.1 * _LOWEST_POWER * total, power, 0.0))

    def by_inputs(self, *powers: Array) -> tuple[Array, ...]:
        """Frequencies at which any of some powers (K,) is not 0, and each of them by inputs, shape (m, lines)."""
        kept, count = np.any(powers, axis=0), int(self.inputs.max()) + 1
        belongs = self.inputs == np.arange(count)[:, None]
        return np.asarray(self.omega[kept]), *((belongs * power)[:, kept] for power in powers)


def _wanted(plant: PlannedPlant, purpose: str) -> Array:
    """Derivatives of what is to be known by the unknowns, over its sizes."""
    value, rows = np.asarray(plant.values[purpose]), plant.unknowns.quantities[purpose]
    size = np.abs(value)
    if purpose == "residues":
        norms = np.linalg.norm(value.reshape(len(value), -1), axis=1)
        size = np.broadcast_to(norms[:, None, None], value.shape)
    size = np.where(size > 0, size, size.max(initial=0.0) or 1.0).ravel()
    rows = rows / np.tile(size, len(rows) // max(1, len(size)))[:, None]
    if not np.all(np.isfinite(rows)):
        raise StructureError("an integrator has no time constant: design for 'real_poles'")
    rows = rows[np.any(rows != 0, axis=1)]
    if not len(rows):
        raise StructureError(
            f"the model has no {purpose.replace('_', ' ')} that are unknown: it has {counted(plant.order, 'mode')}, "
            f"{counted(len(plant.p) - plant.order, 'real pole')} and the structure {plant.structure!r}; choose "
            "another for_"
        )
    return np.asarray(rows)


def _refuse_growth(plant: PlannedPlant) -> None:
    growing = plant.p[plant.p.real > 0]
    if growing.size:
        raise StructureError(
            f"the pole {growing[0]:.4g} grows, and no input can be sent to this plant alone: close the loop, and "
            "design the reference for the closed loop"
        )


def _problem(
    plant: PlannedPlant, lines: _Lines, hold: Hold, noise: NoiseModel, wanted: Array, power: Array
) -> SpectrumProblem:
    """The convex problem; a resonance is as wide as the record resolves, or wider."""
    slowest = -1.0 / (lines.samples * lines.dt)
    known = replace(plant, p=np.minimum(plant.p.real, slowest) + 1j * plant.p.imag)
    D = line_sensitivities(known, lines.omega, hold, noise)[np.arange(len(lines.bins)), lines.inputs]
    with np.errstate(over="ignore"):
        _checks.representable("the information of the record", lines.samples * power.max() * np.abs(D) ** 2 * len(D))
    return SpectrumProblem(D, wanted, lines.inputs, power, lines.samples)


def _spectrum_for(problem: SpectrumProblem, lines: _Lines, limits: _Limits, optimum: Array) -> Array:
    """The optimum; where peaks are limited, the spectrum on the way to it whose signal reaches most at its peak.

    The optimum has few lines, and a sum of few sines a high peak; spectra on the way to it from the even one have more.
    """
    if not limits.has_peak:
        return optimum
    spectra = [*(problem.on_the_way(count) for count in _ON_THE_WAY), optimum]

    def reached(power: Array) -> float:
        return problem.judged(lines.powers(lines.signals(power, limits, _TRIAL))).value

    return min(spectra, key=reached)


def _refuse_unseen(problem: SpectrumProblem, plant: PlannedPlant, purpose: str) -> None:
    """Refuse a band or a plant in which even all lines together do not show what is wanted."""
    D = problem.sensitivities.reshape(-1, problem.sensitivities.shape[2])
    information = Information.of(np.concatenate([D.real, D.imag]), plant.unknowns.names, rows=2 * len(D))
    if not np.all(np.isfinite(standard_errors(information, problem.quantities))):
        raise StructureError(
            f"no input in this band shows the {purpose.replace('_', ' ')}: {counted(len(problem.inputs), 'line')} do "
            f"not tell {listed([combination.words for combination in information.blind][:3])} from one another; widen "
            "the band, take more samples, or leave out modes that no input reaches"
        )


def _low_peak_multisine(power: Array, lines: Indices, samples: int, effort: float = 1.0) -> Array:
    """Signal (samples,) whose Fourier frequencies `lines` have these mean powers; `effort` is a part of all rounds.

    Each round clips the peaks, keeps the phases of what is left, and restores the powers (van der Ouderaa, Schoukens
    and Renneboog, 1988); the signal of the lowest peak of all is returned.
    """
    rounds = int(max(_FEWEST_ROUNDS, effort * min(_ROUNDS, _WORK / samples)))
    amplitudes = samples * np.sqrt(0.5 * power)
    rng, best, lowest = np.random.default_rng(0), np.zeros(samples), np.inf
    starts = [_schroeder(power), *(2 * np.pi * rng.random(len(lines)) for _ in range(_STARTS - 1))]
    for phases in starts:
        spectrum = amplitudes * np.exp(1j * phases)
        for keep in np.linspace(*_CLIP, rounds):
            signal = _synthesised(spectrum, lines, samples)
            peak = float(np.abs(signal).max())
            if peak < lowest:
                best, lowest = signal, peak
            turned = np.fft.rfft(np.clip(signal, -keep * peak, keep * peak))[lines]
            spectrum = amplitudes * np.exp(1j * np.angle(turned))
    return best


def _schroeder(power: Array) -> Array:
    """Phases of a sweep with this spectrum (Schroeder, 1970)."""
    share = np.concatenate([[0.0], np.cumsum(power)[:-1]]) / power.sum()
    return np.asarray(-2 * np.pi * np.cumsum(share))


def _synthesised(spectrum: ComplexArray, lines: Indices, samples: int) -> Array:
    whole = np.zeros(samples // 2 + 1, complex)
    whole[lines] = spectrum
    return np.asarray(np.fft.irfft(whole, samples))
