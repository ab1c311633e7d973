"""A ROS 2 edge in a separate process, driven by JSON lines like the peers of `tests.peers.peer`.

Usage: adapter_program.py CONFIG STATE, the configuration as JSON. Messages are the texts of std_msgs/msg/String.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from pathlib import Path
from typing import Any

from bridge.adapters.ros2.edge import Ros2Edge
from bridge.config.model import Config
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.registry import Registry
from tests.adapters.ros2.conftest import Inbox, string
from tests.support.wait import until

TYPE = "std_msgs/msg/String"


class Program:
    """Executes the commands."""

    def __init__(self, config: Config, state: Path) -> None:
        self.registry = Registry()
        self.edge = Ros2Edge(config, self.registry, state)
        self.failed: list[str] = []
        self.handles: dict[int, Any] = {}
        self.edge.start(self)

    def graph_changed(self) -> None:
        """Ignore it: the commands read the graph."""

    def presence_changed(self) -> None:
        """Ignore it."""

    def message_refused(self, topic: str, reason: str, why: str) -> None:
        """Ignore it."""

    def edge_failed(self, reason: str) -> None:
        self.failed.append(reason)

    def add(self, handle: Any) -> dict[str, Any]:
        self.handles[len(self.handles) + 1] = handle
        return {"id": len(self.handles)}

    def qos(self, latched: bool) -> Qos:
        return Qos(durability=Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE)

    def advertise(self, topic: str, latched: bool = False) -> dict[str, Any]:
        return self.add(self.edge.advertise(topic, self.registry.ros2(TYPE), self.qos(latched)))

    def publish(self, id: int, message: str, source: str = "hub") -> dict[str, Any]:  # noqa: A002
        self.handles[id].send(string(message), source)
        return {}

    def subscribe(self, topic: str, latched: bool = False) -> dict[str, Any]:
        inbox = Inbox()
        self.edge.subscribe(topic, self.registry.ros2(TYPE), self.qos(latched), inbox.deliver)
        return self.add(inbox)

    def wait(self, id: int, count: int, seconds: float) -> dict[str, Any]:  # noqa: A002
        with contextlib.suppress(AssertionError):
            until(lambda: len(self.handles[id].messages) >= count, "messages", seconds)
        return {"messages": self.handles[id].texts()}

    def announce(self, record: str) -> dict[str, Any]:
        self.edge.announce(record.encode())
        return {}

    def sightings(self) -> dict[str, Any]:
        return {"records": [s.record.decode() if s.record is not None else None for s in self.edge.sightings()]}

    def status(self) -> dict[str, Any]:
        return {
            "failed": self.failed,
            "network": self.edge.network(),
            "endpoints": [f"{e.kind.value} {e.topic} {e.made_by.value}" for e in self.edge.endpoints()],
        }


def main() -> None:
    """Execute the commands from standard input until it ends."""
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # keeps Fast DDS's output apart from the answers
    program = Program(Config.model_validate_json(sys.argv[1]), Path(sys.argv[2]))
    for line in sys.stdin:
        params = json.loads(line)
        do = params.pop("do")
        if do == "exit":
            break
        try:
            answer = {"ok": True, **getattr(program, do)(**params)}
        except Exception as err:
            answer = {"ok": False, "error": f"{type(err).__name__}: {err}"}
        answers.write(json.dumps(answer) + "\n")
    program.edge.stop()


if __name__ == "__main__":
    main()
