"""Ports and their connections: sockets and threads."""
