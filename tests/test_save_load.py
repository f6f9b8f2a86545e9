"""Models to JSON files and back."""

from __future__ import annotations

import base64
import builtins
import copy
import dataclasses
import functools
import io
import json
import math
import os
import re
import stat
import struct
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ph_control as phc
from ph_control import FileFormatError, OutputExistsError, PHControlError, StructureError, load, save

property_test = settings(deadline=None, max_examples=20, derandomize=True)


def assert_same_bits(first, second):
    assert (first.shape, first.dtype) == (second.shape, second.dtype)
    assert first.tobytes() == second.tobytes()


def assert_same_modes(first, second):
    assert type(second) is phc.ModalForm
    for name in ("d", "nu", "rigid", "r"):
        assert_same_bits(getattr(first, name), getattr(second, name))


def assert_same_system(first, second):
    assert type(second) is phc.PortHamiltonian
    assert (first._given is None) == (second._given is None)
    if first._given is None:
        assert_same_modes(first.modes, second.modes)
    assert_same_bits(first.Q, second.Q)
    assert_same_bits(first.B, second.B)
    for name in ("name", "input_labels", "output_labels", "state_labels", "dt"):
        assert getattr(first, name) == getattr(second, name)


def assert_same(first, second):
    (assert_same_modes if isinstance(first, phc.ModalForm) else assert_same_system)(first, second)


# --- round trips -------------------------------------------------------------------------------------------------

moderate = st.floats(1e-150, 1e150)
entries = st.one_of(st.floats(-1e100, 1e100), st.sampled_from([0.0, -0.0, 5e-324, 0.1, 1 / 3, 1e22, 2.0**53 + 2]))
labels = st.text(min_size=1, max_size=6).filter(lambda text: "." not in text)


@st.composite
def modal_forms(draw):
    n, m, k = draw(st.integers(0, 4)), draw(st.integers(1, 3)), draw(st.integers(0, 2))
    d = np.sort(np.array(draw(st.lists(moderate, min_size=n, max_size=n))))
    real, imag = (np.array(draw(st.lists(entries, min_size=n * m, max_size=n * m))).reshape(n, m) for _ in range(2))
    nu = np.empty((n, m), complex)
    nu.real, nu.imag = real, imag
    rigid = np.array(draw(st.lists(entries, min_size=k * m, max_size=k * m))).reshape(k, m)
    return phc.ModalForm(d.astype(float), nu, rigid.astype(float))


@st.composite
def systems(draw):
    n, m = draw(st.integers(1, 3)), draw(st.integers(1, 2))
    factor = np.random.default_rng(draw(st.integers(0, 2**32))).standard_normal((2 * n, 2 * n))
    Q = factor @ factor.T + np.eye(2 * n)
    B = np.array(draw(st.lists(entries, min_size=2 * n * m, max_size=2 * n * m))).reshape(2 * n, m)
    B[0, 0] = 1.0  # an input matrix of nothing but the smallest doubles is out of range
    names = {
        kind: draw(st.lists(labels, min_size=count, max_size=count, unique=True))
        for kind, count in (("inputs", m), ("outputs", m), ("states", 2 * n))
    }
    return phc.PortHamiltonian(Q, B, name=draw(labels), **names)


def round_trip(obj, folder):
    path = folder.getbasetemp() / "round_trip.json"
    save(obj, path, overwrite=True)
    return load(path)


@pytest.mark.parametrize(
    "make",
    [
        lambda: phc.ch([2.0, 1 / 3], [0.1, -0.0, 5e-324, 1e22], name="form", inputs="force"),
        lambda: phc.oh([1e-9], [1 / 3, 0.1]),
        lambda: phc.oh([0.0, 0.1, 1.0, 0.3], [0.1, 0.2, 0.3, 0.4]),
        lambda: phc.affine(np.diag([0.1, 1 / 3]), [1.0, 0.1], outputs="displacement"),
    ],
    ids=["controllable", "observable", "doubled", "affine"],
)
def test_canonical_and_affine_systems_come_back_bit_for_bit(make, tmp_path):
    system = make()
    save(system, tmp_path / "model.json")
    back = load(tmp_path / "model.json")
    assert type(back) is type(system)
    for name in ("Q", "C") if isinstance(system, phc.AffineHamiltonian) else ("d", "v"):
        assert_same_bits(getattr(system, name), getattr(back, name))
    for name in ("name", "input_labels", "output_labels", "state_labels"):
        assert getattr(system, name) == getattr(back, name)


def test_a_gain_which_has_no_states_comes_back(tmp_path):
    resistor = phc.ph(ct.tf([2.0], [1.0]), name="resistor")
    assert resistor.nstates == 0
    save(resistor, tmp_path / "model.json")
    back = load(tmp_path / "model.json")
    assert (type(back), back.name, back.D.tolist()) == (type(resistor), "resistor", [[2.0]])
    for part in "QGJRPSN":
        assert_same_bits(getattr(resistor, part), getattr(back, part))


@property_test
@given(modes=modal_forms())
def test_every_modal_form_comes_back_bit_by_bit(tmp_path_factory, modes):
    assert_same_modes(modes, round_trip(modes, tmp_path_factory))


