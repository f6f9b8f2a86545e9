"""Data of every kind become checked experiments, and nothing of the user's is touched."""

from __future__ import annotations

import pickle
import re
import tracemalloc
from dataclasses import FrozenInstanceError, replace
from decimal import Decimal
from fractions import Fraction

import control as ct
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import ph_control as phc
from ph_control.identification.data.experiments import as_experiments, as_record
from ph_control.identification.data.frequency_record import FrequencyRecord
from ph_control.identification.data.time_record import Record

U = np.array([1.0, 0.0, 2.0, 0.0, -1.0, 3.0])
Y = np.array([0.0, 1.0, np.nan, 2.0, 3.0, 0.5])
STEP = 0.1
EPS = np.finfo(float).eps


class Frame:
    """The least that a data frame has, and a mark that nothing of it was written to."""

    def __init__(self, **columns):
        self._columns = columns
        self.columns = list(columns)

    def __getitem__(self, label):
        return self._columns[label]


class Series:
    """A column that is no array, as data frames have them; its missing values are known to itself only."""

    class Missing:
        def __bool__(self):
            raise TypeError("whether the missing is true is not known")

    NA = Missing()

    def __init__(self, values):
        self._values = list(values)

    def __len__(self):
        return len(self._values)

    def __array__(self, dtype=None, copy=None):
        return np.array(self._values, dtype=object)

    def to_numpy(self, na_value=NA):
        return np.array([na_value if one is self.NA else one for one in self._values], dtype=object)


def response(time=None, u=U, y=Y, **options):
    time = STEP * np.arange(len(y)) if time is None else time
    return ct.TimeResponseData(time, y, inputs=u, issiso=True, **options)


def frf(values=(1.0, 2.0 + 1j, 0.5j), omega=(1.0, 2.0, 3.0), **options):
    return ct.FrequencyResponseData(np.array(values), np.array(omega), **options)


def only(data, dt=None, **options):
    (record,) = as_experiments(data, dt, **options)
    return record


def assert_same(one, other):
    assert type(one) is type(other)
    assert one.__dict__.keys() - {"observed"} == other.__dict__.keys() - {"observed"}
    for name in one.__dict__.keys() - {"observed"}:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


# --- one record in time ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("container", [tuple, list])
@pytest.mark.parametrize("kind", [list, tuple, np.array, Series, np.ma.array, lambda x: x[:, None], lambda x: x[None]])
def test_a_pair_of_signals_of_any_kind_is_one_driven_record(container, kind):
    record = only(container((kind(U), kind(Y))), STEP)
    assert isinstance(record, Record) and record.driven and record.samples == 6
    np.testing.assert_array_equal(record.u, U)
    np.testing.assert_array_equal(record.y, Y)
    np.testing.assert_array_equal(record.time, STEP * np.arange(6))
    assert (record.dt, record.input_label, record.output_label, record.title) == (STEP, "u", "y", "")


@pytest.mark.parametrize("dtype", [bool, np.int8, np.uint64, np.float32, np.longdouble, ">f8", object])
def test_numbers_of_any_real_type_become_doubles(dtype):
    u = np.array([1, 0, 1], dtype=dtype)
    record = only((u, u), STEP)
    assert record.u.dtype == record.y.dtype == np.float64
    assert record.u.tolist() == record.y.tolist() == [1.0, 0.0, 1.0]


def test_complex_numbers_without_imaginary_part_are_real_also_where_some_are_missing():
    np.testing.assert_array_equal(only((U + 0j, Y + 0j), STEP).y, Y)
    with pytest.raises(phc.StructureError, match="the output is complex: largest imaginary part 3"):
        as_experiments((U, 1j * Y), STEP)


@pytest.mark.parametrize(
    "y",
    [
        [0.0, None, 2.5],
        np.array([Fraction(0), None, Decimal("2.5")], dtype=object),
        np.ma.array([0, 7, 2.5], mask=[0, 1, 0]),
        Series([0, Series.NA, 2.5]),
        [0.0, float("nan"), 2.5],
    ],
)
def test_every_mark_of_a_missing_output_is_nan_and_refused_of_an_input(y):
    record = only((U[:3], y), STEP)
    np.testing.assert_array_equal(record.y, [0.0, np.nan, 2.5])
    assert record.observed.tolist() == [True, False, True]
    with pytest.raises(phc.StructureError, match=r"the input is (not finite|masked) at sample 1"):
        as_experiments((y, U[:3]), STEP)


