"""ROS 1 services: callers and servers, as raw bytes."""
