"""The hub: a ROS 2 graph spoken over zenoh in rmw_zenoh's Jazzy wire format."""
