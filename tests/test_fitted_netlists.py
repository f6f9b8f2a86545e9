"""Elements of a fitted impedance or admittance are those of the circuit it was measured on, within their errors.

The references are fits of the same circuit by its elements (`pem(model=read_netlist(..))`), draws from the covariance
of a fit, and the circuits themselves.
"""

import control as ct
import numpy as np
import pytest
from slow import slowly

import ph_control as phc

CELL = "I1 0 1\nR1 1 2 20m\nC1 2 3 400\nR2 2 3 30m\nC2 3 0 2\nR3 3 0 15m\n"
MIXED = "I1 0 1\nC1 1 2 100u\nR1 1 2 40\nR2 2 3 25\nL1 2 3 2m\nC2 3 0 1u\nR3 3 0 300\nL2 3 0 4m\n"
BANDS = {CELL: np.geomspace(0.005, 1000, 60), MIXED: np.geomspace(10, 1e5, 60)}


def measured(values, hertz, seed=0, noise=0.005):
    """Frequency response of values with relative noise, in seconds."""
    rng = np.random.default_rng(seed)
    errors = rng.standard_normal(len(hertz)) + 1j * rng.standard_normal(len(hertz))
    data = ct.frd(np.squeeze(values) * (1 + noise / np.sqrt(2) * errors), 2 * np.pi * hertz)
    data.time_unit = "s"
    return data


def spectrum(text, **options):
    hertz = BANDS[text]
    return measured(phc.read_netlist(f"circuit\n{text}")(2j * np.pi * hertz), hertz, **options)


def values(circuit):
    return {element.name: element.value for element in circuit.elements}


def errors(circuit):
    return {element.name: element.stderr for element in circuit.elements}


def within_errors(circuit, expected):
    assert values(circuit).keys() == expected.keys()
    for element in circuit.elements:
        assert abs(element.value - expected[element.name]) < 4 * element.stderr, element


@pytest.fixture(scope="module")
def cell():
    return phc.pem(spectrum(CELL))


@pytest.fixture(scope="module")
def mixed():
    return phc.pem(spectrum(MIXED))


def test_elements_of_data_in_milliseconds_are_in_henry_and_farad(mixed):
    data = ct.frd(np.squeeze(spectrum(MIXED).frdata), 1e-3 * spectrum(MIXED).omega)
    data.time_unit = "ms"
    fit = phc.pem(data)
    circuit, same = phc.netlist(fit, kind="impedance"), phc.netlist(mixed, kind="impedance")
    assert values(circuit) == pytest.approx(values(same), rel=1e-6)
    assert errors(circuit) == pytest.approx(errors(same), rel=1e-4)
    written, expected = (phc.netlist(each.system, "state-space", kind="impedance") for each in (fit, mixed))
    assert values(written) == pytest.approx(values(expected), rel=1e-4)


# --- values and errors -----------------------------------------------------------------------------------------------


def test_a_resistor_and_two_rc(cell):
    circuit = phc.netlist(cell, kind="impedance")
    within_errors(circuit, {"R1": 0.02, "C1": 400.0, "R2": 0.03, "C2": 2.0, "R3": 0.015})
    assert (cell.order, len(cell.real_poles)) == (0, 2) and phc.passivity(cell.system).is_passive
    assert values(circuit) == pytest.approx(values(phc.netlist(cell.system, kind="impedance")), rel=1e-9)
    s = 1j * np.geomspace(0.1, 1e4, 9)
    assert np.allclose(phc.read_netlist(circuit.spice())(s), cell.system(s), rtol=1e-9)


def test_rc_rl_and_a_mode_are_seven_elements(mixed):
    # a resistance in series with L2 and one in series with all are 0 within their errors, and left out
    circuit = phc.netlist(mixed, kind="impedance")
    within_errors(circuit, {"C1": 1e-4, "R1": 40.0, "R2": 25.0, "L1": 2e-3, "C2": 1e-6, "R3": 300.0, "L2": 4e-3})
    assert (mixed.order, len(mixed.real_poles)) == (1, 2) and phc.passivity(mixed.system).is_passive


