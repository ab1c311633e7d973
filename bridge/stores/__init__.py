"""The store of maps and locations: one copy at every daemon, in an embedded database, shared on the hub."""
