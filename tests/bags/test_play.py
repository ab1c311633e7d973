"""``midspan play`` on a real hub, with a ROS 1 bag and subscribers."""

from __future__ import annotations

import json
import os
import pty
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from bridge.bags.play.services import PAUSE, STEP
from bridge.cli.main import main
from bridge.hub.control import RECORDED
from bridge.hub.endpoints.subscription import HubSample
from bridge.hub.node import Hub
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry
from tests.bags import written
from tests.bags.playing import NS, START, Said, transform, write_bag
from tests.contract.hubside import HubSide
from tests.peers.hub.quick import QuickHub
from tests.peers.peer import stop_all
from tests.support.process import Process
from tests.support.wait import until

TEXT, TWIST, TF = "std_msgs/String", "geometry_msgs/Twist", "tf2_msgs/TFMessage"
REGISTRY = Registry()
MESSAGES = [
    Said(0.0, "/name", TEXT, {"data": "latched"}),
    Said(0.0, "/tf_static", TF, {"transforms": [transform("base", "laser")]}),
    *(Said(0.1 * n, "/said", TEXT, {"data": f"said {n}"}) for n in range(6)),
    *(Said(0.1 * n + 0.05, "/cmd_vel", TWIST, {"linear": {"x": 0.5}}) for n in range(3)),
    Said(0.42, "/tf_static", TF, {"transforms": [transform("base", "camera")]}),
]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bags")
    return write_bag(folder / "run.bag", sorted(MESSAGES, key=lambda count: count.at), ["/name", "/tf_static"])


@pytest.fixture(scope="module")
def hubs() -> Iterator[QuickHub]:
    built = QuickHub()
    yield built
    built.stop_router()


class Listener:
    """A program on the hub that records received messages, and when they were sent."""

    def __init__(self, hub: Hub) -> None:
        self.hub = hub
        self.messages: list[tuple[str, Any, float]] = []

    def on_message(self, topic: str, type_name: str, qos: Qos | None = None) -> None:
        to_json(REGISTRY, type_name, from_json(REGISTRY, type_name, {}))  # the first use of a type takes long

        def arrived(sample: HubSample) -> None:
            at = sample.source_time_ns / NS
            self.messages.append((topic, to_json(REGISTRY, type_name, sample.data()), at))

        self.hub.subscription(topic, type_name, "*", qos or Qos(depth=100), arrived)

    def received_on(self, topic: str) -> list[Any]:
        return [message for messages, message, _ in tuple(self.messages) if messages == topic]

    def texts(self, topic: str = "/said") -> list[str]:
        return [message["data"] for message in self.received_on(topic)]

    def frames(self) -> list[set[str]]:
        return [
            {item["child_frame_id"] for item in message["transforms"]} for message in self.received_on("/tf_static")
        ]


@pytest.fixture
def listener(hubs: QuickHub, monkeypatch: pytest.MonkeyPatch) -> Iterator[Listener]:
    for limit in ("APPEAR_SECONDS", "MATCH_SECONDS"):
        monkeypatch.setattr(f"bridge.cli.bags.play.{limit}", 40.0)  # for a busy machine
    with Hub.open(hubs.settings("listener")) as hub:
        built = Listener(hub)
        built.on_message("/said", "std_msgs/msg/String")
        built.on_message("/cmd_vel", "geometry_msgs/msg/Twist")
        built.on_message("/tf_static", "tf2_msgs/msg/TFMessage", LATCHED)
        built.on_message("/clock", "rosgraph_msgs/msg/Clock")
        yield built


@pytest.fixture
def file(hubs: QuickHub, tmp_path: Path) -> Path:
    built = tmp_path / "midspan.yaml"
    hub = {key: value for key, value in hubs.config().items() if value is not None}
    built.write_text(yaml.safe_dump({"name": "robot1", "state": str(tmp_path / "state"), "hub": hub}))
    return built


Play = Callable[..., int]
Player = Callable[..., Process]
IMPORTS = (
    "bridge.bags.play.output",
    "bridge.bags.play.player",
    "bridge.bags.reader",
    "bridge.cli.bags.play",
    "bridge.cli.main",
)


