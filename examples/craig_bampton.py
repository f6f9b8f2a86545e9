"""
A tower crane of two substructures
==================================

The mast and the jib of a crane are welded lattices of 2100 and 3300 degrees of freedom, which meet in two joints.
Each is reduced on its own, and the small models are joined, in two ways: by Craig and Bampton, with modes of the part
clamped at the interface, and by `couple`, with modes of the free part and its residual modes. Both are compared with
the model of the whole crane.
"""

from itertools import pairwise

import matplotlib.pyplot as plt
import numpy as np
from scipy import sparse
from scipy.sparse.linalg import eigsh, splu

import ph_control as phc

E, RHO, A, I = 210e9, 7850.0, 1.9e-3, 2.9e-6  # steel tubes, 115 mm wide, wall of 5.5 mm: Pa, kg/m^3, m^2, m^4
BAY, PIECES = 1.5, 8  # length of a bay in m, elements of a member

# %%
# Mass and stiffness of a lattice of welded members. A joint is a complex number `x + i y`; members are cut into pieces
# with axial motion, bending and rotation of their ends (Euler and Bernoulli, consistent masses).


def beam(step):
    """Mass and stiffness of a beam that leads from one node to another, in the directions of the crane."""
    K, M, l = np.zeros((6, 6)), np.zeros((6, 6)), abs(step)
    axial, bending = np.ix_([0, 3], [0, 3]), np.ix_([1, 2, 4, 5], [1, 2, 4, 5])
    K[axial] = E * A / l * np.array([[1, -1], [-1, 1]])
    M[axial] = RHO * A * l / 6 * np.array([[2, 1], [1, 2]])
    K[bending] = E * I / l**3 * np.array(
        [[12, 6 * l, -12, 6 * l], [6 * l, 4 * l**2, -6 * l, 2 * l**2],
         [-12, -6 * l, 12, -6 * l], [6 * l, 2 * l**2, -6 * l, 4 * l**2]]
    )  # fmt: skip
    M[bending] = RHO * A * l / 420 * np.array(
        [[156, 22 * l, 54, -13 * l], [22 * l, 4 * l**2, 13 * l, -3 * l**2],
         [54, 13 * l, 156, -22 * l], [-13 * l, -3 * l**2, -22 * l, 4 * l**2]]
    )  # fmt: skip
    c, s = step.real / l, step.imag / l
    T = np.kron(np.eye(2), [[c, s, 0], [-s, c, 0], [0, 0, 1]])
    return T.T @ M @ T, T.T @ K @ T


def lattice(members):
    """Nodes, mass and stiffness matrix; what stands on the ground, at y = 0, is clamped and has no numbers."""
    members = np.array(members)
    points = members[:, :1] + (members[:, 1:] - members[:, :1]) * np.linspace(0.0, 1.0, PIECES + 1)
    ends = np.stack([points[:, :-1], points[:, 1:]], axis=2).reshape(-1, 2)
    nodes, numbers = np.unique(ends.round(6), return_inverse=True)
    where = (3 * numbers.reshape(-1, 2, 1) + np.arange(3)).reshape(-1, 6)
    rows, columns = np.repeat(where, 6, axis=1).ravel(), np.tile(where, 6).ravel()
    free = np.repeat(nodes.imag > 0, 3)
    made = []
    for entries in np.array([beam(last - first) for first, last in ends]).swapaxes(0, 1):
        made.append(sparse.csc_array((entries.ravel(), (rows, columns)))[free][:, free])
    return nodes[nodes.imag > 0], *made


def girder(start, along, across, bays):
    """Members of a straight lattice: chords, rungs and a diagonal in each bay; without the rung at its end."""
    low, high = (start + side + along * np.arange(bays + 1) for side in (0, across))
    chords = [pair for chord in (low, high) for pair in pairwise(chord)]
    diagonals = [(low[k], high[k + 1]) if k % 2 else (high[k], low[k + 1]) for k in range(bays)]
    return [*chords, *diagonals, *zip(low[:-1], high[:-1], strict=True)]


