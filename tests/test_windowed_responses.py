"""Responses that were estimated with a window: modes as it shows them, errors as blocks leave them."""

from __future__ import annotations

from functools import cache

import control as ct
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import fftconvolve, get_window

import ph_control as phc
from ph_control.analysis.spectral_window import SpectralWindow
from ph_control.exceptions import StructureError
from ph_control.identification.data.windowed import error_bands

N, H = 128, 0.5
W, ZETA = np.array([0.7, 1.6]), np.array([0.012, 0.01])
LONG = {}  # answers that have died away


def plant(quantity="velocity", outputs=1):
    """Two modes with classical damping; the first output is at the force."""
    phi = np.array([[1.0, 0.6], [-0.8, 1.1]])[:, :outputs]
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.diag(W**2), -np.diag(2 * ZETA * W)]])
    B = np.concatenate([np.zeros(2), phi[:, 0]])[:, None]
    C = {
        "displacement": np.hstack([phi.T, np.zeros((outputs, 2))]),
        "velocity": np.hstack([np.zeros((outputs, 2)), phi.T]),
        "acceleration": phi.T @ np.hstack([-np.diag(W**2), -np.diag(2 * ZETA * W)]),
    }[quantity]
    D = phi.T @ phi[:, :1] if quantity == "acceleration" else np.zeros((outputs, 1))
    return A, B, C, D


def answers(system, count, hold="zoh", step=H):
    """Samples of the outputs (p, count) after one sample of the input, by exponentials of matrices."""
    A, B, C, D = system
    n = len(A)
    big = np.zeros((n + 2, n + 2))
    big[:n, :n], big[:n, n : n + 1], big[n, n + 1] = A * step, B * step, 1.0
    E = expm(big)
    F, first, rise = E[:n, :n], E[:n, n : n + 1], E[:n, n + 1 :]
    now, then = (first, 0 * first) if hold == "zoh" else (first - rise, rise)
    g, x = [(C @ then + D)[:, 0]], F @ then + now
    for _ in range(count - 1):
        g.append((C @ x)[:, 0])
        x = F @ x
    return np.array(g).T


def mean_of_the_estimate(system, window, hold="zoh"):
    """Lines 2 to N/2 - 1 of E[H1] over the response of the hold, by its sum."""
    r = np.correlate(window, window, "full")[len(window) - 1 :]
    line = 2 * np.pi / (len(window) * H)
    omega = line * np.arange(2, len(window) // 2)
    if hold == "bandlimited":  # the integral in place of the sum, by steps 40 times as short
        fine = H / 40
        t = fine * np.arange(len(window) * 40)
        g = answers(system, len(t), step=fine)[:, 1:] / fine
        g = np.concatenate([1.5 * g[:, :1] - 0.5 * g[:, 1:2], 0.5 * (g[:, 1:] + g[:, :-1])], axis=1)
        weight = fine * np.interp(t[:-1], H * np.arange(len(window)), r / r[0])
        weight[0] *= 0.5
        return omega, (weight * g) @ np.exp(-1j * np.outer(t[:-1], omega))
    g = answers(system, len(window), hold) * (r / r[0])
    half = np.sinc(omega * H / (2 * np.pi))
    return omega, (g @ np.exp(-1j * H * np.outer(np.arange(len(window)), omega))) / (
        half * np.exp(-0.5j * omega * H) if hold == "zoh" else half**2
    )


def record(system, blocks, seed, noise=0.1):
    """Input and outputs of a plant that has moved for long."""
    rng = np.random.default_rng(seed)
    T = blocks * N
    u = rng.standard_normal(T + 2000)
    key = tuple(map(tuple, system[2])), float(system[3][0, 0])
    if key not in LONG:
        LONG[key] = answers(system, 2000)
    y = np.array([fftconvolve(u, g)[2000 : 2000 + T] for g in LONG[key]])
    return u[2000:], y + noise * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape)


def estimate(system, blocks, seed, noise=0.1):
    """Spectral estimate of such a record."""
    u, y = record(system, blocks, seed, noise)
    return phc.spectral_estimate(ct.TimeResponseData(H * np.arange(len(u)), y, inputs=u), segments=2 * blocks - 1)


