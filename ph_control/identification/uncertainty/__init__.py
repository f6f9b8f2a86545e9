"""Fisher information, covariance and samples of estimates."""
