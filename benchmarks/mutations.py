"""Deliberate faults in the package, one at a time in a copy of it, and whether the tests that concern it fail.

    python -m benchmarks.mutations [--only FOLDER_OR_FILE ...] [--list]

Signs, factors, weights, thresholds, units and indices: what a hand slips on.  Each fault is a piece of a file, replaced
in a temporary copy of the project, in which pytest then runs some test files until the first failure.  A fault that
none of them notices is said with the files that were run.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

ROOT = Path(__file__).resolve().parents[1]
COPIED = ("ph_control", "tests", "benchmarks", "examples", "docs", "pyproject.toml", "README.md", "CHANGELOG.md")
DEADLINE = 900.0  # seconds: a fault may make a loop endless, which is noticed too


@dataclass(frozen=True)
class Fault:
    """A piece of a file of the package, which occurs there once; what replaces it; test files that should fail."""

    file: str
    right: str
    wrong: str
    tests: tuple[str, ...]

    def put_into(self, folder: Path) -> None:
        """Write the fault into a copy of the package."""
        path = folder / "ph_control" / self.file
        text = path.read_text(encoding="utf-8")
        if text.count(self.right) != 1:
            raise SystemExit(f"{self.file} has {text.count(self.right)} times {self.right!r}, expected once")
        path.write_text(text.replace(self.right, self.wrong), encoding="utf-8")


def fault(file: str, right: str, wrong: str, *tests: str) -> Fault:
    """A fault with tests by the names of their files, without `test_` and ending."""
    return Fault(file, right, wrong, tests)


ID = "identification"
FAULTS = (
    fault("_units.py", '"min": 60.0', '"min": 6.0', "units", "frequency_tables"),
    fault("analysis/energy.py", "else 0.5 * (now + then)", "else 0.5 * (now - then)", "energy"),
    fault("analysis/passivity.py", "np.sqrt(1 - values) if", "1 - values if", "passivity"),
    fault("analysis/spectral_estimate.py", "_INPUT_FLOOR = 1e-6", "_INPUT_FLOOR = 1e-2", "plots"),
    fault(
        "circuits/nodal.py", "skew, symmetric = 0.5 * (K - K.T)", "skew, symmetric = 0.5 * (K.T - K)", "read_netlist"
    ),
    fault(
        "controllers/energy_observers.py", 'R = part["R"] + 0.5 * (loss', 'R = part["R"] - 0.5 * (loss', "controllers"
    ),
    fault("controllers/optimal_damping.py", "d[mode] * ratio * 1.05", "d[mode] / ratio * 1.05", "controllers"),
    fault("equivalence/filters.py", "<= error[:, None] + error", "<= error[:, None] - error", "equivalence"),
    fault("equivalence/groupoids.py", "self.L @ self.source.B", "self.L.T @ self.source.B", "groupoids"),
    fault("io/touchstone.py", "omega = 2 * np.pi * np.asarray", "omega = np.asarray", "formats"),
    fault("io/universal_file.py", "2 * np.pi * hertz", "2.0 * hertz", "formats"),
    fault("modal/discretization.py", "self.h * np.tan(0.5 * phase)", "self.h * np.tan(phase)", "discretization"),
    fault("modal/modal_form.py", "0.5 * (self.d * peak**2)", "(self.d * peak**2)", "modal"),
    fault("modal/foster_test.py", "np.sqrt(2 * mode.sigma", "np.sqrt(mode.sigma", "python_control", "realization"),
    fault(
        "modal/positive_real.py",
        "if self.scattering else 0.5 * smallest",
        "if self.scattering else smallest",
        "passivity",
    ),
    fault(
        "modal/propagation.py",
        "product if rest.any() else _product_of_doubles",
        "_product_of_doubles",
        "propagation",
        "long_steps",
        "response",
    ),
    fault(f"{ID}/change/mode_comparison.py", "/ np.sqrt(2.0)", "/ 2.0", "change"),
    fault(f"{ID}/many/control_chart.py", "0.5 * (edges[1:] + edges[:-1])", "edges[1:]", "change"),
    fault(
        f"{ID}/data/frequency_record.py",
        "0.5 * (relation - covariance)",
        "0.5 * (covariance - relation)",
        "windowed_responses",
    ),
    fault(f"{ID}/diagnosis/hum.py", "_LINE = 1e-6", "_LINE = 0.9", "hum"),
    fault(f"{ID}/diagnosis/noise_levels.py", "_BY_CHANCE = 1e-4", "_BY_CHANCE = 0.9", "frequency_fits", "real_noise"),
    fault(
        f"{ID}/estimates/estimates.py",
        "(0.0, -1.0, -2.0)[power] + 0.5",
        "(0.0, 1.0, 2.0)[power] + 0.5",
        "uncertainty",
    ),
    fault(
        f"{ID}/excitation/design_input.py",
        "2 * np.pi / (self.samples * self.dt)",
        "2 * np.pi / ((self.samples - 1) * self.dt)",
        "design_input",
    ),
    fault(f"{ID}/excitation/plant_information.py", "np.sqrt(2.0 / T)", "np.sqrt(1.0 / T)", "excitation"),
    fault(
        f"{ID}/growth/ending.py", "lost = 0.5 * projection.rows", "lost = 5.0 * projection.rows", "modal_search", "pem"
    ),
    fault(
        f"{ID}/innovations/joint.py",
        "added = 2 * (_gram(X, every) - twice)",
        "added = 2 * (_gram(X, every) + twice)",
        "innovations",
    ),
    fault(
        f"{ID}/innovations/noise_sections.py",
        "closed = self.A - self.K @ self.C",
        "closed = self.A + self.K @ self.C",
        "forces",
        "innovations",
    ),
    fault(
        f"{ID}/moves/late_inputs.py",
        "gain = 0.5 * (_criterion(on_time)",
        "gain = 5.0 * (_criterion(on_time)",
        "input_delays",
    ),
    fault(f"{ID}/parameters/rows.py", "parts = 0.5 * self._motions", "parts = self._motions", "parameters"),
    fault(
        f"{ID}/regression/frequency_rows.py",
        "np.exp(1j * self.omega * self.delay)",
        "np.exp(-1j * self.omega * self.delay)",
        "delays",
    ),
    fault(
        f"{ID}/search/fitted_modes.py", "parameters * float(np.log(samples)) - 2", "2 * parameters - 2", "pem", "hum"
    ),
    fault(f"{ID}/structure/hypothesis_tests.py", "\nLEVEL = 0.05", "\nLEVEL = 0.95", "pem_structures", "damped_model"),
    fault(
        f"{ID}/structure/delayed.py",
        "most = min(none.sum()",
        "most = max(none.sum()",
        "delays",
    ),
    fault(f"{ID}/uncertainty/kalman.py", "spread = C @ P @ C.T + R", "spread = C @ P @ C.T - R", "predictor"),
    fault(
        f"{ID}/uncertainty/fisher.py",
        "0.5 * np.concatenate([amplitudes.real, -amplitudes.imag])",
        "0.5 * np.concatenate([amplitudes.real, amplitudes.imag])",
        "excitation",
        "uncertainty",
    ),
    fault(
        f"{ID}/uncertainty/residual_tests.py",
        "band = norm.isf(0.5 * (1 - confidence)) * np.sqrt(variance) * per_pair",
        "band = norm.isf(1 - confidence) * np.sqrt(variance) * per_pair",
        "validation",
        "validation_kinds",
    ),
    fault("numerics/double_double.py", "rest = ((x[0] - p) - e + x[1])", "rest = ((x[0] - p) + e + x[1])", "twofloat"),
    fault("numerics/modal_assurance.py", "np.exp(-0.5j * np.angle", "np.exp(0.5j * np.angle", "modal_assurance"),
    fault("reduction/optimal.py", "Q12.T @ P12 - minus_Q22 @ P22", "Q12.T @ P12 + minus_Q22 @ P22", "reduce"),
    fault(
        "symplectic/darboux_and_casimirs.py",
        "reached = kernel.T @ ports",
        "reached = -0.0 * kernel.T @ ports",
        "darboux",
    ),
    fault("systems/canonical_forms.py", "(d1 / d2) ** 0.25", "(d1 / d2) ** 0.5", "canonical_forms"),
    fault("systems/interconnection.py", "-(c @ out) / resistance", "(c @ out) / resistance", "interconnection"),
    fault("systems/dissipative.py", '"R": 0.5 * (loss + loss.T)', '"R": 0.5 * (loss - loss.T)', "dissipative"),
    fault(
        "plotting/damping_plot.py",
        "size, zeta = np.abs(p) / unit, -100 * p.real",
        "size, zeta = np.abs(p) / unit, -p.real",
        "controllers",
        "system_plots",
    ),
)


def first_failure(each: Fault) -> str | None:
    """What the tests say of a copy with the fault: the first that fails; None if all pass."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "project"
        folder.mkdir()
        for name in COPIED:
            source = ROOT / name
            if source.is_dir():
                shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__", "_build", "*.png"))
            else:
                shutil.copy(source, folder / name)
        each.put_into(folder)
        files = [f"tests/test_{name}.py" for name in each.tests]
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *files]
        environment = os.environ | {"PYTHONPATH": str(folder), "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
        try:
            done = subprocess.run(
                command, cwd=folder, env=environment, capture_output=True, text=True, timeout=DEADLINE
            )
        except subprocess.TimeoutExpired:
            return "no end"
    if done.returncode == 0:
        return None
    failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return failed[0].split(" - ")[0] if failed else f"pytest ended with {done.returncode}"


def table(faults: Sequence[Fault]) -> int:
    """Print what notices each fault; the number of those that nothing notices."""
    missed = 0
    for each in faults:
        start = perf_counter()
        noticed = first_failure(each)
        missed += noticed is None
        what = noticed or f"MISSED by {', '.join(each.tests)}: {each.right!r} -> {each.wrong!r}"
        print(f"{each.file:48} {perf_counter() - start:5.0f} s  {what}", flush=True)
    print(f"{len(faults) - missed} of {len(faults)} faults noticed")
    return missed


def main() -> None:
    """Run the faults of some files, or list them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", default=[""], help="beginnings of files of the package")
    parser.add_argument("--list", action="store_true", help="do not run anything")
    chosen = parser.parse_args()
    faults = [each for each in FAULTS if each.file.startswith(tuple(chosen.only))]
    if chosen.list:
        for each in faults:
            print(f"{each.file}: {each.right!r} -> {each.wrong!r}  [{', '.join(each.tests)}]")
        return
    table(faults)


if __name__ == "__main__":
    main()
