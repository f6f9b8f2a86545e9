"""The benchmarks run, and their numbers mean what they say.

The reference for outputs and their derivatives is a loop over the samples with 2 x 2 real steps; complex parameters
give its derivatives (a step of 1e-30 along the imaginary axis) without cancellation.
"""

import dataclasses
import functools
import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scripts import ROOT, run

import ph_control as phc

sys.path.insert(0, str(ROOT))  # the benchmarks are not installed with the package

from benchmarks import (
    cold,
    digits,
    golden,
    golden_records,
    measured,
    methods,
    modal_peers,
    montecarlo,
    mutations,
    noise,
    page,
    passive_peers,
    peers,
    report,
    tasks,
    trials,
)
from benchmarks.bound import fit_from_truth, output_and_jacobian, standard_errors
from benchmarks.recordings import BAND, POWER_RATIO, Configuration, simulate, spaced_frequencies

EPS = float(np.finfo(float).eps)
SETTINGS = settings(deadline=None, max_examples=20, derandomize=True)
SMALL = Configuration(3, 400, 20, 3)


# --- an independent model --------------------------------------------------------------------------------------------


def dense_output(theta, u, h, method):
    """Output by a loop over the samples, for real or complex parameters `(d, r, q, p)`."""
    d, r, q, p = np.split(np.asarray(theta), 4)
    c, s = (1.0, h * d) if method == "euler" else (np.cos(h * d), np.sin(h * d))
    push = (h, 0.0) if method == "euler" else (s / d, (c - 1) / d)
    y = []
    for sample in u:
        y.append(np.sum(np.sqrt(r) * d * q))
        force = np.sqrt(r) * sample
        q, p = c * q + s * p + push[0] * force, c * p - s * q + push[1] * force
    return np.array(y)


def case_of(n, seed, samples=50):
    rng = np.random.default_rng(seed)
    theta = np.concatenate([np.sort(rng.uniform(0.2, 2.5, n)), rng.uniform(0.1, 2.0, n), rng.standard_normal(2 * n)])
    return theta, rng.standard_normal(samples)


@SETTINGS
@given(st.integers(1, 4), st.integers(0, 10**6), st.sampled_from([(1.0, "exact"), (0.1, "exact"), (0.1, "euler")]))
def test_output_and_derivatives_of_the_bound_are_those_of_the_model_and_of_the_package(n, seed, kind):
    (theta, u), (h, method) = case_of(n, seed), kind
    y, J = output_and_jacobian(theta, u, h, method)
    reference = dense_output(theta, u, h, method)
    derivatives = np.array([dense_output(theta + 1e-30j * e, u, h, method).imag / 1e-30 for e in np.eye(4 * n)]).T
    # recursions add an error of eps in each of 50 steps
    size, slopes = np.max(np.abs(reference)), np.max(np.abs(derivatives), axis=0)
    assert np.max(np.abs(y - reference)) <= 50 * 20 * EPS * size
    assert (np.max(np.abs(J - derivatives), axis=0) <= 50 * 20 * EPS * (slopes + size)).all()
    d, r, state = theta[:n], theta[n : 2 * n], theta[2 * n :]
    assert np.max(np.abs(simulate(d, r, state, u, h, method) - reference)) <= 50 * 20 * EPS * size


def test_standard_errors_are_the_inverse_of_the_information():
    recording = trials.recording_of(SMALL, 1)
    _, J = output_and_jacobian(recording.theta, recording.u)
    covariance = recording.deviation**2 * np.linalg.pinv(J) @ np.linalg.pinv(J).T
    assert np.allclose(standard_errors(recording), np.sqrt(np.diag(covariance)), rtol=1e-9, atol=0)


def test_the_fit_from_the_truth_is_a_minimum_of_the_loss():
    recording = trials.recording_of(SMALL, 0)
    found = fit_from_truth(recording)
    y, J = output_and_jacobian(found.theta, recording.u)
    error = y - recording.y
    assert np.isclose(found.loss, np.mean(error**2), rtol=1e-12)
    assert found.loss < np.mean((recording.clean - recording.y) ** 2)
    # what a full step of Newton could still gain, against what the fit gained over the truth
    gain = np.linalg.norm(np.linalg.qr(J)[0].T @ error)
    assert gain <= 1e-5 * np.linalg.norm(error)


# --- recordings ------------------------------------------------------------------------------------------------------


@SETTINGS
@given(st.integers(2, 20), st.integers(0, 10**6), st.floats(0.001, 0.1))
def test_the_closest_frequencies_are_exactly_as_far_apart_as_asked_for(n, seed, gap):
    d = spaced_frequencies(n, gap, (0.3, 2.8), np.random.default_rng(seed))
    assert len(d) == n and d[0] >= 0.3 and d[-1] <= 2.8 * (1 + n * EPS)
    assert np.isclose(np.diff(d).min(), gap, rtol=1e4 * EPS / gap, atol=0)


