"""Recordings from text tables."""

from __future__ import annotations

import codecs
import io
import math
import os
from fractions import Fraction
from pathlib import Path

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ph_control import FileFormatError, PHControlError, StructureError, read_csv

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
EPS = np.finfo(float).eps

PLAIN = "t,u,y\n0.0,1.5,-2\n0.1,2.5,3e-1\n0.2,-3.5,4\n"
U, Y = [1.5, 2.5, -3.5], [-2.0, 0.3, 4.0]


@pytest.fixture
def read(tmp_path):
    """Write text or bytes to a file and read it."""

    def run(content, **options):
        path = tmp_path / "record.csv"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_csv(path, **options)

    return run


@pytest.fixture
def message(read):
    """Message of the error that reading ends in, without the folder."""

    def run(content, error=FileFormatError, **options):
        with pytest.raises(PHControlError) as caught:
            read(content, **options)
        assert type(caught.value) is error
        text = str(caught.value)
        return text[text.index("record.csv") :] if "record.csv" in text else text

    return run


def assert_plain(data):
    assert isinstance(data, ct.TimeResponseData)
    assert data.time.tolist() == [0.0, 0.1, 0.2]
    assert data.inputs.tolist() == U
    assert data.outputs.tolist() == Y


# --- layouts -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "content",
    {
        "comma": PLAIN,
        "semicolon": PLAIN.replace(",", ";"),
        "semicolon and decimal comma": PLAIN.replace(",", ";").replace(".", ","),
        "tab": PLAIN.replace(",", "\t"),
        "tab and decimal comma": PLAIN.replace(",", "\t").replace(".", ","),
        "spaces": PLAIN.replace(",", "   "),
        "spaces and decimal comma": PLAIN.replace(",", "   ").replace(".", ","),
        "comma and space": PLAIN.replace(",", ", "),
        "comma and tab": PLAIN.replace(",", ",\t"),
        "mixed white space, indented": PLAIN.replace(",", " \t ").replace("\n", "\n   "),
        "byte order mark": "\ufeff" + PLAIN,
        "UTF-16": codecs.BOM_UTF16_LE + PLAIN.encode("utf-16-le"),
        "Windows line ends": PLAIN.replace("\n", "\r\n"),
        "old Macintosh line ends": PLAIN.replace("\n", "\r"),
        "no line end at the end": PLAIN.rstrip(),
        "trailing separator": PLAIN.replace("\n", ",\n"),
        "trailing separator in the rows only": PLAIN.replace("\n", ",\n").replace("y,", "y"),
        "trailing tab": PLAIN.replace(",", "\t").replace("\n", "\t\n"),
        "empty rows at the end": PLAIN + ",,\n,,\n",
        "blank lines": PLAIN.replace("\n", "\n\n  \n"),
        "comments": "# made by hand\n% twice\n" + PLAIN.replace("\n", "\n  # here too\n"),
        "quoted labels": PLAIN.replace("t,u,y", '"t","u","y"'),
        "quoted numbers": PLAIN.replace("2.5", '"2.5"'),
        "space before a quote": PLAIN.replace(",2.5", ', "2.5"'),
        "quoted decimal commas": 't,u,y\n0,"1,5",-2\n"0,1","2,5","3e-1"\n"0,2","-3,5",4\n',
        "separator announced": "sep=;\n" + PLAIN.replace(",", ";"),
        "tab announced": "sep=\t\n" + PLAIN.replace(",", "\t"),
        "labels in a comment": "# from a logger\n# " + PLAIN,
        "integers before decimal commas": "t;u;y\n0;1,5;-2\n0,1;2,5;3e-1\n0,2;-3,5;4\n",
    }.items(),
    ids=lambda case: case[0],
)
def test_every_usual_layout_gives_the_same_recording(read, content):
    data = read(content[1])
    assert_plain(data)
    assert (data.input_labels, data.output_labels) == (["u"], ["y"])


def test_a_table_without_header_is_chosen_from_by_number(read):
    data = read(PLAIN.removeprefix("t,u,y\n"), time=0)
    assert_plain(data)
    assert (data.input_labels, data.output_labels) == (["u[0]"], ["y[0]"])


def test_separator_at_the_end_of_every_row_makes_no_column_in_a_table_without_header(read):
    assert_plain(read(PLAIN.removeprefix("t,u,y\n").replace("\n", ",\n"), time=0))


