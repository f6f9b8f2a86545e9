"""The two groupoids: axioms, membership, and orbits that are the equivalence classes."""

import copy
import pickle

import control as ct
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from paper_systems import SETTINGS, cases, pair, target
from reference import EPS, dense_matrices, random_symplectic, symplectic_form

import ph_control as phc
from ph_control import PortHamiltonianGroupoid, ReducedGroupoid, act, are_isomorphic, is_morphism, star_equivalent


def close(first, second, size=1.0):
    first, second = np.asarray(first), np.asarray(second)
    return np.linalg.norm(first - second) <= 1e4 * EPS * len(first) * size * max(np.linalg.norm(first), 1e-300)


def same_system(first, second):
    return close(first.Q, second.Q) and close(first.B, second.B)


def commuting(d, v, rng):
    """Matrix that commutes with `J Dhat` and is unitary only on what the input reaches.

    A unitary matrix for each frequency, after one that scales the directions orthogonal to the weights.
    """
    n = len(d)
    nu = v[:n] + 1j * v[n:]
    A = np.zeros((n, n), complex)
    for x in set(d.tolist()):
        l = np.flatnonzero(d == x)
        U, _ = np.linalg.qr(rng.standard_normal((len(l),) * 2) + 1j * rng.standard_normal((len(l),) * 2))
        w = nu[l][:, None]
        along = w @ w.conj().T / (np.vdot(w, w).real or 1.0)
        A[np.ix_(l, l)] = U @ (along + rng.uniform(0.5, 2.0) * (np.eye(len(l)) - along))
    return np.block([[A.real, -A.imag], [A.imag, A.real]])


def reduced_arrow(d, v, rng):
    """Random arrow of the reduced groupoid from `(d, v)`."""
    return ReducedGroupoid(np.eye(len(d))[rng.permutation(len(d))], commuting(d, v, rng), d, v)


def arrow(sys, rng):
    """Random arrow of the port-Hamiltonian groupoid, symplectic only where the input reaches."""
    n = sys.n
    L = random_symplectic(n, rng, 0.3) @ np.linalg.inv(sys.S) @ commuting(np.round(sys.d, 6), sys.v, rng) @ sys.S
    return PortHamiltonianGroupoid(L, sys)


small = st.tuples(st.integers(1, 5), st.sampled_from(["decade", "repeated", "dark"]), st.integers(0, 10**6))


# --- port-Hamiltonian groupoid -----------------------------------------------------------------------------------


@SETTINGS
@given(small)
def test_the_port_hamiltonian_groupoid_has_units_inverses_and_an_associative_product(case):
    d, v, rng = pair(*case)
    f = arrow(target(d, v, random_symplectic(len(d), rng, 0.3)), rng)
    g = arrow(f.target, rng)
    h = arrow(g.target, rng)
    assert close((h @ (g @ f)).L, ((h @ g) @ f).L)
    assert (g @ f).source is f.source and same_system((g @ f).target, g.target)
    unit = PortHamiltonianGroupoid.identity
    assert np.array_equal((f @ unit(f.source)).L, f.L) and np.array_equal((unit(f.target) @ f).L, f.L)
    assert same_system(unit(f.source).target, f.source)
    back = f.inverse()
    assert same_system(back.source, f.target) and same_system(back.target, f.source)
    assert close((back @ f).L, np.eye(2 * len(d)), 10) and close((f @ back).L, np.eye(2 * len(d)), 10)


@SETTINGS
@given(small)
def test_its_arrows_are_isomorphisms_and_its_orbits_the_classes_of_sys(case):
    d, v, rng = pair(*case)
    f = arrow(target(d, v, random_symplectic(len(d), rng, 0.3)), rng)
    check = is_morphism(f.L, f.source, f.target, rtol=1e-11)
    assert check and check.injective and check.surjective
    assert are_isomorphic(f.source, f.target)
    link = PortHamiltonianGroupoid.between(f.source, f.target)
    assert close(link.target.Q, f.target.Q, 100) and close(link.target.B, f.target.B, 100)
    if case[1] == "decade":
        assert close(link.L, f.L, 1e3)  # between canonical systems there is but one


