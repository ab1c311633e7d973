"""Metrics for Prometheus: workers, sides, routes, the store and goals."""
