"""Topics whose names, types or definitions are not valid in another format."""

from __future__ import annotations

import io
import sqlite3
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import Writer
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2

from bridge.bags.bag import BagError
from bridge.bags.copy import BagSelection, CopyResult, convert
from bridge.bags.definitions import full_definition, full_schema, stored_definition
from bridge.bags.reader import open_bag
from bridge.bags.writers import kind_of
from bridge.messages.definitions.hashes import md5_sum, rihs01
from bridge.messages.definitions.schema import World
from bridge.messages.definitions.text import closure, full_text, parse_full
from bridge.messages.json import from_json
from bridge.messages.registry import Registry
from bridge.routing.rules import NameFilter
from tests.bags.foreign import Recorded, foreign_mcap
from tests.bags.stock import mcap, member, rosbag, rosbags
from tests.bags.written import START

TEXT = b"\x02\0\0\0hi"
LINE = "=" * 80 + "\n"


def ros1_file(path: Path, topics: Sequence[tuple[str, str, str, bytes]]) -> Path:
    """Write a bag with one message on each topic (name, type, definition, data)."""
    with Writer1(path) as writer:
        for number, (topic, type_name, text, data) in enumerate(topics):
            types = parse_full(text, type_name, World.ROS1)
            connection = writer.add_connection(
                topic, type_name.replace("/", "/msg/"), msgdef=text, md5sum=md5_sum(closure(types[type_name], types)),
                callerid=f"/node{number}",
            )  # fmt: skip
            writer.write(connection, START + number, data)
    return path


def ros2_file(path: Path, topics: Sequence[tuple[str, str, str, bytes]], encoding: str = "ros2msg") -> Path:
    """Write an MCAP file with one message on each topic; the channel of a topic without a type has no schema."""
    writer = Writer(stream := io.BytesIO())
    writer.start("ros2", "test")
    for number, (topic, type_name, text, data) in enumerate(topics):
        schema = writer.register_schema(type_name, encoding if text else "", text.encode()) if type_name else 0
        channel = writer.register_channel(topic, "cdr", schema)
        writer.add_message(channel, START + number, b"\0\1\0\0" + data, START + number)
    writer.finish()
    path.write_bytes(stream.getvalue())
    return path


def convert_file(source: Path, target: Path, **more: Any) -> CopyResult:
    with open_bag(source) as bag:
        return convert(bag, target, kind_of(target), Registry(), **more)


def test_names_invalid_in_ros2_become_the_hubs_names(tmp_path: Path) -> None:
    names = {
        "chatter": "/chatter", "/a-b": "/a_b", "/camera/1/image": "/camera/n1/image",
        "/option/Enable Auto Exposure/value": "/option/Enable_Auto_Exposure/value", "/fine": "/fine",
        "/größe": "/gr__e", "/p.q/~r": "/p_q/_r",
    }  # fmt: skip
    source = ros1_file(tmp_path / "a.bag", [(name, "std_msgs/String", "string data\n", TEXT) for name in names])
    changed = {old: new for old, new in names.items() if old != new}
    for target in (tmp_path / "b.mcap", tmp_path / "c.db3", tmp_path / "d"):
        assert convert_file(source, target).renamed == changed
        assert {topic for topic, *_ in rosbags(target)} == set(names.values())
    assert convert_file(source, tmp_path / "e.bag").renamed == {}
    assert {topic for topic, *_ in rosbags(tmp_path / "e.bag")} == set(names)
    wanted = BagSelection(NameFilter(["/camera/1/image"]))
    assert convert_file(source, tmp_path / "f.mcap", choice=wanted).messages == 1


def test_invalid_names_in_a_ros2_bag_are_changed_too(tmp_path: Path) -> None:
    source = ros2_file(
        tmp_path / "a.mcap", [("/camera/1/image", "std_msgs/msg/String", "string data\n", b"\3\0\0\0hi\0")]
    )
    assert convert_file(source, tmp_path / "b.db3").renamed == {"/camera/1/image": "/camera/n1/image"}
    assert [topic for topic, *_ in rosbags(tmp_path / "b.db3")] == ["/camera/n1/image"]


