"""What runs in other processes, threads or a cluster gives what runs here, bit by bit."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import numpy as np
import pytest
from scripts import run

import ph_control as phc


@contextmanager
def cluster():
    """A Dask client of a cluster in this process, of two threads."""
    distributed = pytest.importorskip("distributed", reason="the extra 'distributed' is not installed")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=False, dashboard_address=":0", protocol="inproc"
        ) as found,
        distributed.Client(found) as client,
    ):
        yield client


@pytest.fixture(scope="module")
def record():
    """Input and output of two modes, with noise."""
    rng = np.random.default_rng(0)
    plant, u = phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25])), rng.standard_normal(400)
    y = phc.forced_response(plant, 0.1 * np.arange(400), u, intersample="zoh").outputs
    return u, y + 0.05 * rng.standard_normal(400)


@pytest.mark.variants
@pytest.mark.parametrize("kind", ["processes", "threads", "cluster"])
def test_answers_do_not_depend_on_where_they_are_computed(record, kind):
    fit = phc.pem(record, 2, dt=0.1)

    def answers(workers):
        drawn = fit.bootstrap(6, rng=1, workers=workers)
        return drawn.d, drawn.r, phc.order_selection(record, 3, dt=0.1, holdout=0.3, workers=workers).holdout

    if kind == "processes":
        found = answers(2)
    else:
        with ThreadPoolExecutor(2) if kind == "threads" else cluster() as given:
            found = answers(given)
    assert [one.tobytes() for one in found] == [one.tobytes() for one in answers(1)]


def test_what_is_neither_number_nor_executor_is_refused(record):
    for value in (0, "2", True, None):
        with pytest.raises(phc.StructureError, match="workers is"):
            phc.order_selection(record, 2, dt=0.1, holdout=0.3, workers=value)


@pytest.mark.slow
def test_a_script_without_a_main_part_is_told_what_it_lacks(tmp_path):
    (tmp_path / "script.py").write_text(
        "import numpy as np, ph_control as phc\n"
        "u = np.random.default_rng(0).standard_normal(50)\n"
        "phc.pem((None, np.sin(np.arange(50)) + 0.1 * u), 1, dt=0.1).bootstrap(4, rng=1, workers=2)\n"
    )
    done = run(tmp_path, "script.py")
    assert done.returncode == 1 and "if __name__ == '__main__':" in done.stderr
