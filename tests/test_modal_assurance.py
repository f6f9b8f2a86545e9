"""Comparison of mode shapes: modal assurance, phase collinearity, alignment, and poles stable over orders."""

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ph_control as phc
from ph_control.identification.estimates.scaled_shapes import ModeShapes, shape_jacobian
from ph_control.numerics.modal_assurance import Stability, aligned_shapes, mac, phase_collinearity, stable_poles

EPS = np.finfo(float).eps
quick = settings(deadline=None, max_examples=13, derandomize=True)


def random_shapes(seed, n=4, p=6):
    rng = np.random.default_rng(seed)
    return rng.standard_normal((n, p)) + 1j * rng.standard_normal((n, p))


def damped_poles(hertz, ratios):
    d, zeta = 2 * np.pi * np.asarray(hertz, float), np.asarray(ratios, float)
    return d * (-zeta + 1j * np.sqrt(1 - zeta**2))


# --- modal assurance -------------------------------------------------------------------------------------------------


def test_mac_is_its_definition_in_thirty_digits():
    one, other = random_shapes(0, 2, 3), random_shapes(1, 3, 3)
    with mp.workdps(30):
        rows, columns = ([[mp.mpc(x) for x in row] for row in shapes] for shapes in (one, other))
        inner = [[sum(mp.conj(a) * b for a, b in zip(x, y, strict=True)) for y in columns] for x in rows]
        sizes = [[sum(abs(a) ** 2 for a in x) for x in some] for some in (rows, columns)]
        expected = [[float(abs(inner[i][j]) ** 2 / sizes[0][i] / sizes[1][j]) for j in range(3)] for i in range(2)]
    np.testing.assert_allclose(mac(one, other), expected, rtol=0, atol=10 * EPS)


@quick
@given(st.integers(0, 1000), st.integers(-300, 300))
def test_mac_does_not_know_scale_and_phase_of_a_shape(seed, power):
    shapes = random_shapes(seed)
    scaled = shapes * 10.0**power * np.exp(1j * seed)
    np.testing.assert_allclose(mac(shapes, scaled), mac(shapes, shapes), atol=50 * EPS)
    np.testing.assert_allclose(np.diag(mac(shapes, scaled)), 1.0, atol=50 * EPS)
    assert mac(shapes, scaled).max() <= 1.0


def test_mac_of_orthogonal_shapes_and_of_one_that_vanishes_is_zero():
    shapes = np.array([[1.0, 1.0], [1.0, -1.0], [0.0, 0.0]])
    np.testing.assert_allclose(mac(shapes, shapes), np.diag([1.0, 1.0, 0.0]), atol=10 * EPS)


def test_the_mac_of_modal_forms_refuses_other_outputs():
    one = phc.modes([-0.1 + 1j], np.ones((1, 2)), np.ones((1, 1)))
    other = phc.modes([-0.1 + 1j], np.ones((1, 3)), np.ones((1, 1)))
    with pytest.raises(phc.StructureError, match="2 and of 3 outputs"):
        one.mac(other)


# --- phases ----------------------------------------------------------------------------------------------------------


@quick
@given(st.integers(0, 1000))
def test_phase_collinearity_is_that_of_the_principal_axes(seed):
    shapes = random_shapes(seed)
    for shape, found in zip(shapes, phase_collinearity(shapes), strict=True):
        parts = np.stack([shape.real, shape.imag])
        low, high = np.linalg.eigvalsh(parts @ parts.T)
        assert abs(found - ((high - low) / (high + low)) ** 2) <= 20 * EPS


def test_phase_collinearity_of_a_standing_and_of_a_running_wave():
    x = np.arange(8) * np.pi / 4
    standing, running = np.cos(x) * np.exp(0.7j), np.exp(1j * x)
    assert abs(phase_collinearity(standing) - 1) <= 10 * EPS
    assert phase_collinearity(running) <= 10 * EPS
    assert phase_collinearity(1e-250 * standing) == pytest.approx(1.0)
    assert np.isnan(phase_collinearity(np.zeros(3)))


@quick
@given(st.integers(0, 1000), st.floats(-np.pi, np.pi))
def test_an_aligned_shape_is_as_real_as_a_turn_makes_it(seed, angle):
    shapes = random_shapes(seed)
    aligned, turn = aligned_shapes(shapes * np.exp(1j * angle))
    assert np.abs(np.abs(turn) - 1).max() <= 10 * EPS
    for shape, found in zip(shapes, aligned, strict=True):
        turns = np.exp(1j * np.linspace(0, np.pi, 721))
        assert np.linalg.norm(found.real) >= max(np.linalg.norm((shape * one).real) for one in turns) * (1 - 10 * EPS)
        assert found.real[np.abs(found.real).argmax()] > 0


