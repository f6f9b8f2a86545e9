"""The command line: what models are, and one form from another."""

from __future__ import annotations

import json
import re
import warnings
from io import BytesIO

import control as ct
import numpy as np
import pytest
import scipy.io
import scipy.sparse
from hypothesis import given, settings
from hypothesis import strategies as st
from shell import run

import ph_control as phc
from ph_control.io.matlab import read_matlab

PLANT = phc.frenkel_kontorova(2)
LOSSY = {"A": [[0, 1], [-1, -0.1]], "B": [[0], [1]], "C": [[0, 1]]}


def matlab(**variables) -> bytes:
    """Content of a `.mat` file."""
    buffer = BytesIO()
    scipy.io.savemat(buffer, variables)
    return buffer.getvalue()


def shown(content: bytes | str) -> dict:
    """What `info` tells of a model that it reads from standard input."""
    done = run("info", "-", "--json", stdin=content)
    assert done.error == ""
    return json.loads(done.out) | {"status": done.status}


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "model.json"
    phc.save(phc.ph(phc.modes([1.0, 2.0], [0.5, 0.25]), name="plant"), path)
    return path


# --- info ------------------------------------------------------------------------------------------------------------


def test_info_shows_what_a_model_is(model):
    done = run("info", model)
    assert (done.status, done.error) == (0, "")
    assert "PortHamiltonian plant: 2 degrees of freedom, 4 states, 1 port" in done.out
    assert "canonical (controllable and observable): yes" in done.out
    assert re.search(r"2\s+2\s+0\.3183\d+\s+0\.25\s+0\.5", done.out)


def test_info_as_json_has_the_numbers_in_full(model):
    answer = shown(model.read_bytes())
    assert answer["d"] == [1.0, 2.0] and answer["r"] == [0.5, 0.25] and answer["kappa"] == [0.5, 0.5]
    assert answer["lossless"] is answer["canonical"] is True and answer["kind"] == "PortHamiltonian"
    several = json.loads(run("info", model, "--num", "1", "--den", "1,0", "--json").out)
    assert [one["kappa_0"] for one in several["models"]] == [0.0, 1.0]


@pytest.mark.parametrize(
    "kept",
    [
        phc.modes([1.0, 3.0], [1.0, 2.0]),
        phc.ch(PLANT),
        phc.oh(PLANT),
        phc.ph(np.diag([1.0, 2, 1, 2]), np.eye(4, 2, k=-2)),
        phc.ph(ct.tf([2, 0, 1], [1, 0, 1, 0])),
        phc.affine(PLANT.Q, PLANT.B[:, 0]),
    ],
    ids=lambda kept: type(kept).__name__,
)
def test_every_kind_that_can_be_saved_can_be_shown(kept, tmp_path):
    path = tmp_path / "kept.json"
    phc.save(kept, path)
    done = run("info", path)
    assert done.status == 0 and type(kept).__name__ in done.out
    answer = shown(path.read_bytes())
    assert np.allclose(answer["d"], getattr(kept, "modes", kept).d, rtol=1e-15)


PLATE = phc.ph(
    np.diag([4.0, 1.0]), [0.2, 1.0], R=np.diag([0.0, 0.3]), N=[[0.0]], S=[[0.1]], sensors=([[1.0, 0.0]], [[0.5]]),
    name="plate", inputs="force", outputs=["speed", "où"],
)  # fmt: skip
ODD = phc.ph(np.eye(3), [1.0, 0.0, 0.0], J=[[0, 1, 0], [-1, 0, 2], [0, -2, 0]], R=np.diag([0.1, 0.0, 0.0]), name="odd")
CRITICAL = phc.ph(np.eye(2), [0.0, 1.0], R=np.diag([0.0, 2.0]))
GAIN = phc.ph(
    np.zeros((0, 0)), np.zeros((0, 2)), S=np.eye(2), N=[[0, 1], [-1, 0]], sensors=(np.zeros((1, 0)), [[3, 4]])
)


