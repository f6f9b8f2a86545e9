"""Which structure `pem` answers with: what is asked for, or the simplest that the data do not reject."""

from __future__ import annotations

import json

import control as ct
import numpy as np
import pytest
from modal_plants import Plant, data_of
from shell import run, without_pictures

import ph_control as phc

PLANT = Plant.of(2, 3, 2, seed=1)


def recording(noise=0.05, samples=600, seed=1):
    return data_of(PLANT, "time", samples, seed, noise)


# --- one input and one output ----------------------------------------------------------------------------------------


def test_lossless_data_get_the_numbers_of_the_lossless_structure():
    plant, rng = phc.ph(phc.modes([0.5, 1.9], [1.0, 0.4])), np.random.default_rng(1)
    u = rng.standard_normal(500)
    y = phc.forced_response(plant, 0.1 * np.arange(500), u, intersample="zoh").outputs + 0.1 * rng.standard_normal(500)
    auto, named = phc.pem((u, y), dt=0.1), phc.pem((u, y), dt=0.1, structure="lossless")
    assert type(auto) is type(named) is phc.PEMResult and auto.structure == "lossless"
    # the minimum is found to a part of the standard errors
    for key in ("d", "r"):
        assert np.all(np.abs(getattr(auto, key) - getattr(named, key)) < 1e-3 * named.stderr[key])
        assert np.allclose(auto.stderr[key], named.stderr[key], rtol=1e-3)
    assert auto.loss == pytest.approx(named.loss, rel=1e-8)


@pytest.mark.slow
def test_damped_data_get_a_damped_answer_and_the_lossless_one_where_it_is_asked_for():
    u, y = recording()
    u, y = u[0], PLANT.velocities(np.stack([u[0], 0 * u[0]]))[0] + 0.05 * np.random.default_rng(0).standard_normal(600)
    found = phc.pem((u, y), dt=1.0)
    assert found.structure == "classical" and found.tests[0].p < 1e-10 and found.tests[1].p > 0.05
    assert any(one.cause.name == "LOSSES" for one in found.findings)
    asked = phc.pem((u, y), dt=1.0, structure="lossless")
    assert asked.structure == "lossless" and asked.outcome.name == "NOT_DESCRIBED"
    assert found.loglik > asked.loglik


def test_a_sensor_elsewhere_leaves_free_residues_without_a_scale():
    u, _ = recording()
    y = PLANT.velocities(np.stack([u[0], 0 * u[0]]))[2] + 0.02 * np.random.default_rng(0).standard_normal(600)
    found = phc.pem((u[0], y), dt=1.0)
    assert found.structure == "free" and not found.shapes_scaled and type(found.system) is ct.StateSpace
    assert {one.hypothesis for one in found.tests if one.p < 0.05} >= {"lossless", "classical"}


