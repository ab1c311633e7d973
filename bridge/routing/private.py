"""Topics and services that are private to a side and do not cross unless the configuration says so."""

from __future__ import annotations

import re

_PRIVATE: dict[str, tuple[tuple[re.Pattern[str], str], ...]] = {
    "ros1": (
        (re.compile(r"/rosout(_agg)?"), "ROS 1's own log"),
        (re.compile(r"/statistics"), "ROS 1's connection statistics"),
        (re.compile(r".*/parameter_(descriptions|updates)"), "dynamic_reconfigure's own"),
        (re.compile(r".*/bond"), "bond, a node's private life sign"),
    ),
    "ros2": (
        (re.compile(r"/rosout"), "ROS 2's own log"),
        (re.compile(r"/parameter_events"), "ROS 2's parameter events"),
        (re.compile(r"/ros_discovery_info"), "ROS 2's discovery"),
        (re.compile(r".*/transition_event"), "a lifecycle node's own"),
        (re.compile(r".*/_service_event"), "service introspection"),
        (re.compile(r".*/bond"), "bond, a node's private life sign"),
    ),
}
_OWN_SERVICES: dict[str, tuple[tuple[re.Pattern[str], str], ...]] = {
    "ros1": (
        (re.compile(r"roscpp/srv/\w+"), "a node's own loggers"),
        (re.compile(r"dynamic_reconfigure/srv/\w+"), "dynamic_reconfigure's own"),
        (re.compile(r"nodelet/srv/\w+"), "a nodelet manager's own"),
    ),
    "ros2": (
        (re.compile(r"rcl_interfaces/srv/\w+"), "a node's own parameters and loggers"),
        (re.compile(r"type_description_interfaces/srv/\w+"), "a node's own type descriptions"),
        (re.compile(r"lifecycle_msgs/srv/\w+"), "a lifecycle node's own"),
        (re.compile(r"composition_interfaces/srv/\w+"), "a component container's own"),
    ),
}
"""Services that each node has for itself, by their types."""

for _private in (_PRIVATE, _OWN_SERVICES):
    _private["zenoh"] = _private["zenoh_ros2dds"] = _private["ros2"]
    _private["zenoh_ros1"] = _private["ros1"]


def why_private(side: str, name: str, type_name: str, kind: str = "topic") -> str:
    """Why a topic or a service is private to its side, "" where it is not; ``type_name`` is the type's ROS 2 name."""
    if kind == "action":
        return ""
    patterns, word = (_OWN_SERVICES, type_name) if kind == "service" else (_PRIVATE, name)
    return next((why for pattern, why in patterns.get(side, ()) if pattern.fullmatch(word)), "")