def test_layout_can_be_given_where_it_cannot_be_found(read):
    assert_plain(read(PLAIN.replace(",", "|"), delimiter="|"))
    assert_plain(read(PLAIN.replace(",", ";").replace(".", ","), delimiter=";", decimal=","))
    assert_plain(read(PLAIN.replace(",", "\t  "), delimiter=" "))
    numbers_as_labels = read("0,1,2\n" + PLAIN.removeprefix("t,u,y\n"), header=True, time="0")
    assert_plain(numbers_as_labels)
    assert numbers_as_labels.output_labels == ["2"]
    assert read("t,u,y\n0,1,nan\n1,2,3\n", header=True).outputs[1] == 3


def test_decimal_commas_between_spaces_are_not_separators(read):
    assert read("0,5 1,5\n0,75 2,5\n", time=0, input=False).outputs.tolist() == [1.5, 2.5]


def test_single_decimal_comma_is_one_number_only_where_the_comma_does_not_separate(read):
    assert read("0,5\n1,5\n", dt=1).inputs.tolist() == [0, 1]
    assert read("0,5\n1,5\n", dt=1, input=False, delimiter=";").outputs.tolist() == [0.5, 1.5]


def test_numpy_savetxt_with_header_is_read_back_bit_by_bit(tmp_path):
    u, y = np.random.default_rng(1).standard_normal((2, 50))
    path = tmp_path / "savetxt.txt"
    np.savetxt(path, np.column_stack([0.25 * np.arange(50), u, y]), header="time force velocity")
    data = read_csv(str(path))
    # 19 significant digits are enough for every double
    assert (data.inputs == u).all() and (data.outputs == y).all()
    assert data.output_labels == ["velocity"]


@pytest.mark.parametrize("delimiter", [",", "\t", ";", " "])
@pytest.mark.parametrize("comment", ["# time force velocity", "#\ttime  force\tvelocity", "% time, force, velocity"])
def test_comment_with_a_word_for_each_column_labels_them_however_the_numbers_are_separated(read, delimiter, comment):
    data = read(comment + PLAIN.removeprefix("t,u,y").replace(",", delimiter))
    assert_plain(data)
    assert (data.input_labels, data.output_labels) == (["force"], ["velocity"])


def test_units_in_a_comment_of_words_stay_with_their_words(read):
    data = read("# t [s] force [N] x (m)\n0,1,2\n1,2,3\n")
    assert (data.input_labels, data.output_labels) == (["force [N]"], ["x (m)"])


def test_comment_of_another_length_gives_no_labels(read):
    assert read("# my best recording ever\n0 1\n1 2\n", dt=1).output_labels == ["y[0]"]
    assert read("# my best recording ever\n0,1\n1,2\n", dt=1).output_labels == ["y[0]"]


def test_older_western_encoding_keeps_its_units(read):
    data = read("t;force [µN];x [°]\n0;1;2\n1;2;3\n".encode("latin-1"))
    assert (data.input_labels, data.output_labels) == (["force [µN]"], ["x [°]"])


@settings(deadline=None, max_examples=40, derandomize=True)
@given(
    values=st.lists(st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * 2), min_size=2, max_size=20),
    layout=st.sampled_from([(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), (" ", "."), (" ", ",")]),
)
def test_every_double_in_print_comes_back_as_it_was(tmp_path_factory, values, layout):
    delimiter, decimal = layout
    rows = [delimiter.join(repr(x).replace(".", decimal) for x in (0.5 * k, *row)) for k, row in enumerate(values)]
    path = tmp_path_factory.getbasetemp() / "doubles.csv"
    path.write_text("\n".join([delimiter.join(["t", "u", "y"]), *rows]))
    data = read_csv(path)
    assert np.array_equal(np.array(values).T.view(np.int64), np.stack([data.inputs, data.outputs]).view(np.int64))


def test_long_files_with_a_missing_value_or_a_quote_here_and_there_are_read_as_the_clean_ones(read):
    count = 3000
    u, y = np.round(np.random.default_rng(2).standard_normal((2, count)), 6)
    rows = [f"{k / 8},{u[k]},{y[k]}" for k in range(count)]
    clean = read("t,u,y\n" + "\n".join(rows))
    assert (clean.inputs == u).all() and (clean.outputs == y).all()
    rows[1500] = f"{1500 / 8},{u[1500]},n/a"
    rows[2500] = f'"{2500 / 8}","{u[2500]}",{y[2500]}'
    data = read("t,u,y\n" + "\n".join(rows))
    assert np.flatnonzero(np.isnan(data.outputs)).tolist() == [1500]
    keep = np.arange(count) != 1500
    assert (data.inputs == u).all() and (data.outputs == y)[keep].all() and (data.time == clean.time).all()


