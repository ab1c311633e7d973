"""The device types and the base of the device interfaces. Each is in the file of its name."""
