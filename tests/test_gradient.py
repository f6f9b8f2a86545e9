"""The learning scheme of the paper: its model, its gradient, its steps, and what it reports.

The reference is the observable form as a dense recursion, sample by sample; complex parameters give its derivatives
(a step of 1e-30 along the imaginary axis) without cancellation.
"""

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ph_control as phc
from ph_control import gradient_descent, observable_morphism

EPS = float(np.finfo(float).eps)
SETTINGS = settings(deadline=None, max_examples=13, derandomize=True)
KINDS = ("natural", "unique")


# --- an independent model --------------------------------------------------------------------------------------------


def dense_output(d, r, s0, u, h):
    """Euler's rule on the companion matrix, for real or complex parameters."""
    n = len(d)
    square = [np.array([1.0, 0.0, x * x]) for x in d]
    P, N = np.ones(1), np.zeros(2 * n, complex)
    for x in square:
        P = np.convolve(P, x)
    for l in range(n):
        others = np.array([r[l] * d[l], 0.0])
        for j in range(n):
            if j != l:
                others = np.convolve(others, square[j])
        N = N + others
    A = np.diag(np.ones(2 * n - 1, complex), -1)
    A[:, -1] = -P[:0:-1]
    s, y = np.array(s0, complex), []
    for sample in u:
        y.append(s[-1])
        s = s + h * (A @ s + N[::-1] * sample)
    return np.array(y)


def loss_of(theta, n, kind, u, y, h):
    """Mean squared error; missing outputs do not count."""
    d, p, s0 = np.split(theta, [n, 3 * n if kind == "natural" else 2 * n])
    r = p[:n] ** 2 + p[n:] ** 2 if kind == "natural" else p
    error = (dense_output(d, r, s0, u, h) - y)[~np.isnan(y)]
    return error @ error / len(error)


def gradient_of(theta, *case):
    return np.array([loss_of(theta + 1e-30j * e, *case).imag / 1e-30 for e in np.eye(len(theta))])


def case_of(n, kind, seed, samples=60):
    """Parameters of a kind, ascending frequencies, and a record that they do not fit."""
    rng = np.random.default_rng(seed)
    d = np.sort(rng.uniform(0.3, 2.0, n))
    p = rng.standard_normal(2 * n) if kind == "natural" else rng.uniform(0.2, 2.0, n)
    theta = np.concatenate([d, p, rng.standard_normal(2 * n)])
    u, y = rng.standard_normal((2, samples))
    return theta, (n, kind, u, y, 0.1)


def guess_of(theta, n, kind):
    return tuple(np.split(theta, [n, 3 * n if kind == "natural" else 2 * n]))


def found(result):
    """Parameters of a result as one vector."""
    return np.concatenate([result.d, result.v if result.parameters == "natural" else result.r, result.initial_state])


def run(theta, n, kind, u, y, h, **options):
    return gradient_descent((u, y), n, dt=h, parameters=kind, initial_guess=guess_of(theta, n, kind), **options)


cases = st.tuples(st.integers(1, 5), st.sampled_from(KINDS), st.integers(0, 10**6))


# --- the model -------------------------------------------------------------------------------------------------------


@SETTINGS
@given(cases, st.sampled_from(["apart", "equal"]))
def test_the_output_is_that_of_the_observable_form_by_euler_also_where_frequencies_are_equal(case, spectrum):
    theta, (n, kind, u, _, h) = case_of(*case)
    if spectrum == "equal":
        theta[:n] = theta[0]
    d, p, s0 = guess_of(theta, n, kind)
    y = dense_output(d, p[:n] ** 2 + p[n:] ** 2 if kind == "natural" else p, s0, u, h).real
    result = run(theta, n, kind, u, y, h, learning_rate=1e-300, epochs=1)
    # in companion coordinates the recursion adds up terms of the size of the largest coefficient times the state
    size = np.max(np.abs(y)) + (1 + h * 2.0) ** (2 * n) * np.max(np.abs(s0)) * (len(u) * h) ** n
    assert np.sqrt(result.loss_history[0]) <= 100 * EPS * size


