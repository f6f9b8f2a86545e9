"""Identification: from a recording to modal coordinates."""
