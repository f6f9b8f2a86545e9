"""A few modes of sparse structures: those of dense matrices, none missed, and the right static response."""

import copy
import pickle

import numpy as np
import pytest
from scipy import sparse
from scipy.io import mmread
from scipy.linalg import eigh
from scipy.sparse.linalg import eigsh

import ph_control as phc
from ph_control import from_second_order

RESIDUAL = 1e-9


def membrane(side, other=None, free=False):
    """Unit masses with springs to their neighbours: repeated natural frequencies where both sides are the same."""
    K = sparse.csc_array((1, 1))
    for n in (side, other or side):
        row = (2.0 * sparse.eye_array(n) - sparse.eye_array(n, k=1) - sparse.eye_array(n, k=-1)).tolil()
        if free:
            row[0, 0] = row[n - 1, n - 1] = 1.0
        K = sparse.kronsum(K, row, format="csc")
    return sparse.eye_array(K.shape[0], format="csc"), K


def exact(side, free=False):
    """Natural frequencies of the square membrane, in ascending order."""
    j = np.arange(side) if free else np.arange(1, side + 1)
    one = 2 - 2 * np.cos(np.pi * j / (side if free else side + 1))
    return np.sqrt(np.sort((one[:, None] + one).ravel()))


def at(n, *places):
    """Unit forces at degrees of freedom."""
    F = np.zeros((n, len(places)))
    F[places, np.arange(len(places))] = 1.0
    return F


def structures(folder):
    """Matrices M, K of finite-element models."""
    nastran, wing = (np.load(folder / f"structures/{name}.npz") for name in ("nas2cam_k0", "wingbeam75"))
    read = {
        name: [sparse.csc_array(mmread(folder / f"structures/{file}.mtx")) for file in files]
        for name, files in {
            "lund": ("lund_mass", "lund_stiffness"),
            "bcsst02": ("bcsstm02", "bcsstk02"),
            "bcsst01": ("bcsstm01", "bcsstk01"),
        }.items()
    }
    return read | {"nas2cam": [nastran["M"], nastran["K"]], "wingbeam": [wing["M"], wing["K"]]}


# --- real structures -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["lund", "bcsst02", "bcsst01", "nas2cam", "wingbeam"])
@pytest.mark.parametrize("modes", [4, 10, 20])
def test_modes_of_real_structures_are_those_of_dense_matrices(data_folder, name, modes):
    M, K = (sparse.csc_array(matrix) for matrix in structures(data_folder)[name])
    places = np.flatnonzero(M.diagonal())[[1, -1]]
    F = at(M.shape[0], *places)
    all_modes = from_second_order(M.toarray(), K.toarray(), F, condense=True)
    few = from_second_order(M, K, F, modes=modes, condense=True)
    kept = few.structural_modes
    d = np.concatenate([np.zeros(all_modes.rigid_modes), all_modes.d])
    count = len(kept.natural_frequencies)
    assert count >= modes
    assert kept.count == count
    assert kept.is_complete
    assert kept.residuals.max() < RESIDUAL
    np.testing.assert_allclose(kept.natural_frequencies, d[:count], rtol=1e-9)
    assert few.rigid_modes == all_modes.rigid_modes
    elastic = np.flatnonzero(kept.natural_frequencies)
    if not len(elastic):
        return
    kappa = ((kept.shapes.T @ F) ** 2)[elastic]
    other = (np.abs(all_modes.modes.nu) ** 2 * all_modes.d[:, None])[: len(elastic)]
    np.testing.assert_allclose(kappa, other, atol=1e-8 * other.max())
    s = 1e-4j * d[d > 0][0]
    np.testing.assert_allclose(few(s), all_modes(s), rtol=1e-8, atol=1e-8 * np.abs(all_modes(s)).max())