@pytest.mark.slow
@property_test
@given(system=systems())
def test_every_system_comes_back_bit_by_bit_with_its_names(tmp_path_factory, system):
    assert_same_system(system, round_trip(system, tmp_path_factory))


@property_test
@given(modes=modal_forms())
def test_system_made_from_modes_stays_one(tmp_path_factory, modes):
    system = phc.ph(modes, name="from modes")
    restored = round_trip(system, tmp_path_factory)
    assert restored._given is None
    assert_same_system(system, restored)


def test_what_the_package_makes_can_be_saved(tmp_path_factory):
    chain = phc.ph(np.diag([2.0, 1.0, 1.0, 3.0]), [0.0, 0.0, 1.0, 0.5])
    made = [
        phc.ph(ct.tf([2, 0], [1, 0, 4])),
        phc.ph(ct.tf([3, 0, 1], [1, 0, 1, 0])),
        phc.ph(phc.modes([], [])),
        phc.ph(np.zeros((2, 2)), [1.0, -0.0]),
        chain + chain,
        2.5 * chain,
        0.1 * (3 * phc.ph(chain.modes)),
        phc.ph(ct.ss(chain)),
        chain.modes,
        chain.modes.minimal(),
    ]
    for obj in made:
        assert_same(obj, round_trip(obj, tmp_path_factory))


def test_weights_that_differ_from_nu_in_the_last_bit_are_kept(tmp_path_factory):
    modes = phc.modes([1.0, 2.0], [2.0, 0.3])
    assert (np.abs(modes.nu[:, 0]) ** 2 != modes.r).any()
    assert_same_modes(modes, round_trip(modes, tmp_path_factory))


def test_saving_twice_gives_the_same_bytes(tmp_path):
    modes = phc.modes([1.0, 2.0], [2.0, 0.3])
    save(modes, tmp_path / "first.json")
    save(load(tmp_path / "first.json"), str(tmp_path / "second.json"))
    assert (tmp_path / "first.json").read_bytes() == (tmp_path / "second.json").read_bytes()


# --- the file ----------------------------------------------------------------------------------------------------


@pytest.fixture
def model():
    """System of two degrees of freedom that has everything the schema can hold."""
    return phc.ph(phc.modes([0.1, 2.0], [1 / 3, 0.5]), name="a bridge", inputs="force [N]", outputs="v")


@pytest.fixture
def path(tmp_path):
    """Where the tests save."""
    return tmp_path / "model.json"


def test_document_follows_the_schema_in_the_manual(path, model):
    save(model, path)
    document = json.loads(path.read_text())
    assert document.pop("sha256")
    root = [float(model.modes.nu[l, 0].real) for l in range(2)]
    assert document == {
        "format": "ph_control",
        "schema": 2,
        "kind": "PortHamiltonian",
        "data": {
            "name": "a bridge",
            "inputs": ["force [N]"],
            "outputs": ["v"],
            "states": ["x[0]", "x[1]", "x[2]", "x[3]"],
            "modes": {
                "ports": 1,
                "d": [0.1, 2.0],
                "nu": [[[root[0], 0.0]], [[root[1], 0.0]]],
                "rigid": [],
                "r": [1 / 3, 0.5],
            },
        },
    }


def test_system_from_matrices_holds_them_as_given(path):
    save(phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0]), path)
    data = json.loads(path.read_text())["data"]
    assert (data["Q"], data["B"]) == ([[4.0, 0.0], [0.0, 1.0]], [[0.0], [1.0]])
    assert "modes" not in data


def test_document_is_laid_out_for_people(path, model):
    save(model, path)
    lines = path.read_text().splitlines()
    assert '      "d": [0.1, 2.0],' in lines
    assert lines[-1] == "}" and path.read_text().endswith("}\n")
    assert path.read_text().isascii()


def test_existing_file_is_refused_and_left_as_it_was(path, model):
    path.write_text("precious")
    with pytest.raises(
        OutputExistsError, match=r"model\.json exists already; choose another name, or pass overwrite=True"
    ):
        save(model, path)
    assert path.read_text() == "precious"
    assert os.listdir(path.parent) == ["model.json"]


def test_overwriting_replaces_when_asked_for(path, model):
    path.write_text("old")
    save(model, path, overwrite=True)
    assert_same_system(model, load(path))
    assert os.listdir(path.parent) == ["model.json"]


def test_file_that_appears_in_the_last_moment_is_not_overwritten(path, model, monkeypatch):
    written = os.fsync

    def somebody_else_is_faster(descriptor):
        path.write_text("theirs")
        written(descriptor)

    monkeypatch.setattr(os, "fsync", somebody_else_is_faster)
    with pytest.raises(OutputExistsError, match="exists already"):
        save(model, path)
    assert path.read_text() == "theirs"
    assert os.listdir(path.parent) == ["model.json"]


