"""Routing between one side and the hub: rules, routes, loop guard, queues and counters, written once for all sides."""
