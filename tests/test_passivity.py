"""Passivity is decided exactly: bands against roots in 50 digits, random systems against fine grids."""

from __future__ import annotations

import control as ct
import matplotlib.pyplot as plt
import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag

import ph_control as phc


def modal_system(poles, residues, D):
    """State space of `D + sum_l R_l / (s - p_l)` and conjugates; real poles count once."""
    A, B, C = [], [], []
    for p, R in zip(poles, residues, strict=True):
        U, s, V = np.linalg.svd(R)
        for k in np.flatnonzero(s > 1e-15 * s[0]):
            b, c = V[k], U[:, k] * s[k]
            if np.imag(p) == 0:
                A, B, C = [*A, [[np.real(p)]]], [*B, b.real[None]], [*C, c.real[:, None]]
            else:
                A = [*A, [[p.real, p.imag], [-p.imag, p.real]]]
                B, C = [*B, [2 * b.real, -2 * b.imag]], [*C, np.array([c.real, c.imag]).T]
    return ct.ss(block_diag(*A), np.concatenate(B), np.concatenate(C, axis=1), D)


def response(poles, residues, D, omega):
    """`G(j omega)` by partial fractions, shape (N, m, m)."""
    s = 1j * np.asarray(omega)[:, None, None]
    G = np.zeros((len(omega), *np.shape(D)), complex) + D
    for p, R in zip(poles, residues, strict=True):
        G += R / (s - p) + (0 if np.imag(p) == 0 else np.conj(R) / (s - np.conj(p)))
    return G


def drawn(rng, m=None):
    """Random stable poles and residues, near a passive system and often beyond it."""
    n, m = int(rng.integers(1, 8)), m or int(rng.integers(1, 4))
    d = rng.uniform(0.2, 5.0, n) * 10 ** rng.uniform(-1, 1)
    zeta = 10 ** rng.uniform(-4, -0.5, n)
    poles = d * (-zeta + 1j * np.sqrt(1 - zeta**2))
    residues = []
    for l in range(n):
        psi = rng.normal(size=m)
        stray = rng.normal(size=(m, m)) + 1j * rng.normal(size=(m, m))
        tilt = 0.5 * (1 + 1j * zeta[l] / np.sqrt(1 - zeta[l] ** 2))
        residues.append(np.outer(psi, psi) * tilt + stray * 10 ** rng.uniform(-4, -1) * rng.integers(0, 2))
    root = rng.normal(size=(m, m))
    return poles, residues, 0.1 * root @ root.T * rng.integers(0, 2)


def indefinite(poles, residues, D, omega, scattering=False):
    """Smallest eigenvalue of `Phi` on a grid, and a bound of its rounding."""
    G = response(poles, residues, D, omega)
    H = G.conj().transpose(0, 2, 1)
    Phi = np.eye(len(D)) - H @ G if scattering else G + H
    size = sum(np.abs(1 / (1j * omega - p)) * np.linalg.norm(R) for p, R in zip(poles, residues, strict=True))
    return np.linalg.eigvalsh(Phi)[:, 0], 1e-12 * ((1 + size**2) if scattering else size + np.linalg.norm(D))


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("kind", ["immittance", "scattering"])
@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_bands_hold_all_and_only_what_a_fine_grid_shows(kind, seed):
    poles, residues, D = drawn(np.random.default_rng(seed))
    if kind == "scattering":
        residues = [0.3 * R for R in residues]
    report = phc.passivity(modal_system(poles, residues, D), kind)
    near = (np.abs(poles)[:, None] + poles.real[:, None] * np.linspace(-6, 6, 301)).ravel()
    omega = np.unique(np.abs(np.concatenate([near, np.linspace(0, 3 * np.abs(poles).max(), 4001)])))
    least, rounding = indefinite(poles, residues, D, omega, kind == "scattering")
    inside, well_inside = np.zeros(len(omega), bool), np.zeros(len(omega), bool)
    for low, high in report.bands:
        inside |= (omega >= low * (1 - 1e-9) - 1e-12) & (omega <= high * (1 + 1e-9))
        well_inside |= (omega > low * (1 + 1e-7) + 1e-9) & (omega < high * (1 - 1e-7))
    assert not ((least < -rounding) & ~inside).any()
    assert not ((least > rounding) & well_inside).any()
    assert report.is_passive == (not report.bands)
    if report.bands:
        _, size = report.worst
        floor = 0.5 * -least.min() if kind == "immittance" else np.sqrt(1 - least.min()) - 1
        assert size >= floor * (1 - 1e-9) - rounding.max()
        assert report.margin == -size


