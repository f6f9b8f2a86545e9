"""python-control takes port-Hamiltonian systems everywhere, and gives with them what it gives with their matrices."""

import gc
import warnings
import weakref

import control as ct
import matplotlib.pyplot as plt
import numpy as np
import pytest
import reference as ref
from control.pzmap import PoleZeroData

import ph_control as phc

EPS = ref.EPS
PH, SS, TF = phc.PortHamiltonian, ct.StateSpace, ct.TransferFunction


def chain(**names):
    """Two masses and two springs, pushed and watched at the first."""
    K = np.array([[3.0, -1.0], [-1.0, 1.0]])
    return phc.ph(np.block([[K, np.zeros((2, 2))], [np.zeros((2, 2)), np.diag([1.0, 0.5])]]), [0, 0, 1, 0], **names)


def two_port(**names):
    K = np.array([[3.0, -1.0], [-1.0, 1.0]])
    B = np.vstack([np.zeros((2, 2)), np.eye(2)])
    return phc.ph(np.block([[K, np.zeros((2, 2))], [np.zeros((2, 2)), np.diag([1.0, 0.5])]]), B, **names)


def floating():
    return phc.ph(np.diag([0.0, 0.5]), [0.0, 1.0])


def controller():
    return ct.ss([[-1.0]], [[1.0]], [[2.0]], [[0.5]], name="controller", inputs="e", outputs="f")


def close(got, truth, factor=1000):
    return np.max(np.abs(np.asarray(got) - truth), initial=0.0) <= factor * EPS * max(
        1.0, np.max(np.abs(truth), initial=0)
    )


def transfer(sys, s):
    """By a linear solve, whatever the class says of itself."""
    sys = ct.ss(sys)
    return ref.dense_transfer_function(sys.A, sys.B, sys.C, s) + sys.D


POINTS = (0.3 + 0.2j, 2.0, -1.0 + 4.0j)


# --- systems out of systems --------------------------------------------------------------------------------------

CONNECTIONS = [
    ("series", lambda sys: ct.series(sys, controller()), SS, lambda G, K: K * G),
    ("series from the left", lambda sys: ct.series(controller(), sys), SS, lambda G, K: G * K),
    ("parallel", lambda sys: ct.parallel(sys, controller()), SS, lambda G, K: G + K),
    ("parallel of two", lambda sys: ct.parallel(sys, sys), PH, lambda G, K: 2 * G),
    ("negative feedback", lambda sys: ct.feedback(sys, controller()), SS, lambda G, K: G / (1 + G * K)),
    ("positive feedback", lambda sys: ct.feedback(sys, controller(), sign=1), SS, lambda G, K: G / (1 - G * K)),
    ("feedback around a controller", lambda sys: ct.feedback(controller(), sys), SS, lambda G, K: K / (1 + G * K)),
    ("unit feedback", lambda sys: ct.feedback(sys), phc.DissipativePortHamiltonian, lambda G, K: G / (1 + G)),
    ("negate", ct.negate, SS, lambda G, K: -G),
    ("tf", ct.tf, TF, lambda G, K: G),
    ("ss", ct.ss, SS, lambda G, K: G),
    ("minreal", lambda sys: ct.minreal(sys, verbose=False), SS, lambda G, K: G),
    ("modal form", lambda sys: ct.canonical_form(sys, "modal")[0], SS, lambda G, K: G),
    ("observable form", lambda sys: ct.canonical_form(sys, "observable")[0], SS, lambda G, K: G),
    ("reachable form", lambda sys: ct.canonical_form(sys, "reachable")[0], SS, lambda G, K: G),
    ("linearize", lambda sys: ct.linearize(sys, np.zeros(4), [0]), SS, lambda G, K: G),
]  # fmt: skip


@pytest.mark.parametrize(("what", "make", "expected", "value"), CONNECTIONS, ids=[row[0] for row in CONNECTIONS])
def test_functions_of_python_control_give_plain_systems_with_the_right_transfer_function(what, make, expected, value):
    sys = chain()
    result = make(sys)
    assert type(result) is expected
    for s in POINTS:
        G, K = transfer(sys, s)[0, 0], transfer(controller(), s)[0, 0]
        assert close(result(s), value(G, K), 1e5 if "form" in what else 1000)


