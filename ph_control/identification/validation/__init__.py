"""Simulation and residuals of models on new data."""
