"""What a record can and cannot show: Fisher information, blind combinations, excited band, remedies."""

import re

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ph_control as phc
from ph_control.identification.excitation.excitation import excitation
from ph_control.identification.excitation.excited_band import excited_band
from ph_control.identification.excitation.remedy import multisine
from ph_control.identification.uncertainty.fisher import Information

EPS = np.finfo(float).eps
GOLDEN = (np.sqrt(5) - 1) / 2
CHAIN = ([GOLDEN, 1 + GOLDEN], [0.2**0.5, 0.2**0.5])
STEP, SAMPLES = 0.01, 1000
TIME = STEP * np.arange(SAMPLES)


def white(samples, seed=0):
    return np.random.default_rng(seed).standard_normal(samples)


def sines(*frequencies, samples=SAMPLES, h=STEP):
    return sum(np.sin(w * h * np.arange(samples) + 0.3 * w) for w in frequencies)


# --- an independent second implementation: dense matrices, sample by sample, and differences ------------------------


def one_step(d, h, method, intersample):
    """Matrices of `z_{k+1} = E z_k + a u_k + b u_{k+1}` of one mode `q' = d p + u, p' = -d q`, `z = (q, p)`."""
    A, B, eye = np.array([[0.0, d], [-d, 0.0]]), np.array([1.0, 0.0]), np.eye(2)
    if method == "euler":
        return eye + h * A, h * B, 0 * B
    if method == "midpoint":
        inverse = np.linalg.inv(eye - h / 2 * A)
        both = h * inverse @ B
        return inverse @ (eye + h / 2 * A), *((both, 0 * B) if intersample == "zoh" else (both / 2, both / 2))
    E = np.array([[np.cos(d * h), np.sin(d * h)], [-np.sin(d * h), np.cos(d * h)]])
    inverse = np.linalg.inv(A)
    held = inverse @ (E - eye) @ B
    if intersample == "zoh":
        return E, held, 0 * B
    later = inverse @ (held - h * B) / h
    return E, held - later, later


def dense_output(theta, n, u, h, method="exact", intersample="zoh", quantity="velocity"):
    """Output for `theta = (d, r, Re x(0), Im x(0))`; a mode answers with `r d q` and moves freely with `Re x`.

    In displacement it answers with the integral `r (-p')`, in acceleration with the derivative `r d (u + d p')`.
    """
    d, r, real, imaginary = np.reshape(theta, (4, n))
    y = np.zeros(len(u))
    for l in range(n):
        E, a, b = one_step(d[l], h, method, intersample)
        # x = q - i p' with p' = -p: x' = -i d x is q' = d Im x, (Im x)' = -d q
        forced, free = np.zeros(2), np.array([real[l], imaginary[l]])
        for k in range(len(u)):
            later = d[l] * (u[k] + d[l] * forced[1])
            answer = {"velocity": d[l] * forced[0], "displacement": -forced[1], "acceleration": later}
            y[k] += r[l] * answer[quantity] + free[0]
            free = E @ free
            forced = E @ forced + a * u[k] + b * (u[k + 1] if k + 1 < len(u) else 0.0)
    return y


def dense_sensitivities(d, r, x0, u, h, method="exact", intersample="zoh"):
    """Central differences of fourth order; errors of about 1e-10 of the column."""
    n = len(d)
    theta = np.concatenate([d, r, np.real(x0), np.imag(x0)])
    columns = []
    for k in range(4 * n):
        # so small that the phase of a mode moves by little within the record
        step = 1e-3 * (min(theta[k], 1 / (len(u) * h)) if k < n else 1.0)

        def at(change, k=k):
            moved = theta.copy()
            moved[k] += change
            return dense_output(moved, n, u, h, method, intersample)

        columns.append((8 * (at(step) - at(-step)) - (at(2 * step) - at(-2 * step))) / (12 * step))
    return np.array(columns).T


def dense_bounds(J, noise_std):
    """Cramer-Rao bounds by the inverse of the information."""
    return noise_std * np.sqrt(np.diag(np.linalg.inv(J.T @ J)))


def correlation(J):
    scaled = J / np.linalg.norm(J, axis=0)
    return scaled.T @ scaled


def output_of(d, r, x0, u, h, **options):
    return dense_output(np.concatenate([d, r, np.real(x0), np.imag(x0)]), len(d), u, h, **options)


# --- the information ------------------------------------------------------------------------------------------------

KINDS = [("exact", "zoh"), ("exact", "foh"), ("midpoint", "zoh"), ("midpoint", "foh"), ("euler", "zoh")]


@pytest.mark.parametrize("method, intersample", KINDS)
@pytest.mark.parametrize("moving", [False, True])
def test_the_information_is_that_of_a_dense_simulation(method, intersample, moving):
    h, u = 0.05, white(150)
    d, r = np.array([1.0, 2.3]), np.array([1.0, 0.4])
    x0 = np.array([0.8 - 0.3j, 0.2 + 0.5j]) * moving
    J = dense_sensitivities(d, r, x0, u, h, method, intersample)
    y = output_of(d, r, x0, u, h, method=method, intersample=intersample)
    found = excitation((u, y), (d, r), dt=h, method=method, intersample=intersample, noise_std=0.1)
    assert np.allclose(found.information.lengths, np.linalg.norm(J, axis=0), rtol=1e-8)
    vectors = found.information.vectors
    assert np.allclose((vectors.T * found.singular_values**2) @ vectors, correlation(J), atol=1e-8)
    assert np.allclose(found.singular_values**2, np.linalg.eigvalsh(correlation(J))[::-1], rtol=1e-5)
    assert found.condition == pytest.approx(np.linalg.cond(correlation(J)), rel=1e-5)
    bounds = np.concatenate([found.stderr[key] for key in ("d", "r", "initial_state")])
    assert np.allclose(bounds, dense_bounds(J, 0.1), rtol=1e-6)
    factors = np.concatenate([found.inflation[key] for key in ("d", "r", "initial_state")])
    assert np.allclose(factors, dense_bounds(J, 1.0) * np.linalg.norm(J, axis=0), rtol=1e-6)
    assert factors.min() >= 1 - 1e-9


