"""Modes through time, against dense matrices, mpmath and a recursion in long doubles."""

from contextlib import contextmanager
from itertools import product

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import EPS, dense_step, long_double_recursion
from slow import slowly

import ph_control as phc
from ph_control import ModalForm
from ph_control.modal import propagation
from ph_control.modal.discretization import Hold
from ph_control.modal.propagation import discretize, simulate

relaxed = settings(deadline=None, max_examples=15, derandomize=True)
seeds = st.integers(0, 2**32 - 1)

RULES = [("exact", "zoh"), ("exact", "foh"), ("midpoint", "zoh"), ("midpoint", "foh"), ("euler", "zoh")]


@contextmanager
def folded_from(modes):
    """Fold blocks around their middle from so many modes on: both ways must give the same."""
    kept = propagation._FOLD
    propagation._FOLD = modes
    try:
        yield
    finally:
        propagation._FOLD = kept


def random_modes(n, rigid, ports, rng):
    nu = rng.standard_normal((n, ports)) + 1j * rng.standard_normal((n, ports))
    return ModalForm(np.sort(rng.uniform(0.1, 3, n)), nu, rng.standard_normal((rigid, ports)))


def dense_modes(modes):
    """Real block-diagonal `(A, B, C)` of `x' = -i d x + nu u`, `y = Re(d conj(nu) x)`, real parts first."""
    d = np.r_[modes.d, np.zeros(len(modes.rigid))]
    n, zero = len(d), np.zeros((len(d), len(d)))
    A = np.block([[zero, np.diag(d)], [-np.diag(d), zero]])
    nu = np.concatenate([modes.nu, modes.rigid])
    weight = np.r_[modes.d, np.ones(len(modes.rigid))][:, None] * nu
    C = np.concatenate([weight.real, weight.imag]).T
    assert A.shape == (2 * n, 2 * n)
    return A, np.concatenate([nu.real, nu.imag]), C


def real(x):
    return np.concatenate([x.real, x.imag])


def plain_recursion(step, u, x0):
    """`x_{k+1} = lambda x_k + b0 u_k + b1 u_{k+1}`, sample by sample."""
    x = np.empty((len(x0), u.shape[1]), complex)
    x[:, 0] = x0
    for k in range(u.shape[1] - 1):
        x[:, k + 1] = step.multiplier * x[:, k] + step.b0 @ u[:, k] + step.b1 @ u[:, k + 1]
    return (step.c @ x).real, x


def fine_recursion(step, u, x0):
    """The same in long doubles, with both digits of the phase; also the largest sum of what the modes contribute."""
    phase = step.phase[0].astype(np.longdouble) + step.phase[1]
    lam = np.exp(step.growth.astype(np.longdouble)) * (np.cos(phase) + 1j * np.sin(phase))
    b0, b1, c = (M.astype(np.clongdouble) for M in (step.b0, step.b1, step.c))
    x = x0.astype(np.clongdouble)
    y, states, size = np.empty(u.shape), np.empty((len(x0), u.shape[1]), complex), 0.0
    for k in range(u.shape[1]):
        y[:, k], states[:, k] = (c @ x).real, x
        size = max(size, float(np.max(np.abs(c) @ np.abs(x))))
        x = lam * x + b0 @ u[:, k] + b1 @ u[:, min(k + 1, u.shape[1] - 1)]
    return y, states, size


# --- one step ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("method", "intersample"), RULES)
@pytest.mark.parametrize("h", [1e-6, 1e-2, 0.7, 5.0])
def test_one_step_is_that_of_the_dense_system(method, intersample, h):
    modes = random_modes(5, 2, 2, np.random.default_rng(0))
    A, B, C = dense_modes(modes)
    F, G0, G1 = dense_step(A, B, h, method, intersample)
    step = discretize(modes, Hold(h, method, intersample))
    allowed = 100 * EPS * max(1.0, np.linalg.norm(F, 2))
    lam = step.multiplier
    assert (
        np.max(np.abs(np.block([[np.diag(lam.real), -np.diag(lam.imag)], [np.diag(lam.imag), np.diag(lam.real)]]) - F))
        < allowed
    )
    assert np.max(np.abs(real(step.b0) - G0)) < allowed * h * np.linalg.norm(B)
    assert np.max(np.abs(real(step.b1) - G1)) < allowed * h * np.linalg.norm(B)
    assert np.array_equal(np.concatenate([step.c.real, -step.c.imag], axis=1), C)


