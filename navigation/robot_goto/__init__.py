"""The module RobotGoto: drives to a goal by laser and frames alone."""
