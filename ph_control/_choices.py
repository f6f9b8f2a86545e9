"""What options may be, in one table each, from which public calls, command line, files and findings take it.

Nothing is imported that takes time: the command line shows its help without numpy.
"""

from __future__ import annotations

from typing import NamedTuple


class Quantity(NamedTuple):
    """What an output measures.

    Attributes
    ----------
    derivatives : int
        How often the displacement is differentiated; 0 of any other sensor, of which nothing is known.
    words : tuple of str
        Words of labels that tell it.
    units : str
        Pattern of the units that tell it, whole.
    """

    derivatives: int
    words: tuple[str, ...]
    units: str


LENGTH = r"(?:[nuµμmck]?m|in|inch|ft|mil|met(?:er|re)s?|rad|deg|°)"
QUANTITIES = {
    "displacement": Quantity(
        0, ("displacement", "displacements", "disp", "displ", "position", "deflection", "receptance"), LENGTH
    ),
    "free": Quantity(0, ("strain", "microstrain"), r"[uµμ][εe]|[uµμ]?strain|[uµμm]?m/m"),
    "velocity": Quantity(1, ("velocity", "velocities", "vel", "speed", "mobility"), rf"{LENGTH}/s(?:ec)?|rpm"),
    "acceleration": Quantity(
        2,
        ("acceleration", "accelerations", "accel", "acc", "accelerometer", "accelerance", "inertance"),
        rf"{LENGTH}/s(?:ec)?(?:\^|\*\*)?[2²]|{LENGTH}/s/s|m?g_?n?",
    ),
}


class Hypothesis(NamedTuple):
    """A structure that is tested within the free model.

    Attributes
    ----------
    cause : str
        Name of the `Cause` that data show which reject it.
    simpler : tuple of str
        Hypotheses whose models are all among its own.
    channels : int
        Least number of inputs and of outputs with which it says anything.
    ports : int
        Least number of driving points.
    structure : str
        What a model is called for which it is chosen; by default as the hypothesis, which can be given then.
    chosen : bool
        Whether a fit takes it where it is the simplest that is not rejected.
    """

    cause: str
    simpler: tuple[str, ...] = ()
    channels: int = 0
    ports: int = 0
    structure: str = ""
    chosen: bool = True


_REAL_SHAPES = ("lossless", "classical")
HYPOTHESES = {  # the simplest first
    "lossless": Hypothesis("LOSSES"),
    "classical": Hypothesis("COMPLEX_SHAPES", ("lossless",), channels=1),
    "passive": Hypothesis("ACTIVITY", _REAL_SHAPES, channels=1, ports=1),
    "rank one": Hypothesis("SEVERAL_SHAPES", _REAL_SHAPES, channels=2, structure="free"),
    "reciprocal": Hypothesis("ONE_WAY", _REAL_SHAPES, ports=2, structure="free", chosen=False),
}
STRUCTURES = (*(name for name, hypothesis in HYPOTHESES.items() if not hypothesis.structure), "free")

NOISES = ("auto", "white", "correlated", "coloured", "forces")
CRITERIA = ("bic", "aicc", "aic", "holdout")
REPRESENTATIONS = ("observable", "controllable")
