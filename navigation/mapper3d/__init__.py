"""Mapper3D: an octree from clouds and depth images, and a grid of the obstacles that the robot would touch."""
