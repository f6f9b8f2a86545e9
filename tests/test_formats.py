"""Measurements in the formats of other programs: universal files, Touchstone, MATLAB."""

from __future__ import annotations

import gc
import io
import json
import sys
import warnings

import control as ct
import numpy as np
import pytest
import scipy.io
import scipy.linalg
from shell import run
from slow import slowly

import ph_control as phc

pyuff = pytest.importorskip("pyuff")
skrf = pytest.importorskip("skrf")

RNG = np.random.default_rng(5)


# --- universal files -------------------------------------------------------------------------------------------------


def function(
    x,
    data,
    response,
    reference=(0, 0),
    *,
    in_time=False,
    force=False,
    binary=0,
    kind=None,
    component="",
    measured=12,
    applied=13,
):
    """Data set 58 as pyuff writes it; `response` and `reference` are node and direction."""
    return pyuff.prepare_58(
        binary=binary, id1="", id2="", id3="", id4="", id5="", func_type=kind or (1 if in_time else 4), ver_num=0,
        load_case_id=0, rsp_ent_name=component, rsp_node=response[0], rsp_dir=response[1], ref_ent_name="",
        ref_node=reference[0], ref_dir=reference[1], abscissa_spacing=1, abscissa_min=x[0], abscissa_inc=x[1] - x[0],
        abscissa_spec_data_type=17 if in_time else 18, ordinate_spec_data_type=13 if force else measured,
        orddenom_spec_data_type=0 if in_time else applied, data=np.asarray(data), x=np.asarray(x), num_pts=len(x),
    )  # fmt: skip


def written(folder, *functions, name="test.uff"):
    path = folder / name
    file = pyuff.UFF(str(path))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that the writer leaves a file open
        file.write_sets(list(functions), "add")
        gc.collect()
    return path


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("binary", [0, 1])
def test_responses_of_one_test_become_a_matrix(tmp_path, binary):
    f = np.arange(1.0, 41.0)
    places, hammers = [(1, 3), (2, 3), (7, -2)], [(2, 3), (1, 3)]
    H = RNG.standard_normal((3, 2, 40, 2)) @ [1, 1j]
    measured = [(o, i) for i in range(2) for o in range(3) if (o, i) != (2, 1)]
    path = written(tmp_path, *(function(f, H[o, i], places[o], hammers[i], binary=binary) for o, i in measured))
    (data,) = phc.read_uff(path)
    assert isinstance(data, ct.FrequencyResponseData) and data.time_unit == "s" and data.title == "test.uff"
    assert data.output_labels == ["1+Z", "2+Z", "7-Y"] and data.input_labels == ["2+Z", "1+Z"]
    assert np.allclose(data.omega, 2 * np.pi * f, rtol=1e-12)
    for o, i in measured:
        assert np.allclose(data.frdata[o, i], H[o, i], rtol=1e-6)
    assert np.isnan(data.frdata[2, 1]).all()


def test_a_measurement_that_was_repeated_or_has_other_frequencies_is_a_matrix_of_its_own(tmp_path):
    f = np.arange(1.0, 6.0)
    H = RNG.standard_normal((4, 5, 2)) @ [1, 1j]
    path = written(
        tmp_path, function(f, H[0], (1, 1), (1, 1)), function(f, H[1], (2, 1), (1, 1)),
        function(f, H[2], (1, 1), (1, 1)), function(2 * f, H[3], (2, 1), (1, 1)),
    )  # fmt: skip
    found = phc.read_uff(path)
    assert [data.output_labels for data in found] == [["1+X", "2+X"], ["1+X"], ["2+X"]]
    assert np.allclose(found[2].omega, 4 * np.pi * f)
    (row,) = phc.read_uff(path, input="1+X", output=["2+X"])[:1]
    assert row.output_labels == ["2+X"] and np.allclose(row.frdata[0, 0], H[1])


def hammer_runs(binary=0):
    t = np.arange(64) / 2048
    x = RNG.standard_normal((2, 3, 64))
    channels = [((1, 3), True), ((1, 3), False), ((2, -1), False)]
    return x, [
        function(t, x[k, c], place, (1, 3), in_time=True, force=force, binary=binary, component="deck")
        for k in range(2) for c, (place, force) in enumerate(channels)
    ]  # fmt: skip


@pytest.mark.variants
@pytest.mark.parametrize("binary", [0, 1])
def test_channels_become_recordings_with_forces_as_inputs(tmp_path, binary):
    x, functions = hammer_runs(binary)
    found = phc.read_uff(written(tmp_path, *functions))
    assert len(found) == 2
    for data, run_ in zip(found, x, strict=True):
        assert isinstance(data, ct.TimeResponseData) and data.time_unit == "s"
        assert data.input_labels == ["deck:1+Z"] and data.output_labels == ["deck:1+Z", "deck:2-X"]
        # the file prints the step 1/2048 s with six digits
        assert np.array_equal(data.time, np.arange(64) / 2048)
        assert np.allclose(data.outputs, run_[1:], rtol=1e-6) and np.allclose(data.inputs, run_[:1], rtol=1e-6)