@SETTINGS
@given(small)
def test_membership_is_the_two_conditions_on_dense_matrices(case):
    d, v, rng = pair(*case)
    f = arrow(target(d, v, random_symplectic(len(d), rng, 0.3)), rng)
    J = symplectic_form(len(d))
    A, _, C = dense_matrices(f.source.Q, f.source.B)
    moved = J.T @ f.L @ J @ f.source.Q @ np.linalg.inv(f.L)
    assert close(moved, moved.T) and np.linalg.eigvalsh(moved + moved.T).min() > 0
    assert close(f.source.B, J.T @ f.L.T @ J @ f.L @ f.source.B)
    assert close(f.L @ A, J @ f.target.Q @ f.L) and close(C, f.target.B.T @ f.target.Q @ f.L)
    # for n = 1 the first condition holds for any L, the second for any B = 0
    wrong = f.L @ (np.eye(2 * len(d)) + 1e-6 * rng.standard_normal((2 * len(d),) * 2))
    assert PortHamiltonianGroupoid.is_arrow(wrong, f.source) == (not v.any())
    assert PortHamiltonianGroupoid.is_arrow(f.L, f.source)


def test_what_is_no_arrow_is_refused_with_what_was_measured():
    sys = phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0])
    two = phc.ph(np.eye(4), [1.0, 0.0, 0.0, 0.0])
    refusals = [
        (r"B differs from J\^T L\^T J L B by 7.5e-01", 2 * np.eye(2), sys),
        (r"not symmetric: off by", np.eye(4) + np.eye(4, k=1), two),
        (
            r"not positive definite: smallest eigenvalue after scaling -1",
            np.diag([1.0, -1.0]),
            phc.ph(np.eye(2), [0, 0]),
        ),
        (r"not invertible: its condition number is inf", np.zeros((2, 2)), sys),
        (r"shape \(3, 3\), expected \(2, 2\)", np.eye(3), sys),
        (r"this is a StateSpace", np.eye(2), ct.StateSpace(-1.0, 1.0, 1.0, 0.0)),
        (r"2 ports", np.eye(2), phc.ph(np.eye(2), np.eye(2))),
        (r"only positive semidefinite: 1 of 1", np.eye(2), phc.ph(np.diag([0.0, 1.0]), [0.0, 1.0])),
    ]
    for message, L, source in refusals:
        with pytest.raises(phc.StructureError, match=message):
            PortHamiltonianGroupoid(L, source)
    f, g = (
        PortHamiltonianGroupoid.identity(sys),
        PortHamiltonianGroupoid.identity(phc.ph(np.diag([4.0, 2.0]), [0.0, 1.0])),
    )
    with pytest.raises(phc.StructureError, match=r"do not compose: .* differs .* by 2.2e-01 of their size"):
        g @ f
    with pytest.raises(phc.StructureError, match=r"4 and 2 states"):
        f @ PortHamiltonianGroupoid.identity(two)
    with pytest.raises(phc.StructureError, match=r"not isomorphic: the frequencies differ"):
        PortHamiltonianGroupoid.between(sys, g.source)
    with pytest.raises(TypeError):
        f @ np.eye(2)


# --- reduced groupoid --------------------------------------------------------------------------------------------


@SETTINGS
@given(cases)
def test_the_reduced_groupoid_has_units_inverses_and_an_associative_product(case):
    d, v, rng = pair(*case)
    n = len(d)
    f = reduced_arrow(d, v, rng)
    g = reduced_arrow(*f.target, rng)
    h = reduced_arrow(*g.target, rng)
    one, other = h @ (g @ f), (h @ g) @ f
    assert np.array_equal(one.P, other.P) and close(one.A, other.A)
    assert np.array_equal((g @ f).d, f.d) and np.array_equal((g @ f).v, f.v)
    assert np.array_equal((g @ f).target[0], g.target[0]) and close((g @ f).target[1], g.target[1])
    unit = ReducedGroupoid.identity
    for same in (f @ unit(*f.source), unit(*f.target) @ f):
        assert np.array_equal(same.P, f.P) and np.array_equal(same.A, f.A)
    back = f.inverse()
    assert np.array_equal(back.target[0], d) and close(back.target[1], v)
    for loop in (back @ f, f @ back):
        assert np.array_equal(loop.P, np.eye(n)) and close(loop.A, np.eye(2 * n), 10)


