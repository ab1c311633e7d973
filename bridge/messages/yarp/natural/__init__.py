"""The YARP types that say the same as a ROS message; each module has those of one kind."""
