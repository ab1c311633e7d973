"""Actions: hashes and bytes of their parts, which actions are counterparts, and derived types."""

from __future__ import annotations

import base64
import struct
import sys
from pathlib import Path
from typing import Any

import pytest

from bridge.interfaces import bundled_files, bundled_packages
from bridge.messages.definitions.parts import STATUS_TEXT
from bridge.messages.errors import ConversionError, MessageTypeError
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry
from tests.messages.samples import sample
from tests.peers.codecs import base64_text, genpy, needs_genpy, rclpy

PARTS = ("SendGoal", "GetResult", "FeedbackMessage")
MESSAGES = ("SendGoal_Request", "SendGoal_Response", "GetResult_Request", "GetResult_Response", "FeedbackMessage")
RESULT = "GetResult_Response"
PAIRS = {
    "move_base_msgs/MoveBase": "nav2_msgs/action/NavigateToPose",
    "tf2_msgs/LookupTransform": "tf2_msgs/action/LookupTransform",
    "actionlib/Test": "actionlib/action/Test",
    "actionlib/TestRequest": "actionlib/action/TestRequest",
    "actionlib/TwoInts": "actionlib/action/TwoInts",
}
UUID = bytes(range(1, 17))
GOAL_MD5 = {  # seen on the wire of a running move_base
    "goal": "660d6895a1b9a16dce51fbdd9a64a56b",
    "feedback": "7d1870ff6e0decea702b943b5af0b42e",
    "result": "1eb06eeff08fa7ea874431638cb52332",
}


def ros2_actions() -> list[str]:
    """Return every action for which rclpy has a class."""
    installed = {f"{p.parts[-3]}/action/{p.stem}" for p in (Path(sys.prefix) / "share").glob("*/action/*.action")}
    bundled = {f"{pkg}/{path.removesuffix('.action')}" for pkg in bundled_packages() for path in bundled_files(pkg)}
    return sorted(installed | {name for name in bundled if "/action/" in name})


def converters(registry: Registry, ros2: str) -> dict[str, tuple[Any, Any, str]]:
    """Return the converters to ROS 1 and to the hub and the full ROS 1 definition of each message of an action."""
    conversions: dict[str, tuple[Any, Any, str]] = {}
    for part in ("SendGoal", "GetResult"):
        calls = registry.service_hub_to_ros1(f"{ros2}_{part}")
        request, response = calls.side.definition.split("---\n")
        conversions[f"{part}_Request"] = calls.request_to_side, calls.request_to_hub, request
        conversions[f"{part}_Response"] = calls.response_to_side, calls.response_to_hub, response
    to_ros1 = registry.hub_to_ros1(f"{ros2}_FeedbackMessage")
    to_hub = registry.ros1_to_hub(to_ros1.target.name)
    conversions["FeedbackMessage"] = to_ros1.convert, to_hub.convert, to_ros1.target.definition
    return conversions


def test_hashes_are_those_of_rclpys_type_support(registry: Registry):
    names = [name + part for name in ros2_actions() for part in ("", "_SendGoal", "_GetResult")]
    assert len(names) > 50
    for name, answer in zip(names, rclpy([{"hash": name} for name in names]), strict=True):
        ours = registry.service_ros2(name) if "_SendGoal" in name or "_GetResult" in name else registry.ros2(name)
        assert ours.type_id == answer.get("hash"), (name, answer)


def test_cdr_bytes_are_those_of_rclpy(registry: Registry):
    items = []
    for name in [f"{action}_{part}" for action in ros2_actions() for part in MESSAGES]:
        for length in (0, 2):
            values = sample(registry.schema(name), length)
            items.append({"type": name, "values": values, "cdr": base64_text(from_json(registry, name, values))})
    for item, answer in zip(items, rclpy(items), strict=True):
        name, ours = item["type"], base64.b64decode(item["cdr"])
        assert answer.get("same"), (name, answer)
        theirs = registry.hub_check(name)(base64.b64decode(answer["bytes"]))
        assert len(theirs) == len(ours), name
        assert to_json(registry, name, theirs) == to_json(registry, name, ours), name


