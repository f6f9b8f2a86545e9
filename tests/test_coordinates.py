"""States in the coordinates of the forms: each form, built densely, runs from its state along the prediction."""

import warnings

import control as ct
import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import EPS

import ph_control as phc
from ph_control.identification.uncertainty.state_coordinates import controllable_state, observable_state

STEP = 0.1
QUANTITIES = ("velocity", "displacement", "acceleration")
relaxed = settings(deadline=None, max_examples=13, derandomize=True)


def dense(form, d, v):
    """`(A, B, C)` of a form in mpmath, from frequencies and `v` as they are in doubles."""
    n = len(d)
    d, v = [mp.mpf(float(x)) for x in d], [mp.mpf(float(x)) for x in v]
    if form == "ph":
        A, B, C = mp.zeros(2 * n), mp.matrix(v), mp.matrix(1, 2 * n)
        for l in range(n):
            A[l, n + l], A[n + l, l] = d[l], -d[l]
            C[l], C[n + l] = v[l] * d[l], v[n + l] * d[l]
        return A, B, C
    P, N = [mp.mpf(1)], [mp.mpf(0)]
    for l in range(n):
        kappa = (v[l] ** 2 + v[n + l] ** 2) * d[l]
        N = plus(times(N, [d[l] ** 2, 0, 1]), times(P, [0, kappa]))
        P = times(P, [d[l] ** 2, 0, 1])
    A = mp.zeros(2 * n)
    for k in range(2 * n):
        A[2 * n - 1, k] = -P[k]
        if k + 1 < 2 * n:
            A[k, k + 1] = 1
    unit, row = mp.zeros(2 * n, 1), mp.matrix(1, 2 * n)
    unit[2 * n - 1] = 1
    for k in range(2 * n):
        row[k] = N[k]
    return (A, unit, row) if form == "ch" else (A.T, row.T, unit.T)


def times(a, b):
    found = [mp.mpf(0)] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for j, y in enumerate(b):
            found[i + j] += x * y
    return found


def plus(a, b):
    size = max(len(a), len(b))
    return [(a[k] if k < len(a) else 0) + (b[k] if k < len(b) else 0) for k in range(size)]


def outputs(form, system, state, u, quantity="velocity", outside=0.0):
    """What a form shows from a state, its input held between samples, beside what modes `outside` feed through."""
    with mp.workdps(60):
        A, B, C = dense(form, system.d, system.v)
        size = A.rows
        whole = mp.zeros(size + 1)
        whole[:size, :size], whole[:size, size] = A, B
        step = mp.expm(STEP * whole)
        through = mp.mpf(float(outside))
        if quantity == "acceleration":
            C, through = C * A, through + (C * B)[0]
        elif quantity == "displacement":
            C = mp.lu_solve(A.T, C.T).T
        z, found = mp.matrix([float(x) for x in state]), []
        for value in u:
            found.append(float((C * z)[0] + through * float(value)))
            z = step[:size, :size] * z + step[:size, size] * float(value)
        return np.array(found)


def recording(n, quantity, samples=600, seed=0, noise=0.0):
    """A record of n modes that starts in motion, whatever is measured of it."""
    rng = np.random.default_rng(seed + n)
    d = np.arange(1, n + 1) + rng.uniform(-0.2, 0.2, n)
    plant = phc.ph(phc.modes(d, rng.uniform(0.3, 1.5, n)))
    u, state = rng.standard_normal(samples), rng.standard_normal(2 * n)
    x = phc.forced_response(plant, STEP * np.arange(samples), u, state, intersample="zoh").x
    if quantity == "displacement":
        y = np.linalg.solve(plant.A.T, plant.C[0]) @ x
    elif quantity == "acceleration":
        y = plant.C[0] @ plant.A @ x + (plant.C @ plant.B)[0, 0] * u
    else:
        y = plant.C[0] @ x
    return u, y + noise * rng.standard_normal(samples)


def sensor_away(samples=400):
    """A record whose second mode answers with the wrong sign, and moves."""
    rng = np.random.default_rng(4)
    u, t = rng.standard_normal(samples), STEP * np.arange(samples)
    first, second = (
        phc.forced_response(phc.ph(phc.modes(d, r)), t, u, [0.5, 0.2], intersample="zoh").outputs
        for d, r in ((1.0, 1.0), (2.3, 0.4))
    )
    return u, first - second + 2 * np.cos(2.3 * t) + 0.1 * rng.standard_normal(samples)


