"""Canonical forms: companion matrices as the paper has them, responses without them, transfer functions."""

import copy
import itertools
import pickle
import warnings

import control as ct
import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import EPS, dense_transfer_function, on_axis, random_hamiltonian, random_symplectic

import ph_control as phc

relaxed = settings(deadline=None, max_examples=15, derandomize=True)
SPECTRA = {
    "decade": lambda n: np.logspace(0, 1, n),
    "wide 1e4": lambda n: np.logspace(-2, 2, n),
    "clustered 1e-6": lambda n: 1 + 1e-6 * np.arange(n),
    "repeated": lambda n: 1.0 + np.arange(n) // 2,
    "slow": lambda n: 1e-9 * np.arange(1, n + 1),
    "fast": lambda n: 1e9 * np.arange(1, n + 1),
}


@st.composite
def parameters(draw, spectra=tuple(SPECTRA), most=8):
    """`(d, v)` in random order, some modes without weight."""
    n = draw(st.integers(1, most))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    d = rng.permutation(SPECTRA[draw(st.sampled_from(spectra))](n))
    v = rng.standard_normal(2 * n)
    dead = rng.random(n) < draw(st.sampled_from([0.0, 0.3]))
    v[np.r_[dead, dead]] = 0.0
    return d, v


@pytest.fixture(autouse=True)
def _quiet():
    """Companion matrices of close frequencies are looked at here on purpose."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", phc.ConditioningWarning)
        yield


def printed_form(d, v):
    """`g1` and `g2` as the definition of the paper has them, with many digits and without structure."""
    n = len(d)
    with mp.workdps(40):
        squares = [mp.mpf(x) ** 2 for x in d.tolist()]
        r = [mp.mpf(a) ** 2 + mp.mpf(b) ** 2 for a, b in zip(v[:n].tolist(), v[n:].tolist(), strict=True)]

        def elementary(values, k):
            return mp.fsum(mp.fprod(part) for part in itertools.combinations(values, k))

        a = [mp.mpf(0)] * (2 * n)
        a[0::2] = [elementary(squares, n - k) for k in range(n)]
        c = [
            mp.fsum(mp.mpf(d[l]) * r[l] * elementary(squares[:l] + squares[l + 1 :], k) for l in range(n))
            for k in range(n)
        ]
        g1 = np.diag(np.ones(2 * n - 1), 1)
        g1[-1] = [-float(x) for x in a]
        g2 = np.zeros(2 * n)
        g2[1::2] = [float(x) for x in c[::-1]]
        return g1, g2


# --- the matrices --------------------------------------------------------------------------------------------------


@relaxed
@given(parameters(most=6))
def test_the_matrices_are_those_of_the_definition(pair):
    d, v = pair
    g1, g2 = printed_form(d, v)
    unit = np.eye(2 * len(d))[-1]
    c, o = phc.ch(d, v), phc.oh(d, v)
    for found, truth in (
        (c.A, g1), (c.B[:, 0], unit), (c.C[0], g2), (o.A, g1.T), (o.B[:, 0], g2), (o.C[0], unit),
    ):  # fmt: skip
        assert np.all(np.abs(found - truth) <= 16 * EPS * np.abs(truth))
    assert not c.D.any() and not c.a[1::2].any()


@relaxed
@given(parameters(("decade", "wide 1e4")))
def test_the_transfer_function_is_that_of_the_port_hamiltonian_system(pair):
    d, v = pair
    s = np.array([0.3 + 1j, -2.0 + 0.1j, 5.0])
    A, B, C = np.block([[0 * np.diag(d), np.diag(d)], [-np.diag(d), 0 * np.diag(d)]]), v[:, None], np.r_[d, d] * v
    truth = np.array([dense_transfer_function(A, B, C[None, :], x)[0, 0] for x in s])
    for system in (phc.ch(d, v), phc.oh(d, v)):
        assert np.max(np.abs(system(s) - truth)) <= 1e3 * EPS * (1 + np.max(np.abs(truth)))


@relaxed
@given(parameters())
def test_the_frequency_response_never_sees_the_companion_matrix(pair):
    d, v = pair
    n = len(d)
    w = np.r_[0.37, 1.1, 2.3, 7.7] * np.median(d)
    truth = on_axis(d, v[:n] ** 2 + v[n:] ** 2, w)
    for system in (phc.ch(d, v), phc.oh(d, v)):
        values = system(1j * w).imag
        for found, exact in zip(values.tolist(), truth, strict=True):
            assert abs(found - float(exact)) <= 64 * EPS * abs(float(exact))
        assert not system._views.keys() & {"A", "B", "C"}


def test_poles_and_zeros_are_those_of_all_modes():
    d, v = np.array([3.0, 1.0, 1.0, 2.0]), np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    sys = phc.ch(d, v)
    assert np.array_equal(np.sort(sys.poles().imag), [-3, -2, -1, -1, 1, 1, 2, 3])
    # one for the mode without weight, one for the second of two that are equal
    assert {1.0, 2.0} <= set(sys.zeros().imag)


@relaxed
@given(parameters(("decade", "wide 1e4", "clustered 1e-6"), most=4), st.integers(0, 99))
def test_the_image_in_any_symplectic_coordinates_has_the_same_transfer_function(pair, seed):
    d, v = pair
    S = random_symplectic(len(d), np.random.default_rng(seed), squeeze=2.0)
    sys = phc.ch(d, v)
    image = sys.port_hamiltonian(S)
    assert image.n == sys.n
    assert np.max(np.abs(S.T @ np.diag(np.r_[d, d]) @ S - image.Q)) <= 64 * EPS * np.abs(image.Q).max()
    assert np.max(np.abs(S @ image.B[:, 0] - v)) <= 256 * EPS * np.linalg.norm(S) ** 2 * np.linalg.norm(v)
    s = 1j * np.median(d) * 0.77
    assert abs(image([s])[0] - sys([s])[0]) <= 1e4 * len(d) * EPS * np.linalg.norm(S) ** 4 * (1 + abs(sys([s])[0]))


def test_the_image_needs_a_symplectic_matrix():
    with pytest.raises(phc.StructureError, match=r"S is not symplectic: max \|S\^T J S - J\| .* = 7.5e-01, allowed"):
        phc.ch(1.0, [1.0, 0.0]).port_hamiltonian(2 * np.eye(2))


# --- from systems and back -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [1, 2, 5, 20, 100, 200])
def test_the_filter_survives_the_way_through_all_forms(n):
    rng = np.random.default_rng(n)
    d = np.cumsum(rng.uniform(0.5, 1.5, n))
    Q, _ = random_hamiltonian(d, rng, squeeze=0.5)
    first = phc.ph(Q, rng.standard_normal(2 * n))
    last = phc.ph(phc.oh(phc.ph(phc.ch(first))))
    w = np.sqrt(first.d[:-1] * first.d[1:]) if n > 1 else np.array([0.7 * first.d[0]])
    found, truth = (system(1j * w).imag for system in (last, first))
    assert np.max(np.abs(found - truth)) <= 1e-12 * np.max(np.abs(truth))
    assert np.max(np.abs(last.d / first.d - 1)) < 1e-12 and np.max(np.abs(last.r / first.r - 1)) < 1e-12


def test_a_system_keeps_its_size_and_a_transfer_function_arrives_minimal():
    full = phc.lc_circuit([1.0, 1.0, 4.0], 1.0)
    assert phc.ch(full).n == phc.oh(full).n == phc.oh(phc.ch(full)).n == 3
    assert phc.ph(phc.ch(full)).n == phc.ch(ct.tf([2, 0], [1, 0, 4])).n + 1 == 2


def test_names_of_signals_are_kept_on_the_way():
    circuit = phc.lc_circuit([1.0], [1.0])
    assert phc.ch(circuit).input_labels == ["V"] and phc.oh(phc.ch(circuit)).output_labels == ["I"]
    assert phc.ph(phc.oh(circuit)).input_labels == ["V"]
    assert phc.ch(circuit, inputs="drive").input_labels == ["drive"]
    assert phc.ch([1.0], [1.0, 0.0], name="resonator").name == "resonator"


@pytest.mark.parametrize("make", [phc.ch, phc.oh])
def test_a_form_is_a_state_space_that_copies_pickles_and_prints_itself(make):
    sys = make([3.0, 1.0], [0.1, 0.2, 0.3, -0.4], name="form")
    for twin in (
        pickle.loads(pickle.dumps(sys)),
        copy.copy(sys),
        copy.deepcopy(sys),
        eval(repr(sys), vars(np) | {name: getattr(phc, name) for name in phc.__all__}),
    ):
        assert type(twin) is type(sys)
        assert np.array_equal(twin.d, sys.d) and np.array_equal(twin.v, sys.v)
    assert pickle.loads(pickle.dumps(sys)).name == "form"
    assert isinstance(sys, ct.StateSpace) and type(sys + sys) is ct.StateSpace
    with pytest.raises(
        AttributeError, match=r"A of a \w+Hamiltonian cannot be changed: .* make a new one with [co]h\(d, v\)"
    ):
        sys.A = np.eye(4)
    with pytest.raises(ValueError, match="read-only"):
        sys.d[0] = 2.0


def test_arrays_of_the_user_are_neither_changed_nor_shared():
    d, v = np.array([2.0, 1.0]), np.ones(4)
    sys = phc.ch(d, v)
    d[0], v[0] = 9.0, 9.0
    assert np.array_equal(sys.d, [2.0, 1.0]) and np.array_equal(sys.v, np.ones(4))


# --- a semidefinite energy -----------------------------------------------------------------------------------------


def test_the_doubled_parameters_of_a_semidefinite_energy_give_its_rigid_body_mode():
    Q, v = np.diag([0.0, 4.0, 2.0, 1.0]), np.array([0.5, 0.0, 3.0, 1.0])
    truth = phc.ph(Q, v)
    for system in (phc.ch(np.diag(Q), v), phc.oh(np.diag(Q), v), phc.ch(truth), phc.oh(truth)):
        s = np.array([0.3 + 1j, 0.7j])
        assert np.max(np.abs(system(s) - truth(s))) < 32 * EPS * np.max(np.abs(truth(s)))
        assert np.array_equal(system.poles(), [-2j, 0, 0, 2j])
        assert np.allclose(system.a, [0, 0, 4, 0], rtol=4 * EPS, atol=0)
    image = phc.ch(np.diag(Q), v).port_hamiltonian()
    assert np.array_equal(image.Q, Q) and np.array_equal(image.B[:, 0], v)


# --- digits --------------------------------------------------------------------------------------------------------


def test_a_companion_matrix_that_carries_fewer_than_six_digits_warns_and_the_system_does_not():
    n = 30
    sys = phc.ch(np.linspace(1, 10, n), np.ones(2 * n))
    assert sys.digits < 6
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sys([1j]), sys.poles(), sys.zeros(), phc.step_response(sys, np.linspace(0, 1, 5)), phc.ph(sys)
        with pytest.raises(phc.ConditioningWarning, match=r"companion matrix of 30 modes carries 0\.\d decimal digits"):
            sys.A  # noqa: B018
        with pytest.raises(phc.ConditioningWarning, match="transfer function of 30 modes carries"):
            phc.tf(sys)
        well = phc.ch(np.logspace(0, 3, 12), np.ones(24))
        assert well.digits > 6
        well.A, phc.tf(well)


def test_the_digits_are_those_that_the_eigenvalues_of_the_companion_matrix_keep():
    """Where six digits are promised they are there; where none is, they are not."""
    for n, kept in ((5, True), (10, True), (30, False)):
        d = np.linspace(1.1, 11, n)
        sys = phc.ch(d, np.ones(2 * n))
        found = np.linalg.eigvals(sys.A)
        error = max(np.min(np.abs(found - 1j * x)) / x for x in d)
        assert (error < 1e-6) == kept == (sys.digits > 6)


# --- transfer functions --------------------------------------------------------------------------------------------


@relaxed
@given(parameters(("decade", "wide 1e4"), most=6))
def test_the_transfer_function_has_the_coefficients_of_the_minimal_system(pair):
    d, v = pair
    sys = phc.ch(d, v)
    G = phc.tf(sys)
    minimal = sys.modes.minimal()
    if not minimal.n:
        assert not G.num_list[0][0].any()
        return
    g1, g2 = printed_form(minimal.d, np.r_[minimal.nu[:, 0].real, minimal.nu[:, 0].imag])
    num, den = G.num_list[0][0], G.den_list[0][0]
    assert np.all(np.abs(den[1:][::-1] + g1[-1]) <= 16 * EPS * np.abs(g1[-1]))
    assert np.all(np.abs(np.r_[np.zeros(2 * minimal.n - len(num)), num][::-1] - g2) <= 16 * EPS * np.abs(g2))


def test_equal_branches_are_one_mode_of_the_transfer_function():
    G = phc.tf(phc.lc_circuit(np.ones(5), np.ones(5)))
    assert np.allclose(G.num_list[0][0], [5, 0], rtol=8 * EPS, atol=0)
    assert np.allclose(G.den_list[0][0], [1, 0, 1], rtol=8 * EPS, atol=0)
    assert G.input_labels == ["V"]


@pytest.mark.parametrize(
    "stiffness", [[1.0, 2.0, 3.0, 4.0], [0.0, 2.0, 3.0, 4.0]], ids=["definite", "with a rigid body"]
)
@pytest.mark.parametrize("ports", [1, 2])
@pytest.mark.parametrize("make", [phc.ph, phc.affine])
def test_the_transfer_function_is_that_of_the_system_for_any_number_of_ports(stiffness, ports, make):
    B = np.zeros((4, ports))
    B[:2] = np.random.default_rng(0).standard_normal((2, ports))
    sys = make(np.diag(stiffness), B)
    for s in (0.3 + 1j, -2.0, 0.7j):
        assert np.max(np.abs(phc.tf(sys)(s) - sys(s))) < 64 * EPS * np.max(np.abs(sys(s)))


@pytest.mark.parametrize("n", [1, 5, 10])
def test_a_transfer_function_and_back(n):
    d, r = np.linspace(1.1, 11, n), np.linspace(1, 2, n)
    back = phc.ph(phc.tf(phc.modes(d, r)))
    assert np.max(np.abs(back.d / d - 1)) < 1e-12 and np.max(np.abs(back.r / r - 1)) < 1e-10


@pytest.mark.parametrize("n", [25, 30])
def test_coefficients_that_tell_no_modes_are_refused_with_the_figure(n):
    G = phc.tf(phc.modes(np.linspace(1.1, 11, n), np.ones(n)))
    with pytest.raises(
        phc.StructureError,
        match=r"the coefficients of the transfer function carry [0-3]\.\d digits of its poles, needed 4",
    ):
        phc.ph(G)


# --- bad input -----------------------------------------------------------------------------------------------------

BAD = {
    "odd v": (lambda: phc.ch([1.0], [1.0]), r"v has shape \(1,\); with 1 natural frequencies it must be \(2,\)"),
    "sizes": (lambda: phc.oh([1.0, 2.0, 3.0], [1.0, 2.0]), r"v has shape \(2,\); with 3 natural"),
    "zero d": (lambda: phc.ch([0.0], [1.0, 0.0]), r"d is not positive: d\[0\] = 0"),
    "negative d": (lambda: phc.ch([1.0, -1.0], [1.0, 0.0]), r"d is negative: d\[1\] = -1"),
    "nan": (lambda: phc.ch([np.nan], [1.0, 0.0]), "d is not finite"),
    "two ports": (lambda: phc.ch(phc.ph(np.eye(2), np.eye(2))), "the system has 2 ports; canonical forms"),
    "damped": (lambda: phc.ch(ct.tf([1, 0], [1, 1, 1])), "off the imaginary axis"),
    "no system": (lambda: phc.oh("circuit"), "no port-Hamiltonian form of an object of type str"),
    "overflow": (lambda: phc.ch(1e9 * np.arange(1, 41), np.ones(80)).A, "exceed the range of doubles"),
    "dt": (lambda: phc.ch([1.0], [1.0, 0.0], dt=0.1), "dt cannot be given"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_parameters_say_what_is_wrong(name):
    call, message = BAD[name]
    with pytest.raises(phc.StructureError, match=message):
        call()


def test_no_modes_are_a_system_without_states():
    sys = phc.ch([], [])
    assert sys.n == 0 and sys([1j]) == 0


@pytest.mark.parametrize("make", [phc.ch, phc.oh])
def test_weights_whose_squares_underflow_are_refused_and_not_taken_for_zero(make):
    with pytest.raises(phc.StructureError, match=r"v is out of range: .* allowed 1e-153 to 1e"):
        make([1.0], [1e-200, 0.0])
    for d, v in (
        ([1.0, 2.0], [1.0, 1e-200, 0.0, 0.0]),
        ([1e-10], [1e-150, 0.0]),
        ([0.0, 1.0, 1.0, 1.0], [0.0, 1.0, 1e-200, 0.0]),
    ):
        sys = make(d, v)
        for look in (lambda sys=sys: sys.c, lambda sys=sys: sys.modes, lambda sys=sys: sys(1j)):
            with pytest.raises(
                phc.StructureError, match="the modal weights of this d and v leave the range of doubles"
            ):
                look()
    assert make([1.0], [1e-153, 0.0]).c > 0 and make([1.0, 2.0], [1.0, 0.0, 0.0, 0.0]).modes.r[1] == 0


class Filter(phc.ControllableHamiltonian):
    """A class of a user, whose constructor takes something else."""

    def __init__(self, d):
        super().__init__([d], [1.0, 0.0])


def test_a_copy_of_a_subclass_is_of_that_class():
    sys = Filter(2.0)
    for twin in (pickle.loads(pickle.dumps(sys)), copy.copy(sys), copy.deepcopy(sys)):
        assert type(twin) is Filter and twin.d == 2


@pytest.mark.parametrize("make", [phc.ch, phc.oh])
def test_a_form_without_modes_has_matrices_and_can_be_connected(make):
    empty, other = make([], []), make([1.0], [1.0, 0.0])
    assert empty.A.shape == (0, 0) and empty.B.shape == (0, 1) and empty.C.shape == (1, 0) and not empty.D
    s = 0.3 + 0.7j
    for found, value in (
        (empty + other, other(s)),
        (other - empty, other(s)),
        (empty * other, 0),
        (other * empty, 0),
        (ct.feedback(other, empty), other(s)),
        (ct.feedback(empty, other), 0),
    ):
        assert abs(found(s) - value) < 8 * EPS


@pytest.mark.parametrize(("d", "v"), [([[1], [1, 2]], [1.0, 0.0]), ([1.0], [[1], [1, 2]])])
@pytest.mark.parametrize("make", [phc.ch, phc.oh])
def test_ragged_parameters_are_refused(make, d, v):
    with pytest.raises(phc.StructureError, match="is not a rectangular array of numbers"):
        make(d, v)


def test_a_pole_at_0_costs_no_digits():
    form = phc.ch(phc.spring_chain([1.0, 1.0]))
    assert form.digits == phc.ch([np.sqrt(2.0)], [1.0, 0.0]).digits > 15
    assert phc.ch([0.0, 0.0, 1.0, 3.0], [1.0, 1.0, 1.0, 1.0]).digits > 15


def test_where_the_residues_of_two_ports_cancel_the_coefficients_are_zero():
    """Force at one end, velocity at the other: five of the coefficients of a chain of three masses cancel."""
    G = phc.tf(phc.spring_chain([1.0, 2.0, 1.0], 10.0, ground=1.0, port=[0, 2]))
    numerator = G.num_list[0][1]
    assert len(numerator) == 2 and abs(numerator[0] / 50 - 1) < 1e-13 and numerator[1] == 0


# --- as methods ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method, make", [("controllable_form", phc.ch), ("observable_form", phc.oh)])
@pytest.mark.parametrize("canonical", [True, False])
def test_a_form_is_a_method_of_a_system(method, make, canonical):
    sys = phc.ph(np.diag([3.0, 1.0, 3.0, 1.0]), [0.5, 0.2 * canonical, 1.0, 0.0], inputs="F", outputs="v")
    form, made = getattr(sys, method)(name="form"), make(sys)
    assert type(form) is type(made) and form.n == sys.n and sys.is_canonical is canonical
    assert np.array_equal(form.d, made.d) and np.array_equal(form.v, made.v)
    assert (form.name, form.input_labels, form.output_labels) == ("form", ["F"], ["v"])
    assert abs(form(0.3 + 0.7j) - sys(0.3 + 0.7j)) < 1e-13
    two_ports = phc.ph(np.eye(4), np.eye(4)[:, 2:])
    with pytest.raises(phc.StructureError, match="ports"):
        getattr(two_ports, method)()
