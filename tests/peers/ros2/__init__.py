"""ROS 2: rclpy and Cyclone DDS programs, and the adapter in its own process."""
