"""Data of several inputs and outputs: one list of channels for all experiments, whatever they were measured with."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest

import ph_control as phc
from ph_control.identification.data.channels import Recording, ResponseMatrix
from ph_control.identification.data.experiments import as_channels

RNG = np.random.default_rng(0)
U, Y, TIME = RNG.standard_normal((2, 30)), RNG.standard_normal((3, 30)), 0.1 * np.arange(30)


def response(u=U, y=Y, **options):
    return ct.TimeResponseData(TIME, y, inputs=u, issiso=False, **options)


def test_a_pair_has_one_row_for_each_channel():
    (one,) = as_channels((U, Y), 0.1)
    assert isinstance(one, Recording) and one.samples == 30 and one.dt == 0.1
    assert (one.input_labels, one.output_labels) == (("u1", "u2"), ("y1", "y2", "y3"))
    np.testing.assert_array_equal(one.u, U)
    np.testing.assert_array_equal(one.y, Y)
    assert not one.u.flags.writeable and one.observed.all()


def test_signals_without_a_channel_number_are_one_channel():
    (one,) = as_channels((U[0].tolist(), Y[:2].tolist()), 0.1)
    assert (one.u.shape, one.y.shape, one.input_labels) == ((1, 30), (2, 30), ("u",))
    (free,) = as_channels((None, Y), 0.1)
    assert free.u.shape == (0, 30) and free.input_labels == ()


def test_responses_of_python_control_keep_their_labels_and_traces():
    (one,) = as_channels(response(input_labels=["F", "M"], output_labels=["a", "b", "c"], title="shaker"))
    assert (one.input_labels, one.output_labels, one.title) == (("F", "M"), ("a", "b", "c"), "shaker")
    assert one.dt == 0.1 and np.array_equal(one.y, Y)
    system = ct.ss([[-1.0, 2], [-2, -1]], np.eye(2), np.eye(2), 0)
    first, second = as_channels(ct.step_response(system, TIME))
    assert first.u.shape == (2, 30) and second.u[1].all() and not second.u[0].any()


def test_experiments_are_matched_by_label():
    hammer = [
        response(U[:1], Y, input_labels=["left"], output_labels=["a", "b", "c"]),
        response(U[1:], Y[1:], input_labels=["right"], output_labels=["c", "b"]),
    ]
    first, second = as_channels(hammer)
    assert first.input_labels == second.input_labels == ("left", "right")
    assert first.output_labels == second.output_labels == ("a", "b", "c")
    np.testing.assert_array_equal(first.u, [U[0], 0 * U[0]])
    np.testing.assert_array_equal(second.u, [0 * U[0], U[1]])
    np.testing.assert_array_equal(second.y, [np.nan * Y[0], Y[2], Y[1]])


def test_experiments_without_labels_are_matched_by_position():
    first, second = as_channels([(U, Y), (None, Y[:1])], 0.1)
    assert first.input_labels == second.input_labels and not second.u.any()
    assert np.isnan(second.y[1:]).all() and np.array_equal(second.y[0], Y[0])


def test_frequency_responses_keep_all_entries_and_sort_them():
    values = RNG.standard_normal((3, 2, 4)) + 1j * RNG.standard_normal((3, 2, 4))
    values[2, 1, 0] = np.nan
    data = ct.frd(values, [4.0, 1.0, 3.0, 2.0])
    weights = 1 + RNG.random((3, 2, 4))
    (one,) = as_channels(data, weights=weights)
    assert isinstance(one, ResponseMatrix) and one.omega.tolist() == [1, 2, 3, 4]
    np.testing.assert_array_equal(one.response, values[..., [1, 3, 2, 0]])
    np.testing.assert_array_equal(one.weights, weights[..., [1, 3, 2, 0]])
    assert one.observed.sum() == 23 and not one.observed[2, 1, 3]
    (shared,) = as_channels(data, weights=[1.0, 2.0, 3.0, 4.0])
    np.testing.assert_array_equal(shared.weights[0, 1], [2, 4, 3, 1])


def test_roving_frequency_responses_fill_one_matrix():
    parts = [ct.frd(np.full((1, 1, 3), k + 1j), [1.0, 2.0, 3.0], inputs=["F"], outputs=[f"a{k}"]) for k in range(2)]
    first, second = as_channels(parts)
    assert first.output_labels == second.output_labels == ("a0", "a1")
    assert np.isnan(second.response[0]).all() and (second.response[1] == 1 + 1j).all()


def test_data_of_one_channel_are_a_matrix_of_one_entry():
    (one,) = as_channels((U[0], Y[0]), 0.1)
    assert (one.u.shape, one.y.shape, one.input_labels, one.output_labels) == ((1, 30), (1, 30), ("u",), ("y",))
    (again,) = as_channels(one)
    assert again is one
    (both,) = as_channels([one, one])[:1]
    assert both is one


@pytest.mark.parametrize(
    "data, options, message",
    [
        ((U, Y.T), {"dt": 0.1}, r"the outputs have shape \(30, 3\).*pass the transpose, y.T"),
        ((U.T, Y), {"dt": 0.1}, r"the inputs have shape \(30, 2\).*pass the transpose, u.T"),
        ((U, Y[:, 1:]), {"dt": 0.1}, "samples"),
        ((np.where(U > 1, np.nan, U), Y), {"dt": 0.1}, "input 1 is not finite at sample"),
        ((U, np.where(np.arange(3)[:, None] == 1, np.nan, Y)), {"dt": 0.1}, "output 'y2' has no sample"),
        ((U, Y), {}, "dt is missing"),
        ((U, None), {"dt": 0.1}, "no output"),
        ((U, Y), {"dt": 0.1, "weights": [1.0]}, "weights belong to frequency responses"),
        ([response(), ct.frd(np.ones((1, 1, 2)), [1.0, 2.0])], {}, "experiment 2: this is a frequency response"),
        (response(input_labels=["a", "a"]), {}, "2 inputs are called 'a'"),
        (ct.frd(np.ones((1, 1, 2)), [1.0, 2.0]), {"weights": np.ones((2, 1, 2))}, "weights have shape"),
    ],
)
def test_what_does_not_fit_together_is_refused(data, options, message):
    with pytest.raises(phc.StructureError, match=message):
        as_channels(data, **options)
