"""Unique coordinates, morphisms, isomorphisms and equivalence relations of systems."""
