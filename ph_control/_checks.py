"""Validation of user input: the one place that does it.

Each function returns a fresh, read-only double array or raises `StructureError` with what was
measured, what is allowed and what to do.  All tolerances are relative.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from operator import index
from typing import Any, NoReturn, TypeGuard, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linear_sum_assignment, minimize_scalar

from ._types import Array, PortPairs, RandomSource, SystemNames
from .exceptions import StructureError, UnknownKeywordError

EPS = float(np.finfo(float).eps)
_TOGETHER = 1 << 14  # instants looked at together
LARGEST = 1e153  # so that products of two entries, and sums of them, stay in the range of doubles
SMALLEST = 1e-300  # so that reciprocals do, and that sixteen digits are kept
SMALLEST_SQUARED = 1e-153  # so that squares do
TINY = float(np.finfo(float).tiny)

Choice = TypeVar("Choice", bound=str)
SomeArray = TypeVar("SomeArray", bound="NDArray[Any]")


def readonly(array: SomeArray) -> SomeArray:
    """Lock an array against writing, and return it."""
    array.flags.writeable = False
    return array


def shown(value: object) -> str:
    """Text of a value for a message: its type where the text would be long or have several lines, or cannot be made."""
    try:
        text = repr(value)
    except ValueError:  # an integer of thousands of digits
        return type(value).__name__
    return text if len(text) < 40 and "\n" not in text else type(value).__name__


def type_of(value: object) -> str:
    """Type of what is no system; of the result of a fit with the place of its system."""
    kind = type(value)
    return kind.__name__ + ", whose model is its attribute `system`" * hasattr(kind, "system")


def labels(value: Any, count: int, what: str) -> list[str]:
    """Texts of a label, or of several: one for each of so many things."""
    try:
        texts = [value] if isinstance(value, str) else [str(part) for part in value]
    except (TypeError, OSError):  # python-control raises the last on being iterated
        raise StructureError(f"label is {shown(value)}; give a text, or a list of them") from None
    if len(texts) != count:
        raise StructureError(f"{len(texts)} labels for {count} {what}; give one for each")
    return texts


def unit_text(unit: object) -> str:
    """Check the name of a unit; none is the empty text."""
    if not isinstance(unit, str | None):
        raise StructureError(f"the unit {shown(unit)} is not a text; give its name, such as 'm/s', or None")
    return unit or ""


def real_array(name: str, value: object, ndim: int | None = None, *, missing: bool = False) -> Array:
    """Convert to a new array of finite doubles with `ndim` dimensions; NaN marks what is `missing`, if allowed."""
    raw = value if type(value) is np.ndarray and value.dtype.char == "d" else _real_numbers(name, value)
    array = np.array(raw, dtype=float)
    if ndim is not None and array.ndim != ndim:
        raise StructureError(
            f"{name} has {array.ndim} dimensions (shape {array.shape}), expected {ndim}; "
            "reshape it so that nothing is guessed"
        )
    finite(name, np.where(np.isnan(array), 0.0, array) if missing else array)
    return array


def _real_numbers(name: str, value: object) -> NDArray[Any]:
    """Array of what is not an array of doubles."""
    parts = value if isinstance(value, list | tuple) else ()
    if np.ma.is_masked(value) or any(isinstance(part, np.ma.MaskedArray) and np.ma.is_masked(part) for part in parts):
        raise StructureError(f"{name} has masked entries; fill them, since a mask would be lost here")
    try:
        raw = np.asarray(value)
    except ValueError as error:
        raise StructureError(f"{name} is not a rectangular array of numbers: {error}") from None
    if raw.dtype.kind == "c":
        largest = float(np.max(np.abs(raw.imag), initial=0.0))
        if largest > 0:
            raise StructureError(
                f"{name} is complex: largest imaginary part {largest:.3g}, allowed 0; "
                "pass its real part if that is meant"
            )
        raw = raw.real
    if raw.ndim == 0 and raw.dtype.kind == "O":
        raise StructureError(
            f"{name} is of type {type(value).__name__}, not an array of numbers; pass an array (a sparse matrix by its "
            "toarray())"
        )
    if raw.dtype.kind not in "biuf":
        raise StructureError(f"{name} does not hold real numbers: its type is {raw.dtype}; pass an array of floats")
    return raw


def finite(name: str, array: NDArray[np.number]) -> None:
    """Refuse NaN and infinity, naming the first place."""
    good = np.isfinite(array)
    # counting takes a quarter of the time of `all` where there are few
    if np.count_nonzero(good) < good.size:
        if not np.ndim(array):
            raise StructureError(f"{name} is not finite: it is {float(array)}; give a finite number")
        bad = ~good
        where = tuple(int(i) for i in np.argwhere(bad)[0])
        place = where[0] if len(where) == 1 else where
        raise StructureError(
            f"{name} is not finite: {int(bad.sum())} of {array.size} entries are NaN or infinite, "
            f"the first at index {place}; remove or replace them"
        )


def in_range(name: str, array: Array, smallest: float = SMALLEST) -> None:
    """Refuse an array, other than zero, of a size whose square or reciprocal leaves the range of doubles."""
    size = _largest(array)
    if size > LARGEST or 0 < size < smallest:
        raise StructureError(
            f"{name} is out of range: its largest entry is {size:.3g}, allowed {smallest:.0e} to {LARGEST:.0e}; "
            "choose other units of time or amplitude"
        )


def representable(what: str, *arrays: NDArray[np.number], nonzero: NDArray[np.bool_] | bool = False) -> None:
    """Refuse intermediate results that left the range of doubles, where the input itself was finite.

    `nonzero` says where results are not 0: there an underflow would pass for a weight that is absent.
    """
    lost = nonzero is not False and any((nonzero & (np.abs(array) < TINY)).any() for array in arrays)
    if lost or not all(np.isfinite(array).all() for array in arrays):
        raise StructureError(
            f"{what} leave the range of doubles (1e-308 to 1e308); choose other units of time or amplitude"
        )


def complex_points(name: str, value: object) -> NDArray[np.complex128]:
    """Check points of the complex plane: a number or a vector, no NaN; infinity is a point."""
    if np.ma.is_masked(value):
        raise StructureError(f"{name} have masked entries; fill them, since a mask would be lost here")
    try:
        points = np.atleast_1d(np.asarray(value)).astype(complex, copy=False)
    except (TypeError, ValueError, OverflowError):
        raise StructureError(f"{name} are not complex numbers: {shown(value)}; give a number or a vector") from None
    if points.ndim > 1:
        raise StructureError(f"{name} have shape {points.shape}; give a number or a vector")
    # `1j * np.inf` has a real part of NaN, and is infinite all the same
    unknown = np.isnan(points)
    if unknown.any() and (unknown := unknown & ~np.isinf(points)).any():
        raise StructureError(f"{name} are not numbers: the first NaN is at index {int(unknown.argmax())}")
    return points


def complex_matrix(name: str, value: object, rows: int) -> NDArray[np.complex128]:
    """Check a matrix of finite complex numbers with so many rows; a copy."""
    try:
        array = np.array(value, dtype=complex)
    except (TypeError, ValueError, OverflowError):
        raise StructureError(f"{name} does not hold complex numbers: {shown(value)}; pass an array of them") from None
    if array.ndim != 2 or array.shape[0] != rows or array.shape[1] == 0:
        raise StructureError(f"{name} has shape {array.shape}; it must be ({rows}, number of ports)")
    finite(name, array)
    return array


def relative_tolerance(rtol: object) -> float:
    """Check a relative tolerance: a number from 0 to 1, 1 itself excluded."""
    if not is_number(rtol) or not 0 <= rtol < 1:
        raise StructureError(f"rtol is {shown(rtol)}; a relative tolerance is a number from 0 to 1")
    return float(rtol)


def symmetric_matrix(
    Q: ArrayLike, *, name: str = "Q", rtol: float | None = None, even: bool = True, note: str = ""
) -> Array:
    """Check what O(n^2) steps can of a Hamiltonian matrix: square, symmetric, and `even` unless it is a part of one.

    What an error says of a matrix that is not symmetric ends with the `note`.
    """
    array = real_array(name, Q, 2)
    rows, columns = array.shape
    if rows != columns:
        raise StructureError(
            f"{name} is not square: its shape is {array.shape}; it must be ({'2n, 2n' if even else 'n, n'})"
        )
    if even and rows % 2:
        raise StructureError(
            f"{name} has odd size {rows}; a Hamiltonian needs n positions and n momenta, so its matrix is (2n, 2n)"
            "; with losses R, a structure matrix J of any size can be given, such as J=[[0]] for a coil or a mass alone"
        )
    in_range(name, array)
    size, asymmetry = _largest(array), _largest(array - array.T)
    allowed = 1000 * rows * EPS if rtol is None else relative_tolerance(rtol)
    if asymmetry > allowed * size:
        raise StructureError(
            f"{name} is not symmetric: max |{name} - {name}.T| / max |{name}| = {asymmetry / size:.1e}, "
            f"allowed {allowed:.1e}; pass ({name} + {name}.T)/2 if that is meant{note}"
        )
    return array


def skew_matrix(name: str, array: Array) -> Array:
    """Skew part of a square matrix that has hardly any other."""
    size, symmetric, allowed = _largest(array), _largest(array + array.T), 1000 * len(array) * EPS
    if symmetric > allowed * size:
        raise not_skew(name, symmetric / size, allowed)
    return 0.5 * array - 0.5 * array.T


def not_skew(name: str, symmetric: float, allowed: float) -> StructureError:
    """Error of a matrix whose symmetric part is so much of its size."""
    return StructureError(
        f"{name} is not skew-symmetric: max |{name} + {name}.T| / max |{name}| = {symmetric:.1e}, allowed "
        f"{allowed:.1e}; pass ({name} - {name}.T)/2 if that is meant; a symmetric part is dissipation"
    )


def _largest(array: Array) -> float:
    """Largest absolute value, without an array of them: memory that is new costs more than what is done in it."""
    return max(float(array.max(initial=0.0)), -float(array.min(initial=0.0)))


def port_matrix(B: ArrayLike, rows: int, *, name: str = "B") -> Array:
    """Check an input matrix: `(rows,)` becomes one column, `(rows, m)` stays."""
    array = real_array(name, B)
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2 or array.shape[0] != rows:
        raise StructureError(
            f"{name} has shape {np.shape(B)}; with Q of shape ({rows}, {rows}) it must be ({rows},) or "
            f"({rows}, number of ports)"
        )
    if array.shape[1] == 0:
        raise StructureError(f"{name} has no columns; a port-Hamiltonian system needs at least one port")
    in_range(name, array, SMALLEST_SQUARED)
    return array


def natural_frequencies(d: ArrayLike, *, name: str = "d") -> Array:
    """Check a vector of natural frequencies: positive and finite."""
    return _positive(np.atleast_1d(real_array(name, d)), name)


def _positive(array: Array, name: str) -> Array:
    if array.ndim != 1:
        raise StructureError(f"{name} has shape {array.shape}; it must be a vector of n natural frequencies")
    if np.count_nonzero(array > 0) < array.size:
        _refuse_least(name, array, "not positive", "; natural frequencies are > 0")
    return array


def _refuse_least(name: str, array: Array, fault: str, rule: str) -> NoReturn:
    """Refuse a vector for its least entry."""
    worst = int(array.argmin())
    raise StructureError(f"{name} is {fault}: {name}[{worst}] = {array[worst]:.6g}{rule}")


def residue_weights(r: ArrayLike, n: int) -> Array:
    """Check a vector of residue weights: n numbers, none negative."""
    array = np.atleast_1d(real_array("r", r))
    if array.shape != (n,):
        raise StructureError(f"r has shape {array.shape}; with {n} natural frequencies it must be ({n},)")
    if np.count_nonzero(array < 0):
        _refuse_least("r", array, "negative", ", allowed >= 0; a negative residue is not passive")
    return array


def parameter_pair(d: ArrayLike, v: ArrayLike | None) -> tuple[Array, Array]:
    """Check a pair `(d, v)` of the paper: n positive frequencies and a vector of 2n weights."""
    if hasattr(d, "poles"):
        raise StructureError(
            f"d is a {type(d).__name__}, not natural frequencies; of a lossless system with one port, "
            "form = modes(sys), they are d = form.d, and v = np.concatenate([form.nu[:, 0].real, form.nu[:, 0].imag])"
        )
    if v is None:
        raise StructureError("v is missing; pass d, of n natural frequencies, and v, of 2n input weights")
    return _pair(natural_frequencies(d), real_array("v", v))


def _pair(frequencies: Array, vector: Array) -> tuple[Array, Array]:
    in_range("d", frequencies)
    if vector.shape != (2 * len(frequencies),):
        several = vector.ndim == 2 and vector.shape[0] == 2 * len(frequencies)
        hint = "; pairs (d, v) are those of one port" if several else ""
        raise StructureError(
            f"v has shape {vector.shape}; with {len(frequencies)} natural frequencies it must be "
            f"({2 * len(frequencies)},){hint}"
        )
    in_range("v", vector, SMALLEST_SQUARED)
    return frequencies, vector


def hamiltonian_parameters(d: ArrayLike, v: ArrayLike) -> tuple[Array, Array]:
    """Check the parameters of a canonical form: a pair, or `d = (d_1, d_2) >= 0` of as many entries as `v`."""
    given, weights = real_array("d", d), real_array("v", v)
    if given.ndim != 1 or given.size != weights.size or given.size == 0 or given.size % 2:
        return _pair(_positive(np.atleast_1d(given), "d"), weights)
    if given.min() < 0:
        _refuse_least("d", given, "negative", "; the entries of (d_1, d_2) are >= 0")
    in_range("d", given)
    in_range("v", weights, SMALLEST_SQUARED)
    return given, weights


def symplectic_defect(S: Array) -> float:
    """Largest entry of `S^T J S - J` relative to the size of a matrix of even size."""
    in_range("S", S)
    n = len(S) // 2
    half = S[:n].T @ S[n:]
    residual = half - half.T
    residual[:n, n:] -= np.eye(n)
    residual[n:, :n] += np.eye(n)
    return float(np.max(np.abs(residual), initial=0.0)) / max(1.0, float(np.linalg.norm(S, 2)) ** 2 if n else 1.0)


def symplectic_matrix(S: ArrayLike, size: int) -> Array:
    """Check a symplectic matrix of a given size: `S^T J S = J` relative to the size of `S`."""
    array = real_array("S", S, 2)
    if array.shape != (size, size):
        raise StructureError(f"S has shape {array.shape}; expected ({size}, {size})")
    measured, allowed = symplectic_defect(array), 100 * size * EPS
    if measured > allowed:
        raise StructureError(
            f"S is not symplectic: max |S^T J S - J| / ||S||^2 = {measured:.1e}, allowed {allowed:.1e}; "
            "williamson(Q) gives one, or take a product of symplectic matrices"
        )
    return array


def transfer_coefficients(a: ArrayLike, c: ArrayLike) -> tuple[Array, Array]:
    """Check the coefficients of a lossless transfer function: the even ones of `a`, and `c`."""
    denominator, numerator = real_array("a", a, 1), real_array("c", c, 1)
    if len(denominator) != 2 * len(numerator):
        raise StructureError(
            f"a has {len(denominator)} entries and c has {len(numerator)}; expected (a_0 .. a_(2n-1)) and "
            "(c_1, c_3 .. c_(2n-1)): twice as many"
        )
    if denominator[1::2].any():
        worst = 2 * int(np.abs(denominator[1::2]).argmax()) + 1
        raise StructureError(
            f"a[{worst}] is {denominator[worst]:.6g}, expected 0: the denominator of a lossless "
            "system without a pole at 0 is even"
        )
    even = denominator[0::2]
    if even.size and even.min() <= 0:
        worst = 2 * int(even.argmin())
        raise StructureError(f"a[{worst}] is {denominator[worst]:.6g}, expected > 0: a product of (s^2 + d^2), d > 0")
    return even, numerator


def conjugate_closed(name: str, value: ArrayLike) -> NDArray[np.complex128]:
    """Check the zeros or poles of a real system: finite, and each with its conjugate."""
    points = complex_points(f"the {name}", value)
    finite(f"the list of {name}", points)
    upper, lower = points[points.imag > 0], points[points.imag < 0].conj()
    if len(upper) != len(lower):
        raise StructureError(
            f"the {name} are not closed under conjugation: {len(upper)} above the real axis, {len(lower)} below; "
            "a real system has them in conjugate pairs"
        )
    distance = np.abs(upper[:, None] - lower)
    pairs = linear_sum_assignment(distance)
    allowed = 1000 * EPS
    off = distance[pairs] / np.abs(upper[pairs[0]])
    if off.max(initial=0.0) > allowed:
        raise StructureError(
            f"the {name} are not closed under conjugation: the conjugate of {upper[off.argmax()]:.6g} is missing, the "
            f"nearest is off by {off.max():.1e} of its size, allowed {allowed:.1e}; a real system has them in pairs"
        )
    return points


def time_vector(time: ArrayLike, *, name: str = "the time vector") -> tuple[Array, float]:
    """Check a uniform, increasing time vector; return it with its step (0 for a single sample)."""
    t = real_array(name, time, 1)
    return t, time_step(t, name=name)


def time_step(t: Array, *, name: str = "the time vector") -> float:
    """Step of uniform, increasing instants; 0 of a single one.

    Instants made as `t_0 + k h` are followed with that very `h`: their mean step may miss it by a unit in the last
    place, and a mode would be off by `d t eps`.
    """
    if t.size == 0:
        raise StructureError(f"{name} is empty; give at least one instant")
    if t.size == 1:
        return 0.0
    largest = max(abs(float(t[0])), abs(float(t[-1])))
    if largest > 0.25 * np.finfo(float).max:
        raise StructureError(f"{name} goes to {largest:.3g}, out of the range of doubles; choose another unit of time")
    step, rounding = float(t[1] - t[0]), 2 * EPS * largest
    off = distance_from_grid(t, step)
    if off > rounding:
        step = float((t[-1] - t[0]) / (t.size - 1))
        off = distance_from_grid(t, step)
    # printed times are often rounded to a few digits: a hundredth of a step does not make a grid unequal
    allowed = 0.01 * step
    if 0 < allowed < off <= 2.001 * allowed:  # ends that are off by as much can double the distance of the others
        step, off = _nearest_grid(t, step, allowed)
    if not step > 0 or off > allowed or 1000 * rounding > step:
        _refuse_instants(t, off, allowed, name)
    return step


def _nearest_grid(t: Array, step: float, allowed: float) -> tuple[float, float]:
    """Step of the grid of least distance to the instants, and the distance: its first instant may be off it, too."""
    share = np.linspace(0.0, 1.0, t.size)
    rest = (t - t[0] - step * np.arange(float(t.size))) / allowed
    minimum = minimize_scalar(lambda tilt: 0.5 * np.ptp(rest - tilt * share), bounds=(-2.5, 2.5), method="bounded")
    return step + float(minimum.x) * allowed / (t.size - 1), float(minimum.fun) * allowed


def _refuse_instants(t: Array, off: float, allowed: float, name: str) -> None:
    gaps = np.diff(t)
    if not gaps.min() > 0:
        k = int(np.argmax(gaps <= 0))
        raise StructureError(
            f"{name} does not increase: samples {k} and {k + 1} are at {t[k]:.9g} and {t[k + 1]:.9g}; "
            "sort it and drop repeats"
        )
    if off > allowed:
        k = int(np.argmax(np.abs(gaps - np.median(gaps))))
        raise StructureError(
            f"{name} is not equally spaced: the step from sample {k} to {k + 1} is {gaps[k]:.6g}, the median step "
            f"{np.median(gaps):.6g}; instants may be off the grid by {allowed:.1g}; "
            "resample the record to a uniform grid"
        )


@np.errstate(over="ignore")
def distance_from_grid(t: Array, step: float) -> float:
    """Largest `|t_0 + k step - t_k|`, 0 if they are equal to the last bit."""
    # as many at a time as stay in a cache
    steps, off = np.arange(float(min(t.size, _TOGETHER))), 0.0
    for start in range(0, t.size, _TOGETHER):
        part = t[start : start + _TOGETHER]
        grid = steps[: part.size] + start
        grid *= step
        grid += t[0]
        grid -= part
        off = max(off, _largest(grid))
    return off


def sampling_step(dt: object, *, name: str = "dt") -> float:
    """Check a sampling step: one positive finite number."""
    try:
        step = float(real_array(name, dt, 0))
    except StructureError:
        step = np.nan
    if isinstance(dt, bool | np.bool_) or not 1e-100 <= step <= 1e100:
        raise StructureError(f"{name} is {shown(dt)}; it must be one positive number, a time between 1e-100 and 1e100")
    return step


def choice(name: str, value: object, allowed: tuple[Choice, ...]) -> Choice:
    """Check a keyword that names one of a few ways."""
    if not (isinstance(value, str) and value in allowed):
        raise StructureError(f"{name} is {value!r}; it must be one of {', '.join(map(repr, allowed))}")
    return allowed[allowed.index(value)]


def whole_number(name: str, value: Any, least: int | None = None, most: float = np.inf) -> int:
    """Check a whole number, between `least` and `most` where these are given."""
    if not is_whole(value) or not ((value if least is None else least) <= value <= most):
        bound = "" if least is None else f" of at least {least}" if most == np.inf else f" from {least} to {most}"
        raise StructureError(f"{name} is {shown(value)}; it must be a whole number{bound}")
    return int(value)


def is_number(value: object) -> TypeGuard[float]:
    """Whether this is a real number, of Python or of numpy; True and False are none."""
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def is_whole(value: object) -> bool:
    """Whether this is a whole number, of Python or of numpy; True and False are none."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def is_flag(value: object) -> bool:
    """Whether this is True or False: also as a number 0 or 1, or as a boolean of numpy."""
    return isinstance(value, bool | np.bool_ | int | np.integer) and value in (0, 1)