@pytest.fixture
def play(file: Path, bag: Path) -> Play:
    """The command in this process."""
    return lambda *arguments: main(["play", str(bag), "--config", str(file), "--settle", "0", *arguments])


@pytest.fixture
def player(file: Path, bag: Path) -> Iterator[Player]:
    """The command in a separate process."""
    started: list[Process] = []

    def start(*arguments: str) -> Process:
        line = [sys.executable, "-m", "bridge.cli.main", "play", bag, "--config", file, "--settle", "0", *arguments]
        started.append(Process(line, imports=IMPORTS))
        return started[-1]

    yield start
    stop_all(started)


def output_of(program: Process, code: int = 0) -> str:
    """Return a program's output after its exit with this code."""
    until(lambda: program.popen.poll() is not None, "the program exits", 20)
    assert program.popen.poll() == code, program.output()
    return program.output()


def test_a_bag_is_played_with_its_times_and_without_commands(
    play: Play, listener: Listener, capsys: pytest.CaptureFixture[str]
) -> None:
    assert play("--json") == 0
    until(lambda: len(listener.received_on("/said")) == 6 and listener.frames(), "all messages are received")
    assert listener.texts() == [f"said {n}" for n in range(6)]
    times = [at for topic, _, at in listener.messages if topic == "/said"]
    assert times[-1] - times[0] > 0.2, "not all at once; on a busy machine, the first of 0.5 s may be late"
    assert listener.frames() == [{"laser", "camera"}]
    assert listener.received_on("/cmd_vel") == []
    out = capsys.readouterr()
    expected = json.loads(out.out)
    assert expected["topics"] == {"/name": 1, "/said": 6, "/tf_static": 1}
    assert [(item["topic"], item["command"]) for item in expected["left_out"]] == [("/cmd_vel", True)]
    assert "/cmd_vel (geometry_msgs/Twist) is left out: it moves the robot (--commands plays it)" in out.err


@pytest.mark.parametrize("kind", ["ros1", "rosbag2", "mcap"])
def test_all_formats_are_played_alike(
    kind: str, file: Path, tmp_path: Path, listener: Listener, capsys: pytest.CaptureFixture[str]
) -> None:
    built = {"ros1": written.ros1_bag, "rosbag2": written.db3_folder, "mcap": written.mcap_file}[kind](tmp_path / "bag")
    listener.on_message("/pose", "geometry_msgs/msg/PoseStamped")
    listener.on_message("/map_name", "std_msgs/msg/String", LATCHED)
    assert main(["play", str(built), "--config", str(file), "--rate", "20", "--json"]) == 0
    until(lambda: len(listener.received_on("/pose")) == 20 and listener.texts("/map_name"), "all messages are received")
    assert [pose["pose"]["position"]["x"] for pose in listener.received_on("/pose")] == [float(n) for n in range(20)]
    assert listener.texts("/map_name") == ["text 0"]
    assert json.loads(capsys.readouterr().out)["topics"] == {"/map_name": 1, "/pose": 20}


def test_the_option_commands_plays_commands_and_zero_ends_them(
    play: Play, listener: Listener, capsys: pytest.CaptureFixture[str]
) -> None:
    assert play("--commands", "--topics", "/cmd_vel", "--json") == 0
    out = capsys.readouterr()
    played = json.loads(out.out)["messages"]  # on a busy machine, some are dropped as late
    assert 1 <= played <= 3
    until(lambda: len(listener.received_on("/cmd_vel")) >= played + 2, "the velocities and zeros are received")
    speeds = [twist["linear"]["x"] for twist in listener.received_on("/cmd_vel")]
    assert speeds == [0.5] * played + [0.0] * (len(speeds) - played)
    assert "commands are played, the robot may move: /cmd_vel" in out.err


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 0), (signal.SIGHUP, 129)])
def test_latched_topics_stay_latched_but_velocities_do_not(
    player: Player, listener: Listener, number: signal.Signals, code: int
) -> None:
    program = player("--commands", "--rate", "0.02", "--loop")
    until(lambda: listener.received_on("/cmd_vel"), "a velocity is received", 20)
    until(
        lambda: (
            {end.topic for end in listener.hub.graph.publishers() if not end.own and end.qos.latched}
            == {"/name", "/tf_static"}
        ),
        "only these topics are latched",
    )
    listener.on_message("/name", "std_msgs/msg/String", LATCHED)
    until(lambda: listener.texts("/name") == ["latched"], "a late subscriber gets latched messages")
    begun = time.monotonic()
    program.signal(number)
    until(
        lambda: not [end for end in listener.hub.graph.publishers() if not end.own],
        "the player's publishers are gone",
    )
    output_of(program, code)
    assert time.monotonic() - begun < 20.0, "the play ends before the loop of 25 s"
    until(lambda: listener.received_on("/cmd_vel")[-1]["linear"]["x"] == 0.0, "the last velocity is zero")