def test_append_puts_systems_side_by_side():
    result = ct.append(chain(), controller(), two_port())
    assert type(result) is SS
    assert (result.ninputs, result.nstates) == (4, 9)
    for s in POINTS:
        expected = np.zeros((4, 4), complex)
        expected[0, 0] = transfer(chain(), s)[0, 0]
        expected[1, 1] = transfer(controller(), s)[0, 0]
        expected[2:, 2:] = transfer(two_port(), s)
        assert close(transfer(result, s), expected)


def test_interconnect_joins_systems_by_the_names_of_their_signals():
    plant = chain(name="plant", inputs="f", outputs="v")
    error = ct.summing_junction(["r", "-v"], "e")
    result = ct.interconnect([plant, controller(), error], inputs="r", outputs="v")
    assert isinstance(result, SS)
    assert not isinstance(result, PH)
    assert result.state_labels[:4] == [f"plant_x[{i}]" for i in range(4)]
    for s in POINTS:
        G, K = transfer(plant, s)[0, 0], transfer(controller(), s)[0, 0]
        assert close(transfer(result, s)[0, 0], G * K / (1 + G * K))


def test_interconnect_takes_ports_of_several_systems_by_index():
    left, right = two_port(name="left"), chain(name="right")
    result = ct.interconnect(
        [left, right],
        connections=[["right.u[0]", "left.y[1]"]],
        inplist=["left.u[0]", "left.u[1]"],
        outlist=["right.y[0]", "left.y[0]"],
    )
    for s in POINTS:
        G = transfer(left, s)
        assert close(transfer(result, s), np.vstack([transfer(right, s) @ G[1:], G[:1]]))


@pytest.mark.parametrize("method", ["zoh", "bilinear", "euler", "backward_diff"])
@pytest.mark.parametrize("sys", [chain(), two_port()], ids=["one port", "two ports"])
def test_sampling_gives_the_discrete_state_space_that_the_matrices_give(sys, method):
    result = ct.sample_system(sys, 0.1, method=method)
    truth = ct.sample_system(ct.ss(sys), 0.1, method=method)
    assert type(result) is SS
    assert result.dt == 0.1
    for name in "ABCD":
        assert np.array_equal(getattr(result, name), getattr(truth, name))


def test_an_entry_keeps_the_names_of_its_signals():
    sys = two_port(name="beam", inputs=["f", "g"], outputs=["v", "w"])
    entry = sys["w", "f"]
    assert type(entry) is SS
    assert (entry.input_labels, entry.output_labels) == (["f"], ["w"])
    for s in POINTS:
        assert close(entry(s), transfer(sys, s)[1, 0])


# --- numbers out of systems --------------------------------------------------------------------------------------


@pytest.mark.parametrize("sys", [chain(), two_port(), floating()], ids=["one port", "two ports", "floating"])
def test_the_frequency_response_is_that_of_the_matrices(sys):
    omega = np.array([0.01, 0.3, 1.3, 7.0])
    response = ct.frequency_response(sys, omega)
    assert type(response) is ct.FrequencyResponseData
    for k, w in enumerate(omega):
        assert close(response.frdata[:, :, k], transfer(sys, 1j * w), 1e4)
    assert response.sysname == sys.name


def test_the_frequency_response_at_a_pole_is_infinite_and_warns_of_nothing():
    sys = chain()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        value = sys(1j * sys.d[0])
        along = ct.frequency_response(sys, np.array([0.1, sys.d[0], sys.d[1]])).frdata[0, 0]
    assert np.isinf(value)
    assert np.array_equal(np.isinf(along), [False, True, True])
    assert not np.isnan(along.real).any()
    assert not np.isnan(along.imag).any()


