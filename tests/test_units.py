"""The unit of time goes from the header of a recording to every number, table and picture; none is made up."""

from __future__ import annotations

import io
import pickle

import control as ct
import matplotlib.pyplot as plt
import numpy as np
import pytest
from slow import slowly

import ph_control as phc
from ph_control import StructureError

D, R, STEP = np.array([0.3, 1.1]), np.array([1.0, 0.4]), 0.2


def signals(samples: int = 400) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng, t = np.random.default_rng(0), STEP * np.arange(samples)
    u = rng.standard_normal(samples)
    return (
        t,
        u,
        phc.forced_response(phc.ph(phc.modes(D, R)), t, u, intersample="zoh").outputs
        + 0.05 * rng.standard_normal(samples),
    )


def recording(label: str, **options) -> ct.TimeResponseData:
    lines = [f"{t:.1f},{u!r},{y!r}" for t, u, y in zip(*map(np.ndarray.tolist, signals()), strict=True)]
    return phc.read_csv(io.StringIO("\n".join([f'"{label}",f [N],v [m/s]', *lines])), **options)


@pytest.fixture(scope="module")
def in_ms():
    return phc.pem(recording("Time (ms)"), 2)


@pytest.mark.parametrize(
    "label, unit",
    [
        ("Time (ms)", "ms"), ("t [s]", "s"), ("time_ms", "ms"), ("time/ms", "ms"), ("t / h", "h"), ("t_s", "s"),
        ("Time (sec)", "s"), ("TIME (MS)", "ms"), ("time [us]", "us"), ("time [µs]", "us"), ("time [\u03bcs]", "us"),
        ("Time in minutes", "min"), ("time, ns", "ns"), ("Time(min)", "min"), ("timestamp", None), ("t", None),
        ("time [frames]", None), ("time [mS]", None), ("Time (Ms)", None),
    ],
)  # fmt: skip
def test_a_header_tells_the_unit_of_time_or_none(label, unit):
    data = phc.read_csv(io.StringIO(f'"{label}";u;y\n0;1;2\n0.5;3;4\n'))
    assert data.time_unit == unit and data.time.tolist() == [0.0, 0.5]


@pytest.mark.parametrize("label", ["time_constant", "t_max", "time_m", "T [s]", "time/length"])
def test_what_is_no_time_does_not_become_one_by_a_unit(label):
    with pytest.raises(StructureError, match="no column is the time"):
        phc.read_csv(io.StringIO(f"{label},u,y\n0,1,2\n1,3,4\n"))


def test_a_row_of_units_and_a_column_of_any_name_tell_it_too():
    assert phc.read_csv(io.StringIO("time,u,y\nms,N,m\n0,1,2\n1,3,4\n")).time_unit == "ms"
    text = "elapsed_ms,u,y\n0,1,2\n1,3,4\n"
    assert phc.read_csv(io.StringIO(text), time="elapsed_ms").time_unit == "ms"
    assert phc.read_csv(io.StringIO(text), time="elapsed_ms", time_unit="min").time_unit == "min"
    assert phc.read_csv(io.StringIO("0,1\n1,2\n"), dt=2.0).time_unit is None
    assert phc.read_csv(io.StringIO("0,1\n1,2\n"), dt=2.0, time_unit="usec").time_unit == "us"
    with pytest.raises(StructureError, match="time_unit is 'parsec'; known are 'ns'"):
        phc.read_csv(io.StringIO("0,1\n1,2\n"), dt=2.0, time_unit="parsec")


def test_a_result_has_its_frequencies_in_the_unit_of_the_recording_and_in_hertz(in_ms):
    assert in_ms.time_unit == in_ms.record.time_unit == "ms"
    np.testing.assert_allclose(in_ms.d, D, rtol=1e-3)
    np.testing.assert_allclose(in_ms.hertz, 1e3 * in_ms.d / (2 * np.pi))
    np.testing.assert_array_equal(in_ms.natural_frequencies, in_ms.d)
    _t, u, y = signals()
    unknown = phc.pem((u, y), 2, dt=STEP)
    assert unknown.time_unit is None
    np.testing.assert_allclose(unknown.hertz, unknown.d / (2 * np.pi))


