"""Modes as poles and residues, against mpmath, exact fractions and dense matrices."""

import copy
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import (
    EPS,
    dense_matrices,
    dense_transfer_function,
    foster_zeros,
    largest_error,
    on_axis,
    random_hamiltonian,
)
from scipy.linalg import eigvals

import ph_control as phc
from ph_control import ModalForm

relaxed = settings(deadline=None, max_examples=13, derandomize=True)
seeds = st.integers(0, 2**32 - 1)

SPECTRA = {
    "one": [1.7],
    "regular": np.linspace(1, 10, 8),
    "a hundred": np.linspace(1, 100, 100),
    "spread over 1e12": np.logspace(-6, 6, 100),
    "clustered to 1e-6": 1 + 1e-6 * np.random.default_rng(0).random(20),
    "repeated": np.repeat([1.0, 2.0, 3.0], 3),
}


def weights(n, seed=1):
    """Positive weights over four decades."""
    return 10 ** np.random.default_rng(seed).uniform(-3, 1, n)


def frequencies_to_try(modes):
    """Next to poles, on and next to zeros (a dozen of each, evenly chosen), and far away."""
    d, zeros = modes.d, modes.zeros.imag
    zeros = zeros[(zeros > 0) & ~np.isin(zeros, d)]
    zeros, d = zeros[:: len(zeros) // 12 + 1], d[:: len(d) // 12 + 1]
    near = [d * (1 + side * gap) for gap in (1e-12, 1e-9, 1e-3) for side in (1, -1)]
    on_zeros = [zeros, zeros * (1 + EPS), zeros * (1 - 1e-13), zeros * (1 + 1e-6)]
    far = np.logspace(-4, 4, 9) * np.exp(np.mean(np.log(d)))
    w = np.concatenate([*near, *on_zeros, far])
    return w[~np.isin(w, modes.d)]


# --- frequency response --------------------------------------------------------------------------------------------


@pytest.mark.variants
@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("name", SPECTRA)
def test_the_frequency_response_is_right_to_1e_13_next_to_poles_and_zeros(name, scale):
    d = scale * np.sort(SPECTRA[name])
    r = weights(len(d))
    if len(d) > 3:
        r[::4] = 0.0
    modes = phc.modes(d, r)
    w = frequencies_to_try(modes)
    got = modes.freqresp(w)
    assert np.all(got.real == 0)
    assert largest_error(got.imag, on_axis(d, r, w)) < 1e-13


def test_the_frequency_response_is_right_at_a_distance_of_1e_12_from_a_pole():
    d, r = [1.0, 3.0], [1.0, 2.0]
    w = np.array([1 - 1e-12, 1 + 1e-12, 3 - 3e-12, 3 + 3e-12])
    got = phc.modes(d, r).freqresp(w).imag
    assert np.all(np.abs(got) > 1e10)
    assert largest_error(got, on_axis(d, r, w)) < 10 * EPS


def test_a_transmission_zero_keeps_the_digits_that_cancel():
    d, r = np.array([1.0, 2.0]), np.array([1.0, 1.0])
    w = np.sqrt(2.0) * (1 + EPS * np.arange(-3, 4))
    got = phc.modes(d, r).freqresp(w).imag
    # far below the rounding of the two terms that cancel there, each of size sqrt(2)
    assert np.min(np.abs(got)) < 4 * EPS
    assert largest_error(got, on_axis(d, r, w)) < 4 * EPS


def test_the_frequency_response_with_a_rigid_body_mode_is_right_at_its_zeros_too():
    modes = ModalForm(np.array([1.0, 2.0]), np.array([[1.0 + 0j], [0.5]]), np.array([[2.0], [1.0]]))
    assert modes.kappa_0 == 5.0
    w = np.concatenate([frequencies_to_try(modes), [1e-12]])
    got = modes.freqresp(w).imag
    assert largest_error(got, on_axis([1, 2], modes.r, w, 5.0)) < 1e-13


@pytest.mark.parametrize("scale", [1e-200, 1e200])
def test_extreme_units_of_time_neither_overflow_nor_look_like_poles(scale):
    modes = phc.modes([scale, 2 * scale], [1.0, 1.0])
    plain = phc.modes([1.0, 2.0], [1.0, 1.0])
    w = np.array([0.1, 0.9, 1.1, 1.5, 30.0])
    assert np.max(np.abs(modes.freqresp(scale * w) / plain.freqresp(w) - 1)) < 32 * EPS
    assert np.max(np.abs(modes.evaluate(scale * (w + 1j)) / plain.evaluate(w + 1j) - 1)) < 32 * EPS
    assert np.max(np.abs(modes.zeros - scale * plain.zeros)) <= 4 * EPS * scale


def test_a_pole_gives_infinity_and_infinity_gives_zero_and_nothing_gives_nan():
    modes = ModalForm(np.array([1.0, 2.0, 3.0]), np.array([[1.0 + 0j], [0.0], [1.0]]), np.array([[1.0]]))
    got = modes.freqresp([0.0, 1.0, -1.0, 3.0, 2.0])
    assert np.array_equal(np.isinf(got), [True, True, True, True, False])
    assert not np.isnan(got.real).any()
    assert not np.isnan(got.imag).any()
    everywhere = modes.evaluate([1j, 0, 1 + 1j, complex(np.inf, 0), complex(0, np.inf), complex(0, -np.inf)])[0, 0]
    assert np.array_equal(np.isinf(everywhere), [True, True, False, False, False, False])
    # the products that Python makes of infinity and i have one part that is NaN
    assert np.array_equal(modes.evaluate([1j * np.inf, -1j * np.inf])[0, 0], [0, 0])
    assert np.all(everywhere[3:] == 0)


def test_a_point_on_the_axis_does_not_depend_on_the_points_beside_it():
    modes = phc.modes([1.0, 2.0], [1.0, 1.0])
    w = np.sqrt(2.0)
    together = modes.evaluate([1j * w, 1 + 1j, -1.0])[0, 0]
    assert abs(together[0] / modes.evaluate([1j * w])[0, 0, 0] - 1) < 8 * EPS
    assert together[1] == modes.evaluate([1 + 1j])[0, 0, 0]
    assert together[2] == modes.evaluate([-1.0])[0, 0, 0]


def test_the_transfer_function_is_odd_and_positive_real():
    modes = phc.modes([1.0, 2.0, 5.0], [1.0, 3.0, 0.5])
    rng = np.random.default_rng(0)
    s = rng.uniform(0.01, 5, 50) + 1j * rng.uniform(-6, 6, 50)
    here = modes.evaluate(s)[0, 0]
    allowed = 32 * EPS * np.max(np.abs(here))
    assert np.max(np.abs(modes.evaluate(-s)[0, 0] + here)) < allowed
    assert np.max(np.abs(modes.evaluate(s.conj())[0, 0] - here.conj())) < allowed
    assert np.all(here.real > 0)


@relaxed
@given(st.integers(1, 6), st.integers(1, 3), seeds, st.booleans())
def test_any_number_of_ports_agrees_with_dense_matrices(n, ports, seed, free):
    rng = np.random.default_rng(seed)
    d = rng.uniform(0.5, 3, n)
    Q, S = random_hamiltonian(d, rng, 0.5)
    if free:
        D = np.r_[d, d]
        D[0] = 0.0
        Q = S.T @ np.diag(D) @ S
        Q = 0.5 * (Q + Q.T)
    B = rng.standard_normal((2 * n, ports))
    modes = phc.ph(Q, B).modes
    assert (len(modes.d), len(modes.rigid)) == (n - free, int(free))
    A, B, C = dense_matrices(Q, B)
    s = np.concatenate([rng.uniform(-2, 2, 4) + 1j * rng.uniform(-2, 2, 4), 1j * rng.uniform(3.5, 5, 3)])
    got = modes.evaluate(s)
    for k, point in enumerate(s):
        truth = dense_transfer_function(A, B, C, point)
        condition = np.linalg.cond(point * np.eye(2 * n) - A)
        size = np.linalg.norm(B) * np.linalg.norm(C) * np.linalg.norm(np.linalg.inv(point * np.eye(2 * n) - A), 2)
        assert np.max(np.abs(got[:, :, k] - truth)) < 200 * n * EPS * condition * size


def test_the_frequency_response_has_the_shape_of_its_frequencies():
    one = phc.modes([1.0], [1.0])
    assert one.freqresp(0.5).shape == ()
    assert one.freqresp(np.ones((2, 3)) / 2).shape == (2, 3)
    assert one.freqresp([]).shape == (0,)
    two = phc.ph(np.eye(2), np.eye(2)).modes
    assert two.freqresp([0.5, 0.6, 0.7]).shape == (2, 2, 3)
    assert two.freqresp(0.5).shape == (2, 2, 1)
    with pytest.raises(phc.StructureError, match="for several ports it must be a vector"):
        two.freqresp(np.ones((2, 2)) / 2)


def test_long_vectors_of_points_are_cut_into_parts_that_fit_together(monkeypatch):
    modes = phc.modes(np.linspace(1, 2, 7), np.ones(7))
    w = np.linspace(0.1, 4, 101)
    on_axis, off_axis = modes.freqresp(w), modes.evaluate(1j * w + 0.1)
    monkeypatch.setattr("ph_control.modal.modal_form._CHUNK", 70)
    monkeypatch.setattr("ph_control.modal.reactance._BLOCK", 70)
    # products of matrices of another shape may add up in another order
    assert np.max(np.abs(modes.freqresp(w) / on_axis - 1)) < 64 * EPS
    assert np.max(np.abs(modes.evaluate(1j * w + 0.1) / off_axis - 1)) < 64 * EPS


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1j, "fast", None])
def test_frequencies_that_are_no_real_numbers_are_refused(bad):
    with pytest.raises(phc.StructureError, match="omega"):
        phc.modes([1.0], [1.0]).freqresp([0.5, bad])


