"""Routing rules derived from the ``navigation`` section."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError
from zenoh import KeyExpr

from bridge.config.model import Config
from bridge.config.rules import commands
from bridge.config.sections.navigation import OURS
from bridge.hub.security.access import QUESTIONS, harmless_keys
from bridge.routing.limits import Priority
from bridge.routing.rules import RoutePolicy, RuleSet
from navigation.map2d_server.section import Map2DServerSection

GOAL, POSE, TWIST = "nav2_msgs/action/NavigateToPose", "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/Twist"
TWIST_STAMPED = "geometry_msgs/msg/TwistStamped"
MOVE = "move_base_msgs/action/MoveBase"


def rules(planner: str = "robot_path_planner", *, default: str = "deny", **more: Any) -> RuleSet:
    sections = {"navigation": {"planner": planner, **more}, "routing": {"default": default}}
    return RuleSet(Config.model_validate(sections).rules)


def entry_policy(rule_set: RuleSet, side: str) -> RoutePolicy:
    return rule_set.leave("zenoh", side, "/navigate_to_pose", GOAL, "action")


def test_without_a_planner_there_are_no_rules() -> None:
    config = Config.model_validate({"routing": {"rules": [{"topic": "/x", "deny": True}]}})
    assert config.rules is config.routing
    assert "gateway" not in config.hosted


def test_a_built_in_planner_has_all_entry_points() -> None:
    rule_set = rules()
    assert (entry_policy(rule_set, "ros1").allowed, entry_policy(rule_set, "ros1").name) == (True, "/move_base")
    assert (entry_policy(rule_set, "ros2").allowed, entry_policy(rule_set, "ros2").name) == (True, "/navigate_to_pose")
    for side, topic in (("ros1", "/move_base_simple/goal"), ("ros2", "/goal_pose")):
        into = rule_set.enter(side, topic, POSE)
        assert (into.allowed, into.name) == (True, "/goal_pose")
    assert rule_set.leave("zenoh", "ros1", "/navigation/status", "midspan_msgs/msg/NavigationStatus").allowed
    assert rule_set.leave("zenoh", "ros2", "/navigation/stop", "std_srvs/srv/Trigger", "service").allowed


@pytest.mark.parametrize(
    ("planner", "side", "other", "action", "goal"),
    [
        ("move_base", "ros1", "ros2", "/move_base", "/move_base_simple/goal"),
        ("nav2", "ros2", "ros1", "/navigate_to_pose", "/goal_pose"),
    ],
)
def test_a_planner_with_the_name_of_an_entry_point_keeps_it(
    planner: str, side: str, other: str, action: str, goal: str
) -> None:
    rule_set = rules(planner)
    into = rule_set.enter(side, action, MOVE if side == "ros1" else GOAL, "action")
    assert (into.allowed, into.name) == (True, f"/planner/{planner}/navigate_to_pose")
    closed = entry_policy(rule_set, side)
    assert not closed.allowed
    assert f"{planner} has {action} there itself" in closed.why
    assert entry_policy(rule_set, other).allowed
    # otherwise the planner, which subscribes to this topic itself, would receive each goal twice
    assert not rule_set.enter(side, goal, POSE).allowed
    assert not rule_set.leave(other, side, goal, POSE).allowed
    open_topic = "/goal_pose" if other == "ros2" else "/move_base_simple/goal"
    assert rule_set.enter(other, open_topic, POSE).name == "/goal_pose"


def test_ros_2_has_the_gateways_action_of_several_poses_beside_its_entry_point() -> None:
    several = "nav2_msgs/action/NavigateThroughPoses"

    def policy(rule_set: RuleSet, side: str) -> RoutePolicy:
        return rule_set.leave("zenoh", side, "/navigation/navigate_through_poses", several, "action")

    assert policy(rules(), "ros2").name == "/navigate_through_poses"
    assert policy(rules(doors={"ros2": "/robot/navigate_to_pose"}), "ros2").name == "/robot/navigate_through_poses"
    assert not policy(rules(), "ros1").allowed
    assert not policy(rules(doors={"ros2": ""}), "ros2").allowed
    closed = policy(rules("nav2"), "ros2")
    assert not closed.allowed
    assert "nav2 has /navigate_through_poses there itself" in closed.why
    assert not policy(rules("nav2_zenoh"), "ros2").allowed
    assert rules("nav2_zenoh").leave("zenoh", "ros2", "/navigate_through_poses", several, "action").allowed


def test_planners_with_an_action_of_several_poses_are_known() -> None:
    mine = {"name": "mine", "side": "ros1", "action": "/mine"}
    section = Config.model_validate({"navigation": {"planner": "nav2", "planners": [mine, {"name": "far"}]}}).navigation
    assert {name: section.through(name) for name in section.choices} == {
        "robot_path_planner": "/planner/robot_path_planner/navigate_through_poses",
        "robot_goto": "",
        "mine": "",
        "far": "/planner/far/navigate_through_poses",
        "nav2": "/navigate_through_poses",
    }


def test_states_of_nav2_and_its_managers_are_bridged_to_the_hub() -> None:
    state, manage = "lifecycle_msgs/srv/GetState", "nav2_msgs/srv/ManageLifecycleNodes"
    for default in ("allow", "deny"):
        rule_set = rules("nav2", default=default)
        for name, type_name, crosses in (
            ("/docking_server/get_state", state, True),
            ("/camera/get_state", state, False),
            ("/docking_server/change_state", "lifecycle_msgs/srv/ChangeState", False),
            ("/lifecycle_manager_navigation/manage_nodes", manage, True),
            ("/lifecycle_manager_navigation/is_active", "std_srvs/srv/Trigger", True),
        ):
            assert rule_set.enter("ros2", name, type_name, "service").allowed is crosses, (default, name)
    assert not rules("move_base").enter("ros2", "/docking_server/get_state", state, "service").allowed


def test_a_planner_in_a_namespace_has_its_managers_there() -> None:
    mine: dict[str, Any] = {"name": "arm", "side": "ros2", "action": "/arm/navigate_to_pose"}
    own = {**mine, "lifecycle_managers": ["/arm/manager"]}
    ours = {"name": "old", "side": "ros1", "action": "/old"}
    default = ("/arm/lifecycle_manager_localization", "/arm/lifecycle_manager_navigation")
    for entry, managers in ((own, ("/arm/manager",)), (ours, ()), (mine, default)):
        (planner,) = Config.model_validate({"navigation": {"planners": [entry]}}).navigation.planners
        assert planner.managers == managers


def test_a_planner_with_another_name_leaves_the_entry_point_open() -> None:
    mine = {"name": "mine", "side": "ros1", "action": "/robot/nav/move_base", "velocity": "/robot/nav/cmd_vel"}
    rule_set = rules("robot_goto", planners=[mine])
    assert rule_set.enter("ros1", "/robot/nav/move_base", MOVE, "action").name == "/planner/mine/navigate_to_pose"
    assert entry_policy(rule_set, "ros1").name == "/move_base"
    for type_name in (TWIST, TWIST_STAMPED):
        velocity = rule_set.enter("ros1", "/robot/nav/cmd_vel", type_name)
        assert (velocity.name, velocity.priority) == ("/cmd_vel", "command"), "a hold blocks it under this name"


def test_the_file_renames_and_closes_entry_points() -> None:
    rule_set = rules(doors={"ros1": "/robot/move_base", "ros2": "", "ros2_goal": ""}, default="allow")
    assert entry_policy(rule_set, "ros1").name == "/robot/move_base"
    assert not entry_policy(rule_set, "ros2").allowed


def test_the_files_rules_limit_a_planners_path_and_costmap() -> None:
    path = ("ros1", "/move_base/NavfnROS/plan", "nav_msgs/msg/Path")
    assert rules("move_base").enter(*path).allowed
    assert not rules("nav2").enter(*path).allowed
    assert rules("nav2").enter("ros2", "/local_costmap/costmap", "nav_msgs/msg/OccupancyGrid").allowed
    slow = {"rules": [{"topic": "/move_base/**", "rate": 1.0}]}
    config = Config.model_validate({"navigation": {"planner": "move_base"}, "routing": slow})
    policy = RuleSet(config.rules).enter(*path)
    assert (policy.why, policy.rate) == ("rule 1 allows it", 1.0)


def test_rules_of_the_file_keep_their_numbers_and_may_deny() -> None:
    routing = {
        "rules": [{"topic": "/else"}, {"kind": "action", "topic": "/navigate_to_pose", "to": "ros1", "deny": True}]
    }
    config = Config.model_validate({"navigation": {"planner": "robot_goto"}, "routing": routing})
    rule_set = RuleSet(config.rules)
    assert entry_policy(rule_set, "ros1").why == "rule 2 denies it"
    assert entry_policy(rule_set, "ros2").why == "the section navigation.doors.ros2 allows it"
    assert [getattr(rule, "of", "file") for rule in config.rules.rules][-2:] == ["file", "file"]


def test_goals_and_velocities_are_commands_under_each_of_their_names() -> None:
    mine = {"name": "mine", "side": "ros1", "action": "/nav", "velocity": "/nav/speed"}
    config = Config.model_validate({"navigation": {"planner": "mine", "planners": [mine], "velocity": "/drive"}})
    harmless = [KeyExpr(text) for text in harmless_keys(commands(config.rules))]

    def is_harmless(topic: str, type_name: str) -> bool:
        key = KeyExpr(f"0/{topic}/{type_name}/RIHS01_x")
        return any(pattern.intersects(key) for pattern in harmless)

    for topic in ("drive", "nav/speed", "cmd_vel"):
        assert not is_harmless(topic, "geometry_msgs::msg::dds_::Twist_")
    for topic in ("goal_pose", "move_base_simple/goal"):
        assert not is_harmless(topic, "geometry_msgs::msg::dds_::PoseStamped_")
    assert is_harmless("initialpose", "geometry_msgs::msg::dds_::PoseWithCovarianceStamped_")
    questions = [KeyExpr(text) for text in QUESTIONS]
    location = KeyExpr("0/navigation/get_location/midspan_msgs::srv::dds_::GetLocation_/RIHS01_x")
    send = KeyExpr(
        "0/planner/nav2/navigate_to_pose/_action/send_goal/nav2_msgs::action::dds_::NavigateToPose_SendGoal_/RIHS01_x"
    )
    stop = KeyExpr("0/navigation/stop/std_srvs::srv::dds_::Trigger_/RIHS01_x")
    assert any(pattern.intersects(location) for pattern in questions)
    assert not any(pattern.intersects(key) for pattern in questions for key in (send, stop))


@pytest.mark.parametrize(
    ("section", "error"),
    [
        ({"planner": "moovebase"}, "no planner is named 'moovebase'"),
        ({"planners": [{"name": "robot_goto", "side": "ros1", "action": "/x"}]}, "is the name of a built-in planner"),
        ({"planners": [{"name": "x", "side": "ros1", "action": "x"}]}, "begin it with a slash"),
        ({"planners": [{"name": "x", "side": "ros1", "action": "/x"}] * 2}, "two planners have the name x"),
        ({"doors": {"yarp": ["navigation"]}}, "is not a name of a YARP port"),
        ({"localizer": "amc"}, "'amc' is not a source of poses: write one of own, amcl"),
        ({"planner": "mine:Mapper2d"}, "two modules have the name mapper2d"),
        ({"planner": "mine:Mine", "planners": [{"name": "mine"}]}, "two planners have the name mine"),
        ({"planners": [{"name": "x", "side": "ros2"}]}, "name the planner's action on ros2"),
        ({"planners": [{"name": "x", "factory": "m:X", "action": "/x"}]}, "remove 'side' and 'action'"),
        ({"planners": [{"name": "x", "factory": "mine"}]}, "does not name a class"),
    ],
)
def test_invalid_sections_are_rejected(section: dict[str, Any], error: str) -> None:
    with pytest.raises(ValidationError, match=error):
        Config.model_validate({"navigation": section})


def test_modules_inherit_the_map_of_the_section() -> None:
    for section, expected in (({}, "/map"), ({"map": "/mine"}, "/mine")):
        modules = {"robot_path_planner": {"enabled": True, **section}}
        config = Config.model_validate({"navigation": {"map": "/map"}, "modules": modules})
        assert config.hosted["robot_path_planner"].model_dump()["map"] == expected


def test_the_choices_are_the_built_in_and_the_configured_planners() -> None:
    section = Config.model_validate({"navigation": {"planner": "move_base"}}).navigation
    assert section.choices == (*OURS, "move_base")
    assert section.at("move_base") == "/planner/move_base/navigate_to_pose"
    native = {"name": "far", "side": "zenoh", "action": "/far/navigate_to_pose"}
    assert Config.model_validate({"navigation": {"planners": [native]}}).navigation.at("far") == "/far/navigate_to_pose"


@pytest.mark.parametrize(
    ("factory", "name"),
    [("hall:Hall", "hall"), ("own.planners:HallPlanner2", "hall_planner2"), ("own:HTTPPlanner", "http_planner")],
)
def test_a_class_as_planner_is_hosted_under_its_name(factory: str, name: str) -> None:
    config = Config.model_validate({"navigation": {"planner": factory}})
    assert (config.navigation.planner, config.navigation.choices) == (name, (*OURS, name))
    assert config.navigation.at(name) == f"/planner/{name}/navigate_to_pose"
    assert config.hosted[name].model_dump() == {"name": name, "factory": factory, "options": {}}
    assert Config.model_validate(config.model_dump(mode="json", by_alias=True)) == config, (
        "a worker receives the same configuration"
    )


def test_a_map_from_a_topic_has_the_name_of_its_copy_in_the_store() -> None:
    """Planner and localizer receive it before the store does, and initial poses refer to the map by this name."""
    section = {"enabled": True, "take": [{"topic": "/other", "name": "other"}, {"topic": "/map", "name": "apartment"}]}
    server = Config.model_validate({"modules": {"map2d_server": section}}).section(Map2DServerSection)
    assert server.taken_as("/map") == "apartment"
    assert server.taken_as("/far") == ""
    assert server.model_copy(update={"enabled": False}).taken_as("/map") == ""


def test_an_empty_velocity_topic_yields_no_rule() -> None:
    tug = {"name": "tug", "side": "ros1", "action": "/tug", "velocity": "/tug/cmd"}
    config = Config.model_validate({"navigation": {"planner": "tug", "planners": [tug], "velocity": ""}})
    topics = [rule.topic for rule in config.rules.rules]
    assert "/tug" in topics
    assert not any("cmd" in str(topic) for topic in topics)


JOINTS, JOY = "sensor_msgs/msg/JointState", "sensor_msgs/msg/Joy"
INPUT = {"name": "stick", "twist": ["/stick/twist"], "joy": ["/pad"]}
ROBOT: dict[str, Any] = {
    "navigation": {
        "velocity": "/base/velocity",
        "planners": [{"name": "mine", "side": "ros1", "action": "/mine", "velocity": "/mine/velocity"}],
    },
    "sim": {"enabled": True, "drive": "wheels"},
    "modules": {
        "base_control": {"enabled": True, "wheel_command": "/wheels", "inputs": [INPUT]},
        "control_boards": {"enabled": True, "boards": [{"remote": "/cer/arm", "command": "/arm/go"}]},
        "robot_goto": {"enabled": True, "cmd_vel": "/goto/twist"},
    },
}
DRIVEN = [
    ("/base/velocity", TWIST), ("/base/velocity", TWIST_STAMPED), ("/mine/velocity", TWIST), ("/wheels", JOINTS),
    ("/wheel_command", JOINTS), ("/stick/twist", TWIST), ("/stick/twist", TWIST_STAMPED), ("/pad", JOY),
    ("/arm/go", JOINTS), ("/goto/twist", TWIST), ("/goto/twist", TWIST_STAMPED),
]  # fmt: skip


def classes(sections: dict[str, Any], topic: str, type_name: str) -> set[Priority]:
    """Return the classes of a topic's messages at all gates, if its publisher is latched."""
    rule_set = RuleSet(Config.model_validate(sections).rules)
    policies = [
        rule_set.enter("ros1", topic, type_name), rule_set.leave("zenoh", "ros2", topic, type_name),
        rule_set.leave("ros1", "ros2", topic, type_name), rule_set.relay(topic, type_name),
    ]  # fmt: skip
    return {policy.class_of((topic, policy.name), type_name, latched=True) for policy in policies if policy.allowed}


