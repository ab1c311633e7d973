"""Finds what commonly goes wrong with a bridge and its networks, and names the cure."""
