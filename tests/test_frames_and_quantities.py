"""Data frames of several channels with a time index, and quantities that labels tell."""

import re
import time
from datetime import datetime, timedelta, timezone

import numpy as np
import pytest

import ph_control as phc

STEP = 0.02
FORCE, FIRST, SECOND = np.random.default_rng(0).standard_normal((3, 400))


def signals(**more):
    return {"F [N]": FORCE, "a1 [g]": FIRST, "a2 [g]": SECOND, **more}


def expected():
    return STEP * np.arange(400), np.array([FORCE]), np.array([FIRST, SECOND])


def check(data, unit="s"):
    time, u, y = expected()
    np.testing.assert_allclose(data.time, time, rtol=1e-12)
    np.testing.assert_array_equal(np.atleast_2d(data.inputs), u)
    np.testing.assert_array_equal(data.outputs, y)
    assert (data.input_labels, data.output_labels, data.time_unit) == (["F [N]"], ["a1 [g]", "a2 [g]"], unit)


ROLES = {"input": "F [N]", "output": ["a1 [g]", "a2 [g]"]}


def test_a_mapping_of_arrays_is_a_recording():
    check(phc.recording({"t [s]": STEP * np.arange(400), **signals()}, **ROLES))
    check(phc.recording(signals(), **ROLES, fs=50, time_unit="s"))
    check(phc.recording(signals(junk=400 * ["x"]), **ROLES, dt=STEP), None)
    check(phc.recording(signals(), output=ROLES["output"], dt=STEP), None)


def test_a_column_is_found_without_its_unit():
    check(phc.recording(signals(), input="F", output=["a1", "A2"], dt=STEP), None)
    check(phc.recording(signals(), input="f [n]", output=["a1 [g]", "a2"], dt=STEP), None)


@pytest.mark.parametrize("kind", ["seconds", "dates", "zone", "durations", "name", "column"])
def test_the_index_of_a_pandas_frame_is_the_time(kind):
    pandas = pytest.importorskip("pandas", reason="pandas is not installed")
    start = pandas.Timestamp("2026-03-29 00:59:58")
    index = {
        "seconds": pandas.Index(STEP * np.arange(400), name="t [s]"),
        "dates": pandas.date_range(start, periods=400, freq="20ms"),
        "zone": pandas.date_range(start, periods=400, freq="20ms", tz="Europe/Berlin"),
        "durations": pandas.timedelta_range("1s", periods=400, freq="20ms"),
        "name": pandas.Index(20 * np.arange(400), name="time (ms)"),
        "column": pandas.RangeIndex(400),
    }[kind]
    columns = {"time": pandas.date_range(start, periods=400, freq="20ms")} if kind == "column" else {}
    data = phc.recording(pandas.DataFrame(signals(**columns), index=index), **ROLES)
    if kind == "name":
        assert data.time_unit == "ms" and data.time[1] == 20.0
    else:
        check(data) if kind != "durations" else np.testing.assert_allclose(np.diff(data.time), STEP, rtol=1e-9)


def test_frames_of_polars_and_xarray_are_read():
    polars = pytest.importorskip("polars", reason="polars is not installed")
    start = datetime(2026, 1, 1, tzinfo=timezone.utc)
    times = [start + timedelta(milliseconds=20 * k) for k in range(400)]
    check(phc.recording(polars.DataFrame({"time": times, **signals()}), **ROLES))
    xarray = pytest.importorskip("xarray", reason="xarray is not installed")
    coordinate = ("time", STEP * np.arange(400), {"units": "s"})
    dataset = xarray.Dataset({name: ("time", x) for name, x in signals().items()}, coords={"time": coordinate})
    check(phc.recording(dataset, **ROLES))


@pytest.mark.skipif(not hasattr(time, "tzset"), reason="the zone of this machine cannot be changed")
def test_clocks_without_a_zone_do_not_depend_on_that_of_the_machine(monkeypatch):
    pandas = pytest.importorskip("pandas", reason="pandas is not installed")
    # summer time begins in the middle of the record
    clock = [datetime(2026, 3, 29, 1, 59, 56) + timedelta(milliseconds=20 * k) for k in range(400)]
    frame = pandas.DataFrame({"time": pandas.Series(clock, dtype=object), **signals()})
    try:
        monkeypatch.setenv("TZ", "Europe/Berlin")
        time.tzset()
        check(phc.recording(frame, **ROLES))
    finally:
        monkeypatch.undo()
        time.tzset()


