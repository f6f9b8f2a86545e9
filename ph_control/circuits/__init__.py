"""Circuits of systems and systems of circuits: Foster and Cauer forms, SPICE netlists."""
