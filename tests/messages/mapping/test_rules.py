"""Mapping rules in files in the form of ros1_bridge, and the fields that the rules match."""

from __future__ import annotations

from pathlib import Path

import pytest

from bridge.messages.errors import MessageTypeError
from bridge.messages.json import from_json, to_json
from bridge.messages.mapping.rules import load_rules
from bridge.messages.registry import Registry

SEPARATOR = "=" * 80 + "\n"

FILE = """
-
  ros1_package_name: 'old_msgs'
  ros2_package_name: 'new_msgs'
-
  ros1_package_name: 'old_msgs'
  ros1_message_name: 'Pose'
  ros2_package_name: 'new_msgs'
  ros2_message_name: 'Place'
  enable_foreign_mappings: true
  fields_1_to_2:
    header.stamp: 'when'
    point.x: 'east'
    point.y: 'offset.north'
    name: 'label'
    marks: 'marks'
-
  ros1_package_name: 'old_msgs'
  ros1_service_name: 'Ask'
  ros2_package_name: 'new_msgs'
  ros2_service_name: 'AskAgain'
  request_fields_1_to_2:
    a: 'b'
"""
OLD_POSE = (
    "Header header\nstring name\ngeometry_msgs/Point point\nold_msgs/Mark[] marks\n"
    + SEPARATOR
    + "MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
    + SEPARATOR
    + "MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
    + SEPARATOR
    + "MSG: old_msgs/Mark\nuint8 kind\nstring text\n"
)
NEW_PLACE = "string label\nOffset offset\nMark[] marks\nfloat64 east\nbuiltin_interfaces/Time when\nint32 floor 3\n"


@pytest.fixture
def new_msgs(tmp_path: Path) -> Path:
    folder = tmp_path / "defs" / "new_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Place.msg").write_text(NEW_PLACE)
    (folder / "Offset.msg").write_text("float64 up\nfloat64 north\n")
    (folder / "Mark.msg").write_text("uint8 kind\nstring text\n")
    return tmp_path / "defs"


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "rules.yaml"
    path.write_text(text)
    return path


def test_a_rule_file_of_ros1_bridge_is_read(tmp_path: Path):
    package, message, service = load_rules(write(tmp_path, FILE))
    assert (package.kind, package.fields) == ("", {})
    assert (message.kind, message.ros1, message.ros2) == ("msg", "Pose", "Place")
    assert message.fields[""]["point.y"] == "offset.north"
    assert (service.kind, service.ros1, service.ros2) == ("srv", "Ask", "AskAgain")
    assert service.fields == {"Request": {"a": "b"}}


def test_reordered_and_nested_fields_are_mapped(tmp_path: Path, new_msgs: Path):
    registry = Registry(folders=[new_msgs], mapping_rules=[write(tmp_path, FILE)])
    registry.learn_ros1("old_msgs/Pose", OLD_POSE)
    to_hub, to_ros1 = registry.ros1_to_hub("old_msgs/Pose"), registry.hub_to_ros1("new_msgs/msg/Place")
    assert to_hub.target.name == "new_msgs/msg/Place"
    assert to_ros1.target.name == "old_msgs/Pose"
    assert to_hub.convert is not None
    assert to_ros1.convert is not None
    values = {
        "label": "door",
        "offset": {"up": 7.0, "north": 2.5},
        "marks": [{"kind": 1, "text": "a"}, {"kind": 2, "text": "bcd"}],
        "east": 1.5,
        "when": {"sec": 11, "nanosec": 12},
        "floor": 9,
    }
    ros1 = to_ros1.convert(from_json(registry, "new_msgs/msg/Place", values))
    assert ros1.startswith(b"\0\0\0\0\x0b\0\0\0\x0c\0\0\0")
    again = to_json(registry, "new_msgs/msg/Place", to_hub.convert(ros1))
    # Fields that ROS 1 cannot hold have ROS 2's default values.
    assert again == {**values, "offset": {"up": 0.0, "north": 2.5}, "floor": 3}