@SETTINGS
@given(cases)
def test_the_prediction_is_the_response_of_the_observable_form_and_of_the_system(case):
    theta, (n, kind, u, y, h) = case_of(*case)
    result = run(theta, n, kind, u, y, h, learning_rate=1e-9, epochs=1)
    t = h * np.arange(len(u))
    form, plant = result.observable_form, result.system
    assert isinstance(form, phc.ObservableHamiltonian) and isinstance(plant, phc.PortHamiltonian)
    for state, sys in (("fitted", form), ("zero", form), ("zero", plant)):
        start = result.initial_state if state == "fitted" else 0.0
        truth = phc.forced_response(sys, t, u, start, method="euler", return_states=False).outputs
        predicted = result.predict(u, initial_state=state).outputs
        # the frequencies of the form may be close, which costs its modes digits
        assert np.max(np.abs(predicted - truth)) <= 1e-9 * np.max(np.abs(truth))


def test_a_prediction_from_the_final_state_goes_on_where_the_record_ended():
    theta, (n, kind, u, y, h) = case_of(3, "natural", 1, samples=90)
    result = run(theta, n, kind, u[:60], y[:60], h, learning_rate=1e-6, epochs=3)
    whole = result.predict(u).outputs
    ahead = result.predict(u[60:], initial_state="final")
    np.testing.assert_array_equal(ahead.outputs, whole[60:])
    assert ahead.time[0] == 0.0
    np.testing.assert_array_equal(result.predict(u, initial_state=result.initial_state).outputs, whole)
    assert np.max(np.abs(result.predict(u[60:]).outputs - whole[60:])) > 0.01


# --- the gradient ----------------------------------------------------------------------------------------------------


@SETTINGS
@given(cases, st.booleans())
def test_a_plain_step_goes_along_the_gradient_of_the_mean_squared_error(case, gaps):
    theta, problem = case_of(*case)
    if gaps:
        problem[3][::7] = np.nan
    gradient = gradient_of(theta, *problem)
    rate = 1e-7 / np.linalg.norm(gradient)
    result = run(theta, *problem, learning_rate=rate, epochs=1)
    assert result.best_epoch == 1
    assert result.loss_history[0] == pytest.approx(loss_of(theta, *problem).real, rel=1e-11)
    moved = (theta - found(result)) / rate
    rounding = 4 * EPS * np.max(np.abs(theta)) / rate
    assert np.max(np.abs(moved - gradient)) <= rounding + 1e-9 * np.linalg.norm(gradient)


def test_the_first_step_of_adam_has_the_length_of_the_rate_in_every_parameter():
    theta, problem = case_of(2, "unique", 3)
    gradient = gradient_of(theta, *problem)
    result = run(theta, *problem, optimizer="adam", learning_rate=1e-4, epochs=1)
    # the gradient is larger than the floor of 1e-8 in the denominator by far
    np.testing.assert_allclose(theta - found(result), 1e-4 * np.sign(gradient), rtol=1e-6)


def test_adam_takes_the_steps_that_its_authors_define():
    theta, problem = case_of(2, "natural", 5)
    expected, first, second = theta.copy(), 0.0, 0.0
    for k in range(1, 6):
        gradient = gradient_of(expected, *problem)
        first, second = 0.9 * first + 0.1 * gradient, 0.999 * second + 0.001 * gradient**2
        expected = expected - 0.001 * (first / (1 - 0.9**k)) / (np.sqrt(second / (1 - 0.999**k)) + 1e-8)
    result = run(theta, *problem, optimizer="adam", learning_rate=0.001, epochs=5)
    assert result.best_epoch == 5
    np.testing.assert_allclose(found(result), expected, rtol=1e-11)


# --- the descent -----------------------------------------------------------------------------------------------------


def one_mode():
    u = np.random.default_rng(0).standard_normal(100)
    return u, dense_output([1.0], [0.5], [0.3, -0.2], u, 0.1).real


NEAR = {"natural": ([1.1], [0.5, 0.3], [0.1, 0.0]), "unique": ([1.1], [0.3], [0.1, 0.0])}


