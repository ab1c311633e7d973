"""The kinds of ports that YARP users know, on the engine of `yarp_compat.ports`."""
