"""``midspan import``: rules from each known key of other bridges, notes on all other keys, and broken files."""

from __future__ import annotations

from pathlib import Path

import pytest

from bridge.cli.main import main
from bridge.config.load import loads
from bridge.config.model import Config

ROS1 = """\
topics:
  -
    topic: /chatter  # Topic name on both ROS 1 and ROS 2
    type: std_msgs/msg/String
    queue_size: 1
  -
    topic: map
    type: nav_msgs/OccupancyGrid
    qos:
      history: keep_all
      durability: transient_local
services_2_to_1:
  -
    service: /add_two_ints
    type: roscpp_tutorials/TwoInts
services_1_to_2:
  - {service: lamp/on, type: std_srvs/srv/SetBool}
  - {service: /add, package: example_interfaces, type: AddTwoInts}
"""

DOMAINS = """\
name: my bridge
from_domain: 2
to_domain: 3
topics:
  clock:
    type: rosgraph_msgs/msg/Clock
  chatter:
    type: example_interfaces/msg/String
    qos: {reliability: best_effort, depth: 5, deadline: -1}
  chatter:
    type: example_interfaces/msg/String
    to_domain: 4
    remap: ~/received
  chatter:
    type: example_interfaces/msg/String
    reversed: True
"""


class Imported:
    """The output of an import."""

    def __init__(self, capsys: pytest.CaptureFixture[str], file: Path, peer: str, *options: str) -> None:
        self.code = main(["import", peer, str(file), *options])
        captured = capsys.readouterr()
        self.out, self.notes = captured.out, captured.err.replace(f"{file}:", "").splitlines()

    def configs(self) -> list[Config]:
        """The configurations that were printed."""
        return [loads(text) for text in self.out.split("---\n")]


def rules(config: Config) -> list[dict[str, object]]:
    """The keys of the rules that do not have their default values."""
    return [r.model_dump(by_alias=True, exclude_defaults=True) for r in config.routing.rules]


def write(folder: Path, text: str) -> Path:
    """Write a file with this text; return its path."""
    file = folder / "peer.yaml"
    file.write_text(text)
    return file


