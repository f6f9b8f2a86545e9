"""Records in the frequency domain: the columns are transforms of a simulation, exactly, at every bin."""

from itertools import pairwise

import numpy as np
import pytest
from reference import EPS

from ph_control.identification.regression.free import FreeProblem, FreeProjection
from ph_control.identification.regression.modal_regressors import SampledModes
from ph_control.identification.regression.sections import PoleRegion
from ph_control.identification.regression.spectral_rows import ChannelSpectra, FreeWindow, TransformColumns
from ph_control.identification.regression.time_rows import FreeRecord
from ph_control.modal.discretization import Hold

HOLDS = [("exact", "zoh"), ("exact", "foh"), ("midpoint", "zoh"), ("midpoint", "foh"), ("euler", "zoh")]
DAMPINGS = {"lossless": np.zeros(3), "damped": np.array([0.002, 0.2, 0.05])}
D = np.array([0.31, 0.9, 1.7])
RESIDUES = np.array([0.5 + 0.1j, 0.2, 0.35 - 0.3j])


def record_of(samples=200, hold=("exact", "zoh"), p=1j * D, driven=True, seed=0):
    """A record of modes without noise, simulated sample by sample, and the transform ends `tau` of its modes."""
    rng = np.random.default_rng(seed)
    hold = Hold(0.1, *hold)
    u = rng.standard_normal(samples) * driven
    x = rng.standard_normal(len(p)) + 1j * rng.standard_normal(len(p))
    residues = RESIDUES * driven
    step, states = SampledModes.of(hold, p), [x]
    # the input goes round at its end
    for now, then in pairwise([*u, u[0]]):
        states.append(step.multiplier * states[-1] + residues * (step.b0 * now + step.b1 * then))
    y = 2 * np.real(np.array(states[:-1]).sum(axis=1))
    return FreeRecord(u[None], y[None], np.ones(samples, bool), hold, through=False, driven=driven), x - states[-1]


def frequencies(record, places):
    """Natural frequencies that the samples show at these bins."""
    return record.hold.frequency_of(2 * np.pi * np.asarray(places) / record.length)


def everywhere(spectrum):
    return FreeWindow(spectrum, np.arange(1, spectrum.last + 1))


@pytest.mark.variants
@pytest.mark.parametrize("damping", DAMPINGS)
@pytest.mark.parametrize("hold", HOLDS)
@pytest.mark.parametrize("samples, driven", [(200, True), (201, True), (200, False)])
def test_transform_of_a_simulation_is_a_combination_of_the_columns_at_every_bin(samples, driven, hold, damping):
    p = -DAMPINGS[damping] + 1j * D
    record, tau = record_of(samples, hold, p, driven)
    spectrum = ChannelSpectra.of(record)
    # the columns give the ends another name, looked for here from all bins but the constant
    at = FreeProjection([everywhere(spectrum)], p)
    motion, residues = at.own[0][:3] + 1j * at.own[0][3:], at.residues
    if driven:
        assert np.allclose(residues[:, 0, 0], RESIDUES, rtol=1e3 * samples * EPS)
    left = spectrum.unexplained(p, residues, motion, np.zeros((1, residues.shape[2])))
    assert np.abs(left).max() <= 1e3 * samples * EPS * np.abs(spectrum.Y).max()
    turned = SampledModes.of(record.hold, p).powers(np.array([float(samples)]))[:, 0]
    if not driven:
        assert np.allclose(motion[:, 0] * (1 - turned), tau, rtol=0, atol=1e3 * samples * EPS * np.abs(tau).max())


PARTS = ("ahead", "behind", "motion", "mirrored")


def parts_of(spectrum, p, bins):
    """The columns of residues and motions, each with what belongs to the conjugate, and their derivatives."""
    at = TransformColumns(spectrum.length, spectrum.record.modes(p), bins)
    over = at.numerators(spectrum.U[0])
    slopes = *at.forced_slopes(spectrum.U[0], over), *at.motion_slopes
    return dict(zip(PARTS, (*at.forced(over), *at.motion), strict=True)), dict(zip(PARTS, slopes, strict=True))


