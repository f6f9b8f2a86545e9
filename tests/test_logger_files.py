"""Exports of loggers, oscilloscopes and analysers, short and in the layout of their manuals.

Each is read with its sampling time, labels and units, or refused by messages that end in arguments with which it is.
"""

from __future__ import annotations

import ast
import io
import re
import sys
from pathlib import Path

import h5py
import nptdms
import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
import scipy.io.wavfile

import ph_control as phc

IMPEDANCES = Path(__file__).resolve().parents[2] / "shared" / "data" / "impedance"

TEKTRONIX_OLD = (
    "Record Length,2.5e+03,,-0.0004,1.0,\nSample Interval,2.0e-04,,-0.0002,2.0,\nTrigger Point,1.25e+03,,0.0,3.0,\n"
    ",,,0.0002,4.0,\n,,,0.0004,5.0,\n"
)
TEKTRONIX = """Model,DPO2014
Firmware Version,1.33
Waveform Type,ANALOG
Point Format,Y
Horizontal Units,s
Horizontal Scale,4e-05
Sample Interval,4e-10
Record Length,100000
Probe Attenuation,10,10
Vertical Units,V,V
Vertical Scale,0.1,0.2
Label,,
TIME,CH1,CH2
-2.0000e-04,0.02,1
-1.0000e-04,0.04,2
0.0000e+00,0.02,3
"""
KEYSIGHT = "x-axis,1,2\nsecond,Volt,Volt\n-1.0E-03,0.1,0.2\n-0.5E-03,0.3,0.4\n+0.0E+00,0.5,0.6\n"
RIGOL = "X,CH1,Start,Increment,\nSequence,Volt,-6.0e-04,1.0e-06,\n0,1.2e-01,\n1,1.1e-01,\n2,1.3e-01,\n"
RIGOL_NEW = "Time(s),CH1(V),CH2(V)\n-0.001,0.1,0.2\n-0.0005,0.3,0.1\n0,0.2,0.2\n"
SIGLENT = """Record Length,Analog:7000
Sample Interval,Analog:2.00E-07
Vertical Units,CH1:V
Vertical Scale,CH1:2.00E+00
Model Number,SDS1204X-E
Software Version,1.3.26
Source,CH1
Second,Volt
-0.0000004,-0.12
-0.0000002,-0.08
 0.0000000,-0.04
"""
PICOSCOPE = "Time,Channel A,Channel B\n(ms),(V),(mV)\n\n-0.50,0.1,1\n-0.25,0.2,2\n0.00,0.3,3\n"
LECROY = (
    "LECROYHDO4054,11632,Waveform\nSegments,1,SegmentSize,3\nSegment,TrigTime,TimeSinceSegment1\n"
    "#1,26-Nov-2026 12:00:00,0\nTime,Ampl\n-0.02,0.1\n-0.01,0.2\n0,0.3\n"
)
CATMAN = """catman by HBM\tFilename: test.bin\t26.11.2026 12:00\tNumber of channels: 3
MX840A\tMX840A\tMX840A
default sample rate\t50 Hz\t50 Hz
Time  1 - default sample rate [s]\tKraft [kN]\tWeg [mm]
0,00\t1,5\t-0,25
0,02\t1,75\t-0,5
0,04\t2,0\t-0,125
"""
DEWESOFT = """Data file name:;test.dxd
Start time:;26.11.2026 12:00:00
Sample rate:;1000,0 Hz
Number of channels:;2

Zeit (s);Kraft (N);Beschl. (m/s2)
0,000;1,0;0,5
0,001;2,0;0,25
0,002;3,0;0,125
"""
TESTLAB = (
    "Test:\tRun 1\nPoint id\tshaker\tplate\nTime\tForce\tAcc\ns\tN\tm/s^2\n0.0\t1\t2\n0.00390625\t2\t3\n"
    "0.0078125\t3\t4\n"
)
TOA5 = """"TOA5","CR1000","CR1000","12345","CR1000.Std.32","CPU:bridge.CR1","5432","Fast"
"TIMESTAMP","RECORD","Strain","Temp"
"TS","RN","uS","Deg C"
"","","Smp","Avg"
"2026-11-26 23:59:59.9",0,12.5,22.1
"2026-11-27 00:00:00",1,12.4,22.1
"2026-11-27 00:00:00.1",2,"NAN",22.2
"""
PLC = (
    "Zeitstempel;Sollwert;Istwert\n26.11.2026 12:00:00,250;1,0;0,5\n26.11.2026 12:00:00,500;1,0;0,75\n"
    "26.11.2026 12:00:00,750;1,5;0,9\n"
)
PLC_MIDNIGHT = "Date,Time,Setpoint,Actual\n11/26/2026,23:59:58,1,2\n11/26/2026,23:59:59,2,3\n11/27/2026,00:00:00,3,4\n"
ISO = "timestamp,u,y\n2026-11-26T12:00:00.1+01:00,1,2\n2026-11-26T12:00:00.2+01:00,2,3\n2026-11-26T11:00:00.3Z,3,4\n"
HALF_DAY = "Time,Flow (l/min)\n11:59:59 AM,1\n12:00:00 PM,2\n12:00:01 PM,3\n"
COARSE = "Uhrzeit;Druck [bar]\n" + "".join(f"12:00:0{k // 4};{k}\n" for k in range(12))
EPOCH = "timestamp,x\n1795687200.00,1\n1795687200.05,2\n1795687200.10,3\n"
EPOCH_MS = "unix_time;u;y\n1795687200000;1;2\n1795687200050;2;3\n1795687200100;3;4\n"
ARDUINO = "12:00:01.250 -> 512,300\n12:00:01.260 -> 513,301\n12:00:01.270 -> 515,300\n"
ARDUINO_MILLIS = "Logger ready\nCalibrating...\n0\t512\t300\n10\t513\t301\n20\t515\t300\n"
TIMETABLE = "Time,acc\n0 sec,0.1\n0.002 sec,0.2\n0.004 sec,0.3\n"
TIMETABLE_DATES = "Time,u,y\n26-Nov-2026 12:00:00.000,1,2\n26-Nov-2026 12:00:00.500,2,3\n26-Nov-2026 12:00:01.000,3,4\n"
LVM = """LabVIEW Measurement\t
Writer_Version\t2
Separator\tTab
Decimal_Separator\t.
X_Columns\tOne
Date\t2026/11/26
Time\t12:00:00.0
***End_of_Header***\t

Channels\t2\t\t
Samples\t3\t3\t
Y_Unit_Label\tNewtons\tVolts\t
X_Dimension\tTime\tTime\t
X0\t0.0E+0\t0.0E+0\t
Delta_X\t0.001\t0.001\t
***End_of_Header***\t\t\t
X_Value\tForce\tVoltage\tComment
0.000\t0.1\t0.2\t
0.001\t0.3\t0.4\t
0.002\t0.4\t0.5\t
"""
LVM_WITHOUT_X = re.sub(r"(?m)^0\.00\d\t", "\t", LVM) + "\t0.7\t0.8\t\n\t0.9\t1.0\t\n"
FRENCH = "Temps (s);Force (N);Déplacement (mm)\n0,0;1,5;2\n0,1;1,25;3\n0,2;1,0;4\n"
SPANISH = "Registro 7\nTiempo [ms]\tFuerza [N]\n0\t1,5\n5\t2,5\n10\t3,5\n"
JAPANESE = "時間[s],力[N]\n0,1\n0.5,2\n1.0,3\n"
COMMENTED = "// made by hand\n// twice\nt;x\n0;1\n1;2\n"
ACCELEROMETER = "Sample rate: 200 Hz\nSerial: 17\nax,ay\n0.1,0.2\n0.3,0.4\n0.2,0.7\n"

