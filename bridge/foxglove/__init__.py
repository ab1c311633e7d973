"""The server for the Foxglove app: a worker that shows the hub by the library ``foxglove-sdk``."""
