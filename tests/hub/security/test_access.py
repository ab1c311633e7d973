"""An untrusted machine may write all keys except those of commands."""

from __future__ import annotations

from typing import Any

import pytest
import zenoh
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.config.rules import ALWAYS, EVERY, commands, untyped
from bridge.config.sections.hub import OpenSection
from bridge.config.sections.routing import RoutingSection
from bridge.hub.security.access import access_control, buffered_keys, harmless_keys, not_beginning
from bridge.hub.wire.buffers import group_key
from bridge.hub.wire.keys import NO_HASH, dds_type_name, topic_key
from bridge.messages.velocities import VELOCITIES

HASH = "RIHS01_" + "5e" * 32
GRIPPER = "control_msgs/msg/GripperCommand"
RULES = RoutingSection.model_validate(
    {
        "rules": [
            {"topic": "/gripper/set", "type": GRIPPER, "priority": "command"},
            {"topic": "/arm_*/move*", "type": "std_msgs/msg/Float64", "priority": "command"},
            {"regex": "/x.*", "type": "std_msgs/msg/Int8", "priority": "command"},
            {"topic": "/a/**", "type": "std_msgs/msg/Int16", "priority": "command", "rename": "/b/**"},
            {"topic": "/old", "type": "std_msgs/msg/Int32", "priority": "command", "rename": "/ns/new"},
            {"topic": "/image", "type": "sensor_msgs/msg/Image", "priority": "stream"},
        ]
    }
)
KEYS = [zenoh.KeyExpr(harmless_key) for harmless_key in harmless_keys(commands(RULES))]


def allowed(topic: str, type_name: str) -> bool:
    """Return whether a guest may publish. Humble's guests, whose keys have no hash, may publish the same topics."""
    keys = (zenoh.KeyExpr(topic_key(0, topic, type_name, type_hash)) for type_hash in (HASH, NO_HASH))
    (may,) = {any(allowed_key.includes(key) for allowed_key in KEYS) for key in keys}
    return may


def test_types_with_commands_are_found_through_the_rules() -> None:
    command_parts = commands(RULES)
    assert set(ALWAYS) >= set(VELOCITIES)
    assert {name: set(parts) for name, parts in command_parts.items() if name not in ALWAYS} == {
        GRIPPER: {"set"},
        "std_msgs/msg/Float64": {"move*"},
        "std_msgs/msg/Int8": {EVERY},
        "std_msgs/msg/Int16": {EVERY},
        "std_msgs/msg/Int32": {"old", "new"},
    }


def test_allowed_keys_never_match_commands() -> None:
    """No key is in both sets, not even a key with wildcards."""
    goals = ["*/**/$*Goal_/*"]
    others = [
        f"*/{'*/**' if part == EVERY else '**/' + part.replace('*', '$*')}/{dds_type_name(name)}/*"
        for name, parts in commands(RULES).items()
        for part in parts
    ]
    for command in map(zenoh.KeyExpr, goals + others):
        assert not [allowed_key for allowed_key in KEYS if allowed_key.intersects(command)], command
    buffered = [zenoh.KeyExpr(key) for key in buffered_keys(map(str, KEYS))]
    for command in map(zenoh.KeyExpr, ["*/**/$*Goal_/RIHS01_$*", *others]):
        assert not [key for key in buffered if key.intersects(command)], command


@pytest.mark.parametrize(
    ("topic", "type_name", "may"),
    [
        ("/cmd_vel", "geometry_msgs/msg/Twist", False),
        ("/speed", "geometry_msgs/msg/TwistWithCovariance", True),
        ("/pose", "geometry_msgs/msg/PoseStamped", True),
        ("/goa", "geometry_msgs/msg/PoseStamped", True),
        ("/goals", "geometry_msgs/msg/PoseStamped", False),
        ("/goal/pose", "geometry_msgs/msg/PoseStamped", True),
        ("/gripper/set", GRIPPER, False),
        ("/gripper/setting", GRIPPER, True),
        ("/gripper/se", GRIPPER, True),
        ("/arm_1/moves", "std_msgs/msg/Float64", False),
        ("/arm_1/mov", "std_msgs/msg/Float64", True),
        ("/deep/in/a/tree/angle", "std_msgs/msg/Float64", True),
        ("/any", "std_msgs/msg/Int8", False),
        ("/any", "std_msgs/msg/UInt8", True),
        ("/image", "sensor_msgs/msg/Image", True),
    ],
)
def test_guests_may_not_publish_commands(topic: str, type_name: str, may: bool) -> None:
    assert allowed(topic, type_name) is may


@pytest.mark.parametrize(
    ("topic", "type_name", "may"),
    [
        ("/camera/image", "sensor_msgs/msg/Image", True),
        ("/cmd_vel", "geometry_msgs/msg/Twist", False),
        ("/arm_1/moves", "std_msgs/msg/Float64", False),
    ],
)
def test_guests_of_lyrical_may_publish_messages_with_buffers(topic: str, type_name: str, may: bool) -> None:
    section = OpenSection.model_validate({"listen": ["tls/0.0.0.0:7448"], "trusted": ["base"]})
    rules = access_control(section, RULES, ["lo"])["rules"]
    (say,) = [rule for rule in rules if rule["id"] == "say"]
    key = topic_key(0, topic, type_name, HASH)
    for buffered in (group_key(key), f"{key}/_buf/{'5e' * 16}"):
        includes = [zenoh.KeyExpr(expression).includes(zenoh.KeyExpr(buffered)) for expression in say["key_exprs"]]
        assert any(includes) is may


