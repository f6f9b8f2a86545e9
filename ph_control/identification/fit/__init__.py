"""The prediction-error fit, its result and the judgement of it."""