# content, arguments, messages until it is read, step, unit of the time, first instant, inputs, outputs
RECORDS = {
    "Tektronix TDS": (TEKTRONIX_OLD, {}, 2, 2e-4, None, -4e-4, [], ["y[0]"]),
    "Tektronix DPO": (TEKTRONIX, {}, 0, 1e-4, None, -2e-4, ["CH1"], ["CH2"]),
    "Keysight 3000": (KEYSIGHT, {}, 0, 5e-4, "s", -1e-3, ["1 [Volt]"], ["2 [Volt]"]),
    "Rigol DS1000Z": (RIGOL, {}, 1, 1e-6, None, 0.0, [], ["y[0]"]),
    "Rigol MSO5000": (RIGOL_NEW, {}, 0, 5e-4, "s", -1e-3, ["CH1(V)"], ["CH2(V)"]),
    "Siglent SDS1000X": (SIGLENT, {"input": False}, 0, 2e-7, "s", -4e-7, [], ["CH1 [Volt]"]),
    "PicoScope 6": (PICOSCOPE, {}, 0, 0.25, "ms", -0.5, ["Channel A [V]"], ["Channel B [mV]"]),
    "LeCroy HDO": (LECROY, {}, 1, 0.01, None, -0.02, [], ["Ampl"]),
    "HBM catman": (CATMAN, {}, 0, 0.02, "s", 0.0, ["Kraft [kN]"], ["Weg [mm]"]),
    "DEWESoft": (DEWESOFT, {}, 0, 0.001, "s", 0.0, ["Kraft (N)"], ["Beschl. (m/s2)"]),
    "Simcenter Testlab": (TESTLAB, {}, 0, 2**-8, "s", 0.0, ["Force [N]"], ["Acc [m/s^2]"]),
    "Campbell TOA5": (TOA5, {"input": False, "output": "Strain"}, 0, 0.1, "s", 0.0, [], ["Strain [uS]"]),
    "PLC trend": (PLC, {}, 0, 0.25, "s", 0.0, ["Sollwert"], ["Istwert"]),
    "PLC over midnight": (PLC_MIDNIGHT, {}, 0, 1.0, "s", 0.0, ["Setpoint"], ["Actual"]),
    "ISO 8601 with zones": (ISO, {}, 0, 0.1, "s", 0.0, ["u"], ["y"]),
    "a clock of twelve hours": (HALF_DAY, {}, 1, 1.0, "s", 0.0, [], ["Flow (l/min)"]),
    "a clock in whole seconds": (COARSE, {"input": False}, 1, 0.25, None, 0.0, [], ["Druck [bar]"]),
    "seconds since 1970": (EPOCH, {"input": False}, 0, 0.05, "s", 1795687200.0, [], ["x"]),
    "milliseconds since 1970": (EPOCH_MS, {}, 0, 50.0, "ms", 1795687200000.0, ["u"], ["y"]),
    "Arduino serial monitor": (ARDUINO, {}, 0, 0.01, "s", 0.0, ["u[0]"], ["y[0]"]),
    "Arduino with millis": (ARDUINO_MILLIS, {"time_unit": "ms"}, 1, 10.0, "ms", 0.0, ["u[0]"], ["y[0]"]),
    "MATLAB timetable": (TIMETABLE, {"input": False}, 0, 0.002, "s", 0.0, [], ["acc"]),
    "MATLAB timetable of dates": (TIMETABLE_DATES, {}, 0, 0.5, "s", 0.0, ["u"], ["y"]),
    "LabVIEW lvm": (LVM, {}, 1, 0.001, "s", 0.0, ["Force"], ["Voltage"]),
    "LabVIEW lvm without X": (LVM_WITHOUT_X, {}, 2, 0.001, None, 0.0, ["Force"], ["Voltage"]),
    "French": (FRENCH, {}, 0, 0.1, "s", 0.0, ["Force (N)"], ["Déplacement (mm)"]),
    "Spanish": (SPANISH, {"input": False}, 0, 5.0, "ms", 0.0, [], ["Fuerza [N]"]),
    "Japanese": (JAPANESE, {"input": False}, 0, 0.5, "s", 0.0, [], ["力[N]"]),
    "comments of another kind": (COMMENTED, {"input": False, "comment": "//"}, 0, 1.0, None, 0.0, [], ["x"]),
    "a rate above the table": (ACCELEROMETER, {}, 1, 0.005, None, 0.0, ["ax"], ["ay"]),
}  # fmt: skip


