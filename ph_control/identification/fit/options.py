"""Options of `pem`, checked: what a search and a structure are to assume, and poles to start from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ... import _checks
from ..._heartbeat import Callback, reporter
from ..._options import Criterion, Discretisation, InterpolationOrAuto, NoiseKind
from ..._types import Array, ArrayLike, ComplexArray
from ..._units import common_unit
from ...exceptions import StructureError
from ...modal.discretization import Hold
from ..data.channels import Channels, Recording, ResponseMatrix, refuse_still
from ..data.quantities import checked_quantities
from ..search.starting_poles import poles_of
from ..structure.choice import Request

_MOST = 20, 40  # modes of records, and of responses, which may be those of networks
_WHOLE = 1e-6  # samples, or their share: what a dead time may differ from whole samples by


@dataclass(frozen=True)
class Options:
    """Options of `pem`, checked.

    `moving` says whether records may start in motion, `weighted` whether weights were given, `reachable` whether modes
    without weight are left out, as from the controllable form, `is_plain` that noise is white and the same in all
    records, and that nothing else disturbs them.
    """

    order: int | str
    method: Discretisation
    intersample: InterpolationOrAuto
    offset: bool | str
    max_order: int
    criterion: Criterion
    callback: Callback | None
    moving: bool
    weighted: bool
    real_poles: int | str
    delay: Array | None
    input_delay: Array | None
    reachable: bool
    noise: NoiseKind = "auto"
    is_plain: bool = False

    @classmethod
    def checked(cls, channels: Channels, **options: Any) -> Options:
        """Check options, and signals that could not show anything."""
        _checks.flag_or_auto("offset", options["offset"])
        most, real_poles = options["max_order"], options["real_poles"]
        most = _MOST[isinstance(channels[0], ResponseMatrix)] if most is None else most
        most = _checks.whole_number("max_order", most, 1)
        if not isinstance(real_poles, str):
            real_poles = _checks.whole_number("real_poles", real_poles, 0)
        elif real_poles != "auto":
            raise StructureError(f"real_poles is {real_poles!r}; it must be 'auto' or a whole number of at least 0")
        order = _checked_order(options["order"], real_poles)
        late = {
            "delay": _checked_delay(options["delay"], len(channels[0].output_labels)),
            "input_delay": _checked_input_delay(options["input_delay"], channels),
        }
        reporter(most, options["callback"])
        refuse_still(channels, options["moving"])
        if options["method"] == "euler" and options["intersample"] == "auto":
            options["intersample"] = "zoh"
        return cls(**{**options, "order": order, "max_order": most, "real_poles": real_poles, **late})

    def plain(self, channels: Channels) -> Options:
        """The same in plain noise, without delays that are not given."""
        outputs, inputs = channels[0].output_labels, channels[0].input_labels
        delay = np.zeros(len(outputs)) if self.delay is None else self.delay
        input_delay = np.zeros(len(inputs)) if self.input_delay is None else self.input_delay
        return replace(self, is_plain=True, delay=delay, input_delay=input_delay)

    @property
    def largest(self) -> int:
        """Largest number of modes."""
        return self.max_order if isinstance(self.order, str) else self.order


def _checked_order(order: object, real_poles: int | str) -> int | str:
    """Check a number of modes: none only where a number of real poles is given."""
    if isinstance(order, str):
        if order != "auto":
            raise StructureError(f"order is {order!r}; it must be 'auto' or a whole number of at least 1")
        return order
    modes = _checks.whole_number("order", order, 0 if real_poles else 1)
    if not modes and real_poles == "auto":
        raise StructureError(
            "order is 0; it must be a whole number of at least 1, or 0 with real_poles=1 for a lag, or more of them"
        )
    return modes


def _checked_delay(value: ArrayLike, outputs: int) -> Array | None:
    """Check delays that were given, one for each output; None where they are left to the data."""
    if isinstance(value, str):
        _checks.choice("delay", value, ("auto",))
        return None
    delays = _checks.real_array("delay", value)
    if delays.shape not in ((), (outputs,)):
        raise StructureError(
            f"delay has shape {delays.shape}; it must be 'auto', a number, or one for each of the {outputs} outputs"
        )
    return np.broadcast_to(delays, outputs).copy()


def _checked_input_delay(value: ArrayLike, channels: Channels) -> Array | None:
    """Check dead times that were given, one for each input, in whole samples; None where they are left to the data."""
    if isinstance(value, str):
        _checks.choice("input_delay", value, ("auto",))
        return None
    times, inputs = _checks.real_array("input_delay", value), len(channels[0].input_labels)
    if times.shape not in ((), (inputs,)):
        raise StructureError(
            f"input_delay has shape {times.shape}; it must be 'auto', a number, or one for each of the {inputs} inputs"
        )
    times = np.broadcast_to(times, inputs).copy()
    if not times.any():
        return times
    if inputs == 1:
        raise StructureError(f"input_delay is {times[0]:.6g} with one input; what all inputs have in common is a delay")
    if times.min() < 0:
        raise StructureError(f"input_delay has {times.min():.6g}; an input may act later than recorded, not earlier")
    for data in channels:
        if not isinstance(data, Recording):
            raise StructureError(
                "input_delay is of recordings in time; multiply a response by exp(1j omega input_delay) instead"
            )
        samples = times / data.dt
        worst = int(np.argmax(np.abs(samples - np.rint(samples))))
        if abs(samples[worst] - np.rint(samples[worst])) > _WHOLE * max(1.0, samples[worst]):
            raise StructureError(
                f"input_delay has {times[worst]:.6g}, {samples[worst]:.6g} samples of {data.dt:.6g}; it must be whole "
                "samples: round it, and leave the rest to delay"
            )
        if 2 * samples.max() > data.samples:
            raise StructureError(
                f"input_delay has {times.max():.6g}, {samples.max():.0f} samples of a record of {data.samples}; it may "
                "be half of a record at most"
            )
    return times


def request_of(channels: Channels, structure: str, ports: Any, quantity: object, options: Options) -> Request:
    """Check structure, ports and quantities against the channels."""
    outputs, inputs = channels[0].output_labels, channels[0].input_labels
    quantities = checked_quantities(quantity, outputs)
    if options.method != "exact" or options.reachable:
        structure = _lossless_port(structure, (len(outputs), len(inputs)), quantities, options)
    # a sensor of another kind has no power with the input
    assumed = ports is None and len(outputs) == len(inputs) == 1 and quantities != ("free",)
    pairs = ((0, 0),) if assumed else () if ports is None else _checks.port_pairs(ports, outputs, inputs)
    if structure == "passive" and not pairs:
        raise StructureError("structure='passive' needs driving points: name them, ports=[(output, input), ..]")
    return Request(structure, pairs, quantities, options.largest, assumed, options.noise in ("auto", "coloured"))


def _lossless_port(structure: str, shape: tuple[int, int], quantities: tuple[str, ...], options: Options) -> str:
    """Refuse options of the models of the paper for others; return the structure."""
    name, value = ("method", options.method) if options.method != "exact" else ("representation", "controllable")
    if structure not in ("auto", "lossless") or shape[0] != 1 or shape[1] > 1 or "free" in quantities:
        raise StructureError(
            f"{name}={value!r} is for lossless models of one input and one output; this fit has structure="
            f"{structure!r}, {shape[1]} inputs and {shape[0]} outputs ({', '.join(quantities)}): leave {name} out"
        )
    return "lossless"


def starting_poles(guess: object, channels: Channels, options: Options) -> ComplexArray | None:
    """Poles to start from: those of a model, of positive imaginary part and real ones."""
    if guess is None:
        return None
    common_unit(list(channels), guess)
    poles = poles_of(guess)
    poles = poles if options.real_poles else poles[poles.imag > 0]
    count, given = int(np.sum(poles.imag > 0)), isinstance(options.order, int)
    if count > options.largest:
        allowed = f"{options.largest} of the order" if given else f"{options.largest} that 'auto' may take"
        raise StructureError(f"initial_guess has {count} modes, more than the {allowed}")
    fastest = float(poles.imag.max(initial=0.0))
    for data in channels:
        if isinstance(data, Recording):
            hold = Hold(data.dt, options.method)
            ceiling = float(hold.frequency_of(np.array([hold.largest_phase(data.samples)]))[0])
            if fastest > ceiling:
                raise StructureError(
                    f"initial_guess has a mode at {fastest:.6g} rad/time; what the data can show ends at {ceiling:.6g}"
                )
    return poles
