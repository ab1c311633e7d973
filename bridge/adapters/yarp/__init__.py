"""The YARP side: topics and ports are one thing."""
