"""Every bad input is refused with what was measured, what is allowed and what to do."""

import pickle
import warnings
from decimal import Decimal
from fractions import Fraction

import control as ct
import numpy as np
import pytest
import scipy.signal
import scipy.sparse
from slow import slowly

import ph_control as phc

I = np.eye(2)
EPS = np.finfo(float).eps
LEAST_SEMIDEFINITE = f"{8 * 2 * EPS:.1e}"


def refusal(make, error=phc.StructureError):
    with pytest.raises(error) as caught:
        make()
    assert type(caught.value) is error
    return str(caught.value)


@pytest.mark.parametrize(
    ("Q", "message"),
    [
        (np.ones((2, 4)), "Q is not square: its shape is (2, 4); it must be (2n, 2n)"),
        (
            np.eye(3),
            "Q has odd size 3; a Hamiltonian needs n positions and n momenta, so its matrix is (2n, 2n); with losses "
            "R, a structure matrix J of any size can be given, such as J=[[0]] for a coil or a mass alone",
        ),
        (np.ones(4), "Q has 1 dimensions (shape (4,)), expected 2; reshape it so that nothing is guessed"),
        (np.ones((2, 2, 2)), "Q has 3 dimensions (shape (2, 2, 2)), expected 2; reshape it so that nothing is guessed"),
        (
            [[1.0, 3e-4], [0.0, 0.5]],
            "Q is not symmetric: max |Q - Q.T| / max |Q| = 3.0e-04, allowed 4.4e-13; pass (Q + Q.T)/2 if that is meant",
        ),
        (
            np.diag([4.0, -1.0]),
            "Q is indefinite: smallest eigenvalue after scaling to unit diagonal -1, allowed >= "
            f"-{LEAST_SEMIDEFINITE}; a stored energy cannot be negative, so check the signs in Q",
        ),
        (
            [[1.0, np.nan], [np.inf, 1.0]],
            "Q is not finite: 2 of 4 entries are NaN or infinite, the first at index (0, 1); remove or replace them",
        ),
        (1j * I, "Q is complex: largest imaginary part 1, allowed 0; pass its real part if that is meant"),
        ([["a", "b"], ["c", "d"]], "Q does not hold real numbers: its type is <U1; pass an array of floats"),
        ([[Fraction(1), 0], [0, 1]], "Q does not hold real numbers: its type is object; pass an array of floats"),
        (None, "Q is of type NoneType, not an array of numbers; pass an array (a sparse matrix by its toarray())"),
        (
            scipy.sparse.csr_array(I),
            "Q is of type csr_array, not an array of numbers; pass an array (a sparse matrix by its toarray())",
        ),
        (
            np.ma.masked_array(I, mask=[[1, 0], [0, 0]]),
            "Q has masked entries; fill them, since a mask would be lost here",
        ),
        (
            1e154 * I,
            "Q is out of range: its largest entry is 1e+154, allowed 1e-300 to 1e+153; "
            "choose other units of time or amplitude",
        ),
        (
            1e-310 * I,
            "Q is out of range: its largest entry is 1e-310, allowed 1e-300 to 1e+153; "
            "choose other units of time or amplitude",
        ),
    ],
)
def test_a_bad_hamiltonian_matrix_is_refused(Q, message):
    assert refusal(lambda: phc.ph(Q, [0.0, 1.0])) == message
    assert refusal(lambda: phc.williamson(Q)) == message


def test_a_ragged_list_is_refused():
    assert refusal(lambda: phc.ph([[1, 0], [0]], [0, 1])).startswith("Q is not a rectangular array of numbers: ")
    assert refusal(lambda: phc.ph(I, [[1], [0, 1]])).startswith("B is not a rectangular array of numbers: ")