def crosses_in_50_digits(poles, residues, D, end):
    """Whether `det(G + G^H)` changes its sign within 1e-8 of a frequency."""
    with mp.workdps(50):
        p = [mp.mpc(x) for x in poles]
        R = [mp.matrix([[mp.mpc(x) for x in row] for row in one.tolist()]) for one in residues]

        def determinant(w):
            G = mp.matrix(D.tolist())
            for pole, one in zip(p, R, strict=True):
                G += one / (1j * w - pole) + one.apply(mp.conj) / (1j * w - mp.conj(pole))
            return mp.re(mp.det(G + G.H))

        w = mp.mpf(end)
        return determinant(w * (1 - mp.mpf("1e-8"))) * determinant(w * (1 + mp.mpf("1e-8"))) < 0


@pytest.mark.slow
def test_band_ends_are_right_to_eight_digits():
    ends = 0
    for seed in range(30):
        poles, residues, D = drawn(np.random.default_rng(seed))
        report = phc.passivity(modal_system(poles, residues, D))
        inner = [end for band in report.bands for end in band if 0 < end < np.inf]
        assert all(crosses_in_50_digits(poles, residues, D, end) for end in inner), seed
        ends += len(inner)
    assert ends > 20


def test_the_scattering_example_of_the_literature():
    """Two ports, one real and one complex pole, as printed in Gustavsen's paper and the tests of scikit-rf."""
    residues = [np.array([[0.3, 0.1], [0.1, 0.4]]), np.array([[4 + 5j, 2 + 3j], [2 + 3j, 3 + 4j]])]
    system = modal_system([-1.0, -5 + 6j], residues, np.array([[0.2, 0.1], [0.1, 0.3]]))
    report = phc.passivity(system, "scattering")
    np.testing.assert_allclose(report.bands, [(4.24722, 16.43374)], rtol=2e-6)
    assert not report.is_passive and report.margin == -report.worst[1]


@pytest.mark.parametrize("kind", ["immittance", "scattering"])
def test_the_curve_is_the_least_resistance_or_the_largest_gain(kind):
    system = modal_system([-0.3 + 1j], [np.array([[0.2 - 0.1j, 0.1], [0.1, 0.3]])], 0.2 * np.eye(2))
    omega, values = phc.passivity(system, kind).curve()
    G = np.asarray(system(1j * omega)).transpose(2, 0, 1)
    parts = 0.5 * (G + G.conj().transpose(0, 2, 1))
    expected = np.linalg.norm(G, 2, axis=(1, 2)) if kind == "scattering" else np.linalg.eigvalsh(parts)[:, 0]
    np.testing.assert_allclose(values, expected, atol=1e-12)


@pytest.mark.parametrize("quality", [1e4, 1e6])
def test_a_violation_of_a_sharp_resonance_is_found_where_a_grid_misses_it(quality):
    """A resistance of 1, and a resonance at 1 rad/s of half width `w` that takes away 1.01 at its top."""
    w = 0.5 / quality
    top = 1.01
    report = phc.passivity(modal_system([-w + 1j], [np.array([[-top * w + 0j]])], np.array([[1.0]])))
    ((low, high),) = report.bands
    half = w * np.sqrt(top - 1)  # near the top the resonance is `top / (1 + x^2)`, `x` half widths away from it
    np.testing.assert_allclose([low, high], [1 - half, 1 + half], rtol=3 * w)
    np.testing.assert_allclose([high - low, *report.worst], [2 * half, 1.0, 0.01], rtol=1e-3)
    if quality > 1e5:
        assert high - low < 1.01e-7
        grid = np.linspace(0.0, 3.0, 100_001) + 1.3e-5
        assert not ((grid > low) & (grid < high)).any()


@pytest.mark.parametrize(
    ("system", "passive"),
    [
        (ct.tf([1.0], [1.0, 0.0]), True),
        (ct.tf([1.0], [1.0, 0.0, 0.0]), False),
        (ct.tf([1.0, 0.0], [1.0, 0.0, 4.0]), True),
        (ct.tf([-1.0, 0.0], [1.0, 0.0, 4.0]), False),
        (ct.tf([1.0], [1.0, 0.0, 4.0]), False),
        (ct.tf([1.0, 0.0], [1.0, 0.0, 4.0]) + ct.tf([1.0, 0.0], [1.0, 0.1, 9.0]), True),
        (ct.tf([1.0], [1.0, -1.0]), False),
        (ct.ss([], [], [], [[1.0, 2.0], [-2.0, 0.0]]), True),
        (ct.ss([], [], [], [[1.0, 2.0], [-1.0, 0.0]]), False),
        (ct.ss(phc.frenkel_kontorova(5)), True),
        (phc.frenkel_kontorova(5), True),
        (-1 * ct.ss(phc.frenkel_kontorova(5)), False),
        # the unstable part is not reached
        (ct.ss(np.diag([-1.0, 1.0]), [[1.0], [0.0]], [[1.0, 1.0]], 0.0), True),
    ],
)
def test_poles_on_the_axis_and_to_the_right_are_judged(system, passive):
    report = phc.passivity(system)
    assert report.is_passive is passive
    assert ((report.margin == 0 or passive) and (report.margin >= 0) is passive) or not passive