@pytest.mark.parametrize("system", [PLATE, ODD, CRITICAL, GAIN], ids=lambda system: f"{system.nstates} states")
@pytest.mark.parametrize("name", ["x.json", "x.mat"])
def test_a_system_with_losses_goes_round_through_files_with_all_it_has(system, name, tmp_path):
    phc.save(system, tmp_path / "kept.json")
    done = run("convert", tmp_path / "kept.json", tmp_path / name)
    assert (done.status, done.error) == (0, "")
    back = run("convert", tmp_path / name, tmp_path / "back.json")
    assert (back.status, back.error) == (0, "")
    again = phc.load(tmp_path / "back.json")
    assert type(again) is phc.DissipativePortHamiltonian
    for part in "QGJRPSNABCD":
        assert np.array_equal(getattr(again, part), getattr(system, part))
    for kind in ("input_labels", "output_labels", "state_labels"):
        assert getattr(again, kind) == getattr(system, kind)
    assert again.name == system.name
    assert (tmp_path / "back.json").read_bytes() == (tmp_path / "kept.json").read_bytes()


@pytest.mark.parametrize("system", [PLATE, ODD, CRITICAL], ids=lambda system: f"{system.nstates} states")
def test_info_shows_natural_frequencies_and_damping_of_a_system_with_losses(system, tmp_path):
    phc.save(system, tmp_path / "kept.json")
    done = run("info", tmp_path / "kept.json")
    assert done.status == 0 and "port-Hamiltonian with losses: losses R" in done.out and "damping ratio" in done.out
    answer = shown((tmp_path / "kept.json").read_bytes())
    assert answer["lossless"] is False and answer["violations"] == []
    assert np.allclose(answer["natural_frequencies"], system.natural_frequencies)
    assert np.allclose(answer["damping_ratios"], system.damping_ratios)
    assert (answer["ports"], answer["sensors"]) == (1, system.noutputs - 1) and answer["states"] == system.nstates


@pytest.mark.parametrize("system", [PLATE, ODD, CRITICAL], ids=lambda system: f"{system.nstates} states")
def test_modes_with_damping_are_kept_bit_by_bit(system, tmp_path):
    phc.save(system, tmp_path / "kept.json")
    assert run("convert", tmp_path / "kept.json", tmp_path / "modes.json", "--to", "modes").status == 0
    modes = phc.load(tmp_path / "modes.json")
    s = np.array([0.3j, 1.0 + 1j])
    assert np.array_equal(modes.evaluate(s), system.modes.evaluate(s)) and np.array_equal(
        modes.poles, system.modes.poles
    )
    assert run("info", tmp_path / "modes.json").status == 0
    refused = run("convert", tmp_path / "kept.json", tmp_path / "modes.csv", "--to", "modes")
    assert refused.status == 2 and "modes with damping are kept in JSON" in refused.error


@pytest.mark.parametrize("form", ["ss", "tf"])
def test_matrices_and_coefficients_of_a_system_with_losses_are_written(form, tmp_path):
    phc.save(CRITICAL, tmp_path / "kept.json")
    assert run("convert", tmp_path / "kept.json", tmp_path / "x.mat", "--to", form).status == 0
    found = scipy.io.loadmat(tmp_path / "x.mat")
    if form == "ss":
        assert np.array_equal(found["A"], CRITICAL.A) and "Q" not in found
    else:
        assert np.allclose(found["den"], [[1.0, 2.0, 1.0]])
    refused = run("convert", tmp_path / "kept.json", tmp_path / "x.json", "--to", "ch")
    assert refused.status in (1, 2) and "lossless_part" in refused.error


def test_matrices_with_losses_that_others_wrote_are_read(tmp_path):
    scipy.io.savemat(tmp_path / "x.mat", {"Q": PLATE.Q, "B": PLATE.G, "R": PLATE.R, "S": PLATE.S})
    answer = json.loads(run("info", tmp_path / "x.mat", "--json").out)
    assert answer["kind"] == "DissipativePortHamiltonian" and answer["name"] == "x"
    bad = matlab(Q=PLATE.Q, B=PLATE.G, R=-PLATE.R)
    done = run("info", "-", stdin=bad)
    assert done.status == 2 and "negative eigenvalue" in done.error


