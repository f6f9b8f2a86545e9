"""Circuits of systems have their transfer functions, and systems of circuits theirs.

The reference is a nodal analysis in mpmath that reads the text (`nodal_analysis.py`), and where they are installed
ngspice and the symbolic analysis of lcapy, which is not in the extra `test`: it brings twenty packages, even IPython.
"""

import shutil
import subprocess

import control as ct
import mpmath
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from nodal_analysis import FORMS, KINDS, errors, nodal_response, random_one_port, round_trip

import ph_control as phc

SETTINGS = settings(deadline=None, max_examples=13, derandomize=True)
EVERY = [(kind, form) for kind in KINDS for form in FORMS]
RESONATOR = "resonator\nV1 1 0 AC 1\nR1 1 2 50\nL1 2 3 1m\nC1 3 0 10n\n.end\n"


def one_port(d, r, kappa_0=0.0):
    rigid = np.array([[np.sqrt(kappa_0)]] if kappa_0 else np.zeros((0, 1)))
    return phc.ModalForm(np.array(d, float), np.sqrt(np.array(r, float))[:, None].astype(complex), rigid)


def values(circuit):
    return {one.name: one.value for one in circuit.elements}


def nodal(text, w):
    with mpmath.workdps(40):
        return np.array(nodal_response(text, w)[0].tolist(), complex)


# --- lossless one-ports ----------------------------------------------------------------------------------------------


@pytest.mark.variants
@pytest.mark.parametrize("seed", range(0, 40, 5))
@pytest.mark.parametrize(("kind", "form"), EVERY)
def test_every_form_has_the_response_of_the_system_as_far_as_doubles_can_carry_it(kind, form, seed):
    modes = random_one_port(seed, 8 if seed else 30)
    circuit = phc.netlist(modes, form, kind=kind)
    states = 2 * len(modes.d) + len(modes.rigid)
    assert len(circuit.elements) == states and all(one.value > 0 for one in circuit.elements)
    for w in (0.7 * modes.d[0], np.sqrt(modes.d[0] * modes.d[-1]) * 1.01):
        error, of_rounding = errors(modes, circuit, w)
        assert error < 1e-9
        assert error <= 4 * of_rounding


@pytest.mark.parametrize(("kind", "form"), EVERY)
@pytest.mark.parametrize(("n", "kappa_0"), [(0, 2.0), (1, 0.0), (1, 2.0), (2, 0.0), (2, 2.0)])
def test_poles_at_zero_and_single_modes(kind, form, n, kappa_0):
    modes = one_port([1.0, 3.0][:n], [0.5, 2.0][:n], kappa_0)
    circuit = phc.netlist(modes, form, kind=kind)
    assert len(circuit.elements) == 2 * n + bool(kappa_0)
    assert errors(modes, circuit, 1.7)[0] < 1e-14


def test_the_elements_of_two_modes_are_those_of_the_textbook():
    # Y = s/(s^2 + 1) + s/(s^2 + 3) = 2 s (s^2 + 2)/((s^2 + 1)(s^2 + 3)); 1/Y = s/2 + 1/(1/1 ...)
    modes = phc.modes([1.0, np.sqrt(3.0)], [1.0, 1 / np.sqrt(3.0)])
    close = {"rel": 1e-14}
    assert values(phc.netlist(modes, "foster2")) == pytest.approx({"L1": 1, "C1": 1, "L2": 1, "C2": 1 / 3}, **close)
    # 1/Y = s/2 + (3/4)/s + (s/4)/(s^2 + 2)
    assert values(phc.netlist(modes, "foster1")) == pytest.approx(
        {"L1": 0.5, "C1": 4 / 3, "L2": 1 / 8, "C2": 4}, **close
    )
    # 1/Y = s/2 + 1/(s + 1/(2 s + 1/(s/3)))
    assert values(phc.netlist(modes, "cauer1")) == pytest.approx({"L1": 0.5, "C1": 1, "L2": 2, "C2": 1 / 3}, **close)
    # with 1/s in the place of s: frequencies 1 and 1/sqrt(3), residues 1 and 1/3
    again = values(phc.netlist(phc.modes([1 / np.sqrt(3.0), 1.0], [3**-0.5, 1.0]), "cauer1"))
    found = values(phc.netlist(modes, "cauer2"))
    assert found == pytest.approx({name: 1 / again[other] for name, other in [
        ("C1", "L1"), ("L1", "C1"), ("C2", "L2"), ("L2", "C2")]}, **close)  # fmt: skip


