"""General constant structure: Darboux coordinates, the normal form in them, Casimirs split off."""

import copy
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import EPS, symplectic_form
from scipy.linalg import expm

import ph_control as phc
from ph_control import CasimirSplit, darboux, split_casimirs

quick = settings(deadline=None, max_examples=30, derandomize=True)
seeds = st.integers(0, 2**32 - 1)


def skew(sigma, kernel, rng):
    """Random skew matrix with singular values `sigma`, each twice, and a kernel of a given dimension."""
    size = 2 * len(sigma) + kernel
    U, _ = np.linalg.qr(rng.standard_normal((size, size)))
    core = np.zeros((size, size))
    for k, value in enumerate(sigma):
        core[2 * k, 2 * k + 1], core[2 * k + 1, 2 * k] = value, -value
    J = U @ core @ U.T
    return 0.5 * (J - J.T), U[:, 2 * len(sigma) :]


def positive(size, rng, rank=None):
    F = rng.standard_normal((size, size if rank is None else rank))
    return F @ F.T


def transfer(J, Q, B, s):
    B = np.asarray(B, float).reshape(len(Q), -1)
    return B.T @ Q @ np.linalg.solve(s * np.eye(len(Q)) - J @ Q, B.astype(complex))


def largest_difference(J, Q, B, new_Q, new_B, points=(1.0 + 0.5j, 3j + 0.2, 5.0)):
    """Of two transfer functions, relative to the size of the first."""
    new_J = symplectic_form(len(new_Q) // 2)
    worst = 0.0
    for s in points:
        truth, found = transfer(J, Q, B, s), transfer(new_J, new_Q, new_B, s)
        worst = max(worst, np.max(np.abs(found - truth)) / np.max(np.abs(truth)))
    return worst


# --- Darboux ---


@quick
@given(st.integers(1, 8), st.floats(0, 8), st.sampled_from([1e-150, 1e-9, 1.0, 1e9, 1e140]), seeds)
def test_any_invertible_skew_matrix_becomes_canonical_by_a_matrix_of_the_least_condition(n, decades, scale, seed):
    rng = np.random.default_rng(seed)
    J = scale * skew(10 ** rng.uniform(0, decades, n), 0, rng)[0]
    original = J.copy()
    T = darboux(J)
    condition = np.linalg.cond(J)
    assert np.max(np.abs(T @ J @ T.T - symplectic_form(n))) < 20 * n * EPS * condition
    # ||T||^2 ||J|| >= 1 and likewise for the inverses: no T has a condition below the root of that of J
    assert np.linalg.cond(T) < 1.01 * np.sqrt(condition)
    assert np.array_equal(J, original)


@pytest.mark.parametrize("n", [1, 2, 5])
def test_the_canonical_form_is_left_alone(n):
    assert np.array_equal(darboux(symplectic_form(n)), np.eye(2 * n))


def test_uncoupled_planes_of_far_apart_sizes_do_not_make_a_matrix_singular():
    J = np.zeros((4, 4))
    J[0, 2], J[2, 0], J[1, 3], J[3, 1] = 1e-30, -1e-30, 1e30, -1e30
    T = darboux(J)
    assert np.max(np.abs(T @ J @ T.T - symplectic_form(2))) < 8 * EPS


def test_singular_is_decided_relative_to_the_largest_singular_value():
    # coupled, so that the two planes are one group
    U, _ = np.linalg.qr(np.random.default_rng(0).standard_normal((4, 4)))
    bound = 8 * 4 * EPS
    for ratio, accepted in ((30 * bound, True), (bound / 30, False)):
        core = np.zeros((4, 4))
        core[0, 1], core[1, 0], core[2, 3], core[3, 2] = 1.0, -1.0, ratio, -ratio
        J = 1e-20 * U @ core @ U.T
        J = 0.5 * (J - J.T)
        if accepted:
            assert np.all(np.isfinite(darboux(J)))
        else:
            with pytest.raises(phc.StructureError, match="rank 2 of 4, kernel of dimension 2"):
                darboux(J)


@pytest.mark.parametrize(
    ("J", "message"),
    [
        (np.ones((2, 3)), r"J is not square: its shape is \(2, 3\)"),
        (np.eye(2), r"not skew-symmetric: .* = 2\.0e\+00, allowed 4\.4e-13; .*dissipation"),
        ([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]], "from 0 to 1 .*rank 2 of 3, kernel of dimension 1: "),
        (np.zeros((2, 2)), "rank 0 of 2, kernel of dimension 2"),
        ([[0.0, np.inf], [-np.inf, 0.0]], "J is not finite"),
        (1j * np.eye(2), "J is complex"),
    ],
)  # fmt: skip
def test_what_has_no_darboux_coordinates_is_refused_with_what_was_measured(J, message):
    with pytest.raises(phc.StructureError, match=message):
        darboux(J)


