"""Frequency responses on a background, of few points, and with wild lines, beside rational functions written out."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest
from slow import slowly

import ph_control as phc

OMEGA = np.linspace(0.5, 20.0, 420)
MODES = ((1.0, 0.01, 5.0), (2.0, 0.02, 9.0), (0.7, 0.005, 14.0))  # residues, damping ratios, natural frequencies
POWERS = {"displacement": 0, "velocity": 1, "acceleration": 2}


def modal(s, power=1, modes=MODES):
    """Sum of sections `a s^k / (s^2 + 2 zeta d s + d^2)`."""
    return sum((a * s**power / (s * s + 2 * zeta * d * s + d * d) for a, zeta, d in modes), 0 * s)


def noisy(values, level=0.01, seed=0):
    """Values with noise of a share of their median."""
    rng, size = np.random.default_rng(seed), np.median(np.abs(values), axis=-1, keepdims=True)
    return values + level * size * (rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape))


def measured(values, omega=OMEGA):
    return ct.frd(values, omega, smooth=False)


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize(
    "quantity, constant", [("displacement", 0.3 + 0.2j), ("velocity", 0.0), ("acceleration", 0.3 + 0.2j)]
)
def test_a_complex_constant_and_slope_are_no_modes(quantity, constant):
    s, power = 1j * OMEGA, POWERS[quantity]
    modes, slope = modal(s, power), 0.03
    unit = float(np.median(np.abs(modes)))
    response = noisy(np.stack([modes, 0.5 * modes]) + unit * (constant + slope * s), seed=3)[:, None]
    # as large in all lines
    result = phc.pem(measured(response), quantity=quantity, weights=np.ones(response.shape))
    assert result.order == 3 and not len(result.real_poles) and result.outcome.name == "CONSISTENT"
    found = result.background
    imaginary, slopes = found.constant.imag / unit, found.slope.real / unit
    errors = found.stderr / unit
    assert np.all(np.abs(slopes - slope) < 5 * errors[3].real) and np.all(errors[3].real < 2e-3)
    assert np.all(np.abs(imaginary - np.imag(constant)) < 5 * errors[2].imag + 1e-15)
    if quantity == "displacement":
        assert np.all(np.abs(found.constant.real / unit - np.real(constant)) < 0.01)
    else:
        through = np.real(constant) + (power == 2) * np.array([[3.7], [1.85]]) / unit
        deviation = np.nan_to_num(result.stderr["feedthrough"]) / unit
        assert np.all(np.abs(result.feedthrough / unit - through) < 5 * deviation + 1e-12)
    # systems are without it, predictions with it
    whole = result.observed_system(s, squeeze=False) + found.response(OMEGA)
    assert np.allclose(whole, result.predicted, rtol=1e-9, atol=1e-12 * unit)


def test_a_background_that_no_data_show_is_no_parameter():
    response = noisy(np.stack([modal(1j * OMEGA), -modal(1j * OMEGA)]), seed=1)[:, None]
    result = phc.pem(measured(response), structure="free")
    assert result.order == 3 and result.background is None and not result.feedthrough.any()
    # three poles of two numbers, as many residues for both entries, and two variances
    assert result.unknowns == 6 + 2 * 6 + 2


@pytest.mark.parametrize("quantity, lower, upper", [("displacement", -2, 0), ("velocity", -1, 1)])
def test_modes_outside_the_band_leave_residual_terms(quantity, lower, upper):
    s, power = 1j * OMEGA, POWERS[quantity]
    outside = 0.3 * s**lower + 0.02 * s**upper
    result = phc.pem(measured(noisy(modal(s, power) + outside, 0.003)), quantity=quantity, structure="classical")
    found = result.background
    assert result.order == 3
    for values, true, place in ((found.lower_residual, 0.3, lower), (found.upper_residual, 0.02, upper)):
        assert abs(values.item() - true) < 5 * found.stderr[place + 2].real.item() < 0.05 * true


def test_files_and_pictures_have_the_background(tmp_path):
    s = 1j * OMEGA
    response = noisy(np.stack([modal(s) + 0.4 * s, 0.1j + modal(s)]), 0.003)[:, None]
    result = phc.pem(measured(response), 3, weights=np.ones(response.shape), structure="classical")
    result.save(tmp_path / "fit.json")
    again = phc.load(tmp_path / "fit.json")
    assert np.array_equal(again.background.coefficients, result.background.coefficients)
    assert np.array_equal(again.background.stderr, result.background.stderr)
    assert again.background.quantities == ("velocity", "velocity")
    exact = 20 * np.log10(np.abs(modal(s) + 0.4 * s))
    for picture in (result.plot(), result.plot(kind="responses")):
        axis = picture.figure.axes[0]
        curve = max(
            (line for line in axis.lines if line.get_linestyle() != "None"), key=lambda line: len(line.get_xdata())
        )
        x, y = (np.asarray(part, float) for part in curve.get_data())
        drawn = np.interp(OMEGA[200] / (2 * np.pi if x.max() < 4 else 1.0), x, y)
        assert abs(drawn - exact[200]) < 0.2
    low, high = 20 * np.log10(result.sample(200, 0).magnitude_band(OMEGA[200:]))
    assert np.all(low < exact[200:] + 0.05) and np.all(high > exact[200:] - 0.05) and np.all(high - low < 0.2)
    other = np.linspace(1.0, 19.0, 100)
    unseen = measured(np.stack([modal(1j * other) + 0.4j * other, 0.1j + modal(1j * other)])[:, None], other)
    assert phc.compare(unseen, result).fit_percent[0] > 99.0


@pytest.mark.parametrize("entry", [(2, 0), (-1, 0), (0, 1), (0.0, 0), (0, [0]), (True, 0), (None, 0), ("y", 0)])
def test_only_an_output_and_input_that_are_there_have_a_background(entry):
    background = phc.ResponseBackground(np.ones((5, 2, 1)) + 0j, np.zeros((5, 2, 1)) + 0j, ("velocity", "velocity"))
    assert background.entry(np.int64(1), 0).coefficients.shape == (5, 1, 1)
    with pytest.raises(phc.StructureError, match=r"(output|input) is .*; it must be a whole number from 0 to"):
        background.entry(*entry)


def test_terms_that_are_not_there_have_no_value_at_any_frequency():
    terms = np.zeros((5, 1, 1), complex)
    terms[3] = 0.05
    values = phc.ResponseBackground(terms, 0 * terms, ("velocity",)).response([2e-6, 5e-324, 0.0, 1e153])
    np.testing.assert_allclose(values[0, 0], [1e-7j, 0.0, 0.0, 5e151j], rtol=1e-15, atol=1e-300)
    for k, omega in ((0, [1.0, 1e-200]), (4, [1.0, 1e153])):
        large = np.zeros((5, 1, 1), complex)
        large[k] = 1e9
        with pytest.raises(phc.StructureError, match="values of the background leave the range of doubles"):
            phc.ResponseBackground(large, 0 * large, ("velocity",)).response(omega)


@pytest.mark.variants
@pytest.mark.parametrize("zeta", [0.02, *slowly(0.0)])
@pytest.mark.parametrize("lines", [12, *slowly(24)])
@pytest.mark.parametrize("order", [0, 2, 3])
def test_few_lines_show_modes_with_one_number_each(zeta, lines, order):
    omega = np.linspace(0.3, 4.6, lines)
    modes = tuple((a, zeta, d) for a, d in ((1.0, 1.02), (0.7, 2.03), (0.5, 3.48))[:order])
    exact = modal(1j * omega, modes=modes)
    level = 0.01 if order else 0.0
    rng = np.random.default_rng(lines)
    noise = (rng.standard_normal(lines) + 1j * rng.standard_normal(lines)) * (0 if order else 1)
    result = phc.pem(measured(noisy(exact, level, lines) + noise, omega), structure="classical")
    assert result.order == order
    if order:
        assert np.allclose(result.natural_frequencies, [one[2] for one in modes], rtol=3e-3)
        # s / (s^2 + 2 zeta d s + d^2) has the residue p / (p - p*)
        p = result.poles
        assert np.allclose(result.residues[:, 0, 0] / (p / (2j * p.imag)), [one[0] for one in modes], rtol=0.1)


@pytest.mark.variants
@pytest.mark.parametrize("line, size", [(0, 1e7), (77, 1e7), (300, 100.0)])
def test_a_wild_line_is_named_and_hides_no_mode(line, size):
    omega = OMEGA - OMEGA[0]
    response = noisy(np.stack([modal(1j * omega, 0), 0.4 * modal(1j * omega, 0)]))[:, None]
    response[:, :, line] = size * np.abs(response).max()
    result = phc.pem(measured(response, omega), quantity="displacement")
    (finding,) = [one for one in result.findings if one.cause.name == "WILD_LINES"]
    assert finding.values == (omega[line],) and f"{omega[line]:.6g}" in result.message
    assert result.order == 3 and np.allclose(result.natural_frequencies, [5.0, 9.0, 14.0], rtol=1e-3)


def test_a_resonance_next_to_a_line_is_not_wild():
    omega = np.linspace(0.05, 3.2, 150)
    d = np.array([omega[40] + 1e-3 * (omega[1] - omega[0]), 1.7, 2.5])
    exact = modal(1j * omega, modes=[(a, 0.0, one) for a, one in zip((0.5, 0.8, 0.4), d, strict=True)])
    rng = np.random.default_rng(1)
    response = exact + 1e-3 * np.abs(exact) * (rng.standard_normal(150) + 1j * rng.standard_normal(150))
    result = phc.pem(measured(response, omega), structure="classical")
    assert result.order == 3 and np.allclose(result.natural_frequencies, d, rtol=1e-5)
    assert all(one.cause.name != "WILD_LINES" for one in result.findings)


# --- impedances ------------------------------------------------------------------------------------------------------


def test_an_impedance_of_two_cells_has_their_elements():
    omega = np.logspace(-1, 5, 90)
    s, rng = 1j * omega, np.random.default_rng(4)
    exact = 10.0 + 20.0 / (1 + 0.02 * s) + 50.0 / (1 + 1.0 * s)
    Z = exact + 0.01 * np.abs(exact) * (rng.standard_normal(90) + 1j * rng.standard_normal(90))
    result = phc.pem(measured(Z, omega), structure="passive")
    assert result.order == 0 and isinstance(result.system, phc.DissipativePortHamiltonian)
    errors = result.stderr["time_constants"]
    assert np.all(np.abs(result.time_constants - [1.0, 0.02]) < 4 * errors) and np.all(errors < [0.02, 4e-4])
    resistances = result.residues[:, 0, 0].real * result.time_constants
    assert np.allclose(resistances, [50.0, 20.0], rtol=0.02)
    assert abs(result.feedthrough.item() - 10.0) < 4 * result.stderr["feedthrough"].item() < 0.1
    # R0, and two cells of a resistor and a capacitor
    values = sorted(one.value for one in phc.netlist(result.system, kind="impedance").elements if one.name[0] == "R")
    assert np.allclose(values, [10.0, 20.0, 50.0], rtol=0.02)


@pytest.mark.variants
@pytest.mark.parametrize("number, resistances", [(2, (150.0, 503.0)), (3, (1504.0, 4633.0))])
def test_measured_test_circuits_are_passive_models_of_real_poles(data_folder, number, resistances):
    path = data_folder / "impedance" / f"Circuit{number}_EIS_1.z"
    rows = [line.split() for line in path.read_text(errors="replace").splitlines()]
    table = np.array([[float(one.strip(",")) for one in row] for row in rows if len(row) == 9 and _is_number(row[0])])
    table = table[np.argsort(table[:, 0])]
    result = phc.pem(measured(table[:, 4] + 1j * table[:, 5], 2 * np.pi * table[:, 0]), structure="passive")
    assert result.order == 0 and result.outcome.name == "CONSISTENT"
    # a second pole, of a capacitor that is not ideal, has next to nothing
    each = result.residues[:, 0, 0].real * result.time_constants
    assert np.allclose((result.feedthrough.item(), each.sum()), resistances, rtol=0.01) and each[0] > 0.97 * each.sum()


def _is_number(text):
    try:
        float(text.strip(","))
    except ValueError:
        return False
    return True
