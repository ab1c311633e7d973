"""Plain zenoh programs, bridges like zenoh's plugins, and rmw_zenoh nodes."""
