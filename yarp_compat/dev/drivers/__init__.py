"""Devices by name: `PolyDriver`, the registry of what it opens, and the devices of each kind."""
