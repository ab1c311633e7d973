"""Rules: deny wins, the first match gives the attributes, and both gates apply."""

from __future__ import annotations

import pytest

from bridge.config.rules import MadeRule
from bridge.config.sections.routing import RoutingSection, Rule
from bridge.hub.wire.qos import Durability, Qos, Reliability
from bridge.routing.rules import NameFilter, RuleSet

STRING = "std_msgs/msg/String"


def rules(*entries: dict, **section: object) -> RuleSet:
    return RuleSet(RoutingSection.model_validate({"rules": list(entries), **section}))


@pytest.mark.parametrize(
    ("entries", "section", "side", "topic", "allowed"),
    [
        ([], {}, "ros1", "/scan", True),
        ([], {}, "ros1", "/rosout", False),
        ([], {}, "ros2", "/parameter_events", False),
        ([], {"private": False}, "ros1", "/rosout", True),
        ([{"topic": "/rosout"}], {}, "ros1", "/rosout", True),
        ([{"topic": "/scan", "deny": True}], {}, "ros1", "/scan", False),
        ([{"topic": "/scan"}, {"topic": "/s*", "deny": True}], {}, "ros1", "/scan", False),
        ([{"topic": "/scan", "deny": True, "from": "ros2"}], {}, "ros1", "/scan", True),
        ([{"topic": "/scan", "deny": True, "to": "ros2"}], {}, "ros1", "/scan", True),
        ([{"topic": "/scan", "deny": True, "to": "zenoh"}], {}, "ros1", "/scan", False),
        ([{"regex": "/cam[0-9]/.*", "deny": True}], {}, "ros1", "/cam1/image", False),
        ([{"regex": "/cam[0-9]", "deny": True}], {}, "ros1", "/cam1/image", True),
        ([{"type": "sensor_msgs/msg/*", "deny": True}], {}, "ros1", "/scan", True),
        ([{"type": "std_msgs/msg/*", "deny": True}], {}, "ros1", "/scan", False),
        ([], {"default": "deny"}, "ros1", "/scan", False),
        ([{"topic": "/scan"}], {"default": "deny"}, "ros1", "/scan", True),
        ([{"topic": "/scan", "to": "ros2"}], {"default": "deny"}, "ros1", "/scan", True),
        ([{"topic": "/camera/**", "deny": True}], {}, "ros1", "/camera", False),
        ([{"topic": "/camera/**", "deny": True}], {}, "ros1", "/camera/a/b", False),
        ([{"topic": "/camera/*", "deny": True}], {}, "ros1", "/camera/a/b", True),
    ],
)
def test_rules_decide_what_enters_the_hub(
    entries: list[dict], section: dict, side: str, topic: str, allowed: bool
) -> None:
    assert rules(*entries, **section).enter(side, topic, STRING).allowed is allowed


@pytest.mark.parametrize(
    ("entry", "section", "allowed"),
    [
        ({"topic": "/other"}, {}, True),
        ({"topic": "/rosout"}, {"default": "deny"}, True),
        ({"topic": "/other"}, {"default": "deny"}, False),
        ({"topic": "/rosout", "deny": True}, {}, False),
        ({"topic": "/rosout", "deny": True, "from": "zenoh", "to": "zenoh"}, {}, False),
        ({"topic": "/rosout", "deny": True, "to": "ros2"}, {}, True),
        ({"topic": "/rosout", "deny": True, "from": "ros2"}, {}, True),
    ],
)
def test_rules_decide_what_is_relayed_on_the_hub(entry: dict, section: dict, allowed: bool) -> None:
    assert rules(entry, **section).relay("/rosout", STRING).allowed is allowed


def test_a_relayed_topic_keeps_its_name() -> None:
    policy = rules({"topic": "/scan", "rename": "/laser", "rate": 5.0}).relay("/scan", STRING)
    assert (policy.name, policy.rate) == ("/scan", 5.0)


@pytest.mark.parametrize(
    ("entries", "section", "origin", "allowed"),
    [
        ([], {}, "ros1", True),
        ([], {"default": "deny"}, "ros1", True),  # this daemon's own gate admitted it
        ([], {"default": "deny"}, "zenoh", False),
        ([{"topic": "/scan"}], {"default": "deny"}, "zenoh", True),
        ([{"topic": "/scan", "to": "ros2"}], {"default": "deny"}, "ros1", True),
        ([{"topic": "/scan", "to": "yarp"}], {"default": "deny"}, "ros1", False),
        ([{"topic": "/scan", "to": "ros2", "deny": True}], {}, "ros1", False),
        ([{"topic": "/scan", "deny": True}], {}, "zenoh", False),
        ([{"topic": "/scan", "deny": True}, {"topic": "/scan", "to": "ros2"}], {}, "ros1", False),
    ],
)
def test_rules_decide_what_leaves_to_ros2(entries: list[dict], section: dict, origin: str, allowed: bool) -> None:
    assert rules(*entries, **section).leave(origin, "ros2", "/scan", STRING).allowed is allowed


DENY = {"topic": "/scan", "deny": True}


