"""The gateway: one way to navigate for the clients of all sides, over any planner."""
