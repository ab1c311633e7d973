"""The verbs that drive the robot: ``goto``, ``nav``, ``halt`` and ``teleop``."""
