"""Netlists with subcircuits, parameters, expressions, losses beside values and coils without leakage.

Each is compared with its elements written out, by a nodal analysis in mpmath, and where it is installed with ngspice,
which reads the text itself.
"""

import re
import shutil
import subprocess

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nodal_analysis import nodal_response

import ph_control as phc

SETTINGS = settings(deadline=None, max_examples=15, derandomize=True)


POWERS = {"meg": 6, "k": 3, "m": -3, "u": -6, "n": -9, "p": -12}


def nodal(lines, w):
    """Response of elements that are written out, one a line."""
    lines = re.sub(r" ([\d.]+)(meg|[kmunp])$", lambda m: f" {m[1]}e{POWERS[m[2]]}", lines, flags=re.M)
    with mpmath.workdps(60):
        return np.array(nodal_response(f"title\n{lines}\n.end\n", w)[0].tolist(), complex)


def response(lines, w, end=".end"):
    system = phc.read_netlist(f"title\n{lines}\n{end}\n")
    return system(1j * w).reshape(system.noutputs, -1)


def ngspice(lines, folder, w, sources):
    """Responses at the sources, of which each has the amplitude 1 in turn."""
    f, answers = w / (2 * np.pi), []
    for driven, _ in sources:
        text = lines
        for name, _ in sources:
            text = re.sub(rf"(?im)^({name} \S+ \S+)", rf"\1 DC 0 AC {int(name == driven)}", text)
        shown = [f"i({name})" if name[0] == "v" else value for name, value in sources]
        commands = [f"ac lin 1 {f!r} {f!r}", "set numdgt=15", *(f"print {one}" for one in shown), "quit"]
        control = "\n".join([".options noopac", ".control", *commands, ".endc", ".end", ""])
        (folder / "a.cir").write_text(f"title\n{text}\n{control}")
        done = subprocess.run(["ngspice", "-b", "a.cir"], cwd=folder, capture_output=True, text=True, timeout=60)
        said = [line.partition(" = ")[2] for line in done.stdout.splitlines() if line.startswith(tuple(shown))]
        assert len(said) == len(sources), done.stdout + done.stderr
        values = [complex(*map(float, one.split(","))) for one in said]
        answers.append([-x if name[0] == "v" else x for x, (name, _) in zip(values, sources, strict=True)])
    return np.array(answers).T