def matrix(system, blocks, seed, noise=0.1):
    """H1 of several outputs, as a user computes it."""
    u, y = record(system, blocks, seed, noise)
    window, starts = get_window("hann", N), range(0, len(u) - N + 1, N // 2)
    U = np.array([np.fft.rfft(window * u[k : k + N]) for k in starts])
    Y = np.array([np.fft.rfft(window * y[:, k : k + N]) for k in starts])
    lines = np.arange(2, N // 2)
    omega = 2 * np.pi * lines / (N * H)
    response = (np.sum(Y * U.conj()[:, None], axis=0) / np.sum(np.abs(U) ** 2, axis=0))[:, None, lines]
    return response / (np.sinc(omega * H / (2 * np.pi)) * np.exp(-0.5j * omega * H)), omega


# --- the mean --------------------------------------------------------------------------------------------------------


@pytest.mark.variants
@pytest.mark.parametrize(
    ("window", "hold", "quantity"),
    [
        ("hann", "zoh", "velocity"), ("hann", "foh", "velocity"), ("boxcar", "zoh", "displacement"),
        ("hann", "zoh", "acceleration"), (("kaiser", 7.0), "zoh", "velocity"),
    ],
)  # fmt: skip
def test_the_mean_of_an_estimate_gives_the_plant(window, hold, quantity):
    values = get_window(window, N)
    omega, mean = mean_of_the_estimate(plant(quantity), values, hold)
    result = phc.pem(
        ct.frd(mean[:, None], omega), 2, window=(window, N), intersample=hold, structure="free", quantity=quantity
    )
    np.testing.assert_allclose(result.natural_frequencies, W, rtol=1e-8)
    np.testing.assert_allclose(result.damping_ratios, ZETA, rtol=1e-6)
    np.testing.assert_allclose(result.estimated_response(omega)[:, 0], mean, atol=1e-7 * np.abs(mean).max())


def test_an_input_without_content_beyond_the_nyquist_frequency():
    omega, mean = mean_of_the_estimate(plant(), get_window("hann", N), "bandlimited")
    data = ct.frd(mean[:, None], omega)
    result = phc.pem(data, 2, window=("hann", N), intersample="bandlimited", structure="free", real_poles=0, delay=0.0)
    np.testing.assert_allclose(result.damping_ratios, ZETA, rtol=1e-3)


def test_between_lines_the_response_is_that_of_the_sum():
    system, values = plant(), get_window("hann", N)
    omega, mean = mean_of_the_estimate(system, values)
    result = phc.pem(ct.frd(mean[:, None], omega), 2, window=values, structure="free")
    r = np.correlate(values, values, "full")[N - 1 :]
    between = omega[:-1] + 0.3 * np.diff(omega)
    g = answers(system, N)[0] * r / r[0]
    summed = g @ np.exp(-1j * H * np.outer(np.arange(N), between))
    held = np.sinc(between * H / (2 * np.pi)) * np.exp(-0.5j * between * H)
    np.testing.assert_allclose(result.estimated_response(between)[0, 0], summed / held, atol=1e-7 * np.abs(mean).max())


# --- the errors ------------------------------------------------------------------------------------------------------


def test_the_law_of_the_errors_is_that_of_estimates():
    """Variances, correlations of neighbours, and moments without conjugate, of 800 estimates of eight blocks."""
    A, B, C, D = plant()
    lam, V = np.linalg.eig(A)
    up = lam.imag > 0
    residues = ((C @ V)[0] * np.linalg.solve(V, B)[:, 0])[up]
    lines = np.arange(2, N // 2)
    window = SpectralWindow.of("hann", N, H, "zoh")
    law = error_bands(window, lines, lam[up], residues[:, None, None], D)
    estimates = []
    for seed in range(800):
        u, y = record(plant(), 8, seed, noise=0.0)
        y = y + 0.3 * np.random.default_rng([seed, 1]).standard_normal(y.shape)
        starts = range(0, len(u) - N + 1, N // 2)
        w = get_window("hann", N)
        U, Y = (np.array([np.fft.rfft(w * x[k : k + N]) for k in starts]) for x in (u, y[0]))
        estimates.append((np.sum(Y * U.conj(), axis=0) / np.sum(np.abs(U) ** 2, axis=0))[lines])
    errors = (np.array(estimates) - np.mean(estimates, axis=0)) / window.hold_at(lines * window.line)
    blocks = 2 * 8 - 1 - 1  # one degree of freedom less
    for d in range(3):
        ahead, here = np.roll(errors, -d, axis=1)[:, : len(lines) - d], errors[:, : len(lines) - d]
        size = np.sqrt(np.mean(np.abs(ahead) ** 2, axis=0) * np.mean(np.abs(here) ** 2, axis=0))
        both = law.covariance(lines, (0, 0), 0.09)[d], law.relation(lines, (0, 0), (0, 0))[d]
        for moment, other in zip(both, (here.conj(), here), strict=True):
            seen = np.mean(ahead * other, axis=0) / size
            expected = moment[: len(lines) - d] / blocks / size
            assert np.median(np.abs(seen - expected)) < 0.06
            assert np.max(np.abs(seen - expected)) < 0.35


@pytest.mark.slow
def test_intervals_hold_and_nothing_is_added():
    """Stated errors are the same from record to record: the number of blocks says how large they are."""
    z, stated, right = [], [], 0
    for seed in range(5):
        result = phc.pem(estimate(plant(), 30, seed))
        if not result.order == result.states / 2 == 2:
            continue
        right += 1
        assert result.whiteness > 1e-3
        z += [*((result.damping_ratios - ZETA) / result.stderr["damping_ratios"])]
        z += [*((result.natural_frequencies - W) / result.stderr["natural_frequencies"])]
        stated.append(result.stderr["damping_ratios"])
    assert np.all(np.ptp(stated, axis=0) < 0.14 * np.mean(stated, axis=0))
    # which of the records shows a lag beside depends on rounding
    assert right >= 4 and 0.3 < np.mean(np.square(z)) < 2.2  # 99.8 % of 20 squares


def test_without_its_window_an_estimate_shows_too_much_damping():
    data = estimate(plant(), 30, 0)
    bare = phc.pem(ct.frd(data.frdata, data.omega), 2, structure="free", real_poles=0, delay=0.0)
    assert np.all(bare.damping_ratios > 1.3 * ZETA)


def test_outputs_that_show_the_same_motion_tell_it_once():
    response, omega = matrix(plant(), 30, 3, noise=0.01)
    twice = np.concatenate([response, 2.0 * response])
    noise = np.random.default_rng(0).standard_normal((2, *twice.shape))
    twice = twice + 1e-3 * np.abs(twice).mean() * (noise[0] + 1j * noise[1])
    errors = [
        phc.pem(ct.frd(part, omega), 2, window=("hann", N), structure="free", real_poles=0).stderr["damping_ratios"]
        for part in (twice[:1], twice)
    ]
    np.testing.assert_allclose(errors[1], errors[0], rtol=0.1)


def test_several_outputs_keep_their_structure():
    z = []
    for seed in range(3):
        response, omega = matrix(plant(outputs=2), 30, seed)
        result = phc.pem(ct.frd(response, omega), window=("hann", N), ports=[(0, 0)], real_poles=0)
        assert result.order == 2
        z += [*((result.damping_ratios - ZETA) / result.stderr["damping_ratios"])]
    assert np.mean(np.square(z)) < 3.7  # 99.9 % of six squares


# --- what is given ---------------------------------------------------------------------------------------------------


def test_an_estimate_says_its_window():
    data = estimate(plant(), 20, 1)
    assert data.window == data[0, 0].window == ("hann", N) and data.intersample == "zoh"
    told = ct.frd(data.frdata, data.omega)
    by_itself = phc.pem(data, 2, structure="classical")
    given = phc.pem(told, 2, window=("hann", N, 39), dt=H, structure="classical")
    np.testing.assert_allclose(given.damping_ratios, by_itself.damping_ratios, rtol=1e-9)


def test_samples_and_their_hold():
    """Of samples, a response is that of the plant and the hold: so it is with a dt, and where it shows."""
    data = estimate(plant(), 20, 2)
    held = data.frdata * np.sinc(data.omega * H / (2 * np.pi)) * np.exp(-0.5j * data.omega * H)
    expected = phc.pem(data, 2, real_poles=0)
    for raw in (ct.frd(held, data.omega, dt=H), ct.frd(held, data.omega)):
        result = phc.pem(raw, 2, window=("hann", N, data.segments), real_poles=0)
        assert result.structure == expected.structure
        np.testing.assert_allclose(result.damping_ratios, expected.damping_ratios, rtol=1e-6)


@pytest.mark.slow
def test_missing_lines_and_a_band():
    data = estimate(plant(), 20, 2)
    response = data.frdata.copy()
    response[..., [10, 11, 40]] = np.nan
    expected = phc.pem(data)
    for part in (ct.frd(response, data.omega, smooth=False), ct.frd(data.frdata[..., 4:50], data.omega[4:50])):
        result = phc.pem(part, window=("hann", N, data.segments))
        assert result.order == 2
        assert np.all(np.abs(result.damping_ratios - expected.damping_ratios) < expected.stderr["damping_ratios"])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"window": "hann"}, "pass the name and the samples of a block"),
        ({"window": ("hannn", N)}, "knows no 'hannn'"),
        ({"window": np.zeros(N)}, "0 of them not 0"),
        ({"window": ("hann", 4)}, "at least 8"),
        ({"window": ("hann", N, 0)}, "number of blocks"),
        ({"window": ("hann", N // 2)}, "end at line 32"),
        ({"window": ("hann", N), "dt": 0.8}, "between two of them"),
        ({"dt": H}, "or give the window"),
        ({"intersample": "bandlimited"}, "estimated with a window"),
    ],
)
def test_what_does_not_fit_is_refused(options, words):
    data = ct.frd(np.ones(N // 2 - 2), 2 * np.pi * np.arange(2, N // 2) / (N * H))
    with pytest.raises(StructureError, match=words):
        phc.pem(data, **options)


def test_a_record_needs_no_window():
    with pytest.raises(StructureError, match="leave window out"):
        phc.pem((np.ones(50), np.ones(50)), dt=H, window=("hann", N))
    data = phc.pem(
        ct.frd(1 / (1j * np.arange(1, 30) + 1), np.arange(1.0, 30)),
        1,
        real_poles=0,
        structure="free",
        weights=np.ones(29),
    )
    with pytest.raises(StructureError, match="not fitted to responses"):
        data.estimated_response([1.0])


# --- what a result repeats -------------------------------------------------------------------------------------------


@cache
def fit_of_an_estimate():
    """An estimate, and its fit with classical damping."""
    data = estimate(plant(), 20, 4)
    return data, phc.pem(data, structure="classical")


def test_a_result_repeats_the_window(tmp_path):
    data, result = fit_of_an_estimate()
    result.save(tmp_path / "fit.json")
    again = phc.load(tmp_path / "fit.json")
    assert again.window.given == result.window.given == ("hann", N, 39)
    np.testing.assert_array_equal(again.predicted, result.predicted)
    np.testing.assert_array_equal(again.estimated_response(data.omega), result.estimated_response(data.omega))
    compared = phc.compare(data, result, result.observed_system).experiments[0].predicted
    if result.background is None:
        np.testing.assert_allclose(compared[1], compared[0], atol=1e-9 * np.abs(compared).max())
    np.testing.assert_allclose(compared[0], result.predicted, atol=1e-12 * np.abs(compared).max())
    assert phc.residual_analysis(data, again).whiteness > 1e-3
    other = estimate(plant(), 20, 5)
    assert phc.compare(other, result, result.observed_system).fit_percent[0] > 70
    table = phc.fit_many([data, other], order=2, structure="classical").table
    assert len(table["hertz"]) == 4


def test_the_picture_draws_what_was_fitted():
    data, result = fit_of_an_estimate()
    (axis, *_) = result.plot(Hz=False).axes.ravel()
    curve = axis.lines[0]
    drawn = np.interp(data.omega, curve.get_xdata(), curve.get_ydata())
    levels = 20 * np.log10(np.abs(result.predicted))
    peak = int(np.argmax(levels))
    assert abs(drawn[peak] - levels[peak]) < 0.3
    assert 20 * np.log10(abs(result.observed_system(1j * W[0]))) > levels[peak] + 1
