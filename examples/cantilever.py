"""
Modal test of a beam
====================

A steel cantilever of one metre carries nine accelerometers; a hammer hits it at its tip and at two thirds of its
length. The pictures of such a test: frequency responses with what was measured, poles that stay from order to order,
mode shapes, and how they compare with those of a model.
"""

# sphinx_gallery_thumbnail_number = 2
import control as ct
import numpy as np

import ph_control as phc

LENGTH, WIDTH, HEIGHT, E, RHO = 1.0, 0.04, 0.008, 205e9, 7850.0  # steel, in m, Pa and kg/m^3
ELEMENTS, STEP, SAMPLES = 9, 2.5e-4, 24_000
POSITIONS = np.arange(1, 10) / 9 * LENGTH
ACCELEROMETERS = [f"a{k}" for k in range(1, 10)]

# %%
# The beam by finite elements (Euler and Bernoulli), clamped at one end, with proportional damping. Forces act at the
# tip and at two thirds; accelerometers are at all nine joints.


def beam(clamp=1.0):
    """Beam with two ports and nine sensors; the element at the clamp is `clamp` times as stiff as the others."""
    l, size = LENGTH / ELEMENTS, 2 * (ELEMENTS + 1)
    bending = np.array(
        [[12, 6 * l, -12, 6 * l], [6 * l, 4 * l**2, -6 * l, 2 * l**2],
         [-12, -6 * l, 12, -6 * l], [6 * l, 2 * l**2, -6 * l, 4 * l**2]]
    )  # fmt: skip
    inertia = np.array(
        [[156, 22 * l, 54, -13 * l], [22 * l, 4 * l**2, 13 * l, -3 * l**2],
         [54, 13 * l, 156, -22 * l], [-13 * l, -3 * l**2, -22 * l, 4 * l**2]]
    )  # fmt: skip
    K, M = np.zeros((size, size)), np.zeros((size, size))
    for k in range(ELEMENTS):
        part = slice(2 * k, 2 * k + 4)
        K[part, part] += (clamp if k == 0 else 1.0) * E * WIDTH * HEIGHT**3 / 12 / l**3 * bending
        M[part, part] += RHO * WIDTH * HEIGHT * l / 420 * inertia
    K, M, joints = K[2:, 2:], M[2:, 2:], np.eye(size - 2)[::2]
    forces, accelerometers = joints[[8, 5]].T, joints
    names = {"inputs": ["tip", "two thirds"], "outputs": ["v tip", "v two thirds", *ACCELEROMETERS]}
    C = 1.5 * M + 1e-5 * K
    return phc.from_second_order(M, K, forces, C=C, sensors={"acceleration": accelerometers}, **names)


def measured_part(structure):
    """Its accelerations, without the velocities of the ports."""
    return ct.ss(structure)[2:, :]


# %%
# Two recordings of six seconds with one hit each, and 0.5 % of noise.

structure, rng, t = beam(), np.random.default_rng(0), STEP * np.arange(SAMPLES)
blow = np.where(t < 2e-3, 200 * np.sin(np.pi * t / 2e-3) ** 2, 0.0)
recordings = []
for where in (0, 1):
    force = np.outer([where == 0, where == 1], blow)
    acceleration = phc.forced_response(structure, t, force).outputs[2:]
    noise = 0.005 * np.std(acceleration, axis=1, keepdims=True) * rng.standard_normal(acceleration.shape)
    recordings.append(ct.TimeResponseData(t, acceleration + noise, inputs=force, output_labels=ACCELEROMETERS))

# %%
# The responses that both recordings give together, beneath those of a model whose clamp is too soft: its resonances and
# antiresonances are low.

model = measured_part(beam(clamp=0.7))
band = [3.0, 450.0]
plot = phc.frf_plot(
    model, recordings, outputs=["a1", "a5", "a9"], omega_limits=band, intersample="bandlimited",
    time_unit="s", gain_unit="m/s²/N", title="Beam: model with a soft clamp, and measurement",
)  # fmt: skip
plot.figure.savefig("beam_responses.png", dpi=110)

# %%
# Poles and shapes of models of ascending order, here by shift invariance of the decay after the first hit (the
# eigensystem realization of Juang and Pappa). Those of the structure stay, in frequency, damping and shape; others come
# and go.

decay = recordings[0].outputs[:, 10:3000:2]  # every second sample
U, sizes, _ = np.linalg.svd(np.concatenate([decay[:, k : k + 600] for k in range(60)]), full_matrices=False)
orders, models = list(range(2, 33, 2)), []
for order in orders:
    seen = U[:, :order] * np.sqrt(sizes[:order])
    values, vectors = np.linalg.eig(np.linalg.pinv(seen[:-9]) @ seen[9:])
    kept = values.imag > 0
    models.append((np.log(values[kept]) / (2 * STEP), (seen[:9] @ vectors[:, kept]).T))
plot = phc.stabilisation_plot(models, recordings, orders=orders, chosen=18, omega_limits=[0.0, 600.0], time_unit="s")
plot.figure.savefig("beam_stabilisation.png", dpi=110)

# %%
# The shapes of the five lowest modes of order 18, over the positions of the accelerometers.

poles, shapes = models[orders.index(18)]
lowest = np.argsort(np.abs(poles))[:5]
poles, shapes = poles[lowest], shapes[lowest]
plot = phc.shape_plot(shapes, POSITIONS, poles=poles, position_unit="m", time_unit="s")
plot.figure.savefig("beam_shapes.png", dpi=110)
truth = phc.modes(measured_part(structure))
print("measured [Hz]", (np.abs(poles) / (2 * np.pi)).round(2))
print("beam     [Hz]", (truth.natural_frequencies[:5] / (2 * np.pi)).round(2))
assert np.allclose(np.abs(poles), truth.natural_frequencies[:5], rtol=5e-3)

# %%
# Although its frequencies are off, the soft model has nearly the same shapes: the modal assurance criterion is close to
# 1 on the diagonal.

plot = phc.mac_plot(shapes, phc.modes(model).shapes[:5], label=["test", "model"])
plot.figure.savefig("beam_assurance.png", dpi=110)
assert np.all(np.diag(plot.lines[0, 0][0].get_array()) > 0.98)

# %%
# Near each resonance the response draws a circle, of which the measured points say how well it was resolved.

plot = phc.circle_plot(
    measured_part(structure), recordings, modes=[0, 1, 2, 3], intersample="bandlimited", time_unit="s",
    gain_unit="m/s²/N",
)  # fmt: skip
plot.figure.savefig("beam_circles.png", dpi=110)
