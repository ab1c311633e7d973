"""Routing between one side and the hub: rules, routes, loop guard, queues and counters, shared by all sides."""
