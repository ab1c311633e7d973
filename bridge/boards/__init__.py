"""Control boards of YARP robots on the hub, as joint states and commands to joints."""
