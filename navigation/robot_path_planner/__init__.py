"""RobotPathPlanner: plans paths on the map; a local navigator drives them waypoint by waypoint."""