def test_the_cauer_ladder_is_a_chain_of_masses_and_springs():
    masses, springs, wall = [1.0, 2.0, 0.5], [3.0, 0.7], 1.5
    chain = phc.spring_chain(masses, springs, ground=[0, 0, wall])
    circuit = phc.netlist(chain, "cauer1", kind="impedance")
    found = values(circuit)
    assert [found[f"C{k}"] for k in (1, 2, 3)] == pytest.approx(masses, rel=1e-13)
    assert [1 / found[f"L{k}"] for k in (1, 2, 3)] == pytest.approx([*springs, wall], rel=1e-13)


def test_equal_branches_are_one_and_modes_out_of_reach_are_left_out():
    circuit = phc.netlist(phc.lc_circuit([1.0, 1.0], 1.0))
    assert values(circuit) == pytest.approx({"L1": 0.5, "C1": 2.0})
    assert len(phc.netlist(phc.modes([1.0, 2.0], [1.0, 0.0]), "cauer2").elements) == 2
    with pytest.raises(phc.StructureError, match="reaches"):
        phc.netlist(phc.modes([1.0], [0.0]))


def test_zeros_as_close_to_poles_as_doubles_allow():
    modes = one_port([1.0, 1.0 + 2**-50, 2.0], [1.0, 1e-12, 1e-18])
    for kind, form in EVERY:
        error, of_rounding = errors(modes, phc.netlist(modes, form, kind=kind), 1.5)
        assert error <= 4 * of_rounding


# --- losses, several ports -------------------------------------------------------------------------------------------


def test_a_damped_mode_is_a_series_branch_of_an_admittance():
    d, zeta, kappa = 3.0, 0.02, 0.5
    sys = phc.ph(phc.modes([d], [kappa / d], damping=zeta))
    assert values(phc.netlist(sys)) == pytest.approx({"L1": 1 / kappa, "R1": 2 * zeta * d / kappa, "C1": kappa / d**2})
    dual = values(phc.netlist(sys, kind="impedance"))
    assert dual == pytest.approx({"C1": 1 / kappa, "R1": kappa / (2 * zeta * d), "L1": kappa / d**2})


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "sys",
    [
        phc.lc_circuit([1.0, 2.0], [3.0, 4.0], R=[0.1, 0.4]),
        phc.ph(phc.modes([1.0, 2.0], [1.0, 1.0], damping=[0.1, 3.0])),
        phc.ph(ct.tf([2.0], [1.0, 3.0]) + ct.tf([1.0], [1.0, 0.0]) + 1),
        phc.spring_chain([1.0, 2.0], 3.0, ground=1.0, c=0.3, ground_c=0.1, port=[0, 1]),
        phc.spring_chain([1.0, 2.0, 1.0], 3.0, port=[0, 2]),
        phc.ph(phc.ModalForm(np.array([1.0, 2.0]), np.array([[1, 0], [1, -2]], complex), np.array([[0.0, 1.0]]))),
    ],
    ids=["branches", "overdamped", "relaxation", "two damped ports", "floating chain", "one at a port alone"],
)
def test_losses_and_several_ports(sys, kind):
    circuit = phc.netlist(sys, kind=kind)
    assert all(one.value > 0 for one in circuit.elements if one.letter in "RLC")
    again = phc.read_netlist(circuit.spice())
    assert again.nstates == sum(one.letter in "LC" for one in circuit.elements)
    for w in (0.3, 1.7, 5.0):
        expected = sys(1j * w).reshape(sys.noutputs, -1)
        assert np.allclose(nodal(circuit.spice(), w), expected, rtol=1e-12, atol=1e-13)
        assert np.allclose(again(1j * w).reshape(expected.shape), expected, rtol=1e-12, atol=1e-13)


