"""The action ``tf2_buffer_server`` and the service ``tf2_frames``, asked by another node of the hub."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import yaml

from bridge.clock import RunClock, SystemClock
from bridge.messages.actions import GoalState
from bridge.tf.buffer import TransformBuffer
from bridge.tf.server.buffer_server import ACTION, FRAME_GRAPH, FRAMES, LOOKUP, BufferServer
from tests.modules.test_actions import Two
from tests.support.wait import until

S = 1_000_000_000
START = 1_790_000_000 * S
UNIT = (0.0, 0.0, 0.0, 1.0)
SECOND, HOUR = {"sec": 1}, {"sec": 3600}


class Asked:
    """A buffer that is served, and a client of it."""

    def __init__(self) -> None:
        self.two = Two()
        self.buffer = TransformBuffer()
        self.clock = RunClock(simulated=True)
        self.at(START)
        self.two.server.clock = self.clock
        self.server = self.two.on(self.two.server, lambda: BufferServer(self.two.server, self.buffer))
        self.client = self.two.client.action_client(ACTION, LOOKUP)
        until(lambda: self.client.ready, "there is a server")

    def at(self, now: int) -> None:
        """Simulated time goes on."""
        seconds, rest = divmod(now, S)
        self.clock.receive(b"\0\1\0\0" + seconds.to_bytes(4, "little") + rest.to_bytes(4, "little"))

    def lookup(self, target: str, source: str, stamp: int = 0, **more: Any) -> list[Any]:
        """Ends of one goal: they come later."""
        ends: list[Any] = []
        goal = {"target_frame": target, "source_frame": source, "source_time": time(stamp), **more}
        self.two.on(self.two.client, lambda: self.client.send(goal, lambda *end: ends.append(end)))
        return ends

    def answer(self, *asked: Any, **more: Any) -> Any:
        """The result of a goal that ends at once."""
        return result(self.lookup(*asked, **more))

    def waits(self, count: int = 1) -> None:
        until(lambda: self.two.on(self.two.server, self.server.status)["waiting"] == count, "so many wait")


def result(ends: list[Any]) -> Any:
    goal, result, why = until(lambda: ends, "the goal ends")[0]
    assert goal.status is GoalState.SUCCEEDED, why
    return result


def time(stamp: int) -> dict[str, int]:
    return dict(zip(("sec", "nanosec"), divmod(stamp, S), strict=True))


@pytest.fixture
def asked() -> Iterator[Asked]:
    made = Asked()
    try:
        yield made
    finally:
        made.two.close()


def moving(buffer: TransformBuffer, parent: str, child: str) -> None:
    for n in range(11):
        buffer.set_transform(parent, child, START + n * S // 10, (n / 10, 0, 0), UNIT, "mover")


def test_what_is_known_is_answered_at_once(asked: Asked) -> None:
    moving(asked.buffer, "map", "base")
    asked.buffer.set_transform("base", "laser", 0, (0, 2, 0), (0.0, 0.0, 0.6, 0.8), "urdf", static=True)
    found = asked.answer("map", "laser", START + S // 4)
    assert found["error"] == {"error": 0, "error_string": ""}
    assert found["transform"] == {
        "header": {"stamp": time(START + S // 4), "frame_id": "map"},
        "child_frame_id": "laser",
        "transform": {
            "translation": {"x": 0.25, "y": 2, "z": 0},
            "rotation": {"x": 0, "y": 0, "z": pytest.approx(0.6), "w": pytest.approx(0.8)},
        },
    }
    full = {"advanced": True, "target_time": time(START + S), "fixed_frame": "map"}
    found = asked.answer("base", "base", START, **full)
    assert found["transform"]["transform"]["translation"]["x"] == pytest.approx(-1)


def test_errors_have_tf2s_numbers_and_words(asked: Asked) -> None:
    moving(asked.buffer, "map", "base")
    asked.buffer.set_transform("moon", "crater", 0, (0, 0, 0), UNIT, static=True)
    for question, code, words in (
        (("map", "nowhere"), 1, "does not exist"),
        (("map", "crater"), 2, "two or more unconnected trees"),
        (("map", "base", START + 9 * S), 3, "into the future"),
        (("map", ""), 4, "cannot be empty"),
    ):
        said = asked.answer(*question)["error"]
        assert (said["error"], words in said["error_string"]) == (code, True), said
    assert asked.answer("map", "", timeout=HOUR)["error"]["error"] == 4, "there is nothing to wait for"
    asked.buffer.set_transform("base", "map", 0, (0, 0, 0), UNIT, static=True)
    said = asked.answer("map", "crater", START)["error"]
    assert (said["error"], "loop" in said["error_string"]) == (1, True), said
    assert asked.server.status() == {"waiting": 0, "failed": 6}


def test_lookups_wait_for_what_comes_and_no_longer_than_they_may(asked: Asked) -> None:
    patient = [asked.lookup("map", "base", START + n * S // 20, timeout=HOUR) for n in range(20)]
    hasty = asked.lookup("map", "base", timeout=SECOND)
    asked.waits(21)
    asked.at(START + S - 1)
    asked.buffer.set_transform("map", "odom", START, (0, 0, 0), UNIT)
    asked.at(START + S)
    assert result(hasty)["error"]["error"] == 1
    asked.waits(20)
    assert not any(patient)
    moving(asked.buffer, "map", "base")
    for n, ends in enumerate(patient):
        assert result(ends)["transform"]["transform"]["translation"]["x"] == pytest.approx(n / 20)
    assert asked.server.status() == {"waiting": 0, "found": 20, "failed": 1}
    until(lambda: asked.server._timer is None, "it no longer polls")


def test_a_clock_that_is_set_back_ends_what_waits(asked: Asked) -> None:
    waits = asked.lookup("map", "base", timeout=SECOND)
    asked.waits()
    asked.at(5 * S)
    assert result(waits)["error"]["error"] == 1


def test_a_lookup_that_waits_is_cancelled(asked: Asked) -> None:
    ends = asked.lookup("map", "base", timeout=HOUR)
    asked.waits()
    asked.two.on(asked.two.client, asked.client.cancel)
    until(lambda: ends, "the goal ends")
    assert ends[0][0].status is GoalState.CANCELED
    asked.waits(0)


def test_the_frames_are_told_as_tf2_tells_them(asked: Asked) -> None:
    moving(asked.buffer, "map", "no")  # a word that YAML reads as another value
    asked.buffer.set_transform("no", "laser", 0, (0, 2, 0), UNIT, static=True)
    client = asked.two.client.client(FRAMES, FRAME_GRAPH)
    until(lambda: client.ready, "there is a server")
    replies: list[Any] = []
    client.call({}, replies.append)
    told = yaml.safe_load(until(lambda: replies, "a reply")[0]["frame_yaml"])
    assert told["no"] == {
        "parent": "map",
        "broadcaster": "mover",
        "rate": 11.0,
        "most_recent_transform": START / S + 1,
        "oldest_transform": START / S,
        "buffer_length": 1.0,
    }
    assert told["laser"]["rate"] == 10000.0
    assert told["laser"]["broadcaster"] == "no recorded authority"
    assert yaml.safe_load(TransformBuffer().yaml()) == {}


def test_the_time_limit_of_a_lookup_does_not_depend_on_the_system_clock(asked: Asked) -> None:
    now = [START]
    asked.two.server.clock = RunClock(system=SystemClock(lambda: now[0], poll=0))
    patient = asked.lookup("map", "base", timeout=HOUR)
    asked.waits()
    for jump in (-2 * 3600 * S, 5 * 3600 * S):
        now[0] += jump
        asked.buffer.set_transform("map", "other", now[0], (0, 0, 0), UNIT)
        hasty = asked.lookup("map", "base", timeout={"nanosec": S // 10})
        assert result(hasty)["error"]["error"] == 1
    assert not patient
    asked.buffer.set_transform("map", "base", now[0], (0, 0, 0), UNIT)
    assert result(patient)["error"]["error"] == 0
