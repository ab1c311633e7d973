"""Messages: definitions, values, and conversion between ROS 1, ROS 2 and YARP, on bytes."""