STATE_SPACE = {"A": PLANT.A, "B": PLANT.B, "C": PLANT.C}


@pytest.mark.parametrize(
    "content",
    [
        matlab(**STATE_SPACE),
        matlab(**STATE_SPACE, D=0.0, Ts=0.0),
        matlab(a=PLANT.A, b=PLANT.B, c=PLANT.C, d=0.0),
        matlab(sys=STATE_SPACE | {"D": 0.0}),
        matlab(A=scipy.sparse.csc_matrix(PLANT.A), B=PLANT.B, C=PLANT.C),
        matlab(Q=PLANT.Q, B=PLANT.B),
        matlab(num=phc.tf(PLANT).num_list[0][0], DEN=phc.tf(PLANT).den_list[0][0]),
        matlab(d=PLANT.d, r=PLANT.r),
        json.dumps({key: value.tolist() for key, value in STATE_SPACE.items()}),
        json.dumps({"A": PLANT.A.tolist(), "B": PLANT.B[:, 0].tolist(), "C": PLANT.C[0].tolist(), "dt": None}),
        json.dumps({"d": PLANT.d.tolist(), "r": PLANT.r.tolist()}),
        json.dumps({"num": [1, 0, 1, 0], "den": [1, 0, 3, 0, 1]}),
        "1 0 1 0\n1 0 3 0 1\n",
        "1,0,1,0\n1,0,3,0,1",
        "1; 0; 1; 0\n1; 0; 3; 0; 1",
        "num = [1 0 1 0];\nden = [1, 0, 3, 0, 1];\n",
        "[1 0 1 0]\n[1 0 3 0 1]\n",
        "# a plant\n\ndenominator: 1 0 3 0 1  % the poles\nNumerator: 1 0 1 0\n",
        "num,den\n1,1\n0,0\n1,3\n0,0\n,1\n",
        "num\tden\n1\t1\n0\t0\n1\t3\n0\t0\n\t1\n",
        "num,1,0,1,0\nden,1,0,3,0,1\n",
        "\ufeff1 0 1 0\r\n1 0 3 0 1\r\n",
        "1 0 1 0\n1 0 3 0 1\n".encode("utf-16"),
        "d,r\n" + "".join(f"{d},{r}\n" for d, r in zip(PLANT.d, PLANT.r, strict=True)),
    ],
)  # fmt: skip
def test_a_model_is_read_in_every_form_in_which_one_is_handed_over(content):
    answer = shown(content)
    assert answer["status"] == 0
    assert np.allclose(answer["d"], PLANT.d, rtol=1e-13) and np.allclose(answer["r"], PLANT.r, rtol=1e-13)


@pytest.mark.parametrize("content", [matlab(**LOSSY), json.dumps(LOSSY), "1 0\n1 0.1 1\n"])
def test_a_system_with_losses_is_shown_and_converted(content):
    answer = shown(content)
    assert answer["status"] == 0 and answer["lossless"] is False and answer["violations"] == []
    assert np.allclose(answer["damping_ratios"], 0.05, rtol=1e-12)
    done = run("info", "-", stdin=content)
    assert done.status == 0 and "1 output, with losses" in done.out
    made = run("convert", "-", "-", stdin=content)
    assert made.status == 0 and json.loads(made.out)["kind"] == "DissipativePortHamiltonian"
    assert np.allclose(shown(made.out)["damping_ratios"], 0.05, rtol=1e-12)


