"""
A controller for every model that the data allow
================================================

A fit is not one model but many: `sample_systems` draws them from the distribution of the estimate. A controller is
tried on all of them. One that only takes energy is stable with each, however short the record; one that feeds back a
sensor away from its actuator works on the estimate, and on some of the others it does not.
"""

import control as ct
import matplotlib.pyplot as plt
import numpy as np

import ph_control as phc

# %%
# Three masses, a force and a velocity at both ends, and a record of twenty seconds with noise of 50 %. The record says
# that its times are seconds, so that frequencies are in Hz.

beam = phc.spring_chain([1.0, 1.0, 1.0], 300.0, ground=[300.0, 0, 0], c=0.4, ground_c=0.3, port=[0, 2],
                        inputs=["left [N]", "right [N]"], outputs=["left [m/s]", "right [m/s]"])  # fmt: skip
rng = np.random.default_rng(0)
t = 0.05 * np.arange(400)
u = rng.normal(size=(2, t.size))
record = phc.forced_response(beam, t, u, intersample="zoh")
record.y = record.outputs + 0.5 * record.outputs.std() * rng.normal(size=record.outputs.shape)
record.time_unit = "s"
result = phc.pem(record, 3, structure="passive", ports=[(0, 0), (1, 1)])
print(result.summary())
models = result.sample_systems(20, rng=1)
assert all(isinstance(model, phc.PortHamiltonian) for model in models)

# %%
# Two controllers: a gain from the speed of the left end to the force there, as of a dashpot; and one from the speed of
# the right end to the force at the left, a little smaller than that at which the estimate becomes unstable.

closed = [phc.damping_injection(model, 6.0, ports=[0]) for model in models]


def crossed(plant, gain):
    """The loop from the right speed to the left force."""
    return ct.feedback(ct.ss(plant.A, plant.B, plant.C, plant.D), [[0.0, gain], [0.0, 0.0]])


gains = -np.geomspace(0.1, 10.0, 201)
largest = gains[np.argmax([crossed(result.system, gain).poles().real.max() > 0 for gain in gains])]
others = [crossed(model, 0.97 * largest) for model in models]
for name, loops in (("dashpot", closed), ("crossed feedback", others)):
    print(f"{name}: stable with {sum(loop.poles().real.max() < 0 for loop in loops)} of {len(loops)} models")
assert all(loop.poles().real.max() < 0 for loop in closed)
assert 0 < sum(loop.poles().real.max() > 0 for loop in others) < len(others)

# %%
# Bands of what the loop will do: percentiles over the models, of the three poles that the left end sees most, and of
# the response to a step of the force there.


def damping(loop):
    """Frequencies [Hz] and damping ratios [%] of the three modes that the left end sees most, shape (2, 3)."""
    poles, vectors = np.linalg.eig(loop.A)
    size = np.abs(loop.C[0] @ vectors * np.linalg.solve(vectors, loop.B[:, 0])) * (poles.imag > 0)
    three = poles[np.argsort(size)[-3:]]
    three = three[np.argsort(np.abs(three))]
    return np.array([np.abs(three) / (2 * np.pi), -100 * three.real / np.abs(three)])


found = {"no controller": models, "crossed feedback": others, "dashpot": closed}
modes = {name: np.array([damping(loop) for loop in loops]) for name, loops in found.items()}
for name, values in modes.items():
    low, high = np.percentile(values[:, 1], [2.5, 97.5], axis=0)
    print(f"{name:16} damping [%]:", ", ".join(f"{a:.1f} to {b:.1f}" for a, b in zip(low, high, strict=True)))
assert np.percentile(modes["dashpot"][:, 1], 2.5) > np.percentile(modes["no controller"][:, 1], 97.5)

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
for (name, values), marker in zip(modes.items(), "ox^", strict=True):
    left.plot(values[:, 0].ravel(), values[:, 1].ravel(), marker, ms=5, mfc="none", label=name)
left.axhline(0.0, color="0.4", lw=1)
left.set(xlabel="Natural frequency [Hz]", ylabel="Damping ratio [%]", title="Modes of the loops", ylim=(-1, 14))
left.grid(alpha=0.4)
left.legend(loc="upper left")
time = np.linspace(0.0, 8.0, 400)
for name, color in (("no controller", "C0"), ("dashpot", "C2")):
    steps = np.array([phc.step_response(loop, time, input=0, output=0).outputs.ravel() for loop in found[name]])
    label = f"{name}, 95 % of the models"
    right.fill_between(time, *np.percentile(steps, [2.5, 97.5], axis=0), alpha=0.6, color=color, label=label)
right.set(xlabel="Time [s]", ylabel="Speed of the left end [m/s]", title="Step of 1 N at the left end")
right.grid(alpha=0.4)
right.legend()
figure.savefig("robust_damping.png", dpi=110)
