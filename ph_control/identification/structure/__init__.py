"""Structures as constraints on a fit of free residues: their minima, their tests, and the simplest that stands."""
