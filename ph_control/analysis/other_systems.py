"""Time responses and samples of systems of other kinds, by python-control."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import control as ct
import numpy as np
from scipy.signal import cont2discrete

from .. import _checks
from .._options import INTERPOLATIONS
from .._types import Array, ArrayLike, SystemNames
from ..exceptions import StructureError
from ..modal.general_form import GeneralModalForm
from ..modal.modal_form import ModalForm
from ..numerics.rational import LinearSystem
from ..systems.base import Convertible, LosslessSystem, inherited_names
from ..systems.port_hamiltonian import ph

MOST_INSTANTS = 10**9  # 8 GB of them
# by python-control, or slycot; its ControlMIMONotImplemented is one of the third
_REFUSED = ValueError, TypeError, NotImplementedError, ArithmeticError, np.linalg.LinAlgError
# of scipy: what is integrated, and what inputs do in between
_RULES = {("exact", "zoh"): "zoh", ("exact", "foh"): "foh", ("midpoint", "foh"): "bilinear", ("euler", "zoh"): "euler"}


def as_system(sys: Convertible) -> LinearSystem:
    """A linear system: one of this package, or another of python-control; modal forms become one or the other."""
    if isinstance(sys, GeneralModalForm):
        return sys.state_space()
    if isinstance(sys, ModalForm):
        return ph(sys)
    if isinstance(sys, LosslessSystem | ct.StateSpace):
        return sys
    if isinstance(sys, ct.TransferFunction):
        try:
            return ct.ss(sys, name=sys.name)
        except _REFUSED as error:
            raise StructureError(f"the transfer function has no state space ({error}); give a proper one") from None
    raise StructureError(
        f"this is a {_checks.type_of(sys)}; give a system of this package, or a StateSpace or TransferFunction"
    )


def check_exact(method: str) -> None:
    """Refuse rules of integration that are for systems of this package."""
    if method != "exact":
        raise StructureError(
            f"method={method!r} is for systems that ph(sys) makes; others are solved exactly: leave it out"
        )


def instants_of(systems: Sequence[LinearSystem], timepts: ArrayLike | None, samples: int | None) -> Array:
    """Instants that python-control chooses for systems, the longest of these; or those that are given."""
    if timepts is not None and np.ndim(timepts) > 0:
        return _checks.real_array("the time vector", timepts, 1)
    end = None if timepts is None else _checks.sampling_step(timepts, name="the last instant")
    if samples is not None:
        _checks.whole_number("timepts_num", samples, 2, MOST_INSTANTS)
    times = [np.asarray(responding(ct.step_response, sys, end, timepts_num=samples).time, float) for sys in systems]
    return max(times, key=lambda t: float(t[-1]))


def responding(response: Callable[..., Any], sys: LinearSystem, t: Any, *values: object, **options: object) -> Any:
    """A response by python-control, of finite numbers."""
    if np.ndim(t):
        _checks.time_step(t)
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            answer = response(sys, t, *values, **options)
        except _REFUSED as error:
            raise StructureError(f"python-control cannot simulate this system ({error})") from None
    if not np.isfinite(answer.y).all():
        raise StructureError("the response exceeds the range of doubles: scale the input, or end earlier")
    return answer


def held(sys: LinearSystem, t: Array, intersample: str) -> LinearSystem:
    """A system whose inputs are held between instants, where they are."""
    _checks.choice("intersample", intersample, INTERPOLATIONS)
    if intersample == "foh" or not sys.isctime() or len(t) < 2:
        return sys
    return ct.sample_system(ct.ss(sys), _checks.time_step(t) or 1.0, "zoh")


def sampled(sys: LinearSystem, h: float, method: str, intersample: str, names: SystemNames) -> ct.StateSpace:
    """A system of another kind as a discrete-time state space, by the rule of python-control that is the same."""
    rule = _RULES.get((method, intersample))
    if rule is None:
        raise StructureError(
            f"method={method!r} with intersample={intersample!r} is for systems that ph(sys) makes; others have "
            + ", ".join(f"{first} with {second}" for first, second in _RULES)
        )
    if not sys.isctime():
        raise StructureError(f"the system has dt={sys.dt!r}; give one in continuous time")
    system = ct.ss(sys)
    A, B, C, D, _ = cont2discrete((system.A, system.B, system.C, system.D), h, rule)
    return ct.ss(A, B, C, D, h, **inherited_names(system, names, "inputs", "outputs"))