# --- columns -----------------------------------------------------------------------------------------------------

WIDE = "time [s],force [N],velocity (m/s),Pressure / Pa,note\n0,1,2,3,ok\n1,5,6,7,a;b c\n2,9,10,11,12:30\n"


@pytest.mark.parametrize(
    "chosen", ["velocity (m/s)", "velocity", "Velocity", "VELOCITY (M/S)", " velocity ", 2, np.int64(2), "2"]
)
def test_columns_are_chosen_by_label_with_or_without_unit_or_by_number(read, chosen):
    data = read(WIDE, input="force", output=chosen)
    assert data.outputs.tolist() == [2, 6, 10]
    assert (data.input_labels, data.output_labels) == (["force [N]"], ["velocity (m/s)"])


def test_unit_after_a_slash_is_a_unit(read):
    assert read(WIDE, input="force", output="pressure").outputs.tolist() == [3, 7, 11]


def test_literal_label_wins_over_one_without_regard_to_unit_or_case(read):
    assert read("t,y [mm],y,Y\n0,1,2,3\n1,4,5,6\n", input=False, output="y").outputs.tolist() == [2, 5]


def test_lists_give_several_inputs_and_outputs_in_their_order(read):
    data = read(WIDE, input=[1], output=["pressure", 2])
    assert data.inputs.tolist() == [[1, 5, 9]]
    assert data.outputs.tolist() == [[3, 7, 11], [2, 6, 10]]
    assert data.output_labels == ["Pressure / Pa", "velocity (m/s)"]
    data = read(WIDE, input=(2, 1), output="pressure")
    assert (data.ninputs, data.noutputs) == (2, 1)
    assert data.inputs.tolist() == [[2, 6, 10], [1, 5, 9]]


def test_the_one_column_left_is_the_signal_that_is_not_named(read):
    assert read(PLAIN, input="y").outputs.tolist() == U
    assert read(PLAIN, output="u").inputs.tolist() == Y
    assert read("t,y\n0,1\n1,2\n", input=False).outputs.tolist() == [1, 2]


def test_free_decay_has_no_input(read):
    data = read(PLAIN, input=False, output="y")
    assert (data.ninputs, data.inputs, data.input_labels) == (0, None, None)
    assert data.outputs.tolist() == Y


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"input": "force", "output": "speed"}, "output: there is no column called 'speed'; the columns are 0 'time"),
        ({"input": "force", "output": "velocty"}, "did you mean 'velocity (m/s)'?"),
        ({"input": 5, "output": 1}, "input: there is no column number 5; the columns are 0 'time [s]'"),
        ({"input": -1, "output": 1}, "input: there is no column number -1; the columns are"),
        ({"input": 2.0, "output": 1}, "input is 2.0; give the label of a column or its number, counted from 0"),
        ({"input": True, "output": 1}, "input is True; give the label"),
        ({"input": 1, "output": False}, "output is False; give the label"),
        ({"input": 1, "output": []}, "output is an empty list; name at least one column"),
        ({"input": [], "output": 1}, "input is an empty list; name at least one column; pass input=False"),
        ({"input": 1, "output": 1}, "column 1 ('force [N]') is chosen twice; give each its own"),
        ({"input": 1, "output": 0}, "column 0 ('time [s]') is chosen twice"),
        ({}, "which column is the input and which the output? 4 of 5 columns are left to choose from; say which with "
             "input= and output=; several columns are passed as a list (the columns are 0 'time [s]', 1 'force [N]'"),
        ({"input": "force,1"}, "input: there is no column called 'force,1'"),
        ({"input": "force,force"}, "; several columns are passed as a list"),
        ({"output": 1}, "which column is the input? 3 of 5 columns are left"),
        ({"input": False}, "which column is the output? 4 of 5 columns are left"),
        ({"input": 1, "output": 2, "time": "clock"}, "time: there is no column called 'clock'"),
    ],
)  # fmt: skip
def test_a_choice_that_does_not_fit_the_file_says_which_columns_there_are(message, options, expected):
    assert expected in message(WIDE, StructureError, **options)


