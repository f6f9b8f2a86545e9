"""Lossless (port-Hamiltonian) linear systems for python-control."""

from .exceptions import (
    FileFormatError,
    IdentifiabilityWarning,
    IdentificationError,
    NotLosslessError,
    OutputExistsError,
    PHControlError,
    ResolutionWarning,
    StructureError,
)
from .identification.pem import pem
from .identification.result import PEMResult
from .modal import ModalForm
from .response import forced_response, impulse_response, initial_response, step_response
from .symplectic import is_hamiltonian_matrix, is_symplectic, symplectic_form, williamson
from .systems import PortHamiltonian, modes, ph

prediction_error_fit = pem
