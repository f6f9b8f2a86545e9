"""Modal forms with losses, against dense matrices and mpmath."""

import copy
import pickle

import control as ct
import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import EPS

import ph_control as phc
from ph_control.modal.discretization import Hold
from ph_control.modal.propagation import outputs

relaxed = settings(deadline=None, max_examples=13, derandomize=True)
seeds = st.integers(0, 2**32 - 1)
RULES = [("exact", "zoh"), ("exact", "foh"), ("midpoint", "zoh"), ("midpoint", "foh"), ("euler", "zoh")]


def chain(n, loss, rng, inputs=2, outs=3, mass=1.0):
    """A chain of masses with losses that are not proportional, sensors and actuators anywhere, and a feedthrough."""
    K = (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)) * rng.uniform(0.5, 2)
    damper = loss * (K + 0.3 * np.diag(rng.uniform(0, 1, n)))
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-K / mass, -damper / mass]])
    B = np.concatenate([np.zeros((n, inputs)), rng.standard_normal((n, inputs))])
    return ct.ss(A, B, rng.standard_normal((outs, 2 * n)), rng.standard_normal((outs, inputs)))


def response(sys, s):
    """`G(s)` with 50 digits."""
    with mp.workdps(50):
        left = mp.mpmathify(s) * mp.eye(sys.nstates) - mp.matrix(sys.A.tolist())
        columns = [mp.matrix(sys.C.tolist()) * mp.lu_solve(left, mp.matrix(column.tolist())) for column in sys.B.T]
        return np.array([[complex(value) for value in column] for column in columns]).T + sys.D


def recursion(sys, hold, u):
    """Outputs sample by sample, in long doubles."""
    F, rest, held, risen = (M.astype(np.longdouble) for M in hold.step_of_matrices(sys.A, sys.B))
    x, y = np.zeros(sys.nstates, np.longdouble), []
    for k in range(u.shape[1]):
        y.append(sys.C @ x + sys.D @ u[:, k])
        if k + 1 < u.shape[1]:
            x = F @ x + rest @ x + held @ u[:, k] + risen @ (u[:, k + 1] - u[:, k])
    return np.array(y, float).T


# --- from matrices -------------------------------------------------------------------------------------------------


@pytest.mark.variants
@pytest.mark.parametrize("loss", [1e-4, 0.01, 0.3, 1.0, 3.0])
@pytest.mark.parametrize("n", [1, 3, 8])
def test_the_response_is_that_of_the_matrices(n, loss):
    sys = chain(n, loss, np.random.default_rng(n))
    modes = phc.modes(sys)
    w = np.geomspace(0.01, 10, 7)
    values = modes.freqresp(w)
    assert values.shape == (3, 2, 7)
    for k, x in enumerate(w):
        truth = response(sys, 1j * x)
        # what rounding of A moves the poles by counts more the nearer they are
        gap = np.min(np.abs(1j * x - modes.poles))
        assert np.max(np.abs(values[:, :, k] - truth)) < 1e-13 * np.max(np.abs(truth)) * max(1, 0.1 / gap)


@pytest.mark.variants
@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize(("n", "loss"), [(1, 3.0), (3, 0.01), (6, 3.0), (12, 0.2)])
def test_simulation_is_that_of_the_matrices(n, loss, rule):
    rng = np.random.default_rng(n)
    sys, hold = chain(n, loss, rng), Hold(0.05, *rule)
    u = rng.standard_normal((2, 2500))
    truth = recursion(sys, hold, u)
    assert np.max(np.abs(outputs(phc.modes(sys), hold, u) - truth)) < 1e-12 * np.max(np.abs(truth))


def nearly_defective(n, gap, rng):
    """2n poles from -1 on at equal distances, in one chain."""
    Q, _ = np.linalg.qr(rng.standard_normal((2 * n, 2 * n)))
    A = Q @ (np.diag(-1 - gap * np.arange(2 * n)) + np.eye(2 * n, k=1)) @ Q.T
    return ct.ss(A, rng.standard_normal((2 * n, 1)), rng.standard_normal((1, 2 * n)), 0.0)