@pytest.mark.parametrize("target", ["b.mcap", "b.db3", "b"])
def test_the_first_of_two_topics_gets_a_common_name(target: str, tmp_path: Path) -> None:
    topics = [(name, "std_msgs/String", "string data\n", TEXT) for name in ("/a b", "/a-b", "/c")]
    source = ros1_file(tmp_path / "a.bag", topics)
    with pytest.raises(BagError, match=r"/a-b would become /a_b, as /a b does; leave .* -x; --skip-unknown"):
        convert_file(source, tmp_path / target)
    done = convert_file(source, tmp_path / target, skip_unknown=True)
    assert (list(done.unknown), done.messages) == (["/a-b"], 2)
    assert [topic for topic, *_ in rosbags(tmp_path / target)] == ["/a_b", "/c"]


A, B = ("my_msgs/V", "int32 a\n", b"\1\0\0\0"), ("my_msgs/V", "int32 a\nint32 b\n", b"\1\0\0\0\2\0\0\0")
NESTING = ("my_msgs/P", f"my_msgs/V[] vs\n{LINE}MSG: my_msgs/V\nint32 b\n", b"\0\0\0\0")
CLASHES = {
    "on a topic": ([("/x", *A), ("/x", *B), ("/y", *B)], ["/x", "/y"], 1),
    "on two topics": ([("/x", *B), ("/y", *A), ("/z", *B)], ["/y"], 2),
    "nested": ([("/x", *A), ("/y", *NESTING), ("/z", *A)], ["/y"], 2),
    "nested first": ([("/y", *NESTING), ("/x", *A)], ["/x"], 1),
}


@pytest.mark.parametrize("target", ["b.mcap", "b.db3", "b"])
@pytest.mark.parametrize("case", CLASHES)
def test_the_first_of_two_definitions_of_a_type_is_kept(case: str, target: str, tmp_path: Path) -> None:
    topics, others, kept = CLASHES[case]
    source = ros1_file(tmp_path / "a.bag", topics)
    with pytest.raises(BagError, match=rf"{others[0]} has another definition of my_msgs/msg/V.*--skip-unknown"):
        convert_file(source, tmp_path / target)
    assert not (tmp_path / target).exists()
    done = convert_file(source, tmp_path / target, skip_unknown=True)
    assert (sorted(done.unknown), done.messages) == (others, kept)
    assert len(rosbags(tmp_path / target)) == kept


def test_a_bag_of_ros_1_keeps_two_definitions_of_a_type(tmp_path: Path) -> None:
    source = ros1_file(tmp_path / "a.bag", CLASHES["on a topic"][0])
    convert_file(source, tmp_path / "b.bag")
    (types,) = rosbag([tmp_path / "b.bag"])
    assert types == [
        ("/x", "my_msgs/V", {"a": 1}), ("/x", "my_msgs/V", {"a": 1, "b": 2}), ("/y", "my_msgs/V", {"a": 1, "b": 2}),
    ]  # fmt: skip


def test_a_bag_of_ros_1_gets_two_definitions_of_a_type_of_ros_2(tmp_path: Path) -> None:
    definitions = [("/x", A), ("/x", B), ("/z", A)]
    topics = [(name, "my_msgs/msg/V", text, data) for name, (_, text, data) in definitions]
    source = ros2_file(tmp_path / "a.mcap", topics)
    for target in (tmp_path / "b.mcap", tmp_path / "b.db3"):
        with pytest.raises(BagError, match=r"/x has another definition of my_msgs/msg/V than /x.*a \.bag has room"):
            convert_file(source, target)
    convert_file(source, tmp_path / "b.bag")
    (types,) = rosbag([tmp_path / "b.bag"])
    assert [message for *_, message in types] == [{"a": 1}, {"a": 1, "b": 2}, {"a": 1}]


def test_two_versions_of_an_installed_type_become_the_installed_one(tmp_path: Path) -> None:
    texts = [("/x", "std_msgs/Int8", "int8 data\n", b"\1"), ("/y", "std_msgs/Int8", "# older\nint8 data\n", b"\2")]
    convert_file(ros1_file(tmp_path / "a.bag", texts), tmp_path / "b.db3")
    assert [message.data for *_, message in rosbags(tmp_path / "b.db3")] == [1, 2]


