"""Planners, clients and robots around the gateway."""
