"""What is defined for lossless systems only says so of a system with losses, and what to take instead."""

from __future__ import annotations

import pickle

import control as ct
import matplotlib.pyplot as plt
import numpy as np
import pytest

import ph_control as phc

J = np.array([[0.0, 2.0], [-2.0, 0.0]])


def one_port():
    return phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0], R=np.diag([0.0, 0.1]), name="plant")


REFUSED = {
    "d": lambda s: s.d, "r": lambda s: s.r, "v": lambda s: s.v, "is_canonical": lambda s: s.is_canonical,
    "rigid_modes": lambda s: s.rigid_modes, "controllable_form": lambda s: s.controllable_form(),
    "observable_form": lambda s: s.observable_form(), "ch": phc.ch, "oh": phc.oh,
    "affine": lambda s: phc.affine(s if s.name == "plant" else phc.affine(s.Q, s.B)),
    "lift": lambda s: phc.lift(s, 3), "minreal with rtol": lambda s: phc.minreal(s, rtol=1e-9),
    "kalman_decomposition": phc.kalman_decomposition, "canonical_margins": phc.canonical_margins,
    "same_filter": lambda s: phc.same_filter(s, s),
    "same_filter, right": lambda s: phc.same_filter(phc.frenkel_kontorova(1), s),
    "groupoid": lambda s: phc.PortHamiltonianGroupoid(np.eye(2), s), "identity": phc.PortHamiltonianGroupoid.identity,
    "observable_morphism": phc.observable_morphism, "lift_morphism": lambda s: phc.lift_morphism(s, 3),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_needs_a_lossless_system_says_so_and_names_the_lossless_part(name):
    with pytest.raises(phc.NotLosslessError) as refusal:
        REFUSED[name](one_port())
    text = str(refusal.value)
    assert "defined for lossless systems" in text and "'plant' has losses R" in text and "lossless_part()" in text
    assert "no port-Hamiltonian form" not in text
    # and what it names can be had
    REFUSED[name](one_port().lossless_part())
    plt.close("all")


@pytest.mark.parametrize("name", ["d", "r", "nu", "rigid", "kappa", "kappa_0", "minimal", "coefficients"])
def test_modes_with_damping_say_what_they_have_in_place_of_frequencies_and_weights(name):
    with pytest.raises(phc.NotLosslessError, match=r"damping ratios 0\.025, .*all modes have natural_frequencies"):
        value = getattr(one_port().modes, name)
        value()


@pytest.mark.parametrize(
    ("parts", "what"),
    [
        ({"R": np.diag([0.0, 0.1])}, "losses R;"),
        ({"R": np.diag([0.0, 1.0]), "P": [0.0, 0.5], "S": [[1.0]]}, "losses R, losses P, feedthrough S;"),
        ({"N": np.zeros((1, 1)), "sensors": np.eye(2)}, "2 sensors;"),
        ({"R": np.diag([0.1, 0.0]), "J": J}, "losses R, a structure matrix J of its own;"),
    ],
)
def test_a_refusal_names_what_the_system_has(parts, what):
    system = phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0], **parts)
    with pytest.raises(phc.NotLosslessError, match=what) as refusal:
        phc.ch(system)
    copy = pickle.loads(pickle.dumps(refusal.value))
    assert str(copy) == str(refusal.value) and copy.violations == refusal.value.violations


TAKEN = {
    "are_isomorphic": lambda s: bool(phc.are_isomorphic(s, ct.ss(s))),
    "system_isomorphism": lambda s: np.allclose(phc.system_isomorphism(s, ct.ss(s)), np.eye(2)),
    "is_morphism": lambda s: bool(phc.is_morphism(np.eye(2), s, s)),
    "is_odd": lambda s: not phc.is_odd(s),
    "is_even": lambda s: not phc.is_even(s),
    "tf": lambda s: np.allclose(phc.tf(s).den_list[0][0], [1.0, 0.1, 4.0]) and phc.tf(s, name="G").name == "G",
    # both gain crossings of a resonance have margins of one size, of which rounding chooses
    "margin": lambda s: np.allclose(np.abs(phc.margin(s)[:2]), np.abs(ct.margin(ct.ss(s))[:2])),
    "stability_margins": lambda s: phc.stability_margins(s)[0] == np.inf,
    "passivity": lambda s: phc.passivity(s).is_passive,
    "sample": lambda s: phc.sample(s, 0.1).dt == 0.1,
    "ph": lambda s: type(phc.ph(s)) is type(s),
    "modes": lambda s: phc.modes(s).damping_ratios.round(12) == [0.025],
    "bode_plot": phc.bode_plot, "step_plot": phc.step_plot, "pole_zero_plot": phc.pole_zero_plot,
    "impulse_plot": phc.impulse_plot, "root locus": ct.root_locus_plot, "nyquist": ct.nyquist_plot,
}  # fmt: skip


@pytest.mark.parametrize("name", TAKEN)
def test_what_is_defined_for_every_linear_system_takes_it(name):
    assert TAKEN[name](one_port())
    plt.close("all")


def test_the_transfer_function_of_an_entry_of_a_system_with_losses_is_that_of_python_control():
    pair = phc.spring_chain([1.0, 2.0], 3.0, ground=[1.0, 0.0], c=0.2, port=[0, 1], name="pair")
    entry = pair[1, 0]
    for given in (entry, ct.tf(entry)):
        G = phc.tf(given, name="G")
        assert G.name == "G" and (G.input_labels, G.output_labels) == (entry.input_labels, entry.output_labels)
        assert np.allclose(G(0.7j), pair(0.7j)[1, 0], rtol=1e-12)


def test_two_systems_with_other_losses_are_not_isomorphic():
    other = phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0], R=np.diag([0.0, 0.2]))
    assert not phc.are_isomorphic(one_port(), other) and not phc.are_isomorphic(one_port(), one_port().lossless_part())