def test_inputs_and_outputs_of_recordings_can_be_chosen(tmp_path):
    x, functions = hammer_runs()
    path = written(tmp_path, *functions)
    first = phc.read_uff(path, output="deck:2-X")[0]
    assert first.output_labels == ["deck:2-X"] and first.input_labels == ["deck:1+Z"]
    base = phc.read_uff(path, input=["deck:2-X"])[0]
    assert base.input_labels == ["deck:2-X"] and base.output_labels == ["deck:1+Z"]
    assert np.allclose(base.inputs[0] if base.inputs.ndim == 2 else base.inputs, x[0, 2])
    with pytest.raises(phc.StructureError, match=r"deck:1\+Z"):
        phc.read_uff(path, output="9+Z")
    for wrong in ([], 3, [3]):
        with pytest.raises(phc.StructureError, match="label"):
            phc.read_uff(path, input=wrong)


def test_a_recording_without_forces_has_no_input(tmp_path):
    t = 0.01 * np.arange(30)
    path = written(tmp_path, *(function(t, RNG.standard_normal(30), (k, 3), in_time=True) for k in (1, 2)))
    (data,) = phc.read_uff(path)
    assert data.inputs is None and data.outputs.shape == (2, 30)


@pytest.mark.variants
@pytest.mark.parametrize(
    "step", [1 / 6000, 0.1220703125, *slowly(1 / 2048, 1 / 25600, 1 / 44100, 0.001, 0.78125, 0.25, 3.2768)]
)
def test_a_printed_step_is_the_one_that_was_meant(tmp_path, step):
    f = step * np.arange(1, 2001)
    (data,) = phc.read_uff(written(tmp_path, function(f, np.ones(2000) + 0j, (1, 1), (1, 1))))
    assert np.abs(data.omega / (2 * np.pi * f) - 1).max() < 1e-14


def test_other_functions_are_passed_over(tmp_path):
    f = np.arange(1.0, 6.0)
    spectrum, response = function(f, np.ones(5), (1, 1), (1, 1), kind=2), function(f, np.ones(5) * 1j, (1, 1), (1, 1))
    assert len(phc.read_uff(written(tmp_path, spectrum, response))) == 1
    with pytest.raises(phc.FileFormatError, match="auto spectrum"):
        phc.read_uff(written(tmp_path, spectrum, name="spectra.uff"))


@pytest.mark.slow
def test_a_fit_takes_what_was_read(tmp_path):
    f = np.linspace(0.1, 1.0, 60)
    plant = phc.modes([1.5, 4.0], [1.0, 0.5])
    response = plant.freqresp(2 * np.pi * f).reshape(-1)
    path = written(tmp_path, function(f, response, (1, 3), (1, 3), binary=1, measured=11))
    result = phc.pem(phc.read_uff(path)[0], 2)
    assert np.allclose(result.d, [1.5, 4.0], rtol=1e-5)


@pytest.mark.slow
def test_the_quantity_of_an_output_is_that_of_the_file_where_it_responds_to_forces(tmp_path):
    f, H = np.arange(1.0, 6.0), 1j * np.ones(5)
    codes = {1: (8, 13), 2: (11, 13), 3: (12, 13), 4: (12, 12), 5: (0, 13), 6: (3, 13), 7: (13, 13), 8: (12, 0)}
    responses = [function(f, H, (k, 3), (1, 3), measured=code, applied=by) for k, (code, by) in codes.items()]
    doubtful = [function(f, H, (9, 3), (hit, 3), measured=code) for hit, code in ((1, 8), (2, 12))]
    (data,) = phc.read_uff(written(tmp_path, *responses, *doubtful))
    assert data.quantity == {"1+Z": "displacement", "2+Z": "velocity", "3+Z": "acceleration"}
    path = written(tmp_path, *hammer_runs()[1], name="hits.uff")
    assert phc.read_uff(path)[0].quantity == {"deck:1+Z": "acceleration", "deck:2-X": "acceleration"}
    # an acceleration in the place of the force
    assert phc.read_uff(path, input="deck:2-X", output="deck:1+Z")[0].quantity == {}
    decay = function(f, np.ones(5), (3, 1), in_time=True, measured=8)
    assert phc.read_uff(written(tmp_path, decay, name="decay.uff"))[0].quantity == {"3+X": "displacement"}


QUANTITIES = {8: "displacement", 11: "velocity", 12: "acceleration"}


@pytest.mark.slow
@pytest.mark.parametrize("code", QUANTITIES)
def test_a_fit_takes_the_quantity_of_the_file_and_says_so(tmp_path, code):
    f = np.linspace(0.1, 1.0, 60)
    mobility = phc.modes([1.5, 4.0], [1.0, 0.5]).freqresp(2 * np.pi * f).reshape(-1)
    measured = mobility * (2j * np.pi * f) ** {8: -1, 11: 0, 12: 1}[code]
    (data,) = phc.read_uff(written(tmp_path, function(f, measured, (1, 3), (1, 3), binary=1, measured=code)))
    result = phc.pem(data, 2)
    assert result.quantity == QUANTITIES[code] and result.structure == "lossless"
    assert np.allclose(result.modes.r, [1.0, 0.5], rtol=1e-4)
    assert f"  measured        {QUANTITIES[code]}" in result.summary()
    if code == 8:
        found = json.loads(run("fit", str(tmp_path / "test.uff"), "--order", "2", "--json").out)
        assert found["quantity"] == QUANTITIES[code]


