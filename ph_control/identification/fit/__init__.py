"""The prediction-error fit and its result."""
