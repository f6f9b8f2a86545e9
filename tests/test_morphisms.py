"""The matrices between canonical forms and port-Hamiltonian systems, against the paper's recursion in many digits."""

import copy
import pickle
import warnings

import control as ct
import mpmath as mp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from paper_systems import SETTINGS, SQUEEZE, cases, companion, pair, plain, target, transposed
from reference import (
    DIGITS,
    EPS,
    coefficients,
    dense_matrices,
    dense_transfer_function,
    random_hamiltonian,
    random_symplectic,
)

import ph_control as phc
from ph_control import (
    controllable_morphism,
    expressive_power,
    is_morphism,
    lift_morphism,
    observable_morphism,
)


def horner_columns(d, v):
    """`[L_1 v .. L_{2n} v]` as the paper builds it: `L_{2n-k} = A L_{2n-k+1} + a_{2n-k} I`, with 200 digits."""
    n = len(d)
    with mp.workdps(200):
        a, _ = coefficients(d, np.ones(n))
        full = [mp.mpf(0)] * (2 * n)
        full[0::2] = [mp.mpf(x.numerator) / x.denominator for x in a]
        D = [mp.mpf(float(x)) for x in d]
        L = [mp.mpf(float(x)) for x in v]
        columns = [L]
        for k in range(1, 2 * n):
            L = [D[i] * L[n + i] for i in range(n)] + [-D[i] * L[i] for i in range(n)]
            L = [x + full[2 * n - k] * mp.mpf(float(y)) for x, y in zip(L, v, strict=True)]
            columns.append(L)
        return mp.matrix([[columns[2 * n - 1 - j][i] for j in range(2 * n)] for i in range(2 * n)])


# --- CH -> PH ----------------------------------------------------------------------------------------------------


@SETTINGS
@given(cases)
def test_every_entry_of_the_controllable_morphism_is_right_to_the_last_digits(case):
    d, v, _ = pair(*case)
    truth = horner_columns(d, v)
    L = controllable_morphism(d, v)
    n = len(d)
    for i in range(2 * n):
        for j in range(2 * n):
            assert abs(L[i, j] - float(truth[i, j])) <= 4 * n * EPS * abs(float(truth[i, j]))


@SETTINGS
@given(cases, st.sampled_from([0.0, 1.0, SQUEEZE]))
def test_it_is_a_morphism_to_the_system_of_any_symplectic_matrix(case, squeeze):
    d, v, rng = pair(*case)
    n = len(d)
    S = random_symplectic(n, rng, squeeze)
    sys = target(d, v, S)
    check = is_morphism(controllable_morphism(d, v, S), plain(*companion(d, v)), sys)
    assert check.allowed == 100 * 2 * n * EPS
    assert check and check.residual <= check.allowed


def test_the_printed_version_with_the_inverse_in_place_of_s_is_no_morphism():
    """Sections 3 and 5 print `v = S^{-1} B`; the system of the proofs has `B = S^{-1} v`, so `v = S B`."""
    rng = np.random.default_rng(1)
    Q, _ = random_hamiltonian([1.0, 2.0], rng)
    sys = phc.ph(Q, rng.standard_normal(4))
    L = observable_morphism(sys)
    B = np.asarray(sys.B)[:, 0]
    assert is_morphism(L, sys, transposed(*companion(sys.d, sys.S @ B)))
    assert is_morphism(L, sys, transposed(*companion(sys.d, np.linalg.solve(sys.S, B)))).input > 1e-3


def test_the_morphism_of_a_wide_spectrum_is_small_in_the_relative_sense():
    d = np.geomspace(1e-2, 1e2, 8)
    v = np.random.default_rng(0).standard_normal(16)
    check = is_morphism(controllable_morphism(d, v), plain(*companion(d, v)), phc.ph(np.diag(np.r_[d, d]), v))
    assert check.residual <= 16 * EPS and check.rank == 16


@SETTINGS
@given(cases, st.booleans())
def test_the_residuals_see_a_change_of_any_row_or_column(case, column):
    d, v, rng = pair(*case)
    L = controllable_morphism(d, v)
    k = rng.integers(len(L))
    wrong = L.copy()
    wrong[(slice(None), k) if column else k] *= 1.1
    sys = phc.ph(np.diag(np.r_[d, d]), v)
    check = is_morphism(wrong, plain(*companion(d, v)), sys)
    assert bool(check) == np.array_equal(wrong, L)


