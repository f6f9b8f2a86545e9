"""One step of a mode with any pole, against mpmath and dense matrices."""

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import EPS, dense_step

import ph_control as phc
from ph_control.modal.discretization import Hold

SIZES = 10.0 ** np.r_[-300, -200, -100:-6:7, np.linspace(-6, 3, 37), np.linspace(3.3, 9, 20)]
# of poles that decay, oscillate and grow
ANGLES = np.pi * np.array([0.5, -0.5, 0.500001, 0.51, -0.6, 0.75, 0.9, 1.0])
RULES = [("exact", "zoh"), ("exact", "foh"), ("midpoint", "zoh"), ("midpoint", "foh"), ("euler", "zoh")]


def integrals(z):
    """Integrals of `f e^{zt}` over [0, 1] for `f = 1, t, 1 - t, t (1 - t), t^2`, and sizes of what they are made of."""
    if abs(z) < mp.mpf(10) ** -40:
        return [1 + z / 2, 0.5 + z / 3, 0.5 + z / 6, (1 + z / 2) / 6, (1 + 3 * z / 4) / 3], [0] * 5
    e = mp.exp(z)
    one = (e - 1) / z
    t, rest = (e - one) / z, (one - 1) / z
    size = [0, (abs(e) + abs(one)) / abs(z), 0, (abs(t) + abs(rest)) / abs(z), 0]
    return [one, t, rest, (t - rest) / z, (e - 2 * t) / z], size if abs(z) > 3 else [0] * 5


def exact_numbers(p, h):
    """Multiplier, weights of a held input and their derivative, those of an interpolated one and theirs."""
    with mp.workdps(200):
        H = mp.mpf(h)
        z = H * mp.mpc(p.real, p.imag)
        (one, t, rest, both, square), size = integrals(z)
        sizes = [0, 0, H * H * size[1], H * size[1], 0, 0, H * H * size[3]]
        return [mp.exp(z), H * one, H * H * t, H * t, H * rest, H * H * square, H * H * both], sizes


def numbers(p, h):
    held, interpolated = Hold(h), Hold(h, "exact", "foh")
    now, _, slope, _ = held.weights_and_derivatives(p)
    assert np.array_equal(held.weights(p)[0], now)
    assert np.array_equal(interpolated.weights(p), interpolated.weights_and_derivatives(p)[:2])
    return [held.multiplier(p), now, slope, *interpolated.weights_and_derivatives(p)]


@pytest.mark.variants
@pytest.mark.parametrize("angle", ANGLES)
def test_exact_steps_are_right_to_eight_roundings_from_tiny_to_huge_steps(angle):
    h = 0.37
    direction = {0.5 * np.pi: 1j, -0.5 * np.pi: -1j, np.pi: -1.0}.get(angle, np.exp(1j * angle))
    p = direction * SIZES / h
    found = numbers(p, h)
    for k, pole in enumerate(p):
        truths, sizes = exact_numbers(pole, h)
        for values, truth, size in zip(found, truths, sizes, strict=True):
            # next to a zero of a difference: of the terms it is of
            allowed = 8 * EPS * max(abs(truth), size) + np.finfo(float).tiny
            assert abs(mp.mpc(complex(values[k])) - truth) <= allowed


def test_steps_of_growing_modes_are_right_too():
    h, p = 0.5, np.array([1e-9, 0.3, 2.0, 6.5, 40.0, 1.0 + 20j, 30 - 200j, 600.0])
    for k, pole in enumerate(p):
        truths, sizes = exact_numbers(complex(pole), h)
        for values, truth, size in zip(numbers(p.astype(complex), h), truths, sizes, strict=True):
            assert abs(mp.mpc(complex(values[k])) - truth) <= 8 * EPS * max(abs(truth), size)


def test_a_pole_at_zero_integrates():
    zero = np.zeros(1, complex)
    assert Hold(2.0).weights(zero)[0] == 2.0
    now, then, now_slope, then_slope = Hold(2.0, "exact", "foh").weights_and_derivatives(zero)
    assert abs(now - 1) <= EPS and abs(then - 1) <= EPS
    assert abs(now_slope - 4 / 3) <= 4 * EPS and abs(then_slope - 2 / 3) <= 4 * EPS


def test_whole_turns_in_a_step_leave_what_the_rounding_of_the_step_leaves():
    """There a held input does not reach the mode, but for the rounding of the frequency and the step."""
    p = 2j * np.pi * np.array([1.0, 3.0, 1e3, 1e6])
    for value, pole in zip(Hold(1.0).weights(p)[0], p, strict=True):
        truth = exact_numbers(complex(pole), 1.0)[0][1]
        assert 0 < abs(truth) < 1e-15
        assert abs(mp.mpc(complex(value)) - truth) <= 8 * EPS * abs(truth)


