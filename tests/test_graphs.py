"""Connected components of dense graphs, against a walk from each node."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ph_control.numerics.graphs import components, coupled_pairs

relaxed = settings(deadline=None, max_examples=50, derandomize=True)


def walked(near):
    """Labels by walking from each node that has none yet."""
    label = [-1] * len(near)
    count = 0
    for start in range(len(near)):
        if label[start] >= 0:
            continue
        waiting = [start]
        while waiting:
            j = waiting.pop()
            if label[j] < 0:
                label[j] = count
                waiting += [k for k in range(len(near)) if near[j, k] or near[k, j]]
        count += 1
    return count, label


@relaxed
@given(st.integers(0, 12), st.sampled_from([0.0, 0.05, 0.2, 1.0]), st.booleans(), st.integers(0, 2**32 - 1))
def test_components_are_what_walks_reach(n, density, symmetric, seed):
    near = np.random.default_rng(seed).random((n, n)) < density
    near = near | near.T if symmetric else near
    count, label = components(near)
    assert (count, label.tolist()) == walked(near)


@pytest.mark.parametrize("kind", ["nothing", "diagonal", "full", "path", "star", "backward path"])
def test_graphs_of_simple_kinds(kind):
    n = 6
    near = {
        "nothing": np.zeros((n, n), bool), "diagonal": np.eye(n, dtype=bool), "full": np.ones((n, n), bool),
        "path": np.eye(n, k=1, dtype=bool), "backward path": np.eye(n, k=-1, dtype=bool),
        "star": np.arange(n)[:, None] * np.arange(n) == 0,
    }[kind]  # fmt: skip
    count, label = components(near)
    assert (count, label.tolist()) == walked(near)


@relaxed
@given(st.integers(0, 8), st.sampled_from([0.0, 0.02, 0.1, 1.0]), st.integers(0, 2**32 - 1))
def test_pairs_are_coupled_by_any_of_four_entries(n, density, seed):
    rng = np.random.default_rng(seed)
    Q = rng.random((2 * n, 2 * n)) * (rng.random((2 * n, 2 * n)) < density)
    Q = Q + Q.T
    near = np.array([[Q[np.ix_([j, n + j], [k, n + k])].any() for k in range(n)] for j in range(n)]).reshape(n, n)
    count, label = coupled_pairs(Q)
    assert (count, label.tolist()) == walked(near)
