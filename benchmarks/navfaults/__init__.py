"""Faults of a robot that drives to a place, one after the other."""
