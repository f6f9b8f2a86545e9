"""
Damping of a flexible arm
=========================

A long arm on a motor, whose first modes ring. Feedback of the speed where the force acts takes energy out, whatever its
gain; feedback of the speed at the tip gives energy to some modes, and the arm becomes unstable at a small gain.
"""

import control as ct
import matplotlib.pyplot as plt
import numpy as np

import ph_control as phc

# %%
# Twelve masses on springs with some hundredths of a per cent of damping. The first port is at the motor; the second, at
# the tip, only measures.

n = 12
ground = 200.0 * np.eye(n)[0]
arm = phc.spring_chain(np.full(n, 0.5), 2e4, ground=ground, c=0.1, ground_c=0.005, port=[0, n - 1],
                       inputs=["motor", "tip force"], outputs=["motor speed", "tip speed"])  # fmt: skip
print("before:", " ".join(f"{100 * zeta:.2f}" for zeta in arm.damping_ratios[:5]), "% of the first five modes")

# %%
# Collocated: the loop is port-Hamiltonian by its type, and stable for every gain. One gain is the best for the first
# modes; with a larger one the motor is held still, and the modes of the clamped arm have nothing to damp them.

best = phc.optimal_damping(arm, ["motor"], criterion="damping")
print(best)
assert isinstance(best.system, phc.PortHamiltonian) and best.cost > 5 * best.cost_before
best.plot(Hz=True, time_unit="s").figure.savefig("arm_damping.png", dpi=110)

# %%
# Not collocated: the same gain on the speed of the tip. Nothing in the types says that this is stable, and it is not.

gains = np.geomspace(1e-6, 1.0, 121)
plain = ct.ss(arm.A, arm.B[:, :1], arm.C[1:], 0)
growth = np.array([ct.feedback(plain, g * best.gains[0]).poles().real.max() for g in gains])
first = gains[np.flatnonzero(growth > 0)[0]]
print(f"feedback of the tip: unstable from {100 * first:.2g} % of this gain on")
assert first < 0.5

# %%
# With both speeds measured, passive LQG for the motor damps as much as the cost of its force allows. It stays stable on
# an arm with twice the mass at its tip, which it was not made for.

controller = phc.lqg(arm, 0.01, ports=["motor"])
heavy = phc.spring_chain([*np.full(n - 1, 0.5), 1.0], 2e4, ground=ground, c=0.1, ground_c=0.005, port=[0, n - 1])
for name, plant in (("the arm", arm), ("with twice the mass at the tip", heavy)):
    loop = phc.damping_injection(plant, controller, ports=[0])
    print(f"passive LQG, {name}: least damping {100 * loop.damping_ratios.min():.2f} %")
    assert loop.poles().real.max() < 0

# %%
# Released from rest in a bent shape, the arm alone loses little energy in three seconds. With the controller the sum of
# both energies falls, and never rises; and so does the energy of the error of an observer that knows nothing at the
# start and measures both speeds.

time = np.linspace(0.0, 3.0, 1201)
bent = np.concatenate([np.linspace(0.0, 1e-3, n), np.zeros(n)])
no_force = np.zeros((2, time.size))
loop = phc.damping_injection(arm, controller, ports=[0])
still = np.zeros(controller.nstates)
alone = phc.forced_response(arm, time, no_force, bent)
joined = phc.forced_response(loop, time, no_force, np.concatenate([bent, still]))
estimator = phc.observer(arm)
estimated = phc.forced_response(estimator, time, np.vstack([no_force, alone.outputs])).outputs[-arm.nstates :]


def energy(Q, states):
    """Energy over time."""
    return 0.5 * np.einsum("it,ij,jt->t", states, Q, states)


energies = {"the arm alone": energy(arm.Q, alone.states), "arm and controller": energy(loop.Q, joined.states),
            "error of the observer": energy(arm.Q, estimated - alone.states)}  # fmt: skip
figure, axis = plt.subplots(layout="constrained", figsize=(7, 3.8))
for (name, values), style in zip(energies.items(), ("-", "--", "-."), strict=True):
    axis.semilogy(time, 1e3 * values, style, label=name)
    assert np.diff(values).max() < 1e-4 * values[0]
axis.set(xlabel="Time [s]", ylabel="Energy [mJ]", title="Energy without input")
axis.grid(alpha=0.4)
axis.legend()
figure.savefig("arm_energy.png", dpi=110)