def test_a_fit_takes_the_index_of_a_frame_of_one_input_and_one_output():
    pandas = pytest.importorskip("pandas", reason="pandas is not installed")
    u = np.random.default_rng(1).standard_normal(300)
    plant = phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]))
    y = phc.forced_response(plant, 0.1 * np.arange(300), u, intersample="zoh").outputs
    index = pandas.Index(0.1 * np.arange(300), name="t / s")
    result = phc.pem(pandas.DataFrame({"u": u, "v": y}, index=index), 2)
    np.testing.assert_allclose(result.d, [0.5, 2.0], rtol=1e-6)
    assert result.time_unit == "s"
    frame = pandas.DataFrame({"u": u, "v [m/s]": y, "room [C]": y}, index=index)
    with pytest.raises(phc.StructureError, match=r"which column is the input .* phc.recording\(frame, input="):
        phc.pem(frame)


@pytest.mark.parametrize(
    "keywords, words",
    [
        ({}, "no column of the data frame is called time or t, and its index holds no times"),
        ({"dt": STEP, "fs": 10}, "dt = 0.02 contradicts fs, whose step is 0.1"),
        ({"dt": STEP}, "which column is the input and which the output? 3 are left"),
        (
            {"dt": STEP, "input": "force"},
            "input names 'force', which is not a signal; the columns are 'F [N]', 'a1 [g]'",
        ),
        ({"dt": STEP, "input": "F [N]", "output": "F [N]"}, "column 'F [N]' is chosen twice"),
        ({"dt": STEP, "input": "a"}, "input names 'a', which is not a signal"),
        ({"dt": STEP, "input": []}, "pass input=False for a recording without input"),
        ({"time": "clock"}, "time is 'clock'; the columns are"),
        ({"fs": 0}, "fs is 0; it must be one positive number"),
    ],
)
def test_what_a_frame_does_not_tell_is_asked_for(keywords, words):
    with pytest.raises(phc.StructureError, match=re.escape(words)):
        phc.recording(signals(), **keywords)


# --- quantities ------------------------------------------------------------------------------------------------------


def fitted(*labels, **keywords):
    rng = np.random.default_rng(2)
    plant = phc.ph(phc.modes([0.5], [1.0]))
    t, u = 0.1 * np.arange(400), rng.standard_normal(400)
    y = phc.forced_response(plant, t, u, intersample="zoh").outputs
    frame = {"t": t, "u": u} | {label: y + 0.1 * rng.standard_normal(400) for label in labels}
    data = phc.recording(frame, input="u", output=list(labels))
    return phc.pem(data, 1, structure="free", **keywords)


@pytest.mark.variants
@pytest.mark.parametrize(
    "label, quantity",
    [
        ("Accel (g)", "acceleration"), ("tipAccel", "acceleration"), ("ch3 [m/s^2]", "acceleration"),
        ("ch3 (mm/s\u00b2)", "acceleration"), ("H [(m/s^2)/N]", "acceleration"), ("acc_1", "acceleration"),
        ("x (mm)", "displacement"), ("Position", "displacement"), ("phi [rad]", "displacement"),
        ("laser [mm/s]", "velocity"), ("tip velocity", "velocity"), ("w [rpm]", "velocity"),
        ("gauge [\u00b5\u03b5]", "free"), ("strain 4", "free"),
        ("y", "velocity"), ("channel 3 [V]", "velocity"), ("accessory", "velocity"), ("mg", "velocity"),
    ],
)  # fmt: skip
def test_a_label_or_its_unit_tells_what_is_measured(label, quantity):
    assert fitted(label).quantities == (quantity,)
    assert fitted(label, quantity="free").quantities == ("free",)


def test_the_summary_says_what_was_taken_to_be_measured():
    text = fitted("Accel (g)", "x (mm)").summary()
    assert "displacement of 'x (mm)'; acceleration of 'Accel (g)'" in text
    assert "velocity, as given or by default\n" in fitted("y").summary()
    for given in (fitted("v [mm/s]"), fitted("velocity [m/s^2]", quantity="velocity")):
        assert "measured        velocity\n" in given.summary()


def test_what_labels_leave_open_is_asked_for():
    with pytest.raises(phc.StructureError, match="quantity of output 'ch 2' is unknown"):
        fitted("Accel (g)", "ch 2")
    assert fitted("Accel (g)", "ch 2", quantity={"ch 2": "free"}).quantities == ("acceleration", "free")
    with pytest.raises(phc.StructureError, match="suggests both acceleration and velocity; pass quantity"):
        fitted("velocity [m/s^2]")


def test_ports_and_quantities_are_named_with_or_without_the_unit_of_a_label():
    labels, given = ("acc 1 [m/s^2]", "acc 2 [m/s^2]"), {"quantity": {"acc 2": "velocity"}}
    by_name, by_number = fitted(*labels, ports={"acc 1": "u"}, **given), fitted(*labels, ports=[(0, 0)], **given)
    assert by_name.ports == by_number.ports == ((0, 0),)
    assert by_name.quantities == ("acceleration", "velocity")
    with pytest.raises(phc.StructureError, match="no output 'acc'"):
        fitted("acc [m/s^2]", "acc [g]", ports={"acc": "u"})
    assert fitted("acc", "acc [g]", ports={"acc": "u"}).ports == ((0, 0),)
