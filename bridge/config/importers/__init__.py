"""Configurations of other bridges, turned into Midspan's."""