@pytest.mark.parametrize("method", ["exact", "midpoint", "euler"])
@pytest.mark.parametrize("pole", [1.3j, -0.7 + 1.3j, -0.7, 0.2 - 2j, -1e-6 + 40j, -30.0, 1e-9j])
def test_the_logarithm_of_the_multiplier_keeps_its_phase(method, pole):
    h = 0.37
    growth, (high, low) = Hold(h, method).log_multiplier(np.array([pole], complex))
    with mp.workdps(60):
        z = mp.mpf(h) * mp.mpc(pole)
        x, y = z.real, z.imag
        true_growth = {"exact": x, "euler": mp.log(abs(1 + z)), "midpoint": mp.log(abs((1 + z / 2) / (1 - z / 2)))}
        true_phase = {"exact": y, "euler": mp.atan2(y, 1 + x), "midpoint": mp.atan2(y, 1 - (x * x + y * y) / 4)}
        size = max(abs(true_growth[method]), abs(true_phase[method]))
        assert abs(mp.mpf(float(growth[0])) - true_growth[method]) <= 4 * EPS * abs(true_growth[method]) + 1e-19
        # as far as the long double of the machine reaches
        assert abs(mp.mpf(float(high[0])) + mp.mpf(float(low[0])) - true_phase[method]) <= (
            8 * np.finfo(np.longdouble).eps * size
        )


@settings(deadline=None, max_examples=25, derandomize=True)
@given(st.sampled_from(RULES), st.floats(1e-3, 3.0), st.floats(-3, 1), st.floats(-5, 5))
def test_one_step_is_that_of_the_dense_system(rule, h, real, imag):
    hold, p = Hold(h, *rule), np.array([complex(real, imag)])
    A, B = np.array([[real, -imag], [imag, real]]), np.array([[1.0], [0.0]])
    F, now, then = dense_step(A, B, h, *rule)
    # what the exponentials of matrices are right to
    size = 1e-12 * max(1.0, np.linalg.norm(F)) * max(1.0, h)
    assert np.abs(hold.multiplier(p)[0] - (F[0, 0] + 1j * F[1, 0])) <= size
    for weight, truth in zip(hold.weights(p), (now, then), strict=True):
        assert np.abs(weight[0] - (truth[0, 0] + 1j * truth[1, 0])) <= size
    step = hold.step_of_matrices(A, B)
    for found, truth in zip((step.F, step.held - step.risen, step.risen), (F, now, then), strict=True):
        assert np.max(np.abs(found - truth)) <= size


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("pole", [1.3j, -0.7 + 1.3j, -0.4, 8.0j - 2.0, -25.0])
def test_derivatives_by_the_pole_are_those_of_differences(rule, pole):
    hold, p, move = Hold(0.37, *rule), np.array([pole], complex), 1e-6 * (0.6 + 0.8j)
    up, down = (hold.weights(p + sign * move) for sign in (1, -1))
    derivatives = hold.weights_and_derivatives(p)[2:]
    for high, low, derivative in zip(up, down, derivatives, strict=True):
        assert abs((high - low)[0] / (2 * move) - derivative[0]) < 1e-9
    turn = np.log(hold.multiplier(p + move) / hold.multiplier(p - move))[0] / (2 * move)
    assert abs(turn - hold.log_derivative(p)[0]) < 1e-8


@pytest.mark.parametrize("method", ["exact", "midpoint", "euler"])
def test_the_pole_of_a_multiplier_is_the_way_back(method):
    p = np.array([1.3j, -0.7 + 1.3j, -0.4, -2.0 - 6j])
    hold = Hold(0.37, method)
    assert np.max(np.abs(hold.pole(hold.multiplier(p)) - p)) < 1e-14


def test_a_multiplier_of_zero_has_powers():
    for hold, pole in ((Hold(1.0, "euler"), -1.0), (Hold(1.0, "midpoint"), -2.0)):
        powers = hold.step(np.array([pole], complex)).powers(np.array([0.0, 1.0, 2.0]))
        assert np.array_equal(powers, [[1.0, 0.0, 0.0]])


def test_rules_that_have_no_step_are_refused():
    pole = np.array([4.0 + 0j])
    for ask in (
        lambda: Hold(0.5, "midpoint").weights(pole),
        lambda: Hold(0.5, "midpoint").step_of_matrices(np.array([[4.0]]), np.ones((1, 1))),
    ):
        with pytest.raises(phc.StructureError, match="the midpoint rule has no step for an unstable pole at 2/h = 4"):
            ask()
    for ask in (
        lambda: Hold(0.5, "euler", "foh").weights(pole),
        lambda: Hold(0.5, "euler", "foh").step_of_matrices(np.array([[4.0]]), np.ones((1, 1))),
    ):
        with pytest.raises(phc.StructureError, match="intersample must be 'zoh'; use method='exact' or 'midpoint'"):
            ask()


@pytest.mark.parametrize("method", ["exact", "midpoint", "euler"])
def test_an_undamped_mode_turns_by_the_phase_of_its_frequency(method):
    hold = Hold(0.3, method, "zoh")
    phases = np.array([0.01, 0.7, 1.4])
    _, (turned, _) = hold.log_multiplier(1j * hold.frequency_of(phases))
    np.testing.assert_allclose(turned, phases, rtol=1e-12)
