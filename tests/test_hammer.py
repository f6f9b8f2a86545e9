"""Hammer tests whose force channel has noise between the contacts."""

import control as ct
import numpy as np
import pytest
from scipy.signal import lfilter

import ph_control as phc

STEP, SAMPLES, PEAK, NOISE = 0.02, 3000, 150.0, 0.03
PLANT = phc.spring_chain([1.0, 1.0, 1.0], 40.0, ground=[40.0, 0, 0], c=0.02, port=2)
TIME = STEP * np.arange(SAMPLES)
# nothing else is searched for: neither lags nor delays nor forces nor another hold
KNOWN = {"intersample": "foh", "real_poles": 0, "delay": 0.0, "noise": "white"}


def names(result):
    return [one.cause.name for one in result.findings]


def hit(seed, *, noise, background=0.0, outputs=1):
    """Recording of a hit after a pre-trigger; the background is a force, the noise is of the channel."""
    rng = np.random.default_rng(seed)
    force = np.zeros(SAMPLES)
    force[30:40] = PEAK * rng.uniform(0.7, 1.0) * np.sin(np.pi * (np.arange(10) + 0.5) / 10) ** 2
    force += background * np.sin(3.0 * TIME + rng.uniform(0, 6))
    y = phc.forced_response(PLANT, TIME, force).outputs
    y = np.array([y, 0.5 * y][:outputs])
    # as large in all recordings
    y = y + NOISE * rng.standard_normal(y.shape)
    columns = {"force": force + noise * rng.standard_normal(SAMPLES)} | {f"v{k}": row for k, row in enumerate(y)}
    return phc.recording(columns, input="force", output=list(columns)[1:], fs=1 / STEP)


@pytest.mark.variants
@pytest.mark.parametrize(("seed", "outputs"), [(0, 1), (1, 2)])
def test_noise_of_the_force_between_hits_is_no_force(seed, outputs):
    given = [hit([seed, k], noise=0.2, outputs=outputs) for k in range(3)]
    kept = [one.u.copy() for one in given]
    result = phc.pem(given, order="auto", max_order=4, **KNOWN)
    assert result.order == 3 and names(result).count("HAMMER_NOISE") == 1
    (finding,) = [one for one in result.findings if one.cause.name == "HAMMER_NOISE"]
    assert finding.values[0] == pytest.approx(0.2, rel=0.1) and 0.6 * PEAK < finding.values[1] < 1.1 * PEAK
    assert np.abs(result.natural_frequencies / np.sort(PLANT.natural_frequencies) - 1).max() < 1e-4
    assert "Outside the contacts" in result.message
    for one, before in zip(given, kept, strict=True):
        assert np.array_equal(one.u, before)
    fitted = np.ravel(result.experiments[0].record.u)
    assert np.count_nonzero(fitted) < 60 and not fitted[100:].any()


def test_a_force_without_noise_is_as_given():
    result = phc.pem([hit([2, k], noise=0.0) for k in range(2)])
    assert result.order == 3 and "HAMMER_NOISE" not in names(result)


@pytest.mark.slow
def test_a_force_between_hits_that_the_outputs_answer_stays():
    """A machine runs beside: its force is small beside the hits, but resonates."""
    given = [hit([3, k], noise=0.01, background=0.5) for k in range(2)]
    result = phc.pem(given, 3, **KNOWN)
    assert "HAMMER_NOISE" not in names(result)
    assert np.array_equal(np.ravel(result.experiments[0].record.u), np.ravel(given[0].u))


def test_a_random_force_is_no_hammer():
    rng = np.random.default_rng(4)
    force = rng.standard_normal(SAMPLES)
    y = phc.forced_response(PLANT, TIME, force, intersample="zoh").outputs
    result = phc.pem((force, y + 0.05 * y.std() * rng.standard_normal(SAMPLES)), dt=STEP)
    assert "HAMMER_NOISE" not in names(result)


def roving(seed, *, positions, samples, weak, classical=False):
    """Recordings of a hammer at one position after another: two modes at two sensors, the second `weak`."""
    rng = np.random.default_rng(seed)
    p = np.array([-0.004 + 0.5j, -0.02 + 1.9j])
    drive = rng.standard_normal((2, positions))
    shapes = np.array([1.0, weak])[:, None] * rng.choice([-1, 1], (2, 2))
    recordings = []
    for k in range(positions):
        u = np.zeros((positions, samples))
        u[k, 5:8] = [0.5, 1.0, 0.5]
        motion = [
            (size * lfilter([0, np.expm1(pole) / pole], [1, -np.exp(pole)], u[k] + 0j)).real
            for pole, size in zip(p, p / (1j * p.imag) if classical else (1, 1), strict=True)
        ]
        y = (shapes * drive[:, k, None]).T @ np.array(motion)
        recordings.append((u, y + 0.01 * rng.standard_normal(y.shape)))
    return recordings


@pytest.mark.variants
@pytest.mark.parametrize(("positions", "samples", "weak", "seed"), [(12, 400, 0.015, 2), (8, 400, 0.02, 1)])
def test_a_mode_that_each_position_shows_a_little_is_found(positions, samples, weak, seed):
    data = roving(seed, positions=positions, samples=samples, weak=weak)
    result = phc.pem(data, 2, dt=1.0, structure="free", intersample="zoh", noise="white", delay=0)
    assert result.natural_frequencies == pytest.approx([0.5, 1.9], rel=0.02)


