"""A Midspan hub session in a separate process, controlled by a test. See `tests.peers.peer` for the format.

Argument: the settings in JSON. Commands: ``publisher`` and ``subscription`` topic, latched, depth -> id; ``put`` id,
text; ``drum`` id, rate, size: put numbers from 1 on, endlessly; ``wait`` id, count, seconds -> texts; ``way`` id
-> way, why, settled, lost; ``exhaust`` on: use up all file descriptors, or release them; ``drop`` id; ``origin`` side,
network, daemon; ``serve`` name, type, hash, hold: answer each request with itself, or never; ``requests`` -> count;
``call`` name, type, hash: call without waiting for the reply; ``exit``.
"""

from __future__ import annotations

import itertools
import json
import sys
import threading
import time
from contextlib import ExitStack
from typing import Any

from bridge.hub.endpoints.calls import Abandon, Done
from bridge.hub.endpoints.lane_subscription import LaneSubscription
from bridge.hub.endpoints.publisher import HubPublisher
from bridge.hub.endpoints.subscription import HubSample, HubSubscription
from bridge.hub.graph.tokens import Origin
from bridge.hub.session import Hub, HubSettings
from bridge.hub.wire.qos import Durability, Qos
from tests.support.descriptors import no_descriptors
from tests.support.wait import until

TYPE, HASH = "std_msgs/msg/String", "RIHS01_" + "5e" * 32


class HubPeer:
    """Executes the commands."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._endpoints: list[HubPublisher | HubSubscription] = []
        self._texts: dict[int, list[str]] = {}
        self._arrived = threading.Condition()
        self._requests = 0
        self._none = ExitStack()

    def publisher(self, params: dict[str, Any]) -> dict[str, Any]:
        self._endpoints.append(self._hub.publisher(params["topic"], TYPE, HASH, qos(params)))
        return {"id": len(self._endpoints) - 1}

    def subscription(self, params: dict[str, Any]) -> dict[str, Any]:
        texts: list[str] = []

        def on_sample(sample: HubSample) -> None:
            with self._arrived:
                texts.append(sample.data().decode())
                self._arrived.notify_all()

        self._endpoints.append(self._hub.subscription(params["topic"], TYPE, HASH, qos(params), on_sample))
        number = len(self._endpoints) - 1
        self._texts[number] = texts
        return {"id": number}

    def put(self, params: dict[str, Any]) -> dict[str, Any]:
        publisher = self._endpoints[params["id"]]
        assert isinstance(publisher, HubPublisher)
        publisher.put(params["text"].encode())
        return {}

    def drum(self, params: dict[str, Any]) -> dict[str, Any]:
        publisher = self._endpoints[params["id"]]
        assert isinstance(publisher, HubPublisher)

        def run() -> None:
            due = time.monotonic()
            for number in itertools.count(1):
                publisher.put(str(number).encode().ljust(params.get("size", 0)))
                due += 1 / params["rate"]
                time.sleep(max(0.0, due - time.monotonic()))

        threading.Thread(target=run, daemon=True).start()
        return {}

    def wait(self, params: dict[str, Any]) -> dict[str, Any]:
        texts = self._texts[params["id"]]
        with self._arrived:
            self._arrived.wait_for(lambda: len(texts) >= params["count"], params["seconds"])
            return {"texts": list(texts)}

    def way(self, params: dict[str, Any]) -> dict[str, Any]:
        subscription = self._endpoints[params["id"]]
        assert isinstance(subscription, LaneSubscription)
        lost = subscription.lost
        return {"way": subscription.way, "why": subscription.why, "settled": subscription.settled, "lost": lost}

    def exhaust(self, params: dict[str, Any]) -> dict[str, Any]:
        if params["on"]:
            self._none.enter_context(no_descriptors())
        else:
            self._none.close()
        return {}

    def drop(self, params: dict[str, Any]) -> dict[str, Any]:
        self._endpoints[params["id"]].close()
        return {}

    def origin(self, params: dict[str, Any]) -> dict[str, Any]:
        self._hub.set_origin(Origin(params["side"], params["network"], params["daemon"]))
        return {"zid": self._hub.zid}

    def serve(self, params: dict[str, Any]) -> dict[str, Any]:
        def asked(request: bytes, done: Done) -> Abandon:
            self._requests += 1
            if not params.get("hold"):
                done(request)
            return lambda: None

        self._hub.server(params["name"], params["type"], params["hash"], asked)
        return {}

    def requests(self, _params: dict[str, Any]) -> dict[str, Any]:
        return {"count": self._requests}

    def call(self, params: dict[str, Any]) -> dict[str, Any]:
        client = self._hub.client(params["name"], params["type"], params["hash"])
        until(lambda: client.ready, "a server")
        client.call(b"from a peer", lambda _result: None)
        return {}


def qos(params: dict[str, Any]) -> Qos:
    """Return a command's quality of service."""
    latched = Durability.TRANSIENT_LOCAL if params.get("latched") else Durability.VOLATILE
    return Qos(durability=latched, depth=params.get("depth", 1))


def main() -> None:
    """Read commands until the input ends or ``exit``."""
    with Hub.open(HubSettings(**json.loads(sys.argv[1]))) as hub:
        peer = HubPeer(hub)
        for line in sys.stdin:
            command = json.loads(line)
            name = command.pop("do")
            if name == "exit":
                break
            print(json.dumps({"ok": True, **getattr(peer, name)(command)}), flush=True)


if __name__ == "__main__":
    main()