@pytest.mark.parametrize("failing", ["fsync", "replace"])
@pytest.mark.parametrize("overwrite", [False, True])
def test_failure_while_writing_leaves_nothing_behind_and_the_old_file_whole(
    path, model, monkeypatch, failing, overwrite
):
    def disk_full(*_):
        raise OSError(28, "No space left on device")

    if overwrite:
        path.write_text("old")
    monkeypatch.setattr(os, failing, disk_full)
    with pytest.raises(OSError, match=r"No space left on device: '.*model\.json'"):
        save(model, path, overwrite=overwrite)
    assert os.listdir(path.parent) == (["model.json"] if overwrite else [])
    if overwrite:
        assert path.read_text() == "old"


# of two processes one is killed while it writes, the other goes on when it is told to
KILLED = """
import os, signal, sys
import ph_control as phc

other = os.fork()

def ended(descriptor):
    if not other:
        os.kill(os.getpid(), signal.SIGKILL)
    print(os.waitstatus_to_exitcode(os.wait()[1]), flush=True)
    sys.stdin.readline()

os.fsync = ended
phc.save(phc.modes(1.0, 2.0), sys.argv[1 if other else 2])
"""


@pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")
def test_what_a_killed_process_leaves_is_removed_by_the_next_one_and_nothing_else(path, model, tmp_path):
    own = [".ph_control-notes.tmp", "x.tmp", ".ph_control-0123456789abcdef.tmp.txt", "ph_control-0123456789abcdef.tmp"]
    for name in own:
        (tmp_path / name).write_text("mine")
    words = [sys.executable, "-c", KILLED, str(tmp_path / "living.json"), str(tmp_path / "killed.json")]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as living:
        assert living.stdout.readline() == "-9\n"
        assert len(os.listdir(tmp_path)) == len(own) + 2
        save(model, path)
        (left,) = {*os.listdir(tmp_path)} - {*own, path.name}
        assert (tmp_path / left).stat().st_size
        living.communicate("go on\n")
    assert living.returncode == 0
    assert sorted(os.listdir(tmp_path)) == sorted([*own, path.name, "living.json"])
    assert load(tmp_path / "living.json").r.tolist() == [2.0]


@pytest.mark.skipif(os.name != "posix", reason="links are those of POSIX")
def test_what_may_be_written_by_another_computer_is_removed_after_a_day(path, model, tmp_path):
    other, link = tmp_path / ".ph_control-0123456789abcdef.tmp", tmp_path / ".ph_control-fedcba9876543210.tmp"
    other.write_text("half")
    link.symlink_to(tmp_path / "somewhere")
    save(model, path)
    assert other.exists()
    os.utime(other, (0, 0))
    save(model, path, overwrite=True)
    assert not other.exists() and link.is_symlink()


@pytest.mark.skipif(os.name != "posix", reason="file modes are those of POSIX")
@pytest.mark.parametrize("overwrite", [False, True])
def test_permissions_are_those_of_any_new_file(path, model, overwrite):
    for mask in (0o022, 0o027):
        before = os.umask(mask)
        try:
            path.unlink(missing_ok=True)
            save(model, path, overwrite=overwrite)
        finally:
            os.umask(before)
        assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~mask


@pytest.mark.skipif(os.name != "posix", reason="file modes are those of POSIX")
def test_a_file_that_is_replaced_keeps_its_permissions(path, model):
    path.write_text("old")
    path.chmod(0o640)
    save(phc.modes(1.0, 2.0), path, overwrite=True)
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    path.chmod(0o440)
    with pytest.raises(OutputExistsError, match="is read-only; make it writable"):
        save(model, path, overwrite=True)
    assert load(path).r.tolist() == [2.0]
    assert os.listdir(path.parent) == ["model.json"]


@pytest.mark.parametrize("ports", [0, 10**6, 10**12, 10**30])
def test_a_number_of_ports_without_entries_is_refused_before_room_is_made_for_them(ports):
    data = {"ports": ports, "d": [], "nu": [], "rigid": [], "r": []}
    document = {"format": "ph_control", "schema": 1, "kind": "ModalForm", "data": data}
    with pytest.raises(FileFormatError, match=r"ports is \d+; a model has at least one port, and at most 16384"):
        load(io.StringIO(json.dumps(document)))


@pytest.mark.skipif(os.name != "posix", reason="symbolic links need no privilege on POSIX only")
def test_overwriting_through_a_symbolic_link_writes_the_file_it_points_at(path, model):
    (path.parent / "elsewhere").mkdir()
    target = path.parent / "elsewhere" / "real.json"
    path.symlink_to(target)
    with pytest.raises(OutputExistsError):
        save(model, path)
    save(model, path, overwrite=True)
    assert path.is_symlink() and not target.is_symlink()
    assert_same_system(model, load(target))


@pytest.mark.parametrize("overwrite", [False, True])
def test_folder_cannot_be_overwritten(tmp_path, model, overwrite):
    with pytest.raises(OutputExistsError, match="is a folder; pass the name of a file in it"):
        save(model, tmp_path, overwrite=overwrite)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes in folders")
@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("linked", [False, True])
def test_what_is_no_regular_file_is_never_replaced(path, model, overwrite, linked):
    pipe = path.parent / "pipe"
    os.mkfifo(pipe)
    target = path if linked else pipe
    if linked:
        path.symlink_to(pipe)
    before = sorted(os.listdir(path.parent))
    with pytest.raises(OutputExistsError, match="is not a regular file, but a device, a pipe or a socket; choose"):
        save(model, target, overwrite=overwrite)
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert sorted(os.listdir(path.parent)) == before


