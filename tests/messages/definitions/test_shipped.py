"""Definitions are read and parsed once, however many types nest them and however many versions they have."""

from __future__ import annotations

from collections import Counter

from bridge.messages.definitions.library import DefinitionLibrary
from bridge.messages.definitions.schema import World
from bridge.messages.definitions.sources import Found, ShippedTypes
from bridge.messages.definitions.text import parse_definition

TEXTS = {
    "one_msgs/msg/Point": "float64 x",
    "one_msgs/msg/Pose": "Point position",
    "one_msgs/msg/Line": "Point[2] ends\nPose[] poses",
}


class Counted:
    """A source of definitions that counts reads."""

    def __init__(self) -> None:
        self.reads: Counter[str] = Counter()

    def find(self, name: str) -> Found | None:
        self.reads[name] += 1
        return {name: parse_definition(TEXTS[name], name, World.ROS2)} if name in TEXTS else None

    def names(self, package: str, kind: str = "msg") -> list[str]:
        return [name for name in TEXTS if name.startswith(f"{package}/{kind}/")]


def test_shipped_types_are_read_once_for_all_libraries() -> None:
    """Missing types are cached, too: otherwise, each version of a type would search all releases."""
    source = Counted()
    shipped = ShippedTypes(source)
    for _ in range(3):
        library = DefinitionLibrary(World.ROS2, [shipped])
        schema = library.installed("one_msgs/msg/Line")
        assert schema is not None
        assert set(schema.types) == set(TEXTS)
        assert library.installed("one_msgs/msg/Area") is None
    assert source.reads == dict.fromkeys([*TEXTS, "one_msgs/msg/Area"], 1)
    assert shipped.names("one_msgs") == list(TEXTS)


def test_a_library_reads_nested_types_once() -> None:
    source = Counted()
    library = DefinitionLibrary(World.ROS2, [source])
    for name in ("one_msgs/msg/Line", "one_msgs/msg/Pose"):
        assert library.installed(name) is not None
    assert source.reads["one_msgs/msg/Point"] == 1


def test_a_type_that_is_installed_later_is_found() -> None:
    source = Counted()
    library = DefinitionLibrary(World.ROS2, [source])
    assert library.installed("one_msgs/msg/Area") is None
    TEXTS["one_msgs/msg/Area"] = "float64 size"
    try:
        assert library.installed("one_msgs/msg/Area") is not None
    finally:
        del TEXTS["one_msgs/msg/Area"]