def test_a_system_that_is_not_passive_is_status_1_with_its_bands():
    content = "1 -3\n1 3 5\n"
    answer = shown(content)
    assert answer["status"] == 1 and answer["lossless"] is False
    assert "from 0 to 1.58114 rad per unit time it gives energy" in answer["violations"][0]
    done = run("info", "-", stdin=content)
    assert done.status == 1 and "NOT passive" in done.out and "  - from 0 to 1.58114" in done.out
    refused = run("convert", "-", "-", stdin=content)
    assert (refused.status, refused.out) == (1, "") and refused.error.count("\n") == 1
    assert "standard input is not passive, so it has no port-Hamiltonian form: from 0 to 1.58114" in refused.error


def test_the_exact_name_comes_before_the_same_in_another_case():
    both = {"a": 5, "A": 0, "B": 1, "b": 7, "c": 9, "C": 1}
    assert shown(json.dumps(both))["kappa_0"] == 1.0
    ambiguous = run("info", "-", stdin='{"A": 0, "B": 1, "C": 1, "ts": 0, "TS": 1}')
    assert ambiguous.status == 2 and "has both ts and TS; keep the one" in ambiguous.error


def test_a_feedthrough_is_not_lost_for_the_case_of_its_name():
    for content in (matlab(a=0.0, b=1.0, c=1.0, d=2.0), '{"A": 0, "B": 1, "C": 1, "d": 2, "r": 1}'):
        made = phc.load(BytesIO(run("convert", "-", "-", stdin=content).out.encode()))
        assert made.D.item() == 2.0


def test_coefficients_may_be_given_on_the_line():
    for num, den in (("1,0", "1,0,4"), ("[1 0]", "[1 0 4]"), ("-1,0", "-1,0,-4"), ("1;0", "1;0;4")):
        assert json.loads(run("info", "--num", num, "--den", den, "--json").out)["d"] == [2.0]
    assert run("info", "--num", "-1,0", "--den", "1,0,4").status == 1


@pytest.mark.parametrize(
    "content, message",
    [
        (b" \n", "standard input is empty"),
        (b"\x00\xff\x07", "is not a text file"),
        ("# nothing\n", "holds only comments"),
        ("1 0\n", "1 line of text; a model as text is two lines"),
        ("1 0\n1 0 4\n5\n", "3 lines of text.*ph-control fit reads recordings"),
        ("1 x\n1 0 4\n", "line 1: 'x' is not a number"),
        ("1e999 0\n1 0 4\n", "line 1: '1e999' is not finite"),
        ("nan\n1 0 4\n", "line 1: 'nan' is not finite"),
        ("1,5 0\n1 0 4\n", "line 1: '1,5 0' has , and space between its numbers; use one separator"),
        ("num 1 0\nnum 1 0 4\n", "line 2: 'num' is there twice"),
        ("mass 1 0\nden 1 0 4\n", "line 1: 'mass' is not known"),
        ("num: []\nden: 1 0 4\n", "line 1: there are no numbers"),
        ("num,den\n1,1,1\n", "3 columns below 2 names"),
        ("num,den\n1,1\n,0\n0,4\n", "column num: '' is not a number"),
        ("num,den\n1,x\n", "column den: 'x' is not a number"),
        ("num,num\n1,1\n", "column num: 'num' is there twice"),
        ("1 0\n0 0\n", "the denominator is zero"),
        ("1e300 0\n1e-300 0 1\n", "leave the range of doubles"),
        ("{", "not JSON, or damaged or cut short"),
        ("{}", "holds no arrays; expected A, B, C"),
        ('{"mass": 1}', "holds 'mass'; expected A, B, C"),
        ('{"num": "x", "den": [1]}', "num does not hold real numbers"),
        ('{"num": [1, 0], "den": [1, 0, NaN]}', "den is not finite"),
        ('{"num": [1, 0], "den": [1, 0, 1e999]}', "den is not finite"),
        ('{"num": [[1, 0], [2, 0]], "den": [1, 0, 4]}', r"num has shape \(2, 2\)"),
        ('{"num": [], "den": []}', r"den has shape \(0,\)"),
        ('{"A": [[0, 1], [-1]], "B": [0, 1], "C": [0, 1]}', "A is not a rectangular array"),
        ('{"A": [[0, 1], [-1, 0]], "B": [0, 1, 2], "C": [0, 1]}', "holds no system: "),
        ('{"A": [[[1]]], "B": [0], "C": [0]}', "holds no system: .* A must be 2-dimensional"),
        ('{"A": 0, "B": 1, "C": 1, "dt": 0.1}', r"is a sampled system \(dt = 0.1\).*convert it first"),
        ('{"A": 0, "a": 1, "B": 1, "b": 2, "C": 1, "D": 0, "ts": "x"}', "ts does not hold real numbers"),
        ('{"num": ' + 60000 * "[", "nested too deeply"),
        ('{"num": [' + 6000 * "1" + '], "den": [1]}', "damaged or cut short"),
        (matlab(**STATE_SPACE, Ts=0.1), r"is a sampled system \(Ts = 0.1\)"),
        (matlab(**STATE_SPACE, Ts=-1.0), r"is a sampled system \(Ts = -1\)"),
        (matlab(A=1j * np.eye(2), B=np.ones((2, 1)), C=np.ones((1, 2))), "A is complex"),
        (matlab(A="x", B=1, C=1), "A does not hold real numbers"),
        (matlab(A=np.array([1, "a"], dtype=object), B=1, C=1), "A is a cell array"),
        (matlab(A=[[np.nan]], B=1, C=1), "A is not finite"),
        (matlab(k=1.0), "holds 'k'; expected A, B, C"),
        (matlab(**STATE_SPACE)[:300], "is not a .mat file, or damaged"),
        (b"MATLAB 7.3 MAT-file, Platform: GLNXA64", "not a .mat file.*'-v7'"),
        (b"\x89HDF\r\n\x1a\n", "not a .mat file.*'-v7'"),
        (b"MATLAB 5.0 MAT-file" + 300 * b"\x07", "is not a .mat file, or damaged"),
    ],
)  # fmt: skip
def test_what_is_no_model_is_said_to_be_so_in_one_line(content, message):
    done = run("info", "-", stdin=content)
    assert (done.status, done.out) == (2, "")
    assert re.search(message, done.error), done.error
    assert done.error.startswith("ph-control: ") and done.error.count("\n") == 1


