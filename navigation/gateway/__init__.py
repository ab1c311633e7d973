"""The gateway: one navigation interface for the clients of all sides, over any planner."""
