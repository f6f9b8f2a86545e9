"""Stability margins: exact for lossless loops, those of python-control for all others."""

import control as ct
import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ph_control as phc
from ph_control import margin, stability_margins
from ph_control.analysis.margins import gain_crossings

EPS = np.finfo(float).eps
quick = settings(deadline=None, max_examples=15, derandomize=True)
frequencies = st.lists(st.floats(0.01, 1000.0), min_size=1, max_size=8, unique_by=lambda d: round(np.log(d), 3))


def weights(d, seed):
    return 10 ** np.random.default_rng(seed).uniform(-4, 2, len(d))


def every_form():
    chain = phc.frenkel_kontorova(3)
    return {
        "PH": chain, "modes": chain.modes, "CH": phc.ch(chain), "OH": phc.oh(chain),
        "StateSpace": ct.ss(chain), "TransferFunction": ct.tf(chain),
    }  # fmt: skip


# --- the answers ---


@pytest.mark.parametrize("form", list(every_form()))
def test_a_lossless_loop_has_infinite_gain_margin_and_90_degrees_in_every_form(form):
    gm, pm, wcg, wcp = margin(every_form()[form])
    assert (gm, pm) == (np.inf, 90.0)
    assert np.isnan(wcg)
    chain = phc.frenkel_kontorova(3)
    np.testing.assert_allclose(chain(1j * wcp), -1j, rtol=1e-9)


def test_python_control_alone_finds_a_gain_margin_of_nothing_for_the_same_loop():
    """What these functions are for: were it no longer so, they could go."""
    assert ct.margin(phc.frenkel_kontorova())[0] < 1e-6


@quick
@given(frequencies, st.integers(0, 2**32 - 1), st.floats(1e-3, 1e3))
def test_unity_feedback_around_a_lossless_loop_is_stable_for_every_gain(d, seed, gain):
    loop = phc.ph(phc.modes(d, np.random.default_rng(seed).uniform(0.1, 1.0, len(d))))
    assert margin(gain * loop)[0] == np.inf
    closed = np.linalg.eigvals(loop.A - gain * loop.B @ loop.C)
    assert closed.real.max() < 100 * len(d) * EPS * np.abs(closed).max()


@quick
@given(frequencies, st.integers(0, 2**32 - 1), st.booleans())
def test_the_gain_is_one_at_every_crossing_and_none_is_missing(d, seed, free):
    modes = phc.modes(d, weights(d, seed))
    if free:
        modes = (phc.ph(modes) + phc.ph(phc.minreal(phc.spring_chain([1.0]))) * 0.3).modes
    omega, pm = gain_crossings(modes.minimal())
    assert len(omega) == 2 * len(d) + free
    assert np.all(np.diff(omega) >= 0)
    assert np.all(np.abs(pm) == 90.0)
    # one for each sign between two poles: the count above says that none is missing
    places = np.searchsorted(modes.d, omega)
    counts = np.array([[np.sum((places == k) & (pm == sign)) for sign in (-90.0, 90.0)] for k in range(len(d) + 1)])
    expected = np.ones((len(d) + 1, 2), int)
    expected[-1, 0], expected[0, 1] = 0, int(free)
    np.testing.assert_array_equal(counts, expected)


@quick
@given(frequencies, st.integers(0, 2**32 - 1))
def test_crossings_agree_with_mpmath(d, seed):
    modes = phc.modes(d, weights(d, seed))
    omega, pm = gain_crossings(modes)
    with mpmath.workdps(40):
        a, k = ([mpmath.mpf(x) for x in column] for column in (modes.d, modes.r))
        for w, sign in zip(omega, -pm / 90, strict=True):
            x = mpmath.mpf(w)
            value = sum(r * b * x / (b**2 - x**2) for b, r in zip(a, k, strict=True)) - sign
            slope = sum(r * b * (b**2 + x**2) / (b**2 - x**2) ** 2 for b, r in zip(a, k, strict=True))
            # a Newton step to the crossing
            assert abs(value / slope) <= (len(d) + 4) * EPS * w