@pytest.mark.variants
@pytest.mark.parametrize("packed", [False, True])
def test_no_damage_to_a_mat_file_ends_the_program_or_leaves_a_bare_error(packed):
    """The reader of scipy ends the process at some of these."""
    buffer, K = BytesIO(), scipy.sparse.csc_matrix(PLANT.A)
    scipy.io.savemat(buffer, {"K": K, "s": {"A": PLANT.A, "t": "text"}, "B": PLANT.B + 1j}, do_compression=packed)
    whole = buffer.getvalue()
    read = read_matlab(whole, "x.mat")
    np.testing.assert_array_equal(read["K"], PLANT.A)
    np.testing.assert_array_equal(read["s"]["A"], PLANT.A)
    np.testing.assert_array_equal(read["B"], PLANT.B + 1j)
    refused = 0
    for place in range(120, len(whole)):
        for damage in (bytes([whole[place] ^ 0x80]), bytes([whole[place] ^ 0x11]), b"\xff\xff\xff\x7f", b""):
            content = whole[:place] + damage + (whole[place + len(damage) :] if damage else b"")
            try:
                read_matlab(content, "x.mat")
            except phc.FileFormatError:
                refused += 1
    assert refused > len(whole)


def test_files_that_are_none_are_said_to_be_so(tmp_path):
    for name, message in (("absent.json", "there is no file"), (".", "is a folder"), ("a" * 300, "File name too long")):
        done = run("info", tmp_path / name)
        assert done.status == 2 and message in done.error and done.error.count("\n") == 1
    broken = tmp_path / "broken.json"
    broken.write_text("{")
    assert "broken.json" in run("info", broken).error
    old = tmp_path / "old.mat"
    old.write_bytes(b"\x01\x02\x03")
    assert "is not a .mat file, or damaged" in run("info", old).error


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["info"], "no model given; name a file, or pass --num and --den"),
        (["info", "-", "-"], "more than once for standard input"),
        (["info", "--num", "1,0"], "--num and --den belong together"),
        (["info", "--num", "x", "--den", "1"], "argument --num: 'x' is not a number"),
        (["info", "--num", "", "--den", "1"], "there are no numbers; write for example 1,0,4"),
        (["convert", "m.json"], "name the model and the file to write; 1 given"),
        (["convert", "a", "b", "c"], "name the model and the file to write; 3 given"),
        (["convert", "m.json", "-", "--num", "1", "--den", "1"], "name the file to write only; 2 given"),
        (["convert", "m.json", "x.xyz"], "no known suffix; end its name in .json, .mat, .txt, .csv"),
        (["convert", "m.json", "-", "--json"], "--json and - both want standard output"),
        (["convert", "m.json", "-", "--to", "xy"], "invalid choice: 'xy'"),
        (["convert", "m.json", "-", "--name", "a.b"], "'a.b' is not a name"),
        (["convert", "m.json", "no/such/folder.json"], "the folder no/such does not exist"),
    ],
)
def test_wrong_usage_is_status_2_and_one_line(arguments, message):
    done = run(*arguments)
    assert (done.status, done.out) == (2, "")
    assert re.search(re.escape(message), done.error) and done.error.count("\n") == 1