def read_with_advice(content: str, options: dict) -> tuple:
    """Recording, and how many messages were followed until it was read."""
    for messages in range(4):
        try:
            return phc.read_csv(io.StringIO(content), **options), messages
        except phc.StructureError as error:
            advice = re.search(r"(?:for example|such as) ((?:\w+=.*)+)$", str(error))
            assert advice, str(error)
            call = ast.parse(f"f({advice[1]})", mode="eval").body
            options = {**options, **{word.arg: ast.literal_eval(word.value) for word in call.keywords}}
    raise AssertionError(f"not read with {options}")


@pytest.mark.parametrize("case", RECORDS)
def test_an_export_is_read_at_once_or_with_the_arguments_that_messages_propose(case):
    content, options, messages, step, unit, start, inputs, outputs = RECORDS[case]
    data, followed = read_with_advice(content, options)
    assert followed == messages
    assert data.time[0] == pytest.approx(start, abs=1e-12) and np.diff(data.time) == pytest.approx(step, rel=1e-5)
    assert (data.time_unit, data.input_labels or [], data.output_labels) == (unit, inputs, outputs)
    assert len(data.time) == (12 if content is COARSE else 5 if content is TEKTRONIX_OLD else data.outputs.shape[-1])


def test_values_stay_with_their_labels():
    data = phc.read_csv(io.StringIO(CATMAN))
    assert data.inputs.tolist() == [1.5, 1.75, 2.0] and data.outputs.tolist() == [-0.25, -0.5, -0.125]
    toa5 = phc.read_csv(io.StringIO(TOA5), input="Temp", output="Strain")
    assert np.array_equal(toa5.outputs, [12.5, 12.4, np.nan], equal_nan=True) and toa5.inputs.tolist() == [
        22.1,
        22.1,
        22.2,
    ]


