"""The versions of types in ROS 2 releases, and the conversions between them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from bridge.messages.definitions.versions import RELEASES_FOLDER
from bridge.messages.errors import ConversionError
from bridge.messages.mapping.releases import NO_HASH
from bridge.messages.mapping.version_rules import built_in
from bridge.messages.registry import Registry
from bridge.messages.unchanged import same
from bridge.messages.values import MessageReader, MessageWriter

FEEDBACK = "nav2_msgs/action/NavigateToPose_FeedbackMessage"
THROUGH = "nav2_msgs/action/NavigateThroughPoses_SendGoal"
HASHES = {
    (FEEDBACK, "jazzy"): "RIHS01_9d1f6fa2eb975ce733b419ac2e97b134d8ff92b6478b6559feed9a50bdfd82b3",
    (FEEDBACK, "lyrical"): "RIHS01_2c1b4ec1a0e3a53c9aa326aabe717670eeef0ff3d4c3351ff940613b2011728a",
    (THROUGH, "jazzy"): "RIHS01_5a590fa8e9a32b7b9c838fdf5939a2fb8858d6cfd25bdf2f2e5f0f7bbb25f52b",
    (THROUGH, "kilted"): "RIHS01_0fb14135a40c3900a9a184f95b2ed6966a0ffd298739cc9de7903ebc6dc06a25",
}
"""Hashes that Jazzy's rosidl_generator_type_description computes from the files of the releases."""

TYPES = sorted(f"{p.parts[-3]}/{p.parts[-2]}/{p.stem}" for p in RELEASES_FOLDER.glob("*/*/*/*.*"))


def parts(name: str) -> list[str]:
    """Return the messages and services of a file."""
    kind = name.split("/")[1]
    if kind == "action":
        return [f"{name}_{part}" for part in ("SendGoal", "GetResult", "FeedbackMessage")]
    return [name]


def sections(name: str) -> tuple[str, ...]:
    service = "/srv/" in name or name.endswith(("_SendGoal", "_GetResult"))
    return ("Request", "Response") if service else ("",)


@pytest.mark.parametrize("key", HASHES, ids="-".join)
def test_each_hash_gives_its_release_and_the_hash_of_this_one(registry: Registry, key: tuple[str, str]) -> None:
    type_hash = HASHES[key]
    assert registry.releases.release(key[0], type_hash) == key[1]
    assert registry.releases.here(key[0], type_hash) == HASHES[key[0], "jazzy"]
    assert registry.schema(key[0], type_hash).name == key[0]


def test_a_version_without_a_hash_that_equals_that_of_jazzy_is_converted_to_later_versions(registry: Registry) -> None:
    releases = registry.releases
    jazzy, lyrical = HASHES[FEEDBACK, "jazzy"], HASHES[FEEDBACK, "lyrical"]
    assert releases.converter(FEEDBACK, NO_HASH, jazzy) is same
    cdr = MessageWriter(registry.schema(FEEDBACK, jazzy)).message({"feedback": {"distance_remaining": 2.5}})
    for source, target in ((NO_HASH, lyrical), (lyrical, NO_HASH)):
        convert = releases.converter(FEEDBACK, source, target)
        assert convert is not None
        cdr = convert(cdr)
    message = MessageReader(registry.schema(FEEDBACK, jazzy), cdr).message()
    assert message["feedback"]["distance_remaining"] == 2.5


@pytest.mark.parametrize("name", dict.fromkeys(TYPES))
def test_every_version_of_a_type_converts_to_every_other(registry: Registry, name: str) -> None:
    releases, pairs = registry.releases, 0
    for part in parts(name):
        hashes = [*releases.hashes(part), NO_HASH]
        for source, target in ((a, b) for a in hashes for b in hashes if a != b):
            if NO_HASH in (source, target) and not is_humble(registry, part):
                continue
            for section in sections(part):
                convert = releases.converter(part, source, target, section)
                assert convert is not None, (part, source, target, section)
                one, two = (schema(registry, part, version, section) for version in (source, target))
                message = convert(MessageWriter(one).message({}))
                assert MessageWriter(two).message(MessageReader(two, message).message()) == message
                pairs += 1
    assert pairs or len(registry.releases.hashes(parts(name)[0])) == 1


def is_humble(registry: Registry, name: str) -> bool:
    return registry.releases.here(name, NO_HASH) != NO_HASH


def schema(registry: Registry, name: str, version: str, section: str) -> Any:
    found = registry.releases._schema(name, version)
    assert found is not None
    return found.sub(f"{name}_{section}") if section else found


def converted(registry: Registry, name: str, ends: tuple[str, str], value: dict[str, Any], section: str = "") -> Any:
    convert = registry.releases.converter(name, *ends, section)
    assert convert is not None
    payload = convert(MessageWriter(schema(registry, name, ends[0], section)).message(value))
    return MessageReader(schema(registry, name, ends[1], section), payload).message()


