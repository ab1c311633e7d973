"""Names of ports: where the name server is, a client of it, and a server of our own."""