def test_a_free_momentum_is_refused_where_the_normal_form_has_no_place_for_it_and_only_there():
    Q = np.diag([0.0, 1.0])
    message = (
        "Q is only positive semidefinite and its kernel is not symplectic: rank 1, kernel of dimension 1, its "
        f"symplectic part of dimension 0 (eigenvalues below {LEAST_SEMIDEFINITE} after scaling to unit diagonal count "
        "as zero); no S gives diag(d, d): use williamson_semidefinite(Q), or ground or remove the 1 rigid-body mode(s)"
    )
    assert refusal(lambda: phc.williamson(Q)) == message
    sys = phc.ph(Q, [0.0, 1.0])
    assert refusal(lambda: sys.S) == message
    assert refusal(lambda: sys.v) == message
    assert sys(2.0) == 0.5


@pytest.mark.parametrize(
    ("B", "message"),
    [
        ([1.0, 2.0, 3.0], "B has shape (3,); with Q of shape (2, 2) it must be (2,) or (2, number of ports)"),
        ([[1.0, 2.0]], "B has shape (1, 2); with Q of shape (2, 2) it must be (2,) or (2, number of ports)"),
        (1.0, "B has shape (); with Q of shape (2, 2) it must be (2,) or (2, number of ports)"),
        (np.ones((2, 1, 1)), "B has shape (2, 1, 1); with Q of shape (2, 2) it must be (2,) or (2, number of ports)"),
        (np.zeros((2, 0)), "B has no columns; a port-Hamiltonian system needs at least one port"),
        (
            [0.0, np.nan],
            "B is not finite: 1 of 2 entries are NaN or infinite, the first at index 1; remove or replace them",
        ),
        ([2j, 0], "B is complex: largest imaginary part 2, allowed 0; pass its real part if that is meant"),
        (["a", "b"], "B does not hold real numbers: its type is <U1; pass an array of floats"),
        (
            [1e200, 0.0],
            "B is out of range: its largest entry is 1e+200, allowed 1e-153 to 1e+153; "
            "choose other units of time or amplitude",
        ),
    ],
)
def test_a_bad_input_matrix_is_refused(B, message):
    assert refusal(lambda: phc.ph(I, B)) == message


def test_weights_that_leave_the_range_of_doubles_are_refused_when_they_are_needed():
    sys = phc.ph(np.diag([1e150, 1e-150]), [1e100, 0.0])
    assert refusal(lambda: sys.d) == (
        "the modal weights of this Q and B leave the range of doubles (1e-308 to 1e308); "
        "choose other units of time or amplitude"
    )


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ({"inputs": ["a", "b"]}, "2 names given for 1 inputs; give one name for each, all different"),
        ({"input": ["a", "b"]}, "2 names given for 1 inputs; give one name for each, all different"),
        ({"outputs": 3}, "3 names given for 1 outputs; give one name for each, all different"),
        ({"states": ["q"]}, "1 names given for 2 states; give one name for each, all different"),
        ({"states": ["q", "q"]}, "two of the states are called 'q'; give each a name of its own"),
    ],
)
@pytest.mark.parametrize("source", [(I, [0.0, 1.0]), (phc.modes(1.0, 1.0),), (ct.tf([1, 0], [1, 0, 1]),)])
def test_names_of_the_wrong_number_are_refused(source, names, message):
    assert refusal(lambda: phc.ph(*source, **names)) == message


@pytest.mark.parametrize(
    "names",
    [
        {"name": 3}, {"name": "a.b"}, {"inputs": b"x"}, {"outputs": ["a.b"]}, {"inputs": [None]}, {"input": 2.0},
        {"inputs": True}, {"outputs": 2**63}, {"outputs": {"a": 1}}, {"inputs": np.array(["u"])}, {"outputs": [["y"]]},
    ],
    ids=repr,
)  # fmt: skip
@pytest.mark.parametrize(
    "make",
    [
        lambda **names: phc.ph(I, [0.0, 1.0], **names), lambda **names: phc.ch([1.0], [1.0, 0.0], **names),
        lambda **names: phc.tf(phc.frenkel_kontorova(1), **names), phc.frenkel_kontorova,
        lambda **names: phc.sample(phc.frenkel_kontorova(1), 0.1, **names),
        lambda **names: phc.affine(I, [1.0, 0.0], **names),
    ],
)  # fmt: skip
def test_names_that_are_no_texts_are_refused(make, names):
    refusal(lambda: make(**names))


