"""The circumstances of a search as moves on its fit: drifts, delays, noise, lines in error, long records."""