def test_too_few_columns_for_an_input_says_how_to_do_without(message):
    text = message("t,y\n0,1\n1,2\n", StructureError)
    assert "1 of 2 columns are left" in text and "or pass input=False if the recording has no input" in text
    assert "0 of 2 columns are left" in message("t,y\n0,1\n1,2\n", StructureError, output="y")


def test_label_that_is_there_twice_is_chosen_by_number(read, message):
    twice = "t,y,y\n0,1,2\n1,3,4\n"
    assert "columns 1 and 2 are all called 'y'; choose by number" in message(
        twice, StructureError, input=False, output="y"
    )
    assert read(twice, input=1, output=2).outputs.tolist() == [2, 4]


def test_table_without_labels_says_so(message):
    text = message("1,2,3\n4,5,6\n", StructureError, dt=1, input="u")
    assert "no column called 'u'; the file has 3 columns without names; choose by number, 0 to 2" in text


# --- time --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "label", ["t", "time", "Time", "TIME [s]", "t (s)", "time / s", "Timestamp", "time_s", "times"]
)
def test_time_is_found_by_its_label_wherever_it_stands(read, label):
    assert read(f"u,{label},y\n1,5,3\n2,7,4\n").time.tolist() == [5, 7]


@pytest.mark.parametrize("label", ["T", "temp", "time constant", "mytime", "t1"])
def test_other_labels_are_not_taken_for_time(message, label):
    text = message(f"{label},u,y\n1,5,3\n2,7,4\n", StructureError)
    assert "no column is the time; name it with time=, or give the time between samples with dt=" in text
    assert repr(label) in text


def test_time_can_be_named_or_denied(read):
    assert read("clock,t,y\n0,1,3\n2,7,4\n", time="clock").time.tolist() == [0, 2]
    denied = read("t,y\n1,3\n7,4\n", time=False, dt=0.5)
    assert denied.time.tolist() == [0, 0.5]
    assert denied.input_labels == ["t"]


def test_two_columns_that_may_be_the_time_are_a_question(message):
    text = message("time [s],time [ms],y\n0,0,1\n1,1000,2\n", StructureError, input=False)
    assert "column 0 ('time [s]') and column 1 ('time [ms]') may both be the time; choose with time=" in text


def test_time_denied_without_a_step_is_an_error(message):
    assert "give the time between samples with dt=" in message(PLAIN, StructureError, time=False)


@pytest.mark.parametrize("dt", [0, -1, math.nan, math.inf, "fast", True])
def test_step_must_be_a_positive_number(message, dt):
    assert "dt is" in message(PLAIN, StructureError, dt=dt)


def test_step_beside_a_time_column_must_agree_to_a_hundredth_of_a_step_over_the_record(read, message):
    rows = "t,u,y\n" + "".join(f"{k / 10},{k},{k}\n" for k in range(11))
    # over ten steps the grids part by ten times the difference
    agrees = read(rows, dt=0.1 * (1 + 0.99e-3))
    assert agrees.time[-1] == 10 * (0.1 * (1 + 0.99e-3))
    text = message(rows, StructureError, dt=0.1 * (1 + 1.01e-3))
    assert "but the step of column 0 ('t') is 0.1; leave dt out, or pass time=False" in text


def test_times_in_few_digits_give_the_uniform_grid_they_stand_for(read):
    for printed in ("%.2f", "%.6g", "%.17g"):
        rows = "".join(f"{printed % (0.01 * k)},{k},{k}\n" for k in range(5000))
        data = read("t,u,y\n" + rows)
        assert (data.time == 0.01 * np.arange(5000)).all()


@pytest.mark.parametrize("start", [1, 1000])
def test_two_instants_have_the_step_in_their_digits_and_not_its_rounding(read, start):
    first, second = f"{start}.1", f"{start}.4"
    assert float(second) - float(first) != 0.3
    assert read(f"t,u,y\n{first},1,2\n{second},1,2\n").time.tolist() == [float(first), float(first) + 0.3]


def test_rate_that_is_a_whole_number_is_found_although_its_step_has_no_short_decimal(read):
    for rate in (3, 30, 44100, 1024):
        rows = "".join(f"{k / rate:.9f},{k},{k}\n" for k in range(500))
        assert (read("t,u,y\n" + rows).time == (1 / rate) * np.arange(500)).all()