def flags(**given: object) -> None:
    """Check keywords that are True or False."""
    for name, value in given.items():
        if not is_flag(value):
            raise StructureError(f"{name} is {shown(value)}; it must be True or False")


def flag_or_auto(name: str, value: object) -> None:
    """Check a keyword that may be left to the data."""
    if not is_flag(value) and not (isinstance(value, str) and value == "auto"):
        raise StructureError(f"{name} is {shown(value)}; it must be True, False or 'auto'")


def band(value: object) -> tuple[float, float]:
    """Check a band of frequencies, `(low, high)`."""
    edges = real_array("band", value)
    if edges.shape != (2,) or not 0 <= edges[0] < edges[1]:
        raise StructureError(
            f"band is {shown(value)}; it must be (low, high) in rad per unit time, with 0 <= low < high"
        )
    in_range("band", edges)
    return float(edges[0]), float(edges[1])


def level(name: str, value: object) -> float:
    """Check a level of confidence."""
    return between(name, value, 0.0, 1.0, ", such as 0.95")


def between(name: str, value: object, low: float, high: float, advice: str = "") -> float:
    """Check a number between two others."""
    if not (is_number(value) and low < value < high):
        raise StructureError(f"{name} is {shown(value)}; it must be a number between {low:g} and {high:g}{advice}")
    return float(value)