def test_a_halt_pauses_a_player_of_commands(player: Player, listener: Listener) -> None:
    program = player("--commands", "--topics", "/cmd_vel", "--rate", "0.01", "--clock")
    until(lambda: listener.received_on("/cmd_vel"), "a velocity is received", 20)
    assert [answer.value for answer in listener.hub.ask("halt", {}, timeout=20.0)] == [RECORDED]
    until(lambda: listener.received_on("/cmd_vel")[-1]["linear"]["x"] == 0.0, "a zero velocity is received")
    begun = len(listener.received_on("/clock"))

    def stopped() -> bool:
        stamps = [message["clock"] for message in listener.received_on("/clock")[begun:]]
        return len(stamps) > 5 and all(stamp == stamps[-1] for stamp in stamps[-5:])

    until(stopped, "the clock is published again and again, and has stopped")
    speeds = [twist["linear"]["x"] for twist in listener.received_on("/cmd_vel")]
    stop = speeds.index(0.0)  # on a busy machine, several velocities are played before the halt
    assert (set(speeds[:stop]), set(speeds[stop:])) == ({0.5}, {0.0})
    program.signal(signal.SIGINT)
    output_of(program)


def test_keys_pause_step_and_end_the_play(file: Path, bag: Path, listener: Listener) -> None:
    primary, secondary = pty.openpty()
    line = [sys.executable, "-m", "bridge.cli.main", "play", str(bag), "--config", str(file), "--settle", "0"]
    program = subprocess.Popen(
        [*line, "--topics", "/said", "--paused", "--clock"], stdin=secondary, stdout=secondary, stderr=secondary
    )
    try:
        shown = TerminalOutput(primary)
        until(lambda: "paused" in shown.text(), "the progress line is shown", 20)
        until(lambda: listener.received_on("/clock"), "the player has matched the subscriptions")
        os.write(primary, b".")
        until(lambda: listener.texts() == ["said 0"], "a key steps")
        os.write(primary, b"s")
        until(lambda: listener.texts() == ["said 0", "said 1"], "another key steps again")
        until(lambda: "0.1 of 0.5 s, rate 1, 2 messages, paused" in shown.text(), "the progress is shown")
        os.write(primary, b" ")
        until(lambda: "said 4" in listener.texts(), "playback continues")
        os.write(primary, b"q")
        assert program.wait(40) == 0
    finally:
        program.kill()
        program.wait()
        os.close(primary)
        os.close(secondary)


class TerminalOutput:
    """What a program writes to a terminal."""

    def __init__(self, terminal: int) -> None:
        self._terminal, self._text = terminal, ""

    def text(self) -> str:
        while select.select([self._terminal], [], [], 0)[0]:
            self._text += os.read(self._terminal, 4096).decode()
        return self._text


def test_services_pause_and_step_while_the_clock_is_stopped(player: Player, listener: Listener) -> None:
    program = player("--paused", "--clock", "50", "--topics", "/said", "--start", "0.05")
    caller = HubSide(listener.hub, REGISTRY)
    until(lambda: len(listener.received_on("/clock")) > 3, "the clock is published", 20)
    assert caller.call(STEP, "std_srvs/Trigger").result(20)["reply"]["success"]
    until(lambda: listener.texts() == ["said 1"], "a step plays one message")
    until(lambda: listener.received_on("/clock")[-1]["clock"] == clock(0.1), "/clock has the message's time")
    count = len(listener.received_on("/clock"))
    until(lambda: len(listener.received_on("/clock")) > count + 3, "the clock is published again")
    assert listener.received_on("/clock")[-1]["clock"] == clock(0.1)
    assert listener.texts() == ["said 1"]
    caller.call(PAUSE, "std_srvs/SetBool", data=False)
    assert "played 5 messages" in output_of(program)
    until(lambda: listener.texts() == [f"said {n}" for n in range(1, 6)], "all messages arrive")
    until(lambda: listener.received_on("/clock")[-1]["clock"] == clock(0.5), "/clock has the last message's time")
    times = [message["clock"]["sec"] * NS + message["clock"]["nanosec"] for message in listener.received_on("/clock")]
    assert times == sorted(times)


