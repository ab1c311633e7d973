"""``midspan play`` on a real hub: a bag of ROS 1, and who subscribes there."""

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
from bridge.hub.session import Hub
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry
from tests.bags import written
from tests.bags.playing import NS, START, Said, transform, write_bag
from tests.contract.hubside import HubSide
from tests.support.peer import stop_all
from tests.support.process import Process
from tests.support.quick_hub import QuickHub
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
    return write_bag(folder / "run.bag", sorted(MESSAGES, key=lambda said: said.at), ["/name", "/tf_static"])


@pytest.fixture(scope="module")
def hubs() -> Iterator[QuickHub]:
    made = QuickHub()
    yield made
    made.stop_router()


class Listener:
    """A program on the hub that notes what it hears."""

    def __init__(self, hub: Hub) -> None:
        self.hub = hub
        self.heard: list[tuple[str, Any, float]] = []

    def hear(self, topic: str, type_name: str, qos: Qos | None = None) -> None:
        def came(sample: HubSample) -> None:
            self.heard.append((topic, to_json(REGISTRY, type_name, sample.data()), time.monotonic()))

        self.hub.subscription(topic, type_name, "*", qos or Qos(depth=100), came)

    def of(self, topic: str) -> list[Any]:
        return [message for heard, message, _ in tuple(self.heard) if heard == topic]

    def texts(self, topic: str = "/said") -> list[str]:
        return [message["data"] for message in self.of(topic)]

    def frames(self) -> list[set[str]]:
        return [{each["child_frame_id"] for each in message["transforms"]} for message in self.of("/tf_static")]


@pytest.fixture
def listener(hubs: QuickHub) -> Iterator[Listener]:
    with Hub.open(hubs.settings("listener")) as hub:
        made = Listener(hub)
        made.hear("/said", "std_msgs/msg/String")
        made.hear("/cmd_vel", "geometry_msgs/msg/Twist")
        made.hear("/tf_static", "tf2_msgs/msg/TFMessage", LATCHED)
        made.hear("/clock", "rosgraph_msgs/msg/Clock")
        yield made


@pytest.fixture
def file(hubs: QuickHub, tmp_path: Path) -> Path:
    made = tmp_path / "midspan.yaml"
    hub = {key: value for key, value in hubs.config().items() if value is not None}
    made.write_text(yaml.safe_dump({"name": "robot1", "state": str(tmp_path / "state"), "hub": hub}))
    return made


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
    """The verb in this process."""
    return lambda *words: main(["play", str(bag), "--config", str(file), "--settle", "0", *words])


@pytest.fixture
def player(file: Path, bag: Path) -> Iterator[Player]:
    """The verb in a process of its own."""
    started: list[Process] = []

    def start(*words: str) -> Process:
        line = [sys.executable, "-m", "bridge.cli.main", "play", bag, "--config", file, "--settle", "0", *words]
        started.append(Process(line, imports=IMPORTS))
        return started[-1]

    yield start
    stop_all(started)


def ended(program: Process) -> str:
    """What it wrote, once it has ended well."""
    until(lambda: program.popen.poll() is not None, "it ends", 20)
    assert program.popen.poll() == 0, program.output()
    return program.output()


def test_a_bag_is_heard_on_the_hub_with_its_times_and_without_its_commands(
    play: Play, listener: Listener, capsys: pytest.CaptureFixture[str]
) -> None:
    assert play("--json") == 0
    until(lambda: len(listener.of("/said")) == 6, "all is heard", 5)
    assert listener.texts() == [f"said {n}" for n in range(6)]
    times = [at for topic, _, at in listener.heard if topic == "/said"]
    assert times[-1] - times[0] > 0.4
    assert listener.frames() == [{"laser", "camera"}]
    assert listener.of("/cmd_vel") == []
    out = capsys.readouterr()
    told = json.loads(out.out)
    assert told["topics"] == {"/name": 1, "/said": 6, "/tf_static": 1}
    assert [(each["topic"], each["command"]) for each in told["left_out"]] == [("/cmd_vel", True)]
    assert "/cmd_vel (geometry_msgs/Twist) is left out: it moves the robot (--commands plays it)" in out.err


@pytest.mark.parametrize("kind", ["ros1", "rosbag2", "mcap"])
def test_each_format_is_heard_the_same(
    kind: str, file: Path, tmp_path: Path, listener: Listener, capsys: pytest.CaptureFixture[str]
) -> None:
    made = {"ros1": written.ros1_bag, "rosbag2": written.db3_folder, "mcap": written.mcap_file}[kind](tmp_path / "bag")
    listener.hear("/pose", "geometry_msgs/msg/PoseStamped")
    listener.hear("/map_name", "std_msgs/msg/String", LATCHED)
    assert main(["play", str(made), "--config", str(file), "--rate", "20", "--json"]) == 0
    until(lambda: len(listener.of("/pose")) == 20, "all is heard", 5)
    assert [pose["pose"]["position"]["x"] for pose in listener.of("/pose")] == [float(n) for n in range(20)]
    assert listener.texts("/map_name") == ["text 0"]
    assert json.loads(capsys.readouterr().out)["topics"] == {"/map_name": 1, "/pose": 20}


