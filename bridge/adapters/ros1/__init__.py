"""The ROS 1 side, which implements ROS 1's protocols itself and imports no ROS 1 packages."""
