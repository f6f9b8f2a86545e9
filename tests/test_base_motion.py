"""Structures on a base that moves: responses, participation factors and effective masses, computed and fitted."""

import functools
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.linalg import eigh

import ph_control as phc

SETTINGS = settings(deadline=None, max_examples=10, derandomize=True)
MASSES = np.array([2.0, 2.0, 2.0, 1.5, 1.5, 1.0])


def storeys(masses=MASSES, stiffness=900.0):
    """Mass, damping and stiffness of a frame of rigid floors."""
    n = len(masses)
    k = stiffness * np.linspace(1.5, 1.0, n)
    K = np.diag(k + np.append(k[1:], 0.0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    M = np.diag(masses)
    return M, 0.1 * M + 0.0005 * K, K


def dense_response(M, C, K, base, omega):
    """Relative displacements per unit of acceleration of the base, by the equations of motion."""
    return np.linalg.solve(-(omega**2) * M + 1j * omega * C + K, -M @ base)


def random_structure(seed, n, r):
    rng = np.random.default_rng(seed)
    roots = rng.standard_normal((3, n, n))
    M, C, K = (root @ root.T + 0.3 * np.eye(n) for root in roots)
    return M, 0.05 * C, 4.0 * K, rng.standard_normal((n, r)), rng


# --- computed structures ----------------------------------------------------------------------------------------------


@SETTINGS
@given(st.integers(0, 2**32), st.integers(1, 5), st.integers(1, 2), st.booleans())
def test_sensors_show_absolute_accelerations_and_relative_motions(seed, n, r, forced):
    M, C, K, base, rng = random_structure(seed, n, r)
    rows, F = rng.standard_normal((2, n)), rng.standard_normal((n, 1))
    sensors = {"acceleration": rows, "position": rows, "velocity": rows}
    plant = phc.from_second_order(M, K, F if forced else None, C=C, base=base, sensors=sensors)
    ports = r + forced
    for omega in (0.1, 1.0, 7.0):
        q, response = dense_response(M, C, K, base, omega), plant(1j * omega).reshape(ports + 6, ports)
        expected = [rows @ (base - omega**2 * q), rows @ q, 1j * omega * rows @ q]
        assert response[ports:, forced:] == pytest.approx(np.concatenate(expected), rel=1e-8, abs=1e-9)
        assert response[forced:ports, forced:] == pytest.approx(-1j * omega * base.T @ M @ q, rel=1e-8, abs=1e-9)
        if forced:
            q = np.linalg.solve(-(omega**2) * M + 1j * omega * C + K, F)
            assert response[ports : ports + 2, :1] == pytest.approx(-(omega**2) * rows @ q, rel=1e-8, abs=1e-9)
    assert not plant.D[ports:, forced:].any()


@SETTINGS
@given(st.integers(0, 2**32), st.integers(1, 6), st.integers(1, 2))
def test_effective_masses_are_those_of_the_modes_and_sum_up_to_the_moving_mass(seed, n, r):
    M, _, K, base, _ = random_structure(seed, n, r)
    motion = phc.from_second_order(M, K, base=base).base_motion
    squares, shapes = eigh(K, M)
    factors = shapes.T @ M @ base
    assert motion.natural_frequencies == pytest.approx(np.sqrt(squares))
    assert motion.effective_masses == pytest.approx(factors**2, rel=1e-7, abs=1e-9)
    assert np.abs(motion.participation_factors) == pytest.approx(np.abs(factors), rel=1e-7, abs=1e-7)
    assert motion.total == pytest.approx(np.diag(base.T @ M @ base)) == motion.moving_mass
    assert motion.contributions.sum(axis=0) == pytest.approx(base, abs=1e-9)
    assert motion.ratios.sum(axis=0) == pytest.approx(np.ones(r))


def test_the_port_of_the_base_takes_the_power_that_the_relative_motion_gets():
    M, _, K = storeys()
    plant = phc.from_second_order(M, K, base=np.ones(6))
    assert plant.is_lossless and (plant.input_labels, plant.output_labels) == (["a_g"], ["p_g"])
    # of an undamped structure the weights at this port are the effective masses
    assert plant.modes.kappa == pytest.approx(plant.base_motion.effective_masses[:, 0])
    both = phc.from_second_order(M, K, np.eye(6)[5], base=np.eye(6)[:, :2], name="frame")
    assert both.input_labels == ["F", "a_g_1", "a_g_2"] and both.output_labels == ["v", "p_g_1", "p_g_2"]


def test_the_lowest_modes_of_a_sparse_structure_carry_what_is_left_out_with_the_base():
    M, C, K = storeys(np.ones(40))
    sensors = {"acceleration": np.eye(40)[[9, 39]]}
    whole = phc.from_second_order(M, K, C=C, base=np.ones(40), sensors=sensors)
    few = phc.from_second_order(
        sparse.csc_array(M), sparse.csc_array(K), C=sparse.csc_array(C), base=np.ones(40), modes=6, sensors=sensors
    )
    assert few.base_motion.effective_masses == pytest.approx(whole.base_motion.effective_masses[:6], rel=1e-8)
    assert few.base_motion.moving_mass == pytest.approx([40.0])
    assert few.base_motion.contributions == pytest.approx(np.abs(whole.base_motion.contributions[:6]) * np.sign(
        few.base_motion.contributions), rel=1e-6, abs=1e-9)  # fmt: skip
    for omega in (0.0, 0.5, 2.0):
        exact = 1 - omega**2 * dense_response(M, C, K, np.ones(40), omega)[[9, 39]]
        assert few(1j * omega)[1:, 0] == pytest.approx(exact, rel=2e-4)


def test_storeys_without_mass_follow_the_others():
    masses = np.array([2.0, 0.0, 1.0])
    M, _, K = storeys(masses)
    rows = np.eye(3)
    plant = phc.from_second_order(M, K, base=np.ones(3), condense=True, sensors={"acceleration": rows})
    assert plant.base_motion.total == pytest.approx([3.0]) and plant.base_motion.moving_mass == pytest.approx([3.0])
    for omega in (1.0, 20.0):
        exact = 1 - omega**2 * dense_response(M, np.zeros((3, 3)), K, np.ones(3), omega)
        assert plant(1j * omega)[1:, 0] == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize("size", [1e-9, 1e9])
def test_units_of_mass_scale_effective_masses(size):
    M, _, K = storeys()
    plain, other = (phc.from_second_order(s * M, s * K, base=np.ones(6)).base_motion for s in (1.0, size))
    assert other.effective_masses == pytest.approx(size * plain.effective_masses, rel=1e-9)
    assert other.contributions == pytest.approx(plain.contributions, rel=1e-9)


def test_the_base_motion_is_in_copies_and_prints_a_table():
    M, _, K = storeys()
    plant = phc.from_second_order(M, K, base=np.ones(6))
    again = pickle.loads(pickle.dumps(plant))
    assert np.array_equal(again.base_motion.effective_masses, plant.base_motion.effective_masses)
    assert phc.base_motion(plant) is plant.base_motion
    assert "effective mass" in str(plant.base_motion) and "84.69 %" in str(plant.base_motion)


@pytest.mark.parametrize(
    "options, message",
    [
        ({}, "neither forces F nor a base that moves"),
        ({"base": np.ones(5)}, r"base has shape \(5,\); it must be \(6,\)"),
        ({"base": np.zeros(6)}, "base has no motion in direction 0"),
        ({"base": np.ones((6, 0))}, "base has shape"),
        ({"base": [1.0, np.nan, 1.0, 1.0, 1.0, 1.0]}, "base"),
    ],
)
def test_directions_that_are_none_are_refused(options, message):
    M, _, K = storeys()
    for more in ({}, {"modes": 2}):
        with pytest.raises(phc.StructureError, match=message):
            phc.from_second_order(M, K, **options, **more)


def test_a_base_that_moves_no_mass_is_refused():
    M, _, K = storeys(np.array([1.0, 0.0]))
    with pytest.raises(phc.StructureError, match="no mass moves with the base in direction 0"):
        phc.from_second_order(M, K, base=[0.0, 1.0], condense=True)


# --- fits -------------------------------------------------------------------------------------------------------------


@functools.cache
def shaken(noise=0.05):
    """Record of the ground and the floors, and the frame; the base shear is the last output."""
    M, C, K = storeys()
    plant = phc.from_second_order(M, K, C=C, base=np.ones(6), sensors={"acceleration": np.eye(6)}, modes=6)
    rng, t = np.random.default_rng(0), 0.02 * np.arange(2500)
    ground = rng.standard_normal(len(t))
    floors = phc.forced_response(plant, t, ground).outputs[1:]
    measured = np.concatenate([floors, [MASSES @ floors]])
    return ground, measured + noise * measured.std(axis=1, keepdims=True) * rng.standard_normal(measured.shape), plant


@functools.cache
def fitted():
    ground, floors, _ = shaken()
    return phc.pem((ground, floors), 6, dt=0.02, quantity="acceleration", structure="classical", intersample="foh")


def test_effective_masses_of_six_storeys_sum_up_to_the_mass_within_their_errors():
    motion, exact = phc.base_motion(fitted(), masses=[*MASSES, 0.0]), shaken()[2].base_motion
    assert motion.moving_mass == pytest.approx([10.0])
    assert abs(motion.total[0] - 10.0) < 3 * motion.stderr["total"][0] < 0.1
    z = (motion.effective_masses - exact.effective_masses) / motion.stderr["effective_masses"]
    assert np.abs(z).max() < 4 and 0.3 < np.sqrt(np.mean(z**2)) < 2
    factors = np.abs(exact.participation_factors)
    assert np.abs(motion.participation_factors / factors - 1)[:3].max() < 0.05
    assert np.all(motion.stderr["effective_masses"][:3, 0] < 0.02 * exact.effective_masses[:3, 0])
    assert "+-" in str(motion)


def test_contributions_of_the_modes_need_no_masses():
    motion, exact = phc.base_motion(fitted()), shaken()[2].base_motion
    z = (motion.contributions[:, :6] - exact.contributions) / motion.stderr["contributions"][:, :6]
    assert np.abs(z).max() < 4.5 and 0.5 < np.sqrt(np.mean(z**2)) < 1.6
    assert np.isnan(motion.effective_masses).all() and "largest contribution" in str(motion)


def test_a_measured_base_shear_has_the_effective_masses_itself():
    shear = phc.base_motion(fitted(), masses=[0.0] * 6 + [1.0])
    floors = phc.base_motion(fitted(), masses=[*MASSES, 0.0])
    spread = np.hypot(shear.stderr["effective_masses"], floors.stderr["effective_masses"])
    assert np.all(np.abs(shear.effective_masses - floors.effective_masses) < 4 * spread)


@pytest.mark.parametrize("quantity, power", [("displacement", 0), ("velocity", 1), ("acceleration", 2)])
def test_errors_are_those_of_differences(quantity, power):
    """By what a result is made of: size and damping of the pole, and both parts of the residue."""
    rng, h = np.random.default_rng(1), 0.1
    plant = phc.from_second_order([[1.0]], [[9.0]], C=[[0.3]], base=[1.0], sensors={quantity: [[1.0]]})
    t, ground = h * np.arange(600), rng.standard_normal(600)
    y = phc.forced_response(plant, t, ground).outputs[1]
    fit = phc.pem(
        (ground, y + 0.02 * rng.standard_normal(600)), 1, dt=h, quantity=quantity, structure="free", intersample="foh"
    )

    def contribution(theta):
        p = theta[0] * (-theta[1] + 1j * np.sqrt(1 - theta[1] ** 2))
        return -((theta[2] + 1j * theta[3]) * 2j * p.imag / p**power).real

    theta = np.array([fit.d[0], fit.damping_ratios[0], fit.residues[0, 0, 0].real, fit.residues[0, 0, 0].imag])
    slopes = [(contribution(theta + step) - contribution(theta - step)) / 2e-6 for step in 1e-6 * np.eye(4)]
    expected = np.sqrt(np.array(slopes) @ fit.covariance[:4, :4] @ slopes)
    motion = phc.base_motion(fit, masses=[2.0])
    assert motion.stderr["contributions"].item() == pytest.approx(expected, rel=1e-5)
    assert motion.contributions.item() == pytest.approx(contribution(theta), rel=1e-12)
    assert motion.contributions.item() == pytest.approx(1.0, abs=5 * expected)
    assert motion.effective_masses.item() == pytest.approx(2 * contribution(theta))
    assert motion.stderr["total"].item() == pytest.approx(2 * expected, rel=1e-5)


@pytest.mark.parametrize(
    "masses, message",
    [
        ([1.0, 2.0], r"shape \(7,\), one for each output"),
        (-np.ones(7), "at least 0"),
        (np.zeros(7), "not all 0"),
    ],
)
def test_masses_that_are_none_are_refused(masses, message):
    with pytest.raises(phc.StructureError, match=message):
        phc.base_motion(fitted(), masses=masses)


def test_what_has_no_moving_base_is_refused():
    with pytest.raises(phc.StructureError, match="a PortHamiltonian without a motion of its base"):
        phc.base_motion(phc.frenkel_kontorova(2))
    rng = np.random.default_rng(0)
    u = rng.standard_normal(300)
    y = phc.forced_response(phc.ph(phc.modes(1.0, 1.0, damping=0.05)), 0.1 * np.arange(300), u).outputs
    free = phc.pem((u, y + 0.01 * rng.standard_normal(300)), 1, dt=0.1, quantity="free", structure="free")
    with pytest.raises(phc.StructureError, match="of no known quantity"):
        phc.base_motion(free)
