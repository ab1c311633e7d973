"""Map2DServer: serves the store's maps and places to YARP clients, ROS 1 and ROS 2, and their planners."""
