"""Sessions, nodes and programs on the hub."""