@pytest.mark.parametrize(
    "suffix, command", [(".mat", "convert"), (".csv", "convert"), (".TXT", "convert"), (".cir", "netlist")]
)
def test_a_name_that_promises_another_format_is_refused(tmp_path, model, suffix, command):
    with pytest.raises(
        StructureError, match=rf"would hold JSON, which .* end its name in \.json, and .*`ph-control {command} model"
    ):
        save(model, tmp_path / f"model{suffix}")
    assert not os.listdir(tmp_path)


def test_a_model_in_place_of_the_name_is_told_by_its_type(path, model):
    with pytest.raises(StructureError, match=r"^path is PortHamiltonian; it must be the name of a file"):
        save(path, model)


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("name", ["x" * 5000, "nul\0nul"], ids=["too long", "zero byte"])
def test_name_that_cannot_be_one_of_a_file_is_refused_in_writing_and_reading(tmp_path, model, overwrite, name):
    for use in (lambda path: save(model, path, overwrite=overwrite), load, phc.read_csv):
        with pytest.raises(StructureError, match=r"cannot be the name of a file: .*; choose another name") as caught:
            use(tmp_path / name)
        assert len(str(caught.value)) < 300
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("path", [None, 3, b"model.json", ""])
def test_path_that_is_no_path_is_refused_in_writing_and_reading(model, path):
    for use in (lambda path: save(model, path), load, phc.read_csv, phc.read_netlist):
        with pytest.raises(StructureError, match=r"^path is .*; it must be the name of a file, as a string or"):
            use(path)


@pytest.mark.parametrize("overwrite", [False, True])
def test_folder_that_cannot_be_written_is_told_with_the_name_of_the_file(path, model, monkeypatch, overwrite):
    def denied(*_, **__):
        raise PermissionError(13, "Permission denied", "temporary name")

    monkeypatch.setattr(builtins, "open", denied)
    with pytest.raises(PermissionError, match=r"Permission denied: '.*model\.json'"):
        save(model, path, overwrite=overwrite)


@pytest.mark.skipif(os.name != "posix", reason="symbolic links need no privilege on POSIX only")
def test_overwriting_through_a_link_into_a_missing_folder_says_which_folder(path, model):
    path.symlink_to(path.parent / "absent" / "model.json")
    with pytest.raises(PHControlError, match=r"the folder .*absent does not exist; make it first"):
        save(model, path, overwrite=True)


def test_missing_folder_is_an_error_of_both_families(tmp_path, model):
    with pytest.raises(PHControlError, match=r"the folder .*absent does not exist; make it first") as caught:
        save(model, tmp_path / "absent" / "model.json")
    assert isinstance(caught.value, FileNotFoundError)


class Subclass(phc.PortHamiltonian):
    """A system that knows more than its base."""


@pytest.mark.parametrize(
    "obj", [ct.tf([1], [1, 0]), 3.0, None, [1], Subclass(np.eye(2), [0.0, 1.0])], ids=lambda obj: type(obj).__name__
)
def test_object_of_another_type_is_refused_by_its_name(path, obj):
    expected = rf"an object of type {type(obj).__name__} cannot be saved, only PortHamiltonian, ModalForm"
    with pytest.raises(StructureError, match=expected):
        save(obj, path)
    assert not path.exists()


def test_refusal_of_a_plain_state_space_names_calls_that_work(path):
    sys = ct.ss([[0.0, 1.0], [-4.0, -0.1]], [[0.0], [1.0]], [[0.3, 1.0]], 0.0)
    with pytest.raises(StructureError, match=r"save\(modes\(sys\), path\); a fit .* by result\.save\(path\)"):
        save(sys, path)
    save(phc.modes(sys), path)
    np.testing.assert_allclose(load(path).evaluate([1j]), phc.modes(sys).evaluate([1j]), rtol=1e-15)


def test_model_that_could_not_be_loaded_is_not_written(path):
    infinite = phc.ModalForm._of(np.array([1.0]), np.array([[1.0 + 0j]]), np.zeros((0, 1)), np.array([np.inf]))
    with pytest.raises(StructureError, match=r'this ModalForm cannot be saved.*r is "inf", expected a number'):
        save(infinite, path)
    unsorted = phc.ModalForm._of(np.array([2.0, 1.0]), np.ones((2, 1), complex), np.zeros((0, 1)))
    with pytest.raises(StructureError, match=r"this ModalForm cannot be saved.*d is not ascending"):
        save(unsorted, path)
    assert not path.exists()


# --- refusals ----------------------------------------------------------------------------------------------------


@pytest.fixture
def message(path):
    """What the error that loading ends in says about the file."""

    def run(content):
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        with pytest.raises(FileFormatError) as caught:
            load(path)
        text = str(caught.value)
        assert text.startswith(str(path))
        return text.removeprefix(str(path)).lstrip(": ")

    return run


@pytest.fixture
def document(path, model):
    """Valid document without checksum, to be spoilt."""
    save(model, path)
    content = json.loads(path.read_text())
    del content["sha256"]
    return content