@pytest.mark.variants
@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
def test_the_information_of_a_known_initial_state_leaves_it_out(n):
    h, u = 0.1, white(120)
    d, r = 1.0 + 1.5 * np.arange(n), 1.0 / (1 + np.arange(n))
    J = dense_sensitivities(d, r, np.zeros(n), u, h)
    known = excitation((u, None), (d, r), dt=h, initial_state="zero", noise_std=1.0)
    unknown = excitation((u, None), (d, r), dt=h, noise_std=1.0)
    assert known.names == tuple(f"d_{l + 1}" for l in range(n)) + tuple(f"r_{l + 1}" for l in range(n))
    assert len(unknown.names) == 4 * n
    for found, columns in ((known, J[:, : 2 * n]), (unknown, J)):
        bounds = dense_bounds(columns, 1.0)
        assert np.allclose(found.stderr["d"], bounds[:n], rtol=1e-6)
        assert np.allclose(found.stderr["r"], bounds[n : 2 * n], rtol=1e-6)
    assert np.all(known.stderr["r"] < unknown.stderr["r"])


def test_missing_outputs_are_left_out_of_the_information():
    h, u = 0.1, white(100)
    y = output_of([1.0], [1.0], [0.3], u, h)
    y[20:60] = np.nan
    found = excitation((u, y), ([1.0], [1.0]), dt=h, noise_std=1.0)
    J = dense_sensitivities(np.array([1.0]), np.array([1.0]), [0.3], u, h)[~np.isnan(y)]
    assert found.observed == 60
    assert np.allclose(found.stderr["r"], dense_bounds(J, 1.0)[1], rtol=1e-6)


def test_the_noise_is_estimated_from_what_a_model_leaves():
    u, h = white(4000), 0.1
    noise = 0.05 * white(4000, seed=1)
    y = output_of([1.0, 3.0], [1.0, 0.2], [1 + 1j, 0.5], u, h) + noise
    found = excitation((u, y), ([1.0, 3.0], [1.0, 0.2]), dt=h)
    # its standard deviation is known to 1/sqrt(2 T)
    assert found.noise_std == pytest.approx(np.std(noise), rel=3 / np.sqrt(2 * 4000))
    assert excitation((u, y), ([1.0, 3.0], [1.0, 0.2]), dt=h, noise_std=0.7).noise_std == 0.7
    assert np.isnan(excitation((u, None), ([1.0, 3.0], [1.0, 0.2]), dt=h).noise_std)


def test_the_bounds_at_a_fit_are_its_standard_errors():
    u, h = white(800), 0.1
    y = output_of([1.0, 3.0], [1.0, 0.2], [1 + 1j, 0.5], u, h) + 0.05 * white(800, seed=1)
    result = phc.pem((u, y), 2, dt=h)
    found = excitation((u, y), result, dt=h)
    assert found.noise_std == pytest.approx(np.sqrt(result.noise_variance), rel=1e-9)
    ratios = np.concatenate([result.stderr[name] / found.stderr[name] for name in ("d", "r")])
    assert np.ptp(ratios) < 1e-6
    # the errors of a fit have the noise that its free model leaves, whose deviation is known to 1/sqrt(2 T)
    assert ratios[0] == pytest.approx(1.0, abs=1 / np.sqrt(2 * 800))


def test_every_form_of_a_model_and_of_a_record_gives_the_same():
    u, h = white(300), 0.1
    modes = phc.modes([1.0, 3.0], [1.0, 0.2])
    y = np.asarray(phc.forced_response(phc.ph(modes), h * np.arange(300), u, intersample="zoh").outputs)
    response = ct.TimeResponseData(h * np.arange(300), y, inputs=u, issiso=True)
    kept = u.copy(), y.copy()
    expected = excitation((u, y), ([3.0, 1.0], [0.2, 1.0]), dt=h, noise_std=1.0)
    others = [
        excitation((u, y), modes, dt=h, noise_std=1.0),
        excitation((u, y), phc.ph(modes), dt=h, noise_std=1.0),
        excitation(response, phc.ch(modes.d, np.concatenate([np.sqrt(modes.r), [0, 0]])), noise_std=1.0),
        excitation((u, y), phc.tf(phc.ph(modes)), dt=h, noise_std=1.0),
        excitation((list(u), list(y)), modes, dt=h, noise_std=1.0),
    ]
    for found in others:
        assert np.allclose(found.d, [1.0, 3.0], rtol=1e-9)
        assert np.allclose(found.stderr["r"], expected.stderr["r"], rtol=1e-6)
    assert np.array_equal(u, kept[0]) and np.array_equal(y, kept[1])


def test_a_factor_with_the_same_gram_matrix_gives_the_same_information():
    J = np.random.default_rng(0).standard_normal((500, 4))
    names = ("d_1", "r_1", "Re x_1(0)", "Im x_1(0)")
    whole = Information.of(J, names, rows=500)
    factor = Information.of(np.linalg.qr(J, mode="r"), names, rows=500)
    assert np.allclose(whole.stderr(1.0), factor.stderr(1.0), rtol=100 * EPS)
    assert whole.tolerance == factor.tolerance


# --- the chain of the paper ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("x0", [[0, 0], [1 - 0.5j, 0.3 + 0.8j]])
def test_a_sine_does_not_show_the_weights_of_the_chain_with_an_exact_hold(x0):
    u = np.sin(TIME)
    y = output_of(*CHAIN, x0, u, STEP)
    found = excitation((u, y), phc.frenkel_kontorova(2), dt=STEP, noise_std=1.0)
    assert found.rank == len(found.names) - 1 == 7
    assert found.singular_values[-1] < 1e-14 * found.singular_values[0]
    assert found.singular_values[-2] > 0.05
    assert np.isinf(found.condition)
    (combination,) = found.blind
    assert combination.words == "r_1 and r_2 with the initial states of modes 1 and 2"
    assert {"r_1", "r_2"} <= set(found.blind_parameters)
    assert np.isinf(found.stderr["r"]).all() and np.isfinite(found.stderr["d"]).all()
    assert np.isinf(found.inflation["r"]).all() and np.isfinite(found.inflation["d"]).all()
    assert not found.sufficient
    assert "r cannot be learned" in str(found)
    assert "add a frequency near 1.6 rad/time" in str(found)
    assert "white or multisine input of the same length over 0.31 .. 2 rad/time" in str(found)
    assert found.driven_zeros == pytest.approx((1.0,))
    assert "drives a zero" in found.details


