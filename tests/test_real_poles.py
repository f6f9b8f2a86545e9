"""Plants with real poles: lags, motors, circuits of resistors and capacitors, overdamped and critical masses."""

import control as ct
import numpy as np
import pytest
from scipy.signal import lfilter
from slow import slowly

import ph_control as phc

H, SAMPLES = 0.01, 1200

# poles of the upper half-plane and real ones, with residues
PLANTS = {
    "lag": ([-4.0], [3.0]),
    "motor": ([-1.5, -25.0], [2.0, -2.0]),
    "network of resistors and capacitors": ([-0.8, -5.0, -40.0], [0.5, 2.0, 14.0]),
    "lag beside a mode": ([-0.2 + 14.0j, -1.2], [0.4 - 0.2j, 1.0]),
    "critically damped mass": ([-7.0, -7.0 - 1e-6], [1e6, -1e6]),
    "integrator and lag": ([0.0, -4.0], [1.0, -1.0]),
}


def response(poles, residues, s):
    """Transfer function at points."""
    value = np.zeros(np.shape(s), complex)
    for p, r in zip(poles, residues, strict=True):
        value = value + r / (s - p) + (np.conj(r) / (s - np.conj(p)) if np.imag(p) else 0.0)
    return value


def held(poles, residues, u, h=H):
    """Output of a plant at rest for an input held between samples, step by step."""
    y = np.zeros(len(u))
    for p, r in zip(poles, residues, strict=True):
        x, step = 0.0, np.exp(p * h)
        weight = h if p == 0 else (step - 1) / p
        for k, value in enumerate(u):
            y[k] += (2 if np.imag(p) else 1) * (r * x).real
            x = step * x + weight * value
    return y