# --- the three forms show the same ------------------------------------------------------------------------------------


@pytest.mark.variants
@pytest.mark.parametrize("n", [1, 2, 3, 5, 8])
def test_every_form_runs_along_the_prediction_from_its_state(n):
    for quantity in QUANTITIES if n <= 3 else QUANTITIES[n % 3 :][:1]:
        u, y = recording(n, quantity, noise=0.01)
        result = phc.pem((u, y), n, dt=STEP, quantity=quantity, delay=0.0, noise="white")
        shown = 60 if n < 6 else 30
        size = np.abs(result.predicted).max()
        # what an accelerometer feels of modes above those of the model is an unknown of its own
        outside = result.feedthrough[0, 0] - result.kappa.sum() * (quantity == "acceleration")
        error = np.nan_to_num(result.stderr["feedthrough"][0, 0]) + np.linalg.norm(result.stderr["kappa"])
        assert abs(outside) < 4 * error
        for form in ("ph", "ch", "oh"):
            found = outputs(form, result.system, result.initial_state_in(form), u[:shown], quantity, outside)
            # a state in a companion form loses these digits, and one more for the sum over the modes
            lost = 10.0 ** -(phc.oh(result.system).digits - 2) if form != "ph" else 100 * n * EPS
            assert np.abs(found - result.predicted[:shown]).max() < lost * size, (form, quantity)
        assert np.array_equal(result.initial_state_in("ph"), result.initial_state)


def test_the_state_does_not_depend_on_what_is_measured():
    states = {}
    for quantity in QUANTITIES:
        result = phc.pem(recording(2, quantity), 2, dt=STEP, quantity=quantity)
        for form in ("ph", "ch", "oh"):
            states.setdefault(form, []).append(result.initial_state_in(form))
    for found in states.values():
        for other in found[1:]:
            assert np.allclose(other, found[0], rtol=1e-9, atol=1e-9)


@pytest.mark.variants
@pytest.mark.parametrize("method, intersample", [("midpoint", "zoh"), ("euler", "zoh"), ("exact", "foh")])
def test_forms_start_from_their_state_under_every_discretisation(method, intersample):
    rng = np.random.default_rng(1)
    plant, t, u = phc.ph(phc.modes([1.0, 2.3], [1.0, 0.4])), 0.02 * np.arange(400), rng.standard_normal(400)
    y = phc.forced_response(plant, t, u, [1.0, 0.0, 0.5, -1.0], method=method, intersample=intersample).outputs
    result = phc.pem((u, y), 2, dt=0.02, method=method, intersample=intersample)
    for form in (phc.ch, phc.oh):
        state = result.initial_state_in(form.__name__)
        again = phc.forced_response(form(result.system), t, u, state, method=method, intersample=intersample)
        assert np.allclose(again.outputs, result.predicted, rtol=0, atol=1e-10 * np.abs(y).max())


def test_each_experiment_has_a_state_of_its_own():
    data = [recording(2, "velocity", 300), recording(2, "velocity", 200)]
    result = phc.pem(data, 2, dt=STEP)
    for k, one in enumerate(result.experiments):
        for form in ("ch", "oh"):
            found = outputs(form, result.system, result.initial_state_in(form, k), one.record.u[:40])
            assert np.allclose(found, one.predicted[:40], rtol=0, atol=1e-10)
    assert not np.allclose(result.initial_state_in("oh", 0), result.initial_state_in("oh", 1))


# --- the maps are the morphisms of the paper --------------------------------------------------------------------------