@SETTINGS
@given(cases)
def test_it_has_an_inverse_exactly_when_the_system_is_canonical(case):
    d, v, _ = pair(*case)
    n = len(d)
    power = expressive_power(d, v)
    canonical = len(set(d.tolist())) == n and (v[:n] ** 2 + v[n:] ** 2).min() > 0
    assert power.is_full == canonical == (power.rank == 2 * n)
    with mp.workdps(300):
        determinant = mp.det(horner_columns(d, v))
        largest = mp.fprod(mp.norm(horner_columns(d, v)[:, j]) for j in range(2 * n))
        assert (abs(determinant) > largest * mp.mpf(10) ** -250) == canonical


@pytest.mark.parametrize("n", range(1, 6))
def test_the_determinant_of_the_controllability_matrix_is_the_product_of_the_paper(n):
    rng = np.random.default_rng(n)
    d, v = rng.uniform(1, 10, n), rng.standard_normal(2 * n)
    with mp.workdps(DIGITS):
        x, w = [mp.mpf(float(y)) for y in d], [mp.mpf(float(y)) for y in v]
        columns = [w]
        for _ in range(2 * n - 1):
            last = columns[-1]
            columns.append([x[i] * last[n + i] for i in range(n)] + [-x[i] * last[i] for i in range(n)])
        determinant = mp.det(mp.matrix(columns).T)
        formula = mp.fprod(x) * mp.fprod(w[i] ** 2 + w[n + i] ** 2 for i in range(n))
        formula *= mp.fprod((x[j] + x[k]) ** 2 * (x[j] - x[k]) ** 2 for k in range(n) for j in range(k))
        assert abs(abs(determinant) - formula) <= formula * mp.mpf(10) ** (-DIGITS + 20)


# --- what cannot be expressed ------------------------------------------------------------------------------------


@SETTINGS
@given(cases, st.sampled_from([0.0, 1.0]))
def test_the_missing_states_complete_the_image_and_the_output_does_not_see_them(case, squeeze):
    d, v, rng = pair(*case)
    n = len(d)
    S = random_symplectic(n, rng, squeeze)
    sys = target(d, v, S)
    power = expressive_power(d, v, S)
    L = controllable_morphism(d, v, S)
    frequencies = {x for x, y in zip(d, v[:n] ** 2 + v[n:] ** 2, strict=True) if y > 0}
    assert power.rank == 2 * len(frequencies)
    assert power.missing.shape == (2 * n, 2 * n - power.rank)
    assert power.rank == 2 * n or np.linalg.matrix_rank(power.missing) == 2 * n - power.rank
    # orthogonal in the energy to all that is reached, which the output sees
    tolerance = 100 * n * EPS * np.exp(2 * squeeze)
    sizes = np.linalg.norm(sys.Q) * np.linalg.norm(L, axis=0) * np.linalg.norm(power.missing)
    assert np.all(np.abs(power.missing.T @ sys.Q @ L) <= tolerance * sizes)