V1, I1, I2 = ("v1", ""), ("i1", "v(1)"), ("i2", "v(2)")
LADDER = "R1 1 2 50\nL1 2 3 491.8n\nC2 3 0 515p\nL3 3 4 300n\nR2 4 0 75"
# name: what is read, the same written out, and the sources with what is measured at them
NETLISTS = {
    "subcircuit": (
        "V1 1 0\n.SUBCKT pi1 a b\nL1 a m 491.8n\nC2 m 0 515p\nL3 m b 300n\n.ENDS\nR1 1 2 50\nX1 2 4 PI1\nR2 4 0 75",
        f"V1 1 0\n{LADDER}", [V1],
    ),
    "called before it is defined": (
        "V1 1 0\nR1 1 2 50\nX1 2 4 half l=491.8n c={515p}\nR2 4 0 75\n"
        ".subckt half a b l=1 c=1\nL1 a m {l}\nC2 m 0 {c}\nL3 m b 300n\n.ends half",
        f"V1 1 0\n{LADDER}", [V1],
    ),
    "default and given parameters": (
        ".param z=50\nV1 1 0\n.subckt load a PARAMS: r=75 c='2*3p'\nR1 a 0 {r}\nC1 a 0 {c}\n.ends\n"
        "R1 1 2 {z}\nL1 2 3 1u\nX1 2 load\nX2 3 load r={z/2}\nX3 3 load params: c=1n",
        "V1 1 0\nR1 1 2 50\nL1 2 3 1u\nRa 2 0 75\nCa 2 0 6p\nRb 3 0 25\nCb 3 0 6p\nRc 3 0 75\nCc 3 0 1n", [V1],
    ),
    "nested subcircuits": (
        "I1 0 1\n.subckt outer a b k=2\n.param l0={k*1u}\n.subckt inner a b l=1\nL1 a x {l}\n"
        "R1 x b {k*5}\n.ends inner\n"
        "X1 a m inner l={l0}\nX2 m b inner l={3*l0}\nC1 m 0 1n\n.ends outer\nX1 1 2 outer k=3\nR2 2 0 50\nC3 1 0 2n",
        "I1 0 1\nL1 1 x 3u\nR1 x m 15\nL2 m y 9u\nR2 y 2 15\nC1 m 0 1n\nRz 2 0 50\nC3 1 0 2n", [I1],
    ),
    "one subcircuit in another": (
        "V1 1 0\n.subckt cell a b\nR1 a b 10\nC1 b 0 1n\n.ends\n.subckt two a b\nX1 a m cell\nX2 m b cell\n.ends\n"
        "X1 1 2 two\nX2 2 3 two\nL1 3 0 1m",
        "V1 1 0\nR1 1 a 10\nC1 a 0 1n\nR2 a 2 10\nC2 2 0 1n\nR3 2 b 10\nC3 b 0 1n\nR4 b 3 10\n"
        "C4 3 0 1n\nL1 3 0 1m", [V1],
    ),
    "names meet those outside": (
        "V1 1 0\nR1 1 m 10\nC1 m 0 1n\n.subckt s m n\nR1 m 1 20\nC1 1 n 3n\n.ends\nX1 m 2 s\nR2 2 0 30",
        "V1 1 0\nR1 1 m 10\nC1 m 0 1n\nRa m x 20\nCa x 2 3n\nR2 2 0 30", [V1],
    ),
    "global nodes": (
        ".global bus\nI1 0 bus\n.subckt s a\nR1 a bus 10\n.ends\nX1 2 s\nX2 3 s\nL1 2 0 1m\n"
        "C1 3 0 1n\nR9 bus 0 1k\nR8 1 bus 1",
        "I1 0 b\nR1 2 b 10\nR2 3 b 10\nL1 2 0 1m\nC1 3 0 1n\nR9 b 0 1k\nR8 1 b 1", [("i1", "v(bus)")],
    ),
    "order of parameters": (
        ".param b={2*a+1} a=3\nV1 1 0\nR1 1 2 {b}\nC1 2 0 'a*1u'\n.param d={b*a}\nL1 2 0 {d*1u}\nR3 2 0 {d}",
        "V1 1 0\nR1 1 2 7\nC1 2 0 3u\nL1 2 0 21u\nR3 2 0 21", [V1],
    ),
    "arithmetic": (
        ".param f0=10k Q=5 l={1m}\n.param w={2*3.14159265358979312*f0}\nV1 1 0\nR1 1 2 {w*l/q}\nL1 2 3 {l}\n"
        "C1 3 0 {1/(w**2*l)}\nR2 3 0 {-(-2**2)*1k+sqrt(16)/2^2}\nC2 3 0 '(1n + 2n)*3'",
        "V1 1 0\nR1 1 2 12.566370614359172\nL1 2 3 1m\nC1 3 0 2.5330295910584444e-07\nR2 3 0 4001\nC2 3 0 9n", [V1],
    ),
    "suffixes in expressions": (
        "V1 1 0\nR1 1 2 {4.7k/10}\nL1 2 3 {1meg*1n}\nC1 3 0 {10uF/1k}\nR2 3 0 {2*0.1k+.5K}",
        "V1 1 0\nR1 1 2 470\nL1 2 3 1m\nC1 3 0 10n\nR2 3 0 700", [V1],
    ),
    "comments, continuations, letters of either size": (
        "* a comment\nv1 IN GND ; here\n.PARAM Rv=50 $ and here\n.subckt T1 In\n+ oUt\n+ params: L=1m\nl1 IN out {l}\n"
        "* inside\n.EnDs\nr1 in\n+ A\n* between\n+ {rV}\nxA a 0\n+ t1\n+ l=2m\nCx A 0 1u\n.op",
        "V1 1 0\nR1 1 2 50\nL1 2 0 2m\nC1 2 0 1u", [V1],
    ),
    "m": (
        "V1 1 0\nR1 1 2 50 m=2\nL1 2 3 1m m=4\nC1 3 0 1n m=3\n.subckt s a b\nR1 a b 30\nC1 a b 2n\n.ends\nX1 3 0 s m=5",
        "V1 1 0\nR1 1 2 25\nL1 2 3 0.25m\nC1 3 0 3n\nR2 3 0 6\nC2 3 0 10n", [V1],
    ),
    "values by their letters": (
        "V1 1 0\nR1 1 2 R={10+40}\nL1 2 3 L=1m\nC1 3 0 C='2*5n' ic=0", "V1 1 0\nR1 1 2 50\nL1 2 3 1m\nC1 3 0 10n", [V1],
    ),
    "ideal transformer": (
        "V1 1 0\nR1 1 2 10\nL1 2 0 1m\nL2 3 0 4m\nK1 L1 L2 1\nR2 3 0 75\nC2 3 0 10n",
        # its primary inductance, and the load by the square of the ratio
        "V1 1 0\nR1 1 2 10\nL1 2 0 1m\nR2 2 0 18.75\nC2 2 0 40n", [V1],
    ),
    "ideal transformer that turns the sign, two ports": (
        "I1 0 1\nI2 0 2\nL1 1 0 9m\nL2 2 0 1m\nK1 L1 L2 -1\nR1 1 0 90\nR2 2 0 10\nC1 1 0 1n",
        "I1 0 1\nI2 0 2\nL1 1 0 9m\nL2 2 0 1m\nK1 L1 L2 -1\nR1 1 0 90\nR2 2 0 10\nC1 1 0 1n", [I1, I2],
    ),
    "three coils on one core": (
        "V1 1 0\nR1 1 2 10\nL1 2 0 1m\nL2 3 0 4m\nL3 4 0 0.25m\nK1 L1 L2 1\nK2 L1 L3 1\nK3 L2 L3 1\n"
        "R2 3 0 75\nR4 4 5 3\nC2 5 0 10u",
        "V1 1 0\nR1 1 2 10\nL1 2 0 1m\nR2 2 0 18.75\nR4 2 5 12\nC2 5 0 2.5u", [V1],
    ),
    "leakage to a third coil": (
        "V1 1 0\nR1 1 2 10\nL1 2 0 1m\nL2 3 0 4m\nL3 4 0 1m\nK1 L1 L2 1\nK2 L1 L3 .5\nK3 L2 L3 .5\nR2 3 0 75\nR4 4 0 3",
        "V1 1 0\nR1 1 2 10\nL1 2 0 1m\nL3 4 0 1m\nK1 L1 L3 .5\nR2 2 0 18.75\nR4 4 0 3", [V1],
    ),
    "autotransformer": (
        "V1 1 0\nR1 1 2 10\nL1 2 3 1m\nL2 3 0 1m\nK1 L1 L2 1\nR2 3 0 5\nC2 3 0 1u",
        "V1 1 0\nR1 1 2 10\nL1 2 0 4m\nR2 2 0 20\nC2 2 0 0.25u", [V1],
    ),
    "coupling in a subcircuit": (
        "V1 1 0\n.subckt tr a b c d PARAMS: l=1m n=2 k=1\nL1 a b {l}\nL2 c d {l*n**2}\nK1 L1 L2 {k}\n.ends\nR1 1 2 10\n"
        "X1 2 0 3 0 tr n=3\nX2 3 0 4 0 tr k=0.5 l=2m\nR2 4 0 90",
        "V1 1 0\nR1 1 2 10\nL1 2 0 1m\nL3 2 0 0.2222222222222222m\nL4 4 0 8m\nK1 L3 L4 0.5\nR2 4 0 90", [V1],
    ),
    "high turns ratio": (
        "V1 1 0\nR1 1 2 10\nL1 2 0 1\nL2 3 0 1u\nK1 L1 L2 1\nL3 3 0 1u\nL4 4 0 1p\nK2 L3 L4 1\nR2 4 0 1u\nC2 4 0 3",
        "V1 1 0\nR1 1 2 10\nL1 2 0 1\nL3 2 0 1\nR2 2 0 1meg\nC2 2 0 3p", [V1],
    ),
    "several couplings in a line": (
        "V1 1 0\nR1 1 2 10\nL1 2 0 1m\nL2 3 0 4m\nL3 4 0 2m\nK1 L1 L2 .6\nK2 L2 L3 0.5\n"
        "K3 L1 L3 {0.3}\nR2 3 0 75\nR4 4 0 3",
        "V1 1 0\nR1 1 2 10\nL1 2 0 1m\nL2 3 0 4m\nL3 4 0 2m\nK1 L1 L2 .6\nK2 L2 L3 .5\nK3 L1 L3 .3\n"
        "R2 3 0 75\nR4 4 0 3",
        [V1],
    ),
    "ladder of many subcircuits": (
        "V1 1 0\n.subckt c a b n=1\nL1 a b {n*1u}\nC1 b 0 {1n/n}\n.ends\nR1 1 2 50\n"
        + "\n".join(f"X{k} {k + 1} {k + 2} c n={k}" for k in range(1, 9)) + "\nR9 10 0 50",
        "V1 1 0\nR1 1 2 50\n"
        + "\n".join(f"L{k} {k + 1} {k + 2} {k}e-6\nC{k} {k + 2} 0 {1e-9 / k!r}" for k in range(1, 9)) + "\nR9 10 0 50",
        [V1],
    ),
}  # fmt: skip
# of other programs than ngspice
OTHERS = {
    "losses of a coil": (
        "V1 1 0\nR1 1 2 50\nL1 2 0 1m Rser=0.1 Rpar=10k Cpar=5p\nC1 2 0 10n",
        "V1 1 0\nR1 1 2 50\nL1 2 x 1m\nRa x 0 0.1\nRb 2 0 10k\nCb 2 0 5p\nC1 2 0 10n",
    ),
    "losses of a capacitor": (
        "V1 1 0\nR1 1 2 50\nC1 2 0 1u Rser={2*r} Lser=1n Rpar=1meg Cpar=1p Rlshunt=3\nL1 2 0 1m\n.param r=5m",
        "V1 1 0\nR1 1 2 50\nC1 2 x 1u\nRa x y 10m\nLa y 0 1n\nRs y 0 3\nRb 2 0 1meg\nCb 2 0 1p\nL1 2 0 1m",
    ),
    "a part of no loss": ("V1 1 0\nR1 1 2 50\nL1 2 0 1m Rser=0 Cpar=0", "V1 1 0\nR1 1 2 50\nL1 2 0 1m"),
    "m of a coil with losses": (
        "V1 1 0\nR1 1 2 50\nL1 2 0 1m Rser=2 Cpar=1n m=2",
        "V1 1 0\nR1 1 2 50\nL1 2 x 0.5m\nR2 x 0 1\nC1 2 0 2n",
    ),
    "coupled coils with losses": (
        "V1 1 0\nR1 1 2 50\nL1 2 0 1m Rser=3\nL2 3 0 4m Rser=5\nK1 L1 L2 1\nR2 3 0 75",
        "V1 1 0\nR1 1 2 50\nL1 2 x 1m\nRa x 0 3\nL2 3 y 4m\nRb y 0 5\nK1 L1 L2 1\nR2 3 0 75",
    ),
    "resistance of a source": (
        "V1 1 0 PULSE(0 1 0 1n 1n) Rser=50 Cpar=1n\nL1 1 0 1m",
        "V1 x 0\nR1 1 x 50\nC1 1 0 1n\nL1 1 0 1m",
    ),
    "all coils at once": (
        "V1 1 0\nR1 1 2 5\nL1 2 0 1m\nL2 3 0 4m\nL3 4 0 9m\nK1 L1 L2 L3 0.9\nR2 3 0 75\nR3 4 0 9",
        "V1 1 0\nR1 1 2 5\nL1 2 0 1m\nL2 3 0 4m\nL3 4 0 9m\nK1 L1 L2 .9\nK2 L1 L3 .9\nK3 L2 L3 .9\nR2 3 0 75\nR3 4 0 9",
    ),
    "a coupling without a number": (
        "V1 1 0\nR1 1 2 5\nL1 2 0 1m\nL2 3 0 4m\nR2 3 0 75\nK L1 L2 K=.9",
        "V1 1 0\nR1 1 2 5\nL1 2 0 1m\nL2 3 0 4m\nK1 L1 L2 .9\nR2 3 0 75",
    ),
    "coils that are not coupled": (
        "V1 1 0\nR1 1 2 5\nL1 2 3 1m\nL2 3 0 4m\nK1 L1 L2 0",
        "V1 1 0\nR1 1 2 5\nL1 2 3 1m\nL2 3 0 4m",
    ),
    "wires": (
        "V1 1 0\nR1 1 2 50\nR2 2 3 0\nL2 3 4 0\nC1 4 0 1u\nRg 5 0 {3-3}\nL1 2 5 1m\nC9 2 0 0\nR7 2 4 7",
        "V1 1 0\nR1 1 2 50\nC1 2 0 1u\nL1 2 0 1m",
    ),
    "m in m": (
        "V1 1 0\n.subckt s a b\nC1 a b 2n m=2\nX1 a b t m=3\n.ends\n.subckt t a b\nR1 a b 30\n"
        ".ends\nL1 1 2 1m\nX1 2 0 s m=5",
        "V1 1 0\nL1 1 2 1m\nR2 2 0 2\nC2 2 0 20n",
    ),
    "pi": ("V1 1 0\nR1 1 2 {2*pi}\nL1 2 0 1m", "V1 1 0\nR1 1 2 6.283185307179586\nL1 2 0 1m"),
    "what no program computes": (
        ".param pulse1=PULSE(0 1 1n) x=3\nV1 1 0 {pulse1}\nR1 1 2 {x} tc1=1e-3 tol=5\nL1 2 0 1m ic=1 mfg=none\n"
        ".model d1 D(is=1e-15)\n.step param x 1 2 3\n.backanno\n.wave a.wav 16 44k v(2)\n.net v(2) Rout=50",
        "V1 1 0\nR1 1 2 3\nL1 2 0 1m",
    ),
}
FREQUENCIES = (2e4, 1.3e6)


