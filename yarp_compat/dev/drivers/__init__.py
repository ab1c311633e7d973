"""Devices by name: `PolyDriver`, its registry, and the factories of each kind of device."""