@pytest.mark.parametrize(
    ("x", "squeeze", "shape"),
    [(1.0, None, ()), ([1.0], None, (1,)), ([1.0, 2j, 3], None, (3,)), ([1.0, 2j], False, (1, 1, 2))],
)
def test_a_call_gives_the_shape_that_python_control_gives(x, squeeze, shape):
    assert np.shape(chain()(x, squeeze=squeeze)) == np.shape(ct.ss(chain())(x, squeeze=squeeze)) == shape
    assert np.shape(two_port()(x, squeeze=squeeze)) == np.shape(ct.ss(two_port())(x, squeeze=squeeze))


def test_the_value_at_zero_is_zero_or_infinite():
    assert chain().dcgain() == ct.dcgain(chain()) == 0
    assert np.max(np.abs(two_port().dcgain())) < EPS**2
    assert floating().dcgain() == np.inf


def test_damping_ratios_are_zero_and_frequencies_those_of_the_modes():
    sys = chain()
    frequencies, damping, poles = ct.damp(sys, doprint=False)
    assert np.array_equal(np.sort(frequencies), np.repeat(sys.d, 2))
    assert np.array_equal(damping, np.zeros(4))
    assert np.array_equal(np.sort(poles.imag), np.sort(np.r_[-sys.d, sys.d]))


def test_the_pole_zero_map_interlaces_on_the_axis():
    sys = chain()
    poles_and_zeros = ct.pole_zero_map(sys)
    assert isinstance(poles_and_zeros, PoleZeroData)
    assert np.all(poles_and_zeros.poles.real == 0)
    assert np.all(poles_and_zeros.zeros.real == 0)
    upper = np.sort(np.r_[poles_and_zeros.poles, poles_and_zeros.zeros].imag)
    kinds = [w in poles_and_zeros.poles.imag for w in upper]
    assert kinds == [True, False] * 3 + [True]


def test_poles_and_zeros_through_the_functions_of_python_control():
    sys = chain()
    assert np.array_equal(ct.poles(sys), sys.poles())
    assert np.array_equal(ct.zeros(sys), sys.zeros())
    assert np.allclose(np.sort(sys.poles().imag), np.sort(ct.ss(sys).poles().imag), rtol=0, atol=100 * EPS)
    assert np.allclose(np.sort(sys.zeros().imag), np.sort(ct.ss(sys).zeros().imag), rtol=0, atol=1e-7)


def test_margins_gramians_and_designs_run_on_the_matrices():
    sys = chain()
    assert np.linalg.matrix_rank(ct.ctrb(sys.A, sys.B)) == 4
    assert np.linalg.matrix_rank(ct.obsv(sys.A, sys.C)) == 4
    K, _, E = ct.lqr(sys, np.eye(4), 1.0)
    assert K.shape == (1, 4)
    assert np.all(np.real(E) < 0)
    L, _, _ = ct.lqe(sys, np.eye(1), np.eye(1))
    assert np.all(np.linalg.eigvals(sys.A - L @ sys.C).real < 0)
    for got, plain in zip(ct.stability_margins(sys), ct.stability_margins(ct.ss(sys)), strict=True):
        assert np.allclose(got, plain, rtol=1e-6, atol=1e-6, equal_nan=True)


# --- time --------------------------------------------------------------------------------------------------------

TIME = np.linspace(0, 5, 51)
INPUT = np.cos(1.7 * TIME)
RESPONSES = [
    ("step", lambda sys: ct.step_response(sys, TIME)),
    ("impulse", lambda sys: ct.impulse_response(sys, TIME)),
    ("initial", lambda sys: ct.initial_response(sys, TIME, np.arange(1.0, 5))),
    ("forced", lambda sys: ct.forced_response(sys, TIME, np.tile(INPUT, (sys.ninputs, 1)), np.arange(1.0, 5))),
    ("input-output", lambda sys: ct.input_output_response(sys, TIME, np.tile(INPUT, (sys.ninputs, 1)), np.zeros(4))),
]


