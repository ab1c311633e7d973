"""Figures for Prometheus: of the workers, their sides and routes, the store and the goals."""
