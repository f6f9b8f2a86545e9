"""
A tower in the wind
===================

Nobody measures the wind. Four velocity sensors on a tower record ten minutes of its motion, and a pump below runs all
the time. From the outputs alone, `pem` finds the modes, with standard errors, and tells the pump from the modes.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.signal import welch

import ph_control as phc

# %%
# A tower of four storeys on an elastic ground. The wind pushes all storeys, each at random; `lightly` is the damping
# that we look for.

MASSES, STIFFNESS = [300.0, 280.0, 260.0, 200.0], 2.6e5  # kg, N/m
lightly = np.array([0.008, 0.010, 0.012, 0.015])
M, K = np.diag(MASSES), STIFFNESS * (2 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1))
K[-1, -1] = STIFFNESS
squares, modes = np.linalg.eigh(K / np.sqrt(np.outer(MASSES, MASSES)))
omega, phi = np.sqrt(squares), modes / np.sqrt(MASSES)[:, None]
C = M @ phi @ np.diag(2 * lightly * omega) @ phi.T @ M
tower = phc.from_second_order(M, K, np.eye(4), C=C)

# %%
# The wind changes much faster than the tower moves: 200 gusts a second, while the sensors record 20 values a second.
# The pump turns at 3.1 Hz, and each sensor adds a tenth of noise.

FAST, EVERY, SAMPLES = 0.005, 10, 12_000
rng = np.random.default_rng(3)
gusts = 400 * rng.standard_normal((4, EVERY * SAMPLES))
t = FAST * np.arange(EVERY * SAMPLES)
y = phc.forced_response(tower, t, gusts, intersample="zoh").outputs[:, ::EVERY]
STEP = FAST * EVERY
pump = 0.4 * np.sin(2 * np.pi * 3.1 * STEP * np.arange(SAMPLES))
y = y + y.std(axis=1, keepdims=True) * (np.array([[1.0], [0.6], [0.3], [0.2]]) * pump)
y = y + 0.1 * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape)

# %%
# There is no input: the first of the pair is `None`. That the record is no free decay is decided by the likelihood.

result = phc.pem((None, y), dt=STEP)
print(result.summary())
assert result.order == 4 and result.is_ambient
for name, true in (("natural_frequencies", omega), ("damping_ratios", lightly)):
    assert np.all(np.abs(getattr(result, name) - true) < 4 * result.stderr[name]), name
(hum,) = [finding for finding in result.findings if finding.cause.name == "HUM"]
print(f"the pump: {hum.values[0] / (2 * np.pi):.4f} Hz")

# %%
# Damping is the hard part. In `N` periods, one mode alone in little noise has a coefficient of variation of
# `1 / sqrt(2 pi zeta N)`, whatever the method: only a longer record makes it smaller.

law = 1 / np.sqrt(2 * np.pi * lightly * omega / (2 * np.pi) * STEP * SAMPLES)
print("coefficient of variation of damping:", (result.stderr["damping_ratios"] / result.damping_ratios).round(2))
print("the law:                            ", law.round(2))

# %%
# Shapes have no scale, as no force was measured, but they compare with those of a model.

assurance = np.diag(result.mac(phi.T))
print("modal assurance with the model:", assurance.round(4))
assert np.all(assurance > 0.97)

# %%
# The spectrum of the top, and what the intervals say.

figure, (spectrum, damping) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
hertz, density = welch(y[-1], fs=1 / STEP, nperseg=2000)
spectrum.semilogy(hertz[1:], density[1:], color="0.5", lw=1)
for k, f in enumerate(omega / (2 * np.pi)):
    spectrum.axvline(f, color="C0", ls=":", zorder=1, label="modes" if k == 0 else None)
spectrum.axvline(hum.values[0] / (2 * np.pi), color="C3", ls="--", zorder=1, label="pump")
spectrum.set(xlabel="Frequency [Hz]", ylabel="PSD of the top's velocity [(m/s)²/Hz]", xlim=(0, 1 / (2 * STEP)))
spectrum.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, frameon=False)
damping.errorbar(omega / (2 * np.pi), 100 * result.damping_ratios, 196 * result.stderr["damping_ratios"], fmt="o",
                 label="fit, 95 %")  # fmt: skip
damping.plot(omega / (2 * np.pi), 100 * lightly, "k_", ms=14, label="true")
damping.set(xlabel="Frequency [Hz]", ylabel="Damping ratio [%]", ylim=(0, None))
damping.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, frameon=False)
for axis in (spectrum, damping):
    axis.grid(alpha=0.4)
figure.savefig("ambient_tower.png", dpi=120)
