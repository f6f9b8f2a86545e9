"""Long and short steps of systems whose poles coincide or nearly do, against 60 digits and closed forms."""

import mpmath as mp
import numpy as np
import pytest
from reference import DIGITS, exact_motion, exact_steps, share_of_largest
from slow import slowly

import ph_control as phc

SAMPLES = 8
ALLOWED = 1e-13
RATIOS = [1 + 10.0**-k for k in (0, 1, 3, 8, 16)]
STEPS = [1e-6, 1e-3, 0.2, 1.5, 4.4, 12.0, 50.0]  # times the faster of two poles


def masses(*sections, **options):
    """Masses `(m, p, ratio)`, each on a spring and a dashpot, with poles `-p` and `-ratio p`, driven by one force."""
    m, p, ratio = np.array(sections).T
    n = len(m)
    Q = np.diag(np.r_[m * p * p * ratio, 1 / m])
    return phc.ph(Q, np.r_[np.zeros(n), np.ones(n)], R=np.diag(np.r_[np.zeros(n), m * p * (1 + ratio)]), **options)


def chain(p, ratio):
    """Three coupled masses, each mode of which has two real poles."""
    w, V = np.linalg.eigh(2 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1))
    fast = p * np.sqrt(w / w.max())
    K, C = V * (fast**2 * ratio) @ V.T, V * (fast * (1 + ratio)) @ V.T
    Z = np.zeros((3, 3))
    Q = np.block([[0.5 * (K + K.T), Z], [Z, np.eye(3)]])
    return phc.ph(Q, [0, 0, 0, 1.0, 0, 0], R=np.block([[Z, Z], [Z, 0.5 * (C + C.T)]]))


SYSTEMS = {
    "one": lambda ratio: masses((0.7, 3.1, ratio)),
    "one with its position": lambda ratio: masses((0.7, 3.1, ratio), sensors=[[1.0, 0.0]]),
    "equal ones": lambda ratio: masses((0.7, 3.1, ratio), (2.0, 3.1, ratio)),
    "two": lambda ratio: masses((0.7, 3.1, ratio), (2.0, 3.5, ratio)),
    "coupled": lambda ratio: chain(3.1, ratio),
}


def flat(columns, C):
    return [value for column in columns for value in mp.matrix(C.tolist()) * column]


@pytest.mark.variants
@pytest.mark.parametrize("ratio", [*RATIOS[1::2], *slowly(*RATIOS[::2])])
@pytest.mark.parametrize("name", SYSTEMS)
def test_all_responses_are_right_to_rounding_of_the_largest_sample(name, ratio):
    sys, rng = SYSTEMS[name](ratio), np.random.default_rng(7)
    n, fastest = sys.nstates, np.abs(sys.poles()).max()
    u, z0 = rng.standard_normal((1, SAMPLES)), rng.standard_normal(n)
    still, ones, shift = 0 * u, np.ones((1, SAMPLES)), np.eye(n)[0]
    each = 2 if n == 2 else 3
    for step in STEPS[RATIOS.index(ratio) % each :: each]:
        h = step / fastest
        t, steps = h * np.arange(SAMPLES), exact_steps(sys.A, sys.B, h)
        with mp.workdps(DIGITS):
            for hold in ("zoh", "foh"):
                cases = [
                    (phc.forced_response(sys, t, u, z0, intersample=hold), u, z0),
                    (phc.forced_response(sys, t, u, intersample=hold), u, 0 * z0),
                    (phc.step_response(sys, t, intersample=hold), ones, 0 * z0),
                    (phc.impulse_response(sys, t), still, sys.B[:, 0]),
                    (phc.initial_response(sys, t, shift), still, shift),
                ]
                for response, inputs, start in cases:
                    z = exact_motion(steps, inputs, start, hold)
                    y = np.reshape(response.outputs, (-1, SAMPLES))
                    assert share_of_largest(y.T, flat(z, sys.C)) < ALLOWED
                    x = np.reshape(response.states, (n, SAMPLES))
                    assert share_of_largest(x.T, flat(z, np.eye(n))) < ALLOWED
                F, G, S = steps
                found = phc.sample(sys, h, intersample=hold)
                assert share_of_largest(found.A, list(F)) < ALLOWED
                assert share_of_largest(found.B, list(G if hold == "zoh" else G - S + F * S)) < ALLOWED


@pytest.mark.parametrize("h", [1e-5, 1e-3, 0.05])
def test_many_short_steps_add_up_no_error(h):
    sys = masses((1.0, 2.0, 1.0))
    t = h * np.arange(min(200_000, int(8 / h)))
    exact = t * np.exp(-2 * t)
    assert np.max(np.abs(phc.step_response(sys, t).outputs - exact)) < ALLOWED * exact.max()
    assert np.max(np.abs(phc.initial_response(sys, t, [1.0, 0.0]).outputs + 4 * exact)) < 4 * ALLOWED * exact.max()


@pytest.mark.parametrize("n", [20, 60])
def test_many_critically_damped_sections_keep_their_digits(n):
    """With neighbouring double poles close to one another, in time and in frequency."""
    p = np.random.default_rng(n).uniform(1, 40, n)
    sys = masses(*((1.0, pole, 1.0) for pole in p))
    w = np.geomspace(0.1, 100, 15)
    exact = np.sum(1j * w[:, None] / (1j * w[:, None] + p) ** 2, axis=1)
    assert np.max(np.abs(sys.modes.freqresp(w).ravel() - exact)) < ALLOWED * np.max(np.abs(exact))
    t = 0.05 * np.arange(30)
    exact = np.sum(t[:, None] * np.exp(-p * t[:, None]), axis=1)
    assert np.max(np.abs(phc.step_response(sys, t).outputs - exact)) < ALLOWED * exact.max()


@pytest.mark.parametrize("ratio", [1.0, 1 + 1e-12, 1.01, 1e3, 1e8])
def test_poles_that_do_not_oscillate_need_no_resolution(ratio):
    sys = masses((1.0, 2.0, ratio))
    for h in (1e-3, 2.0, 1e4):
        phc.sample(sys, h)
    for simulate in (phc.step_response, phc.impulse_response):
        assert np.isfinite(simulate(sys).outputs).all()


def test_damped_oscillations_are_named_by_the_frequency_at_which_they_swing():
    sys = phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0], R=np.diag([0.0, 3.2]))  # 2 rad/s, 80 per cent: 1.2 rad/s
    phc.sample(sys, 0.99 * np.pi / 1.2)
    with pytest.warns(phc.ResolutionWarning, match=r"1 mode at d = 1\.2 rad.* take a step below 2\.618"):
        phc.sample(sys, 1.01 * np.pi / 1.2)
