"""Bags that are converted, cut and repaired, checked with independent readers."""

from __future__ import annotations

import io
import struct
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.interfaces import ConnectionExtRosbag1, ConnectionExtRosbag2, QosDurability
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bridge.bags.bag import BagError, BagMessage, Kind
from bridge.bags.copy import BagSelection, CopyResult, convert, cut
from bridge.bags.reader import open_bag
from bridge.messages.registry import Registry
from bridge.routing.rules import NameFilter
from tests.bags.written import (
    ROS1,
    ROS2,
    SECOND,
    START,
    STRING,
    db3_folder,
    long_mcap,
    mcap_bytes,
    mcap_file,
    nobody_knows,
    ros1_bag,
    value,
)

_KINDS: dict[str, Kind] = {".bag": "bag", ".mcap": "mcap", ".db3": "db3", "": "db3"}


@pytest.fixture(scope="module")
def registry() -> Registry:
    return Registry()


def copy_bag(source: Path, target: Path, registry: Registry, **more: Any) -> CopyResult:
    with open_bag(source) as bag:
        return convert(bag, target, _KINDS[target.suffix], registry, **more)


def messages_of(path: Path) -> list[tuple[str, int, Any]]:
    """Return topic, time and content of each message, read by rosbags."""
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as bag:
        return [(c.topic, time, bag.deserialize(raw, c.msgtype)) for c, time, raw in bag.messages()]


def raw_of(path: Path) -> list[tuple[str, str, int, bytes]]:
    with open_bag(path) as bag:
        return [(m.topic.name, m.topic.type_name, m.time_ns, m.data) for m in bag.messages()]


def test_a_bag_is_unchanged_after_all_formats(registry: Registry, tmp_path: Path) -> None:
    steps = [ros1_bag(tmp_path / "a.bag"), *(tmp_path / name for name in ("b.mcap", "c.db3", "d", "e.bag"))]
    for source, target in pairwise(steps):
        assert copy_bag(source, target, registry).messages == 21
    first, last = messages_of(steps[0]), messages_of(steps[-1])
    assert str(first) == str(last)  # rosbags creates separate classes for each bag
    assert len(first) == 21
    for path in steps[1:4]:
        for (topic, time, message), (topic2, time2, message2) in zip(first, messages_of(path), strict=True):
            assert (topic, time) == (topic2, time2)
            if topic == "/pose":
                assert str(message.pose) == str(message2.pose)
                assert str(message.header.stamp) == str(message2.header.stamp)
    with AnyReader([steps[-1]]) as bag:
        progress = {c.topic: c.ext for c in bag.connections}
    assert progress == {
        "/map_name": ConnectionExtRosbag1("/midspan", 1), "/pose": ConnectionExtRosbag1("/midspan", 0),
    }  # fmt: skip


def test_ros2s_own_decoder_reads_converted_mcap(registry: Registry, tmp_path: Path) -> None:
    copy_bag(ros1_bag(tmp_path / "a.bag"), tmp_path / "b.mcap", registry)
    with (tmp_path / "b.mcap").open("rb") as stream:
        decoded = list(make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages(["/pose"]))
    assert [(d.message.log_time, d.decoded_message.pose.position.x) for d in decoded] == [
        (START + number * SECOND // 10, float(number)) for number in range(20)
    ]
    assert decoded[0].channel.metadata["callerid"] == "/robot"


def test_large_and_nested_messages_are_converted_both_ways(registry: Registry, tmp_path: Path) -> None:
    types = ROS1.types
    header = types["std_msgs/msg/Header"](seq=0, stamp=types["builtin_interfaces/msg/Time"](1, 2), frame_id="cam")
    image = types["sensor_msgs/msg/Image"](header, 480, 640, "rgb8", 0, 1920, np.arange(921600, dtype=np.uint8))
    scan = types["sensor_msgs/msg/LaserScan"](
        header, 0.0, 1.0, 0.1, 0.0, 0.1, 0.2, 9.0, np.arange(700, dtype=np.float32), np.zeros(0, dtype=np.float32)
    )
    with Writer1(tmp_path / "a.bag") as writer:
        for topic, message in {"/image": image, "/scan": scan}.items():
            connection = writer.add_connection(topic, message.__msgtype__, typestore=ROS1)
            writer.write(connection, START, ROS1.serialize_ros1(message, message.__msgtype__))
    copy_bag(tmp_path / "a.bag", tmp_path / "b.mcap", registry)
    copy_bag(tmp_path / "b.mcap", tmp_path / "c.bag", registry, compression="lz4")
    assert raw_of(tmp_path / "a.bag") == raw_of(tmp_path / "c.bag")


def custom_bag(path: Path) -> Path:
    """Write a bag with a message of a type that only the bag defines, and one of an installed type."""
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("int32 number\nstd_msgs/String[] texts\n", "odd_msgs/msg/Odd"))
    odd = store.types["odd_msgs/msg/Odd"](7, [store.types[STRING]("a")])
    with Writer1(path) as writer:
        connection = writer.add_connection("/odd", "odd_msgs/msg/Odd", typestore=store)
        writer.write(connection, START, store.serialize_ros1(odd, "odd_msgs/msg/Odd"))
        known = writer.add_connection("/known", STRING, typestore=store)
        writer.write(known, START + 1, store.serialize_ros1(value(ROS1, STRING, 1), STRING))
    return path


