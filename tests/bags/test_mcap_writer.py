"""Independent readers read our MCAP files (types, values, times, QoS), and the remaining messages of truncated ones."""

from __future__ import annotations

import io
import struct
from pathlib import Path
from typing import Any

import pytest
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection, ConnectionExtRosbag2, QosDurability, QosReliability
from rosbags.typesys import Stores, get_typestore

from bridge.bags.mcap_writer import ChannelInfo, Compression, McapWriter
from bridge.hub.graph.tokens import Origin
from bridge.hub.wire.qos import LATCHED, Qos, Reliability
from bridge.messages.definitions.text import full_text
from bridge.messages.json import from_json
from bridge.messages.registry import Registry

POSE = "geometry_msgs/msg/PoseStamped"
FEEDBACK = "nav2_msgs/action/NavigateToPose_FeedbackMessage"
EVENT = "std_srvs/srv/SetBool_Event"
ORIGIN = Origin("ros1", "run-1", "robot1")


@pytest.fixture(scope="module")
def registry() -> Registry:
    return Registry()


def info(registry: Registry, topic: str, type_name: str, *qos: Qos) -> ChannelInfo:
    definition = full_text(registry.schema(type_name))
    return ChannelInfo(topic, type_name, registry.ros2(type_name).type_id, definition, qos, "ros1", ORIGIN)


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_independent_readers_read_the_written_messages(
    registry: Registry, tmp_path: Path, compression: Compression
) -> None:
    file = tmp_path / "one.mcap"
    pose = {"header": {"stamp": {"sec": 5, "nanosec": 6}, "frame_id": "map"}, "pose": {"position": {"x": 1.5}}}
    feedback = {"feedback": {"distance_remaining": 2.5, "number_of_recoveries": 3}}
    with file.open("wb", buffering=0) as stream:
        writer = McapWriter(stream, compression)
        poses = writer.channel(info(registry, "/pose", POSE, LATCHED, Qos(Reliability.BEST_EFFORT, deadline_ns=10**8)))
        feedbacks = writer.channel(info(registry, "/goto/_action/feedback", FEEDBACK))
        events = writer.channel(info(registry, "/lamp/_service_event", EVENT))
        writer.write(events, 4_000, 4_000, from_json(registry, EVENT, {"request": [{"data": True}]}))
        writer.write(poses, 2_000, 1_000, from_json(registry, POSE, pose), 7)
        writer.write(feedbacks, 3_000, 2_500, from_json(registry, FEEDBACK, feedback), 1)
        writer.finish()
    with AnyReader([file]) as bag:
        messages_: dict[str, tuple[Connection, int, Any]] = {
            c.topic: (c, time, bag.deserialize(raw, c.msgtype)) for c, time, raw in bag.messages()
        }
    connection, time, message = messages_["/pose"]
    assert (connection.msgtype, time) == (POSE, 2_000)
    assert (message.header.frame_id, message.pose.position.x) == ("map", 1.5)
    assert messages_["/goto/_action/feedback"][2].feedback.distance_remaining == 2.5
    assert messages_["/lamp/_service_event"][2].request[0].data is True
    assert isinstance(connection.ext, ConnectionExtRosbag2)
    first, second = connection.ext.offered_qos_profiles
    assert (first.durability, first.depth) == (QosDurability.TRANSIENT_LOCAL, 1)
    assert (second.reliability, second.deadline.nsec) == (QosReliability.BEST_EFFORT, 10**8)
    with file.open("rb") as stream:  # mcap's decoder rejects names with "_", which an action's own types have
        decoded = list(make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages(["/pose"]))
    schema, channel, raw, value = decoded[0]
    assert (schema.name, raw.log_time, raw.publish_time, raw.sequence) == (POSE, 2_000, 1_000, 7)
    assert value.pose.position.x == 1.5
    reported = {name: channel.metadata[name] for name in ("side", "origin", "daemon", "topic_type_hash")}
    assert reported == {
        "side": "ros1", "origin": "run-1", "daemon": "robot1", "topic_type_hash": registry.ros2(POSE).type_id,
    }  # fmt: skip


def test_messages_of_an_unknown_type_are_kept_as_bytes(tmp_path: Path) -> None:
    file = tmp_path / "one.mcap"
    with file.open("wb", buffering=0) as stream:
        writer = McapWriter(stream)
        writer.write(writer.channel(ChannelInfo("/odd", "odd_msgs/msg/Odd")), 1, 1, b"\0\1\0\0abcd")
        writer.finish()
    with AnyReader([file], default_typestore=get_typestore(Stores.EMPTY)) as bag:
        assert [(c.msgtype, raw) for c, _, raw in bag.messages()] == [("odd_msgs/msg/Odd", b"\0\1\0\0abcd")]


def test_flushed_messages_are_read_from_an_unfinished_file(registry: Registry) -> None:
    stream = io.BytesIO()
    writer = McapWriter(stream, chunk_bytes=1000)
    channel = writer.channel(info(registry, "/pose", POSE))
    written = 0
    for number in range(1, 101):
        closing = writer.closes(300)
        assert writer.write(channel, number, number, bytes(300), number) == closing
        written = number if closing else written
    assert 90 < written < 100
    whole = stream.getvalue()
    assert read_all(whole) == list(range(1, written + 1))
    less = read_all(whole[:-2000])
    assert less == list(range(1, len(less) + 1))
    assert 0 < len(less) < written


def read_all(data: bytes) -> list[int]:
    """Return the numbers of the messages up to the end of the data."""
    messages_: list[int] = []
    with pytest.raises((EndOfFile, struct.error)):
        messages_.extend(r.sequence for r in StreamReader(io.BytesIO(data)).records if isinstance(r, Message))
    return messages_
