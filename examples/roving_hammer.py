"""
A hammer test with nine positions
=================================

One accelerometer stays where it is, near the tip of a cantilever beam, and a hammer hits nine positions one after the
other: nine recordings with different inputs. Together they show natural frequencies, damping ratios and mode shapes,
with their standard errors.
"""

import control as ct
import matplotlib.pyplot as plt
import numpy as np

import ph_control as phc

RATE, SECONDS = 2000.0, 0.5  # Hz, s
POSITIONS = np.linspace(1, 9, 9) / 9  # in lengths of the beam, from the clamped end
SENSOR = 7  # the accelerometer sits where the hammer hits eighth

# %%
# The beam, 10 kg of steel: the first five bending modes of the textbook, scaled to unit modal mass.

roots = np.array([1.8751041, 4.6940911, 7.8547574, 10.9955407, 14.1371684])
HERTZ = 9.0 * (roots / roots[0]) ** 2
RATIOS = np.array([0.012, 0.006, 0.004, 0.005, 0.008])


def bending(x):
    """Modes of a clamped beam with a free end, shape (5, len(x))."""
    arc = roots[:, None] * x
    sigma = ((np.cosh(roots) + np.cos(roots)) / (np.sinh(roots) + np.sin(roots)))[:, None]
    return (np.cosh(arc) - np.cos(arc) - sigma * (np.sinh(arc) - np.sin(arc))) / np.sqrt(10.0)


shapes = bending(POSITIONS)
omega = 2 * np.pi * HERTZ
beam = phc.from_second_order(
    np.eye(5), np.diag(omega**2), shapes, C=np.diag(2 * RATIOS * omega), sensors={"acceleration": shapes[:, SENSOR]}
)

# %%
# The recordings: each hit is a half sine of 2 ms with another force, and the noise is 0.1 m/s² of the acceleration
# and 0.05 N of the force. Labels say which position was hit; that is how recordings of one test are told apart. `pem`
# sets the force to 0 outside the contact, and says so.

rng = np.random.default_rng(3)
t = np.arange(SECONDS * RATE) / RATE
recordings = []
for k in range(9):
    force = np.where((t >= 0.01) & (t < 0.012), rng.uniform(50, 150) * np.sin(np.pi * (t - 0.01) / 0.002), 0.0)
    inputs = np.zeros((9, t.size))
    inputs[k] = force
    clean = phc.forced_response(beam, t, inputs, intersample="zoh").outputs[-1]
    recording = ct.TimeResponseData(
        t, clean + 0.1 * rng.standard_normal(t.size),
        inputs=force + 0.05 * rng.standard_normal(t.size), issiso=True,
        input_labels=[f"hit {k + 1}"], output_labels=["acceleration"],
    )  # fmt: skip
    recording.time_unit = "s"
    recordings.append(recording)

# %%
# One fit of all nine. Hit 8 is where the accelerometer is: this driving point gives the shapes their scale.

result = phc.pem(recordings, quantity="acceleration", ports=[("acceleration", f"hit {SENSOR + 1}")])
print(result.summary())
for name, values, true in (("natural_frequencies", result.natural_frequencies, omega),
                           ("damping_ratios", result.damping_ratios, RATIOS)):  # fmt: skip
    assert np.all(np.abs(values - true) < 4.5 * result.stderr[name]), name

# %%
# A residue of an acceleration is ``psi_sensor psi_hit p^2 / (2j Im p)``: the nine hits show the shape at the nine
# positions, since a force here moves the beam there as much as one there does here. Models drawn from the distribution
# of the estimate give the standard errors.


def shape_of(poles, residues):
    """Shapes of unit modal mass at the nine positions, of one model or many: (..., 5, 9)."""
    products = (residues[..., 0, :] * (2j * poles.imag / poles**2)[..., None]).real
    return products / np.sqrt(products[..., [SENSOR]])


measured = shape_of(result.poles, result.residues)
drawn = result.sample(1000, rng=0)
spread = shape_of(drawn.poles, drawn.residues).std(axis=0)
turned = np.sign(shapes[:, [SENSOR]])  # a shape and its opposite are one
assert np.all(np.abs(measured - turned * shapes) < 5 * spread)

# %%
# The shapes over the beam and the textbook's, and damping ratios; intervals are those of 95 %.

x = np.linspace(0, 1, 300)
figure, axes = plt.subplots(2, 3, figsize=(9, 5.6), layout="constrained", sharex=True, sharey=True)
for l, axis in enumerate(axes.flat[:5]):
    axis.plot(x, turned[l] * bending(x)[l], color="0.6", label="textbook")
    axis.errorbar(
        POSITIONS, measured[l], 1.96 * spread[l], fmt="o", markersize=4, capsize=3, color="C0", label="nine hits, 95 %"
    )
    axis.plot(POSITIONS[SENSOR], measured[l, SENSOR], "s", markersize=8, fillstyle="none", color="C3", label="sensor")
    half = 196 * result.stderr["damping_ratios"][l]
    title = f"{result.hertz[l]:.2f} Hz, {100 * result.damping_ratios[l]:.3f} % ± {half:.3f} %"
    axis.set_title(title, loc="left", fontsize="medium")
    axis.axhline(0, color="0.3", linewidth=0.8)
    axis.grid(True, alpha=0.4)
figure.supylabel("Shape, unit modal mass [kg$^{-1/2}$]", fontsize="medium")
figure.supxlabel("Position [length of the beam]", fontsize="medium")
axes[0, 2].tick_params(labelbottom=True)
axes[1, 2].axis("off")
axes[1, 2].legend(*axes[0, 0].get_legend_handles_labels(), loc="center")
figure.savefig("roving_hammer.png", dpi=110)