@pytest.mark.parametrize("kind", KINDS)
def test_one_mode_is_recovered_from_a_near_start_and_the_loss_never_grows(kind):
    result = gradient_descent(
        one_mode(), 1, dt=0.1, parameters=kind, learning_rate=0.2, epochs=1000, initial_guess=NEAR[kind]
    )
    assert result.loss < 1e-22 and not result.diverged
    np.testing.assert_allclose(np.r_[result.d, result.r, result.initial_state], [1.0, 0.5, 0.3, -0.2], atol=1e-9)
    assert result.system.d == pytest.approx([1.0], abs=1e-9) and result.system.r == pytest.approx([0.5], abs=1e-9)
    assert np.all(np.diff(result.loss_history) <= EPS * result.loss_history[0])
    assert len(result.loss_history) == 1001 and result.validation_history is None


@pytest.mark.parametrize("kind", KINDS)
def test_plain_steps_converge_below_the_stable_rate_and_leave_the_minimum_above_it(kind):
    u, y = one_mode()
    p = [np.sqrt(0.5), 0.0] if kind == "natural" else [0.5]
    at_minimum = ([1.0], p, [0.3, -0.2])
    limit = gradient_descent((u, y), 1, dt=0.1, parameters=kind, initial_guess=at_minimum, epochs=1).stable_rate
    near = ([1.0 + 1e-5], p, [0.3, -0.2])
    slow, fast = (
        gradient_descent(
            (u, y), 1, dt=0.1, parameters=kind, initial_guess=near, learning_rate=factor * limit, epochs=60
        )
        for factor in (0.9, 1.1)
    )
    assert slow.loss_history[-1] < slow.loss_history[0] < fast.loss_history[-1]


def chain_record():
    """The second recording of the paper, and the parameters that made it."""
    plant = phc.frenkel_kontorova(2)
    t = 0.01 * np.arange(2000)
    u, z0 = np.sin(t), [2.0, 1.0, -3.0, -3.0]
    y = phc.forced_response(plant, t, u, z0, method="euler").outputs
    return u, y, (plant.d, plant.r, observable_morphism(plant) @ z0)


def test_the_rate_of_the_paper_is_not_stable_at_the_true_parameters_of_its_chain():
    u, y, truth = chain_record()
    result = gradient_descent(
        (u[:1000], y[:1000]), 2, dt=0.01, parameters="unique", initial_guess=truth, learning_rate=1e-9, epochs=1,
        validation=(u[1000:], y[1000:]),
    )  # fmt: skip
    assert result.loss_history[0] < 1e-26 and result.validation_history[0] < 1e-26
    assert result.stable_rate == pytest.approx(0.0067, rel=0.01)
    assert result.stable_rate < 0.02


def test_a_descent_that_diverges_stops_says_so_and_keeps_the_best_parameters():
    result = gradient_descent(one_mode(), 1, dt=0.1, learning_rate=10.0, initial_guess=NEAR["natural"])
    assert result.diverged and len(result.loss_history) < 501
    assert "diverged" in result.message and "stable for learning rates below" in result.message
    assert np.isfinite(result.loss_history).all() and result.loss == result.loss_history.min()
    assert np.isfinite(result.predict(np.ones(50)).outputs).all()


def test_what_is_kept_are_the_parameters_of_the_smallest_loss():
    u, y = one_mode()
    options = {"dt": 0.1, "parameters": "unique", "learning_rate": 0.8, "initial_guess": NEAR["unique"]}
    result = gradient_descent((u, y), 1, epochs=300, **options)
    assert result.loss < 0.5 * result.loss_history[-1]
    assert f"after step {result.best_epoch} are kept" in result.message
    same = gradient_descent((u, y), 1, epochs=result.best_epoch, **options)
    np.testing.assert_array_equal(found(result), found(same))
    error = result.predict(u).outputs - y
    assert np.mean(error**2) == pytest.approx(result.loss, rel=1e-12)
    assert "are kept" not in same.message


def test_plain_descent_in_v_only_scales_the_pair_of_each_mode():
    theta, problem = case_of(3, "natural", 8)
    result = run(theta, *problem, learning_rate=1e-3, epochs=50)
    before, after = theta[3:9].reshape(2, 3), result.v.reshape(2, 3)
    np.testing.assert_allclose(after[0] * before[1], after[1] * before[0], rtol=1e-12)
    assert np.max(np.abs(after - before)) > 1e-3


