"""Parameters that ROS 1's parameter server and ROS 2's nodes share, where `routing.parameters` names them."""
