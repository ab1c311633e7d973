"""Requests that wait until the origin of their client is known."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from bridge.adapters.ros2.rcl import RequestId
from bridge.adapters.ros2.services import held
from bridge.adapters.ros2.services.held import MOST_HELD, PATIENCE_SECONDS, HeldRequests
from bridge.routing.edge import MadeBy

CLIENT = bytes(range(16))


class World:
    """A clock, a thread without time, and what is known of the clients."""

    def __init__(self) -> None:
        self.now = 0.0
        self.marked = self.listed = MadeBy.UNKNOWN
        self.reads = 0
        self.due: list[Any] = []
        self.accepted: list[int] = []
        self.failures: list[str] = []

    def after(self, _seconds: float, call: Any, *, once: bool = False) -> None:
        assert once
        if call not in self.due:
            self.due.append(call)

    def client_made_by(self, _service: str, _prefix: bytes) -> MadeBy:
        self.reads += 1
        return self.listed

    def advance(self, seconds: float) -> None:
        """Let time pass, and make the scheduled calls."""
        self.now += seconds
        due, self.due = self.due, []
        for call in due:
            call()

    def requests(self) -> HeldRequests:
        marks = SimpleNamespace(made_by=lambda _gid: self.marked)
        context: Any = SimpleNamespace(graph=self, later=self, participant=SimpleNamespace(marks=marks))
        return HeldRequests("/lamp", context, lambda r, *_: self.accepted.append(r.number), self.failures.append)


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> World:
    world = World()
    monkeypatch.setattr(held, "time", SimpleNamespace(monotonic=lambda: world.now))
    return world


def test_requests_of_a_native_client_are_served_in_order(world: World) -> None:
    requests = world.requests()
    for number in range(3):
        requests.hold(RequestId(CLIENT, number), b"", 1)
    world.advance(0.1)
    assert world.accepted == []
    world.marked = MadeBy.NATIVE
    world.advance(0.1)
    assert (world.accepted, world.due, world.failures) == ([0, 1, 2], [], [])


def test_requests_of_midspan_are_dropped_silently(world: World) -> None:
    requests = world.requests()
    requests.hold(RequestId(CLIENT, 1), b"", 1)
    world.marked = MadeBy.MIDSPAN
    world.advance(0.1)
    assert (world.accepted, world.due, world.failures) == ([], [], [])


def test_after_some_seconds_they_are_dropped_with_a_reason(world: World) -> None:
    requests = world.requests()
    requests.hold(RequestId(CLIENT, 1), b"", 1)
    world.advance(PATIENCE_SECONDS - 0.1)
    assert world.due
    world.advance(0.2)
    assert world.failures == ["the origin of its client is still unknown"]
    assert (world.accepted, world.due) == ([], [])


def test_their_number_is_limited(world: World) -> None:
    requests = world.requests()
    for number in range(MOST_HELD + 1):
        requests.hold(RequestId(CLIENT, number), b"", 1)
    (failure,) = world.failures
    assert f"{MOST_HELD} requests already wait" in failure
    world.marked = MadeBy.NATIVE
    world.advance(0.1)
    assert len(world.accepted) == MOST_HELD


def test_a_client_that_only_the_graph_knows_is_read_once(world: World) -> None:
    requests = world.requests()
    assert requests.made_by(CLIENT) is MadeBy.UNKNOWN
    world.listed = MadeBy.NATIVE
    assert [requests.made_by(CLIENT) for _ in range(3)] == [MadeBy.NATIVE] * 3
    assert world.reads == 2
