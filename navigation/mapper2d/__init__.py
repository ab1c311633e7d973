"""Mapper2D: a map from a laser and a pose that is given, painted on while it grows."""