@pytest.mark.parametrize("coupled", [0.0, 3e-16, -3e-16, 1e-15, 1e-12])
@pytest.mark.parametrize("B", [[[1.0], [1.0]], [[1.0], [0.0]], [[0.7], [-0.3]]])
def test_a_double_pole_is_no_pole_in_the_right_half_plane(coupled, B):
    A = np.array([[-1.0, -1.108], [coupled, -1.0]])
    report = phc.passivity(ct.ss(A, B, np.transpose(B), 1.0))
    assert not len(report.unstable) and report.is_passive


def test_two_ports_may_share_a_pole_on_the_axis():
    A = np.kron(np.eye(2), [[0.0, 1.0], [-4.0, 0.0]])
    B = np.kron(np.eye(2), [[0.0], [1.0]])
    assert phc.passivity(ct.ss(A, B, B.T, 0.0)).is_passive
    assert not phc.passivity(ct.ss(A, B, np.diag([1.0, -1.0]) @ B.T, 0.0)).is_passive


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_time_and_amplitude_scale_the_answer(scale):
    poles, residues, D = drawn(np.random.default_rng(3), 2)
    plain = phc.passivity(modal_system(poles, residues, D))
    slow = phc.passivity(modal_system(np.array(poles) * scale, [R * scale for R in residues], D))
    loud = phc.passivity(modal_system(poles, [R * scale for R in residues], D * scale))
    np.testing.assert_allclose(np.ravel(slow.bands), scale * np.ravel(plain.bands), rtol=1e-9)
    np.testing.assert_allclose(np.ravel(loud.bands), np.ravel(plain.bands), rtol=1e-9)
    np.testing.assert_allclose(loud.sizes, scale * plain.sizes, rtol=1e-6)


@pytest.mark.parametrize(
    ("system", "message"),
    [
        (ct.ss([[-1.0]], [[1.0]], [[1.0]], 0.0, 0.1), "discrete time"),
        (ct.ss([[-1.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]]), "2 inputs and 1 outputs"),
        ([1.0], "list"),
    ],
)
def test_what_has_no_ports_is_refused(system, message):
    with pytest.raises(phc.StructureError, match=message):
        phc.passivity(system)


def test_the_picture_shades_the_bands():
    system = ct.tf([1.0, 1.0], [1.0, 0.2, 1.0]) + ct.tf([1.0, 0.0], [1.0, 0.01, 0.09])
    report = phc.passivity(system)
    plot = report.plot()
    assert len(plot.axes[0, 0].patches) == len(report.bands) == 1
    (line, *_) = plot.lines[0, 0]
    omega, value = line.get_data()
    np.testing.assert_allclose(value, system(1j * omega).real, rtol=1e-6, atol=1e-9)
    plt.close(plot.figure)


@pytest.mark.parametrize("seed", range(12))
def test_hidden_positions_of_rigid_bodies_are_no_reason_to_call_them_active(seed):
    """Free bodies beside oscillators and a slow dashpot, in rotated states: rounding parts the double poles at 0."""
    rng = np.random.default_rng(seed)
    bodies, ports = int(rng.integers(1, 4)), int(rng.integers(1, 3))
    rigid, nu, slow = rng.normal(size=(bodies, ports)), rng.normal(size=(4, ports)), rng.normal(size=(1, ports))
    positions = np.kron([[0, 1], [0, 0]], rng.normal(size=(bodies, bodies)))
    A = block_diag(positions, [[0, 2], [-2, 0]], [[0, 3], [-3, -0.1]], [[-1e-3]])
    nu[2] = 0
    B = np.vstack([0 * rigid, rigid, nu, slow])
    C = np.vstack([0 * rigid, rigid, nu, slow]).T
    T = np.linalg.qr(rng.normal(size=A.shape))[0]
    system = ct.ss(T @ A @ T.T, T @ B, C @ T.T, 0)
    assert phc.passivity(system).is_passive
    assert not phc.passivity(-1 * system).is_passive