TOP, TIP = 24j * BAY, (28 + 24j) * BAY
mast_members = girder(0j, 1j * BAY, BAY, 24)
jib_members = [*girder(TOP - 8 * BAY, BAY, 1j * BAY, 36), (TIP, TIP + 1j * BAY)]
interface = [TOP, TOP + BAY]


def numbers_at(nodes, places):
    """Degrees of freedom (x, y, rotation) of the nodes at these places."""
    return np.concatenate([3 * np.argmin(abs(nodes - place)) + np.arange(3) for place in places])


# %%
# The whole crane: its lowest natural frequencies, and the velocity of the tip of the jib under a vertical force there,
# by a factorisation at each frequency. Damping is `C = 0.1 M + 1e-4 K`.


def damping(M, K):
    """Rayleigh damping."""
    return 0.1 * M + 1e-4 * K


nodes, M, K = lattice(mast_members + jib_members)
tip = numbers_at(nodes, [TIP])[1]
force = np.zeros(K.shape[0], complex)
force[tip] = 1.0
COUNT = 14
exact = np.sqrt(np.sort(eigsh(K, COUNT, M, sigma=0.0, return_eigenvectors=False)))
hertz = exact / (2 * np.pi)
print(f"crane: {K.shape[0]} degrees of freedom, {COUNT} modes from {hertz[0]:.2f} to {hertz[-1]:.1f} Hz")
w = np.sort([*np.geomspace(0.5 * exact[0], 1.1 * exact[-1], 140), *exact])
dynamic = [(K + 1j * x * damping(M, K) - x**2 * M).tocsc() for x in w]
mobility = np.array([
    1j * x * splu(Z, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.1).solve(force)[tip]
    for x, Z in zip(w, dynamic, strict=True)
])  # fmt: skip

# %%
# The parts. Their ports are the six degrees of freedom of the interface, and of the jib its tip.

parts = [lattice(mast_members), lattice(jib_members)]
ports = [numbers_at(part[0], interface) for part in parts]
shared = len(ports[0])
ports[1] = np.append(ports[1], numbers_at(parts[1][0], [TIP])[1])
KEPT = 14  # modes of each part

# %%
# Craig and Bampton: the coordinates of a part are the displacements of its ports, with the deflections that they impose
# on the inside at rest (constraint modes), and the modes of the inside while the ports are clamped, which
# `from_second_order` finds. Parts are assembled like elements, by the displacements that they share.


def craig_bampton(M, K, at):
    """Basis of a part: the constraint modes of its ports, then the lowest fixed-interface modes."""
    inside = np.setdiff1d(np.arange(K.shape[0]), at)
    K_inside, K_ports = K[inside][:, inside], K[inside][:, at].toarray()
    M_inside = M[inside][:, inside]
    clamped = phc.from_second_order(M_inside, K_inside, K_ports, modes=KEPT, residual_modes=False).structural_modes
    basis = np.zeros((K.shape[0], len(at) + KEPT))
    basis[at, : len(at)] = np.eye(len(at))
    basis[inside] = np.hstack([-splu(K_inside.tocsc()).solve(K_ports), clamped.shapes])
    return basis


size = shared + 2 * KEPT + 1  # interface, modes of the mast, tip, modes of the jib
M_small, K_small = np.zeros((size, size)), np.zeros((size, size))
for (_, M_part, K_part), at, first in zip(parts, ports, (shared, shared + KEPT), strict=True):
    T = craig_bampton(M_part, K_part, at)
    where = np.r_[:shared, first : first + T.shape[1] - shared]
    M_small[np.ix_(where, where)] += T.T @ M_part @ T
    K_small[np.ix_(where, where)] += T.T @ K_part @ T
fixed = phc.from_second_order(M_small, K_small, np.eye(size)[shared + KEPT], C=damping(M_small, K_small))

# %%
# The same with systems: of each part the modes while its ports are free, of the jib with its three rigid ones, and a
# residual mode for each port, which keeps the flexibility of all modes that are left out. `couple` makes the ports of
# both move together.