def test_skewness_is_decided_relative_to_the_size_of_the_matrix():
    for scale in (1e-100, 1.0, 1e100):
        allowed = 1000 * 2 * EPS
        darboux(scale * np.array([[0.0, 1.0], [-1.0 + 0.9 * allowed, 0.0]]))
        with pytest.raises(phc.StructureError, match="not skew"):
            darboux(scale * np.array([[0.0, 1.0], [-1.0 + 1.1 * allowed, 0.0]]))


# --- the normal form ---


def in_normal_form(Q, B, J):
    """Matrices of the system in Darboux coordinates."""
    system = phc.ph(Q, B, J=J)
    return system.Q, system.B


@quick
@given(st.integers(1, 6), st.floats(0, 4), st.integers(1, 3), seeds)
def test_the_normal_form_has_the_transfer_function_of_the_original_structure(n, decades, ports, seed):
    rng = np.random.default_rng(seed)
    J, _ = skew(10 ** rng.uniform(0, decades, n), 0, rng)
    Q, B = positive(2 * n, rng), rng.standard_normal((2 * n, ports))
    (new_Q, new_B), T = in_normal_form(Q, B, J), darboux(J)
    assert np.array_equal(new_Q, new_Q.T)
    assert np.max(np.abs(T.T @ new_Q @ T - Q)) < 100 * n * EPS * np.linalg.norm(Q, 2) * np.linalg.cond(T) ** 2
    assert np.max(np.abs(new_B - T @ B)) == 0
    points = np.linalg.norm(J @ Q, 2) * np.array([1.0 + 0.5j, 0.3 + 0.1j])
    assert largest_difference(J, Q, B, new_Q, new_B, points) < 1e3 * n * EPS * np.linalg.cond(T) ** 2


def test_a_charged_mass_in_a_magnetic_field_turns_at_the_cyclotron_frequency():
    # kinetic momenta do not commute: {p_x, p_y} = charge * field
    field, mass = 3.0, 2.0
    J = symplectic_form(2) + np.pad([[0.0, field], [-field, 0.0]], ((2, 0), (2, 0)))
    Q = np.diag([0.0, 0.0, 1 / mass, 1 / mass])
    sys = phc.ph(Q, [0.0, 0.0, 1.0, 0.0], J=J)
    assert np.max(np.abs(sys.d - [field / mass])) < 8 * EPS
    s = 0.7 + 0.2j
    assert abs(sys(s) - (s / mass) / (s**2 + (field / mass) ** 2)) < 16 * EPS


def test_a_singular_structure_has_no_normal_form_of_its_own_size():
    with pytest.raises(phc.StructureError, match=r"split_casimirs\(Q, B, J\)"):
        in_normal_form(np.eye(2), [0.0, 1.0], np.zeros((2, 2)))


@pytest.mark.parametrize("call", [in_normal_form, split_casimirs])
@pytest.mark.parametrize(
    ("Q", "B", "message"),
    [
        (np.eye(3), [0.0, 1.0], r"Q has shape \(3, 3\); with J of shape \(2, 2\) it must be the same"),
        (np.eye(2), [1.0], r"B has shape \(1,\)"),
        ([[1.0, 0.1], [0.0, 1.0]], [1.0, 0.0], "Q is not symmetric"),
        (-np.eye(2), [1.0, 0.0], "Q is indefinite"),
    ],
)
def test_matrices_that_do_not_fit_are_refused(call, Q, B, message):
    with pytest.raises(phc.StructureError, match=message):
        call(Q, B, symplectic_form(1))


# --- Casimirs ---


