"""The patches of docs/change_it.md, applied to a copy of the package: what they add works through public calls."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "change_it.md").read_text(encoding="utf-8")
MOST_FILES = 3  # of an addition

# what a user would do with all four additions
SCRIPT = """
import json, struct, sys
from pathlib import Path
import control as ct, numpy as np, ph_control as phc
from ph_control.cli import main

rng, seen = np.random.default_rng(0), {}
omega = np.linspace(0.2, 4.0, 240)
s, poles = 1j * omega, np.array([-0.02 + 1j, -0.04 + 2.5j])


def response(poles, residues):
    return sum(R / (s - p) + np.conj(R) / (s - np.conj(p)) for p, R in zip(poles, residues))


def noisy(values, size):
    return ct.frd(values + size * (rng.standard_normal(240) + 1j * rng.standard_normal(240)), omega)


# jerk of two modes, told by the label; at a step of the force there is an impulse, which no sample has
t, u = 0.1 * np.arange(800), rng.standard_normal(800)
weights = np.array([1.0, 2.0])
inside = phc.modes(poles, weights * poles**3 / (2j * poles.imag), np.ones(2)).state_space()
jerk = ct.forced_response(ct.c2d(inside, 0.1), t, u).outputs + float((2 * poles.real * weights).sum()) * u
labels = {"output_labels": ["tip [m/s^3]"], "input_labels": ["force"]}
data = ct.TimeResponseData(t, jerk + 0.02 * rng.standard_normal(800), inputs=u, issiso=True, **labels)
fit = phc.pem(data, 2, intersample="zoh", delay=0.0, real_poles=0)
pulls = (fit.r - weights / np.abs(poles)) / fit.stderr["r"]
seen["jerk"] = fit.quantities, fit.structure, np.abs(pulls).max(), fit.stderr["r"].max(), fit.outcome.name

# velocity that was integrated
fit = phc.pem(noisy(response(poles, poles / (2j * poles.imag)), 0.02 / omega), 2, structure="classical")
(finding,) = [each for each in fit.findings if each.cause.name == "INTEGRATED_NOISE"]
pulls = (fit.poles - poles).imag / fit.stderr["natural_frequencies"]
seen["noise"] = finding.gain, fit.whiteness, np.abs(pulls).max(), "falls with the frequency" in str(fit)

# poles on the axis, residues of other phases; then with damping
gyroscopic = noisy(response(1j * poles.imag, [0.5 + 0.3j, 0.4 - 0.2j]), 0.02)
fit = phc.pem(gyroscopic, 2, quantity="free")
test = next(each for each in fit.tests if each.hypothesis == "undamped")
seen["undamped"] = fit.structure, np.abs(fit.poles.real).max(), test.dof, test.p
phc.save(fit, "fit.json")
seen["saved"] = phc.load("fit.json").structure
fit = phc.pem(noisy(response(poles, [0.5 + 0.3j, 0.4 - 0.2j]), 0.02), 2, quantity="free", structure="undamped")
seen["refused"] = fit.tests[0].p, fit.outcome.name, [each.cause.name for each in fit.findings]

# a seismogram of 300 samples
motion = np.exp(-0.01 * np.arange(300)) * np.sin(0.5 * np.arange(300)) + 1e-3 * rng.standard_normal(300)
for order, file in (("<", "little.sac"), (">", "big.sac")):
    header = bytearray(632)
    struct.pack_into(order + "f", header, 0, 0.02)
    struct.pack_into(order + "i", header, 304, 6)
    struct.pack_into(order + "i", header, 316, 300)
    header[600:608] = b"HHZ     "
    Path(file).write_bytes(bytes(header) + motion.astype(order + "f4").tobytes())
both = [phc.read_recording(file, input=False) for file in ("little.sac", "big.sac")]
seen["sac"] = [(data.output_labels, data.time[1], np.abs(data.outputs - motion).max()) for data in both]
Path("broken.sac").write_bytes(b"no header")
try:
    phc.read_recording("broken.sac")
except phc.FileFormatError as error:
    seen["broken"] = str(error)
