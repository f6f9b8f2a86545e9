"""Fits to many recordings, the table of their modes, and modes followed from recording to recording."""
