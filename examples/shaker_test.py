"""
A shaker test with two inputs
=============================

Two shakers drive a frame of four storeys with random forces, and eight accelerometers, left and right on each floor,
record 20 s. The frame bends and twists at almost the same frequencies: with one shaker such pairs of modes are hard to
tell apart, with two they are not.
"""

import control as ct
import matplotlib.pyplot as plt
import numpy as np

import ph_control as phc

# %%
# Floors move sideways (x) and turn (theta, times half the width of the frame). Twisting is 1 % stiffer than bending.

STOREY = 2 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1)
STOREY[-1, -1] = 1.0
MASS, STIFFNESS = 200.0, 4e6  # kg, N/m
M = MASS * np.eye(8)
K = STIFFNESS * np.kron(np.diag([1.0, 1.01]), STOREY)
left_right = np.kron([[1.0, 1.0], [1.0, -1.0]], np.eye(4))  # rows: left of floors 1 to 4, then right
squares, modes = np.linalg.eigh(K / MASS)
omega = np.sqrt(squares)
RATIOS = np.linspace(0.004, 0.012, 8)
C = MASS * modes @ np.diag(2 * RATIOS * omega) @ modes.T

names = [f"left {k}" for k in range(1, 5)] + [f"right {k}" for k in range(1, 5)]
DRIVEN = [3, 5]  # shakers: left on floor 4, right on floor 2
frame = phc.from_second_order(M, K, left_right[DRIVEN].T, C=C, sensors={"acceleration": left_right})

# %%
# The recording, 250 samples a second, with 5 % of noise.

STEP, SAMPLES = 0.004, 5000
rng = np.random.default_rng(2)
t = STEP * np.arange(SAMPLES)
forces = 100 * rng.standard_normal((2, SAMPLES))
clean = phc.forced_response(frame, t, forces).outputs[2:]
noise = 0.05 * clean.std(axis=1, keepdims=True)
recording = ct.TimeResponseData(
    t, clean + noise * rng.standard_normal(clean.shape), inputs=forces, issiso=False,
    input_labels=[f"force {names[k]}" for k in DRIVEN], output_labels=names,
)  # fmt: skip
recording.time_unit = "s"

# %%
# One call. At two of the sensors a shaker acts: these driving points give the shapes unit modal mass. The forces
# are smooth, so they are nearly linear between samples rather than held; accelerometers, which feel them at once,
# cannot tell the two apart without knowing the structure.

ports = [(names[k], f"force {names[k]}") for k in DRIVEN]
result = phc.pem(recording, quantity="acceleration", ports=ports, intersample="foh")
print(result.summary())
for name, values, true in (("natural_frequencies", result.natural_frequencies, omega),
                           ("damping_ratios", result.damping_ratios, RATIOS)):  # fmt: skip
    assert np.all(np.abs(values - true) < 4.5 * result.stderr[name]), name
apart = np.diff(result.natural_frequencies)[::2] / (2 * RATIOS * omega)[::2]
print(f"distance of the pairs in half-power bandwidths: {', '.join(f'{one:.2f}' for one in apart)}")

# %%
# Above, the response at the shaker on floor 4: the pairs look like single peaks. Below, the shapes that the fit tells
# apart, left side and right side over the floors, with 95 % intervals: one of each pair bends, the other
# twists.

figure = plt.figure(figsize=(11, 7), layout="constrained")
upper, lower = figure.subfigures(2, 1, height_ratios=(1.25, 1))
pair = upper.subplots(2, 1, sharex=True, height_ratios=(1.6, 1))
driven = f"force {names[DRIVEN[0]]}"
phc.frf_plot(
    result, outputs=[names[DRIVEN[0]]], inputs=[driven], omega_limits=[5, 50], gain_unit="m/s²/N", ax=pair[:, None],
    title="",
)  # fmt: skip
floors = np.arange(1, 5)
for l, axis in enumerate(lower.subplots(1, 8, sharex=True, sharey=True)):
    shape, spread = result.shapes[l].real, result.stderr["shapes"][l].real
    for side, color, marker in ((slice(0, 4), "C0", "o"), (slice(4, 8), "C3", "s")):
        place = np.concatenate([[0], shape[side]]), np.arange(5)
        axis.plot(*place, color=color, label=("left", "right")[side.start // 4])
        axis.errorbar(
            shape[side], floors, xerr=1.96 * spread[side], fmt=marker, color=color, markersize=4, capsize=2,
            fillstyle="none" if side.start else "full",
        )  # fmt: skip
    axis.axvline(0, color="0.3", linewidth=0.8)
    axis.set_title(f"{result.hertz[l]:.3f} Hz\n{100 * result.damping_ratios[l]:.2f} %", fontsize="medium")
    axis.grid(True, alpha=0.4)
    if l == 0:
        axis.set(ylabel="Floor", yticks=range(5), xticks=[-0.05, 0, 0.05], xticklabels=["-0.05", "0", "0.05"])
        handles = axis.get_legend_handles_labels()
lower.supxlabel("Shape, unit modal mass [kg$^{-1/2}$]", fontsize="medium")
lower.legend(*handles, loc="outside upper right", ncols=2, fontsize="small", frameon=False)
figure.savefig("shaker_test.png", dpi=110)