def test_the_file_of_a_parameter_bridge_becomes_rules(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    done = Imported(capsys, write(tmp_path, ROS1), "ros1_bridge")
    (config,) = done.configs()
    assert config.routing.default == "deny"
    grid = {"topic": "/map", "type": "nav_msgs/msg/OccupancyGrid"}
    assert rules(config) == [
        {"topic": "/chatter", "type": "std_msgs/msg/String", "depth": 1},
        grid,
        {**grid, "to": "ros2", "qos": {"durability": "transient_local"}},
        {"kind": "service", "topic": "/lamp/on", "type": "std_srvs/srv/SetBool", "from": "ros2", "to": "ros1"},
        {"kind": "service", "topic": "/add", "type": "example_interfaces/srv/AddTwoInts", "from": "ros2", "to": "ros1"},
        {"kind": "service", "topic": "/add_two_ints", "from": "ros1", "to": "ros2"},
    ]
    assert (done.code, done.notes) == (0, [])
    assert "    # peer.yaml:3\n    - topic: /chatter\n" in done.out
    assert "    # peer.yaml:14, roscpp_tutorials/TwoInts on ROS 1\n    - kind: service\n" in done.out


def test_unsupported_settings_of_ros1_bridge_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = """\
topics:
  - topic: /a
    type: std_msgs/String
    queue_sise: 5
    qos:
      history: keep_last
      depth: 7
      deadline: {secs: 10, nsecs: 2345}
      liveliness: LIVELINESS_AUTOMATIC
      liveliness_lease_duration: {secs: 1, nsecs: 0}
  - {topic: a, type: std_msgs/String}
rate: 5
services_2_to_1:
  - {service: /s, type: MyPkg/do_it, timeout: 5}
  - {service: s, type: std_srvs/Empty}
"""
    done = Imported(capsys, write(tmp_path, text), "ros1_bridge")
    assert rules(done.configs()[0]) == [
        {"topic": "/a", "type": "std_msgs/msg/String", "depth": 7},
        {"kind": "service", "topic": "/s", "from": "ros1", "to": "ros2"},
    ]
    lease = "liveliness_lease_duration"
    known = "topics, services_1_to_2, services_2_to_1"
    assert [note.partition(";")[0] for note in done.notes] == [
        "4:5: topics[0].queue_sise: unknown key 'queue_sise'",
        "8:7: topics[0].qos.deadline: Midspan's publishers on ROS 2 have no deadline",
        f"10:7: topics[0].qos.{lease}: Midspan's publishers on ROS 2 have no {lease}",
        "11:5: topics[1]: /a is already listed in line 2",
        f"12:1: rate: 'rate' is not a list of the parameter_bridge ({known})",
        "14:38: services_2_to_1[0].timeout: unknown key 'timeout'",
        "15:5: services_2_to_1[1]: /s is already listed in line 14",
    ]
    assert "did you mean 'queue_size'?" in done.notes[0]
    for note in done.notes:
        assert note.split(": ")[0] in done.out


def test_mapping_rules_are_imported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = tmp_path / "mapping.yaml"
    given.write_text("- {ros1_package_name: a_msgs, ros2_package_name: b_msgs}\n")
    file = write(tmp_path, "topics: [{topic: /a, type: b_msgs/msg/A}]\n")
    done = Imported(capsys, file, "ros1_bridge", "--mapping-rules", str(given))
    assert done.code == 0
    assert done.configs()[0].types.mapping_rules == (given,)
    refused = Imported(capsys, given, "ros1_bridge")
    assert refused.code == 1
    assert "--mapping-rules" in refused.notes[0]


def test_a_domain_bridge_becomes_one_daemon_for_each_domain(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    done = Imported(capsys, write(tmp_path, DOMAINS), "domain_bridge")
    assert done.code == 0
    domain2, domain3, domain4 = done.configs()
    assert [(c.name, c.ros2.domain, c.ros1.enabled, c.routing.default) for c in (domain2, domain3, domain4)] == [
        (f"my_bridge_{n}", n, False, "deny") for n in (2, 3, 4)
    ]
    clock, text = "rosgraph_msgs/msg/Clock", "example_interfaces/msg/String"
    sides = {"from": "ros2", "to": "ros2"}
    entries = {"from": "ros2", "to": "zenoh"}
    assert rules(domain2) == [
        {"topic": "/clock", "type": clock, **entries, "rename": "/domain2/clock"},
        {"topic": "/chatter", "type": text, **entries, "rename": "/domain2/chatter"},
        {"topic": "/domain3/chatter", "type": text, **sides, "rename": "/chatter"},
    ]
    assert rules(domain3) == [
        {"topic": "/chatter", "type": text, **entries, "rename": "/domain3/chatter"},
        {"topic": "/domain2/clock", "type": clock, **sides, "rename": "/clock"},
        {"topic": "/domain2/chatter", "type": text, **sides, "rename": "/chatter", "depth": 5,
         "qos": {"reliability": "best_effort"}},
    ]  # fmt: skip
    assert rules(domain4) == [
        {"topic": "/domain2/chatter", "type": text, **sides, "rename": "/my_bridge/received"},
    ]


def test_unsupported_settings_of_domain_bridge_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = """\
from_domain: 2
to_domain: 3
mode: compress
topics:
  /a:
    type: std_msgs/msg/String
    bidirectional: yes
    qos: {lifespan: auto, liveliness: manual_by_topic}
  a: {type: std_msgs/msg/String, remap: b}
services:
  add: {type: example_interfaces/srv/AddTwoInts, qos: {depth: 5}}
  add: {type: example_interfaces/srv/AddTwoInts, remap: c}
"""
    done = Imported(capsys, write(tmp_path, text), "domain_bridge")
    assert done.code == 3
    problems = [note.partition(";")[0] for note in done.notes[:-1]]
    assert problems[0].startswith("3:1: mode: Midspan leaves messages as they are")
    assert problems[1:] == [
        "8:11: topics[0]./a.qos.lifespan: Midspan's publishers on ROS 2 have no lifespan",
        "8:27: topics[0]./a.qos.liveliness: Midspan's publishers on ROS 2 have no liveliness",
        "9:3: topics[1].a: line 5 already bridges /a from domain 2 to 3",
        "11:50: services[0].add.qos: a rule's depth and QoS are for topics only",
        "12:3: services[1].add: line 11 already bridges /add from domain 2 to 3",
    ]
    for note in done.notes[:-1]:
        assert note.split(": ")[0] in done.out
    assert len(done.configs()) == 2


def test_services_and_actions_are_bridged_from_their_servers_domain(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A file may contain only services and actions. Each is bridged from its server's domain.

    This is ``from_domain``, or ``to_domain`` with ``reversed``.
    """
    text = """\
from_domain: 2
to_domain: 3
services:
  add: {type: example_interfaces/srv/AddTwoInts, remap: ~/plus}
  add: {type: example_interfaces/AddTwoInts, to_domain: 4}
actions:
  /go: {type: nav2_msgs/action/NavigateToPose, reversed: true}
"""
    done = Imported(capsys, write(tmp_path, text), "domain_bridge")
    assert done.code == 0
    domain2, domain3, domain4 = done.configs()
    add = {"kind": "service", "type": "example_interfaces/srv/AddTwoInts", "from": "ros2"}
    go = {"kind": "action", "type": "nav2_msgs/action/NavigateToPose", "from": "ros2"}
    assert rules(domain2) == [
        {**add, "topic": "/add", "to": "zenoh", "rename": "/domain2/add"},
        {**go, "topic": "/domain3/go", "to": "ros2", "rename": "/go"},
    ]
    assert rules(domain3) == [
        {**go, "topic": "/go", "to": "zenoh", "rename": "/domain3/go"},
        {**add, "topic": "/domain2/add", "to": "ros2", "rename": "/domain_bridge/plus"},
    ]
    assert rules(domain4) == [{**add, "topic": "/domain2/add", "to": "ros2", "rename": "/add"}]


def test_import_writes_files_and_overwrites_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, folder = write(tmp_path, DOMAINS), tmp_path / "out"
    done = Imported(capsys, file, "domain_bridge", "-o", str(folder))
    assert done.code == 0
    files = [folder / f"my_bridge_domain{number}.yaml" for number in (2, 3, 4)]
    assert done.out.split() == [str(f) for f in files]
    for path in files:
        assert main(["config", "check", str(path)]) == 0
    capsys.readouterr()
    files[1].write_text("mine")
    again = Imported(capsys, file, "domain_bridge", "-o", str(folder))
    assert again.code == 1
    assert "file exists; --force overwrites" in again.notes[0]
    assert files[1].read_text() == "mine"
    assert Imported(capsys, file, "domain_bridge", "-o", str(folder), "--force").code == 0
    assert files[1].read_text() != "mine"


@pytest.mark.parametrize(
    ("peer", "text", "complaints"),
    [
        ("ros1_bridge", "topics: [\n", ["2:1: not valid YAML"]),
        ("ros1_bridge", "", ["has none of ros1_bridge's lists"]),
        ("ros1_bridge", "topic: []\n", ["1:1: has none of ros1_bridge's lists: topics"]),
        ("ros1_bridge", "topics: {a: b}\n", ["1:9: topics: must be a list"]),
        (
            "ros1_bridge",
            "topics:\n- {topic: /a}\n- {topic: 5, type: x}\n- hello\n- {topic: /b c, type: a/B}\n",
            ["2:3: topics[0]: has no 'type'", "3:11: topics[1].topic: ", "4:3: topics[2]: must be a section",
             "5:11: topics[3].topic: '/b c' is not a topic name"],
        ),
        (
            "ros1_bridge",
            "topics:\n- topic: /a\n  type: a/B\n  qos: {reliability: reliabel}\n",
            ["4:22: topics[0].qos.reliability: 'reliabel' is not one of reliable, best_effort; did you mean"],
        ),
        ("ros1_bridge", "topics:\n- {topic: /a, type: B}\n", ["2:21: topics[0].type: 'B' is not a message type"]),
        ("ros1_bridge", "services_1_to_2: {a: b}\n", ["1:18: services_1_to_2: must be a list"]),
        (
            "ros1_bridge",
            """services_1_to_2:\n- {service: /a}\n- {service: /a b, type: a/B}\n- {service: /a, type: a/msg/B}
services_2_to_1:\n- {service: /a, type: TwoInts}\n""",
            ["2:3: services_1_to_2[0]: has no 'type'", "3:13: services_1_to_2[1].service: '/a b' is not a service name",
             "4:23: services_1_to_2[2].type: 'a/msg/B' is not a service type, such as std_srvs/srv/SetBool",
             "6:23: services_2_to_1[0].type: 'TwoInts' is not a service type of ROS 1, such as std_srvs/SetBool"],
        ),
        ("domain_bridge", "services: [a]\n", ["1:11: services: must be a map of service names"]),
        (
            "domain_bridge",
            "from_domain: 1\nto_domain: 2\nactions: {go: {type: a/srv/B}}\n",
            ["3:22: actions[0].go.type: 'a/srv/B' is not an action type, such as nav2_msgs/action/NavigateToPose"],
        ),
        ("domain_bridge", "topics: 3\n", ["1:9: topics: must be a map of topic names"]),
        ("domain_bridge", "topics: {a: {type: a/B, from_domain: 1}}\n", ["1:10: topics[0].a: has no to_domain"]),
        (
            "domain_bridge",
            "from_domain: 1\nto_domain: 999\ntopics: {a: {type: a/B}}\n",
            ["2:12: to_domain: input should be less than or equal to 232"],
        ),
        ("domain_bridge", "from_domain: 1\nto_domain: 1\ntopics: {a: {type: a/B}}\n", ["3:13: topics[0].a: goes from"]),
        (
            "domain_bridge",
            "from_domain: 1\nto_domain: 2\ntopics:\n  a:\n    type: a/B\n    qos: {durability: transient}\n",
            ["6:23: topics[0].a.qos.durability: 'transient' is not one of volatile, transient_local; did you mean"],
        ),
        ("domain_bridge", "name: x\n", ["topics: has no topic, service or action that goes"]),
    ],
)  # fmt: skip
def test_broken_files_are_refused_with_place_and_reason(
    peer: str, text: str, complaints: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    done = Imported(capsys, write(tmp_path, text), peer)
    assert done.code == 1
    assert done.out == ""
    for note, complaint in zip(done.notes, complaints, strict=True):
        assert complaint in note
