"""Which messages are played or dropped, with a clock that the test advances, and which topics are commands."""

from __future__ import annotations

import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from bridge.bags.bag import BagError, BagTopic
from bridge.bags.play.player import LEAST_SECONDS, Player
from bridge.bags.play.source import PlayMessage, PlayPart, PlaySource
from bridge.bags.play.timeline import Timeline, Wait
from bridge.bags.play.topics import CommandTopics, LeftOut, PlayChoice, PlayTopic, choose
from bridge.bags.reader import open_bag
from bridge.config.model import Config
from bridge.hub.errors import HubClosedError, HubError
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.definitions.schema import World
from bridge.messages.errors import ConversionError
from bridge.messages.json import to_json
from bridge.messages.registry import Registry
from tests.bags.playing import NS, START, Said, transform, write_bag
from tests.bags.test_play_timeline import Clock

TEXT, TWIST, TF = "std_msgs/String", "geometry_msgs/Twist", "tf2_msgs/TFMessage"
REGISTRY = Registry()


def topic(name: str, *, command: bool = False, convert: Callable[[bytes], bytes] | None = None) -> PlayTopic:
    chosen_ = BagTopic(name, "std_msgs/msg/String", World.ROS2)
    return PlayTopic(chosen_, name, "std_msgs/msg/String", "", convert, "", Qos(), command=command)


SCAN, DRIVE = topic("/scan"), topic("/cmd_vel", command=True)


class Tape:
    """Messages in memory."""

    def __init__(self, *messages: tuple[float, PlayTopic]) -> None:
        self.begin_ns, self.end_ns = START, START + max(round(at * NS) for at, _ in messages)
        self.bad: list[tuple[PlayTopic, str]] = []
        self.troubles: list[str] = []
        self._messages = [PlayMessage(topic, START + round(at * NS), str(at).encode()) for at, topic in messages]

    def move(self, *payloads: bytes) -> None:
        """Set the payloads of the last messages."""
        for number, data in enumerate(payloads, -len(payloads)):
            self._messages[number] = self._messages[number]._replace(data=data)

    def kept(self) -> list[PlayMessage]:
        return []

    def messages(self) -> Iterator[PlayMessage]:
        return iter(self._messages)


class RecordingOutput:
    """Records what was published, and when."""

    def __init__(self, clock: Clock) -> None:
        self.now = clock.now
        self.messages: list[tuple[float, str, str]] = []
        self.times: list[int] = []
        self.after: Callable[[], None] = lambda: None
        self._moving = False

    def put(self, topic: PlayTopic, data: bytes) -> None:
        self.messages.append((round(self.now() - 5000.0, 3), topic.name, data.decode()))
        self._moving |= topic.command
        self.after()

    def clock(self, time_ns: int) -> None:
        self.times.append(time_ns - START)

    def end_velocities(self) -> bool:
        moving, self._moving = self._moving, False
        if moving:
            self.messages.append((round(self.now() - 5000.0, 3), "/cmd_vel", "zero"))
        return moving

    def received_on(self, name: str) -> list[tuple[float, str]]:
        return [(at, data) for at, messages, data in self.messages if messages == name]


class Stage:
    """A player of messages in memory, on a clock that the test advances."""

    def __init__(self, *messages: tuple[float, PlayTopic], paused: bool = False, **more: Any) -> None:
        self.clock = Clock()
        self.recorded = RecordingOutput(self.clock)
        self.reports: list[str] = []
        self.wait: Wait = self.clock.wait
        self.timeline = Timeline(paused=paused, now=self.clock.now, wait=lambda *given: self.wait(*given))
        self.tape = Tape(*messages)
        self.player = Player(self.tape, self.recorded, self.timeline, report=self.reports.append, **more)


def test_each_message_is_played_at_its_time_and_a_velocity_ends_with_zero() -> None:
    stage = Stage((0.0, SCAN), (0.5, DRIVE), (1.0, SCAN))
    stage.player.run()
    assert stage.recorded.messages == [
        (0.0, "/scan", "0.0"), (0.5, "/cmd_vel", "0.5"), (1.0, "/scan", "1.0"), (1.0, "/cmd_vel", "zero"),
    ]  # fmt: skip
    assert stage.player.played == {"/scan": 2, "/cmd_vel": 1}
    assert not stage.player.dropped