@SETTINGS
@given(cases)
def test_its_orbits_are_the_classes_of_star(case):
    d, v, rng = pair(*case)
    f = reduced_arrow(d, v, rng)
    assert star_equivalent(*f.source, *f.target)
    link = ReducedGroupoid.between(*f.source, *f.target)
    assert np.array_equal(link.target[0], f.target[0]) and close(link.target[1], f.target[1])
    moved = act(rng.permutation(len(d)), rng.uniform(0, 6, len(d)), d, v)
    assert close(ReducedGroupoid.between(d, v, *moved).target[1], moved[1])
    if v.any():
        with pytest.raises(phc.StructureError, match="not equivalent: the input weights differ"):
            ReducedGroupoid.between(d, v, d, 1.1 * v)


@SETTINGS
@given(small)
def test_an_arrow_of_one_groupoid_gives_one_of_the_other(case):
    """Theorem 4.9: `L = S^{-1} diag(P, P) A S` is an arrow between the systems of two pairs."""
    d, v, rng = pair(*case)
    f = reduced_arrow(d, v, rng)
    S = random_symplectic(len(d), rng, 0.3)
    first, second = target(d, v, S), target(*f.target, S)
    L = np.linalg.inv(S) @ np.kron(np.eye(2), f.P) @ f.A @ S
    assert same_system(PortHamiltonianGroupoid(L, first).target, second)


@pytest.mark.parametrize("seed", range(5))
def test_with_source_and_target_as_printed_the_product_leaves_the_groupoid(seed):
    """Definition 4.12 calls arrows composable whose product, as it prints it, mixes modes of different frequencies."""
    rng = np.random.default_rng(seed)
    d, v = np.array([1.0, 1.0, 2.0]), rng.standard_normal(6)
    shift = np.roll(np.eye(3), 1, axis=0)
    second = ReducedGroupoid(shift, commuting(d, v, rng), d, v)
    # printed: composable if beta(arrow 2) = alpha(arrow 1), that is, if arrow 1 starts where arrow 2 ends
    first = ReducedGroupoid(shift, commuting(*second.target, rng), *second.target)
    both = np.kron(np.eye(2), first.P)
    printed = second.P @ first.P, both.T @ second.A @ both @ first.A
    generator = symplectic_form(3) @ np.diag(np.r_[first.d, first.d])
    assert np.linalg.norm(printed[1] @ generator - generator @ printed[1]) > 1e-3
    assert not ReducedGroupoid.is_arrow(*printed, *first.source)
    with pytest.raises(phc.StructureError, match="do not compose"):
        second @ first
    # by the meaning of source and target the other order composes, and the product is an arrow
    product = first @ second
    assert ReducedGroupoid.is_arrow(product.P, product.A, *second.source)
    assert close(product.target[0], first.target[0]) and close(product.target[1], first.target[1])


def test_what_is_no_reduced_arrow_is_refused_with_what_was_measured():
    d, v, I, J = [1.0, 2.0], [1.0, 0.0, 0.0, 1.0], np.eye(2), np.eye(4)
    refusals = [
        (r"A J Dhat = J Dhat A is off by", I, np.eye(4)[[1, 0, 3, 2]], d, np.zeros(4)),
        (r"A\^T Dhat A v = Dhat v is off by 7.5e-01", I, 2 * J, d, v),
        (r"not a permutation matrix of 2 modes", 2 * I, J, d, v),
        (r"not a permutation matrix", np.ones((2, 2)), J, d, v),
        (r"not a permutation matrix", np.eye(3), J, d, v),
        (r"not invertible", I, 0 * J, d, v),
        (r"A has shape \(2, 2\)", I, I, d, v),
        (r"v has shape", I, J, d, [1.0]),
    ]
    for message, P, A, *source in refusals:
        with pytest.raises(phc.StructureError, match=message):
            ReducedGroupoid(P, A, *source)
        assert not ReducedGroupoid.is_arrow(P, A, *source)
    f = ReducedGroupoid.identity(d, v)
    with pytest.raises(phc.StructureError, match=r"differs .* by 1.2e-01 of their size"):
        f @ ReducedGroupoid.identity([1.0, 2.3], v)
    with pytest.raises(phc.StructureError, match="2 and 4 states"):
        f @ ReducedGroupoid.identity([1.0], [1.0, 0.0])
    with pytest.raises(TypeError):
        f @ J


