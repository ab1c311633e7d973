"""The daemon records real programs of all four sides, and independent readers decode the files."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Protocol

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from bridge.hub.wire.qos import Qos
from bridge.messages.json import from_json
from bridge.messages.registry import Registry
from tests.bags.stock import member, rosbag, rosbags
from tests.contract.side import CUSTOM_FOLDER
from tests.peers.daemon.deployment import Deployment
from tests.peers.daemon.midspan import MIDSPAN
from tests.peers.hub.actions import HubActions
from tests.peers.hub.recorded_robot import Contents, read
from tests.peers.yarp.programs import Definitions, Names, YarpProgram
from tests.support.process import Process
from tests.support.wait import until

STRING = "std_msgs/String"
NAVIGATE, FEEDBACK = "nav2_msgs/NavigateToPose", "move_base_msgs/MoveBaseActionFeedback"


@pytest.fixture(scope="module")
def names() -> Iterator[Names]:
    server = Names()
    yield server
    server.stop()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, names: Names) -> Iterator[Deployment]:
    """A deployment that records, with one ROS 1 topic that the rules keep off the hub."""
    with Deployment(tmp_path_factory.mktemp("recorded")) as deployment:
        deployment.start(
            record={"enabled": True, "exclude": ["^/diagnostics", "^/rosout"]},
            yarp={"enabled": True, "nameserver": "site", "address": names.endpoint, "poll": 0.1},
            routing={"rules": [{"topic": "/home", "deny": True}]},
        )
        until(lambda: deployment.worker("record").get("state") == "running", "the daemon records", 30)
        yield deployment


class Recorded(Protocol):
    """A deployment whose recorder reports its status."""

    def worker(self, side: str, /) -> dict[str, Any]:
        """Return the status of a worker, or an empty one if it does not respond."""


def until_written(deployment: Recorded, send: Callable[[], None], *topics: str, seconds: float = 40.0) -> None:
    """Send until the recorder has written a message of each topic; a failure names the recorder's last status."""
    document: dict[str, Any] = {}
    missing = list(topics)

    def written() -> bool:
        nonlocal document, missing
        send()
        document = deployment.worker("record")
        counted = {entry["topic"] for entry in document.get("recording", {}).get("topics", []) if entry["messages"]}
        missing = [topic for topic in topics if topic not in counted]
        return not missing

    try:
        until(written, "a message of each topic is written", seconds, every=0.2)
    except AssertionError as err:
        recording = document.get("recording", {})
        counts = {entry["topic"]: (entry["messages"], entry["dropped"]) for entry in recording.get("topics", [])}
        status = f"{document.get('state', 'no answer')}, pid {document.get('pid')}, file {recording.get('file')}"
        raise AssertionError(f"{err}; missing: {missing}; recorder: {status}, messages and drops: {counts}") from None


def split(deployment: Deployment) -> Path:
    """Close the recorder's file, and return it. The status may already name another file, of a later message."""
    done = deployment.command("record", "--daemon", "split", "--json")
    assert done.returncode == 0, done.stderr
    (closed,) = json.loads(done.stdout)
    return Path(closed["file"])


def test_a_failure_names_the_missing_topics_and_the_file() -> None:
    counts = [{"topic": "/a", "messages": 3, "dropped": {}}, {"topic": "/b", "messages": 0, "dropped": {"queue": 1}}]
    document = {"state": "running", "pid": 7, "recording": {"file": "/tmp/x.mcap", "topics": counts}}
    stand_in = SimpleNamespace(worker=lambda _side: document)
    expected = r"missing: \['/b', '/c'\]; recorder: running, pid 7, file /tmp/x.mcap"
    with pytest.raises(AssertionError, match=expected) as failure:
        until_written(stand_in, lambda: None, "/a", "/b", "/c", seconds=0.0)
    assert "'/b': (0, {'queue': 1})" in str(failure.value)