@pytest.mark.parametrize("target", ["b.mcap", "b.db3", "b", "b.bag"])
@pytest.mark.parametrize(
    ("type_name", "problem"), [("", "has no type: its channel has no schema"), ("a/b/c/d", "is not a type of ROS 2")]
)
def test_a_channel_without_a_type_is_named_or_left_out(
    type_name: str, problem: str, target: str, tmp_path: Path
) -> None:
    text = ("/text", "std_msgs/msg/String", "string data\n", b"\3\0\0\0hi\0")
    source = ros2_file(tmp_path / "a.mcap", [("/raw", type_name, "", b"\1"), text])
    with pytest.raises(BagError, match=f"/raw .*{problem}.*--skip-unknown"):
        convert_file(source, tmp_path / target)
    assert not (tmp_path / target).exists()
    done = convert_file(source, tmp_path / target, skip_unknown=True)
    assert (list(done.unknown), done.messages) == (["/raw"], 1)
    assert [(topic, message.data) for topic, _, message in rosbags(tmp_path / target)] == [("/text", "hi")]


def test_a_two_part_type_name_becomes_a_ros2_type(tmp_path: Path) -> None:
    source = ros2_file(tmp_path / "a.mcap", [("/text", "std_msgs/String", "string data\n", b"\3\0\0\0hi\0")])
    for target in (tmp_path / "b.db3", tmp_path / "b.bag"):
        convert_file(source, target)
        assert [(type_name, m.data) for _, type_name, m in rosbags(target)] == [("std_msgs/msg/String", "hi")]


UNKNOWN = {
    "nothing": ("", b""), "not a definition": ("?!\n", b""), "nests what is missing": ("gone_msgs/Gone gone\n", b""),
    "wide text": ("wstring text\n", b"\0\0\0\0"),
}  # fmt: skip


@pytest.mark.parametrize("target", ["b.mcap", "b.db3", "b"])
@pytest.mark.parametrize("case", UNKNOWN)
def test_a_definition_that_readers_refuse_does_not_affect_other_topics(case: str, target: str, tmp_path: Path) -> None:
    text, data = UNKNOWN[case]
    topics = [
        ("/odd", "my_msgs/msg/Odd", text, data),
        ("/text", "std_msgs/msg/String", "string data\n", b"\3\0\0\0hi\0"),
    ]
    assert convert_file(ros2_file(tmp_path / "a.mcap", topics), tmp_path / target).messages == 2
    from rosbags.highlevel import AnyReader

    with AnyReader([tmp_path / target]) as bag:
        types = {c.topic: (c.msgtype, c.msgcount) for c in bag.connections}
        reported = [bag.deserialize(raw, c.msgtype) for c, _, raw in bag.messages() if c.topic == "/text"]
    assert types == {"/odd": ("my_msgs/msg/Odd", 1), "/text": ("std_msgs/msg/String", 1)}
    assert [member(message, "data") for message in reported] == ["hi"]


@pytest.mark.parametrize("target", ["b.mcap", "b.db3", "b"])
def test_one_of_several_channels_may_have_the_definition(target: str, tmp_path: Path) -> None:
    topics = [(name, "my_msgs/msg/Own", text, b"\5\0\0\0") for name, text in (("/a", ""), ("/a", OWN))]
    source = ros2_file(tmp_path / "a.mcap", topics)
    assert convert_file(source, tmp_path / target).messages == 2
    assert [message.n for *_, message in rosbags(tmp_path / target)] == [5, 5]


