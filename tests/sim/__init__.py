"""The simulated base."""