@quick
@given(st.integers(0, 4), st.integers(0, 4), st.integers(1, 3), st.booleans(), seeds)
def test_a_system_without_its_casimirs_has_the_same_transfer_function(n, kernel, ports, blind, seed):
    if n + kernel == 0:
        return
    rng = np.random.default_rng(seed)
    J, K = skew(rng.uniform(0.5, 3.0, n), kernel, rng)
    size = len(J)
    Q, B = positive(size, rng), rng.standard_normal((size, ports))
    if blind:
        B = B - K @ (K.T @ B)
        if n == 0:
            return
    split = split_casimirs(Q, B, J)
    assert (split.rank, split.casimirs.shape, split.driven.shape) == (2 * n, (kernel, size), (kernel,))
    driven = 0 if blind else min(kernel, ports)
    assert np.array_equal(split.driven, np.arange(kernel) < driven)
    assert split.Q.shape == (2 * (n + driven),) * 2
    assert np.array_equal(split.Q, split.Q.T)
    # Casimirs: orthonormal, in the kernel, and the ones not driven meet no port
    scale = 50 * size * EPS
    assert np.max(np.abs(split.casimirs @ J), initial=0.0) < scale * np.max(np.abs(J), initial=1.0)
    assert np.max(np.abs(split.casimirs @ split.casimirs.T - np.eye(kernel)), initial=0.0) < scale
    assert np.max(np.abs(split.casimirs[driven:] @ B), initial=0.0) < scale * np.max(np.abs(B))
    # structure of the new coordinates
    half = np.zeros_like(split.T @ J @ split.T.T)
    m = n + driven
    for l in range(n):
        half[l, m + l], half[m + l, l] = 1.0, -1.0
    assert np.max(np.abs(split.T @ J @ split.T.T - half), initial=0.0) < 20 * scale
    assert np.max(np.abs(split.B - split.T @ B)) == 0
    points = (1.0 + max(1.0, np.linalg.norm(J @ Q, 2))) * np.array([1.0 + 0.5j, 0.3 + 0.1j])
    assert largest_difference(J, Q, B, split.Q, split.B, points) < 1e4 * size * EPS
    # and it is a port-Hamiltonian system like any other
    sys = phc.ph(split.Q, split.B)
    truth = transfer(J, Q, B, points[0])
    assert np.max(np.abs(sys.horner(points[0])[:, :, 0] - truth)) < 1e4 * size * EPS * np.max(np.abs(truth))


def test_the_motion_of_the_original_conserves_the_casimirs_that_are_not_driven_and_no_other():
    rng = np.random.default_rng(7)
    J, _ = skew([1.0, 2.0], 3, rng)
    Q, B = positive(7, rng), rng.standard_normal((7, 1))
    split = split_casimirs(Q, B, J)
    assert split.driven.tolist() == [True, False, False]
    z0, u = rng.standard_normal(7), 1.5
    # an affine motion: exponentiate the system with the constant input as a state
    full = np.zeros((8, 8))
    full[:7, :7], full[:7, 7] = J @ Q, B[:, 0] * u
    z = (expm(0.3 * full) @ np.r_[z0, 1.0])[:7]
    change = split.casimirs @ (z - z0)
    assert np.max(np.abs(change[1:])) < 1e3 * EPS * np.linalg.norm(z)
    # c' = B_c u, whatever the energy
    assert abs(change[0] - 0.3 * u * (split.casimirs[0] @ B)[0]) < 1e3 * EPS * np.linalg.norm(z)
    assert abs(change[0]) > 0.01


def test_a_driven_casimir_adds_a_cyclic_degree_of_freedom_and_a_pole_at_zero():
    J = np.zeros((3, 3))
    J[0, 1], J[1, 0] = 1.0, -1.0
    Q = np.diag([4.0, 1.0, 2.0])
    split = split_casimirs(Q, [0.0, 1.0, 1.0], J)
    sys = phc.ph(split.Q, split.B)
    assert np.max(np.abs(sys.d - [2.0])) < 8 * EPS
    s = 0.3 + 1j
    assert abs(sys(s) - (s / (s**2 + 4) + 2 / s)) < 32 * EPS  # the Casimir's energy c^2, its rate u


def test_the_report_says_what_was_split_off_and_what_became_of_it():
    J = np.zeros((4, 4))
    J[0, 1], J[1, 0] = 1.0, -1.0
    split = split_casimirs(np.eye(4), [0.0, 1.0, 3.0, -4.0], J)
    assert str(split) == split.report()
    first, driven, still, last = split.report().splitlines()
    assert first == "structure matrix of size 4 and rank 2: 1 degree of freedom and 2 Casimirs"
    assert driven.startswith("c_1 = ") and "0.6 z_3" in driven and "0.8 z_4" in driven
    assert driven.endswith("driven by the ports; it becomes the momentum of an added cyclic position")
    assert still.startswith("c_2 = ") and still.endswith("it keeps its initial value, set to 0")
    assert last == "port-Hamiltonian system with 2 degrees of freedom"