def coupled(residual_modes=True):
    """Crane of two reduced systems; its ports are the six of the interface and the tip."""
    systems = []
    for (_, M_part, K_part), at, name in zip(parts, ports, ("mast", "jib"), strict=True):
        F, C = sparse.eye_array(K_part.shape[0], format="csc")[:, at], damping(M_part, K_part)
        systems.append(
            phc.from_second_order(M_part, K_part, F, C=C, modes=KEPT, residual_modes=residual_modes, name=name)
        )
    return phc.couple(*systems, ports=[(k, k) for k in range(shared)])


# %%
# Two models of 35 modes in place of 5400. Their natural frequencies are above those of the crane, since they restrict
# its motion. At a resonance a response is off by about the error of the frequency over the damping ratio, which is 0.3
# to 3 % here. Modes of free parts without residual modes are of no use: the joints are far too stiff.

models = {"Craig-Bampton": fixed, "couple": coupled(), "couple, no residual modes": coupled(residual_modes=False)}
errors, off = {}, {}
for name, model in models.items():
    found = np.sort(model.natural_frequencies)
    errors[name] = found[found > 1e-3 * exact[0]][:COUNT] / exact - 1
    response = np.reshape(model(1j * w), (-1, len(w)))[-1]  # at the tip, which is the last port
    off[name] = np.max(abs(response / mobility - 1))
    print(f"{name}: {model.n} modes; relative errors of natural frequencies up to {errors[name].max():.1e}, "
          f"of the response {off[name]:.1e}")  # fmt: skip
    assert np.all(errors[name] > -1e-9) and phc.passivity(model).is_passive
assert errors["Craig-Bampton"].max() < 3e-3 and off["Craig-Bampton"] < 0.3
assert errors["couple"].max() < 3e-4 and off["couple"] < 0.06
assert errors["couple, no residual modes"].max() > 0.1

# %%
# The crane, the response of its tip, and the errors of the natural frequencies.

figure, axes = plt.subplot_mosaic(
    [["crane", "crane"], ["response", "errors"]], figsize=(10, 9), layout="constrained", height_ratios=[1.35, 1]
)
for members, color, name in ((mast_members, "C0", "mast"), (jib_members, "C1", "jib")):
    lines = axes["crane"].plot(np.real(members).T, np.imag(members).T, color=color, linewidth=1)
    lines[0].set_label(name)
axes["crane"].plot(np.real(interface), np.imag(interface), "k.", label="interface")
axes["crane"].annotate(
    "force", (TIP.real, TIP.imag - 0.3), (TIP.real, TIP.imag - 7.0), ha="center", arrowprops={"arrowstyle": "->"}
)
axes["crane"].set(aspect="equal", xlabel="x [m]", ylabel="y [m]", ylim=(-1, 42))
fine = np.geomspace(w[0], w[-1], 2000)
MARKERS = dict(zip(models, "os^", strict=True))
for (name, model), color, width in zip(models.items(), ("C2", "C3", "0.75"), (2.5, 1.0, 1.0), strict=True):
    response = np.reshape(model(1j * fine), (-1, len(fine)))[-1]
    axes["response"].loglog(
        fine / (2 * np.pi), abs(response), color=color, linewidth=width, zorder=1 + (color[0] == "C"), label=name
    )
    axes["errors"].semilogy(hertz, errors[name], MARKERS[name], color=color, label=name)
axes["response"].loglog(w / (2 * np.pi), abs(mobility), "k.", markersize=3, zorder=3, label="whole crane")
axes["response"].set(xlabel="Frequency [Hz]", ylabel="Mobility of the tip [(m/s)/N]")
axes["errors"].set(xlabel="Natural frequency [Hz]", ylabel="Relative error of the frequency")
axes["crane"].legend(loc="lower right")
axes["response"].legend(fontsize="small", loc="lower left")
axes["errors"].legend(fontsize="small", loc="lower right")
for name in ("response", "errors"):
    axes[name].grid(alpha=0.4)
figure.savefig("crane.png", dpi=110)
