"""Time responses, sampling, energy balance, margins and spectral estimates."""