def test_dark_and_resonant_modes_are_named():
    power = expressive_power([2.0, 1.0, 2.0, 3.0], [1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert power.dark == (3,) and power.resonant == ((0, 2),) and power.rank == 4
    assert not power.is_full


def test_the_tolerance_of_resonance_and_darkness_is_the_one_of_minimal_forms():
    d, v = [1.0, 1.0 + 1e-7], [1.0, 1e-4, 0.0, 0.0]
    assert expressive_power(d, v).rank == 4 == 2 * phc.modes(d, [1.0, 1e-8]).minimal().n
    assert expressive_power(d, v, rtol=1e-6).rank == 2 == 2 * phc.modes(d, [1.0, 1e-8]).minimal(rtol=1e-6).n


# --- PH -> OH ----------------------------------------------------------------------------------------------------


@SETTINGS
@given(cases, st.sampled_from([0.0, 1.0, SQUEEZE]))
def test_the_observable_morphism_leads_to_the_observable_form(case, squeeze):
    d, v, rng = pair(*case)
    n = len(d)
    sys = target(d, v, random_symplectic(n, rng, squeeze))
    check = is_morphism(observable_morphism(sys), sys, transposed(*companion(d, v)))
    # the frequencies found in Q are known to eps cond(Q), and cond(Q) = cond(S)^2 max d / min d
    floor = EPS * np.exp(4 * squeeze) * d.max() / d.min()
    assert check.residual <= 100 * n * floor
    # to the form that was made of the same numbers it leads exactly
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", phc.ConditioningWarning)
        assert is_morphism(observable_morphism(sys), sys, phc.oh(sys))


@SETTINGS
@given(cases)
def test_its_rows_are_those_of_the_paper(case):
    d, v, _ = pair(*case)
    order = np.argsort(d, kind="stable")
    n = len(d)
    d, v = d[order], v[np.r_[order, n + order]]
    L = observable_morphism(phc.ph(np.diag(np.r_[d, d]), v))
    # row k is v^T Dhat L_k, and L_k commutes with J Dhat: its transpose has the opposite sign of J
    mirrored = horner_columns(d, np.r_[v[:n], -v[n:]])
    for k in range(2 * n):
        for i in range(2 * n):
            truth = float(mirrored[i, k]) * d[i % n] * (1 if i < n else -1)
            assert abs(L[k, i] - truth) <= 50 * n * EPS * d[i % n] * float(mp.norm(mirrored[:, k]))


def test_a_rigid_body_mode_is_observed_too():
    sys = phc.ph(np.diag([0.0, 4.0, 1.0, 1.0]), [0.0, 0.0, 1.0, 2.0])
    A = np.diag(np.ones(3), -1)
    A[:, -1] = [0, 0, -4, 0]
    # G = 1/s + 4 s/(s^2 + 4) = (5 s^3 + 4 s)/(s^4 + 4 s^2)
    oh = plain(A, np.array([[0.0], [4.0], [0.0], [5.0]]), np.eye(4)[-1:])
    check = is_morphism(observable_morphism(sys), sys, oh)
    assert check and check.rank == 3


# --- lifting and composition -------------------------------------------------------------------------------------


@SETTINGS
@given(cases, st.integers(0, 3))
def test_lifting_is_an_injective_morphism_for_any_padding(case, more):
    d, v, rng = pair(*case)
    n, m = len(d), len(d) + more
    sys = target(d, v, random_symplectic(n, rng))
    Q, B = np.zeros((2 * m, 2 * m)), np.zeros(2 * m)
    ours, padding = np.r_[0:n, m : m + n], np.r_[n:m, m + n : 2 * m]
    Q[np.ix_(ours, ours)], B[ours] = sys.Q, sys.B[:, 0]
    Q[np.ix_(padding, padding)] = random_hamiltonian(rng.uniform(20, 30, more), rng)[0]
    lifted = phc.ph(Q, B)
    L = lift_morphism(sys, m)
    check = is_morphism(L, sys, lifted)
    assert check and check.injective and check.surjective == (more == 0)
    assert np.array_equal(L.T @ L, np.eye(2 * n))


@SETTINGS
@given(cases)
def test_the_composition_of_lifting_and_observing_reaches_a_larger_observable_form(case):
    d, v, rng = pair(*case)
    n, m = len(d), len(d) + 2
    sys = target(d, v, random_symplectic(n, rng, 0.3))
    padding = 2 * d.max() * np.array([1.0, 1.5])
    Q, B = np.zeros((2 * m, 2 * m)), np.zeros(2 * m)
    ours = np.r_[0:n, m : m + n]
    Q[np.ix_(ours, ours)], B[ours] = sys.Q, sys.B[:, 0]
    Q[[n, n + 1, m + n, m + n + 1], [n, n + 1, m + n, m + n + 1]] = np.r_[padding, padding]
    lifted = phc.ph(Q, B)
    d_lifted, v_lifted = np.r_[d, padding], np.r_[v[:n], 0, 0, v[n:], 0, 0]
    oh = transposed(*companion(d_lifted, v_lifted))
    check = is_morphism(observable_morphism(lifted) @ lift_morphism(sys, m), sys, oh)
    assert check.residual <= 100 * m * EPS * np.exp(1.2) * d_lifted.max() / d_lifted.min()


# --- is_morphism -------------------------------------------------------------------------------------------------


@SETTINGS
@given(cases)
def test_the_verdict_does_not_depend_on_the_units_of_states(case):
    d, v, rng = pair(*case)
    first, second = plain(*companion(d, v)), plain(*dense_matrices(np.diag(np.r_[d, d]), v))
    L = controllable_morphism(d, v) * (1 + 1e-3 * rng.standard_normal((2 * len(d),) * 2))
    t, u = (2.0 ** rng.integers(-30, 30, 2 * len(d)) for _ in range(2))
    rescaled = [plain(s.A / w[:, None] * w, s.B / w[:, None], s.C * w) for s, w in ((first, t), (second, u))]
    one, other = is_morphism(L, first, second), is_morphism(L / u[:, None] * t, *rescaled)
    assert not one and not other
    # balancing by powers of two ends within a factor of 2 for each of the three matrices
    assert one.residual / 8 <= other.residual <= one.residual * 8


def test_each_residual_measures_its_own_condition():
    sys = phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0])
    A, B, C = (np.asarray(M) for M in (sys.A, sys.B, sys.C))
    for other, offence in (((2 * A, B, C), "dynamics"), ((A, 2 * B, C), "input"), ((A, B, 2 * C), "output")):
        check = is_morphism(np.eye(2), plain(*other), sys)
        found = {name: getattr(check, name) for name in ("dynamics", "input", "output")}
        assert found.pop(offence) > 0.1 and set(found.values()) == {0.0} and not check
    feedthrough = ct.StateSpace(A, B, C, 1.0)
    assert is_morphism(np.eye(2), feedthrough, sys).output == 1.0