OWN = "int32 n\n"
ASK = "int32 a\nmy_msgs/Part part\n---\nint32 b\n" + LINE + "MSG: my_msgs/Part\nchar n\n"
EMPTY = "---\nbool ok\nstring<=9[<=2] texts\n"
DIG = "float32 depth\n---\nbool done\n---\nmy_msgs/Part part\n" + LINE + "MSG: my_msgs/Part\nfloat32 depth\n"
NEAR = "Part part\n---\nbool done\n---\nPart[2] parts\n" + LINE + "MSG: my_robot/Part\nfloat32 depth\n"
NEAR_GOAL = {"request": [{"goal": {"part": {"depth": 2.5}}}]}
NEAR_PARTS = {"feedback": {"parts": [{"depth": 0.5}, {"depth": 1.5}]}}
FILES = {
    "my_robot/srv/Ask_Event": (ASK, {"request": [{"a": 5, "part": {"n": 3}}]}, "request.0.part.n", 3),
    "my_robot/srv/Empty_Event": (EMPTY, {"response": [{"texts": ["x", "y"]}]}, "response.0.texts.1", "y"),
    "my_robot/action/Dig_FeedbackMessage": (DIG, {"feedback": {"part": {"depth": 1.5}}}, "feedback.part.depth", 1.5),
    "my_robot/action/Dig_SendGoal_Event": (DIG, {"request": [{"goal": {"depth": 2.5}}]}, "request.0.goal.depth", 2.5),
    # a type of the same package, named without the package
    "my_robot/action/Near_FeedbackMessage": (NEAR, NEAR_PARTS, "feedback.parts.1.depth", 1.5),
    "my_robot/action/Near_SendGoal_Event": (NEAR, NEAR_GOAL, "request.0.goal.part.depth", 2.5),
}
"""For each type: the text of its .srv or .action file, which rosbag2 stores; a message's fields; the path of one member
and its value."""


@pytest.mark.parametrize("target", ["b.mcap", "b.db3", "b"])
@pytest.mark.parametrize("type_name", FILES)
def test_the_text_of_a_service_or_action_file_becomes_a_definition(type_name: str, target: str, tmp_path: Path) -> None:
    text, values, path, value = FILES[type_name]
    registry = Registry()
    registry.learn_ros2(type_name, full_definition(type_name, "ros2msg", text))
    data = from_json(registry, type_name, values)
    source = ros2_file(tmp_path / "a.mcap", [("/part", type_name, text, data[4:])])
    convert_file(source, tmp_path / target)
    again = tmp_path / f"again-{target}"
    convert_file(tmp_path / target, again)  # as in another process, which knows only the definition in the new file
    for file in (tmp_path / target, again):
        assert [(kind, member(message, path)) for _, kind, message in rosbags(file)] == [(type_name, value)]


def test_a_definition_that_an_older_midspan_recorded_is_corrected(tmp_path: Path) -> None:
    type_name = "my_robot/action/Dig_FeedbackMessage"
    registry = Registry()
    registry.learn_ros2(type_name, full_definition(type_name, "ros2msg", DIG))
    known = registry.ros2(type_name)
    data = from_json(registry, type_name, {"goal_id": {"uuid": [7] * 16}, "feedback": {"part": {"depth": 1.5}}})
    old = known.definition.replace("my_robot/action/", "my_robot/")
    assert old != known.definition
    with Writer2(tmp_path / "a", version=9) as writer:
        topic = writer.add_connection("/dig/_action/feedback", type_name, msgdef=old, rihs01=known.type_id)
        writer.write(topic, START, data)
    for name in ("b.mcap", "b.db3"):
        convert_file(tmp_path / "a", tmp_path / name)
        assert [member(message, "feedback.part.depth") for *_, message in rosbags(tmp_path / name)] == [1.5]
    convert_file(tmp_path / "a", tmp_path / "b.bag")
    (types,) = rosbag([tmp_path / "b.bag"])
    ((topic_name, kind, message),) = types
    assert (topic_name, kind) == ("/dig/feedback", "my_robot/DigActionFeedback")
    assert member(message, "feedback.part.depth") == 1.5  # type: ignore[arg-type]
    assert member(message, "status.goal_id.id") == "midspan-07070707-0707-0707-0707-070707070707"


@pytest.mark.parametrize("text", ['a # b "q"', "it's # b", '"q"', "both ' and \" # b", "", "\\"])
def test_any_text_of_a_constant_of_ros_1_leaves_the_new_file_readable(text: str, tmp_path: Path) -> None:
    definition = f"string S={text}\nstring EMPTY=\nint32 n\nchar c\n"
    source = ros1_file(tmp_path / "a.bag", [("/own", "my_msgs/Own", definition, b"\5\0\0\0A")])
    for target in (tmp_path / "b.mcap", tmp_path / "b.db3"):
        convert_file(source, target)
        assert [message.n for *_, message in rosbags(target)] == [5]
    assert [message.n for *_, message in mcap(tmp_path / "b.mcap")] == [5]


