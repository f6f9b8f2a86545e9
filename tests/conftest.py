"""What every test shares: no test may change global state, and where third-party data lies."""

import gc
import os
from collections import Counter
from pathlib import Path

# the matrices of the tests are small: threads of the linear algebra would only wait for one another
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import control
import hypothesis
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest

matplotlib.use("Agg")

# the same examples in every run
hypothesis.settings.register_profile("suite", derandomize=True, deadline=None, max_examples=30)
hypothesis.settings.load_profile("suite")


def pytest_configure(config):
    """Give files to processes in their order: few long tests at the end would keep one of them waiting."""
    if hasattr(config.option, "loadscopereorder"):
        config.option.loadscopereorder = False


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Spare the collector of garbage all that stays: hundreds of thousands of objects, which it would visit often."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_addoption(parser):
    parser.addoption("--slow", action="store_true", help="also run tests that are marked as slow")


def pytest_collection_modifyitems(config, items):
    """Leave slow tests and variants out, unless they are asked for by the option, or by the marker: `-m slow`."""
    cases = Counter()
    for item in items:
        if item.get_closest_marker("variants"):
            name = item.nodeid.split("[")[0]
            if cases[name] % EACH:
                item.add_marker(pytest.mark.slow)
            cases[name] += 1
    if config.getoption("--slow") or config.getoption("-m"):
        return
    slow = [item for item in items if item.get_closest_marker("slow")]
    items[:] = [item for item in items if not item.get_closest_marker("slow")]
    config.hook.pytest_deselected(items=slow)


EACH = 8  # cases of a test that is marked with `variants`, of which one is quick
DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


def _global_state():
    return {
        "numpy.geterr()": np.geterr(),
        "control.config.defaults": dict(control.config.defaults),
        "matplotlib.rcParams": dict.copy(matplotlib.rcParams),
        "numpy.random": [
            part.tobytes() if isinstance(part, np.ndarray) else part
            for part in np.random.get_state()  # noqa: NPY002
        ],
    }


@pytest.fixture(autouse=True)
def global_state_is_unchanged():
    """Hold the global state after a test against that before it; close all figures."""
    before = _global_state()
    yield
    plt.close("all")
    after = _global_state()
    changed = [name for name in before if before[name] != after[name]]
    assert not changed, f"the test changed {', '.join(changed)}"


@pytest.fixture(scope="session")
def data_folder():
    """Folder of third-party data; its tests are skipped where it is absent."""
    if not DATA.is_dir():
        pytest.skip(f"third-party data not found at {DATA}")
    return DATA