def test_late_commands_are_dropped_and_others_are_played_late_and_reported() -> None:
    stage = Stage((0.0, SCAN), *((0.1 * n, DRIVE) for n in range(1, 9)), (0.9, SCAN))

    def stall() -> None:
        stage.clock.seconds += 0.7
        stage.recorded.after = lambda: None

    stage.recorded.after = stall
    stage.player.run()
    # at 0.7 s, the message of 0.1 s is far too late: the bag time is set back to it, and the later intervals are kept
    assert stage.recorded.received_on("/cmd_vel")[:2] == [(0.8, "0.2"), (0.9, "0.30000000000000004")]
    assert stage.player.dropped == {("/cmd_vel", "late"): 1}
    assert [data for _, data in stage.recorded.received_on("/scan")] == ["0.0", "0.9"]
    assert stage.reports == ["playback cannot keep up with a rate of 1: 0.6 s behind so far"]


def test_slightly_late_commands_are_not_published_in_a_burst() -> None:
    stage = Stage((0.0, SCAN), *((0.02 * n, DRIVE) for n in range(1, 11)))

    def stall() -> None:
        stage.clock.seconds += 0.19
        stage.recorded.after = lambda: None

    stage.recorded.after = stall
    stage.player.run()
    assert stage.player.dropped == {("/cmd_vel", "late"): 4}
    assert stage.reports == []


@pytest.mark.parametrize(("name", "head"), [("Twist", b"\0\1\0\0"), ("TwistStamped", b"\0\1\0\0" + bytes(16))])
@pytest.mark.parametrize("stall", [0.19, 0.7])
def test_a_late_zero_velocity_is_played(name: str, head: bytes, stall: float) -> None:
    type_name = f"geometry_msgs/msg/{name}"
    drive = PlayTopic(
        BagTopic("/cmd_vel", type_name, World.ROS2), "/cmd_vel", type_name, "", None, "", Qos(), command=True
    )
    moving, zero = (head + struct.pack("<6d", x, 0.0, 0.0, 0.0, 0.0, 0.0) for x in (2.0, 0.0))
    stage = Stage((0.0, SCAN), (0.02, drive), (0.03, drive))
    if stall > 0.5:  # the bag's time is set back to the first message, and only that one is late
        stage.tape.move(zero, moving)
    else:
        stage.tape.move(moving, zero)

    def wait() -> None:
        stage.clock.seconds += stall
        stage.recorded.after = lambda: None

    stage.recorded.after = wait
    stage.player.run()
    assert stage.recorded.received_on("/cmd_vel")[0] == (stall, zero.decode())
    assert stage.player.dropped == ({} if stall > 0.5 else {("/cmd_vel", "late"): 1})


def test_a_pause_ends_a_velocity_and_drops_old_commands() -> None:
    stage = Stage((0.0, DRIVE), (0.1, DRIVE), (5.0, DRIVE))
    calls: list[float | None] = []

    def wait(condition: threading.Condition, seconds: float | None) -> None:
        calls.append(seconds)
        if len(calls) == 2:  # while the player waits for the third message
            stage.clock.seconds += 1.0
            stage.timeline.pause(True)
        elif seconds is None:
            stage.clock.seconds += 60.0
            stage.timeline.pause(False)
        else:
            stage.clock.wait(condition, seconds)

    stage.wait = wait
    stage.player.run()
    assert stage.recorded.received_on("/cmd_vel") == [
        (0.0, "0.0"), (0.1, "0.1"), (1.1, "zero"), (65.0, "5.0"), (65.0, "zero"),
    ]  # fmt: skip


def test_a_velocity_that_was_due_before_a_pause_is_not_published_after_it() -> None:
    def halted_meanwhile(data: bytes) -> bytes:
        stage.timeline.pause(True)  # as a halt does on another thread, while this one is starved
        stage.wait = lambda *_: stage.timeline.stop()
        return data

    stage = Stage((0.0, DRIVE), (0.1, topic("/cmd_vel", command=True, convert=halted_meanwhile)))
    stage.player.run()
    assert stage.recorded.received_on("/cmd_vel") == [(0.0, "0.0"), (0.1, "zero")]
    assert stage.player.dropped == {("/cmd_vel", "paused"): 1}