@pytest.mark.slow
def test_one_output_may_be_any_sensor_by_a_word_a_list_or_its_label():
    u, _ = recording()
    y = PLANT.velocities(np.stack([u[0], 0 * u[0]]))[2] + 0.02 * np.random.default_rng(0).standard_normal(600)
    for quantity in ("free", ["free"], {"y": "free"}):
        found = phc.pem((u[0], y), 2, dt=1.0, quantity=quantity)
        assert found.structure == "free" and found.quantities == ("free",) and found.ports == ()
    assert phc.pem((u[0], y), 2, dt=1.0, quantity=["velocity"], structure="lossless").quantity == "velocity"
    with pytest.raises(phc.StructureError, match="2 entries for 1 output"):
        phc.pem((u[0], y), dt=1.0, quantity=["free", "free"])
    with pytest.raises(phc.StructureError, match="'passive' needs driving points"):
        phc.pem((u[0], y), dt=1.0, quantity="free", structure="passive")


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("kind", ["recording", "response"])
def test_a_first_order_lag_beside_modes_is_a_real_pole(kind):
    rng, u = np.random.default_rng(1), np.random.default_rng(0).standard_normal(800)
    modes, lag = PLANT.velocities(np.stack([u, 0 * u]))[0], ct.tf([0.3], [1, 0.3])
    lagging = ct.forced_response(ct.c2d(lag, 1.0, "zoh"), np.arange(800.0), u).outputs
    if kind == "recording":
        data = u, modes + 2 * lagging + 0.05 * rng.standard_normal(800)
        options = {"dt": 1.0, "intersample": "zoh"}
    else:
        omega = np.linspace(0.02, 3.0, 400)
        errors = rng.standard_normal((2, 400))
        clean = PLANT.response(1j * omega)[0, 0] + 2 * lag(1j * omega)
        data, options = ct.frd(clean + 0.02 * (errors[0] + 1j * errors[1]), omega), {"weights": np.ones(400)}
    result = phc.pem(data, structure="free", **options)
    assert result.order == 2 and result.states == 5 and len(result.poles) == 3
    (rate,), (error,) = result.real_poles, result.stderr["real_poles"]
    assert abs(rate + 0.3) < 4 * error < 0.1
    assert abs(result.residues[2, 0, 0].real - 0.6) < 4 * result.stderr["residues"][2, 0, 0].real
    assert result.whiteness > 0.01 and np.abs(result.poles[:2] - PLANT.poles).max() < 5e-4
    assert np.allclose(phc.pem(data, structure="free", order=2, real_poles=1, **options).poles, result.poles)
    assert np.allclose(phc.pem(data, structure="free", order=2, **options).poles, result.poles)
    without = phc.pem(data, structure="free", order=2, real_poles=0, **options)
    assert not len(without.real_poles) and without.bic > result.bic + 100


def test_an_interpolated_input_is_told_by_the_structure():
    """With free residues and a feedthrough a hold and an interpolation are the same models."""
    rng, t = np.random.default_rng(2), 0.1 * np.arange(1000)
    u = rng.standard_normal(1000)
    y = ct.forced_response(ct.tf([1, 0], [1, 0.2, 1]), t, u).outputs + 0.01 * rng.standard_normal(1000)
    found = phc.pem((u, y), dt=0.1)
    assert (found.structure, found.intersample) == ("classical", "foh")
    assert phc.pem((u, y), dt=0.1, structure="classical").intersample == "foh"


# --- several channels ------------------------------------------------------------------------------------------------


@pytest.mark.variants
@pytest.mark.parametrize("kind", ["time", "response"])
def test_the_simplest_structure_that_stands_is_the_answer(kind):
    options = {"dt": 1.0} if kind == "time" else {}
    found = phc.pem(data_of(PLANT, kind, 300, 3, 0.05), ports=[(0, 0), (1, 1)], **options)
    assert found.structure == "classical" and found.order == 2
    by_name = {one.hypothesis: one for one in found.tests}
    assert by_name["lossless"].p < 1e-10 and min(by_name[name].p for name in ("classical", "rank one")) > 0.05
    assert isinstance(found.system, phc.PortHamiltonian)
    free = phc.pem(data_of(PLANT, kind, 300, 3, 0.05), 2, structure="free", **options)
    assert np.all(found.stderr["damping_ratios"] <= free.stderr["damping_ratios"] * 1.001)


@pytest.mark.slow
def test_labels_numbers_and_kinds_of_data_say_the_same():
    u, y = recording()
    t = np.arange(600.0)
    named = ct.TimeResponseData(t, y, inputs=u, input_labels=["f", "g"], output_labels=["a", "b", "c"])
    first = phc.pem(named, 2, ports=[("a", "f"), ("b", "g")], structure="classical")
    second = phc.pem((u, y), 2, dt=1.0, ports=[(0, 0), (1, 1)], structure="classical")
    assert np.array_equal(first.poles, second.poles) and first.output_labels == ("a", "b", "c")
    assert second.output_labels == ("y1", "y2", "y3") and first.ports == second.ports


