"""Hosted modules: nodes of the hub that Midspan runs itself, such as the YARP navigation modules."""