@pytest.fixture
def matrices(path):
    """Valid document of a system given by its matrices, without checksum."""
    save(phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0]), path)
    content = json.loads(path.read_text())
    del content["sha256"]
    return content


def test_document_without_checksum_is_read(path, document, model):
    path.write_text(json.dumps(document))
    assert_same_system(model, load(path))


def test_byte_order_mark_and_white_space_do_no_harm(path, model):
    save(model, path)
    text = json.dumps(json.loads(path.read_text()), indent=3).replace("\n", "\r\n")
    path.write_bytes(b"\xef\xbb\xbf\r\n" + text.encode())
    assert_same_system(model, load(path))


def test_changed_digit_is_found_by_the_checksum(path, model, message):
    save(model, path)
    text = path.read_text()
    assert text.count("0.5]") == 1
    spoilt = message(text.replace("0.5]", "0.6]"))
    assert "is damaged: its content does not match its checksum; restore it from a copy" in spoilt
    assert 'delete the line "sha256"' in spoilt


def test_number_edited_on_purpose_is_read_without_the_checksum(path, document):
    document["data"]["modes"]["d"] = [1, 2]
    path.write_text(json.dumps(document))
    assert load(path).d.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("", "is empty; pass a file that ph_control.save has written"),
        (" \n", "is empty"),
        ("t,u,y\n0,1,2\n", "is not JSON, or damaged or cut short: Expecting value: line 1 column 1"),
        (
            '{"format": "ph_control",\n "schema": 1',
            "is not JSON, or damaged or cut short: Expecting ',' delimiter: line 2",
        ),
        (b"\x89PNG", "is not JSON, or damaged or cut short: 'utf-8' codec can't decode byte 0x89"),
        ("[1, 2]", 'is JSON, but not a ph_control file: it has no "format": "ph_control"'),
        ("{}", "is JSON, but not a ph_control file"),
        ('{"format": "other"}', "is JSON, but not a ph_control file"),
        ("[" * 100_000, "is damaged: it is nested too deeply"),
        ('{"a":' * 100_000, "is damaged: it is nested too deeply"),
        ("1" * 5000, "is not JSON, or damaged or cut short: "),
    ],
    ids=lambda value: str(value)[:20],
)
def test_file_that_is_no_document_says_what_it_is(message, content, expected):
    assert message(content).startswith(expected)


def test_every_truncation_is_refused(path, model, message):
    save(model, path)
    content = path.read_bytes().rstrip()
    for length in range(0, len(content), 7):
        assert "empty" in (text := message(content[:length])) or "cut short" in text


def test_a_document_of_schema_1_is_read(path, model):
    """Its content is that of schema 2, without systems with losses."""
    save(model, path)
    text = path.read_text()
    path.write_text(text.replace('"schema": 2', '"schema": 1'))
    assert '"schema": 1' in path.read_text() and load(path).input_labels == model.input_labels


NOTHING = object()


def packed(numbers, *shape):
    """An array as its bytes."""
    content = base64.b64encode(zlib.compress(struct.pack(f"<{len(numbers)}d", *numbers)))
    return {"shape": list(shape), "float64": content.decode()}


def test_long_arrays_are_their_bytes_and_short_ones_as_well_where_they_are_so(path, tmp_path):
    modes = phc.modes(np.arange(1.0, 12_002.0), np.linspace(0.1, 1.0, 12_001))
    save(modes, path)
    assert 2 * path.stat().st_size < len(repr(modes.d.tolist()) + 3 * repr(modes.r.tolist()))
    assert_same_modes(modes, load(path))
    document = json.loads(path.read_text())
    assert document["data"]["d"] == packed(modes.d, 12_001)
    save(phc.modes([0.1, 2.0], [1.0, 1.0]), path, overwrite=True)
    document = json.loads(path.read_text())
    document["data"]["d"] = packed([0.1, 2.0], 2)
    del document["sha256"]
    path.write_text(json.dumps(document))
    assert load(path).d.tolist() == [0.1, 2.0]