def test_the_phase_margin_counts_as_python_control_counts_it():
    omega, pm = gain_crossings(phc.modes(1.0, 1.0))
    G = phc.modes(1.0, 1.0).freqresp(omega)
    np.testing.assert_allclose(np.remainder(np.angle(G, deg=True), 360.0) - 180.0, pm, atol=1e-9)
    golden = (1 + np.sqrt(5)) / 2
    np.testing.assert_allclose(omega, [1 / golden, golden], rtol=4 * EPS)


def test_the_nyquist_plot_comes_closest_to_minus_one_at_the_zeros():
    chain = phc.frenkel_kontorova(4)
    gm, pm, sm, wpc, wgc, wms = stability_margins(chain, returnall=True)
    zeros = chain.zeros().imag
    np.testing.assert_array_equal(wms, zeros[zeros > 0])
    np.testing.assert_array_equal(sm, np.ones(3))
    assert (len(gm), len(wpc), len(pm), len(wgc)) == (0, 0, 8, 8)
    distance = np.abs(1 + chain(1j * np.geomspace(1e-3, 1e3, 2000)))
    assert distance.min() >= 1.0


def test_without_a_positive_zero_the_least_distance_is_that_at_an_end_of_the_axis():
    assert stability_margins(phc.modes(1.0, 1.0))[2::3] == (1.0, 0.0)
    assert stability_margins(ct.tf([2.0], [1.0, 0.0]))[2::3] == (1.0, np.inf)


@pytest.mark.parametrize("method", [np.array(["best", "frd"]), 3, None])
def test_an_unknown_method_is_an_error(method):
    with pytest.raises(phc.StructureError, match="method is"):
        stability_margins(phc.modes(1.0, 1.0), method=method)


def test_an_integrator_crosses_once():
    np.testing.assert_allclose(margin(ct.tf([2.0], [1.0, 0.0])), (np.inf, 90.0, np.nan, 2.0), rtol=4 * EPS)


def test_a_loop_that_does_not_respond_has_no_margin_to_lose():
    gm, pm, sm, wpc, wgc, wms = stability_margins(phc.modes([1.0, 2.0], [0.0, 0.0]))
    assert (gm, pm, sm, wms) == (np.inf, np.inf, 1.0, 0.0)
    assert np.isnan([wpc, wgc]).all()


def test_modes_that_the_port_does_not_reach_do_not_count():
    hidden = phc.modes([1.0, 2.0, 3.0], [1.0, 0.0, 1.0])
    np.testing.assert_array_equal(gain_crossings(hidden.minimal())[0], gain_crossings(phc.modes([1, 3], [1, 1]))[0])
    for form in (hidden, phc.ph(hidden)):
        found, expected = (stability_margins(loop, returnall=True) for loop in (form, phc.modes([1, 3], [1, 1])))
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_array_equal(one, other)


def test_crossings_below_a_frequency_can_be_left_out():
    full = stability_margins(phc.frenkel_kontorova(), returnall=True)
    part = stability_margins(phc.frenkel_kontorova(), returnall=True, epsw=0.7)
    np.testing.assert_array_equal(part[4], full[4][full[4] > 0.7])
    assert part[5].tolist() == full[5].tolist()
    assert 0 < len(part[4]) < len(full[4])


def test_crossings_closer_to_a_pole_than_a_double_are_at_it():
    omega, pm = gain_crossings(phc.modes([1.0, 2.0], [1e-30, 1e-30]))
    np.testing.assert_allclose(omega, [1.0, 1.0, 2.0, 2.0], rtol=2 * EPS)
    assert pm.tolist() == [-90.0, 90.0, -90.0, 90.0]


@pytest.mark.parametrize("scale", [1e-150, 1e-30, 1e30, 1e150])
def test_the_unit_of_time_does_not_matter(scale):
    plain = gain_crossings(phc.modes([1.0, 3.0], [1.0, 0.5]))[0]
    # kappa = r d scales with d
    np.testing.assert_allclose(
        gain_crossings(phc.modes([scale, 3.0 * scale], [1.0, 0.5]))[0], scale * plain, rtol=8 * EPS
    )


