"""Transforms between frames over time: the functions of tf2's buffer, on flat arrays and compiled kernels."""
