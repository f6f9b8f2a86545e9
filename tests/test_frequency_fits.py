"""Fits to frequency responses: maximum likelihood for lossless plants, frequencies and damping of real ones."""

from __future__ import annotations

from functools import partial

import control as ct
import numpy as np
import pytest
from scipy.io import loadmat
from slow import slowly

import ph_control as phc

lossless_fit = partial(phc.pem, structure="lossless")

PLANTS = {
    1: ([1.03], [1.0]),
    3: ([0.51, 1.93, 2.6], [1.0, 0.4, 0.7]),
    6: ([0.31, 0.74, 1.13, 1.62, 2.21, 2.77], [1.0, 0.4, 0.7, 0.5, 0.8, 0.3]),
}
EPS = np.finfo(float).eps


def response(d, r, omega, quantity="velocity", ratio=0.0):
    factor = {"velocity": 1j * omega, "displacement": 1.0, "acceleration": -(omega**2)}[quantity]
    parts = zip(d, r, strict=True)
    return sum(weight * one * factor / (one**2 - omega**2 + 2j * ratio * one * omega) for one, weight in parts) + 0j


def noise(size, seed):
    rng = np.random.default_rng(seed)
    return size * (rng.standard_normal(np.shape(size)) + 1j * rng.standard_normal(np.shape(size)))


def found(result, name):
    """Findings of a cause."""
    return [one for one in result.findings if one.cause.name == name]


def share_of(result):
    """Noise over gain, where it grows with it."""
    return found(result, "GAIN_NOISE")[0].values[0] if found(result, "GAIN_NOISE") else 0.0


def is_at_the_optimum(result, d, r):
    return bool(
        np.all(np.abs(result.d - d) < 4 * result.stderr["d"]) and np.all(np.abs(result.r - r) < 4 * result.stderr["r"])
    )


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("quantity", ["velocity", "displacement", "acceleration"])
@pytest.mark.parametrize("n", PLANTS)
def test_noisy_responses_of_lossless_plants_are_fitted_to_within_their_errors(n, quantity):
    d, r = PLANTS[n]
    omega = np.linspace(0.05, 3.2, 60)
    exact, rejected = response(d, r, omega, quantity), 0
    for seed in (2, 3):
        measured = exact + noise(0.01 * np.median(np.abs(exact)) * np.ones(60), seed)
        data, order = ct.frd(measured, omega), n if seed % 2 else "auto"
        result = phc.pem(data, order, quantity=quantity)
        assert result.order == n and result.outcome.name == "CONSISTENT"
        # one in twenty is rejected by chance
        rejected += result.structure != "lossless"
        assert is_at_the_optimum(lossless_fit(data, order, quantity=quantity), d, r)
    assert rejected <= 1


@pytest.mark.variants
@pytest.mark.parametrize("n", PLANTS)
def test_weights_make_the_estimate_that_of_the_noise_they_belong_to(n):
    d, r = PLANTS[n]
    omega = np.linspace(0.05, 3.2, 80)
    exact = response(d, r, omega)
    size = 0.01 * (np.median(np.abs(exact)) + np.abs(exact))
    errors = []
    for seed in range(2):
        data = ct.frd(exact + noise(size, seed), omega)
        weighted, plain = lossless_fit(data, n, weights=1 / size**2), lossless_fit(data, n, weights=np.ones(80))
        assert is_at_the_optimum(weighted, d, r)
        assert weighted.noise_variance == pytest.approx(1.0, rel=0.4)
        errors.append([np.linalg.norm(weighted.r - r), np.linalg.norm(plain.r - r)])
    weighted_error, plain_error = np.mean(errors, axis=0)
    assert weighted_error < plain_error