NAMES = ("name", "inputs", "outputs", "states")
_KNOWN_NAMES = {*SystemNames.__annotations__, "dt"}


def known_keywords(
    function: str, names: Mapping[str, object], own: Sequence[str] = (), advice: Mapping[str, str] | None = None
) -> None:
    """Refuse keywords that are no names of a system and its signals; `own` are those that a function has beside them.

    `advice` says of keywords that may be expected what takes their place.
    """
    unknown = [key for key in names if key not in _KNOWN_NAMES and key not in own]
    if unknown:
        key = unknown[0]
        remedy = (advice or {}).get(key, "leave it out, or check its spelling")
        raise UnknownKeywordError(
            f"unexpected keyword {key!r}: {function} takes {', '.join([*own, *NAMES])} as keywords; {remedy}"
        )


def signal_names(names: Mapping[str, object], **sizes: int) -> None:
    """Check the name of a system, and those of so many signals of each kind, before python-control reads them."""
    if names.get("name") is not None:
        _text("name", names["name"])
    for kind, size in sizes.items():
        given = next((names[key] for key in (kind, kind[:-1]) if names.get(key) is not None), size)
        listed: Sequence[object] = () if is_whole(given) else given if isinstance(given, list | tuple) else [given]
        for name in listed:
            _text(f"one of the {kind}", name)
        count = given if is_whole(given) else len(listed)
        if count != size:
            raise StructureError(f"{shown(count)} names given for {size} {kind}; give one name for each, all different")
        if len(set(listed)) < len(listed):
            twice = next(name for k, name in enumerate(listed) if name in listed[:k])
            raise StructureError(f"two of the {kind} are called {shown(twice)}; give each a name of its own")


