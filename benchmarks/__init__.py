"""Benchmarks: one script for each claim; see README.md."""