def test_rosbags_and_mcaps_decoder_read_messages_from_all_sides(recorded: Deployment, names: Names) -> None:
    ros1, ros2, sdk = recorded.ros1(), recorded.ros2(), recorded.sdk()
    yarp = recorded.keep(YarpProgram(names.client, "/program", Definitions((CUSTOM_FOLDER,))))
    programs = {"ros1": ros1, "ros2": ros2, "zenoh": sdk, "yarp": yarp}
    pose = {"header": {"frame_id": "map"}, "pose": {"position": {"x": 1.5}}}
    ends = {side: (program, program.advertise(f"/from_{side}", STRING)) for side, program in programs.items()}
    late = ros1.advertise("/kept", "geometry_msgs/PoseStamped", latched=True)
    ros1.publish(late, pose)

    def publish() -> None:
        for side, (program, end) in ends.items():
            program.publish(end, {"data": side})

    until_written(recorded, publish, "/kept", *(f"/from_{side}" for side in programs))
    file = split(recorded)
    with AnyReader([file]) as bag:
        messages: dict[str, Any] = {c.topic: bag.deserialize(raw, c.msgtype) for c, _, raw in bag.messages()}
    assert {side: messages[f"/from_{side}"].data for side in programs} == {side: side for side in programs}
    assert (messages["/kept"].header.frame_id, messages["/kept"].pose.position.x) == ("map", 1.5)
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        topics = ["/kept", *(f"/from_{side}" for side in programs)]
        decoded = {
            channel.topic: (channel.metadata["side"], message)
            for _, channel, _, message in reader.iter_decoded_messages(topics)
        }
    assert {side: decoded[f"/from_{side}"][0] for side in programs} == {side: side for side in programs}
    assert {decoded[f"/from_{side}"][1].data for side in programs} == set(programs)
    assert decoded["/kept"][1].pose.position.x == 1.5


GOAL: dict[str, Any] = {"pose": {"header": {"frame_id": "map"}, "pose": {"orientation": {"w": 1.0}}}}
PLACE = {"pose": {"position": {"x": 1.5}}}


def test_a_recorded_goal_is_converted_for_rosbag_and_for_rosbags(recorded: Deployment, tmp_path: Path) -> None:
    """Record and convert a goal for ROS 1's ``move_base`` and a goal for a Nav2 planner on the hub."""
    ros1, hub = recorded.ros1(), recorded.keep(HubActions(recorded.settings("planner")))
    ros1.ask("act", action="/move_base", type="move_base_msgs/MoveBase", feedback=[{"base_position": PLACE}])
    hub.ask("act", action="/navigate_to_pose", type=NAVIGATE, feedback=[{"current_pose": PLACE}])
    goals = {
        "/move_base": (hub, {"type": NAVIGATE, "goal": GOAL}),
        "/navigate_to_pose": (ros1, {"type": "move_base_msgs/MoveBase", "goal": {"target_pose": GOAL["pose"]}}),
    }
    topics = [f"{action}/_action/{part}" for action in goals for part in ("feedback", "status")]

    def send_goals() -> None:
        """Send a goal to each server. Feedback is not latched, and the recorder may have missed that of the first goal.

        The clients need not receive it, because their goals end right after it, and a result has its own path through
        the hub.
        """
        for action, (client, request) in goals.items():
            goal = client.ask("send_goal", action=action, seconds=30.0, **request)["id"]
            state = client.ask("goal", id=goal, until={"accepted": True, "status": 4}, seconds=30.0)
            assert (state["accepted"], state["status"]) == (True, 4), f"the goal for {action} did not end: {state}"

    until_written(recorded, send_goals, *topics)
    file = split(recorded)
    for name in ("new.mcap", "new.db3", "new.bag"):
        done = recorded.command("bag", "convert", str(file), str(tmp_path / name), "--config", str(recorded.file))
        assert done.returncode == 0, done.stderr
    for path in (file, tmp_path / "new.mcap", tmp_path / "new.db3"):
        last = {topic: message for topic, _, message in rosbags(path)}
        for action in goals:
            assert member(last[f"{action}/_action/feedback"], "feedback.current_pose.pose.position.x") == 1.5
            assert member(last[f"{action}/_action/status"], "status_list.0.status") in (1, 2, 4)
    (messages,) = rosbag([tmp_path / "new.bag"])
    assert not isinstance(messages, str), messages
    types = {topic: type_name for topic, type_name, _ in messages}
    places = {topic: member(m, "feedback.base_position.pose.position.x") for topic, t, m in messages if t == FEEDBACK}
    for action in goals:
        assert types[f"{action}/status"] == "actionlib_msgs/GoalStatusArray"
        assert places[f"{action}/feedback"] == 1.5


