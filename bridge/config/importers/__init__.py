"""Converts configurations of other bridges into Midspan's."""
