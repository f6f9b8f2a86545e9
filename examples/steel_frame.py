"""
A steel frame of 147 degrees of freedom
=======================================

A plane frame of seven storeys and six bays, welded from HEB 200 beams and fixed to the ground: 49 joints with two
displacements and a rotation each. It is of the size and kind of the frame in the LUND matrices of the Harwell-Boeing
collection (147 degrees of freedom, 2.3 to 236 Hz in SI units), and made here from the formulas of a beam, so that all
is known.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.linalg import eigh

import ph_control as phc

E, rho, A, I = 210e9, 7850.0, 78.1e-4, 5696e-8  # steel, HEB 200: Pa, kg/m^3, m^2, m^4
STOREYS, COLUMNS, HEIGHT, BAY = 7, 7, 3.0, 5.0

# %%
# Stiffness and mass of one beam, and of all of them together. A beam has axial motion, bending and rotation of its
# ends (Euler and Bernoulli, consistent masses).


def beam(length, angle):
    """Stiffness and mass of a beam between two joints, in the directions of the frame."""
    K, M = np.zeros((6, 6)), np.zeros((6, 6))
    axial, bending = np.ix_([0, 3], [0, 3]), np.ix_([1, 2, 4, 5], [1, 2, 4, 5])
    l = length
    K[axial] = E * A / l * np.array([[1, -1], [-1, 1]])
    M[axial] = rho * A * l / 6 * np.array([[2, 1], [1, 2]])
    K[bending] = E * I / l**3 * np.array(
        [[12, 6 * l, -12, 6 * l], [6 * l, 4 * l**2, -6 * l, 2 * l**2],
         [-12, -6 * l, 12, -6 * l], [6 * l, 2 * l**2, -6 * l, 4 * l**2]]
    )  # fmt: skip
    M[bending] = rho * A * l / 420 * np.array(
        [[156, 22 * l, 54, -13 * l], [22 * l, 4 * l**2, 13 * l, -3 * l**2],
         [54, 13 * l, 156, -22 * l], [-13 * l, -3 * l**2, -22 * l, 4 * l**2]]
    )  # fmt: skip
    c, s = np.cos(angle), np.sin(angle)
    T = np.kron(np.eye(2), [[c, s, 0], [-s, c, 0], [0, 0, 1]])
    return T.T @ K @ T, T.T @ M @ T


joints = {(column, storey): column + COLUMNS * storey for storey in range(STOREYS + 1) for column in range(COLUMNS)}
members = [(joints[c, s], joints[c, s + 1], HEIGHT, np.pi / 2) for c in range(COLUMNS) for s in range(STOREYS)]
members += [(joints[c, s], joints[c + 1, s], BAY, 0.0) for c in range(COLUMNS - 1) for s in range(1, STOREYS + 1)]
size = 3 * len(joints)
K, M = np.zeros((size, size)), np.zeros((size, size))
for one, other, length, angle in members:
    where = np.r_[3 * one : 3 * one + 3, 3 * other : 3 * other + 3]
    stiffness, mass = beam(length, angle)
    K[np.ix_(where, where)] += stiffness
    M[np.ix_(where, where)] += mass
K, M = K[3 * COLUMNS :, 3 * COLUMNS :], M[3 * COLUMNS :, 3 * COLUMNS :]  # the lowest joints are fixed
n = len(K)

# %%
# A hammer hits the roof sideways at the middle column, and a sensor there measures the velocity.

hit = 3 * (joints[COLUMNS // 2, STOREYS] - COLUMNS)
b = np.zeros(n)
b[hit] = 1.0
frame = phc.from_second_order(M, K, b, name="frame", inputs="force", outputs="velocity")
hertz = frame.d / (2 * np.pi)
reference, shapes = eigh(K, M)
print(f"{n} degrees of freedom, {hertz[0]:.2f} to {hertz[-1]:.0f} Hz")
print(f"largest relative difference from scipy.linalg.eigh: {np.max(np.abs(frame.d / np.sqrt(reference) - 1)):.0e}")

# %%
# The frame is symmetric about its middle column, and a sideways blow there moves only the modes in which both sides
# sway alike: 3 numbers for each of 21 joints of one side, and 2 for each of the 7 in the middle, which cannot rise.
# The other modes are hidden: no experiment with this hammer and this sensor shows them.

seen = phc.minreal(frame)
print(f"modes that the hammer reaches: {seen.n} of {frame.n}")
assert seen.n == 3 * 21 + 2 * 7
grid = np.linspace(1.0, 4000.0, 500)
print(f"largest relative change of the gain without the others: "
      f"{np.max(np.abs(seen.modes.freqresp(grid) / frame.modes.freqresp(grid) - 1)):.0e}")  # fmt: skip

# %%
# The response of the roof below 30 Hz. A blow of 1 N s, as a force of 2 ms, leaves the frame ringing for ever: the
# energy of the blow is kept to rounding.

plot = phc.bode_plot(
    seen, title="Roof of the frame", omega_limits=(0.5, 30.0), Hz=True, gain_unit="(m/s)/N", plot_phase=False
)
plot.figure.savefig("frame_bode.png", dpi=110)
h = 1e-3
t = h * np.arange(4000)
force = np.where(t < 2e-3, 500.0, 0.0)
response = phc.forced_response(seen, t, force, intersample="zoh")
stored = phc.energy_balance(response, seen).stored
print(f"energy after the blow {1e3 * stored[2]:.4f} mJ, four seconds later {1e3 * stored[-1]:.4f} mJ")
assert abs(stored[-1] / stored[2] - 1) < 1e-10

# %%
# The first modes that the hammer sees, and the first that it does not.

place = np.array([(BAY * c, HEIGHT * s) for (c, s) in joints])
figure, axes = plt.subplots(1, 4, figsize=(10, 2.2), layout="constrained", sharex=True, sharey=True)
hidden = np.array([np.min(np.abs(seen.d / d - 1)) > 1e-6 for d in np.sqrt(reference)])
chosen = [*np.flatnonzero(~hidden)[:2], *np.flatnonzero(hidden)[:2]]
for mode, axis in zip(chosen, axes, strict=True):
    motion = np.zeros((len(joints), 2))
    motion[COLUMNS:] = shapes[:, mode].reshape(-1, 3)[:, :2]
    moved = place + 2.5 * motion / np.max(np.abs(motion))
    for one, other, *_ in members:
        axis.plot(*place[[one, other]].T, color="0.85", linewidth=1, zorder=1)
        axis.plot(*moved[[one, other]].T, color="C0", linewidth=1.2)
    axis.set_title(f"{hertz[mode]:.2f} Hz, {'hidden' if hidden[mode] else 'seen'}", fontsize="medium")
    axis.set_aspect("equal")
    axis.set_axis_off()
figure.savefig("frame_modes.png", dpi=110)
