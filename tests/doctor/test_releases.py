"""The check that names the DDS and the release of ROS 2 nodes."""

from __future__ import annotations

from typing import Any

import pytest

from bridge.doctor.check import Result
from bridge.doctor.checks import CHECKS, releases
from bridge.hub.graph import HubEndpoint
from bridge.hub.graph.tokens import EndpointKind, Origin
from bridge.hub.wire.keys import NO_HASH
from bridge.hub.wire.qos import Qos
from tests.doctor.parts import around, every, hub, only, results

JAZZY = {"name": "Fast DDS 2", "release": "Iron or Jazzy", "nodes": ["/a", "/b"], "count": 2}
KILTED = {"name": "Fast DDS 3.2.2", "release": "Kilted", "nodes": ["/k"], "count": 1}
HUMBLE = {"name": "Cyclone DDS", "release": "Humble", "hashes": False, "nodes": ["/h"], "count": 1}
PLAIN = {"name": "Cyclone DDS 11.0.1", "ros": False, "hashes": False, "nodes": ["/p"], "count": 1}


def side(*groups: dict[str, Any]) -> dict[str, Any]:
    return {"worker": "ros2", "side": "ros2", "middlewares": list(groups)}


def native(node: str, type_hash: str = "RIHS01_" + "1" * 64, **more: Any) -> HubEndpoint:
    kind, more = EndpointKind.PUBLISHER, {"origin": None, "pending": False, "own": False, **more}
    return HubEndpoint("ab", node, "/", kind, "/t", "std_msgs/msg/String", type_hash, Qos(), bytes(16), **more)


@pytest.mark.parametrize(
    ("group", "result", "words"),
    [
        (JAZZY, Result.OK, "Fast DDS 2 (Iron or Jazzy): /a, /b"),
        (HUMBLE, Result.WARN, "Cyclone DDS (Humble): /h; these nodes have no type hashes"),
        (PLAIN, Result.OK, "Cyclone DDS 11.0.1 (not a ROS 2 program): /p"),
        ({"nodes": ["/x"]}, Result.OK, "unknown DDS (unknown release): /x"),
    ],
)
def test_nodes_of_the_side_are_listed_with_their_release(group: dict[str, Any], result: Result, words: str) -> None:
    finding = only(releases.check_releases(around(hub=hub(side(group)))))
    assert finding.result is result
    assert words in finding.seen
    assert bool(finding.cure) is (result is Result.WARN)


def test_two_versions_of_fast_dds_without_common_shared_memory_are_a_warning() -> None:
    findings = every(releases.check_releases(around(hub=hub(side(JAZZY, KILTED)))))
    assert [finding.result for finding in findings] == [Result.OK, Result.OK, Result.WARN]
    assert "Fast DDS 2 and Fast DDS 3.2.2 on one network do not share memory with each other" in findings[2].seen


def test_native_nodes_of_the_hub_are_listed_with_their_release() -> None:
    ends = [
        native("humble", NO_HASH, hashless=True),
        native("lyrical", buffers=True),
        native("other"),
        native("ours", own=True),
        native("bridged", origin=Origin("ros2", "", "robot1")),
    ]
    findings = every(releases.check_releases(around(hub=hub(side(), endpoints=ends))))
    assert [(finding.result, finding.seen.partition(";")[0]) for finding in findings] == [
        (Result.WARN, "on the hub: rmw_zenoh (Humble): /humble"),
        (Result.OK, "on the hub: rmw_zenoh (Jazzy or later): /other"),
        (Result.OK, "on the hub: rmw_zenoh (Lyrical or later): /lyrical"),
    ]


def test_midspan_itself_is_not_a_node_of_a_release() -> None:
    view = hub({**side(), "zid": "ab"}, endpoints=[native("midspan_console")])
    assert only(releases.check_releases(around(hub=view))).seen == "no ROS 2 node found"


def test_without_a_worker_the_check_is_skipped() -> None:
    assert results(releases.check_releases(around(hub=hub()))) == [Result.SKIP]
    assert "ros2-releases" in [check.id for check in CHECKS]
