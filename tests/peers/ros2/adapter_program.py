"""A ROS 2 edge in a separate process, driven by JSON lines like the peers of `tests.peers.peer`.

Usage: adapter_program.py CONFIG STATE, with the configuration in JSON. Messages are the texts of std_msgs/msg/String.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from bridge.adapters.ros2.edge import Ros2Edge
from bridge.config.model import Config
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.registry import Registry
from tests.adapters.ros2.conftest import string, text
from tests.peers.commands import Commands, Record, only_answers, serve
from tests.peers.listener import Listener

TYPE = "std_msgs/msg/String"


class Program(Commands):
    """Executes the commands."""

    def __init__(self, config: Config, state: Path) -> None:
        super().__init__()
        self.registry = Registry()
        self.edge = Ros2Edge(config, self.registry, state)
        self.listener = Listener()
        self.edge.start(self.listener)

    def qos(self, latched: bool) -> Qos:
        return Qos(durability=Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE)

    def advertise(self, topic: str, latched: bool = False) -> dict[str, Any]:
        return self.add(self.edge.advertise(topic, self.registry.ros2(TYPE), self.qos(latched)))

    def publish(self, id: int, message: str, source: str = "hub") -> dict[str, Any]:  # noqa: A002
        self.parts[id].send(string(message), source)
        return {}

    def subscribe(self, topic: str, latched: bool = False) -> dict[str, Any]:
        record = Record()
        self.edge.subscribe(
            topic, self.registry.ros2(TYPE), self.qos(latched), lambda payload, *_: record.add(text(payload))
        )
        return self.add(record)

    def announce(self, record: str) -> dict[str, Any]:
        self.edge.announce(record.encode())
        return {}

    def sightings(self) -> dict[str, Any]:
        return {"records": [s.record.decode() if s.record is not None else None for s in self.edge.sightings()]}

    def status(self) -> dict[str, Any]:
        return {
            "failed": self.listener.failures,
            "warnings": self.edge.warnings(),
            "network": self.edge.network(),
            "endpoints": [f"{e.kind.value} {e.topic} {e.made_by.value}" for e in self.edge.endpoints()],
        }


def main() -> None:
    """Execute the commands from standard input until it ends."""
    answers = only_answers()  # Fast DDS writes to standard output
    program = Program(Config.model_validate_json(sys.argv[1]), Path(sys.argv[2]))
    serve(program, answers)
    program.edge.stop()


if __name__ == "__main__":
    main()
