"""Numerical linear algebra that LAPACK and numpy lack."""