@settings(deadline=None, max_examples=60, derandomize=True)
@given(
    step=st.floats(1e-4, 1e3),
    start=st.integers(-1000, 1000),
    count=st.integers(2, 400),
    digits=st.integers(3, 6),
)
def test_step_of_rounded_times_is_right_within_their_rounding(tmp_path_factory, step, start, count, digits):
    # times rounded to a fraction of a step, in exact arithmetic
    unit = Fraction(10) ** (math.floor(math.log10(step)) - digits)
    printed = [round(Fraction(step) * (start + k) / unit) * unit for k in range(count)]
    path = tmp_path_factory.getbasetemp() / "rounded.csv"
    path.write_text("t,u,y\n" + "".join(f"{float(t)!r},{k},{k}\n" for k, t in enumerate(printed)))
    time = read_csv(path).time
    found = (time[-1] - time[0]) / (count - 1)
    # a line through instants that are each wrong by half a unit: its end and start are wrong by at most about two
    allowed = 2 * float(unit) / (count - 1) + 8 * EPS * abs(time).max()
    assert abs(found - step) <= allowed
    assert time[0] == float(printed[0])


def test_grid_is_uniform_to_the_last_bit_of_start_plus_step_times_index(read):
    rows = "".join(f"{7 + 0.1 * k:.3f},{k},{k}\n" for k in range(100))
    assert (read("t,u,y\n" + rows).time == 7 + 0.1 * np.arange(100)).all()


def _with_time(k, value):
    times = [f"{0.5 * j:.6f}" for j in range(10)]
    times[k] = str(value)
    return "# comment\nt,u,y\n" + "".join(f"{t},1,2\n" for t in times)


def test_unequal_sampling_says_at_which_line_and_what_the_times_are(message):
    text = message(_with_time(4, 2.25))
    assert text.startswith("record.csv, line 7, column 0 ('t'): the time is 2.25, after 1.5 in line 6: a step of 0.75")
    assert "the median is 0.5" in text and "resample" in text and "time=False, dt=0.5" in text


def test_instants_may_be_off_the_grid_by_a_hundredth_of_a_step_and_no_more(read, message):
    # a grid between one instant and all others halves its distance
    assert read(_with_time(4, 2.0 + 1.98 * 0.005)).time[4] == pytest.approx(2.0, abs=0.01)
    assert "must be uniform to a hundredth of a step" in message(_with_time(4, 2.0 + 2.02 * 0.005))


def _at(times):
    return "t,u,y\n" + "".join(f"{t!r},1,2\n" for t in times)


@pytest.mark.parametrize("count", [1, 3])
def test_lost_samples_are_counted_and_never_closed_by_numbering_the_rows(message, count):
    times = [0.5 * k for k in range(20)]
    text = message(_at(times[:4] + times[4 + count :]))
    assert text.startswith(f"record.csv, line 6, column 0 ('t'): the time is {times[4 + count]:g}, after 1.5 in line 5")
    assert f"samples are lost, {count} there and {count} in the whole file; add rows" in text
    assert "time=False" not in text


def test_samples_lost_at_several_places_are_counted_at_the_worst_and_altogether(message):
    text = message(_at([k for k in range(40) if k not in (5, 20, 21, 30)]))
    assert "the time is 22, after 19" in text
    assert "samples are lost, 2 there and 4 in the whole file" in text


def test_numbering_the_rows_is_offered_up_to_half_a_step_beside_the_grid_and_no_further(message):
    for late, offered in ((0.5, True), (0.53125, False)):
        times = [float(k) if k < 5 else k + late for k in range(20)]
        text = message(_at(times))
        assert ("time=False, dt=" in text) is offered
        assert ("samples are lost, 1 there" in text) is not offered


def test_gap_beyond_all_counting_is_an_error_like_any_other(message):
    assert "samples are lost, 999999999 there" in message(_at([0.0, 1e-300, 2e-300, 1e300]))


def test_surplus_row_is_told_from_a_lost_one(message):
    text = message(_at([0.0, 1.0, 2.0, 2.25, 3.0, 4.0, 5.0]))
    assert "the time is 2.25, after 2 in line 4" in text
    assert "one too many there: drop it, or resample" in text and "time=False" not in text


@pytest.mark.parametrize("repeat", ["1.5", "0.1"])
def test_time_that_stands_still_or_goes_back_says_where(message, repeat):
    text = message(_with_time(4, repeat))
    assert text.startswith(
        f"record.csv, line 7, column 0 ('t'): the time is {repeat}, after 1.5 in line 6; it must increase"
    )