def test_the_blind_combination_leaves_the_output_of_the_chain_as_it_is():
    u = np.sin(TIME)
    (blind,) = excitation((u, None), CHAIN, dt=STEP).blind
    names = excitation((u, None), CHAIN, dt=STEP).names
    theta = np.concatenate([*CHAIN, np.zeros(4)])
    moved = theta.copy()
    for name, change in zip(blind.parameters, blind.coefficients, strict=True):
        moved[names.index(name)] += 0.2 * change
    before, after = (dense_output(at, 2, u, STEP) for at in (theta, moved))
    assert np.abs(after - before).max() < 1e-9 * np.abs(before).max()
    assert np.abs(moved[2:4] - theta[2:4]).min() > 0.1


def test_eulers_rule_shows_the_weights_of_the_chain_by_an_artefact():
    u = np.sin(TIME)
    found = excitation((u, None), CHAIN, dt=STEP, method="euler")
    assert found.rank == 8
    assert 1e-3 < found.singular_values[-1] < 1e-2
    assert found.artefacts[0].words == "r_1 and r_2 with the initial states of modes 1 and 2"
    assert found.nearly_blind[0].inflation == pytest.approx(1 / found.singular_values[-1])
    assert not found.sufficient
    assert "growth of Euler's rule" in str(found)
    # an input that an exact hold learns from is no artefact
    assert excitation((white(SAMPLES), None), CHAIN, dt=STEP, method="euler").artefacts == ()
    assert excitation((u, None), CHAIN, dt=STEP, method="midpoint").rank == 7


@pytest.mark.variants
@pytest.mark.parametrize("kind", ["white", "multisine", "two sines"])
def test_other_inputs_of_the_same_length_show_the_weights_to_the_cramer_rao_bound(kind):
    u = {
        "white": white(SAMPLES),
        "multisine": multisine(SAMPLES, STEP, 0.31, 2.0),
        "two sines": np.sin(TIME) + np.sin(1.6 * TIME),
    }[kind]
    found = excitation((u, None), CHAIN, dt=STEP, noise_std=0.01)
    assert found.rank == 8 and found.sufficient and found.details == "" and found.remedies == ()
    J = dense_sensitivities(*map(np.array, CHAIN), np.zeros(2), u, STEP)
    bounds = dense_bounds(J, 0.01)
    assert np.allclose(found.stderr["d"], bounds[:2], rtol=1e-5)
    assert np.allclose(found.stderr["r"], bounds[2:4], rtol=1e-5)
    assert np.all(found.stderr["r"] < 0.2 * np.array(CHAIN[1]))


def test_from_known_rest_a_sine_shows_the_weights():
    found = excitation((np.sin(TIME), None), CHAIN, dt=STEP, initial_state="zero")
    assert found.rank == 4 and found.sufficient


# --- inputs ----------------------------------------------------------------------------------------------------------


@pytest.mark.variants
@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("moving", [False, True])
def test_m_sines_show_m_combinations_of_the_weights(n, moving):
    d, r = 1.0 + 0.9 * np.arange(n), 1.0 / (1 + np.arange(n))
    x0 = (0.5 - 0.2j) * np.ones(n) * moving
    for m in range(1, 4):
        u = sines(*(1.3 + 0.9 * np.arange(m)), samples=600, h=0.1)
        y = output_of(d, r, x0, u, 0.1)
        found = excitation((u, y), (d, r), dt=0.1)
        assert found.rank == 4 * n - max(0, n - m)
        assert len(found.blind) == max(0, n - m)
        assert found.band.shown_weights == m
        assert all(not name.startswith("d") for name in found.blind_parameters)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_a_constant_shows_no_weight_unless_the_plant_was_at_rest(n):
    d, r = 1.0 + np.arange(n), np.ones(n)
    found = excitation((np.full(500, 2.0), None), (d, r), dt=0.1)
    assert found.rank == 3 * n
    assert {b.words for b in found.blind} == {f"r_{l + 1} with the initial state of mode {l + 1}" for l in range(n)}
    assert found.band.intervals == () and found.band.order == 1
    assert "none: the input is constant" in found.summary()
    assert f"add {'a frequency' if n == 1 else 'frequencies'} near 1" in found.details
    assert excitation((np.full(500, 2.0), None), (d, r), dt=0.1, initial_state="zero").rank == 2 * n


def test_no_input_shows_nothing_but_the_free_motion():
    u = np.zeros(300)
    still = excitation((u, None), ([1.0, 2.0], [1.0, 1.0]), dt=0.1)
    assert still.blind_parameters == ("d_1", "d_2", "r_1", "r_2") and still.rank == 4
    assert "the input is zero" in still.details
    y = output_of([1.0, 2.0], [1.0, 1.0], [1.0, 1j], u, 0.1)
    free = excitation((u, y), ([1.0, 2.0], [1.0, 1.0]), dt=0.1)
    assert free.blind_parameters == ("r_1", "r_2") and free.rank == 6
    assert [b.words for b in free.blind] == ["r_1", "r_2"]


@pytest.mark.parametrize("n", [1, 2, 4])
def test_an_impulse_shows_the_weights_if_it_comes_within_the_record(n):
    d, r = 1.0 + np.arange(n), np.ones(n)
    impulse = np.eye(400)
    # at the first sample it is a free motion from the second on: only the first sample differs
    first = excitation((impulse[0], None), (d, r), dt=0.1)
    assert first.rank == 3 * n + 1
    assert excitation((impulse[200], None), (d, r), dt=0.1).rank == 4 * n
    assert excitation((impulse[0], None), (d, r), dt=0.1, initial_state="zero").rank == 2 * n


def test_a_mode_without_weight_is_told_apart_from_a_poor_input():
    found = excitation((white(300), None), ([1.0, 2.0], [1.0, 0.0]), dt=0.1)
    assert found.blind_parameters == ("d_2",)
    assert "Of mode 2 r is 0" in found.details
    assert found.remedies == ()


@settings(deadline=None, max_examples=15, derandomize=True)
@given(
    n=st.integers(1, 5), lines=st.integers(0, 6), seed=st.integers(0, 1000), offset=st.booleans(), rest=st.booleans()
)
def test_the_rank_follows_from_the_spectral_lines(n, lines, seed, offset, rest):
    rng = np.random.default_rng(seed)
    places = 0.4 + 0.35 * np.arange(12) + 0.05 * rng.random(12)
    chosen = rng.permutation(places)
    d, w = np.sort(chosen[:n]), chosen[n : n + lines]
    u = sum((np.sin(one * 0.2 * np.arange(500) + one) for one in w), offset * np.ones(500))
    found = excitation((u, None), (d, np.ones(n)), dt=0.2, initial_state="zero" if rest else "estimate")
    if rest:
        assert found.rank == (2 * n if lines or offset else 0)
    else:
        silent = n if not (lines or offset) else 0
        assert found.rank == 3 * n - silent + min(n, lines)
    assert found.band.order == 2 * lines + offset
    assert np.allclose(found.band.lines, np.sort(w), rtol=1e-6)


