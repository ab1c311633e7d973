"""Hosted modules: nodes of the hub that Midspan runs itself, the YARP navigation modules among them."""
