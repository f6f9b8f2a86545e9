"""Lossless (port-Hamiltonian) linear systems for python-control."""

from .affine import AffineHamiltonian, Symmetry, affine, is_even, is_odd
from .canonical_forms import ControllableHamiltonian, ObservableHamiltonian, ch, oh, tf
from .casimirs import CasimirSplit, darboux, split_casimirs
from .coefficients import ScaledCoefficients
from .equivalence import filter_coefficients, same_filter, star_equivalent
from .exceptions import (
    ConditioningWarning,
    FileFormatError,
    FileMissingError,
    IdentifiabilityWarning,
    IdentificationError,
    NotLosslessError,
    OutputExistsError,
    PHControlError,
    ResolutionWarning,
    StructureError,
)
from .files import load, save
from .groupoids import PortHamiltonianGroupoid, ReducedGroupoid
from .identification.bootstrap import Bootstrap
from .identification.excitation import excitation
from .identification.excitation_report import Excitation
from .identification.gradient import GradientResult, gradient_descent
from .identification.orders import OrderSelection, order_selection
from .identification.pem import pem, prediction_error_fit
from .identification.prediction import FittedExperiment
from .identification.residuals import ResidualAnalysis, residual_analysis
from .identification.result import PEMResult
from .identification.samples import ModeSamples
from .identification.validation import Comparison, compare
from .isomorphism import Verdict, are_isomorphic, system_isomorphism
from .margins import margin, stability_margins
from .modal import ModalForm
from .mode_plots import modes_plot, pole_zero_plot
from .models import frenkel_kontorova, from_second_order, lc_circuit, spring_chain
from .morphisms import (
    ExpressivePower,
    MorphismCheck,
    controllable_morphism,
    expressive_power,
    is_morphism,
    lift_morphism,
    observable_morphism,
)
from .pairs import act, from_unique, to_unique
from .plots import bode_plot, fit_plot
from .realization import (
    CanonicalMargins,
    KalmanDecomposition,
    canonical_margins,
    kalman_decomposition,
    lift,
    minreal,
)
from .recordings import read_csv
from .response import forced_response, impulse_response, initial_response, step_response
from .sampling import EnergyBalance, energy_balance, sample
from .semidefinite import semidefinite_coefficients, williamson_semidefinite
from .spectra import spectral_estimate
from .symplectic import is_hamiltonian_matrix, is_symplectic, symplectic_form, williamson
from .systems import PortHamiltonian, modes, ph
from .time_plots import energy_plot, impulse_plot, step_plot