# --- the excited band ------------------------------------------------------------------------------------------------


def test_the_band_of_an_input_is_where_its_power_is():
    h, samples = 0.1, 5000
    omega = 2 * np.pi * np.fft.rfftfreq(samples, h)
    spectrum = np.fft.rfft(white(samples))
    limited = np.fft.irfft(np.where((omega > 3) & (omega < 7), spectrum, 0.0), samples)
    ((low, high),) = excited_band(limited, h).intervals
    few = 8 * 2 * np.pi / (samples * h)
    assert abs(low - 3) < few and abs(high - 7) < few
    ((low, high),) = excited_band(white(samples), h).intervals
    assert low < few and high > np.pi / h - few
    ((low, high),) = excited_band(1e6 + limited, h).intervals
    assert abs(low - 3) < few and abs(high - 7) < few
    two = limited + np.fft.irfft(np.where((omega > 12) & (omega < 13), spectrum, 0.0), samples)
    assert len(excited_band(two, h).intervals) == 2


def test_modes_outside_the_band_are_named():
    found = excitation((sines(1.0, samples=2000, h=0.1), None), ([1.0, 2.0], [1.0, 1.0]), dt=0.1)
    assert 1.0 in found.band and 2.0 not in found.band
    assert "Outside the excited band: mode 2, at 2 rad/time" in found.details
    assert "outside the band" in found.summary()


@pytest.mark.parametrize(
    "u, order, full",
    [
        (np.zeros(400), 0, False),
        (np.ones(400), 1, False),
        (np.arange(400.0), 2, False),
        (sines(1.0, samples=400, h=0.1), 2, False),
        (3 + sines(1.0, 2.0, samples=400, h=0.1), 5, False),
        (white(400), 32, True),
        (np.eye(400)[200], 32, True),
        (np.eye(400)[0], 1, False),
    ],
)
def test_the_order_of_excitation_is_the_number_of_independent_copies(u, order, full):
    band = excited_band(u, 0.1)
    assert (band.order, band.full) == (order, full)


def test_lines_are_found_as_fast_as_the_samples_carry_them():
    assert excited_band(sines(200.0, 300.0), STEP).lines == pytest.approx((200.0, 300.0))
    assert excited_band(sines(1.0, 1.1), STEP).lines == pytest.approx((1.0, 1.1))
    assert excited_band(np.exp(-TIME), STEP).lines == ()


# --- time ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [0.999, 1.001])
def test_modes_above_the_nyquist_frequency_are_named(ratio):
    d = np.array([1.0, ratio * np.pi / 0.5])
    found = excitation((white(4000), None), (d, [1.0, 1.0]), dt=0.5)
    assert found.above_nyquist == ((1,) if ratio > 1 else ())
    assert ("above the Nyquist frequency" in found.details) == (ratio > 1)
    assert found.sufficient == (ratio < 1)
    if ratio > 1:
        assert found.apparent[1] == pytest.approx(2 * np.pi / 0.5 - d[1])
        (step,) = re.findall(r"sample with a step below ([\d.]+\d)", found.details)
        assert float(step) == pytest.approx(np.pi / d[1], rel=0.05)


@pytest.mark.parametrize("turns", [1, 2])
def test_at_the_nyquist_frequency_rounding_is_not_taken_for_information(turns):
    found = excitation((white(1000), None), ([1.0, turns * np.pi], [1.0, 1.0]), dt=1.0)
    assert set(found.blind_parameters) >= {"r_2", "Im x_2(0)"}


def test_the_midpoint_rule_has_no_nyquist_frequency():
    found = excitation((white(1000), None), ([1.0, 10.0], [1.0, 1.0]), dt=1.0, method="midpoint")
    assert found.above_nyquist == ()
    assert found.apparent[1] == pytest.approx(2 * np.arctan(5.0))


@pytest.mark.parametrize("bins", [0.9, 1.1])
def test_modes_closer_than_a_bin_are_named_with_the_record_that_resolves_them(bins):
    h, samples = 0.1, 2000
    one_bin = 2 * np.pi / (samples * h)
    d = 1.0 + np.array([0.0, bins * one_bin])
    found = excitation((white(samples), None), (d, [1.0, 1.0]), dt=h)
    assert found.unresolved == (((0, 1),) if bins < 1 else ())
    assert ("less than the" in found.details) == (bins < 1)
    if bins < 1:
        (needed,) = re.findall(r"\((\d+) samples\)", found.details)
        assert int(needed) == pytest.approx(samples / bins, abs=2)
        assert excitation((white(int(needed)), None), (d, [1.0, 1.0]), dt=h).unresolved == ()


def test_modes_much_closer_than_a_bin_are_hardly_seen():
    found = excitation((white(1000), None), ([1.0, 1.0001], [1.0, 1.0]), dt=0.1)
    assert found.nearly_blind and found.headline.startswith("hardly shows")
    assert min(found.inflation["r"]) > 100
    assert "Hardly seen, with errors inflated up to" in found.details


def test_modes_of_one_frequency_are_to_be_taken_as_one():
    found = excitation((white(400), None), ([1.0, 1.0], [1.0, 2.0]), dt=0.1)
    assert found.rank == 4
    assert "take modes 1 and 2, of one frequency, as one" in found.details


@pytest.mark.parametrize("periods", [0.95, 1.05])
def test_modes_without_a_full_period_are_named(periods):
    d = periods * 2 * np.pi / (500 * 0.1)
    found = excitation((white(500), None), ([d, 5.0], [1.0, 1.0]), dt=0.1)
    assert found.slow == ((0,) if periods < 1 else ())
    assert ("less than a period" in found.summary()) == (periods < 1)


@pytest.mark.parametrize("samples", [2, 3, 5, 7])
def test_few_samples_show_as_many_combinations_at_most(samples):
    found = excitation((white(samples), None), ([0.7, 1.9], [1.0, 1.0]), dt=1.0)
    assert found.rank <= samples and not found.sufficient
    assert f"It has {samples} observed samples for 8 unknowns." in found.details
    assert "record" in found.remedies[-1]


