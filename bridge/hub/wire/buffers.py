"""Buffers of rmw_zenoh since 0.10.5 (Lyrical): their part of the token, their key, and the types that have them.

A volatile publisher of such a type no longer publishes on its topic's key. Subscriptions that announce the CPU as their
only backend share one key, the CPU group. Every other subscription, even one that announces no backend, has a separate
key ``<key>/_buf/<GID>`` (rmw_zenoh_cpp 0.10.5, rmw_publisher_data.cpp, ``on_subscriber_discovered``). A subscription as
in Jazzy therefore receives nothing. Serialized messages, as ``ros2 bag play`` publishes them, are still published on
the topic's key.
"""

from __future__ import annotations

CPU_GROUP = "_buf_cpu"
"""The last part of the CPU group's key."""

CPU_BACKEND = "backends:cpu:"
"""The part of a token that announces the CPU as the only backend."""

_BACKENDS = "backends:"

BUFFER_TYPES = frozenset({
    "map_msgs/msg/PointCloud2Update", "nav2_msgs/msg/Costmap", "nav2_msgs/msg/CostmapUpdate",
    "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2",
    "std_msgs/msg/UInt8MultiArray", "stereo_msgs/msg/DisparityImage", "visualization_msgs/msg/InteractiveMarker",
    "visualization_msgs/msg/InteractiveMarkerControl", "visualization_msgs/msg/InteractiveMarkerInit",
    "visualization_msgs/msg/InteractiveMarkerUpdate", "visualization_msgs/msg/Marker",
    "visualization_msgs/msg/MarkerArray", "visualization_msgs/msg/MeshFile",
})  # fmt: skip
"""The standard types with buffers, which contain an unbounded sequence of uint8, possibly in a nested type
(rosidl_typesupport_fastrtps_cpp, msg__type_support_impl.hpp.em). The tokens of publishers reveal other types."""


def group_key(key: str) -> str:
    """Return the key of a topic's CPU group."""
    return f"{key}/{CPU_GROUP}"


def announces_backends(part: str) -> bool:
    """Return whether a part of a token announces buffer backends."""
    return part.startswith(_BACKENDS)