@pytest.mark.parametrize("bad", [np.nan, complex(0, np.nan), "here", [[1j, 2j]], None])
def test_points_that_are_no_vector_of_numbers_are_refused(bad):
    with pytest.raises(phc.StructureError, match="the points"):
        phc.modes([1.0], [1.0]).evaluate([1j, bad] if np.ndim(bad) == 0 else bad)


# --- zeros ---------------------------------------------------------------------------------------------------------


@pytest.mark.variants
@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("name", ["one", "regular", "spread over 1e12", "clustered to 1e-6"])
def test_zeros_interlace_with_poles_and_are_right_to_the_last_digits(name, scale):
    d = scale * np.sort(SPECTRA[name])[:30]
    modes = phc.modes(d, weights(len(d)))
    w = modes.zeros.imag
    assert np.all(modes.zeros.real == 0)
    assert len(w) == 2 * len(d) - 1
    assert np.array_equal(w, -w[::-1])
    positive = w[len(d) :]
    assert np.all((positive > d[:-1]) & (positive < d[1:]))
    assert largest_error(positive, foster_zeros(d, modes.kappa)) < 8 * EPS


@relaxed
@given(st.integers(2, 8), seeds)
def test_zeros_interlace_however_small_or_large_the_residues_are(n, seed):
    rng = np.random.default_rng(seed)
    d = np.sort(rng.uniform(1, 2, n))
    modes = phc.modes(d, 10 ** rng.uniform(-30, 30, n))
    positive = modes.zeros.imag[n:]
    assert np.all((positive >= d[:-1]) & (positive <= d[1:]))
    assert largest_error(positive, foster_zeros(d, modes.kappa)) < 8 * EPS


