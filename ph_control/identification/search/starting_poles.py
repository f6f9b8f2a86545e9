"""Poles to start a search from, of whatever describes a model."""

from __future__ import annotations

from typing import Any

import control as ct
import numpy as np

from ..._types import ComplexArray
from ...exceptions import StructureError
from ...modal.modal_form import ModalForm
from ...systems.port_hamiltonian import modes


def poles_of(guess: Any) -> ComplexArray:
    """Return the poles of positive imaginary part and the real ones of a result, pair (d, r), modal form or system."""
    if isinstance(guess, tuple | list) and len(guess) == 2:
        guess = modes(*guess)
    if isinstance(getattr(guess, "poles", None), np.ndarray) and not isinstance(guess, ModalForm):
        poles = np.asarray(guess.poles)
    elif isinstance(form := guess if isinstance(guess, ModalForm) else getattr(guess, "modes", None), ModalForm):
        poles = np.asarray(form.mode_poles)
    elif isinstance(guess, ct.StateSpace | ct.TransferFunction):
        poles = np.asarray(guess.poles())
    else:
        raise StructureError(
            f"initial_guess is a {type(guess).__name__}; pass a result, a pair (d, r), a ModalForm or a system"
        )
    poles = poles[poles.imag >= 0].astype(complex)
    if not len(poles):
        raise StructureError("initial_guess has no modes and no real poles to start from")
    return poles
