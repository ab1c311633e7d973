"""The whole daemon between real ROS 1, ROS 2 and zenoh programs."""