def test_quantities_of_several_outputs_go_by_their_labels(tmp_path):
    f = np.arange(0.5, 20.0, 0.25)
    shapes, omega = np.array([[1.0, 0.5, -0.7], [0.4, -1.0, 0.8]]), 2 * np.pi * f
    poles = np.array([-0.5 + 30j, -0.8 + 70j])
    response = phc.modes(poles, shapes, shapes[:, :1] / (2j * poles.imag[:, None])).freqresp(omega)
    codes = (12, 8, 0)
    raised = np.array([1j * omega] * 3) ** np.array([[2], [0], [1]])
    path = written(tmp_path, *(
        function(f, response.reshape(3, -1)[k] * raised[k], (k + 1, 3), (1, 3), measured=codes[k], binary=1)
        for k in range(3)
    ))  # fmt: skip
    (data,) = phc.read_uff(path)
    result = phc.pem(data, 2, structure="free", ports=[("1+Z", "1+Z")])
    assert result.quantities == ("acceleration", "displacement", "velocity")
    assert np.allclose(result.shapes, shapes, rtol=1e-3, atol=1e-4)
    again = phc.read_uff(path)[0]
    again.quantity = {"1+Z": "velocity"}
    with pytest.raises(phc.StructureError, match=r"'1\+Z' is acceleration in one experiment and velocity"):
        phc.pem([data, again], 2)


@pytest.mark.slow
def test_dots_of_a_component_are_no_hindrance(tmp_path):
    f = np.arange(1.0, 6.0)
    many = [function(f, (k + 1) * np.ones(5), (3, 3), (3, 3), component=name) for k, name in enumerate(("a.b", "a_b"))]
    path = written(tmp_path, *many)
    (data,) = phc.read_uff(path)
    assert data.output_labels[0] != data.output_labels[1] == "a_b:3+Z" and "." not in data.output_labels[0]
    assert np.allclose(data.frdata[:, 0].real, [[1] * 5, [2] * 5])
    assert data.quantity == dict.fromkeys(data.output_labels, "acceleration")
    for label in ("a.b:3+Z", data.output_labels[0]):
        (part,) = phc.read_uff(path, output=label)
        assert np.allclose(part.frdata, 1)
    t = np.arange(6.0)
    (record,) = phc.read_uff(written(tmp_path, function(t, t, (1, 1), in_time=True, component="a.b"), name="b.uff"))
    assert record.output_labels == ["a.b:1+X"]


def responses(folder, outputs, hammers, **options):
    """Universal file of a frame of two places, its natural frequencies and mode shapes of unit modal mass."""
    f = np.arange(0.5, 40.0, 0.25)
    M, K = np.diag([2.0, 1.0]), np.array([[3e4, -1e4], [-1e4, 1e4]])
    C, w = 0.4 * M + 3e-5 * K, 2 * np.pi * f
    H = np.array([-x * x * np.linalg.inv(K - x * x * M + 1j * x * C) for x in w])
    pairs = [(int(np.sign(a)), abs(a), int(np.sign(b)), abs(b)) for b in hammers for a in outputs]
    sets = [function(f, s * r * H[:, a - 1, b - 1], (a, 3 * s), (b, 3 * r), **options) for s, a, r, b in pairs]
    values, vectors = scipy.linalg.eigh(K, M)
    return written(folder, *sets), np.sqrt(values), np.abs(vectors)


@pytest.mark.slow
def test_driving_points_are_those_of_equal_places_and_directions(tmp_path):
    path, d, shapes = responses(tmp_path, [1, 2], [2])
    (data,) = phc.read_uff(path)
    assert data.ports == [("2+Z", "2+Z")]
    result = phc.pem(data, 2)
    assert result.ports == ((1, 0),) and result.shapes_scaled and result.structure != "free"
    assert np.allclose(result.natural_frequencies, d, rtol=1e-5)
    # the shapes of `pem` are those of unit modal mass in units of velocity
    assert np.allclose(np.abs(result.shapes), shapes.T, rtol=1e-3)
    assert phc.pem(data, 2, ports=[]).ports == ()
    free = phc.pem(data, 2, quantity="free")
    assert free.ports == () and free.quantities == ("free", "free")


@pytest.mark.slow
def test_what_is_no_driving_point_is_not_taken_for_one(tmp_path):
    for options, outputs, hammers in (
        ({"applied": 12}, [1, 2], [2]), ({"measured": 0}, [1, 2], [2]), ({}, [1, -2], [2]), ({}, [1], [2]),
    ):  # fmt: skip
        path, _, _ = responses(tmp_path, outputs, hammers, **options)
        assert phc.read_uff(path)[0].ports == []
        path.unlink()
    path, _, _ = responses(tmp_path, [-1, 2], [-1, 2])
    assert phc.read_uff(path)[0].ports == [("1-Z", "1-Z"), ("2+Z", "2+Z")]
    path.unlink()
    f = np.arange(1.0, 6.0)
    path = written(tmp_path, function(f, np.ones(5), (3, 0), (3, 0)))
    assert phc.read_uff(path)[0].ports == []


def test_driving_points_of_recordings(tmp_path):
    t = np.arange(0.0, 1.0, 0.125)
    force = function(t, np.cos(t), (2, 3), in_time=True, force=True)
    motions = [function(t, k * t, (k, 3), in_time=True) for k in (1, 2)]
    (data,) = phc.read_uff(written(tmp_path, force, *motions))
    assert data.ports == [("2+Z", "2+Z")]


