"""Inputs that are designed: the optimum of a general solver, limits that hold, and errors that a fit confirms."""

import functools

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from slow import slowly

import ph_control as phc

SETTINGS = settings(deadline=None, max_examples=8, derandomize=True)
LIGHT = phc.modes([3.0, 7.0, 13.0], [0.3, 0.1, 0.08], damping=[0.01, 0.008, 0.012])
STEP, SAMPLES = 0.05, 3000


@functools.cache
def design():
    return phc.design_input(LIGHT, SAMPLES, STEP, peak=1.0, noise_std=0.05)


# --- an independent reference: formulas, differences, and a general solver --------------------------------------------


def upper(plant):
    """Poles and residues of the upper half-plane, by natural frequency."""
    p, residues = plant.poles, plant.residues[:, 0, 0]
    kept = np.flatnonzero(p.imag > 0)
    kept = kept[np.argsort(np.abs(p[kept]))]
    return p[kept], residues[kept]


def parameters(plant):
    """Natural frequencies, damping ratios, real and imaginary parts of residues of one input and output."""
    p, residues = upper(plant)
    return np.concatenate([np.abs(p), -p.real / np.abs(p), residues.real, residues.imag])


def response(theta, omega, h):
    """Response of held inputs at frequencies."""
    z, total = np.exp(1j * omega * h), np.zeros(len(omega), complex)
    for d, zeta, real, imaginary in np.reshape(theta, (4, -1)).T:
        p, rho = d * (-zeta + 1j * np.sqrt(1 - zeta**2)), real + 1j * imaginary
        for pole, residue in ((p, rho), (p.conj(), rho.conj())):
            total += residue * np.expm1(pole * h) / pole / (z - np.exp(pole * h))
    return total


def line_sensitivities(theta, omega, h):
    columns = []
    for k, value in enumerate(theta):
        step = np.zeros(len(theta))
        step[k] = 1e-5 * max(abs(value), 1e-2)
        columns.append((response(theta + step, omega, h) - response(theta - step, omega, h)) / (2 * step[k]))
    return np.array(columns).T


def criterion(power, D, theta, samples, noise, first):
    """Sum of squared relative errors of n parameters from the `first`, and its gradient by the powers."""
    n = len(theta) // 4
    information = samples / noise**2 * np.einsum("k,ki,kj->ij", power, D.conj(), D).real
    scale = np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale)
    wanted = np.eye(4 * n)[first : first + n] / theta[first : first + n, None]
    gradient = -samples / noise**2 * np.sum(np.abs(D @ covariance @ wanted.T) ** 2, axis=1)
    return np.trace(wanted @ covariance @ wanted.T), gradient


def least_by_a_general_solver(D, theta, samples, noise, first):
    """Least criterion over powers that sum up to 1, `P ~ exp(x)`, by a quasi-Newton method."""

    def logarithm(x):
        power = np.exp(x - x.max())
        power /= power.sum()
        value, gradient = criterion(power, D, theta, samples, noise, first)
        return np.log(value), power * (gradient - power @ gradient) / value

    start = np.zeros(len(D))
    bounds = [(-20.0, 20.0)] * len(D)
    return np.exp(minimize(logarithm, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 2000}).fun)


@SETTINGS
@given(st.integers(0, 2**32), st.sampled_from(["damping_ratios", "natural_frequencies"]))
def test_the_spectrum_is_as_good_as_that_of_a_general_solver(seed, purpose):
    rng = np.random.default_rng(seed)
    T, h, band, n = 60, 1.0, (0.3, 2.2), 2
    d = np.array([rng.uniform(0.6, 1.0), rng.uniform(1.2, 2.0)])
    plant = phc.modes(d, rng.uniform(0.3, 1.0, n), damping=rng.uniform(0.05, 0.1, n))
    designed = phc.design_input(plant, T, h, rms=1.3, band=band, for_=purpose, noise_std=0.2)
    theta, omega = parameters(plant), 2 * np.pi * np.arange(3, 22) / (T * h)
    D, first = line_sensitivities(theta, omega, h), n * (purpose == "damping_ratios")

    least = least_by_a_general_solver(D, theta, T, 0.2, first) / 1.3**2
    power = np.zeros(len(omega))
    power[np.searchsorted(omega, designed.frequencies * (1 - 1e-9))] = designed.spectrum[0]
    reached, _ = criterion(power, D, theta, T, 0.2, first)
    assert designed.criterion == pytest.approx(reached, rel=1e-4)
    assert reached < least * (1 + 2e-3)  # the general solver may end above
    assert designed.criterion == pytest.approx(designed.least_criterion, rel=1e-3)