@pytest.mark.parametrize("make", [chain, two_port])
@pytest.mark.parametrize(("what", "respond"), RESPONSES, ids=[row[0] for row in RESPONSES])
def test_time_responses_are_those_of_the_matrices_and_carry_the_names(what, respond, make):
    sys = make(name="beam", states=["q1", "q2", "p1", "p2"])
    response, truth = respond(sys), respond(ct.ss(sys))
    assert type(response) is ct.TimeResponseData
    assert response.sysname == "beam"
    assert response.state_labels == ["q1", "q2", "p1", "p2"]
    assert np.max(np.abs(truth.outputs)) > 0.1
    assert np.array_equal(response.outputs, truth.outputs)
    assert np.array_equal(response.states, truth.states)


def test_the_default_time_vector_of_python_control_works():
    response = ct.step_response(chain())
    assert len(response.time) > 10
    assert np.all(np.isfinite(response.outputs))


def test_our_responses_agree_with_those_of_python_control():
    sys = two_port()
    ours, theirs = phc.step_response(sys, TIME), ct.step_response(ct.ss(sys), TIME)
    assert np.allclose(ours.outputs, theirs.outputs, rtol=0, atol=1e-12)
    ours = phc.forced_response(sys, TIME, np.tile(INPUT, (2, 1)), intersample="foh")
    theirs = ct.forced_response(ct.ss(sys), TIME, np.tile(INPUT, (2, 1)))
    assert np.allclose(ours.outputs, theirs.outputs, rtol=0, atol=1e-12)


def test_the_dynamics_and_the_output_function_are_those_of_the_matrices():
    for sys in (chain(), two_port(), phc.ph(phc.modes([1.0, 2.0], [1.0, 1.0]))):
        z, u = np.arange(1.0, 5), np.arange(1.0, 1 + sys.ninputs)
        assert close(sys.dynamics(0.0, z, u), sys.A @ z + sys.B @ u)
        assert close(sys.output(0.0, z, u), sys.C @ z)


# --- pictures ----------------------------------------------------------------------------------------------------

PLOTS = [
    ct.bode_plot,
    ct.nyquist_plot,
    ct.nichols_plot,
    ct.pole_zero_plot,
    ct.root_locus_plot,
    ct.singular_values_plot,
    lambda sys: ct.gangof4_plot(sys, controller()),
    lambda sys: ct.step_response(sys, TIME).plot(),
    lambda sys: ct.frequency_response(sys, np.logspace(-1, 1, 40)).plot(),
]


@pytest.mark.variants
@pytest.mark.parametrize("plot", PLOTS, ids=range(len(PLOTS)))
def test_each_plot_of_python_control_draws_a_system(plot):
    picture = plot(chain())
    assert isinstance(picture, ct.ControlPlot)
    plt.close("all")


def curves(picture, row):
    """Data of the curves of one row of a Bode plot, without the vertical lines at special frequencies."""
    lines = [line for axis in picture.axes[row] for line in axis.get_lines()]
    return [line.get_xydata() for line in lines if len(line.get_xdata()) > 10]


@pytest.mark.slow
def test_a_bode_plot_takes_a_mixed_list_and_draws_the_same_curve_twice():
    sys = chain()
    omega = np.logspace(-1, 1, 101)
    picture = ct.bode_plot([sys, ct.ss(sys)], omega)
    assert isinstance(picture, ct.ControlPlot)
    for row in (0, 1):
        first, second = curves(picture, row)
        assert np.array_equal(first[:, 0], omega)
        # a phase that jumps by half a turn may be drawn a whole turn lower
        difference = first[:, 1] - second[:, 1] if row == 0 else (first[:, 1] - second[:, 1] + 180) % 360 - 180
        assert np.max(np.abs(difference)) < 1e-9 * np.max(np.abs(first[:, 1]))
    magnitude = curves(picture, 0)[0][:, 1]
    assert np.allclose(magnitude, [abs(transfer(sys, 1j * w)[0, 0]) for w in omega], rtol=1e-9)
    assert picture.lines.shape == (2, 1)