def test_a_number_of_names_that_no_memory_holds_is_refused_at_once():
    assert refusal(lambda: phc.ph(I, [0.0, 1.0], states=2**63)).startswith("9223372036854775808 names given for 2")
    assert phc.ph(I, [0.0, 1.0], states=np.int64(2), inputs=1).nstates == 2
    assert refusal(lambda: phc.tf(phc.frenkel_kontorova(1), states=["a", "b"])).startswith("2 names given for 0 states")


@pytest.mark.parametrize(
    "h", [1j, np.array(0.1 + 1j), np.ma.masked, "0.1", np.True_, [0.1], np.array(["0.1"])], ids=repr
)
def test_a_step_that_is_no_number_is_refused(h):
    assert "must be one positive number" in refusal(lambda: phc.sample(phc.frenkel_kontorova(1), h))


@pytest.mark.parametrize("dt", [0, 0.1, None, True])
@pytest.mark.parametrize("source", [(I, [0.0, 1.0]), (phc.modes(1.0, 1.0),), (ct.tf([1, 0], [1, 0, 1]),)])
def test_a_sampling_time_is_refused(source, dt):
    assert refusal(lambda: phc.ph(*source, dt=dt)) == (
        "dt cannot be given: a port-Hamiltonian system is continuous-time; use sample() of the system"
    )


def test_an_unknown_keyword_is_refused_as_python_control_does():
    with pytest.raises(TypeError, match="unexpected keyword"):
        phc.ph(I, [0.0, 1.0], colour="red")


@pytest.mark.parametrize(
    ("d", "r", "message"),
    [
        ([1.0, -2.0], [1.0, 1.0], "d is not positive: d[1] = -2; natural frequencies are > 0"),
        ([0.0, 2.0], [1.0, 1.0], "d is not positive: d[0] = 0; natural frequencies are > 0"),
        ([1.0, 2.0], [1.0, -0.5], "r is negative: r[1] = -0.5, allowed >= 0; a negative residue is not passive"),
        ([1.0, 2.0], [1.0], "r has shape (1,); with 2 natural frequencies it must be (2,)"),
        ([1.0], [1.0, 2.0], "r has shape (2,); with 1 natural frequencies it must be (1,)"),
        (I, [1.0, 2.0], "d has shape (2, 2); it must be a vector of n natural frequencies"),
        (
            [1.0, np.inf],
            [1.0, 1.0],
            "d is not finite: 1 of 2 entries are NaN or infinite, the first at index 1; remove or replace them",
        ),
        ([1.0], [1j], "r is complex: largest imaginary part 1, allowed 0; pass its real part if that is meant"),
        (["x"], [1.0], "d does not hold real numbers: its type is <U1; pass an array of floats"),
    ],
)
def test_bad_modal_data_are_refused(d, r, message):
    assert refusal(lambda: phc.modes(d, r)) == message


@pytest.mark.parametrize(
    ("z", "message"),
    [
        ([1.0, 2.0, 3.0], "z has shape (3,); it must be (2,) or (2, T)"),
        (np.ones((3, 5)), "z has shape (3, 5); it must be (2,) or (2, T)"),
        (1.0, "z has shape (); it must be (2,) or (2, T)"),
        (
            [np.nan, 0.0],
            "z is not finite: 1 of 2 entries are NaN or infinite, the first at index 0; remove or replace them",
        ),
    ],
)
def test_a_bad_state_has_no_energy(z, message):
    assert refusal(lambda: phc.ph(I, [0.0, 1.0]).hamiltonian(z)) == message


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.ones((2, 2)), "the points have shape (2, 2); give a number or a vector"),
        ([1.0, np.nan], "the points are not numbers: the first NaN is at index 1"),
        ("two", "the points are not complex numbers: 'two'; give a number or a vector"),
    ],
)
def test_bad_points_have_no_transfer_function(points, message):
    assert refusal(lambda: phc.ph(I, [0.0, 1.0]).horner(points)) == message


