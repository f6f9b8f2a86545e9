"""
From 100 000 degrees of freedom to a controller
===============================================

A building of thirty storeys and twenty bays, as finite elements. Forty modes of it are enough for its response up to a
few hertz, twenty states for a controller, and since all of them are port-Hamiltonian, the controller that was made for
the smallest damps the largest. ``python large_frame.py 29`` splits every beam and column into 29 elements: 105 210
degrees of freedom, ten seconds of one core. Without an argument it is two elements each, and 5 580 degrees of freedom.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np
from scipy import sparse

import ph_control as phc

E, rho, A, I = 210e9, 7850.0, 149e-4, 25170e-8  # steel, HEB 300: Pa, kg/m^3, m^2, m^4
STOREYS, COLUMNS, HEIGHT, BAY = 30, 21, 3.0, 5.0
parts = int(sys.argv[1]) if len(sys.argv) == 2 else 2

# %%
# Stiffness and mass of an element that lies, or stands, and the sums over all.


def element(length, standing):
    """Stiffness and mass of a piece of a beam, displacements and rotation of each end."""
    l, L = length, np.diag([1.0, 1.0, length] * 2)
    K, M = np.zeros((6, 6)), np.zeros((6, 6))
    axial, bending = np.ix_([0, 3], [0, 3]), np.ix_([1, 2, 4, 5], [1, 2, 4, 5])
    K[axial], M[axial] = E * A / l * np.array([[1, -1], [-1, 1]]), rho * A * l / 6 * np.array([[2, 1], [1, 2]])
    K[bending] = E * I / l**3 * np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]])
    M[bending] = rho * A * l / 420 * np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22],
                                               [-13, -3, -22, 4]])  # fmt: skip
    turn = np.kron(np.eye(2), [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]) if standing else np.eye(6)
    return turn.T @ L @ K @ L @ turn, turn.T @ L @ M @ L @ turn


joint = np.arange((STOREYS + 1) * COLUMNS).reshape(STOREYS + 1, COLUMNS)
count, stiffness, mass, where = joint.size, [], [], []
for standing, first, last, length in (
    (True, joint[:-1].ravel(), joint[1:].ravel(), HEIGHT), (False, joint[1:, :-1].ravel(), joint[1:, 1:].ravel(), BAY)
):  # fmt: skip
    inner = count + np.arange(len(first) * (parts - 1)).reshape(len(first), parts - 1)
    count += inner.size
    nodes = np.column_stack([first, inner, last])
    ends = np.column_stack([nodes[:, :-1].ravel(), nodes[:, 1:].ravel()])
    where.append((3 * ends[:, :, None] + np.arange(3)).reshape(-1, 6))
    k, m = element(length / parts, standing)
    stiffness.append(np.tile(k.ravel(), len(ends)))
    mass.append(np.tile(m.ravel() * (1.0 if standing else 3.0), len(ends)))  # beams carry floors
where = np.concatenate(where)
rows, columns = np.repeat(where, 6, axis=1).ravel(), np.tile(where, 6).ravel()
K, M = (sparse.coo_array((np.concatenate(one), (rows, columns)), (3 * count, 3 * count)).tocsc()[3 * COLUMNS :]
        [:, 3 * COLUMNS :] for one in (stiffness, mass))  # fmt: skip

# %%
# Ports are the sideways force and velocity of the roof and of the fifteenth floor. Damping is that of Rayleigh, 0.2
# to 1.1 % of critical.

F = np.zeros((K.shape[0], 2))
for port, storey in enumerate((STOREYS, STOREYS // 2)):
    F[3 * (joint[storey, 0] - COLUMNS), port] = 1.0
frame = phc.from_second_order(M, K, F, C=0.02 * M + 2e-4 * K, modes=40, inputs=["roof", "middle"],
                              outputs=["speed of the roof", "speed of the middle"])  # fmt: skip
print(f"{K.shape[0]} degrees of freedom, {frame.nstates} states of the lowest modes, "
      f"{frame.hertz[0]:.2f} to {np.sort(frame.hertz)[39]:.1f} Hz")  # fmt: skip
print("damping of the first modes:", " ".join(f"{100 * z:.2f}" for z in frame.damping_ratios[:5]), "%")

# %%
# Models of 20 states by three methods, and what each loses of the response. Where damping is light, the two storages
# that balancing compares differ little; the heights of resonances and the H2 norm tell better what counts.

highest = max(np.linalg.norm(frame(2j * np.pi * f), 2) for f in frame.hertz[:10])
models = {method: phc.reduce(frame, 20, method=method) for method in ("modal", "balanced", "h2")}
for method, model in models.items():
    print(f"{method}: largest error {100 * model.error_bound / highest:.1f} % of the highest resonance")
small = models["h2"]
assert max(small.error_bound, models["modal"].error_bound) < 0.3 * models["balanced"].error_bound

# %%
# A passive LQG controller for the small model, joined to the large one. That it damps modes that the small model does
# not have, and makes none unstable, needs no check: both are passive.

controller = phc.lqg(small, 1e-6)
loop = phc.damping_injection(frame, controller)
assert isinstance(loop, phc.PortHamiltonian) and loop.poles().real.max() < 0
least = [100 * one.damping_ratios[one.hertz < 3.0].min() for one in (frame, loop)]
print(
    f"a controller of {controller.nstates} states: least damping below 3 Hz {least[1]:.1f} %, before {least[0]:.1f} %"
)
assert least[1] > 10 * least[0]

f = np.geomspace(0.3, 12.0, 1500)
figure, axis = plt.subplots(layout="constrained", figsize=(7, 4.2))
for name, one, style in (
    ("frame, 40 modes", frame, "-"),
    ("model, 20 states", small, "--"),
    ("frame with the controller", loop, "-."),
):
    axis.loglog(f, np.abs(one(2j * np.pi * f)[0, 0]), style, label=name)
axis.set(xlabel="Frequency [Hz]", ylabel="Mobility of the roof [(m/s)/N]")
axis.grid(alpha=0.4)
axis.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3, fontsize="small", frameon=False)
figure.savefig("large_frame.png", dpi=110)