def test_the_table_has_hertz_damping_and_residues_to_their_errors(in_ms):
    head, *rows = [line.split() for line in in_ms.summary().split("\n\n")[1].splitlines()]
    assert " ".join(head) == "mode f [Hz] +- damping [%] +- |residue| +- phase [deg]"
    assert "step 0.2 ms" in in_ms.summary()
    for l, row in enumerate(rows):
        hertz, hertz_error, damping, _, size, size_error, phase = map(float, row[1:])
        # of lossless modes the residue is half that of the weight, kappa = r d
        assert size_error == pytest.approx(0.5 * in_ms.stderr["kappa"][l], rel=0.05)
        assert abs(size - 0.5 * in_ms.kappa[l]) < 0.06 * size_error
        assert hertz_error == pytest.approx(in_ms.stderr["hertz"][l], rel=0.05)
        assert abs(hertz - in_ms.hertz[l]) < 0.06 * hertz_error
        assert damping == phase == 0.0
        # two digits of the error, and no more of the number than that
        for number, error in ((row[1], row[2]), (row[5], row[6])):
            assert "e" in error or len(number.partition(".")[2]) == len(error.partition(".")[2])


def test_no_unit_is_shown_that_nobody_has_told():
    _t, u, y = signals()
    unknown = phc.pem((u, y), 2, dt=STEP)
    assert "f [1/time]" in unknown.summary()
    assert "Hz" not in unknown.summary() and "rad/s" not in unknown.summary()
    pictures = [
        unknown.plot(), phc.bode_plot(unknown), phc.step_plot(unknown), phc.modes_plot(unknown),
        phc.compare((u, y), unknown).plot(), phc.bode_plot(unknown.system, data=unknown.record.as_response()),
    ]  # fmt: skip
    for picture in pictures:
        assert picture.axes[-1, 0].get_xlabel().split(" [")[-1] in ("Time", "rad/time]")


def test_every_picture_carries_the_unit_of_the_recording(in_ms):
    data = recording("Time (ms)")
    pictures = {
        "fit": in_ms.plot(), "fit_plot": phc.fit_plot(in_ms), "bode": phc.bode_plot(in_ms),
        "data": phc.bode_plot(in_ms.system, data=data), "step": phc.step_plot(in_ms), "modes": phc.modes_plot(in_ms),
        "poles": phc.pole_zero_plot(in_ms), "compare": phc.compare(data, in_ms).plot(),
        "orders": phc.order_selection(data, 2).plot(),
    }  # fmt: skip
    labels = {name: picture.axes[-1, 0].get_xlabel() for name, picture in pictures.items()}
    assert all(label.endswith(("Time [ms]", "[rad/ms]")) for label in labels.values()), labels
    for picture in (phc.bode_plot(in_ms.system, data=data, Hz=True), phc.bode_plot(in_ms, data=data, Hz=True)):
        assert picture.axes[-1, 0].get_xlabel() == "Frequency [Hz]"
        legend = [text.get_text() for text in picture.legend.get_texts()]
        assert legend[-1] == "Nyquist frequency (2500 Hz)"
    poles, *_ = phc.pole_zero_plot(in_ms, Hz=True).lines[0, 0]
    np.testing.assert_allclose(poles.get_xdata(), in_ms.hertz)
    with pytest.raises(StructureError, match="time_unit is 's', but the times are in ms"):
        phc.bode_plot(in_ms, time_unit="s")
    plt.close("all")


def test_a_file_keeps_the_unit(in_ms, tmp_path):
    phc.save(in_ms, tmp_path / "fit.json")
    again = phc.load(tmp_path / "fit.json")
    assert again.time_unit == "ms" and again.summary() == in_ms.summary()
    assert in_ms.record.as_response().time_unit == "ms"
    assert in_ms.predict(recording("Time (ms)")).time_unit == "ms"
    assert pickle.loads(pickle.dumps(in_ms.record)).time_unit == "ms"


