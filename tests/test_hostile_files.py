"""Odd, damaged and hostile files of every format: read right, or refused with the file, the place and a remedy."""

from __future__ import annotations

import codecs
import io
import json
import struct
import sys
import zlib

import numpy as np
import pytest
import scipy.io
from shell import run

import ph_control as phc

h5py = pytest.importorskip("h5py")
pytest.importorskip("pyuff")
pytest.importorskip("skrf")


def stream(content, name):
    opened = io.BytesIO(content.encode() if isinstance(content, str) else content)
    opened.name = name
    return opened


def read(reader, content, name, options):
    """Numbers of what was read: the last output of a recording, the first entry of a response, the poles of a model."""
    data = reader(stream(content, name), **options)
    data = data[0] if isinstance(data, list) else data
    if hasattr(data, "frdata"):
        return data.frdata[0, 0].tolist()
    return np.atleast_2d(data.outputs)[-1].tolist() if hasattr(data, "outputs") else data.poles.imag.tolist()


# --- text ------------------------------------------------------------------------------------------------------------

TABLE = "t,u,y\n0,1,2\n0.5,1,3\n1,0,4.5\n"
GOOD = [2.0, 3.0, 4.5]
EIS = "freq/Hz\tRe(Z)/Ohm\t-Im(Z)/Ohm\n1,0\t2,5\t0,5\n2,0\t1,5\t0,25\n"
POINT = "f [Hz],mag,phase [deg]\n3,1,{}\n4,1,0\n"
CSV, FREQUENCY = phc.read_csv, phc.read_frequency_csv

TEXTS = {
    "UTF-16": (CSV, TABLE.encode("utf-16"), GOOD),
    "a byte order mark": (CSV, TABLE.encode("utf-8-sig"), GOOD),
    "old line ends": (CSV, TABLE.replace("\n", "\r"), GOOD),
    "line ends in the other order": (CSV, TABLE.replace("\n", "\n\r"), GOOD),
    "the mark of an end": (CSV, TABLE + "\x1a", GOOD),
    "a comment of megabytes": (CSV, "# " + 2_000_000 * "x" + "\n" + TABLE, GOOD),
    "labels over lines": (CSV, '"t","u\n[N]","y\r\n[m]"\n0,1,2\n0.5,1,3\n1,0,4.5\n', GOOD),
    "Latin-1": (CSV, TABLE.replace("u", "µ").encode("latin-1"), GOOD),
    "decimal commas": (CSV, "t;u;y\n0,0;1;2,0\n0,5;1;3,0\n1,0;0;4,5\n", GOOD),
    "decimal commas in quotes": (CSV, 't,u,y\n"0,0",1,"2,0"\n"0,5",1,"3,0"\n"1,0",0,"4,5"\n', GOOD),
    "UTF-16 without a mark": (CSV, TABLE.encode("utf-16-le"), "a.csv is not a text file.*UTF-8"),
    "UTF-32": (CSV, TABLE.encode("utf-32"), "a.csv is not a text file.*UTF-8"),
    "UTF-16 cut within a character": (CSV, TABLE.encode("utf-16")[:-1], "a.csv is not a text file.*UTF-8"),
    "a mark alone": (CSV, codecs.BOM_UTF16_LE, "a.csv is empty; it needs rows"),
    "nothing": (CSV, "", "a.csv is empty; it needs rows"),
    "one line": (CSV, "t,u,y\n", "a.csv has a header in line 1 and no rows"),
    "one sample": (CSV, "t,u,y\n0,1,2\n", r"a.csv has one row of numbers \(line 2\); at least two"),
    "no values": (CSV, "t,u,y\n0,1,nan\n1,1,\n2,1,-\n", "column 2 .'y'. has no values at all; choose"),
    "infinity": (CSV, TABLE.replace("3", "-inf"), "a.csv, line 3, column 2 .'y'.: '-inf' is not finite.*; correct it"),
    "a time that overflows": (CSV, TABLE.replace("\n1,", "\n1.7e308,"), "a.csv, line 4, column 0.*another unit"),
    "thousands": (CSV, TABLE.replace("4.5", "1'000.5"), "a.csv, line 4, column 2.*not a number; correct it"),
    "a word": (CSV, TABLE.replace("4.5", "\u0664"), "a.csv, line 4, column 2.*not a number; correct it"),
    "control characters": (CSV, TABLE.replace("4.5", "\x1b[31m"), "a.csv is not a text file"),
    "lost samples": (CSV, TABLE + "3,1,1\n3.5,1,1\n", "a.csv, line 5, column 0.*samples are lost"),
    "a quote that is left open": (CSV, TABLE.replace("t,", '"t,'), "a.csv, line 2: 3 fields, but the header has 1"),
    "a packed table": (CSV, b"PK\x03\x04" + bytes(30), "a.csv is not a text file"),
    "negative imaginary parts": (FREQUENCY, EIS, [2.5 - 0.5j, 1.5 - 0.25j]),
    "a minus of another width": (FREQUENCY, EIS.replace("-Im", "\u2212 Im"), [2.5 - 0.5j, 1.5 - 0.25j]),
    "minus in words": (FREQUENCY, EIS.replace("-Im(Z)/Ohm", "neg. Im"), [2.5 - 0.5j, 1.5 - 0.25j]),
    "primes": (FREQUENCY, EIS.replace("Re(Z)/", "Z' ").replace("-Im(Z)/", "-Z'' "), [2.5 - 0.5j, 1.5 - 0.25j]),
    "imaginary parts": (FREQUENCY, EIS.replace("-Im", "Im"), [2.5 + 0.5j, 1.5 + 0.25j]),
    "a negative phase": (FREQUENCY, POINT.replace("phase", "-phase").format(90), [-1j, 1.0]),
    "a phase without digits": (FREQUENCY, POINT.format("1e300"), "a.csv, line 2, column 2.*no digits left"),
    "a phase that is none": (FREQUENCY, POINT.format("inf"), "a.csv, line 2, column 2.*not finite"),
    "complex numbers": (FREQUENCY, "f [Hz],re,im\n1,1+2j,1\n2,1,1\n", "a.csv, line 2, column 1.*complex number; give"),
    "a unit nobody knows": (FREQUENCY, "f [rpm],re,im\n1,1,1\n", "column 0 .'f .rpm.'.: the unit 'rpm' is not known"),
}