@needs_genpy
@pytest.mark.parametrize(("ros1", "ros2"), PAIRS.items())
def test_mapping_a_type_to_the_hub_and_back_gives_the_same_type(ros1: str, ros2: str, registry: Registry):
    assert registry.action_to_ros1(ros2) == ros1
    base = ros1.replace("/", "/action/")
    for part in ("SendGoal", "GetResult"):
        from_ros1 = registry.service_ros1_to_hub(f"{base}_{part}")
        assert (from_ros1.side.name, from_ros1.hub.name) == (f"{base}_{part}", f"{ros2}_{part}")
        from_hub = registry.service_hub_to_ros1(from_ros1.hub.name, from_ros1.hub.type_id)
        assert (from_hub.side, from_hub.hub) == (from_ros1.side, from_ros1.hub)
        assert registry.service_ros2(from_ros1.hub.name, from_ros1.hub.type_id) == from_ros1.hub
    feedback = registry.ros1_to_hub(f"{base}_FeedbackMessage")
    again = registry.hub_to_ros1(f"{ros2}_FeedbackMessage", feedback.target.type_id)
    assert (again.source, again.target) == (feedback.target, feedback.source)


@needs_genpy
def test_ros1_bytes_are_those_of_genpy(registry: Registry):
    """The actions are those with the same fields on both sides, and derived ones; each is converted in both directions.

    Midspan adds the status text to the ROS 1 result (`STATUS_TEXT`). It is empty here, because genpy's results lack it.
    """
    text_field, no_text = f"string {STATUS_TEXT}\n", bytes(4)
    items, cdrs, backs = [], [], []
    for action in [*PAIRS.values(), *ros2_actions()]:
        if action == PAIRS["move_base_msgs/MoveBase"]:
            continue  # the fields have other names, which are tested below
        base = registry.action_to_ros1(action)
        for part, (to_side, to_hub, definition) in converters(registry, action).items():
            for length in (0, 2):
                values = sample(registry.schema(f"{action}_{part}"), length)
                cdrs.append(from_json(registry, f"{action}_{part}", values))
                backs.append(to_hub)
                ros1 = to_side(cdrs[-1])
                if part == RESULT:
                    assert (definition.count(text_field), ros1[1:5]) == (1, no_text)
                    ros1 = ros1[:1] + ros1[5:]
                plain = definition.replace(text_field, "")
                items.append(
                    {"type": f"{base}_{part}", "definition": plain, "values": values, "ros1": base64_text(ros1)}
                )
    assert len(items) > 200
    for item, cdr, to_hub, answer in zip(items, cdrs, backs, genpy(items), strict=True):
        assert answer.get("same"), (item["type"], answer)
        assert answer["bytes"] == item["ros1"], item["type"]
        encoded = base64.b64decode(answer["bytes"])
        padded = encoded[:1] + no_text + encoded[1:] if str(item["type"]).endswith(RESULT) else encoded
        assert to_hub(padded) == cdr, item["type"]


def pose(seed: int) -> dict[str, Any]:
    """Return a pose with a different value in each field."""
    return {
        "header": {"stamp": {"sec": seed, "nanosec": seed + 1}, "frame_id": f"map{seed}"},
        "pose": {
            "position": {"x": seed + 2.5, "y": seed + 3.5, "z": seed + 4.5},
            "orientation": {"x": seed + 5.5, "y": seed + 6.5, "z": seed + 7.5, "w": seed + 8.5},
        },
    }


def wire_pose(seed: int) -> bytes:
    """Return the same pose as ROS 1 writes it."""
    frame = f"map{seed}".encode()
    head = struct.pack("<III", 0, seed, seed + 1) + struct.pack("<I", len(frame)) + frame
    return head + struct.pack("<7d", *(seed + n + 0.5 for n in range(2, 9)))