@pytest.mark.parametrize(
    ("place", "value", "expected"),
    [
        (["schema"], 3, "has schema 3; this version of ph_control reads schemas 1 to 2: upgrade ph_control"),
        (["schema"], 0, "has schema 0; this version of ph_control reads schemas 1 to 2"),
        (["schema"], "1", 'schema is "1", expected an integer'),
        (["schema"], True, "schema is true, expected an integer"),
        (["schema"], 1.0, "schema is 1.0, expected an integer"),
        (["schema"], NOTHING, "the field 'schema' is missing"),
        (["kind"], "Spaceship", "holds a 'Spaceship'; this version of ph_control reads 'PortHamiltonian', 'Mod"),
        (["kind"], 7, "kind is 7, expected a string"),
        (["kind"], NOTHING, "the field 'kind' is missing"),
        (["data"], [1], "data is a list with 1 entries, expected an object with fields"),
        (["data"], NOTHING, "the field 'data' is missing"),
        (["comment"], "hi", "unknown field 'comment'; the fields here are 'data', 'format', 'kind', 'schema'"),
        (["sha256"], 5, "sha256 is 5, expected a string"),
        (["data", "name"], None, "data: name is null, expected a string"),
        (["data", "name"], NOTHING, "data: the field 'name' is missing; the file is damaged or incomplete"),
        (["data", "name"], "a.b", "holds no valid PortHamiltonian: name is 'a.b'"),
        (["data", "inputs"], ["u", 3], "data: inputs is a list with 2 entries, expected a list of strings"),
        (["data", "inputs"], "u", 'data: inputs is "u", expected a list of strings'),
        (["data", "inputs"], ["u", "w"], "holds no valid PortHamiltonian: 2 "),
        (["data", "states"], ["x"], "holds no valid PortHamiltonian: 1 "),
        (["data", "colour"], "red", "data: unknown field 'colour'; the fields here are 'inputs', 'modes', 'name'"),
        (["data", "Q"], [[1.0]], "data: unknown field 'Q'"),
        (["data", "modes"], NOTHING, "data: the field 'Q' is missing"),
        (["data", "modes"], 4, "data: modes is 4, expected an object with fields"),
        (["data", "modes", "ports"], 0, "holds no valid PortHamiltonian: ports is 0; a model has at least one"),
        (["data", "modes", "ports"], 2, "data: modes: nu has shape (2, 1, 2), expected (2, 2, 2); the file is damaged"),
        (["data", "modes", "d"], [0.1], "data: modes: nu has shape (2, 1, 2), expected (1, 1, 2)"),
        (["data", "modes", "d"], [2.0, 0.1], "holds no valid PortHamiltonian: d is not ascending"),
        (["data", "modes", "d"], [-0.1, 2.0], "holds no valid PortHamiltonian: d is not positive: d[0] = -0.1"),
        (["data", "modes", "d"], [0.1, "NaN"], 'data: modes: d is "NaN", expected a number'),
        (["data", "modes", "d"], [0.1, "nan"], 'data: modes: d is "nan", expected a number'),
        (["data", "modes", "d"], [0.1, None], "data: modes: d is null, expected a number"),
        (["data", "modes", "d"], [0.1, True], "data: modes: d is true, expected a number"),
        (["data", "modes", "d"], [0.1, [2.0]], "data: modes: d is a list with 1 entries, expected a number"),
        (["data", "modes", "d"], 0.1, "data: modes: d has shape (), expected (any)"),
        (["data", "modes", "d"], {}, "data: modes: d is an object with 0 entries, expected an array of numbers, or"),
        (["data", "modes", "d"], {"shape": [2], "float64": "no"}, "data: modes: d is an object with 2 entries, expect"),
        (["data", "modes", "d"], {"shape": [2.0], "float64": ""}, "data: modes: d is an object with 2 entries, expect"),
        (["data", "modes", "d"], packed([0.1, 2.0, 3.0], 2), "data: modes: d is an object with 2 entries, expect"),
        (["data", "modes", "d"], packed([0.1], 10**9), "data: modes: d is an object with 2 entries, expect"),
        (["data", "modes", "d"], packed([0.1, np.inf], 2), "data: modes: d holds NaN, or a number that is too large"),
        (["data", "modes", "nu"], [[[1.7e308, 1.7e308]], [[0.7, 0.0]]], "holds no valid PortHamiltonian: r is not"),
        (["data", "modes", "nu"], [1.0, 2.0], "data: modes: nu has shape (2,), expected (2, 1, 2)"),
        (["data", "modes", "r"], [0.5], "data: modes: r has shape (1,), expected (2)"),
        (["data", "modes", "r"], [-0.5, 1.0], "holds no valid PortHamiltonian: r is negative: -0.5"),
        (["data", "modes", "r"], [0.5, 0.5], "holds no valid PortHamiltonian: r is not |nu|^2; change both or none"),
        (["data", "modes", "rigid"], [[1.0, 2.0]], "data: modes: rigid has shape (1, 2), expected (any, 1)"),
        (["data", "modes", "extra"], 1, "data: modes: unknown field 'extra'"),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, list) and all(type(x) is str for x in value) else None,
)  # fmt: skip
def test_each_wrong_field_is_named_with_what_was_found(document, message, place, value, expected):
    assert message(json.dumps(spoil(document, place, value))).startswith(expected)


@pytest.mark.parametrize(
    ("place", "value", "expected"),
    [
        (["data", "Q"], [[4.0, 0.0], [0.0, -1.0]], "holds no valid PortHamiltonian: Q is indefinite"),
        (["data", "Q"], [[4.0, 1.0], [0.0, 1.0]], "holds no valid PortHamiltonian: Q is not symmetric"),
        (["data", "Q"], [[4.0]], "holds no valid PortHamiltonian: Q has odd size 1"),
        (["data", "Q"], [[4.0, 0.0]], "holds no valid PortHamiltonian: Q is not square"),
        (["data", "Q"], [[4.0, 0.0], [0.0]], "data: Q has shape (2,), expected (any, any)"),
        (
            ["data", "Q"],
            [[1e308, 0.0], [0.0, 1e308]],
            "holds no valid PortHamiltonian: Q is out of range",
        ),
        (["data", "B"], [[1.0]], "holds no valid PortHamiltonian: B has shape (1, 1)"),
        (["data", "B"], [[], []], "holds no valid PortHamiltonian: B has no columns"),
        (["data", "B"], [0.0, 1.0], "data: B has shape (2,), expected (any, any)"),
        (["data", "B"], NOTHING, "data: the field 'B' is missing"),
    ],
)
def test_matrices_that_make_no_system_are_refused(matrices, message, place, value, expected):
    assert message(json.dumps(spoil(matrices, place, value))).startswith(expected)