def test_a_three_part_type_name_becomes_a_ros1_type(tmp_path: Path) -> None:
    topic = Recorded("/text", "std_msgs/msg/String", "string data\n", [TEXT])
    source = foreign_mcap(tmp_path / "a.mcap", topic, encoding="ros1")
    for target in (tmp_path / "b.db3", tmp_path / "b.bag"):
        convert_file(source, target)
        assert [(type_name, m.data) for _, type_name, m in rosbags(target)] == [("std_msgs/msg/String", "hi")]
    (types,) = rosbag([tmp_path / "b.bag"])
    assert types == [("/text", "std_msgs/String", {"data": "hi"})]


IDL = """\
================================================================================
IDL: my_msgs/msg/Shape
#include "my_msgs/msg/Corner.idl"
module my_msgs {
  module msg {
    typedef float float__2[2];
    module Shape_Constants { const int8 ROUND = 3; };
    @verbatim (language="comment", text="A shape.")
    struct Shape {
      float__2 size;
      sequence<my_msgs::msg::Corner, 4> corners;
      string<5> name;
      boolean closed;
    };
  };
};
================================================================================
IDL: my_msgs/msg/Corner
module my_msgs { module msg { struct Corner { uint8 structure_needs_at_least_one_member; }; }; };
"""


def test_a_definition_in_idl_is_read(tmp_path: Path) -> None:
    text = full_definition("my_msgs/msg/Shape", "ros2idl", IDL)
    same = (
        f"int8 ROUND=3\nfloat32[2] size\nCorner[<=4] corners\nstring<=5 name\nbool closed\n{LINE}MSG: my_msgs/Corner\n"
    )
    idl, msg = (full_schema("my_msgs/msg/Shape", name) for name in (text, same))
    assert (rihs01(idl), idl.root.constants) == (rihs01(msg), msg.root.constants)
    registry = Registry()
    registry.learn_ros2("my_msgs/msg/Shape", text)
    data = from_json(registry, "my_msgs/msg/Shape", {"size": [1.0, 2.0], "name": "box"})
    source = ros2_file(tmp_path / "a.mcap", [("/shape", "my_msgs/msg/Shape", IDL, data[4:])], "ros2idl")
    convert_file(source, tmp_path / "b.bag")
    (types,) = rosbag([tmp_path / "b.bag"])
    assert [member(message, "name") for *_, message in types] == ["box"]
    convert_file(source, tmp_path / "b.mcap")
    assert [member(message, "name") for *_, message in mcap(tmp_path / "b.mcap")] == ["box"]


@pytest.mark.parametrize(
    "text", ["", "module", "IDL: x\n", f"{LINE}IDL: a/msg/B\nmodule a {{ module msg {{ struct B {{"]
)
def test_invalid_idl_counts_as_no_definition(text: str) -> None:
    assert full_definition("a/msg/B", "ros2idl", text) == ""
    assert full_definition("a/srv/B_Event", "ros2msg", "int32 a\n---\nint32 b\n---\nint32 c\n") == ""
    assert full_definition("a/msg/B", "proto", "anything") == ""


@pytest.mark.parametrize(
    "type_name", ["std_srvs/srv/SetBool_Event", "rcl_interfaces/srv/SetParameters_Event", "std_srvs/srv/Trigger_Event"]
)
def test_a_stored_definition_is_read_back(type_name: str) -> None:
    known = Registry().ros2(type_name)
    encoding, text = stored_definition(type_name, known.definition)
    assert encoding == "ros2idl"
    assert rihs01(full_schema(type_name, full_definition(type_name, encoding, text))) == known.type_id


def test_a_stored_definition_keeps_its_authors_text(tmp_path: Path) -> None:
    definition = full_text(Registry().schema("sensor_msgs/msg/LaserScan"))
    assert stored_definition("sensor_msgs/msg/LaserScan", definition) == ("ros2msg", definition)
    # the channel has no definition, but the registry has one of the type
    convert_file(ros2_file(tmp_path / "a.mcap", [("/e", "std_msgs/msg/Empty", "", b"\0")]), tmp_path / "b.db3")
    with sqlite3.connect(tmp_path / "b.db3") as file:
        assert file.execute("SELECT topic_type FROM message_definitions").fetchall() == [("std_msgs/msg/Empty",)]
