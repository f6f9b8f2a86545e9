"""Gyroscopic structures against their equations of motion, and what is neither gyroscopic nor an energy."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

import ph_control as phc

POINTS = (0.2 + 0.7j, 0.05 + 3j, 1.5)


def drawn(n, seed, *, spin=1.0):
    """Matrices M, C, G, K of a structure of n degrees of freedom with all kinds of forces but circulatory ones."""
    rng = np.random.default_rng(seed)
    root, stiff, loss, skew = (rng.standard_normal((n, n)) for _ in range(4))
    M, K = root @ root.T + n * np.eye(n), stiff @ stiff.T + np.eye(n)
    return M, 0.2 * loss @ loss.T, spin * (skew - skew.T), K


def motion(M, D, K, F, s):
    return np.linalg.solve(s**2 * M + s * D + K, F.astype(complex))


def whirling(M, G, K):
    """Positive imaginary parts of the roots of `det(s^2 M + s G + K)`."""
    n = len(M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, G)]])
    roots = np.linalg.eigvals(A)
    return np.sort(roots.imag[roots.imag > 0])


@settings(max_examples=15, deadline=None)
@given(st.integers(1, 6), st.sampled_from([1e-3, 1.0, 10.0]), st.integers(0, 10**6))
def test_a_gyroscopic_structure_is_lossless_with_its_whirling_frequencies(n, spin, seed):
    M, _, G, K = drawn(n, seed, spin=spin)
    F = np.eye(n)[:, :1]
    sys = phc.from_second_order(M, K, F, G=G)
    assert type(sys) is phc.PortHamiltonian and sys.is_lossless
    frequencies = whirling(M, G, K)
    np.testing.assert_allclose(sys.d, frequencies, rtol=0, atol=1e-11 * frequencies[-1])
    for s in POINTS:
        wanted = s * F.T @ motion(M, G, K, F, s)
        np.testing.assert_allclose(sys.horner(s)[:, :, 0], wanted, rtol=1e-9)


@settings(max_examples=15, deadline=None)
@given(st.integers(1, 6), st.booleans(), st.integers(0, 10**6))
def test_damping_and_sensors_of_a_gyroscopic_structure_are_those_of_its_equations(n, damped, seed):
    M, C, G, K = drawn(n, seed)
    rng = np.random.default_rng(seed)
    F = rng.standard_normal((n, 2))
    rows = {kind: rng.standard_normal((2, n)) for kind in ("acceleration", "position", "velocity")}
    sys = phc.from_second_order(M, K, F, C=C if damped else None, G=G, sensors=rows)
    D = C + G if damped else G
    factor = {"position": 0, "velocity": 1, "acceleration": 2}
    np.testing.assert_array_equal(sys.J[n:, n:], -G)
    for s in POINTS:
        q = motion(M, D, K, F, s)
        wanted = np.vstack([s * F.T @ q, *(s ** factor[kind] * part @ q for kind, part in rows.items())])
        np.testing.assert_allclose(sys.horner(s)[:, :, 0], wanted, rtol=0, atol=1e-9 * np.abs(wanted).max())


def chain(n):
    """Two bending planes of a shaft of n disks, coupled by their spin."""
    line = 2 * sparse.eye_array(n) - sparse.eye_array(n, k=1) - sparse.eye_array(n, k=-1)
    K = sparse.block_diag([line, 1.1 * line], format="csc")
    spin = sparse.diags_array(np.linspace(0.5, 1.0, n))
    G = sparse.block_array([[None, spin], [-spin, None]], format="csc")
    F = np.zeros((2 * n, 1))
    F[n // 3] = 1.0
    return sparse.eye_array(2 * n, format="csc"), K, G, F


@pytest.mark.parametrize("damped", [False, True])
def test_all_modes_of_a_sparse_gyroscopic_structure_are_the_whole_of_it(damped):
    M, K, G, F = chain(12)
    C = 0.01 * K if damped else None
    few = phc.from_second_order(M, K, F, C=C, G=G, modes=24)
    for s in POINTS:
        D = (G + C if damped else G).toarray()
        wanted = s * F.T @ motion(M.toarray(), D, K.toarray(), F, s)
        np.testing.assert_allclose(few.horner(s)[:, :, 0], wanted, rtol=1e-9)


def test_low_modes_of_a_gyroscopic_structure_have_its_low_frequencies_and_static_response():
    M, K, G, F = chain(150)
    slow = phc.from_second_order(M, K, F, G=0.02 * G, modes=40)
    exact = whirling(M.toarray(), 0.02 * G.toarray(), K.toarray())
    np.testing.assert_allclose(slow.d[:6], exact[:6], rtol=1e-4)
    # at low frequency the velocity is that of the compliance
    s = 1e-7j
    compliance = (F.T @ sparse.linalg.spsolve(K, F)).item()
    np.testing.assert_allclose(slow(s) / s, compliance, rtol=1e-8)


def test_a_spinning_body_without_springs_precesses():
    # masses in a plane under a magnetic field: circles of frequency g / m, about any place
    m, g = 2.0, 3.0
    body = phc.from_second_order(m * np.eye(2), np.zeros((2, 2)), [1.0, 0.0], G=[[0.0, g], [-g, 0.0]])
    np.testing.assert_allclose(body.d, [g / m])
    s = 0.3 + 1j
    np.testing.assert_allclose(body(s), (m * s / ((m * s) ** 2 + g**2)), rtol=1e-12)


def test_motions_without_mass_take_no_gyroscopic_force():
    M, K = np.diag([1.0, 1.0, 0.0]), 3 * np.eye(3) - np.ones((3, 3))
    G = np.zeros((3, 3))
    G[0, 1], G[1, 0] = 0.4, -0.4
    sys = phc.from_second_order(M, K, [1.0, 0, 0], G=G, condense=True)
    s = 0.2 + 1j
    wanted = s * motion(M, G, K, np.eye(3)[:, :1], s)[0, 0]
    np.testing.assert_allclose(sys(s), wanted, rtol=1e-12)
    G[1, 2], G[2, 1] = 0.1, -0.1
    for options in ({}, {"modes": 2}):
        with pytest.raises(phc.StructureError, match="act on degrees of freedom without mass"):
            phc.from_second_order(M, K, [1.0, 0, 0], G=G, condense=True, **options)


@pytest.mark.parametrize("options", [{}, {"modes": 1}])
@pytest.mark.parametrize(
    "G, message",
    [
        ([[0.0, 1.0], [1.0, 0.0]], r"G is not skew-symmetric: .* = 2\.0e\+00, allowed .*; pass \(G - G.T\)/2"),
        ([[0.1, 1.0], [-1.0, 0.0]], "G is not skew-symmetric"),
        (np.zeros((3, 3)), r"G has shape \(3, 3\)"),
        (np.nan * np.eye(2), "G is not finite|entries of G|G "),
    ],
)
def test_what_is_no_gyroscopic_matrix_is_refused(G, message, options):
    with pytest.raises(phc.StructureError, match=message):
        phc.from_second_order(np.eye(2), np.eye(2), [1.0, 0.0], G=G, **options)


def test_without_spin_a_structure_is_what_it_was():
    plain = phc.from_second_order(np.eye(2), 2 * np.eye(2), [1.0, 0.0])
    same = phc.from_second_order(np.eye(2), 2 * np.eye(2), [1.0, 0.0], G=np.zeros((2, 2)))
    np.testing.assert_array_equal(plain.Q, same.Q)
    few = phc.from_second_order(np.eye(2), 2 * np.eye(2), [1.0, 0.0], G=np.zeros((2, 2)), modes=2)
    assert few.is_lossless and few.n == 2


@pytest.mark.parametrize("options", [{}, {"modes": 1}])
def test_a_skew_part_of_stiffness_is_called_circulatory_and_closed_as_a_loop(options):
    M, C, _, K = drawn(3, 5)
    skew = np.array([[0.0, 0.8, -0.3], [-0.8, 0.0, 0.5], [0.3, -0.5, 0.0]])
    with pytest.raises(phc.StructureError, match=r"K is not symmetric: .*circulatory .*\(K \+ K\.T\)/2 .*feedback"):
        phc.from_second_order(M, K + skew, np.eye(3), C=C, **options)
    # what the message says to do
    sys = phc.from_second_order(M, K, np.eye(3), C=C, sensors={"position": np.eye(3)})
    closed = ct.feedback(ct.ss(sys), np.hstack([np.zeros((3, 3)), skew]))
    for s in POINTS:
        wanted = motion(M, C, K + skew, np.eye(3), s)
        np.testing.assert_allclose(closed(s)[3:], wanted, rtol=0, atol=1e-10 * np.abs(wanted).max())


@pytest.mark.parametrize("options", [{}, {"modes": 1}])
def test_a_skew_part_of_damping_is_passed_as_the_message_says(options):
    M, C, G, K = drawn(3, 6)
    both = C + G
    with pytest.raises(phc.StructureError, match=r"a skew part is gyroscopic: pass it as G=\(C - C.T\)/2"):
        phc.from_second_order(M, K, np.eye(3), C=both, **options)
    phc.from_second_order(M, K, np.eye(3), C=(both + both.T) / 2, G=(both - both.T) / 2, **options)