def test_without_input_a_record_is_autonomous_and_stays_so():
    record = only((None, Y), STEP)
    assert not record.driven and not record.u.any() and record.samples == 6
    back = record.as_response()
    assert back.ninputs == 0 and back.inputs is None
    assert_same(only(back), replace(record, title="Recording"))
    plant = phc.ph(phc.modes([1.0], [1.0]))
    assert not only(phc.initial_response(plant, np.arange(5.0), [1.0, 0.0])).driven
    assert not only(ct.TimeResponseData(np.arange(3.0), U[:3], inputs=np.zeros((0, 3)), issiso=True)).driven


def test_a_response_keeps_its_labels_its_title_and_its_time():
    time = 5.0 + STEP * np.arange(6)
    record = only(response(time, input_labels=["force [N]"], output_labels=["velocity"], title="run 7"))
    assert (record.input_label, record.output_label, record.title) == ("force [N]", "velocity", "run 7")
    assert record.dt == STEP and record.driven
    np.testing.assert_array_equal(record.time, time)
    back = record.as_response()
    assert (back.input_labels, back.output_labels, back.title) == (["force [N]"], ["velocity"], "run 7")
    assert_same(only(back), record)


def test_every_trace_is_an_experiment_that_keeps_its_label():
    runs = [
        ct.TimeResponseData(STEP * np.arange(6), y, inputs=U * k, issiso=True) for k, y in ((1, Y), (2, -Y), (3, 2 * Y))
    ]
    both = ct.combine_time_responses(runs, trace_labels=["up", "down", "again"])
    records = as_experiments(both)
    assert [record.title for record in records] == ["up", "down", "again"]
    for record, run in zip(records, runs, strict=True):
        assert_same(replace(record, title=""), only(run))
    # python-control keeps the inputs of several traces also without an axis for the one input
    flat = ct.TimeResponseData(np.arange(6.0), np.stack([Y, -Y]), inputs=np.stack([U, 2 * U]), multi_trace=True)
    assert [record.u[0] for record in as_experiments(flat)] == [1.0, 2.0]
    assert [record.title for record in as_experiments([both, runs[0]])] == ["up", "down", "again", ""]
    spoiled = ct.combine_time_responses([runs[0], response(y=np.where(Y == 2, np.inf, Y))])
    with pytest.raises(phc.StructureError, match=r"^trace 2: the output is infinite at sample 3"):
        as_experiments(spoiled)
    with pytest.raises(phc.StructureError, match=r"^experiment 2: trace 2: the output is infinite at sample 3"):
        as_experiments([runs[0], spoiled])


@settings(deadline=None, max_examples=30, derandomize=True)
@given(
    k=st.integers(1, 200), rate=st.booleans(), samples=st.integers(2, 50), origin=st.floats(-1e6, 1e6),
)  # fmt: skip
def test_the_origin_of_time_changes_the_time_only(k, rate, samples, origin):
    step = 1 / k if rate else k / 100
    u = np.arange(float(samples))
    here, there = (only(response(start + step * u, u, u)) for start in (0.0, origin))
    assert here.dt == there.dt == step
    np.testing.assert_array_equal(here.y, there.y)
    np.testing.assert_array_equal(there.time, origin + step * u)


@settings(deadline=None, max_examples=20, derandomize=True)
@given(step=st.floats(1e-90, 1e90), samples=st.integers(2, 40))
def test_a_step_of_any_size_is_found_to_rounding(step, samples):
    u = np.arange(float(samples))
    assert abs(only(response(step * u, u, u)).dt - step) <= 16 * EPS * step