@pytest.mark.parametrize("decay", [0.0, 0.05])
@pytest.mark.parametrize("turn", [1.0, 1j])
@pytest.mark.parametrize("hold", HOLDS)
def test_slopes_of_the_columns_are_their_derivatives_on_bins_and_between(hold, turn, decay):
    spectrum = ChannelSpectra.of(record_of(hold=hold)[0])
    bins, step = np.arange(1, 100), 1e-5
    p = 1j * frequencies(spectrum.record, [4.0, 9.0 + 1e-6, 17.0 - 3e-4, 25.3, 31.5 - 1e-3]) - decay
    (ahead, _), (here, slopes), (behind, _) = (parts_of(spectrum, p + s * turn, bins) for s in (step, 0.0, -step))
    for part, column in here.items():
        difference = (ahead[part] - behind[part]) / (2 * step)
        # what belongs to the conjugate vanishes where the other peaks: they are two parts of one column
        size = np.abs(here["motion" if part == "mirrored" else part]).max(axis=1)
        # the record lasts 20: a column changes by no more than its size times this, to the power of the order; the
        # weights of the input change more slowly
        allowed = step**2 * 20.0**3 * size + 1e3 * EPS * size / step
        slope = slopes[part] * (np.conj(turn) if part in ("behind", "mirrored") else turn)
        assert (np.abs(slope - difference).max(axis=1) <= allowed).all(), part
        assert column.shape == (5, 99) and (np.abs(slope).max(axis=1) > 100 * allowed).all()


@pytest.mark.parametrize("hold", HOLDS)
@pytest.mark.parametrize("driven", [True, False])
def test_the_transform_of_a_model_is_that_of_its_columns(hold, driven):
    """Of modes on a bin, next to one, two at the same bin, and between."""
    spectrum = ChannelSpectra.of(record_of(hold=hold, driven=driven)[0])
    p = 1j * frequencies(spectrum.record, [4.0, 9.0 + 1e-6, 17.0 - 3e-4, 17.2, 25.5])
    p.real[-1] = -0.1
    bins = np.arange(0, 60)
    rng = np.random.default_rng(4)
    residues, motion = rng.standard_normal((2, 5)) + 1j * rng.standard_normal((2, 5))
    at = TransformColumns(spectrum.length, spectrum.record.modes(p), bins)
    U = np.fft.rfft(spectrum.record.u)[: int(driven)]
    over = at.numerators(U[0]) if driven else (np.zeros((5, 60), complex),) * 2
    columns = dict(zip(PARTS, (*at.forced(over), *at.motion), strict=True))
    factors = dict(zip(PARTS, (residues, residues.conj(), motion, motion.conj()), strict=True))
    parts = [factors[name][:, None] * column for name, column in columns.items()]
    (found,) = at.output(U, residues[:, None, None], motion[:, None], np.array([[0.7]]))
    expected = sum(parts).sum(axis=0) + (0.7 * U[0, bins] if driven else 0.0)
    assert np.abs(found - expected).max() <= 100 * EPS * max(np.abs(one).max() for one in parts)


@pytest.mark.variants
@pytest.mark.parametrize("hold", HOLDS)
@pytest.mark.parametrize("place", [12.0, 12.0 + 1e-12, 12.0 - 1e-7, 12.0 + 1e-4, 12.002, 12.4])
def test_transforms_of_motions_lie_in_the_span_of_the_columns_on_a_bin_as_well(hold, place):
    record, _ = record_of(400, hold)
    spectrum = ChannelSpectra.of(record)
    p, bins = 1j * frequencies(record, [place]), np.arange(5, 20)
    # of both parts of the motion and of the residue
    real = np.concatenate(list(FreeWindow(spectrum, bins).evaluated(p).blocks()))[:4].T
    real = real / np.linalg.norm(real, axis=0)
    assert np.linalg.cond(real) < 1e3
    in_time = np.concatenate(list(record.evaluated(p).blocks()), axis=1)[:4]
    motions = np.fft.rfft(in_time, axis=1)[:, bins]
    targets = np.concatenate([motions.real, motions.imag], axis=1).T
    left = targets - real @ np.linalg.lstsq(real, targets, rcond=None)[0]
    assert (np.linalg.norm(left, axis=0) <= 1e3 * 400 * EPS * np.linalg.norm(targets, axis=0)).all()