# --- netlist ---------------------------------------------------------------------------------------------------------


def test_a_circuit_of_a_model_is_written_and_is_a_model_again(model, tmp_path):
    target = tmp_path / "ladder.cir"
    done = run("netlist", model, target, "--form", "cauer1", "--kind", "impedance")
    assert (done.status, done.out, done.error) == (0, f"Written: {target}\n", "")
    assert target.read_text() == phc.netlist(phc.modes([1.0, 2.0], [0.5, 0.25]), "cauer1", kind="impedance").spice()
    assert np.allclose(json.loads(run("info", target, "--json").out)["natural_frequencies"], [1.0, 2.0])
    assert run("netlist", model, target).status == 2 and run("netlist", model, target, "--overwrite").status == 0
    assert run("netlist", "--num", "1,0", "--den", "1,0,4", "-").out.startswith("Foster II form")
    refused = run("netlist", "--num", "1,-3", "--den", "1,3,5", "-")
    assert (refused.status, refused.out) == (1, "") and "passive" in refused.error
    assert "name the model and the netlist; 1 given" in run("netlist", model).error


# --- reduce ----------------------------------------------------------------------------------------------------------


def test_a_model_is_reduced_and_written(model, tmp_path):
    target = tmp_path / "small.json"
    done = run("reduce", model, target, "--order", "2")
    assert (done.status, done.error) == (0, "")
    assert done.out == f"4 states reduced to 2, largest difference 0.1667\nWritten: {target}\n"
    assert phc.load(target).nstates == 2
    lossy = tmp_path / "lossy.json"
    phc.save(phc.msd_chain(8), lossy)
    answer = json.loads(
        run("reduce", lossy, tmp_path / "s.json", "--tolerance", "0.3", "--method", "balanced", "--json").out
    )
    assert answer["states"] < 16 and 0 < answer["error_bound"] < 0.3
    assert answer["states"] == phc.load(tmp_path / "s.json").nstates
    assert run("reduce", lossy, tmp_path / "t.json").status == 2
    assert run("reduce", "--num", "1,-3", "--den", "1,3,5", "-", "--order", "1").status == 1


# --- convert ---------------------------------------------------------------------------------------------------------


