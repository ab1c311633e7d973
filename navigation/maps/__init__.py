"""Converts maps between YARP's flags and the grids and masks of planners."""