@pytest.mark.variants
@pytest.mark.parametrize("quantity", ["velocity", "displacement", "acceleration"])
@pytest.mark.parametrize("n", PLANTS)
@pytest.mark.parametrize("order", ["given", "auto"])
def test_exact_responses_are_fitted_to_rounding(n, quantity, order):
    d, r = PLANTS[n]
    omega = np.linspace(0.05, 3.2, 60)
    result = phc.pem(
        ct.frd(response(d, r, omega, quantity), omega), n if order == "given" else "auto", quantity=quantity
    )
    assert result.order == n
    assert np.allclose(result.d, d, rtol=1e3 * n * EPS, atol=0)
    assert np.allclose(result.r, r, rtol=1e5 * n * EPS, atol=0)


@pytest.mark.slow
def test_modes_between_two_points_and_close_to_one_are_found():
    omega = np.linspace(0.1, 3.0, 30)
    step = omega[1] - omega[0]
    for place in (0.5, 0.02, 0.97):
        d, r = [omega[8] + place * step, omega[20] + 0.4 * step], [1.0, 0.5]
        exact = response(d, r, omega)
        result = lossless_fit(ct.frd(exact + noise(0.01 * np.median(np.abs(exact)) * np.ones(30), 0), omega), 2)
        assert is_at_the_optimum(result, d, r)


def test_two_modes_between_the_same_two_points_are_told_apart_without_noise():
    omega = np.linspace(0.1, 3.0, 30)
    d = omega[10] + np.array([0.25, 0.8]) * (omega[1] - omega[0])
    result = phc.pem(ct.frd(response(d, [1.0, 0.6], omega), omega), 2)
    assert np.allclose(result.d, d, rtol=1e-8) and np.allclose(result.r, [1.0, 0.6], rtol=1e-6)


def test_noise_that_goes_with_the_gain_casts_doubt_where_points_were_taken_as_equally_sure():
    omega, rng = np.linspace(0.2, 3.0, 300), np.random.default_rng(5)
    exact = phc.frenkel_kontorova().modes.freqresp(omega)
    noise = rng.standard_normal(300) + 1j * rng.standard_normal(300)
    data = ct.frd(exact * (1 + 0.01 * noise), omega, smooth=False)
    alike = lossless_fit(data, 2, weights=np.ones(300))
    assert alike.outcome.name == "DOUBTFUL" and not found(alike, "GAIN_NOISE")
    weighted = lossless_fit(data, 2, weights=1 / np.abs(exact) ** 2)
    assert weighted.outcome.name == "CONSISTENT" and not found(weighted, "GAIN_NOISE")


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("order", [3, "auto"])
def test_noise_that_goes_with_the_gain_is_estimated_without_weights(order):
    inside = []
    for seed in range(2):
        d, r, exact, data = plant_with_noise(3, seed, relative=0.02, floor=0.002)
        result = lossless_fit(data, order)
        assert result.order == 3 and result.outcome.name == "CONSISTENT"
        assert share_of(result) == pytest.approx(0.02 / np.sqrt(2), rel=0.4)
        size = np.hypot(0.02 * np.abs(exact), 0.002 * np.median(np.abs(exact)))
        known = lossless_fit(data, 3, weights=1 / size**2)
        assert np.allclose(result.stderr["d"], known.stderr["d"], rtol=0.4)
        assert np.all(np.abs(result.d - known.d) < 1.5 * known.stderr["d"])
        for name, true in (("d", d), ("r", r)):
            inside.append(np.abs(getattr(result, name) - true) < 1.96 * result.stderr[name])
    assert np.mean(inside) > 0.85


def test_constant_noise_of_a_response_stays_constant():
    d, r = PLANTS[3]
    omega = np.linspace(0.05, 3.2, 80)
    exact = response(d, r, omega)
    for seed in range(2):
        data = ct.frd(exact + noise(np.full(80, 0.02 * np.median(np.abs(exact))), seed), omega)
        plain, told = phc.pem(data, 3), phc.pem(data, 3, weights=np.ones(80))
        assert share_of(plain) == 0 and np.array_equal(plain.d, told.d)


def test_the_share_of_the_noise_is_saved_with_the_result(tmp_path):
    *_, data = plant_with_noise(1, 0, relative=0.02)
    result = phc.pem(data, 1)
    result.save(tmp_path / "fit.json")
    assert phc.load(tmp_path / "fit.json").findings == result.findings and share_of(result) > 0


