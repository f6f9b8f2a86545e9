"""The search in data under given circumstances: modes join, are doubted, and settle; the choice of the order."""