def test_the_model_of_a_fit_keeps_the_unit_alone_too(in_ms, tmp_path):
    phc.save(in_ms.system, tmp_path / "model.json")
    for model in (in_ms.system, phc.load(tmp_path / "model.json"), pickle.loads(pickle.dumps(in_ms.system))):
        assert model.time_unit == "ms"
        with pytest.raises(StructureError, match="times are in s here and in ms there"):
            phc.compare(recording("t [s]"), model)
    assert phc.bode_plot(in_ms.system).axes[-1, 0].get_xlabel() == "Frequency [rad/ms]"
    assert phc.frenkel_kontorova().time_unit is None
    plt.close("all")


def test_a_unit_can_be_said_of_any_data():
    t, u, y = signals()
    data = ct.TimeResponseData(t, y, inputs=u)
    assert phc.pem(data, 2).time_unit is None
    data.time_unit = "µs"
    assert phc.pem(data, 2).time_unit == "us"
    data.time_unit = 3
    with pytest.raises(StructureError, match="time_unit is 3"):
        phc.pem(data, 2)


class Frame(dict):
    """What is used of a data frame."""

    @property
    def columns(self):
        return list(self)


def test_a_data_frame_tells_it_by_the_label_of_its_time():
    t, u, y = signals()
    assert phc.pem(Frame({"Time (ms)": t, "u": u, "y": y}), 2).time_unit == "ms"


def test_two_units_are_never_mixed(in_ms):
    seconds = recording("t [s]")
    with pytest.raises(StructureError, match="times are in ms here and in s there"):
        phc.pem([recording("t [ms]"), seconds], 2)
    for call in (
        lambda: phc.compare(seconds, in_ms), lambda: phc.residual_analysis(seconds, in_ms),
        lambda: in_ms.predict(seconds), lambda: phc.bode_plot(in_ms, data=seconds),
        lambda: phc.pem(seconds, 2, initial_guess=in_ms),
    ):  # fmt: skip
        with pytest.raises(StructureError, match="times are in"):
            call()


def test_a_table_of_frequencies_is_per_second():
    omega = 2 * np.pi * np.geomspace(100.0, 1000.0, 60)
    G = phc.ph(phc.modes([2000.0], [1.0]))(1j * omega)
    lines = [f"{w / 2e3 / np.pi!r},{g.real!r},{g.imag!r}" for w, g in zip(omega.tolist(), G.tolist(), strict=True)]
    data = phc.read_frequency_csv(io.StringIO("\n".join(["f [kHz],re,im", *lines])))
    result = phc.pem(data, 1)
    assert data.time_unit == result.time_unit == "s" and "f [Hz]" in result.summary()
    np.testing.assert_allclose(result.hertz, 2000.0 / 2 / np.pi)
    assert phc.bode_plot(result).axes[-1, 0].get_xlabel() == "Frequency [rad/s]"
    plt.close("all")


def test_what_an_input_shows_is_told_in_the_unit_of_the_record():
    t = 0.1 * np.arange(500)
    data = ct.TimeResponseData(t, np.zeros(500), inputs=np.sin(t))
    data.time_unit = "ms"
    data.y[:] = np.nan
    found = phc.excitation(data, ([0.5, 2.0], [1.0, 0.25]))
    text = "".join([found.summary(), str(found), *found.remedies])
    assert "step 0.1 ms: one bin is 0.1257 rad/ms" in text and "d [rad/ms]" in text and "time" not in text


def test_pictures_of_many_recordings_say_hz_only_where_the_unit_of_time_is_known():
    t, rng = 0.1 * np.arange(400), np.random.default_rng(0)
    chain = phc.ph(phc.modes([1.0, 2.5], [1.0, 0.5]))
    records = [phc.forced_response(chain, t, rng.standard_normal(400), intersample="zoh") for _ in range(2)]
    for unit, label in ((None, "1/time"), ("s", "Hz")):
        for record in records:
            record.time_unit = unit
        fits = phc.fit_many(records)
        axes = fits.plot().axes[:, 0]
        assert {axis.get_ylabel() for axis in axes} == {f"Frequency [{label}]", "Damping ratio [%]"}
        assert f"mode {label} +-" in " ".join(str(fits).split())
        assert f"first {label}" in str(fits.track())
    plt.close("all")