def test_frequencies_that_do_not_fit_the_band_are_refused():
    with pytest.raises(ValueError, match="4 modes at distances of 1 do not fit between 0 and 2"):
        spaced_frequencies(4, 1.0, (0.0, 2.0), np.random.default_rng(0))


@pytest.mark.parametrize("config", [SMALL, Configuration(5, 1000, 10, 1.5)])
def test_a_recording_is_what_its_configuration_says(config):
    for seed in range(3):
        recording = trials.recording_of(config, seed)
        assert len(recording.d) == config.n and len(recording.u) == len(recording.y) == config.samples
        assert np.isclose(np.diff(recording.d).min(), config.bins * 2 * np.pi / config.samples, rtol=1e-9)
        assert BAND[0] * np.pi <= recording.d[0] and recording.d[-1] <= BAND[1] * np.pi
        signal, noise = np.mean(recording.clean**2), np.mean((recording.y - recording.clean) ** 2)
        assert np.isclose(signal / recording.deviation**2, 10 ** (config.snr / 10))
        assert np.isclose(noise, recording.deviation**2, rtol=5 * np.sqrt(2 / config.samples))
        state = recording.state.reshape(2, -1)
        parts = [
            simulate(recording.d[l : l + 1], recording.r[l : l + 1], state[:, l], recording.u) for l in range(config.n)
        ]
        powers = np.mean(np.square(parts), axis=1)
        assert np.allclose(np.sum(parts, axis=0), recording.clean, atol=1e-9)
        assert powers.min() >= (1 - 1e-9) / POWER_RATIO and powers.max() <= 1 + 1e-9
        free = [np.sqrt(r) * d * np.hypot(*z) for d, r, z in zip(recording.d, recording.r, state.T, strict=True)]
        assert min(free) > 0.0
        again, other = trials.recording_of(config, seed), trials.recording_of(config, seed + 1)
        assert np.array_equal(again.y, recording.y) and not np.array_equal(other.y, recording.y)


# --- Monte-Carlo studies ---------------------------------------------------------------------------------------------


def test_the_studies_are_those_that_were_promised():
    asked = [(2, 1000, 20, 3), (5, 1000, 20, 3), (5, 2000, 10, 3), (10, 4000, 20, 3), (5, 1000, 20, 1.5)]
    asked += [(20, 10_000, 20, 3), (50, 100_000, 20, 3)]
    assert [dataclasses.astuple(config) for config in trials.CONVERGENCE] == asked
    assert trials.EFFICIENCY == trials.CONVERGENCE[:3]
    assert [(config.n, config.samples) for config in (*trials.ORDER, trials.NOISE)] == [
        (2, 1000), (5, 1000), (10, 4000), (0, 1000),
    ]  # fmt: skip


def test_a_fit_counts_as_found_by_its_distance_from_the_truth_in_units_of_the_bound():
    config = trials.CONVERGENCE[0]
    trial = trials.convergence((config, 0))
    recording = trials.recording_of(config, 0)
    result = phc.pem((recording.u, recording.y), order=2, dt=1.0, structure="lossless")
    distance = np.abs(result.d - recording.d) / standard_errors(recording)[:2]
    assert trial["outcome"] == trials.FOUND and np.isclose(trial["worst"], distance.max()) and trial["worst"] < 4
    assert trial["loss"] < trial["loss_of_truth"] and trial["seconds"] > 0


@pytest.mark.parametrize("side", [-1, 1])
def test_the_limit_is_four_standard_errors_in_every_frequency(side):
    recording = trials.recording_of(SMALL, 0)
    for factor, outcome in ((3.99, trials.FOUND), (4.01, trials.FALSE_MINIMUM)):
        off = np.zeros(3)
        off[1] = side * factor * standard_errors(recording)[1]
        guess = SimpleNamespace(d=recording.d + off, loss=1.0, verdict="")
        trial = trials.judged(recording, guess)
        assert trial["outcome"] == outcome and np.isclose(trial["worst"], factor, rtol=1e-6)


def test_a_false_minimum_is_told_from_bad_luck_by_the_fit_from_the_truth():
    recording = trials.recording_of(SMALL, 0)
    best = fit_from_truth(recording).loss
    far = recording.d + 5 * 2 * np.pi / SMALL.samples
    for loss, outcome in ((1.001 * best, trials.FALSE_MINIMUM), (best, trials.BAD_LUCK), (0.9 * best, trials.BAD_LUCK)):
        trial = trials.judged(recording, SimpleNamespace(d=far, loss=loss, verdict="fine"))
        assert trial["outcome"] == outcome and trial["loss_near_truth"] == best
    lost = trials.judged(recording, SimpleNamespace(d=recording.d * np.nan, loss=2 * best, verdict=""))
    assert lost["outcome"] == trials.FALSE_MINIMUM


