"""The supervisor: it starts the workers of the sides and modules, watches them, and restarts them."""
