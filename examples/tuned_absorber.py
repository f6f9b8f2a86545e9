"""
A tower and its absorber
========================

A tower of five storeys with little damping, and on its roof a mass on a spring and a damper that is tuned to its first
mode. Both are port-Hamiltonian; joined at the roof they are so again, and the energies say where a gust goes.
"""

import matplotlib.pyplot as plt
import numpy as np

import ph_control as phc

# %%
# The tower: 20 t and 30 MN/m a storey, dampers between the storeys. Its port is at the roof, and there the first mode
# has the modal mass `1 / kappa` of the tower without dampers.

storeys, mass, stiffness, damping = 5, 20e3, 30e6, 20e3
ground = np.eye(storeys)[0]
tower = phc.spring_chain(
    np.full(storeys, mass), stiffness, ground=stiffness * ground, c=damping, ground_c=damping * ground,
    port=storeys - 1, name="tower",
)  # fmt: skip
rigid = tower.lossless_part()
w1, modal_mass = rigid.d[0], 1 / rigid.modes.kappa[0]
print(f"first mode: {tower.hertz[0]:.3f} Hz, {100 * tower.damping_ratios[0]:.2f} % of critical, {modal_mass:.0f} kg")

# %%
# The absorber stands on a plate of 100 kg, and its mass is 5 % of the modal mass of the tower, tuned by the rule of den
# Hartog. `couple` joins its plate to the roof: the force between them is eliminated, and the plate becomes a part of
# the fifth storey.

ratio = 0.05
m = ratio * modal_mass
w, zeta = w1 / (1 + ratio), np.sqrt(3 * ratio / (8 * (1 + ratio)))
absorber = phc.spring_chain([100.0, m], m * w**2, c=2 * zeta * m * w, name="absorber")
both = phc.couple(tower, absorber, name="tower with absorber")
print(f"{tower.n} + {absorber.n} degrees of freedom become {both.n}; passive: {phc.passivity(both).is_passive}")
assert both.n == tower.n + absorber.n - 1 and both.poles().real.max() < 0

# %%
# The mobility of the roof: one peak becomes two low ones.

plot = phc.bode_plot([tower, both], gain_unit="(m/s)/N", time_unit="s", omega=2 * np.pi * np.geomspace(0.8, 12, 800))
plot.figure.savefig("absorber_bode.png", dpi=110)
peaks = [np.abs(one(1j * np.linspace(0.5, 1.5, 2001) * w1)).max() for one in (tower, both)]
print(f"the first peak is {peaks[0] / peaks[1]:.1f} times lower")
assert peaks[0] > 4 * peaks[1]

# %%
# A gust of 0.3 seconds at the roof. What goes in is stored, and then lost: with the absorber within a few seconds.

t = np.linspace(0.0, 12.0, 4801)
gust = np.where(t < 0.3, 10e3, 0.0)
balances = [phc.energy_balance(phc.forced_response(one, t, gust, intersample="zoh"), one) for one in (tower, both)]
for name, balance in zip(("alone", "with absorber"), balances, strict=True):
    half = t[np.flatnonzero(balance.stored > 0.5 * balance.stored.max())[-1]]
    print(f"{name}: {balance.supplied[-1]:.0f} J supplied, half of what was stored is lost after {half:.1f} s")
    assert np.abs(balance.defect).max() < 1e-12 * balance.supplied.max()

phc.energy_plot(
    balances, label=["alone", "with absorber"], time_unit="s", energy_unit="J"
).figure.savefig("absorber_energy.png", dpi=110)  # fmt: skip
assert balances[1].stored[-1] < 0.02 * balances[0].stored[-1]

# %%
# Which absorber is best depends on the wind. Of a single mass without damping both answers are known: den Hartog's
# makes the two peaks of the response equally high, Warburton's is best for gusts of all frequencies. `optimal_damping`
# finds them, and goes on where no formula is known.

single = phc.spring_chain([1.0], [], ground=1.0)
ratio = 0.05
formulas = {
    "fixed points": (1 / (1 + ratio), np.sqrt(3 * ratio / (8 * (1 + ratio)))),
    "h2": (np.sqrt(1 + ratio / 2) / (1 + ratio),
           0.5 * np.sqrt(ratio * (1 + 3 * ratio / 4) / ((1 + ratio) * (1 + ratio / 2)))),
}  # fmt: skip
omega = np.linspace(0.7, 1.3, 2000)
figure, axis = plt.subplots(layout="constrained", figsize=(7, 4))
for criterion, label, style in (
    ("fixed points", "fixed points (den Hartog)", "-"), ("h2", "least H2 norm (Warburton)", "--")
):  # fmt: skip
    best = phc.optimal_damping(single, [0], mass=ratio, criterion=criterion, outputs="displacement")
    found = best.tuned_frequencies[0], best.tuned_damping_ratios[0]
    print(f"{label}: frequency ratio {found[0]:.7f}, damping {found[1]:.7f}")
    assert np.allclose(found, formulas[criterion], rtol=1e-6)
    response = np.abs(best.system(1j * omega).ravel() / omega)
    axis.plot(omega, response, style, label=label)
    if criterion == "fixed points":
        high = response[1:-1][(response[1:-1] > response[:-2]) & (response[1:-1] > response[2:])]
        assert len(high) == 2 and abs(high[0] / high[1] - 1) < 0.01
axis.set(xlabel="Frequency over that of the mass alone", ylabel="Displacement over static displacement",
         title="A mass with an absorber of 5 %")  # fmt: skip
axis.grid(alpha=0.4)
axis.legend()
figure.savefig("absorber_designs.png", dpi=110)
