"""RobotPathPlanner: plans paths on the map; a local navigator drives them waypoint by waypoint."""

from bridge.descriptors import ModuleDescriptor

MODULE = ModuleDescriptor(
    name="robot_path_planner",
    factory="navigation.robot_path_planner.module:RobotPathPlanner",
    section="navigation.robot_path_planner.section:RobotPathPlannerSection",
    about="Plans paths on the map, which a local navigator drives; see docs/navigation/robot_path_planner.md.",
)
