"""Smaller models that stay port-Hamiltonian, and the passive models next to others."""
