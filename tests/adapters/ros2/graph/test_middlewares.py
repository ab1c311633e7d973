"""The DDS and the release of participants."""

from __future__ import annotations

import pytest

from bridge.adapters.ros2.graph import middlewares
from bridge.hub.wire.qos import Qos
from bridge.routing.edge import Endpoint, Kind, MadeBy

FAST, CYCLONE, OTHER = (bytes.fromhex(vendor + "aabbccdd" + "00" * 6) for vendor in ("010f", "0110", "0199"))
HASH = "RIHS01_" + "1" * 64
EVENT = "lifecycle_msgs/msg/TransitionEvent"
LYRICAL = "RIHS01_78b19e2be41a797fc009c96bda68944182edabec7852cccd928a40bc06f6f9d7"


def end(prefix: bytes, type_hash: str = HASH, type_name: str = "std_msgs/msg/String", node: str = "/node") -> Endpoint:
    gid = (prefix + bytes(4)).hex()
    return Endpoint(gid, Kind.PUBLISHER, "/topic", type_name, Qos(), MadeBy.NATIVE, node=node, type_id=type_hash)


@pytest.mark.parametrize(
    ("ends", "version", "name", "release"),
    [
        ([end(FAST)], "3.2.2", "Fast DDS 3.2.2", "Kilted"),
        ([end(FAST)], "3.6.0", "Fast DDS 3.6.0", "Lyrical or later"),
        ([end(FAST)], "", "Fast DDS 2", "Iron or Jazzy"),
        ([end(FAST, "")], "", "Fast DDS 2", "Humble"),
        ([end(FAST)], None, "Fast DDS", "Iron or later"),
        ([end(FAST, ""), end(FAST)], None, "Fast DDS", "Iron or later"),
        ([end(FAST), end(FAST, LYRICAL, EVENT)], None, "Fast DDS", "Lyrical or later"),
        ([end(FAST, LYRICAL, EVENT)], "", "Fast DDS 2", ""),
        ([end(CYCLONE)], "0.10.5", "Cyclone DDS 0.10.5", "Iron or later"),
        ([end(CYCLONE, "")], None, "Cyclone DDS", "Humble"),
        ([end(OTHER)], None, "an unknown DDS (vendor 01 99)", "Iron or later"),
    ],
)
def test_a_participants_middleware_and_release_are_recognized(
    ends: list[Endpoint], version: str | None, name: str, release: str
) -> None:
    prefix = bytes.fromhex(ends[0].id)[:12]
    versions = {} if version is None else {prefix: version}
    (group,) = middlewares.groups(ends, frozenset({prefix}), versions)
    assert (group["name"], group["release"]) == (name, release)
    assert group["hashes"] is any(endpoint.type_id for endpoint in ends)


def test_programs_without_ros_are_listed_without_a_release() -> None:
    (group,) = middlewares.groups([end(CYCLONE, "", node="")], frozenset(), {})
    assert group["ros"] is False
    assert group["release"] == ""
    assert group["nodes"] == ["a node with an unknown name"]


def test_alike_participants_are_one_group() -> None:
    second = FAST[:-1] + b"\1"
    ends = [end(FAST, node="/b"), end(second, node="/a"), end(CYCLONE, node="/c")]
    found = middlewares.groups(ends, frozenset({FAST, second, CYCLONE}), {})
    assert [(group["name"], group["nodes"], group["count"]) for group in found] == [
        ("Cyclone DDS", ["/c"], 1),
        ("Fast DDS", ["/a", "/b"], 2),
    ]