def test_a_real_shape_keeps_its_entries():
    aligned, _ = aligned_shapes(np.array([[0.5, -2.0, 1.0]]) * np.exp(2.5j))
    np.testing.assert_allclose(aligned, [[-0.5, 2.0, -1.0]], atol=20 * EPS)


# --- poles over orders -----------------------------------------------------------------------------------------------

LEVELS = {
    "new": ([1.02], [0.01], [1.0, 1.0], Stability.NEW),
    "frequency": ([1.009], [0.02], [1.0, 1.0], Stability.FREQUENCY),
    "damping": ([1.009], [0.0104], [1.0, -1.0], Stability.DAMPING),
    "shape": ([1.009], [0.0104], [1.0, 0.9], Stability.SHAPE),
}


@pytest.mark.parametrize("case", LEVELS)
def test_a_pole_is_stable_in_what_it_has_in_common_with_the_order_before(case):
    hertz, ratios, shape, level = LEVELS[case]
    poles = [damped_poles([1.0], [0.01]), damped_poles(hertz, ratios)]
    shapes = [np.array([[1.0, 1.0]]), np.array([shape])]
    first, second = stable_poles(poles, shapes)[0]
    assert first.tolist() == [Stability.NEW] and second.tolist() == [level]


def test_the_tolerances_are_kept_on_both_sides():
    poles = [damped_poles([1.0], [0.01]), damped_poles([1.02], [0.0108])]
    shapes = [np.array([[1.0, 1.0]]), np.array([[1.0, 0.5]])]  # of MAC 0.9
    keys = ("frequency_tolerance", "damping_tolerance", "least_mac")
    for values, level in (
        ((0.0195, 0.1, 0.8), 0), ((0.0197, 0.074, 0.8), 1), ((0.0197, 0.0741, 0.9001), 2), ((0.0197, 0.0741, 0.8999), 3)
    ):  # fmt: skip
        assert stable_poles(poles, shapes, **dict(zip(keys, values, strict=True)))[0][1].tolist() == [level]


@pytest.mark.parametrize("tolerance", [0.0, 5e-324])
def test_a_tolerance_that_no_rounding_passes_holds_for_equal_frequencies_alone(tolerance):
    poles = [damped_poles([1.0, 2.0], [0.01, 0.01]), damped_poles([1.5, 2.0, 3.0], [0.01, 0.01, 0.01])]
    assert stable_poles(poles, frequency_tolerance=tolerance)[0][1].tolist() == [
        Stability.NEW, Stability.DAMPING, Stability.NEW,
    ]  # fmt: skip


def test_a_pole_confirms_one_pole_only_the_one_of_the_same_shape():
    """Of close modes the shape tells which is which, not the distance of the frequencies."""
    poles = [damped_poles([1.0], [0.01]), damped_poles([1.001, 1.004], [0.01, 0.01])]
    shapes = [np.array([[1.0, 1.0]]), np.array([[1.0, -1.0], [1.0, 1.0]])]
    assert stable_poles(poles, shapes)[0][1].tolist() == [Stability.NEW, Stability.SHAPE]
    assert stable_poles(poles)[0][1].tolist() == [Stability.DAMPING, Stability.NEW]


def test_a_single_output_has_no_shape_to_be_stable():
    poles = [damped_poles([1.0], [0.01])] * 2
    assert stable_poles(poles, [np.ones((1, 1))] * 2)[0][1].tolist() == [Stability.DAMPING]


def test_lossless_and_rigid_modes_and_orders_without_poles_are_classified():
    still = np.array([0.0, 1j, 2j])
    assert stable_poles([still, still])[0][1].tolist() == [2, 2, 2]
    assert [row.tolist() for row in stable_poles([still[:0], still, still[:0]])[0]] == [[], [0, 0, 0], []]


@pytest.mark.parametrize("ports", [(), ((0, 0),), ((1, 0), (2, 1))])
def test_derivatives_of_shapes_are_those_of_differences(ports):
    rng, quantities = np.random.default_rng(3), ("velocity", "acceleration", "displacement")
    residue = rng.standard_normal((3, 2)) + 1j * rng.standard_normal((3, 2))
    x = np.concatenate([[2.0, 0.05], residue.real.ravel(), residue.imag.ravel()])

    def shape(x):
        pole = np.array([x[0] * (-x[1] + 1j * np.sqrt(1 - x[1] ** 2))])
        (found,) = ModeShapes.of(pole, (x[2:8] + 1j * x[8:]).reshape(1, 3, 2), quantities, ports).shapes
        return np.concatenate([found.real, found.imag])

    differences = np.array([(shape(x + 1e-6 * one) - shape(x - 1e-6 * one)) / 2e-6 for one in np.eye(14)]).T
    J = shape_jacobian(complex(2 * (-0.05 + 1j * np.sqrt(1 - 0.05**2))), residue, quantities, ports)
    assert np.allclose(J, differences, rtol=0, atol=1e-7 * np.abs(differences).max())