def test_signals_of_any_scale_are_taken_as_they_are():
    for scale in (1e-9, 1e9, 1e-99, 1e99):
        record = only((scale * U, Y / scale), scale)
        np.testing.assert_array_equal(record.u, scale * U)
        np.testing.assert_array_equal(record.y, Y / scale)
        assert record.dt == scale
    for scale in (1e-101, 1e101):
        with pytest.raises(phc.StructureError, match=r"the input is of size .* choose another unit"):
            as_experiments((scale * U, Y), STEP)
        with pytest.raises(phc.StructureError, match=r"the output is of size .* choose another unit"):
            as_experiments((U, -scale * Y), STEP)


# --- nothing is modified, nothing is copied without need -------------------------------------------------------------


def test_records_are_locked_copies_and_the_data_stay_as_they_were():
    u, y, omega = U.copy(), Y.copy(), np.array([2.0, 1.0])
    values = np.array([1.0, 2j])
    record, spectrum = only((u, y), STEP), only(ct.FrequencyResponseData(values, omega), weights=omega)
    for array in (u, y, omega, values):
        array[:] = 7
        assert array.flags.writeable
    assert record.u[0] == 1.0 and record.y[1] == 1.0 and spectrum.omega.tolist() == [1.0, 2.0]
    arrays = [record.time, record.u, record.y, record.observed]
    arrays += [spectrum.omega, spectrum.response, spectrum.weights, spectrum.observed]
    for array in arrays:
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    for one, name in ((record, "dt"), (record, "observed"), (spectrum, "omega")):
        with pytest.raises(FrozenInstanceError):
            setattr(one, name, None)


@pytest.fixture
def disk(tmp_path):
    """Make a memory-mapped array."""

    def make(values, mode="r"):
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}.npy"
        np.save(path, values)
        return np.load(path, mmap_mode=mode)

    return make


def test_memory_mapped_doubles_stay_on_the_disk(disk):
    table = disk(np.stack([U, Y], axis=1))
    record = only((table[:, 0], table[:, 1]), STEP)
    assert np.shares_memory(record.u, table) and np.shares_memory(record.y, table)
    np.testing.assert_array_equal(record.y, Y)
    row = disk(Y[None])
    assert np.shares_memory(only((None, row), STEP).y, row)
    with pytest.raises(phc.StructureError, match="the input is not finite at sample 2"):
        as_experiments((table[:, 1], table[:, 0]), STEP)


@pytest.mark.parametrize("mode, dtype", [("r+", float), ("c", float), ("r", np.float32), ("r", ">f8"), ("r", np.int16)])
def test_mapped_arrays_that_may_change_or_are_no_doubles_are_copied(disk, mode, dtype):
    mapped = disk(np.arange(6).astype(dtype), mode)
    record = only((mapped, mapped), STEP)
    assert not np.shares_memory(record.u, mapped) and record.u.tolist() == list(range(6))
    assert mapped.flags.writeable == (mode != "r")


def allocated(call):
    """Bytes at the peak of a call."""
    tracemalloc.start()
    call()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def test_a_long_record_takes_no_more_memory_than_its_signals_and_its_mask(disk):
    T, spare = 1_000_000, 4_000_000
    signal = np.ones(T)
    mapped = disk(signal)
    assert allocated(lambda: only((mapped, mapped), STEP)) < spare
    assert allocated(lambda: only((mapped, mapped), STEP).observed) < T + spare
    assert 16 * T < allocated(lambda: only((signal, signal), STEP)) < 16 * T + spare
    assert 24 * T < allocated(lambda: only((signal, signal), STEP).time) < 24 * T + spare


def test_faults_are_found_and_counted_beyond_the_first_block():
    u = np.zeros(200_000)
    u[[66_000, 150_000, 199_999]] = np.nan
    with pytest.raises(phc.StructureError, match="not finite at sample 66000: 3 of 200000 samples"):
        as_experiments((u, np.zeros(200_000)), STEP)
    with pytest.raises(phc.StructureError, match="the output is infinite at sample 199999"):
        as_experiments((np.zeros(200_000), np.where(np.arange(200_000) == 199_999, -np.inf, u)), STEP)


