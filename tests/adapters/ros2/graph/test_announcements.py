"""Announcements of real participants, and messages that are not announcements."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import pytest

from bridge.adapters.ros2.graph import spdp
from bridge.adapters.ros2.graph.announcements import Announcement, Announcements, parse
from tests.adapters.ros2.conftest import RunningEdge
from tests.adapters.ros2.graph.test_interfaces import Calls
from tests.peers.peer import Peer
from tests.peers.ros2.cyclone import CyclonePeer
from tests.peers.ros2.network import new_domain
from tests.support.missing import CYCLONE, ROS2, needs
from tests.support.wait import until

FAST = bytes.fromhex("010f78fd7664c96c00000000")
CONNEXT = bytes.fromhex("0101000000000000000000aa")
READER_AND_WRITER = bytes.fromhex("000100c7 000100c2")
CYCLONES = bytes.fromhex("01108c9dd0cc9ade6b2cf7dd")


def announcement(prefix: bytes, *parameters: tuple[int, bytes], order: str = "<") -> bytes:
    """Return an announcement with these parameters (DDSI-RTPS 2.5, 9.4.5.4, 9.4.2.11)."""
    listed = b"".join(struct.pack(f"{order}HH", number, len(value)) + value for number, value in parameters)
    body = struct.pack(f"{order}HH", 0, 16) + READER_AND_WRITER + struct.pack(f"{order}iI", 0, 1)
    body += (b"\0\3\0\0" if order == "<" else b"\0\2\0\0") + listed + struct.pack(f"{order}HH", 1, 0)
    data = struct.pack(f"{order}BBH", 0x15, 0b0101 if order == "<" else 0b0100, len(body)) + body
    time = struct.pack("<BBH", 0x09, 1, 8) + bytes(8)  # INFO_TS
    return b"RTPS\2\2" + prefix[:2] + prefix + time + data


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(
    ("prefix", "parameters", "version"),
    [
        (FAST, [(0x16, b"\1\x0f\0\0"), (0x8000, b"\3\2\2\0")], "3.2.2"),
        (FAST, [(0x8007, b"\1\0\0\0")], ""),
        (CONNEXT, [(0x8000, b"\7\3\0\1")], "7.3.0"),
        (CYCLONES, [(0x8007, bytes(20) + b"\x16\0\0\0vm/11.0.1/Linux/Linux\0\0\0")], "11.0.1"),
        (CYCLONES, [(0x8007, bytes(20))], ""),
        (CYCLONES, [(0x8000, b"\3\2\2\0")], ""),
        (CYCLONES, [(0x8007, bytes(24) + b"host/" + b"9" * 400 + b"/x\0")], ""),
    ],
)
def test_the_version_of_each_vendor_is_read_from_its_announcement(
    prefix: bytes, parameters: list[tuple[int, bytes]], version: str, order: str
) -> None:
    assert parse(announcement(prefix, *parameters, order=order)) == Announcement(prefix, version)


def test_other_messages_are_not_announcements() -> None:
    whole = announcement(FAST, (0x8000, b"\3\2\2\0"))
    for length in range(len(whole) - 4):
        parse(whole[:length])  # it does not raise
    assert parse(b"") is None
    assert parse(b"x" * 100) is None
    assert parse(whole.replace(bytes.fromhex("000100c2"), bytes.fromhex("000003c2"))) is None, "SEDP"
    assert parse(spdp.disposal(FAST)) is None
    assert parse(spdp.announcement(FAST, 0, 1, 7999)) == Announcement(FAST, "")


def test_a_silent_participant_is_prompted_a_few_times() -> None:
    prompts: list[int] = []
    domain = new_domain()
    listener = Announcements(CONNEXT, domain, lambda: frozenset({FAST}), prompts.append, Calls(), localhost_only=True)
    try:
        for _ in range(5):
            listener._poll()
        assert prompts == [listener.port] * 3
        spdp.send_all([announcement(FAST, (0x8000, b"\3\2\2\0"))], domain, localhost_only=True)
        until(lambda: listener.versions() == {FAST: "3.2.2"}, "the multicast arrives")
    finally:
        listener.close()
    assert listener.versions() == {FAST: "3.2.2"}


def groups(edge: RunningEdge) -> dict[str, dict[str, Any]]:
    return {group["name"]: group for group in edge.edge.details()["middlewares"]}


@needs(ROS2)
def test_a_real_node_on_fast_dds_is_listed_with_its_version_and_release(
    edge: RunningEdge, peer: Callable[..., Peer]
) -> None:
    """The node's discovery range is LOCALHOST, so it does not use multicast."""
    before = peer("before")
    before.advertise("/before", "std_msgs/String")
    until(lambda: groups(edge).get("Fast DDS 2", {}).get("nodes") == ["/before"], "its version is known")
    assert groups(edge)["Fast DDS 2"]["release"] == "Iron or Jazzy"


@needs(CYCLONE)
def test_a_real_program_on_cyclone_dds_is_listed_with_its_version(edge: RunningEdge) -> None:
    program = CyclonePeer()
    try:
        program.advertise("/lamp", "std_msgs/msg/String")
        (group,) = until(lambda: edge.edge.details()["middlewares"], "it is seen")
        until(lambda: [g["name"] for g in edge.edge.details()["middlewares"]] == ["Cyclone DDS 11.0.1"], "it is known")
        assert group["count"] == 1
    finally:
        program.stop()
