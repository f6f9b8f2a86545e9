"""The tasks of the report as pytest-benchmark groups: `python -m pytest benchmarks/test_systems.py`.

Up to 100 modes; `python -m benchmarks.report` has the large ones.
"""

import pytest

from benchmarks.tasks import FAMILIES

CASES = [
    (name, arguments)
    for name, family in FAMILIES.items()
    for arguments in family.sizes
    if not arguments or arguments[0] <= 100
]
MOST = 6  # contenders of a task


@pytest.fixture(scope="module", params=CASES, ids=lambda case: "-".join(map(str, (case[0], *case[1]))))
def task(request):
    name, arguments = request.param
    made = FAMILIES[name].make(*arguments)
    assert len(made.runs) <= MOST
    return made


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("place", range(MOST))
def test_task(benchmark, task, place):
    if place >= len(task.runs):
        pytest.skip(f"the task has {len(task.runs)} contenders")
    name = list(task.runs)[place]
    benchmark.group = f"{task.name}, {task.size}"
    benchmark.extra_info["contender"] = name
    benchmark.name = f"{benchmark.name} {name}"
    if task.apart:
        # processes of their own, which measure themselves
        seconds, benchmark.extra_info["peak"] = benchmark.pedantic(task.runs[name], rounds=1)
        benchmark.extra_info["seconds"] = seconds
    else:
        assert benchmark(task.runs[name]) is not None