@pytest.mark.slow
def test_a_roving_hammer_and_roving_sensors_are_one_experiment_each():
    rng, t, parts = np.random.default_rng(4), np.arange(500.0), []
    for driven, seen in ((0, [0, 1]), (1, [0, 1]), (0, [0, 2])):
        u = np.zeros((2, 500))
        u[driven] = rng.standard_normal(500)
        y = PLANT.velocities(u)[seen]
        y = y + 0.05 * np.std(y, axis=1, keepdims=True) * rng.standard_normal(y.shape)
        names = {"input_labels": [f"u{driven}"], "output_labels": [f"y{k}" for k in seen]}
        parts.append(ct.TimeResponseData(t, y, inputs=u[[driven]], **names))
    found = phc.pem(parts, 2, ports=[("y0", "u0"), ("y1", "u1")])
    assert found.structure == "classical" and found.residues.shape == (2, 3, 2)
    # what no experiment shows follows from the structure, with its error
    assert np.all(np.abs(found.residues - PLANT.residues) < 5 * np.abs(found.stderr["residues"]))
    assert np.all(np.abs(found.shapes - PLANT.shapes) < 5 * np.abs(found.stderr["shapes"]))


@pytest.mark.slow
def test_shapes_of_a_roving_hammer_compare_over_the_places_of_the_hits():
    rng, t, parts = np.random.default_rng(5), np.arange(500.0), []
    for k in (0, 1, 0, 1):
        u = np.zeros((2, 500))
        u[k] = rng.standard_normal(500)
        y = PLANT.velocities(u)[0]
        y = y + 0.02 * np.std(y) * rng.standard_normal(500)
        parts.append(ct.TimeResponseData(t, y, inputs=u[k], issiso=True, input_labels=[f"u{k}"], output_labels=["y"]))
    found = phc.pem(parts, 2, ports=[("y", "u0")], structure="free")
    assert found.shapes.shape == (2, 1)
    np.testing.assert_allclose(found.mac(PLANT.shapes[:, :2]).diagonal(), 1, atol=1e-3)
    np.testing.assert_allclose(found.mac(found), phc.mac_plot(found).lines[0, 0][0].get_array())
    assert np.all(found.phase_collinearity > 0.99) and np.all(found.phase_collinearity < 1)


@pytest.mark.slow
def test_gaps_and_an_offset_are_no_modes():
    u, y = recording()
    y = y + np.array([[3.0], [0.0], [-20.0]])
    y[1, 100:140] = np.nan
    found = phc.pem((u, y), dt=1.0, structure="free")
    assert found.order == 2 and np.allclose(found.offsets[0], [3, 0, -20], atol=0.2)
    assert np.isnan(found.residuals[1, 100:140]).all() and not np.isnan(found.predicted).any()


