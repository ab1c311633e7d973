"""actionlib's five topics against the three services and two topics of a ROS 2 action; see docs/sides/actions.md."""