def test_reordered_fields_within_sequences_are_mapped(tmp_path: Path):
    folder = tmp_path / "defs" / "b_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Item.msg").write_text("string[] words\nuint8 number\nstring name\n")
    (folder / "List.msg").write_text("Item[] items\nuint16 end\n")
    rules = """
- {ros1_package_name: a_msgs, ros2_package_name: b_msgs}
- ros1_package_name: a_msgs
  ros2_package_name: b_msgs
  ros1_message_name: Item
  ros2_message_name: Item
  fields_1_to_2: {name: name, number: number, words: words}
"""
    registry = Registry(folders=[tmp_path / "defs"], mapping_rules=[write(tmp_path, rules)])
    item = SEPARATOR + "MSG: a_msgs/Item\nstring name\nuint8 number\nstring[] words\n"
    registry.learn_ros1("a_msgs/List", "Item[] items\nuint16 end\n" + item)
    to_hub, to_ros1 = registry.ros1_to_hub("a_msgs/List"), registry.hub_to_ros1("b_msgs/msg/List")
    values = {
        "items": [
            {"words": ["a", "bcde"], "number": 3, "name": "first"},
            {"words": [], "number": 4, "name": ""},
            {"words": ["", "xyz"], "number": 5, "name": "third"},
        ],
        "end": 777,
    }
    assert to_hub.convert is not None
    assert to_ros1.convert is not None
    cdr = from_json(registry, "b_msgs/msg/List", values)
    assert to_hub.convert(to_ros1.convert(cdr)) == cdr
    assert to_json(registry, "b_msgs/msg/List", cdr) == values


BROKEN = [
    ("ros1_package_name: x", "not a list"),
    ("- just text", "entry 1: not a mapping"),
    ("- {ros1_package_name: a}", "entry 1: needs ros1_package_name and ros2_package_name"),
    ("- {ros1_package_name: a, ros2_package_name: b, ros1_mesage_name: C}", "entry 1: unknown key 'ros1_mesage_name'"),
    ("- {ros1_package_name: a, ros2_package_name: b, ros1_message_name: C}", "go together"),
    ("- {ros1_package_name: a, ros2_package_name: b, fields_1_to_2: {a: b}}", "needs ros1_message_name"),
    ("- {ros1_package_name: a, ros2_package_name: [b]}", "is not text"),
    ("- {ros1_package_name: a, ros2_package_name: b}\n- {ros1_package_name: 3, ros2_package_name: b}", "entry 2"),
    ("- [unclosed", "cannot read the mapping rules"),
]


@pytest.mark.parametrize(("text", "reason"), BROKEN)
def test_errors_name_file_and_entry(tmp_path: Path, text: str, reason: str):
    with pytest.raises(MessageTypeError, match=reason) as caught:
        load_rules(write(tmp_path, text))
    assert "rules.yaml" in str(caught.value)


def test_an_empty_file_has_no_rules(tmp_path: Path):
    assert load_rules(write(tmp_path, "")) == []


def test_a_rule_with_an_unknown_field_names_file_and_entry(tmp_path: Path, new_msgs: Path):
    rules = write(tmp_path, FILE.replace("point.x", "point.w"))
    registry = Registry(folders=[new_msgs], mapping_rules=[rules])
    registry.learn_ros1("old_msgs/Pose", OLD_POSE)
    with pytest.raises(MessageTypeError, match=r"rules.yaml, entry 2: old_msgs/Pose has no field point.w"):
        registry.ros1_to_hub("old_msgs/Pose")


def test_a_field_mapped_twice_is_refused(tmp_path: Path, new_msgs: Path):
    rules = write(tmp_path, FILE.replace("'east'", "'label'"))
    registry = Registry(folders=[new_msgs], mapping_rules=[rules])
    registry.learn_ros1("old_msgs/Pose", OLD_POSE)
    with pytest.raises(MessageTypeError, match="label of new_msgs/msg/Place is mapped twice"):
        registry.ros1_to_hub("old_msgs/Pose")