def test_zeros_between_neighbouring_doubles_stay_between_them():
    d = np.array([1.0, np.nextafter(1.0, 2.0)])
    assert phc.modes(d, [1.0, 1.0]).zeros.imag[-1] in d


def test_the_pole_at_zero_takes_the_zero_from_there():
    modes = ModalForm(np.array([1.0, 2.0]), np.array([[1.0 + 0j], [1.0]]), np.array([[0.3]]))
    w = modes.zeros.imag
    assert len(w) == 4
    assert largest_error(w[2:], foster_zeros(modes.d, modes.kappa, modes.kappa_0)) < 8 * EPS
    assert np.all((w[2:] > [0, 1]) & (w[2:] < [1, 2]))


def test_modes_that_cannot_be_seen_are_cancelled_by_a_zero_each():
    assert np.array_equal(phc.modes([1.0, 2.0, 3.0], [1.0, 0.0, 0.0]).zeros.imag, [-3, -2, 0, 2, 3])
    assert np.array_equal(phc.modes([2.0, 2.0, 2.0], [1.0, 1.0, 0.0]).zeros.imag, [-2, -2, 0, 2, 2])
    assert np.array_equal(phc.modes([1.0, 2.0], [0.0, 0.0]).zeros.imag, [-2, -1, 1, 2])


