"""The tasks of the report as pytest-benchmark groups: `python -m pytest benchmarks/test_systems.py`.

Up to 100 modes; `python -m benchmarks.report` has the large ones.
"""

import pytest

from benchmarks.tasks import FAMILIES

CASES = [
    (family, arguments)
    for family, (_, sizes) in FAMILIES.items()
    for arguments in sizes
    if not arguments or arguments[0] <= 100
]


@pytest.fixture(scope="module", params=CASES, ids=lambda case: "-".join(map(str, (case[0], *case[1]))))
def task(request):
    family, arguments = request.param
    return FAMILIES[family][0](*arguments)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("place", range(4))
def test_task(benchmark, task, place):
    if place >= len(task.runs):
        pytest.skip(f"the task has {len(task.runs)} contenders")
    name = list(task.runs)[place]
    benchmark.group = f"{task.name}, {task.size}"
    benchmark.extra_info["contender"] = name
    benchmark.name = f"{benchmark.name} {name}"
    assert benchmark(task.runs[name]) is not None