@pytest.mark.parametrize("number", ["1e999", "-1e999", "1" + "0" * 400])
def test_number_beyond_doubles_is_refused(matrices, message, number):
    text = json.dumps(spoil(matrices, ["data", "B"], [[0.0], ["HERE"]])).replace('"HERE"', number)
    assert message(text).startswith("data: B holds NaN, or a number that is too large for a double")


@pytest.mark.parametrize("token", ["NaN", "Infinity", "-Infinity"])
def test_tokens_that_are_no_json_are_refused(matrices, message, token):
    text = json.dumps(spoil(matrices, ["data", "B"], [[0.0], ["HERE"]])).replace('"HERE"', token)
    assert message(text).startswith("data: B holds NaN, or a number that is too large")


def test_weights_may_part_from_nu_by_half_the_digits_and_no_more(path, document, message):
    half = math.sqrt(np.finfo(float).eps)
    # r is compared through its root, which moves half as much
    document["data"]["modes"]["r"][1] = 0.5 * (1 + 1.9 * half)
    path.write_text(json.dumps(document))
    assert load(path).r[1] == 0.5 * (1 + 1.9 * half)
    document["data"]["modes"]["r"][1] = 0.5 * (1 + 2.1 * half)
    assert "r is not |nu|^2" in message(json.dumps(document))


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(PHControlError, match=r"there is no file .*absent\.json") as caught:
        load(tmp_path / "absent.json")
    assert isinstance(caught.value, FileNotFoundError)
    with pytest.raises(FileFormatError, match="is a folder; pass the file in it"):
        load(tmp_path)


# --- damage of any kind ------------------------------------------------------------------------------------------


def spoil(document, place, value):
    """Copy of a document with one entry set to a value, or taken out."""
    spoilt = copy.deepcopy(document)
    *way, last = place
    parent = spoilt
    for key in way:
        parent = parent[key]
    if value is NOTHING:
        del parent[last]
    else:
        parent[last] = value
    return spoilt


KINDS = {
    "modes": phc.modes([0.5, 2.0], [1.0, 0.25]),
    "system": phc.ph(np.diag([4.0, 1.0]), [0.5, 1.0], name="plant"),
    "system from modes": phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25])),
}


@functools.cache
def written(kind):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "valid.json")
        save(KINDS[kind], path)
        return path.read_bytes()


def loads_the_same_or_refuses(obj, content, folder):
    path = folder.getbasetemp() / "spoilt.json"
    path.write_bytes(content)
    try:
        restored = load(path)
    except FileFormatError as error:
        assert "spoilt.json" in str(error)
    else:
        assert_same(obj, restored)


@pytest.mark.variants
@pytest.mark.parametrize("kind", KINDS)
@settings(deadline=None, max_examples=60, derandomize=True)
@given(data=st.data())
def test_damaged_bytes_give_the_same_object_or_a_refusal(tmp_path_factory, kind, data):
    content = written(kind)
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(content)))
        stop = data.draw(st.integers(start, min(len(content), start + 40)) | st.just(len(content)))
        patch = data.draw(
            st.binary(max_size=4) | st.sampled_from([b" ", b"\n", b"0", b"-", b"e9", b"null", b"NaN", b"{"])
        )
        content = content[:start] + patch + content[stop:]
    loads_the_same_or_refuses(KINDS[kind], content, tmp_path_factory)


def places(value, way=()):
    yield way
    for key, item in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        yield from places(item, (*way, key))


anything = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**53), 2**53)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=4,
)


@pytest.mark.variants
@pytest.mark.parametrize("kind", KINDS)
@settings(deadline=None, max_examples=60, derandomize=True)
@given(data=st.data())
def test_any_other_value_anywhere_gives_a_valid_model_or_a_refusal_also_without_checksum(tmp_path_factory, kind, data):
    document = json.loads(written(kind))
    del document["sha256"]
    place = data.draw(st.sampled_from([way for way in places(document) if way]))
    spoilt = spoil(document, place, data.draw(anything | st.just(NOTHING)))
    path = tmp_path_factory.getbasetemp() / "spoilt.json"
    path.write_text(json.dumps(spoilt))
    try:
        restored = load(path)
    except FileFormatError:
        return
    # what was read is what the document says
    save(restored, path, overwrite=True)
    assert json.loads(path.read_text())["data"] == spoilt["data"]
    assert type(restored).__name__ == spoilt["kind"]


# --- fits: a field of each sort -----------------------------------------------------------------------------------


