"""The numbers that a fit is tuned by, each with its reason.

Bounds of rounding, and sizes of what is worked on at a time, stay beside the function that they belong to.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tuning:
    """What a search decides by; distances of frequencies are in bins, `2 pi` over the length of a record."""

    # --- what noise does
    by_chance: float = 1e-3  # probability that noise alone shows such a mode anywhere in the band
    constant_by_chance: float = 1e-2  # that noise of one level is taken to grow with the gain
    white: float = 1e-3  # p-value below which residuals are not white
    surely_white: float = 0.05  # p-value from which on what was fitted need not be taken into account
    lags: int = 20  # of the test of whiteness
    past_of_noise: int = (
        4  # samples of it that coloured noise depends on, at most: few, so that no mode passes for noise
    )
    broad_noise: float = 8.0  # bins: half-width of a peak of it, at least; what is narrower is a mode
    ringing_noise: float = 3.0  # the same of an autoregression, which is cheaper than a mode that inputs drive
    hopeless: float = 0.3  # logarithm of the ratio of variances of each output, that other poles hardly make up for
    wandering: float = 20.0  # by which the BIC is smaller, at least, of slow poles in place of noise that wanders
    tails: float = 10.0  # degrees of freedom of the t distribution that a law of noise is fitted with
    fewest_points: int = 20  # to spare: with fewer no law of noise is estimated

    # --- where modes are looked for
    half_width: int = 12  # bins on either side of a mode, and as many half-widths of the peak of a damped one
    thinned: int = 1024  # bins about a damped mode, at most
    everywhere: int = 100  # bins between these
    all_over: int = 1024  # bins that show what has no peak
    in_time: int = 1500  # samples up to which every step is refined in time; of longer records the bins do
    piece: int = 1 << 18  # numbers worked on at a time: a few megabytes
    ridge: float = 1e-9  # keeps nearly collinear columns apart while candidates are compared

    # --- the path of modes
    patience: int = 3  # orders without a better criterion before a path ends
    nearly_as_strong: float = 0.1  # of the strongest candidate's gain: others that may join at the same step,
    together_apart: float = 8.0  # so far from one another,

    # --- circumstances that look like modes
    delays: tuple[int, ...] = tuple(range(-2, 9))  # samples that are tried
    delay_prior: float = 2.0  # log-likelihood that each sample of a delay costs
    likely: float = 8.0  # log-likelihood at which a search begins again under other circumstances,
    sure: float = 3.0  # log-likelihood by which one hold is told from the other

    # --- damped modes
    fastest_growth: float = 2.0  # a factor of 3e5 over a record, which leaves ten digits
    slowest_growth: float = 0.16  # a factor of e over a record, as errors of poles that do not decay may have
    decay_rates: tuple[float, ...] = (0.03, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)  # tried where nothing is known
    widths_of_peaks: tuple[int, ...] = (6, 24, 96, 384)  # half-widths of the windows in which one mode is looked for
    narrowest: float = 0.02  # half-width of a peak
    broadest: float = 0.2  # damping ratio of what still counts as a mode
    damped_apart: float = 3.0  # between modes, their half-widths added: what is closer mends the shape of a peak
    same_shape: float = 0.9  # modal assurance criterion from which on two modes are told by their frequencies only
    likelier: float = 0.05  # by which the logarithm of the noise variance falls where a search goes back to a model
    patches: int = 4  # modes more that may mend the shape of others where nothing else leaves white residuals
    tried: int = 3  # candidates for one more mode
    vague: float = 0.5  # of the half-width of a peak, or of a bin: with larger errors of it there is no mode
    fed_through: float = 4.0  # standard errors below which nothing is
    rough: float = 1e-6  # relative decrease of the loss at which refinements on the way end


TUNING = Tuning()