def test_a_split_cannot_be_changed():
    split = split_casimirs(np.eye(3), np.ones(3), np.zeros((3, 3)))
    assert isinstance(split, CasimirSplit)
    for array in (split.Q, split.B, split.T, split.casimirs, split.driven):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    with pytest.raises(AttributeError):
        split.rank = 2


def test_an_invertible_structure_has_nothing_to_split_off():
    rng = np.random.default_rng(2)
    J, _ = skew([1.0, 3.0], 0, rng)
    Q, B = positive(4, rng), rng.standard_normal(4)
    split = split_casimirs(Q, B, J)
    for found, expected in zip((split.Q, split.B, split.T), (*in_normal_form(Q, B, J), darboux(J)), strict=True):
        # the same products, in another order on some machines
        assert np.abs(found - expected).max() <= 20 * EPS * np.abs(expected).max()
    assert "0 Casimirs" in split.report()


@pytest.mark.parametrize("size", [1e-100, 1.0, 1e100])
def test_the_size_of_a_port_does_not_decide_whether_it_drives(size):
    assert split_casimirs(np.eye(3), size * np.array([1.0, 0.0, 1e-3]), skew_plane()).driven.all()
    # in coupled variables the kernel is known up to rounding
    J, K = skew([1.0], 1, np.random.default_rng(3))
    blind = np.linalg.qr(K, mode="complete")[0][:, 1]
    assert not split_casimirs(np.eye(3), size * (blind + EPS * K[:, 0]), J).driven.any()
    assert split_casimirs(np.eye(3), size * (blind + 1e3 * EPS * K[:, 0]), J).driven.all()


@pytest.mark.parametrize("x", [1e-3, 1e-18, 1e-60])
def test_the_unit_of_a_casimir_does_not_decide_whether_it_is_driven(x):
    """`c = z_3` in units such that its input is x and its energy `(c / x)^2 / 2`: the same system for every x."""
    split = split_casimirs(np.diag([1.0, 1.0, 1 / x**2]), [0.0, 1.0, x], skew_plane())
    assert split.driven.tolist() == [True]
    s = 0.3 + 1j
    assert abs(phc.ph(split.Q, split.B)(s) - (s / (s**2 + 1) + 1 / s)) < 32 * EPS


def test_casimirs_of_far_apart_units_are_parted_into_driven_and_still_ones():
    x = 1e-18
    # three uncoupled Casimirs, two ports, one combination left alone: k with k @ B = 0
    B = np.array([[1.0, 1.0], [x, 2 * x], [0.0, x], [0.0, 0.0]])
    split = split_casimirs(np.eye(4), B, np.zeros((4, 4)))
    assert split.driven.tolist() == [True, True, False, False]
    rows = split.casimirs
    assert np.max(np.abs(rows @ rows.T - np.eye(4))) < 32 * EPS
    assert np.max(np.abs(rows[2:] @ B)) <= 32 * EPS
    # the combinations that B leaves alone
    assert np.max(np.abs(rows[:2] @ np.array([[0.0, 1.0, -1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]).T)) <= 32 * EPS
    one = split_casimirs(np.diag([1.0, 1 / x**2]), [1.0, x], np.zeros((2, 2)))
    assert one.driven.tolist() == [True, False] and abs(one.casimirs[1] @ [1.0, x]) <= 8 * EPS * x
    # both store as much energy: G = 1/s + 1/s
    assert abs(phc.ph(one.Q, one.B)(2.0) - 1.0) < 32 * EPS


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda split: pickle.loads(pickle.dumps(split))])
def test_copies_of_a_split_cannot_be_changed_either(copied):
    split = split_casimirs(np.eye(3), np.ones(3), np.zeros((3, 3)))
    twin = copied(split)
    for name in ("Q", "B", "T", "casimirs", "driven"):
        assert np.array_equal(getattr(twin, name), getattr(split, name))
        with pytest.raises(ValueError, match="read-only"):
            getattr(twin, name)[...] = 0
    assert twin.rank == split.rank and hash(twin)


def skew_plane():
    J = np.zeros((3, 3))
    J[0, 1], J[1, 0] = 1.0, -1.0
    return J
