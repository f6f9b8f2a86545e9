"""Poles and residues: modal form, pole-residue splitting, discretisation, zeros."""