def test_the_mask_is_made_once_and_records_survive_copying_and_pickling():
    record, spectrum = only((U, Y), STEP), only(frf((1.0, np.nan, 3.0)))
    for one in (record, spectrum):
        assert one.observed is one.observed
        assert_same(pickle.loads(pickle.dumps(one)), one)
    # a changed output has a mask of its own
    assert replace(record, y=U).observed.all() and not record.observed.all()
    assert record == record and record != replace(record) and len({record, spectrum}) == 2


def test_a_record_can_be_made_of_its_parts_in_order():
    assert Record(np.arange(3.0), 1.0, U[:3], Y[:3], "a", "b").driven
    assert not Record(np.arange(3.0), 1.0, U[:3], Y[:3], "a", "b", False).driven


# --- data frames -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("label", ["t", "time", "Time [s]", "timestamp", "t / s"])
def test_the_time_of_a_data_frame_is_known_by_its_label_wherever_it_stands(label):
    columns = {"force": U, label: 2.0 + STEP * np.arange(6), "velocity": Y}
    record = only(Frame(**columns))
    np.testing.assert_array_equal(record.u, U)
    np.testing.assert_array_equal(record.y, Y)
    assert (record.dt, record.time[0], record.input_label, record.output_label) == (STEP, 2.0, "force", "velocity")
    assert_same(only(Frame(**{name: Series(column) for name, column in columns.items()})), record)


@pytest.mark.parametrize("step, digits", [(1 / 3, 5), (1 / 44100, 9), (0.02, 2), (1 / 7, 12)])
def test_a_data_frame_gives_the_record_that_its_file_gives(tmp_path, step, digits):
    time = np.array([round(k * step, digits) for k in range(60)])
    u, y = np.random.default_rng(0).standard_normal((2, 60))
    path = tmp_path / "run.csv"
    rows = "\n".join(f"{a!r},{b!r},{c!r}" for a, b, c in zip(time.tolist(), u.tolist(), y.tolist(), strict=True))
    path.write_text(f"time [s],u,y\n{rows}\n")
    read = only(phc.read_csv(path))
    assert read.dt == step and read.title == "run.csv"
    assert_same(only(Frame(**{"time [s]": time, "u": u, "y": y})), replace(read, title=""))


def test_a_data_frame_without_time_needs_the_step():
    record = only(Frame(u=U, y=Y), STEP)
    assert record.dt == STEP and record.time[0] == 0.0 and record.input_label == "u"
    assert not only(Frame(t=STEP * np.arange(6), u=U), output_needed=False).observed.any()


@pytest.mark.parametrize(
    "columns, dt, words",
    [
        ({}, None, "no column of the data frame is called time or t"),
        ({}, 1.0, "0 columns are left beside the time"),
        ({"u": U, "y": Y}, None, "or give the time between samples with dt (the columns"),
        ({"T": U, "u": U, "y": Y}, None, "the columns are 'T', 'u', 'y'"),
        ({"t": U, "y": Y}, None, "1 columns are left beside the time; choose with phc.recording"),
        ({"t": U, "y": Y}, None, "of a free motion (None, y), with dt (the columns are 't', 'y')"),
        ({"t": U, "u": U, "y": Y, "z": Y}, None, "which column is the input and which the output? 3 columns are left"),
        ({"t": U, "time": U, "u": U, "y": Y}, None, "'t' and 'time' of the data frame may both be the time"),
        ({"t": np.arange(6.0), "u": U, "y": Y}, 2.0, "dt = 2 contradicts the time (column 't'), whose step is 1"),
        ({"t": U, "u": U, "y": U}, None, "the time (column 't') does not increase"),
        ({"t": np.arange(6.0), "u": Y, "y": U}, None, "the input (column 'u') is not finite at sample 2"),
        ({"t": Y, "u": U, "y": U}, None, "the time (column 't') is not finite at sample 2"),
        ({"t": np.arange(6.0), "u": U, "y": Y[:4]}, None, "the input has 6 samples, the output 4"),
        ({"t": np.arange(4.0), "u": U, "y": Y}, None, "the output has 6 samples, the time 4"),
        ({"t": np.arange(6.0), "u": U, "y": ["on"] * 6}, None, "the output (column 'y') does not hold real numbers"),
    ],
)  # fmt: skip
def test_a_data_frame_that_is_no_recording_says_what_is_missing(columns, dt, words):
    with pytest.raises(phc.StructureError, match=re.escape(words)):
        as_experiments(Frame(**columns), dt)