@pytest.mark.parametrize(
    ("entries", "why", "cure"),
    [
        ([DENY], "rule 1 denies it", "remove or narrow rule 1"),
        ([{"topic": "/scan"}, {"type": "std_msgs/**", "deny": True}], "rule 2 denies it", "remove or narrow rule 2"),
        ([DENY, {"topic": "/scan"}, {"regex": "/s.*", "deny": True}], "rule 1 and rule 3 deny it", "remove or narrow"),
    ],
)
def test_the_cure_of_a_denied_topic_names_each_rule_that_denies(entries: list[dict], why: str, cure: str) -> None:
    policy = rules(*entries).enter("ros1", "/scan", STRING)
    assert policy.why == why
    assert policy.cure.startswith(cure)
    assert policy.cure.endswith("; a rule that denies overrides all rules that allow")
    assert (
        not rules({"topic": "/scan"}, *entries, {"topic": "/scan", "to": "zenoh"})
        .enter("ros1", "/scan", STRING)
        .allowed
    )
    kept = [rule for rule in entries if not rule.get("deny")]
    assert rules(*kept).enter("ros1", "/scan", STRING).allowed


def test_the_cure_of_a_generated_rule_names_its_section() -> None:
    rule = MadeRule.model_validate({"of": "navigation (move_base has /move_base there itself)", **DENY})
    section = RoutingSection().model_copy(update={"rules": (rule, Rule.model_validate(DENY))})
    policy = RuleSet(section).enter("ros1", "/scan", STRING)
    assert policy.why == "the section navigation (move_base has /move_base there itself) and rule 1 deny it"
    assert policy.cure.startswith("change navigation, which generates that rule and remove or narrow rule 1")


@pytest.mark.parametrize(
    ("entries", "section", "origin"),
    [
        ([], {"default": "deny"}, "zenoh"),
        ([{"topic": "/scan", "to": "yarp"}], {"default": "deny"}, "ros1"),
        ([], {}, "zenoh"),
        ([{"topic": "/rosout", "to": "yarp"}], {}, "zenoh"),
        ([], {"default": "deny"}, "ros1"),
    ],
)
def test_cure_without_a_denying_rule_is_an_allow_rule(entries: list[dict], section: dict, origin: str) -> None:
    for topic in ("/scan", "/rosout"):
        denied = rules(*entries, **section).leave(origin, "ros2", topic, STRING, elsewhere=True)
        if denied.allowed:
            continue
        assert "a rule that allows it, with 'to: ros2' or without 'to'" in denied.cure
        for rule in ({"topic": topic}, {"topic": topic, "to": "ros2"}):
            assert rules(*entries, rule, **section).leave(origin, "ros2", topic, STRING, elsewhere=True).allowed
        for key, value in (("routing.private: false", {"private": False}), ("default: allow", {"default": "allow"})):
            if key in denied.cure:
                assert (
                    rules(*entries, **{**section, **value}).leave(origin, "ros2", topic, STRING, elsewhere=True).allowed
                )


def test_topics_admitted_by_another_daemon_need_an_allow_rule() -> None:
    def leaves(topic: str, default: str) -> bool:
        compiled = rules({"topic": "/scan"}, default=default)
        return compiled.leave("ros1", "ros2", topic, STRING, elsewhere=True).allowed

    assert leaves("/scan", "deny")
    assert not leaves("/other", "deny")
    assert leaves("/other", "allow")


@pytest.mark.parametrize(
    ("rule", "topic", "name"),
    [
        ({"topic": "/a/*", "rename": "/b/*"}, "/a/x", "/b/x"),
        ({"topic": "/a/**", "rename": "/r1/a/**"}, "/a/x/y", "/r1/a/x/y"),
        ({"topic": "/a/**", "rename": "/r1/**"}, "/a", "/r1"),
        ({"topic": "/*/scan", "rename": "/scan_*"}, "/left/scan", "/scan_left"),
        ({"regex": r"/(\w+)/image", "rename": r"/cameras/\1"}, "/left/image", "/cameras/left"),
        ({"topic": "/a", "rename": "/z"}, "/a", "/z"),
    ],
)
def test_a_rule_renames_a_topic(rule: dict, topic: str, name: str) -> None:
    assert rules(rule).enter("ros1", topic, STRING).name == name


def test_a_rename_at_the_entry_is_not_done_again_at_the_exit() -> None:
    compiled = rules({"topic": "/**", "rename": "/robot/**", "rate": 5, "priority": "state"})
    assert compiled.enter("ros1", "/scan", STRING).name == "/robot/scan"
    leaving = compiled.leave("ros1", "ros2", "/robot/scan", STRING)
    assert (leaving.name, leaving.rate, leaving.priority) == ("/robot/scan", None, "state")
    assert compiled.leave("zenoh", "ros2", "/scan", STRING).name == "/robot/scan"


def test_qos_and_depth_are_overridden() -> None:
    policy = rules({"qos": {"durability": "transient_local", "reliability": "best_effort"}, "depth": 3}).enter(
        "ros1", "/a", STRING
    )
    assert policy.override(Qos()) == Qos(Reliability.BEST_EFFORT, Durability.TRANSIENT_LOCAL, depth=3)


def test_a_name_filter_matches_names_as_rules_do() -> None:
    names = ["/camera", "/camera/a/b", "/scan", "/scan/raw", "tf"]
    for globs, exclude, wanted in (
        (["/**"], [], names),
        (["/camera/**", "tf"], [], ["/camera", "/camera/a/b", "tf"]),
        (["/s*"], [], ["/scan"]),
        (["scan/*", "/t?"], [], ["/scan/raw", "tf"]),
        (["/**"], ["raw$", "^/cam"], ["/scan", "tf"]),
    ):
        assert list(filter(NameFilter(globs, exclude).matches, names)) == wanted, (globs, exclude)
    assert NameFilter(["/scan", "s*", "/gone/**", "/camera"], ["scan"]).idle(names) == ["/gone/**"]
