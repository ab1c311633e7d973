"""Names on the hub for the state of Midspan's parts, as rqt_robot_monitor and the Foxglove app show it."""

TOPIC = "/diagnostics"
TYPE = "diagnostic_msgs/msg/DiagnosticArray"
HEARD = "/_midspan/diagnostics"
"""Under this name a side's worker subscribes while a program of its side hears `TOPIC`: who tells need not ask for it.

The routes of a topic subscribe on the hub whether or not anybody on their side listens.
"""