def test_lines_above_the_table_can_be_left_out_by_number():
    text = "1,2\n3,4\nt,x\n0,5\n1,6\n"
    assert phc.read_csv(io.StringIO(text), skiprows=2, input=False).outputs.tolist() == [5, 6]
    with pytest.raises(phc.FileFormatError, match=r"line 1 is neither a header nor .* pass skiprows=1 "):
        phc.read_csv(io.StringIO("Interval,2\n0,5\n1,6\n"), dt=1.0)
    assert phc.read_csv(io.StringIO("Interval,2\n0,5\n1,6\n"), dt=1.0, skiprows=1).outputs.tolist() == [5, 6]
    with pytest.raises(phc.StructureError, match="skiprows is -1"):
        phc.read_csv(io.StringIO(text), skiprows=-1)
    with pytest.raises(phc.FileFormatError, match=r"no lines below the \d that skiprows= leaves out"):
        phc.read_csv(io.StringIO(text), skiprows=9)
    with pytest.raises(phc.StructureError, match="comment is 3; it must be the text"):
        phc.read_csv(io.StringIO(text), comment=3)


@pytest.mark.parametrize("between", ["\n", "\n\nsecond run\n", "\n# second run\n"])
@pytest.mark.parametrize("first, second", [(5, 9), (9, 5), (5, 5)])
def test_of_tables_with_as_many_columns_the_largest_is_read(first, second, between):
    tables = [
        f"t,{labels}\n" + "".join(f"{k},{scale * k},{k}\n" for k in range(count))
        for labels, scale, count in (("u,y", 2, first), ("v,z", 3, second))
    ]
    data = phc.read_csv(io.StringIO(between.join(tables)), input=1)
    expected = ("v", "z", 3, second) if second > first else ("u", "y", 2, first)
    assert (data.input_labels, data.output_labels) == ([expected[0]], [expected[1]])
    assert data.inputs.tolist() == [expected[2] * k for k in range(expected[3])]


def test_a_row_of_words_within_a_table_is_refused():
    for text in ("t,u,y\n0,1,1\n1,2,2\nover,over,over\n3,4,4\n", "t,u,y\n0,1,1\n1,2,2\n\n2,over,3\n3,4,4\n"):
        with pytest.raises(phc.FileFormatError, match="'over' is not a number"):
            phc.read_csv(io.StringIO(text), input="u", output="y")


@pytest.mark.parametrize(
    "content, message",
    [
        ("time,y\n12:00:00,1\n12:61:00,2\n", r"line 3, column 0 \('time'\): '12:61:00' is no instant"),
        ("time,y\n12:00:00,1\nlate,2\n", r"line 3, column 0 \('time'\): 'late' is no instant as '12:00:00' in line 2"),
        ("time,y\n26.11.2026 12:00:00,1\n31.11.2026 12:00:01,2\n", "'31.11.2026 12:00:01' is no instant"),
        ("time,y\n2026-11-26 12:00:00,1\n12:00:01,2\n", "'12:00:01' is no instant as '2026-11-26 12:00:00'"),
        ("time,y\n12:00:00,1\n12:00:01,2\n12:00:09,3\n12:00:10,3\n", "samples are lost, 7 there"),
    ],
)
def test_instants_that_are_none_are_refused_with_their_line(content, message):
    with pytest.raises(phc.FileFormatError, match=message):
        phc.read_csv(io.StringIO(content), input=False)


# --- frequency responses ---------------------------------------------------------------------------------------------

