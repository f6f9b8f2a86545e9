"""Identification: from a recording to modal coordinates."""

from . import document  # noqa: F401  # teaches save and load what a result is