@functools.cache
def small_fit():
    rng = np.random.default_rng(0)
    u, noise = rng.standard_normal((2, 120))
    plant = phc.ph(phc.modes([1.0], [1.0]))
    y = phc.forced_response(plant, 0.1 * np.arange(120), u, intersample="zoh").outputs + 0.01 * noise
    return phc.pem((u, y), 1, dt=0.1, offset=False)


def test_an_object_of_a_kind_that_has_no_document_is_refused(path):
    with pytest.raises(StructureError, match="an object of type OrderSelection cannot be saved"):
        save(phc.order_selection(small_fit().record, 1), path)


def test_missing_and_infinite_numbers_of_a_fit_come_back(path):
    covariance = np.full((5, 5), -0.0)
    covariance[0, :3], covariance[1, 1] = [np.nan, np.inf, -np.inf], 1e-300
    covariance[:3, 0] = covariance[0, :3]
    fit = dataclasses.replace(small_fit(), covariance=covariance)
    save(fit, path)
    restored = load(path)
    assert_same_modes(fit.modes, restored.modes)
    assert_same_bits(covariance, restored.covariance)
    assert_same_bits(fit.experiments[0].free_amplitudes, restored.experiments[0].free_amplitudes)
    assert_same_bits(fit.experiments[0].initial_stderr, restored.experiments[0].initial_stderr)
    assert np.isnan(restored.experiments[0].offset_stderr) and np.isnan(fit.experiments[0].offset_stderr)
    assert (restored.loss, restored.unknowns, restored.success) == (fit.loss, fit.unknowns, fit.success)
    assert (restored.tests, restored.findings, restored.delay_stderr) == (fit.tests, fit.findings, fit.delay_stderr)
    for token in ("NaN", "Infinity"):
        assert token not in path.read_text()


@pytest.mark.parametrize(
    ("place", "value", "expected"),
    [
        (["success"], 1, "data: success is 1, expected true or false"),
        (["unknowns"], 1.5, "data: unknowns is 1.5, expected an integer"),
        (["loss"], "infinite", 'data: loss is "infinite", expected a number'),
        (["loss"], [1.0], "data: loss has shape (1,), expected ()"),
        (["quantities"], ["a", 2], "data: quantities is a list with 2 entries, expected "),
        (["order_table", "loss"], [], "data: order_table: loss has shape (0,), expected (2)"),
        (["experiments", "1", "free_amplitudes", 0], [1.0], "data: experiments: 1: free_amplitudes has shape (1, 1)"),
        (["experiments", "1", "free_amplitudes", 0], ["no", 1.0], 'data: experiments: 1: free_amplitudes is "no"'),
        (["covariance"], [1.0], "data: covariance has shape (1,), expected (15)"),
        (["experiments", "1", "record", "title"], 5, "data: experiments: 1: record: title is 5, expected a string"),
        (["experiments", "1", "record", "shape"], 5, "data: experiments: 1: record: unknown field 'shape'"),
        (["experiments", "1", "shape"], 5, "data: experiments: 1: unknown field 'shape'"),
    ],
)
def test_fields_of_every_sort_are_checked(path, message, place, value, expected):
    save(small_fit(), path)
    document = json.loads(path.read_text())
    del document["sha256"]
    assert message(json.dumps(spoil(document, ["data", *place], value))).startswith(expected)


def test_a_lossless_fit_of_version_0_2_is_read(path):
    """It was of another class, with the covariance of frequencies, weights and states."""
    older = Path(__file__).with_name("older_fit.json")
    told, result = json.loads(older.read_text())["data"], load(older)
    assert isinstance(result, phc.PEMResult) and result.structure == "lossless"
    assert result.d.tolist() == told["system"]["modes"]["d"]
    assert np.allclose(result.r, told["system"]["modes"]["r"], rtol=1e-14)
    assert result.initial_state.tolist() == told["experiments"]["1"]["initial_state"]
    errors = np.sqrt(np.diag(told["covariance"]))
    names = ["d", "r", "initial_state", "offset"]
    assert np.allclose(np.concatenate([result.stderr[name] for name in names]), [*errors, *told["offset_stderr"]])
    # the motion has the sign of today
    record = result.record
    again = result.predict((record.u, None), initial_state="fitted")
    assert np.allclose(again.outputs, told["experiments"]["1"]["predicted"], rtol=0, atol=1e-12)
    fit = phc.pem(record, 2, offset=True, structure="lossless", intersample="zoh")
    assert np.allclose(fit.d, result.d, rtol=1e-7) and np.isclose(fit.bic, result.bic)
    assert fit.unknowns == result.unknowns and np.allclose(fit.initial_state, result.initial_state, rtol=1e-6)
    save(result, path)
    assert_same_bits(load(path).covariance, result.covariance)


@pytest.mark.parametrize("mode", ["r", "rb"])
def test_an_open_file_is_loaded_like_one_of_that_name(tmp_path, mode):
    path = tmp_path / "model.json"
    save(phc.modes([1.0, 2.0], [3.0, 4.0]), path)
    with open(path, mode) as stream:
        assert_same_bits(load(stream).d, load(path).d)
    path.write_text("{")
    with open(path, mode) as stream, pytest.raises(FileFormatError, match=re.escape(str(path))):
        load(stream)
