"""What a search works with: rows of channels, candidates, likelihood and criteria, and the fit that it ends with."""
