"""Requests that wait until the origin of their client is known."""

from __future__ import annotations

import errno
from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.adapters.ros2.rcl import RequestId
from bridge.adapters.ros2.services import held
from bridge.adapters.ros2.services.held import MOST_HELD, PATIENCE_SECONDS, HeldRequests
from bridge.routing.edge import MadeBy

CLIENT, OTHER = bytes(range(16)), bytes(range(1, 17))


@dataclass
class Server:
    """A server that records what it executes and drops."""

    world: World
    name: str

    def execute(self, request: RequestId, _payload: bytes, _backlog: int) -> None:
        self.world.executed.append((self.name, request.number))
        self.world.executing(request)

    def drop(self, reason: str) -> None:
        self.world.failures.append(reason)


class World:
    """A clock, delayed calls that `advance` makes, and what is known of the clients."""

    def __init__(self) -> None:
        self.now = 0.0
        self.marked = self.listed = MadeBy.UNKNOWN
        self.reads = 0
        self.due: list[Any] = []
        self.executed: list[tuple[str, int]] = []
        self.failures: list[str] = []
        self.executing: Callable[[RequestId], None] = lambda _request: None
        later: Any = self
        self.requests = HeldRequests(later, later, lambda _gid: self.marked)

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

    def receive(self, number: int, service: str = "/lamp", client: bytes = CLIENT) -> None:
        self.requests.receive(Server(self, service), RequestId(client, number), b"", 1)


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> World:
    world = World()
    monkeypatch.setattr(held, "time", SimpleNamespace(monotonic=lambda: world.now))
    return world


def test_requests_of_a_native_client_are_served_in_order(world: World) -> None:
    for number in range(3):
        world.receive(number)
    world.advance(0.1)
    assert world.executed == []
    world.marked = MadeBy.NATIVE
    world.advance(0.1)
    assert (world.executed, world.due, world.failures) == ([("/lamp", n) for n in range(3)], [], [])


def test_a_cancel_request_does_not_overtake_its_goal(world: World) -> None:
    world.receive(1, "/drive/_action/send_goal")
    world.marked = MadeBy.NATIVE
    world.receive(2, "/drive/_action/cancel_goal")
    world.receive(3, client=OTHER)
    world.advance(0.1)
    assert world.executed == [("/lamp", 3), ("/drive/_action/send_goal", 1), ("/drive/_action/cancel_goal", 2)]
    world.receive(4)
    assert world.executed[-1] == ("/lamp", 4)


def test_a_request_that_arrives_while_the_last_held_one_is_served_follows_it(world: World) -> None:
    world.receive(1)
    world.marked = MadeBy.NATIVE
    order: list[str] = []

    def executing(request: RequestId) -> None:
        order.append(f"{request.number} begins")
        if request.number == 1:
            world.receive(2)
        order.append(f"{request.number} ends")

    world.executing = executing
    world.advance(0.1)
    assert order == ["1 begins", "1 ends", "2 begins", "2 ends"]


def test_requests_of_midspan_are_dropped_silently(world: World) -> None:
    world.receive(1)
    world.marked = MadeBy.MIDSPAN
    world.advance(0.1)
    assert (world.executed, world.due, world.failures) == ([], [], [])


def test_held_requests_are_dropped_with_a_reason_after_some_seconds(world: World) -> None:
    world.receive(1)
    world.advance(PATIENCE_SECONDS - 0.1)
    assert world.due
    world.advance(0.2)
    assert world.failures == ["the origin of its client is still unknown"]
    assert (world.executed, world.due) == ([], [])


def test_held_requests_are_served_after_an_error_of_the_graph(world: World) -> None:
    def read(_service: str, _prefix: bytes) -> MadeBy:
        raise OSError(errno.EMFILE, "Too many open files")

    world.receive(1)
    graph: Any = world
    client_made_by, graph.client_made_by = graph.client_made_by, read
    with pytest.raises(OSError, match="Too many"):
        world.advance(0.1)
    graph.client_made_by = client_made_by
    world.listed = MadeBy.NATIVE
    world.advance(0.1)
    assert world.executed == [("/lamp", 1)]


def test_the_number_of_held_requests_is_limited(world: World) -> None:
    for number in range(MOST_HELD + 1):
        world.receive(number, client=CLIENT if number % 2 else OTHER)
    (failure,) = world.failures
    assert f"{MOST_HELD} requests already wait" in failure
    world.marked = MadeBy.NATIVE
    world.advance(0.1)
    assert len(world.executed) == MOST_HELD


def test_a_client_that_only_the_graph_knows_is_read_once(world: World) -> None:
    world.receive(1)
    assert (world.reads, world.executed) == (1, [])
    world.listed = MadeBy.NATIVE
    world.advance(0.1)
    for number in (2, 3):
        world.receive(number)
    assert world.executed == [("/lamp", n) for n in (1, 2, 3)]
    assert world.reads == 2