def test_a_goal_of_move_base_converts_to_navigate_to_pose(registry: Registry):
    conversion = registry.service_ros1_to_hub("move_base_msgs/action/MoveBase_SendGoal")
    name = "nav2_msgs/action/NavigateToPose_SendGoal"
    assert (conversion.hub.name, conversion.left_out) == (name, ())
    assert conversion.request_to_hub is not None
    assert conversion.request_to_side is not None
    cdr = conversion.request_to_hub(UUID + wire_pose(10))
    uuid = {"uuid": base64.b64encode(UUID).decode()}
    assert to_json(registry, f"{name}_Request", cdr) == {
        "goal_id": uuid,
        "goal": {"pose": pose(10), "behavior_tree": ""},
    }
    sent = {"goal_id": uuid, "goal": {"pose": pose(20), "behavior_tree": "other.xml"}}
    assert conversion.request_to_side(from_json(registry, f"{name}_Request", sent)) == UUID + wire_pose(20)
    assert conversion.response_to_side is not None
    accepted = {"accepted": True, "stamp": {"sec": 3, "nanosec": 4}}
    assert conversion.response_to_side(from_json(registry, f"{name}_Response", accepted)) == struct.pack(
        "<?II", 1, 3, 4
    )


def test_feedback_and_result_of_navigate_to_pose_convert_to_move_base(registry: Registry):
    name = "nav2_msgs/action/NavigateToPose"
    feedback = registry.hub_to_ros1(f"{name}_FeedbackMessage")
    assert feedback.target.name == "move_base_msgs/action/MoveBase_FeedbackMessage"
    message = {
        "goal_id": {"uuid": base64.b64encode(UUID).decode()},
        "feedback": {
            "current_pose": pose(30),
            "navigation_time": {"sec": 1, "nanosec": 2},
            "estimated_time_remaining": {"sec": 3, "nanosec": 4},
            "number_of_recoveries": 5,
            "distance_remaining": 6.5,
        },
    }
    assert feedback.convert is not None
    ros1 = feedback.convert(from_json(registry, f"{name}_FeedbackMessage", message))
    assert ros1 == UUID + wire_pose(30)
    back = registry.ros1_to_hub("move_base_msgs/action/MoveBase_FeedbackMessage")
    assert back.convert is not None
    converted = to_json(registry, f"{name}_FeedbackMessage", back.convert(ros1))
    assert converted["feedback"]["current_pose"] == pose(30)
    assert (converted["feedback"]["number_of_recoveries"], converted["feedback"]["distance_remaining"]) == (0, 0.0)
    result = registry.service_hub_to_ros1(f"{name}_GetResult")
    assert result.response_to_hub is not None
    assert result.response_to_side is not None
    ended = {"status": 6, "result": {"error_code": 7, "error_msg": "stuck"}}
    assert result.response_to_side(from_json(registry, f"{name}_GetResult_Response", ended)) == b"\6\5\0\0\0stuck"
    converted = to_json(registry, f"{name}_GetResult_Response", result.response_to_hub(b"\6\6\0\0\0no way"))
    assert converted == {"status": 6, "result": {"error_code": 0, "error_msg": "no way"}}
    assert not result.left_out
    with pytest.raises(ConversionError):
        result.response_to_hub(b"")


@needs_genpy
def test_the_topics_of_an_action_have_actionlibs_types_and_md5_sums(registry: Registry):
    for part, md5 in GOAL_MD5.items():
        topic = getattr(registry.ros1_action("move_base_msgs/MoveBase"), part)
        assert (topic.name, topic.type_id) == (f"move_base_msgs/MoveBaseAction{part.capitalize()}", md5)
    derived = registry.ros1_action("nav2_msgs/Spin")
    assert derived.goal.name == "nav2_msgs/SpinActionGoal"
    header, goal_id = (f"\nMSG: {name}\n" for name in ("std_msgs/Header", "actionlib_msgs/GoalID"))
    assert derived.goal.definition.startswith("Header header\nactionlib_msgs/GoalID goal_id\nnav2_msgs/SpinGoal goal\n")
    assert header in derived.goal.definition
    assert goal_id in derived.goal.definition
    assert "MSG: actionlib_msgs/GoalStatus" in derived.result.definition
    assert "nav2_msgs/SpinFeedback feedback" in derived.feedback.definition
    answer = genpy([
        {
            "type": topic.name,
            "definition": topic.definition,
            "values": {},
            "ros1": base64_text(bytes(200)),
        }
        for topic in (derived.goal, derived.result, derived.feedback)
    ])  # fmt: skip
    assert [topic_type.get("md5") for topic_type in answer] == [
        derived.goal.type_id,
        derived.result.type_id,
        derived.feedback.type_id,
    ]


