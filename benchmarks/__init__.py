"""Benchmarks: one script per claim; see README.md."""
