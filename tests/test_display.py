"""What objects print and show in notebooks: text that evaluates back, and HTML that is well-formed and safe."""

from __future__ import annotations

import functools
import html
import xml.etree.ElementTree as ElementTree

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ph_control as phc

SETTINGS = settings(max_examples=30, deadline=None)

NASTY = ["a<b>", "R&D", "$x$ and $y$", 'say "yes"', "it's", "</div><script>", "κ &amp; \\(r\\)"]

positive = st.floats(1e-150, 1e150)
names = st.text(
    st.characters(codec="utf-8", exclude_categories=("C",), exclude_characters="."), min_size=1, max_size=12
)


def evaluated(text):
    """What a user gets who pastes a printed object."""
    words: dict[str, object] = {}
    exec("from ph_control import *\nfrom numpy import array", words)
    return eval(text, words)


def parsed(document):
    """Elements of an HTML fragment; an error if it is not well-formed."""
    return ElementTree.fromstring(f"<div>{document}</div>")


def text_of(document):
    return "".join(parsed(document).itertext())


@functools.cache
def chain():
    return phc.frenkel_kontorova(name="chain")


@functools.cache
def two_ports():
    nu = np.array([[1.0 + 2.0j, 0.5], [0.25, -1.0j]])
    return phc.ModalForm(np.array([1.0, 3.0]), nu, np.zeros((0, 2)))


@functools.cache
def record():
    rng = np.random.default_rng(0)
    t, u = 0.1 * np.arange(300), rng.standard_normal(300)
    y = phc.forced_response(chain(), t, u, intersample="zoh").outputs + 0.01 * rng.standard_normal(300)
    return ct.TimeResponseData(
        t, y, inputs=u, input_labels=["force <F> & $more$"], output_labels=["v</pre>"], issiso=True
    )


@functools.cache
def fitted():
    return phc.pem(record(), 2)


RESULTS = {
    "PEMResult": fitted,
    "FittedExperiment": lambda: fitted().experiments[0],
    "Comparison": lambda: phc.compare(record(), chain(), labels=["<chain> & $co$"]),
    "ResidualAnalysis": lambda: phc.residual_analysis(record(), fitted()),
    "OrderSelection": lambda: phc.order_selection(record(), 2),
    "Excitation": lambda: phc.excitation(record(), 2),
    "PlantExcitation": lambda: phc.excitation(record(), phc.modes([1.0, 2.0], [1.0, 0.5], damping=0.02)),
    "InputDesign": lambda: phc.design_input(fitted(), 100, 0.1, peak=1.0, for_="natural_frequencies"),
    "EnergyBalance": lambda: phc.energy_balance(phc.forced_response(chain(), record().time, 1.0), chain()),
    "GradientResult": lambda: phc.gradient_descent(record(), 1, epochs=2, rng=0),
}


# --- text that evaluates back ----------------------------------------------------------------------------------------


@SETTINGS
@given(st.lists(st.tuples(positive, positive), max_size=5))
def test_the_printed_modal_form_evaluates_to_the_same_modes(pairs):
    d, r = np.array(pairs).reshape(-1, 2).T
    try:
        modes = phc.modes(d, r)
    except phc.StructureError:
        return
    assert repr(modes).startswith("modes(")
    twin = evaluated(repr(modes))
    for name in ("d", "r", "nu", "rigid"):
        one, other = getattr(twin, name), getattr(modes, name)
        assert one.dtype == other.dtype and np.array_equal(one, other)


@SETTINGS
@given(st.integers(0, 3), st.integers(1, 3), st.integers(0, 1), st.integers(0, 2**32))
def test_the_printed_modal_form_of_any_shape_evaluates_to_the_same(n, ports, rigid, seed):
    rng = np.random.default_rng(seed)
    nu = rng.standard_normal((n, ports)) + 1j * rng.standard_normal((n, ports))
    modes = phc.ModalForm(np.sort(rng.uniform(0.1, 9.0, n)), nu, rng.standard_normal((rigid, ports)))
    twin = evaluated(repr(modes))
    for name in ("d", "r", "nu", "rigid"):
        assert np.array_equal(getattr(twin, name), getattr(modes, name))
        assert getattr(twin, name).shape == getattr(modes, name).shape