# --- completeness ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("modes", [1, 2, 5, 9, 16])
def test_repeated_modes_are_complete(modes):
    M, K = membrane(25)
    kept = from_second_order(M, K, at(625, 40), modes=modes).structural_modes
    d = exact(25)
    count = len(kept.natural_frequencies)
    last = np.searchsorted(d, d[modes - 1] * (1 + 1e-9))
    assert count == last == kept.count
    assert kept.is_complete
    np.testing.assert_allclose(kept.natural_frequencies, d[:count], rtol=1e-12)
    np.testing.assert_allclose(kept.shapes.T @ kept.shapes, np.eye(count), atol=1e-12)


def test_many_copies_of_one_structure_keep_all_of_their_modes():
    M, K = membrane(12)
    copies = 7
    whole, mass = (sparse.block_diag([matrix] * copies, format="csc") for matrix in (K, M))
    kept = from_second_order(mass, whole, at(copies * 144, 5), modes=8).structural_modes
    np.testing.assert_allclose(kept.natural_frequencies, np.repeat(exact(12)[:3], copies), rtol=1e-10)
    assert kept.count == 21


@pytest.mark.parametrize(("low", "high"), [(0.0, 0.6), (0.5, 0.8), (1.0, 1.1), (2.7, 3.0)])
def test_a_band_has_all_its_modes_and_no_other(low, high):
    M, K = membrane(25, 25)
    kept = from_second_order(M, K, at(625, 40), band=(low, high), residual_modes=False).structural_modes
    d = exact(25)
    np.testing.assert_allclose(kept.natural_frequencies, d[(d >= low) & (d <= high)], rtol=1e-11)
    assert kept.count == len(kept.natural_frequencies)
    assert kept.is_complete


def test_a_band_without_modes_is_refused_unless_residual_modes_make_a_system():
    M, K = membrane(25)
    with pytest.raises(phc.StructureError, match="no natural frequency"):
        from_second_order(M, K, at(625, 40), band=(0.0, 0.1), residual_modes=False)
    static = from_second_order(M, K, at(625, 40), band=(0.0, 0.1), sensors=at(625, 40).T)
    assert static.n == 1
    np.testing.assert_allclose(static(0.0)[1], np.linalg.inv(K.toarray())[40, 40], rtol=1e-12)


@pytest.mark.slow
def test_rigid_modes_are_found_and_kept():
    M, K = membrane(18, free=True)
    pieces, mass = (sparse.block_diag([matrix] * 2, format="csc") for matrix in (K, M))
    sys = from_second_order(mass, pieces, at(648, 40, 400), modes=7)
    assert sys.rigid_modes == 2
    d = exact(18, free=True)
    np.testing.assert_allclose(sys.structural_modes.natural_frequencies, np.repeat(d[:4], 2)[:8], rtol=1e-11)
    # in a band above them, for the static response
    banded = from_second_order(mass, pieces, at(648, 40, 400), band=(0.3, 0.45))
    assert banded.rigid_modes == 2
    dense = from_second_order(mass.toarray(), pieces.toarray(), at(648, 40, 400))
    s = 1e-3j
    for one in (sys, banded):
        np.testing.assert_allclose(one(s), dense(s), rtol=1e-7, atol=1e-9 * np.abs(dense(s)).max())
        compliance = (one(s) - dense(s)) / s  # beside the rigid part
        assert np.abs(compliance).max() < 1e-5 * np.abs(np.linalg.pinv(K.toarray())).max()


# --- static response -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("damped", [False, True])
@pytest.mark.parametrize("chosen", [{"modes": 6}, {"band": (0.0, 0.5)}, {"band": (0.4, 0.6)}], ids=str)
def test_residual_modes_make_the_static_response_right(chosen, damped):
    M, K = membrane(20, 23)
    n = K.shape[0]
    F = at(n, 40, 41, 200)
    rows = np.vstack([F.T, at(n, 3, 300).T])
    dampers = 0.01 * sparse.diags_array(np.arange(n) % 3 * 1.0, format="csc") if damped else None
    flexibility = np.linalg.inv(K.toarray())
    with_, without = (
        from_second_order(M, K, F, C=dampers, sensors=rows, residual_modes=flag, **chosen) for flag in (True, False)
    )
    assert with_.n == without.n + 3
    exact_response = rows @ flexibility @ F
    np.testing.assert_allclose(with_(0.0)[3:].real, exact_response, rtol=1e-10)
    assert np.abs(without(0.0)[3:] - exact_response).max() > 1e-2 * np.abs(exact_response).max()
    # and at the ports its slope: -K^{-1} C K^{-1}
    s = 1e-4
    drag = np.zeros((3, 3)) if dampers is None else -F.T @ flexibility @ dampers @ flexibility @ F
    slope = (with_(s)[3:6] - with_(-s)[3:6]) / (2 * s)
    np.testing.assert_allclose(slope.real, drag, atol=1e-7 * np.abs(exact_response).max())
    assert with_.poles().real.max() < 1e-12