@pytest.mark.parametrize("case", [*NETLISTS, *OTHERS])
def test_a_netlist_has_the_response_of_its_elements_written_out(case):
    lines, plain = ({name: pair[:2] for name, pair in NETLISTS.items()} | OTHERS)[case]
    for w in FREQUENCIES:
        expected = nodal(plain, w)
        scale = np.abs(expected).max()
        np.testing.assert_allclose(response(lines, w)[: len(expected)], expected, rtol=1e-11, atol=1e-12 * scale)


@pytest.mark.skipif(shutil.which("ngspice") is None, reason="ngspice is not installed")
@pytest.mark.parametrize("case", NETLISTS)
def test_ngspice_finds_the_same_response(case, tmp_path):
    lines, _, sources = NETLISTS[case]
    w = FREQUENCIES[1]
    expected = ngspice(lines, tmp_path, w, sources)
    np.testing.assert_allclose(response(lines, w), expected, rtol=1e-9, atol=1e-10 * np.abs(expected).max())


# --- random circuits ---------------------------------------------------------------------------------------------


def random_circuit(seed):
    """A random circuit written out, and the same in subcircuits whose values are parameters.

    A chain of parts from one of the nodes 1 to n to the next, and of parts from any of them to ground.  Coils at the
    nodes are coupled without leakage to others, behind which the next chain stands.
    """
    rng = np.random.default_rng(seed)
    plain, calls, cells = ["V1 1 0", "R0 1 2 3.5"], ["V1 1 0", "R0 1 2 3.5"], []
    node = 2
    for part in range(int(rng.integers(2, 5))):
        a, b, r, c, x = (round(10 ** rng.uniform(-1, 1), 4) for _ in range(5))
        k = float(rng.choice([1.0, -1.0, 0.7]))
        cells += [
            f".subckt s{part} in out params: a=1 b=1 x=1", ".param two={2*a}", "La in 0 {a}", "Lb m 0 'b'",
            f"K1 La Lb {{{k}*x/x}}", f"Xr m out r{part}", f".subckt r{part} p q",
            "R1 p q {x+two}", "C1 q 0 {1/(two*b)}", ".ends", ".ends",
        ]  # fmt: skip
        far = node + 1
        calls.append(f"X{part} {node} {far} s{part} a={a} x={{{x}}} b={b}")
        plain += [
            f"La{part} {node} 0 {a!r}", f"Lb{part} m{part} 0 {b!r}", f"K{part} La{part} Lb{part} {k!r}",
            f"R{part}x m{part} {far} {x + 2 * a!r}", f"C{part} {far} 0 {1 / (2 * a * b)!r}",
        ]  # fmt: skip
        branch = [f"Rz{part} {far} y{part} {r!r}", f"Cz{part} y{part} 0 {c!r}"]
        plain += branch
        calls += branch
        node = far
    return "\n".join(plain), "\n".join([*calls, *cells])


