"""ROS 2 services: callers and servers, as raw bytes."""
