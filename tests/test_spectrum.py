"""Records in the frequency domain: the columns are transforms of a simulation, exactly, at every bin."""

from itertools import pairwise

import numpy as np
import pytest
from reference import EPS

from ph_control.identification.regression.modal_regressors import QUANTITIES, output_weight, regressors
from ph_control.identification.regression.spectral_rows import SmoothColumns, Spectrum, Window
from ph_control.identification.regression.time_rows import Experiment
from ph_control.identification.regression.variable_projection import Problem
from ph_control.modal.discretization import Hold

HOLDS = [("exact", "zoh"), ("exact", "foh"), ("midpoint", "zoh"), ("midpoint", "foh"), ("euler", "zoh")]
D, KAPPA = np.array([0.31, 0.9, 1.7]), np.array([1.0, 0.4, 0.7])


def experiment_of(samples=200, hold=("exact", "zoh"), quantity="velocity", driven=True, seed=0):
    """A record of a model without noise, and the transform ends `tau` that its modes have."""
    rng = np.random.default_rng(seed)
    hold = Hold(0.1, *hold)
    u = rng.standard_normal(samples) if driven else np.zeros(samples)
    free = rng.standard_normal(3) + 1j * rng.standard_normal(3)
    longer = regressors(D, np.concatenate([u, u[:1]]), hold, quantity)
    y = (longer.columns() @ np.concatenate([KAPPA * driven, free.real, free.imag]))[:samples]
    one = Experiment(u, y, np.ones(samples, bool), hold, quantity=quantity, driven=driven)
    return one, free, _ends(one, free)