def clock(at: float) -> dict[str, int]:
    seconds, nanoseconds = divmod(START + round(at * NS), NS)
    return {"sec": seconds, "nanosec": nanoseconds}


def test_each_loop_publishes_all_static_transforms_once(player: Player, listener: Listener) -> None:
    program = player("--loop", "--rate", "5")
    until(lambda: listener.texts().count("said 5") >= 3, "the message arrives three times", 20)
    program.signal(signal.SIGTERM)
    output_of(program, 143)
    begun = listener.texts().index("said 0")  # on a busy machine, the first loop may begin before the player matches
    assert listener.texts()[begun : begun + 12] == [f"said {n}" for n in range(6)] * 2
    until(
        lambda: len(listener.frames()) - listener.texts().count("said 0") in (bool(begun), bool(begun) + 1),
        "each loop has one message of frames",
    )
    assert all(item == {"laser", "camera"} for item in listener.frames())


def test_a_live_publisher_is_reported(play: Play, hubs: QuickHub, capsys: pytest.CaptureFixture[str]) -> None:
    with Hub.open(hubs.settings("live_robot")) as robot:
        live = robot.publisher("/said", "std_msgs/msg/String", REGISTRY.ros2("std_msgs/msg/String").type_id, Qos())
        live.put(from_json(REGISTRY, "std_msgs/msg/String", {}))
        assert play("--rate", "50") == 0
    assert "/said has a publisher already, live_robot" in capsys.readouterr().err


def test_topics_are_selected_and_renamed(play: Play, listener: Listener, capsys: pytest.CaptureFixture[str]) -> None:
    listener.on_message("/text/new", "std_msgs/msg/String")
    assert play("--rate", "10", "--topics", "/s*", "/name", "-x", "ame$", "--remap", "said:=/text/new", "--json") == 0
    until(lambda: len(listener.received_on("/text/new")) == 6, "the messages arrive on the topic's new name")
    assert json.loads(capsys.readouterr().out)["topics"] == {"/text/new": 6}


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--topics", "/nothing"], "there is nothing to play"),
        (["--start", "99"], "--start is 99"),
    ],
)
def test_invalid_options_are_reported(
    play: Play, arguments: list[str], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert play(*arguments) == 1
    assert expected in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["--remap", "/a=/b"], ["--rate", "0"], ["--start", "-1"], ["-x", "("]])
def test_invalid_values_are_refused(play: Play, arguments: list[str]) -> None:
    with pytest.raises(SystemExit):
        play(*arguments)


def test_a_file_that_is_not_a_bag_is_reported(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "no.bag").write_bytes(b"nothing of the kind")
    assert main(["play", str(tmp_path / "no.bag"), "--config", str(file)]) == 1
    assert "no.bag" in capsys.readouterr().err


def test_a_damaged_bag_is_played_up_to_the_damage_and_fails(
    file: Path, tmp_path: Path, listener: Listener, capsys: pytest.CaptureFixture[str]
) -> None:
    messages = [Said(0.01 * n, "/said", TEXT, {"data": f"{n}" + "x" * 100_000}) for n in range(40)]
    built = write_bag(tmp_path / "damaged.bag", messages)
    data = bytearray(built.read_bytes())
    data[1_300_000:1_450_000] = bytes(150_000)  # in the second chunk, over the header of a message
    built.write_bytes(data)
    assert main(["play", str(built), "--config", str(file), "--settle", "0", "--json"]) == 1
    out = capsys.readouterr()
    played = json.loads(out.out)["messages"]
    assert 5 < played < 20
    assert "damaged.bag, byte" in out.err
    until(lambda: len(listener.texts()) == played, "the messages before the damage arrive")