@pytest.mark.parametrize("case", TEXTS)
def test_text_tables_are_read_right_or_refused_with_the_place(case):
    reader, content, expected = TEXTS[case]
    if isinstance(expected, str):
        with pytest.raises(phc.StructureError, match=expected):
            read(reader, content, "a.csv", {})
    else:
        assert np.allclose(read(reader, content, "a.csv", {}), expected, rtol=1e-15)


# --- networks --------------------------------------------------------------------------------------------------------

S = "# MHz S RI R 50\n1.0 0.0 0.0\n2.0 0.5 0.0\n"
SECOND = (
    "[Version] 2.0\n# MHz S RI R 50\n[Number of Ports] 1\n[Number of Frequencies] {}\n[Network Data]\n1 0 0\n2 .5 0\n"
)

DECIBELS = "# {}\n1 -20 0\n2 -40 0\n"  # impedances of 0.1 and 0.01 of the reference, if they are in decibels

NETWORKS = {
    "UTF-16": ("a.s1p", S.encode("utf-16"), [50.0, 150.0]),
    "old line ends": ("a.s1p", S.replace("\n", "\r"), [50.0, 150.0]),
    "options in another order": ("a.s1p", S.replace("MHz S RI R 50", "R 25 RI S MHz ! c"), [25.0, 75.0]),
    "options left out": ("a.z1p", DECIBELS.format("Z DB"), [5.0, 0.5]),
    "all but one left out": ("a.s1p", DECIBELS.format("DB"), [50 * 1.1 / 0.9, 50 * 1.01 / 0.99]),
    "an option twice": ("a.s1p", DECIBELS.format("MHz MHz DB"), "a.s1p is not a Touchstone file, or damaged.*mhz"),
    "an option that is none": ("a.s1p", DECIBELS.format("foo"), "a.s1p is not a Touchstone file, or damaged.*foo"),
    "version 2": ("a.ts", SECOND.format(2) + "[End]\n", [50.0, 150.0]),
    "version 2 that is cut": ("a.ts", SECOND.format(9), "a.ts has 2 frequencies, and says 9; copy"),
    "no reference": ("a.s1p", S.replace("R 50", "R 0"), "a.s1p has a reference impedance of 0 ohm"),
    "a negative reference": ("a.s1p", S.replace("R 50", "R -50"), "a.s1p has a reference impedance of -50 ohm"),
    "nothing": ("a.s1p", "", "a.s1p holds no frequencies"),
    "not a number": ("a.s1p", S.replace("0.5", "nan"), "a.s1p holds numbers that are not finite"),
    "decimal commas": ("a.s1p", S.replace(".", ","), "a.s1p is not a Touchstone file.*suffix"),
    "the ports of another": ("a.s2p", S, "a.s2p is not a Touchstone file.*suffix"),
    "no ports": ("a.s0p", S, "a.s0p is not a Touchstone file.*suffix"),
    "numbers of another program": ("a.s1p", b"\0\1", "a.s1p is not a text file"),
}


