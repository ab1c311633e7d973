"""Faults during the drive of a robot to a place."""