def test_columns_that_cannot_be_told_apart_or_read_are_refused():
    twice = Frame(t=U, u=U)
    twice.columns = ["t", "u", "u"]
    with pytest.raises(phc.StructureError, match="2 columns called 'u'"):
        as_experiments(twice)

    class Lazy(Frame):
        def __getitem__(self, label):
            raise TypeError("not evaluated")

    with pytest.raises(phc.StructureError, match="column 't' of the Lazy cannot be read: not evaluated"):
        as_experiments(Lazy(t=U, u=U, y=Y))


def test_a_wide_data_frame_is_not_listed_to_its_end():
    with pytest.raises(phc.StructureError, match="'c29' and 10 more") as caught:
        as_experiments(Frame(**{f"c{k}": U for k in range(40)}))
    assert len(str(caught.value)) < 600


# --- frequency responses ---------------------------------------------------------------------------------------------


def test_a_frequency_response_keeps_its_values_its_labels_and_its_repeats():
    data = frf((1.0, 2.0, 3.0, 4.0, 5.0), (3.0, 0.0, 1.0, 3.0, 1.0), inputs=["F"], outputs=["v"], name="beam")
    record = only(data, weights=[10, 20, 30, 40, 50])
    assert isinstance(record, FrequencyRecord) and record.samples == 5
    assert record.omega.tolist() == [0.0, 1.0, 1.0, 3.0, 3.0]
    assert record.response.tolist() == [2.0, 3.0, 5.0, 1.0, 4.0]
    assert record.weights.tolist() == [20.0, 30.0, 50.0, 10.0, 40.0]
    assert (record.input_label, record.output_label, record.title) == ("F", "v", "beam")
    assert data.omega.tolist() == [3.0, 0.0, 1.0, 3.0, 1.0]
    assert only(data).weights.tolist() == 5 * [1.0]
    many = only(frf(np.arange(200.0), np.arange(200.0) % 2))
    assert many.response.tolist() == [*range(0, 200, 2), *range(1, 200, 2)]


def test_missing_points_are_kept_but_not_observed():
    record = only(frf((complex(np.nan, 0), 2.0, complex(0, np.nan)), (0.0, 1.0, 2.0)))
    assert record.observed.tolist() == [False, True, False]
    back = record.as_response()
    assert back.ninputs == back.noutputs == 1 and back.omega.tolist() == [0.0, 1.0, 2.0]
    assert_same(only(back), record)


def test_labels_that_python_control_refuses_are_given_back_changed():
    record = replace(only(frf()), input_label="motor.torque", title="hammer")
    back = record.as_response()
    assert back.input_labels == ["motor_torque"] and back.title == "hammer"
    np.testing.assert_array_equal(back.frdata[0, 0], record.response)


def test_a_frequency_record_made_by_hand_has_unit_weights_and_copies():
    omega = np.array([1.0, 2.0])
    record = FrequencyRecord(omega, [1, 2j])
    omega[0] = 9.0
    assert record.omega.tolist() == [1.0, 2.0] and record.weights.tolist() == [1.0, 1.0]
    assert record.response.dtype == complex
    assert only(record) is record
    assert only(record, weights=[1.0, 3.0]).weights.tolist() == [1.0, 3.0]


