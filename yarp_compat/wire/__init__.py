"""YARP's wire formats: bytes in, values out. No sockets and no threads here."""
