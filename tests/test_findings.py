"""What a fit says: the likely cause first, one sentence for several channels, stages while it runs."""

from __future__ import annotations

import numpy as np
import pytest

import ph_control as phc

STEP = 0.3


@pytest.fixture(scope="module")
def record():
    rng = np.random.default_rng(3)
    u = rng.standard_normal(600)
    plant = phc.ph(phc.modes([0.7, 1.9], [1.0, 0.5]))
    y = phc.forced_response(plant, STEP * np.arange(600), u, intersample="zoh").outputs
    return u, y + 0.1 * y.std() * rng.standard_normal(600)


def causes(result) -> list[str]:
    return [finding.cause.name for finding in result.findings]


def test_swapped_columns_are_named_as_the_likely_cause(record):
    u, y = record
    result = phc.pem((y, u), dt=STEP, max_order=1, noise="white", delay=0)
    assert "SWAPPED" in causes(result)
    assert "columns of input and output are probably swapped: 'u' is the response" in result.message
    assert "SWAPPED" not in causes(phc.pem((u, y), 2, dt=STEP, structure="lossless"))


def test_identical_columns_are_named_first_with_their_factor(record):
    u, y = record
    result = phc.pem((u, np.array([y, -2 * y])), 2, dt=STEP, structure="free", noise="white")
    assert causes(result).count("SAME_COLUMNS") == 1
    assert result.message.startswith("The columns 'y1' and 'y2' are the same up to a factor of -2: probably one")


@pytest.mark.slow
def test_outputs_with_the_same_finding_share_one_sentence(record):
    u, y = record
    rng = np.random.default_rng(5)
    outputs = np.array([y * (k + 1) + 0.01 * rng.standard_normal(y.size) for k in range(6)])
    outputs[:, 100] += 1e3
    result = phc.pem((u, outputs), 2, dt=STEP, structure="free", noise="white", intersample="zoh", offset=False)
    assert causes(result).count("OUTLIERS") == 6
    assert result.message.count("far outside the noise") == 2
    assert (
        "6 outputs have values far outside the noise ('y1', 'y2', 'y3', 'y4', 'y5', 'y6'). Of them:" in result.message
    )


def test_what_is_mostly_noise_is_not_called_consistent(record):
    u, y = record
    noise = y.std() * np.random.default_rng(1).standard_normal(600)
    results = [
        phc.pem((u, y + size * noise), 2, dt=STEP, structure="free", noise="white", intersample="zoh")
        for size in (0.1, 3.0)
    ]
    assert [result.outcome.name for result in results] == ["CONSISTENT", "MOSTLY_NOISE"]
    assert results[1].fit_percent < 50 < results[0].fit_percent and "consistent" not in results[1].verdict


def test_a_callback_is_told_the_stage(record):
    told = []
    phc.pem(record, 2, dt=STEP, structure="lossless", callback=told.append)
    assert {progress.stage for progress in told} >= {"search"} and all(progress.order >= 0 for progress in told)


def test_a_bar_shows_the_progress_and_is_gone_at_the_end(record, capsys):
    phc.pem(record, callback=phc.show_progress, dt=STEP, max_order=4, structure="lossless", noise="white", delay=0)
    shown = capsys.readouterr().err
    assert "[#####" in shown and " of at most 4, iteration " in shown
    assert shown.startswith("\r[") and shown.rsplit("\r", 2)[1].strip() == ""


def test_findings_of_many_values_are_short(record):
    u, y = record
    spoilt = np.where(np.isin(np.arange(y.size), [7, 97, 187, 277, 367, 457]), 50.0, y)
    result = phc.pem((u, spoilt), 2, dt=STEP, structure="free", noise="white", intersample="zoh", offset=False)
    (outliers,) = (finding for finding in result.findings if finding.cause.name == "OUTLIERS")
    assert repr(outliers) == "Finding(OUTLIERS, (7, 97, 187, 277, ... 2 more), gain=0, output='y')"


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_printed_for_a_shell(shell, capsys):
    pytest.importorskip("shtab")
    from ph_control.cli import main

    assert main(["--print-completion", shell]) == 0
    script = capsys.readouterr().out
    assert "watch-progress" in script and "fit-many" in script
    assert main(["--print-completion", "cmd"]) == 2
    assert "takes the name of a shell, one of bash, zsh" in capsys.readouterr().err


def test_progress_is_written_to_a_pipe_where_it_is_asked_for(tmp_path, record, monkeypatch, capsys):
    from ph_control.cli import main

    monkeypatch.setattr("ph_control.cli.outcome._IN_LINES", 0.0)
    table = tmp_path / "record.csv"
    np.savetxt(table, np.column_stack(record), delimiter=",", header="u,y", comments="")
    words = ["fit", str(table), "--dt", str(STEP), "--order", "2", "--structure", "lossless"]
    assert main(words) == 0 and not capsys.readouterr().err
    assert main([*words, "--watch-progress"]) == 0
    assert "ph-control: order 2 of at most" in capsys.readouterr().err


def test_a_lag_has_the_exit_status_of_a_model(tmp_path, capsys):
    from ph_control.cli import main

    rng = np.random.default_rng(0)
    u, y = np.repeat(rng.standard_normal(40), 10), np.zeros(400)
    for k in range(1, 400):
        y[k] = 0.9 * y[k - 1] + 0.1 * u[k - 1]
    table = tmp_path / "motor.csv"
    rows = np.column_stack([0.1 * np.arange(400), u, y + 0.05 * rng.standard_normal(400)])
    np.savetxt(table, rows, delimiter=";", header="Zeit [s];Spannung [V];Drehzahl", comments="")
    assert main(["fit", str(table), "--order", "0", "--real-poles", "1", "--noise", "white"]) == 0
    assert "1 real pole of 'Drehzahl' from 'Spannung [V]'" in capsys.readouterr().out
