"""The supervisor: starts, monitors and restarts the workers of the sides and modules."""