def _ends(one, free):
    """What the columns belong to, from `c (x_0 - x_T)` by the recursion itself, the record going round at its end."""
    step = one.hold.step(-1j * D)
    lam, b0, b1 = step.multiplier, step.b0[:, 0], step.b1[:, 0]
    x = free.astype(complex)
    weight = output_weight(D, one.quantity)[0]
    around = np.concatenate([one.u, one.u[:1]])
    for now, after in pairwise(around):
        x = lam * x + weight * KAPPA * one.driven * (b0 * now + b1 * after)
    return free - x


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("hold", HOLDS)
@pytest.mark.parametrize("samples, driven", [(200, True), (201, True), (200, False)])
def test_transform_of_a_simulation_is_a_combination_of_the_columns_at_every_bin(samples, driven, hold, quantity):
    one, _, tau = experiment_of(samples, hold, quantity, driven)
    spectrum = Spectrum.of(one)
    bins = np.arange(samples // 2 + 1)
    forced, (plus, minus) = spectrum.columns(D, bins)
    left = spectrum.Y - KAPPA @ forced - tau @ plus - tau.conj() @ minus
    assert np.abs(left).max() <= 100 * samples * EPS * np.abs(spectrum.Y).max()
    # the smooth columns tell the same with another name for the motion, found here from some of the bins
    at = Problem((Window(spectrum, bins[1 : spectrum.last + 1]),)).project(D)
    assert np.allclose(at.kappa, KAPPA * driven, rtol=1e3 * samples * EPS)
    left = spectrum.left(D, at.kappa, at.own[0])
    assert np.abs(left).max() <= 1e3 * samples * EPS * np.abs(spectrum.Y).max()


PARTS = ("forced", "plus", "minus")


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("hold", HOLDS)
def test_slopes_of_the_columns_are_their_derivatives_on_bins_and_between(hold, quantity):
    spectrum = Spectrum.of(experiment_of(hold=hold, quantity=quantity)[0])
    bins, step = np.arange(1, 100), 1e-5
    d = spectrum.frequency(np.array([4.0, 9.0 + 1e-6, 17.0 - 3e-4, 25.3, 31.5 - 1e-3]))
    ahead, here, behind = (SmoothColumns(spectrum, d + s, bins) for s in (step, 0.0, -step))
    for part, slope in zip(PARTS, here.slopes, strict=True):
        column = getattr(here, part)
        difference = (getattr(ahead, part) - getattr(behind, part)) / (2 * step)
        # `plus` vanishes where `minus` peaks: they are two parts of one column
        size = np.abs(here.minus if part == "plus" else column).max(axis=1)
        # the record lasts 20: a column changes by no more than its size times this, to the power of the order; the
        # weights of the input and of the sensor change more slowly
        allowed = step**2 * 20.0**3 * size + 1e3 * EPS * size / step
        assert (np.abs(slope - difference).max(axis=1) <= allowed).all(), part
        assert (np.abs(slope).max(axis=1) > 100 * allowed).all()


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("hold", HOLDS)
@pytest.mark.parametrize("driven", [True, False])
def test_the_transform_of_a_model_is_that_of_its_columns(hold, quantity, driven):
    """Of modes on a bin, next to one, two at the same bin, and between."""
    spectrum = Spectrum.of(experiment_of(hold=hold, quantity=quantity, driven=driven)[0])
    d = spectrum.frequency(np.array([4.0, 9.0 + 1e-6, 17.0 - 3e-4, 17.2, 25.5]))
    at = SmoothColumns(spectrum, d, np.arange(0, 60))
    rng = np.random.default_rng(4)
    kappa, motion = rng.random(5), rng.standard_normal(5) + 1j * rng.standard_normal(5)
    parts = [kappa[:, None] * at.forced, motion[:, None] * at.plus, motion.conj()[:, None] * at.minus]
    assert np.abs(at.output(kappa, motion) - sum(parts).sum(axis=0)).max() <= 100 * EPS * np.abs(parts).max()


@pytest.mark.parametrize("hold", HOLDS)
@pytest.mark.parametrize("place", [12.0, 12.0 + 1e-12, 12.0 - 1e-7, 12.0 + 1e-4, 12.002, 12.4])
def test_transforms_of_motions_lie_in_the_span_of_the_columns_on_a_bin_as_well(hold, place):
    one, *_ = experiment_of(400, hold)
    spectrum = Spectrum.of(one)
    d, bins = spectrum.frequency(np.array([place])), np.arange(5, 20)
    at = SmoothColumns(spectrum, d, bins)
    columns = np.concatenate([at.forced, at.plus + at.minus, 1j * (at.plus - at.minus)])
    real = np.concatenate([columns.real, columns.imag], axis=1).T
    real = real / np.linalg.norm(real, axis=0)
    assert np.linalg.cond(real) < 1e3
    motions = np.fft.rfft(regressors(d, one.u, one.hold).columns(), axis=0)[bins]
    targets = np.concatenate([motions.real, motions.imag])
    left = targets - real @ np.linalg.lstsq(real, targets, rcond=None)[0]
    assert (np.linalg.norm(left, axis=0) <= 1e3 * 400 * EPS * np.linalg.norm(targets, axis=0)).all()


def test_columns_pass_smoothly_through_a_bin():
    spectrum = Spectrum.of(experiment_of(400)[0])
    bins = np.arange(5, 20)
    step = 5e-4
    path = [SmoothColumns(spectrum, spectrum.frequency(np.array([12 + k * step])), bins) for k in range(-20, 21)]
    for part in PARTS:
        found = np.array([getattr(at, part)[0] for at in path])
        size = np.abs(path[0].minus if part == "plus" else found).max()
        # a bin is a turn of the mode over the record
        assert np.abs(np.diff(found, 3, axis=0)).max() <= (2 * np.pi * step) ** 3 * size
        assert np.ptp(found.real) + np.ptp(found.imag) > 0


@pytest.mark.parametrize("samples", [64, 65])
def test_energy_is_the_sum_of_squares(samples):
    y = np.random.default_rng(1).standard_normal(samples)
    one = Experiment(0 * y, y, np.ones(samples, bool), Hold(0.1))
    spectrum = Spectrum.of(one)
    assert np.isclose(spectrum.energy(spectrum.Y), y @ y, rtol=samples * EPS)


@pytest.mark.parametrize("hold", [("exact", "zoh"), ("midpoint", "zoh"), ("euler", "zoh")])
def test_place_and_frequency_are_inverse_to_one_another(hold):
    spectrum = Spectrum.of(experiment_of(hold=hold)[0])
    places = np.array([0.25, 3.4, 17.0, 42.9])
    assert np.allclose(spectrum.place(spectrum.frequency(places)), places, rtol=1e3 * EPS)


def test_missing_outputs_count_as_what_is_put_in_their_place():
    one, *_ = experiment_of()
    lost = np.arange(200) % 9 == 4
    holed = Experiment(one.u, np.where(lost, np.nan, one.y), ~lost, one.hold)
    assert np.array_equal(Spectrum.of(holed, one.y).Y, Spectrum.of(one).Y)
    assert np.array_equal(Spectrum.of(holed).Y, np.fft.rfft(np.where(lost, 0.0, one.y)))


@pytest.mark.parametrize("driven", [True, False])
def test_window_holds_the_bins_about_the_modes_and_never_the_constant(driven):
    one, *_ = experiment_of(driven=driven)
    spectrum = Spectrum.of(one)
    d = spectrum.frequency(np.array([1.2, 40.3]))
    window = Window.about(spectrum, d, 3)
    assert window.bins.tolist() == [1, 2, 3, 4, 37, 38, 39, 40, 41, 42, 43]
    assert window.samples == 22 and window.driven is driven and window.own_unknowns(2) == 4
    assert window.bin == one.bin and window.ceiling == one.ceiling
    assert window.largest == np.abs(spectrum.Y[window.bins]).max()
    assert Window.about(spectrum, spectrum.frequency(np.array([99.0])), 5).bins.tolist() == list(range(94, 100))


@pytest.mark.parametrize("driven", [True, False])
def test_window_of_a_noise_free_record_shows_its_modes(driven):
    one, *_ = experiment_of(driven=driven)
    window = Window.about(Spectrum.of(one), D, 8)
    at = Problem((window,)).project(D)
    energy = float(np.sum(np.abs(window.spectrum.Y[window.bins]) ** 2))
    assert at.loss <= (1e3 * EPS) ** 2 * 200 * energy
    assert np.allclose(at.kappa, KAPPA * driven, rtol=1e-9)
    predicted = at.predicted()[0]
    assert np.abs(predicted - window.spectrum.Y).max() <= 1e-9 * np.abs(window.spectrum.Y).max()


def test_gradient_over_a_window_is_the_derivative_of_its_loss():
    one, *_ = experiment_of()
    noise = np.random.default_rng(2).standard_normal(200)
    noisy = Experiment(one.u, one.y + 0.3 * noise, one.observed, one.hold)
    problem = Problem((Window.about(Spectrum.of(noisy), D, 8),))
    d, step = D + np.array([0.004, -0.003, 0.005]), 1e-6
    gradient = problem.project(d).gradient
    for l in range(3):
        shift = step * np.eye(3)[l]
        difference = (problem.project(d + shift).loss - problem.project(d - shift).loss) / (4 * step)
        assert abs(gradient[l] - difference) <= 1e-5 * np.abs(gradient).max()