def test_euler_grows_midpoint_and_exact_do_not():
    d, h = np.array([1e-6, 0.3, 1.0, 2.5]), 0.5
    modes = phc.modes(d, np.ones(4))
    growth = np.abs(discretize(modes, Hold(h, "euler")).multiplier) ** 2
    assert np.max(np.abs(growth / (1 + (h * d) ** 2) - 1)) < 8 * EPS
    for method in ("exact", "midpoint"):
        powers = discretize(modes, Hold(h, method)).powers(np.array([1.0, 1e3, 1e9]))
        assert np.max(np.abs(np.abs(powers) - 1)) < 4 * EPS


@pytest.mark.parametrize("k", [1e5, 1e9, 1e12])
def test_high_powers_keep_their_phase(k):
    modes = phc.modes([0.3, 1.0, 2.9], np.ones(3))
    got = discretize(modes, Hold(0.1)).powers(np.array([k]))[:, 0]
    with mp.workdps(60):
        for value, d in zip(got, modes.d, strict=True):
            truth = mp.expj(-mp.mpf(float(d)) * mp.mpf(0.1) * mp.mpf(k))
            assert abs(mp.mpc(complex(value)) - truth) < 8 * EPS


def test_euler_cannot_interpolate_its_input():
    with pytest.raises(phc.StructureError, match="intersample must be 'zoh'; use method='exact' or 'midpoint'"):
        discretize(phc.modes([1.0], [1.0]), Hold(0.1, "euler", "foh"))


# --- many steps ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("method", "intersample"), RULES)
def test_blocks_of_every_size_give_what_sample_by_sample_gives(method, intersample):
    rng = np.random.default_rng(1)
    modes = random_modes(6, 1, 2, rng)
    step = discretize(modes, Hold(0.2, method, intersample))
    u = rng.standard_normal((2, 97))
    x0 = rng.standard_normal(7) + 1j * rng.standard_normal(7)
    x0[6] = x0[6].real
    y_truth, x_truth = plain_recursion(step, u, x0)
    for block, fold in product((1, 2, 7, 96, 97, 98, 256), (0, 100)):
        with folded_from(fold):
            y, x = simulate(step, u, x0, states=True, block=block)
            assert np.max(np.abs(y - y_truth)) < 97 * EPS * np.max(np.abs(y_truth)) * 10
            assert np.max(np.abs(x - x_truth)) < 97 * EPS * np.max(np.abs(x_truth)) * 10
            assert np.array_equal(simulate(step, u, x0, block=block)[0], y)


@relaxed
@given(
    st.integers(0, 4), st.integers(0, 2), st.integers(1, 3), st.integers(1, 40), seeds, st.sampled_from(RULES),
    st.sampled_from([0, 100]),
)  # fmt: skip
def test_any_number_of_modes_rigid_bodies_ports_and_samples_agrees_with_the_recursion(
    n, rigid, ports, samples, seed, rule, fold
):
    rng = np.random.default_rng(seed)
    modes = random_modes(n, rigid, ports, rng)
    step = discretize(modes, Hold(0.3, *rule))
    u = rng.standard_normal((ports, samples))
    x0 = (rng.standard_normal(n + rigid)).astype(complex)
    y_truth, x_truth = plain_recursion(step, u, x0)
    with folded_from(fold):
        y, x = simulate(step, u, x0, states=True, block=16)
    assert y.shape == (ports, samples)
    assert x.shape == (n + rigid, samples)
    size = np.abs(step.c) @ np.abs(x_truth) if n + rigid else np.zeros_like(y)
    assert np.max(np.abs(y - y_truth)) <= 20 * samples * EPS * np.max(size)
    assert np.max(np.abs(x - x_truth), initial=0.0) <= 20 * samples * EPS * np.max(np.abs(x_truth), initial=0.0)


def hard_input(name, step, samples, rng):
    """Samples whose response is hard in one way; `DRIVES` names them."""
    k = np.arange(samples)
    phase = step.phase[0][0]
    return {
        "noise": lambda: rng.standard_normal(samples),
        "constant": lambda: np.ones(samples),
        "resonance": lambda: np.cos(phase * k),
        "beating": lambda: np.cos((phase + 200 * np.pi / samples) * k),
        "large, then nothing": lambda: np.where(k < 300, 1.0, 0.0) * rng.standard_normal(samples),
        "nothing, then a pulse": lambda: np.where(k == samples - 40, 1.0, 0.0),
        "alternating": lambda: (-1.0) ** k,
    }[name]()


