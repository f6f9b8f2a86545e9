"""Time responses: values against dense matrices, values and shapes against python-control."""

import inspect
import pickle
import warnings

import control as ct
import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import EPS, dense_matrices, dense_simulation, random_hamiltonian, random_symplectic

import ph_control as phc

relaxed = settings(deadline=None, max_examples=13, derandomize=True)
seeds = st.integers(0, 2**32 - 1)

RULES = [("exact", "zoh"), ("exact", "foh"), ("midpoint", "zoh"), ("midpoint", "foh"), ("euler", "zoh")]
RESPONSES = [phc.forced_response, phc.step_response, phc.impulse_response, phc.initial_response]


def semidefinite(D, rng, ports):
    """A dense Q with a symplectic normal form diag(D), and random ports."""
    S = random_symplectic(len(D) // 2, rng, 0.5)
    Q = S.T @ np.diag(D) @ S
    return 0.5 * (Q + Q.T), rng.standard_normal((len(D), ports))


def matrices():
    rng = np.random.default_rng(2)
    return {
        "one port": (random_hamiltonian([1.0, 2.0, 3.5], rng, 0.5)[0], rng.standard_normal((6, 1))),
        "two ports": (random_hamiltonian([0.7, 2.0], rng, 0.5)[0], rng.standard_normal((4, 2))),
        "repeated frequency": (random_hamiltonian([1.0, 1.0, 2.0], rng, 0.5)[0], rng.standard_normal((6, 1))),
        "free momentum": semidefinite([0.0, 1.0, 2.0, 1.0, 1.0, 2.0], rng, 1),
        "free momenta, two ports": semidefinite([0.0, 0.0, 2.0, 1.0, 3.0, 2.0], rng, 2),
        "cyclic pair": semidefinite([0.0, 1.0, 0.0, 1.0], rng, 1),
        "no springs": (np.diag([0.0, 0.0, 1.0, 4.0]), rng.standard_normal((4, 1))),
        "no energy at all": (np.zeros((2, 2)), rng.standard_normal((2, 1))),
    }


MATRICES = matrices()


def largest(*arrays):
    return max(float(np.max(np.abs(a), initial=0.0)) for a in arrays)


def assert_close(got, truth, steps, size=None):
    """Agree up to the rounding that `steps` dense steps may collect."""
    assert got.shape == truth.shape
    size = largest(truth) if size is None else size
    assert largest(np.asarray(got) - np.asarray(truth)) <= 100 * steps * EPS * size


# --- values against dense matrices ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("method", "intersample"), RULES)
@pytest.mark.parametrize("name", MATRICES)
def test_outputs_and_states_are_those_of_the_dense_system(name, method, intersample):
    Q, B = MATRICES[name]
    rng = np.random.default_rng(3)
    t = 0.5 + 0.05 * np.arange(120)
    u, z0 = rng.standard_normal((B.shape[1], t.size)), rng.standard_normal(len(Q))
    sys = phc.ph(Q, B)
    got = phc.forced_response(sys, t, u, z0, method=method, intersample=intersample, squeeze=False)
    y, z = dense_simulation(*dense_matrices(Q, B), u, z0, 0.05, method, intersample)
    # an output is a sum of products with rows of C
    size = largest(np.abs(dense_matrices(Q, B)[2]) @ np.abs(z))
    assert_close(got.outputs, y, t.size, size)
    assert_close(got.states, z, t.size)
    assert np.array_equal(got.inputs, u)
    assert np.array_equal(got.time, t)


@relaxed
@given(st.integers(1, 5), st.integers(1, 2), seeds, st.sampled_from(RULES), st.floats(1e-3, 2.0))
def test_random_systems_agree_with_dense_matrices(n, ports, seed, rule, h):
    rng = np.random.default_rng(seed)
    Q, _ = random_hamiltonian(rng.uniform(0.3, 2.0, n), rng, 0.5)
    B = rng.standard_normal((2 * n, ports))
    u, z0 = rng.standard_normal((ports, 30)), rng.standard_normal(2 * n)
    got = phc.forced_response(phc.ph(Q, B), h * np.arange(30), u, z0, method=rule[0], intersample=rule[1])
    A, B, C = dense_matrices(Q, B)
    y, z = dense_simulation(A, B, C, u, z0, h, *rule)
    assert_close(np.atleast_2d(got.outputs), y, 30, largest(np.abs(C) @ np.abs(z)))
    assert_close(got.states, z, 30)


@pytest.mark.parametrize("ratio", [1e6, 1e10])
def test_a_stiff_dense_system_starts_where_it_was_told_to(ratio):
    Q, _ = random_hamiltonian([1.0, 1.0, ratio, ratio], np.random.default_rng(4), 0.0)
    z0 = np.arange(1.0, 9.0)
    got = phc.initial_response(phc.ph(Q, np.ones(8)), [0.0, 1.0], z0)
    assert largest(got.states[:, 0] - z0) < 200 * EPS * largest(z0)


def test_the_step_is_the_one_the_instants_were_made_of():
    """An error of one unit in the last place of the step would show as `d t eps`, far above the bound."""
    k, d = 100_000, 3.0
    steps = [h for h in np.linspace(0.1, 0.9, 50) if (k * h - 0.0) / k != h]
    assert len(steps) > 2
    for h in steps[:3]:
        response = phc.impulse_response(phc.ph(phc.modes(d, 1.0)), h * np.arange(k + 1))
        with mp.workdps(50):
            truth = d * mp.cos(mp.mpf(d) * mp.mpf(float(h)) * k)
        assert abs(response.outputs[-1] - float(truth)) < 1000 * EPS * d
        assert d * d * k * np.spacing(h) > 10 * 1000 * EPS * d


def test_printed_instants_are_followed_with_their_mean_step():
    t = np.round(np.arange(1001) / 3, 3)
    response = phc.impulse_response(phc.ph(phc.modes(1.0, 1.0)), t)
    assert largest(response.outputs - np.cos(np.linspace(0, t[-1], 1001))) < 1000 * EPS


@pytest.mark.parametrize("method", ["exact", "midpoint"])
def test_the_energy_of_a_free_motion_is_conserved(method):
    for name in ("one port", "two ports", "free momentum"):
        sys = phc.ph(*MATRICES[name])
        z0 = np.random.default_rng(5).standard_normal(sys.nstates)
        states = phc.initial_response(sys, 0.1 * np.arange(3000), z0, method=method).states
        energy = sys.hamiltonian(states)
        size = np.linalg.norm(sys.Q, 2) * largest(states) ** 2
        assert largest(energy - energy[0]) < 3000 * EPS * size


def test_the_energy_under_euler_grows_by_one_plus_h_d_squared_a_step():
    d, h = 2.0, 0.05
    sys = phc.ph(phc.modes(d, 1.0))
    states = phc.initial_response(sys, h * np.arange(500), [1.0, -2.0], method="euler").states
    energy = sys.hamiltonian(states)
    assert largest(energy[1:] / energy[:-1] / (1 + (h * d) ** 2) - 1) < 100 * EPS
    assert energy[-1] > 100 * energy[0]


def test_the_methods_converge_to_the_exact_response_with_their_orders():
    sys = phc.ph(*MATRICES["one port"])
    exact = phc.initial_response(sys, [0.0, 1.0], 1.0).outputs[-1]

    def error(method, steps):
        return abs(phc.initial_response(sys, np.linspace(0, 1, steps + 1), 1.0, method=method).outputs[-1] - exact)

    assert 1.8 < error("euler", 2000) / error("euler", 4000) < 2.2
    assert 3.8 < error("midpoint", 200) / error("midpoint", 400) < 4.2


# --- values and shapes against python-control ----------------------------------------------------------------------


def assert_same(ours, theirs, steps=200):
    """Same values, shapes and labels of time, outputs, states and inputs."""
    for name in ("time", "outputs", "states"):
        assert_close(np.asarray(getattr(ours, name)), np.asarray(getattr(theirs, name)), steps)
    for name in ("issiso", "output_labels", "state_labels", "trace_labels", "trace_types", "ntraces", "plot_inputs"):
        assert getattr(ours, name) == getattr(theirs, name), name
    assert ours.ninputs == theirs.ninputs


SHAPES = [{}, {"squeeze": True}, {"squeeze": False}, {"transpose": True}, {"transpose": True, "squeeze": False}]
TIME = np.linspace(0, 4, 101)


@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("name", ["one port", "two ports", "free momentum"])
class TestPythonControlGivesTheSame:
    """`control.forced_response` interpolates its input linearly."""

    def test_forced_response(self, name, shape):
        sys = phc.ph(*MATRICES[name], name="sys")
        u = np.random.default_rng(6).standard_normal((sys.ninputs, TIME.size))
        u = u.T if shape.get("transpose") else u
        ours = phc.forced_response(sys, TIME, u, 0.5, **shape)
        theirs = ct.forced_response(ct.ss(sys, name="sys"), TIME, u, 0.5, **shape)
        assert_same(ours, theirs)
        assert np.array_equal(ours.inputs, theirs.inputs)
        assert ours.title == theirs.title
        held = phc.forced_response(sys, TIME, u, 0.5, intersample="zoh", **shape)
        assert largest(held.outputs - ours.outputs) > 1e-3 * largest(ours.outputs)

    @pytest.mark.parametrize(
        "indices", [{}, {"output_indices": 0}, {"input_indices": 0}, {"output_indices": 0, "input_indices": 0}], ids=str
    )
    def test_step_response(self, name, shape, indices):
        sys = phc.ph(*MATRICES[name], name="sys")
        ours = phc.step_response(sys, TIME, 0.5, **indices, **shape)
        theirs = ct.step_response(ct.ss(sys, name="sys"), TIME, 0.5, **indices, **shape)
        assert_same(ours, theirs)
        assert ours.inputs.shape == theirs.inputs.shape
        assert ours.title == theirs.title

    @pytest.mark.parametrize(
        "indices", [{}, {"output_indices": 0}, {"input_indices": 0}, {"output_indices": 0, "input_indices": 0}], ids=str
    )
    def test_impulse_response(self, name, shape, indices):
        sys = phc.ph(*MATRICES[name], name="sys")
        ours = phc.impulse_response(sys, TIME, **indices, **shape)
        theirs = ct.impulse_response(ct.ss(sys, name="sys"), TIME, **indices, **shape)
        assert_same(ours, theirs)
        assert ours.title == theirs.title

    @pytest.mark.parametrize("indices", [{}, {"output_indices": 0}], ids=str)
    def test_initial_response(self, name, shape, indices):
        sys = phc.ph(*MATRICES[name], name="sys")
        z0 = np.arange(1.0, sys.nstates + 1)
        ours = phc.initial_response(sys, TIME, z0, **indices, **shape)
        theirs = ct.initial_response(ct.ss(sys, name="sys"), TIME, z0, **indices, **shape)
        assert_same(ours, theirs)
        assert ours.inputs is None
        assert theirs.inputs is None
        assert ours.title == theirs.title


@pytest.mark.parametrize("keep", [None, True, False])
def test_unpacking_gives_time_and_outputs_and_states_on_request(keep):
    sys = phc.ph(*MATRICES["two ports"])
    plain = ct.ss(sys)
    u = np.ones((2, TIME.size))
    ours = tuple(phc.forced_response(sys, TIME, u, intersample="foh", return_states=keep))
    theirs = tuple(ct.forced_response(plain, TIME, u, return_states=keep))
    assert len(ours) == len(theirs) == (3 if keep else 2)
    for mine, other in zip(ours, theirs, strict=True):
        assert_close(mine, other, 200)
    for response in (phc.step_response, phc.impulse_response, phc.initial_response):
        assert len(tuple(response(sys, TIME, return_states=bool(keep)))) == (3 if keep else 2)


def test_without_states_the_outputs_are_the_same_and_the_states_absent():
    sys = phc.ph(*MATRICES["free momentum"])
    with_states = phc.forced_response(sys, TIME, 1.0)
    without = phc.forced_response(sys, TIME, 1.0, return_states=False)
    assert np.array_equal(without.outputs, with_states.outputs)
    assert without.states.shape == (0, TIME.size)
    assert with_states.states.shape == (6, TIME.size)


@pytest.mark.parametrize("name", ["step_response", "impulse_response", "initial_response", "forced_response"])
def test_a_list_of_systems_gives_a_list_of_responses_at_common_instants(name):
    systems = [phc.ph(phc.modes([1.0], [1.0]), name="slow"), phc.ph(phc.modes([5.0, 7.0], [1.0, 2.0]), name="fast")]
    ours = getattr(phc, name)(systems, TIME)
    theirs = getattr(ct, name)([ct.ss(sys, name=sys.name) for sys in systems], TIME)
    assert type(ours) is type(theirs)
    assert len(ours) == 2
    for mine, other in zip(ours, theirs, strict=True):
        assert_close(mine.outputs, other.outputs, 200, max(largest(other.outputs), EPS))
        assert mine.sysname == other.sysname
    default = getattr(phc, name)(tuple(systems))
    assert np.array_equal(default[0].time, default[1].time)


def test_the_short_names_of_python_control_mean_the_same():
    sys = phc.ph(*MATRICES["two ports"])
    u = np.random.default_rng(0).standard_normal((2, TIME.size))
    z0 = np.arange(4.0)

    def same(first, second):
        return np.array_equal(first.outputs, second.outputs) and np.array_equal(first.states, second.states)

    assert same(phc.forced_response(sys, T=TIME, U=u, X0=z0, return_x=True), phc.forced_response(sys, TIME, u, z0))
    assert same(
        phc.step_response(sys, T=2.0, T_num=50, X0=z0, input=1, output=0, return_x=True),
        phc.step_response(sys, 2.0, z0, 1, 0, 50),
    )
    assert same(phc.impulse_response(sys, T=2.0, input=1), phc.impulse_response(sys, 2.0, input_indices=[1]))
    assert same(phc.initial_response(sys, T=TIME, X0=z0), phc.initial_response(sys, TIME, z0))
    assert len(tuple(phc.initial_response(sys, T=TIME, return_x=True))) == 3


@pytest.mark.parametrize("name", ["step_response", "impulse_response", "initial_response", "forced_response"])
def test_arguments_stand_where_python_control_has_them(name):
    ours = [p for p in inspect.signature(getattr(phc, name)).parameters.values() if p.kind is p.POSITIONAL_OR_KEYWORD]
    theirs = inspect.signature(getattr(ct, name)).parameters
    shared = [p for p in theirs if p in {q.name for q in ours}]
    assert [p.name for p in ours] == shared
    for parameter in ours:
        assert parameter.default == theirs[parameter.name].default


def test_responses_can_be_plotted():
    sys = phc.ph(*MATRICES["two ports"])
    for response in (
        phc.step_response(sys, TIME), phc.impulse_response(sys, TIME), phc.initial_response(sys, TIME, 1.0),
        phc.forced_response(sys, TIME, np.ones((2, TIME.size))),
    ):  # fmt: skip
        assert isinstance(response.plot(), ct.ControlPlot)


# --- corner cases --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("t", [0.0, 3.0, -2.0])
def test_a_single_instant_shows_the_initial_state(t):
    sys = phc.ph(*MATRICES["free momentum"])
    z0 = np.arange(1.0, 7.0)
    for method, intersample in RULES:
        got = phc.forced_response(sys, [t], [5.0], z0, method=method, intersample=intersample)
        assert got.outputs.shape == (1,)
        size = np.abs(sys.C) @ np.abs(z0)
        assert abs(got.outputs[0] - (sys.C @ z0)[0]) < 100 * EPS * size[0]
        assert largest(got.states[:, 0] - z0) < 100 * EPS * 7
    assert phc.step_response(sys, [t]).outputs == 0


def test_a_system_without_states_is_silent():
    nothing = phc.ph(phc.modes([], []))
    for response in RESPONSES:
        got = response(nothing, [0.0, 1.0, 2.0])
        assert np.array_equal(got.outputs, [0, 0, 0])
        assert got.states.shape[0] == 0
        assert response(nothing).outputs.shape == (101,)


def test_an_initial_state_may_be_a_number_a_vector_or_a_column():
    sys = phc.ph(*MATRICES["one port"])
    first = phc.initial_response(sys, TIME, 1.0).outputs
    assert np.array_equal(phc.initial_response(sys, TIME, np.ones(6)).outputs, first)
    assert np.array_equal(phc.initial_response(sys, TIME, np.ones((6, 1))).outputs, first)


def test_inputs_may_be_a_number_a_vector_or_a_row_and_are_not_modified():
    sys = phc.ph(*MATRICES["one port"])
    u = 2 * np.ones(TIME.size)
    time = TIME.copy()
    z0 = np.ones(6)
    first = phc.forced_response(sys, time, u, z0).outputs
    assert np.array_equal(phc.forced_response(sys, time, 2.0, z0).outputs, first)
    assert np.array_equal(phc.forced_response(sys, time, u[None, :], z0).outputs, first)
    assert np.array_equal(phc.forced_response(sys, time, u[:, None], z0, transpose=True).outputs, first)
    assert np.array_equal(u, 2 * np.ones(TIME.size))
    assert np.array_equal(time, TIME)
    assert np.array_equal(z0, np.ones(6))


def test_states_looked_at_later_are_those_of_the_inputs_and_instants_of_the_call():
    sys = phc.ph(*MATRICES["one port"])
    u, time = np.cos(TIME), TIME.copy()
    at_once = phc.forced_response(sys, time, u, 1.0, return_states=True)
    later = phc.forced_response(sys, time, u, 1.0)
    u[:], time[:] = 0.0, 0.0
    with pytest.raises(ValueError, match="read-only"):
        later.u[0, 0] = 5.0
    assert np.array_equal(later.states, at_once.states)
    assert np.array_equal(later.time, TIME)
    assert np.array_equal(later.inputs, np.cos(TIME))
    at_once.u[0, 0] = 5.0  # nothing hangs on it any more


@pytest.mark.parametrize(
    "time",
    [0.1 * np.arange(50), 3.7 + 0.1 * np.arange(50), np.linspace(0, 1, 50), np.round(np.arange(50) / 3, 3), [7.0]],
    ids=["made of a step", "later", "divided", "printed", "one"],
)
def test_the_instants_of_a_response_are_those_given_to_the_last_bit(time):
    response = phc.step_response(ONE, time)
    assert np.array_equal(response.time, time)
    assert response.time is response.t
    assert len(next(iter(response))) == response.outputs.size == len(time)
    twin = pickle.loads(pickle.dumps(response))
    assert np.array_equal(twin.time, time)
    response.t[0] = -1.0
    assert response.time[0] == -1.0


@pytest.mark.parametrize("t", [[0.0, 1e150, 1.5e150], [0.0, 1.0, 3.0], [0.0, 1e-320, 1.0], [1e9, 1e9 + 1, 1e9 + 3]])
def test_unequal_instants_are_refused_whatever_their_size(t):
    with pytest.raises(phc.StructureError, match="not equally spaced"):
        phc.step_response(ONE, t)


def test_instants_finer_than_their_own_rounding_must_still_increase():
    t = 1e9 + 1e-8 * np.arange(50)  # a unit in the last place is 1.2e-7
    with pytest.raises(phc.StructureError, match="does not increase"):
        phc.step_response(ONE, t)


# --- default instants ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_default_instants_resolve_the_fastest_mode_and_show_the_slowest(scale):
    for d in ([1.0], [1.0, 30.0], [1.0, 2.0, 300.0]):
        d = scale * np.array(d)
        t = phc.step_response(phc.ph(phc.modes(d, np.ones(len(d))))).time
        assert t[0] == 0
        assert t[-1] >= 2.99 * 2 * np.pi / d.min()
        assert t[1] - t[0] <= 2 * np.pi / d.max() / 19
        assert t.size <= 20_000


def test_default_instants_warn_of_the_modes_they_do_not_show_naming_them_and_the_caller():
    stiff = phc.ph(phc.modes([1e-3, 2e-3, 1e4], np.ones(3)))
    with pytest.warns(phc.ResolutionWarning, match=r"too short for 2 modes at d = 0.001, 0.002 rad") as caught:
        response = phc.step_response(stiff)
    assert caught[0].filename == __file__
    # the fast one is resolved all the same
    assert response.time[1] * 1e4 < 2 * np.pi / 7
    with pytest.warns(phc.ResolutionWarning, match=r"too coarse for 1 mode at d = 1e\+04 rad"):
        phc.impulse_response(stiff, 1e4)
    with pytest.warns(phc.ResolutionWarning, match=r"too short for 3 modes"):
        phc.initial_response(phc.ph(phc.modes([1.0, 2.0, 3.0, 1e3], np.ones(4))), timepts_num=100)
    with pytest.warns(phc.ResolutionWarning, match=r"4 modes at d = 0.0001, 0.0002, 0.0003, …"):
        phc.step_response(phc.ph(phc.modes([1e-4, 2e-4, 3e-4, 4e-4, 1e4], np.ones(5))))


def test_what_the_caller_chose_brings_no_warning_nor_do_modes_no_port_reaches():
    stiff = phc.ph(phc.modes([1e-3, 1e4], np.ones(2)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert phc.step_response(stiff, 1e-3).time[-1] == 1e-3
        assert phc.step_response(stiff, 1e3, timepts_num=5).time.size == 5
        assert phc.step_response(stiff, [0.0, 1.0]).time.size == 2
        hidden = phc.ph(phc.modes([1e-3, 1.0, 1e4], [0.0, 1.0, 0.0]))
        assert phc.step_response(hidden).time[-1] == pytest.approx(6 * np.pi)


# --- messages ------------------------------------------------------------------------------------------------------

ONE, TWO = phc.ph(phc.modes([1.0, 2.0], [1.0, 1.0])), phc.ph(*MATRICES["two ports"])
T3 = [0.0, 1.0, 2.0]

BAD = {
    "unequal steps": (
        lambda: phc.step_response(ONE, [0.0, 1.0, 2.0, 4.0]),
        r"step from sample 2 to 3 is 2, the median step 1; .*resample",
    ),
    "going back": (
        lambda: phc.step_response(ONE, [0.0, 1.0, 0.5]),
        "does not increase: samples 1 and 2 are at 1 and 0.5",
    ),
    "the same instant": (
        lambda: phc.forced_response(ONE, [0.0, 0.0, 0.0], [1.0, 1.0, 1.0]),
        "does not increase: samples 0 and 1 are at 0 and 0",
    ),
    "no instants": (lambda: phc.step_response(ONE, []), "the time vector is empty"),
    "a table of instants": (lambda: phc.step_response(ONE, [[0.0, 1.0]]), "the time vector has 2 dimensions"),
    "NaN instant": (lambda: phc.step_response(ONE, [0.0, np.nan]), "the time vector is not finite"),
    "end in the past": (
        lambda: phc.step_response(ONE, -1.0),
        "the last instant is -1.0; it must be one positive number",
    ),
    "end no number": (lambda: phc.step_response(ONE, "later"), "the last instant is 'later'"),
    "one default instant": (
        lambda: phc.step_response(ONE, timepts_num=1),
        "timepts_num is 1; it must be a whole number from 2 to",
    ),
    "half an instant": (lambda: phc.step_response(ONE, timepts_num=10.5), "timepts_num is 10.5"),
    "short input": (
        lambda: phc.forced_response(ONE, T3, [1.0, 2.0]),
        r"input has shape \(2,\); with 3 instants it must be \(3,\) or \(1, 3\)",
    ),
    "one input for two ports": (
        lambda: phc.forced_response(TWO, T3, [1.0, 2.0, 3.0]),
        r"input has shape \(3,\); .* must be \(2, 3\)",
    ),
    "input on its side": (
        lambda: phc.forced_response(TWO, T3, np.ones((3, 2))),
        r"input has shape \(3, 2\); .* must be \(2, 3\)",
    ),
    "input not on its side": (
        lambda: phc.forced_response(TWO, T3, np.ones((2, 3)), transpose=True),
        r"must be \(2, 3\), transposed",
    ),
    "NaN input": (
        lambda: phc.forced_response(ONE, T3, [1.0, np.nan, 2.0]),
        "the input is not finite: 1 of 3 .* first at index 1",
    ),
    "complex input": (lambda: phc.forced_response(ONE, T3, [1.0, 1j, 2.0]), "the input is complex"),
    "no input": (lambda: phc.forced_response(ONE, T3, None), "the input is of type NoneType, not an array of numbers"),
    "long state": (
        lambda: phc.initial_response(ONE, T3, np.ones(5)),
        r"initial state has shape \(5,\); the system has 4 states",
    ),
    "row state": (lambda: phc.initial_response(ONE, T3, np.ones((1, 4))), r"initial state has shape \(1, 4\)"),
    "infinite state": (lambda: phc.initial_response(ONE, T3, [1.0, np.inf, 0.0, 0.0]), "initial state is not finite"),
    "unknown method": (
        lambda: phc.step_response(ONE, T3, method="rk4"),
        "method is 'rk4'; it must be one of 'exact', 'midpoint', 'euler'",
    ),
    "unknown hold": (
        lambda: phc.forced_response(ONE, T3, intersample="spline"),
        "intersample is 'spline'; it must be one of 'zoh', 'foh'",
    ),
    "no such output": (
        lambda: phc.step_response(TWO, T3, output_indices=2),
        "output_indices is 2; it must be one number from 0 to 1",
    ),
    "negative output": (lambda: phc.initial_response(TWO, T3, output_indices=-1), "output_indices is -1"),
    "no such input": (lambda: phc.impulse_response(TWO, T3, input_indices=5), "input_indices is 5"),
    "two inputs": (lambda: phc.impulse_response(TWO, T3, input_indices=[0, 1]), r"input_indices is \[0, 1\]"),
    "named input": (lambda: phc.impulse_response(TWO, T3, input_indices="u[0]"), r"input_indices is 'u\[0\]'"),
    "no systems": (lambda: phc.step_response([], T3), "the list of systems is empty"),
    "no system": (lambda: phc.step_response(2.0, T3), "this is a float; give a system of this package"),
    "response data": (
        lambda: phc.forced_response(ct.frd([1.0], [1.0]), T3),
        "this is a FrequencyResponseData; give a system",
    ),
    "a hold for another system": (
        lambda: phc.step_response(ct.ss(ONE), T3, intersample="spline"),
        "intersample is 'spline'",
    ),
    "a rule for another system": (
        lambda: phc.step_response(ct.ss(ONE), T3, method="euler"),
        "method='euler' is for systems that ph",
    ),
    "Euler overflow": (
        lambda: phc.step_response(ONE, 1e3 * np.arange(200), method="euler"),
        "with method='euler' and step 1000 the fastest mode grows by 2000 a step; use method='exact'",
    ),
    "overflow": (
        lambda: phc.forced_response(ONE, np.arange(100.0), 1.7e308),
        "exceeds the range of doubles: with method='exact' .* scale the input",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_a_response_says_what_is_wrong_with_its_arguments(name):
    call, message = BAD[name]
    with pytest.raises(phc.StructureError, match=message):
        call()


@pytest.mark.parametrize("response", RESPONSES)
def test_unknown_and_doubled_keywords_are_errors(response):
    with pytest.raises(TypeError, match="unrecognized keyword: 'speed'"):
        response(ONE, T3, speed=1)
    with pytest.raises(TypeError, match="multiple values for 'timepts': also given as 'T'"):
        response(ONE, T3, T=[0.0, 2.0])


def test_a_keyword_of_another_response_is_unknown():
    with pytest.raises(TypeError, match="unrecognized keyword: 'U'"):
        phc.step_response(ONE, T3, U=1.0)
    with pytest.raises(TypeError, match="unrecognized keyword: 'X0'"):
        phc.impulse_response(ONE, T3, X0=1.0)
    with pytest.raises(TypeError, match="multiple values for 'initial_state'"):
        phc.initial_response(ONE, T3, np.ones(4), X0=np.zeros(4))


@pytest.mark.parametrize("ragged", [[[1], [1, 2]], ([1], [1, 2])])
def test_ragged_arguments_are_refused(ragged):
    for call in (
        lambda: phc.forced_response(ONE, ragged),
        lambda: phc.forced_response(ONE, T3, ragged),
        lambda: phc.forced_response(ONE, T3, 0.0, ragged),
        lambda: phc.step_response(ONE, T=ragged),
    ):
        with pytest.raises(phc.StructureError, match="is not a rectangular array of numbers"):
            call()
    with pytest.raises(TypeError, match="multiple values for 'inputs'"):
        phc.forced_response(ONE, T3, ragged, U=1.0)


@pytest.mark.parametrize("count", [10**400, 10**5000, 10**10], ids=["400", "5000", "10"])
def test_a_number_of_instants_that_no_memory_holds_is_refused(count):
    with pytest.raises(phc.StructureError, match=r"timepts_num is .*; it must be a whole number from 2 to"):
        phc.step_response(ONE, timepts_num=count)


@pytest.mark.parametrize("jitter", [0.0056, 0.0099])
@pytest.mark.parametrize("worst", [[0], [-1], [0, -1], [1, 5]], ids=str)
def test_instants_up_to_a_hundredth_of_a_step_off_any_grid_are_taken(jitter, worst):
    h, rng = 0.1, np.random.default_rng(0)
    off = jitter * rng.uniform(-1, 1, 400)
    off[worst], off[200] = jitter, -jitter
    t = 3.0 + h * (np.arange(400) + off)
    response = phc.forced_response(phc.ph(phc.modes(1.0, 1.0)), t, 1.0)
    assert np.array_equal(response.time, t)
    # a step off by so much in all is off by the same share of one at the end of the record
    assert abs(response.rule.h - h) < 2.1 * jitter * h / 399


def test_instants_further_off_every_grid_are_refused():
    t = 0.1 * np.arange(400)
    t[::2] += 0.1 * 0.0101
    t[1::2] -= 0.1 * 0.0101
    with pytest.raises(phc.StructureError, match="is not equally spaced"):
        phc.forced_response(phc.ph(phc.modes(1.0, 1.0)), t, 1.0)


@pytest.mark.parametrize("squeeze", ["yes", 2.0, [True]])
def test_a_squeeze_that_is_no_flag_is_an_error(squeeze):
    sys = phc.modes(1.0, 1.0)
    with pytest.raises(phc.StructureError, match=r"squeeze is .*; it must be True or False"):
        phc.step_response(sys, np.linspace(0, 1, 5), squeeze=squeeze)
    with pytest.raises(phc.StructureError, match=r"squeeze is .*; it must be True or False"):
        phc.forced_response(sys, np.linspace(0, 1, 5), np.zeros(5), squeeze=squeeze)


LAG = ct.tf([2.0], [3.0, 1.0], name="lag")


def test_systems_of_any_kind_respond():
    t = np.linspace(0.0, 9.0, 31)
    decay = np.exp(-t / 3)
    np.testing.assert_allclose(phc.step_response(LAG, t).outputs, 2 * (1 - decay), atol=1e-12)
    np.testing.assert_allclose(phc.impulse_response(LAG, t).outputs, 2 / 3 * decay, atol=1e-12)
    np.testing.assert_allclose(phc.initial_response(ct.ss(-1 / 3, 1.0, 2.0, 0.0), t, 0.5).outputs, decay, atol=1e-12)
    free = phc.modes([-0.1 + 1.0j], [[1.0]], [[1.0]])
    expected = phc.step_response(phc.ph(free), t).outputs
    np.testing.assert_allclose(phc.step_response(free, t).outputs, expected, atol=1e-12)
    assert phc.step_response(LAG).time[-1] > 9 and phc.step_response(LAG, 5.0, timepts_num=11).time.shape == (11,)


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
def test_inputs_of_other_systems_are_held_or_interpolated(intersample):
    plant, t = phc.modes([-0.1 + 1.0j, -0.4 + 2.0j], [[1.0], [0.7]], [[1.0], [0.3]]), 0.3 * np.arange(40.0)
    u = np.random.default_rng(0).standard_normal(40)
    expected = phc.forced_response(phc.ph(plant), t, u, intersample=intersample).outputs
    np.testing.assert_allclose(phc.forced_response(plant, t, u, intersample=intersample).outputs, expected, atol=1e-12)
    both = phc.forced_response([plant, phc.ph(plant)], t, u, intersample=intersample)
    np.testing.assert_allclose(both[0].outputs, both[1].outputs, atol=1e-12)


@pytest.mark.parametrize("rule", [("exact", "zoh"), ("exact", "foh"), ("midpoint", "foh"), ("euler", "zoh")])
def test_other_systems_are_sampled_as_ours_are(rule):
    plant = phc.modes([-0.1 + 1.0j, -0.4 + 2.0j], [[1.0], [0.7]], [[1.0], [0.3]])
    method, intersample = rule
    ours = phc.sample(phc.ph(plant), 0.2, method, intersample=intersample)
    other = phc.sample(plant, 0.2, method, intersample=intersample, name="sampled")
    z = np.exp(1j * np.linspace(0.1, 3.0, 9))
    np.testing.assert_allclose(other(z), ours(z), rtol=1e-9)
    assert other.name == "sampled" and other.dt == 0.2
    with pytest.raises(phc.StructureError, match=r"dt=0\.2; give one in continuous time"):
        phc.sample(ct.ss(other), 0.1)
    with pytest.raises(phc.StructureError, match="is for systems that ph"):
        phc.sample(plant, 0.2, "midpoint", intersample="zoh")
