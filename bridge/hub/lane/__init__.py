"""The lane: small messages between the worker processes of one daemon, without zenoh's threads."""
