"""Transforms between frames over time: what tf2's buffer does, on flat arrays and compiled kernels."""
