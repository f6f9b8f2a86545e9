"""Recordings, frequency tables, JSON and MATLAB files."""