@SETTINGS
@given(st.integers(0, 10**6), st.floats(0.1, 10.0))
def test_random_circuits_in_subcircuits_are_those_written_out(seed, w):
    plain, nested = random_circuit(seed)
    expected = nodal(plain, w)
    for lines in (plain, nested):
        np.testing.assert_allclose(response(lines, w), expected, rtol=1e-9)


@SETTINGS
@given(st.integers(0, 10**6))
def test_coils_without_leakage_lose_nothing_and_store_what_they_take(seed):
    plain, _ = random_circuit(seed)
    lossless = "\n".join(line for line in plain.splitlines() if line[0] != "R" or line.startswith("R0 "))
    lossless = lossless.replace("R0 1 2 3.5", "Cs 1 2 3.5")
    system = phc.read_netlist(f"title\n{lossless}\n.end\n")
    assert system.is_lossless
    assert np.abs(system.poles().real).max() <= 1e-9 * max(1.0, np.abs(system.poles()).max())


@pytest.mark.parametrize("k", [0.0, 0.5, 1 - 1e-6, 1 - 1e-12, 1.0, -1.0])
def test_a_coupling_may_come_as_close_to_1_as_it_will(k):
    lines = f"V1 1 0\nR1 1 2 10\nL1 2 0 2\nL2 3 0 3\nK1 L1 L2 {k!r}\nR2 3 0 7"
    np.testing.assert_allclose(response(lines, 2.0), nodal(lines.replace("K1 L1 L2 0.0\n", ""), 2.0), rtol=1e-13)
    assert phc.read_netlist(f"t\n{lines}\n").nstates == (1 if abs(k) == 1 else 2)


