"""
Two masses, and what the input hides
====================================

The second experiment of the paper: a chain of two masses, learned in two parametrisations and by `pem`. The data come
from Euler's rule, and so do the models; the paper descends by 1500 steps with the rate 0.02. The input drives a
transmission zero of the chain, and exact data would not show the weights at all.
"""

import warnings

import matplotlib.pyplot as plt
import numpy as np

import ph_control as phc

STEP, LEARN, TOTAL, STARTS = 0.01, 1000, 5000, 3
time = STEP * np.arange(TOTAL)
force = np.sin(time)
chain = phc.frenkel_kontorova(2)
START = [2.0, 1.0, -3.0, -3.0]
velocity = phc.forced_response(chain, time, force, START, method="euler").outputs
learn = force[:LEARN], velocity[:LEARN]
ahead = force[LEARN:], velocity[LEARN:]


def descend(kind, seed, optimizer="adam"):
    """Learn as the paper does; both parametrisations see the same random starts."""
    return phc.gradient_descent(
        learn, 2, dt=STEP, parameters=kind, optimizer=optimizer, learning_rate=0.02, epochs=1500, rng=seed,
        validation=(ahead[0][:LEARN], ahead[1][:LEARN]),
    )  # fmt: skip


def report(name, model):
    """Return the prediction of the record and what follows; print what was found, and how well it predicts."""
    predicted = model.predict(force, initial_state="fitted").outputs
    error = np.sqrt(np.mean((predicted[LEARN:] - ahead[1]) ** 2) / np.mean(ahead[1] ** 2))
    order = np.argsort(model.d)
    print(f"{name:28s} d = {model.d[order].round(4)}, r = {model.r[order].round(4)}, next 4000 samples to {error:.1e}")
    return predicted


print(f"{'the chain itself':28s} d = {chain.d.round(4)}, r = {chain.r.round(4)}")
NAMES = {"natural": "natural parameters $(d, v)$", "unique": "unique parameters $(d, r)$"}
results = {kind: [descend(kind, seed) for seed in range(STARTS)] for kind in NAMES}
for kind, tried in results.items():
    for seed, result in enumerate(tried):
        report(f"Adam, {kind}, start {seed}", result)
best = {kind: min(tried, key=lambda result: result.loss) for kind, tried in results.items()}
plain = descend("unique", 1, "plain")
report("plain steps, unique, start 1", plain)
print("   ", plain.message)
for order in (2, "auto"):
    fitted = phc.pem(learn, order, dt=STEP, method="euler")
    report(f"pem, order {order}", fitted)
    print("   ", fitted.message)

# %%
# Validation error on the 1000 samples that follow.
figure, axis = plt.subplots(figsize=(8, 4.8), layout="constrained")
for colour, (kind, name) in zip(("C0", "C1"), NAMES.items(), strict=True):
    others = [result for result in results[kind] if result is not best[kind]]
    for k, result in enumerate([best[kind], *others]):
        label = [f"{name}, best of {STARTS} starts", "other starts"][min(k, 1)]
        axis.plot(
            np.log10(result.validation_history), color=colour, linewidth=0.8 if k else 2.0, alpha=0.5 if k else 1.0,
            label=label if k < 2 else None,
        )  # fmt: skip
axis.plot(np.log10(plain.validation_history), color="0.5", linewidth=0.15)
axis.plot([], [], color="0.5", linewidth=4, label="plain steps, unique: back and forth")
again = fitted.predict(ahead[0][:LEARN], initial_state="final").outputs
below = np.log10(np.mean((again - ahead[1][:LEARN]) ** 2))
axis.plot([], [], " ", label=f"pem: {below:.0f}, far below this picture")
axis.set_xlabel("Steps of the descent, rate 0.02")
axis.set_ylabel("$\\log_{10}$ of mean squared error [m²/s²]")
axis.set_title("Validation error, 1000 samples after those learned from", loc="left", fontsize="medium")
axis.set_xlim(0, 1500)
axis.grid(True, alpha=0.4)
axis.legend(fontsize="small", loc="lower left")
figure.savefig("paper_validation.png", dpi=110)

# %%
# Training and testing after the last step, next to `pem`.
models = {f"({letter}) {NAMES[kind]}": best[kind] for letter, kind in zip("ab", NAMES, strict=True)} | {
    "(c) pem": fitted
}
figure, axes = plt.subplots(4, 1, sharex=True, figsize=(9, 9.5), layout="constrained")
for axis, colour, (name, model) in zip(axes, ("C0", "C1", "C2"), models.items(), strict=False):
    predicted = model.predict(force, initial_state="fitted").outputs
    axis.axvspan(0, STEP * LEARN, color="0.5", alpha=0.15, linewidth=0, label="learned from")
    axis.plot(time, velocity, color="0.65", linewidth=3.5, label="chain")
    axis.plot(time, predicted, "--", color=colour, linewidth=1.4, label="model")
    axis.set_title(name, loc="left", fontsize="medium")
    axis.set_ylabel("Velocity [m/s]")
    axis.legend(loc="upper left", ncols=3, fontsize="small")
    axes[-1].semilogy(time, np.abs(predicted - velocity), color=colour, linewidth=1, label=name)
axes[-1].legend(loc="center right", fontsize="small")
for axis in axes:
    axis.grid(True, alpha=0.4)
axes[-1].set_title("Absolute error", loc="left", fontsize="medium")
axes[-1].set_ylabel("Error [m/s]")
axes[-1].set_xlabel("Time [s]")
axes[-1].set_ylim(1e-17, 3.0)
axes[-1].set_xlim(0, time[-1])
figure.align_ylabels()
figure.savefig("paper_chain.png", dpi=110)


# %%
# What the input cannot show.
def singular_values(method):
    """Of the signals that the output is a sum of: forced and two free motions of each mode, each of length 1."""
    signals = []
    for d in chain.d:
        mode = phc.ph(phc.modes(d, 1.0))
        for u, state in ((force[:LEARN], [0.0, 0.0]), (0.0, [1.0, 0.0]), (0.0, [0.0, 1.0])):
            signals.append(phc.forced_response(mode, time[:LEARN], u, state, method=method, intersample="zoh").outputs)
    return np.linalg.svd([x / np.linalg.norm(x) for x in signals], compute_uv=False)


print(f"u = sin t drives a zero of the chain: zeros {chain.modes.zeros.round(12)}, |G(i)| = {abs(chain(1j)):.1e}")
for method in ("exact", "euler"):
    ratio = singular_values(method)
    print(f"  {method}: signals of which the output is a sum, smallest of {len(ratio)} singular values {ratio[-1]:.0e}")
with warnings.catch_warnings(record=True) as told:
    warnings.simplefilter("always")
    exact = phc.forced_response(chain, time[:LEARN], force[:LEARN], START, intersample="zoh").outputs
    blind = phc.pem((force[:LEARN], exact), 2, dt=STEP)
print("  exact data:", *(str(warning.message) for warning in told))
print(
    f"  d = {blind.d.round(6)}, r = {blind.r.round(4)}: r is not determined; Euler's growing modes only seem to show it"
)
