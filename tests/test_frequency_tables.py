"""Measured frequency responses from text tables."""

from __future__ import annotations

import io

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ph_control as phc
from ph_control import FileFormatError, FileMissingError, StructureError

PART = st.floats(-1e6, 1e6).filter(lambda x: x == 0 or abs(x) > 1e-6)


def read(text: str, **options) -> ct.FrequencyResponseData:
    return phc.read_frequency_csv(io.StringIO(text), **options)


def table(header: str, *columns) -> str:
    rows = [",".join(repr(float(x)) for x in row) for row in zip(*columns, strict=True)]
    return "\n".join([header, *rows]) + "\n"


@settings(deadline=None, max_examples=30, derandomize=True)
@given(st.lists(st.tuples(PART, PART).filter(any), min_size=1, max_size=5))
def test_a_response_comes_back_from_every_form_it_is_written_in(parts):
    G = np.array([complex(*part) for part in parts])
    omega = np.arange(1.0, len(G) + 1)
    forms = [
        table("omega,re,im", omega, G.real, G.imag),
        table("f [Hz],mag,phase [rad]", omega / 2 / np.pi, np.abs(G), np.angle(G)),
        table("freq_kHz,gain_db,phase_deg", omega / 2e3 / np.pi, 20 * np.log10(np.abs(G)), np.degrees(np.angle(G))),
    ]
    for text in forms:
        data = read(text)
        assert np.allclose(data.omega, omega, rtol=1e-14)
        # a decibel value carries the eps of its own size
        assert np.all(np.abs(data.frdata[0, 0] - G) <= 1e-13 * np.abs(G))


def test_quarter_turns_are_exact():
    data = read(table("w,mag,phase [deg]", [1, 2, 3, 4, 5], [2] * 5, [0, 90, 180, -90, 450]))
    assert data.frdata[0, 0].tolist() == [2, 2j, -2, -2j, 2j]


def test_rows_are_sorted_by_frequency_and_what_is_missing_is_nan():
    data = read("f [Hz];re;im\n2;5;6\n1;;4\n")
    assert np.allclose(data.omega, [2 * np.pi, 4 * np.pi])
    assert np.isnan(data.frdata[0, 0, 0]) and data.frdata[0, 0, 1] == 5 + 6j


@pytest.mark.parametrize("label", ["Impedance(Ohms)", "|Z| [ohm]", "Admittance (S)", "mobility", "|G|", "|Y| / S"])
def test_the_magnitude_may_be_called_by_what_it_is(label):
    found = phc.read_frequency_csv(io.StringIO(f"Freq(Hz),{label},Phase(Deg)\n10,7.5,90\n20,8,0\n"))
    assert np.array_equal(found.frdata[0, 0], [7.5j, 8.0])


def test_columns_and_units_can_be_said():
    data = read("9 20 90 1\n7 0 0 1\n", frequency=0, magnitude=1, phase=2, frequency_unit="Hz", magnitude_unit="dB",
                phase_unit="deg")  # fmt: skip
    assert np.allclose(data.omega, [14 * np.pi, 18 * np.pi])
    assert np.allclose(data.frdata[0, 0], [1, 10j], rtol=1e-15)
    given_unit = read("f [Hz],re,im\n1,2,3\n", frequency_unit="rad/s")
    assert given_unit.omega.tolist() == [1.0]


@pytest.mark.parametrize(
    "unit, factor", [("Hz", 1.0), ("kHz", 1e3), ("MHz", 1e6), ("GHz", 1e9), ("rad/s", 1 / 2 / np.pi)]
)
def test_units_of_frequency_stand_in_the_label_in_all_the_usual_ways(unit, factor):
    for label in (f"f [{unit}]", f"Frequency ({unit})", f"freq / {unit}"):
        assert np.allclose(read(f"{label},re,im\n1,2,3\n").omega, 2 * np.pi * factor, rtol=1e-15), label


