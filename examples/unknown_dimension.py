"""
A system of unknown dimension
=============================

The paper learns a system whose number of modes is not known in a form that is surely large enough: lifted to more
degrees of freedom, a system keeps its filter. This example does both: it goes up with the true system, and learns with
too many modes, and with the number to be found.
"""

import matplotlib.pyplot as plt
import numpy as np

import ph_control as phc

plant = phc.spring_chain(np.ones(3), 3.0, ground=1.0, name="plant")

# %%
# Up: from three degrees of freedom to seven. The gain does not change, and `minreal` finds the way back. The
# observable form of the lifted system has 14 states; the morphism between the two carries motions of one into motions
# of the other.

lifted = phc.lift(plant, 7)
omega = np.linspace(0.05, 5.0, 400)
change = np.max(np.abs(lifted.modes.freqresp(omega) / plant.modes.freqresp(omega) - 1))
print(f"degrees of freedom {plant.n} -> {lifted.n} -> {phc.minreal(lifted).n}, largest change of the gain {change:.0e}")
check = phc.is_morphism(phc.lift_morphism(plant, 7), plant, lifted)
print("the map of states is a morphism:", bool(check))
print("same filter, though the dimensions differ:", bool(phc.same_filter(plant, lifted)))

# %%
# A record of 600 samples with 5 % of noise, from a motion that goes on when it begins, and 600 more to test with.

rng = np.random.default_rng(3)
t, u = 0.2 * np.arange(1200), rng.standard_normal(1200)
y = phc.forced_response(plant, t, u, rng.standard_normal(6), intersample="zoh").outputs
noise = 0.05 * np.std(y)
measured = y + noise * rng.standard_normal(1200)

# %%
# Down: learned with 1 to 6 modes. Too few miss what is there. Too many cost little here: the modes that are not there
# get weights near 0, and predict the noise of the record, which is why the error of what follows rises again. Input and
# output are known to have no delay, which could stand for a part of the modes that are missing.

orders = range(1, 7)
within, ahead = [], []
for order in orders:
    result = phc.pem((u[:600], measured[:600]), order, dt=0.2, rng=0, structure="lossless", delay=0.0)
    rest = result.predict(u[600:], initial_state="final").outputs
    within.append(np.std(result.residuals) / noise)
    ahead.append(np.std(rest - y[600:]) / noise)
    print(f"{order} modes: residual {within[-1]:6.3f}, error ahead {ahead[-1]:6.3f}, in units of the noise")

# %%
# `order="auto"` finds three.

found = phc.pem((u[:600], measured[:600]), dt=0.2)
print(f"auto: {found.order} modes, d = {found.d.round(4)}, in truth {plant.d.round(4)}")

figure, axis = plt.subplots(figsize=(7, 3.8), layout="constrained")
axis.semilogy(orders, within, "o-", color="0.6", label="residual of the record learned from")
axis.semilogy(orders, ahead, "s-", color="C0", label="error over the 600 samples that follow, without noise")
axis.axvline(found.order, color="C3", linewidth=1, linestyle="--", label='order="auto"')
axis.set_xlabel("Number of modes")
axis.set_ylabel("Relative to the noise")
axis.grid(True, alpha=0.4)
axis.legend(fontsize="small")
figure.savefig("unknown_dimension.png", dpi=110)
