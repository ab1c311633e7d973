"""Shared parts of the tests: free ports, processes, conditions with deadlines, and simulated machines."""