@pytest.mark.variants
@pytest.mark.parametrize("absent", [(1, 0), (2, 1)])
def test_a_pair_that_was_not_measured_is_named_by_the_fit(tmp_path, absent):
    f = np.arange(0.5, 20.0, 0.5)
    response = phc.modes([-1 + 40j], RNG.standard_normal((1, 3)), [[1j, 0.5j]]).freqresp(2 * np.pi * f)
    measured = [(o, i) for o in range(3) for i in range(2) if (o, i) != absent]
    path = written(tmp_path, *(function(f, response[o, i], (o + 1, 3), (i + 1, 3)) for o, i in measured))
    (data,) = phc.read_uff(path)
    with pytest.raises(phc.StructureError, match=rf"'{absent[0] + 1}\+Z' to '{absent[1] + 1}\+Z' was not measured"):
        phc.pem(data, 1, structure="free")
    whole = phc.read_uff(path, output=[f"{o + 1}+Z" for o in range(3) if o != absent[0]])[0]
    assert np.allclose(phc.pem(whole, 1, structure="free", quantity="displacement").poles, -1 + 40j, rtol=1e-4)


def damaged(rng, content: bytes) -> bytes:
    data, kind = bytearray(content), rng.integers(4)
    where = int(rng.integers(len(data)))
    if kind == 0:
        return bytes(data[:where])
    if kind == 1:
        data[where] = rng.integers(256)
    elif kind == 2:
        del data[where : where + int(rng.integers(1, 60))]
    else:
        data[where:where] = data[int(rng.integers(len(data))) :][:50]
    return bytes(data)


def refused_or_read(read, content, name):
    """Whether damaged content is refused; every other error than those of the package fails the test."""
    stream = io.BytesIO(content)
    stream.name = name
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            read(stream)
        except phc.StructureError:
            return True
    return False