# --- what is refused ---------------------------------------------------------------------------------------------


REFUSED = [
    (".include other.cir", "line 3.*no other file is opened"),
    (".LIB 'models.lib' tt", "line 3.*no other file is opened"),
    ("X1 1 0 other", "no subcircuit other"), (".subckt a 1 2", "line 3.*has no end"), (".ends", "ends no subcircuit"),
    (".subckt a 1 1\n.ends", "node is named twice"), (".subckt\n.ends", "needs a name"),
    (".subckt a p q\nR1 p q 1\n.ends\nX1 1 a", "line 6.*2 nodes, and X1 gives 1"),
    (".subckt a p q\nX1 p q a\n.ends\nX1 1 0 a", "calls itself"),
    (".subckt a p q\nR1 p q {r}\n.ends\nX1 1 0 a", "line 4.*'r' is neither a number nor a parameter"),
    (".subckt a p\n.ends\n.subckt A p\n.ends", "another subcircuit A"),
    (".subckt a p gnd\nR1 p gnd 1\n.ends\nX1 1 2 a", "node 0 of a is the same everywhere"),
    (".param a={b} b={a}\nR1 1 0 {a}", "follows from itself"), (".param a=1\n.param A=2", "set twice"),
    (".param a", "name=value"), (".func f(x) {2*x}", "func is not read"), (".if (1)", "if is not read"),
    ("R1 1 0 {1/0}", "cannot be computed: .*zero"), ("R1 1 0 {(-8)**(1/3)}", "cannot be computed"),
    ("R1 1 0 {2**3**2}", "parentheses"), ("R1 1 0 {9**999}", "cannot be computed"), ("R1 1 0 {1 +}", "no arithmetic"),
    ("R1 1 0 {2[0]}", "has '\\['"), ("R1 1 0 {1e400}", "finite"),
    ("R1 1 0 {" + "(" * 500 + "1" + ")" * 500 + "}", "no arithmetic"),
    ("R1 1 0 {" + "-" * 1500 + "1}", "no arithmetic"),
    ("R1 1 0 {" + "1+" * 1500 + "1}", "characters"), ("R1 1 0 4k7", "not a number"), ("R1 1 0 2*3", "in braces"),
    ("R1 1 0 -5", "must not be negative"), (".param c=-1n\nC1 1 0 {c}", "line 4.*must not be negative"),
    ("L5 1 0 {1m-2m}", "must not be negative"), ("C1 1 0 1e-320", "between"), ("R1 1 0 1e400", "between"),
    ("R1 1 0 50 ac=5", "ac=5 is not read"), ("L5 1 0 1m Rser=-1", "rser is -1"), ("L5 1 0 1m Rpar=0", "rpar is 0"),
    ("C1 1 0 Q=2*x", "is not read|and a value"), ("R1 1 0 5 m=0", "m is 0"), ("R1 1 0 r =", "no value"),
    ("R1 1 0 5 6", "'6'"),
    ("D1 1 0 d", "a diode"), ("Q1 1 0 2 npn", "transistor"), ("G1 1 0 1 0 5", "controlled source"),
    ("T1 1 0 2 0", "line"),
    ("B1 1 0 I=V(1)", "formula"), ("%1 1 0", "is no R, L"), ("K1 L1 L2 1.01", "between -1 and 1"),
    ("K1 L1", "two inductors"),
    ("L2 2 0 0\nK1 L1 L2 1", "L2 is 0 and coupled"), ("K1 L1 L7 1", "(?i)no inductor L7"),
    ("R1 2 0 1\nr1 2 0 1", "another r1"), ("C1 2 3 0\nR3 3 4 1", "3, 4 is not connected"),
    ("L2 2 0 1\nL3 3 0 1\nR3 3 0 1\nK1 L1 L2 1\nK2 L2 L3 1", "positive semidefinite"),
    ("L2 2 0 1\nK1 L1 L2 1\nV2 2 0", "V2, V1 are a loop"),
    ("L2 2 0 1\nK1 L1 L2 1\nC2 2 0 1", "C2, V1 are a loop of cap"),
    ("R9 1 0 0", "V1 is short-circuited"), ("E1 2 0 1 0 5\nR9 2 0 1", "no ideal transformers"),
]  # fmt: skip


