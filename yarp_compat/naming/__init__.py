"""Names of ports: the address of the name server, a client, and our own server."""
