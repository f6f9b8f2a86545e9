"""Covariance of the estimates, against finite differences of a dense prediction and against repeated noise."""

from functools import partial

import numpy as np
import pytest
from reference import EPS
from scipy.signal import lfilter
from slow import slowly

import ph_control as phc
from ph_control.identification.regression.free import FreeProjection
from ph_control.identification.regression.time_rows import FreeRecord
from ph_control.modal.discretization import Hold

lossless_fit = partial(phc.pem, structure="lossless")

D, R = np.array([0.7, 2.0, 3.5]), np.array([1.0, 0.4, 0.2])
N = len(D)
QUANTITIES = ("velocity", "displacement", "acceleration")


def predicted(d, r, state, u, h, quantity="velocity"):
    """Output from a state in Williamson coordinates, one complex recursion for each mode."""
    n = len(d)
    y = u * (r * d).sum() if quantity == "acceleration" else np.zeros(len(u))
    weight = {"velocity": np.ones(n) + 0j, "displacement": 1j / d, "acceleration": -1j * d}[quantity]
    for l in range(n):
        lam = np.exp(-1j * d[l] * h)
        start = d[l] * np.sqrt(r[l]) * (state[l] + 1j * state[n + l])
        pushed = np.concatenate([[start], r[l] * (1 - lam) / 1j * u[:-1]])
        y = y + (weight[l] * lfilter([1.0], [1.0, -lam], pushed)).real
    return y


def recording(samples, h, seed, noise=0.1, quantity="velocity", offset=0.0, d=D, r=R, size=None):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(samples)
    y = predicted(d, r, rng.standard_normal(2 * len(d)), u, h, quantity)
    y = y + noise * (np.std(y) if size is None else size) * rng.standard_normal(samples) + offset
    y[rng.random(samples) < 0.03] = np.nan
    return u, y


def dense_covariance(result, experiments, steps, quantity, with_offset):
    """`s^2 (J^T J)^-1` of `(d, r, states, offsets)`, differences of the dense prediction, and `s^2`.

    What is fed through to an accelerometer is unknown as well.
    """
    n, count = result.order, len(experiments)
    felt = [result.feedthrough.ravel()] if quantity == "acceleration" else []
    theta = np.concatenate([result.d, result.r, *result.initial_states, *felt, result.offsets[: count * with_offset]])

    def output(theta):
        states = theta[2 * n : 2 * n * (1 + count)].reshape(count, 2 * n)
        constants = theta[-count:] if with_offset else np.zeros(count)
        # what an accelerometer feels beside that of these modes
        beside = theta[2 * n * (1 + count)] - theta[:n] @ theta[n : 2 * n] if felt else 0.0
        return np.concatenate([
            (predicted(theta[:n], theta[n : 2 * n], states[k], u, steps[k], quantity) + beside * u + constants[k])[
                ~np.isnan(y)
            ]
            for k, (u, y) in enumerate(experiments)
        ])  # fmt: skip

    J = np.empty((len(output(theta)), len(theta)))
    for k in range(len(theta)):
        shift = np.zeros(len(theta))
        shift[k] = 1e-5 * max(abs(theta[k]), 0.1)
        J[:, k] = (output(theta + shift) - output(theta - shift)) / (2 * shift[k])
    left = np.concatenate([y[~np.isnan(y)] for _, y in experiments]) - output(theta)
    lengths = np.linalg.norm(J, axis=0)
    variance = left @ left / (len(left) - len(theta))
    return variance * np.linalg.inv((J / lengths).T @ (J / lengths)) / np.outer(lengths, lengths), variance


def residues_of(d, r, quantity):
    """Real or imaginary part, whichever is not 0, of the residues, and its derivatives by `(d, r)`, (n, 2n)."""
    power, sign = {"velocity": (1, 1), "displacement": (0, -1), "acceleration": (2, 1)}[quantity]
    slopes = np.concatenate([np.diag(power * r * d ** (power - 1.0)), np.diag(d**power)], axis=1)
    return 0.5 * sign * r * d**power, 0.5 * sign * slopes