@pytest.mark.parametrize(
    "text, message",
    [
        ("f,re,im\n1,2,3\n", r"column 0 \('f'\): its label tells no unit; say which with frequency_unit=.*'Hz'"),
        ("f [mHz],re,im\n1,2,3\n", "the unit 'mHz' is not known"),
        ("w,mag,phase\n1,2,3\n", "phase_unit=, one of 'deg', 'rad'"),
        ("w,mag,phase [deg]\n1,-2,3\n", "line 2, column 1.*magnitude is -2, .* magnitude_unit='dB'"),
        ("w,mag [dB],phase [deg]\n1,1e5,3\n", "100000 dB is beyond the range of doubles.*magnitude_unit='linear'"),
        ("w,a,b\n1,2,3\n", "which column is the magnitude and which the phase.*or real= and imag="),
        ("a,re,im\n1,2,3\n", "which column is the frequency.*frequency="),
        ("1,2,3\n2,3,4\n", "choose by number, 0 to 2"),
        ("w,re,im,mag,phase\n1,2,3,4,5\n", "magnitude and phase, and real and imaginary part as well"),
        ("w,omega,re,im\n1,1,3,4\n", "may both be the frequency; choose with frequency="),
        ("w,re,im\n,2,3\n", "line 2, column 0.*the frequency is missing"),
        ("w,re,im\n1,2,x\n", "'x' is not a number"),
        ("w,re,im\n-2,1,1\n-1,1,1\n1,1,-1\n", "has negative frequencies, the lowest -2 rad/s; leave them out"),
        ("f [GHz],re,im\n1,2,3\n1e300,2,3\n", r"line 3, column 0 .*1e\+300 is beyond the range of doubles in rad/s"),
        ("", "is empty"),
    ],
)
def test_what_is_no_frequency_response_is_refused_with_its_place_and_a_remedy(text, message):
    with pytest.raises(StructureError, match=message):
        read(text)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"real": "re", "magnitude": "im"}, "give one pair"),
        ({"real": "re", "imag": "re"}, "is chosen twice"),
        ({"frequency": "speed"}, "no column called 'speed'"),
        ({"frequency_unit": "rpm"}, "frequency_unit is 'rpm'"),
        ({"phase_unit": "turns"}, "phase_unit is 'turns'"),
        ({"magnitude_unit": "neper"}, "magnitude_unit is 'neper'"),
        ({"delimiter": ""}, "delimiter is ''; it must be one character"),
        ({"delimiter": 5}, "delimiter is 5; it must be one character"),
        ({"decimal": "x"}, "decimal is 'x'; it must be one of"),
        ({"header": "yes"}, "header is 'yes'; it must be True, False or None"),
        ({"real": "re"}, None),
    ],
)
def test_arguments_that_do_not_fit_are_refused(options, message):
    text = "w,re,im\n1,2,3\n"
    if message is None:
        assert read(text, **options).frdata[0, 0, 0] == 2 + 3j
        return
    with pytest.raises(StructureError, match=message):
        read(text, **options)


def test_a_file_is_read_and_its_name_is_the_title(tmp_path):
    path = tmp_path / "shaker.csv"
    path.write_text("omega,re,im\n1,2,3\n")
    assert phc.read_frequency_csv(path).title == "shaker.csv"
    with pytest.raises(FileMissingError):
        phc.read_frequency_csv(tmp_path / "absent.csv")
    path.write_bytes(b"\x00\xff")
    with pytest.raises(FileFormatError, match="not a text file"):
        phc.read_frequency_csv(path)


@pytest.mark.parametrize("reads", [phc.read_csv, phc.read_frequency_csv, phc.load])
def test_a_file_that_gives_no_content_is_refused(reads, tmp_path):
    path = tmp_path / "table.csv"
    path.write_bytes("w,re,im,\xe9\n1,2,3,4\n".encode("latin-1"))
    with path.open() as closed:
        pass
    with pytest.raises(StructureError, match=r"table\.csv cannot be read: .*closed file.*open it for reading"):
        reads(closed)
    with path.open(encoding="utf-8") as other, pytest.raises(StructureError, match="cannot be read: 'utf-8' codec"):
        reads(other)
    with path.open("w") as writing, pytest.raises(StructureError, match="cannot be read: not readable"):
        reads(writing)


def test_a_written_response_is_fitted_as_it_was_before():
    plant = phc.frenkel_kontorova(2)
    omega = np.linspace(0.205, 2.5, 120)
    G = plant.modes.freqresp(omega)
    fitted = phc.pem(read(table("f [Hz],mag,phase [deg]", omega / 2 / np.pi, abs(G), np.degrees(np.angle(G)))), 2)
    assert np.allclose(fitted.d, plant.d, rtol=1e-9) and np.allclose(fitted.r, plant.r, rtol=1e-9)