def test_weights_that_are_not_the_squares_of_their_roots_are_printed_as_well():
    modes = phc.ModalForm(np.array([1.0]), np.array([[0.6 + 0.8j]]), np.zeros((0, 1)), np.array([1.0 + 1e-15]))
    assert evaluated(repr(modes)).r.tolist() == modes.r.tolist()


PARTS = {
    "R": np.diag([0.0, 1.0 / 3.0]), "P": [[0.0], [0.1]], "S": [[1.0]], "N": [[0.0]], "J": [[0.0, 2.0], [-2.0, 0.0]],
    "sensors": ([[1.0, 0.0], [0.1, 0.7]], [[0.0], [0.3]]),
}  # fmt: skip


@pytest.mark.parametrize(
    "names", ["R", "RPS", "RJ", "S", "R sensors", "sensors", "J sensors", "RPSNJ sensors"], ids=lambda text: text
)
@pytest.mark.parametrize("labels", [{}, {"name": "plant", "inputs": ["F"], "states": ["q", "p's"]}])
def test_the_printed_system_with_losses_evaluates_to_the_same(names, labels):
    letters, _, sensors = names.partition(" ") if names != "sensors" else ("", "", "sensors")
    parts = {name: PARTS[name] for name in [*letters, *([sensors] if sensors else [])]}
    system = phc.ph(np.diag([4.0, 0.1]), [[0.2], [1.0]], **parts, **labels)
    again = evaluated(repr(system))
    assert type(again) is type(system) is phc.DissipativePortHamiltonian
    for name in "QGJRPSNABCD":
        assert np.array_equal(getattr(again, name), getattr(system, name))
    assert again.input_labels == system.input_labels and again.state_labels == system.state_labels
    if labels:
        assert again.name == system.name
    formula = system._repr_latex_()
    assert all((rf"\quad {name} = \begin" in formula) == (name in letters and name != "N") for name in "RPSNJ")
    assert ("C_s" in formula) == bool(sensors) and ("(J - R)" in formula) == ("R" in letters)
    shown = text_of(system._repr_html_())
    assert "begin{bmatrix}" in shown and "damping ratio" in shown


def test_a_system_with_losses_of_which_none_is_there_evaluates_to_the_same():
    closed = ct.feedback(phc.DissipativePortHamiltonian(np.eye(2), [0.0, 1.0]), 0.5)
    assert np.array_equal(evaluated(repr(closed)).A, closed.A)
    none = phc.DissipativePortHamiltonian(np.eye(2), [0.0, 1.0])
    assert type(evaluated(repr(none))) is type(none)


@pytest.mark.slow
@SETTINGS
@given(names, names, names, st.integers(0, 2**32))
def test_the_printed_system_evaluates_to_the_same_with_any_names(name, source, sink, seed):
    rng = np.random.default_rng(seed)
    v, d = rng.standard_normal(4), np.sort(rng.uniform(0.5, 5.0, 2))
    given_names = {"name": name, "inputs": source, "outputs": sink}
    X = rng.standard_normal((4, 4))
    systems = [
        phc.ph(X @ X.T + np.eye(4), v, **given_names), phc.ph(phc.modes(d, v[:2] ** 2), **given_names),
        phc.ch(d, v, **given_names), phc.oh(d, v, **given_names), phc.affine(X @ X.T + np.eye(4), v, **given_names),
    ]  # fmt: skip
    for sys in systems:
        twin = evaluated(repr(sys))
        assert type(twin) is type(sys)
        for matrix in "ABC":
            assert np.array_equal(getattr(twin, matrix), getattr(sys, matrix))
        assert (twin.name, twin.input_labels, twin.output_labels) == (name, [source], [sink])
        assert np.array_equal(twin.modes.d, sys.modes.d) and np.array_equal(twin.modes.nu, sys.modes.nu)