@pytest.mark.parametrize("seed", range(3))
def test_points_weighted_by_their_gain_lead_to_the_resonances(seed):
    """So weighted, antiresonances count as much as resonances, and a mode alone is drawn away from its own."""
    omega = np.linspace(0.2, 3.0, 300)
    exact = response([0.618, 1.618], [0.447, 0.447], omega)
    data = ct.frd(exact + noise(0.01 * np.abs(exact), seed), omega)
    result = phc.pem(data, 2, weights=1 / np.abs(exact) ** 2)
    assert np.allclose(result.d, [0.618, 1.618], rtol=1e-3) and result.outcome.name == "CONSISTENT"


def plant_with_noise(n, seed, *, relative, floor=0.0, points=25):
    """Residues within a factor of 5, modes at least 4 points apart, noise in proportion to the gain above a floor."""
    rng = np.random.default_rng([n, seed])
    omega = np.linspace(0.05, 3.2, points * n)
    place = np.sort(rng.uniform(2, len(omega) - 3, (1000, n)), axis=1)
    place = place[np.min(np.diff(place, axis=1), axis=1, initial=np.inf) >= 4][0]
    d, r = np.interp(place, np.arange(len(omega)), omega), rng.uniform(0.2, 1.0, n)
    exact = response(d, r, omega)
    size = np.hypot(relative * np.abs(exact), floor * np.median(np.abs(exact))) / np.sqrt(2)
    return d, r, exact, ct.frd(exact + noise(size, seed), omega, smooth=False)


@pytest.mark.variants
@pytest.mark.parametrize("n", [3, 12])
def test_the_order_is_found_where_noise_and_weights_go_with_the_gain(n):
    """There one mode alone explains next to nothing, and no criterion speaks for it."""
    d, r, exact, data = plant_with_noise(n, 0, relative=0.01)
    result = lossless_fit(data, weights=1 / np.abs(exact) ** 2)
    assert result.order == n and is_at_the_optimum(result, d, r)
    assert result.whiteness > 1e-3 and result.tests[0].p > 1e-3


@pytest.mark.variants
@pytest.mark.parametrize("distance", [0.1, 1e-2, 1e-4])
def test_a_resonance_close_to_a_point_is_placed_by_that_point(distance):
    """There the minimum is narrow, and beside it is a wide one that leaves the point unexplained."""
    for seed in range(2):
        d, r, exact, data = plant_with_noise(3, seed, relative=0.001)
        step = data.omega[1] - data.omega[0]
        d[1] = data.omega[np.argmin(np.abs(data.omega - d[1]))] - distance * step
        exact = response(d, r, data.omega)
        data = ct.frd(exact + noise(0.001 * np.abs(exact), seed), data.omega, smooth=False)
        result = lossless_fit(data, 3, weights=1 / np.abs(exact) ** 2)
        assert is_at_the_optimum(result, d, r)
        assert np.sqrt(result.noise_variance) == pytest.approx(0.001, rel=0.4)


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize(
    "d, r",
    [
        ([1.064, 2.648, 5.679, 7.375, 7.756, 8.54], [0.2, 1.84, 1.97, 0.72, 1.66, 0.35]),
        ([3.914, 5.515, 5.796, 6.173, 6.628, 7.625], [1.15, 1.94, 1.04, 1.66, 1.76, 1.33]),
    ],
)
def test_modes_in_wrong_places_are_passed_by_some_that_are_dropped_again(d, r):
    """Modes a few points apart, and antiresonances between them that count as much: a path of six steps goes astray."""
    omega = np.geomspace(0.1, 20.0, 400)
    exact = response(d, r, omega)
    for seed in range(2):
        data = ct.frd(exact + noise(0.01 / np.sqrt(2) * np.abs(exact), seed), omega, smooth=False)
        result = phc.pem(data, 6, weights=1 / np.abs(exact) ** 2)
        assert np.allclose(result.d, d, rtol=1e-3) and np.all(np.abs(result.residues) > 0), seed