@pytest.mark.parametrize(("lines", "reason"), REFUSED)
def test_what_has_no_meaning_is_refused_with_a_reason(lines, reason):
    with pytest.raises(phc.StructureError, match=f"(?s){reason}"):
        phc.read_netlist(f"title\nV1 1 0\n{lines}\nL1 1 0 1\n")


def test_subcircuits_that_double_without_end_are_stopped():
    doubling = "\n".join(f".subckt s{k} a\nX1 a s{k + 1}\nX2 a s{k + 1}\n.ends" for k in range(30))
    with pytest.raises(phc.FileFormatError, match="over 100000 elements"):
        phc.read_netlist(f"t\nV1 1 0\nL1 1 0 1\n{doubling}\n.subckt s30 a\n.ends\nX1 1 s0\n")


def test_a_file_of_subcircuits_alone_says_what_to_add():
    with pytest.raises(phc.FileFormatError, match="calls none; add a source and a line such as 'X1 1 0 coil'"):
        phc.read_netlist("t\n.subckt coil a b\nL1 a b 1m\n.ends\n")


def test_no_other_file_is_opened(tmp_path):
    (tmp_path / "other.cir").write_text("R1 1 0 50\n")
    path = tmp_path / "a.cir"
    path.write_text(f"t\nV1 1 0\n.include {tmp_path / 'other.cir'}\nL1 1 0 1\n")
    with pytest.raises(phc.FileFormatError, match="no other file is opened"):
        phc.read_netlist(path)