# --- systems that are not one ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("thing", "kind"),
    [
        (I, "ndarray"),
        (None, "NoneType"),
        (3.0, "float"),
        ("sys", "str"),
        ([], "list"),
        (ct.frd([1, 2], [1, 2]), "FrequencyResponseData"),
        (ct.nlsys(None, lambda t, x, u, p: u, inputs=1, outputs=1), "NonlinearIOSystem"),
    ],
)
def test_what_is_no_linear_system_is_refused(thing, kind):
    assert refusal(lambda: phc.ph(thing)) == (
        f"no port-Hamiltonian form of an object of type {kind}; pass a StateSpace, a TransferFunction, "
        "a zero-pole-gain system, a ModalForm, or the matrices Q and B"
    )


def test_a_system_without_ports_is_refused():
    sys = ct.ss(I, np.zeros((2, 0)), np.zeros((0, 2)), np.zeros((0, 0)), remove_useless_states=False)
    assert refusal(lambda: phc.ph(sys)) == "the system has no inputs; a port-Hamiltonian system needs at least one port"


@pytest.mark.parametrize(
    ("zeros", "poles", "gain", "message"),
    [
        (
            [],
            [1j],
            1.0,
            "the poles are not closed under conjugation: 1 above the real axis, 0 below; "
            "a real system has them in conjugate pairs",
        ),
        (
            [0.0],
            [1j, -1.5j],
            1.0,
            "the poles are not closed under conjugation: the conjugate of 0+1j is missing, the nearest is off by "
            "5.0e-01 of its size, allowed 2.2e-13; a real system has them in pairs",
        ),
        (
            [0.0, 1j],
            [1j, -1j, 2j, -2j],
            1.0,
            "the zeros are not closed under conjugation: 1 above the real axis, 0 below; "
            "a real system has them in conjugate pairs",
        ),
        ([np.nan], [1j, -1j], 1.0, "the zeros are not numbers: the first NaN is at index 0"),
        (
            [0],
            [1j, -1j],
            1j,
            "the gain is complex: largest imaginary part 1, allowed 0; pass its real part if that is meant",
        ),
    ],
)
def test_zeros_and_poles_of_no_real_system_are_refused(zeros, poles, gain, message):
    assert refusal(lambda: phc.ph(scipy.signal.ZerosPolesGain(zeros, poles, gain))) == message


def test_the_matrices_of_a_state_space_are_checked():
    def sys(corner):
        return scipy.signal.StateSpace([[0, 1], [-1, corner]], [[0], [1]], [[0, 1]], [[0]])

    assert refusal(lambda: phc.ph(sys(np.nan))) == (
        "A is not finite: 1 of 4 entries are NaN or infinite, the first at index (1, 1); remove or replace them"
    )
    assert refusal(lambda: phc.ph(sys(1e200))) == (
        "A is out of range: its largest entry is 1e+200, allowed 1e-300 to 1e+153; "
        "choose other units of time or amplitude"
    )


def test_a_system_too_ill_conditioned_to_decide_says_so_instead_of_losing_modes():
    d = [0.3, 0.5, 0.72, 0.73, 1.4]
    half = 0.5 * sum(ct.tf([x, 0], [1, 0, x * x]) for x in d)
    # every pole twice in the denominator: their cluster is lost in the rounding of 21 coefficients
    message = refusal(lambda: phc.ph(half + half))
    assert message == (
        "the coefficients of the transfer function carry 0.6 digits of its poles, needed 4: the rest is lost in their "
        "rounding to doubles; give natural frequencies and weights, zeros, poles and gain, or a state space instead"
    )
    # with a factor that is not odd it is no lossless transfer function with lost digits
    damped = refusal(lambda: phc.ph((half + half) * ct.tf([1.0, 1.0], [1.0, 2.0]), lossless=True), phc.NotLosslessError)
    assert damped.startswith("the system is")
    assert phc.ph(half).n == 5


# --- the error itself --------------------------------------------------------------------------------------------