def test_commands_come_with_commands_and_zero_ends_them(
    play: Play, listener: Listener, capsys: pytest.CaptureFixture[str]
) -> None:
    assert play("--commands", "--topics", "/cmd_vel", "--json") == 0
    out = capsys.readouterr()
    played = json.loads(out.out)["messages"]  # on a busy machine some are late
    assert 1 <= played <= 3
    until(lambda: len(listener.of("/cmd_vel")) == played + 1, "the velocities and zero are heard", 5)
    assert [twist["linear"]["x"] for twist in listener.of("/cmd_vel")] == [0.5] * played + [0.0]
    assert "commands are played, the robot may move: /cmd_vel" in out.err


def test_latched_stays_latched_and_a_velocity_is_not(player: Player, listener: Listener) -> None:
    program = player("--commands", "--rate", "0.05", "--loop")
    until(lambda: listener.of("/cmd_vel"), "it drives", 20)
    ends = {end.topic: end for end in listener.hub.graph.publishers() if not end.own}
    assert {name for name, end in ends.items() if end.qos.latched} == {"/name", "/tf_static"}
    listener.hear("/name", "std_msgs/msg/String", LATCHED)
    until(lambda: listener.texts("/name") == ["latched"], "who comes late gets what is latched", 5)
    begun = time.monotonic()
    program.signal(signal.SIGINT)
    until(lambda: not [end for end in listener.hub.graph.publishers() if not end.own], "its publishers are gone", 5)
    ended(program)
    assert time.monotonic() - begun < 2.0
    assert listener.of("/cmd_vel")[-1]["linear"]["x"] == 0.0


def test_a_halt_pauses_a_player_of_commands(player: Player, listener: Listener) -> None:
    program = player("--commands", "--topics", "/cmd_vel", "--rate", "0.05", "--clock")
    until(lambda: listener.of("/cmd_vel"), "it drives", 20)
    assert [answer.value for answer in listener.hub.ask("halt", {})] == [RECORDED]
    until(lambda: listener.of("/cmd_vel")[-1]["linear"]["x"] == 0.0, "it stands", 5)
    until(lambda: listener.of("/clock")[-1] == listener.of("/clock")[-2], "the time stands still", 5)
    at, said = listener.of("/clock")[-1], len(listener.of("/clock"))
    until(lambda: len(listener.of("/clock")) > said + 5, "the clock is said again", 5)
    assert listener.of("/clock")[-1] == at
    assert [twist["linear"]["x"] for twist in listener.of("/cmd_vel")] == [0.5, 0.0]
    program.signal(signal.SIGINT)
    ended(program)


def test_keys_pause_step_and_end_it(file: Path, bag: Path, listener: Listener) -> None:
    primary, secondary = pty.openpty()
    line = [sys.executable, "-m", "bridge.cli.main", "play", str(bag), "--config", str(file), "--settle", "0"]
    program = subprocess.Popen(
        [*line, "--topics", "/said", "--paused"], stdin=secondary, stdout=secondary, stderr=secondary
    )
    try:
        shown = Shown(primary)
        until(lambda: "paused" in shown.text(), "its line is there", 20)
        os.write(primary, b".")
        until(lambda: listener.texts() == ["said 0"], "a key steps", 5)
        os.write(primary, b"s")
        until(lambda: listener.texts() == ["said 0", "said 1"], "and another one", 5)
        until(lambda: "0.1 of 0.5 s, rate 1, 2 messages, paused" in shown.text(), "the progress is shown", 5)
        os.write(primary, b" ")
        until(lambda: "said 4" in listener.texts(), "it goes on", 5)
        os.write(primary, b"q")
        assert program.wait(10) == 0
    finally:
        program.kill()
        program.wait()
        os.close(primary)
        os.close(secondary)


class Shown:
    """What a program writes to a terminal."""

    def __init__(self, terminal: int) -> None:
        self._terminal, self._text = terminal, ""

    def text(self) -> str:
        while select.select([self._terminal], [], [], 0)[0]:
            self._text += os.read(self._terminal, 4096).decode()
        return self._text