@pytest.mark.variants
@pytest.mark.parametrize("seed", range(2))
def test_a_response_with_a_missed_resonance_is_not_called_explained(seed):
    """A few points at the resonance outweigh all others: without care, what they leave looks white."""
    omega = np.linspace(2.0, 100.0, 400)
    exact = response([10.0, 25.0, 60.0], [1.0, 0.6, 0.3], omega)
    data = ct.frd(exact + noise(np.full(400, 0.01 * np.median(np.abs(exact))), seed), omega)
    missed, whole = phc.pem(data, 1), phc.pem(data, 3)
    assert missed.whiteness < 1e-10 and missed.outcome.name == "DOUBTFUL"
    assert whole.whiteness > 1e-3 and whole.outcome.name == "CONSISTENT"


def test_the_fit_of_a_response_is_judged_in_the_scale_of_its_weights():
    omega = np.linspace(0.2, 5.0, 60)
    size = np.where(omega > 3, 1.0, 0.01)
    data = ct.frd(response([1.0, 2.3], [1.0, 0.5], omega) + noise(size, 1), omega)
    result = phc.pem(data, 2, weights=1 / size**2)
    y, error, weight = (np.squeeze(x) for x in (data.frdata, result.residuals, 1 / size**2))
    mean = np.sum(weight * y) / np.sum(weight)
    expected = 1 - np.sqrt(np.sum(weight * abs(error) ** 2) / np.sum(weight * abs(y - mean) ** 2))
    assert np.isclose(result.fit_percent, 100 * expected, rtol=1e-12)
    assert np.isclose(result.experiments[0].fit_percent, result.fit_percent, rtol=1e-12)
    assert np.isclose(phc.compare(result.record, result, weights=1 / size**2).fit_percent[0], result.fit_percent)


def test_repeated_frequencies_count_as_repeated_measurements():
    d, r = PLANTS[3]
    once = np.linspace(0.05, 3.2, 40)
    omega = np.repeat(once, 3)
    exact = response(d, r, omega)
    size = 0.02 * np.median(np.abs(exact))
    many = phc.pem(ct.frd(exact + noise(size * np.ones(120), 0), omega), 3)
    few = phc.pem(ct.frd((exact + noise(size * np.ones(120), 0))[::3], once), 3)
    assert is_at_the_optimum(many, d, r)
    assert np.allclose(few.stderr["d"] / many.stderr["d"], np.sqrt(3), rtol=0.4)


@pytest.mark.variants
@pytest.mark.parametrize("order", [1, "auto"])
@pytest.mark.parametrize("points", [3, 5, 7, 9, 12])
def test_few_points_are_enough_for_a_mode(points, order):
    omega = np.linspace(0.6, 1.6, points)
    result = phc.pem(ct.frd(response([1.03], [0.7], omega), omega), order)
    assert result.d[0] == pytest.approx(1.03, rel=1e-9) and result.r[0] == pytest.approx(0.7, rel=1e-8)


@pytest.mark.parametrize("points", [3, 5, 7])
def test_few_points_of_a_sensor_of_any_kind_are_enough_for_a_mode(points):
    omega = np.linspace(0.6, 1.6, points)
    result = phc.pem(ct.frd(response([1.03], [0.7], omega), omega), 1, quantity="free")
    assert result.poles[0] == pytest.approx(1.03j, rel=1e-9)


@pytest.mark.variants
@pytest.mark.parametrize("seed", range(6))
def test_few_noisy_points_are_fitted_or_left_without_a_mode(seed):
    omega = np.linspace(0.6, 1.6, 3)
    exact = response([1.03], [0.7], omega)
    result = phc.pem(ct.frd(exact + noise(0.3 * np.abs(exact), seed), omega), 1)
    assert result.order <= 1 and np.all(np.isfinite(result.poles))


def test_two_points_are_too_few_for_a_mode_of_any_damping():
    with pytest.raises(phc.IdentificationError, match="4 unknowns in all channels, more than the 4 observed"):
        phc.pem(ct.frd(response([1.03], [0.7], np.array([0.6, 1.6])), [0.6, 1.6]), 1)


