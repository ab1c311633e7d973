"""The relay between the hub's own nodes whose versions of a type differ, such as nodes of two ROS 2 releases."""
