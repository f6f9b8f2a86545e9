"""Large structures are reduced from their sparse matrices, and `error_bound` bounds the error of the full response."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest
from scipy import sparse
from slow import slowly

import ph_control as phc

SIDE = 18
N = SIDE**2
RNG = np.random.default_rng(0)


def membrane():
    row = 2 * sparse.eye_array(SIDE) - sparse.eye_array(SIDE, k=1) - sparse.eye_array(SIDE, k=-1)
    return sparse.diags_array(RNG.uniform(0.8, 1.2, N)).tocsc(), sparse.kronsum(row, row, format="csc")


M, K = membrane()
HERE = sparse.diags_array((np.arange(N) % 10 == 0).astype(float), format="csc")
DAMPINGS = {
    "stiffness": 0.01 * K,
    "Rayleigh": 0.004 * K + 0.003 * M,
    "some dashpots": 0.004 * K + 0.02 * HERE,
    "one dashpot": 0.004 * K + sparse.csc_array(([0.3], ([17], [17])), shape=(N, N)),
}


def ports(count):
    F = np.zeros((N, count))
    F[[N // 3 + 2, N // 5][:count], range(count)] = 1.0
    return F


def dense_response(C, F, sensors, omega):
    """By dense matrices and the definition of each output."""
    values = []
    for w in omega:
        damping = 0 if C is None else C.toarray()
        q = np.linalg.solve(K.toarray() + 1j * w * damping - w**2 * M.toarray(), F)
        rate = {"position": 1.0, "velocity": 1j * w, "acceleration": -(w**2)}
        values.append(np.vstack([1j * w * F.T @ q, *(rate[kind] * (rows @ q) for kind, rows in sensors.items())]))
    return np.stack(values, axis=2)


def largest(difference):
    return np.linalg.norm(np.moveaxis(difference, 2, 0), 2, axis=(1, 2)).max()


SENSORS = {"position": np.eye(N)[[40]], "acceleration": np.eye(N)[[100, 200]]}


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("damping", DAMPINGS)
@pytest.mark.parametrize("count, sensors", [(2, SENSORS), *slowly((1, {}))])
@pytest.mark.parametrize("method", ["modal", "balanced"])
def test_the_bound_holds_over_the_band_and_is_near_the_error(damping, count, sensors, method):
    C, F, band = DAMPINGS[damping], ports(count), (0.0, 0.6)
    structure = phc.SecondOrderSystem(M, K, F, C=C, sensors=sensors)
    small = phc.reduce(structure, 16, band=band, method=method)
    assert small.nstates == 16 and small.error_bound is not None
    assert phc.passivity(ct.ss(small.A, small.B, small.C, small.D)[:count, :count]).is_passive
    frequencies = structure.modal_model(band=band).structural_modes.natural_frequencies
    omega = np.unique(np.concatenate([np.linspace(0.001, 0.6, 60), frequencies]))
    exact = dense_response(C, F, sensors, omega)
    error = largest(small(1j * omega).reshape(exact.shape) - exact)
    assert error <= small.error_bound <= 1.2 * error + 0.05 * largest(exact)


@pytest.mark.variants
@pytest.mark.parametrize("damping", DAMPINGS)
def test_what_many_states_leave_is_what_the_modes_left_out_do(damping):
    # more states than the modes of the band and beyond have: the model of modes itself
    C, F = DAMPINGS[damping], ports(2)
    small = phc.reduce(phc.SecondOrderSystem(M, K, F, C=C), 500, band=(0.0, 0.4), method="balanced")
    omega = np.linspace(0.001, 0.4, 50)
    exact = dense_response(C, F, {}, omega)
    error = largest(small(1j * omega) - exact)
    assert 0 < error <= small.error_bound <= 20 * error < 0.3 * largest(exact)


def test_all_modes_leave_nothing():
    stiffness = 2 * np.eye(30) - np.eye(30, k=1) - np.eye(30, k=-1)
    structure = phc.SecondOrderSystem(np.eye(30), stiffness, np.eye(30)[0], C=0.01 * stiffness)
    assert phc.reduce(structure, 60).error_bound < 1e-9


def test_the_order_alone_bounds_the_error_up_to_the_modes_kept():
    C, F = DAMPINGS["Rayleigh"], ports(1)
    structure = phc.SecondOrderSystem(M, K, F, C=C)
    small = phc.reduce(structure, 14, method="h2")
    high = structure.modal_model(modes=14).structural_modes.natural_frequencies[6 - 1]
    omega = np.linspace(0.001, high, 100)
    exact = dense_response(C, F, {}, omega)
    assert largest(small(1j * omega)[None, None] - exact) <= small.error_bound < 0.5 * largest(exact)


def test_a_lossless_structure_stays_lossless():
    structure = phc.SecondOrderSystem(M, K, ports(1))
    small = phc.reduce(structure, band=(0.0, 0.5))
    assert small.is_lossless and np.isfinite(small.error_bound)
    kept = structure.modal_model(band=(0.0, 0.5)).structural_modes.natural_frequencies
    omega = 0.5 * (kept[1:] + kept[:-1])
    exact = dense_response(None, ports(1), {}, omega)
    assert largest(small(1j * omega)[None, None] - exact) <= small.error_bound
    # without one of the resonances no bound is finite
    assert phc.reduce(structure, 8, band=(0.0, 0.5)).error_bound == np.inf


def test_a_floating_structure_keeps_its_rigid_motion():
    row = sparse.diags_array([[1.0] + [2.0] * 58 + [1.0], [-1.0] * 59, [-1.0] * 59], offsets=[0, 1, -1], format="csc")
    structure = phc.SecondOrderSystem(sparse.eye_array(60), row, np.eye(60)[0], C=0.3 * row)
    small = phc.reduce(structure, 16, band=(0.0, 0.3), method="balanced")
    assert abs(small(1e-6j) * 1e-6j * 60 - 1) < 1e-6  # as one mass of 60
    omega = np.linspace(1e-3, 0.3, 60)
    exact = np.array([1j * w * np.linalg.solve(row.toarray() * (1 + 0.3j * w) - w**2 * np.eye(60), np.eye(60)[0])[0]
                      for w in omega])  # fmt: skip
    assert np.abs(small(1j * omega) - exact).max() <= small.error_bound < 0.1 * np.abs(exact).max()


def test_degrees_of_freedom_without_mass_follow_the_others():
    masses = np.where(np.arange(N) % 7 == 3, 0.0, 1.0)
    F = ports(1) * (masses > 0)[:, None]
    light = sparse.diags_array(masses, format="csc")
    with pytest.raises(phc.StructureError, match="M is singular"):
        phc.SecondOrderSystem(light, K, F)
    structure = phc.SecondOrderSystem(light, K, F, C=0.01 * light, condense=True)
    small = phc.reduce(structure, 20, band=(0.0, 0.4))
    omega = np.linspace(1e-3, 0.4, 50)
    exact = np.array([1j * w * F[:, 0] @ np.linalg.solve(
        (K + (0.01j * w - w**2) * light).toarray(), F[:, 0]) for w in omega])  # fmt: skip
    assert np.abs(small(1j * omega) - exact).max() <= small.error_bound < 0.2 * np.abs(exact).max()


def test_the_response_is_that_of_the_matrices():
    omega = np.array([0.1, 0.35, 2.0])
    structure = phc.SecondOrderSystem(M, K, ports(2), C=DAMPINGS["some dashpots"], sensors=SENSORS)
    exact = dense_response(DAMPINGS["some dashpots"], ports(2), SENSORS, omega)
    np.testing.assert_allclose(structure(1j * omega), exact, rtol=0, atol=1e-12 * np.abs(exact).max())
    np.testing.assert_allclose(structure(0.35j), exact[:, :, 1], rtol=0, atol=1e-12 * np.abs(exact).max())
    single = phc.SecondOrderSystem(M, K, ports(1))
    assert np.ndim(single(0.1j)) == 0 and single(1j * omega).shape == (3,)
    assert repr(structure) == "<SecondOrderSystem: 324 degrees of freedom, 2 ports, 3 sensors>"


@pytest.mark.variants
@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_units_do_not_matter(unit):
    C, F = DAMPINGS["one dashpot"], ports(1)
    usual = phc.reduce(phc.SecondOrderSystem(M, K, F, C=C), 12, band=(0.0, 0.5))
    other = phc.reduce(phc.SecondOrderSystem(M, K * unit**2, F, C=C * unit), 12, band=(0.0, 0.5 * unit))
    assert other.error_bound == pytest.approx(usual.error_bound / unit, rel=1e-5)


def test_what_it_refuses():
    structure = phc.SecondOrderSystem(M, K, ports(1), C=0.01 * K)
    with pytest.raises(phc.StructureError, match="tolerance is not for a large structure"):
        phc.reduce(structure, tolerance=0.1)
    with pytest.raises(phc.StructureError, match="give the order"):
        phc.reduce(structure, band=(0.0, 0.5), method="balanced")
    with pytest.raises(phc.StructureError, match="lossless"):
        phc.reduce(phc.SecondOrderSystem(M, K, ports(1)), 8, method="h2")
    with pytest.raises(phc.UnknownKeywordError, match="gyroscopic"):
        phc.SecondOrderSystem(M, K, ports(1), G=K)
    with pytest.raises(phc.StructureError, match="symmetric"):
        phc.SecondOrderSystem(M, sparse.triu(K), ports(1))
    with pytest.raises(phc.StructureError, match="is a pole"):
        phc.SecondOrderSystem(np.eye(2), np.diag([1.0, 0.0]), [1.0, 1.0])(0.0)
