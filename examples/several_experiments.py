"""
Several experiments, one model
==============================

Three short and noisy experiments: two with an input, of different length and step, and one free motion of which
almost a third of the samples was lost.
"""

import control as ct
import matplotlib.pyplot as plt
import numpy as np

import ph_control as phc

rng = np.random.default_rng(2)
plant = phc.spring_chain(np.ones(3), 4.0, ground=1.0, name="plant")


def experiment(samples, step, noise, driven=True):
    """White force or none, a start in motion, and the velocity with noise."""
    force = rng.standard_normal(samples) if driven else np.zeros(samples)
    t = step * np.arange(samples)
    velocity = phc.forced_response(plant, t, force, rng.standard_normal(6), intersample="zoh").outputs
    velocity = velocity + noise * rng.standard_normal(samples)
    labels = {"input_labels": ["force [N]"]} if driven else {}
    record = ct.TimeResponseData(
        t, velocity, inputs=force if driven else None, issiso=driven, output_labels=["velocity [m/s]"], **labels
    )
    record.time_unit = "s"
    return record


pushed = experiment(250, 0.1, 0.4)
longer = experiment(800, 0.15, 0.4)
released = experiment(600, 0.2, 0.4, driven=False)
lost = rng.random(600) < 0.3
released.y[0, lost] = np.nan  # samples that were not taken

# %%
# Frequencies and weights are shared; each experiment has its own initial state.
alone = phc.pem(pushed, 3)
together = phc.pem([pushed, longer, released], 3)
print(together.summary())
print()
print("standard errors of d, first record alone:", alone.stderr["d"].round(5))
print("                 all three together:     ", together.stderr["d"].round(5))
again = together.bootstrap(60, rng=0)
print("                 from the bootstrap:     ", again.stderr["d"].round(5))
print("off by, in standard errors:              ", ((together.d - plant.d) / together.stderr["d"]).round(2))

# %%
# The records with the predictions of one model, and what the further records add to the certainty of the gain.
figure = plt.figure(figsize=(9, 8), layout="constrained")
rows = figure.subfigures(2, 1, height_ratios=[1.3, 1])
axes = rows[0].subplots(3, 1)
titles = ("force, step 0.1 s", "force, step 0.15 s", "released, step 0.2 s, 30 % of the samples lost")
for axis, one, title in zip(axes, together.experiments, titles, strict=True):
    shown = slice(0, 200)
    t = one.record.time[shown]
    axis.plot(t, one.measured[shown], ".", color="0.6", markersize=4, label="measured")
    axis.plot(t, one.predicted[shown], color="C0", linewidth=1.2, label="predicted")
    axis.set_title(f"{title}: fit {one.fit_percent:.1f} %", loc="left", fontsize="medium")
    axis.set_ylabel("Velocity [m/s]")
    axis.grid(True, alpha=0.4)
axes[0].legend(fontsize="small", loc="lower right", bbox_to_anchor=(1, 1), ncols=2, frameon=False)
axes[-1].set_xlabel("Time [s]")
rows[0].align_ylabels(axes)

axis = rows[1].subplots()
beside = plant.d[:, None] * [1 - 2e-4, 1 + 2e-4]  # the peaks are infinite, and all alike leave the picture
omega = np.sort(np.append(np.linspace(0.3, 5.0, 700), beside))
for result, colour, name in ((alone, "C1", "first record alone"), (together, "C0", "all three")):
    low, high = result.sample(400, rng=0).magnitude_band(omega)
    axis.fill_between(omega, low, high, color=colour, alpha=0.5, label=f"{name}, 95 % of the models")
axis.plot(omega, np.abs(plant.modes.freqresp(omega)), color="k", linewidth=0.7, label="plant")
axis.set_yscale("log")
axis.set_ylim(1e-2, 1e2)
axis.set_xlabel("Frequency [rad/s]")
axis.set_ylabel("Gain [(m/s)/N]")
axis.grid(True, alpha=0.4)
axis.legend(fontsize="small")
figure.savefig("several_experiments.png", dpi=110)