def test_a_refusal_lists_eight_reasons_and_keeps_all():
    with pytest.raises(phc.NotLosslessError) as caught:
        phc.ph(ct.ss(-np.diag(np.arange(1.0, 11)), np.ones((10, 1)), np.ones((1, 10)), 0), lossless=True)
    error = caught.value
    assert len(error.violations) == 10
    lines = str(error).split("\n")
    assert lines[0] == "the system is not lossless:"
    assert [line.strip(" -") for line in lines[1:9]] == list(error.violations[:8])
    assert lines[9] == "  - and 2 more; see the attribute violations"
    assert lines[10].endswith("with every kappa positive")
    twin = pickle.loads(pickle.dumps(error))
    assert (type(twin), twin.violations, str(twin)) == (type(error), error.violations, str(error))


def test_every_refusal_can_be_caught_as_a_value_error_and_by_the_root_of_the_package():
    for error in (phc.StructureError, phc.NotLosslessError):
        assert issubclass(error, ValueError)
        assert issubclass(error, phc.PHControlError)
    assert issubclass(phc.NotLosslessError, phc.StructureError)


# --- fuzzing -----------------------------------------------------------------------------------------------------

STRANGE = [
    None, True, 3, 2.5, 1j, "abc", "1", b"12", ..., int, len, {}, {1}, [], [[]], [[[1]]], (1, 2), ((1, 0), (0, 1)),
    np.array(2.0), np.array([[None, 1], [1, 2]], object), np.array([[1, 0], [0, 1]], object),
    [[Fraction(1), 0], [0, 1]], [[Decimal(1), 0], [0, 1]], [[1, 2], [3]], [[1, 0], [0, [1]]],
    [[10**400, 0], [0, 1]], [[2**70, 0], [0, 1]],
    np.zeros((0, 0)), np.zeros((2, 2)), np.ones((2, 3)), np.ones((2, 2, 2)), np.ones((2, 1)), np.ones((1, 2)), I, -I,
    np.eye(4), I + 0j, 1j * I, I.astype(bool), I.astype(np.float16), I.astype(np.longdouble), 1e300 * I, 1e-300 * I,
    1.7e308 * I, 5e-324 * I, np.diag([1e300, 1e-300]), np.diag([1e308, 1e308, 1e-308, 1e-308]),
    np.diag([1e150, 1e-150]),
    np.diag([np.inf, 1]), np.diag([np.nan, 1]), np.diag([1.0, 0.0]), np.diag([1.0, -1.0]), [[1, 1e-3], [0, 1]],
    scipy.sparse.csr_matrix(I), scipy.sparse.csr_array(I), np.ma.masked_array(I, mask=[[1, 0], [0, 0]]),
    np.zeros((2, 2), dtype=[("a", float)]), np.zeros((2, 2), "M8[s]"), np.ones((2, 2), "m8[s]"), [0.0, 1.0],
    [np.nan, 0.0], [1e300, 1e300], [1e-300, 0.0], [0, 0], ["a", "b"], ct.tf([1, 0], [1, 0, 1]), phc.modes(1.0, 1.0),
]  # fmt: skip


def use(sys):
    """Everything a system computes from what it was given."""
    values = [sys.modes.kappa, sys.d, sys.r, sys.poles(), sys.zeros(), sys.horner([0, 1j, 2.0]), sys.A, sys.C, sys.B]
    values += [(2 * sys).r, (sys + sys).d, sys.hamiltonian(np.ones(sys.nstates))]
    assert all(not np.isnan(value).any() for value in values)


def accepted(make):
    """Whether it is accepted, and then usable; any error but ours, and any warning, goes through."""
    try:
        made = make()
        if isinstance(made, phc.PortHamiltonian):
            use(made)
    except phc.PHControlError:
        return False
    return True


def test_strange_matrices_are_accepted_and_used_or_refused_but_nothing_else_happens():
    outcomes = [accepted(lambda Q=Q, B=B: phc.PortHamiltonian(Q, B)) for Q in STRANGE for B in STRANGE]
    assert 20 < sum(outcomes) < len(outcomes) / 4


