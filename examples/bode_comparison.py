"""
Bode plots of a lossless system, side by side
=============================================

The peaks and notches of a lossless system are infinitely high and deep, and narrow. Frequencies that are chosen
without regard to them cut each off somewhere: the picture shows heights that mean nothing, close modes run together,
and a phase that is put together from sample to sample goes astray at every jump.
"""

import control as ct
import matplotlib.pyplot as plt
import numpy as np

import ph_control as phc

# Twenty modes over two decades, two of them 0.1 % apart; the phase is +90 or -90 degrees everywhere.
d = np.sort(np.append(np.geomspace(1.0, 100.0, 19), 10.01))
system = phc.ph(phc.modes(d, 1.0 / d), name="system")

# %%
# Above the picture of python-control, below that of this package, both as they come. To the right the same around the
# close pair at 10 rad/s.

figure, axes = plt.subplots(4, 2, figsize=(11, 10), layout="constrained")
drawn = {}
for column, limits in enumerate(([0.5, 200.0], [9.9, 10.1])):
    theirs = ct.bode_plot(ct.ss(system), ax=axes[:2, column : column + 1], dB=True, omega_limits=limits, title="")
    ours = phc.bode_plot(system, ax=axes[2:, column : column + 1], omega_limits=limits, title="", time_unit="s")
    drawn[column] = {"python-control": theirs.lines, "ph_control": ours.lines}
for row, name in ((0, "python-control"), (2, "ph_control")):
    axes[row, 0].set_title(name, loc="left", fontsize="medium")
    axes[row, 1].set_title(f"{name}, around the close pair", loc="left", fontsize="medium")
for axis in axes[:, 1]:
    axis.set_xticks([9.9, 9.95, 10.0, 10.05, 10.1], ["9.9", "9.95", "10", "10.05", "10.1"])
    axis.set_xticks([], minor=True)
figure.savefig("bode_comparison.png", dpi=110)

# %%
# What was drawn on the left: how many of the 20 peaks, how high the lowest of them, and which phases.

for name, lines in drawn[0].items():
    omega, magnitude = (np.asarray(x) for x in lines[0, 0][0].get_data())
    phase = np.asarray(lines[1, 0][0].get_data()[1])
    top = (magnitude[1:-1] > magnitude[:-2]) & (magnitude[1:-1] > magnitude[2:])
    print(
        f"{name}: {len(omega)} frequencies, {top.sum()} peaks, the lowest {magnitude[1:-1][top].min():.0f} dB", end=""
    )
    print(f", phase from {np.nanmin(phase):.0f} to {np.nanmax(phase):.0f} degrees")