# --- the signal -------------------------------------------------------------------------------------------------------


def test_the_signal_has_the_spectrum_that_is_stated_and_keeps_its_limits():
    designed = phc.design_input(LIGHT, SAMPLES, STEP, rms=0.4, noise_std=0.05)
    power = 2 * np.abs(np.fft.rfft(designed.signal[0]) / SAMPLES) ** 2
    bins = np.rint(designed.frequencies * SAMPLES * STEP / (2 * np.pi)).astype(int)
    assert power[bins] == pytest.approx(designed.spectrum[0], rel=1e-6, abs=1e-9 * power.max())
    assert np.delete(power, bins).max() < 1e-20
    assert designed.rms == pytest.approx([0.4]) and designed.spectrum.sum() == pytest.approx(0.16)
    assert designed.peak_factor == pytest.approx(np.abs(designed.signal).max(axis=1) / 0.4)
    assert designed.optimal_spectrum == pytest.approx(designed.spectrum, rel=0.05, abs=1e-3)
    assert np.array_equal(designed.time, STEP * np.arange(SAMPLES))


@pytest.mark.slow
def test_a_limited_peak_is_reached_and_a_low_one():
    assert design().peak == pytest.approx([1.0])
    assert design().peak_factor[0] < 1.6
    assert design().least_criterion <= design().criterion
    both = phc.design_input(LIGHT, SAMPLES, STEP, peak=1.0, rms=0.3, noise_std=0.05)
    assert both.rms == pytest.approx([0.3]) and both.peak[0] <= 1.0


@pytest.mark.slow
def test_damping_becomes_known_twice_as_well_as_by_white_noise_of_the_same_peak():
    white = np.random.default_rng(0).standard_normal(SAMPLES)
    other = phc.excitation((white / np.abs(white).max(), None), LIGHT, dt=STEP, noise_std=0.05)
    for key in ("damping_ratios", "natural_frequencies"):
        assert np.all(design().stderr[key] < 0.2 * other.stderr[key])


def test_a_peak_is_better_used_than_by_the_optimum_alone():
    alone = phc.design_input(LIGHT, SAMPLES, STEP, rms=1.0, noise_std=0.05)
    size = alone.peak_factor[0]  # of the optimum at a peak of 1
    assert np.all(design().stderr["damping_ratios"] < 0.8 * size * alone.stderr["damping_ratios"])


def test_the_same_call_gives_the_same_signal_and_leaves_its_arguments():
    limits = np.array([0.5])
    first, second = (phc.design_input(LIGHT, 500, STEP, peak=limits, noise_std=0.1) for _ in range(2))
    assert np.array_equal(first.signal, second.signal) and limits == [0.5]


# --- what is predicted ------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("structure", ["free", *slowly("classical")])
def test_predicted_errors_are_those_that_a_fit_to_the_input_states(structure):
    rng, u = np.random.default_rng(0), design().signal[0]
    y = phc.forced_response(phc.ph(LIGHT), design().time, u, intersample="zoh").outputs
    fit = phc.pem((u, y + 0.05 * rng.standard_normal(SAMPLES)), 3, dt=STEP, structure=structure, delay=0)
    again = phc.design_input(fit, SAMPLES, STEP, peak=1.0)
    if structure == "free":
        assert design().stderr["damping_ratios"] == pytest.approx(fit.stderr["damping_ratios"], rel=0.05)
    # the signal is all but the same, as the plant is; residues of a structure are known better
    for key in ("natural_frequencies", "damping_ratios", "residues", "hertz"):
        assert np.abs(again.stderr[key]) == pytest.approx(np.abs(fit.stderr[key]), rel=0.1)