def test_a_title_may_begin_like_an_element():
    for title in ("X-tal filter", "R", "Resonant tank {50}", "Kit 4", "LC low pass of order 3", "D1 in out bridge"):
        assert phc.read_netlist(f"{title}\nV1 1 0\nL1 1 0 1\n").nstates == 1


def test_labels_have_the_path_of_elements_in_subcircuits():
    text = "t\nV1 1 0\n.subckt a p\nX2 p b\n.ends\n.subckt b p\nL1 p 0 1 Cpar=1\nI3 0 p\n.ends\nR1 1 2 1\nX1 2 a\n"
    system = phc.read_netlist(text)
    assert system.state_labels == ["q_Cpar_L_X1_X2_L1", "phi_L_X1_X2_L1"]
    assert system.input_labels == ["v_V1", "i_I_X1_X2_I3"]


def test_a_node_inside_is_reached_by_its_path():
    lines = "V1 1 0\n.subckt s a\nR1 a m 2\nL1 m 0 3\n.ends\nX1 1 s\nIout 0 X1.m"
    plain = "V1 1 0\nR1 1 m 2\nL1 m 0 3\nIout 0 m"
    np.testing.assert_allclose(response(lines, 0.7), nodal(plain, 0.7), rtol=1e-14)


def test_a_line_of_many_sections_has_the_admittance_of_its_continued_fraction():
    n = 300
    lines = [f"R{k} n{k} m{k} 1m\nL{k} m{k} n{k + 1} 1u\nC{k} n{k + 1} 0 1n" for k in range(n)]
    text = "\n".join(["t", "V1 n0 0", *lines, f"Rl n{n} 0 50"])
    system = phc.read_netlist(text)
    s, admittance = 1e6j, 1 / 50
    for _ in range(n):
        admittance = 1 / (1e-3 + s * 1e-6 + 1 / (admittance + s * 1e-9))
    G = system.C @ np.linalg.solve(s * np.eye(2 * n) - system.A, system.B) + system.D
    np.testing.assert_allclose(G, admittance, rtol=1e-9)
