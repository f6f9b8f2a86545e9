"""A plant that a test is planned for: its poles and residues, what of them is unknown, and the noise of its outputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ... import _checks
from ..._display import aligned, to_its_error
from ..._frozen import ReadOnlyMapping
from ..._options import Discretisation, Interpolation
from ..._types import Array, ArrayLike, ComplexArray, Indices, Mask
from ..._units import common_unit, hertz_size, rate
from ...exceptions import StructureError
from ...modal.modal_form import ModalForm
from ...systems.port_hamiltonian import modes
from ..regression.prediction import halved, natural_jacobian
from ..regression.sections import Sections
from ..structure.coordinates import ChannelLayout, ShapeCoordinates
from ..uncertainty.fisher import Information
from ..uncertainty.noise_model import NoiseModel

_TRACE = 1e-6  # part of a unit vector without a trace, from which on a quantity is unknown


@dataclass(frozen=True, eq=False)
class PlannedPlant:
    """A plant at which the information of a record is evaluated.

    Attributes
    ----------
    p : ndarray of complex, shape (N,)
        Poles: those of modes by their natural frequencies, upper half-plane, then real ones, the slowest first.
    residues : ndarray of complex, shape (N, q, m)
        At these poles; of real ones half, as they are their own conjugates.
    feedthrough : ndarray, shape (q, m)
        Response at infinity.
    fed : ndarray of bool, shape (q, m)
        Which entries of it are unknown; the others are held.
    structure : str
        'lossless' and 'classical' hold residues to those of real shapes, 'free' and 'passive' do not.
    quantities, ports : tuple
        As those of a `PEMResult`; of ports only where the structure needs them.
    input_labels, output_labels : tuple of str
        Names of the channels.
    time_unit : str or None
        Unit of time, where it is known.
    method, intersample : str
        How the plant meets the samples.
    noise : NoiseModel or None
        What a fit says of the noise.
    """

    p: ComplexArray
    residues: ComplexArray
    feedthrough: Array
    fed: Mask
    structure: str
    quantities: tuple[str, ...]
    ports: tuple[tuple[int, int], ...]
    input_labels: tuple[str, ...]
    output_labels: tuple[str, ...]
    time_unit: str | None = None
    method: Discretisation = "exact"
    intersample: Interpolation = "zoh"
    noise: NoiseModel | None = None

    @classmethod
    def of(cls, model: Any) -> PlannedPlant:
        """Plant of a `PEMResult`, a modal form, a pair (d, r) or any linear system of continuous time."""
        plant = cls._of_result(model) if hasattr(model, "experiments") else cls._of_system(model)
        if not plant.residues.shape[2] or not len(plant.p):
            raise StructureError(
                f"the model has {plant.residues.shape[2]} inputs and {len(plant.p)} poles; an input can be chosen, or "
                "judged, for at least one of each"
            )
        return plant

    @classmethod
    def _of_result(cls, result: Any) -> PlannedPlant:
        return cls(
            result.poles, halved(result.poles, result.residues), result.feedthrough,
            ~np.isnan(result.stderr["feedthrough"]) & (result.feedthrough != 0), result.structure, result.quantities,
            result.ports, result.input_labels, result.output_labels, result.time_unit, result.method,
            result.intersample, result.noise,
        )  # fmt: skip

    @classmethod
    def _of_system(cls, model: Any) -> PlannedPlant:
        pair = isinstance(model, tuple | list)
        if pair and len(model) != 2:
            raise StructureError(f"the model has {len(model)} entries; give a pair (d, r), a system, or a result")
        own = getattr(model, "modes", None)
        form = modes(*model) if pair else own if isinstance(own, ModalForm) else modes(model)
        p, residues = np.asarray(form.poles, complex), np.asarray(form.residues, complex)
        upper = np.flatnonzero(p.imag >= 0)
        rank = upper[np.lexsort((np.abs(p[upper]), p[upper].imag == 0))]
        through = np.array(form.feedthrough, float)
        outputs, inputs = through.shape
        names = [getattr(model, f"{kind}_labels", None) for kind in ("input", "output")]
        given = [
            tuple(labels) if labels else tuple(f"{letter}[{k}]" for k in range(count))
            for labels, letter, count in zip(names, "uy", (inputs, outputs), strict=True)
        ]
        return cls(
            p[rank], halved(p[rank], residues[rank]), through, through != 0, "free", ("free",) * outputs, (), given[0],
            given[1], common_unit(model),
        )  # fmt: skip

    @property
    def order(self) -> int:
        """Number of modes."""
        return int(np.sum(self.p.imag != 0))

    @property
    def outputs(self) -> int:
        """Number of outputs."""
        return int(self.residues.shape[1])

    @property
    def inputs(self) -> int:
        """Number of inputs."""
        return int(self.residues.shape[2])

    @property
    def has_feedthrough(self) -> bool:
        """Whether some entry of the feedthrough is unknown."""
        return bool(self.fed.any())

    @cached_property
    def values(self) -> dict[str, Any]:
        """Quantities by the keys of `PlantUnknowns.stderr`."""
        n, d = self.order, np.abs(self.p)
        with np.errstate(divide="ignore"):
            constants = -1.0 / self.p[n:].real
        return {
            "natural_frequencies": d[:n], "hertz": d[:n] / hertz_size(self.time_unit),
            "damping_ratios": 0.0 - self.p[:n].real / d[:n], "real_poles": self.p[n:].real,
            "time_constants": constants, "poles": self.p,
            "residues": self.residues * np.where(self.p.imag == 0, 2.0, 1.0)[:, None, None],
            "feedthrough": self.feedthrough,
        }  # fmt: skip

    def noise_at(self, dt: float, given: ArrayLike | None) -> NoiseModel | None:
        """Noise of the outputs at samples of a step: that which is `given`, or that of the fit."""
        if given is None:
            noise = self.noise
            if noise is not None and abs(noise.dt - dt) > 1e-9 * dt:
                raise StructureError(
                    f"the noise of the fit is that of samples {noise.dt:.6g} apart, and dt is {dt:.6g}: give the noise "
                    "at this step, as a standard deviation for each output"
                )
            return noise
        return NoiseModel(np.diag(positive_for_each("noise_std", given, self.outputs, "outputs") ** 2), dt)

    # --- what is unknown ----------------------------------------------------------------------------------------------

    @cached_property
    def unknowns(self) -> PlantUnknowns:
        """What of the plant is unknown, and how poles, residues and feedthrough depend on it."""
        if self.structure in ("lossless", "classical"):
            return self._of_shapes()
        return self._of_free_residues()

    def _of_free_residues(self) -> PlantUnknowns:
        """Natural frequencies, damping ratios, real poles, residues of any phase, and feedthrough."""
        n, N, width = self.order, len(self.p), 2 * len(self.p) + self.has_feedthrough
        places = np.concatenate([np.arange(n), N + np.arange(N)])  # Im of modes, Re of all poles
        natural = natural_jacobian(self.p)[np.ix_(np.r_[np.arange(n), N + np.arange(n)], np.r_[:n, N : N + n])]
        by_poles = np.zeros((2 * N, n + N))
        by_poles[np.ix_(np.r_[:n, N : N + n], np.arange(2 * n))] = np.linalg.inv(natural)
        by_poles[places[2 * n :], np.arange(2 * n, n + N)] = 1.0
        names = [*(f"d_{l + 1}" for l in range(n)), *(f"zeta_{l + 1}" for l in range(n))]
        names += [f"pole_{l + 1}" for l in range(n, N)]
        rows = []
        for o in range(self.outputs):
            for i in range(self.inputs):
                entry = "" if self.residues[0].size == 1 else f"[{o}, {i}]"
                first = i * width
                rows += [(o, first + l, f"Re residue_{l + 1}{entry}") for l in range(N)]
                rows += [(o, first + N + l, f"Im residue_{l + 1}{entry}") for l in range(n)]
                if self.has_feedthrough and self.fed[o, i]:
                    rows.append((o, first + 2 * N, f"feedthrough{entry}"))
        count = n + N + len(rows)
        by_shared = np.zeros((self.outputs, width * self.inputs, count))
        for k, (o, place, name) in enumerate(rows):
            by_shared[o, place, n + N + k] = 1.0
            names.append(name)
        return PlantUnknowns(self, tuple(names), np.pad(by_poles, ((0, 0), (0, len(rows)))), by_shared)

    def _of_shapes(self) -> PlantUnknowns:
        """Coordinates of the sections, real shapes and participation, and feedthrough."""
        sections, shown = Sections.of(self.p), np.any(self.residues != 0, axis=0)
        layout = ChannelLayout(self.outputs, self.inputs, np.ones(self.outputs), self.quantities, self.ports)
        damped = self.structure == "classical"
        coordinates = ShapeCoordinates(layout, sections, shown, self.fed, damped=damped, real=True, tied=True)
        x = coordinates.start(self.residues, self.feedthrough)
        kept = coordinates.free_coordinates(x)
        by_shared = [coordinates.derivatives(x, o, self.has_feedthrough)[:, kept] for o in range(self.outputs)]
        names = tuple(f"x_{k + 1}" for k in range(int(kept.sum())))
        return PlantUnknowns(self, names, coordinates.pole_derivatives(x)[:, kept], np.array(by_shared))


@dataclass(frozen=True, eq=False)
class PlantUnknowns:
    """Unknown numbers `theta` (P,) of a plant and what depends on them.

    `by_poles` (2N, P) are derivatives of imaginary, then real parts of the poles; `by_shared` (q, w, P) those of real
    and imaginary parts of the residues and the feedthrough of each input, for each output.
    """

    plant: PlannedPlant
    names: tuple[str, ...]
    by_poles: Array
    by_shared: Array

    @cached_property
    def quantities(self) -> dict[str, Array]:
        """Derivatives of all quantities by theta, rows as the entries of the arrays of `PlannedPlant.values`.

        Of complex ones those of the real parts, then those of the imaginary parts.
        """
        plant = self.plant
        n, N, (q, m) = plant.order, len(plant.p), plant.feedthrough.shape
        natural = natural_jacobian(plant.p) @ self.by_poles
        real_poles = self.by_poles[N + n :]
        each = self.by_shared.reshape(q, m, -1, len(self.names))
        twice = np.where(plant.p.imag == 0, 2.0, 1.0)[:, None, None, None]
        parts = [twice * np.moveaxis(each[:, :, k * N : (k + 1) * N], 2, 0) for k in (0, 1)]
        through = each[:, :, 2 * N] if plant.has_feedthrough else np.zeros((q, m, len(self.names)))
        with np.errstate(divide="ignore", invalid="ignore"):
            constants = real_poles / plant.p[n:].real[:, None] ** 2
        return {
            "natural_frequencies": natural[:n], "hertz": natural[:n] / hertz_size(plant.time_unit),
            "damping_ratios": natural[N : N + n], "real_poles": real_poles, "time_constants": constants,
            "poles": np.concatenate([self.by_poles[N:], self.by_poles[:N]]),
            "residues": np.concatenate([part.reshape(-1, len(self.names)) for part in parts]),
            "feedthrough": through.reshape(-1, len(self.names)),
        }  # fmt: skip

    def stderr(self, information: Information) -> ReadOnlyMapping:
        """Standard errors by the keys of `PEMResult.stderr` and 'poles'; infinite for what leaves no trace."""
        errors = {}
        for name, rows in self.quantities.items():
            value, flat = self.plant.values[name], standard_errors(information, rows)
            if np.iscomplexobj(value):
                pair = np.empty(value.size, complex)
                pair.real, pair.imag = np.split(flat, 2)
                errors[name] = pair.reshape(value.shape)
            else:
                errors[name] = flat.reshape(np.shape(value))
        errors["feedthrough"] = np.where(self.plant.fed, errors["feedthrough"], np.nan)
        return ReadOnlyMapping(errors)


def standard_errors(information: Information, rows: Array) -> Array:
    """Cramer-Rao bounds of `rows @ theta`, shape (k,); infinite where these have a part that leaves no trace."""
    lengths, rank = information.lengths, information.rank
    silent = lengths == 0
    scaled = np.where(silent, 0.0, rows / np.where(silent, 1.0, lengths))
    along = scaled @ information.vectors.T
    size = np.linalg.norm(scaled, axis=1)
    lost = np.linalg.norm(along[:, rank:], axis=1) > _TRACE * size
    lost |= np.any(rows[:, silent] != 0, axis=1)
    errors = np.linalg.norm(along[:, :rank] / information.singular_values[:rank], axis=1)
    return np.where(lost, np.inf, errors)


def positive_for_each(name: str, value: ArrayLike, count: int, channels: str) -> Array:
    """Check positive numbers (count,) of channels, one for all or one for each."""
    given = _checks.real_array(name, value)
    if given.shape not in ((), (count,)) or np.any(given <= 0):
        raise StructureError(
            f"{name} is {_checks.shown(value)}; it must be positive, a number or one for each of {count} {channels}"
        )
    return np.array(np.broadcast_to(given, count), float)


def pole_tables(values: Mapping[str, Any], stderr: Mapping[str, Any], time_unit: str | None, last: str) -> list[str]:
    """Tables of modes, with a title of their `last` column, and of real poles, with their standard errors."""

    def cells(l: int, *names: str) -> list[str]:
        pairs = ((values[name][l], stderr[name][l]) for name in names)
        return [text for value, error in pairs
                for text in (to_its_error(value, error), "-" if np.isnan(error) else f"{error:.2g}")]  # fmt: skip

    modes = [["mode", f"d [{rate(time_unit)}]", "+-", "damping ratio", "+-", last]]
    modes += [[str(l + 1), *cells(l, "natural_frequencies", "damping_ratios"), ""]
              for l in range(len(values["natural_frequencies"]))]  # fmt: skip
    poles = [["real pole", f"[1/{time_unit or 'time'}]", "+-", ""]]
    poles += [["", *cells(l, "real_poles"), ""] for l in range(len(values["real_poles"]))]
    return [line for table in (modes, poles) if len(table) > 1 for line in aligned(table)]


def acting_together(noise: NoiseModel) -> list[Indices]:
    """Outputs whose noise is correlated, which have to be looked at together."""
    alone = noise.forces is None and not np.any(noise.covariance - np.diag(np.diag(noise.covariance)))
    every = np.arange(noise.outputs)
    return [every[k : k + 1] for k in every] if alone else [every]
