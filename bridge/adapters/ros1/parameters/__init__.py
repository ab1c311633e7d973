"""Parameters that ROS 1's parameter server and ROS 2's nodes share, by the rules in `routing.parameters`."""
