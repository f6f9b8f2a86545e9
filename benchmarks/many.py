"""Many recordings: the same bits wherever they are fitted, what is killed in between, speed, memory, and tracking.

python -m benchmarks.many same|killed|speed|memory|tracking [--recordings N] [--samples T] [--picture FILE]
"""

from __future__ import annotations

import argparse
import contextlib
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray

import ph_control as phc

Array = NDArray[np.float64]

STEP = 0.1
OPTIONS: dict[str, Any] = {"dt": STEP, "order": 2, "structure": "lossless"}


def recording(k: int, samples: int) -> tuple[Array, Array]:
    """Input and output of two modes, one of which drifts, with 1 % of noise."""
    rng = np.random.default_rng(k)
    u = rng.standard_normal(samples)
    plant = phc.ph(phc.modes([0.5 * (1 + 1e-5 * k), 2.0], [1.0, 0.25]))
    y = phc.forced_response(plant, STEP * np.arange(samples), u, intersample="zoh").outputs
    return u, y + 0.01 * rng.standard_normal(samples)


def recordings(count: int, samples: int) -> Iterator[tuple[Array, Array]]:
    """So many of them, one by one."""
    return (recording(k, samples) for k in range(count))


def digest(fits: phc.FitTable) -> bytes:
    """Bits of a table, but for the names of files."""
    return b"".join(fits.table[name].tobytes() for name in fits.table.dtype.names if name != "result")


