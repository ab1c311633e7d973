"""A Midspan hub session in a separate process, controlled by a test. See `tests.peers.peer` for the format.

Argument: the settings in JSON. Commands: ``publisher`` and ``subscription`` topic, latched, depth -> id; ``put`` id,
text; ``drum`` id, rate, size, first: put numbers, until ``counted``; ``wait`` id, count, seconds -> texts; ``way`` id
-> way, why, settled, lost; ``exhaust`` on: use up all file descriptors, or release them; ``drop`` id; ``origin`` side,
network, daemon; ``serve`` name, type, hash, hold: answer each request with itself, or never; ``requests`` -> count;
``call`` name, type, hash: call without waiting for the reply -> id; ``result`` id, seconds -> result; ``collide``: each
later query ends while other threads query and declare.
"""
# ruff: noqa: A002  # parameters are named as in the commands

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from contextlib import ExitStack
from threading import Thread
from typing import Any

import zenoh

from bridge.hub.endpoints.calls import Abandon, CallError, Done
from bridge.hub.endpoints.lane_subscription import LaneSubscription
from bridge.hub.endpoints.subscription import HubSample
from bridge.hub.graph.tokens import Origin
from bridge.hub.node import Hub
from bridge.hub.session import HubSettings
from bridge.hub.wire.qos import Durability, Qos
from tests.peers.commands import Commands, Counting, Record, only_answers, serve
from tests.support.descriptors import no_descriptors
from tests.support.wait import until

TYPE, HASH = "std_msgs/msg/String", "RIHS01_" + "5e" * 32


class HubPeer(Commands):
    """Executes the commands."""

    def __init__(self, hub: Hub) -> None:
        super().__init__()
        self._hub = hub
        self._texts: dict[int, Record] = {}
        self._requests = 0
        self._none = ExitStack()

    def publisher(self, topic: str, **options: Any) -> dict[str, Any]:
        return self.add(self._hub.publisher(topic, TYPE, HASH, qos(**options)))

    def subscription(self, topic: str, **options: Any) -> dict[str, Any]:
        texts = Record()

        def on_sample(sample: HubSample) -> None:
            texts.add(sample.data().decode())

        number = self.add(self._hub.subscription(topic, TYPE, HASH, qos(**options), on_sample))
        self._texts[number["id"]] = texts
        return number

    def put(self, id: int, text: str) -> dict[str, Any]:
        self.parts[id].put(text.encode())
        return {}

    def drum(self, id: int, rate: float, size: int = 0, first: int = 1) -> dict[str, Any]:
        publisher = self.parts[id]
        self.countings[id] = Counting(lambda number: publisher.put(number.encode().ljust(size)), first, math.inf, rate)
        return {}

    def wait(self, id: int, count: int, seconds: float, since: int = 0) -> dict[str, Any]:
        return {"texts": self._texts[id].wait(count, seconds, since)}

    def way(self, id: int) -> dict[str, Any]:
        subscription = self.parts[id]
        assert isinstance(subscription, LaneSubscription)
        lost = subscription.lost
        return {"way": subscription.way, "why": subscription.why, "settled": subscription.settled, "lost": lost}

    def exhaust(self, on: bool) -> dict[str, Any]:
        if on:
            self._none.enter_context(no_descriptors())
        else:
            self._none.close()
        return {}

    def ended_links(self) -> dict[str, Any]:
        return {"links": self._hub.mesh.ended}

    def drop(self, id: int) -> dict[str, Any]:
        self.parts[id].close()
        return {}

    def origin(self, side: str, network: str, daemon: str) -> dict[str, Any]:
        self._hub.set_origin(Origin(side, network, daemon))
        return {"zid": self._hub.zid}

    def serve(self, name: str, type: str, hash: str, hold: bool = False) -> dict[str, Any]:
        def on_request(request: bytes, done: Done) -> Abandon:
            self._requests += 1
            if not hold:
                done(request)
            return lambda: None

        self._hub.server(name, type, hash, on_request)
        return {}

    def requests(self) -> dict[str, Any]:
        return {"count": self._requests}

    def call(self, name: str, type: str, hash: str) -> dict[str, Any]:
        client, results = self._hub.client(name, type, hash), Record()
        until(lambda: client.ready, "a server")

        def done(result: bytes | CallError) -> None:
            results.add(str(result) if isinstance(result, CallError) else result.decode())

        client.call(b"from a peer", done)
        number = self.add(client)
        self._texts[number["id"]] = results
        return number

    def result(self, id: int, seconds: float) -> dict[str, Any]:
        return {"result": "".join(self._texts[id].wait(1, seconds))}

    def collide(self) -> dict[str, Any]:
        real, session = zenoh.handlers.Callback, self._hub._session

        def end(drop: Callable[[], None]) -> None:
            """Run on zenoh's thread, which holds the lock of all queries if the server's session was lost."""
            for work in (lambda: session.get("other/key"), lambda: session.declare_subscriber("other/key")):
                other = Thread(target=work, daemon=True)
                other.start()
                other.join(0.2)  # by then it waits for zenoh's lock; no function of zenoh shows that
            drop()

        def colliding(callback: Any, drop: Callable[[], None] | None = None, **options: Any) -> Any:
            return real(callback, None if drop is None else lambda: end(drop), **options)

        zenoh.handlers.Callback = colliding  # type: ignore[assignment, misc]
        return {}


def qos(latched: bool = False, depth: int = 1) -> Qos:
    """Return a command's QoS."""
    durability = Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE
    return Qos(durability=durability, depth=depth)


def main() -> None:
    """Execute the commands from standard input until it ends."""
    answers = only_answers()
    with Hub.open(HubSettings(**json.loads(sys.argv[1]))) as hub:
        serve(HubPeer(hub), answers)


if __name__ == "__main__":
    main()
