"""Topics that are private to a side and do not cross unless the configuration says so."""

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
_PRIVATE["zenoh"] = _PRIVATE["zenoh_ros2dds"] = _PRIVATE["ros2"]
_PRIVATE["zenoh_ros1"] = _PRIVATE["ros1"]


def why_private(side: str, topic: str) -> str:
    """Why a topic is private to its side, "" where it is not."""
    for pattern, why in _PRIVATE.get(side, ()):
        if pattern.fullmatch(topic):
            return why
    return ""