# --- missing values ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "token", ["", " ", "NaN", "nan", "-nan", "NA", "N/A", "#N/A", "null", "NULL", "None", "-", "?", '""', "-1.#IND"]
)
def test_missing_outputs_become_nan(read, token):
    data = read(f"t,u,y\n0,1,2\n1,2,{token}\n2,3,4\n")
    assert np.array_equal(data.outputs, [2, np.nan, 4], equal_nan=True)


def test_missing_outputs_in_a_row_of_tabs_and_a_row_of_commas_are_not_blank_lines(read):
    assert np.isnan(read("a\tb\n1\t2\n\t\n3\t4\n", dt=1, input=False, output=1).outputs).tolist() == [
        False,
        True,
        False,
    ]
    assert np.isnan(read("a,b\n1,2\n,\n3,4\n", dt=1, input=False, output=1).outputs).tolist() == [False, True, False]


def test_missing_output_in_the_first_row_does_not_hide_the_column(read):
    assert np.array_equal(read("0,1,\n1,2,3\n", time=0).outputs, [np.nan, 3], equal_nan=True)


def test_missing_input_names_line_and_column(message):
    text = message("t,u,y\n0,1,2\n1,NA,3\n2,,3\n")
    assert text.startswith("record.csv, line 3, column 1 ('u'): the input is missing, and only outputs may be")
    assert "fill it in, or cut the recording there" in text


def test_missing_time_names_line_and_column(message):
    text = message("t,u,y\n0,1,2\n,1,3\n2,1,3\n")
    assert text.startswith("record.csv, line 3, column 0 ('t'): the time is missing, and only outputs may be")


def test_output_without_any_value_is_an_error(message):
    assert "column 2 ('y') has no values at all; choose another output" in message("t,u,y\n0,1,\n1,2,\n", header=True)


# --- bad content -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("field", "expected"),
    [
        ("abc", "'abc' is not a number; correct it, or leave the field empty if the value is missing"),
        ("1_0", "'1_0' is not a number"),
        ("0x10", "'0x10' is not a number"),
        ("1 2", "'1 2' is not a number"),
        ("１", "'１' is not a number"),
        ("inf", "'inf' is not finite, or too large for a double"),
        ("-Infinity", "'-Infinity' is not finite"),
        ("1e999", "'1e999' is not finite, or too large for a double"),
        ('"0,5"', "'0,5' has a decimal comma, but the numbers above have a decimal point"),
        ("12:30:00", "'12:30:00' is a date or a time of day; convert it to a number first"),
        ("2024-05-01", "'2024-05-01' is a date"),
        ("1.0+2.0j", "'1.0+2.0j' is a complex number; give its real and its imaginary part a column each"),
        ("(1.5e+00-2.5e-01j)", "'(1.5e+00-2.5e-01j)' is a complex number"),
        ("1-2i", "'1-2i' is a complex number"),
        ("x" * 99, "'" + "x" * 57 + "...' is not a number"),
    ],
)
def test_field_that_is_no_number_says_line_column_and_what_was_found(message, field, expected):
    content = "t,u,y\n# note\n0.0,1,2\n\n0.5," + field + ",3\n1.0,2,3\n"
    assert message(content).startswith(f"record.csv, line 5, column 1 ('u'): {expected}")


@pytest.mark.variants
@pytest.mark.parametrize("field", ["1" * 200_000 + "x", "s" + 200_000 * " " + "m", "1+2" + 200_000 * " " + "x"])
def test_field_or_label_of_any_length_is_answered(read, message, field):
    # a pattern that tried every way to split it would not come to an end here
    assert "is not a number" in message(f"t,u,y\n0,1,2\n1,{field},3\n")
    assert read(f"t,u,{field}\n0,1,2\n1,2,3\n", header=True).output_labels == [field]


def test_error_far_down_names_its_own_line(message):
    rows = [f"{k},{k},{k}" for k in range(5000)]
    rows[4321] = "4321,4321,bad"
    assert message("t,u,y\n" + "\n".join(rows)).startswith(
        "record.csv, line 4323, column 2 ('y'): 'bad' is not a number"
    )


def test_decimal_point_among_decimal_commas_is_an_error(message):
    text = message("t;u;y\n0,5;1,5;2\n1,5;1.234;3\n")
    assert text.startswith(
        "record.csv, line 3, column 1 ('u'): '1.234' has a decimal point, but the numbers above have a"
    )


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "   "])
@pytest.mark.parametrize("units", ["s,N,m/s", "[s],[N],[m/s]", "(s),(N),(m/s)", '"s","N","m/s"'])
def test_row_of_units_below_the_labels_joins_them(read, delimiter, units):
    content = f"time,force,velocity\n{units}\n" + PLAIN.removeprefix("t,u,y\n")
    data = read(content.replace(",", delimiter), input="force", output="velocity")
    assert_plain(data)
    assert (data.input_labels, data.output_labels) == (["force [N]"], ["velocity [m/s]"])