def test_fields_that_a_rule_moves_keep_their_values(registry: Registry) -> None:
    name = "nav2_msgs/action/FollowPath_FeedbackMessage"
    jazzy, lyrical = registry.releases.hashes(name)
    value = {"feedback": {"distance_to_goal": 2.5, "speed": 0.5}}
    newer = converted(registry, name, (jazzy, lyrical), value)["feedback"]["tracking_feedback"]
    assert (newer["distance_to_goal"], newer["speed"]) == (2.5, 0.5)
    value = {"feedback": {"tracking_feedback": {"distance_to_goal": 1.5, "speed": 0.25, "current_path_index": 3}}}
    assert converted(registry, name, (lyrical, jazzy), value)["feedback"] == {"distance_to_goal": 1.5, "speed": 0.25}
    lost, _ = registry.releases.losses(name, lyrical, jazzy)
    assert "nav2_msgs/action/FollowPath_Feedback.tracking_feedback.current_path_index" in lost
    assert not any("speed" in field for field in lost)


def test_messages_that_replace_each_other_are_converted(registry: Registry) -> None:
    name = "nav2_msgs/action/FollowWaypoints_GetResult"
    jazzy, kilted = registry.releases.hashes(name)
    value = {"result": {"missed_waypoints": [{"index": 2, "error_code": 9}, {"index": 4}]}}
    newer = converted(registry, name, (jazzy, kilted), value, "Response")["result"]["missed_waypoints"]
    shown = [(point["waypoint_index"], point["waypoint_status"], point["error_code"]) for point in newer]
    assert shown == [(2, 3, 9), (4, 3, 0)]  # FAILED


def test_added_fields_get_the_defaults_of_their_definition(registry: Registry) -> None:
    name = "nav2_msgs/srv/IsPathValid"
    hashes = list(registry.releases.hashes(name))
    request = converted(registry, name, (hashes[0], hashes[-1]), {}, "Request")
    assert (request["max_cost"], request["stop_at_first_collision"], request["max_lookahead_distance"]) == (
        254,
        True,
        -1.0,
    )


def test_types_that_do_not_differ_are_not_converted(registry: Registry) -> None:
    name = "sensor_msgs/msg/Image"
    (own,) = registry.releases.hashes(name)
    assert registry.releases.converter(name, own, NO_HASH) is same
    assert registry.releases.here(name, NO_HASH) == NO_HASH
    assert registry.releases.converter(name, own, "RIHS01_" + "0" * 64) is None


def test_bad_messages_are_refused(registry: Registry) -> None:
    convert = registry.releases.converter(FEEDBACK, HASHES[FEEDBACK, "lyrical"], HASHES[FEEDBACK, "jazzy"])
    assert convert is not None
    with pytest.raises(ConversionError, match=r"position_tracking_error|ends before"):
        convert(MessageWriter(registry.schema(FEEDBACK)).message({}))


def test_each_folder_may_have_a_version(tmp_path: Path) -> None:
    for number, text in enumerate(("int32 one\nint32 two\n", "int32 two\nstring more\n")):
        (tmp_path / str(number) / "own_msgs" / "msg").mkdir(parents=True)
        (tmp_path / str(number) / "own_msgs" / "msg" / "Own.msg").write_text(text)
    registry, name = Registry(folders=[tmp_path / "0", tmp_path / "1"]), "own_msgs/msg/Own"
    first, second = registry.releases.hashes(name)
    assert registry.ros2(name).type_id == first
    assert registry.releases.here(name, second) == first
    assert converted(registry, name, (first, second), {"one": 1, "two": 2}) == {"two": 2, "more": ""}
    assert converted(registry, name, (second, first), {"two": 2, "more": "x"}) == {"one": 0, "two": 2}
    assert registry.releases.losses(name, second, first) == (("own_msgs/msg/Own.more",), ())
    assert [registry.releases.release(name, version) for version in (first, second)] == [
        str(tmp_path / "0"),
        str(tmp_path / "1"),
    ]


def test_every_rule_applies(registry: Registry) -> None:
    """Each rule names messages and fields that exist in some version."""
    known: dict[str, set[str]] = {}
    for name in TYPES:
        for part in parts(name):
            for version in (*registry.releases.hashes(part), NO_HASH):
                found = registry.releases._schema(part, version)
                for nested in () if found is None else found.types.values():
                    known.setdefault(nested.name, set()).update(field.name for field in nested.fields)
    for rule in built_in():
        assert {path.split(".")[0] for path in rule.fields} <= known[rule.older]
        assert {path.split(".")[0] for path in rule.fields.values()} <= known[rule.newer]
        assert rule.defaults.keys() <= known[rule.newer]
