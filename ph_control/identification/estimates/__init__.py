"""The numbers of a fit with their errors: parameters, mode shapes, initial states, predictions, likelihood."""
