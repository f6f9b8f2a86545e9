"""Transfer functions: polynomials made of the modes, as products of positive numbers where there is one port."""

from __future__ import annotations

from typing import Any

import control as ct
import numpy as np

from .. import _checks
from .._types import Array, SystemNames, Unpack
from ..exceptions import NotLosslessError
from ..modal.modal_form import ModalForm
from ..numerics.polynomials import cofactors, digits
from ..numerics.rational import transfer_function
from .base import Convertible, LosslessSystem
from .canonical_forms import warn_of_lost_digits
from .port_hamiltonian import ph


def tf(sys: Convertible, **names: Unpack[SystemNames]) -> ct.TransferFunction:
    """Transfer function; of a lossless system of one port all coefficients have full relative accuracy.

    Parameters
    ----------
    sys : PortHamiltonian, ControllableHamiltonian, ObservableHamiltonian, AffineHamiltonian, or any that `ph` takes
        System to convert, such as an entry `circuit["v_Iout", "v_V1"]` of a larger system.
    **names
        `name`, `inputs`, `outputs` as for `control.tf`; those of the system are kept.

    Returns
    -------
    control.TransferFunction
        Minimal: equal frequencies are merged, and modes that no port reaches dropped.

    Raises
    ------
    StructureError
        If a coefficient exceeds the range of doubles.
    NotLosslessError
        If modes, or a system of `scipy.signal`, are not lossless.

    Warns
    -----
    ConditioningWarning
        If fewer than six digits of the frequencies survive the rounding of the coefficients: no transfer function
        in doubles carries more, `control.tf` included.

    Notes
    -----
    One port: products of positive numbers only, O(n^2).  More ports: `sum_l R_l prod_{j != l} (s^2 + d_j^2)` for each
    entry, where residues of either sign may cancel; O(n^2 m^2).  Of a system that is not lossless, or has sensors,
    what `control.tf` gives.

    Examples
    --------
    >>> import ph_control as phc
    >>> phc.tf(phc.lc_circuit([1.0, 0.25], [1.0, 1.0])).num_list[0][0]
    array([2., 0., 5., 0.])
    """
    _checks.known_keywords("tf", names, ("display_format",))
    try:
        source = sys if isinstance(sys, LosslessSystem) else ph(sys, lossless=True)
    except NotLosslessError:
        if not isinstance(sys, ct.StateSpace | ct.TransferFunction):
            raise
        return transfer_function(sys, **names) if isinstance(sys, ct.StateSpace) else ct.tf(sys, **names)
    _checks.signal_names(names, inputs=source.ninputs, outputs=source.noutputs, states=0)
    given: dict[str, Any] = {**names}
    for kind, label in (("inputs", "input_labels"), ("outputs", "output_labels")):
        if given.get(kind) is None and given.get(kind[:-1]) is None:
            given[kind] = getattr(source, label)
    if not source._in_normal_form:
        return transfer_function(source, **given)
    modes = source.modes.minimal()
    warn_of_lost_digits(modes.n, digits(modes.d), "transfer function", stacklevel=3)
    if modes.nports == 1:
        a, c = modes.coefficients()
        numerator, denominator = np.zeros(max(1, 2 * modes.n)), np.concatenate([[1.0], a[::-1]])
        numerator[0 : 2 * modes.n : 2] = c
        # of the double pole that stands for a rigid-body mode one is cancelled
        shift = 1 if len(modes.rigid) else 0
        numerator, denominator = numerator[: len(numerator) - shift], denominator[: len(denominator) - shift]
        if source._integrated and modes.n and not numerator[-1]:
            numerator = numerator[:-1]
        elif source._integrated:
            denominator = np.append(denominator, 0.0)
        return ct.tf(numerator, denominator, **given)
    numerators, denominator = _matrix_coefficients(modes)
    if source._integrated:
        denominator = np.append(denominator, 0.0)
    return ct.tf(numerators, [[denominator] * modes.nports for _ in range(modes.nports)], **given)


def _matrix_coefficients(modes: ModalForm) -> tuple[list[list[Array]], Array]:
    """Numerators and the common denominator of several ports, descending."""
    still = min(1, len(modes.rigid))
    frequencies = np.concatenate([np.zeros(still), np.unique(modes.d)])
    others, size = cofactors(frequencies), 2 * len(frequencies)
    # all rigid-body modes are one term, at the first place
    place = np.concatenate([np.zeros(still, int), np.searchsorted(frequencies, modes.d)])
    even, odd = modes._symmetric_residues
    d, nu, rigid = modes.d[:, None, None], np.abs(modes.nu), np.abs(modes.rigid)
    even = np.concatenate([(modes.rigid.T @ modes.rigid)[None][:still], even])
    odd = np.concatenate([0 * even[:still], odd * d])
    sizes = np.concatenate([(rigid.T @ rigid)[None][:still], d * nu[:, :, None] * nu[:, None, :]])
    table = np.zeros((*even.shape[1:], size))
    for start, parts, bounds in ((1, even, sizes), (0, odd, sizes * frequencies[place, None, None])):
        total, terms = (np.einsum("lij,lk->ijk", values, others[place]) for values in (parts, bounds))
        # where all cancel, what is left is rounding
        table[:, :, start::2] = np.where(np.abs(total) > 8 * size * _checks.EPS * terms, total, 0.0)
    denominator = np.zeros(size + 1)
    denominator[0::2] = np.convolve(others[0], [frequencies[0] ** 2, 1.0])[::-1] if size else 1.0
    _checks.representable("the coefficients of the transfer function", table, denominator)
    return [[entry[::-1] for entry in line] for line in table], denominator