def test_discrete_systems_of_the_same_step_compare():
    a, b = (ct.StateSpace([[0.5]], [[1.0]], [[1.0]], 0.0, dt) for dt in (0.1, 0.2))
    assert is_morphism([[1.0]], a, a)
    with pytest.raises(phc.StructureError, match=r"dt = 0.1 and dt = 0.2"):
        is_morphism([[1.0]], a, b)


def test_morphisms_between_systems_of_several_ports_are_measured_port_by_port():
    sys = phc.ph(np.diag([4.0, 1.0]), [[0.0, 1e-9], [1.0, 0.0]])
    wrong = phc.ph(np.diag([4.0, 1.0]), [[0.0, 2e-9], [1.0, 0.0]])
    assert is_morphism(np.eye(2), sys, sys)
    assert is_morphism(np.eye(2), sys, wrong).input > 0.1


def test_a_morphism_keeps_the_transfer_function():
    d, v, _ = pair(4, "decade", 3)
    A, B, C = companion(d, v)
    s = 0.3 + 1.7j
    G = dense_transfer_function(*dense_matrices(np.diag(np.r_[d, d]), v), s)
    assert abs(dense_transfer_function(A, B, C, s) - G) < 1e4 * EPS * abs(G)


# --- refusals ----------------------------------------------------------------------------------------------------


def test_bad_arguments_are_refused_with_what_was_measured():
    sys = phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0])
    two = phc.ph(np.diag([4.0, 1.0]), np.eye(2))
    refusals = [
        (
            r"S is not symplectic: .* = 7.5e-01, allowed 4.4e-14",
            lambda: controllable_morphism([1], [1, 0], np.eye(2) * 2),
        ),
        (r"S has shape \(3, 3\)", lambda: controllable_morphism([1], [1, 0], np.eye(3))),
        (r"v has shape \(3,\)", lambda: controllable_morphism([1], [1, 0, 2])),
        (r"one port", lambda: controllable_morphism([1], np.eye(2))),
        (r"d is not positive", lambda: controllable_morphism([-1], [1, 0])),
        (r"range of doubles", lambda: controllable_morphism([1e100, 2e100, 3e100], np.ones(6))),
        (r"2 ports, expected 1", lambda: observable_morphism(two)),
        (r"expected a PortHamiltonian", lambda: observable_morphism(ct.ss(sys))),
        (r"m is 0, .* from n to", lambda: lift_morphism(sys, 0)),
        (r"m is int, .* to 100000", lambda: lift_morphism(sys, 10**5000)),
        (r"m is 1000000, .* to 100000", lambda: phc.lift(sys, 10**6)),
        (r"m is 2.0", lambda: lift_morphism(sys, 2.0)),
        (r"expected a PortHamiltonian", lambda: lift_morphism("x", 2)),
        (r"L has shape \(2, 1\)", lambda: is_morphism([[1], [1]], sys, sys)),
        (r"must agree", lambda: is_morphism(np.eye(2), sys, two)),
        (r"TransferFunction", lambda: is_morphism(np.eye(2), ct.tf([1, 0], [1, 0, 1]), sys)),
        (r"rtol is -1", lambda: is_morphism(np.eye(2), sys, sys, rtol=-1)),
        (r"rtol is 'x'", lambda: expressive_power([1], [1, 0], rtol="x")),
    ]
    for message, call in refusals:
        with pytest.raises(phc.StructureError, match=message):
            call()


