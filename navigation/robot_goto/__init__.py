"""The module RobotGoto: drives to a goal with only a laser and transforms."""