def steps(seed, samples=SAMPLES):
    rng = np.random.default_rng(seed)
    return np.repeat(rng.choice([-1.0, 1.0], samples // 12 + 1), 12)[:samples] + 0.3 * rng.standard_normal(samples), rng


def recording(name, seed=3, noise=0.02):
    poles, residues = PLANTS[name]
    u, rng = steps(seed)
    y = held(poles, residues, u)
    return poles, residues, u, y + noise * np.std(y) * rng.standard_normal(len(u))


@pytest.mark.variants
@pytest.mark.parametrize("name", PLANTS)
def test_real_poles_are_estimated_with_errors_that_hold(name):
    poles, residues, u, y = recording(name)
    result = phc.pem((u, y), dt=H)
    real = [p for p in poles if np.imag(p) == 0]
    assert result.states == len(real) + 2 * (len(poles) - len(real)) == len(result.system.poles())
    assert result.outcome.name == "CONSISTENT"
    omega = np.array([0.3, 2.0, 9.0])
    truth = response(poles, residues, 1j * omega)
    assert np.allclose(result.observed_system(1j * omega), truth, rtol=0.03, atol=0.01 * np.abs(truth).max())
    if name != "critically damped mass":  # whose poles go together or apart by chance
        assert result.order == len(poles) - len(real)
        errors = result.stderr["real_poles"]
        assert np.all(np.abs(result.real_poles - np.sort(real)[::-1]) < 4 * errors)
        assert np.allclose(result.time_constants * result.real_poles, -1.0)
        assert np.allclose(result.stderr["time_constants"], errors / result.real_poles**2)


def test_the_number_of_real_poles_may_be_given():
    _, _, u, y = recording("motor")
    known = {"dt": H, "intersample": "zoh", "delay": 0.0}
    (slow,) = phc.pem((u, y), real_poles=1, max_order=1, structure="free", **known).real_poles
    assert -3.0 < slow < -0.3  # the other one is left to coloured noise
    assert phc.pem((u, y), real_poles=2, **known).states == 2
    for wrong in (-1, 1.5, "some"):
        with pytest.raises(phc.StructureError, match="real_poles"):
            phc.pem((u, y), dt=H, real_poles=wrong)


@pytest.mark.slow
def test_real_poles_may_be_given_without_modes():
    _, _, u, y = recording("motor")
    motor = phc.pem((u, y), 0, dt=H, real_poles=2)
    assert (motor.order, len(motor.real_poles)) == (0, 2)
    assert np.allclose(motor.real_poles, phc.pem((u, y), dt=H).real_poles, rtol=1e-3)
    lag = phc.pem((u, y), 0, dt=H, real_poles=1)
    assert (lag.order, len(lag.real_poles)) == (0, 1) and lag.outcome.name != "CONSISTENT"
    for few in ({"real_poles": "auto"}, {"real_poles": 0}):
        with pytest.raises(phc.StructureError, match="order is 0"):
            phc.pem((u, y), 0, dt=H, **few)


@pytest.mark.slow
def test_an_overdamped_mass_is_classical_and_a_network_of_relaxations_passive():
    u, rng = steps(5)
    mass = held([-4.0, -18.0], [1 / 14, -1 / 14], u)
    result = phc.pem((u, mass + 0.02 * np.std(mass) * rng.standard_normal(len(u))), dt=H, quantity="displacement",
                     intersample="zoh")  # fmt: skip
    assert result.structure == "classical" and len(result.real_poles) == 2
    assert isinstance(result.system, phc.PortHamiltonian) and result.system.nstates == 2
    *_, u, y = recording("network of resistors and capacitors")
    network = phc.pem((u, y), dt=H, intersample="zoh")
    assert network.structure == "passive" and isinstance(network.system, phc.PortHamiltonian)
    assert np.all(network.residues.real > 0)


@pytest.mark.slow
def test_outputs_share_a_real_pole():
    u, rng = np.stack([steps(1)[0], steps(2)[0]]), np.random.default_rng(4)
    poles, gains = [-0.3 + 9.0j, -2.0], rng.uniform(0.5, 1.0, (2, 2, 2))
    y = np.array([sum(held(poles, gains[:, o, i], u[i]) for i in range(2)) for o in range(2)])
    y += 0.02 * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape)
    result = phc.pem((u, y), dt=H, quantity="free")
    assert (result.order, len(result.real_poles)) == (1, 1)
    assert abs(result.real_poles[0] + 2.0) < 4 * result.stderr["real_poles"][0]
    found, errors = result.residues[1].real, result.stderr["residues"][1].real
    assert np.all(np.abs(found - gains[1]) < 4.5 * errors)


def test_a_response_shows_real_poles():
    poles, residues = [-3.0, -60.0], [2.0, 30.0]
    omega, rng = np.geomspace(0.2, 500.0, 150), np.random.default_rng(0)
    clean = response(poles, residues, 1j * omega)
    measured = clean + 0.005 * np.abs(clean).max() * (rng.standard_normal((2, 150)) * [[1], [1j]]).sum(axis=0)
    result = phc.pem(ct.frd(measured, omega), weights=np.ones(150))
    assert result.order == 0 and len(result.real_poles) == 2
    assert np.all(np.abs(result.real_poles - poles) < 4 * result.stderr["real_poles"])


@pytest.mark.slow
def test_a_fit_with_real_poles_predicts_and_comes_back_from_a_file(tmp_path):
    poles, residues, u, y = recording("lag beside a mode")
    result = phc.pem((u, y), dt=H)
    fresh, _ = steps(11)
    truth = held(poles, residues, fresh)
    predicted = result.predict(fresh, initial_state="zero").outputs
    assert np.linalg.norm(predicted - truth) < 0.02 * np.linalg.norm(truth)
    assert phc.compare((fresh, truth), result, dt=H).fit_percent[0] > 98
    assert np.allclose(result.predict((u, y), initial_state="fitted").outputs, result.predicted)
    result.save(tmp_path / "fit.json")
    again = phc.load(tmp_path / "fit.json")
    assert np.array_equal(again.poles, result.poles) and str(again) == str(result)
    assert "time constant" in str(result) and "1 mode and 1 real pole" in str(result)
    result.report(tmp_path / "fit.html")
    assert "time constant" in (tmp_path / "fit.html").read_text(encoding="utf-8")


def test_draws_of_a_fit_with_real_poles_have_its_errors():
    *_, u, y = recording("lag beside a mode")
    result = phc.pem((u, y), dt=H, structure="free", noise="white", intersample="zoh")
    draws = result.sample(800, rng=0)
    assert np.allclose(draws.poles[:, 1].imag, 0.0)
    assert abs(np.std(draws.poles[:, 1].real) / result.stderr["real_poles"][0] - 1) < 0.15
    low, high = draws.magnitude_band([0.5])[:, 0]
    assert low < abs(result.observed_system(0.5j)) < high
    assert all(len(one.poles()) == 3 for one in result.sample_systems(3, rng=0))


@pytest.mark.slow
def test_no_lag_is_seen_in_a_plant_without_any():
    rng, t = np.random.default_rng(2), 0.1 * np.arange(1500)
    plant = phc.ph(phc.modes([1.0, 2.5], [0.5, 0.4], damping=[0.01, 0.02]))
    seen = 0
    for _ in range(3):
        u = rng.standard_normal(1500)
        y = phc.forced_response(plant, t, u, intersample="zoh").outputs
        seen += len(phc.pem((u, y + 0.05 * rng.standard_normal(1500)), dt=0.1).real_poles)
    assert seen == 0


@pytest.mark.parametrize("seed", [5, 66])
def test_a_lag_is_not_two_poles_close_to_each_other(seed):
    """Of a record of which the search sees the bins about poles, a lag explains what all bins show."""
    rng = np.random.default_rng([seed, 0])
    u = np.repeat(rng.choice([-1.0, 1.0], 200), 10) + 0.3 * rng.standard_normal(2000)
    y = held([-5.0], [5.0], u, 0.01)
    result = phc.pem((u, y + 0.03 * y.std() * rng.standard_normal(2000)), dt=0.01)
    assert len(result.poles) == 1 and result.structure == "classical"
    assert abs(result.real_poles[0] + 5.0) < 4 * result.stderr["real_poles"][0]


def carts(samples=1000, h=0.1, push=1.0, seed=0):
    """Velocity of two carts on a spring that are pushed: rigid motion and a mode, no losses."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(samples)
    y = held([0.0, 2.0j], [0.3, 0.5], u, h) + push + 0.02 * rng.standard_normal(samples)
    return u, y


def test_a_lag_that_is_over_within_two_samples_is_one_lag():
    u, z = np.repeat((rng := np.random.default_rng(0)).choice([-1.0, 1.0], 100), 3), np.exp(-1 / 0.7)
    y = lfilter([0.0, 1 - z], [1.0, -z], u)
    result = phc.pem((u, y + 0.02 * np.std(y) * rng.standard_normal(300)), dt=1.0, quantity="free")
    assert (result.order, len(result.real_poles), result.delay[0]) == (0, 1, 0.0)
    assert abs(result.time_constants[0] - 0.7) < 3 * result.stderr["time_constants"][0] < 0.1


@pytest.mark.variants
@pytest.mark.parametrize("structure, seed", [("lossless", 1), ("auto", 2), ("auto", 4)])
def test_a_cart_that_rolls_beside_a_mode_is_lossless(structure, seed):
    result = phc.pem(carts(seed=seed, push=0.5 * seed), dt=0.1, structure=structure, noise="white", intersample="zoh")
    assert result.structure == "lossless" and result.outcome.name == "CONSISTENT"
    assert result.poles[1] == 0
    np.testing.assert_allclose(result.poles[0], 2.0j, atol=2e-3)
    np.testing.assert_allclose(result.residues[:, 0, 0], [0.5, 0.3], atol=5e-3)
    # motion of the mode, and of the carts together
    assert [len(state) for state in result.initial_states] == [3]
    np.testing.assert_allclose(result.initial_states[0][2], 0.5 * seed, atol=0.02)
    assert np.isfinite(result.stderr["initial_state"]).all()


@pytest.mark.slow
def test_a_pair_that_turns_real_under_a_structure_leads_to_a_passive_model():
    rng = np.random.default_rng(96)
    t, u = 0.1 * np.arange(80), rng.standard_normal(80)
    sizes, phases = rng.uniform(0.2, 1, 2), rng.uniform(0, 6, 2)
    y = sum(a * np.cos(w * t + b) for a, b, w in zip(sizes, phases, (1.0, 2.7), strict=True))
    result = phc.pem((u, y + 0.05 * rng.standard_normal(80)), dt=0.1, max_order=1, initial_state="zero", offset=False)
    assert result.order <= 1


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("seed", range(2))
def test_inputs_are_held_where_a_mode_beside_lags_says_so(seed):
    """With a residue of any phase no structure stands, and the fits themselves differ by what is fed through."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(2000)
    y = held([-0.8, -9.0, -0.3 + 25.0j], [1.0, -0.7, 0.6j], u)
    result = phc.pem((u, y + 0.03 * np.std(y) * rng.standard_normal(2000)), dt=H)
    assert result.intersample == "zoh" and (result.feedthrough == 0).all()


# --- beside a number of modes that is given --------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize(
    "zeros_and_poles, order, modes, real",
    [
        (([], [-0.35, -1.7]), 1, 0, 2),  # a pair of real poles is a mode
        *slowly((([0.0], [-0.35, -1.7]), 1, 0, 2)),  # an overdamped mass
        (([-1.0, -0.4 + 1j, -0.4 - 1j], [-0.25, -1.6, -0.05 + 2.9j, -0.05 - 2.9j]), 1, 1, 2),
    ],
)
def test_real_poles_are_found_beside_a_number_of_modes(zeros_and_poles, order, modes, real):
    zeros, poles = zeros_and_poles
    plant = ct.zpk(zeros, poles, 1.0)
    rng, t = np.random.default_rng(11), 0.1 * np.arange(1500)
    u = rng.standard_normal(1500)
    y = ct.forced_response(ct.c2d(ct.ss(plant), 0.1), t, u).outputs
    result = phc.pem((u, y + 0.02 * y.std() * rng.standard_normal(1500)), order, dt=0.1)
    assert (result.order, len(result.real_poles)) == (modes, real)
    expected = np.sort([p.real for p in poles if np.imag(p) == 0])
    assert np.all(np.abs(np.sort(result.real_poles) - expected) < 5 * np.sort(result.stderr["real_poles"]).max())
    assert result.outcome.name == "CONSISTENT"