@relaxed
@given(st.integers(1, 4), st.integers(2, 3), seeds, st.booleans())
def test_the_zeros_of_several_ports_are_those_of_the_dense_system_matrix(n, ports, seed, free):
    rng = np.random.default_rng(seed)
    n += ports
    Q, _ = random_hamiltonian(rng.uniform(0.5, 3, n), rng, 0.5)
    rigid = np.zeros((0, ports))
    modes = phc.ph(Q, rng.standard_normal((2 * n, ports))).modes
    if free:
        rigid = rng.standard_normal((1, ports))
    modes = ModalForm(modes.d, modes.nu, rigid)
    eta = np.sqrt(modes.d)[:, None] * modes.nu
    size = 2 * n + len(rigid)
    A = np.zeros((size, size))
    A[:n, n : 2 * n], A[n : 2 * n, :n] = np.diag(modes.d), -np.diag(modes.d)
    B = np.concatenate([eta.real, eta.imag, rigid])
    left = np.block([[A, B], [B.T, np.zeros((ports, ports))]])
    right = np.zeros_like(left)
    right[:size, :size] = np.eye(size)
    truth = eigvals(left, right)
    truth = truth[np.isfinite(truth) & (np.abs(truth) < 1e6)]
    assert len(modes.zeros) == size - ports
    assert np.all(modes.zeros.real == 0)
    # the pencil has defective infinite eigenvalues, which cost the dense reference half of its digits
    assert np.max(np.abs(np.sort(truth.imag) - modes.zeros.imag)) < 100 * np.sqrt(EPS)
    worst = max(np.linalg.svd(left - z * right, compute_uv=False)[-1] for z in modes.zeros)
    assert worst < 100 * size * EPS * np.linalg.norm(left)


# --- the minimal form ----------------------------------------------------------------------------------------------


def test_the_minimal_form_merges_equal_frequencies_and_drops_unreached_modes():
    modes = phc.modes([3.0, 1.0, 1.0, 2.0], [0.0, 0.25, 0.5, 1.0])
    assert not modes.is_minimal
    minimal = modes.minimal()
    assert minimal.is_minimal
    assert np.array_equal(minimal.d, [1, 2])
    assert np.array_equal(minimal.r, [0.75, 1])
    w = np.array([0.1, 0.9, 1.3, 2.9, 5.0])
    assert np.max(np.abs(minimal.freqresp(w) / modes.freqresp(w) - 1)) < 16 * EPS


def test_the_tolerance_of_the_minimal_form_is_relative_and_has_two_sides():
    for scale in (1e-9, 1.0, 1e9):
        close = phc.modes(scale * np.array([1.0, 1 + 1e-6]), [1.0, 1.0])
        assert close.is_minimal
        assert close.minimal(rtol=2e-6).n == 1
        assert close.minimal(rtol=0.5e-6).n == 2
        weak = phc.modes(scale * np.array([1.0, 2.0]), [1.0, 1e-9])
        assert weak.minimal(rtol=4e-9).n == 1
        assert weak.minimal(rtol=1e-9).n == 2
    for wrong in (-1e-9, 1.0, np.nan):
        with pytest.raises(phc.StructureError, match="rtol is"):
            phc.modes([1.0], [1.0]).minimal(rtol=wrong)
    bound = 8 * 2 * EPS
    assert not phc.modes([1.0, 1 + 0.5 * bound], [1.0, 1.0]).is_minimal
    assert phc.modes([1.0, 1 + 2 * bound], [1.0, 1.0]).is_minimal


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_with_a_port_at_each_mass_all_zeros_are_exactly_zero(scale):
    frame = phc.from_second_order(np.diag([1.0, 2.0]), scale**2 * np.array([[5.0, -4.0], [-4.0, 5.0]]), np.eye(2))
    np.testing.assert_array_equal(frame.modes.zeros, [0.0, 0.0])


def test_with_several_ports_a_frequency_stays_as_often_as_its_residue_has_rank():
    rng = np.random.default_rng(0)
    nu = rng.standard_normal((5, 2)) + 1j * rng.standard_normal((5, 2))
    modes = ModalForm(np.array([1.0, 1.0, 1.0, 2.0, 3.0]), nu, rng.standard_normal((3, 2)))
    minimal = modes.minimal()
    assert np.array_equal(minimal.d, [1, 1, 2, 3])
    assert len(minimal.rigid) == 2
    s = rng.standard_normal(5) + 1j * rng.standard_normal(5)
    assert np.max(np.abs(minimal.evaluate(s) - modes.evaluate(s))) < 100 * EPS * np.max(np.abs(modes.evaluate(s)))
    assert minimal.is_minimal


# --- the object ----------------------------------------------------------------------------------------------------