def test_strange_objects_are_accepted_as_systems_and_modes_or_refused_but_nothing_else_happens():
    assert [type(thing).__name__ for thing in STRANGE if accepted(lambda thing=thing: phc.ph(thing))] == [
        "TransferFunction",
        "ModalForm",
    ]
    outcomes = [accepted(lambda d=d, r=r: phc.modes(d, r)) for d in STRANGE for r in STRANGE if r is not None]
    assert 3 < sum(outcomes) < len(outcomes) / 4
    assert sum(accepted(lambda Q=Q: phc.williamson(Q)) for Q in STRANGE) > 5


SIZES = [0.0, 1.0, -1.0, 2.0, 1e-9, 1e9, 1e-160, 1e160, 1e300, 1e-300, 1e308, 5e-324]


@pytest.mark.parametrize("seed", [0, *slowly(1, 2, 3)])
def test_systems_with_numbers_of_any_size_are_accepted_and_used_or_refused_but_nothing_else_happens(seed):
    rng = np.random.default_rng(seed)
    outcomes = []
    for k in range(100):
        sizes = SIZES[: 4 + k % 9]
        n, m = rng.integers(1, 5), rng.integers(1, 3)
        A, B = rng.choice(sizes, (n, n)), rng.choice(sizes, (n, m))
        A, C = (A - A.T, B.T) if k % 2 else (A, rng.choice(sizes, (m, n)))
        num, den = (rng.choice(sizes, rng.integers(1, size)) for size in (5, 7))
        zeros, poles = (1j * rng.choice(sizes, rng.integers(0, size)) for size in (3, 4))
        zeros, poles, gain = np.r_[zeros, -zeros, np.zeros(k % 2)], np.r_[poles, -poles], rng.choice(sizes)
        makers = [
            lambda A=A, B=B, C=C, m=m: ct.StateSpace(A, B, C, np.zeros((m, m)), remove_useless_states=False),
            lambda num=num, den=den: ct.TransferFunction(num, den),
            lambda num=num, den=den: scipy.signal.TransferFunction(num, den),
            lambda zpk=(zeros, poles, gain): scipy.signal.ZerosPolesGain(*zpk),
        ]
        for make in makers:
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    sys = make()
            except (ValueError, IndexError):
                continue  # python-control or scipy refuse it themselves
            outcomes.append(accepted(lambda sys=sys: phc.ph(sys)))
    assert len(outcomes) > 200
    assert 10 < sum(outcomes) < len(outcomes)


def test_masks_within_a_list_are_not_lost():
    rows = [np.ma.masked_array([1.0, 0.0], [False, True]), [0.0, 1.0]]
    assert refusal(lambda: phc.ph(rows, [0.0, 1.0])).startswith("Q has masked entries")
    assert refusal(lambda: phc.modes([1.0, np.ma.masked], [1.0, 1.0])).startswith("d has masked entries")


@pytest.mark.parametrize("options", [{"intersample": np.ones(2)}, {"intersample": None}, {"method": 1j}])
def test_a_way_of_sampling_is_refused_for_what_is_not_sampled(options):
    assert "this one is not sampled" in refusal(lambda: phc.ph(I, [0.0, 1.0], **options))


def test_frequencies_of_a_form_that_are_no_vector_are_refused():
    for form in (phc.ch, phc.oh, phc.ObservableHamiltonian):
        refusal(lambda form=form: form(np.array([[1.0, 2.0]]), [1.0, 0.5]))
        refusal(lambda form=form: form(np.zeros((2, 2, 2)), np.ones(8)))


