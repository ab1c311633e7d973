"""Faults, and the recovery from them."""