def test_the_phase_of_a_lossless_system_is_plus_or_minus_a_quarter_turn():
    phase = curves(ct.bode_plot(chain(), np.logspace(-1, 1, 101)), 1)[0][:, 1]
    assert np.allclose(np.abs(phase % 360 - 180), 90, rtol=0, atol=1e-9)


def displacement(sys):
    return phc.affine(sys.Q, ref.symplectic_form(sys.n) @ sys.B)


def spans(picture):
    return [(axis.min(), axis.max()) for axis in (curve[:, 1] for curve in curves(picture, 1))]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sys", "low", "high"),
    [
        (phc.frenkel_kontorova(6), -90, 90),
        (phc.ch([1.0, 2.0], [1.0, 1.0, 0.3, 0.2]), -90, 90),
        (phc.ph(np.diag([0.0, 4.0, 1.0, 2.0]), [1.0, -1.0, 2.0, 0.0]), -90, 90),
        (phc.affine(np.diag([0.0, 4.0, 1.0, 2.0]), [1.0, -1.0, 0.0, 0.0]), -180, 0),
        (displacement(phc.frenkel_kontorova(3)), -180, 0),
    ],
    ids=["chain", "canonical form", "rigid body", "affine, free", "affine"],
)
def test_python_control_unwraps_the_phase_of_a_lossless_port_the_way_it_goes(sys, low, high):
    ((least, most),) = spans(sys.bode_plot())
    assert abs(least - low) < 1e-9 and abs(most - high) < 1e-9
    for draw in (ct.bode_plot, lambda sys: ct.frequency_response(sys).plot(), lambda sys: ct.bode_plot([sys])):
        plt.close("all")
        ((least, most),) = spans(draw(sys))
        assert abs(most - least - 180) < 1e-9 and min((least - low) % 360, (low - least) % 360) < 1e-9
    plt.close("all")
    ((least, most),) = spans(sys.bode_plot(initial_phase=720))
    assert abs(least - 720 - low) < 1e-9
    plt.close("all")


def test_the_phase_between_two_ports_falls_at_each_resonance_without_an_antiresonance_before_it():
    """As the phase of the same structure with a little damping does."""
    M, K, b = np.eye(4), 4 * np.eye(4) - 2 * np.eye(4, k=1) - 2 * np.eye(4, k=-1), np.eye(4)[:, [0, 3, 1]]
    omega = np.linspace(0.05, 4.5, 4000)
    A = np.block([[0 * M, M], [-K, -1e-9 * K]])
    B = np.concatenate([0 * b, b])
    C = np.concatenate([0 * b, b]).T
    frame = phc.from_second_order(M, K, b)
    for sys, out in ((frame, C), (displacement(frame), np.roll(C, 4, 1))):
        ours = ct.frequency_response(sys, omega).frdata
        damped = ct.frequency_response(ct.ss(A, B, out, 0), omega).frdata
        assert np.max(np.abs(np.unwrap(np.angle(ours)) - np.unwrap(np.angle(damped)))) < 1e-3


@pytest.mark.slow
def test_a_bode_plot_without_frequencies_and_of_several_ports_draws():
    for sys in ([chain(), controller()], two_port(), [floating(), ct.ss(floating())]):
        assert isinstance(ct.bode_plot(sys), ct.ControlPlot)
        plt.close("all")


# --- standing beside StateSpace ----------------------------------------------------------------------------------


def test_a_system_counts_as_a_continuous_linear_state_space():
    for sys in (chain(), two_port(), floating()):
        assert isinstance(sys, SS)
        assert sys.isctime()
        assert not sys.isdtime()
        assert ct.isctime(sys, strict=True)
        assert sys.dt == 0
        assert ct.issiso(sys) == (sys.ninputs == 1)
        A, B, C, D = ct.ssdata(sys)
        for given, own in ((A, sys.A), (B, sys.B), (C, sys.C), (D, sys.D)):
            assert np.array_equal(given, own)


