"""Tests of a fit against its assumptions."""
