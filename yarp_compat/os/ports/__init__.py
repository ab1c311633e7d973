"""YARP's port classes, on the core of `yarp_compat.ports`."""
