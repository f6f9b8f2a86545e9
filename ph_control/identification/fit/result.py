"""What every result of a fit can do: views of its modes, comparisons, pictures, files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast, get_args

import control as ct
import numpy as np

from ... import _checks
from ..._display import Report
from ..._frozen import Frozen
from ..._threads import on_one_thread
from ..._types import Array, ArrayLike, ComplexArray, RealOrComplex
from ..._units import common_unit, hertz_size, parted, unit_for
from ...exceptions import StructureError
from ...io.codecs import save
from ...io.files import as_path, refuse_unwritable, write_atomically
from ...modal.modal_form import ModalForm
from ...numerics.modal_assurance import mac, phase_collinearity
from ...plotting.fit_plot import fit_plot
from ...plotting.frf_plot import frf_plot, nyquist_plot
from ...plotting.shape_plot import circle_plot, mac_plot, over_inputs, shape_plot
from ...plotting.validation_plot import hypothesis_plot, stabilisation_plot
from ..data.channels import Recording, ResponseMatrix
from ..data.frequency_record import FrequencyRecord
from ..data.time_record import Record
from ..diagnosis.verdict import CUT_SHORT, Outcome
from ..estimates.stabilisation import Orders, Stabilisation, compared
from ..regression.prediction import FittedChannels, FittedExperiment, chosen_experiment, joint_percent, shares_left
from ..uncertainty.draws import intervals

PictureKind = Literal[
    "fit", "responses", "nyquist", "circles", "shapes", "assurance", "stabilisation", "residuals", "tests"
]


@dataclass(frozen=True)
class OrderRow(Frozen):
    """One row of the order table: what the best model found with `order` modes achieves.

    Attributes
    ----------
    order : int
        Number of modes.
    loss : float
        Mean squared residual.
    aic, bic : float
        Criteria.
    d : ndarray, shape (order,)
        Natural frequencies, ascending, rad per unit time.
    """

    order: int
    loss: float
    aic: float
    bic: float
    d: Array


class FittedModes(Report, Frozen):
    """What follows from the attributes of a `PEMResult`: views of its modes, comparisons, pictures and files."""

    if TYPE_CHECKING:
        poles: ComplexArray
        shapes: ComplexArray
        residues: ComplexArray
        experiments: tuple[FittedChannels, ...] | tuple[FittedExperiment, ...]
        outcome: Outcome
        stderr: Mapping[str, RealOrComplex]

        @property
        def _spare(self) -> int: ...

        def _orders_about(self, most: int) -> Orders: ...

    @property
    def natural_frequencies(self) -> Array:
        """Natural frequencies `|p|` of the modes, ascending, rad per unit time."""
        return np.abs(self.poles[: self.order])

    @property
    def real_poles(self) -> Array:
        """Real poles, the slowest first, per unit time."""
        return np.asarray(self.poles[self.order :].real)

    @property
    def time_constants(self) -> Array:
        """Time constants `-1/p` of the real poles; infinite for an integrator, negative where one grows."""
        with np.errstate(divide="ignore"):
            return np.asarray(-1.0 / self.real_poles)

    @property
    def states(self) -> int:
        """Number of all poles: two of each mode, and the real ones."""
        return self.order + len(self.poles)

    @property
    def hertz(self) -> Array:
        """Natural frequencies in Hz; where `time_unit` is not known, as if it were the second."""
        return _checks.readonly(self.natural_frequencies / hertz_size(self.time_unit))

    @property
    def order(self) -> int:
        """Number of modes n: pairs of complex poles."""
        return int(np.sum(self.poles.imag != 0))

    @property
    def verdict(self) -> str:
        """The verdict, in a few words."""
        return self.outcome.value

    @property
    def time_unit(self) -> str | None:
        """Unit of time of the data, as 'ms', and so of frequencies in radians per unit; None where it is not known."""
        return common_unit([experiment.record for experiment in self.experiments])

    @property
    def input_labels(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return self.experiments[0].record.input_labels

    @property
    def output_labels(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return self.experiments[0].record.output_labels

    @property
    def phase_collinearity(self) -> Array:
        """Modal phase collinearity `|c^T c|^2 / (c^H c)^2`, shape (n,): 1 where outputs move in phase or opposed.

        Of one output and several inputs, as of a roving hammer, it is that of the shapes over the inputs.
        """
        return phase_collinearity(_compared_shapes(self))

    def mac(self, other: object) -> Array:
        """Modal assurance criterion `|c^H c'|^2 / (|c|^2 |c'|^2)` of the mode shapes of two results, from 0 to 1.

        Parameters
        ----------
        other : PEMResult, ModalForm, or array_like, shape (k, p)
            Other mode shapes of the same outputs; where this result has one output and several inputs, of the inputs.

        Returns
        -------
        ndarray, shape (n, k)
            One row for each mode of this result, one column for each of the other.

        Raises
        ------
        StructureError
            If the other has no shapes, or another number of outputs.

        Notes
        -----
        Shapes of results are in units of velocity, so that fits to accelerations and to velocities compare.  A form or
        an array must have the same quantity at all outputs, or be in units of velocity.  Of a result of one output and
        several inputs, as of a roving hammer, the shapes are those over the inputs, as in `shape_plot`.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> plant, u = phc.ph(phc.modes(1.0, 1.0)), np.random.default_rng(0).standard_normal(500)
        >>> y = phc.forced_response(plant, 0.1 * np.arange(500), u, intersample="zoh").outputs
        >>> result = phc.pem((u, y), dt=0.1)
        >>> result.mac(result)
        array([[1.]])
        """
        if isinstance(other, FittedModes | ModalForm):
            return mac(_compared_shapes(self), _compared_shapes(other))
        try:
            shapes = np.array(other, dtype=complex)
        except (TypeError, ValueError, OverflowError):
            shapes = np.zeros(0, complex)
        if shapes.ndim != 2:
            raise StructureError(
                f"other is {_checks.shown(other)}; pass a result, a form or an array of shapes (modes, outputs); of "
                "finite elements `structural_modes.shapes[places].T`, with the rows where the sensors are"
            )
        _checks.finite("other", shapes)
        return mac(_compared_shapes(self), shapes)

    def _only(self, name: str) -> FittedChannels | FittedExperiment:
        if len(self.experiments) > 1:
            raise StructureError(
                f"this fit has {len(self.experiments)} experiments; use experiments[k].{name} for one of them"
            )
        return self.experiments[0]

    @property
    def record(self) -> Record | FrequencyRecord | Recording | ResponseMatrix:
        """The data, of a fit to one experiment."""
        return self._only("record").record

    @property
    def free_amplitudes(self) -> ComplexArray:
        """Free motion of each mode at each output, `Re(amplitude exp(p t))`, of a fit to one experiment.

        Shape (n,) of one input and output, else (n, p).
        """
        return np.asarray(self._only("free_amplitudes").free_amplitudes)

    def _given_state(self, value: ArrayLike) -> Array:
        """State (2n,); a number is every entry of it."""
        state, size = _checks.real_array("initial_state", value), self.states
        if state.ndim and state.shape != (size,):
            raise StructureError(f"initial_state has shape {state.shape}; a state of this model is a vector ({size},)")
        return np.full(size, state) if not state.ndim else state

    @property
    def predicted(self) -> RealOrComplex:
        """Predicted outputs, all experiments one after the other along the last axis."""
        return _checks.readonly(np.concatenate([experiment.predicted for experiment in self.experiments], axis=-1))

    @property
    def residuals(self) -> RealOrComplex:
        """What the prediction leaves, all experiments one after the other; NaN where the output is missing."""
        return _checks.readonly(np.concatenate([experiment.residuals for experiment in self.experiments], axis=-1))

    @on_one_thread
    def stabilisation(
        self,
        beyond: int = 5,
        *,
        frequency_tolerance: float = 0.01,
        damping_tolerance: float = 0.05,
        least_mac: float = 0.95,
    ) -> Stabilisation:
        """Fit models of ascending order to the same data, and tell which poles stay from one to the next.

        Parameters
        ----------
        beyond : int
            Number of orders above that of the result.
        frequency_tolerance, damping_tolerance : float
            Relative change up to which a frequency, or a damping ratio, counts as the same.
        least_mac : float
            Modal assurance criterion from which on a shape does.

        Returns
        -------
        Stabilisation
            Poles and shapes of each order, their stability, and a picture.

        Raises
        ------
        StructureError
            If `beyond` or a tolerance is out of range, or the result has no modes.

        See Also
        --------
        stabilisation_plot : draws the same of a result.

        Notes
        -----
        Models of one mode more each, from a single one to `order + beyond`, or to what the data can carry; that of this
        order is the result itself.  Of damped modes they have free residues, of lossless ones none has damping, and a
        mode of noise joins at each order beyond: it may stay as well, which is why the criteria, and not this diagram,
        choose the order.  The cost is that of a search for so many modes.

        Examples
        --------
        >>> import numpy as np, matplotlib.pyplot as plt, ph_control as phc
        >>> rng, plant = np.random.default_rng(0), phc.ph(phc.modes([1.0, 2.0], [1.0, 0.5], damping=[0.01, 0.02]))
        >>> u = rng.standard_normal(500)
        >>> y = phc.forced_response(plant, 0.5 * np.arange(500), u, intersample="zoh").outputs
        >>> result = phc.pem((u, y + 0.05 * rng.standard_normal(500)), dt=0.5)
        >>> diagram = result.stabilisation(beyond=2)
        >>> print(diagram)
          order  new  frequency  damping
              1    1          0        0
              2    1          0        1  the result
              3    1          0        2
              4    2          0        2
        >>> diagram.stable[1].tolist(), diagram.damping_ratios[1].round(3).tolist()
        ([True, False], [0.01, 0.02])
        >>> plt.close(diagram.plot(time_unit="s").figure)
        """
        beyond = _checks.whole_number("beyond", beyond, 0)
        if not self.order:
            raise StructureError("this result has no modes, and there are none to follow over orders")
        return compared(
            self._orders_about(self.order + beyond), self, frequency_tolerance=frequency_tolerance,
            damping_tolerance=damping_tolerance, least_mac=least_mac,
        )  # fmt: skip

    def confidence_interval(self, level: float = 0.95) -> Mapping[str, RealOrComplex]:
        """Confidence intervals of the parameters.

        Parameters
        ----------
        level : float
            Probability of each interval, between 0 and 1.

        Returns
        -------
        mapping
            Arrays of shape (..., 2), lower and upper ends, under the keys of `stderr`; NaN for what is held.  Of
            complex numbers the ends are those of real and imaginary part.

        Raises
        ------
        StructureError
            If the level is not between 0 and 1.

        Notes
        -----
        From Student's t distribution, as the noise variances are estimated as well; weights and frequencies are cut off
        at 0.  Those of lossless models are right to the square of their error: of frequencies over the Fourier spacing,
        of weights over their size.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> rng = np.random.default_rng(0)
        >>> plant, u = phc.ph(phc.modes(1.0, 1.0)), rng.standard_normal(500)
        >>> y = phc.forced_response(plant, 0.1 * np.arange(500), u, intersample="zoh").outputs
        >>> y = y + 0.1 * rng.standard_normal(500)
        >>> (low, high), = phc.pem((u, y), 1, dt=0.1).confidence_interval()["d"]
        >>> bool(low < 1.0 < high)
        True
        """
        names = {"initial_state": "initial_states", "offset": "offsets"}
        values = {
            name: np.reshape(getattr(self, names.get(name, name)), np.shape(error))
            for name, error in self.stderr.items()
        }
        lower = dict.fromkeys(("d", "r", "kappa", "natural_frequencies", "hertz"), 0.0)
        return intervals(values, self.stderr, level, lower, self._spare)

    def summary(self) -> str:
        """Report for people: model, uncertainty, quality, verdict.

        Returns
        -------
        str
            Several lines, at most 100 characters wide; `-` stands for the error of what is held.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> plant, u = phc.ph(phc.modes(1.0, 1.0)), np.random.default_rng(0).standard_normal(500)
        >>> y = phc.forced_response(plant, 0.1 * np.arange(500), u, intersample="zoh").outputs
        >>> print(phc.pem((u, y), dt=0.1).summary())
        1 mode of 'y' from 'u'
          verdict         consistent with the record
          structure       lossless
          record          500 samples, step 0.1, input held between samples
        ...
          Not rejected: lossless (p = 1), classical (p = 1), passive (p = 1). The data are reproduced to
          rounding.
        """
        return str(self)

    def plot(
        self,
        experiment: int = 0,
        *,
        kind: PictureKind = "fit",
        output: int | None = None,
        input: int | None = None,
        **kwargs: Any,
    ) -> ct.ControlPlot:
        """Picture of one measured and predicted output with the residual below; of a response, over frequency.

        Parameters
        ----------
        experiment : int
            Which of several experiments, counted from 0.
        kind : {'fit', 'responses', 'nyquist', 'circles', 'shapes', 'assurance', 'stabilisation', 'residuals', 'tests'}
            What to show: 'fit' as above, or the picture of `frf_plot`, `nyquist_plot`, `circle_plot`, `shape_plot`,
            `mac_plot`, `stabilisation_plot`, `residual_plot` or `hypothesis_plot`.
        output, input : int
            Which output, and of a response from which input, counted from 0; by default the first, and of 'circles' of
            each mode those in which it counts most.
        **kwargs
            Passed to the plotting function: labels and units.

        Returns
        -------
        control.ControlPlot

        Raises
        ------
        StructureError
            If there is no such kind, experiment, output or input.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> rng = np.random.default_rng(0)
        >>> plant, u = phc.ph(phc.modes(1.0, 1.0, damping=0.02)), rng.standard_normal(500)
        >>> y = phc.forced_response(plant, 0.1 * np.arange(500), u, intersample="zoh").outputs
        >>> result = phc.pem((u, y + 0.1 * rng.standard_normal(500)), 1, dt=0.1, structure="free")
        >>> picture = result.plot(output_unit="m/s")
        >>> picture.figure.savefig("fit.png")  # doctest: +SKIP
        """
        from ..validation.result_plots import residual_plot

        pictures: dict[str, Callable[..., Any]] = {
            "responses": frf_plot, "nyquist": nyquist_plot, "circles": circle_plot, "shapes": shape_plot,
            "assurance": mac_plot, "stabilisation": stabilisation_plot, "residuals": residual_plot,
            "tests": hypothesis_plot,
        }  # fmt: skip
        if _checks.choice("kind", kind, get_args(PictureKind)) != "fit":
            given: dict[str, dict[str, Any]] = {
                "circles": {"output": output, "input": input},
                "residuals": {"experiment": experiment},
            }
            return pictures[kind](self, **given.get(kind, {}), **kwargs)
        fitted_experiment = chosen_experiment(self.experiments, experiment)
        place = _checks.whole_number("output", 0 if output is None else output, 0, len(self.output_labels) - 1)
        if np.iscomplexobj(fitted_experiment.predicted):
            source = _checks.whole_number("input", 0 if input is None else input, 0, len(self.input_labels) - 1)
            names = (parted(name)[0] for name in (self.input_labels[source], self.output_labels[place]))
            kwargs.setdefault("title", "Frequency response, {} to {}".format(*names))
            # on the background of this experiment
            shown = replace(cast(Any, self), experiments=[fitted_experiment]) if len(self.experiments) > 1 else self
            return frf_plot(shown, fitted_experiment.record.as_response(), outputs=[place], inputs=[source], **kwargs)
        # a label such as "velocity [m/s]" carries its unit
        name, unit = parted(self.output_labels[place])
        kwargs.setdefault("output_label", name)
        if unit:
            kwargs.setdefault("output_unit", unit)
        kwargs["time_unit"] = unit_for(kwargs.get("time_unit"), self)
        y, predicted = (
            np.atleast_2d(part)[place] for part in (fitted_experiment.measured, fitted_experiment.predicted)
        )
        fitted = joint_percent(np.ravel(shares_left([(fitted_experiment.record, fitted_experiment.predicted)]))[place])
        return fit_plot(fitted_experiment.record.time, y, predicted, fit_percent=fitted, **kwargs)

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write the result as JSON; `load` gives it back.

        Parameters
        ----------
        path : str or Path
            File to write.
        overwrite : bool
            Whether an existing file may be replaced.

        Raises
        ------
        OutputExistsError
            If the file exists and `overwrite` is false.

        Examples
        --------
        >>> import pathlib, tempfile, numpy as np, ph_control as phc
        >>> plant, u = phc.ph(phc.modes(1.0, 1.0)), np.random.default_rng(0).standard_normal(500)
        >>> y = phc.forced_response(plant, 0.1 * np.arange(500), u, intersample="zoh").outputs
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "result.json")
        ...     phc.pem((u, y), dt=0.1).save(path)
        ...     phc.load(path).order
        1
        """
        save(self, path, overwrite=overwrite)

    def report(self, path: str | Path, *, title: str | None = None, overwrite: bool = False) -> None:
        """Write the result as one HTML page: summary, modes, tests, pictures, and what it takes to repeat the fit.

        Parameters
        ----------
        path : str or Path
            File to write.
        title : str, optional
            Heading of the page.
        overwrite : bool
            Whether an existing file may be replaced.

        Raises
        ------
        OutputExistsError
            If the file exists and `overwrite` is false.
        StructureError
            If the title is no text.

        Notes
        -----
        Pictures are inside the file, as SVG; nothing is loaded from elsewhere, no script runs.

        Examples
        --------
        >>> import pathlib, tempfile, numpy as np, ph_control as phc
        >>> plant, u = phc.ph(phc.modes(1.0, 1.0)), np.random.default_rng(0).standard_normal(500)
        >>> y = phc.forced_response(plant, 0.1 * np.arange(500), u, intersample="zoh").outputs
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "fit.html")
        ...     phc.pem((u, y), dt=0.1).report(path, title="One mode")
        ...     "<h1>One mode</h1>" in path.read_text(encoding="utf-8")
        True
        """
        from ..validation.html_report import page_of

        if title is not None and not isinstance(title, str):
            raise StructureError(f"title is {_checks.shown(title)}; pass a text, or None")
        target = as_path(path)
        refuse_unwritable(target, overwrite)
        page = page_of(cast(Any, self), title or "Identification report")
        write_atomically(target, page, overwrite=overwrite)


def _compared_shapes(model: Any) -> ComplexArray:
    """Shapes over the outputs (n, p), or of one output and several inputs over the inputs (n, m)."""
    moved = over_inputs(model)
    return np.asarray(model.shapes) if moved is None else moved


def cut_short(result: Any) -> Any:
    """A result of a fit that was interrupted on the way to a better one."""
    return replace(result, success=False, outcome=Outcome.INTERRUPTED, message=CUT_SHORT)