@pytest.mark.parametrize(
    "data, options, words",
    [
        (frf((1, 2), (-1, 1)), {}, "omega is negative at point 0: -1, allowed >= 0"),
        (frf((1, 2), (1, -1e-300)), {}, "omega is negative at point 1"),
        (frf((1, 2), (1, np.nan)), {}, "omega is not finite"),
        (frf((1, np.inf), (1, 2)), {}, "the response is infinite at point 1 (omega = 2); mark missing points with NaN"),
        (frf((1, complex(np.nan, np.inf)), (1, 2)), {}, "the response is infinite at point 1"),
        (frf((1e150, 1), (1, 2)), {}, "the response is of size 1e+150"),
        (frf((1, 2), (1e150, 1)), {}, "omega is of size 1e+150"),
        (frf(np.ones((2, 1, 3))), {}, "1 inputs and 2 outputs ('u[0]'; 'y[0]', 'y[1]'), and a fit takes one of each"),
        (frf(dt=0.5), {}, "that of a sampled system (dt = 0.5)"),
        (frf(dt=True), {}, "that of a sampled system (of unknown step)"),
        (frf(), {"dt": 0.5}, "dt is the step of a record in time, and a frequency response has none"),
        (frf(), {"weights": [1, 2]}, "weights have shape (2,); with a response of shape (1, 1, 3) they must be (1"),
        (frf(), {"weights": 2.0}, "weights have shape ()"),
        (frf(), {"weights": [1, 2, 0]}, "weights are not positive: entry 2 is 0"),
        (frf(), {"weights": [1, 1e150, 1]}, "the largest weight is of size 1e+150"),
        (frf(), {"weights": [1, np.inf, 1]}, "weights is not finite"),
        ([frf(), frf()], {"weights": np.ones(3)}, "weights are a ndarray; with a list of 2 experiments"),
        ([frf(), frf()], {"weights": [np.ones(3)]}, "weights has 1 entries for 2 experiments"),
        ([frf(), frf()], {"weights": [None, [1, 2]]}, "experiment 2: weights have shape (2,)"),
        ((U, Y), {"dt": 1.0, "weights": np.ones(6)}, "weights belong to frequency responses"),
        ([response()], {"weights": [np.ones(6)]}, "experiment 1: weights belong to frequency responses"),
    ],
)  # fmt: skip
def test_frequency_responses_that_cannot_be_fitted_are_refused_with_the_reason(data, options, words):
    with pytest.raises(phc.StructureError, match=re.escape(words)):
        as_experiments(data, **options)


def test_a_frequency_response_without_points_cannot_be_identified():
    with pytest.raises(phc.IdentificationError, match="no frequencies"):
        as_experiments(frf((), ()))


# --- several experiments ---------------------------------------------------------------------------------------------


def test_experiments_keep_their_own_length_step_start_and_kind():
    data = [(U, Y), (None, Y[:3]), response(100 + 0.5 * np.arange(6)), Frame(t=3 + np.arange(6.0), u=U, y=Y)]
    records = as_experiments(data, dt=[0.2, 0.3, None, 1.0])
    assert [record.samples for record in records] == [6, 3, 6, 6]
    assert [record.dt for record in records] == [0.2, 0.3, 0.5, 1.0]
    assert [record.time[0] for record in records] == [0.0, 0.0, 100.0, 3.0]
    assert [record.driven for record in records] == [True, False, True, True]
    # one step for all those that have none of their own, and the same for the others
    assert [record.dt for record in as_experiments([(U, Y), (None, Y), response()], dt=STEP)] == 3 * [STEP]
    for steps in ((0.2, 0.3), np.array([0.2, 0.3])):
        assert [record.dt for record in as_experiments(data[:2], dt=steps)] == [0.2, 0.3]


EXPERIMENTS = {
    "responses": lambda k: response(y=k * Y),
    "pairs": lambda k: (U, k * Y),
    "autonomous": lambda k: (None, k * Y),
    "frames": lambda k: Frame(t=STEP * np.arange(6), u=U, y=k * Y),
    "records": lambda k: Record(STEP * np.arange(6), STEP, U, k * Y),
    "spectra": lambda k: frf((k, 2.0, 3.0)),
    "spectral records": lambda k: FrequencyRecord(np.arange(3.0), np.array([k, 1, 2])),
}


