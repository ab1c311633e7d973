"""Services between one side and the hub, including the three services of an action."""
