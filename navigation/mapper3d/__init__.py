"""Mapper3D: an octree from clouds and depth images, and the grid of what the robot would touch."""
