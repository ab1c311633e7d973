"""The verb ``yarp``."""
