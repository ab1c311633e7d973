"""The store of maps and locations: a replica at every daemon, in an embedded database, synchronized over the hub."""
