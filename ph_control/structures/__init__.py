"""Structures by mass, damping and stiffness: all their modes, or those that matter of large ones."""
