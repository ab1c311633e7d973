"""RobotPathPlanner: ways over the map to a goal, driven waypoint by waypoint by a local navigator."""