def test_residues_of_all_positions_are_counted():
    data = roving(0, positions=3, samples=200, weak=0.3)
    options = {"structure": "free", "intersample": "zoh", "noise": "white", "delay": 0, "initial_state": "zero"}
    result = phc.pem(data, 2, dt=1.0, **options)
    poles, residues, variances = 4, 3 * 2 * 4, 2
    assert result.unknowns == poles + residues + variances + np.count_nonzero(result.feedthrough)


@pytest.mark.parametrize("seed", [1, pytest.param(6, marks=pytest.mark.slow)])
def test_a_weak_mode_with_a_shape_is_found_where_free_residues_would_be_too_many(seed):
    result = phc.pem(roving(seed, positions=3, samples=400, weak=0.018, classical=True), dt=1.0)
    assert result.structure == "classical"
    assert result.natural_frequencies == pytest.approx([0.5, 1.9], rel=0.01)


def errors_beside_force_noise(theta, hits, spread, noise):
    """Standard errors of frequencies, damping ratios and gains of a classical port, by dense matrices."""

    def velocity(theta, force):
        systems = [ct.tf([gain, 0], [1, 2 * zeta * w, w**2]) for w, zeta, gain in zip(*np.split(theta, 3), strict=True)]
        return ct.forced_response(sum(systems[1:], systems[0]), TIME, force).outputs

    information, contact = 0.0, np.arange(20, 50)
    H = np.array([velocity(theta, spread * (np.arange(SAMPLES) == k)) for k in contact])
    hits = [np.where(np.isin(np.arange(SAMPLES), contact), force, 0.0) for force in hits]
    inner = np.linalg.inv(np.eye(len(H)) + H @ H.T / noise**2)
    for force in hits:
        steps = np.diag(1e-5 * theta)
        J = np.array([velocity(theta + step, force) - velocity(theta - step, force) for step in steps])
        J /= 2e-5 * theta[:, None]
        information += J @ J.T / noise**2 - J @ H.T @ inner @ H @ J.T / noise**4  # by the lemma of Woodbury
    return np.sqrt(np.diag(np.linalg.inv(information)))


@pytest.mark.variants
@pytest.mark.parametrize(("count", "spread"), [(1, 0.3), (3, 0.3), (2, 0.9)])
def test_errors_of_the_force_within_contacts_are_in_those_of_shapes(count, spread):
    given = [hit([8, k], noise=spread) for k in range(count)]
    result = phc.pem(given, max_order=4, initial_state="zero", quantity="velocity", **KNOWN)
    assert result.order == 3 and result.structure == "classical" and "FORCES" not in names(result)
    (finding,) = [each for each in result.findings if each.cause.name == "CONTACT_NOISE"]
    assert finding.values[0] == pytest.approx(spread, rel=0.1) and finding.values[2] > 2
    assert "within the contacts" in result.message.lower()
    # unit masses, so that the shapes of unit modal mass are those of the stiffness
    gains = np.linalg.eigh([[80.0, -40.0, 0.0], [-40.0, 80.0, -40.0], [0.0, -40.0, 40.0]])[1][2] ** 2
    theta = np.concatenate([PLANT.natural_frequencies, PLANT.damping_ratios, gains])
    expected = np.split(errors_beside_force_noise(theta, [data.u[0] for data in given], spread, NOISE), 3)
    for stated, bound in zip(
        (result.stderr["natural_frequencies"], result.stderr["damping_ratios"],
         2 * gains * result.shape_stderr[:, 0].real / np.abs(result.shapes[:, 0].real)),
        expected, strict=True,
    ):  # fmt: skip
        np.testing.assert_allclose(stated, bound, rtol=0.1)
    z = (2 * np.log(np.abs(result.shapes[:, 0])) - np.log(gains)) * gains / expected[2]
    assert np.abs(z).max() < 3


def test_a_fit_to_hits_that_is_stopped_stops():
    calls = []

    def stop(progress):
        calls.append(progress)
        raise StopIteration

    result = phc.pem([hit([9, k], noise=0.3) for k in range(2)], initial_state="zero", callback=stop, **KNOWN)
    assert result.outcome.name == "INTERRUPTED" and len(calls) == 1 and "HAMMER_NOISE" in names(result)


@pytest.mark.slow
def test_errors_of_the_force_within_a_contact_are_no_mode():
    """A hit that differs from what was recorded leaves what one mode more explains, until the force is corrected."""
    rng, t = np.random.default_rng([11, 83]), np.arange(2048.0)
    frequencies, damping = np.sort(np.exp(rng.uniform(np.log(0.1), np.log(1.2), 2))), rng.uniform(0.004, 0.02, 2)
    frequencies[1] = max(frequencies[1], 1.2 * frequencies[0])
    poles = frequencies * (-damping + 1j * np.sqrt(1 - damping**2))
    shapes = rng.standard_normal((2, 1))
    plant = phc.modes(poles, shapes, shapes * (poles / (2j * poles.imag))[:, None]).state_space()
    force, width, first = np.zeros(len(t)), int(rng.integers(6, 12)), int(rng.integers(20, 100))
    force[first : first + width] = rng.uniform(0.5, 1.5) * np.sin(np.pi * np.arange(1, width + 1) / (width + 1)) ** 2
    y = np.atleast_2d(ct.forced_response(plant, t, force).outputs)
    y = y + 0.01 * y.std() * rng.standard_normal(y.shape)
    hit = force + 1e-3 * rng.standard_normal(len(t))
    result = phc.pem((hit, y), dt=1.0, intersample="foh", initial_state="zero", ports=[(0, 0)])
    assert "CONTACT_NOISE" in names(result) and (result.order, len(result.real_poles)) == (2, 0)
    assert np.all(np.abs(result.natural_frequencies - frequencies) < 4 * result.stderr["natural_frequencies"])