def test_an_error_of_the_fit_is_a_failure_with_its_message(monkeypatch):
    recording = trials.recording_of(SMALL, 0)
    silent = dataclasses.replace(recording, y=0 * recording.y)
    monkeypatch.setattr(trials, "recording_of", lambda config, seed: silent)
    trial = trials.convergence((SMALL, 7))
    assert trial["outcome"] == trials.ERROR and "is zero throughout" in trial["error"]
    (line, told) = montecarlo._report_convergence(SMALL, [trial])
    assert "  0/1, at the optimum   0/1" in line and "seed 7: IdentificationError" in told


def test_efficiency_redraws_the_noise_only_and_its_errors_are_in_units_of_the_bound():
    config = trials.EFFICIENCY[0]
    done = [trials.efficiency((config, seed)) for seed in range(6)]
    scaled = np.array([trial["scaled_error"] for trial in done])
    recording = trials.recording_of(config, 0)
    noisy = recording.again(np.random.default_rng([config.n, config.samples, 3, 1]))
    result = phc.pem((recording.u, noisy.y), order=2, dt=1.0, structure="lossless")
    off = np.concatenate([result.d, result.r, result.initial_state]) - recording.theta
    assert np.allclose(scaled[3], off / standard_errors(recording), rtol=1e-6)
    limits = 1.96 * np.concatenate([result.stderr[name] for name in ("d", "r", "initial_state")])
    assert done[3]["covered"] == (np.abs(off) <= limits).tolist()
    # the means of 6 squared standard normal scores are 1 +- sqrt(2/6); 5 deviations above
    assert (np.mean(scaled**2, axis=0) < 1 + 5 * np.sqrt(2 / 6)).all()
    assert 0.3 < np.mean(scaled**2) and len({row.tobytes() for row in scaled}) == 6


def test_the_efficiency_report_gives_mean_square_and_coverage_of_each_group():
    scaled = [[1.0, -1.0, 2.0, 2.0, 3.0, 3.0, 3.0, 3.0], [1.0, 1.0, 0.0, 0.0, 3.0, -3.0, 3.0, 3.0]]
    covered = [[True] * 2 + [False] * 6, [True] * 4 + [False] * 4]
    done = [{"scaled_error": s, "covered": c, "seconds": 1.0} for s, c in zip(scaled, covered, strict=True)]
    _, d, r, state = montecarlo._report_efficiency(trials.EFFICIENCY[0], done)
    assert "bound 1.000 +- 0.000 (parameters 1.00 .. 1.00); 95 % intervals hold 100.0 +- 0.0 %" in d
    assert "bound 2.000 +- 2.000 (parameters 2.00 .. 2.00); 95 % intervals hold 50.0 +- 50.0 %" in r
    assert "bound 9.000 +- 0.000 (parameters 9.00 .. 9.00); 95 % intervals hold 0.0 +- 0.0 %" in state


def test_the_order_study_counts_right_orders_and_knows_pure_noise():
    right, nothing = trials.order((trials.ORDER[0], 0)), trials.order((trials.NOISE, 1))
    assert right["order"] == 2 and nothing["order"] == 0
    assert nothing["message"] == "nothing to model"
    wrong = right | {"order": 3, "seed": 5}
    line, told, *_ = montecarlo._report_order(trials.ORDER[0], [right, wrong])
    assert "right order   1/2 (orders found 2: 1, 3: 1)" in line and told.split() == [
        "wrong",
        "at",
        "seeds",
        "5",
        "(3)",
    ]
    assert "pure noise, T=1000" in montecarlo._report_order(trials.NOISE, [nothing])[0]