def test_residual_modes_of_one_force_at_two_ports_are_one():
    M, K = membrane(15, 17)
    F = np.repeat(at(255, 40), 2, axis=1) * [1.0, -3.0]
    assert from_second_order(M, K, F, modes=3).n == 4


def test_all_modes_leave_no_residual_mode():
    M, K = membrane(3, 4)
    few, dense = from_second_order(M, K, at(12, 2), modes=12), from_second_order(M.toarray(), K.toarray(), at(12, 2))
    assert few.n == 12
    np.testing.assert_allclose(few.d, dense.d, rtol=1e-13)
    np.testing.assert_allclose(few(0.3j), dense(0.3j), rtol=1e-12)


# --- damping and sensors ---------------------------------------------------------------------------------------------


def test_proportional_damping_is_that_of_each_mode():
    M, K = membrane(20, 21)
    sys = from_second_order(M, K, at(420, 7), C=0.01 * M + 0.002 * K, modes=9)
    d = np.concatenate([sys.structural_modes.natural_frequencies, sys.structural_modes.residual_frequencies])
    np.testing.assert_allclose(sys.R, np.diag(np.concatenate([np.zeros(10), 0.01 + 0.002 * d**2])), rtol=1e-10)
    assert np.count_nonzero(sys.R) == 10
    np.testing.assert_allclose(np.sort(sys.natural_frequencies), np.sort(d), rtol=1e-10)


def test_sensors_and_general_damping_are_those_of_the_full_structure_where_its_modes_are_kept():
    M, K = membrane(6, 7)
    n = 42
    C = 0.05 * sparse.diags_array((np.arange(n) == 9) * 1.0, format="csc")
    rows = {kind: at(n, place).T for kind, place in (("position", 3), ("velocity", 5), ("acceleration", 11))}
    F = at(n, 9, 30)
    dense = from_second_order(M.toarray(), K.toarray(), F, C=C.toarray(), sensors=rows)
    every = {kind: sparse.csr_array(values) for kind, values in rows.items()}
    few = from_second_order(M, K, sparse.csc_array(F), C=C, sensors=every, modes=n)
    assert few.output_labels == dense.output_labels
    s = 1j * np.array([0.2, 0.9, 2.5])
    np.testing.assert_allclose(few(s), dense(s), rtol=1e-9, atol=1e-11)


def test_dense_matrices_and_sparse_ones_give_the_same():
    M, K = membrane(9, 11)
    one, other = (
        from_second_order(*matrices, at(99, 7), modes=5, name="plate")
        for matrices in ((M, K), (M.toarray(), K.toarray()))
    )
    np.testing.assert_array_equal(one.Q, other.Q)
    np.testing.assert_array_equal(one.B, other.B)
    assert one.state_labels[0] == "q_mode_1"
    assert isinstance(one, phc.PortHamiltonian)
    assert from_second_order(M.toarray(), K.toarray(), at(99, 7)).structural_modes is None


def test_the_shapes_take_the_states_to_all_degrees_of_freedom():
    M, K = membrane(9, 11)
    sys = from_second_order(M, K, at(99, 7), modes=5, C=0.1 * M)
    basis = np.hstack([sys.structural_modes.shapes, sys.structural_modes.residual_shapes])
    np.testing.assert_allclose(basis.T @ M @ basis, np.eye(6), atol=1e-12)
    q = np.linalg.solve(sys.A, -sys.B)[:6]
    np.testing.assert_allclose((basis @ q)[:, 0], np.linalg.inv(K.toarray())[:, 7], rtol=1e-10)