@pytest.mark.parametrize("call", [controllable_morphism, expressive_power])
def test_refusal_of_a_system_tells_where_its_parameters_are(call):
    form = phc.modes(phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0]))
    for arguments in ([form], [phc.ph(form)], [phc.ph(form), [1.0, 0.0]]):
        with pytest.raises(
            phc.StructureError, match=r"form = modes\(sys\), they are d = form\.d, and v = np\.conc"
        ) as told:
            call(*arguments)
    d, v = form.d, eval(str(told.value).split("v = ")[1], {"np": np, "form": form})
    assert expressive_power(d, v).is_full and controllable_morphism(d, v).shape == (2, 2)
    with pytest.raises(phc.StructureError, match="v is missing; pass d, of n natural frequencies, and v, of 2n"):
        call([1.0])


def test_a_system_without_states_has_empty_morphisms():
    assert controllable_morphism([], []).shape == (0, 0)
    assert expressive_power([], []).is_full


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda power: pickle.loads(pickle.dumps(power))])
def test_copies_of_an_expressive_power_cannot_be_changed_either(copied):
    power = expressive_power([1.0, 2.0], [1.0, 0.0, 0.0, 0.0])
    twin = copied(power)
    assert (twin.rank, twin.dark, twin.resonant) == (power.rank, power.dark, power.resonant)
    assert np.array_equal(twin.missing, power.missing) and hash(twin)
    with pytest.raises(ValueError, match="read-only"):
        twin.missing[...] = 0


# --- sizes -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [1e-150, 1e-100, 1e-30, 1e-8, 1e8, 1e30, 1e100, 1e150])
def test_what_is_a_morphism_does_not_depend_on_units(size):
    """Warnings are errors here."""
    for sys in (
        phc.ph(size * np.eye(2), [1.0, 0.0]),
        phc.ph(np.eye(2), [size, 0.0]),
        phc.ph(size * np.eye(2), [size, 0.0]),
        phc.ch([size], [1.0, 0.0]),
    ):
        if size not in (1e-150, 1e150) or isinstance(sys, phc.PortHamiltonian):
            assert is_morphism(np.eye(2), sys, sys) and not is_morphism((1 + 1e-9) * np.eye(2), sys, sys)


@pytest.mark.parametrize("size", [1e-8, 1e8, 1e-30, 1e30])
def test_companion_matrices_are_balanced_in_any_unit_of_time(size):
    """Warnings are errors here; the entries span the fourth power of the unit."""
    sys = phc.ch([size, 2 * size], np.ones(4))
    assert is_morphism(np.eye(4), sys, sys) and not is_morphism(np.diag([1, 1, 1, 1 + 1e-9]), sys, sys)


def test_products_beyond_the_range_of_doubles_are_refused():
    sys = phc.ph(1e100 * np.eye(2), [1.0, 0.0])
    with pytest.raises(phc.StructureError, match="products of L and these systems leave the range"):
        is_morphism(1e250 * np.eye(2), sys, sys)


@pytest.mark.parametrize(("d", "v"), [(1e-200, 1e-100), (1e150, 1e150), (1e-150, 1e-150), (1e150, 1e-150)])
def test_a_weight_in_small_units_is_not_taken_for_a_dark_mode(d, v):
    for rtol in (None, 1e-3):
        assert expressive_power([d, 2 * d], [v, 0.5 * v, 0.0, 0.0], rtol=rtol).is_full
        assert expressive_power([d, 2 * d], [v, 0.0, 0.0, 0.0], rtol=rtol).dark == (1,)
    assert expressive_power([1.0, 2.0], [1e-200, 1.0, 0.0, 0.0]).is_full


def test_the_smallest_input_weight_that_is_not_0_is_reached():
    power = phc.expressive_power([1.0, 2.0], [0.5, 5e-324, 1.0, 0.0])
    assert power.is_full and power.rank == 4
