"""The action ``tf2_buffer_server`` and the service ``tf2_frames``, called by another node of the hub."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import yaml

from bridge.clock import RunClock, SystemClock
from bridge.messages.actions import GoalState
from bridge.tf.buffer import TransformBuffer
from bridge.transform_server.buffer_server import ACTION, FRAME_GRAPH, FRAMES, LOOKUP, BufferServer
from tests.modules.test_actions import NodePair
from tests.support.wait import until

S = 1_000_000_000
START = 1_790_000_000 * S
UNIT = (0.0, 0.0, 0.0, 1.0)
SECOND, HOUR = {"sec": 1}, {"sec": 3600}


class Served:
    """A buffer with its server, and a client."""

    def __init__(self) -> None:
        self.two = NodePair()
        self.buffer = TransformBuffer()
        self.clock = RunClock(simulated=True)
        self.set_time(START)
        self.two.server.clock = self.clock
        self.server = self.two.on(self.two.server, lambda: BufferServer(self.two.server, self.buffer))
        self.client = self.two.client.action_client(ACTION, LOOKUP)
        until(lambda: self.client.ready, "the server is discovered")

    def set_time(self, now: int) -> None:
        """Set the simulated time, in nanoseconds."""
        seconds, nanoseconds = divmod(now, S)
        self.clock.receive(b"\0\1\0\0" + seconds.to_bytes(4, "little") + nanoseconds.to_bytes(4, "little"))

    def lookup(self, target: str, source: str, stamp: int = 0, **more: Any) -> list[Any]:
        """Send a goal; return the list to which its end is appended."""
        ends: list[Any] = []
        goal = {"target_frame": target, "source_frame": source, "source_time": time(stamp), **more}
        self.two.on(self.two.client, lambda: self.client.send(goal, lambda *end: ends.append(end)))
        return ends

    def answer(self, *served: Any, **more: Any) -> Any:
        """Return the result of a goal that ends at once."""
        return result(self.lookup(*served, **more))

    def wait_for_waiting(self, count: int = 1) -> None:
        until(lambda: self.two.on(self.two.server, self.server.status)["waiting"] == count, f"{count} lookups wait")


def result(ends: list[Any]) -> Any:
    goal, result, error = until(lambda: ends, "the goal ends")[0]
    assert goal.status is GoalState.SUCCEEDED, error
    return result


def time(stamp: int) -> dict[str, int]:
    return dict(zip(("sec", "nanosec"), divmod(stamp, S), strict=True))


@pytest.fixture
def served() -> Iterator[Served]:
    server = Served()
    try:
        yield server
    finally:
        server.two.close()


def moving(buffer: TransformBuffer, parent: str, child: str) -> None:
    for n in range(11):
        buffer.set_transform(parent, child, START + n * S // 10, (n / 10, 0, 0), UNIT, "mover")


def test_known_transforms_are_returned_at_once(served: Served) -> None:
    moving(served.buffer, "map", "base")
    served.buffer.set_transform("base", "laser", 0, (0, 2, 0), (0.0, 0.0, 0.6, 0.8), "urdf", static=True)
    transform = served.answer("map", "laser", START + S // 4)
    assert transform["error"] == {"error": 0, "error_string": ""}
    assert transform["transform"] == {
        "header": {"stamp": time(START + S // 4), "frame_id": "map"},
        "child_frame_id": "laser",
        "transform": {
            "translation": {"x": 0.25, "y": 2, "z": 0},
            "rotation": {"x": 0, "y": 0, "z": pytest.approx(0.6), "w": pytest.approx(0.8)},
        },
    }
    full = {"advanced": True, "target_time": time(START + S), "fixed_frame": "map"}
    transform = served.answer("base", "base", START, **full)
    assert transform["transform"]["transform"]["translation"]["x"] == pytest.approx(-1)


def test_errors_have_tf2s_codes_and_texts(served: Served) -> None:
    moving(served.buffer, "map", "base")
    served.buffer.set_transform("moon", "crater", 0, (0, 0, 0), UNIT, static=True)
    for question, code, message in (
        (("map", "nowhere"), 1, "does not exist"),
        (("map", "crater"), 2, "two or more unconnected trees"),
        (("map", "base", START + 9 * S), 3, "into the future"),
        (("map", ""), 4, "cannot be empty"),
    ):
        error_ = served.answer(*question)["error"]
        assert (error_["error"], message in error_["error_string"]) == (code, True), error_
    assert served.answer("map", "", timeout=HOUR)["error"]["error"] == 4, "waiting cannot help"
    served.buffer.set_transform("base", "map", 0, (0, 0, 0), UNIT, static=True)
    error_ = served.answer("map", "crater", START)["error"]
    assert (error_["error"], "loop" in error_["error_string"]) == (1, True), error_
    assert served.server.status() == {"waiting": 0, "failed": 6}


def test_lookups_wait_for_transforms_until_their_time_limit(served: Served) -> None:
    patient = [served.lookup("map", "base", START + n * S // 20, timeout=HOUR) for n in range(20)]
    hasty = served.lookup("map", "base", timeout=SECOND)
    served.wait_for_waiting(21)
    served.set_time(START + S - 1)
    served.buffer.set_transform("map", "odom", START, (0, 0, 0), UNIT)
    served.set_time(START + S)
    assert result(hasty)["error"]["error"] == 1
    served.wait_for_waiting(20)
    assert not any(patient)
    moving(served.buffer, "map", "base")
    for n, ends in enumerate(patient):
        assert result(ends)["transform"]["transform"]["translation"]["x"] == pytest.approx(n / 20)
    assert served.server.status() == {"waiting": 0, "found": 20, "failed": 1}
    until(lambda: served.server._timer is None, "the server no longer polls")


def test_a_clock_that_is_set_back_ends_waiting_lookups(served: Served) -> None:
    ends = served.lookup("map", "base", timeout=SECOND)
    served.wait_for_waiting()
    served.set_time(5 * S)
    assert result(ends)["error"]["error"] == 1


def test_a_waiting_lookup_is_canceled(served: Served) -> None:
    ends = served.lookup("map", "base", timeout=HOUR)
    served.wait_for_waiting()
    served.two.on(served.two.client, served.client.cancel)
    until(lambda: ends, "the goal ends")
    assert ends[0][0].status is GoalState.CANCELED
    served.wait_for_waiting(0)


def test_frames_are_returned_in_tf2s_format(served: Served) -> None:
    moving(served.buffer, "map", "no")  # a name that YAML would read as another value
    served.buffer.set_transform("no", "laser", 0, (0, 2, 0), UNIT, static=True)
    client = served.two.client.client(FRAMES, FRAME_GRAPH)
    until(lambda: client.ready, "the server is discovered")
    replies: list[Any] = []
    client.call({}, replies.append)
    frames = yaml.safe_load(until(lambda: replies, "a reply arrives")[0]["frame_yaml"])
    assert frames["no"] == {
        "parent": "map",
        "broadcaster": "mover",
        "rate": 11.0,
        "most_recent_transform": START / S + 1,
        "oldest_transform": START / S,
        "buffer_length": 1.0,
    }
    assert frames["laser"]["rate"] == 10000.0
    assert frames["laser"]["broadcaster"] == "no recorded authority"
    assert yaml.safe_load(TransformBuffer().yaml()) == {}


def test_the_time_limit_of_a_lookup_does_not_depend_on_the_system_clock(served: Served) -> None:
    now = [START]
    served.two.server.clock = RunClock(system=SystemClock(lambda: now[0], poll=0))
    patient = served.lookup("map", "base", timeout=HOUR)
    served.wait_for_waiting()
    for jump in (-2 * 3600 * S, 5 * 3600 * S):
        now[0] += jump
        served.buffer.set_transform("map", "other", now[0], (0, 0, 0), UNIT)
        hasty = served.lookup("map", "base", timeout={"nanosec": S // 10})
        assert result(hasty)["error"]["error"] == 1
    assert not patient
    served.buffer.set_transform("map", "base", now[0], (0, 0, 0), UNIT)
    assert result(patient)["error"]["error"] == 0
