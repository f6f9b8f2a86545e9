"""The judgement of a fit: its residuals, the evidence for and against it, the outcome and its reasons."""