def _text(what: str, name: object) -> None:
    if not (isinstance(name, str) and "." not in name):
        raise StructureError(f"{what} is {shown(name)}; a name is a text without dots")


def without_dots(labels: Sequence[str]) -> list[str]:
    """Labels as systems of python-control take them, without dots; those that differ still do."""
    names: list[str] = []
    for k, label in enumerate(labels):
        name = label.replace(".", "_")
        while name != label and (name in labels or name in names[:k]):
            name += "_"
        names.append(name)
    return names


def port_pairs(ports: PortPairs, outputs: Sequence[str], inputs: Sequence[str]) -> tuple[tuple[int, int], ...]:
    """Numbers of the output and the input of each port, given by labels or numbers, as pairs or as a mapping."""
    try:
        listed = [(output, input) for output, input in (ports.items() if isinstance(ports, Mapping) else ports)]
        if any(isinstance(pair, str) for pair in ports) and not isinstance(ports, Mapping):
            raise TypeError
    except (TypeError, ValueError, OSError):  # python-control raises the last on being iterated
        raise StructureError(
            f"ports={shown(ports)} is not a list of pairs (output, input), such as [(0, 0), (2, 1)] or [('y1', 'u1')]"
        ) from None
    sides = []
    for k, (role, labels) in enumerate((("output", outputs), ("input", inputs))):
        chosen = [signal_number(role, pair[k], labels) for pair in listed]
        repeated = [number for number in chosen if chosen.count(number) > 1]
        if repeated:
            label = labels[repeated[0]]
            raise StructureError(f"{role} {label!r} is at {chosen.count(repeated[0])} ports; each belongs to one")
        sides.append(chosen)
    return tuple(zip(*sides, strict=True))