def test_a_pair_without_a_peak_may_be_two_real_poles_under_a_structure():
    rng, t = np.random.default_rng(0), 0.1 * np.arange(2000)
    u = rng.standard_normal(2000)
    plant = ct.tf([1.0, 0.0], np.poly([-0.3, -2.0]))
    y = ct.forced_response(ct.c2d(ct.ss(plant), 0.1), t, u).outputs
    y += 0.03 * y.std() * rng.standard_normal(2000)
    result = phc.pem((u, y), 2, dt=0.1, real_poles=0, noise="white", intersample="zoh")
    assert result.fit_percent > 95


@pytest.mark.slow
def test_a_pair_of_real_poles_does_not_become_more_modes_than_the_largest_order():
    rng = np.random.default_rng(6)
    rng.uniform()
    plant = ct.tf([1.0], [1.0, 1.8, 0.81]) + ct.tf([0.4], [1.0, 0.12, 9.0])  # critically damped, beside a mode
    u = rng.standard_normal(600)
    y = ct.forced_response(ct.c2d(ct.ss(plant), 0.1), 0.1 * np.arange(600), u).outputs
    result = phc.pem((u, y + 0.1 * y.std() * rng.standard_normal(600)), dt=0.1, max_order=1)
    assert result.order == 1 and result.outcome.name == "CONSISTENT"