def test_pause_and_step_by_service_while_the_clock_stands_still(player: Player, listener: Listener) -> None:
    program = player("--paused", "--clock", "50", "--topics", "/said", "--start", "0.05")
    caller = HubSide(listener.hub, REGISTRY)
    until(lambda: len(listener.of("/clock")) > 3, "the clock is said", 20)
    assert caller.call(STEP, "std_srvs/Trigger").result(5)["reply"]["success"]
    until(lambda: listener.texts() == ["said 1"], "one message is played", 5)
    until(lambda: listener.of("/clock")[-1]["clock"] == clock(0.1), "the time is its", 5)
    said = len(listener.of("/clock"))
    until(lambda: len(listener.of("/clock")) > said + 3, "the clock is said again", 5)
    assert listener.of("/clock")[-1]["clock"] == clock(0.1)
    assert listener.texts() == ["said 1"]
    caller.call(PAUSE, "std_srvs/SetBool", data=False)
    assert "played 5 messages" in ended(program)
    assert listener.texts() == [f"said {n}" for n in range(1, 6)]
    assert listener.of("/clock")[-1]["clock"] == clock(0.5)
    times = [message["clock"]["sec"] * NS + message["clock"]["nanosec"] for message in listener.of("/clock")]
    assert times == sorted(times)


def clock(at: float) -> dict[str, int]:
    seconds, rest = divmod(START + round(at * NS), NS)
    return {"sec": seconds, "nanosec": rest}


def test_a_loop_says_the_static_transforms_whole_once_each_time(player: Player, listener: Listener) -> None:
    program = player("--loop", "--rate", "5")
    until(lambda: listener.texts().count("said 5") >= 3, "it is heard three times", 20)
    program.signal(signal.SIGTERM)
    ended(program)
    assert listener.texts()[:12] == [f"said {n}" for n in range(6)] * 2
    frames = listener.frames()
    assert all(each == {"laser", "camera"} for each in frames)
    assert len(frames) in (listener.texts().count("said 0"), listener.texts().count("said 0") + 1)


def test_a_live_publisher_is_told(play: Play, hubs: QuickHub, capsys: pytest.CaptureFixture[str]) -> None:
    with Hub.open(hubs.settings("live_robot")) as robot:
        live = robot.publisher("/said", "std_msgs/msg/String", REGISTRY.ros2("std_msgs/msg/String").type_id, Qos())
        live.put(from_json(REGISTRY, "std_msgs/msg/String", {}))
        assert play("--rate", "50") == 0
    assert "/said has a publisher already, live_robot" in capsys.readouterr().err


def test_topics_are_chosen_and_renamed(play: Play, listener: Listener, capsys: pytest.CaptureFixture[str]) -> None:
    listener.hear("/text/new", "std_msgs/msg/String")
    assert play("--rate", "10", "--topics", "/s*", "/name", "-x", "ame$", "--remap", "said:=/text/new", "--json") == 0
    until(lambda: len(listener.of("/text/new")) == 6, "it has its new name", 5)
    assert json.loads(capsys.readouterr().out)["topics"] == {"/text/new": 6}


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--topics", "/nothing"], "there is nothing to play"),
        (["--start", "99"], "--start is 99"),
    ],
)
def test_mistakes_are_told(play: Play, words: list[str], told: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert play(*words) == 1
    assert told in capsys.readouterr().err


@pytest.mark.parametrize("words", [["--remap", "/a=/b"], ["--rate", "0"], ["--start", "-1"], ["-x", "("]])
def test_what_cannot_be_meant_is_refused(play: Play, words: list[str]) -> None:
    with pytest.raises(SystemExit):
        play(*words)


def test_a_file_that_is_no_bag_is_told(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "no.bag").write_bytes(b"nothing of the kind")
    assert main(["play", str(tmp_path / "no.bag"), "--config", str(file)]) == 1
    assert "no.bag" in capsys.readouterr().err


def test_a_damaged_bag_is_played_up_to_the_damage_and_fails(
    file: Path, tmp_path: Path, listener: Listener, capsys: pytest.CaptureFixture[str]
) -> None:
    messages = [Said(0.01 * n, "/said", TEXT, {"data": f"{n}" + "x" * 100_000}) for n in range(40)]
    made = write_bag(tmp_path / "damaged.bag", messages)
    data = bytearray(made.read_bytes())
    data[1_300_000:1_450_000] = bytes(150_000)  # of the second chunk, over the head of a message
    made.write_bytes(data)
    assert main(["play", str(made), "--config", str(file), "--settle", "0", "--json"]) == 1
    out = capsys.readouterr()
    played = json.loads(out.out)["messages"]
    assert 5 < played < 20
    assert "damaged.bag, byte" in out.err
    until(lambda: len(listener.texts()) == played, "what stands before is heard", 5)