@pytest.mark.parametrize("name", EXPERIMENTS)
@settings(deadline=None, max_examples=15, derandomize=True)
@example(factors=[1, 2], container=list)
@example(factors=[1, 2], container=tuple)
@given(
    factors=st.lists(st.integers(1, 9), min_size=1, max_size=5),
    container=st.sampled_from([list, tuple]),
)
def test_a_list_or_tuple_of_experiments_is_the_sequence_of_each_alone(name, factors, container):
    make = EXPERIMENTS[name]
    dt = STEP if name in ("pairs", "autonomous") else None
    together = as_experiments(container(make(k) for k in factors), dt)
    assert len(together) == len(factors)
    for record, k in zip(together, factors, strict=True):
        assert_same(record, only(make(k), dt))
    assert as_experiments(together) == together


def test_lists_of_responses_made_by_python_control_are_experiments():
    systems = [ct.tf([1], [1, k]) for k in (1, 2)]
    assert len(as_experiments(ct.step_response(systems, np.arange(3.0)))) == 2
    assert len(as_experiments(ct.frequency_response(systems, np.arange(1.0, 3.0)))) == 2


def test_two_lists_or_tuples_of_numbers_are_a_pair_of_signals():
    for data in ([[1, 2, 3], [4, 5, 6]], ((1, 2, 3), (4, 5, 6)), [(1, 2, 3), (4, 5, 6)], [U[:3], U[3:]]):
        record = only(data, STEP)
        assert record.samples == 3 and np.array_equal(record.u, data[0]) and np.array_equal(record.y, data[1])
    # nor are two samples two experiments
    for number in (int, np.float64, np.array, Fraction):
        assert only([(number(1), number(2)), (number(3), number(4))], STEP).y.tolist() == [3.0, 4.0]


@pytest.mark.parametrize(
    "data, options, words",
    [
        ([], {}, "data is an empty list; pass at least one experiment"),
        ((), {}, "data is an empty tuple"),
        ([response(), frf()], {}, "experiment 2: this is a frequency response, the first is a record in time"),
        ([frf(), (U, Y)], {}, "experiment 2: this is a record in time, the first is a frequency response"),
        ([[response(), response()], response()], {}, "experiment 1: this is a list of experiments; lists are not"),
        ([[response()]], {}, "experiment 1: this is a list of experiments; lists are not nested"),
        ([(response(), response())], {}, "experiment 1: this is a tuple of experiments; lists are not nested"),
        ([(U, Y), [(U, Y), (U, Y)]], {"dt": 1.0}, "experiment 2: this is a list of experiments"),
        (((response(), response()), (response(), response())), {}, "experiment 1: this is a tuple of experiments"),
        ([[U, Y], [U, Y]], {"dt": 1.0}, "several experiments are a list of tuples, [(u1, y1)"),
        ([[U, Y], [U, Y], [U, Y]], {"dt": 1.0}, "experiment 1: this is a list; pass"),
        ((U, U, Y), {"dt": 1.0}, "experiment 1: this is a ndarray; pass"),
        ([1.0, 2.0, 3.0], {"dt": 1.0}, "experiment 1: this is a float"),
        ([response(), U], {}, "experiment 2: this is a ndarray"),
        ([response(), None], {}, "experiment 2: this is a NoneType"),
        ((one for one in [response()]), {}, "data is a generator; pass"),
        ((one for one in [response()]), {}, "put what it yields in a list"),
        ("run.csv", {}, "data is a str; pass"),
        ("run.csv", {}, "phc.read_csv reads a file"),
        ({"u": U, "y": Y}, {}, "data is a dict"),
        (np.stack([U, Y]), {"dt": 1.0}, "data is a ndarray"),
        (None, {}, "data is a NoneType"),
        ([(U, Y), (U, Y)], {"dt": [1.0, 2.0, 3.0]}, "dt has 3 entries for 2 experiments; give one for each"),
        ([(U, Y), (U, Y)], {"dt": [1.0, None]}, "experiment 2: dt is missing"),
        ([(U, Y), (U, Y)], {"dt": [1.0, -1.0]}, "experiment 2: dt is -1.0"),
        ([(U, Y), (np.where(U == 3, np.nan, U), Y)], {"dt": 1.0}, "experiment 2: the input is not finite at sample 5"),
        ([(U, Y), (U, U[:5])], {"dt": 1.0}, "experiment 2: the input has 6 samples, the output 5"),
        ([(U, Y), (None, None)], {"dt": 1.0}, "experiment 2: the record has neither input nor output"),
        ([response(), response()], {"dt": [None, 0.2]}, "experiment 2: dt = 0.2 contradicts the time of the record"),
        ((U, Y), {}, "dt is missing"),
        ((U, Y), {"dt": [0.1]}, "dt is [0.1]; it must be one positive number"),
        ((None, None), {"dt": 1.0}, "neither input nor output"),
        ((np.zeros((0, 3)), None), {"dt": 1.0}, "neither input nor output"),
        ((np.zeros((0, 3)), None), {"dt": 1.0, "output_needed": False}, "neither input nor output"),
        ((U, None), {"dt": 1.0}, "the record has no output"),
        ((1.0, 2.0), {"dt": 1.0}, "the input has shape ()"),
        ((U, np.array(["1"] * 6, dtype=object)), {"dt": 1.0}, "does not hold real numbers"),
        (([10**400, 1, 2], U[:3]), {"dt": 1.0}, "does not hold real numbers"),
    ],
)  # fmt: skip
def test_what_is_no_experiment_is_refused_with_its_place_and_the_reason(data, options, words):
    with pytest.raises(phc.StructureError, match=re.escape(words)):
        as_experiments(data, **options)


