"""Source code of discrete systems: compiled, or executed, it does what the system does."""

import ctypes
import shutil
import subprocess

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

import ph_control as phc

SETTINGS = settings(deadline=None, max_examples=10, derandomize=True)
COMPILER = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
compiled = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler: cc, gcc or clang")


def random_system(seed, n, m, p, dt=0.1):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    A *= 0.9 / max(np.abs(np.linalg.eigvals(A)).max(), 0.1) if n else 1.0
    matrices = A, rng.standard_normal((n, m)), rng.standard_normal((p, n)), rng.standard_normal((p, m))
    return ct.ss(*matrices, dt, remove_useless_states=False)


def stepped(sys, u):
    """Outputs by the equations."""
    x, y = np.zeros(sys.nstates), []
    for sample in u.T:
        y.append(sys.C @ x + sys.D @ sample)
        x = sys.A @ x + sys.B @ sample
    return np.array(y).T


def run(code, name, sys, u, folder, real="double"):
    """Outputs of the function in C."""
    source, library = folder / f"{name}.c", folder / f"{name}.so"
    source.write_text(code)
    flags = ["-std=c89", "-pedantic", "-Wall", "-Wextra", "-Werror", "-O1", "-shared", "-fPIC"]
    more = [f"-D{name.upper()}_REAL=float"] if real == "float" else []
    done = subprocess.run(
        [COMPILER, *flags, *more, str(source), "-o", str(library)], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    kind = ctypes.c_float if real == "float" else ctypes.c_double
    step = getattr(ctypes.CDLL(str(library)), f"{name}_step")
    step.restype = None
    x, y = (kind * max(1, sys.nstates))(), (kind * sys.noutputs)()
    outputs = []
    for sample in u.T:
        step(x, (kind * sys.ninputs)(*sample), y)
        outputs.append(list(y))
    return np.array(outputs).T


@compiled
@pytest.mark.parametrize(("n", "m", "p"), [(0, 1, 1), (1, 1, 1), (4, 2, 3), (7, 3, 1)])
def test_the_function_in_c_makes_the_steps_of_the_system(n, m, p, tmp_path):
    sys = random_system(n, n, m, p)
    u = np.random.default_rng(1).standard_normal((m, 60))
    y = run(phc.to_c(sys, "loop"), "loop", sys, u, tmp_path)
    assert y == pytest.approx(stepped(sys, u), rel=1e-12, abs=1e-12)


@compiled
def test_the_function_in_c_runs_in_single_precision_and_with_hostile_names(tmp_path):
    plant = phc.sample(phc.ph(phc.modes([1.0, 3.0], [1.0, 0.5])), 0.1)
    sys = ct.ss(
        plant.A, plant.B, plant.C, plant.D, 0.1, name="a*/b\\", inputs=["force /* ??/"], outputs=["v\n#error */"]
    )
    u = np.random.default_rng(1).standard_normal((1, 100))
    y = run(phc.to_c(sys), "plant", sys, u, tmp_path, "float")
    expected = stepped(sys, u)
    assert y == pytest.approx(expected, abs=1e-4 * np.abs(expected).max())
    assert y != pytest.approx(expected, abs=1e-12)


@compiled
def test_a_controller_of_python_control_runs_in_c(tmp_path):
    sys = ct.ss(ct.sample_system(ct.tf([1.0, 0.2], [1.0, 3.0]), 0.05, "tustin"))
    u = np.ones((1, 40))
    assert run(phc.to_c(sys, "law"), "law", sys, u, tmp_path) == pytest.approx(stepped(sys, u), rel=1e-13)


@SETTINGS
@given(st.integers(0, 2**32), st.integers(0, 5), st.integers(1, 3), st.integers(1, 3))
def test_the_code_for_scipy_gives_the_matrices_back(seed, n, m, p):
    sys, made = random_system(seed, n, m, p, 0.3), {}
    exec(phc.to_python(sys, "loop"), made)
    loop = made["loop"]
    assert loop.dt == 0.3
    for letter in "ABCD":
        assert np.array_equal(getattr(loop, letter), getattr(sys, letter))
    if n:
        u = np.random.default_rng(1).standard_normal((m, 30))
        assert signal.dlsim(loop, u.T)[1].T == pytest.approx(stepped(sys, u), rel=1e-10, abs=1e-10)


def test_names_cannot_break_out_of_the_code():
    sys, made = random_system(0, 2, 1, 1), {}
    sys.input_labels = ["a\nraise SystemExit"]
    exec(phc.to_python(sys), made)
    assert made["plant"].A.shape == (2, 2)


@pytest.mark.parametrize("unit, period", [("s", "0.1 s:"), (None, "0.1 (in the unit of time of the system):")])
def test_the_heading_has_the_name_that_is_given_and_the_unit_of_time(unit, period):
    sys = random_system(0, 1, 1, 2)
    sys.time_unit = unit
    heading = phc.to_c(sys, "law").splitlines()
    assert heading[0] == "/* law: 1 state, 1 input, 2 outputs"
    assert heading[2].endswith(f"Call law_step once in each period of {period}")
    assert phc.to_python(sys, "law").startswith("# law: inputs")


@pytest.mark.parametrize("function", [phc.to_c, phc.to_python])
@pytest.mark.parametrize(
    "sys",
    [
        phc.frenkel_kontorova(2), ct.ss(-1.0, 1.0, 1.0, 0.0), ct.tf([1.0], [1.0, 0.5], 0.1), 3.0,
        ct.ss(0.5, 1.0, 1.0, 0.0, True),
    ],
)  # fmt: skip
def test_what_has_no_step_is_refused_with_a_way_to_one(function, sys):
    with pytest.raises(phc.StructureError, match=r"of discrete time with a step: sample it by sample\(sys, h\)"):
        function(sys)


@pytest.mark.parametrize("function", [phc.to_c, phc.to_python])
@pytest.mark.parametrize("name", ["2nd", "a b", "", "for", None, "a;b"])
def test_names_that_are_none_are_refused(function, name):
    with pytest.raises(phc.StructureError, match="name is"):
        function(random_system(0, 1, 1, 1), name)


def test_infinite_matrices_are_refused():
    with pytest.raises(phc.StructureError, match="matrix D"):
        phc.to_c(ct.ss(0.5, 1.0, 1.0, np.inf, 0.1))
