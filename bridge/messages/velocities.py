"""The ROS 2 types of velocity commands: since Kilted, Nav2 publishes stamped ones by default."""

TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
VELOCITIES = (TWIST, TWIST_STAMPED)