def test_nothing_in_the_configuration_of_python_control_removes_states_or_sets_a_timebase():
    before = dict(ct.config.defaults)
    try:
        ct.config.defaults["statesp.remove_useless_states"] = True
        ct.config.defaults["control.default_dt"] = 0.5
        hidden = phc.ph(np.eye(4), [0.0, 0.0, 1.0, 0.0])
        assert hidden.nstates == 4
        assert hidden.dt == 0
        assert phc.ph(phc.modes(1.0, 1.0)).dt == 0
    finally:
        ct.config.defaults.clear()
        ct.config.defaults.update(before)


def test_what_comes_back_from_python_control_can_be_made_port_hamiltonian_again():
    sys = chain()
    for changed in (
        ct.ss(sys),
        ct.tf(sys),
        ct.minreal(ct.append(sys, 0)[0, 0], verbose=False),
        ct.similarity_transform(sys, np.diag([1.0, 2.0, 4.0, 8.0])),
        ct.negate(-sys),
        sys - 0 * sys,
        sys * 2 - sys,
        ct.parallel(ct.ss(sys), ct.ss(sys)),
    ):
        factor = 2 if changed.nstates == 8 and changed(1.0) != pytest.approx(sys(1.0)) else 1
        again = phc.ph(changed)
        assert np.allclose(again.modes.minimal().d, sys.d, rtol=1e-10)
        assert np.allclose(again.modes.minimal().r, factor * sys.r, rtol=1e-9)


def test_feedback_of_two_lossless_systems_is_lossless_again():
    """The negative feedback of passive systems without loss has none."""
    closed = ct.feedback(chain(), 0.7 * chain())
    assert type(closed) is PH
    sys = phc.ph(ct.ss(closed))
    assert type(sys) is PH
    for s in POINTS:
        assert close(sys(s), transfer(closed, s)[0, 0], 1e6)


# --- names and functions ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ports", [1, 2])
def test_names_that_nobody_gave_are_those_of_a_state_space_system(ports):
    Q, B = np.diag([4.0, 9.0, 1.0, 1.0]), np.ones((4, ports))
    system = phc.ph(Q, B)
    plain = ct.StateSpace(system.A, system.B, system.C, system.D)
    for kind in ("input", "output", "state"):
        assert getattr(system, f"{kind}_labels") == getattr(plain, f"{kind}_labels")
        assert getattr(system, f"{kind}_index") == getattr(plain, f"{kind}_index")
        assert getattr(system, f"n{kind}s") == getattr(plain, f"n{kind}s")
    # whatever python-control gives a system is there, and of the same kind
    named = phc.ph(Q, B, name="plant")
    for name in vars(plain):
        assert type(getattr(system, name)) in {type(getattr(plain, name)), type(getattr(named, name))}
    assert system._generic_name_check()
    assert phc.ph(Q, B).name != system.name


def test_names_of_one_system_are_not_those_of_another():
    first, second = phc.ph(np.eye(2), [1.0, 0.0]), phc.ph(np.eye(2), [1.0, 0.0])
    first.set_inputs(["force"])
    first.set_states(["q", "p"])
    first.params["k"] = 1.0
    assert (second.input_labels, second.state_labels, second.params) == (["u[0]"], ["x[0]", "x[1]"], {})
    assert first.state_labels == ["q", "p"]
    small = phc.minreal(first)
    small.set_inputs(["other"])
    assert first.input_labels == ["force"]


def test_the_functions_of_a_system_are_its_equations():
    system = phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0])
    for same in (system, phc.ph(system.Q, system.B, name="plant")):
        assert np.array_equal(same.updfcn(0.0, [1.0, 2.0], [3.0], {}), [2.0, -1.0])
        assert np.array_equal(same.outfcn(0.0, [1.0, 2.0], [3.0], {}), [2.0])


@pytest.mark.parametrize("names", [{}, {"name": "plant"}])
def test_a_system_goes_when_its_last_user_does(names):
    system = phc.ph(np.eye(2), [1.0, 0.0], **names)
    gone = weakref.ref(system)
    gc.disable()
    try:
        del system
        assert gone() is None
    finally:
        gc.enable()