def test_move_base_is_known_where_ros1_is_not_installed(registry: Registry):
    bare = Registry(ros1_packages=Path("/nonexistent"))
    topics = bare.ros1_action("move_base_msgs/MoveBase")
    assert {part: getattr(topics, part).type_id for part in GOAL_MD5} == GOAL_MD5
    assert bare.action_to_ros1("nav2_msgs/action/NavigateToPose") == "move_base_msgs/MoveBase"
    service = bare.service_hub_to_ros1("nav2_msgs/action/NavigateToPose_SendGoal")
    assert service.hub == registry.service_hub_to_ros1("nav2_msgs/action/NavigateToPose_SendGoal").hub


def test_cancel_and_status_types_are_those_of_action_msgs(registry: Registry):
    cancel = registry.service_hub_to_ros1("action_msgs/srv/CancelGoal")
    assert (cancel.side.name, cancel.hub.name) == ("action_msgs/srv/CancelGoal",) * 2
    assert registry.service_ros1_to_hub("action_msgs/srv/CancelGoal").side == cancel.side
    assert cancel.request_to_side is not None
    assert cancel.response_to_hub is not None
    values = {"goal_info": {"goal_id": {"uuid": list(UUID)}, "stamp": {"sec": 3, "nanosec": 4}}}
    request = cancel.request_to_side(from_json(registry, "action_msgs/srv/CancelGoal_Request", values))
    assert request == UUID + struct.pack("<II", 3, 4)
    response = struct.pack("<bI", 2, 1) + request
    cancel_response = to_json(registry, "action_msgs/srv/CancelGoal_Response", cancel.response_to_hub(response))
    assert (cancel_response["return_code"], len(cancel_response["goals_canceling"])) == (2, 1)
    status = registry.hub_to_ros1("action_msgs/msg/GoalStatusArray")
    assert status.target.name == "action_msgs/GoalStatusArray"
    assert status.convert is not None
    goal_status = {"goal_info": values["goal_info"], "status": 4}
    ros1 = status.convert(from_json(registry, "action_msgs/msg/GoalStatusArray", {"status_list": [goal_status]}))
    assert ros1 == struct.pack("<I", 1) + UUID + struct.pack("<IIb", 3, 4, 4)


ACTION = "int32 Order\ntime until\n---\nbool DONE=1\nint32[] sequence\n---\nstring note\n"


@pytest.fixture
def folders(tmp_path: Path) -> Path:
    """Return a folder with a package's action, as written for ROS 1."""
    folder = tmp_path / "my_acts" / "action"
    folder.mkdir(parents=True)
    (folder / "count_up.action").write_text(ACTION)
    return tmp_path


def test_an_action_that_exists_only_in_ros1_is_derived(folders: Path):
    registry = Registry(folders=[folders])
    assert registry.ros1("my_acts/count_upActionGoal").definition.startswith("Header header\n")
    service = registry.service_ros1_to_hub("my_acts/action/count_up_SendGoal")
    assert service.hub.name == "my_acts/action/CountUp_SendGoal"
    assert registry.service_hub_to_ros1(service.hub.name, service.hub.type_id).side == service.side
    assert list(sample(registry.schema("my_acts/action/CountUp_SendGoal_Request"))["goal"]) == ["order", "until"]
    files = registry.ros2_package_sources("my_acts")
    assert files["action/CountUp.action"].startswith("int32 order\nbuiltin_interfaces/Time until\n---\nbool DONE=1\n")


def test_an_action_known_only_from_connection_headers_is_derived(folders: Path):
    """A connection header contains the type that wraps a goal, with the goal's type nested in it."""
    topics = Registry(folders=[folders]).ros1_action("my_acts/count_up")
    registry = Registry()
    for topic in (topics.goal, topics.result):
        registry.learn_ros1(topic.name, topic.definition, topic.type_id)
    service = registry.service_ros1_to_hub("my_acts/action/count_up_SendGoal")
    assert service.hub.name == "my_acts/action/CountUp_SendGoal"
    registry.service_ros1_to_hub("my_acts/action/count_up_GetResult")
    with pytest.raises(MessageTypeError, match="ROS 1 action my_acts/action/count_up_Feedback") as caught:
        registry.ros1_to_hub("my_acts/action/count_up_FeedbackMessage")
    assert ".action files" in caught.value.cure
    registry.learn_ros1(topics.feedback.name, topics.feedback.definition)
    assert registry.ros1_action("my_acts/count_up") == topics