def test_responses_of_several_signals_say_what_to_select():
    two = ct.step_response(ct.ss(-np.eye(2), np.eye(2), np.ones((1, 2)), 0), np.arange(3.0))
    words = (
        r"2 inputs and 1 outputs \('u\[0\]', 'u\[1\]'; 'y\[0\]'\).*pass the pair \(data\.u\[j\], data\.y\[i\]\) with dt"
    )
    with pytest.raises(phc.StructureError, match=words):
        as_experiments(two)
    # what the message says works
    wide = ct.forced_response(ct.ss(-np.eye(2), np.eye(2), np.eye(2), 0), np.arange(6.0), np.stack([U, 2 * U]))
    np.testing.assert_array_equal(only((wide.u[1], wide.y[0]), 1.0).u, 2 * U)


@pytest.mark.parametrize("samples", [0, 1])
@pytest.mark.parametrize(
    "make",
    [
        lambda n: ((U[:n], Y[:n]), 1.0),
        lambda n: ((None, Y[:n]), 1.0),
        lambda n: (response(np.arange(float(n)), U[:n], Y[:n]), None),
        lambda n: (Frame(t=np.arange(float(n)), u=U[:n], y=Y[:n]), None),
        lambda n: (Frame(u=U[:n], y=Y[:n]), 1.0),
    ],
)
def test_two_samples_are_a_record_and_fewer_are_none(make, samples):
    data, dt = make(samples)
    with pytest.raises(phc.IdentificationError, match=f"^the record has {samples} sample"):
        as_experiments(data, dt)
    with pytest.raises(phc.IdentificationError, match=f"^experiment 1: the record has {samples} sample"):
        as_experiments([data], dt)
    assert only(*make(2)).samples == 2


@pytest.mark.parametrize("data", [response(), Record(STEP * np.arange(6), STEP, U, Y), Frame(t=np.arange(6), u=U, y=Y)])
def test_a_step_may_be_given_along_with_a_time_but_not_contradict_it(data):
    step = only(data).dt
    for factor in (1.0, 1.0099, 0.9901):
        assert only(data, factor * step).dt == step
    for factor in (1.0101, 0.9899):
        with pytest.raises(phc.StructureError, match=r"contradicts .* leave dt out"):
            as_experiments(data, factor * step)


def test_the_door_for_one_record_takes_driven_records_only():
    assert_same(as_record((U, Y), STEP), only((U, Y), STEP))
    assert_same(as_record(response(title="run")), only(response(title="run")))
    for data in ((None, Y), ct.TimeResponseData(np.arange(6.0), Y, issiso=True)):
        with pytest.raises(phc.StructureError, match="the record has no input"):
            as_record(data, 1.0)
    with pytest.raises(phc.StructureError, match="data is a FrequencyResponseData"):
        as_record(frf())
    assert not as_record((U, None), STEP, output_needed=False).observed.any()
