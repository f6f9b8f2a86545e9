"""Models without losses, drawn or given by frequencies and weights, as tests of intervals and bands need them."""

import numpy as np

from ph_control import ModalSamples


def lossless_draws(d, r):
    """Draws of lossless models with frequencies and weights (k, n): residues `r d / 2` at the poles `i d`."""
    d, r = np.array(d, float), np.array(r, float)
    k, n = d.shape
    return ModalSamples(1j * d, (0.5 * r * d).reshape(k, n, 1, 1), np.zeros((k, 1, 1)), np.ones((k, n, 1)))