arguments = ["fit", "big.sac", "--no-input", "--order", "1", "--quantity", "jerk", "--structure", "undamped"]
seen["status"] = main([*arguments, "--result", "shell.json", "--json"])
seen["shell"] = phc.load("shell.json").quantities, phc.load("shell.json").structure
Path("seen.json").write_text(json.dumps(seen, default=float))
"""


def patches() -> dict[str, list[tuple[str, str]]]:
    """Of each section of the page the files that it changes, with the lines of the patch."""
    sections = re.split(r"^## ", PAGE, flags=re.M)[1:]
    found = {
        section.splitlines()[0]: re.findall(r"^```diff\nIndex: (\S+)\n(.*?)^```$", section, re.M | re.S)
        for section in sections
    }
    return {title: blocks for title, blocks in found.items() if blocks}


def apply(folder: Path, path: str, patch: str) -> None:
    """Replace what each part of a patch shows without its new lines, which has to stand in the file once."""
    file = folder / path
    text = file.read_text(encoding="utf-8")
    for part in patch.split("\n ...\n"):
        lines = part.rstrip("\n").split("\n")
        before, after = ("".join(f"{line[1:]}\n" for line in lines if line[:1] in kept) for kept in (" -", " +"))
        assert text.count(before) == 1, f"{path} does not have these lines once:\n{before}"
        text = text.replace(before, after)
    file.write_text(text, encoding="utf-8")


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """What the script finds in a copy of the package with all patches."""
    folder = tmp_path_factory.mktemp("changed")
    shutil.copytree(ROOT / "ph_control", folder / "ph_control", ignore=shutil.ignore_patterns("__pycache__"))
    for blocks in patches().values():
        for path, patch in blocks:
            apply(folder, path, patch)
    environment = os.environ | {"PYTHONPATH": str(folder), "MPLBACKEND": "Agg"}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-W", "ignore:::pyparsing", "-c", SCRIPT], cwd=folder, env=environment,
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads((folder / "seen.json").read_text(encoding="utf-8"))


def test_each_addition_touches_three_files_at_most():
    files = {title: {path for path, _ in blocks} for title, blocks in patches().items()}
    assert list(files) == ["A measured quantity", "A law of the noise", "A structure", "A file format"]
    assert all(1 <= len(paths) <= MOST_FILES for paths in files.values()), files


def test_a_patch_that_does_not_fit_is_noticed(tmp_path):
    (tmp_path / "a.py").write_text("x = 1\n", encoding="utf-8")
    apply(tmp_path, "a.py", " x = 1\n+y = 2\n")
    assert (tmp_path / "a.py").read_text(encoding="utf-8") == "x = 1\ny = 2\n"
    with pytest.raises(AssertionError, match="does not have these lines once"):
        apply(tmp_path, "a.py", "-x = 2\n+x = 3\n")


def test_a_jerk_has_the_weights_of_its_modes(seen):
    quantities, structure, pull, error, outcome = seen["jerk"]
    assert (quantities, structure, outcome) == (["jerk"], "classical", "CONSISTENT")
    assert pull < 4 and error < 0.01


def test_noise_of_an_integral_is_in_the_likelihood(seen):
    gain, whiteness, pull, told = seen["noise"]
    assert gain > 50 and whiteness > 0.01 and pull < 4 and told


def test_poles_on_the_axis_are_a_structure_with_a_test(seen):
    structure, damping, dof, p = seen["undamped"]
    assert (structure, damping, dof) == ("undamped", 0.0, 2) and p > 0.05
    assert seen["saved"] == "undamped"
    p, outcome, causes = seen["refused"]
    assert p < 1e-6 and outcome == "NOT_DESCRIBED" and "DAMPING" in causes


def test_seismograms_are_read(seen):
    for labels, step, error in seen["sac"]:
        assert labels == ["HHZ"] and step == pytest.approx(0.02) and error < 1e-6
    assert "broken.sac is no SAC file, or damaged" in seen["broken"]


def test_the_command_line_has_all_of_them(seen):
    # the motion decays
    assert seen["status"] == 1 and seen["shell"] == [["jerk"], "undamped"]
