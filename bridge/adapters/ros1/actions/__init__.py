"""Maps actionlib's five topics to the three services and two topics of a ROS 2 action; see docs/sides/actions.md."""