def test_modes_are_sorted_and_their_weights_go_with_them():
    modes = phc.modes([3, 1, 2], [30, 10, 20])
    assert np.array_equal(modes.d, [1, 2, 3])
    assert np.array_equal(modes.r, [10, 20, 30])
    assert np.array_equal(modes.kappa, [10, 40, 90])
    assert np.array_equal(modes.poles.imag, [-3, -2, -1, 1, 2, 3])
    assert np.all(modes.poles.real == 0)
    assert modes.n == 3
    assert modes.nports == 1
    assert np.max(np.abs(np.abs(modes.nu[:, 0]) ** 2 / modes.r - 1)) < 4 * EPS


def test_the_weights_survive_unchanged_not_squared_from_their_roots():
    r = weights(50)
    assert np.array_equal(phc.modes(np.arange(1.0, 51), r).r, r)


def test_modes_do_not_follow_the_arrays_they_were_made_from_and_are_locked():
    d, r = np.array([1.0, 2.0]), np.array([1.0, 1.0])
    modes = phc.modes(d, r)
    d[0] = 7.0
    assert np.array_equal(modes.d, [1, 2])
    for array in (modes.d, modes.r, modes.nu, modes.rigid, modes.kappa, modes.zeros):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    with pytest.raises(AttributeError):
        modes.d = d


@pytest.mark.parametrize("through", [copy.copy, copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))])
def test_a_copy_is_the_same_and_as_locked(through):
    modes = phc.modes([1.0, 2.0], [1.0, 0.1])
    other = through(modes)
    for name in ("d", "r", "nu", "rigid"):
        assert np.array_equal(getattr(other, name), getattr(modes, name))
        assert not getattr(other, name).flags.writeable


def test_the_text_is_a_call_of_modes_and_with_rigid_bodies_one_of_the_class():
    assert repr(phc.modes([1.0, 2.0], [0.5, 0.25])) == "modes([1.0, 2.0], [0.5, 0.25])"
    assert repr(phc.ph(np.diag([0.0, 1.0]), [0.0, 1.0]).modes).endswith("array([[1.]]))")


def test_no_modes_are_the_zero_system():
    none = phc.modes([], [])
    assert none.n == 0
    assert none.is_minimal
    assert none.kappa_0 == 0
    for empty in (none.poles, none.zeros, none.kappa, *none.coefficients(), none.minimal().d):
        assert empty.shape == (0,)
    assert np.array_equal(none.freqresp([0.0, 1.0]), [0, 0])
    assert np.array_equal(none.evaluate([1 + 1j])[0, 0], [0])


@pytest.mark.parametrize(
    ("d", "r", "message"),
    [
        ([1.0, 0.0], [1.0, 1.0], r"d is not positive: d\[1\] = 0; natural frequencies are > 0"),
        ([1.0, -2.0], [1.0, 1.0], r"d is not positive: d\[1\] = -2"),
        ([1.0, 2.0], [1.0, -1e-9], r"r is negative: r\[1\] = -1e-09, allowed >= 0"),
        ([1.0, 2.0], [1.0], r"r has shape \(1,\); with 2 natural frequencies it must be \(2,\)"),
        ([[1.0, 2.0]], [1.0, 1.0], r"d has shape \(1, 2\); it must be a vector"),
        ([1.0, np.nan], [1.0, 1.0], "d is not finite: 1 of 2 entries are NaN or infinite, the first at index 1"),
        ([1.0], [np.inf], "r is not finite"),
        ([1.0 + 1j], [1.0], "d is complex: largest imaginary part 1"),
        (["fast"], [1.0], "d does not hold real numbers"),
        ([1.0, 2.0], [1.0, 1e308], "a residue d r exceeds the range of doubles"),
    ],
)
def test_modes_say_what_is_wrong_with_their_input(d, r, message):
    with pytest.raises(phc.StructureError, match=message):
        phc.modes(d, r)


@pytest.mark.parametrize(
    "rtol", ["a", [1e-6], np.array([1e-6, 1e-6]), np.nan, np.inf, 1, 1.0, -1, -1e-9, True, 1j], ids=str
)
def test_a_relative_tolerance_is_a_number_from_0_to_1(rtol):
    with pytest.raises(phc.StructureError, match=r"rtol is .*; a relative tolerance is a number from 0 to 1"):
        phc.modes([1.0, 2.0], [1.0, 1.0]).minimal(rtol=rtol)


@pytest.mark.parametrize("rtol", [0, 0.0, 0.999, np.float32(1e-6), np.int64(0)])
def test_a_number_from_0_to_1_of_any_type_is_a_relative_tolerance(rtol):
    assert phc.modes([1.0], [1.0]).minimal(rtol=rtol).n == 1


