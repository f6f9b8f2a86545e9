"""Many recordings: one table whatever they are fitted in, whatever dies meanwhile, and modes followed over them."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import replace

import control as ct
import matplotlib.pyplot as plt
import numpy as np
import pytest
from scripts import ROOT
from shell import run as shell
from slow import slowly
from test_workers import cluster

import ph_control as phc

STEP = 0.1
OPTIONS = {"order": 1, "structure": "lossless", "intersample": "zoh", "delay": 0.0, "noise": "white", "offset": False}


def pair(k, samples=80):
    """Input and output of a mode, of its own frequency and noise."""
    rng = np.random.default_rng(k)
    u = rng.standard_normal(samples)
    y = phc.forced_response(
        phc.ph(phc.modes(1 + 0.01 * k, 1.0)), STEP * np.arange(samples), u, intersample="zoh"
    ).outputs
    return u, y + 0.01 * rng.standard_normal(samples)


def write(path, k):
    """The same as a file."""
    u, y = pair(k)
    np.savetxt(path, np.column_stack([STEP * np.arange(len(u)), u, y]), delimiter=",", header="t,u,y", comments="")
    return path


def six(folder):
    """Six recordings, the third of which is none."""
    paths = [write(folder / f"{k:02d}.csv", k) for k in range(6)]
    paths[2].write_text("t,u,y\n0,1,2\n0,1,2\n")
    return paths


@pytest.fixture
def files(tmp_path):
    """Six recordings that a test may change."""
    return six(tmp_path)


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """Six recordings that stay as they are."""
    return six(tmp_path_factory.mktemp("recordings"))


@pytest.fixture(scope="module")
def fits(kept):
    """Their table."""
    return phc.fit_many(kept, **OPTIONS)


def same(one, other):
    """Whether two tables hold the same bits."""
    return one.table.dtype == other.table.dtype and one.table.tobytes() == other.table.tobytes()


# --- the table -------------------------------------------------------------------------------------------------------


def test_a_row_for_each_recording_and_mode_in_their_order(kept, fits):
    assert fits.complete and fits.table["recording"].tolist() == list(range(6))
    assert fits.table["name"].tolist() == [str(one) for one in kept]
    one, row = phc.pem(phc.read_csv(kept[4]), **OPTIONS), fits.table[4]
    assert (row["hertz"], row["damping_ratio"], row["fit_percent"]) == (one.hertz[0], 0.0, one.fit_percent)
    assert row["hertz_stderr"] == one.stderr["natural_frequencies"][0] / (2 * np.pi)
    assert (row["structure"], row["order"], row["mode"], row["message"]) == ("lossless", 1, 0, one.verdict)
    assert np.array_equal(fits.shapes[4], one.shapes[0])


def test_a_failure_is_a_row_with_its_message(files):
    fits = phc.fit_many([*files, "no such file.csv", (np.ones(5), np.ones(4))], dt=STEP, **OPTIONS)
    assert fits.failures["recording"].tolist() == [2, 6, 7]
    assert "it must increase" in fits.failures["message"][0] and "no such file" in fits.failures["message"][1]
    assert "5 samples" in fits.failures["message"][2] and fits.failures["name"][2] == "recording 7"
    assert np.isnan(fits.failures["hertz"]).all() and (fits.failures["mode"] == -1).all()
    assert "5 modes of 8 recordings, 3 failed" in str(fits).splitlines()[0]
    assert len(str(fits).splitlines()) == 2 + 8


def test_a_long_table_is_printed_with_all_that_failed(fits):
    table = np.repeat(fits.table, [30, 30, 1, 30, 30, 30])
    lines = str(replace(fits, table=table)).splitlines()
    assert len(lines) == 2 + 20 + 3 + 20 and "it must increase" in lines[2 + 21]
    assert (lines[2 + 20], lines[2 + 22]) == ("  ... 40 more ...", "  ... 70 more ...")


def test_a_recording_without_a_mode_is_no_failure():
    rng = np.random.default_rng(0)
    fits = phc.fit_many([(rng.standard_normal(60), rng.standard_normal(60))], dt=STEP)
    assert (fits.table["order"].tolist(), len(fits.failures), fits.table["mode"].tolist()) == ([0], 0, [-1])


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["processes", "threads", "cluster"])
def test_the_table_does_not_depend_on_where_it_is_computed(files, kind):
    here = phc.fit_many(files, **OPTIONS)
    if kind == "processes":
        assert same(phc.fit_many(files, workers=2, **OPTIONS), here)
        return
    with ThreadPoolExecutor(2) if kind == "threads" else cluster() as given:
        assert same(phc.fit_many(iter(files), workers=given, **OPTIONS), here)


def test_patterns_files_and_data_of_any_kind_are_recordings(files, tmp_path):
    u, y = pair(5)
    time_ = STEP * np.arange(len(u))
    data = [ct.TimeResponseData(time_, y, inputs=u, issiso=True, title="test 5"), (u, y)]
    fits = phc.fit_many([tmp_path / "0[345].csv", *data], dt=STEP, **OPTIONS)
    assert fits.table["name"].tolist() == [*map(str, files[3:]), "test 5", "recording 2"]
    assert np.ptp(fits.table["hertz"][2:]) < 1e-12
    assert len(phc.fit_many(str(tmp_path / "*.csv"), **OPTIONS).table) == 6


@pytest.mark.slow
def test_data_of_any_kind_travel_to_other_processes():
    rng, t = np.random.default_rng(0), STEP * np.arange(80)
    u = rng.standard_normal(80)
    response = ct.forced_response(ct.tf([1, 0], [1, 0, 1]), t, u)
    data = [response, (response.inputs, response.outputs), [(u, response.outputs)]]
    here, there = (phc.fit_many(data, workers=workers, dt=STEP, **OPTIONS) for workers in (1, 2))
    assert same(here, there) and not len(here.failures)


@pytest.mark.slow
def test_an_iterator_is_taken_as_there_is_room():
    taken, ahead = [], []

    def recordings():
        for k in range(15):
            taken.append(k)
            yield pair(k % 3)

    with ThreadPoolExecutor(2) as pool:
        fits = phc.fit_many(
            recordings(), workers=pool, dt=STEP, callback=lambda told: ahead.append(len(taken) - told.done), **OPTIONS
        )
    # two for each thread; more when they are known to be short
    assert len(fits) == 15 and ahead[0] == 3


@pytest.mark.parametrize("kind", ["processes", *slowly("threads")])
def test_a_failure_among_quick_recordings_is_its_own_only(kind):
    def recordings():
        return (pair(k % 5, 30) if k != 10 else {"no": lambda: None} for k in range(14))

    here = phc.fit_many([pair(k, 30) for k in range(5)], dt=STEP, **OPTIONS).table["hertz"]
    expected = [here[k % 5] for k in range(14) if k != 10]
    with ThreadPoolExecutor(2) if kind == "threads" else nullcontext(2) as given:
        fits = phc.fit_many(recordings(), workers=given, dt=STEP, **OPTIONS)
    assert fits.failures["recording"].tolist() == [10]
    assert fits.table["hertz"][fits.table["order"] >= 0].tolist() == expected


def test_a_callback_is_told_of_each_recording(files):
    told = []
    phc.fit_many(files, callback=told.append, **OPTIONS)
    assert [(one.done, one.failed, one.total) for one in told] == [
        (1, 0, 6), (2, 0, 6), (3, 1, 6), (4, 1, 6), (5, 1, 6), (6, 1, 6)
    ]  # fmt: skip
    assert told[3].name == str(files[3]) and told[3].message == "consistent with the record"


def test_a_data_frame_has_the_fields_as_columns(fits):
    pandas = pytest.importorskip("pandas", reason="pandas is not installed")
    frame = fits.to_pandas()
    assert isinstance(frame, pandas.DataFrame) and list(frame.columns) == list(fits.table.dtype.names)
    assert frame["hertz"].tolist()[3:] == fits.table["hertz"].tolist()[3:]


@pytest.mark.parametrize(
    ("recordings", "options", "message"),
    [
        (pair(0), {"dt": STEP}, "recordings is"),
        (3, {}, "recordings is"),
        (ct.ss(-1.0, 1.0, 1.0, 0.0), {}, "recordings is"),
        (ct.TimeResponseData(np.arange(3.0), np.zeros(3), issiso=True), {}, "recordings is"),
        ([], {"workers": 0}, "workers is"),
        ([], {"rng": np.random.default_rng(0)}, "rng is"),
    ],
)
def test_what_is_no_list_of_recordings_is_refused(recordings, options, message):
    with pytest.raises(phc.StructureError, match=message):
        phc.fit_many(recordings, **options)


def test_an_option_that_pem_does_not_have_is_an_error():
    with pytest.raises(TypeError, match="unexpected keyword argument 'ordr'"):
        phc.fit_many([], ordr=3)
    with pytest.raises(
        TypeError, match=r"columns of files are chosen by fit_many\(read_csv\(file, input=.., output=..\)"
    ):
        phc.fit_many([], input="force")


# --- the store -------------------------------------------------------------------------------------------------------


def written(store):
    """When each result was written."""
    return {one.name: one.stat().st_mtime_ns for one in store.iterdir()}


@pytest.mark.slow
def test_what_is_in_the_store_is_not_fitted_again(files, tmp_path):
    store = tmp_path / "results"
    first = phc.fit_many(files, store=store, **OPTIONS)
    before = written(store)
    assert len(before) == 5 and set(first.table["result"]) == {*before, ""}
    assert same(phc.fit_many(files, store=store, workers=2, **OPTIONS), first) and written(store) == before
    kept = phc.load(store / first.table["result"][0])
    assert kept.hertz[0] == first.table["hertz"][0]


@pytest.mark.slow
def test_what_has_changed_is_fitted_again(files, tmp_path):
    store = tmp_path / "results"
    first = phc.fit_many(files, store=store, **OPTIONS)
    write(files[0], 9)
    second = phc.fit_many(files, store=store, **OPTIONS)
    changed = first.table["result"] != second.table["result"]
    assert changed.tolist() == [True, *[False] * 5]
    third = phc.fit_many(files, store=store, **OPTIONS | {"quantity": "displacement"})
    assert not set(third.table["result"]) - {""} & set(second.table["result"])
    assert len(written(store)) == 11


def test_a_damaged_result_is_fitted_again(files, tmp_path):
    store = tmp_path / "results"
    first = phc.fit_many(files, store=store, **OPTIONS)
    hurt = store / first.table["result"][1]
    hurt.write_bytes(hurt.read_bytes()[:100])
    assert same(phc.fit_many(files, store=store, **OPTIONS), first) and phc.load(hurt).order == 1


def test_recordings_that_are_alike_share_a_result(tmp_path):
    fits = phc.fit_many([pair(1), pair(1), pair(2)], dt=STEP, store=tmp_path, **OPTIONS)
    assert len(fits) == 3 and len(written(tmp_path)) == 2


def test_a_store_that_is_a_file_is_refused(files):
    with pytest.raises(phc.OutputExistsError, match="a file"):
        phc.fit_many(files, store=files[0])


# --- what dies meanwhile ---------------------------------------------------------------------------------------------


def read_or_die(path):
    """Read a recording; of one, the process that does so first is killed, of another, each."""
    mark = path.with_suffix(".mark")
    if path.stem == "04" or (path.stem == "01" and not mark.exists()):
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return phc.read_csv(path)


def test_a_killed_process_is_replaced_and_loses_nothing(files, fits, tmp_path):
    store, here = tmp_path / "results", fits
    fits = phc.fit_many(files, reader=read_or_die, workers=2, store=store, **OPTIONS)
    assert fits.table["recording"].tolist() == list(range(6))
    assert fits.failures["recording"].tolist() == [2, 4] and "died" in fits.failures["message"][1]
    well = np.delete(np.arange(6), [2, 4])
    assert fits.table["hertz"][well].tolist() == here.table["hertz"][well].tolist()
    assert {one.suffix for one in store.iterdir()} == {".json"} and len(written(store)) == 4


@pytest.mark.slow
def test_a_killed_client_loses_no_result_and_doubles_none(tmp_path):
    files, store = [write(tmp_path / f"{k:03d}.csv", k) for k in range(8)], tmp_path / "results"
    code = f"""if True:
        import ph_control as phc
        import time
        wait = lambda told: told.done < 4 or time.sleep(600)
        phc.fit_many({str(tmp_path / "*.csv")!r}, store={str(store)!r}, callback=wait, **{OPTIONS!r})
    """
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    with subprocess.Popen([sys.executable, "-c", code], env=os.environ | {"PYTHONPATH": path}) as client:
        while client.poll() is None and len(list(store.glob("*.json"))) < 4:
            time.sleep(0.01)
        client.kill()
    before = {name: at for name, at in written(store).items() if name.endswith(".json")}
    assert len(before) == 4
    assert all(phc.load(store / name).order == 1 for name in before)
    fits = phc.fit_many(files, store=store, workers=2, **OPTIONS)
    after = written(store)
    assert before.items() <= after.items() and len(list(store.glob("*.json"))) == len(files)
    assert sorted(fits.table["result"]) == sorted(one.name for one in store.glob("*.json"))
    assert fits.table["hertz"].tolist() == phc.fit_many(files, **OPTIONS).table["hertz"].tolist()


@pytest.mark.parametrize(
    ("reason", "workers"),
    [(StopIteration, 1), (KeyboardInterrupt, 2), *slowly((StopIteration, 2), (KeyboardInterrupt, 1))],
)
def test_an_interruption_gives_what_is_done(files, tmp_path, workers, reason):
    def stop(told):
        if told.done == 2:
            raise reason

    store = tmp_path / "results"
    fits = phc.fit_many(files, workers=workers, store=store, callback=stop, **OPTIONS)
    assert not fits.complete and len(fits) == 2 and "interrupted" in str(fits)
    again = phc.fit_many(files, store=store, **OPTIONS)
    assert again.complete and len(written(store)) == 5


# --- modes that are followed -----------------------------------------------------------------------------------------


def crossing(outputs, recordings=200, noise=2e-4, missing=0.0, seed=0):
    """A table as fits would give it, and the mode of each row: one drifts by 1 % across another, a third stays far."""
    rng = np.random.default_rng(seed)
    shapes = np.array([[1.0, 0.6, 0.3], [1.0, -0.4, -0.8], [0.2, 1.0, -0.7]])[:, :outputs]
    dtype = phc.fit_many(["none"]).table.dtype
    rows, seen, truth = [], [], []
    for k in range(recordings):
        hertz = np.array([10.0 * (0.995 + 0.01 * k / recordings), 10.0, 25.0]) * (1 + noise * rng.standard_normal(3))
        for mode in np.argsort(hertz):
            if rng.random() < missing:
                continue
            row = np.zeros((), dtype)
            row["recording"], row["hertz"], row["hertz_stderr"] = k, hertz[mode], noise * hertz[mode]
            row["damping_ratio"], row["damping_ratio_stderr"] = (
                0.01 * (1 + mode) * (1 + 0.05 * rng.standard_normal()),
                5e-4,
            )
            rows.append(row)
            seen.append(shapes[mode] * np.exp(1j * rng.uniform(0, 6)) + 0.05 * rng.standard_normal(outputs))
            truth.append(mode)
    return phc.FitTable(np.array(rows), tuple(seen), True), np.array(truth)


@pytest.mark.variants
@pytest.mark.parametrize("missing", [0.0, 0.1])
def test_a_mode_that_drifts_and_the_one_it_crosses_are_both_followed(missing):
    for seed in range(2):
        fits, truth = crossing(3, missing=missing, seed=seed)
        tracks = fits.track()
        assert len(tracks) == 3
        for mode in range(3):
            assert len(set(tracks.ids[truth == mode])) == 1
        assert len({tracks.ids[truth == mode][0] for mode in range(3)}) == 3


def test_a_mode_is_found_again_after_shapes_that_were_mixed_where_it_crossed():
    fits, truth = crossing(3)
    mixed = (truth == 0) & (abs(fits.table["recording"] - 100) < 5)
    share = np.array([0.6, 0.5, 0.4, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3])[:, None]
    shapes = np.array(fits.shapes)
    shapes[mixed] = share * [1.0, 0.6, 0.3] + (1 - share) * [1.0, -0.4, -0.8]
    tracks = phc.FitTable(fits.table, tuple(shapes), True).track()
    for mode in range(3):
        assert len(set(tracks.ids[~mixed & (truth == mode)])) == 1


def test_with_one_output_modes_cross_by_their_trends():
    fits, truth = crossing(1, noise=1e-5)
    tracks = fits.track()
    wrong = sum((tracks.ids[truth == mode] != tracks.ids[truth == mode][0]).sum() for mode in range(3))
    # where the two are closer than their errors nothing tells them apart
    assert len(tracks) == 3 and wrong <= 4
    assert tracks.ids[truth == 0][0] == tracks.ids[truth == 0][-1]


def test_a_mode_that_was_away_too_long_is_another_one():
    fits, truth = crossing(3)
    keep = (truth != 2) | (fits.table["recording"] < 50) | (fits.table["recording"] > 80)
    part = phc.FitTable(fits.table[keep], tuple(np.array(fits.shapes)[keep]), True)
    assert len(part.track(gap=10)) == 4 and len(part.track(gap=40)) == 3


def test_what_is_seen_once_is_followed_by_nothing():
    fits, _ = crossing(3, recordings=20)
    lone = fits.table[:1].copy()
    lone["hertz"] = 50.0
    more = phc.FitTable(np.concatenate([fits.table, lone]), (*fits.shapes, fits.shapes[0]), True)
    assert more.track().ids[-1] == -1 and more.track(shortest=1).ids[-1] == 3
    assert "1 rows left over" in str(more.track())


def test_the_tracks_are_rows_of_the_table():
    fits, _ = crossing(3, recordings=30)
    tracks = fits.track()
    assert sum(map(len, tracks)) == len(fits) and [int(one["recording"][0]) for one in tracks] == [0, 0, 0]
    assert "3 modes followed over 30 recordings" in str(tracks)


def test_modes_count_from_1_where_they_are_read_and_from_0_in_the_table(files):
    fits = phc.fit_many(files[:2], **OPTIONS)
    assert fits.table["mode"].tolist() == [0, 0]
    assert [line.split()[1] for line in str(fits).splitlines()[2:]] == ["1", "1"]
    tracks = crossing(3, recordings=30)[0].track()
    assert [line.split()[0] for line in str(tracks).splitlines()[2:]] == ["1", "2", "3"]
    plot = tracks.plot()
    assert sorted(text.get_text()[:7] for text in plot.legend.get_texts()) == ["mode 1 ", "mode 2 ", "mode 3 "]
    plt.close(plot.figure)


@pytest.mark.slow
def test_the_picture_has_frequencies_dampings_and_their_bands():
    fits, _ = crossing(3)
    plot, tracks = fits.plot(), fits.track()
    far, near, below = plot.axes[:, 0]
    # modes that meet share a panel
    assert [len(axis.collections) for axis in (far, near, below)] == [1, 2, 3] and len(plot.legend.get_texts()) == 3
    drawn = sorted(line.get_ydata().tolist() for row in plot.lines[:2, 0] for line in row)
    assert drawn == sorted(one["hertz"].tolist() for one in tracks)
    (band,) = far.collections
    highest = max(tracks, key=lambda one: one["hertz"][0])
    edges = highest["hertz"] + 1.959964 * np.array([[1], [-1]]) * highest["hertz_stderr"]
    heights = band.get_paths()[0].vertices[:, 1]
    assert (heights.max(), heights.min()) == pytest.approx((edges.max(), edges.min()), rel=1e-9)
    moved = fits.plot(relative=True)
    assert moved.axes.shape == (2, 1) and moved.axes[0, 0].get_ylabel() == "Change of natural frequency [%]"
    own = plt.subplots(2)[1]
    assert fits.plot(ax=own).axes[:, 0].tolist() == own.tolist()
    plt.close("all")


@pytest.mark.parametrize("wrong", [{"least_mac": 1.5}, {"frequency_tolerance": 0}, {"window": 0}, {"gap": -1}])
def test_bounds_that_make_no_sense_are_refused(wrong):
    with pytest.raises(phc.StructureError, match=next(iter(wrong))):
        crossing(1, recordings=2)[0].track(**wrong)


# --- the command line ------------------------------------------------------------------------------------------------


def test_the_command_writes_the_table_and_says_what_failed(files, tmp_path):
    table, picture = tmp_path / "modes.csv", tmp_path / "tracks.svg"
    pattern, lossless = str(tmp_path / "0?.csv"), ("--order", 1, "--structure", "lossless")
    done = shell("fit-many", pattern, *lossless, "--table", table, "--plot", picture, "--store", tmp_path / "results")
    assert done.status == 1 and "5 modes of 6 recordings, 1 failed" in done.out and "it must increase" in done.out
    fits = phc.fit_many(files, order=1, structure="lossless")
    with open(table, newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["name"] for row in rows] == fits.table["name"].tolist()
    assert [float(row["hertz"] or "nan") for row in rows] == pytest.approx(fits.table["hertz"].tolist(), nan_ok=True)
    assert [int(row["track"]) for row in rows] == fits.track().ids.tolist()
    assert picture.read_text().startswith("<?xml") and len(list((tmp_path / "results").iterdir())) == 5
    again = shell("fit-many", pattern, *lossless, "--json", "--workers", 2, "--store", tmp_path / "results")
    told = json.loads(again.out)
    assert (
        told["failed"] == 1 and told["rows"][2]["hertz"] is None and told["rows"][5]["hertz"] == fits.table["hertz"][5]
    )


def test_columns_and_weights_reach_the_fits(tmp_path):
    w = np.linspace(0.51, 2.02, 40)
    response = phc.ph(phc.modes(1.0, 1.0))(1j * w) + 0.01 * np.random.default_rng(0).standard_normal(40)
    columns = np.column_stack([w, response.real, response.imag, 1 + w])
    np.savetxt(tmp_path / "r.csv", columns, delimiter=",", header="omega,re,im,trust", comments="")
    words = ("fit-many", tmp_path / "r.csv", "--order", 1, "--structure", "lossless", "--json")
    words += ("--frequency-unit", "rad/s", "--weights", "trust")
    (row,) = json.loads(shell(*words).out)["rows"]
    one = phc.pem(ct.frd(response, w), 1, weights=1 + w, structure="lossless")
    assert row["hertz"] == pytest.approx(one.hertz[0], rel=1e-9)


def test_a_cluster_is_named_by_its_address(files):
    distributed = pytest.importorskip("distributed", reason="the extra 'distributed' is not installed")
    words = ("fit-many", *files[3:], "--order", 1, "--structure", "lossless", "--json")
    with distributed.LocalCluster(n_workers=1, processes=False, dashboard_address=":0") as found:
        there = shell(*words, "--scheduler", found.scheduler_address)
    assert there.status == 0 and there.out == shell(*words).out


def test_callbacks_and_titles_of_other_kinds_are_refused_before_a_fit(tmp_path):
    with pytest.raises(phc.StructureError, match="callback is 'told'; pass a function"):
        phc.fit_many([(np.ones(9), np.arange(9.0))], dt=1.0, callback="told")
    u = np.random.default_rng(0).standard_normal(200)
    result = phc.pem(
        (u, np.cumsum(u)), 1, dt=1.0, structure="free", quantity="free", intersample="zoh", delay=0.0, noise="white"
    )
    for title in (np.ones(2), NotImplemented, 3):
        with pytest.raises(phc.StructureError, match="pass a text"):
            result.report(tmp_path / "fit.html", title=title)
    assert not list(tmp_path.iterdir())