LOSSY = phc.ph(np.eye(2), [0.0, 1.0], R=np.diag([0.0, 0.1]))


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: phc.ph(np.eye(2), [0.0, 1.0], R=[[0.0, 0.0], [0.0]]), "R is not a rectangular array"),
        (lambda: phc.modes([7e305, 2.0], [0.5, 0.5], damping=0.01), "d is out of range"),
        (lambda: phc.modes(1.0, 0.5, damping=-1e300), "damping is out of range"),
        (lambda: LOSSY.horner(np.ma.masked_array([1j, 2j], [False, True])), "the points have masked entries"),
        (lambda: ct.feedback(LOSSY, np.array([[1e300]])), "the gain is out of range"),
        (lambda: phc.damping_injection(LOSSY, 1e300), "the gain is out of range"),
        (lambda: phc.from_second_order(I, I, [1.0, 0.0], band=(0.0, 1e155)), "band is out of range"),
        (lambda: phc.damping_injection(1e100 * LOSSY, 1e150), "R is out of range"),
        (lambda: phc.ph(1e100 * I, [0.0, 1.0], R=1e100 * I).horner(1j), "the state-space matrix A is out of range"),
        (lambda: phc.ph(I, [0.0, 1.0], sensors=1e300 * I), "the matrix C of the sensors is out of range"),
        (lambda: phc.ph(ct.tf([1.0, 0.0, 0.0], [1.0, 1.0])), "improper"),
        (lambda: phc.impulse_plot(ct.tf([1.0, 2.0, 3.0], [1.0, 1.0])), "improper"),
        (lambda: phc.step_plot(ct.tf([1.0, 2.0, 3.0], [1.0, 1.0]), [0.0, 0.1, 0.2]), "improper"),
        (lambda: phc.step_plot(ct.tf([1.0, 2.0, 3.0], [1.0, 1.0], 0.1)), "improper"),
        (lambda: phc.passivity(ct.ss(np.full((2, 2), 1e200), [[1.0], [1.0]], [[1.0, 1.0]], 0.0)), "A is out of range"),
        (lambda: phc.modes(1e150, 1e12, damping=0.01), "kappa = r d is out of range"),
        (lambda: phc.fit_plot([0.0, 1.0], [1.0, 2.0], [1.0, 2.0], output_label=np.ones(2)), "output_label is"),
        (lambda: phc.modes_plot(phc.ph(phc.modes(1.0, 1.0)), linewidth=np.array(np.inf)), "linewidth is"),
        (lambda: phc.ch([1e6, 5e-324, 1e6, 3e6], [0.4, 0.3, -0.3, -0.5]).modes, "leave the range of doubles"),
        (lambda: phc.spring_chain([1.0, 2.0], port=[[1.0], [1.0, 2.0]]), "port is"),
        (lambda: phc.ph(np.eye(2), [0.0, 1.0], sensors=(0.6, 2.1, 0.5)), "the sensors"),
        (lambda: phc.gradient_descent((np.ones(9), np.ones(9)), 1, dt=1.0, learning_rate=10**400), "learning_rate is"),
    ],
)
def test_what_is_no_number_of_a_double_is_refused_before_it_is_used(call, message):
    assert message in refusal(call)


def test_states_of_very_different_units_are_balanced_without_a_warning():
    # a mode of 1 rad/s with a second state in a unit of 1e-25
    Q, J, R = np.diag([1.0, 1e50]), np.array([[0.0, 1e-25], [-1e-25, 0.0]]), np.diag([0.1, 1e-51])
    sys = phc.ph(Q, [1.0, 0.0], J=J, R=R)
    assert sys.natural_frequencies == pytest.approx([np.sqrt(1.01)])


def test_a_sensor_away_from_its_force_is_refused_where_masses_are_sought():
    A = [[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0], [-2.0, 1.0, -0.1, 0.0], [1.0, -2.0, 0.0, -0.1]]
    sys = ct.ss(A, [[0.0], [0.0], [1.0], [0.0]], [[0.0, 0.0, 0.0, 1.0]], 0.0)
    assert "not passive" in refusal(lambda: phc.ph(sys), phc.NotPassiveError)


def test_a_number_that_is_not_finite_is_told_as_it_is():
    assert refusal(lambda: phc.lc_circuit(np.inf, 1.0)) == "C is not finite: it is inf; give a finite number"


def test_a_displacement_is_refused_with_the_way_to_a_velocity():
    displacement = ct.tf([1], [1, 3, 5])
    assert "s times a displacement" in refusal(lambda: phc.ph(displacement), phc.NotPassiveError)
    assert phc.ph(ct.tf([1, 0], [1]) * displacement).damping_ratios.round(4) == [0.6708]


def test_coefficients_that_overflow_over_the_first_are_refused():
    assert "leave the range of doubles" in refusal(lambda: phc.ph(ct.tf([1.0, 0.0], [1e-320, 0.0, 1.0])))