@relaxed
@given(st.integers(0, 6), st.integers(0, 2**32 - 1), st.floats(1e-3, 1e3))
def test_the_states_are_linked_by_the_morphisms(n, seed, unit):
    rng = np.random.default_rng(seed)
    d = unit * (np.arange(1, n + 1) + rng.uniform(-0.3, 0.3, n))
    r = rng.uniform(0.2, 2.0, n)
    system = phc.ph(phc.modes(d, r)) if n else None
    amplitudes = rng.standard_normal(n) + 1j * rng.standard_normal(n)
    x = amplitudes / (d * np.sqrt(r))
    z = np.concatenate([x.real, x.imag])
    observable, kept = observable_state(d, amplitudes)
    controllable, also = controllable_state(d, r, amplitudes)
    if not n:
        assert observable.shape == controllable.shape == (0,)
        return
    assert 8 < kept < 16 and 8 < also < 16
    expected = phc.observable_morphism(system) @ z
    size = np.abs(phc.observable_morphism(system)) @ np.abs(z)
    assert np.all(np.abs(observable - expected) <= 20 * n * EPS * size)
    L = phc.controllable_morphism(d, np.concatenate([np.sqrt(r), np.zeros(n)]))
    assert np.all(np.abs(L @ controllable - z) <= 20 * n * EPS * (np.abs(L) @ np.abs(controllable)))


@pytest.mark.parametrize("n", [2, 6, 10, 14])
def test_the_digits_are_those_that_are_left_after_rounding(n):
    """Run back, in many digits, from the rounded state to the amplitudes: the loss is near the promise, not beyond."""
    rng = np.random.default_rng(n)
    d, r = np.arange(1, n + 1) + rng.uniform(-0.2, 0.2, n), np.ones(n)
    amplitudes = rng.standard_normal(n) + 1j * rng.standard_normal(n)
    with mp.workdps(60):
        for state, digits, back in (
            (*observable_state(d, amplitudes), from_observable),
            (*controllable_state(d, r, amplitudes), from_controllable),
        ):  # fmt: skip
            found = np.array([complex(a) for a in back(state, d)])
            error = np.abs(found - amplitudes).max() / np.abs(amplitudes).max()
            assert error < 10 * n * 10.0**-digits
            assert error > 1e-3 * 10.0**-digits


def polynomial_without(d, l):
    found = [mp.mpf(1)]
    for j, other in enumerate(d):
        if j != l:
            found = times(found, [mp.mpf(float(other)) ** 2, 0, 1])
    return found


def from_observable(state, d):
    for l, frequency in enumerate(d):
        pole = mp.mpc(0, -float(frequency))
        value = sum(mp.mpf(float(s)) * pole**k for k, s in enumerate(state))
        slope = 2 * pole * sum(c * pole**k for k, c in enumerate(polynomial_without(d, l)))
        yield 2 * value / slope


def from_controllable(state, d):
    """With `r = 1`: `a = d w`, `w` the state as a functional on `P(s)/(s + i d)`."""
    for l, frequency in enumerate(d):
        row = times(polynomial_without(d, l), [mp.mpc(0, -float(frequency)), 1])
        yield float(frequency) * sum(c * mp.mpf(float(s)) for c, s in zip(row, state, strict=True))


# --- modes without weight ---------------------------------------------------------------------------------------------


def test_the_observable_form_shows_the_free_motion_of_a_mode_without_weight():
    u, y = sensor_away()
    result = phc.pem((u, y), 2, dt=STEP, intersample="zoh", structure="lossless")
    assert (result.r > 0).tolist() == [True, False] and abs(result.free_amplitudes[1]) > 1
    found = outputs("oh", result.system, result.initial_state_in("oh"), u[:80])
    assert np.allclose(found, result.predicted[:80], rtol=0, atol=1e-11)
    # no state of the system itself shows it
    held = outputs("ph", result.system, result.initial_state_in("ph"), u[:80])
    assert np.abs(held - result.predicted[:80]).max() > 1
    with pytest.raises(phc.StructureError, match=r"mode 2 moves freely, by 1 of the largest mode.*form='oh'"):
        result.initial_state_in("ch")


def test_with_the_controllable_representation_all_forms_have_the_state():
    u, y = sensor_away()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", phc.IdentifiabilityWarning)
        result = phc.pem((u, y), 2, dt=STEP, representation="controllable", intersample="zoh", structure="lossless")
    assert result.order == 1 and result.r[0] > 0
    for form in ("ph", "ch", "oh"):
        found = outputs(form, result.system, result.initial_state_in(form), u[:80])
        assert np.allclose(found, result.predicted[:80], rtol=0, atol=1e-11)