@pytest.mark.parametrize("case", NETWORKS)
def test_networks_are_read_right_or_refused(case):
    name, content, expected = NETWORKS[case]
    if isinstance(expected, str):
        with pytest.raises(phc.FileFormatError, match=expected):
            read(phc.read_touchstone, content, name, {})
    else:
        assert np.allclose(read(phc.read_touchstone, content, name, {}), expected, rtol=1e-12)


def test_the_frequency_of_a_network_without_a_unit_is_in_gigahertz():
    data = phc.read_touchstone(stream(DECIBELS.format("S DB"), "a.s1p"))
    assert np.allclose(data.omega, 2e9 * np.pi * np.array([1, 2]), rtol=1e-15)


# --- MATLAB ----------------------------------------------------------------------------------------------------------

T = 0.25 * np.arange(6.0)
U, Y, H = np.ones(6), 3.0 + np.arange(6.0), np.arange(1.0, 7.0) * (1 - 2j)


def level_5(**variables):
    with io.BytesIO() as buffer:
        scipy.io.savemat(buffer, variables)
        return buffer.getvalue()


def runs(*fields):
    """Row of structures."""
    found = np.empty((1, len(fields)), dtype=[(key, object) for key in fields[0]])
    for k, one in enumerate(fields):
        found[0, k] = tuple(one.values())
    return found


def cell(*values):
    found = np.empty((1, len(values)), dtype=object)
    found[0, :] = values
    return found


def column(values):
    return np.asarray(values)[:, None]


def put(group, name, values, kind="double"):
    """Array as MATLAB writes it in version 7.3: its dimensions in the other order."""
    made = group.create_dataset(name, data=np.asarray(values).T)
    made.attrs["MATLAB_class"] = np.bytes_(kind)
    return made


def references(group, name, targets, kind=None):
    made = group.create_dataset(name, (len(targets), 1), h5py.ref_dtype)
    for k, one in enumerate(targets):
        made[k, 0] = one.ref
    if kind:
        made.attrs["MATLAB_class"] = np.bytes_(kind)
    return made


def version_7_3(*builders):
    """File of arrays and what the builders add to it."""
    with io.BytesIO() as buffer:
        with h5py.File(buffer, "w", userblock_size=512) as file:
            for name, values in (("t", T), ("u", U), ("y", Y)):
                put(file, name, column(values))
            for build in builders:
                build(file)
        content = bytearray(buffer.getvalue())
    content[:128] = b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM"
    return bytes(content)


def with_runs(file):
    inner, struct_array = file.create_group("#refs#"), file.create_group("runs")
    struct_array.attrs["MATLAB_class"] = np.bytes_("struct")
    for key, values in (("t", T), ("u", U), ("y", Y)):
        made = [put(inner, f"{key}{k}", column(values * (1 if key == "t" else k + 1))) for k in range(2)]
        references(struct_array, key, made)
    references(file, "c", [put(inner, f"c{k}", column(Y + k)) for k in range(3)], "cell")


def with_structure(file):
    test = file.create_group("test")
    test.attrs["MATLAB_class"] = np.bytes_("struct")
    put(test, "f", column(T + 1))
    pairs = np.zeros(6, [("real", float), ("imag", float)])
    pairs["real"], pairs["imag"] = H.real, H.imag
    put(test, "frf", column(pairs))
    put(test, "frf2", np.stack([H, 2 * H, 3 * H, 4 * H, 5 * H, 6 * H], 1).real.reshape(6, 3, 2))


def with_sparse(file):
    group = file.create_group("sp")
    group.attrs["MATLAB_sparse"] = np.uint64(6)
    group["data"], group["ir"], group["jc"] = [7.0, 8.0], np.array([1, 4], "u8"), np.array([0, 2], "u8")