@pytest.mark.variants
@pytest.mark.parametrize("gap", [0.0, 1e-12, 1e-9, 1e-6, 1e-3, 1e-1])
@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
def test_poles_that_coincide_or_nearly_so_cost_no_digits(n, gap):
    rng = np.random.default_rng(n)
    sys = nearly_defective(n, gap, rng)
    modes = phc.modes(sys)
    for w in (0.0, 0.3, 1.0, 5.0):
        truth = response(sys, 1j * w)[0, 0]
        # a chain of 2n equal poles turns rounding of its entries into powers of them
        assert abs(modes.freqresp(w) - truth) < 1e-12 * max(1, 4 ** (n - 3)) * abs(truth)
    u, hold = rng.standard_normal((1, 1500)), Hold(0.1, "exact", "foh")
    truth = recursion(sys, hold, u)
    assert np.max(np.abs(outputs(modes, hold, u) - truth)) < 1e-12 * np.max(np.abs(truth))
    if gap < 1e-2:
        assert [len(block.A) for block in modes.clusters] == [2 * n]
        for name in ("residues", "participation", "modal_mass"):
            with pytest.raises(phc.StructureError, match=r"are not parted .* have no digits"):
                getattr(modes, name)
        assert len(modes.poles) == 2 * n
        assert np.all(np.isfinite(modes.shapes)) and np.all(modes.natural_frequencies > 0)


@relaxed
@given(st.integers(1, 6), st.integers(1, 3), st.integers(1, 3), seeds)
def test_any_state_space_stable_or_not_keeps_its_response(n, inputs, outs, seed):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    B, C, D = (rng.standard_normal(shape) for shape in ((n, inputs), (outs, n), (outs, inputs)))
    sys = ct.ss(A, B, C, D)
    modes = phc.modes(sys)
    assert np.max(np.abs(np.sort_complex(modes.poles) - np.sort_complex(np.linalg.eigvals(A)))) < 1e-6
    for s in (0.3 + 2j, 3.0, 10j):
        truth, X = response(sys, s), np.linalg.norm(np.linalg.inv(s * np.eye(n) - A))
        size = np.linalg.norm(sys.B) * np.linalg.norm(sys.C) * X * max(1, np.linalg.norm(A) * X)
        assert np.max(np.abs(modes.evaluate([s])[:, :, 0] - truth)) < 3e4 * EPS * size
    back = phc.modes(modes.state_space())
    assert np.max(np.abs(back.evaluate([2j]) - modes.evaluate([2j]))) < 1e-9 * np.max(np.abs(modes.evaluate([2j])))


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_rigid_bodies_first_order_lags_and_free_masses(scale):
    s = ct.tf("s")
    plant = ct.ss(1 / (s / scale)) + ct.ss(2 / (s / scale + 1)) + 0.5
    modes = phc.modes(plant)
    assert sorted(np.abs(modes.poles)) == [0.0, scale]
    assert modes.evaluate([0.0])[0, 0, 0] == np.inf
    assert abs(modes.evaluate([2 * scale])[0, 0, 0] - (0.5 + 2 / 3 + 0.5)) < 1e-14
    assert modes.evaluate([np.inf])[0, 0, 0] == 0.5
    double = phc.modes(ct.ss(1 / s**2))
    assert len(double.clusters) == 1
    assert abs(double.evaluate([3j])[0, 0, 0] + 1 / 9) < 1e-15


def test_a_slow_pole_beside_a_fast_one_is_not_taken_for_a_rigid_body():
    modes = phc.modes(ct.ss(np.diag([-1e-6, -1e12]), [[1.0], [1.0]], [[1.0, 1.0]], 0.0))
    assert np.array_equal(np.sort(modes.poles.real), [-1e12, -1e-6])


def test_values_next_to_a_pole_are_right_and_at_one_infinite_only_where_it_is_seen():
    p = np.array([-1e-9 + 1j, -0.5])
    modes = phc.modes(p, [[1.0, 0.0], [0.0, 1.0]], [[1.0 + 1j], [2.0]])
    values = modes.evaluate([p[0]])[:, :, 0]
    assert values[0, 0] == np.inf and abs(values[1, 0] - 2 / (p[0] + 0.5)) < 4 * EPS
    near = p[0] + 1e-13
    truth = (1 + 1j) / mp.mpc(near - p[0]) + (1 - 1j) / (mp.mpc(near) - mp.mpc(p[0].conj()))
    assert abs(mp.mpc(complex(modes.evaluate([near])[0, 0, 0])) - truth) < 8 * EPS * abs(truth)
    critical = phc.modes([1.0], [1.0], damping=1.0)
    assert critical.evaluate([-1.0])[0, 0, 0] == np.inf
    assert not np.isnan(modes.evaluate([np.inf, 1e308, 5e-324, p[0], p[1], 1e200j])).any()


# --- proportional damping ------------------------------------------------------------------------------------------


