"""Which endpoints a Midspan created, by GUID prefix and enclave."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import pytest

from bridge.adapters.ros2.graph.marks import ENCLAVE, EnclaveMarks, NodeMarks
from bridge.adapters.ros2.graph.origins import PREFIX_BYTES, new_prefix
from bridge.hub.wire.qos import Durability, Qos
from bridge.routing.edge import Endpoint, Kind, MadeBy
from tests.adapters.ros2.conftest import RunningEdge, string
from tests.peers.ros2.cyclone import CyclonePeer
from tests.support.wait import until

CYCLONE, OTHER_CYCLONE, FAST = (bytes.fromhex(f"{start:0<32}") for start in ("0110aa", "0110bb", "010faa"))
MARKED = new_prefix(b"\x01\x0f\0\0") + b"\0\0\1\3"


def on_fast_dds(**enclaves: str) -> NodeMarks:
    """Return the marks of a worker that sees nodes with these enclaves."""
    return NodeMarks(lambda: {f"/{node}": set(names.split()) for node, names in enclaves.items()})


def test_a_marked_prefix_is_midspans_on_both() -> None:
    for marks in (on_fast_dds(), EnclaveMarks(lambda _prefix: "/")):
        assert marks.made_by(MARKED) is MadeBy.MIDSPAN
        assert marks.of_endpoint(MARKED, "", has_hash=True) is MadeBy.MIDSPAN


def test_on_fast_dds_an_endpoint_on_cyclone_dds_is_pending_until_its_nodes_enclave_is_known() -> None:
    marks = on_fast_dds(midspan=ENCLAVE, camera="/")
    assert marks.made_by(FAST) is MadeBy.NATIVE
    assert marks.of_endpoint(CYCLONE, "", has_hash=True) is MadeBy.UNKNOWN
    assert marks.of_endpoint(CYCLONE, "/unlisted", has_hash=True) is MadeBy.UNKNOWN
    assert marks.made_by(CYCLONE) is MadeBy.UNKNOWN
    assert marks.of_endpoint(CYCLONE, "/midspan", has_hash=True) is MadeBy.MIDSPAN
    assert marks.of_endpoint(OTHER_CYCLONE, "/camera", has_hash=True) is MadeBy.NATIVE
    assert (marks.made_by(CYCLONE), marks.made_by(OTHER_CYCLONE)) == (MadeBy.MIDSPAN, MadeBy.NATIVE)
    assert marks.of_endpoint(CYCLONE, "", has_hash=True) is MadeBy.MIDSPAN  # its other endpoints are known, too


def test_a_node_with_the_name_of_a_midspan_stays_pending() -> None:
    marks = on_fast_dds(midspan=f"{ENCLAVE} /")
    assert marks.of_endpoint(CYCLONE, "/midspan", has_hash=True) is MadeBy.UNKNOWN
    assert on_fast_dds(twin="/ /other").of_endpoint(CYCLONE, "/twin", has_hash=True) is MadeBy.NATIVE


def test_programs_without_type_hashes_are_native() -> None:
    """Plain DDS programs have no nodes, and those of Humble no known ones; Midspan announces a hash for each type."""
    marks = on_fast_dds()
    assert marks.of_endpoint(CYCLONE, "", has_hash=False) is MadeBy.NATIVE
    assert marks.made_by(CYCLONE) is MadeBy.UNKNOWN


def test_on_cyclone_dds_the_participants_enclave_decides() -> None:
    enclaves = {CYCLONE[:PREFIX_BYTES]: ENCLAVE, FAST[:PREFIX_BYTES]: "/"}
    marks = EnclaveMarks(enclaves.get)
    assert marks.made_by(CYCLONE) is MadeBy.MIDSPAN
    assert marks.made_by(FAST) is MadeBy.NATIVE
    assert marks.of_endpoint(OTHER_CYCLONE, "/camera", has_hash=True) is MadeBy.UNKNOWN
    assert marks.made_by(b"") is MadeBy.UNKNOWN


HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


@pytest.fixture
def other_midspan() -> Iterator[CyclonePeer]:
    """A program with the enclave of a Midspan on Cyclone DDS."""
    peer = CyclonePeer(user_data=f"enclave={ENCLAVE};")
    yield peer
    peer.stop()


GRAPH = "ros_discovery_info", "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"


def graph_message(writer: bytes, name: bytes = b"midspan") -> bytes:
    """Return the ``rmw_dds_common/msg/ParticipantEntitiesInfo`` of a node with one writer; ``name`` has 7 letters."""
    node = struct.pack("<II2sxxI8s", 1, 2, b"/", 8, name) + struct.pack("<II", 0, 1)
    return b"\0\1\0\0" + writer[:PREFIX_BYTES] + b"\x00\x00\x01\xc1" + node + writer


def test_a_midspan_on_cyclone_dds_is_never_bridged(edge: RunningEdge, other_midspan: CyclonePeer) -> None:
    """The edge is on Fast DDS; it does not know the publisher's origin before the node's announcement."""
    inbox = edge.subscribe("/guard", "std_msgs/msg/String")
    graph = other_midspan.advertise_raw(*GRAPH, latched=True)
    publisher = other_midspan.ask("advertise", topic="/guard", type="std_msgs/String", type_hash=HASH)["id"]

    def listed() -> list[Endpoint]:
        return [e for e in edge.edge.endpoints() if e.topic == "/guard" and e.kind is Kind.PUBLISHER]

    until(lambda: [end.made_by for end in listed()] == [MadeBy.UNKNOWN], "its publisher is pending")
    gid = bytes.fromhex(other_midspan.ask("gid", id=publisher)["gid"])
    other_midspan.put(graph, graph_message(gid))
    until(lambda: [end.made_by for end in listed()] == [MadeBy.MIDSPAN], "its publisher is Midspan's")
    native = CyclonePeer(user_data="enclave=/;")
    try:
        second = native.advertise("/guard", "std_msgs/String")  # no hash: a plain DDS program

        def arrives() -> bool:
            other_midspan.put(publisher, string("loop"))
            native.put(second, string("native"))
            return "native" in inbox.texts()

        until(arrives, "the message of the native publisher arrives", every=0.1)
    finally:
        native.stop()
    assert "loop" not in inbox.texts()


def test_a_latched_message_of_an_unknown_origin_arrives_once(edge: RunningEdge) -> None:
    """The volatile reader receives it before its origin is known; the latched reader, created then, receives it too."""
    native, other = CyclonePeer(user_data="enclave=/;"), CyclonePeer()
    try:
        other.advertise("/held", "std_msgs/String")  # no hash: known at once, and volatile
        until(lambda: [e for e in edge.edge.endpoints() if e.topic == "/held"], "its publisher is known")
        inbox = edge.subscribe("/held", "std_msgs/msg/String", Qos(durability=Durability.TRANSIENT_LOCAL))
        graph = native.advertise_raw(*GRAPH, latched=True)
        publisher = native.advertise("/held", "std_msgs/String", type_hash=HASH, latched=True)

        def origins() -> list[MadeBy]:
            ends = [e for e in edge.edge.endpoints() if e.topic == "/held" and e.kind is Kind.PUBLISHER]
            return sorted((end.made_by for end in ends), key=lambda made_by: made_by is MadeBy.NATIVE)

        until(lambda: origins() == [MadeBy.UNKNOWN, MadeBy.NATIVE], "its origin is unknown")
        until(lambda: native.ask("matched", id=publisher)["count"], "the volatile reader has matched")
        native.put(publisher, string("first"))
        gid = bytes.fromhex(native.ask("gid", id=publisher)["gid"])
        native.put(graph, graph_message(gid, b"scanner"))
        until(lambda: origins() == [MadeBy.NATIVE] * 2, "its origin is known")
        until(lambda: "first" in inbox.texts(), "the first message arrives")
        native.put(publisher, string("second"))
        until(lambda: "second" in inbox.texts(), "the second message arrives")
    finally:
        native.stop()
        other.stop()
    assert inbox.texts() == ["first", "second"]
