"""Names of ports: the address of the name server, a client of it, and a name server."""
