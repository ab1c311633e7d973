"""Shared parts of the endurance benchmarks: a daemon between programs of every side, and its processes' resources."""