@relaxed
@given(
    st.lists(st.tuples(st.floats(0.1, 10), st.floats(0.1, 3), st.floats(-2, 4)), min_size=1, max_size=4),
    st.floats(0.5, 4), st.floats(0.1, 10),
)  # fmt: skip
def test_modes_with_damping_ratios_are_those_of_the_sum(parameters, real, imag):
    d, r, zeta = np.array(parameters).T
    modes, s = phc.modes(d, r, damping=zeta), complex(real, imag)
    with mp.workdps(40):
        x = mp.mpc(s)
        terms = [mp.mpf(a) * mp.mpf(b) * x / (x * x + 2 * mp.mpf(z) * mp.mpf(a) * x + mp.mpf(a) ** 2)
                 for a, b, z in zip(d, r, zeta, strict=True)]  # fmt: skip
        truth, size = complex(mp.fsum(terms)), float(mp.fsum(map(abs, terms)))
    gap = np.min(np.abs(s - modes.poles)) / np.max(np.abs(modes.poles))
    if gap > 1e-6:
        assert abs(modes.evaluate([s])[0, 0, 0] - truth) <= 1e-12 * size * max(1.0, 1e-2 / gap)


@pytest.mark.parametrize("away", [0.0, 1e-12, 1e-9, 1e-6, 1e-4, 1e-2, 0.3, -1e-9, -1e-5, -1e-2])
def test_critical_damping_loses_no_digits(away):
    d, zeta, w = 3.0, 1.0 + away, 2.0
    values = phc.modes(d, 0.5, damping=zeta).freqresp(w)
    with mp.workdps(40):
        s = mp.mpc(0, w)
        truth = mp.mpf(1.5) * s / (s * s + 2 * mp.mpf(zeta) * d * s + d * d)
        assert abs(mp.mpc(complex(values)) - truth) < 1e-13 * abs(truth)


def test_of_proportional_damping_frequencies_ratios_and_masses_are_as_given():
    d, r, zeta = np.array([0.5, 1.0, 3.0]), np.array([1.0, 2.0, 0.5]), np.array([1e-4, 0.02, 0.6])
    modes = phc.modes(d, r, damping=zeta)
    assert not modes.is_lossless
    assert np.max(np.abs(modes.natural_frequencies / d - 1)) < 4 * EPS
    assert np.max(np.abs(modes.damping_ratios / zeta - 1)) < 8 * EPS
    assert np.max(np.abs(modes.modal_mass * r * d - 1)) < 8 * EPS
    assert np.array_equal(phc.modes(d, r, damping=0.0).kappa, phc.modes(d, r).kappa)
    assert phc.modes([2.0], [1.0], damping=0.0).is_lossless


@pytest.mark.parametrize("decades", [2, 4])
def test_modes_far_slower_than_others_of_a_stiff_structure_stand_alone(decades):
    d, zeta, Q = np.geomspace(1, 10**decades, 12), 0.01, np.linalg.qr(np.random.default_rng(0).normal(size=(12, 12)))[0]
    K, C, F = Q * d**2 @ Q.T, Q * (2 * zeta * d) @ Q.T, np.eye(12)[:, :2]
    A = np.block([[np.zeros((12, 12)), np.eye(12)], [-K, -C]])
    modes = phc.modes(ct.ss(A, np.concatenate([0 * F, F]), np.concatenate([0 * F, F]).T, 0))
    assert not modes.clusters
    assert np.abs(modes.natural_frequencies / d - 1).max() < 1e-9
    assert np.abs(modes.damping_ratios / zeta - 1).max() < 1e-7
    points = 1j * np.geomspace(0.1, 10 * d[-1], 40)
    terms = points / (points**2 + 2 * zeta * d[:, None] * points + d[:, None] ** 2)
    truth = np.einsum("al,bl,lk->abk", Q[:2], Q[:2], terms)
    assert np.abs(modes.evaluate(points) - truth).max() < 1e-8 * np.abs(truth).max()


def test_frequencies_and_ratios_of_matrices_are_those_of_control():
    sys = chain(4, 0.02, np.random.default_rng(3))
    wn, zeta, _ = ct.damp(sys, doprint=False)
    modes = phc.modes(sys)
    assert np.allclose(np.repeat(modes.natural_frequencies, 2), np.sort(wn), rtol=1e-12)
    assert np.allclose(np.repeat(modes.damping_ratios, 2), zeta[np.argsort(wn)], rtol=1e-9)