def test_a_quote_that_is_never_closed_is_an_error_of_the_file_however_long_it_goes_on():
    with pytest.raises(FileFormatError, match="line 1 is neither a header nor a row of numbers") as caught:
        read_csv(io.StringIO('"' + 200_000 * "0" + ",u,y\n0,1,2\n1,2,3\n"))
    assert len(str(caught.value)) < 1000


def test_a_label_of_any_length_is_shortened_in_messages():
    label = 100_000 * "a"
    for call in (
        lambda: read_csv(io.StringIO(f"t,{label},y,z\n0,1,2,3\n1,2,3,4\n")),
        lambda: read_csv(io.StringIO(f"t,{label}\n0,x\n1,2\n"), input=False),
        lambda: read_csv(io.StringIO("t,u,y\n0,1,2\n1,2,3\n"), input=label),
    ):
        with pytest.raises(StructureError) as caught:
            call()
        assert 40 < len(str(caught.value)) < 1000


@pytest.mark.parametrize(
    "unit", ["m/s^2", "m/s²", "mm", "µm", "°C", "%", "rad/s", "N*m", "N·m", "kN", "1/s", "volts", "Hz"]
)
def test_usual_units_are_known(read, unit):
    assert read(f"t,u,y\ns,-,{unit}\n0,1,2\n1,2,\n").output_labels == [f"y [{unit}]"]
    assert read(f"t,u,y,\ns,,{unit},\n0,1,2,\n1,2,3,\n").input_labels == ["u"]


@pytest.mark.parametrize(
    "content",
    [
        "t,u,y\nbad,worse,m\n0,1,2\n1,2,3\n",
        "t,u,y\nerror,error,error\n0,1,2\n1,2,3\n",
        "t,u,y\ns,1,m\n0,1,2\n1,2,3\n",
        "t,u,y\ns,N,m\n0,1,A\n1,2,B\n",
    ],
)
def test_row_of_words_that_may_be_no_units_is_told_what_to_do(message, content):
    text = message(content)
    assert text.startswith("record.csv, line 2, column 0 (") and "is not a number" in text
    assert text.endswith("put # in front of the line if it holds units")


def test_row_of_units_without_rows_below_is_no_recording(message):
    assert "has a header in line 1 and no rows of numbers" in message("t,u,y\ns,N,m\n", FileFormatError)


def test_complex_column_of_a_recording_is_an_error_only_where_it_is_asked_for(read, message):
    content = "t,u,y,z\n0,1,2,1+2j\n1,2,3,2-1j\n"
    assert read(content, input="u", output="y").outputs.tolist() == [2, 3]
    text = message(content, input="u", output="z")
    assert text.startswith("record.csv, line 2, column 3 ('z'): '1+2j' is a complex number")


@pytest.mark.parametrize("row", ["1,2", "1,2,3,4", "1,2,3,,", '1,"2,3"', "end of record"])
def test_ragged_row_names_its_line_and_both_lengths(message, row):
    text = message(f"t,u,y\n0,1,2\n{row}\n2,3,4\n")
    assert text.startswith("record.csv, line 3: ")
    assert "but the header has 3 (separator: comma)" in text and "put # in front" in text


def test_ragged_row_without_header_is_held_against_the_first(message):
    text = message("0,1,2\n1,2\n", time=0)
    assert text.startswith("record.csv, line 2: 2 fields, but line 1 has 3")
    assert message("0 1 2\n1\n", time=0).startswith(
        "record.csv, line 2: 1 field, but line 1 has 3 (separator: white space)"
    )