def test_what_is_fed_through_stands_out_of_its_error():
    rng = np.random.default_rng(1)
    u, noise, z = rng.standard_normal(300), 0.1 * rng.standard_normal(300), np.exp(-0.2)
    y = lfilter([0, 1 - z], [1, -z], u) + noise
    options = {"dt": 0.1, "real_poles": 1, "intersample": "zoh", "quantity": "free", "noise": "white"}
    # true values of 0 and of 5 standard errors, whose estimates are 2 and 7 of them
    assert phc.pem((u, y), 0, **options).feedthrough == 0
    np.testing.assert_allclose(phc.pem((u, y + 0.03 * u), 0, **options).feedthrough, 0.03, atol=0.012)


@pytest.mark.parametrize(("seed", "colour"), [(0, 0.0), (2, 0.9), *slowly((5, 0.5))])
def test_a_lag_of_negative_gain_is_fitted_with_its_sign(seed, colour):
    rng, samples = np.random.default_rng(seed), 400
    u = np.repeat(rng.choice([-1.0, 1.0], samples // 5), 5)
    clean = -lfilter([0, 0.1], [1, -0.9], u)
    noise = lfilter([1], [1, -colour], rng.standard_normal(samples))
    result = phc.pem((u, clean + 0.1 * clean.std() * noise / noise.std()), dt=1.0, intersample="zoh")
    assert result.structure == "free" and result.fit_percent > 85
    np.testing.assert_allclose(ct.dcgain(result.system), -1, rtol=0.05)