def test_several_responses_and_missing_points_are_one_fit():
    d, r = PLANTS[3]
    parts = [np.linspace(0.05, 1.7, 40), np.linspace(1.2, 3.2, 35)]
    data = []
    for seed, omega in enumerate(parts):
        measured = response(d, r, omega) + noise(0.01 * np.ones(len(omega)), seed)
        measured[::9] = np.nan
        data.append(ct.frd(measured, omega))
    result = lossless_fit(data, 3)
    assert is_at_the_optimum(result, d, r)
    reversed_order = lossless_fit(data[::-1], 3)
    assert np.allclose(result.d, reversed_order.d, rtol=1e-9)


@pytest.mark.slow
def test_a_long_response_is_searched_everywhere():
    d, r = PLANTS[6]
    omega = np.linspace(0.05, 3.2, 4000)
    exact = response(d, r, omega)
    result = phc.pem(ct.frd(exact + noise(0.2 * np.median(np.abs(exact)) * np.ones(4000), 0), omega), 6)
    assert is_at_the_optimum(result, d, r)


def test_damped_response_is_no_lossless_one_and_has_its_damping():
    d, r = PLANTS[3]
    omega = np.linspace(0.05, 3.2, 200)
    exact = response(d, r, omega, ratio=0.01)
    data = ct.frd(exact + noise(0.02 * np.median(np.abs(exact)) * np.ones(200), 0), omega)
    result = phc.pem(data)
    assert result.structure == "classical" and result.outcome.name == "CONSISTENT"
    assert np.allclose(result.natural_frequencies, d, rtol=1e-3)
    assert np.allclose(result.damping_ratios, 0.01, rtol=0.02)
    lossless = lossless_fit(data)
    assert np.allclose(lossless.d, d, rtol=0.03) and lossless.outcome.name == "NOT_DESCRIBED"
    assert found(lossless, "LOSSES") and "show losses" in lossless.message


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("weighted", [True, False])
def test_a_response_is_tested_for_damping_that_leaves_its_residuals_white(weighted):
    d, r = PLANTS[3]
    omega = np.linspace(0.05, 3.2, 80)
    p = []
    for ratio in (0.0, 1e-3):
        for seed in range(3):
            exact = response(d, r, omega, ratio=ratio)
            size = 0.01 * (np.abs(exact) if weighted else np.median(np.abs(exact)))
            data = ct.frd(exact + noise(size * np.ones(80), seed), omega, smooth=False)
            result = lossless_fit(data, 3, weights=1 / size**2 if weighted else None)
            (test,) = result.tests
            # six unknowns fewer, and what is fed through where it stands out by chance
            assert test.hypothesis == "lossless" and test.dof in (6, 7)
            p.append(test.p)
            if ratio:
                damped = phc.pem(data, 3, weights=1 / size**2 if weighted else None, structure="classical")
                assert np.all(np.abs(damped.damping_ratios - ratio) < 4 * damped.stderr["damping_ratios"])
    assert min(p[:3]) > 1e-3 and max(p[:3]) > 0.3 and max(p[3:]) < 1e-3


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("n", [1, 3])
@pytest.mark.parametrize("relative, floor", [(0.02, 0.0), (0.02, 0.02), *slowly((0.0, 0.02))])
def test_intervals_of_responses_without_weights_hold_what_they_should(n, relative, floor):
    inside = []
    for seed in range(4 // n + 1):
        d, r, _, data = plant_with_noise(n, seed, relative=relative, floor=floor)
        result = lossless_fit(data, n)
        assert (share_of(result) > 0) == (relative > 0) and result.whiteness > 1e-3
        assert result.tests[0].p > 1e-3
        for name, true in (("d", d), ("r", r)):
            low, high = result.confidence_interval()[name].T
            inside.append((low <= true) & (true <= high))
    assert np.mean(inside) >= 0.8


@pytest.mark.slow
def test_noise_that_grows_with_the_gain_is_found_in_any_units():
    *_, data = plant_with_noise(3, 1, relative=0.03, floor=0.02)
    laws = [share_of(phc.pem(ct.frd(unit * data.frdata, data.omega), 3)) for unit in (1e-6, 1.0, 1e6)]
    assert laws[1] > 0.01 and np.allclose(laws, laws[1], rtol=1e-6)


# --- recordings ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_both_modes_of_the_robot_arm_are_found_and_what_contradicts_is_said(data_folder):
    torque, acceleration = np.loadtxt(data_folder / "measured" / "robot_arm.dat", unpack=True)
    options = {"dt": 1.0, "quantity": "acceleration"}
    free = phc.pem((torque, acceleration), 2, **options)
    assert np.allclose(free.hertz, [0.0583, 0.1267], rtol=0.01)
    result = lossless_fit((torque, acceleration), 2, **options)
    assert result.outcome.name == "NOT_DESCRIBED" and found(result, "LOSSES")


@pytest.mark.variants
@pytest.mark.parametrize("column, order", [(0, 3), (0, "auto"), (1, "auto"), (2, "auto")])
def test_all_three_modes_of_the_measured_receptances_are_found(data_folder, column, order):
    content = loadmat(data_folder / "measured" / "mckiddat.mat")
    data = ct.frd(content["Recep"][:, column], 2 * np.pi * content["Freq"].ravel())
    free = phc.pem(data, order, quantity="displacement")
    assert np.allclose(free.hertz, [0.1029, 0.1962, 0.3247], rtol=0.01) and np.all(free.damping_ratios > 0)
    result = lossless_fit(data, order, quantity="displacement")
    assert np.allclose(result.hertz, free.hertz, rtol=0.01)
    assert result.outcome.name == "NOT_DESCRIBED" and found(result, "LOSSES")


@pytest.mark.slow
def test_all_six_modes_of_the_free_beam_are_found(data_folder):
    lines = (data_folder / "measured" / "meas_point_1.txt").read_text().split()
    measured = np.array([complex(one) for one in lines])
    frequency = np.arange(len(measured), dtype=float)
    # the highest point within each peak, to the spacing of the points
    size = np.abs(measured)
    inside = (size[1:-1] > size[:-2]) & (size[1:-1] > size[2:])
    peaks = np.flatnonzero(inside & (size[1:-1] > 10 * np.median(size))) + 1
    free = phc.pem(ct.frd(measured, 2 * np.pi * frequency), quantity="acceleration")
    sharp = free.hertz[free.damping_ratios < 0.05]
    assert np.allclose(sharp, [51.5, 142.2, 278.7, 460.4, 687.2, 958.5], rtol=0.001)
    assert all(np.abs(frequency[peaks] - one).min() <= 1.0 for one in sharp)
    assert found(lossless_fit(ct.frd(measured, 2 * np.pi * frequency), 6, quantity="acceleration"), "LOSSES")


def outliers_of(result):
    """Numbers of values far out of the noise, and where the farthest are."""
    return [one.values for one in found(result, "OUTLIERS")]


def left_out(result):
    """Frequencies of the lines that were left out."""
    return [value for each in found(result, "WILD_LINES") for value in each.values]


@pytest.mark.parametrize("order", [3, "auto"])
def test_a_point_far_out_of_the_noise_is_named(order):
    d, _, exact, data = plant_with_noise(3, 1, relative=0.01)
    size = 0.01 * np.abs(exact)
    weights = 1 / size**2
    plain = phc.pem(data, order, weights=weights)
    assert not outliers_of(plain) and not left_out(plain)
    measured = np.array(data.frdata[0, 0])
    measured[40] += 200 * size[40]
    result = phc.pem(ct.frd(measured, data.omega, smooth=False), order, weights=weights)
    # beside a number of modes that is given, or as a mode that only this line would ask for
    named = (outliers_of(result) == [(40.0,)] and result.outcome.name == "DOUBTFUL") or left_out(result) == [
        pytest.approx(data.omega[40])
    ]
    assert named and result.order == 3 and np.allclose(result.natural_frequencies, d, rtol=2e-3)


@pytest.mark.variants
@pytest.mark.parametrize("point", [0, 2])
def test_an_error_at_a_resonance_is_no_damping(point):
    d, r, exact, data = plant_with_noise(3, 1, relative=0.01)
    size = 0.01 * np.abs(exact)
    place = int(np.argmin(np.abs(data.omega - d[point])))
    measured = np.array(data.frdata[0, 0])
    measured[place] += 200 * size[place]
    result = phc.pem(ct.frd(measured, data.omega, smooth=False), 3, weights=1 / size**2)
    assert left_out(result) == [pytest.approx(data.omega[place])]
    assert result.structure == "lossless" and is_at_the_optimum(result, d, r)


@pytest.mark.slow
def test_damped_resonances_with_a_wrong_value_next_to_each_keep_all_lines_but_that():
    omega, d = np.linspace(0.05, 3.2, 120), [0.9, 1.7, 2.6]
    exact = response(d, [1.0, 0.8, 1.2], omega, ratio=0.01)
    size = 0.01 * np.abs(exact)
    assert not left_out(phc.pem(ct.frd(exact + noise(size, 3), omega, smooth=False), 3, weights=1 / size**2))
    for resonance in d:
        measured = exact + noise(size, 3)
        place = int(np.argmin(np.abs(omega - resonance)))
        measured[place] += 200 * size[place]
        result = phc.pem(ct.frd(measured, omega, smooth=False), 3, weights=1 / size**2)
        assert left_out(result) == [pytest.approx(omega[place])] or outliers_of(result) == [(float(place),)]


def test_a_sample_far_out_of_the_noise_of_a_record_is_named():
    rng = np.random.default_rng(0)
    u, plant = rng.standard_normal(400), phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]))
    y = phc.forced_response(plant, np.arange(400.0), u, intersample="zoh").outputs + 0.1 * rng.standard_normal(400)
    assert not outliers_of(phc.pem((u, y), 2, dt=1.0))
    y[123] += 20
    result = phc.pem((u, y), 2, dt=1.0)
    assert outliers_of(result) == [(123.0,)] and result.outcome.name == "DOUBTFUL"