BODE_100 = "Frequency (Hz),Trace 1: Gain: Magnitude (dB),Trace 1: Gain: Phase (°)\n10,20,90\n100,0,0\n"
BODE_100_IMPEDANCE = "Frequency (Hz);Trace 1: Impedance: Real (Ω);Trace 1: Impedance: Imag (Ω)\n10;1,5;-2\n100;2,5;-1\n"
KEYSIGHT_FRA = "#,Frequency (Hz),Amplitude (Vpp),Gain (dB),Phase (°)\n1,10,0.5,20,90\n2,100,0.5,0,0\n"
GAMRY = (
    "ZCURVE\tTABLE\n\tPt\tTime\tFreq\tZreal\tZimag\tZmod\n\t#\ts\tHz\tohm\tohm\tohm\n"
    "\t0\t1\t10\t3\t-4\t5\n\t1\t3\t100\t1\t0\t1\n"
)
BIOLOGIC = (
    "EC-Lab ASCII FILE\nNb header lines : 3\nfreq/Hz\tRe(Z)/Ohm\t-Im(Z)/Ohm\ttime/s\t\n10\t3\t4\t0\n100\t1\t0\t1\n"
)
ZPLOT = (
    "ZPLOT2 ASCII\n  Data Points: 2\n  Freq(Hz)\tAmpl\tTime(Sec)\tZ'(a)\tZ''(b)\nEnd Comments\n"
    "10\t1\t2\t3\t-4\n100\t1\t3\t1\t0\n"
)
RESPONSES = {
    "OMICRON Bode 100": (BODE_100, {}, [10j, 1.0]),
    "OMICRON impedance": (BODE_100_IMPEDANCE, {}, [1.5 - 2j, 2.5 - 1j]),
    "Keysight FRA": (KEYSIGHT_FRA, {"magnitude": "Gain"}, [10j, 1.0]),
    "Gamry": (GAMRY, {}, [3 - 4j, 1.0]),
    "BioLogic": (BIOLOGIC, {}, [3 - 4j, 1.0]),
    "ZPlot": (ZPLOT, {}, [3 - 4j, 1.0]),
}  # fmt: skip


@pytest.mark.parametrize("case", RESPONSES)
def test_an_export_of_an_analyser_is_a_frequency_response(case):
    content, options, expected = RESPONSES[case]
    data = phc.read_frequency_csv(io.StringIO(content), **options)
    assert np.allclose(data.omega, [20 * np.pi, 200 * np.pi]) and np.allclose(data.frdata[0, 0], expected)


@pytest.mark.parametrize(
    "name, points, first",
    [
        ("exampleDataGamry.DTA", 72, 17007.49 - 6635.557j),
        ("exampleDataBioLogic.mpt", 43, 110.97003 - 2.3458567j),
        ("exampleDataZPlot.z", 21, 613.68 - 137.13j),
        ("Circuit1_EIS_1.z", 48, 75.803 - 0.16244j),
    ],
)
def test_measured_impedances_are_read_from_the_files_of_their_instruments(name, points, first):
    if not (IMPEDANCES / name).exists():
        pytest.skip(f"third-party data not at {IMPEDANCES}")
    data = phc.read_frequency_csv(IMPEDANCES / name)
    assert data.frdata.shape == (1, 1, points) and data.frdata[0, 0, 0] == pytest.approx(first)


# --- binary files ----------------------------------------------------------------------------------------------------


def tdms(path: Path, steps=(0.001, 0.001)) -> None:
    with nptdms.TdmsWriter(str(path)) as writer:
        writer.write_segment(
            [
                nptdms.ChannelObject("run", label, np.arange(3.0) + k, {"wf_increment": step, "unit_string": unit})
                for k, (label, unit, step) in enumerate(zip(("force", "acc"), "Ng", steps, strict=True))
            ]
        )  # fmt: skip


def test_tdms_brings_its_step_and_units(tmp_path):
    path = tmp_path / "run.tdms"
    tdms(path)
    data = phc.read_recording(path)
    assert data.time == pytest.approx([0, 0.001, 0.002]) and data.time_unit == "s"
    assert (data.input_labels, data.output_labels) == (["force [N]"], ["acc [g]"])
    assert data.inputs.tolist() == [0, 1, 2] and data.outputs.tolist() == [1, 2, 3]
    tdms(path, (0.001, 0.01))
    with pytest.raises(phc.FileFormatError, match="channels of several rates"):
        phc.read_recording(path)


def test_parquet_brings_instants(tmp_path):
    path = tmp_path / "run.parquet"
    instants = np.datetime64("2026-11-26T12:00:00") + np.array([0, 250, 500], "timedelta64[ms]")
    pyarrow.parquet.write_table(
        pyarrow.table({"when": instants, "u": [1, 2, 3], "y": [4, None, 6], "n": list("abc")}), path
    )
    data = phc.read_recording(path, input="u", output="y")
    assert data.time.tolist() == [0, 0.25, 0.5] and np.array_equal(data.outputs, [4, np.nan, 6], equal_nan=True)
    with pytest.raises(phc.FileFormatError, match=r"column 3 \('n'\) holds .* no numbers; choose another"):
        phc.read_recording(path, input="u", output="n")


