"""Records in the frequency domain: the columns are transforms of a simulation, exactly, at every bin."""

from itertools import pairwise

import numpy as np
import pytest
from reference import EPS

from ph_control.identification.regression.modal_regressors import QUANTITIES, SampledModes
from ph_control.identification.regression.spectral_rows import Spectrum, TransformColumns, Window
from ph_control.identification.regression.time_rows import RecordRows
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
    u_next = np.append(u, u[0])
    longer = RecordRows(u_next, u_next, np.ones(samples + 1, bool), hold, quantity=quantity)
    y = (longer.sensitivities(D, KAPPA, free)[:, 3:] @ np.concatenate([KAPPA * driven, free.real, free.imag]))[:samples]
    one = RecordRows(u, y, np.ones(samples, bool), hold, quantity=quantity, driven=driven)
    return one, free, _ends(one, free)


def _ends(one, free):
    """What the columns belong to, from `c (x_0 - x_T)` by the recursion itself, the record going round at its end."""
    step = SampledModes.lossless(one.hold, D, one.quantity)
    x = free.astype(complex)
    around = np.concatenate([one.u, one.u[:1]])
    for now, after in pairwise(around):
        x = step.multiplier * x + KAPPA * one.driven * (step.b0 * now + step.b1 * after)
    return free - x


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("hold", HOLDS)
@pytest.mark.parametrize("samples, driven", [(200, True), (201, True), (200, False)])
def test_transform_of_a_simulation_is_a_combination_of_the_columns_at_every_bin(samples, driven, hold, quantity):
    one, _, tau = experiment_of(samples, hold, quantity, driven)
    spectrum = Spectrum.of(one)
    bins = np.arange(samples // 2 + 1)
    # the columns give the ends another name, found here from all bins but the constant
    at = Problem((Window(spectrum, bins[1 : spectrum.last + 1]),)).project(D)
    assert np.allclose(at.kappa, KAPPA * driven, rtol=1e3 * samples * EPS)
    left = Window(spectrum, bins).at(D).left(at.kappa, at.own[0])
    assert np.abs(left).max() <= 1e3 * samples * EPS * np.abs(spectrum.Y).max()
    motion = at.own[0][:3] + 1j * at.own[0][3:]
    turned = SampledModes.of(one.hold, 1j * D).powers(np.array([float(samples)]))[:, 0]
    if not driven:
        assert np.allclose(2 * motion * (1 - turned), tau.conj(), rtol=0, atol=1e3 * samples * EPS * np.abs(tau).max())


PARTS = ("ahead", "behind", "motion", "mirrored")


def parts_of(spectrum, d, bins):
    """The columns of residues and motions of lossless modes, each with what belongs to the conjugate."""
    at = TransformColumns(spectrum.length, spectrum.lossless(d), bins)
    over = at.numerators(spectrum.U)
    slopes = *at.forced_slopes(spectrum.U, over), *at.motion_slopes
    return dict(zip(PARTS, (*at.forced(over), *at.motion), strict=True)), dict(zip(PARTS, slopes, strict=True))


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("hold", HOLDS)
def test_slopes_of_the_columns_are_their_derivatives_on_bins_and_between(hold, quantity):
    spectrum = Spectrum.of(experiment_of(hold=hold, quantity=quantity)[0])
    bins, step = np.arange(1, 100), 1e-5
    d = spectrum.frequency(np.array([4.0, 9.0 + 1e-6, 17.0 - 3e-4, 25.3, 31.5 - 1e-3]))
    (ahead, _), (here, slopes), (behind, _) = (parts_of(spectrum, d + s, bins) for s in (step, 0.0, -step))
    for part, column in here.items():
        difference = (ahead[part] - behind[part]) / (2 * step)
        # what belongs to the conjugate vanishes where the other peaks: they are two parts of one column
        size = np.abs(here["motion" if part == "mirrored" else part]).max(axis=1)
        # the record lasts 20: a column changes by no more than its size times this, to the power of the order; the
        # weights of the input and of the sensor change more slowly
        allowed = step**2 * 20.0**3 * size + 1e3 * EPS * size / step
        assert (np.abs(slopes[part] - difference).max(axis=1) <= allowed).all(), part
        assert column.shape == (5, 99) and (np.abs(slopes[part]).max(axis=1) > 100 * allowed).all()


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("hold", HOLDS)
@pytest.mark.parametrize("driven", [True, False])
def test_the_transform_of_a_model_is_that_of_its_columns(hold, quantity, driven):
    """Of modes on a bin, next to one, two at the same bin, and between."""
    spectrum = Spectrum.of(experiment_of(hold=hold, quantity=quantity, driven=driven)[0])
    d = spectrum.frequency(np.array([4.0, 9.0 + 1e-6, 17.0 - 3e-4, 17.2, 25.5]))
    bins = np.arange(0, 60)
    rng = np.random.default_rng(4)
    residues, motion = rng.standard_normal((2, 5)) + 1j * rng.standard_normal((2, 5))
    at, (columns, _) = TransformColumns(spectrum.length, spectrum.lossless(d), bins), parts_of(spectrum, d, bins)
    factors = dict(zip(PARTS, (residues * driven, residues.conj() * driven, motion, motion.conj()), strict=True))
    parts = [factors[name][:, None] * column for name, column in columns.items()]
    U, each = spectrum.U[None][: int(driven)], residues[:, None, None]
    (found,) = at.output(U, each, motion[:, None], np.array([[0.7]]))
    expected = sum(parts).sum(axis=0) + 0.7 * spectrum.U[bins] * driven
    assert np.abs(found - expected).max() <= 100 * EPS * max(np.abs(one).max() for one in parts)


@pytest.mark.parametrize("hold", HOLDS)
@pytest.mark.parametrize("place", [12.0, 12.0 + 1e-12, 12.0 - 1e-7, 12.0 + 1e-4, 12.002, 12.4])
def test_transforms_of_motions_lie_in_the_span_of_the_columns_on_a_bin_as_well(hold, place):
    one, *_ = experiment_of(400, hold)
    spectrum = Spectrum.of(one)
    d, bins = spectrum.frequency(np.array([place])), np.arange(5, 20)
    real = np.concatenate(list(Window(spectrum, bins).at(d).blocks()))[:-1].T
    real = real / np.linalg.norm(real, axis=0)
    assert np.linalg.cond(real) < 1e3
    motions = np.fft.rfft(one.sensitivities(d, KAPPA[:1], np.zeros(1, complex))[:, 1:], axis=0)[bins]
    targets = np.concatenate([motions.real, motions.imag])
    left = targets - real @ np.linalg.lstsq(real, targets, rcond=None)[0]
    assert (np.linalg.norm(left, axis=0) <= 1e3 * 400 * EPS * np.linalg.norm(targets, axis=0)).all()


def test_columns_pass_smoothly_through_a_bin():
    spectrum = Spectrum.of(experiment_of(400)[0])
    bins = np.arange(5, 20)
    step = 5e-4
    path = [parts_of(spectrum, spectrum.frequency(np.array([12 + k * step])), bins)[0] for k in range(-20, 21)]
    for part in PARTS:
        found = np.array([at[part][0] for at in path])
        size = np.abs(path[0]["motion"] if part == "mirrored" else found).max()
        # a bin is a turn of the mode over the record
        assert np.abs(np.diff(found, 3, axis=0)).max() <= (2 * np.pi * step) ** 3 * size
        assert np.ptp(found.real) + np.ptp(found.imag) > 0


@pytest.mark.parametrize("samples", [64, 65])
def test_energy_is_the_sum_of_squares(samples):
    y = np.random.default_rng(1).standard_normal(samples)
    one = RecordRows(0 * y, y, np.ones(samples, bool), Hold(0.1))
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
    holed = RecordRows(one.u, np.where(lost, np.nan, one.y), ~lost, one.hold)
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
    left = window.at(D).left(at.kappa, at.own[0])
    assert np.abs(left).max() <= 1e-9 * np.abs(window.spectrum.Y).max()


def test_gradient_over_a_window_is_the_derivative_of_its_loss():
    one, *_ = experiment_of()
    noise = np.random.default_rng(2).standard_normal(200)
    noisy = RecordRows(one.u, one.y + 0.3 * noise, one.observed, one.hold)
    problem = Problem((Window.about(Spectrum.of(noisy), D, 8),))
    d, step = D + np.array([0.004, -0.003, 0.005]), 1e-6
    gradient = problem.project(d).gradient
    for l in range(3):
        shift = step * np.eye(3)[l]
        difference = (problem.project(d + shift).loss - problem.project(d - shift).loss) / (4 * step)
        assert abs(gradient[l] - difference) <= 1e-5 * np.abs(gradient).max()
