"""Passivity is a matter of the system, not of its units, its coordinates or the rounding of its matrices.

References: roots in 50 digits of `Re N(jw) D(-jw)`, a polynomial in the square of the frequency; partial fractions.
"""

from __future__ import annotations

import warnings

import control as ct
import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ph_control as phc

UNITS = (1e-12, 1e-9, 1e-3, 1.0, 1e6, 1e12)


def fraction(modes, resistance):
    """Coefficients of `resistance + sum_l kappa_l s / (s^2 + 2 zeta_l d_l s + d_l^2)`."""
    den = np.ones(1)
    for d, zeta, _ in modes:
        den = np.convolve(den, [1.0, 2 * zeta * d, d * d])
    num = resistance * den
    for k, (_, _, kappa) in enumerate(modes):
        part = np.array([kappa, 0.0])
        for other, (d, zeta, _) in enumerate(modes):
            if other != k:
                part = np.convolve(part, [1.0, 2 * zeta * d, d * d])
        num = np.polyadd(num, part)
    return num, den


def in_units(num, den, time, gain):
    """The same transfer function with time and gain in other units: a pole `p` becomes `p / time`."""
    powers = len(den) - len(num) + np.arange(len(num))
    return ct.tf(gain * num * time ** (-1.0 * powers), den * time ** (-1.0 * np.arange(len(den))))