@pytest.mark.slow
def test_each_purpose_is_served_best_by_its_own_input():
    plant = phc.modes([-0.02 + 1j, -0.1 + 3j, -0.4], [[1.0], [0.5], [0.7]], [[1.0], [1.0], [1.0]])
    purposes = ("damping_ratios", "real_poles", "residues")
    designs = {name: phc.design_input(plant, 800, 0.3, rms=1.0, noise_std=0.1, for_=name) for name in purposes}

    def relative(designed, name):
        errors, values = designed.stderr[name], designed.values[name]
        sizes = np.linalg.norm(values.reshape(len(values), -1), axis=1) if name == "residues" else np.abs(values)
        return np.sum(np.abs(errors.reshape(len(values), -1)) ** 2 / sizes[:, None] ** 2)

    for name in purposes:
        assert min(purposes, key=lambda other, name=name: relative(designs[other], name)) == name


def test_several_inputs_have_lines_of_their_own_and_limits_of_their_own():
    plant = phc.modes([-0.05 + 1j, -0.2 + 3j], [[1.0, 0.5], [0.5, -1.0]], [[1.0, 0.3j], [0.2, 1.0]])
    designed = phc.design_input(plant, 600, 0.2, rms=[1.0, 2.0], noise_std=[0.1, 0.2], for_="residues")
    assert designed.signal.shape == (2, 600) and designed.rms == pytest.approx([1.0, 2.0])
    assert not np.any(designed.spectrum[0] * designed.spectrum[1]) and np.all(designed.spectrum.any(axis=1))
    white = np.random.default_rng(0).standard_normal((2, 600)) * [[1.0], [2.0]]
    other = phc.excitation((white, None), plant, dt=0.2, noise_std=[0.1, 0.2])
    same = phc.excitation((designed.signal, None), plant, dt=0.2, noise_std=[0.1, 0.2])
    assert np.array_equal(same.stderr["residues"], designed.stderr["residues"])
    assert np.sum(np.abs(designed.stderr["residues"]) ** 2) < 0.3 * np.sum(np.abs(other.stderr["residues"]) ** 2)


def test_noise_of_a_fit_moves_power_to_where_it_is_little():
    plant = phc.modes([1.0, 2.0], [1.0, 1.0], damping=0.02)
    low = phc.NoiseModel([[0.01]], 0.5, [[0.95]])
    rng, h = np.random.default_rng(0), 0.5
    u = rng.standard_normal(1500)
    y = phc.forced_response(phc.ph(plant), h * np.arange(1500), u, intersample="zoh").outputs
    e = 0.1 * rng.standard_normal(1600)
    for k in range(1, 1600):
        e[k] += 0.95 * e[k - 1]
    fit = phc.pem((u, y + e[100:]), 2, dt=h, structure="free", delay=0)
    coloured = phc.design_input(fit, 1500, h, rms=1.0)
    white = phc.design_input(fit, 1500, h, rms=1.0, noise_std=0.1)
    share = [designed.spectrum[0, designed.frequencies < 1.5].sum() for designed in (coloured, white)]
    spectra = low.spectrum([1.0, 2.0])[0, 0].real
    assert spectra[0] > 3 * spectra[1] and share[0] > 1.3 * share[1]
    with pytest.raises(phc.StructureError, match=r"samples 0.5 apart, and dt is 0.25"):
        phc.design_input(fit, 1500, 0.25, rms=1.0)


# --- degenerate plants ------------------------------------------------------------------------------------------------


