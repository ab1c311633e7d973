"""The ROS 2 side: rclpy over Fast DDS or Cyclone DDS. Besides this package, only the demo's programs import rclpy."""
