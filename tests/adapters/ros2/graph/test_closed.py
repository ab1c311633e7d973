"""Endpoints on Cyclone DDS that close while their participant stays: Fast DDS keeps listing them."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import pytest

from bridge.adapters.ros2.graph.origins import PREFIX_BYTES
from bridge.adapters.ros2.graph.vendors import ClosedEndpoints
from bridge.routing.edge import Endpoint, Kind
from tests.adapters.ros2.conftest import RunningEdge
from tests.peers.ros2.cyclone import CyclonePeer
from tests.support.wait import until

CYCLONE, FAST = b"\x01\x10" + bytes(14), b"\x01\x0f" + bytes(14)
NODE = "/driver"


def test_an_endpoint_that_has_left_its_node_is_closed() -> None:
    closed = ClosedEndpoints()
    assert not closed.is_closed(CYCLONE, "")  # its node is not known yet
    assert not closed.is_closed(CYCLONE, NODE)
    assert closed.is_closed(CYCLONE, "")
    assert not closed.is_closed(CYCLONE[:-1] + b"\1", "")
    assert not closed.is_closed(CYCLONE, NODE)  # the participant was discovered once more


def test_fast_dds_removes_closed_endpoints_itself() -> None:
    closed = ClosedEndpoints()
    assert not closed.is_closed(FAST, NODE)
    assert not closed.is_closed(FAST, "")


def test_endpoints_of_participants_that_left_are_forgotten() -> None:
    closed = ClosedEndpoints()
    closed.is_closed(CYCLONE, NODE)
    closed.retain({CYCLONE[:PREFIX_BYTES]})
    assert closed.is_closed(CYCLONE, "")
    closed.retain({FAST[:PREFIX_BYTES]})
    assert not closed.is_closed(CYCLONE, "")


@pytest.fixture
def program() -> Iterator[CyclonePeer]:
    peer = CyclonePeer()
    yield peer
    peer.stop()


def graph_message(writers: list[bytes]) -> bytes:
    """Return the ``rmw_dds_common/msg/ParticipantEntitiesInfo`` of a participant with one node and these writers."""
    participant = writers[0][:PREFIX_BYTES] + b"\x00\x00\x01\xc1"
    node = struct.pack("<I2sxxI7sx", 2, b"/", 7, b"driver") + struct.pack("<II", 0, len(writers))
    return b"\0\1\0\0" + participant + struct.pack("<I", 1) + node + b"".join(writers)


def test_a_closed_publisher_of_a_node_on_cyclone_dds_leaves(edge: RunningEdge, program: CyclonePeer) -> None:
    graph = program.advertise_raw(
        "ros_discovery_info", "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_", latched=True
    )
    publishers = [program.advertise(f"/closing/{name}", "std_msgs/String") for name in ("first", "second")]
    first, second = (bytes.fromhex(program.ask("gid", id=part)["gid"]) for part in publishers)

    def listed() -> list[Endpoint]:
        ends = (e for e in edge.edge.endpoints() if e.topic.startswith("/closing/") and e.kind is Kind.PUBLISHER)
        return sorted(ends, key=lambda end: end.topic)

    program.put(graph, graph_message([first, second]))
    until(lambda: [end.node for end in listed()] == [NODE, NODE], "the node has both publishers")
    program.drop(publishers[0])
    program.put(graph, graph_message([second]))
    until(lambda: [end.topic for end in listed()] == ["/closing/second"], "the closed publisher has left")
