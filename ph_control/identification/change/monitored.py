"""What a fit says of a plant that may have changed since."""

from __future__ import annotations

from ... import _checks
from ..._options import TestedParameters
from ..._threads import on_one_thread
from ...exceptions import StructureError
from .mode_comparison import ModeComparison, compared_modes
from .score_test import ChangeTest, score_test


class Monitored:
    """Comparison of a result with a later one, and its test on a later record."""

    def compare(
        self, other: object, *, frequency_tolerance: float = 0.1, least_mac: float = 0.5, level: float = 0.05
    ) -> ModeComparison:
        """Pair the modes of this fit with those of a later one, and hold their shifts against the errors of both.

        Parameters
        ----------
        other : PEMResult
            Fit to other data of the same plant.
        frequency_tolerance : float
            Largest relative change of a frequency within a pair.
        least_mac : float
            Least modal assurance of the shapes of a pair, where both fits have the same outputs, or the same inputs of
            one output.
        level : float
            Probability of finding any shift where there is none.

        Returns
        -------
        ModeComparison
            Pairs, shifts, z, p and adjusted p as arrays, and modes without a partner; printed, a table.

        Raises
        ------
        StructureError
            If `other` is no result, its unit of time is another one, or a number is out of range.

        See Also
        --------
        PEMResult.changed : tests a new record without a fit.
        compare : holds models against data.

        Notes
        -----
        As many modes are paired as can be within the bounds, those of the least sum of distances in frequency and of
        `1 - MAC`; real poles of one sign pair up to a factor of 2.  A shift over its standard error,
        `z = (after - before) / sqrt(s1^2 + s2^2)`, is standard normal if nothing has changed.  The adjusted p-values
        are those of Holm over all frequencies, damping ratios and real poles, so that the probability of any false
        shift is at most `level`.  Both fits must hold: see their verdicts.  O(n^3).

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> def recording(d, seed):
        ...     rng = np.random.default_rng(seed)
        ...     plant, u = phc.ph(phc.modes(d, [1.0, 1.0], damping=[0.01, 0.02])), rng.standard_normal(1000)
        ...     y = phc.forced_response(plant, 0.5 * np.arange(1000), u, intersample="zoh").outputs
        ...     return u, y + 0.1 * rng.standard_normal(1000)
        >>> before, after = (phc.pem(recording(*each), dt=0.5) for each in (([1.0, 2.0], 0), ([0.99, 2.0], 1)))
        >>> comparison = before.compare(after)
        >>> comparison.shifted, comparison.frequency_z.round()
        (array([0]), array([-316.,   -2.]))
        """
        if not isinstance(other, Monitored):
            raise StructureError(f"other is {_checks.shown(other)}; pass the result of another fit by pem")
        return compared_modes(self, other, frequency_tolerance, least_mac, level)

    @on_one_thread
    def changed(
        self, data: object, *, parameters: TestedParameters = "all", level: float = 0.05, dt: float | None = None
    ) -> ChangeTest:  # fmt: skip
        """Test whether a new record is one of the same plant, without a fit.

        Parameters
        ----------
        data : TimeResponseData, or pair (u, y) of arrays, shape (T,) or (m, T) and (p, T)
            A record in time, of the same inputs and outputs, that the fit has not seen; `(None, y)` of outputs alone.
            Missing outputs are NaN.
        parameters : {'all', 'poles'}
            What is tested: poles, residues and feedthrough; or poles only, with residues of the record's own, as where
            sensors were placed anew.  Of ambient excitation it is the poles only.
        level : float
            Probability of a false alarm.
        dt : float, optional
            Time between samples, for arrays; by default that of the record that was fitted.

        Returns
        -------
        ChangeTest
            Statistic, degrees of freedom, p, and for each mode the shift that one step estimates; true in a condition
            if `p` is below the level.

        Raises
        ------
        StructureError
            If the record has other channels or is too short, the fit has no standard errors or a pole that grows, or
            the step is another one where the noise is known at that of the fit only.

        See Also
        --------
        PEMResult.compare : compares with a fit to the new record.
        fit_many : watches many recordings, with `reference=` and `FitTable.changes`.

        Notes
        -----
        With the errors e of the record at the old parameters, their derivatives `psi` by the parameters, both
        whitened by the noise of the fit, and their covariance S estimated from the record, the score is
        `z = sum psi^T S^-1 e` and the information `F = sum psi^T S^-1 psi`.  The old parameters have errors of
        covariance C themselves, so that the covariance of z is `F + F C F`, and

            statistic = z^T (F + F C F)^-1 z

        is chi-square with as many degrees of freedom as there are directions of change.  One step from the old
        parameters estimates the shifts, `F^-1 z` with covariance `F^-1 + C`.

        Initial motion, constant, drift, and a delay that was estimated are those of the new record: their derivatives
        are projected out first.  Of ambient excitation these are shapes and gains as well, so that a wind of other
        strength or from elsewhere is no change.  Directions that the structure of the fit excludes, such as damping of
        a lossless one, are not tested; `noise_ratio` and `whiteness` tell what does not fit otherwise.

        The level holds for records of some hundred samples and errors so small that the outputs are linear in them.
        O(T p (n m + n)^2), one evaluation and two of each derivative by a pole; with forces that were not measured
        p times as many.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> def recording(d, seed):
        ...     rng = np.random.default_rng(seed)
        ...     plant, u = phc.ph(phc.modes(d, [1.0, 1.0], damping=[0.01, 0.02])), rng.standard_normal(1000)
        ...     y = phc.forced_response(plant, 0.5 * np.arange(1000), u, intersample="zoh").outputs
        ...     return u, y + 0.1 * rng.standard_normal(1000)
        >>> result = phc.pem(recording([1.0, 2.0], 0), dt=0.5)
        >>> result.changed(recording([1.0, 2.0], 1)).changed
        False
        >>> test = result.changed(recording([0.997, 2.0], 2))
        >>> test.changed, test.modes, (test.frequency_shift / result.d).round(3)
        (True, array([0]), array([-0.003, -0.   ]))
        """
        return score_test(self, data, parameters, level, dt)
