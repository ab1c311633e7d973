"""The server for the Foxglove app: a worker that serves the hub's topics with the library ``foxglove-sdk``."""
