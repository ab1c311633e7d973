"""The zenoh adapter, against programs written from the plugins' sources."""
