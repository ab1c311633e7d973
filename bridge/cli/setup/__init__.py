"""The commands that prepare a machine: configuration, keys, message packages, services."""