def with_nothing(file):
    empty = put(file, "e", np.array([0, 0], "u8"))
    empty.attrs["MATLAB_empty"] = 1
    put(file, "text", np.array([[104, 105]], "u2"), "char")
    file["word"] = "hello"
    references(file, "none", [])
    file.create_dataset("null", (2, 1), h5py.ref_dtype)


def with_circle(file):
    group = file.create_group("s")
    references(group, "a", [group, group])


def with_outer_data(file):
    file.create_dataset("x", (10,), "f8", external=[("/etc/hostname", 0, 80)])


def with_virtual_data(file):
    layout = h5py.VirtualLayout((6,), "f8")
    layout[:] = h5py.VirtualSource("other.h5", "d", (6,))
    file.create_virtual_dataset("v", layout)


def with_size_alone(file):
    file.create_dataset("x", (10**6, 10**6), "f8", chunks=(100, 100))


def with_object(file):
    put(file, "sys", np.arange(6, dtype="u4")).attrs["MATLAB_object_decode"] = 3


def linked(link):
    return lambda file: file.__setitem__("x", link)


SIMPLE = {"t": T, "u": U, "y": Y}
TWO = runs(SIMPLE, {"t": T, "u": 2 * U, "y": 2 * Y})
HERTZ = {"frequency": "test.f", "frequency_unit": "Hz"}
FRF = HERTZ | {"response": "test.frf"}
MAT, RESPONSE = phc.read_mat, phc.read_frequency_mat
ZEROS = struct.pack("<II", 15, len(packed := zlib.compress(bytes(1 << 20)))) + packed
NAMED = {one: {"input": f"{one}.u", "output": f"{one}.y", "time": f"{one}.t"} for one in ("runs[1]", "runs(2)", "a.b")}

