"""The zenoh side: the other key dialects in use on zenoh networks, each a network of its own beside the hub."""
