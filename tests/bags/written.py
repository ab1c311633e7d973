"""Valid bags of all formats for the tests, written by rosbags and by Midspan's MCAP writer."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

from mcap.writer import Writer
from rosbags.interfaces import Qos as BagQos
from rosbags.interfaces import QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from bridge.bags.mcap_writer import ChannelInfo, Compression, McapWriter
from bridge.hub.graph.tokens import Origin
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages.definitions.text import full_text
from bridge.messages.json import from_json
from bridge.messages.registry import Registry

STRING, POSE = "std_msgs/msg/String", "geometry_msgs/msg/PoseStamped"
SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_JAZZY)


def value(store: Any, type_name: str, number: int) -> Any:
    """Return one message of rosbags' own classes."""
    types = store.types
    if type_name == STRING:
        return types[STRING](f"text {number}")
    stamp = types["builtin_interfaces/msg/Time"](number, 5)
    header = types["std_msgs/msg/Header"](**({"seq": 0} if store is ROS1 else {}), stamp=stamp, frame_id="map")
    position = types["geometry_msgs/msg/Point"](float(number), 2.0, 3.0)
    turn = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    return types[POSE](header, types["geometry_msgs/msg/Pose"](position, turn))


TOPICS = {"/map_name": STRING, "/pose": POSE}


def ros1_bag(path: Path, count: int = 20, compression: str = "none") -> Path:
    """Write a ROS 1 bag: a latched text at the start, then poses every 100 ms."""
    writer = Writer1(path)
    writer.chunk_threshold = 1000
    if compression != "none":
        writer.set_compression(Writer1.CompressionFormat[compression.upper()])
    with writer:
        text = writer.add_connection("/map_name", STRING, typestore=ROS1, callerid="/server", latching=1)
        pose = writer.add_connection("/pose", POSE, typestore=ROS1, callerid="/robot", latching=0)
        writer.write(text, START, ROS1.serialize_ros1(value(ROS1, STRING, 0), STRING))
        for number in range(count):
            data = ROS1.serialize_ros1(value(ROS1, POSE, number), POSE)
            writer.write(pose, START + number * SECOND // 10, data)
    return path


def db3_folder(path: Path, count: int = 20) -> Path:
    """Write the same messages as a rosbag2 folder."""
    far = QosTime(9_223_372_036, 854_775_807)
    latched = BagQos(
        QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, far, far,
        QosLiveliness.AUTOMATIC, far, False,
    )  # fmt: skip
    with Writer2(path, version=9) as writer:
        text = writer.add_connection("/map_name", STRING, typestore=ROS2, offered_qos_profiles=[latched])
        pose = writer.add_connection("/pose", POSE, typestore=ROS2)
        writer.write(text, START, bytes(ROS2.serialize_cdr(value(ROS2, STRING, 0), STRING)))
        for number in range(count):
            data = bytes(ROS2.serialize_cdr(value(ROS2, POSE, number), POSE))
            writer.write(pose, START + number * SECOND // 10, data)
    return path


def mcap_bytes(count: int = 20, compression: Compression = "zstd", *, finished: bool = True) -> bytes:
    """Return the same messages as MCAP."""
    registry = Registry()
    stream = io.BytesIO()
    writer = McapWriter(stream, compression, chunk_bytes=1000)
    channels = [
        writer.channel(
            ChannelInfo(
                topic, name, registry.ros2(name).type_id, full_text(registry.schema(name)),
                (LATCHED if name == STRING else Qos(),), "ros2", Origin("run-2", "r", "robot1"),
            )
        )
        for topic, name in TOPICS.items()
    ]  # fmt: skip
    writer.write(channels[0], START, START, from_json(registry, STRING, {"data": "text 0"}))
    for number in range(count):
        header = {"stamp": {"sec": number, "nanosec": 5}, "frame_id": "map"}
        position = {"position": {"x": float(number), "y": 2.0, "z": 3.0}, "orientation": {"w": 1.0}}
        time = START + number * SECOND // 10
        writer.write(channels[1], time, time, from_json(registry, POSE, {"header": header, "pose": position}), number)
    if finished:
        writer.finish()
    else:
        writer.flush()
    return stream.getvalue()


def mcap_file(path: Path, count: int = 20, compression: Compression = "zstd", *, finished: bool = True) -> Path:
    """Write the same messages as an MCAP file."""
    path.write_bytes(mcap_bytes(count, compression, finished=finished))
    return path


def nobody_knows(path: Path) -> Path:
    """Write a file whose one type has no definition anywhere, along with a known type."""
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start("ros2", "test")
    for topic, name in {"/odd": "none_msgs/msg/None", "/known": STRING}.items():
        channel = writer.register_channel(topic, "cdr", writer.register_schema(name, "", b""))
        writer.add_message(channel, START, b"\0\1\0\0\x03\0\0\0hi\0", START)
    writer.finish()
    path.write_bytes(stream.getvalue())
    return path


def long_mcap(path: Path, count: int, size: int) -> Path:
    """Write an uncompressed MCAP file of ``count`` texts of ``size`` bytes; bz2 takes 0.2 s for a megabyte of them."""
    alphabet = bytes(range(ord("a"), ord("z") + 1))
    text = size.to_bytes(4, "little") + (alphabet * (size // 26 + 1))[: size - 1] + b"\0"
    with path.open("wb") as stream:
        writer = McapWriter(stream, "none")
        channel = writer.channel(ChannelInfo("/text", STRING, definition="string data\n"))
        for number in range(count):
            writer.write(channel, START + number, START + number, b"\0\1\0\0" + text)
        writer.finish()
    return path
