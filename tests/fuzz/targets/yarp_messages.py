"""ROS messages from YARP ports: nested lists, selected fields, and YARP's own types."""

from __future__ import annotations

from tests.fuzz.target import Subject, Target

_TYPES = (
    "geometry_msgs/msg/Twist",
    "sensor_msgs/msg/LaserScan",
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/JointState",
    "nav_msgs/msg/Odometry",
    "nav_msgs/msg/Path",
    "nav_msgs/msg/OccupancyGrid",
    "std_msgs/msg/String",
    "std_msgs/msg/Float64MultiArray",
)
_FIELDS: dict[str, list[str | int]] = {
    "geometry_msgs/msg/Twist": ["linear.x", "deg(angular.z)", 3, "'end'"],
    "sensor_msgs/msg/JointState": ["header.stamp", "name", "position"],
}
_WORDS = [
    bytes.fromhex(hex_code) for hex_code in ("00010000", "01010000", "0a010000", "14010000", "20010000", "ffffffff")
]


def _subject(form: str) -> Subject:
    """The first byte selects the type, the second the profile; accepted inputs become a message of the type."""
    from bridge.messages.errors import ConversionError
    from bridge.messages.json import from_json
    from bridge.messages.registry import Registry
    from bridge.messages.yarp.contents import Content
    from bridge.messages.yarp.fields import BottleEntry
    from tests.messages.samples import sample
    from yarp_compat.wire.profile import Profile

    registry = Registry()
    types = tuple(_FIELDS) if form == "fields" else _TYPES
    codecs, seeds = [], []
    for number, name in enumerate(types):
        entries = tuple(BottleEntry.parse(entry) for entry in _FIELDS[name]) if form == "fields" else ()
        codec = Content(form, entries).codec(registry, name)
        codecs.append((codec, registry.hub_check(name)))
        if name in ("sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2", "nav_msgs/msg/OccupancyGrid"):
            continue  # the sample's sizes do not fit its data
        cdr = from_json(registry, name, sample(registry.schema(name)))
        seeds.append(bytes((number, 0)) + b"".join(codec.to_yarp(cdr).payload))
    profiles = (None, *Profile)

    def parse(data: bytes) -> None:
        codec, check = codecs[data[0] % len(codecs)] if data else codecs[0]
        cdr = codec.to_hub(data[2:], profiles[data[1] % 3] if len(data) > 1 else None, 1)
        assert check(cdr) == cdr

    return Subject(parse, seeds, (ConversionError,), _WORDS, largest=4096)


TARGETS = (
    Target("yarp_layout", 15_000, lambda: _subject("bottle")),
    Target("yarp_fields", 10_000, lambda: _subject("fields")),
    Target("yarp_natural", 20_000, lambda: _subject("natural")),
)