@pytest.mark.parametrize("kind, kept", [("unique", True), ("natural", False)])
def test_a_weight_that_would_become_negative_is_held_at_0(kind, kept):
    """The sensor has the wrong polarity: the best weight is negative, which no port-Hamiltonian system has."""
    u, y = one_mode()
    result = gradient_descent((u, -y), 1, dt=0.1, parameters=kind, learning_rate=0.2, initial_guess=NEAR[kind])
    assert (result.r[0] == 0.0) == kept and result.r[0] < 1e-6
    assert ("ended with r at 0" in result.message) == kept


@pytest.mark.parametrize("d, held", [(0.05, True), (0.5, False)])
def test_a_frequency_that_would_become_negative_is_held_above_0(d, held):
    """A constant output asks for a mode at 0: the step of 0.1 takes the slower frequency there and beyond."""
    result = gradient_descent(
        (np.zeros(20), np.ones(20)), 1, dt=0.1, optimizer="adam", learning_rate=0.1, epochs=1,
        initial_guess=([d], [0.1, 0.1], [0.0, 0.5]),
    )  # fmt: skip
    lowest = 1e-3 / (20 * 0.1)
    assert result.best_epoch == 1
    assert result.d[0] == pytest.approx(lowest if held else d - 0.1, rel=1e-6)
    assert result.system.d[0] == result.d[0]
    assert ("ended with d at its lower bound" in result.message) == held


def test_unique_parameters_come_back_with_ascending_frequencies():
    theta, (_, kind, u, y, h) = case_of(3, "unique", 2)
    swapped = theta[[2, 0, 1, 5, 3, 4, *range(6, 12)]]
    one, other = (run(x, 3, kind, u, y, h, learning_rate=1e-4, epochs=5) for x in (theta, swapped))
    assert np.all(np.diff(other.d) > 0)
    np.testing.assert_allclose(found(other), found(one), rtol=1e-12)
    np.testing.assert_array_equal(one.v, np.r_[np.sqrt(one.r), 0, 0, 0])


def test_the_validation_error_is_that_of_the_prediction_that_goes_on():
    theta, (n, kind, u, y, h) = case_of(2, "unique", 4, samples=100)
    y[70] = np.nan
    result = run(theta, n, kind, u[:60], y[:60], h, learning_rate=1e-5, epochs=4, validation=(u[60:], y[60:]))
    error = result.predict(u[60:], initial_state="final").outputs - y[60:]
    assert len(result.validation_history) == 5 and result.best_epoch == 4
    assert result.validation_history[-1] == pytest.approx(np.nanmean(error**2), rel=1e-12)
    alone = run(theta, n, kind, u[:60], y[:60], h, learning_rate=1e-5, epochs=4)
    np.testing.assert_allclose(found(result), found(alone), rtol=1e-12)


# --- starts and data -------------------------------------------------------------------------------------------------


def test_a_random_start_depends_on_the_seed_alone_and_scales_with_the_units():
    u, y = one_mode()
    options = {"epochs": 1, "learning_rate": 1e-200}
    one, again = (gradient_descent((u, y), 2, dt=0.1, rng=rng, **options) for rng in (7, np.random.default_rng(7)))
    np.testing.assert_array_equal(found(one), found(again))
    other = gradient_descent((u, y), 2, dt=0.1, rng=8, **options)
    assert not np.array_equal(one.d, other.d)
    scaled = gradient_descent((u, 1e3 * y), 2, dt=0.001, rng=7, **options)
    np.testing.assert_allclose(scaled.d, 100 * one.d, rtol=1e-12)
    np.testing.assert_allclose(scaled.r, 1e3 * one.r, rtol=1e-12)
    # a state s_k of the observable form has the unit of the output over time to the power 2n - k
    np.testing.assert_allclose(
        scaled.initial_state, 1e3 * one.initial_state * 100.0 ** np.arange(3, -1, -1), rtol=1e-12
    )
    assert scaled.loss == pytest.approx(1e6 * one.loss, rel=1e-9)
    assert len(set(np.r_[gradient_descent((u, y), 2, dt=0.1, **options).d, one.d])) == 4


