"""Algorithms on arrays, without input, output or dependence on modules."""