@pytest.mark.variants
@pytest.mark.parametrize("size", [1e-9, 1e9])
def test_other_units_give_the_same_input(size):
    plain = phc.design_input(phc.modes(1.0, 1.0, damping=0.02), 400, 0.5, rms=1.0, noise_std=0.1)
    other = phc.design_input(phc.modes(1.0 / size, 1.0, damping=0.02), 400, 0.5 * size, rms=size, noise_std=0.1 * size)
    assert other.signal == pytest.approx(plain.signal * size, rel=1e-3, abs=1e-3 * size)
    assert other.stderr["damping_ratios"] == pytest.approx(plain.stderr["damping_ratios"], rel=1e-3)
    assert other.stderr["natural_frequencies"] == pytest.approx(plain.stderr["natural_frequencies"] / size, rel=1e-3)


def test_lossless_modes_and_lags_have_inputs_too():
    chain = phc.design_input(phc.frenkel_kontorova(2), 500, 0.2, peak=1.0, noise_std=0.1)
    assert np.all(chain.stderr["damping_ratios"] < 1e-3)
    lag = ct.tf([1.0], [5.0, 1.0])
    designed = phc.design_input(lag, 300, 0.5, rms=1.0, noise_std=0.1, for_="time_constants")
    assert designed.values["time_constants"] == pytest.approx([5.0])
    # the best lines of a lag lie about its corner
    middle = designed.frequencies @ designed.spectrum[0] / designed.spectrum.sum()
    assert 0.05 < middle < 1.0 and designed.stderr["time_constants"] < 0.5
    assert "real pole" in designed.summary()


@pytest.mark.parametrize(
    "options, message",
    [
        ({}, "neither rms nor peak is given"),
        ({"rms": -1.0}, "rms is -1.0; it must be positive"),
        ({"peak": [1.0, 2.0]}, "peak is .*; it must be positive, a number or one for each of 1 inputs"),
        ({"rms": 1.0, "band": (5.0, 4.0)}, r"it must be \(low, high\)"),
        ({"rms": 1.0, "band": (5.0, 5.001)}, "Fourier frequenc.* lie in the band"),
        ({"rms": 1.0, "band": (60.0, 60.1), "samples": 200}, "Fourier frequenc.* lie in the band"),
        ({"rms": 1.0, "for_": "real_poles"}, "the model has no real poles that are unknown"),
        ({"rms": 1.0, "for_": "shapes"}, "for_ is 'shapes'"),
        ({"rms": 1.0, "noise_std": None}, "the noise is not known: give noise_std"),
        ({"rms": 1.0, "samples": 3}, "samples"),
        ({"rms": 1.0, "model": phc.modes([0.1 + 1j], [[1.0]], [[1.0]])}, r"the pole 0.1\+1j grows"),
        ({"rms": 1.0, "model": phc.modes([-0.1 + 1j], [[1.0]], [[0.0]])}, "no input in this band shows the damping"),
        ({"rms": 1.0, "model": ct.ss([], [], [], [[1.0]])}, "the model has 1 inputs and 0 poles"),
    ],
)
def test_what_cannot_be_designed_is_refused_with_the_reason(options, message):
    known = {"model": LIGHT, "samples": 1000, "dt": STEP, "noise_std": 0.1} | options
    with pytest.raises(phc.StructureError, match=message):
        phc.design_input(known.pop("model"), known.pop("samples"), known.pop("dt"), **known)


def test_a_structure_without_damping_has_none_to_learn():
    rng, chain = np.random.default_rng(0), phc.modes([1.0, 2.0], [1.0, 0.5])
    u = rng.standard_normal(500)
    y = phc.forced_response(phc.ph(chain), 0.2 * np.arange(500), u, intersample="zoh").outputs
    fit = phc.pem((u, y + 0.05 * rng.standard_normal(500)), 2, dt=0.2, structure="lossless")
    with pytest.raises(phc.StructureError, match=r"no damping ratios that are unknown.*'lossless'"):
        phc.design_input(fit, 500, 0.2, peak=1.0)
    designed = phc.design_input(fit, 500, 0.2, peak=1.0, for_="natural_frequencies")
    assert np.all(designed.stderr["natural_frequencies"] < fit.stderr["natural_frequencies"])