def test_arrows_cannot_be_changed():
    f = ReducedGroupoid.identity([1.0], [1.0, 0.0])
    g = PortHamiltonianGroupoid.identity(phc.ph(np.eye(2), [1.0, 0.0]))
    for frozen in (f, g):
        with pytest.raises(AttributeError):
            frozen.source = None
    for array in (f.P, f.A, f.d, f.v, *f.target, g.L):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda arrow: pickle.loads(pickle.dumps(arrow))])
def test_copies_of_arrows_cannot_be_changed_either(copied):
    f = ReducedGroupoid.identity([1.0], [1.0, 0.0])
    g = PortHamiltonianGroupoid.identity(phc.ph(np.eye(2), [1.0, 0.0]))
    first, second = copied(f), copied(g)
    for array, original in zip(
        (first.P, first.A, first.d, first.v, *first.target, second.L, second.source.Q),
        (f.P, f.A, f.d, f.v, *f.target, g.L, g.source.Q),
        strict=True,
    ):
        assert np.array_equal(array, original)
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    assert hash(first) and (second @ g).L.tolist() == np.eye(2).tolist()


# --- sizes -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("d", "v"), [(1e100, 1e100), (1e-100, 1e-100), (1e150, 1e-150), (1.0, 1e-152), (1.0, 1e152)])
def test_what_is_an_arrow_does_not_depend_on_units(d, v):
    """Warnings are errors here."""
    source = [d], [v, 0.0]
    turn = symplectic_form(1)
    sys = phc.ph(np.diag([d, d]), source[1])
    assert ReducedGroupoid.is_arrow(np.eye(1), turn, *source) and PortHamiltonianGroupoid.is_arrow(turn, sys)
    for size in (2.0, 0.5, 1 + 1e-9, 1e200, 1e-200):
        assert not ReducedGroupoid.is_arrow(np.eye(1), size * turn, *source)
        assert not PortHamiltonianGroupoid.is_arrow(size * turn, sys)
    arrow = ReducedGroupoid(np.eye(1), turn, *source)
    assert np.array_equal((arrow.inverse() @ arrow).A, np.eye(2))
    with pytest.raises(phc.StructureError, match="differs from the source of the left one by"):
        ReducedGroupoid.identity([d], [0.0, 0.9 * v]) @ arrow


def test_there_is_a_unit_at_the_system_without_states():
    unit = PortHamiltonianGroupoid.identity(phc.ph(phc.modes([], [])))
    assert unit.L.shape == (0, 0) and (unit @ unit.inverse()).target.nstates == 0
    assert ReducedGroupoid.identity([], []).target[0].shape == (0,)


@pytest.mark.parametrize("thing", [3, None, ct.tf([1.0, 0.0], [1.0, 0.0, 1.0]), np.eye(2)])
def test_there_is_no_unit_at_what_is_no_port_hamiltonian_system(thing):
    with pytest.raises(phc.StructureError, match="expected a PortHamiltonian"):
        PortHamiltonianGroupoid.identity(thing)


def test_masked_matrices_are_no_arrow():
    masked = np.ma.masked_array(np.eye(2), np.eye(2))
    assert not phc.ReducedGroupoid.is_arrow(np.ma.masked_array([[1.0]], [[True]]), np.eye(2), [1.0], [1.0, 0.0])
    assert not phc.PortHamiltonianGroupoid.is_arrow(masked, phc.frenkel_kontorova(1))