@pytest.mark.parametrize("text", [MIXED, *slowly(CELL)])
def test_values_and_errors_are_those_of_a_fit_of_the_elements(text, cell, mixed):
    circuit = phc.netlist(cell if text == CELL else mixed, kind="impedance")
    names = list(values(circuit))
    given = phc.pem(spectrum(text), model=phc.read_netlist(f"circuit\n{text}", parameters=names), quantity="free")
    assert list(errors(circuit).values()) == pytest.approx(given.stderr["parameters"], rel=0.05)
    difference = np.array(list(values(circuit).values())) - given.parameters
    assert np.all(np.abs(difference) < 0.3 * given.stderr["parameters"])


def test_errors_are_the_spread_of_draws_from_the_covariance(cell):
    draws = cell.sample(4000, rng=0)
    rho, a = draws.residues[:, :, 0, 0].real, -draws.poles.real
    stated = errors(phc.netlist(cell, kind="impedance"))
    expected = [(1 / rho).std(axis=0), (rho / a).std(axis=0)]
    assert [stated[name] for name in ("C1", "C2", "R2", "R3")] == pytest.approx(np.concatenate(expected), rel=0.06)
    assert stated["R1"] == pytest.approx(cell.stderr["feedthrough"][0, 0], rel=1e-9)


TANK = np.geomspace(1e4, 1e8, 60)


@pytest.mark.parametrize(
    ("Z", "hertz", "expected"),
    [
        (lambda s: 1 / (1 / (300 + 2e-3 * s) + 12e-12 * s), np.geomspace(1e4, 1e7, 60),
         {"C1": 12e-12, "L1": 2e-3, "R1": 300.0}),
        (lambda s: 1 / (1 / (2e-3 * s) + 1 / 1.2e3 + 12e-12 * s), TANK, {"C1": 12e-12, "R1": 1.2e3, "L1": 2e-3}),
        *slowly((lambda s: 5 + 1 / (1 / (2e-3 * s) + 1 / 1.2e3 + 12e-12 * s), TANK,
                 {"R1": 5.0, "C1": 12e-12, "R2": 1.2e3, "L1": 2e-3})),
    ],
    ids=["coil with its resistance", "overdamped", "overdamped with a resistor"],
)  # fmt: skip
def test_a_mode_with_other_losses(Z, hertz, expected):
    fit = phc.pem(measured(Z(2j * np.pi * hertz), hertz), structure="passive")
    within_errors(phc.netlist(fit, kind="impedance"), expected)


def test_an_admittance_has_branches_side_by_side():
    hertz = np.geomspace(10, 1e5, 60)
    s = 2j * np.pi * hertz
    fit = phc.pem(measured(1 / 50 + 1e-5 * s / (1 + 1e-3 * s) + 1 / (20 + 1e-3 * s), hertz), structure="passive")
    circuit = phc.netlist(fit)
    assert {element.nodes for element in circuit.elements if element.name == "R1"} == {("1", "0")}
    s = 1j * np.geomspace(100, 1e5, 7)
    expected = 1 / 50 + 1e-5 * s / (1 + 1e-3 * s) + 1 / (20 + 1e-3 * s)
    assert np.allclose(phc.read_netlist(circuit.spice())(s), expected, rtol=0.01)
    stated, given = values(circuit), {"R1": 50.0, "L1": 1e-3, "C1": 1e-5}
    assert all(abs(stated[name] - given[name]) < 4 * errors(circuit)[name] for name in given)


def test_the_inductance_of_leads_is_an_element():
    hertz = np.geomspace(10, 1e5, 60)
    s = 2j * np.pi * hertz
    fit = phc.pem(measured(50 + 1e-4 * s + 1000 / (1 + 1e-3 * s), hertz), 0, real_poles=1, structure="passive")
    within_errors(phc.netlist(fit, kind="impedance"), {"R1": 50.0, "C1": 1e-6, "R2": 1000.0, "L1": 1e-4})


# --- what has no such elements ---------------------------------------------------------------------------------------