@pytest.mark.slow
def test_a_crystal_is_damped_though_its_lossless_model_does_not_converge():
    f = np.linspace(9.98e6, 10.05e6, 800)
    s = 2j * np.pi * f
    exact = 1 / (15 + s * 12.665e-3 + 1 / (s * 20e-15)) + s * 5e-12
    rng = np.random.default_rng(0)
    z = rng.standard_normal(800) + 1j * rng.standard_normal(800)
    measured = ct.frd(exact + 0.005 * np.abs(exact) * z + 2e-6 * z[::-1], s.imag)
    result = phc.pem(measured)
    assert result.order == 1 and result.structure == "classical"
    values = {one.name: one.value for one in phc.netlist(result.system).elements}
    assert values == pytest.approx({"L1": 12.665e-3, "R1": 15.0, "C1": 20e-15}, rel=0.01)


def test_noise_in_proportion_to_the_gain_of_two_damped_modes_leaves_two_modes():
    # lossless modes do not even converge here, which says nothing of damped ones
    rng, hertz = np.random.default_rng(2), np.linspace(5.0, 200.0, 200)
    s = 2j * np.pi * hertz
    modes = ((1.0, 2 * np.pi * 33.0, 0.01), (0.6, 2 * np.pi * 120.0, 0.02))
    for _ in range(2):  # the second response
        noise = 0.03 * (rng.standard_normal(200) + 1j * rng.standard_normal(200))
    response = sum(weight * s / (d**2 + 2 * zeta * d * s + s**2) for weight, d, zeta in modes) * (1 + noise)
    result = phc.pem(ct.frd(response, s.imag))
    assert (result.order, result.structure, result.outcome.name) == (2, "classical", "CONSISTENT")
    assert np.all(np.abs(result.damping_ratios - [0.01, 0.02]) < 4 * result.stderr["damping_ratios"])