@pytest.mark.parametrize(("d", "r"), [([1e-200], [1e-200]), ([1.0, 1e-10], [1.0, 1e-300])])
def test_a_residue_that_underflows_is_refused_and_not_taken_for_zero(d, r):
    with pytest.raises(phc.StructureError, match="the residues d r leave the range of doubles"):
        phc.modes(d, r)
    assert phc.modes(d, 0 * np.array(r)).kappa[0] == 0


@pytest.mark.parametrize(
    "point", [10**400, 10**5000, [1.0, 10**400], [[1], [1, 2]]], ids=["400", "5000", "list", "ragged"]
)
def test_a_point_that_is_no_double_is_refused(point):
    with pytest.raises(phc.StructureError, match="the points are not complex numbers"):
        phc.modes(1.0, 1.0).evaluate(point)


def test_a_value_beyond_the_range_next_to_the_pole_at_0_is_infinite():
    rigid = phc.ph(np.diag([0.0, 1.0]), [0.0, 1.0]).modes
    for point in (5e-324j, 5e-324, 1e-310 + 1e-310j, 0.0):
        assert rigid.evaluate(point)[0, 0, 0] == complex(np.inf, 0)
    assert abs(rigid.evaluate(1e-300)[0, 0, 0] / 1e300 - 1) < 4 * EPS
    two = phc.ph(np.diag([0.0, 4.0, 1.0, 1.0]), np.eye(4)[:, 2:]).modes
    values = two.evaluate(5e-324)[:, :, 0]
    assert values[0, 0] == complex(np.inf, 0) and values[0, 1] == values[1, 0] == 0 and abs(values[1, 1]) < 1e-300


# --- made by hand --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([-1.0], [[1.0]], np.zeros((0, 1))), "d is not positive"),
        (([np.nan], [[1.0]], np.zeros((0, 1))), "d is not finite"),
        (([2.0, 1.0], [[1.0], [1.0]], np.zeros((0, 1))), "d is not ascending"),
        (([1.0], [[np.nan]], np.zeros((0, 1))), "nu is not finite"),
        (([1.0], [1.0], np.zeros((0, 1))), "nu has shape"),
        (([1.0], [[1.0], [1.0]], np.zeros((0, 1))), "nu has shape"),
        (([1.0], "weights", np.zeros((0, 1))), "nu does not hold complex numbers"),
        (([1.0], [[1.0]], np.zeros((0, 2))), "rigid has shape"),
        (([1.0], [[1.0]], [[np.inf]]), "rigid is not finite"),
        (([1.0], [[1e200]], np.zeros((0, 1))), "leave the range of doubles"),
        (([1.0], [[1.0]], np.zeros((0, 1)), [2.0]), r"r is not \|nu\|\^2"),
        (([1.0], [[1.0]], np.zeros((0, 1)), [-1.0]), "r is negative"),
        (([1.0], [[1.0]], np.zeros((0, 1)), [[1.0]]), "r has shape"),
    ],
)
def test_a_modal_form_made_by_hand_is_checked(arguments, message):
    with pytest.raises(phc.StructureError, match=message):
        phc.ModalForm(*arguments)


def test_a_modal_form_leaves_the_arrays_it_is_made_of_alone():
    given = [np.array([1.0, 2.0]), np.ones((2, 1), complex), np.ones((1, 1)), np.ones(2)]
    modes = phc.ModalForm(*given)
    for array in given:
        array[:] = 7.0
    assert np.array_equal(modes.d, [1.0, 2.0]) and np.array_equal(modes.nu, [[1.0], [1.0]])
    assert np.array_equal(modes.rigid, [[1.0]]) and np.array_equal(modes.r, [1.0, 1.0])
    for array in (modes.d, modes.nu, modes.rigid, modes.r):
        assert not array.flags.writeable


def test_residues_are_shapes_times_participations_and_make_up_the_response():
    system = phc.spring_chain([1.0, 2.0], 3.0, ground=0.5, port=[0, 1])
    form = system.modes
    residues, upper = form.residues, form.mode_poles
    for residue, shape, participation in zip(residues[-2:], form.shapes, form.participation, strict=True):
        np.testing.assert_allclose(residue, np.outer(shape, participation), atol=1e-15)
    s = 0.3 + 0.7j
    parts = [r / (s - p) + r.conj() / (s - p.conjugate()) for r, p in zip(residues[-2:], upper, strict=True)]
    np.testing.assert_allclose(np.sum(parts, axis=0), system(s), rtol=1e-12)