def drawn(seed):
    """Up to six modes, some of them driven backwards, and a resistance of either sign or none."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 7))
    d = np.cumsum(rng.uniform(0.4, 1.5, n)) * 0.3
    signs = np.where(rng.uniform(size=n) < 0.15, -1.0, 1.0)
    modes = list(zip(d, 10 ** rng.uniform(-2.5, 0.0, n), signs * rng.uniform(0.3, 2.0, n), strict=True))
    return fraction(modes, rng.choice([0.0, 0.05, -0.02]))


def crossings(num, den):
    """Frequencies at which the real part changes its sign, from the coefficients, in 50 digits."""
    with mp.workdps(50):
        a, b = ([mp.mpf(float(x)) for x in p[::-1]] for p in (num, den))
        real = [mp.mpf(0)] * ((len(a) + len(b)) // 2 + 1)
        for i, x in enumerate(a):
            for k, y in enumerate(b):
                if (i + k) % 2 == 0:  # `(jw)^i (-jw)^k`
                    real[(i + k) // 2] += x * y * (-1) ** ((i - k) // 2)
        while real and real[-1] == 0:
            real.pop()
        while real and real[0] == 0:
            real.pop(0)
        if not real:
            return [], 0
        with warnings.catch_warnings():  # of the order of coefficients, which mpmath is about to change
            warnings.simplefilter("ignore", DeprecationWarning)
            roots = mp.polyroots(real[::-1], maxsteps=500, extraprec=400) if len(real) > 1 else []
        found = sorted(float(mp.sqrt(mp.re(x))) for x in roots if mp.re(x) > 0 and abs(mp.im(x)) < 1e-30 * abs(x))
        return found, int(mp.sign(real[0]))


@pytest.mark.slow
@settings(max_examples=20, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**31), time=st.sampled_from(UNITS), gain=st.sampled_from(UNITS))
def test_bands_of_coefficients_are_those_of_50_digits_in_any_units(seed, time, gain):
    num, den = drawn(seed)
    ends, sign = crossings(num, den)
    report = phc.passivity(in_units(num, den, time, gain))
    edges = [0.0] * (sign < 0) + ends
    edges += [np.inf] * (len(edges) % 2)
    np.testing.assert_allclose(np.ravel(report.bands) * time, edges, rtol=1e-6)
    assert report.is_passive is (not edges)


@settings(max_examples=13, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**31), time=st.sampled_from(UNITS), gain=st.sampled_from(UNITS))
def test_the_form_is_the_same_in_any_units(seed, time, gain):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 7))
    d = 0.5 + np.cumsum(rng.uniform(0.3, 1.0, n))
    num, den = fraction(
        list(zip(d, 10 ** rng.uniform(-2, -0.3, n), rng.uniform(0.3, 2, n), strict=True)), rng.choice([0.0, 0.3])
    )
    omega = np.linspace(0.2, 1.5 * d[-1], 50)
    wanted = np.polyval(num, 1j * omega) / np.polyval(den, 1j * omega)
    form = phc.ph(in_units(num, den, time, gain))
    got = form(1j * omega / time) / gain
    assert np.abs(got - wanted).max() <= 1e-8 * np.abs(wanted).max()
    assert form.nstates == 2 * n
    k = np.sort(form.natural_frequencies)
    np.testing.assert_allclose(k[k > 0] * time, d, rtol=1e-6)


@pytest.mark.variants
@pytest.mark.parametrize("time", UNITS)
@pytest.mark.parametrize("gain", [1e-12, 1.0, 1e12])
def test_transfer_matrices_are_judged_in_any_units(time, gain):
    """Modes with shapes of rank one at two ports; the second system takes energy back at one of them."""
    rng = np.random.default_rng(11)
    shapes, d, zeta = rng.normal(size=(3, 2)), np.array([1.0, 2.0, 3.5]), np.array([0.02, 0.1, 0.3])
    for back, passive in ((0.0, True), (0.4, False)):
        residues = [np.outer(row, row) for row in shapes]
        residues[1] = residues[1] - back * np.eye(2)
        entries = [
            [fraction([(*pair, K[i, j]) for *pair, K in zip(d, zeta, residues, strict=True)], 0.0) for j in (0, 1)]
            for i in (0, 1)
        ]
        table = [[in_units(num, den, time, gain) for num, den in row] for row in entries]
        G = ct.tf(*([[getattr(one, name)[0][0] for one in row] for row in table] for name in ("num_list", "den_list")))
        report = phc.passivity(G)
        assert report.is_passive is passive
        if passive:
            form, s = phc.ph(G), 1j * np.linspace(0.3, 5.0, 30)
            wanted = sum(
                np.einsum("ij,n->ijn", K, s / (s * s + 2 * z * w * s + w * w))
                for w, z, K in zip(d, zeta, residues, strict=True)
            )
            assert np.abs(form(s / time) / gain - wanted).max() <= 1e-8 * np.abs(wanted).max()


@pytest.mark.variants
@pytest.mark.parametrize("time", [1e-9, 1.0, 1e9])
def test_polynomials_of_a_state_space_are_the_same_in_any_units(time):
    num, den = drawn(3)
    there = phc.tf(ct.ss(phc.nearest_passive(in_units(num, den, time, 1e-6))))
    back = phc.tf(ct.ss(phc.nearest_passive(ct.tf(num, den))))
    s = 1j * np.linspace(0.1, 3.0, 20)
    np.testing.assert_allclose(there(s / time) / 1e-6, back(s), rtol=1e-6)
    assert there.den_list[0][0].size == back.den_list[0][0].size


# --- the rounding of matrices ------------------------------------------------------------------------------------


def plain(system):
    return ct.ss(*(np.array(getattr(system, name)) for name in "ABCD"))


def in_other_states(system, rng):
    T = np.linalg.qr(rng.normal(size=(system.nstates,) * 2))[0]
    return ct.ss(T @ system.A @ T.T, T @ system.B, system.C @ T.T, system.D)


@settings(max_examples=13, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**31), light=st.sampled_from([1e-3, 1e-5, 1e-7, 1e-8, 1e-9, 1e-10, 1e-12, 1e-14]))
def test_light_dampers_are_passive_with_the_sign_that_they_have(seed, light):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 6))
    masses, springs, ground = rng.uniform(0.4, 3, n), rng.uniform(1, 6, n - 1), rng.uniform(0.1, 1, n)
    ports = sorted(rng.choice(n, int(rng.integers(1, n + 1)), replace=False).tolist())
    system = phc.spring_chain(masses, springs, ground=ground, c=light, port=ports)
    for given_system in (system, plain(system), in_other_states(system, rng)):
        report = phc.passivity(given_system)
        assert report.is_passive and report.margin == 0 and not len(report.unstable)
    form = phc.ph(plain(system))
    assert form.nstates == 2 * n
    if light < 1e-10:
        return
    # the same dampers reversed make energy
    Q, R = np.array(system.Q), np.array(system.R)
    reversed_dampers = ct.ss((system.J + R) @ Q, system.B, system.C, system.D)
    report = phc.passivity(reversed_dampers)
    assert not report.is_passive
    with pytest.raises(phc.StructureError):
        phc.ph(reversed_dampers)


@pytest.mark.variants
@pytest.mark.parametrize("damping", [1.0, 1e2, 1e4, 1e6, 1e7, 1e8])
@pytest.mark.parametrize("seed", range(4))
def test_overdamped_masses_are_passive(damping, seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 4))
    M, K, B = rng.uniform(0.5, 2, n), rng.uniform(0.5, 9, n), rng.normal(size=n)
    losses = 2 * damping * np.sqrt(M * K)
    system = phc.ph(np.diag(np.r_[K, 1 / M]), np.r_[0 * B, B], R=np.diag(np.r_[0 * K, losses]))
    for given_system in (system, plain(system)):
        assert phc.passivity(given_system).is_passive
    assert not phc.passivity(-1 * plain(system)).is_passive


@pytest.mark.parametrize("size", [1e-6, 1e-9, 1e-12])
def test_a_small_negative_resistance_is_found_and_a_positive_one_is_not(size):
    """Off resonance the real part of a lightly damped chain is less than this resistance takes away."""
    chain = plain(phc.spring_chain([1.0, 2.0, 1.5], [3.0, 2.0], ground=[1.0, 0.5, 0.7], c=1e-3 * size, port=1))
    assert phc.passivity(chain + size).is_passive
    report = phc.passivity(chain - size)
    assert not report.is_passive
    assert report.worst[1] == pytest.approx(size, rel=1e-2)


def test_a_port_hamiltonian_system_is_passive_whatever_its_scales():
    rng = np.random.default_rng(5)
    for _ in range(10):
        n = 6
        scale = 10 ** rng.uniform(-5, 5, n)
        root, loss, J = rng.normal(size=(3, n, n))
        Q = (root @ root.T + 0.1 * np.eye(n)) * scale * scale[:, None]
        R = loss[:, :2] @ loss[:, :2].T * 10 ** rng.uniform(-14, 2)
        system = phc.ph(Q, rng.normal(size=(n, 2)), J=J - J.T, R=R)
        report = phc.passivity(system)
        assert report.is_passive and report.margin >= 0


# --- poles at infinity -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize(
    ("num", "den", "passive"),
    [
        ([3.0, 2.0], [1.0], True),
        ([3.0, 0.0], [1.0], True),
        ([-3.0, 2.0], [1.0], False),
        ([3.0, -2.0], [1.0], False),
        ([1.0, 0.0, 0.0], [1.0], False),
        ([2.0, 1.0, 10.0, 4.0], [1.0, 0.25, 4.0], True),  # 2 s + (s^2 / 2 + 2 s + 4) / (s^2 + s / 4 + 4)
        ([1.0, 1.0, 5.0, 0.0], [1.0, 0.1, 4.0], False),
    ],
)
def test_improper_functions_are_judged_by_their_residue_at_infinity(num, den, passive, unit):
    powers = len(den) - len(num) + np.arange(len(num))
    G = ct.tf(np.array(num) * unit ** (-1.0 * powers), np.array(den) * unit ** (-1.0 * np.arange(len(den))))
    report = phc.passivity(G)
    assert report.is_passive is passive
    assert (report.margin >= 0) is passive


def test_inductances_of_several_ports_are_judged_by_their_matrix():
    def impedance(mutual):
        return ct.tf([[[2.0, 1.0], [mutual, 0.0]], [[mutual, 0.0], [2.0, 3.0]]], [[[1.0], [1.0]], [[1.0], [1.0]]])

    assert phc.passivity(impedance(1.9)).is_passive and not phc.passivity(impedance(2.1)).is_passive


def test_an_impedance_with_an_inductance_is_converted_as_admittance():
    G = ct.tf([3.0, 2.0], [1.0])
    with pytest.raises(phc.StructureError, match=r"improper.*ph\(1 / G\)") as caught:
        phc.ph(G)
    assert not isinstance(caught.value, phc.NotLosslessError)
    with pytest.raises(phc.NotLosslessError, match="improper"):
        phc.ph(G, lossless=True)
    form = phc.ph(1 / G)
    assert form(2j) == pytest.approx(1 / (6j + 2)) and form.hamiltonian(np.ones(1)) > 0
    with pytest.raises(phc.StructureError, match="no passive system grows faster"):
        phc.ph(ct.tf([1.0, 0.0, 2.0], [1.0]))


# --- polynomials of state spaces ---------------------------------------------------------------------------------


@pytest.mark.variants
@pytest.mark.parametrize("time", UNITS)
@pytest.mark.parametrize("gain", UNITS)
def test_a_state_space_keeps_its_poles_and_margins_in_any_units(time, gain):
    A = np.array([[0.0, 1.3, 0.0], [-2.0, -0.3, 0.4], [0.0, -0.7, -0.5]])
    B, C = np.array([[1.0], [0.4], [0.3]]), np.array([[0.2, 1.0, 0.4]])
    system = ct.ss(A / time, B * gain / time, C, 0.0)
    s = 1j * np.linspace(0.1, 5.0, 30)
    wanted = np.array([(C @ np.linalg.solve(x * np.eye(3) - A, B)).item() for x in s])
    G = phc.tf(system)
    assert np.abs(G(s / time) / gain - wanted).max() <= 1e-12 * np.abs(wanted).max()
    # with a gain of 1 the margins are those of the unit of time 1
    loop = ct.ss(A / time, B / time, C, 0.0)
    plain = ct.stability_margins(ct.ss(A, B, C, 0.0))
    found = np.array(phc.stability_margins(loop)) * [1, 1, 1, time, time, time]
    np.testing.assert_allclose(found, plain, rtol=1e-6)