def test_a_type_defined_only_in_the_bag_is_converted_and_back(tmp_path: Path) -> None:
    source = custom_bag(tmp_path / "a.bag")
    copy_bag(source, tmp_path / "b.mcap", Registry())  # as in another process, which has not seen the bag's types
    copy_bag(tmp_path / "b.mcap", tmp_path / "c.db3", Registry())
    copy_bag(tmp_path / "c.db3", tmp_path / "d.bag", Registry())
    assert raw_of(source) == raw_of(tmp_path / "d.bag")


def test_a_type_without_counterpart_is_named_or_left_out(registry: Registry, tmp_path: Path) -> None:
    source = nobody_knows(tmp_path / "a.mcap")
    with pytest.raises(BagError, match=r"/odd has type none_msgs/msg/None.*--skip-unknown"):
        copy_bag(source, tmp_path / "b.bag", registry)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mcap"]
    done = copy_bag(source, tmp_path / "b.bag", registry, skip_unknown=True)
    assert (done.messages, list(done.unknown)) == (1, ["/odd"])
    assert [name for name, *_ in raw_of(tmp_path / "b.bag")] == ["/known"]
    assert copy_bag(source, tmp_path / "c.db3", registry).messages == 2  # CDR can be copied even if the type is unknown


def test_a_message_that_is_not_of_its_type_is_named_or_left_out(registry: Registry, tmp_path: Path) -> None:
    with Writer1(tmp_path / "a.bag") as writer:
        connection = writer.add_connection("/text", STRING, typestore=ROS1)
        writer.write(connection, START, b"\xff\xff\xff\x7fhi")
        writer.write(connection, START + 1, b"\x02\0\0\0hi")
    with pytest.raises(BagError, match=rf"a message of /text at {START} ns is bad.*--skip-bad"):
        copy_bag(tmp_path / "a.bag", tmp_path / "b.mcap", registry)
    done = copy_bag(tmp_path / "a.bag", tmp_path / "b.mcap", registry, skip_bad=True)
    assert (done.messages, done.refused) == (1, {"/text": 1})


def test_a_failed_write_leaves_nothing(registry: Registry, tmp_path: Path) -> None:
    source = mcap_file(tmp_path / "a.mcap")
    (tmp_path / "there.bag").write_text("mine")
    for name, text in {"there.bag": "exists already", "gone/b.bag": "cannot be written"}.items():
        with pytest.raises(BagError, match=text):
            copy_bag(source, tmp_path / name, registry)
    with pytest.raises(BagError, match="bag has none, lz4, bz2"):
        copy_bag(source, tmp_path / "b.bag", registry, compression="zstd")

    def interrupt(_messages: int, _data: int) -> None:
        raise KeyboardInterrupt

    big = long_mcap(tmp_path / "big.mcap", 100, 5000)
    for name in ("b.bag", "b.mcap", "b.db3", "folder"):
        with pytest.raises(KeyboardInterrupt):
            copy_bag(big, tmp_path / name, registry, on_progress=interrupt)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mcap", "big.mcap", "there.bag"]
    assert (tmp_path / "there.bag").read_text() == "mine"