def test_one_port_alone_needs_no_transformer():
    sys = ct.append(phc.lc_circuit([1.0], [1.0]), phc.lc_circuit([2.0], [1.0]))
    for kind in KINDS:
        assert {one.letter for one in phc.netlist(sys, kind=kind).elements} == {"L", "C"}


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda: phc.netlist(phc.spring_chain([1.0, 2.0], port=[0, 1]), "cauer1"), "2 ports"),
        (lambda: phc.netlist(phc.lc_circuit(1.0, 1.0, R=1.0), "cauer1"), "losses"),
        (lambda: phc.netlist(phc.spring_chain([1.0, 2.0, 3.0], c=[1.0, 0.0], port=0)), "classical"),
        (lambda: phc.netlist(phc.ModalForm([1.0], [[1.0, 1j]], np.zeros((0, 2)))), "gyrators"),
        (lambda: phc.netlist(phc.ph(np.eye(2), [0, 1], R=np.diag([0, 1.0]), sensors=[1, 0])), "sensors"),
        (lambda: phc.netlist(ct.tf([-1, 0], [1, 0.1, 4])), "passive"),
        (lambda: phc.netlist(phc.modes(1.0, 1.0), "foster3"), "foster3"),
        (lambda: phc.netlist(phc.modes(1.0, 1.0), kind="scattering"), "scattering"),
        (lambda: phc.netlist(np.eye(2)), "type"),
    ],
)
def test_what_has_no_circuit_is_refused_by_name(make, reason):
    with pytest.raises(phc.StructureError, match=reason):
        make()


# --- round trips -----------------------------------------------------------------------------------------------------


@SETTINGS
@given(st.integers(0, 10**6), st.sampled_from(EVERY))
def test_from_netlist_to_system_and_back(seed, which):
    kind, form = which
    circuit = phc.netlist(random_one_port(seed, 4), form, kind=kind)
    # what a relative change of eps of the modes may make of an element
    assert round_trip(circuit) < 1e-7 if form != "foster2" or kind != "admittance" else 1e-11


@SETTINGS
@given(st.lists(st.floats(1e-15, 1e15), min_size=1, max_size=4), st.floats(1e-3, 1e9))
def test_values_are_read_as_they_were_written(weights, d):
    assume(all(1e-250 < d * r < 1e250 for r in weights))
    circuit = phc.netlist(phc.modes(d * np.arange(1.0, len(weights) + 1), weights))
    system = phc.read_netlist(circuit.spice())
    found = {name: 1 / system.Q[k, k] for k, name in enumerate(system.state_labels)}
    for one in circuit.elements:
        assert found[f"{'q' if one.letter == 'C' else 'phi'}_{one.name}"] == pytest.approx(one.value, rel=1e-15)


# --- reading ---------------------------------------------------------------------------------------------------------


def test_states_are_charges_and_fluxes():
    sys = phc.read_netlist(RESONATOR)
    assert sys.state_labels == ["q_C1", "phi_L1"] and sys.input_labels == ["v_V1"] and sys.output_labels == ["i_V1"]
    assert np.allclose(sys.Q, np.diag([1e8, 1e3])) and np.allclose(sys.R, np.diag([0, 50])) and not sys.S.any()
    assert phc.read_netlist(RESONATOR, name="tank", inputs=["V"]).input_labels == ["V"]


@pytest.mark.parametrize(
    ("text", "ohm"),
    [
        ("4.7k", 4700.0), ("1MEG", 1e6), ("1mil", 25.4e-6), ("2m", 2e-3), ("2M", 2e-3), ("3u", 3e-6), ("3\u00b5", 3e-6),
        ("5n", 5e-9), ("7p", 7e-12), ("1F", 1e-15), ("2g", 2e9), ("1T", 1e12), ("10kOhm", 1e4), ("1e3", 1e3),
        ("1.5E-2k", 15.0), (".5", 0.5), ("5.", 5.0), ("100Ohm", 100.0), ("3.3uF", 3.3e-6), ("1megohm", 1e6),
    ],
)  # fmt: skip
def test_suffixes_are_those_of_spice(text, ohm):
    assert phc.read_netlist(f"t\nV1 1 0\nR1 1 2 {text}\nL1 2 0 1\n").R[0, 0] == pytest.approx(ohm, rel=1e-15)