# --- what is left to python-control ---


@pytest.mark.parametrize(
    "loop",
    [
        ct.tf(1, [1, 2, 1, 0]),
        ct.tf([1, 0], [1, 0.1, 1]),
        ct.ss(ct.tf([2], [1, 3, 3, 1])),
        ct.tf([0.5], [1, -0.8], 0.1),
        phc.frenkel_kontorova() * ct.tf([1], [1, 1]),
        phc.affine(np.diag([4.0, 1.0]), [0.0, 1.0]),
        ct.frd([1.0, -2.0, -0.5], [1.0, 2.0, 3.0]),
    ],
    ids=["lag", "damped", "ss", "discrete", "series", "affine", "frd"],
)
@pytest.mark.filterwarnings("ignore")
def test_every_other_loop_has_the_margins_of_python_control(loop):
    np.testing.assert_array_equal(margin(loop), ct.margin(loop))
    np.testing.assert_array_equal(stability_margins(loop), ct.stability_margins(loop))


def test_a_frequency_response_has_the_margins_of_python_control():
    w = np.geomspace(0.1, 10.0, 50)
    mag, phase, _ = ct.frequency_response(ct.tf(1, [1, 2, 1, 0]), w)
    np.testing.assert_array_equal(margin(mag, np.degrees(phase), w), ct.margin(mag, np.degrees(phase), w))


def test_a_method_of_python_control_is_used_where_it_is_asked_for():
    chain = phc.frenkel_kontorova()
    assert stability_margins(chain, method="poly") == pytest.approx(ct.stability_margins(chain, method="poly"))
    with pytest.raises(phc.StructureError, match="method is"):
        stability_margins(chain, method="guess")


def test_several_ports_have_no_margins():
    with pytest.raises(ct.ControlMIMONotImplemented):
        margin(ct.ss(phc.spring_chain([1.0, 2.0], 1.0, ground=1.0, port=[0, 1])))


def infinite(kind):
    if kind == "state space":
        loop = ct.ss([[1.0, 2.0], [3.0, 4.0]], [[1.0], [1.0]], [[1.0, 0.0]], 0)
        loop.A = np.array([[np.inf, 0.0], [0.0, 1.0]])
    else:
        loop = ct.tf([1.0], [1.0, 1.0])
        loop.den_array[0, 0] = np.array([np.inf, 1.0])
    return loop


@pytest.mark.parametrize("call", [margin, stability_margins, lambda loop: stability_margins(loop, method="poly")])
@pytest.mark.parametrize("kind", ["state space", "transfer function"])
def test_a_loop_that_is_not_finite_is_refused_instead_of_searched_without_end(call, kind):
    with pytest.raises(phc.StructureError, match="a number of the loop is not finite"):
        call(infinite(kind))


@pytest.mark.parametrize("call", [margin, stability_margins])
@pytest.mark.parametrize("loop", ["loop", None, (1, 2, 3)], ids=str)
def test_what_is_no_loop_is_refused_without_a_print(call, loop, capsys):
    with pytest.raises(ValueError, match="Margin sysdata must be"):
        call(loop)
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("loop", ["x", np.array([1j]), [[1.0], [1.0, 2.0]], 10**400, None], ids=repr)
def test_what_is_no_loop_is_refused_by_name(loop):
    for ask in (phc.margin, phc.stability_margins):
        with pytest.raises(phc.StructureError, match=r"python-control has no margins|not finite"):
            ask(loop)


@pytest.mark.parametrize("epsw", ["a", np.ones(2), [], np.nan])
def test_a_least_frequency_that_is_no_number_is_refused(epsw):
    with pytest.raises(phc.StructureError, match="epsw"):
        phc.stability_margins(phc.frenkel_kontorova(), epsw=epsw)


@pytest.mark.parametrize("returnall", [np.zeros(0), np.ones(2), "x", None])
def test_a_flag_that_is_none_is_refused(returnall):
    with pytest.raises(phc.StructureError, match="returnall is"):
        phc.stability_margins(phc.frenkel_kontorova(), returnall)
