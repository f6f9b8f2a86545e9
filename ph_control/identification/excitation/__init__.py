"""What an input can show of a model."""