@pytest.mark.slow
def test_the_studies_run_from_the_command_line_and_workers_do_not_change_them(tmp_path):
    done = run(
        tmp_path, "-m", "benchmarks.montecarlo", "convergence", "--config", "1", "--first-seed", "3", "--seeds", "2",
        "--workers", "2", "--json", "study.json",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "2 workers; OPENBLAS_NUM_THREADS=1" in done.stdout
    assert "n=2, T=1000, 20 dB, 3 bins" in done.stdout and "  2/2, at the optimum   2/2" in done.stdout
    (entry,) = json.loads((tmp_path / "study.json").read_text())["configurations"]
    assert entry["configuration"] == {"n": 2, "samples": 1000, "snr": 20, "bins": 3}
    for seed, found in zip((3, 4), entry["trials"], strict=True):
        here = trials.convergence((trials.CONVERGENCE[0], seed))
        assert found | {"seconds": 0.0} == here | {"seconds": 0.0}


def test_a_study_writes_what_it_prints(capsys, tmp_path):
    file = tmp_path / "study.json"
    montecarlo.main(["order", "--config", "1", "4", "--seeds", "1", "--json", str(file)])
    out = capsys.readouterr().out
    assert "n=2, T=1000, 20 dB, 3 bins" in out and "pure noise, T=1000" in out and "1 worker;" in out
    document = json.loads(file.read_text())
    assert document["study"] == "order"
    assert [entry["trials"][0]["order"] for entry in document["configurations"]] == [2, document_order(out)]


def document_order(out):
    """Order found in pure noise, as printed."""
    (line,) = (line for line in out.splitlines() if line.startswith("pure noise"))
    return int(line.partition("orders found ")[2].partition(":")[0])


def test_a_configuration_that_does_not_exist_is_refused(capsys):
    with pytest.raises(SystemExit):
        montecarlo.main(["efficiency", "--config", "4"])
    assert "efficiency has the configurations 1 to 3" in capsys.readouterr().err


# --- side by side ----------------------------------------------------------------------------------------------------


CASES = [peers.Case(rule, 3, 300, 20.0) for rule in ("exact", "euler")]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_the_true_plant_as_a_discrete_state_space_scores_no_error(case):
    recording, new, answer = peers.recording_of(case, 0)
    true = phc.sample(recording.plant, recording.h, method=case.rule)
    method = methods.Method("truth", lambda rec, setting, seed: methods._discrete(rec, true.A, true.B, true.C, true.D))
    trial = peers.attempt(method, None, case, 0)
    assert trial["close"] and trial["efficient"] and trial["failure"] == ""
    assert trial["error"] <= 1e4 * EPS * len(new) and trial["frequency_error"] <= 1e4 * EPS
    assert not recording.state.any() and len(answer) == len(new) == 2000


def test_closeness_and_efficiency_are_counted_apart():
    case = CASES[0]
    recording, _, answer = peers.recording_of(case, 0)
    errors = standard_errors(recording)[:3]
    assert (4.5 * errors < 0.01 * recording.d).all()
    for factor, close, efficient in (
        (3.9, True, True),
        (4.1, True, False),
        (1.01 * (0.01 * recording.d / errors), False, False),
    ):
        model = methods.Model(recording.d + factor * errors, lambda u: 1.5 * answer)
        trial = peers.attempt(methods.Method("near", lambda rec, s, seed, model=model: model), None, case, 0)
        assert (trial["close"], trial["efficient"]) == (close, efficient)
        assert np.isclose(trial["error"], 0.5)


def test_modes_that_a_method_does_not_find_fail_it():
    recording, _, _ = peers.recording_of(CASES[0], 0)
    model = methods._discrete(recording, np.diag([0.5, -0.5]), np.ones(2), np.ones(2), 0.0)
    assert np.isnan(model.d).all() and model.d.shape == (3,)


def test_the_best_setting_by_the_truth_counts_and_a_failing_one_is_reported():
    def identify(recording, setting, seed):
        if setting == "fails":
            raise np.linalg.LinAlgError("no")
        return methods.Model(recording.d, lambda u: setting * simulate(recording.d, recording.r, recording.state, u))

    method = methods.Method("some", identify, ("fails", 3.0, 1.25))
    (trial,) = peers.trials_of(method, CASES[0], 1)
    assert trial["setting"] == 1.25 and np.isclose(trial["error"], 0.25)
    rows = {"some": [trial], "broken": peers.trials_of(dataclasses.replace(method, settings=("fails",)), CASES[0], 1)}
    assert "failed: LinAlgError: no" in peers.table(CASES[0], rows)[-1]


def test_a_package_that_is_not_installed_is_said_to_be_so():
    missing = methods.Method("stranger", None, package="no_such_package_anywhere")
    assert not missing.installed
    rows = {"stranger": peers.trials_of(missing, CASES[0], 1)}
    assert peers.table(CASES[0], rows)[-1].split() == ["stranger", "not", "installed"]
    assert methods.METHODS[0].installed and methods.METHODS[0].name == "ph_control pem"


def test_the_table_gives_medians_and_ratios_to_our_row(capsys, tmp_path):
    file = tmp_path / "peers.json"
    peers.main(
        ["--seeds", "2", "--rule", "exact", "--modes", "3", "--samples", "500", "--method", "ERA", "--json", str(file)]
    )
    out = capsys.readouterr().out.splitlines()
    (ours,) = (line.split() for line in out if line.startswith("  ph_control pem"))
    (theirs,) = (line.split() for line in out if line.startswith("  python-control markov"))
    (entry,) = json.loads(file.read_text())
    assert entry["case"] == "exact recording, 3 modes, 500 samples, 20 dB"
    medians = {
        name: [np.median([trial[key] for trial in rows]) for key in ("frequency_error", "error", "seconds")]
        for name, rows in entry["trials"].items() if rows
    }  # fmt: skip
    assert ours[2:4] == ["2/2", "2/2"]
    for row, name in ((ours, "ph_control pem"), (theirs, "python-control markov + ERA")):
        assert np.allclose([float(cell) for cell in row[-6::2]], medians[name], rtol=6e-3)
    ratios = np.divide(medians["python-control markov + ERA"], medians["ph_control pem"])
    assert np.allclose([float(cell) for cell in theirs[-5::2]], ratios, rtol=6e-3)
    assert ratios[0] > 10 and ratios[1] > 5


@pytest.mark.slow
@pytest.mark.parametrize(
    "parameters, optimizer, rate", [*zip(methods.COORDINATES, ("plain", "adam"), (1e-3, 0.05), strict=False)]
)
def test_the_descent_to_be_compiled_takes_the_steps_of_the_library(parameters, optimizer, rate):
    recording, _, _ = peers.recording_of(peers.Case("euler", 3, 100, 20.0), 0)
    assert methods.disagreement(recording, parameters, optimizer, rate, 25) <= 1e5 * EPS


@pytest.mark.slow
def test_another_rate_of_the_descent_is_another_descent(monkeypatch):
    recording, _, _ = peers.recording_of(peers.Case("euler", 3, 100, 20.0), 0)
    library = phc.gradient_descent
    monkeypatch.setattr(
        phc, "gradient_descent", lambda *data, **options: library(*data, **options | {"learning_rate": 0.02})
    )
    assert methods.disagreement(recording, "unique", "adam", 0.0201, 5) > 1e-6


@pytest.mark.slow
def test_the_paper_scheme_keeps_its_best_point_and_predicts_by_eulers_rule(monkeypatch):
    monkeypatch.setattr(methods, "EPOCHS", 30)
    recording, new, _ = peers.recording_of(peers.Case("euler", 3, 200, 20.0), 0)
    models = [build("natural", "adam")(recording, 0.02, 1) for build in (methods._gradient, methods._compiled)]
    assert models[0].steps == models[1].steps == 30
    assert np.allclose(models[0].d, models[1].d, rtol=1e-9)
    assert np.allclose(models[0].response(new[:100]), models[1].response(new[:100]), rtol=1e-9, atol=1e-9)
    response = methods._euler_response(recording.d, recording.r, recording.h)
    truth = simulate(recording.d, recording.r, 0 * recording.state, new, recording.h, "euler")
    assert np.max(np.abs(response(new) - truth)) <= 1e4 * EPS * np.max(np.abs(truth))


# --- time and memory -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_fit_in_a_process_of_its_own_reports_time_peak_memory_and_error():
    found = cold.measure(2, 300)
    assert found["seconds"] > 0 and found["error"] < 1e-2
    # bytes: an interpreter with numpy and scipy takes tens of megabytes, and a record of 300 samples not much more
    assert 2e7 < found["before"] <= found["peak"] < 1e9


# --- the report ------------------------------------------------------------------------------------------------------


def task_of(runs, **options):
    return tasks.Task("some task", "n = 1", runs, **options)


def test_the_report_judges_ratios_errors_time_and_memory():
    task = task_of({}, needed={"slow": 3.0, "fast": 3.0, "absent": 2.0}, limits={"seconds": 2.0, "error": 1e-12})
    found = report.Found(
        {report.OURS: 1.0, "slow": 3.5, "fast": 2.9}, {report.OURS: 1e-11, "slow": 0.1, "fast": np.nan}
    )
    assert report.verdicts(task, found) == ["3x slow: yes", "3x fast: NO", "2 s: yes", "error 1e-12: NO"]
    heavy = report.Found({report.OURS: 2.5}, {report.OURS: np.nan}, {report.OURS: 2e6})
    limits = {"seconds": 2.0, "megabytes": 2.0, "error": 1.0}
    # an error that is not known is none that holds
    assert report.verdicts(task_of({}, limits=limits), heavy) == ["2 s: NO", "2 MB: yes", "error 1e+00: NO"]
    assert report.row(task, found) == (
        "| some task | n = 1 | 1 s |  | 1.0e-11 | slow 3.5 s, 3.5x, 1.0e-01; fast 2.9 s, 2.9x | "
        "3x slow: yes, 3x fast: NO, 2 s: yes, error 1e-12: NO |"
    )


@pytest.mark.slow
def test_the_report_measures_time_memory_and_error_of_each_contender():
    calls = []

    def ours():
        calls.append("ours")
        return np.ones(10**5)

    found = report.measure(task_of({report.OURS: ours, "other": lambda: np.zeros(3)}, error=lambda y: float(y[0])))
    assert found.errors == {report.OURS: 1.0, "other": 0.0} and len(calls) > 3
    assert 8e5 <= found.peaks[report.OURS] < 9e5 and found.peaks["other"] < 1e5
    assert 0 < found.seconds["other"] < found.seconds[report.OURS] < 0.1


def test_what_is_measured_in_a_process_of_its_own_runs_once():
    calls = iter([(7.0, 5e6)])
    found = report.measure(task_of({report.OURS: lambda: next(calls)}, apart=True))
    assert found.seconds == {report.OURS: 7.0} and found.peaks == {report.OURS: 5e6}


def test_the_slope_is_that_of_the_larger_half():
    assert report.slope([(n, 3.0 * n**1.72) for n in (5, 10, 20, 40)]) == 1.7
    assert report.slope([(40, 4.0), (1, 1.0), (10, 1.0), (20, 2.0)]) == 1.0
    assert str(report.slope([(1, 1.0), (10, 0.999)])) == "0.0"


def test_a_run_replaces_only_the_one_on_the_page(tmp_path):
    path = tmp_path / "page.md"
    begin, end = page.marks("the run")
    path.write_text(f"before\n\n{begin}\n\nold\n\n{end}\n\nafter\n")
    page.write(path, "the run", ["new", "", "parts"])
    assert path.read_text() == f"before\n\n{begin}\n\nnew\n\nparts\n\n{end}\n\nafter\n"
    path.write_text(f"{end} {begin}")
    with pytest.raises(SystemExit, match="once each, in this order"):
        page.write(path, "the run", ["new"])
    assert path.read_text() == f"{end} {begin}"


@pytest.mark.slow
def test_the_report_writes_what_it_prints(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(report, "race", functools.partial(report.race, rounds=1))
    path, pictures = tmp_path / "page.md", tmp_path / "pictures"
    path.write_text("".join(page.marks("the run")))
    assert report.main(f"--tasks zeros --largest 50 --pictures {pictures} --write {path}".split()) == 0
    printed, written = capsys.readouterr().out, path.read_text()
    rows = [line for line in printed.splitlines() if line.startswith("| zeros")]
    assert len(rows) == 3 and all(line in written for line in rows)
    (power,) = (line for line in written.splitlines() if line.startswith("| Zeros, modes known | n^"))
    assert "python-control n^" in power and power in printed
    assert "![Zeros, modes known](pictures/performance_zeros.png)" in written
    assert (pictures / "performance_zeros.png").stat().st_size > 1e4


@pytest.mark.parametrize("name", ["the run", "digits"])
def test_the_page_of_the_manual_has_a_place_for_a_run(name):
    text = (ROOT / "docs" / "performance.md").read_text(encoding="utf-8")
    begin, end = page.marks(name)
    assert text.count(begin) == text.count(end) == 1


def test_digits_are_counted_from_the_frequencies_and_weights_of_the_doubles_that_were_given():
    Q, B = np.diag([9.0, 1.0, 1.0, 4.0]), np.array([1.0, 0.0, 0.0, 0.5])
    d, r = digits.exact_modes(Q, B)
    # q1, p1 of frequency 3 with the input along q1, q2, p2 of frequency 2 with the input along p2
    assert [float(x) for x in d] == [2.0, 3.0]
    assert np.allclose([float(x) for x in r], phc.ph(Q, B).r, rtol=1e-15)
    assert (digits.errors(Q, B) <= 10 * EPS).all()
    # a weight that is wrong by one per cent shows
    assert np.isclose(digits._relative(np.array([2.02, 3.0]), d), 0.01)


@pytest.mark.slow
def test_the_digits_are_written_as_they_are_printed(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(digits, "SEEDS", 1)
    path = tmp_path / "page.md"
    path.write_text("".join(page.marks("digits")))
    digits.main(["--sizes", "2", "--write", str(path)])
    rows = capsys.readouterr().out.splitlines()
    assert len(rows) == 2 + 3 + 4 and "\n".join(rows) in path.read_text()
    # weights lose what the gap to the next frequency asks for
    lost = [float(line.split("|")[3]) for line in rows if "apart" in line]
    assert lost[-1] > 1e3 * lost[0]


@pytest.mark.slow
def test_one_step_of_variable_projection_is_measured_in_a_process_of_its_own():
    found = cold.measure(2, 300, "step")
    # a step from the truth goes where the noise takes it
    assert found["seconds"] > 0 and 0 < found["error"] < 1e-2
    assert 2e7 < found["before"] <= found["peak"] < 1e9


def test_an_import_is_timed_after_what_comes_before():
    assert cold.imported("import time", "time.sleep(0)", rounds=1) < 0.1
    assert cold.imported("", "sum(range(10**6))", rounds=1) > 1e-3


def test_the_conversion_of_passive_systems_is_judged_by_its_matrices(capsys, monkeypatch):
    passive_peers.main(["--count", "1", "--states", "6", "--method", "ph_control", "epsilon"])
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("ph_control")]
    assert len(rows) == len(passive_peers.KINDS) and all(" 1/1 " in row for row in rows)

    def lossy(A, B, C, D):
        Q, J, R, *rest = passive_peers.ours(A, B, C, D)
        return Q, J, -R, *rest

    monkeypatch.setitem(passive_peers.METHODS, "ph_control", lossy)
    trial = passive_peers.attempt("ph_control", "chain", 6, 0)
    assert not trial.counts and trial.losses < -0.1 and trial.transfer > 1e-3


# --- damped modes ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", [*modal_peers.CASES["time"][:1], *modal_peers.CASES["frf"]])
def test_derivatives_by_poles_are_those_of_the_model(case):
    data, truth, _ = modal_peers.data_of(case, 0)
    columns, _ = modal_peers.derivatives(data, truth)

    def output(step, l):
        poles = truth.poles.copy()
        poles[l] += step
        moved = dataclasses.replace(truth, poles=poles)
        if case.kind == "record":
            return moved.simulate(data.u, data.h)
        entries = moved.response(data.omega).reshape(len(columns), -1)
        return np.concatenate([entries.real, entries.imag], axis=1)

    size = 1e-6 * np.abs(truth.poles)
    for l in range(case.n):
        for step, row in ((1j * size[l], l), (size[l], case.n + l)):
            expected = (output(step, l) - output(-step, l)) / (2 * size[l])
            found = np.array([column[row] for column in columns])
            assert np.linalg.norm(found - expected) <= 1e-4 * np.linalg.norm(expected)


@pytest.mark.slow
def test_damped_modes_are_found_by_us_and_held_against_the_bound():
    for case in (modal_peers.CASES["time"][0], modal_peers.CASES["frf"][0]):
        lines, document = modal_peers.study(case, 2, ["ERA"])
        ours = document["trials"]["ph_control pem, free"]
        assert all(one["found"] and not one["failure"] for one in ours), lines
        # four standard errors of an rms over few numbers
        assert modal_peers.rms([one["damping"] for one in ours]) < 4 * document["bound"][1]
        assert max(one["ahead"] for one in ours) < 0.1 and "Cramer-Rao" in lines[1]


def test_what_is_no_mode_of_the_truth_is_not_found():
    _, truth, _ = modal_peers.data_of(modal_peers.CASES["time"][1], 3)
    estimate = modal_peers.Estimate(truth.poles)
    assert modal_peers.errors(estimate, truth)[2]
    for poles in (truth.poles[1:], truth.poles * np.r_[1.05, 1, 1, 1, 1], truth.poles.imag * 1j, -truth.poles.conj()):
        assert not modal_peers.errors(modal_peers.Estimate(poles), truth)[2]


def test_a_method_without_its_package_is_listed(monkeypatch):
    monkeypatch.setattr(modal_peers.Method, "missing", property(lambda method: "not installed"))
    lines, _ = modal_peers.study(modal_peers.CASES["time"][0], 1, None)
    assert sum("not installed" in line for line in lines) == 12


def told(file, **changes):
    (case,) = [dataclasses.replace(one, **changes) for one in measured.CASES if one.file == file]
    return list(measured.study(case, ["none"]))


def test_modes_of_measured_receptances_stand_beside_those_of_peers(data_folder):
    lines = told("mckiddat.mat")
    assert "pem: 3 modes, passive" in lines[1]
    frequencies = [float(line.split()[0]) for line in lines[3:6]]
    assert np.allclose(frequencies, [0.1029, 0.1962, 0.3247], rtol=1e-3)
    assert "residual 0.0 %" in lines[-1]


@pytest.mark.slow
def test_the_second_half_of_the_robot_arm_is_predicted_as_the_first_was_fitted(data_folder):
    # the arm has two modes; searches for more of them, for lags and for the noise take long
    known = {"quantity": "acceleration", "max_order": 2, "real_poles": 0, "noise": "white", "delay": 0.0}
    lines = told("robot_arm.dat", known=known, orders=(2,))
    (share,) = [line for line in lines if "fit over that of" in line]
    assert float(share.split("chosen ")[1].split()[0]) >= 95
    rows = [line for line in lines if "states" in line]
    assert len(rows) == 2 and all(float(row.split()[-3]) > 95 for row in rows)


def test_measured_data_that_are_not_there_are_skipped(monkeypatch, tmp_path):
    monkeypatch.setattr(measured, "DATA", tmp_path)
    assert all("skipped" in list(measured.study(case, None))[-1] for case in measured.CASES)


# --- golden -----------------------------------------------------------------------------------------------------------


@pytest.mark.variants
@pytest.mark.parametrize("name", golden_records.KINDS)
def test_records_are_those_of_their_seed(name):
    """The same seed is the same record, and another place another one."""
    if name in ("very_long", "long"):
        pytest.skip("long records are made as short ones are")
    (seed, made), (again, other) = golden_records.record(name, 0), golden_records.record(name, 0)
    assert seed == again and np.array_equal(made.plant.poles, other.plant.poles)
    assert repr(made.keywords) == repr(other.keywords)
    parts = [one.data if isinstance(one.data, list) else [one.data] for one in (made, other)]
    for a, b in zip(*parts, strict=True):
        outputs = [one.frdata if hasattr(one, "frdata") else one[1] for one in (a, b)]
        assert np.array_equal(*outputs, equal_nan=True)
    assert golden_records.record(name, 1)[0] != seed


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_outputs_of_a_golden_plant_are_those_of_its_states(hold):
    rng = np.random.default_rng(4)
    plant = golden_records.scattered(rng, np.array([2.0, 7.0, 7.1]), np.array([0.0, 0.3, 0.01]), 2, 2)
    u, start = rng.standard_normal((2, 50)), golden_records.moving(rng, plant)
    p, h = plant.poles, golden_records.STEP
    x, expected = np.zeros((3, 2), complex), []  # the motion each input has left in each mode
    for k in range(50):
        free = start * np.exp(p * k * h)[:, None]
        expected.append(2 * (np.einsum("lij,lj->i", plant.residues, x) + free.sum(axis=0)).real)
        # the variation of constants by quadrature
        s = 0.5 * h * (np.polynomial.legendre.leggauss(20)[0] + 1)
        weight = 0.5 * h * np.polynomial.legendre.leggauss(20)[1]
        after = u[:, min(k + 1, 49)] if hold == "foh" else u[:, k]
        drive = u[:, [k]] + np.outer(after - u[:, k], s / h)
        x = np.exp(p * h)[:, None] * x + np.einsum("q,lq,jq->lj", weight, np.exp(np.outer(p, h - s)), drive)
    assert np.allclose(plant.output(u, start, hold), np.array(expected).T, rtol=0, atol=1e-12 * np.abs(expected).max())


def golden_file(path, *, order=2, error=1e-3, seconds=1.0, **more):
    fit = {"kind": "plain", "place": 0, "seed": 1, "true_order": 2, "order": order, "seconds": seconds}
    fit |= {"structure": "free", "findings": ["DELAY"], "errors": {"frequencies": [error, -error]}}
    path.write_text(golden.text_of({"version": "1", "fits": [fit | more]}))
    return path


@pytest.mark.parametrize(("new", "status", "said"), [
    ({}, 0, "no worse"), ({"error": 1.019e-3}, 0, "no worse"), ({"error": 1.03e-3}, 1, "errors of frequencies"),
    ({"order": 3}, 1, "order is right in 0"), ({"seconds": 1.1}, 1, "take 1.1 s"), ({"seed": 2}, 1, "no fit in common"),
    ({"findings": ["HOLD"]}, 0, "findings -DELAY +HOLD"), ({"structure": "passive"}, 0, "structure free -> passive"),
    ({"errors": None, "findings": None, "structure": None}, 0, "findings -DELAY"),
])  # fmt: skip
def test_the_gate_refuses_what_is_worse_and_nothing_else(tmp_path, capsys, new, status, said):
    files = golden_file(tmp_path / "old.json"), golden_file(tmp_path / "new.json", **new)
    assert golden.main(["compare", *map(str, files)]) == status
    assert said in capsys.readouterr().out


def test_exact_fits_are_compared_as_such(tmp_path):
    files = golden_file(tmp_path / "old.json", error=1e-14), golden_file(tmp_path / "new.json", error=1e-11)
    assert golden.main(["compare", *map(str, files)]) == 0


def test_a_golden_fit_is_recorded_with_its_errors(tmp_path):
    path = tmp_path / "fits.json"
    assert golden.main(["record", str(path), "--kind", "response", "pure_noise"]) == 0
    fits = json.loads(path.read_text())["fits"]
    assert len(fits) == sum(golden_records.KINDS[name][0] for name in ("response", "pure_noise"))
    for fit in fits:
        assert fit["order"] == fit["true_order"] and (fit["kind"] == "pure_noise" or fit["stderr_frequencies"])
    assert all(abs(one) < 1e-4 for fit in fits for one in fit["errors"]["frequencies"])
    assert golden.main(["compare", str(path), str(path)]) == 0


def test_each_deliberate_fault_is_in_the_package_once():
    for fault in mutations.FAULTS:
        text = (ROOT / "ph_control" / fault.file).read_text(encoding="utf-8")
        assert text.count(fault.right) == 1, f"{fault.file}: {fault.right}"
        assert all((ROOT / "tests" / f"test_{name}.py").is_file() for name in fault.tests)


@pytest.mark.slow
def test_a_poor_fit_under_the_other_hold_makes_no_plant_lossless():
    # classical damping is rejected by chance; beside forces ten times as large the other hold had a poor fit
    table = noise.run("a shaker with a tenth of the ambient forces", (3, 3, 1), 1, 6000, forces=10.0, first=165)
    assert set(table.orders) == {(3, 0)} and "HOLD" not in table.findings
    assert set(table.structures) <= {"classical", "free"}