# --- residues, shapes, masses --------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [
    lambda: phc.modes(chain(3, 0.05, np.random.default_rng(0), 2, 2)),
    lambda: phc.ph(np.diag([4.0, 1.0, 0.0, 1.0, 2.0, 1.0]), np.eye(6)[:, 3:5]).modes,
    lambda: phc.modes([1.0, 2.0], [0.5, 0.25]),
])  # fmt: skip
def test_residues_are_products_of_shapes_and_participation_and_add_up_to_the_response(make):
    modes, s = make(), 0.3 + 0.7j
    values = modes.feedthrough + np.sum(modes.residues / (s - modes.poles)[:, None, None], axis=0)
    assert np.max(np.abs(values - modes.evaluate([s])[:, :, 0])) < 1e-13 * np.max(np.abs(values))
    assert np.allclose(np.abs(modes.shapes).max(axis=1), 1.0)
    pairs = modes.residues[-len(modes.shapes) :]
    assert np.allclose(modes.shapes[:, :, None] * modes.participation[:, None], pairs, rtol=1e-13, atol=1e-16)


def test_the_mass_of_a_mode_is_that_which_moves():
    """Two equal masses: in phase and against each other they move as one of both."""
    frame = phc.from_second_order(np.eye(2), np.array([[2.0, -1.0], [-1.0, 2.0]]), np.eye(2)).modes
    assert np.allclose(frame.modal_mass, [2.0, 2.0], rtol=1e-14)
    assert np.allclose(frame.mac(frame), np.eye(2), atol=1e-14)
    assert phc.modes([2.0], [0.0]).modal_mass[0] == np.inf


def test_the_assurance_criterion_compares_shapes_whatever_their_phase():
    rng = np.random.default_rng(1)
    shapes = rng.standard_normal((3, 4)) + 1j * rng.standard_normal((3, 4))
    one = phc.modes([-0.1 + 1j, -0.1 + 2j, -0.1 + 3j], shapes, np.ones(3))
    other = phc.modes([-0.1 + 1j, -0.1 + 2j], np.exp(1j) * shapes[1:], np.ones(2))
    table = one.mac(other)
    assert table.shape == (3, 2)
    assert np.allclose(table[1:], np.abs(table[1:]) * 1.0) and np.allclose(np.diag(table[1:]), 1.0)
    assert table[0].max() < 0.95
    with pytest.raises(phc.StructureError, match="shapes of 4 and of 1 outputs"):
        one.mac(phc.modes(1.0, 1.0))


def test_poles_and_vectors_of_a_lossless_system_give_its_frequencies_and_weights():
    lossless = phc.ph(np.diag([4.0, 1.0, 1.0, 1.0]), [[0.3, 0.0], [0.0, 1.0], [1.0, 0.2], [0.1, 1.0]]).modes
    again = phc.modes(lossless.mode_poles, lossless.shapes, lossless.participation)
    assert again.is_lossless
    assert np.allclose(again.d, lossless.d) and np.allclose(again.r, lossless.r)
    turned = phc.modes(lossless.mode_poles, lossless.shapes, 1j * lossless.participation)
    assert not turned.is_lossless
    assert np.max(np.abs(turned.poles.real)) == 0


def test_zeros_are_those_of_the_matrices():
    sys = chain(3, 0.1, np.random.default_rng(2), 2, 2)
    found, true = (np.sort_complex(zeros[zeros.imag > 0]) for zeros in (phc.modes(sys).zeros, sys.zeros()))
    assert len(found) == len(sys.zeros()) / 2
    assert np.allclose(found, true, rtol=1e-9)


@pytest.mark.parametrize("ports", [1, 3, 4, 40])
def test_zeros_are_there_for_many_ports_of_few_states(ports):
    rng = np.random.default_rng(ports)
    sys = phc.ph(np.eye(2), rng.standard_normal((2, ports)), R=np.diag([0.0, 0.1]), S=np.eye(ports))
    true = np.poly(sys.A - sys.B @ np.linalg.solve(sys.D, sys.C))
    plain = ct.ss(sys.A, sys.B, sys.C, sys.D)
    for zeros in (sys.zeros(), phc.modes(sys).zeros):
        assert np.allclose(np.poly(zeros), true)
    for drawing in map(phc.pole_zero_plot, (sys, plain)):
        drawn = [line.get_xydata() @ [1, 1j] for line in drawing.axes.flat[0].lines]
        assert any(np.allclose(np.poly(marks), true) for marks in drawn if len(marks) == 2)
    wide = ct.ss(sys.A, sys.B, sys.C[:1], sys.D[:1])
    assert len(phc.modes(wide).zeros) == (2 if ports == 1 else 0)


