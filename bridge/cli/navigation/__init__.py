"""The commands that drive or stop the robot, such as ``goto``, ``dock``, ``nav``, ``teleop`` and ``halt``."""
