"""The transform server, which shares one buffer with other programs; it stands on the module host."""