def test_comments_continuations_and_analyses_are_as_in_spice(tmp_path):
    text = """R1 is not 1 here: the title
* a comment
v1 IN gnd sin(0 1 1k) ; source
r1 in A
+ 50 $ ohm
+
L1 a B 1m
.options noopac
.control
R9 is no element
.endc
C1 b 0 10n
.ac dec 10 1 1k
.end
R7 1 2 3"""
    path = tmp_path / "a.cir"
    path.write_bytes(text.replace("\n", "\r\n").encode())
    for source in (text, path, str(path)):
        sys = phc.read_netlist(source)
        assert np.allclose(sys(1e5j), phc.read_netlist(RESONATOR)(1e5j))
    with open(path) as stream:
        assert phc.read_netlist(stream).nstates == 2
    # without a title
    assert phc.read_netlist(RESONATOR.partition("\n")[2]).nstates == 2


@pytest.mark.parametrize(
    ("line", "number"),
    [
        ("R1 1 2", 3), ("R1 1 2 five", 3), ("R1 1 2 -5", 3), ("R1 1 2 1e400", 3), ("R1 1 2 5 6", 3),
        ("Q1 1 2 3 npn", 3), (".include other.cir", 3), (".subckt a 1 2", 3), ("C1 1 2 {c}", 3), ("V1 2 0", 3),
        ("K1 L1 L2 1.1", 3), ("X1 1 2 other", 3), ("F1 1 0 V9", 3), (",", 3),
    ],
)  # fmt: skip
def test_a_line_that_is_not_understood_is_named(line, number):
    with pytest.raises(phc.FileFormatError, match=f"line {number}: "):
        phc.read_netlist(f"title\nV1 1 0\n{line}\nL1 1 0 1\n")


@pytest.mark.parametrize(
    ("lines", "reason"),
    [
        ("", "no elements"), ("L1 1 0 1", "no source"),
        ("V1 1 2\nL1 1 2 1", "no ground"), ("V1 1 0\nC1 1 0 1", "C1, V1 are a loop"),
        ("V1 1 0\nC1 1 2 1\nC2 2 0 1\nC3 1 0 1", "loop"), ("V1 1 0\nV2 1 0\nL1 1 0 1", "V2, V1 are a loop"),
        ("I1 0 1\nL1 1 0 1", "L1, I1 are a cut set"), ("I1 0 1\nI2 1 0\nC1 2 0 1\nR1 2 0 1", "I1, I2 are a cut set"),
        ("V1 1 0\nL1 1 0 1\nC1 3 4 1", "3, 4"), ("V1 1 0\nL1 1 0 1\nL2 2 3 1\nR2 2 3 1\nK1 L1 L2 .5", "2, 3"),
        ("V1 1 0\nL1 1 0 1\nK1 L1 L7 .5", "l7"), ("V1 1 0\nL1 1 0 1\nK1 L1 L1 .5", "two inductors"),
        ("V1 1 0\nL1 1 0 1\nL2 1 0 1\nL3 1 0 1\nK1 L1 L2 .9\nK2 L2 L3 .9\nK3 L1 L3 -.9", "positive semidefinite"),
        ("V1 1 0\nL1 1 0 1\nF1 1 0 V9 2", "V9"), ("V1 1 0\nL1 1 2 1\nE1 2 0 1 0 2", "transformers"),
        ("V1 1 0\nL1 1 2 1\nR1 2 0 1\nE1 2 0 1 0 2\nE2 2 0 1 0 2", "contradict"),
    ],
)  # fmt: skip
def test_a_circuit_without_a_port_hamiltonian_form_is_refused_by_name(lines, reason):
    with pytest.raises(phc.StructureError, match=f"(?i){reason}"):
        phc.read_netlist(f"title\n{lines}\n.end\n")