def test_first_row_half_words_half_numbers_is_a_question(read, message):
    content = "t,1,2\n0,1,2\n1,2,3\n"
    text = message(content)
    assert text.startswith(
        "record.csv, line 1 is neither a header nor a row of numbers: '1' in column 1 is a number, 't' in"
    )
    assert "pass header=True or header=False" in text
    assert read(content, header=True).output_labels == ["2"]
    # words in the same column of every row are no header
    assert read("0,1,2,ok\n1,2,3,ok\n", time=0, input=1, output=2).outputs.tolist() == [2, 3]


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("", "record.csv is empty; it needs rows of numbers"),
        ("\n \n", "record.csv is empty"),
        ("# a\n% b\n", "record.csv holds only comments"),
        ("\ufeff", "record.csv is empty"),
        ("t,u,y\n", "record.csv has a header in line 1 and no rows of numbers below it"),
        ("# a\n\nt,u,y\n,,\n", "record.csv has a header in line 3 and no rows"),
        (",,\n", "record.csv has no rows of numbers"),
        ("sep=,\n", "record.csv has no rows of numbers"),
        ("t,u,y\n0,1,2\n", "record.csv has one row of numbers (line 2); at least two samples are needed"),
        (
            b"\x89PNG\r\n\x1a\n\0\0\0",
            "record.csv is not a text file: it holds bytes that no text has; export it as CSV",
        ),
        (b"PK\x03\x04\x14\x00", "record.csv is not a text file"),
        (codecs.BOM_UTF16_LE + b"\0\xd8\0", "record.csv is not a text file"),
    ],
)
def test_file_without_a_table_says_what_it_is(message, content, expected):
    assert message(content).startswith(expected)


def test_single_row_is_an_error_also_with_a_step(message):
    assert "one row of numbers" in message("1,2\n", dt=1)


def test_missing_file_is_an_error_of_both_families(tmp_path):
    with pytest.raises(
        PHControlError, match=r"there is no file .*absent\.csv \(looked from .*check its name"
    ) as caught:
        read_csv(tmp_path / "absent.csv")
    assert isinstance(caught.value, FileNotFoundError)
    with pytest.raises(FileNotFoundError, match="there is no file"):
        read_csv(tmp_path / "absent" / "record.csv")


def test_folder_is_an_error(tmp_path):
    with pytest.raises(FileFormatError, match="is a folder; pass the file in it"):
        read_csv(tmp_path)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"header": "yes"}, "header is 'yes'; it must be True, False or None"),
        ({"delimiter": ",,"}, "delimiter is ',,'; it must be one character"),
        ({"delimiter": ""}, "delimiter is ''; it must be one character"),
        ({"delimiter": 3}, "delimiter is 3; it must be one character"),
        ({"decimal": ";"}, "decimal is ';'; it must be one of '.', ','"),
    ],
)
def test_layout_arguments_are_checked(message, options, expected):
    assert expected in message(PLAIN, StructureError, **options)


@settings(deadline=None, max_examples=200, derandomize=True)
@given(
    content=st.one_of(st.binary(max_size=60), st.text('tuy0123456789.,;eE+-# \t\n"%NA[', max_size=60)), dt=st.booleans()
)
def test_any_content_gives_a_recording_or_an_error_of_this_package(tmp_path_factory, content, dt):
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    try:
        data = read_csv(path, dt=0.5 if dt else None)
    except StructureError as error:
        assert "any.csv" in str(error)
    else:
        assert len(data.time) == data.outputs.shape[-1] >= 2
        assert np.isfinite(data.time).all() and np.isfinite(data.inputs).all()


def test_reading_changes_neither_the_file_nor_the_folder(read, tmp_path):
    read(PLAIN)
    assert os.listdir(tmp_path) == ["record.csv"]
    assert (tmp_path / "record.csv").read_text() == PLAIN


def test_recording_of_the_flexible_robot_arm():
    path = DATA / "measured" / "robot_arm.dat"
    if not path.exists():
        pytest.skip(f"third-party recording not at {path}")
    data = read_csv(path, dt=1.0)
    reference = np.array([line.split() for line in path.read_text().splitlines()], dtype=float)
    assert reference.shape == (1024, 2)
    assert (data.inputs == reference[:, 0]).all() and (data.outputs == reference[:, 1]).all()
    assert (data.time == np.arange(1024)).all()


@pytest.mark.parametrize("stream", [io.StringIO, lambda text: io.BytesIO(text.encode())])
def test_an_open_file_is_read_like_one_of_that_name(stream):
    data = read_csv(stream("t,u,y\n0,1,2\n0.5,3,4\n"))
    assert data.time.tolist() == [0.0, 0.5] and data.inputs.tolist() == [1.0, 3.0] and data.outputs.tolist() == [2, 4]
    named = stream("t,u,y\n0,1,2\n0.5,x,4\n")
    named.name = "the pipe"
    with pytest.raises(FileFormatError, match=r"^the pipe, line 3, column 1 \('u'\): 'x' is not a number"):
        read_csv(named)
