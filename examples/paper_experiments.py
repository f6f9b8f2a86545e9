"""The two recordings of the paper: Euler data of a circuit and of a chain, 1000 samples to learn from, 4000 to predict.

Euler's rule is not lossless, so the fit is told that it made the data: `method="euler"`.
"""

import matplotlib.pyplot as plt
import numpy as np

import ph_control as phc

STEP, LEARN, TOTAL = 0.01, 1000, 5000
time = STEP * np.arange(TOTAL)
INPUTS = {
    "sine": np.sin(time),
    "constant": np.ones(TOTAL),
    "square": np.where(np.sin(time) >= 0, 1.0, -1.0),
    "ramp": 0.1 * time,
}


def recording(plant, u, state):
    """Return the output of a plant by the explicit Euler rule."""
    return phc.forced_response(plant, time, u, state, method="euler").outputs


def worst(predicted, measured):
    """Return the largest error in units of the largest output."""
    return np.max(np.abs(predicted - measured)) / np.max(np.abs(measured))


rng = np.random.default_rng(0)
circuit, chain = phc.lc_circuit(np.ones(5), np.ones(5)), phc.frenkel_kontorova(2)
for name, plant, state in (("circuit", circuit, rng.standard_normal(10)), ("chain", chain, [2.0, 1.0, -3.0, -3.0])):
    y = recording(plant, INPUTS["sine"], state)
    for order in (plant.n, "auto"):
        result = phc.pem((INPUTS["sine"][:LEARN], y[:LEARN]), order, dt=STEP, method="euler")
        ahead = result.predict(INPUTS["sine"][LEARN:], initial_state="final").outputs
        error = worst(ahead, y[LEARN:])
        print(f"{name}, order {order}: {result.modes.minimal().n} visible modes, next 4000 samples to {error:.1e}")
        print("   ", result.message)

# The circuit, learned from the sine, under inputs it has not seen.
y = recording(circuit, INPUTS["sine"], rng.standard_normal(10))
result = phc.pem((INPUTS["sine"][:LEARN], y[:LEARN]), 5, dt=STEP, method="euler")
figure, axes = plt.subplots(3, 1, sharex=True, figsize=(7, 7), layout="constrained")
for axis, name in zip(axes, ("constant", "square", "ramp"), strict=True):
    truth = recording(circuit, INPUTS[name], 0.0)
    predicted = result.predict(INPUTS[name], initial_state="zero").outputs
    print(f"circuit, {name} input: error {worst(predicted, truth):.1e}")
    axis.plot(time, truth, color="0.6", linewidth=3, label="circuit")
    axis.plot(time, predicted, "--", label="model learned from a sine")
    axis.set_ylabel("Current [A]")
    axis.set_title(f"{name} voltage", loc="left", fontsize="medium")
    axis.grid(True, alpha=0.4)
figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
axes[-1].set_xlabel("Time [s]")
figure.savefig("paper_circuit.png", dpi=110)
