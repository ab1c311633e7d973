"""A ROS 1 master: names, registrations, parameters, and the calls to nodes that follow from them."""