def test_a_model_goes_round_through_all_files_and_forms(model, tmp_path):
    steps = [
        ("a.mat",), ("b.txt",), ("c.csv",), ("d.json", "--to", "ch"), ("e.mat",), ("f.json", "--to", "oh"),
        ("g.csv", "--to", "modes"), ("h.mat", "--to", "modes"), ("i.json", "--to", "tf"), ("j.json", "--to", "ss"),
        ("k.txt", "--to", "modes"), ("l.mat", "--to", "tf"), ("m.json", "--to", "ph"), ("n", "--format", "mat"),
    ]  # fmt: skip
    source = model
    for name, *options in steps:
        target = tmp_path / name if "--format" not in options else tmp_path / "n.mat"
        done = run("convert", source, target, *options)
        assert (done.status, done.out, done.error) == (0, f"Written: {target}\n", ""), name
        source = target
    answer = json.loads(run("info", source, "--json").out)
    assert np.allclose(answer["d"], [1.0, 2.0], rtol=1e-12) and np.allclose(answer["r"], [0.5, 0.25], rtol=1e-12)


@settings(deadline=None, max_examples=25, derandomize=True)
@given(
    st.lists(st.tuples(st.floats(1e-3, 1e3), st.floats(1e-6, 1e6)), min_size=1, max_size=3, unique_by=lambda p: p[0]),
    st.sampled_from([1e-6, 1.0, 1e6]),
)
def test_modes_as_text_and_as_matrices_come_back(pairs, scale):
    d, r = np.array(sorted(pairs)).T
    text = "d,r\n" + "".join(f"{scale * x!r},{y!r}\n" for x, y in zip(d.tolist(), r.tolist(), strict=True))
    back = run("convert", "-", "-", "--format", "csv", "--to", "modes", stdin=text)
    assert back.out == text
    matrices = run("convert", "-", "-", "--format", "mat", stdin=text)
    answer = shown(matrices.output)
    assert np.allclose(answer["d"], scale * d, rtol=1e-12) and np.allclose(answer["r"], r, rtol=1e-9)


def test_matrices_of_each_form_are_those_of_the_library(model, tmp_path):
    system = phc.load(model)
    for form, expected in (("ph", system), ("ch", phc.ch(system)), ("oh", phc.oh(system)), ("ss", system)):
        done = run("convert", model, "-", "--format", "mat", "--to", form)
        found = scipy.io.loadmat(BytesIO(done.output))
        for key in "ABCD":
            assert np.array_equal(found[key], getattr(expected, key)), (form, key)
    found = scipy.io.loadmat(BytesIO(run("convert", model, "-", "--format", "mat", "--to", "tf").output))
    assert np.array_equal(found["num"][0], phc.tf(system).num_list[0][0])


def test_the_same_model_gives_the_same_bytes(model):
    for kind in ("json", "mat", "txt", "csv"):
        first, second = (run("convert", model, "-", "--format", kind) for _ in range(2))
        assert first.status == 0 and first.output == second.output
    assert phc.load(BytesIO(run("convert", model, "-").output)).name == "plant"


def test_names_are_kept_or_given(model, tmp_path):
    named = run("convert", model, "-", "--name", "bridge")
    assert json.loads(named.out)["data"]["name"] == "bridge"
    assert json.loads(run("convert", "--num", "1,0", "--den", "1,0,4", "-").out)["data"]["name"] == "model"
    odd = tmp_path / "my plant.v2.txt"
    odd.write_text("1 0\n1 0 4\n")
    assert json.loads(run("convert", odd, "-").out)["data"]["name"] == "my_plant_v2"
    modes = tmp_path / "a.b.csv"
    modes.write_text("d,r\n1,2\n")
    assert json.loads(run("convert", modes, "-", "--to", "ph").out)["data"]["name"] == "a_b"
    assert json.loads(run("convert", modes, "-").out)["kind"] == "ModalForm"


def test_the_result_of_a_fit_stands_for_its_model(tmp_path):
    t, u = 0.1 * np.arange(300), np.random.default_rng(0).standard_normal(300)
    result = phc.pem((u, phc.forced_response(PLANT, t, u, intersample="zoh").outputs), 2, dt=0.1)
    path = tmp_path / "result.json"
    result.save(path)
    assert (
        json.loads(run("convert", path, "-", "--to", "tf").out)["den"] == phc.tf(result.system).den_list[0][0].tolist()
    )


