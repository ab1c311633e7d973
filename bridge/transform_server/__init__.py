"""The transform server, a hosted module that shares one buffer with other programs."""
