"""Simulated time, and a simulated hub for the gateway's node."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

from bridge.hub.endpoints.calls import CallError


class Clock:
    """Simulated time, and the calls that are due."""

    def __init__(self) -> None:
        self.now = 1000.0
        self._due: list[tuple[float, int, Callable[[], Any]]] = []
        self._numbers = itertools.count()

    def monotonic(self) -> float:
        return self.now

    @property
    def pending(self) -> bool:
        """Whether any call is due later."""
        return bool(self._due)

    def after(self, seconds: float, action: Callable[[], Any]) -> None:
        heapq.heappush(self._due, (self.now + seconds, next(self._numbers), action))

    def run_to(self, end: float) -> None:
        while self._due and self._due[0][0] <= end:
            self.now, _, action = heapq.heappop(self._due)
            action()
        self.now = end


class Timer:
    """A timer of the gateway's loop."""

    def __init__(self) -> None:
        self.closed = False

    def close(self) -> None:
        self.closed = True


class Loop:
    """The gateway's thread."""

    def __init__(self, clock: Clock) -> None:
        self._clock, self.dead = clock, False
        self._stalled_until = 0.0

    def stall(self, seconds: float) -> None:
        """Run nothing for a time; actions that become due run afterwards, in order."""
        self._stalled_until = self._clock.now + seconds

    @property
    def stalled(self) -> bool:
        """Whether it runs nothing now."""
        return self._clock.now < self._stalled_until

    def _run(self, timer: Timer, action: Callable[[], Any]) -> None:
        if self.stalled:
            self._clock.after(self._stalled_until - self._clock.now, lambda: self._run(timer, action))
        elif not (self.dead or timer.closed):
            action()

    def post(self, action: Callable[[], Any]) -> None:
        self.after(0.0, action)

    def after(self, seconds: float, action: Callable[[], Any]) -> Timer:
        timer = Timer()
        self._clock.after(seconds, lambda: self._run(timer, action))
        return timer

    def every(self, seconds: float, action: Callable[[], Any]) -> Timer:
        timer = Timer()

        def run() -> None:
            action()
            if not timer.closed:
                self._clock.after(seconds, lambda: self._run(timer, run))

        self._clock.after(seconds, lambda: self._run(timer, run))
        return timer


@dataclass
class Hub:
    """Tokens, latched messages and servers, as all sessions see them."""

    publishers: dict[str, set[bytes]] = field(default_factory=dict)
    servers: dict[str, Callable[[dict[str, Any], Callable[[Any], None]], None]] = field(default_factory=dict)
    gids: dict[str, bytes] = field(default_factory=dict)  # of the servers
    latched: dict[str, tuple[bytes, Any]] = field(default_factory=dict)
    subscriptions: dict[str, list[Subscription]] = field(default_factory=dict)
    sides: set[str] = field(default_factory=set)

    def publish(self, topic: str, gid: bytes, message: Any, *, keep: bool = True) -> None:
        if keep:
            self.latched[topic] = gid, message
        for subscription in list(self.subscriptions.get(topic, ())):
            subscription.deliver(gid, message)


class Subscription:
    """A subscription of the gateway's node."""

    def __init__(self, node: Node, topic: str, receive: Callable[[Any], None]) -> None:
        self._node, self._receive, self.topic = node, receive, topic
        self.sender = b""
        node.hub_state.subscriptions.setdefault(topic, []).append(self)
        if topic in node.hub_state.latched:
            gid, message = node.hub_state.latched[topic]
            node.loop.after(0.02, lambda: self._give(gid, message))

    def deliver(self, gid: bytes, message: Any) -> None:
        self._node.loop.after(0.005, lambda: self._give(gid, message))

    def _give(self, gid: bytes, message: Any) -> None:
        if self in self._node.hub_state.subscriptions.get(self.topic, ()):
            self.sender = gid
            self._receive(message)


class Client:
    """A service client of the gateway's node."""

    def __init__(self, node: Node, name: str) -> None:
        self._node, self._name = node, name
        self._pending: dict[int, Callable[[Any], None]] = {}

    @property
    def ready(self) -> bool:
        return self._name in self._node.hub_state.servers

    def call(self, request: dict[str, Any], replied: Callable[[Any], None]) -> Callable[[], None]:
        server = self._node.hub_state.servers.get(self._name)

        def answer(reply: Any) -> None:
            self._node.loop.after(0.005, lambda: replied(reply))

        if server is None:
            answer(CallError(f"{self._name} has no server"))
        else:
            server(request, answer)
        return lambda: None


class Node:
    """The gateway's node on the hub."""

    def __init__(self, hub: Hub, loop: Loop) -> None:
        self.hub_state, self.loop = hub, loop
        graph = SimpleNamespace(
            publishers=lambda topic: [SimpleNamespace(gid=gid) for gid in hub.publishers.get(topic, ())],
            servers=lambda name: [SimpleNamespace(gid=hub.gids[name])] if name in hub.servers else [],
            subscriptions=lambda _topic: [],
            velocities=list,
            origins=lambda: {side: SimpleNamespace(side=side) for side in hub.sides},
        )
        self.hub = SimpleNamespace(graph=graph, zid="gateway")

    def subscription(self, topic: str, _type: str, receive: Callable[[Any], None], _qos: Any = None) -> Subscription:
        return Subscription(self, topic, receive)

    def subscription_cdr(self, topic: str, *args: Any, **_options: Any) -> Subscription:
        return Subscription(self, topic, args[1])

    def client(self, name: str, _type: str) -> Client:
        return Client(self, name)

    def release(self, endpoint: Any) -> None:
        if isinstance(endpoint, Subscription):
            self.hub_state.subscriptions[endpoint.topic].remove(endpoint)