@pytest.mark.parametrize("count", [1000, 1001])
def test_large_systems_are_abbreviated_with_their_size_and_never_evaluate_to_a_smaller_one(count):
    modes = phc.modes(np.arange(1.0, count + 1), np.ones(count))
    form = phc.oh(modes.d[: count // 2], np.ones(2 * (count // 2)))
    for shown in (modes, phc.ph(modes), form if count == 1000 else phc.oh(modes.d, np.ones(2 * count))):
        text = repr(shown)
        if count == 1000:
            assert np.array_equal(evaluated(text).d, shown.d)
        else:
            assert "..." in text
            assert f"shape=({count},)" in text and len(text) < 1000
            with pytest.raises((TypeError, phc.StructureError)):
                evaluated(text)


# --- HTML ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("nasty", NASTY)
@pytest.mark.parametrize("make", [phc.ch, phc.oh, lambda d, v, **k: phc.ph(phc.modes(d, [1.0]), **k), "affine"])
def test_names_are_read_in_a_notebook_as_they_are(nasty, make):
    make = (lambda d, v, **k: phc.affine(np.eye(2), v, **k)) if make == "affine" else make
    sys = make([1.0], [1.0, 0.5], name=nasty.replace(".", ""), inputs=nasty + "u", outputs=nasty + "y")
    for document in (sys._repr_html_(), sys._repr_markdown_()):
        assert sys._repr_info_() in text_of(document)
        assert "<script" not in document and nasty + "u" not in document.replace("it's", "")
        # dollar signs are those of the one formula, all others text that no typesetter looks at
        assert document.count("$") == 4
        outside = [e for e in parsed(document) if "mathjax_ignore" not in e.get("class", "")]
        assert outside == []


def test_python_control_leaves_an_ampersand_as_it_is():
    with pytest.raises(ElementTree.ParseError):
        parsed(ct.ss(chain(), name="R&D")._repr_html_())


@pytest.mark.parametrize(
    "make", [lambda: chain(), lambda: phc.ch(chain()), lambda: phc.oh(chain()), lambda: chain().modes, two_ports]
)
def test_the_numbers_of_a_notebook_are_those_of_the_object(make):
    shown = make()
    modes = getattr(shown, "modes", shown)
    rows = [[cell.text or "" for cell in row] for row in parsed(shown._repr_html_()).iter("tr")]
    m = modes.nports
    assert rows[0][:2] == ["mode", "d"] and len(rows) == 1 + len(modes.d)
    for l, row in enumerate(rows[1:]):
        assert row[0] == str(l + 1)
        numbers = np.concatenate([[modes.d[l]], np.reshape(modes.r, (-1, m))[l], np.reshape(modes.kappa, (-1, m))[l]])
        assert np.allclose([float(text) for text in row[1:]], numbers, rtol=1e-6, atol=0)
    formula = text_of(shown._repr_html_())
    assert formula.count("$$") == 2 and shown._repr_latex_() in formula


def matrix(*rows):
    return r"\begin{bmatrix}" + r" \\ ".join(rows) + r"\end{bmatrix}"


def test_the_formula_of_a_system_holds_its_matrices():
    formula = chain()._repr_latex_()
    rows = "2 & -1 & 0 & 0", "-1 & 1 & 0 & 0", "0 & 0 & 1 & 0", "0 & 0 & 0 & 1"
    assert rf"Q = {matrix(*rows)}" in formula and rf"B = {matrix('0', '0', '1', '0')}" in formula
    A = matrix("0 & 1 & 0 & 0", "0 & 0 & 1 & 0", "0 & 0 & 0 & 1", "-1 & 0 & -3 & 0")
    assert f"{A} x + {matrix('0', '0', '0', '1')} u" in phc.ch(chain())._repr_latex_()


def test_a_large_system_shows_its_first_and_last_modes_and_builds_no_matrix():
    sys = phc.ph(phc.modes(np.arange(1.0, 20_001.0), np.ones(20_000)), states=40_000)
    rows = [[cell.text for cell in row] for row in parsed(sys._repr_html_()).iter("tr")]
    assert [row[0] for row in rows[1:]] == ["1", "2", "3", "4", "5", "6", "⋮", *(str(k) for k in range(19_995, 20_001))]
    assert "20000 modes" in text_of(sys._repr_html_()) and "$$" not in sys._repr_html_()
    assert sys._repr_latex_() is None and not sys._views
    assert r"\sum_{l=1}^{20000}" in sys.modes._repr_latex_()


def test_to_look_at_a_large_system_does_not_compute_its_modes():
    sys = phc.ph(np.eye(202), np.ones(202), name="large")
    assert "101 degrees of freedom" in text_of(sys._repr_html_()) and sys._modes is None
    assert len(sys.modes.d) and "1 mode" in text_of(phc.ph(np.eye(2), [0.0, 1.0])._repr_html_())
    assert list(parsed(sys._repr_html_()).iter("tr"))


def test_to_print_a_large_system_builds_no_matrix():
    modes = phc.modes(np.arange(1.0, 40_001.0), np.ones(40_000))
    for sys in (phc.ph(modes, name="large"), phc.oh(modes.d, np.ones(80_000), name="large")):
        text = str(sys)
        assert text.splitlines()[0] == f"<{type(sys).__name__}>: large" and "States (80000)" in text
        assert "\n\nd = [1.0000e+00 2.0000e+00 3.0000e+00 ... " in text and len(text) < 400
        assert not set(sys._views) & {"A", "B", "C", "Q"}
    unknown = phc.ph(np.eye(202), np.ones(202))
    assert str(unknown).endswith("States (202)") and unknown._modes is None
    assert "A = [[" in str(phc.ph(np.eye(200), np.ones(200)))


def test_the_size_and_the_format_of_formulas_are_those_of_python_control():
    numbers = phc.ph(np.diag([np.pi, 1.0]), [0.0, -2.5e-17])
    with ct.config.defaults({"statesp.latex_maxsize": 4, "statesp.latex_num_format": ".5g"}):
        assert chain()._repr_latex_() is None
        assert matrix("3.1416 & 0", "0 & 1") in numbers._repr_latex_()
    assert matrix("3.14 & 0", "0 & 1") in numbers._repr_latex_()
    assert matrix("0", r"-2.5\cdot 10^{-17}") in numbers._repr_latex_()
    assert chain()._repr_latex_() is not None


def test_a_free_mass_has_a_row_and_a_term_of_its_own():
    modes = phc.ph(np.diag([0.0, 4.0, 1.0, 1.0]), [0.0, 0.0, 1.0, 0.5]).modes
    assert modes._repr_latex_().startswith(r"$$" r"G(s) = \frac{1}{s} + \frac{")
    rows = [[cell.text for cell in row] for row in parsed(modes._repr_html_()).iter("tr")]
    assert rows[1] == ["free", "0", None, "1"] and len(rows) == 3
    assert phc.ModalForm(np.zeros(0), np.zeros((0, 1)), np.zeros((0, 1)))._repr_latex_() == "$$G(s) = 0$$"


def test_the_formula_of_several_ports_is_their_response():
    modes, s = two_ports(), 0.3 + 0.7j
    K = modes.d[:, None, None] * modes.nu.conj()[:, :, None] * modes.nu[:, None, :]
    terms = (K.real * s + K.imag * modes.d[:, None, None]) / (s**2 + modes.d[:, None, None] ** 2)
    assert np.allclose(terms.sum(axis=0), phc.ph(modes)(s), rtol=1e-12)
    assert r"\frac{\mathrm{Re} K_l s + \mathrm{Im} K_l d_l}{s^2 + d_l^2}" in modes._repr_latex_()


# --- results ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", RESULTS)
def test_a_result_is_one_line_in_a_list_and_a_report_where_it_is_printed(name):
    result = RESULTS[name]()
    text = repr(result)
    assert text.startswith(f"<{name}: ") and text.endswith(">")
    assert len(text) < 200 and "\n" not in text
    assert len(str(result)) > 20 and str(result) != text
    document = result._repr_html_()
    read = " ".join(text_of(document).split())
    assert "<script" not in document and "$" not in document
    for word in str(result).split():
        # the summary of a fit has its table as a table
        assert word in read or name == "PEMResult"


def test_the_line_of_a_fit_says_its_order_its_fit_and_the_verdict():
    assert repr(fitted()) == f"<PEMResult: 2 modes, lossless, fit {fitted().fit_percent:.2f} %, {fitted().verdict}>"
    assert str(fitted()) == fitted().summary()
    comparison = RESULTS["Comparison"]()
    assert repr(comparison) == f"<Comparison: fit to 'v</pre>': <chain> & $co$ {comparison.fit_percent[0]:.2f} %>"
    assert repr(RESULTS["OrderSelection"]()) == "<OrderSelection: orders 0 to 2, BIC chooses 2>"


def test_the_notebook_shows_the_modes_of_a_fit_with_their_errors():
    rows = [[cell.text for cell in row] for row in parsed(fitted()._repr_html_()).iter("tr")]
    assert rows[0] == ["mode", "f [1/time]", "±", "damping [%]", "±", "|residue|", "±", "phase [deg]"]
    for l, row in enumerate(rows[1:]):
        values = fitted().d[l] / (2 * np.pi), 0.0, 0.5 * fitted().kappa[l]
        errors = fitted().stderr["d"][l] / (2 * np.pi), 0.0, 0.5 * fitted().stderr["kappa"][l]
        assert np.allclose([float(row[k]) for k in (2, 4, 6)], errors, rtol=0.05)
        assert np.allclose([float(row[k]) for k in (1, 3, 5)], values, rtol=1e-7, atol=0.05 * max(errors))
    read = text_of(fitted()._repr_html_())
    assert fitted().message in read and "force <F> & $more$" in read and html.unescape(read) == read


def test_a_record_is_shown_by_its_size_and_not_by_its_numbers():
    u = np.random.default_rng(0).standard_normal(400)
    plant = phc.frenkel_kontorova()
    fit = phc.pem((u, phc.forced_response(plant, 0.1 * np.arange(400), u, intersample="zoh").outputs), 2, dt=0.1)
    assert repr(fit.record) == "<Record: 400 samples, step 0.1, 'y' from 'u'>"
    free = phc.pem((None, phc.initial_response(plant, 0.1 * np.arange(400), [1.0, 0, 0, 0.5]).outputs), 2, dt=0.1)
    assert repr(free.record) == "<Record: 400 samples, step 0.1, 'y'>"
    omega = np.linspace(0.105, 2.0, 50)
    response = phc.pem(ct.frd(plant.modes.freqresp(omega), omega, smooth=False), 2)
    assert repr(response.record) == "<FrequencyRecord: 50 frequencies, 'y[0]' from 'u[0]'>"


def test_a_summary_writes_a_frequency_to_its_error_however_many_digits_that_takes():
    rng, s = np.random.default_rng(0), 2j * np.pi * (1e7 + np.linspace(-500.0, 500.0, 101))
    admittance = 1 / (15 + 12.7e-3 * s + 12.7e-3 * (2e7 * np.pi) ** 2 / s)  # a quartz at 10 MHz
    data = ct.frd(admittance + 1e-5 * (rng.standard_normal(101) + 1j * rng.standard_normal(101)), s.imag)
    data.time_unit = "s"
    result = phc.pem(data, 1, ports=[(0, 0)])
    (found,), (error,) = result.hertz, result.stderr["hertz"]
    digits = 1 - int(np.floor(np.log10(error)))
    assert digits >= 3
    assert f" {found:.{digits}f} {error:.{digits}f} " in result.summary()
