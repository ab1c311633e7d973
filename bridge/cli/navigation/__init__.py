"""The commands that drive the robot: ``goto``, ``nav``, ``halt`` and ``teleop``."""
