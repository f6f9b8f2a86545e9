"""
A circuit, learned from its answer to a sine
============================================

The first experiment of the paper: learn from a sine, then predict the answer to other inputs. There are five equal
branches, so that only one mode is seen from the source. 1000 samples to learn from, 4000 to predict, all made by
Euler's rule, which the fit is told: `method="euler"`.
"""

import matplotlib.pyplot as plt
import numpy as np

import ph_control as phc

STEP, LEARN, TOTAL, STARTS = 0.01, 1000, 5000, 4
time = STEP * np.arange(TOTAL)
INPUTS = {
    "sine": np.sin(time),
    "constant": np.ones(TOTAL),
    "square": np.where(np.sin(time) >= 0, 1.0, -1.0),
    "ramp": 0.1 * time,
}

circuit = phc.lc_circuit(np.ones(5), np.ones(5))
start = np.random.default_rng(0).standard_normal(10)
sine = INPUTS["sine"]
# the recording starts in motion; the other inputs meet the circuit at rest
truth = {
    name: phc.forced_response(circuit, time, u, start if name == "sine" else 0.0, method="euler").outputs
    for name, u in INPUTS.items()
}
learn = sine[:LEARN], truth["sine"][:LEARN]


def worst(predicted, measured):
    """Return the largest error in units of the largest output."""
    return np.max(np.abs(predicted - measured)) / np.max(np.abs(measured))


# %%
# `pem` with the true order, and with the order to be found.
fitted = {}
for order in (5, "auto"):
    fitted[order] = result = phc.pem(learn, order, dt=STEP, method="euler")
    error = worst(result.predict(sine[LEARN:], initial_state="final").outputs, truth["sine"][LEARN:])
    visible = result.modes.minimal().n
    print(f"pem, order {order}: {visible} visible mode{'s' * (visible != 1)}, next 4000 samples to {error:.1e}")
    print("   ", result.message)


# %%
# The learning scheme of the paper.
def descend(seed, optimizer="adam"):
    """Learn as the paper does, from a random start: 500 steps with the rate 0.1."""
    return phc.gradient_descent(
        learn, 5, dt=STEP, parameters="natural", optimizer=optimizer, learning_rate=0.1, epochs=500, rng=seed
    )


plain = [descend(seed, "plain") for seed in range(STARTS)]
print(f"gradient descent, plain steps: {sum(result.diverged for result in plain)} of {STARTS} starts diverge")
print("   ", plain[0].message)
learned = min((descend(seed) for seed in range(STARTS)), key=lambda result: result.loss)
print(f"gradient descent, steps of Adam, best of {STARTS} starts")
print("   ", learned.message)
print("    frequencies", np.sort(learned.d).round(3), "where the circuit has", circuit.d)

# %%
# The same four inputs for all models.
MODELS = {"pem": (fitted[5], "C0", "--"), "gradient descent (Adam)": (learned, "C3", "-")}
figure, axes = plt.subplots(4, 2, sharex=True, figsize=(10, 9), layout="constrained")
for (name, u), (left, right) in zip(INPUTS.items(), axes, strict=True):
    left.plot(time, u, color="0.3", linewidth=1)
    left.set_ylim(min(0.0, 1.2 * u.min()), 1.2 * u.max())
    left.set_ylabel("Voltage [V]")
    left.set_title(f"{name}: input", loc="left", fontsize="medium")
    right.plot(time, truth[name], color="0.7", linewidth=4, label="circuit")
    errors = []
    for label, (model, colour, style) in MODELS.items():
        predicted = model.predict(u, initial_state="fitted" if name == "sine" else "zero").outputs
        errors.append(f"{label} {worst(predicted, truth[name]):.1e}")
        right.plot(time, predicted, style, color=colour, linewidth=1.5 if model is fitted[5] else 0.7, label=label)
    print(f"{name} input, largest error over largest output: {', '.join(errors)}")
    # sized for the truth: what the descent learned may leave the picture
    size = 1.4 * np.max(np.abs(truth[name]))
    right.set_ylim(-size, size)
    right.set_ylabel("Current [A]")
    right.set_title(f"{name}: output", loc="left", fontsize="medium")
    for axis in (left, right):
        axis.grid(True, alpha=0.4)
for axis in axes[0]:
    axis.axvspan(0, STEP * LEARN, color="C2", alpha=0.15, linewidth=0, label="learned from")
for axis in axes[-1]:
    axis.set_xlabel("Time [s]")
figure.legend(*axes[0, 1].get_legend_handles_labels(), loc="outside upper right", ncols=4)
axes[0, 0].set_xlim(0, time[-1])
figure.align_ylabels()
figure.savefig("paper_circuit.png", dpi=110)
