"""Zeros and poles of systems of all classes are exact conjugate pairs, as functions of python-control want them."""

import control as ct
import numpy as np
import pytest

import ph_control as phc


def damped_chain(n, c, ports=0):
    rng = np.random.default_rng(n)
    springs = rng.uniform(1, 5, n - 1) if n > 1 else []
    return phc.spring_chain(rng.uniform(0.5, 2, n), springs, ground=rng.uniform(0.1, 2, n), c=c, port=ports)


def lossless():
    return phc.ph(phc.modes([1.0, 2.0, 3.0], [1.0, 0.5, 2.0]))


SYSTEMS = {
    **{f"chain of {n}, {c}": lambda n=n, c=c: damped_chain(n, c) for n in (1, 2, 5, 9) for c in (0.0, 0.03, 0.6, 4.0)},
    "two ports": lambda: damped_chain(4, 0.1, [0, 3]),
    "lossless two ports": lambda: damped_chain(4, 0.0, [0, 3]),
    "critical": lambda: phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0], R=np.diag([0.0, 4.0])),
    "equal damped modes": lambda: phc.ph(phc.modes([1.0, 2.0, 2.0], [1.0, 0.5, 2.0], damping=[1.0, 0.1, 1.0])),
    "lossless": lossless,
    "controllable form": lambda: phc.ch(lossless()),
    "observable form": lambda: phc.oh(lossless()),
    "affine": lambda: phc.affine(lossless().Q, lossless().B),
    "of a transfer function": lambda: phc.ph(ct.tf([2.0, 1.0, 3.0], [1.0, 0.4, 2.0])),
    "of none": lambda: phc.ph([[2.0]], [1.0], R=[[0.3]], J=[[0.0]]),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_zeros_and_poles_make_a_real_transfer_function(name):
    sys = SYSTEMS[name]()
    zeros, poles = sys.zeros(), sys.poles()
    for roots in (zeros, poles, sys.modes.zeros, sys.modes.poles):
        assert np.array_equal(np.sort(roots), np.sort(roots.conj()))
    made = ct.zpk(zeros, poles, 1.0)
    assert np.isrealobj(made.num_array[0, 0]) and np.isrealobj(made.den_array[0, 0])
    if sys.ninputs == 1:
        # the same but for a factor, where no pole or zero is near
        points = np.array([0.7 + 1.9j, 2.1 + 0.4j, 1.3 + 5.0j])
        ratio = made(points) / sys(points)
        assert np.max(np.abs(ratio / ratio[0] - 1)) < 1e-9


@pytest.mark.parametrize("n", [2, 6])
def test_zeros_with_losses_are_those_of_the_matrices(n):
    sys = damped_chain(n, 0.2)
    for z in sys.zeros():
        pencil = np.block([[z * np.eye(2 * n) - sys.A, -sys.B], [sys.C, sys.D]])
        assert np.linalg.svd(pencil, compute_uv=False)[-1] < 1e-13 * np.linalg.norm(pencil)


@pytest.mark.parametrize("ports", [[0], [0, 2]])
@pytest.mark.parametrize("mass, time", [(1e20, 1.0), (1e12, 1e-9), (1.0, 1e9), (1e-12, 1.0)])
def test_zeros_do_not_depend_on_the_units(ports, mass, time):
    M, K = np.diag([1.0, 2.0, 1.5]), np.array([[5.0, -4, 0], [-4, 9, -4], [0, -4, 5]])
    F, C = np.eye(3)[:, ports], 0.05 * K
    plain = phc.from_second_order(M, K, F, C=C).zeros()
    scaled = phc.from_second_order(mass * M, mass / time**2 * K, F, C=mass / time * C).zeros() * time
    np.testing.assert_allclose(np.sort_complex(scaled), np.sort_complex(plain), atol=1e-10)