@pytest.mark.parametrize("damped", [False, True])
def test_copies_and_pickles_keep_the_shapes(damped):
    M, K = membrane(9, 11)
    sys = from_second_order(M, K, at(99, 7), modes=3, C=0.1 * M if damped else None)
    for other in (copy.deepcopy(sys), pickle.loads(pickle.dumps(sys))):
        kept = other.structural_modes
        assert kept is not sys.structural_modes
        assert kept.is_complete
        np.testing.assert_array_equal(kept.shapes, sys.structural_modes.shapes)
        np.testing.assert_array_equal(other.Q, sys.Q)


def test_the_size_of_time_and_mass_does_not_matter():
    M, K = membrane(14, 15, free=True)
    plain = from_second_order(M, K, at(210, 7), modes=6)
    for mass, stiffness in ((1e-6, 1e9), (1e8, 1e-3)):
        scaled = from_second_order(mass * M, stiffness * K, at(210, 7), modes=6)
        assert scaled.rigid_modes == plain.rigid_modes == 1
        np.testing.assert_allclose(scaled.d, plain.d * np.sqrt(stiffness / mass), rtol=1e-10)


def test_reduced_parts_joined_at_their_ports_have_the_modes_of_the_whole():
    def chain(n, tied):
        K = (2.0 * sparse.eye_array(n) - sparse.eye_array(n, k=1) - sparse.eye_array(n, k=-1)).tolil()
        K[0, 0], K[n - 1, n - 1] = 1.0 + tied, 1.0
        return sparse.eye_array(n, format="csc"), K.tocsc()

    n = 120
    parts = [chain(n, 1.0), chain(n + 20, 0.0)]
    both = sparse.block_diag([K for _, K in parts]).toarray()
    joined = np.delete(np.eye(2 * n + 20), n, axis=1)  # end and beginning move together
    joined[n, n - 1] = 1.0
    whole = np.sqrt(eigh(joined.T @ both @ joined, joined.T @ joined, eigvals_only=True))
    errors = {}
    for residual in (True, False):
        first = from_second_order(*parts[0], at(n, n - 1), modes=12, residual_modes=residual)
        second = from_second_order(*parts[1], at(n + 20, 0), modes=12, residual_modes=residual)
        d = phc.couple(first, second).natural_frequencies
        d = np.sort(d[d > 1e-6])[:8]
        errors[residual] = np.abs(d / whole[:8] - 1).max()
    assert errors[True] < 1e-4
    assert errors[False] > 20 * errors[True]


# --- another eigensolver ---------------------------------------------------------------------------------------------


def test_an_eigensolver_takes_the_place_of_arpack():
    M, K = membrane(13, 16)
    calls = []

    def solver(K, M, k, sigma):
        calls.append((k, sigma))
        squares, shapes = eigh(K.toarray(), M.toarray())
        nearest = np.argsort(np.abs(squares - sigma))[:k]
        return squares[nearest], 3.0 * shapes[:, nearest]  # of any length

    ours = from_second_order(M, K, at(208, 7), modes=6)
    theirs = from_second_order(M, K, at(208, 7), modes=6, eigensolver=solver)
    assert len(calls) == 1
    assert calls[0][0] >= 6
    assert calls[0][1] < 0
    np.testing.assert_allclose(theirs.d, ours.d, rtol=1e-11)
    np.testing.assert_allclose(theirs(0.1j), ours(0.1j), rtol=1e-9)


def test_a_mode_that_an_eigensolver_misses_is_noticed():
    M, K = membrane(13, 16)

    def blind(K, M, k, sigma):
        squares, shapes = eigsh(K, k + 1, M=M, sigma=sigma)
        return np.delete(squares, 2), np.delete(shapes, 2, axis=1)

    with pytest.raises(phc.StructureError, match="inertia"):
        from_second_order(M, K, at(208, 7), modes=6, eigensolver=blind)