def test_action_announced_on_the_hub_is_known_by_its_parts(folders: Path):
    remote = Registry(folders=[folders])
    goal, result = (remote.service_ros1_to_hub(f"my_acts/action/count_up_{part}").hub for part in PARTS[:2])
    feedback = remote.ros1_to_hub("my_acts/action/count_up_FeedbackMessage").target
    registry = Registry()
    for announced in (goal, result, feedback):
        registry.learn_ros2(announced.name, announced.definition)
    for announced in (goal, result):
        assert registry.service_ros2(announced.name, announced.type_id).type_id == announced.type_id
        assert registry.service_hub_to_ros1(announced.name, announced.type_id).side.name == announced.name
    assert registry.schema(feedback.name, feedback.type_id).name == feedback.name
    assert registry.hub_to_ros1(feedback.name, feedback.type_id).target.name == feedback.name
    assert registry.action_to_ros1("my_acts/action/CountUp") == "my_acts/CountUp"
    assert registry.ros1_action("my_acts/CountUp").goal.name == "my_acts/CountUpActionGoal"
    assert registry.ros2_package_sources("my_acts")["action/CountUp.action"].count("---\n") == 2


RULES = """
- ros1_package_name: my_acts
  ros1_action_name: count_up
  ros2_package_name: nav2_msgs
  ros2_action_name: Wait
  goal_fields_1_to_2: {until.secs: time.sec}
  result_fields_1_to_2: {}
  feedback_fields_1_to_2: {}
"""


def test_a_mapping_rule_bridges_actions_with_other_names_and_fields(folders: Path, tmp_path: Path):
    rules = tmp_path / "rules.yaml"
    rules.write_text(RULES)
    registry = Registry(folders=[folders], mapping_rules=[rules])
    assert registry.action_to_ros1("nav2_msgs/action/Wait") == "my_acts/count_up"
    goal = registry.service_ros1_to_hub("my_acts/action/count_up_SendGoal")
    assert goal.hub.name == "nav2_msgs/action/Wait_SendGoal"
    assert goal.request_to_hub is not None
    request = to_json(registry, f"{goal.hub.name}_Request", goal.request_to_hub(UUID + struct.pack("<iII", 7, 8, 9)))
    assert request["goal"] == {"time": {"sec": 8, "nanosec": 0}}


@pytest.mark.parametrize(
    ("rule", "reason"),
    [
        ("ros1_action_name: A", "ros1_action_name and ros2_action_name go together"),
        ("goal_fields_1_to_2: {a: b}", "goal_fields_1_to_2 needs ros1_action_name"),
        ("ros1_action_name: A, ros2_action_name: B, request_fields_1_to_2: {}", "request_fields_1_to_2 needs"),
        (
            "ros1_action_name: A, ros2_action_name: B, ros1_service_name: A, ros2_service_name: B",
            "names both services and actions",
        ),
    ],
)
def test_invalid_rule_is_reported(rule: str, reason: str, tmp_path: Path):
    file = tmp_path / "rules.yaml"
    file.write_text(f"- {{ros1_package_name: a, ros2_package_name: b, {rule}}}\n")
    with pytest.raises(MessageTypeError, match=reason):
        Registry(mapping_rules=[file])


def test_unknown_action_is_reported_with_its_cure(registry: Registry):
    for ask in (
        lambda: registry.ros1_action("nobody_acts/Do"),
        lambda: registry.service_ros1_to_hub("nobody_acts/action/Do_SendGoal"),
        lambda: registry.service_hub_to_ros1("nobody_acts/action/Do_SendGoal"),
        lambda: registry.hub_to_ros1("nobody_acts/action/Do_FeedbackMessage"),
    ):
        with pytest.raises(
            MessageTypeError, match=r"no definition of the ROS [12] action nobody_acts/action/Do"
        ) as caught:
            ask()
        assert ".action files" in caught.value.cure
    assert registry.action_to_ros1("nobody_acts/action/Do") == "nobody_acts/Do"
