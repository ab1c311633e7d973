"""Faults during a robot's drive to a place."""
