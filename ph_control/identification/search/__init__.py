"""From data to initial estimates and to the order."""