@pytest.mark.parametrize("gap, longer", [(0.03, True), (1e-4, False), (1e-6, False)])
def test_a_record_more_than_a_hundred_times_as_long_is_not_advised(gap, longer):
    found = excitation((white(1000), None), ([1.0, 1.0 + gap], [1.0, 1.0]), dt=0.1)
    assert any("record for at least" in remedy for remedy in found.remedies) == longer
    assert any("take modes 1 and 2 as one" in remedy for remedy in found.remedies) != longer
    slow = excitation((white(1000), None), ([2e-5, 1.0], [1.0, 1.0]), dt=0.1, noise_std=1e9)
    assert slow.slow == (0,) and not any("record for at least" in remedy for remedy in slow.remedies)


@pytest.mark.parametrize("n, lines", [(2, 1), (12, 3), (30, 1)])
def test_in_brief_there_is_one_reason_and_one_remedy(n, lines):
    d = np.linspace(1.0, 12.0, n)
    u = sum(np.sin(w * 0.1 * np.arange(2000)) for w in np.linspace(2.0, 5.0, lines))
    found = excitation((u, None), (d, np.ones(n)), dt=0.1)
    assert found.blind and len(re.findall(r"\. [A-Z]", found.message)) == 1
    assert len(found.message) < 400 and len(found.details) > len(found.message)
    assert found.remedies[0] in found.message and all(remedy in found.details for remedy in found.remedies)


# --- remedies --------------------------------------------------------------------------------------------------------


@settings(deadline=None, max_examples=10, derandomize=True)
@given(n=st.integers(2, 4), seed=st.integers(0, 1000))
def test_the_frequencies_that_are_advised_cure_the_input(n, seed):
    rng = np.random.default_rng(seed)
    h, samples = 0.2, 600
    d = 0.5 + 0.8 * np.arange(n) + 0.3 * rng.random(n)
    u = np.sin(rng.uniform(0.5, 3.0) * h * np.arange(samples))
    found = excitation((u, None), (d, np.ones(n)), dt=h)
    assert not found.sufficient
    (advice,) = re.findall(r"add (?:a frequency|frequencies) near ([\d., and]+) rad/time", found.remedies[0])
    added = [float(word) for word in re.findall(r"[\d.]+", advice)]
    assert len(added) < n + 1
    cured = excitation((u + sum(np.sin(w * h * np.arange(samples)) for w in added), None), (d, np.ones(n)), dt=h)
    assert cured.sufficient
    (low, high) = map(float, re.findall(r"over ([\d.]+) \.\. ([\d.]+) rad/time", found.remedies[0])[0])
    assert low < d[0] and high > d[-1]
    assert excitation((multisine(samples, h, low, high), None), (d, np.ones(n)), dt=h).sufficient


def test_noise_that_drowns_the_weights_asks_for_a_stronger_input():
    u = white(SAMPLES)
    noisy = excitation((u, None), CHAIN, dt=STEP, noise_std=50.0)
    assert {"r_1", "r_2"} <= set(noisy.uncertain) and noisy.headline.startswith("is too noisy for")
    assert "50 the standard error is" in noisy.details
    (factor,) = re.findall(r"at least ([\d.e+]+) times as strong", noisy.details)
    stronger = excitation((1.1 * float(factor) * u, None), CHAIN, dt=STEP, noise_std=50.0)
    assert stronger.sufficient
    assert max(stronger.stderr["r"] / CHAIN[1]) < 0.1 and max(stronger.stderr["d"] / CHAIN[0]) < 0.1
    assert excitation((u, None), CHAIN, dt=STEP, noise_std=1e-3).uncertain == ()


# --- a number of modes -----------------------------------------------------------------------------------------------


@pytest.mark.variants
@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_white_noise_shows_any_modes_anywhere(n):
    found = excitation((white(1000), None), n, dt=0.1)
    assert found.sufficient and found.n == n
    assert (found.scan.deficiency == 0).all()
    (low, high) = found.scan.shown[0][0], found.scan.shown[-1][1]
    assert low < 0.05 * np.pi / 0.1 and high > 0.9 * np.pi / 0.1


@pytest.mark.variants
@pytest.mark.parametrize("n", [2, 3, 5])
def test_a_sine_shows_two_modes_nowhere_and_one_mode_near_it(n):
    u = sines(1.0, samples=1000, h=0.1)
    blind = excitation((u, None), n, dt=0.1)
    assert (blind.scan.deficiency == n - 1).all() and blind.scan.shown == ()
    assert not blind.sufficient and "shown nowhere" in blind.details
    one = excitation((u, None), 1, dt=0.1)
    assert (one.scan.deficiency == 0).all()
    assert any(low <= 1.0 <= high for low, high in one.scan.shown)
    assert all(0.3 < low <= high < 3 for low, high in one.scan.shown)


def test_a_number_of_modes_is_judged_with_the_band_of_the_input():
    h, samples = 0.1, 2000
    omega = 2 * np.pi * np.fft.rfftfreq(samples, h)
    limited = np.fft.irfft(np.where((omega > 3) & (omega < 7), np.fft.rfft(white(samples)), 0.0), samples)
    found = excitation((limited, None), 2, dt=h)
    assert all(w in found.band for w in found.d) and found.sufficient
    assert any(low <= 5 <= high for low, high in found.scan.shown)
    assert found.scan.error[np.argmin(abs(found.scan.frequencies - 28))] > 10
    assert "shown at" in found.summary() and "3 bins apart" in found.details


def test_a_constant_shows_no_modes_at_all():
    found = excitation((np.ones(300), None), 2, dt=0.1)
    assert found.scan.shown == () and not found.sufficient


# --- units -----------------------------------------------------------------------------------------------------------


def verdict_of(found):
    combinations = tuple(frozenset(one.parameters) for one in (*found.blind, *found.nearly_blind, *found.artefacts))
    return (
        found.rank, found.headline, found.sufficient, combinations, found.above_nyquist, found.unresolved, found.slow,
        found.uncertain, found.band.order, len(found.band.lines), len(found.band.intervals), len(found.remedies),
        tuple(w in found.band for w in found.apparent), len(found.driven_zeros),
    )  # fmt: skip