MATRICES = {
    "fields": (MAT, level_5(a={"b": SIMPLE}), NAMED["a.b"], Y),
    "structures from 0": (MAT, level_5(runs=TWO), NAMED["runs[1]"], 2 * Y),
    "structures from 1": (MAT, level_5(runs=TWO), NAMED["runs(2)"], 2 * Y),
    "cells": (MAT, level_5(**SIMPLE, c=cell(Y, 5 * Y)), {"output": "c{2}"}, 5 * Y),
    "a column of a field": (MAT, level_5(**SIMPLE, r=runs({"z": np.c_[U, 4 * Y]})), {"output": "r.z[1]"}, 4 * Y),
    "integers": (MAT, level_5(t=np.arange(6, dtype=np.int8), u=U > 0, y=Y.astype(np.int16)), {}, Y),
    "responses in fields": (RESPONSE, level_5(test={"f": T + 1, "frf": column(H)}), FRF, H),
    "responses in structures": (
        RESPONSE, level_5(f=T + 1, r=runs({"H": H}, {"H": 2 * H})),
        {"frequency": "f", "response": ["r[1].H", "r[0].H"], "frequency_unit": "Hz"}, 2 * H,
    ),
    "version 7.3": (MAT, version_7_3(), {}, Y),
    "version 7.3, structures": (MAT, version_7_3(with_runs), NAMED["runs[1]"], 2 * Y),
    "version 7.3, structures from 1": (MAT, version_7_3(with_runs), NAMED["runs(2)"], 2 * Y),
    "version 7.3, cells": (MAT, version_7_3(with_runs), {"output": "c{3}"}, Y + 2),
    "version 7.3, sparse": (MAT, version_7_3(with_sparse), {"output": "sp"}, [0.0, 7.0, 0.0, 0.0, 8.0, 0.0]),
    "version 7.3, other things": (MAT, version_7_3(with_nothing), {}, Y),
    "version 7.3, responses": (RESPONSE, version_7_3(with_structure), HERTZ | {"response": "test.frf"}, H),
    "version 7.3, a matrix": (RESPONSE, version_7_3(with_structure), HERTZ | {"response": "test.frf2"}, H.real),
    "version 7.3, empty": (MAT, version_7_3(with_nothing), {"output": "e"}, "a.mat: e is empty; an array"),
    "version 7.3, a text": (MAT, version_7_3(with_nothing), {"output": "text"}, "a.mat: text is a text; an array"),
    "version 7.3, a circle": (MAT, version_7_3(with_circle), {}, "a.mat has arrays in more than"),
    "version 7.3, a file beside": (MAT, version_7_3(with_outer_data), {}, "a.mat: /x lies in another file"),
    "version 7.3, several files": (MAT, version_7_3(with_virtual_data), {}, "a.mat: /v lies in another file"),
    "version 7.3, a link": (MAT, version_7_3(linked(h5py.ExternalLink("b.h5", "/a"))), {}, "a.mat: x is a link; save"),
    "version 7.3, a link to nothing": (MAT, version_7_3(linked(h5py.SoftLink("/a"))), {}, "a.mat: x is a link; save"),
    "version 7.3, terabytes": (MAT, version_7_3(with_size_alone), {}, "a.mat: /x has 8000000000000 bytes by"),
    "version 7.3, an object": (MAT, version_7_3(with_object), {}, "a.mat holds a MATLAB object.*run there"),
    "version 7.3 that is cut": (MAT, version_7_3(with_runs)[:-900], {}, "a.mat is not a .mat file, or damaged.*-v7"),
    "version 7.3, its mark alone": (MAT, version_7_3()[:512], {}, "a.mat is not a .mat file, or damaged.*-v7"),
    "nothing": (MAT, b"", {}, "a.mat is not a .mat file, or damaged.*-v7"),
    "a head alone": (MAT, level_5(t=T)[:128], {}, "a.mat holds no arrays of numbers; save"),
    "zeros that were packed": (MAT, level_5(t=T)[:128] + ZEROS, {}, "a.mat is not a .mat file, or damaged.*-v7"),
    "infinity": (MAT, level_5(t=T, u=U, y=Y + np.inf), {}, "a.mat: y has infinite values; replace"),
    "an input that is missing": (MAT, level_5(t=T, u=U + np.nan, y=Y), {}, "a.mat: u has missing values"),
    "one sample": (MAT, level_5(t=1.0, u=1.0, y=1.0), {}, "a.mat holds a recording of one sample"),
    "a structure that is not there": (
        MAT, level_5(runs=TWO), {"input": "runs(3).u", "output": "runs(1).y", "time": "runs(1).t"}, "'runs.2..u'",
    ),
    "all structures": (MAT, level_5(**SIMPLE, r=TWO), {"output": "r"}, "a.mat: r is an array of structures; an array"),
    "a response twice": (
        RESPONSE, level_5(f=T + 1, H=H), {"frequency": "f", "response": ["H", "H"], "frequency_unit": "Hz"},
        "a.mat: H is named twice",
    ),
    "a frequency that overflows": (
        RESPONSE, level_5(f=1e307 * (T + 1), H=H), {"frequency": "f", "response": "H", "frequency_unit": "GHz"},
        "a.mat: f is beyond the range of doubles",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", MATRICES)
def test_matlab_files_are_read_right_or_refused(case):
    reader, content, options, expected = MATRICES[case]
    if isinstance(expected, str):
        with pytest.raises(phc.StructureError, match=expected):
            read(reader, content, "a.mat", options)
    else:
        assert np.allclose(read(reader, content, "a.mat", options), expected, rtol=1e-15)


def test_names_with_dots_give_labels_without_them_that_differ():
    content = level_5(f=T + 1, a={"b": H}, a_b=2 * H)
    data = phc.read_frequency_mat(stream(content, "a.mat"), "f", ["a.b", "a_b"], frequency_unit="Hz")
    assert len(set(data.output_labels)) == 2 and not any("." in label for label in data.output_labels)
    assert np.array_equal(data[1, 0].frdata.ravel(), 2 * H)


def test_without_h5py_the_extra_is_named(monkeypatch):
    content = version_7_3()
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(phc.MissingPackageError, match=r"a.mat .*h5py.*ph_control\[formats\].*'-v7'"):
        phc.read_mat(stream(content, "a.mat"))


def test_damaged_files_of_version_7_3_are_refused_with_an_error_of_the_package():
    content, rng = version_7_3(with_runs), np.random.default_rng(11)
    refused = 0
    for _ in range(60):
        damaged = bytearray(content)
        for place in rng.integers(512, len(content), 4):
            damaged[place] = rng.integers(256)
        try:
            phc.read_mat(stream(bytes(damaged), "a.mat"))
        except phc.PHControlError:
            refused += 1
    assert refused > 10


# --- models ----------------------------------------------------------------------------------------------------------


def document(folder, **changes):
    path = folder / "model.json"
    phc.save(phc.modes([1.5, 4.0], [0.5, 0.25]), path, overwrite=True)
    content = json.loads(path.read_text())
    del content["sha256"]
    content["data"] |= changes
    return json.dumps(content)


@pytest.mark.parametrize(("encoding", "said"), [
    ("utf-8-sig", None), ("latin-1", None), ("utf-16", "a.json is not JSON"), ("utf-32", "a.json is not JSON"),
])  # fmt: skip
def test_documents_in_other_encodings(tmp_path, encoding, said):
    content = document(tmp_path).encode(encoding)
    if said is None:
        assert np.allclose(sorted(read(phc.load, content, "a.json", {}))[-2:], [1.5, 4.0])
    else:
        with pytest.raises(phc.FileFormatError, match=said):
            read(phc.load, content, "a.json", {})


@pytest.mark.parametrize(("value", "said"), [
    ([1.5, "nan"], 'd is "nan", expected a number'), ([[1.5, 4.0]], "d has shape"), (None, "d has shape"),
    ({"shape": [10**9], "float64": ""}, "d is an object"), ({"shape": [-1], "float64": ""}, "d is an object"),
    ([0.0, 4.0], "d is not positive"), ([1.5], "nu has shape"), ("\x1b[31m", "d has shape"),
])  # fmt: skip
def test_documents_with_other_values_name_the_field(tmp_path, value, said):
    with pytest.raises(phc.FileFormatError, match=f"^a.json.*{said}"):
        read(phc.load, document(tmp_path, d=value), "a.json", {})


# --- names -----------------------------------------------------------------------------------------------------------

ODD = "a\n\x1b]0;owned\x07\x1b[31m\x9b2J\u202eb"


def is_printable(text):
    return not any(mark in text for mark in "\x1b\x07\x9b\u202e")


READERS = {
    "csv": CSV, "s1p": phc.read_touchstone, "mat": MAT, "uff": phc.read_uff, "json": phc.load, "cir": phc.read_netlist,
}  # fmt: skip


@pytest.mark.parametrize("suffix", READERS)
def test_names_of_files_do_not_steer_the_terminal(tmp_path, suffix):
    name = f"{ODD}.{suffix}"
    with pytest.raises(phc.PHControlError) as refused:
        READERS[suffix](stream("what is in it", name))
    assert is_printable(str(refused.value)) and "\n" not in str(refused.value) and r"a\n\x1b]0;" in str(refused.value)
    with pytest.raises(phc.PHControlError) as missing:
        READERS[suffix](tmp_path / name)
    assert is_printable(str(missing.value))


def test_names_in_files_do_not_steer_the_terminal(tmp_path):
    path = tmp_path / "odd.csv"
    path.write_bytes("t,force\x9b31m,\u202emotion\n0,1,2\n1,2,3\n2,3,4\n".encode())
    data = phc.read_csv(path)
    assert data.input_labels == [r"force\x9b31m"] and data.output_labels == [r"\u202emotion"]
    model = phc.ph(phc.modes([1.0], [0.5]), inputs=["\x1b[31mu"], outputs=["y"], name="\x9b2J")
    assert is_printable(str(model))
    phc.save(model, tmp_path / "model.json")
    assert phc.load(tmp_path / "model.json").input_labels == ["\x1b[31mu"]
    for words in (["info", str(tmp_path / "model.json")], ["info", f"x{ODD}.csv"], ["fit", f"{ODD}", "--input", ODD]):
        done = run(*words)
        assert is_printable(done.out + done.error) and done.out + done.error


@pytest.mark.parametrize("content", [None, 3, ["t,u,y"]])
def test_what_is_no_content_is_refused(content):
    class Odd:
        name = "odd.csv"

        def read(self):
            return content

    with pytest.raises(phc.StructureError, match=r"odd.csv gives"):
        phc.read_csv(Odd())


def test_a_file_that_cannot_be_read_says_so(tmp_path, monkeypatch):
    def refused(path):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pathlib.Path.read_bytes", refused)
    with pytest.raises(phc.StructureError, match=r"a.csv cannot be read: Permission denied; check its permissions"):
        phc.read_csv(tmp_path / "a.csv")