def test_inaccurate_shapes_of_an_eigensolver_are_refused():
    M, K = membrane(13, 16)

    def rough(K, M, k, sigma):
        squares, shapes = eigsh(K, k, M=M, sigma=sigma)
        return squares, shapes + 1e-5 * np.random.default_rng(0).standard_normal(shapes.shape)

    with pytest.raises(phc.StructureError, match="does not meet its equation"):
        from_second_order(M, K, at(208, 7), modes=6, eigensolver=rough)


@pytest.mark.parametrize("answer", [None, (np.ones(2), np.ones((208, 2))), (np.ones(7), np.ones((7, 208)))], ids=str)
def test_what_is_no_answer_of_an_eigensolver_is_refused(answer):
    M, K = membrane(13, 16)
    with pytest.raises(phc.StructureError, match="eigensolver returned"):
        from_second_order(M, K, at(208, 7), modes=6, eigensolver=lambda *given: answer)


# --- refusals --------------------------------------------------------------------------------------------------------

M9, K9 = membrane(9, 11)
HEAVY = sparse.diags_array([0.0] * 3 + [1.0] * 96, format="csc")


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({}, "modes="),
        ({"modes": 0}, "modes is 0"),
        ({"modes": 100}, "modes is 100"),
        ({"modes": 2.0}, "modes is 2.0"),
        ({"modes": 3, "band": (0, 1)}, "both"),
        ({"band": (1, 0)}, "band"),
        ({"band": (0, 1, 2)}, "band"),
        ({"band": (-1, 1)}, "band"),
        ({"eigensolver": print}, "needs modes="),
        ({"modes": 3, "eigensolver": "arpack"}, "must be a function"),
        ({"modes": 3, "residual_modes": "yes"}, "residual_modes"),
        ({"modes": 3, "K": sparse.triu(K9, format="csc")}, "one triangle"),
        ({"modes": 3, "K": K9[:98, :98]}, "shape"),
        ({"modes": 3, "K": K9 * 1j}, "complex"),
        ({"modes": 3, "K": K9 * np.nan}, "not finite"),
        ({"modes": 3, "K": -K9}, "indefinite"),
        ({"modes": 3, "K": K9 - 0.5 * M9}, "indefinite"),
        ({"modes": 3, "M": -M9}, "indefinite"),
        ({"modes": 3, "M": 0 * M9}, "M is zero"),
        ({"modes": 3, "M": HEAVY}, "condense=True"),
        ({"modes": 3, "M": HEAVY, "condense": True, "F": at(99, 1)}, "a force acts"),
        ({"modes": 3, "M": HEAVY, "condense": True, "C": 0.1 * M9}, "dampers act"),
        ({"modes": 3, "C": -0.1 * M9}, "C on the modes has a negative eigenvalue"),
        ({"modes": 3, "F": np.ones(98)}, "F has shape"),
        ({"modes": 3, "sensors": np.ones(98)}, "sensors"),
        ({"modes": 3, "rtol": -1}, "rtol"),
    ],
    ids=lambda value: value if isinstance(value, str) else ",".join(value),
)
def test_what_makes_no_system_is_refused(change, text):
    with pytest.raises(phc.StructureError, match=text):
        from_second_order(**({"M": M9, "K": K9, "F": at(99, 7)} | change))


def test_a_band_that_ends_at_a_natural_frequency_is_not_certain():
    M, K = membrane(9, 9)
    edge = 2.0  # of the modes j + k = 10, exactly representable
    assert np.isclose(exact(9), edge).sum() == 9
    with pytest.warns(phc.ConditioningWarning, match="not certain"):
        kept = from_second_order(M, K, at(81, 7), band=(0.0, edge)).structural_modes
    assert not kept.is_complete
    # a little further all is well
    assert from_second_order(M, K, at(81, 7), band=(0.0, edge + 1e-6)).structural_modes.is_complete


def test_matrices_of_the_user_are_not_changed():
    M, K = membrane(9, 11)
    held = [matrix.copy() for matrix in (M, K)]
    from_second_order(M, K, at(99, 7), modes=3, C=0.1 * K)
    assert all(abs(one - other).max() == 0 for one, other in zip((M, K), held, strict=True))