@pytest.mark.variants
@pytest.mark.parametrize("amplitude", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("duration", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("name", ["sine", "white", "constant", "euler", "impulse", "close", "noisy", "number"])
def test_verdicts_do_not_depend_on_units(name, duration, amplitude):
    u, model, method, noise = {
        "sine": (np.sin(TIME), CHAIN, "exact", None),
        "white": (white(SAMPLES), CHAIN, "exact", 0.01),
        "constant": (np.ones(SAMPLES), CHAIN, "exact", None),
        "euler": (np.sin(TIME), CHAIN, "euler", None),
        "impulse": (np.eye(SAMPLES)[0], CHAIN, "exact", None),
        "close": (white(SAMPLES), ([3.0, 3.01, 400.0], [1.0, 1.0, 1.0]), "exact", None),
        "noisy": (white(SAMPLES), CHAIN, "exact", 50.0),
        "number": (np.sin(TIME), 2, "exact", None),
    }[name]

    def judged(duration, amplitude):
        # kappa = r d has the unit of a rate: r does not change with that of time
        scaled = model if model == 2 else (np.array(model[0]) / duration, np.array(model[1]))
        noise_std = None if noise is None else noise * amplitude
        return excitation((amplitude * u, None), scaled, dt=STEP * duration, method=method, noise_std=noise_std)

    plain, scaled = judged(1.0, 1.0), judged(duration, amplitude)
    assert verdict_of(scaled) == verdict_of(plain)
    finite = np.isfinite(plain.inflation["r"])
    assert np.array_equal(np.isfinite(scaled.inflation["r"]), finite)
    assert np.allclose(scaled.inflation["r"][finite], plain.inflation["r"][finite], rtol=1e-6)
    if noise is not None:
        assert np.allclose(scaled.stderr["r"], plain.stderr["r"], rtol=1e-6)
        assert np.allclose(scaled.stderr["d"] * duration, plain.stderr["d"], rtol=1e-6)


# --- words -----------------------------------------------------------------------------------------------------------


def test_the_summary_is_narrow_and_complete():
    for u, model in ((np.sin(TIME), CHAIN), (white(SAMPLES), 3), (sines(1.0, 2.0), (1.0 + np.arange(5), np.ones(5)))):
        found = excitation((u, None), model, dt=STEP, noise_std=0.1)
        lines = found.summary().splitlines()
        assert max(map(len, lines)) <= 120
        assert found.headline in lines[1]
        assert "standard deviation 0.1" in found.summary()
        assert len([line for line in lines if re.match(r"\s+\d+\s+[\d.e+-]+\s", line)]) == found.n
        assert " ".join(found.details.split()) in " ".join(found.summary().split())


def test_many_modes_are_told_in_few_words():
    n = 30
    crowded = excitation((sines(1.0), None), (0.5 + 0.2 * np.arange(n), np.ones(n)), dt=STEP)
    assert "and 53 more" in crowded.headline
    assert "use a white or multisine input" in crowded.details or "record for at least" in crowded.details
    assert len(crowded.details) < 4000
    assert "The same is true of 26 more." in crowded.details
    wide = excitation((sines(1.0), None), (1 + 1.3 * np.arange(10), np.ones(10)), dt=STEP)
    assert "add frequencies" not in wide.details and "white or multisine" in wide.message


def test_the_text_says_what_is_shown_where_nothing_is_amiss():
    found = excitation((white(SAMPLES), None), CHAIN, dt=STEP)
    assert str(found) == "The record shows d, r and the initial state of 2 modes."
    rest = excitation((white(SAMPLES), None), CHAIN, dt=STEP, initial_state="zero")
    assert str(rest) == "The record shows d and r of 2 modes."


def test_the_arrays_of_a_finding_cannot_be_changed():
    found = excitation((white(100), None), CHAIN, dt=STEP)
    for array in (found.d, found.r, found.apparent, found.singular_values):
        with pytest.raises(ValueError):
            array[0] = 1.0
    with pytest.raises(TypeError):
        found.stderr["d"] = None


@pytest.mark.parametrize(
    "data, order, options, words",
    [
        ((white(50), None), 0, {}, "order is 0; a number of modes must be at least 1"),
        ((white(50), None), ([1.0], [1.0], [1.0]), {}, "order has 3 entries"),
        ((white(50), None), ([1.0, 2.0], [1.0]), {}, "r "),
        ((white(50), None), ([-1.0], [1.0]), {}, "d "),
        ((white(50), None), "two", {}, "no port-Hamiltonian form of an object of type str"),
        ((white(50), None), True, {}, "no port-Hamiltonian form of an object of type bool"),
        ((white(50), None), 1, {"noise_std": 0.0}, "noise_std is 0; it must be positive"),
        ((white(50), None), 1, {"noise_std": np.nan}, "noise_std is not finite"),
        ((white(50), None), 1, {"noise_std": [1.0, 2.0]}, "noise_std has 1 dimensions"),
        ((white(50), None), 1, {"method": "exakt"}, "method"),
        ((white(50), None), 1, {"initial_state": "rest"}, "initial_state"),
        ((white(50), None), 1, {"intersample": "foh", "method": "euler"}, "intersample must be 'zoh'"),
        ((white(50), None), 1, {"dt": None}, "dt is missing"),
        ((white(50), white(49)), 1, {}, "the same length"),
        ((np.r_[white(9), np.nan], None), 1, {}, "the input is not finite"),
        ((white(5000), None), ([300.0], [1.0]), {"method": "euler"}, "use method='exact'"),
        ((white(50), None), ([1e200], [1.0]), {}, "check the units of d and dt"),
        (([1e99, -1e99, 2e98], None), ([1.0], [1e250]), {}, "leave the range of doubles"),
    ],
)
def test_bad_input_is_refused_with_what_is_wrong(data, order, options, words):
    with pytest.raises(phc.PHControlError, match=re.escape(words)):
        excitation(data, order, **({"dt": 0.1} | options))


def test_a_model_of_other_ports_than_the_record_is_refused():
    many = phc.ph(np.eye(4), np.eye(4)[:, 2:])
    with pytest.raises(phc.StructureError, match="the record has 1 input and 1 output; the model has 2 and 2"):
        excitation((white(50), None), many, dt=0.1)


def test_a_rigid_body_is_judged_as_a_real_pole():
    rigid = phc.ph(ct.tf([1], [1, 0]) + ct.tf([1, 0], [1, 0, 1]))
    report = excitation((white(400), None), rigid, dt=0.1, noise_std=0.1)
    assert report.n == 1 and report.values["real_poles"] == pytest.approx([0.0])
    assert report.sufficient and np.isfinite(report.stderr["real_poles"]).all()


def test_a_fit_by_another_method_is_refused():
    u = white(300)
    y = output_of([1.0], [1.0], [0.2], u, 0.1) + 0.01 * white(300, seed=1)
    result = phc.pem((u, y), 1, dt=0.1, method="midpoint")
    with pytest.raises(phc.StructureError, match="fitted with method='midpoint'"):
        excitation((u, y), result, dt=0.1)
    assert excitation((u, y), result, dt=0.1, method="midpoint").sufficient
    assert excitation((u, y), result.modes, dt=0.1).sufficient


# --- several records, and what is measured ---------------------------------------------------------------------------


def test_two_records_show_together_what_neither_shows_alone():
    chain, t = phc.frenkel_kontorova(2), 0.01 * np.arange(1000)
    one, other = (np.sin(t), None), (np.sin(1.6 * t), None)
    assert not excitation(one, chain, dt=0.01).sufficient
    assert "r_1 and r_2" in str(excitation([one, one], chain, dt=0.01))
    assert excitation([one, other], chain, dt=0.01).sufficient
    assert excitation([other, one], chain, dt=0.01).rank == 4


@pytest.mark.parametrize("quantity", ["velocity", "displacement", "acceleration"])
def test_errors_of_several_records_are_those_of_the_dense_joint_problem(quantity):
    d, r, h = np.array([1.0, 2.2]), np.array([1.0, 0.3]), 0.2
    inputs = [white(150), white(90, seed=5)]
    states = [np.array([0.3, -0.1 + 0.5j]), np.array([0.2j, 0.4])]

    def outputs(theta):
        parts = []
        for k, u in enumerate(inputs):
            parts.append(dense_output(np.append(theta[:4], theta[4 + 4 * k : 8 + 4 * k]), 2, u, h, quantity=quantity))
        return np.concatenate(parts)

    theta = np.concatenate([d, r, *[part for x in states for part in (x.real, x.imag)]])
    step = 1e-6
    J = np.array([(outputs(theta + step * e) - outputs(theta - step * e)) / (2 * step) for e in np.eye(len(theta))]).T
    expected = 0.1 * np.sqrt(np.diag(np.linalg.inv(J.T @ J)))
    y = np.split(outputs(theta), [150])
    found = excitation(list(zip(inputs, y, strict=True)), (d, r), dt=h, quantity=quantity, noise_std=0.1)
    assert np.allclose(np.concatenate([found.stderr["d"], found.stderr["r"]]), expected[:4], rtol=1e-5)


def test_a_frequency_response_is_refused_before_its_excitation_is_asked_for():
    response = ct.FrequencyResponseData([1j, 2j], [1.0, 2.0])
    with pytest.raises(phc.StructureError, match="frequency response; what an input shows"):
        excitation(response, 1)


# --- plants with losses, several inputs and outputs -------------------------------------------------------------------


def damped_output(theta, u, h):
    """Outputs of a mode and a real pole, `theta` = (d, zeta, pole, residues by rows), step by step."""
    d, zeta, rate, *rest = theta
    (q, m), p = (2, len(u)), d * (-zeta + 1j * np.sqrt(1 - zeta**2))
    real, imaginary, slow = np.reshape(rest, (3, q, m))
    y, state, lag = np.zeros((q, u.shape[1])), np.zeros(m, complex), np.zeros(m)
    for k in range(u.shape[1]):
        y[:, k] = 2 * ((real + 1j * imaginary) @ state).real + slow @ lag
        state = np.exp(p * h) * state + (np.exp(p * h) - 1) / p * u[:, k]
        lag = np.exp(rate * h) * lag + (np.exp(rate * h) - 1) / rate * u[:, k]
    return y


def damped_bounds(theta, u, h, covariance, moving=True):
    """Cramer-Rao bounds of `theta` by differences of all outputs, with the dense covariance of the noise."""
    T, columns = u.shape[1], []
    for k in range(len(theta)):
        step = np.zeros(len(theta))
        step[k] = 1e-5 * max(abs(theta[k]), 0.1)
        columns.append((damped_output(theta + step, u, h) - damped_output(theta - step, u, h)).ravel() / (2 * step[k]))
    d, zeta, rate = theta[:3]
    p, t = d * (-zeta + 1j * np.sqrt(1 - zeta**2)), h * np.arange(T)
    if moving:
        motions = [np.exp(p * t).real, np.exp(p * t).imag, np.exp(rate * t)]
        columns += [np.kron(np.eye(2)[o], motion) for o in range(2) for motion in motions]
    J = np.array(columns).T
    dense = np.kron(covariance, np.eye(T)) if len(covariance) == 2 else covariance
    information = J.T @ np.linalg.solve(dense, J)
    return np.sqrt(np.diag(np.linalg.inv(information)))[: len(theta)]


def dense_covariance(noise, T):
    """Covariance of the outputs of autoregressive noise at T samples, one output after another."""
    answers = np.zeros((2, 500))
    answers[:, 0] = 1.0
    for k in range(1, 500):
        for i, row in enumerate(noise.colours.T):
            answers[:, k] += row * (answers[:, k - 1 - i] if k > i else 0.0)
    lags = np.subtract.outer(np.arange(T), np.arange(T))
    return np.block([
        [noise.covariance[a, b] * np.correlate(answer, other, "full")[np.clip(499 + lags, 0, 998)]
         * (np.abs(lags) < 500) for b, other in enumerate(answers)] for a, answer in enumerate(answers)
    ])  # fmt: skip


def of_report(errors):
    real = errors["residues"]
    return np.concatenate([
        errors["natural_frequencies"], errors["damping_ratios"], errors["real_poles"], real[0].real.ravel(),
        real[0].imag.ravel(), real[1].real.ravel(),
    ])  # fmt: skip


def damped_model():
    """A plant with a mode and a real pole, and its parameters."""
    p = 2.0 * (-0.05 + 1j * np.sqrt(1 - 0.05**2))
    shapes, participation = [[1.0, 0.5 + 0.2j], [0.4, 1.0]], [[0.4, 0.1 - 0.3j], [0.3, 0.2]]
    model = phc.modes([p, -0.6], shapes, participation)
    rho = np.outer(shapes[0], participation[0])
    return model, np.concatenate([
        [2.0, 0.05, -0.6], rho.real.ravel(), rho.imag.ravel(), np.outer(shapes[1], participation[1]).real.ravel()
    ])  # fmt: skip


@pytest.mark.parametrize("noise_std", [0.3, [0.2, 0.5]])
@pytest.mark.parametrize("initial_state", ["estimate", "zero"])
def test_bounds_of_a_plant_with_losses_are_those_of_dense_sensitivities(noise_std, initial_state):
    (model, theta), h = damped_model(), 0.2
    u = np.random.default_rng(0).standard_normal((2, 150))
    report = phc.excitation((u, None), model, dt=h, noise_std=noise_std, initial_state=initial_state)
    covariance = np.diag(np.broadcast_to(noise_std, 2) ** 2)
    expected = damped_bounds(theta, u, h, covariance, moving=initial_state == "estimate")
    assert of_report(report.stderr) == pytest.approx(expected, rel=1e-5)
    assert report.sufficient and len(report.names) == len(theta) == report.rank


def test_bounds_of_a_fit_are_those_that_it_states():
    h, rng = 0.2, np.random.default_rng(1)
    u = rng.standard_normal((2, 800))
    root = np.array([[0.1, 0.0], [0.08, 0.06]])
    y = damped_output(damped_model()[1], u, h) + root @ rng.standard_normal((2, 800))
    fit = phc.pem((u, y), 1, dt=h, real_poles=1, structure="free", delay=0)
    report = phc.excitation((u, y), fit, dt=h)
    for key in ("natural_frequencies", "damping_ratios", "real_poles", "residues"):
        assert report.stderr[key].real == pytest.approx(fit.stderr[key].real, rel=0.02)


def test_coloured_noise_enters_by_its_spectrum():
    h, rng, T = 0.2, np.random.default_rng(2), 500
    u = rng.standard_normal((2, T))
    e = 0.1 * rng.standard_normal((2, T + 50))
    for k in range(1, T + 50):
        e[:, k] += 0.8 * e[:, k - 1]
    theta = damped_model()[1]
    fit = phc.pem((u, damped_output(theta, u, h) + e[:, 50:]), 1, dt=h, real_poles=1, structure="free", delay=0)
    assert fit.noise.colours is not None
    report = phc.excitation((u, None), fit, dt=h)
    known = np.concatenate([
        fit.natural_frequencies, fit.damping_ratios, fit.real_poles, fit.residues[0].real.ravel(),
        fit.residues[0].imag.ravel(), fit.residues[1].real.ravel(),
    ])  # fmt: skip
    expected = damped_bounds(known, u, h, dense_covariance(fit.noise, T))
    assert of_report(report.stderr) == pytest.approx(expected, rel=0.03)
    gaps = np.where(rng.random((2, T)) < 0.1, np.nan, damped_output(theta, u, h))
    with pytest.raises(phc.StructureError, match="samples are missing"):
        phc.excitation((u, gaps), fit, dt=h)


def test_missing_samples_and_several_records_are_counted():
    (model, theta), h, rng = damped_model(), 0.2, np.random.default_rng(3)
    u = rng.standard_normal((2, 300))
    y = damped_output(theta, u, h) + 0.1 * rng.standard_normal((2, 300))
    y[:, 150:] = np.nan
    short = phc.excitation((u[:, :150], y[:, :150]), model, dt=h, noise_std=0.1)
    gaps = phc.excitation((u, y), model, dt=h, noise_std=0.1)
    both = phc.excitation([(u[:, :150], y[:, :150])] * 2, model, dt=h, noise_std=0.1)
    assert gaps.observed == short.observed == 300
    assert of_report(gaps.stderr) == pytest.approx(of_report(short.stderr), rel=1e-6)
    assert of_report(both.stderr) == pytest.approx(of_report(short.stderr) / np.sqrt(2), rel=1e-6)
    alone = phc.excitation((u[:, :150], y[:, :150]), model, dt=h)
    assert np.sqrt(np.diag(alone.noise.covariance)) == pytest.approx([0.1, 0.1], rel=0.2)


def test_inputs_that_are_one_do_not_show_what_each_does():
    (model, _), h = damped_model(), 0.2
    u = np.random.default_rng(4).standard_normal(300)
    report = phc.excitation((np.stack([u, u]), None), model, dt=h, noise_std=0.1)
    assert not report.sufficient and report.information.deficiency == 6
    assert np.isfinite(report.stderr["damping_ratios"]).all()
    assert np.isinf(report.stderr["residues"][0].real).all()
    assert "independent of one another" in report.remedies[0]
    assert "does NOT show" in str(report) and report.summary().startswith("What the record shows of a plant of 1 mode")
    unknown = phc.excitation((np.stack([u, u]), None), model, dt=h)
    assert np.isnan(unknown.stderr["damping_ratios"]).all() and np.isinf(unknown.stderr["residues"][0].real).all()


@pytest.mark.parametrize("size", [1e-9, 1e9])
def test_bounds_of_a_plant_follow_units_of_time_and_of_signals(size):
    (model, _), h = damped_model(), 0.2
    u = np.random.default_rng(5).standard_normal((2, 200))
    plain = phc.excitation((u, None), model, dt=h, noise_std=0.1).stderr
    faster = phc.modes(model.poles[model.poles.imag >= 0] / size, model.shapes, np.asarray(model.participation) / size)
    other = phc.excitation((size * u, None), faster, dt=size * h, noise_std=0.1 * size).stderr
    assert other["damping_ratios"] == pytest.approx(plain["damping_ratios"], rel=1e-6)
    assert other["natural_frequencies"] == pytest.approx(plain["natural_frequencies"] / size, rel=1e-6)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"quantity": "displacement"}, "quantity is 'displacement', which is asked of lossless modes of one port"),
        ({"noise_std": [0.1, 0.1, 0.1]}, "a number or one for each of 2 outputs"),
        ({"noise_std": -1.0}, "it must be positive"),
    ],
)
def test_options_that_do_not_fit_a_plant_with_losses_are_refused(options, message):
    with pytest.raises(phc.StructureError, match=message):
        phc.excitation((np.ones((2, 50)), None), damped_model()[0], dt=0.1, **options)


def test_a_record_too_short_for_a_plant_is_refused():
    with pytest.raises(phc.IdentificationError, match="record more than 4"):
        phc.excitation((np.ones((2, 4)), None), damped_model()[0], dt=0.1)