def test_a_step_skips_commands_and_publishes_the_time() -> None:
    stage = Stage((0.0, DRIVE), (0.1, DRIVE), (0.2, SCAN), (0.3, SCAN), paused=True)
    stage.timeline.step()
    stage.wait = lambda *_: stage.timeline.stop()
    stage.player.run()
    assert [(name, data) for _, name, data in stage.recorded.messages] == [("/scan", "0.2")]
    assert stage.player.dropped == {("/cmd_vel", "stepped"): 2}
    assert stage.recorded.times == [0, NS // 5]


def test_a_stop_in_the_middle_ends_the_velocity() -> None:
    stage = Stage((0.0, DRIVE), (10.0, SCAN))
    stage.recorded.after = stage.timeline.stop
    stage.player.run()
    assert [data for _, _, data in stage.recorded.messages] == ["0.0", "zero"]
    assert stage.player.loops == 0


def test_the_velocity_ends_at_the_damage_of_a_bag(tmp_path: Path) -> None:
    stage = Stage((0.0, DRIVE), (1.0, DRIVE))
    messages = stage.tape.messages

    def damaged() -> Iterator[PlayMessage]:
        yield from messages()
        raise BagError(tmp_path, "is damaged", 17)

    stage.tape.messages = damaged  # type: ignore[method-assign]
    with pytest.raises(BagError, match="byte 17"):
        stage.player.run()
    assert [data for _, _, data in stage.recorded.messages] == ["0.0", "1.0", "zero"]


def test_each_loop_ends_the_velocity_and_has_a_minimum_duration() -> None:
    stage = Stage((0.0, DRIVE), loop=True)

    def third() -> None:
        if len(stage.recorded.messages) == 5:
            stage.timeline.stop()

    stage.recorded.after = third
    stage.player.run()
    assert [at for at, _, data in stage.recorded.messages if data != "zero"] == [0.0, LEAST_SECONDS, 2 * LEAST_SECONDS]
    assert [data for _, _, data in stage.recorded.messages] == ["0.0", "zero"] * 3


def test_invalid_messages_are_skipped_and_reported_once() -> None:
    def refuse(_: bytes) -> bytes:
        raise ConversionError("it ends early")

    stage = Stage((0.0, topic("/bad", convert=refuse)), (0.1, topic("/bad", convert=refuse)), (0.2, SCAN))
    stage.player.run()
    assert stage.player.dropped == {("/bad", "bad"): 2}
    assert stage.reports == ["/bad: a message was skipped: it ends early"]
    assert stage.player.played == {"/scan": 1}


@pytest.mark.parametrize(("err", "goes_on"), [(HubError("too large"), True), (HubClosedError("gone"), False)])
def test_a_refused_message_is_skipped_and_a_lost_hub_ends_the_play(err: HubError, goes_on: bool) -> None:
    stage = Stage((0.0, SCAN), (0.1, SCAN))

    def refuse() -> None:
        stage.recorded.after = lambda: None
        raise err

    stage.recorded.after = refuse
    if goes_on:
        stage.player.run()
        assert stage.player.dropped == {("/scan", "bad"): 1}
        assert stage.player.played == {"/scan": 1}
    else:
        with pytest.raises(HubClosedError):
            stage.player.run()


COMMANDS = [
    ("/cmd_vel", "geometry_msgs/msg/Twist"),
    ("/anything", "geometry_msgs/msg/TwistStamped"),
    ("/move_base_simple/goal", "geometry_msgs/msg/PoseStamped"),
    ("/goal_pose", "geometry_msgs/msg/PoseStamped"),
    ("/move_base/goal", "move_base_msgs/msg/MoveBaseActionGoal"),
    ("/move_base/cancel", "actionlib_msgs/msg/GoalID"),
    ("/arm/drive", "std_msgs/msg/Float64"),
    ("/wheels", "my_msgs/msg/Wheels"),
    ("/drive", "my_msgs/msg/Twist"),
]
HARMLESS = [
    ("/pose", "geometry_msgs/msg/PoseStamped"),
    ("/initialpose", "geometry_msgs/msg/PoseWithCovarianceStamped"),
    ("/move_base/feedback", "move_base_msgs/msg/MoveBaseActionFeedback"),
    ("/move_base/status", "actionlib_msgs/msg/GoalStatusArray"),
    ("/odom", "nav_msgs/msg/Odometry"),
    ("/arm/state", "std_msgs/msg/Float64"),
    ("/velocity", "geometry_msgs/msg/TwistWithCovarianceStamped"),
]


@pytest.mark.parametrize(
    ("name", "type_name", "moves"), [*((*item, True) for item in COMMANDS), *((*item, False) for item in HARMLESS)]
)
def test_commands_are_recognized_by_type_role_and_rules(name: str, type_name: str, moves: bool) -> None:
    rules = [
        {"topic": "/arm/drive", "type": "std_msgs/msg/Float64", "priority": "command"},
        {"topic": "/wheels", "priority": "command"},
    ]
    moving = CommandTopics(Config.model_validate({"routing": {"rules": rules}}))
    assert moving.has(name, type_name) is moves


def chosen(
    path: Path, stack: ExitStack, config: Config | None = None, **wanted: Any
) -> tuple[dict[Any, list[PlayTopic]], list[LeftOut]]:
    choice = PlayChoice(**{"name": lambda _: True, "remap": {}, **wanted})
    return choose([stack.enter_context(open_bag(path))], REGISTRY, config or Config(), choice)


DRIVING = [
    Said(0.0, "/scan", "sensor_msgs/LaserScan", {"ranges": [1.0]}),
    Said(0.1, "/cmd_vel", TWIST, {"linear": {"x": 0.5}}),
    Said(0.2, "/move_base_simple/goal", "geometry_msgs/PoseStamped", {}),
    Said(0.3, "/clock", "rosgraph_msgs/Clock", {}),
    Said(0.4, "no/slash", TEXT, {}),
]


@pytest.fixture(scope="module")
def driving(tmp_path_factory: pytest.TempPathFactory) -> Path:
    latched = ("/cmd_vel", "/scan")
    return write_bag(tmp_path_factory.mktemp("bags") / "driving.bag", DRIVING, latched)


def test_commands_are_left_out_and_reported_unless_requested(driving: Path) -> None:
    with ExitStack() as stack:
        chosen_, left = chosen(driving, stack)
        names = {topic.name for topics in chosen_.values() for topic in topics}
        assert names == {"/scan", "/clock", "/no/slash"}
        assert [(item.name, item.command) for item in left] == [("/cmd_vel", True), ("/move_base_simple/goal", True)]


def test_requested_commands_are_never_latched(driving: Path) -> None:
    with ExitStack() as stack:
        chosen_, left = chosen(driving, stack, commands=True, clock=True)
        topics = {topic.name: topic for topics_ in chosen_.values() for topic in topics_}
        assert [(item.name, item.why) for item in left] == [("/clock", "--clock replaces it")]
        drive = topics["/cmd_vel"]
        assert (drive.command, drive.velocity, drive.priority) == (True, True, "command")
        assert drive.qos.durability is Durability.VOLATILE
        assert topics["/scan"].qos.latched
        assert (topics["/move_base_simple/goal"].command, topics["/move_base_simple/goal"].velocity) == (True, False)


def test_the_new_name_determines_commands(driving: Path) -> None:
    remap = {"/move_base_simple/goal": "/shown/place", "/cmd_vel": "/shown/velocity", "/scan": "/bad name"}
    with ExitStack() as stack:
        chosen_, left = chosen(driving, stack, remap=remap)
        names = {topic.name for topics in chosen_.values() for topic in topics}
        assert "/shown/place" in names
        assert {item.name for item in left} == {"/shown/velocity", "/bad name"}


def test_all_static_transforms_are_merged_at_the_start(tmp_path: Path) -> None:
    messages = [
        Said(0.0, "/tf_static", TF, {"transforms": [transform("base", "laser", x=1.0)]}),
        Said(1.0, "/tf_static", TF, {"transforms": [transform("base", "camera", x=2.0)]}),
        Said(1.5, "/tf_static", TF, {"transforms": [transform("base", "laser", x=3.0)]}),
        Said(2.0, "/tf", TF, {"transforms": [transform("odom", "base")]}),
    ]
    bag = write_bag(tmp_path / "tf.bag", messages, latched=["/tf_static"])
    with ExitStack() as stack:
        chosen_, _ = chosen(bag, stack)
        source = PlaySource(chosen_, PlayPart(start=0.5))
        kept = source.kept()
        assert [(item.topic.name, item.ready) for item in kept] == [("/tf_static", True)]
        transforms_ = to_json(REGISTRY, "tf2_msgs/msg/TFMessage", kept[0].data)["transforms"]
        places = {item["child_frame_id"]: item["transform"]["translation"]["x"] for item in transforms_}
        assert places == {"laser": 3.0, "camera": 2.0}
        assert [message.topic.name for message in source.messages()] == ["/tf"]
        assert source.kept() is kept


def test_static_transforms_are_played_despite_a_damaged_end(tmp_path: Path) -> None:
    messages = [
        Said(0.0, "/tf_static", TF, {"transforms": [transform("base", "laser")]}),
        *(Said(0.1 * n, "/said", TEXT, {"data": "x" * 100_000}) for n in range(1, 60)),
        Said(6.0, "/tf_static", TF, {"transforms": [transform("base", "camera")]}),
    ]
    bag = write_bag(tmp_path / "damaged.bag", messages, latched=["/tf_static"])
    data = bytearray(bag.read_bytes())
    data[1_300_000:1_450_000] = bytes(150_000)  # in the second chunk, over the header of a message
    bag.write_bytes(data)
    with ExitStack() as stack:
        chosen_, _ = chosen(bag, stack)
        source = PlaySource(chosen_, PlayPart())
        assert [item.topic.name for item in source.kept()] == ["/tf_static"]
        assert [str(bag) in trouble for trouble in source.troubles] == [True]


def test_messages_latched_before_the_start_are_played_and_a_part_ends_in_time(tmp_path: Path) -> None:
    messages = [
        *(Said(at, "/name", TEXT, {"data": f"name {at}"}) for at in (0.0, 1.0, 4.0)),
        *(Said(0.5 * n, "/said", TEXT, {"data": f"said {n}"}) for n in range(10)),
    ]
    bag = write_bag(tmp_path / "latched.bag", sorted(messages), latched=["/name"])
    with ExitStack() as stack:
        chosen_, _ = chosen(bag, stack)
        source = PlaySource(chosen_, PlayPart(start=2.0, duration=1.5))
        kept = [item.topic.convert(item.data) for item in source.kept() if item.topic.convert]
        assert [to_json(REGISTRY, "std_msgs/msg/String", data) for data in kept] == [{"data": "name 1.0"}]
        assert [(item.time_ns - START) / NS for item in source.messages()] == [2.0, 2.5, 3.0, 3.5]
        with pytest.raises(BagError, match=r"has 4\.5 s, but --start is 5"):
            PlaySource(chosen_, PlayPart(start=5.0))


def test_several_bags_are_merged_by_time(tmp_path: Path) -> None:
    bags = [
        write_bag(tmp_path / f"{name}.bag", [Said(at, f"/{name}", TEXT, {}) for at in times])
        for name, times in (("a", (1.0, 3.0)), ("b", (0.0, 2.0, 4.0)))
    ]
    with ExitStack() as stack:
        opened = [stack.enter_context(open_bag(bag)) for bag in bags]
        chosen_, _ = choose(opened, REGISTRY, Config(), PlayChoice(lambda _: True, {}))
        source = PlaySource(chosen_, PlayPart())
        assert [message.topic.name for message in source.messages()] == ["/b", "/a", "/b", "/a", "/b"]
        assert (source.end_ns - source.begin_ns) == 4 * NS
