"""Noise that comes through the plant: unmeasured forces, sensors that share noise, ambient excitation."""