def test_the_search_starts_from_a_guess_and_tells_of_its_progress():
    seen = []
    first = phc.pem(recording(), dt=1.0, structure="free", callback=seen.append)
    again = phc.pem(recording(), dt=1.0, structure="free", initial_guess=first)
    assert len(seen) > 2 and seen[-1].order >= 1 and 0 < seen[-1].loss < np.inf
    assert np.allclose(again.poles, first.poles, rtol=1e-6)
    with pytest.raises(phc.StructureError, match="initial_guess is a str"):
        phc.pem(recording(), dt=1.0, initial_guess="this")


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize(
    "order, structure, error",
    [(2, "free", StopIteration), ("auto", "auto", KeyboardInterrupt), (2, "classical", StopIteration)],
)
def test_an_interrupted_fit_gives_the_best_so_far_and_says_so(order, structure, error):
    calls, losses, data = 0, [], recording(samples=200)

    def callback(progress):
        nonlocal calls
        calls += 1
        assert 1 <= progress.order <= progress.max_order and progress.iteration >= 1 and progress.loss > 0
        if calls > allowed:
            raise error

    allowed = np.inf
    options = {"dt": 1.0, "structure": structure, "callback": callback}
    whole = phc.pem(data, order, **options)
    total = calls
    for allowed in [0, total // 2, total - 1]:
        calls = 0
        result = phc.pem(data, order, **options)
        assert calls == allowed + 1, "no call after the one that ended the fit"
        assert result.outcome.name == "INTERRUPTED" and not result.success and "interrupted" in result.summary()
        assert 1 <= result.order <= 3 and np.isfinite(result.stderr["damping_ratios"]).all()
        assert result.structure == ("free" if structure == "auto" and allowed < total - 1 else result.structure)
        losses.append(result.loglik)
    assert whole.success and losses[0] < whole.loglik - 10 and losses[-1] > whole.loglik - 10


def test_an_interrupted_fit_of_one_output_gives_damped_modes_as_soon_as_there_are_some():
    (u, y), orders = recording(), []
    u, y = u[0], PLANT.velocities(np.stack([u[0], 0 * u[0]]))[2] + 0.02 * np.random.default_rng(0).standard_normal(600)

    def stop(progress):
        orders.extend([progress.order] * (progress.stage == "search"))  # signs of life are a matter of time
        if len(orders) > allowed:
            raise StopIteration

    allowed = np.inf
    whole = phc.pem((u, y), dt=1.0, callback=stop)
    total, orders, allowed = len(orders), [], len(orders) - 1
    late = phc.pem((u, y), dt=1.0, callback=stop)
    assert len(orders) == total and late.outcome.name == "INTERRUPTED"
    assert np.allclose(late.poles, whole.poles, rtol=1e-3)


def test_noise_alone_is_nothing_to_model():
    rng = np.random.default_rng(0)
    found = phc.pem((rng.standard_normal((2, 300)), rng.standard_normal((2, 300))), dt=1.0)
    assert found.order == 0 and found.outcome.name == "NOTHING" and found.residues.shape == (0, 2, 2)
    assert "Nothing to model" in found.summary() and "Nothing to model" in found._repr_html_()
    response = ct.frd(rng.standard_normal((2, 2, 80)) + 1j * rng.standard_normal((2, 2, 80)), np.linspace(1, 2, 80))
    for quantity in ("displacement", "velocity", "acceleration"):
        found = phc.pem(response, quantity=quantity, ports=[(0, 0), (1, 1)])
        assert found.order == 0 and found.summary() and found.confidence_interval()["damping_ratios"].shape == (0, 2)


# --- the command line ------------------------------------------------------------------------------------------------


def test_the_command_line_fits_channels_and_names_ports(tmp_path, monkeypatch):
    without_pictures(monkeypatch)
    u, y = recording(samples=300)
    table = np.column_stack([np.arange(300.0), u.T, y.T])
    np.savetxt(tmp_path / "r.csv", table, delimiter=",", header="t,f,g,a,b,c", comments="")
    words = ["fit", tmp_path / "r.csv", "--order", 2, "--inputs", "f,g", "--outputs", "a,b,c", "--ports", "a:f,b:g"]
    words[2:2] = ["--intersample", "zoh"]
    done = run(*words, "--model", tmp_path / "m.json", "--result", tmp_path / "x.json", "--bode", tmp_path / "b.png")
    assert done.status == 0 and "classical" in done.out and "damping [%]" in done.out
    found = phc.load(tmp_path / "x.json")
    assert isinstance(phc.load(tmp_path / "m.json"), phc.PortHamiltonian) and found.ports == ((0, 0), (1, 1))
    answer = json.loads(run(*words, "--json", "--structure", "free").out)
    assert answer["structure"] == "free" and answer["ports"] == ["a:f", "b:g"] and answer["outputs"] == ["a", "b", "c"]
    assert np.allclose(answer["damping_ratios"], found.damping_ratios, rtol=0.1)
    assert np.shape(answer["stderr"]["residues"]) == (2, 3, 2, 2)
    refused = run(*words[:-1], "a-f")
    assert refused.status == 2 and "not a list of ports" in refused.error


@pytest.mark.variants
@pytest.mark.parametrize("intersample, seed", [("zoh", 0), ("foh", 0), ("zoh", 2), ("foh", 1)])
def test_the_hold_is_that_of_the_more_nearly_real_shapes(intersample, seed):
    """With one local damper, and a sensor away from the force, no structure stands, and both holds fit alike."""
    n, rng = 4, np.random.default_rng(seed)
    K = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    C = 0.01 * K + 0.06 * np.diag(np.arange(n) == seed)
    velocity = {"velocity": np.eye(n)[[2]]}
    plant = phc.from_second_order(np.eye(n), K, np.eye(n)[0], C=C, sensors=velocity)
    u = rng.standard_normal(3000)
    y = phc.forced_response(plant, 0.5 * np.arange(3000), u, intersample=intersample).outputs[1]
    result = phc.pem((u, y + 0.05 * y.std() * rng.standard_normal(3000)), dt=0.5)
    assert result.structure == "free" and result.intersample == intersample
