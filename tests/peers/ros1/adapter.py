"""Helpers for the tests of the ROS 1 edge."""

from __future__ import annotations

import base64
import os
import struct
import sys
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from bridge.adapters.ros1.environment import worker_environment
from bridge.config.model import Config
from bridge.config.sections.clock import ClockSection
from bridge.config.sections.ros import Ros1Section
from tests.peers.peer import Peer
from tests.peers.ros1.network import RosMaster
from tests.support.wait import until

ROOT = Path(__file__).parents[3]
PROGRAM = Path(__file__).with_name("adapter_program.py")
AT_ONCE = 4.0
"""Seconds: twice the limit of `Edge.start` and `Edge.stop`, to allow for a busy machine."""


def string(text: str) -> str:
    """Return a std_msgs/String in the ROS 1 serialization, as base64 for the edge's program."""
    data = text.encode()
    return base64.b64encode(struct.pack("<I", len(data)) + data).decode()


def text(payload: str) -> str:
    """Return the text of a std_msgs/String in the ROS 1 serialization, given as base64."""
    data = base64.b64decode(payload)
    (length,) = struct.unpack_from("<I", data)
    assert len(data) == length + 4
    return data[4:].decode()


class EdgeUnderTest(Peer):
    """A ROS 1 edge in a separate process, in the worker's environment."""

    def __init__(
        self, master: str, state: Path, daemon: str = "robot", clock: str = "system",
        variables: Mapping[str, str] = MappingProxyType({}), **ros1: Any,
    ) -> None:  # fmt: skip
        source = ClockSection(source=clock)
        config = Config(
            name=daemon, state=state, clock=source, ros1=Ros1Section(master=master, **{"poll": 0.1, **ros1})
        )
        environ = {k: v for k, v in os.environ.items() if not k.startswith("ROS_")}
        env = worker_environment(config, environ | variables) | {"PYTHONPATH": str(ROOT)}
        super().__init__(PROGRAM, Path(sys.executable), env, config.model_dump_json(by_alias=True), str(state))

    def joined(self, network: str = "") -> str:
        """Wait until the edge has joined a master (with this run ID, if given); return the network's identity."""

        def there() -> Any:
            result = self.ask("network")["network"]
            return result if result and network in ("", result) else None

        return str(until(there, "the edge joins the master"))

    def endpoints(self, **like: Any) -> list[dict[str, Any]]:
        """Return the endpoints with these values."""
        result: list[dict[str, Any]] = self.ask("endpoints")["endpoints"]
        return [e for e in result if all(e[k] == v for k, v in like.items())]

    def endpoint(self, **like: Any) -> dict[str, Any]:
        """Wait for an endpoint with these values and return it."""
        (result,) = until(lambda: self.endpoints(**like), f"an endpoint {like}")
        return result

    def received(self, subscription: int, count: int, seconds: float = 40.0) -> list[tuple[str, str]]:
        """Return the payloads and sources so far, once ``count`` have arrived or the time is over."""
        return [(p, s) for p, s, _ in self.ask("wait", id=subscription, count=count, seconds=seconds)["messages"]]

    def open(self, topic: str, type_: str, **more: str) -> int:
        """Subscribe, and return the subscription's id."""
        return int(self.ask("subscribe", topic=topic, type=type_, **more)["id"])

    def until_connected(self, publisher: int, count: int = 1) -> None:
        """Wait until ``count`` subscribers are connected."""
        until(lambda: self.ask("subscribers", id=publisher)["count"] == count, f"{count} subscribers are connected")

    def leave(self) -> float:
        """Stop the edge, and return the duration in seconds; a master on a busy machine may respond late."""
        return float(self.ask("stop", patience=40.0)["seconds"])

    def send(self, publisher: int, text_: str, source: str = "a") -> None:
        """Publish a std_msgs/String."""
        self.ask("send", id=publisher, payload=string(text_), source=source)


def edge_on(master: RosMaster, state: Path, daemon: str = "robot", **ros1: Any) -> EdgeUnderTest:
    """Start an edge, and wait until it has joined the master."""
    edge = EdgeUnderTest(master.uri, state, daemon, **ros1)
    edge.ask("start")
    edge.joined()
    return edge