CIRCUITS = [
    ("V1 1 0\nR1 1 2 2\nC1 2 0 1\nC2 2 3 2\nC3 3 0 3\nL1 3 0 1", 3),  # a loop of capacitors
    ("I1 0 1\nR1 1 0 2\nL1 1 2 1\nL2 2 0 2\nL3 2 3 3\nC1 3 0 1", 3),  # a cut set of inductors
    ("V1 1 0\nL1 1 0 2\nL2 2 0 3\nK1 L1 L2 0.8\nR2 2 3 5\nC3 3 0 0.1", 3),  # coupled inductors
    ("V1 1 0\nR1 1 2 1\nR2 2 0 1\nR3 2 3 1\nL3 3 0 1\nI1 0 2", 1),  # ports of both kinds, resistors between
    ("V1 1 0\nR1 1 2 1\nV2 2 3\nL1 3 4 1\nR4 4 0 1\nC4 4 0 1\nI2 3 4", 2),
    ("I1 0 1\nL1 1 2 1\nL2 1 3 2\nR1 1 0 1e3\nR2 2 0 1e-3\nR3 3 0 10\nK1 L1 L2 -0.99", 2),
    ("I1 0 1\nR1 1 2 3\nVS a 0 0\nE1 a b 2 0 0.5\nF1 2 0 VS 0.5\nC1 b 0 1\nL1 2 0 1", 2),  # a transformer
    ("V1 1 0\nR1 1 0 5\nI2 0 2\nR2 2 1 3\nR3 2 0 1", 0),  # resistors alone
]


@pytest.mark.parametrize(("lines", "states"), CIRCUITS)
def test_circuits_with_loops_cut_sets_couplings_and_several_ports(lines, states):
    text = f"title\n{lines}\n.end\n"
    sys = phc.read_netlist(text)
    assert sys.nstates == states
    for w in (0.3, 2.1):
        assert np.allclose(sys(1j * w).reshape(sys.noutputs, -1), nodal(text, w), rtol=1e-10, atol=1e-14)


@pytest.mark.parametrize("kind", ["admittance", "impedance"])
def test_a_resistor_comes_back_from_its_netlist(kind):
    back = phc.read_netlist(phc.netlist(ct.tf([2.0], [1.0]), kind=kind).spice())
    assert back.nstates == 0 and np.allclose(back.D, 2.0) and not back.is_lossless


# --- files, SPICE, lcapy ---------------------------------------------------------------------------------------------


def test_a_file_is_not_replaced_unless_asked_for(tmp_path):
    circuit, path = phc.netlist(phc.modes([2.0], [1.0])), tmp_path / "a.cir"
    circuit.save(path)
    with pytest.raises(phc.OutputExistsError):
        circuit.save(path)
    circuit.save(path, overwrite=True)
    assert path.read_text() == circuit.spice()


def test_a_netlist_is_frozen_and_says_what_it_is():
    circuit = phc.netlist(phc.modes([2.0], [1.0]))
    assert repr(circuit) == "<Netlist: foster2 of an admittance, 2 elements, 1 port(s)>"
    with pytest.raises(AttributeError):
        circuit.form = "cauer1"


# --- controlled sources for any passive model -------------------------------------------------------------------------


def gyroscopic(ports=2):
    """Structure with general damping and gyroscopes, and a sensor beside its ports."""
    rng = np.random.default_rng(0)
    R, G = rng.standard_normal((3, 3)), np.zeros((3, 3))
    G[0, 1], G[1, 0] = 0.4, -0.4
    F = rng.standard_normal((3, ports))
    return phc.from_second_order(
        np.eye(3), np.diag([1.0, 4.0, 9.0]), F, C=0.1 * R @ R.T, G=G, sensors={"position": np.eye(3)[2]}
    )