def test_an_envelope_and_a_tuned_damper_are_told_in_the_unit_of_the_system():
    plot = phc.step_plot(phc.modes([1.0, 1e6], [1.0, 0.1]), time_unit="s")
    assert "at d = 1e+06 rad/s, too fast" in plot.legend.get_texts()[-1].get_text()
    plt.close(plot.figure)
    plant = phc.spring_chain([1.0], [], ground=1.0)
    assert "rad/time and" in str(phc.optimal_damping(plant, mass=0.1))
    plant.time_unit = "s"
    assert "rad/s and" in str(phc.optimal_damping(plant, mass=0.1))


def test_a_system_of_a_known_unit_has_hertz_and_gives_the_unit_to_what_is_made_of_it():
    plant = phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0], R=np.diag([0.0, 0.4]))
    assert plant.hertz == pytest.approx(2 / (2 * np.pi)) and phc.ph(plant).time_unit is None  # cycles per unit of time
    plant.time_unit = "milliseconds"
    assert plant.hertz == pytest.approx(2e3 / (2 * np.pi))
    again = pickle.loads(pickle.dumps(plant))
    for made in (plant, plant.lossless_part(), phc.sample(plant, 0.1), phc.ph(plant), again):
        assert made.time_unit == "ms"


def test_pictures_of_passivity_and_energy_have_the_unit_of_the_system():
    plant = phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0], R=np.diag([0.0, 0.4]))
    plant.time_unit = "ms"
    axes = phc.passivity(plant).plot().axes
    assert axes[0, 0].get_xlabel() == "Frequency [rad/ms]"
    balance = phc.energy_balance(phc.step_response(plant, np.linspace(0.0, 5.0, 50)), plant)
    assert balance.plot().axes[1, 0].get_xlabel() == "Time [ms]"
    plt.close("all")


def test_a_system_takes_known_units_of_time_only():
    plant = phc.ph(phc.modes(D, R))
    with pytest.raises(StructureError, match=r"'fortnight'; known are 'ns', 'us', 'ms', 's', 'min', 'h', or None"):
        plant.time_unit = "fortnight"
    assert plant.time_unit is None


@pytest.mark.parametrize(("label", "unit"), [("acc [g]", "g"), ("acc (g)", "g"), ("acc (left)", ""), ("acc", "")])
def test_brackets_tell_the_unit_of_pictures(label, unit):
    model = ct.ss(phc.ph(phc.modes(D, R)))
    model.input_labels, model.output_labels = ["hammer (N)"], [label]
    plot = phc.bode_plot(model)
    assert plot.axes[0, 0].get_ylabel() == f"Magnitude [dB{f' re 1 {unit}/N' if unit else ''}]"
    plt.close(plot.figure)


def test_a_unit_of_the_gain_that_the_measurement_tells_is_that_of_the_model():
    model = ct.tf([1.0, 0.0], [1.0, 0.1, 1.0])
    data = ct.frd(
        model(1j * np.linspace(0.5, 2.0, 50)), np.linspace(0.5, 2.0, 50), inputs="force [N]", outputs="v [m/s]"
    )
    plot = phc.bode_plot(model, data=data)
    assert plot.axes[0, 0].get_ylabel() == "Magnitude [dB re 1 m/s/N]"
    assert phc.bode_plot(model).axes[0, 0].get_ylabel() == "Magnitude [dB]"
    circle = phc.circle_plot(phc.pem(data, 1))
    assert circle.axes[0, 0].get_xlabel() == "Real part [m/s/N]"
    plt.close("all")


@pytest.mark.parametrize(("unit", "seconds"), [("min", 60.0), *slowly(("ms", 1e-3), ("s", 1.0), ("h", 3600.0))])
def test_hertz_are_those_of_the_unit_of_time(unit, seconds):
    result = phc.pem(recording(f"Time ({unit})"), 2)
    np.testing.assert_allclose(result.hertz, D / (2 * np.pi * seconds), rtol=0.02)
    np.testing.assert_allclose(result.natural_frequencies, D, rtol=0.02)
