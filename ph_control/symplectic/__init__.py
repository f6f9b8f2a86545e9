"""Symplectic forms, Williamson's normal form, Darboux coordinates and Casimirs."""