PASSIVE = {
    "three ports and a sensor": gyroscopic(3),
    "a transfer function with feedthrough": ct.tf([1, 2, 3, 1.5], [1, 3, 4, 1]),
    "an integrator": ct.tf([1.0], [1.0, 0.0]),
    "critical damping": ct.tf([1.0, 0.0], [1.0, 2.0, 1.0]),
    "three equal lags": ct.tf([1.0, 2.0, 1.1], [1.0, 3.0, 3.0, 1.0]),
    "lossless": phc.frenkel_kontorova(3),
    "a resistor": ct.ss([], [], [], [[2.0]]),
    "nanoseconds": ct.tf([1e9, 0.0], [1.0, 1e8, 1e18]),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", PASSIVE)
def test_controlled_sources_have_the_response_of_any_passive_model(kind, name):
    sys = PASSIVE[name]
    circuit = phc.netlist(sys, "state-space", kind=kind)
    m = sys.ninputs
    assert circuit.form == "state-space" and len(circuit.ports) == m
    scale = 1e9 if name == "nanoseconds" else 1.0
    for w in (0.3 * scale, 1.7 * scale):
        response = np.reshape(sys(1j * w), (-1, m))[:m]
        assert nodal(circuit.spice(), w) == pytest.approx(response, rel=1e-10, abs=1e-12)


def test_sensors_are_voltages_of_nodes_of_their_own():
    sys = gyroscopic(1)
    text = phc.netlist(sys, "state-space").spice()
    # a current source of 0 A is a voltmeter: its voltage for 1 V at the port
    probe = text.replace(".options", "I2 0 y2 0\n.options")
    assert nodal(probe, 1.3)[1, 0] == pytest.approx(sys(1.3j)[1, 0], rel=1e-10)


@SETTINGS
@given(st.integers(0, 2**32), st.integers(1, 4), st.integers(1, 2), st.sampled_from(KINDS))
def test_controlled_sources_of_random_passive_models(seed, n, m, kind):
    rng = np.random.default_rng(seed)
    A, B, roots = rng.standard_normal((n, n)), rng.standard_normal((n, m)), rng.standard_normal((2, n, n))
    J, R, Q = A - A.T, roots[0] @ roots[0].T, roots[1] @ roots[1].T + 0.1 * np.eye(n)
    sys = ct.ss((J - R) @ Q, B, B.T @ Q, 0.1 * np.eye(m))
    text = phc.netlist(sys, "state-space", kind=kind).spice()
    expected = np.reshape(sys(0.9j), (m, m))
    assert nodal(text, 0.9) == pytest.approx(expected, rel=1e-6, abs=1e-7 * np.abs(expected).max())


def test_capacitors_and_conductances_are_of_a_size_that_programs_are_made_for():
    circuit = phc.netlist(PASSIVE["nanoseconds"], "state-space")
    conductances = [abs(part.value) for part in circuit.elements if part.name[0] == "G"]
    capacitors = [part.value for part in circuit.elements if part.name[0] == "C"]
    assert 0.1 < max(conductances) < 2 and capacitors == pytest.approx([1e-9, 1e-9], rel=0.1)


def test_an_active_model_has_no_circuit():
    with pytest.raises(phc.NotPassiveError):
        phc.netlist(ct.tf([1.0, -0.5], [1.0, 0.2, 1.0]), "state-space")
    with pytest.raises(phc.StructureError):
        phc.netlist(ct.ss(-1.0, [[1.0, 0.5]], 1.0, 0.0), "state-space")


@pytest.mark.skipif(shutil.which("ngspice") is None, reason="ngspice is not installed")
@pytest.mark.parametrize(
    ("kind", "form", "ports"),
    [(*one, 1) for one in EVERY]
    + [("admittance", "foster2", 2), ("impedance", "foster1", 2)]
    + [(kind, "state-space", ports) for kind in KINDS for ports in (1, 2)],
)
def test_ngspice_finds_the_response_of_the_system(kind, form, ports, tmp_path):
    rng = np.random.default_rng(3)
    nu = rng.standard_normal((3, ports)).astype(complex)
    modes = phc.ModalForm(np.array([1.0, 2.0, 3.0]), nu, rng.standard_normal((1, ports)))
    circuit, w = phc.netlist(modes, form, kind=kind), 1.3
    shown = [f"i({port.name.lower()})" if kind == "admittance" else f"v({port.nodes[1]})" for port in circuit.ports]
    f = w / (2 * np.pi)
    commands = [f"ac lin 1 {f!r} {f!r}", "set numdgt=12", *(f"print {one}" for one in shown), "quit"]
    text = circuit.spice().replace(".end\n", "\n".join([".control", *commands, ".endc", ".end", ""]))
    (tmp_path / "a.cir").write_text(text)
    done = subprocess.run(["ngspice", "-b", "a.cir"], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    lines = [line.partition("=")[2] for line in done.stdout.splitlines() if line.startswith(tuple(shown))]
    found = np.array([complex(*map(float, line.split(","))) for line in lines])
    assert len(found) == ports
    sign = -1 if kind == "admittance" else 1
    assert np.allclose(sign * found, phc.ph(modes)(1j * w).reshape(ports, ports).sum(axis=1), rtol=1e-6, atol=1e-6)


def symbolic(text, points):
    """Responses of the ports of a netlist by lcapy, in rational functions of s with exact coefficients."""
    lcapy = pytest.importorskip("lcapy", reason="lcapy is not installed")
    import sympy

    listed = [line.split() for line in text.splitlines()[1:] if line[0] not in ".*"]
    sensed = {one[3] for one in listed if one[0][0] == "F"}
    ports = [one[:3] for one in listed if one[0][0] in "VI" and one[0] not in sensed]
    elements = [one for one in listed if one[:3] not in ports]
    found = np.zeros((len(points), len(ports), len(ports)), complex)
    for column in range(len(ports)):
        # the current of a source of lcapy leaves it at the first node, that of SPICE at the second
        sources = [
            [name, *((plus, minus) if name[0] == "V" else (minus, plus)), "s", str(int(k == column))]
            for k, (name, plus, minus) in enumerate(ports)
        ]
        circuit = lcapy.Circuit("\n".join(map(" ".join, [*sources, *elements])))
        for row, (name, plus, minus) in enumerate(ports):
            s = lcapy.s
            answer = -circuit[name].I(s) if name[0] == "V" else circuit[minus].V(s) - circuit[plus].V(s)
            for k, point in enumerate(points):
                exact = sympy.Rational(point.real) + sympy.I * sympy.Rational(point.imag)
                found[k, row, column] = complex(answer.sympy.subs(s.sympy, exact).evalf(30))
    return found


@pytest.mark.parametrize("n", [1, 2, 3, 4])
@pytest.mark.parametrize(("kind", "form"), EVERY)
def test_lcapy_finds_the_response_of_lossless_one_ports(kind, form, n):
    rng = np.random.default_rng(n)
    modes = one_port(np.sort(10 ** rng.uniform(-1, 2, n)), 10 ** rng.uniform(-2, 2, n), kappa_0=1.5 * (n % 2))
    points = [0.03j, 1j * np.sqrt(modes.d[0] * modes.d[-1]) * 1.01, 500j, 0.4 + 1.1j]
    found = symbolic(phc.netlist(modes, form, kind=kind).spice(), points)
    np.testing.assert_allclose(found[:, 0, 0], [phc.ph(modes)(point) for point in points], rtol=1e-13)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "sys",
    [
        phc.ph(phc.modes([1.0, 2.0], [1.0, 1.0], damping=[0.1, 3.0])),
        phc.spring_chain([1.0, 2.0], 3.0, ground=1.0, c=0.3, ground_c=0.1, port=[0, 1]),
    ],
    ids=["overdamped", "two damped ports"],
)
def test_lcapy_finds_the_response_with_losses_and_two_ports(sys, kind):
    points = [0.3j, 1.7j, 0.4 + 1.1j]
    found = symbolic(phc.netlist(sys, kind=kind).spice(), points)
    np.testing.assert_allclose(found, [np.reshape(sys(point), found.shape[1:]) for point in points], rtol=1e-12)


@pytest.mark.parametrize("lines", [lines for lines, _ in CIRCUITS])
def test_lcapy_finds_the_response_of_what_is_read(lines):
    text, points = f"title\n{lines}\n.end\n", [0.3j, 2.1j, 0.4 + 1.1j]
    system, found = phc.read_netlist(text), symbolic(text, points)
    np.testing.assert_allclose(
        found, [np.reshape(system(point), found.shape[1:]) for point in points], rtol=1e-10, atol=1e-14
    )