def test_files_are_replaced_only_on_request_and_inputs_never(model, tmp_path):
    target = tmp_path / "out.mat"
    target.write_text("mine")
    done = run("convert", model, target)
    assert done.status == 2 and "--overwrite" in done.error and target.read_text() == "mine"
    answer = json.loads(run("convert", model, target, "--overwrite", "--json").out)
    assert answer == {
        "command": "convert", "source": str(model), "form": "ph", "format": "mat", "written": [str(target)]
    }  # fmt: skip
    before = model.read_bytes()
    assert "is one of the inputs" in run("convert", model, model, "--overwrite").error
    assert model.read_bytes() == before


def test_forms_that_cannot_hold_a_model_are_refused(tmp_path):
    kept = {
        "affine": phc.affine(PLANT.Q, PLANT.B[:, 0]),
        "two": phc.ph(np.diag([1.0, 2, 1, 2]), np.eye(4, 2, k=-2)),
        "rigid": phc.ph(ct.tf([2, 0, 1], [1, 0, 1, 0])),
    }
    for name, system in kept.items():
        phc.save(system, tmp_path / f"{name}.json")
    for name, options, message in (
        ("affine", ["--to", "ph"], "its derivative has"),
        ("affine", ["--format", "txt"], "its derivative has"),
        ("two", ["--to", "ch"], "has 2 ports"),
        ("two", ["--to", "tf"], "has 2 inputs and 2 outputs.*--to ss"),
        ("two", ["--to", "modes", "--format", "csv"], "several ports, or with a pole at 0"),
        ("rigid", ["--to", "modes", "--format", "mat"], "several ports, or with a pole at 0"),
        ("rigid", ["--to", "ph", "--format", "txt"], "texts hold the coefficients"),
    ):
        done = run("convert", tmp_path / f"{name}.json", "-", *options)
        assert (done.status, done.out) == (2, "") and re.search(message, done.error), done.error
    for name in kept:
        found = scipy.io.loadmat(BytesIO(run("convert", tmp_path / f"{name}.json", "-", "--format", "mat").output))
        assert np.array_equal(found["A"], kept[name].A) and np.array_equal(found["C"], kept[name].C)
        assert run("convert", tmp_path / f"{name}.json", "-").output == (tmp_path / f"{name}.json").read_bytes()


def test_lost_digits_are_a_warning_of_one_line(tmp_path):
    path = tmp_path / "many.json"
    phc.save(phc.ph(phc.modes(np.linspace(1, 5, 60), np.ones(60))), path)
    done = run("convert", path, "-", "--to", "ch", "--format", "mat")
    assert done.status == 0 and done.error.startswith("ph-control: warning: the companion matrix of 60 modes carries")
    assert done.error.count("\n") == 1


def test_what_other_packages_warn_of_is_not_shown_to_whoever_runs_a_command(monkeypatch):
    class PyparsingDeprecationWarning(UserWarning, DeprecationWarning):
        """As later releases of pyparsing have it."""

    def warned(*arguments, **keywords):
        warnings.warn("'parseString' deprecated - use 'parse_string'", PyparsingDeprecationWarning, stacklevel=1)
        warnings.warn("few digits", phc.ConditioningWarning, stacklevel=1)
        return PLANT

    monkeypatch.setattr(phc, "ph", warned)
    done = run("info", "--num", "1,0", "--den", "1,0,4")
    assert (done.status, done.error) == (0, "ph-control: warning: few digits\n")


@settings(max_examples=150, derandomize=True, deadline=None)
@given(st.one_of(st.binary(max_size=60), st.text(alphabet='0123456789.,;- \n{}[]":numdeABC', max_size=40)))
def test_no_input_ends_in_an_error_of_the_program(content):
    done = run("info", "-", stdin=content)
    assert done.status in (0, 1, 2) and done.error.count("\n") <= 1
