"""Mapper2D: builds a map from a laser and the robot's pose; people can paint on it meanwhile."""