def processor_time(pid: int) -> float:
    """Seconds that a process has computed."""
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def resident(pid: int) -> float:
    """Memory of a process in MB."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def workers_of(*, own: bool = False) -> list[int]:
    """Processes that work for this one."""
    return [one.pid for one in multiprocessing.active_children() if one.pid] + [os.getpid()] * own


@contextlib.contextmanager
def cluster() -> Iterator[Any]:
    """A Dask client of two worker processes."""
    import distributed

    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as found,
        distributed.Client(found) as client,
    ):
        yield client


# --- the same bits ---------------------------------------------------------------------------------------------------


def same(count: int, samples: int) -> None:
    """Tables by one process, two, two threads and a cluster of two."""
    bits = {}
    ways = {"serial": 1, "2 processes": 2, "2 threads": ThreadPoolExecutor(2), "Dask, 2 workers": cluster}
    for name, workers in ways.items():
        start = time.perf_counter()
        with workers() if callable(workers) else contextlib.nullcontext(workers) as given:
            fits = phc.fit_many(recordings(count, samples), workers=given, **OPTIONS)
        bits[name] = digest(fits)
        print(
            f"{name}: {fits._headline()}, {time.perf_counter() - start:.0f} s, load {os.getloadavg()[0]:.1f}, "
            f"{'the same bits' if bits[name] == bits['serial'] else 'OTHER BITS'}", flush=True,
        )  # fmt: skip


# --- what is killed --------------------------------------------------------------------------------------------------


def client(store: str, count: int, samples: int) -> None:
    """Fit into a store; this process is to be killed."""
    phc.fit_many(recordings(count, samples), workers=2, store=store, **OPTIONS)


def killed(count: int, samples: int) -> None:
    """A client and its workers killed at three moments, a worker at a fourth; then the rest."""
    folder = Path(tempfile.mkdtemp())
    store = folder / "results"
    code = f"from benchmarks.many import client; client({str(store)!r}, {count}, {samples})"
    for share in (0.15, 0.3, 0.45):
        done = subprocess.Popen([sys.executable, "-c", code])
        while done.poll() is None and len(list(store.glob("*.json"))) < share * count:
            time.sleep(0.005)
        done.send_signal(signal.SIGKILL)
        done.wait()
        time.sleep(0.5)
        print(f"client killed with {len(list(store.glob('*.json')))} results in the store", flush=True)
    kept = {one: one.stat().st_mtime_ns for one in store.glob("*.json")}
    deaths = []

    def kill(told: phc.RecordingFitted) -> None:
        if told.done in (int(0.6 * count), int(0.8 * count)):
            deaths.append(workers_of()[0])
            os.kill(deaths[-1], signal.SIGKILL)

    fits = phc.fit_many(recordings(count, samples), workers=2, store=store, callback=kill, **OPTIONS)
    files = {one.name for one in store.glob("*.json")}
    whole = sum(phc.load(store / name).order == 2 for name in files)
    untouched = all(one.stat().st_mtime_ns == at for one, at in kept.items())
    print(
        f"then {len(deaths)} workers killed: {fits._headline()}, {len(files)} files, {whole} of them whole, those from "
        f"before {'untouched' if untouched else 'WRITTEN AGAIN'}, rows and files "
        f"{'one to one' if sorted(set(fits.table['result'])) == sorted(files) else 'DIFFER'}"
    )
    fresh = phc.fit_many(recordings(count, samples), workers=2, **OPTIONS)
    print(f"against a run without a store: {'the same bits' if digest(fits) == digest(fresh) else 'OTHER BITS'}")
    shutil.rmtree(folder)


# --- speed and memory ------------------------------------------------------------------------------------------------


def speed(count: int, samples: int) -> None:
    """Time of one process, and of two with their client: by wall clock, and by processor time.

    Of processor time, that of the busiest process is the wall time of a machine with a core for each, and half of all
    that of one with two.
    """
    data = list(recordings(count, samples))
    phc.fit_many(data[:5], **OPTIONS)
    for _ in range(2):
        wall, own = time.perf_counter(), time.process_time()
        phc.fit_many(data, **OPTIONS)
        serial, serial_own = time.perf_counter() - wall, time.process_time() - own
        spent: list[float] = []

        def note(told: phc.RecordingFitted, spent: list[float] = spent) -> None:
            if told.done == count:
                spent += map(processor_time, workers_of())

        wall, own = time.perf_counter(), time.process_time()
        phc.fit_many(data, workers=2, callback=note, **OPTIONS)
        both, both_own = time.perf_counter() - wall, time.process_time() - own
        busiest, half = max(*spent, both_own), (sum(spent) + both_own) / 2
        shown = " and ".join(f"{one:.1f}" for one in spent)
        print(
            f"{count} recordings: serial {serial:.1f} s, {serial_own:.1f} s of processor; two processes {both:.1f} s, "
            f"{shown} s of processor and {both_own:.2f} s of the client: {serial / both:.2f} times by the wall, "
            f"{serial_own / busiest:.2f} times by the busiest process, {serial_own / half:.2f} times by half of all "
            f"processor time (load {os.getloadavg()[0]:.1f})", flush=True,
        )  # fmt: skip


def memory(count: int, samples: int) -> None:
    """Resident memory of client and workers as an iterator goes on."""
    moments = {count // 5, count // 2, count}

    def note(told: phc.RecordingFitted) -> None:
        if told.done in moments:
            client, workers = resident(os.getpid()), [resident(pid) for pid in workers_of()]
            shown = " and ".join(f"{one:.0f}" for one in workers)
            print(f"{told.done} recordings: client {client:.1f} MB, workers {shown} MB", flush=True)

    size = count * samples * 16e-6
    print(f"all recordings together are {size:.0f} MB")
    phc.fit_many(recordings(count, samples), workers=2, callback=note, **OPTIONS)


# --- tracking --------------------------------------------------------------------------------------------------------

SHAPES = np.array([[1.0, 0.6, 0.3], [1.0, -0.4, -0.8], [0.4, 1.0, -0.7]])


def monitored(k: int, count: int, samples: int) -> tuple[Array, Array]:
    """Three outputs of three damped modes: the first rises by 1 %, the second falls by 4 % across it."""
    rng = np.random.default_rng(k)
    passed = k / (count - 1)
    d = np.array([0.995 + 0.01 * passed, 1.02 - 0.04 * passed, 1.7])
    poles = d * (-0.004 + 1j)
    plant = phc.modes(poles, SHAPES, SHAPES[:, :2]).state_space()
    u = rng.standard_normal((2, samples))
    y = ct.forced_response(ct.c2d(plant, 0.5), 0.5 * np.arange(samples), u).outputs
    return u, y + 0.02 * np.std(y, axis=1, keepdims=True) * rng.standard_normal(y.shape)


def tracking(count: int, samples: int, picture: str | None) -> None:
    """How many rows of each true mode have the number of its track."""
    fits = phc.fit_many(
        (monitored(k, count, samples) for k in range(count)), workers=2, dt=0.5, order=3, structure="free"
    )
    tracks = fits.track()
    print(tracks)
    shapes = np.array([one if len(one) else np.zeros(3) for one in fits.shapes])
    unit = SHAPES / np.linalg.norm(SHAPES, axis=1, keepdims=True)
    norm = np.maximum(np.linalg.norm(shapes, axis=1, keepdims=True), 1e-300)
    truth = np.argmax(np.abs(shapes / norm @ unit.T), axis=1)
    for mode in range(3):
        numbers = tracks.ids[(truth == mode) & (fits.table["mode"] >= 0)]
        most = np.bincount(numbers[numbers >= 0]).argmax()
        print(f"true mode {mode}: {len(numbers)} rows, {int((numbers == most).sum())} of them in track {most}")
    if picture:
        tracks.plot().figure.savefig(picture, dpi=110)


def main() -> None:
    """Run one of the studies."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("study", choices=("same", "killed", "speed", "memory", "tracking"))
    parser.add_argument("--recordings", type=int)
    parser.add_argument("--samples", type=int, default=400)
    parser.add_argument("--picture", help="of the tracks")
    options = parser.parse_args()
    count = options.recordings or (200 if options.study == "tracking" else 1000)
    if options.study == "tracking":
        tracking(count, options.samples, options.picture)
    else:
        globals()[options.study](count, options.samples)


if __name__ == "__main__":
    main()