def without_unit(label: str) -> str:
    """Label without the unit at its end: `force [N]`, `force (N)` and `force / N` are all `force`."""
    return re.sub(r"(?<!\s)\s*(\[[^\]]*\]|\([^)]*\)|\s/\s*\S+)$", "", label).strip()


def labelled(wanted: str, labels: Sequence[str]) -> list[int]:
    """Places of the labels that say it: literally, else without their unit, else without regard to case."""
    for simplify in (str.strip, without_unit, str.casefold, lambda label: without_unit(label).casefold()):
        target = wanted.strip() if simplify in (str.strip, without_unit) else wanted.strip().casefold()
        matches = [j for j, label in enumerate(labels) if label and simplify(label) == target]
        if matches:
            return matches
    return []


def label_named(name: str, labels: Sequence[str]) -> str | None:
    """Label that a name stands for, as `labelled` finds it; None without one, or with several."""
    alike = {labels[k] for k in labelled(name, labels)}
    return alike.pop() if len(alike) == 1 else None


def signal_number(role: str, value: Any, labels: Sequence[str]) -> int:
    """Number of an input or output, given by its number or label, with or without the unit."""
    if isinstance(value, str) and (label := label_named(value, labels)) is not None:
        return list(labels).index(label)
    if is_whole(value) and 0 <= int(value) < len(labels):
        return int(value)
    listed = ", ".join(map(repr, labels)) or "none"
    raise StructureError(
        f"there is no {role} {shown(value)}; the {role}s are {listed}, numbered from 0 to {len(labels) - 1}"
    )


def random_generator(rng: RandomSource) -> np.random.Generator:
    """Check where random numbers come from."""
    sources = np.random.Generator | np.random.BitGenerator | np.random.SeedSequence | np.random.RandomState
    try:
        # an array in numpy's own hands may end in a recursion that no handler catches, as np.matrix does
        if rng is not None and not isinstance(rng, sources):
            rng = [index(part) for part in rng] if isinstance(rng, Sequence | np.ndarray) else index(rng)
        return np.random.default_rng(rng)
    except (TypeError, ValueError, OverflowError):
        raise StructureError(f"rng is {shown(rng)}; pass a numpy Generator, a seed >= 0, or None") from None
