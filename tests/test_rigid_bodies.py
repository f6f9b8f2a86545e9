"""Several bodies without springs to the ground, in plain state spaces: each answer is right, or there is none."""

import control as ct
import numpy as np
import pytest
from scipy.linalg import block_diag

import ph_control as phc


def rotated(A, B, C, rng, condition=1.0):
    n = len(A)
    U, V = (np.linalg.qr(rng.normal(size=(n, n)))[0] for _ in range(2))
    s = np.geomspace(1, condition, n)
    T, inverse = U * s @ V, V.T / s @ U.T
    return T @ A @ inverse, T @ B, C @ inverse


def plain(A, B, C):
    return ct.ss(A, B, C, np.zeros((len(C), B.shape[1])))


def two_masses(seed):
    A = np.eye(4, k=2)
    b = np.array([[0.0, 0.0, 1.0, 2.0]]).T
    Q = np.linalg.qr(np.random.default_rng(seed).normal(size=(4, 4)))[0]
    return plain(Q.T @ A @ Q, Q.T @ b, b.T @ Q)


def free_beam(elements):
    """Mass and stiffness of a free Euler-Bernoulli beam, EI = m = L = 1, consistent mass."""
    h = 1 / elements
    k = np.array([[12, 6 * h, -12, 6 * h], [0, 4 * h * h, -6 * h, 2 * h * h], [0, 0, 12, -6 * h], [0, 0, 0, 4 * h * h]])
    m = np.array(
        [[156, 22 * h, 54, -13 * h], [0, 4 * h * h, 13 * h, -3 * h * h], [0, 0, 156, -22 * h], [0, 0, 0, 4 * h * h]]
    )
    K, M = np.zeros((2, 2 * elements + 2, 2 * elements + 2))
    for e in range(elements):
        part = np.s_[2 * e : 2 * e + 4, 2 * e : 2 * e + 4]
        K[part] += (k + np.triu(k, 1).T) / h**3
        M[part] += (m + np.triu(m, 1).T) * h / 420
    return M, K


def state_space(M, K, b):
    n = len(M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), np.zeros((n, n))]])
    return A, np.r_[0 * b, np.linalg.solve(M, b)], np.c_[0 * b.T, b.T]


@pytest.mark.variants
@pytest.mark.parametrize("call", [phc.ph, phc.minreal])
def test_two_free_masses_are_one_residue_at_zero_in_any_coordinates(call):
    for seed in range(150):
        sys = call(two_masses(seed))
        assert len(sys.d) == 0 and abs(sys.modes.kappa_0 - 5) < 1e-12
    assert phc.same_filter(two_masses(0), two_masses(1))


def test_a_free_beam_keeps_its_first_bending_mode_beside_its_rigid_ones():
    M, K = free_beam(8)
    b = np.eye(len(M))[:, :1]
    A, B, C = state_space(M, K, b)
    # rotated, positions and velocities have rounding errors of one size
    for matrices, close in (((A, B, C), 1e-8), (rotated(A, B, C, np.random.default_rng(0)), 1e-5)):
        sys = phc.ph(plain(*matrices))
        assert abs(sys.modes.kappa_0 - 4) < close
        assert len(sys.d) == 16 and abs(sys.d[0] / 22.3750899 - 1) < 1e-7
        for s in (0.1 + 1j, 3 + 20j, 10 + 60j, 300 + 500j):
            truth = (s * b.T @ np.linalg.solve(s * s * M + K, b.astype(complex)))[0, 0]
            assert abs(sys(s) / truth - 1) < close
    assert phc.same_filter(plain(A, B, C), phc.from_second_order(M, K, b), rtol=1e-8)


def structure(rng):
    """Up to four bodies with positions that follow in any way, up to five oscillators, up to three ports."""
    bodies, oscillators, ports = (int(rng.integers(low, high)) for low, high in ((1, 5), (0, 6), (1, 4)))
    d = 10 ** rng.uniform(-1.5, 1.5, oscillators)
    rigid, nu = rng.normal(size=(bodies, ports)), rng.normal(size=(2 * oscillators, ports))
    A = block_diag(np.kron([[0, 1], [0, 0]], rng.normal(size=(bodies, bodies))), *([[0, x], [-x, 0]] for x in d))
    B = np.concatenate([0 * rigid, rigid, nu])
    C = np.concatenate([0 * rigid, rigid, np.repeat(d, 2)[:, None] * nu]).T
    return A, B, C, d


def value(A, B, C, s):
    return C @ np.linalg.solve(s * np.eye(len(A)) - A, B.astype(complex))


@pytest.mark.variants
@pytest.mark.parametrize("decades", [0, 9])
@pytest.mark.parametrize("condition", [1.0, 30.0, 1e4])
def test_bodies_and_oscillators_in_any_coordinates_are_right_or_refused_for_their_condition(decades, condition):
    answered, rng = 0, np.random.default_rng(int(condition) + decades)
    for _ in range(25):
        A, B, C, d = structure(rng)
        time, unit = 10 ** rng.uniform(-decades, decades), 10 ** rng.uniform(-decades, decades, len(A))
        a, b, c = rotated(A, B, C, rng, condition)
        sys = plain(unit[:, None] * a / unit / time, unit[:, None] * b, c / unit / time)
        try:
            found = phc.ph(sys)
        except phc.NotLosslessError:
            raise
        except phc.StructureError:
            continue
        answered += 1
        assert len(found.d) == len(d)
        for w in (0.1, *d, 100.0):
            truth = value(A, B, C, w * (0.3 + 0.5j))
            assert np.abs(found.horner(w * (0.3 + 0.5j) / time)[:, :, 0] - truth).max() < 1e-6 * np.abs(truth).max()
    assert answered >= 23


@pytest.mark.variants
@pytest.mark.parametrize(
    ("method", "hold"), [("exact", "zoh"), ("exact", "foh"), ("midpoint", "zoh"), ("midpoint", "foh"), ("euler", "zoh")]
)
def test_sampled_bodies_come_back(method, hold):
    rng = np.random.default_rng(0)
    for _ in range(12):
        A, B, C, d = structure(rng)
        sys, h = phc.ph(plain(A, B, C)), 0.3 / max([1.0, *d])
        F = phc.sample(phc.ph(sys.Q, sys.B), h, method, intersample=hold)
        a, b, c = rotated(F.A, F.B, F.C, rng)
        back = phc.ph(ct.ss(a, b, c, F.D, h), method=method, intersample=hold)
        assert len(back.d) == len(d) and np.allclose(back.d, sys.d, rtol=1e-7)
        assert np.allclose(back.modes.kappa_0, sys.modes.kappa_0, rtol=1e-7, atol=1e-7)


def test_slow_oscillators_and_slow_damping_beside_bodies_are_not_taken_for_rest():
    rng = np.random.default_rng(1)
    A, B, C, _ = structure(rng)
    for d in (1e-3, 1e-2):
        slow = block_diag(A, [[0, d], [-d, 0]]), np.r_[B, B[-2:]], np.c_[C, d * B[-2:].T]
        assert abs(phc.ph(plain(*rotated(*slow, rng))).d[0] / d - 1) < 1e-6
    damped = block_diag(A, [[-1e-3]]), np.r_[B, B[-1:]], np.c_[C, B[-1:].T]
    with pytest.raises(phc.NotLosslessError, match="damped"):
        phc.ph(plain(*rotated(*damped, rng)), lossless=True)