DRIVES = ["noise", "constant", "resonance", "beating", "large, then nothing", "nothing, then a pulse", "alternating"]
LONG = 34_000  # samples, several of the pieces in which a record is worked off


@pytest.mark.variants
@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("rule", [("exact", "foh"), *slowly((("midpoint", "zoh"),))])
def test_long_responses_to_hard_inputs_are_right_to_1e_13_of_the_largest_output(drive, rule):
    rng = np.random.default_rng(3)
    step = discretize(phc.modes([0.013, 0.4, 0.40001, 1.3, 2.9], rng.uniform(0.1, 2.0, 5)), Hold(0.9, *rule))
    u = hard_input(drive, step, LONG, rng)[None]
    truth, _, _ = fine_recursion(step, u, np.zeros(5))
    assert np.max(np.abs(truth)) > 0.1
    for fold in (0, 100):
        with folded_from(fold):
            y, _ = simulate(step, u, np.zeros(5, complex))
        assert np.max(np.abs(y - truth)) < 1e-13 * np.max(np.abs(truth))


@pytest.mark.variants
@pytest.mark.parametrize("rule", RULES)
def test_a_long_record_of_several_ports_with_rigid_bodies_is_right_in_outputs_and_states(rule):
    rng = np.random.default_rng(4)
    modes = random_modes(7, 2, 3, rng)
    # steps so small that the growth of the Euler rule stays within a hundredfold
    step = discretize(modes, Hold(0.005 if rule[0] == "euler" else 0.3, *rule))
    u = rng.standard_normal((3, LONG))
    x0 = rng.standard_normal(9) + 1j * np.r_[rng.standard_normal(7), 0, 0]
    y_truth, x_truth, size = fine_recursion(step, u, x0)
    for block, fold in ((16, 0), (50, 100), (None, 0), (None, 100)):
        with folded_from(fold):
            y, x = simulate(step, u, x0, states=True, block=block)
        assert np.max(np.abs(y - y_truth)) < 1e-13 * size
        assert np.max(np.abs(x - x_truth)) < 1e-13 * np.max(np.abs(x_truth))


def test_what_cancels_at_a_transmission_zero_loses_no_more_than_the_digits_that_cancel():
    """Between two equal modes the response to a sine is the difference of two large motions."""
    modes = phc.modes([0.95, 1.05], [1.0, 0.95 / 1.05])
    step = discretize(modes, Hold(0.5, "exact", "foh"))
    zero = float(np.max(np.abs(modes.zeros)))
    t = 0.5 * np.arange(LONG)
    u = (np.sin(zero * t) * np.minimum(1.0, t / t[-1]) ** 2)[None]
    truth, _, size = fine_recursion(step, u, np.zeros(2))
    assert np.max(np.abs(truth)) < 0.02 * size
    for fold in (0, 100):
        with folded_from(fold):
            y, _ = simulate(step, u, np.zeros(2, complex))
        assert np.max(np.abs(y - truth)) < 1e-13 * size