def test_a_free_motion_has_a_state_of_the_observed_system_alone():
    t = STEP * np.arange(300)
    y = phc.initial_response(phc.ph(phc.modes([1.0, 2.3], [1.0, 0.4])), t, [1.0, 2.0, 0.0, 1.0]).outputs
    result = phc.pem((None, y), 2, dt=STEP)
    again = ct.initial_response(result.observed_system, t, result.initial_state).outputs
    assert np.allclose(again, y, rtol=0, atol=1e-10)
    for form in ("ph", "ch", "oh"):
        with pytest.raises(phc.StructureError, match="driven lossless models"):
            result.initial_state_in(form)


def test_modes_that_the_record_does_not_show_are_at_rest():
    u, y = recording(1, "velocity")
    result = phc.pem((u, y), 3, dt=STEP)
    for form in ("ch", "oh"):
        found = outputs(form, result.system, result.initial_state_in(form), u[:60])
        assert np.allclose(found, result.predicted[:60], rtol=0, atol=1e-10)


def test_a_plant_at_rest_is_at_rest_in_every_form():
    rng = np.random.default_rng(0)
    u = rng.standard_normal(300)
    y = phc.forced_response(
        phc.ph(phc.modes([1.0, 2.3], [1.0, 0.4])), STEP * np.arange(300), u, intersample="zoh"
    ).outputs
    result = phc.pem((u, y), 2, dt=STEP, initial_state="zero")
    for form in ("ph", "ch", "oh"):
        assert not result.initial_state_in(form).any()


# --- what is refused, and told ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def one_mode():
    return phc.pem(recording(1, "velocity", 100), 1, dt=STEP)


@pytest.mark.parametrize("form", ["PH", "observable", None, 1])
def test_a_form_is_named_ph_ch_or_oh(form, one_mode):
    with pytest.raises(phc.StructureError, match=r"form is .* 'ph', 'ch', 'oh'"):
        one_mode.initial_state_in(form)


@pytest.mark.parametrize("experiment", [1, -1, 0.0, True, None])
def test_an_experiment_that_is_not_there_is_refused(experiment, one_mode):
    with pytest.raises(phc.StructureError, match=r"experiment is .* counted from 0 to 0"):
        one_mode.initial_state_in("oh", experiment)


def test_a_frequency_response_has_no_initial_state():
    omega = np.linspace(0.31, 3.0, 40)
    values = phc.modes(1.0, 1.0).freqresp(omega) + 0.01j * np.random.default_rng(0).standard_normal(40)
    result = phc.pem(ct.frd(values, omega, smooth=False), 1)
    with pytest.raises(phc.StructureError, match="a frequency response has no initial state"):
        result.initial_state_in("oh")


@pytest.mark.variants
@pytest.mark.parametrize("form", ["ch", "oh"])
def test_a_state_that_carries_few_digits_is_said_to_do_so(form):
    """Twelve modes within an octave: companion matrices have lost the frequencies."""
    rng = np.random.default_rng(0)
    d = np.linspace(1.0, 1.6, 12)
    u = rng.standard_normal(3000)
    y = phc.forced_response(
        phc.ph(phc.modes(d, np.ones(12))), 0.5 * np.arange(3000), u, np.ones(24), intersample="zoh"
    ).outputs
    result = phc.pem((u, y), 12, dt=0.5, initial_guess=(d, np.ones(12)))
    with pytest.warns(phc.ConditioningWarning, match=r"carries [0-5]\.\d decimal digits of the free motion"):
        result.initial_state_in(form)
    result.initial_state_in("ph")


def test_states_beyond_the_range_of_doubles_are_refused():
    d, amplitudes = 1e60 * np.arange(1.0, 5.0), np.ones(4, complex)
    for made in (lambda: observable_state(d, amplitudes), lambda: controllable_state(1 / d, np.ones(4), amplitudes)):
        with pytest.raises(phc.StructureError, match="leave the range of doubles"):
            made()


def test_the_state_is_a_copy(one_mode):
    before = one_mode.initial_state.copy()
    for form in ("ph", "ch", "oh"):
        one_mode.initial_state_in(form)[:] = 7.0
    assert np.array_equal(one_mode.initial_state, before)
