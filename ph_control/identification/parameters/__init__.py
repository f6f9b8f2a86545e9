"""Physical parameters: modes of a system function, pairing with fitted modes, and model updating."""
