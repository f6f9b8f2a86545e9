"""
Pictures of undamped systems
============================

A step response whose fast mode a picture cannot show, the modes of a fit with their confidence intervals, a hundred
poles and zeros on the imaginary axis, and the energy along two integrators.
"""

import control as ct
import matplotlib.pyplot as plt
import numpy as np

import ph_control as phc

# %%
# A slow mode and a fast one, 1 and 200 000 rad/s.  Instants that suit the slow one are far apart for the fast one: a
# line through them shows a motion that is not there.  `step_plot` draws the envelope.

stiff = phc.ph(phc.modes([1.0, 2e5], [1.0, 0.3]), name="stiff")
sampled = ct.step_response(ct.ss(stiff), timepts=np.linspace(0.0, 20.0, 201))
print(f"{2 * np.pi / 2e5 / np.diff(sampled.time)[0]:.1e} samples in a period of the fast mode")

figure, axes = plt.subplots(1, 2, figsize=(11, 3.6), layout="constrained", sharey=True)
ct.time_response_plot(sampled, ax=axes[:1, None], title="")
phc.step_plot(stiff, 20.0, time_unit="s", ax=axes[1], title="", show_legend=True)
axes[0].set_title("python-control, 201 instants", loc="left", fontsize="medium")
axes[1].set_xlabel("Time [s]")
figure.savefig("plots_step.png", dpi=100)

# %%
# A fit, beside the system that was measured: its natural frequencies and weights with 95 % intervals.

rng = np.random.default_rng(4)
frame = phc.spring_chain(np.ones(4), 4.0, ground=1.0, name="frame")
t = 0.2 * np.arange(250)
force = rng.standard_normal(250)
velocity = phc.forced_response(frame, t, force, intersample="zoh").outputs + 0.15 * rng.standard_normal(250)
fit = phc.pem((force, velocity), order=4, dt=0.2)
phc.modes_plot([fit, frame], time_unit="s", title="").figure.savefig("plots_modes.png", dpi=100)

# %%
# A hundred poles alternate with as many zeros.  The axis is parted into strips in which each is seen.

many = phc.modes(np.linspace(1.0, 20.0, 100) + 0.05 * rng.standard_normal(100), np.ones(100))
phc.pole_zero_plot(many, time_unit="s", title="").figure.savefig("plots_poles.png", dpi=100)

# %%
# The energy that is stored is the energy that was supplied; explicit Euler makes energy from nothing.

t = 0.02 * np.arange(1001)
balances = [
    phc.energy_balance(phc.forced_response(frame, t, np.sin(t), method=method), frame) for method in ("exact", "euler")
]
for name, balance in zip(("exact", "Euler"), balances, strict=True):
    print(f"{name}: {balance}")
plot = phc.energy_plot(balances, label=["exact", "Euler"], title="", time_unit="s", energy_unit="J")
plot.figure.savefig("plots_energy.png", dpi=100)