@pytest.mark.variants
@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("offset", [False, True])
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_covariance_is_that_of_the_dense_fisher_information(quantity, offset, count):
    steps = [0.1, 0.13][:count]
    experiments = [
        # noise as large in both
        recording(T, h, T, quantity=quantity, offset=2.0 * offset, size=2.0)
        for T, h in zip([500, 400], steps, strict=False)
    ]
    result = lossless_fit(experiments, N, dt=steps, quantity=quantity, offset=offset)
    expected, variance = dense_covariance(result, experiments, steps, quantity, offset)
    assert np.isclose(result.noise_variance[0], variance, rtol=2 / 400)
    # errors rest on the variance that the free model leaves: one factor for all, known as the variance is
    factor = result.stderr["d"][0] ** 2 / expected[0, 0]
    assert abs(factor - 1) < 4 * np.sqrt(2 * (3 * N + 1)) / 400
    deviation = np.sqrt(factor * np.diag(expected))
    # sensitivities by central differences over 1e-5 of records of about 50 radians
    assert np.allclose(result.stderr["d"], deviation[:N], rtol=1e-5)
    assert np.allclose(result.stderr["r"], deviation[N : 2 * N], rtol=1e-5)
    assert np.allclose(np.ravel(result.stderr["initial_state"]), deviation[2 * N :][: 2 * N * count], rtol=1e-5)
    assert result.stderr["initial_state"].shape == ((2 * N,) if count == 1 else (count, 2 * N))
    if offset:
        assert np.allclose(result.stderr["offset"], deviation[-count:], rtol=1e-5)
    # frequencies and residues together
    residues, slopes = residues_of(result.d, result.r, quantity)
    T = np.concatenate([np.eye(N, 2 * N), slopes])
    shown = factor * T @ expected[: 2 * N, : 2 * N] @ T.T
    first = (2 if quantity == "velocity" else 3) * N
    places = np.concatenate([np.arange(N), first + np.arange(N)])
    found, size = result.covariance[np.ix_(places, places)], np.sqrt(np.diag(shown))
    turned = result.residues[:, 0, 0].real if quantity == "velocity" else result.residues[:, 0, 0].imag
    assert np.allclose(turned, residues, rtol=1e-12)
    assert np.abs((found - shown) / np.outer(size, size)).max() <= 1e-5
    assert np.array_equal(np.isnan(result.covariance), np.isnan(result.covariance.T))
    assert np.allclose(found, found.T, rtol=0, atol=100 * EPS * np.abs(found).max())
    # damping is none, and known to be
    assert not result.stderr["damping_ratios"].any() and not result.damping_ratios.any()


def test_covariance_of_a_plant_at_rest_has_no_states():
    rng = np.random.default_rng(0)
    u = rng.standard_normal(500)
    y = predicted(D, R, np.zeros(2 * N), u, 0.1) + 0.1 * rng.standard_normal(500)
    result = lossless_fit((u, y), N, dt=0.1, initial_state="zero")
    assert np.isnan(result.stderr["initial_state"]).all() and not result.initial_state.any()
    theta, step, still = np.concatenate([result.d, result.r]), 1e-5, np.zeros(2 * N)

    def at(theta):
        return predicted(theta[:N], theta[N:], still, u, 0.1)

    J = np.array([(at(theta + shift) - at(theta - shift)) / (2 * step) for shift in step * np.eye(2 * N)]).T
    deviation = np.sqrt(np.diag(np.linalg.inv(J.T @ J)))
    found = np.concatenate([result.stderr["d"], result.stderr["r"]])
    assert np.allclose(found / deviation, found[0] / deviation[0], rtol=1e-5)
    assert abs((found[0] / deviation[0]) ** 2 / result.noise_variance[0] - 1) < 4 * np.sqrt(2 * (2 * N + 1)) / 500


def test_a_weight_held_at_zero_has_no_error_and_its_mode_no_state():
    known = {"dt": 0.1, "intersample": "zoh", "delay": 0.0, "noise": "white"}
    u, y = recording(800, 0.1, 1, noise=0.05)
    y = y - predicted(np.array([5.0]), np.array([0.1]), np.array([8.0, 0.0]), u, 0.1)
    result = lossless_fit((u, y), N + 1, **known)
    assert result.r[3] == 0 and abs(result.d[3] - 5.0) < 0.05
    for name in ("r", "kappa", "residues"):
        missing = np.isnan(result.stderr[name].ravel())
        assert missing.tolist() == [False, False, False, True], name
    assert np.isnan(result.stderr["initial_state"]).reshape(2, -1).tolist() == [[False, False, False, True]] * 2
    # the frequency of what moves there is known, and what is known of the others hardly changes
    assert 0 < result.stderr["d"][3] < 0.01
    intervals = result.confidence_interval()
    assert np.isnan(intervals["r"][3]).all() and np.isfinite(intervals["d"]).all()
    without = lossless_fit((u, y + predicted(result.d[3:], np.array([1e-9]), 0 * result.d[:2], u, 0.1)), N + 1, **known)
    assert np.allclose(without.stderr["d"], result.stderr["d"], rtol=1e-3)