# --- the object ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("through", [copy.copy, copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))])
def test_a_copy_is_the_same_and_as_locked(through):
    modes = phc.modes(nearly_defective(1, 0.0, np.random.default_rng(0)))
    other = through(modes)
    assert np.array_equal(other.freqresp([0.3, 2.0]), modes.freqresp([0.3, 2.0]))
    with pytest.raises(ValueError, match="read-only"):
        other.feedthrough[...] = 0


def test_the_text_of_single_modes_is_a_call_of_modes():
    modes = phc.modes([1.0, 2.0], [0.5, 0.25], damping=0.1)
    again = eval(repr(modes), {"modes": phc.modes, "array": np.array})
    assert np.array_equal(again.freqresp([0.5, 1.5]), modes.freqresp([0.5, 1.5]))
    assert "damping ratio" in modes._repr_html_()
    assert repr(phc.modes(ct.ss(ct.tf([1, 2], [1, 1])))) == "<ModalForm: 1 modes, 1 outputs, 1 inputs>"


def test_what_only_lossless_forms_have_is_refused_with_the_damping():
    modes = phc.modes([1.0, 2.0], [0.5, 0.25], damping=0.1)
    for ask in (lambda: modes.d, lambda: modes.kappa, lambda: modes.minimal(), lambda: modes.coefficients()):
        with pytest.raises(phc.NotLosslessError, match=r"these have damping ratios 0\.1, 0\.1"):
            ask()
    with pytest.raises(phc.NotLosslessError, match="off the imaginary axis"):
        phc.ph(modes, lossless=True)


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        (([1j - 1], [1.0]), {}, "d is complex"),
        (([-1 - 1j], [1.0], [1.0]), {}, "in the lower half-plane; give one of each pair"),
        (([-1.0], [1j], [1.0]), {}, "of a real pole are complex"),
        (([-1.0 + 1j], [1.0, 2.0], [[1.0], [2.0]]), {}, "participation has shape"),
        (([np.inf], [1.0], [1.0]), {}, "the poles"),
        (([1.0], [1.0], [1.0]), {"damping": 0.1}, "and no damping"),
        (([1.0],), {"damping": 0.1}, "give d and r"),
        (([1.0], [1.0]), {"damping": [0.1, 0.2]}, "damping has shape"),
        (([1.0], [1.0]), {"damping": np.nan}, "damping is not finite"),
        ((ct.ss([[0.5]], [[1.0]], [[1.0]], 0.0, 0.1),), {}, "the system is discrete-time"),
        ((ct.ss([[np.inf]], [[1.0]], [[1.0]], 0.0),), {}, "not finite"),
    ],
)  # fmt: skip
def test_what_is_no_modal_form_is_refused(arguments, options, message):
    with pytest.raises(phc.StructureError, match=message):
        phc.modes(*arguments, **options)


@pytest.mark.parametrize("damping", [[[0.1, -0.1], [-0.1, 0.1]], [[0.1, 0.0], [0.0, 0.0]]])
def test_a_rigid_body_with_dampers_has_poles_at_0_exactly_and_none_to_the_right(damping):
    floating = phc.from_second_order(np.diag([1.0, 3.0]), [[1.0, -1.0], [-1.0, 1.0]], [1.0, 0.0], C=damping)
    free = bool(damping[0][1])
    poles = floating.poles()
    assert poles.real.max() == 0 and np.sum(poles == 0) == 1 + free
    assert floating.damping_ratios.min() >= 0
    # far below the elastic mode the rigid body alone: `1 / (4 s)`; of two equal poles rounding leaves `eps / s`
    assert not free or abs(floating(1e-6j) - 0.25 / 1e-6j) < 1e-9 * 0.25e6
    M, K, C = np.diag([1.0, 3.0]), np.array([[1.0, -1.0], [-1.0, 1.0]]), np.array(damping)
    for s in (1e-3j, 0.4j, 1.0 + 1.0j):
        truth = s * np.linalg.inv(s**2 * M + s * C + K)[0, 0]
        assert abs(floating(s) - truth) < 1e-9 * abs(truth)


def test_a_label_that_python_control_cannot_place_is_refused():
    """Where there are more outputs than inputs it takes one for the other."""
    watched = phc.ph(np.eye(2), [0.0, 1.0], R=np.eye(2), sensors=np.eye(2))
    with pytest.raises(TypeError):
        watched.bode_plot(label="a")
