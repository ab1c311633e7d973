"""The command ``yarp``."""
