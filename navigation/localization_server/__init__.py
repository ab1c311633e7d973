"""LocalizationServer: publishes the robot's pose, from Midspan's own localizer or from another one."""
