"""The closed loop in lock-step, in one process: simulator, BaseControl, RobotGoto, planner and localizer."""