@pytest.mark.parametrize("form", ["bag", "db3", "mcap"])
def test_a_part_is_cut_with_what_was_latched_before(form: str, tmp_path: Path) -> None:
    source, target = {
        "bag": (lambda: ros1_bag(tmp_path / "a.bag"), tmp_path / "b.bag"),
        "db3": (lambda: db3_folder(tmp_path / "a"), tmp_path / "b"),
        "mcap": (lambda: mcap_file(tmp_path / "a.mcap"), tmp_path / "b.mcap"),
    }[form]
    start = START + SECOND
    with open_bag(source()) as bag:
        cut(bag, target, BagSelection(start_ns=start, end_ns=start + SECOND // 2, latched=True))
        topics = {topic.name: (topic.type_name, topic.definition, topic.qos) for topic in bag.topics}
    result = raw_of(target)
    assert [(name, time) for name, _, time, _ in result] == [
        ("/map_name", start), *(("/pose", start + number * SECOND // 10) for number in range(5)),
    ]  # fmt: skip
    with open_bag(target) as bag:
        assert {topic.name: (topic.type_name, topic.definition, topic.qos) for topic in bag.topics} == topics


def test_a_cut_of_mcap_keeps_channels_of_other_encodings(tmp_path: Path) -> None:
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start("ros1", "their library")
    schema = writer.register_schema("std_msgs/String", "ros1msg", b"string data\n")
    channel = writer.register_channel("/a", "ros1", schema, {"md5sum": "992ce8a1687cec8c8bd883ec73ca41d1", "own": "x"})
    for time in range(10):
        writer.add_message(channel, time, b"\0\0\0\0", time + 1)
    writer.add_metadata("theirs", {"robot": "r1"})
    writer.finish()
    (tmp_path / "a.mcap").write_bytes(stream.getvalue())
    with open_bag(tmp_path / "a.mcap") as bag:
        assert bag.about == {"theirs": {"robot": "r1"}}
        assert cut(bag, tmp_path / "b.mcap", BagSelection(start_ns=5)).messages == 5
    with (tmp_path / "b.mcap").open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros1"
        assert [record.metadata for record in reader.iter_metadata()] == [{"robot": "r1"}]
        rows = list(reader.iter_messages())
    assert rows[0][1].metadata["own"] == "x"
    assert [(m.log_time, m.publish_time) for _, _, m in rows] == [(time, time + 1) for time in range(5, 10)]


def test_topics_are_selected_by_name_and_glob(registry: Registry, tmp_path: Path) -> None:
    source = mcap_file(tmp_path / "a.mcap")
    assert copy_bag(source, tmp_path / "b.mcap", registry, choice=BagSelection(NameFilter(["map*"]))).messages == 1
    others = BagSelection(NameFilter(exclude=["^/map"]))
    assert copy_bag(source, tmp_path / "c.mcap", registry, choice=others).messages == 20
    with pytest.raises(BagError, match="has no topic /nowhere"):
        copy_bag(source, tmp_path / "d.mcap", registry, choice=BagSelection(NameFilter(["/pose", "/nowhere"])))


def test_each_publishers_qos_is_kept(registry: Registry, tmp_path: Path) -> None:
    with Writer1(tmp_path / "a.bag") as writer:
        for caller, latching in {"/one": 1, "/two": 0}.items():
            connection = writer.add_connection("/text", STRING, typestore=ROS1, callerid=caller, latching=latching)
            writer.write(connection, START, b"\x02\0\0\0hi")
    copy_bag(tmp_path / "a.bag", tmp_path / "b", registry)
    copy_bag(tmp_path / "b", tmp_path / "c.mcap", registry)
    copy_bag(tmp_path / "c.mcap", tmp_path / "d.db3", registry)
    for name in ("b", "c.mcap", "d.db3"):
        with AnyReader([tmp_path / name]) as bag:
            (connection,) = bag.connections
            assert isinstance(connection.ext, ConnectionExtRosbag2)
            result = [(qos.durability, qos.depth) for qos in connection.ext.offered_qos_profiles]
        assert result == [(QosDurability.TRANSIENT_LOCAL, 1), (QosDurability.VOLATILE, 10)], name
        with open_bag(tmp_path / name) as ours:
            assert (ours.topics[0].qos.latched, ours.topics[0].count) == (True, 2)


def test_the_file_of_a_killed_recorder_is_mended(tmp_path: Path) -> None:
    whole = mcap_bytes(200, finished=False)
    for number, length in enumerate((len(whole), len(whole) - 5, len(whole) // 2)):
        source, target = tmp_path / f"{number}.mcap", tmp_path / f"{number}-whole.mcap"
        source.write_bytes(whole[:length])
        with open_bag(source) as bag:
            assert bag.unfinished
            expected = sum(topic.count for topic in bag.topics)
            done = cut(bag, target, mend=True)
        assert done.messages == expected > 50
        assert [err.offset is not None for err in done.damage] == [True]
        with AnyReader([target]) as other:
            assert sum(1 for _ in other.messages()) == expected


def test_a_bag_of_ros_1_without_its_index_is_mended(tmp_path: Path) -> None:
    path = ros1_bag(tmp_path / "a.bag", 100)
    data = bytearray(path.read_bytes())
    at = data.index(b"index_pos=") + len(b"index_pos=")
    index = struct.unpack_from("<Q", data, at)[0]
    data[at : at + 8] = bytes(8)
    active = tmp_path / "a.bag.active"
    active.write_bytes(data[: index - 10])
    with open_bag(active) as bag:
        assert bag.unfinished
        done = cut(bag, tmp_path / "b.bag", mend=True)
    assert done.messages == 101
    assert str(messages_of(tmp_path / "b.bag")) == str(messages_of(path))


@pytest.mark.parametrize("form", ["bag", "mcap"])
def test_a_modified_chunk_is_reported_and_the_rest_is_saved(form: str, tmp_path: Path) -> None:
    path = ros1_bag(tmp_path / "a.bag", 100, "lz4") if form == "bag" else mcap_file(tmp_path / "a.mcap", 100)
    data = bytearray(path.read_bytes())
    magic = b"\x04\x22\x4d\x18" if form == "bag" else b"\x28\xb5\x2f\xfd"
    places = [at for at in range(len(data) - 4) if data[at : at + 4] == magic]
    data[places[3] + 40] ^= 0xFF
    path.write_bytes(data)
    before: list[BagMessage] = []
    with open_bag(path) as bag:
        with pytest.raises(BagError, match=r", byte \d+: ") as caught:
            before.extend(bag.messages())
        assert caught.value.offset is not None
        assert places[3] - 100 < caught.value.offset <= places[3]
        assert len(before) > 5
        done = cut(bag, tmp_path / f"b.{form}", mend=True)
    assert 80 < done.messages < 101
    assert [err.offset for err in done.damage] == [caught.value.offset]
    assert len(messages_of(tmp_path / f"b.{form}")) == done.messages


def test_a_folder_of_mcap_is_cut_into_one_file_of_mcap(tmp_path: Path) -> None:
    with Writer2(tmp_path / "run", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        text = writer.add_connection("/text", STRING, typestore=ROS2)
        for number in range(10):
            data = bytes(ROS2.serialize_cdr(value(ROS2, STRING, number), STRING))
            writer.write(text, START + number * SECOND, data)
    with open_bag(tmp_path / "run") as bag:
        assert cut(bag, tmp_path / "a.mcap", BagSelection(start_ns=START + 4 * SECOND)).messages == 6
        assert cut(bag, tmp_path / "b.mcap", mend=True).messages == 10
    assert [message.data for _, _, message in messages_of(tmp_path / "a.mcap")] == [f"text {n}" for n in range(4, 10)]
    assert raw_of(tmp_path / "b.mcap") == raw_of(tmp_path / "run")


def test_damage_in_a_file_of_a_folder_loses_only_its_chunk(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    for number in range(2):
        mcap_file(folder / f"run_{number}.mcap", 100, "none")
    whole = raw_of(folder)
    broken = bytearray((folder / "run_0.mcap").read_bytes())
    broken[len(broken) // 2] ^= 0xFF
    (folder / "run_0.mcap").write_bytes(broken)
    with open_bag(folder) as bag:
        done = cut(bag, tmp_path / "a.mcap", mend=True)
    assert [err.path.name for err in done.damage] == ["run_0.mcap"]
    assert done.messages == len(raw_of(tmp_path / "a.mcap"))
    assert 0 < len(whole) - done.messages < 20


@pytest.mark.parametrize("way", ["mend", "latched", "topics"])
def test_messages_of_other_encodings_are_copied_or_named(way: str, tmp_path: Path) -> None:
    source, target = tmp_path / "mixed.mcap", tmp_path / "new.mcap"
    with source.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        known = writer.register_channel("/said", "cdr", writer.register_schema(STRING, "ros2msg", b"string data\n"))
        other = writer.register_channel("/state", "json", writer.register_schema("state", "jsonschema", b"{}"))
        for number in range(3):
            writer.add_message(known, START + number, b"\0\1\0\0\2\0\0\0a\0", START)
            writer.add_message(other, START + number, b"{}", START)
        writer.finish()
    if way == "mend":  # the file of a killed recorder
        source.write_bytes(source.read_bytes()[:-40])
    choice = {
        "mend": BagSelection(),
        "latched": BagSelection(start_ns=START + 1, latched=True),
        "topics": BagSelection(NameFilter(["/said"])),
    }[way]
    with open_bag(source) as bag:
        done = cut(bag, target, choice, mend=way == "mend")
    with target.open("rb") as stream:
        topics = [channel.topic for _, channel, _ in make_reader(stream).iter_messages()]
    assert done.messages == len(topics)
    if way == "topics":
        assert (topics, done.left_out) == (["/said"] * 3, ("/state (json)",))
    else:
        assert (topics, done.left_out) == (["/said", "/state"] * (3 if way == "mend" else 2), ())
