"""The classes that are a `control.StateSpace`, and conversions between them."""
