"""Change of a plant: modes of two fits compared, and a new record tested against an old fit."""