WORD = st.from_regex(r"[A-Za-z][A-Za-z0-9_]{0,20}", fullmatch=True)


@settings(max_examples=200)
@given(WORD, WORD, WORD)
def test_every_other_type_is_allowed(topic: str, package: str, name: str) -> None:
    type_name = f"{package}/msg/{name}"
    ends = ("Goal", *(f":{command_type.rpartition('/')[2]}" for command_type in commands(RULES)))
    assert allowed(f"/{topic}", type_name) is not f":{name}".endswith(ends)


@given(
    st.sets(st.sampled_from(["go", "goal", "goa*", "x", "stop", "st*"])),
    st.sampled_from(["g", "go", "goa", "goal", "goals", "x", "xx", "s", "sto", "u"]),
)
def test_not_beginning_matches_all_other_words(words: set[str], word: str) -> None:
    taken = any(word.startswith(pattern[:-1]) if pattern.endswith("*") else word == pattern for pattern in words)
    matching = [pattern for pattern in not_beginning("", words) if zenoh.KeyExpr(pattern).includes(zenoh.KeyExpr(word))]
    assert bool(matching) is not taken


def test_command_rule_requires_a_type() -> None:
    rules: list[dict[str, Any]] = [
        {"topic": "/drive", "priority": "command"},
        {"topic": "/drive", "priority": "command", "type": "geometry_msgs/msg/Twist*"},
        {"topic": "/drive", "priority": "command", "type": "geometry_msgs/msg/Twist"},
        {"topic": "/scan"},
    ]
    assert [rule.index for rule in untyped(RoutingSection.model_validate({"rules": rules}))] == [0, 1]


def test_without_tls_no_machine_is_trusted_by_name() -> None:
    section = OpenSection(listen=("tcp/0.0.0.0:7448",), insecure=True)
    rules = access_control(section, RoutingSection(), ["lo"])
    assert rules["subjects"] == [{"id": "here", "interfaces": ["lo"]}, {"id": "others"}]
    assert [policy["subjects"] for policy in rules["policies"]] == [["here"], ["others"]]
    everybody = access_control(section.model_copy(update={"trusted": ("*",)}), RoutingSection(), ["lo"])
    assert everybody["policies"][0]["subjects"] == ["here", "others"]


@pytest.mark.parametrize(
    ("message", "key", "may"),
    [
        ("query", "midspan/store/0/location/kitchen", True),
        ("query", "midspan/store/**", True),
        ("query", "midspan/store/0/@sync/digest/a1", True),
        ("query", "midspan/store/0/@sync/fetch/a1/**", True),
        ("query", "midspan/store/0/@sync/write/a1", False),
        ("query", "midspan/store/0/@sync/**", False),
        ("put", "midspan/store/0/location/kitchen", False),
        ("put", "midspan/store/0/location/*", False),
        ("put", "midspan/store/**", False),
        ("delete", "midspan/store/0/location/kitchen", False),
        ("reply", "midspan/store/0/location/kitchen", False),
        ("reply", "midspan/store/0/@sync/fetch/a1/location/kitchen", False),
        ("liveliness_token", "midspan/store/0/@sync/alive/a1/robot", True),
    ],
)
def test_untrusted_machine_reads_the_store_but_cannot_change_it(message: str, key: str, may: bool) -> None:
    check_rights(message, key, may)


@pytest.mark.parametrize(
    ("key", "may"),
    [
        ("@ros2_lv/0/a1/0/0/NN/%/%/talker", True),
        *((f"@midspan/0/{kind}/a1/x", True) for kind in ("wire", "member", "near")),
        ("@midspan/0/origin/a1/ros1/x/y", True),
        ("@midspan/0/velocity/a1/%cmd_vel/x", True),
        ("@midspan/0/relay/a1/1/b2", True),
        ("@midspan/external/a1", True),
        ("@midspan/0/driver/a1/%cmd_vel/anna", False),
    ],
)
def test_untrusted_machine_cannot_announce_that_it_drives(key: str, may: bool) -> None:
    """Its velocities are refused, and the announcement would lock out those who may drive."""
    check_rights("liveliness_token", key, may)


def check_rights(message: str, key: str, may: bool) -> None:
    section = OpenSection.model_validate({"listen": ["tls/0.0.0.0:7448"], "trusted": ["base"]})
    rules = access_control(section, RoutingSection(), ["lo"])
    names = {rule["id"]: rule for rule in rules["rules"]}
    for subject, expected in (("others", may), ("trusted", True)):
        mine = [
            names[name] for policy in rules["policies"] if subject in policy["subjects"] for name in policy["rules"]
        ]
        passed = [
            rule["id"]
            for rule in mine
            if "ingress" in rule["flows"]
            and message in rule["messages"]
            and any(zenoh.KeyExpr(expression).includes(zenoh.KeyExpr(key)) for expression in rule["key_exprs"])
        ]
        assert bool(passed) is expected, (subject, passed)