def test_a_topic_that_is_not_bridged_is_recorded_on_its_side(recorded: Deployment, tmp_path: Path) -> None:
    ros1 = recorded.ros1()
    home, other = ros1.advertise("/home", STRING, latched=True), ros1.advertise("/out", STRING)
    ros1.publish(home, {"data": "at home"})
    ros1.publish(other, {"data": "not requested"})
    until(
        lambda: any(line["topic"] == "/home" for line in recorded.explain("/home")),
        "the daemon has discovered the topic",
    )
    file = tmp_path / "home.mcap"
    command = ["record", "/home", "-o", file, "--config", recorded.file]
    with Process([*MIDSPAN, *command]) as recorder:
        until(lambda: written_by_verb(recorded, file) or recorder.popen.poll(), "a message is written", 40, every=0.1)
        recorder.signal(signal.SIGINT)
        until(lambda: recorder.popen.poll() is not None, "the recorder exits", 20)
    assert recorder.popen.poll() == 0, recorder.output()
    contents = read(file)
    assert contents.texts("/home") == ["at home"]
    assert set(contents.channels) == {"/home"}
    assert contents.channels["/home"][0].metadata["side"] == "ros1"
    assert contents.channels["/home"][0].metadata["tap"] == "/_midspan/ros1/home"


def test_messages_reported_as_written_survive_kill_9_and_the_daemon_continues(recorded: Deployment) -> None:
    registry = Registry()
    robot = recorded.zenoh()
    kind = "std_msgs/msg/String"
    out = robot.hub.publisher("/many", kind, registry.ros2(kind).type_id, Qos(depth=1000))
    until(
        lambda: any("record" in e.node for e in robot.hub.graph.subscriptions("/many")), "the recorder subscribes", 30
    )
    sent = 0

    def written() -> bool:
        nonlocal sent
        for _ in range(100):
            sent += 1
            out.put(from_json(registry, kind, {"data": str(sent) + "x" * 500}))
        return many(recorded.worker("record").get("recording", {})) >= 500

    until(written, "500 messages are written", 20)
    pid = recorded.answer("record")["pid"]
    recording = recorded.answer("record")["recording"]
    os.kill(pid, signal.SIGKILL)
    contents = read(Path(recording["file"]))
    assert not contents.whole
    assert many(recording) >= 500
    received = numbers(contents)
    assert len(received) >= many(recording)
    assert received == list(range(received[0], len(received) + received[0]))

    def again() -> bool:
        document = recorded.worker("record")
        file = document.get("recording", {}).get("file")  # a worker that starts has none yet
        return document.get("pid", pid) != pid and file not in (None, recording["file"])

    until(again, "the daemon records again", 30, every=0.1)
    assert recorded.answer("ros1")["state"] == "running"


def written_by_verb(deployment: Deployment, file: Path) -> bool:
    """Return whether the command that writes this file has written a message; it publishes a status like a worker."""
    recordings = [document.get("recording", {}) for document in deployment.status()]
    return any(recording.get("file") == str(file) and recording["messages"] for recording in recordings)


def many(recording: dict[str, Any]) -> int:
    """Return the number of messages that the recorder has written for /many."""
    return next((entry["messages"] for entry in recording.get("topics", []) if entry["topic"] == "/many"), 0)


def numbers(contents: Contents) -> list[int]:
    return [int(text.rstrip("x")) for text in contents.texts("/many")]