def test_hdf5_is_read_by_paths(tmp_path):
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        file["run/t"], file["run/force"], file["run/acc"] = np.arange(3) / 2, np.arange(3.0), np.ones((3, 2))
    data = phc.read_recording(path, input="run/force", output=["run/acc"], time="run/t", time_unit="s")
    assert data.time.tolist() == [0, 0.5, 1] and data.output_labels == ["run.acc[0]", "run.acc[1]"]


def test_arrays_of_plain_hdf5_are_samples_by_channels(tmp_path):
    path = tmp_path / "run.h5"
    acc = np.arange(12.0).reshape(4, 3)
    with h5py.File(path, "w") as file:
        file["run/acc"] = acc
        file["other/acc"] = acc.T
        file["other/acc"].attrs["MATLAB_class"] = np.bytes_("double")
    for name in ("run/acc", "other/acc"):  # the second has the dimensions in the order of MATLAB, and its mark
        data = phc.read_recording(path, input=False, output=name, dt=0.1)
        assert np.array_equal(data.outputs, acc.T)
        data = phc.read_recording(path, input=f"{name}[0]", output=f"{name}[2]", dt=0.1)
        assert data.inputs.tolist() == [0, 3, 6, 9] and data.outputs.tolist() == [2, 5, 8, 11]


def test_wav_has_full_scale_one():
    file = io.BytesIO()
    scipy.io.wavfile.write(file, 100, np.array([0, 128, 255], np.uint8))
    file.name = "bell.wav"
    data = phc.read_recording(file, input=False)
    assert data.time.tolist() == [0, 0.01, 0.02] and data.outputs.tolist() == [-1, 0, 127 / 128]


@pytest.mark.parametrize("order", "<>")
def test_a_wav_file_that_was_cut_short_is_refused(order):
    file = io.BytesIO()
    scipy.io.wavfile.write(file, 100, np.zeros((200, 2), f"{order}i2"))
    whole = file.getvalue()

    def read(content):
        file = io.BytesIO(content)
        file.name = "bell.wav"
        return phc.read_recording(file, input="channel 1", output="channel 2")

    # what follows the samples may be missing, and the length unknown, of what was written to a pipe
    for content in (whole, whole + b"LIST" + bytes(6), whole[:40] + b"\xff\xff\xff\xff" + whole[44:]):
        assert read(content).outputs.shape == (200,)
    for size in (300, 301):
        with pytest.raises(phc.FileFormatError, match=f"announces 800 bytes of samples, and {size - 44} are there"):
            read(whole[:size])


@pytest.mark.parametrize("package, suffix", [("nptdms", "tdms"), ("pyarrow", "parquet"), ("h5py", "h5")])
def test_a_package_that_is_not_installed_is_named_with_its_installation(package, suffix, monkeypatch, tmp_path):
    path = tmp_path / f"run.{suffix}"
    path.write_bytes(b"\x89HDF\r\n\x1a\n" if suffix == "h5" else b"TDSm")
    for module in [name for name in sys.modules if name.partition(".")[0] == package] + [package]:
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(
        phc.MissingPackageError, match=rf"{package}, which is not installed: pip install 'ph_control\[formats\]'"
    ):
        phc.read_recording(path, input="u", output="y", dt=1.0)


@pytest.mark.parametrize("suffix", ["tdms", "parquet", "wav"])
def test_a_damaged_file_is_refused(suffix, tmp_path):
    path = tmp_path / f"run.{suffix}"
    path.write_bytes(b"RIFF no such file")
    with pytest.raises(phc.FileFormatError, match="or damaged"):
        phc.read_recording(path)


def test_a_binary_file_given_to_the_reader_of_texts_names_the_right_call(tmp_path):
    path = tmp_path / "run.tdms"
    tdms(path)
    with pytest.raises(phc.FileFormatError, match="not a text file, but TDMS; call") as caught:
        phc.read_csv(path)
    call = str(caught.value).rpartition("; call ")[2].removeprefix("ph_control.")
    assert eval(call, {"read_recording": phc.read_recording}).output_labels == ["acc [g]"]
    assert phc.read_recording(io.BytesIO(b"t,u,y\n0,1,2\n1,2,3\n")).outputs.tolist() == [2, 3]
