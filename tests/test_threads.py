"""Fits and reductions run on one thread of BLAS, and leave the number of threads as it was."""

from __future__ import annotations

from threading import Thread

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import ph_control as phc

RNG = np.random.default_rng(0)
INPUT = RNG.standard_normal(300)
PLANT = phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25], damping=0.01))
OUTPUT = phc.forced_response(PLANT, 0.1 * np.arange(300), INPUT).outputs + 0.05 * RNG.standard_normal(300)


def threads():
    return [one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"]


@pytest.fixture(autouse=True)
def two_threads():
    with threadpool_limits(limits=2, user_api="blas"):
        yield


def fitted(callback):
    return phc.pem((INPUT, OUTPUT), 2, dt=0.1, structure="free", callback=callback)


def test_a_fit_has_one_thread_and_gives_back_the_others():
    before, inside = threads(), []
    assert 2 in before
    fitted(lambda progress: inside.append(threads()))
    assert inside and all(one == [1] * len(before) for one in inside) and threads() == before


@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError])
def test_a_fit_that_is_cut_short_gives_them_back_as_well(error):
    def stop(progress):
        raise error

    before = threads()
    if error is KeyboardInterrupt:
        assert fitted(stop).outcome.name == "INTERRUPTED"
    else:
        with pytest.raises(error):
            fitted(stop)
    assert threads() == before


def test_fits_at_the_same_time_have_one_thread_of_the_first():
    before, inside, after = threads(), [], []

    def another(progress):
        if not after:
            thread = Thread(target=fitted, args=(lambda progress: inside.append(threads()),))
            thread.start()
            thread.join(120)
            after.append(threads())

    fitted(another)
    assert inside and all(one == [1] * len(before) for one in [*inside, *after]) and threads() == before


@pytest.mark.variants
@pytest.mark.parametrize("method", ["modal", "balanced", "h2"])
def test_reduced_models_do_not_depend_on_the_number_of_threads(method):
    chain, before = phc.msd_chain(15), threads()
    by_two = phc.reduce(chain, 4, method=method)
    assert threads() == before
    with threadpool_limits(limits=1, user_api="blas"):
        by_one = phc.reduce(chain, 4, method=method)
    assert by_two.error_bound == by_one.error_bound
    assert np.array_equal(by_two.A, by_one.A)
