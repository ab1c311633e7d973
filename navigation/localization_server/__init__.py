"""LocalizationServer: publishes where the robot is, by a localiser of its own or by another one."""