def test_a_record_of_python_control_will_do_and_nothing_given_is_changed():
    u, y = one_mode()
    guess = tuple(np.array(part) for part in NEAR["unique"])
    copies = [array.copy() for array in (u, y, *guess)]
    response = ct.TimeResponseData(0.1 * np.arange(100), y, inputs=u, issiso=True, output_labels=["speed"])
    options = {"parameters": "unique", "learning_rate": 0.02, "epochs": 20, "initial_guess": guess}
    one, other = gradient_descent(response, 1, **options), gradient_descent((u, y), 1, dt=0.1, **options)
    np.testing.assert_allclose(found(one), found(other), rtol=1e-12)
    assert one.predict(u).output_labels == ["speed"]
    for array, copy in zip((u, y, *guess), copies, strict=True):
        np.testing.assert_array_equal(array, copy)
    with pytest.raises(ValueError, match="read-only"):
        one.d[0] = 2.0


U, Y = one_mode()
BAD = [
    ({"order": 0}, "order is 0; it must be a whole number of at least 1"),
    ({"order": "auto"}, "order is 'auto'; it must be a whole number"),
    ({"order": True}, "order is True"),
    ({"parameters": "best"}, "parameters is 'best'; it must be one of 'natural', 'unique'"),
    ({"optimizer": "newton"}, "optimizer is 'newton'; it must be one of 'plain', 'adam'"),
    ({"learning_rate": 0.0}, "learning_rate is 0.0; it must be a positive number"),
    ({"learning_rate": np.inf}, "learning_rate is inf"),
    ({"learning_rate": np.nan}, "learning_rate is nan"),
    ({"learning_rate": "fast"}, "learning_rate is 'fast'"),
    ({"epochs": 0}, "epochs is 0; it must be a whole number from 1 to"),
    ({"epochs": 2.5}, "epochs is 2.5"),
    ({"dt": None}, "dt is missing"),
    ({"data": 3}, "pass a control.TimeResponseData"),
    ({"rng": "dice"}, "rng is 'dice'"),
    ({"rng": -1}, "rng is -1"),
    ({"initial_guess": ([1.0], [1.0, 0.0])}, "not a triple"),
    ({"initial_guess": "abc"}, "not a triple"),
    ({"initial_guess": 1.0}, "not a triple"),
    ({"initial_guess": ([1.0, 2.0], [1.0, 0.0], [0.0, 0.0])}, r"d of the initial guess has shape \(2,\)"),
    ({"initial_guess": ([-1.0], [1.0, 0.0], [0.0, 0.0])}, "d is not positive"),
    ({"initial_guess": ([1.0], [1.0], [0.0, 0.0])}, r"v of the initial guess has shape \(1,\)"),
    ({"initial_guess": ([1.0], [1.0, 0.0], [0.0])}, r"s0 of the initial guess has shape \(1,\)"),
    ({"initial_guess": ([1.0], [-1.0], [0.0, 0.0]), "parameters": "unique"}, "r is negative"),
    ({"initial_guess": ([1e200], [1.0, 0.0], [0.0, 0.0])}, "loss of the initial guess exceeds the range of doubles"),
    ({"validation": (U, np.full(100, np.nan))}, "the validation record has no outputs"),
    ({"validation": (U, Y[:5])}, "the same length"),
]


@pytest.mark.parametrize("change, message", BAD)
def test_bad_input_is_refused_with_what_was_found_and_what_is_allowed(change, message):
    arguments = {"data": (U, Y), "order": 1, "dt": 0.1, "epochs": 3} | change
    with pytest.raises(phc.StructureError, match=message):
        gradient_descent(arguments.pop("data"), arguments.pop("order"), **arguments)


def test_a_record_must_have_more_samples_than_the_order_has_unknowns():
    options = {"dt": 0.1, "epochs": 1, "learning_rate": 1e-9, "rng": 0}
    assert len(gradient_descent((U[:9], Y[:9]), 2, **options).d) == 2
    with pytest.raises(phc.IdentificationError, match=r"order 2 has 8 unknowns, .* 8 observed .* is 1"):
        gradient_descent((U[:8], Y[:8]), 2, **options)
    with pytest.raises(phc.IdentificationError, match="output is zero"):
        gradient_descent((U, 0 * Y), 1, **options)


@pytest.mark.parametrize("state", ["estimate", np.zeros(3), [np.nan, 0.0]])
def test_a_prediction_refuses_states_that_the_form_does_not_have(state):
    result = gradient_descent((U, Y), 1, dt=0.1, epochs=1, rng=0, learning_rate=1e-9)
    with pytest.raises(phc.StructureError, match="initial_state"):
        result.predict(U, initial_state=state)
