"""A Hamiltonian matrix that rounding of its entries deprives of its frequencies is told, whatever the units."""

import warnings

import mpmath as mp
import numpy as np
import pytest

import ph_control as phc

HALF_ULP = 2.0**-53


def turn(rng, n):
    """Orthogonal symplectic matrix."""
    U, _ = np.linalg.qr(rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n)))
    return np.block([[U.real, -U.imag], [U.imag, U.real]])


def squeezed(n, power, seed):
    """Q with the frequencies 1 .. n, but for rounding, and a condition of `10**power` that no units take away."""
    rng = np.random.default_rng(seed)
    stretch = 10.0 ** np.linspace(power / 4, 0.0, n)
    S = turn(rng, n) * np.r_[stretch, 1 / stretch] @ turn(rng, n)
    Q = S.T @ np.diag(np.tile(np.arange(1.0, n + 1), 2)) @ S
    return (Q + Q.T) / 2


def response(Q, B, s):
    """Transfer function of the very doubles with 50 digits."""
    n = len(Q) // 2
    with mp.workdps(50):
        Q, B = mp.matrix(Q.tolist()), mp.matrix(B.reshape(-1, 1).tolist())
        A = mp.matrix(np.kron([[0.0, 1.0], [-1.0, 0.0]], np.eye(n)).tolist()) * Q
        return np.array([complex((B.T * Q * mp.lu_solve(mp.mpc(x) * mp.eye(2 * n) - A, B))[0]) for x in s])


def digits_lost(Q, B):
    """Decimal digits of the response near frequencies of 1 .. n that changes of half an ulp of Q take away."""
    n, rng = len(Q) // 2, np.random.default_rng(0)
    s = (0.2 + 0.7j) * np.arange(1.0, n + 1)
    right, worst = response(Q, B, s), 0.0
    for _ in range(3):
        signs = np.triu(rng.choice([-1.0, 1.0], Q.shape))
        changed = response(Q * (1 + HALF_ULP * (signs + np.triu(signs, 1).T)), B, s)
        worst = max(worst, float(np.max(np.abs(changed / right - 1))))
    return np.log10(worst / HALF_ULP)


def warns(build):
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        build()
    assert all(issubclass(warning.category, phc.ConditioningWarning) for warning in told)
    return len(told)


def chain(rng, n, free):
    """Q of masses on springs, in normal or in turned coordinates."""
    k = rng.uniform(0.5, 3.0, n) * 10.0 ** rng.uniform(-2, 2, n)
    k[0] *= not free
    K = np.diag(k) + np.diag(np.r_[k[1:], 0.0]) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    T = np.linalg.qr(rng.standard_normal((n, n)))[0] if rng.random() < 0.5 else np.eye(n)
    Q = np.zeros((2 * n, 2 * n))
    Q[:n, :n], Q[n:, n:] = T.T @ K @ T, T.T @ np.diag(rng.uniform(0.5, 2.0, n)) @ T
    return (Q + Q.T) / 2


@pytest.mark.variants
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("n", [2, 3, 5])
def test_fifteen_lost_digits_are_told_and_eleven_are_not(n, seed):
    B = np.random.default_rng(seed).standard_normal(2 * n)
    worst, well = squeezed(n, 17.5, seed), squeezed(n, 11, seed)
    assert digits_lost(worst, B) > 15 and digits_lost(well, B) < 11.5
    losses = 0.1 * np.eye(2 * n)
    for more in ({}, {"R": losses}):
        with pytest.warns(phc.ConditioningWarning, match="ill-conditioned in any units"):
            phc.ph(worst, B, **more)
        assert warns(lambda more=more: phc.ph(worst, B, **more)) == 1
        assert warns(lambda more=more: phc.ph(well, B, **more)) == 0


@pytest.mark.variants
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("n", [2, 5, 12, 30])
def test_units_of_states_time_and_ports_neither_bring_a_warning_nor_take_it(n, seed):
    rng = np.random.default_rng([n, seed])
    B = rng.standard_normal((2 * n, 2))
    lost, chained = squeezed(n, 16.5, seed), chain(rng, n, free=seed % 2)
    for _ in range(3):
        units = 10.0 ** rng.uniform(-9, 9, n)
        units, time, ports = np.r_[units, 1 / units], 10.0 ** rng.uniform(-9, 9), 10.0 ** rng.uniform(-9, 9, 2)
        for Q, expected in ((lost, 1), (chained, 0)):
            moved = time * Q * units[:, None] * units
            into = B / units[:, None] * ports
            assert warns(lambda Q=moved, B=into: phc.ph(Q, B)) == expected
            assert warns(lambda Q=moved, B=into: phc.ph(Q, B, S=0.1 * np.eye(2)).poles()) == expected


def test_the_figure_is_the_change_of_the_frequency():
    # four entries of 1 that change by eps move the eigenvalue e/2 by 2 eps, and its root, relative, by 2 eps / e
    e, Q = 2.0**-42, np.eye(4)
    Q[:2, :2] = [[1.0 + e, -1.0], [-1.0, 1.0]]
    with pytest.warns(phc.ConditioningWarning, match=r"natural frequency 3\.372e-07 by 2e-03 of itself"):
        phc.ph(Q, [0.0, 0.0, 1.0, 0.0])


def test_structures_and_circuits_in_plain_units_bring_no_warning():
    rng = np.random.default_rng(1)
    for free in (False, True):
        masses, springs = rng.uniform(0.5, 2.0, 300), rng.uniform(1e3, 1e7, 299)
        sys = phc.spring_chain(masses, springs, ground=0.0 if free else 1e3)
        assert warns(lambda sys=sys: phc.ph(sys.Q, sys.B).modes) == 0
    farads, henries = np.geomspace(1e-12, 1e-9, 6), np.geomspace(1e-6, 1e-3, 6)
    assert warns(lambda: phc.ph(np.diag(np.r_[1 / farads, 1 / henries]), np.ones(12)).modes) == 0
    coupled = np.diag(henries) + 0.999 * (np.sqrt(np.outer(henries, henries)) - np.diag(henries))
    Q = np.zeros((12, 12))
    Q[:6, :6], Q[6:, 6:] = np.diag(1 / farads), np.linalg.inv(coupled)
    assert warns(lambda: phc.ph((Q + Q.T) / 2, np.ones(12)).modes) == 0


def test_a_large_matrix_is_judged_with_its_modes():
    n = 40
    Q = np.eye(2 * n)
    small = squeezed(2, 16.5, 0)
    rows = np.array([0, 1, n, n + 1])
    Q[np.ix_(rows, rows)] = small
    Q[2, 3] = Q[3, 2] = 0.1
    sys = phc.ph(Q, np.ones(2 * n))
    with pytest.warns(phc.ConditioningWarning, match="ill-conditioned in any units"):
        assert len(sys.modes.d)