def reversed_sensor():
    """A record whose third mode answers with the wrong sign: nothing that a plant at rest can do helps."""
    rng = np.random.default_rng(6)
    u = rng.standard_normal(400)
    y = predicted(D[:2], R[:2], np.zeros(4), u, 0.1) - 0.3 * predicted(D[2:], R[2:], np.zeros(2), u, 0.1)
    return u, y + 0.02 * rng.standard_normal(400)


def test_a_mode_that_neither_answers_nor_moves_has_a_frequency_without_error():
    rng = np.random.default_rng(1)
    u = rng.standard_normal(400)
    y = -predicted(np.array([2.0]), np.array([0.5]), np.zeros(2), u, 0.1) + 0.05 * rng.standard_normal(400)
    result = lossless_fit((u, y), 1, dt=0.1, initial_state="zero")
    assert result.r[0] == 0 and np.isnan(result.stderr["d"][0]) and np.isnan(result.stderr["r"][0])
    assert result.success and result.verdict == "NOT described by a model of this structure"


def test_a_controllable_model_has_no_mode_without_weight():
    result = lossless_fit(reversed_sensor(), 3, dt=0.1, initial_guess=(D, R), representation="controllable")
    assert np.all(result.r > 0) and result.order < 3
    assert np.isfinite(result.stderr["d"]).all() and np.isfinite(result.stderr["r"]).all()


def test_order_of_the_modes_in_the_search_does_not_matter():
    u, y = recording(400, 0.1, 3)
    rows = FreeRecord(u[None], np.nan_to_num(y)[None], ~np.isnan(y), Hold(0.1), offset=1)
    found = []
    for order in ([0, 1, 2], [2, 0, 1]):
        at = FreeProjection([rows], (-0.01 + 1j * D)[order])
        places = np.argsort(order)
        every = np.concatenate([places + k * N for k in range(4)])
        found.append(at.covariance(1.0)[np.ix_(every, every)])
    scale = np.sqrt(np.diag(found[0]))
    assert np.abs((found[0] - found[1]) / np.outer(scale, scale)).max() <= 1e6 * EPS


@pytest.mark.parametrize("quantity", [QUANTITIES[1], *slowly(QUANTITIES[0], *QUANTITIES[2:])])
def test_standard_errors_are_those_of_repeated_noise(quantity):
    rng = np.random.default_rng(4)
    d, r, samples, seeds = D[:2], R[:2], 250, 30
    u, state = rng.standard_normal(samples), rng.standard_normal(4)
    clean = predicted(d, r, state, u, 0.1, quantity)
    deviation = 0.05 * np.std(clean)
    scores = []
    for seed in range(seeds):
        y = clean + deviation * np.random.default_rng(1000 + seed).standard_normal(samples)
        # nothing but the parameters is looked for
        result = lossless_fit(
            (u, y), 2, dt=0.1, quantity=quantity, initial_guess=(d, r), intersample="zoh", delay=0.0, noise="white",
            offset=False,
        )  # fmt: skip
        scores.append(np.concatenate([
            (result.d - d) / result.stderr["d"], (result.r - r) / result.stderr["r"],
            (result.initial_state - state) / result.stderr["initial_state"],
        ]))  # fmt: skip
    mean_square = np.mean(np.square(scores), axis=0)
    # eight tests at three deviations of a chi-squared mean
    assert (np.abs(mean_square - 1) <= 3 * np.sqrt(2 / seeds)).all()
    assert abs(np.mean(mean_square) - 1) <= 3 * np.sqrt(2 / seeds / 4)


def test_more_data_shrink_the_errors_as_they_should():
    # errors of frequencies fall with the length to the power 3/2, of weights with its root
    known = {"dt": 0.1, "intersample": "zoh", "delay": 0.0, "noise": "white"}
    short, long = (lossless_fit(recording(T, 0.1, 5, noise=0.1), N, **known) for T in (500, 4000))
    assert np.allclose(np.mean(long.stderr["d"] / short.stderr["d"]), 8**-1.5, rtol=0.4)
    twice = recording(500, 0.1, 4)
    both = lossless_fit([twice, twice], N, **known)
    # the same record twice: half the variance, whatever belongs to each of them being known separately; that of the
    # noise is what a free model leaves, with poles and residues, and a motion for each record
    one, samples = lossless_fit(twice, N, **known), int(np.sum(~np.isnan(twice[1])))
    degrees = (2 * samples - 8 * N) / (samples - 6 * N)
    assert np.allclose(both.d, one.d, rtol=1e-6)
    assert np.allclose((one.stderr["d"] / both.stderr["d"]) ** 2, degrees, rtol=1e-6)
