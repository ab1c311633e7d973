"""The ROS 2 side: rclpy over Fast DDS. Nothing outside this package imports rclpy."""
