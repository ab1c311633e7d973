"""Map2DServer: the maps and places of the store, for YARP's clients, for ROS 1 and ROS 2, and for their planners."""
