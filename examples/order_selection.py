"""
How many modes?
===============

Six modes, three of them weak and two of them close together, under noise. `order_selection` adds one mode after the
other and keeps what each order achieved.
"""

import numpy as np

import ph_control as phc

plant = phc.ph(phc.modes([0.7, 1.1, 1.16, 2.0, 2.9, 3.6], [1.0, 0.4, 0.3, 0.1, 0.02, 0.05]))
rng = np.random.default_rng(5)
t, u = 0.25 * np.arange(1600), rng.standard_normal(1600)
y = phc.forced_response(plant, t, u, intersample="zoh").outputs
y = y + 0.05 * np.std(y) * rng.standard_normal(1600)

# %%
# The last quarter of the record is held out: the models do not know it, and have to predict it.

selection = phc.order_selection((u, y), 10, dt=0.25, holdout=0.25)
print(selection)
for criterion in ("bic", "aicc", "holdout"):
    print(f"{criterion:8s} chooses {selection.chosen(criterion)} modes")

# %%
# The frequencies over the order: a mode of the plant stays where it was found, and those of noise come last. To the
# right, the criteria: BIC and the error of what was held out turn back at the true order; AIC and AICc, which hardly
# charge for a mode in so long a record, go on into the noise.

selection.plot(time_unit="s").figure.savefig("order_selection.png", dpi=110)

# %%
# `pem` with its default, `order="auto"`, takes the order of the least BIC, and drops modes that noise alone could have
# shown.

result = phc.pem((u, y), dt=0.25)
print(f"pem: {result.order} modes.", result.message)
print("errors in units of their standard errors:", ((result.d - plant.d) / result.stderr["d"]).round(1))