def test_a_fit_that_is_not_passive_is_refused_with_the_measured_loss():
    hertz = np.geomspace(0.01, 10, 20)
    active = phc.pem(measured(1 - 2 / (1 + 2j * np.pi * hertz), hertz), 0, real_poles=1, structure="free")
    with pytest.raises(phc.StructureError, match=r"resistor of its own .* \+- .*must not be negative"):
        phc.netlist(active, kind="impedance")


def test_other_forms_of_a_fit_are_those_of_its_system(cell):
    circuit = phc.netlist(cell, "state-space", kind="impedance")
    assert values(circuit) == values(phc.netlist(cell.system, "state-space", kind="impedance"))
    assert {element.stderr for element in circuit.elements} == {None}
    with pytest.raises(phc.StructureError, match="losses"):
        phc.netlist(cell, "cauer1", kind="impedance")


# --- measured spectra ------------------------------------------------------------------------------------------------


def zplot(path):
    lines = path.read_text(encoding="latin-1").splitlines()
    begin = next(k for k, line in enumerate(lines) if "End Comments" in line) + 1
    table = np.array([[float(cell) for cell in line.split()] for line in lines[begin:] if line.strip()])[::-1]
    return table[:, 0], table[:, 4] + 1j * table[:, 5]


# R0, R1, C1 and their errors as published with the data, where the inductance of leads is no part of the circuit
PUBLISHED = {
    1: ([29.1, 46.7, 1.04e-5], [0.036, 0.047, 2.95e-8]),
    2: ([150.0, 502.0, 3.12e-8], [0.32, 0.36, 7.8e-11]),
    3: ([1510.0, 4630.0, 2.02e-8], [2.6, 3.1, 5.4e-11]),
}


@pytest.mark.parametrize("number", [2, *slowly(1, 3)])
def test_elements_of_test_circuits_are_those_published(number, data_folder):
    hertz, Z = zplot(data_folder / "impedance" / f"Circuit{number}_EIS_1.z")
    fit = phc.pem(measured(Z, hertz, noise=0.0), 0, real_poles=1, structure="passive")
    circuit = phc.netlist(fit, kind="impedance")
    stated = [values(circuit)[name] for name in ("R1", "R2", "C1")]
    published, their_errors = map(np.array, PUBLISHED[number])
    rounded = 10.0 ** np.floor(np.log10(published) - 2) / 2  # of three digits
    ours = np.array([errors(circuit)[name] for name in ("R1", "R2", "C1")])
    assert np.all(np.abs(stated - published) < rounded + 4 * np.hypot(ours, their_errors))
    residual = np.sqrt(np.mean(np.abs(fit.predicted / Z - 1) ** 2))
    assert residual < 0.005  # the circuit of the publication leaves 0.008 to 0.010


def test_a_battery_is_a_passive_model_of_real_poles(data_folder):
    hertz, real, imaginary = np.loadtxt(data_folder / "impedance" / "exampleData.csv", delimiter=",").T
    lines = imaginary < 0  # as the published fit, without lines where leads prevail
    Z = (real + 1j * imaginary)[lines]
    fit = phc.pem(measured(Z, hertz[lines], noise=0.0), structure="passive")
    assert fit.order == 0 and phc.passivity(fit.system).is_passive
    # the best sum of positive RC elements leaves 0.0016, the published circuit 0.020
    assert np.sqrt(np.mean(np.abs(fit.predicted / Z - 1) ** 2)) < 0.0022
    circuit = phc.netlist(fit, kind="impedance")
    assert all(element.value > 0 and element.stderr > 0 for element in circuit.elements)
    # with the inductance of leads only the admittance has a state space
    admittance = phc.read_netlist(circuit.spice().replace("I1 0 1", "V1 1 0"))
    assert np.allclose(1 / np.squeeze(admittance(2j * np.pi * hertz[lines])), fit.predicted, rtol=1e-6)


@pytest.mark.slow
def test_more_real_poles_than_a_battery_shows_give_no_warning(data_folder):
    hertz, real, imaginary = np.loadtxt(data_folder / "impedance" / "exampleData.csv", delimiter=",").T
    fit = phc.pem(measured(real + 1j * imaginary, hertz, noise=0.0), structure="passive", real_poles=14)
    assert np.all(fit.real_poles <= 0)