@pytest.mark.variants
@pytest.mark.parametrize("time_unit", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("amplitude", [1e-9, *slowly(1.0, 1e9)])
def test_the_error_scales_with_the_units(time_unit, amplitude):
    rng = np.random.default_rng(5)
    d, r, u = np.array([0.3, 0.7, 2.0]) / time_unit, np.array([1.0, 2.0, 0.5]), rng.standard_normal((1, LONG))
    step = discretize(phc.modes(d, r), Hold(0.8 * time_unit))
    x0 = amplitude * (rng.standard_normal(3) + 1j * rng.standard_normal(3))
    truth, _, size = fine_recursion(step, amplitude * u, x0)
    assert size > 0
    for fold in (0, 100):
        with folded_from(fold):
            y, _ = simulate(step, amplitude * u, x0)
        assert np.max(np.abs(y - truth)) < 1e-13 * size


@pytest.mark.variants
@pytest.mark.parametrize("n", [1, 30, *slowly(2, 300)])
def test_pieces_of_a_record_join_whatever_the_number_of_modes(n):
    """Many modes leave fewer blocks to a piece."""
    rng = np.random.default_rng(n)
    step = discretize(
        phc.modes(np.sort(rng.uniform(0.01, 3.0, n)), rng.uniform(0.1, 1.0, n)), Hold(1.0, "exact", "foh")
    )
    u, x0 = rng.standard_normal((1, 20_001)), rng.standard_normal(n) + 0j
    truth, _, _ = fine_recursion(step, u, x0)
    for block in (24, None):
        y, _ = simulate(step, u, x0, block=block)
        assert np.max(np.abs(y - truth)) < 1e-13 * np.max(np.abs(truth))


def test_a_mode_that_grows_beyond_all_doubles_is_no_matter_before_it_is_struck():
    """Under Euler `|lambda|^k` overflows within the record; silence before a late pulse must stay silence."""
    step = discretize(phc.modes([1.0, 2.0], [1.0, 1.0]), Hold(1.0, "euler"))
    u = np.zeros((1, 5000))
    u[0, -20] = 1.0
    with np.errstate(over="ignore", invalid="ignore"):
        y, _ = simulate(step, u, np.zeros(2, complex))
    truth, _, _ = fine_recursion(step, u[:, -20:], np.zeros(2))
    assert np.array_equal(y[0, :-20], np.zeros(4980))
    assert np.max(np.abs(y[:, -20:] - truth)) < 1e-13 * np.max(np.abs(truth))


def test_a_single_sample_is_the_initial_state_and_no_mode_is_silence():
    step = discretize(phc.modes([1.0, 2.0], [1.0, 1.0]), Hold(1.0, "exact", "foh"))
    x0 = np.array([1 + 2j, 3 - 1j])
    y, x = simulate(step, np.array([[5.0]]), x0, states=True)
    assert np.max(np.abs(x[:, 0] - x0)) <= 4 * EPS * 5
    assert abs(y[0, 0] - 7.0) <= 16 * EPS * 7
    silent = discretize(phc.modes([], []), Hold(1.0))
    y, x = simulate(silent, np.ones((1, 5)), np.zeros(0, complex), states=True)
    assert np.array_equal(y, np.zeros((1, 5)))
    assert x.shape == (0, 5)


@pytest.mark.slow
@pytest.mark.parametrize(
    "d",
    [np.sort(np.random.default_rng(7).uniform(0.05, 3.0, 100)), np.logspace(-6, 6, 100)],
    ids=["dense spectrum", "twelve decades, most of them turning many times a step"],
)
def test_a_hundred_modes_stay_right_to_1e_12_over_a_hundred_thousand_samples(d):
    rng = np.random.default_rng(8)
    samples, h = 100_000, 0.37
    r = rng.uniform(0.1, 2.0, 100)
    u = rng.standard_normal(samples)
    modes = phc.modes(d, r)
    x0 = rng.standard_normal(100) + 1j * rng.standard_normal(100)
    truth = long_double_recursion(d, r, h, u, x0)
    # the reference scales its states by kappa / nu, so that its output is the sum of real parts
    start = x0 / (modes.d * modes.nu[:, 0].conj())
    # what the long doubles of the reference itself may have lost
    own = samples * float(np.finfo(np.longdouble).eps)
    for row, intersample in enumerate(("zoh", "foh")):
        y, _ = simulate(discretize(modes, Hold(h, "exact", intersample)), u[None, :], start)
        error = np.max(np.abs(y[0] - truth[row])) / np.max(np.abs(truth[row]))
        assert error < 1e-12 + own
    assert np.max(np.abs(truth[0] - truth[1])) > 1e-3 * np.max(np.abs(truth[0]))


@pytest.mark.parametrize("seed", range(3))
def test_midpoint_and_exact_conserve_the_energy_and_euler_lets_it_grow_as_predicted(seed):
    rng = np.random.default_rng(seed)
    modes = random_modes(5, 0, 1, rng)
    samples, h = 2000, 0.1
    x0 = rng.standard_normal(5) + 1j * rng.standard_normal(5)
    silence = np.zeros((1, samples))
    for method, growth in (("exact", 0 * modes.d), ("midpoint", 0 * modes.d), ("euler", (h * modes.d) ** 2)):
        _, x = simulate(discretize(modes, Hold(h, method)), silence, x0, states=True)
        predicted = np.abs(x0[:, None]) ** 2 * np.exp(np.multiply.outer(np.log1p(growth), np.arange(samples)))
        assert np.max(np.abs(np.abs(x) ** 2 / predicted - 1)) < 10 * samples * EPS