@pytest.mark.variants
@pytest.mark.parametrize("binary", [0, 1])
def test_damaged_universal_files_are_refused_with_an_error_of_the_package(tmp_path, binary):
    content = written(tmp_path, *hammer_runs(binary)[1]).read_bytes()
    rng = np.random.default_rng(binary)
    assert not refused_or_read(phc.read_uff, content, "a.uff")
    assert sum(refused_or_read(phc.read_uff, damaged(rng, content), "a.uff") for _ in range(120)) > 30
    for cut in range(1, len(content) - 10, len(content) // 40):
        # what ends where a data set does is a file of fewer
        assert refused_or_read(phc.read_uff, content[:cut], "a.uff") != content[:cut].rstrip().endswith(b"    -1")
    for other in (b"", b"t,u,y\n0,1,2\n", b"    -1\n    -1\n"):
        assert refused_or_read(phc.read_uff, other, "a.uff")
    with pytest.raises(phc.FileMissingError):
        phc.read_uff(tmp_path / "absent.uff")


# --- mode shapes of universal files ----------------------------------------------------------------------------------

POLES = np.array([-0.5 + 30j, -0.8 + 70j])
PLACES = ["deck:7-Y", "2+Z", "7+X"]
ON_PLACES = np.array([[1.0, 0.5j, -0.7], [0.4, -1.0, 0.8 + 0.1j]])


def receptances(drive=0):
    """Of three outputs, with shapes of unit modal mass."""
    f = np.arange(0.5, 20.0, 0.25)
    plant = phc.modes(POLES, ON_PLACES, ON_PLACES[:, drive : drive + 1] / (2j * POLES.imag[:, None]))
    return 2 * np.pi * f, plant.freqresp(2 * np.pi * f)


def fit_of_shapes(time_unit=None, scaled=True):
    omega, H = receptances()
    seconds = {"ms": 1e-3, "s": 1.0, None: 1.0}[time_unit]
    data = ct.FrequencyResponseData(H, omega * seconds, outputs=PLACES, inputs=["f"])
    if time_unit:
        data.time_unit = time_unit
    return phc.pem(data, 2, structure="free", quantity="displacement", ports=[(0, 0)] if scaled else None)


@pytest.mark.parametrize("time_unit", [None, "s", "ms"])
def test_shapes_come_back_from_a_universal_file(tmp_path, time_unit):
    result = fit_of_shapes(time_unit)
    assert result.shapes_scaled
    phc.write_uff(result, tmp_path / "modes.uff")
    (found,) = phc.read_uff(tmp_path / "modes.uff")
    assert isinstance(found, phc.UniversalModes) and found.time_unit == "s" and found.shapes_scaled
    # by node and axis; the direction turned
    assert found.output_labels == ("2+Z", "7+X", "7+Y")
    assert np.allclose(found.poles, POLES, rtol=1e-5) and np.allclose(found.hertz, result.hertz, rtol=5e-6)
    assert np.allclose(found.damping_ratios, result.damping_ratios, rtol=1e-5)
    expected = result.shapes[:, [1, 2, 0]] * [1, 1, -1]
    assert np.allclose(found.shapes, expected, rtol=0, atol=5e-6 * np.abs(expected).max())
    assert np.allclose(result.mac(found.shapes[:, [2, 0, 1]] * [-1, 1, 1]), result.mac(result), atol=1e-4)
    # the whole model from a force at each place
    omega, H = receptances()
    receptance = found.modes.freqresp(omega)[:, 2]
    size = np.abs(H).max()
    assert np.allclose(receptance, -H[[1, 2, 0], 0] * np.array([[1], [1], [-1]]), rtol=0, atol=1e-3 * size)
    # what was read is written the same, but for the last digit of modal B
    phc.write_uff(found, tmp_path / "again.uff")
    (again,) = phc.read_uff(tmp_path / "again.uff")
    assert again.output_labels == found.output_labels
    for name in ("poles", "shapes", "modal_a"):
        assert np.array_equal(getattr(again, name), getattr(found, name))


def test_another_reader_finds_one_data_set_for_each_mode(tmp_path):
    result = fit_of_shapes()
    path = tmp_path / "modes.unv"
    phc.write_uff(result, path, places={"deck:7-Y": "3+Y", "7+X": "40-X"})
    with pytest.raises(phc.OutputExistsError):
        phc.write_uff(result, path)
    assert all(len(line) <= 80 for line in path.read_text().splitlines())
    sets = pyuff.UFF(str(path)).read_sets()
    assert [(one["type"], one["analysis_type"], one["spec_data_type"], one["mode_n"]) for one in sets] == [
        (55, 3, 8, 1), (55, 3, 8, 2),
    ]  # fmt: skip
    for one, pole, shape in zip(sets, result.poles, result.shapes, strict=True):
        assert np.isclose(one["eig"], pole, rtol=1e-5) and np.isclose(one["modal_a"], 2j * pole.imag, rtol=1e-5)
        assert np.isclose(one["modal_b"], -pole * one["modal_a"], rtol=1e-5)
        assert one["node_nums"].tolist() == [2, 3, 40]
        table = np.array([[0, 0, -shape[2]], [0, shape[0], 0], [shape[1], 0, 0]])
        assert np.allclose([one["r1"], one["r2"], one["r3"]], table, atol=1e-5)


def test_shapes_without_a_driving_point_have_no_scale(tmp_path):
    result = fit_of_shapes(scaled=False)
    assert not result.shapes_scaled
    phc.write_uff(result, tmp_path / "modes.uff", places=["1+X", "2+X", "3+X"])
    (found,) = phc.read_uff(tmp_path / "modes.uff")
    assert not found.shapes_scaled and not found.modal_a.any()
    assert np.allclose(found.shapes, result.shapes, atol=1e-5)
    with pytest.raises(phc.StructureError, match="no modal mass"):
        _ = found.modes


def test_a_lossless_fit_is_written_as_well(tmp_path):
    omega = np.linspace(0.5, 6.0, 60)
    data = ct.FrequencyResponseData(phc.modes([1.5, 4.0], [1.0, 0.5]).freqresp(omega), omega)
    result = phc.pem(data, 2, structure="lossless")
    phc.write_uff(result, tmp_path / "modes.uff", places="1-Z")
    (found,) = phc.read_uff(tmp_path / "modes.uff")
    assert np.allclose(found.poles, [1.5j, 4j], rtol=1e-5)
    assert np.allclose(1j * omega * found.modes.freqresp(omega).ravel(), data.frdata.ravel(), rtol=1e-3, atol=1e-3)


def shape_set(kind, nodes, values, mode=1, **fields):
    """Data set 55 as pyuff writes it; a column of values for each direction."""
    return {
        "type": 55, "analysis_type": kind, "data_ch": 3 if len(values) == 6 else 2, "spec_data_type": 8, "load_case": 1,
        "mode_n": mode, "node_nums": np.array(nodes), **{f"r{k + 1}": np.array(v) for k, v in enumerate(values)},
    } | fields  # fmt: skip


def test_normal_modes_of_other_programs_are_read(tmp_path):
    none = [0.0, 0.0]
    first = shape_set(
        2, [4, 9], [[1.0, -2.0], none, none, none, none, [0.0, 0.25]], freq=2.0, modal_m=3.0, modal_damp_vis=0.02
    )
    second = shape_set(
        2, [9, 12], [[0.5, 0.5], [0.1, 0.0], none, none, none, none], 2, freq=5.0, modal_m=1.0, modal_damp_his=0.02
    )
    (found,) = phc.read_uff(written(tmp_path, first, second))
    assert found.output_labels == ("4+X", "9+X", "9+Y", "9+RZ", "12+X")
    assert np.allclose(found.shapes, [[1, -2, 0, 0.25, 0], [0, 0.5, 0.1, 0, 0.5]])
    assert np.allclose(found.hertz, [2.0, 5.0]) and np.allclose(found.damping_ratios, [0.02, 0.01])
    # the receptance of the first mode at rest is shape shape^T / (m d^2), damping aside
    at_rest = found.modes.freqresp(0.0).reshape(5, 5)[0, 0]
    assert np.isclose(at_rest, 1 / (3.0 * (4 * np.pi) ** 2), rtol=1e-5)


def test_complex_modes_of_other_programs_are_read(tmp_path):
    shape = [np.array([1 + 1j, 2.0]), np.zeros(2) + 0j, np.zeros(2) + 0j]
    conjugate = [column.conj() for column in shape]
    sets = [
        shape_set(3, [1, 2], shape, eig=-1 + 5j, modal_a=2 + 10j),
        shape_set(3, [1, 2], conjugate, 2, eig=-1 - 5j, modal_a=2 - 10j),
        shape_set(7, [1, 2], shape, 3, eig=-1 + 9j, modal_a=18j, spec_data_type=12),
        shape_set(5, [1, 2], shape, 4, freq=3.0, freq_step_n=1),
    ]
    (found,) = phc.read_uff(written(tmp_path, *sets))
    assert np.allclose(found.poles, [-1 + 5j, -1 + 9j]) and np.allclose(found.shapes, [[1 + 1j, 2]] * 2)
    # the scale of accelerations is not agreed
    assert np.allclose(found.modal_a, [2 + 10j, 0])
    path = written(tmp_path, function(np.arange(1.0, 6.0), np.ones(5) * 1j, (1, 1), (1, 1)), *sets, name="both.uff")
    assert [type(one) for one in phc.read_uff(path)] == [ct.FrequencyResponseData]


def test_what_is_no_mode_is_refused_with_its_reason(tmp_path):
    result = fit_of_shapes()
    path = tmp_path / "modes.uff"
    for places, reason in (
        (["1+Z", "2+Z"], "2 entries for 3 outputs"), (["1+Z", "2+Z", "1-Z"], "'1-Z'; give them different nodes"),
        (["1+Z", "2+Z", "3+RX"], "not a node and"), (["1+Z", "2+Z", 3], "not a node and"),
        ({"deck": "1+Z"}, "places names 'deck'"), (3, "1 entries"), ({"2+Z": "acc 2"}, "not a node and"),
    ):  # fmt: skip
        with pytest.raises(phc.StructureError, match=reason):
            phc.write_uff(result, path, places=places)
    for other in (phc.modes([1.0], [1.0]), 3, ct.ss(-1, 1, 1, 0)):
        with pytest.raises(phc.StructureError, match="pass the result of a fit"):
            phc.write_uff(other, path)
    assert not path.exists()
    phc.write_uff(result, path)
    with pytest.raises(phc.StructureError, match="leave out input and output"):
        phc.read_uff(path, output="2+Z")
    content, rng = path.read_bytes(), np.random.default_rng(3)
    assert not refused_or_read(phc.read_uff, content, "a.uff")
    assert sum(refused_or_read(phc.read_uff, damaged(rng, content), "a.uff") for _ in range(120)) > 20
    silent = shape_set(2, [1], [[0.0]] * 3, freq=1.0, modal_m=1.0)
    with pytest.raises(phc.FileFormatError, match="all 0"):
        phc.read_uff(written(tmp_path, silent, name="silent.uff"))
    static = shape_set(5, [1], [[1.0]] * 3, freq=1.0, freq_step_n=1)
    with pytest.raises(phc.FileFormatError, match="no modes"):
        phc.read_uff(written(tmp_path, static, name="static.uff"))


# --- Touchstone ------------------------------------------------------------------------------------------------------


def impedance(f):
    """Series resistor, inductor and capacitor from port 1 to 2, and a capacitor across port 2."""
    s = 2j * np.pi * f
    series, shunt = 2.0 + 1e-6 * s + 1 / (1e-9 * s), 1 / (3e-9 * s)
    return np.array([[series + shunt, shunt], [shunt, shunt]])


@pytest.fixture
def network(tmp_path):
    f = np.linspace(1e6, 1e7, 50)
    Z = impedance(f)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        made = skrf.Network(frequency=skrf.Frequency.from_f(f, unit="hz"), z=Z.transpose(2, 0, 1), z0=50)
        made.write_touchstone("filter", dir=str(tmp_path))
    return tmp_path / "filter.s2p", f, Z


def test_impedance_admittance_and_scattering_of_a_network(network):
    path, f, Z = network
    data = phc.read_touchstone(path)
    assert data.input_labels == ["i1", "i2"] and data.output_labels == ["v1", "v2"] and data.time_unit == "s"
    assert np.allclose(data.omega, 2 * np.pi * f) and np.allclose(data.frdata, Z, rtol=1e-7)
    Y = phc.read_touchstone(path, parameter="Y")
    assert Y.input_labels == ["v1", "v2"]
    assert np.allclose(np.einsum("ijk,jlk->ilk", Y.frdata, Z), np.eye(2)[:, :, None], atol=1e-6)
    S = phc.read_touchstone(path, parameter="S").frdata
    expected = [(z - 50 * np.eye(2)) @ np.linalg.inv(z + 50 * np.eye(2)) for z in Z.transpose(2, 0, 1)]
    assert np.allclose(S.transpose(2, 0, 1), expected, atol=1e-9)


def test_what_has_no_impedance_says_so_and_what_to_read():
    open_end = io.StringIO("# Hz S RI R 50\n1.0 1.0 0.0\n2.0 0.5 0.0\n")
    open_end.name = "open.s1p"
    with pytest.raises(phc.StructureError, match="parameter='Y'"):
        phc.read_touchstone(open_end)
    open_end.seek(0)
    assert np.allclose(phc.read_touchstone(open_end, parameter="Y").frdata[0, 0], [0.0, 1 / 150])


def test_damaged_networks_are_refused_with_an_error_of_the_package(network):
    content = network[0].read_bytes()
    rng = np.random.default_rng(3)
    assert not refused_or_read(phc.read_touchstone, content, "a.s2p")
    assert sum(refused_or_read(phc.read_touchstone, damaged(rng, content), "a.s2p") for _ in range(60)) > 10
    assert refused_or_read(phc.read_touchstone, content, "a.txt")
    for other in (b"", b"# Hz S RI R 50\n", b"1 2 3\n4 5"):
        assert refused_or_read(phc.read_touchstone, other, "a.s1p")
    with pytest.raises(phc.StructureError, match="parameter"):
        phc.read_touchstone(network[0], parameter="T")


def test_measured_networks_are_read(data_folder):
    data = phc.read_touchstone(data_folder / "networks" / "ring_slot.s2p")
    assert data.frdata.shape[:2] == (2, 2) and np.isclose(data.omega[0], 2 * np.pi * 75e9)
    four = phc.read_touchstone(data_folder / "networks" / "Agilent_E5071B.s4p", parameter="S")
    assert four.frdata.shape[:2] == (4, 4) and 0.97 < np.linalg.svd(four.frdata.transpose(2, 0, 1))[1].max() < 0.98


@pytest.mark.parametrize(
    ("package", "read", "name"), [("pyuff", phc.read_uff, "a.uff"), ("skrf", phc.read_touchstone, "a.s1p")]
)
def test_without_the_package_that_reads_a_format_the_extra_is_named(monkeypatch, package, read, name):
    monkeypatch.setitem(sys.modules, package, None)
    stream = io.StringIO("    -1\n")
    stream.name = name
    with pytest.raises(ImportError, match=r"ph_control\[formats\]") as refused:
        read(stream)
    assert isinstance(refused.value, phc.PHControlError)


# --- MATLAB ----------------------------------------------------------------------------------------------------------


def mat(**variables):
    stream = io.BytesIO()
    scipy.io.savemat(stream, variables)
    stream.seek(0)
    stream.name = "test.mat"
    return stream


T, U, Y = 0.5 + np.arange(20) / 10, RNG.standard_normal((20, 2)), RNG.standard_normal((20, 3))


def test_variables_of_a_recording_are_named():
    data = phc.read_mat(mat(t=T, u=U, y=Y), time_unit="ms")
    assert data.input_labels == ["u[0]", "u[1]"] and data.output_labels == ["y[0]", "y[1]", "y[2]"]
    assert np.array_equal(data.inputs, U.T) and np.array_equal(data.outputs, Y.T) and data.time_unit == "ms"
    assert np.allclose(data.time, T, rtol=1e-15)
    inside = mat(test={"f": U[:, 0], "a": Y, "clock": T})
    data = phc.read_mat(inside, input="test.f", output=["test.a[2]", "test.a[0]"], time="test.clock")
    assert data.output_labels == ["test.a[2]", "test.a[0]"] and data.input_labels == ["test.f"]
    assert np.array_equal(data.outputs, Y.T[[2, 0]]) and data.time_unit is None


def test_samples_run_along_the_rows_unless_the_time_says_otherwise():
    assert np.array_equal(phc.read_mat(mat(t=T, u=U.T, y=Y.T)).outputs, Y.T)
    free = phc.read_mat(mat(y=Y.T), input=False, dt=0.1)
    assert free.outputs.shape == (20, 3) and free.inputs is None
    column = phc.read_mat(mat(u=U[:, :1].T, y=Y[:, :1]), dt=0.1)
    assert np.array_equal(np.ravel(column.inputs), U[:, 0]) and np.allclose(column.time, 0.1 * np.arange(20))


def test_what_does_not_fit_names_the_variables():
    for options, said in (
        ({"output": "x"}, "t, u, y"), ({"output": "y[3]"}, "no column 3"), ({"dt": 0.2, "time": "t"}, "leave dt out"),
        ({"time": False}, "dt="), ({"output": 3}, "name of a variable"), ({"output": ["y", "y[0]"]}, "twice"),
    ):  # fmt: skip
        with pytest.raises(phc.StructureError, match=said):
            phc.read_mat(mat(t=T, u=U, y=Y), **options)
    with pytest.raises(phc.StructureError, match="samples"):
        phc.read_mat(mat(u=U[:7], y=Y), dt=0.1)
    gap = np.where(np.arange(20) == 4, np.nan, U[:, 0])
    with pytest.raises(phc.FileFormatError, match="missing"):
        phc.read_mat(mat(u=gap, y=Y), dt=0.1)
    assert np.isnan(phc.read_mat(mat(u=U, y=gap), dt=0.1).outputs).sum() == 1
    for wrong in ({"y": "text"}, {"y": 1j * Y}, {"y": np.zeros((2, 2, 2))}):
        with pytest.raises(phc.StructureError):
            phc.read_mat(mat(u=U, **wrong), dt=0.1)
    with pytest.raises(phc.FileFormatError, match="uniform"):
        phc.read_mat(mat(t=T**2, u=U, y=Y))


def test_frequency_responses_of_matlab():
    f, H = np.array([3.0, 1.0, 2.0]), RNG.standard_normal((3, 2, 3, 2)) @ [1, 1j]
    data = phc.read_frequency_mat(mat(f=f, H=H), frequency="f", response="H", frequency_unit="kHz")
    assert np.allclose(data.omega, 2e3 * np.pi * np.arange(1, 4)) and np.allclose(data.frdata, H[..., [1, 2, 0]])
    first = phc.read_frequency_mat(mat(f=f, H=H.transpose(2, 0, 1)), "f", "H", frequency_unit="kHz")
    assert np.array_equal(first.frdata, data.frdata)  # as modalfrf has them: frequencies, outputs, inputs
    columns = phc.read_frequency_mat(
        mat(f=f, a=H[:2, 0].T, b=H[2, 0]), frequency="f", response=["a[1]", "b"], frequency_unit="rad/s"
    )
    assert np.allclose(columns.frdata[:, 0], H[[1, 2], 0][:, [1, 2, 0]]) and columns.output_labels == ["a[1]", "b"]
    with pytest.raises(phc.StructureError, match="frequency_unit="):
        phc.read_frequency_mat(mat(f=f, H=H), "f", "H")
    with pytest.raises(phc.StructureError, match="3 frequencies"):
        phc.read_frequency_mat(mat(f=f, H=np.ones(4)), frequency="f", response="H", frequency_unit="Hz")


def test_measured_matlab_files_are_read(data_folder):
    arm = phc.read_mat(
        data_folder / "measured" / "CD_player_arm_dat.mat", dt=1.0,
        input=["CD_player_arm_dat[0]", "CD_player_arm_dat[1]"], output=["CD_player_arm_dat[2]", "CD_player_arm_dat[3]"],
    )  # fmt: skip
    assert arm.inputs.shape == arm.outputs.shape == (2, 2048)
    receptance = phc.read_frequency_mat(
        data_folder / "measured" / "mckiddat.mat", frequency="Freq", response="Recep", frequency_unit="Hz"
    )
    peaks = receptance.omega[np.abs(receptance.frdata[0, 0]).argmax()] / 2 / np.pi
    assert receptance.frdata.shape == (3, 1, 401) and min(abs(peaks - one) for one in (0.1029, 0.1962, 0.3247)) < 1e-3


@pytest.mark.parametrize("read", [
    lambda source: phc.read_mat(source, dt=0.1),
    lambda source: phc.read_frequency_mat(source, frequency="u", response="y", frequency_unit="Hz"),
])  # fmt: skip
def test_damaged_matlab_files_are_refused_with_an_error_of_the_package(read):
    content = mat(u=np.abs(U[:, 0]), y=Y).getvalue()
    rng = np.random.default_rng(8)
    assert not refused_or_read(read, content, "a.mat")
    assert sum(refused_or_read(read, damaged(rng, content), "a.mat") for _ in range(100)) > 30
    assert refused_or_read(read, b"u,y\n1,2\n", "a.csv")


# --- text tables of several channels ---------------------------------------------------------------------------------


def test_a_table_of_several_responses_is_a_matrix():
    text = "f [Hz],r1,i1,r2,i2\n1,1,2,3,4\n2,5,6,7,8\n"
    column = phc.read_frequency_csv(io.StringIO(text), real=["r1", "r2"], imag=["i1", "i2"])
    assert np.array_equal(column.frdata, [[[1 + 2j, 5 + 6j]], [[3 + 4j, 7 + 8j]]])
    row = phc.read_frequency_csv(io.StringIO(text), real=[["r1", "r2"]], imag=[["i1", "i2"]])
    assert np.array_equal(row.frdata, [[[1 + 2j, 5 + 6j], [3 + 4j, 7 + 8j]]])
    for real, imag in (
        (["r1"], ["i1", "i2"]),
        ([["r1"], ["r2", "r1"]], "i1"),
        ([], "i1"),
        (["r1", "r1"], ["i1", "i2"]),
    ):
        with pytest.raises(phc.StructureError):
            phc.read_frequency_csv(io.StringIO(text), real=real, imag=imag)


# --- the command line ------------------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def recorded():
    rng = np.random.default_rng(1)
    t, u = 0.1 * np.arange(400), rng.standard_normal(400)
    y = phc.forced_response(phc.ph(phc.modes([1.0, 2.5], [1.0, 0.4])), t, u, intersample="zoh").outputs
    return t, u, y + 0.01 * rng.standard_normal(400)


def fitted(*words):
    return json.loads(run("fit", *words, "--order", "2", "--json").out)["d"]


def test_commands_read_every_format(folder):
    t, u, y = recorded()
    f = np.linspace(0.1, 1.0, 60)
    response = phc.modes([1.0, 4.0], [1.0, 0.5]).freqresp(2 * np.pi * f).reshape(-1)
    scipy.io.savemat("a.mat", {"t": t, "u": u, "y": y, "f": f, "H": response})
    written(
        folder,
        *(function(t, x, (1, 3), in_time=True, force=force, measured=11) for x, force in ((u, True), (y, False))),
    )
    written(folder, function(f, response, (1, 3), (1, 3), measured=11), name="shaker.unv")
    np.savetxt("a.csv", np.column_stack([t, u, -u, y]), delimiter=",", header="t,u,v,y", comments="")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        z = response.reshape(-1, 1, 1)
        skrf.Network(frequency=skrf.Frequency.from_f(f, unit="hz"), z=z, z0=1).write_touchstone("circuit")
    recordings = (["a.mat"], ["a.mat", "--inputs", "u", "--outputs", "y"], ["test.uff", "--output", "1+Z"],
                  ["a.csv", "--inputs", "u", "--outputs", "y"])  # fmt: skip
    for words in recordings:
        assert np.allclose(fitted(*words), [1.0, 2.5], rtol=2e-3), words
    for words in (["a.mat", "--frequency", "f", "--outputs", "H", "--frequency-unit", "Hz"], ["shaker.unv"],
                  ["circuit.s1p"], ["circuit.s1p", "--inputs", "i1"]):  # fmt: skip
        assert np.allclose(fitted(*words), [1.0, 4.0], rtol=1e-4), words


@pytest.mark.parametrize(("words", "said"), [
    (["a.mat", "test.s1p"], "do not go together"), (["a.mat", "--input", "u", "--inputs", "u"], "contradict"),
    (["a.mat", "--frequency", "f"], "--outputs"), (["a.mat", "--outputs", "q"], "no variable"),
    (["test.s1p", "--outputs", "q"], "no output"), (["test.s1p", "--weights", "w"], "--weights"),
    (["a.mat", "--inputs", "a,,b"], "list of names"), (["test.s1p", "--inputs", "i1,i2"], "no input"),
])  # fmt: skip
def test_commands_say_what_a_file_does_not_have(folder, words, said):
    scipy.io.savemat("a.mat", {"t": T, "u": U[:, 0], "y": Y[:, 0]})
    (folder / "test.s1p").write_text("# Hz Z RI R 1\n1 0 1\n2 0 2\n3 0 -1\n")
    done = run("fit", *words)
    assert done.status == 2 and said in done.error
