"""The zenoh side: key dialects of other zenoh bridges and programs, each a network separate from the hub."""
