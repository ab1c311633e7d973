"""Bags of other programs: topics, types, QoS, times and bytes are read as by an independent reader."""

from __future__ import annotations

import io
import itertools
import re
import shutil
from pathlib import Path

import pytest
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys.msg import normalize_msgtype

from bridge.bags.conversion import to_hub, to_ros1
from bridge.bags.reader import BagError, BagTopic, open_bag
from bridge.messages.definitions.schema import World
from bridge.messages.registry import Registry
from tests.bags.written import POSE, ROS1, ROS2, SECOND, START, STRING, db3_folder, mcap_file, ros1_bag, value

FORMS = ["none.bag", "bz2.bag", "lz4.bag", "folder", "none.mcap", "zstd.mcap", "lz4.mcap", "unfinished.mcap"]


def write(form: str, folder: Path) -> Path:
    path = folder / form
    how, _, kind = form.partition(".")
    if kind == "bag":
        return ros1_bag(path, compression=how)
    if not kind:
        return db3_folder(path)
    if how == "unfinished":
        return mcap_file(path, finished=False)
    return mcap_file(path, compression="none" if how == "none" else "lz4" if how == "lz4" else "zstd")


@pytest.mark.parametrize("form", FORMS)
def test_a_bag_yields_the_same_messages_as_rosbags(form: str, tmp_path: Path) -> None:
    path = write(form, tmp_path)
    with open_bag(path) as bag:
        messages_ = [(m.topic.name, m.topic.type_name, m.time_ns, m.data) for m in bag.messages()]
        topics = {topic.name: topic for topic in bag.topics}
        assert (bag.start_ns, bag.end_ns, bag.size > 1000) == (START, START + 19 * SECOND // 10, True)
        assert bag.unfinished == ("unfinished" in form)
        if path.is_file():
            expected = form.partition(".")[0]
            assert bag.compression == ("zstd" if expected == "unfinished" else expected)
    assert {name: (topic.count, topic.qos.latched) for name, topic in topics.items()} == {
        "/map_name": (1, True), "/pose": (20, False),
    }  # fmt: skip
    assert "float64 x" in topics["/pose"].definition
    if "unfinished" in form:
        path = mcap_file(tmp_path / "whole.mcap")
    with AnyReader([path]) as other:
        expected_messages = [(c.topic, c.msgtype, time, bytes(data)) for c, time, data in other.messages()]
    assert [(name, normalize_msgtype(kind), time, data) for name, kind, time, data in messages_] == expected_messages


def test_a_message_headers_fields_may_be_in_any_order(tmp_path: Path) -> None:
    path = ros1_bag(tmp_path / "a.bag", 100)
    with open_bag(path) as bag:
        before = [(m.topic.name, m.time_ns, m.data) for m in bag.messages()]
    fields = re.compile(rb"(\x04\0\0\0op=\x02)(\x09\0\0\0conn=.{4})(\x0d\0\0\0time=.{8})", re.DOTALL)
    orders = itertools.cycle([*itertools.permutations((1, 2, 3)), (2, 1, 3), (2, 1, 3)])
    data, count = fields.subn(lambda messages_: b"".join(messages_.group(*next(orders))), path.read_bytes())
    path.write_bytes(data)
    with open_bag(path) as bag:
        assert [(m.topic.name, m.time_ns, m.data) for m in bag.messages()] == before
    assert count == 101


@pytest.mark.parametrize("form", ["none.bag", "folder", "zstd.mcap"])
def test_topics_and_times_are_selected(form: str, tmp_path: Path) -> None:
    with open_bag(write(form, tmp_path)) as bag:
        pose = next(topic for topic in bag.topics if topic.name == "/pose")
        start = START + SECOND // 2
        messages_ = [m.time_ns for m in bag.messages([pose], start, start + SECOND // 2)]
        assert messages_ == [START + number * SECOND // 10 for number in range(5, 10)]
        assert not list(bag.messages([]))


def test_overlapping_pieces_are_read_in_order_of_time(tmp_path: Path) -> None:
    stream = io.BytesIO()
    writer = Writer(stream, chunk_size=200, compression=CompressionType.NONE)
    writer.start("ros2", "test")
    channel = writer.register_channel("/a", "cdr", writer.register_schema("std_msgs/msg/String", "ros2msg", b""))
    times = [5, 1, 9, 30, 2, 7, 40, 3, 8, 4, 50, 6, 41]
    for time in times:
        writer.add_message(channel, time, bytes(60), time)
    writer.finish()
    path = tmp_path / "any.name"
    path.write_bytes(stream.getvalue())
    with open_bag(path) as bag:
        assert [m.time_ns for m in bag.messages()] == sorted(times)


def test_messages_of_ros_1_outside_of_chunks_are_read_and_other_encodings_left_out(tmp_path: Path) -> None:
    stream = io.BytesIO()
    writer = Writer(stream, use_chunking=False)
    writer.start("ros1", "test")
    definition, md5 = ROS1.generate_msgdef(STRING)
    schema = writer.register_schema("std_msgs/String", "ros1msg", definition.encode())
    first = writer.register_channel("/a", "ros1", schema, {"md5sum": md5, "latching": "1", "callerid": "/x"})
    other = writer.register_channel("/json", "json", 0)
    data = bytes(ROS1.serialize_ros1(value(ROS1, STRING, 4), STRING))
    for time in range(3):
        writer.add_message(first, time, data, time)
        writer.add_message(other, time, b"{}", time)
    writer.finish()
    path = tmp_path / "one.mcap"
    path.write_bytes(stream.getvalue())
    with open_bag(path) as bag:
        (topic,) = bag.topics
        assert (topic.world, topic.type_name, topic.type_hash, topic.count) == (World.ROS1, "std_msgs/String", md5, 3)
        assert (topic.qos.latched, topic.metadata["callerid"], bag.left_out) == (True, "/x", ("/json (json)",))
        form = to_hub(Registry(), topic)
        assert form.convert is not None
        assert [form.convert(m.data) for m in bag.messages()] == [
            bytes(ROS2.serialize_cdr(value(ROS2, STRING, 4), STRING))
        ] * 3


def test_a_single_file_of_a_folder_and_a_folder_without_metadata_are_read(tmp_path: Path) -> None:
    folder = db3_folder(tmp_path / "run")
    with open_bag(folder / "run.db3") as bag:
        assert (bag.kind, sum(1 for _ in bag.messages())) == ("db3", 21)
    (folder / "metadata.yaml").unlink()
    with open_bag(folder) as bag:
        assert (bag.unfinished, sum(1 for _ in bag.messages())) == (True, 21)


def test_a_folder_of_several_files_is_one_bag(tmp_path: Path) -> None:
    folder = tmp_path / "split"
    folder.mkdir()
    first = mcap_file(folder / "a_0.mcap", 5)
    shutil.copy(first, folder / "a_1.mcap")
    with open_bag(folder) as bag:
        assert {topic.name: topic.count for topic in bag.topics} == {"/map_name": 2, "/pose": 10}
        assert sum(1 for _ in bag.messages([t for t in bag.topics if t.name == "/pose"])) == 10


def test_an_unknown_type_is_named() -> None:
    topic = BagTopic("/odd", "odd_msgs/Odd", World.ROS1, type_hash="0" * 32)
    with pytest.raises(BagError, match=r"/odd has type odd_msgs/Odd"):
        to_hub(Registry(), topic)
    with pytest.raises(BagError, match="odd_msgs/msg/Odd"):
        to_ros1(Registry(), BagTopic("/odd", "odd_msgs/msg/Odd", World.ROS2))


def test_a_type_defined_only_in_the_bag_is_converted_and_back() -> None:
    registry = Registry()
    topic = BagTopic("/odd", "odd_msgs/Odd", World.ROS1, "int32 number\nstring text\n")
    form = to_hub(registry, topic)
    assert form.type_name == "odd_msgs/msg/Odd"
    assert form.convert is not None
    back = to_ros1(Registry(), BagTopic("/odd", form.type_name, World.ROS2, form.definition, form.type_hash))
    assert back.convert is not None
    data = b"\x07\0\0\0\x02\0\0\0hi"
    assert (back.type_name, back.convert(form.convert(data))) == ("odd_msgs/Odd", data)


@pytest.mark.parametrize("type_name", [STRING, POSE])
def test_both_worlds_have_the_same_message(type_name: str, tmp_path: Path) -> None:
    registry = Registry()
    with (
        open_bag(ros1_bag(tmp_path / "a.bag", 1)) as ros1_message,
        open_bag(db3_folder(tmp_path / "b", 1)) as ros2_message,
    ):
        first = next(m for m in ros1_message.messages() if m.topic.type_name == type_name.replace("/msg/", "/"))
        second = next(m for m in ros2_message.messages() if m.topic.type_name == type_name)
        converted, back = to_hub(registry, first.topic), to_ros1(registry, second.topic)
        assert converted.convert is not None
        assert back.convert is not None
        assert (converted.convert(first.data), back.convert(second.data)) == (second.data, first.data)
        assert to_hub(registry, second.topic).type_hash == converted.type_hash == ROS2.hash_rihs01(type_name)


@pytest.mark.parametrize("mode", ["FILE", "MESSAGE"])
@pytest.mark.parametrize("plugin", ["SQLITE3", "MCAP"])
def test_compressed_folders_are_read(mode: str, plugin: str, tmp_path: Path) -> None:
    writer = Writer2(tmp_path / "a", version=9, storage_plugin=StoragePlugin[plugin])
    writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    data = bytes(ROS2.serialize_cdr(value(ROS2, POSE, 3), POSE))
    with writer:
        connection = writer.add_connection("/pose", POSE, typestore=ROS2)
        for number in range(5):
            writer.write(connection, START + number, data)
    with open_bag(tmp_path / "a") as bag:
        assert [(m.time_ns, m.data) for m in bag.messages()] == [(START + number, data) for number in range(5)]
        assert (bag.compression, bag.unfinished) == ("zstd", False)