@pytest.mark.parametrize(("topic", "type_name"), DRIVEN)
def test_topics_that_move_the_configured_robot_are_commands(topic: str, type_name: str) -> None:
    assert classes(ROBOT, topic, type_name) == {Priority.COMMAND}
    assert classes(ROBOT, topic, "std_msgs/msg/String") == {Priority.STATE}
    assert classes({}, topic, type_name) == {Priority.STATE}
    protected = commands(Config.model_validate(ROBOT).rules)[type_name]
    assert {"*", topic.rpartition("/")[2]} & protected, "machines that are not trusted cannot publish it"


def test_rules_of_the_file_apply_to_topics_that_move_the_robot() -> None:
    renamed = {
        "routing": {"rules": [{"topic": "/wheels", "rate": 5, "from": "ros1"}, {"topic": "/w", "rename": "/wheels"}]}
    }
    rule_set = RuleSet(Config.model_validate(ROBOT | renamed).rules)
    policy = rule_set.enter("ros1", "/wheels", JOINTS)
    assert (policy.rate, policy.priority) == (5.0, "command")
    assert rule_set.enter("ros1", "/w", JOINTS).priority == "command"
    stream = {"routing": {"rules": [{"topic": "/wheels", "priority": "stream"}]}}
    assert classes(ROBOT | stream, "/wheels", JOINTS) == {Priority.STREAM}
    denied = Config.model_validate(ROBOT | {"routing": {"default": "deny"}})
    assert not RuleSet(denied.rules).enter("ros1", "/wheels", JOINTS).allowed