@pytest.mark.parametrize("decay", [0.0, 0.05])
def test_columns_pass_smoothly_through_a_bin(decay):
    record, _ = record_of(400)
    spectrum, bins, step = ChannelSpectra.of(record), np.arange(5, 20), 5e-4
    path = [parts_of(spectrum, 1j * frequencies(record, [12 + k * step]) - decay, bins)[0] for k in range(-20, 21)]
    for part in PARTS:
        found = np.array([at[part][0] for at in path])
        size = np.abs(path[0]["motion" if part == "mirrored" else part]).max()
        # a bin is a turn of the mode over the record
        assert np.abs(np.diff(found, 3, axis=0)).max() <= (2 * np.pi * step) ** 3 * size
        assert np.ptp(found.real) + np.ptp(found.imag) > 0


@pytest.mark.parametrize("samples", [64, 65])
def test_energies_are_the_sums_of_squares(samples):
    y = np.random.default_rng(1).standard_normal((2, samples))
    spectrum = ChannelSpectra.of(FreeRecord(0 * y, y, np.ones(samples, bool), Hold(0.1)))
    assert np.allclose(spectrum.energies(spectrum.Y), np.sum(y**2, axis=1), rtol=samples * EPS)


@pytest.mark.parametrize("hold", [("exact", "zoh"), ("midpoint", "zoh"), ("euler", "zoh")])
def test_place_and_frequency_are_inverse_to_one_another(hold):
    record, _ = record_of(hold=hold)
    places = np.array([0.25, 3.4, 17.0, 42.9])
    assert np.allclose(ChannelSpectra.of(record).place(frequencies(record, places)), places, rtol=1e3 * EPS)


def test_missing_outputs_count_as_what_is_put_in_their_place():
    record, _ = record_of()
    lost = np.arange(200) % 9 == 4
    holed = FreeRecord(record.u, np.where(lost, np.nan, record.y), ~lost, record.hold)
    assert np.array_equal(ChannelSpectra.of(holed).Y, np.fft.rfft(np.where(lost, 0.0, record.y)))


@pytest.mark.parametrize("driven", [True, False])
def test_window_holds_the_bins_about_the_modes_and_never_the_constant(driven):
    record, _ = record_of(16000, driven=driven)
    spectrum = ChannelSpectra.of(record)
    window = FreeWindow.thinned(spectrum, 1j * frequencies(record, [1.2, 900.3]))
    assert {1, 2, 3, 899, 900, 901} <= set(window.bins.tolist()) and window.bins[0] == 1
    assert window.bins[-1] <= spectrum.last and len(window.bins) < 0.5 * spectrum.last
    assert window.samples == 2 * len(window.bins) and window.inputs == driven and window.own_unknowns(2) == 4
    # of a wide peak a part, each bin counting as many
    wide = FreeWindow.thinned(spectrum, np.array([-1.0 + 1j * frequencies(record, [900.3])[0]]))
    assert wide.counts.max() > 1 and wide.counts.min() == 1


@pytest.mark.parametrize("damping", DAMPINGS)
@pytest.mark.parametrize("driven", [True, False])
def test_window_of_a_noise_free_record_shows_its_modes(driven, damping):
    p = -DAMPINGS[damping] + 1j * D
    record, _ = record_of(2000, p=p, driven=driven)
    window = FreeWindow.thinned(ChannelSpectra.of(record), p)
    at = FreeProjection([window], p)
    energy = float(np.sum(np.abs(window.counts * window.spectrum.Y[0, window.bins]) ** 2)) * 2 / 2000
    assert at.loss <= (1e3 * EPS) ** 2 * 2000 * energy
    if driven:
        assert np.allclose(at.residues[:, 0, 0], RESIDUES, rtol=1e-9)


def test_gradient_over_a_window_is_the_derivative_of_its_loss():
    record, _ = record_of(p=-DAMPINGS["damped"] + 1j * D)
    noise = 0.3 * np.random.default_rng(2).standard_normal((1, 200))
    noisy = FreeRecord(record.u, record.y + noise, record.observed, record.hold, through=False)
    start = np.array([-0.004 + 0.314j, -0.15 + 0.897j, -0.06 + 1.705j])
    window = FreeWindow.thinned(ChannelSpectra.of(noisy), start)
    problem = FreeProblem([window], PoleRegion(noisy.bin, noisy.ceiling))
    x, step = FreeProjection([window], start).x, 1e-6
    gradient = problem.project(x).gradient
    for l in range(len(x)):
        shift = step * np.eye(len(x))[l]
        difference = (problem.project(x + shift).loss - problem.project(x - shift).loss) / (4 * step)
        assert abs(gradient[l] - difference) <= 1e-5 * np.abs(gradient).max()
