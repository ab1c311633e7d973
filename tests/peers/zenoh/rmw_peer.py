"""An rmw_zenoh node in a separate process that a test controls with JSON lines; see `tests.peers.peer`.

Arguments: router, domain, name. Commands: ``advertise``, ``publish``, ``subscribe``, ``wait``, ``drop``, ``silence``.
Sessions in one process share zenoh's threads, and their callbacks share Python's lock: on a busy machine, 26 such
sessions lost their links.
"""
# ruff: noqa: A002  # parameters are named as in the commands

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from bridge.hub.wire.qos import Durability, Qos, Reliability
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry
from tests.contract.hubside import ros2_name
from tests.peers.commands import Commands, Record, only_answers, serve
from tests.peers.zenoh.rmw import RmwNode, RmwPublisher, RmwSubscription


class Publisher:
    """A publisher of messages of one type, given by their fields."""

    def __init__(self, registry: Registry, type_: str, end: RmwPublisher) -> None:
        self._registry, self._type, self._end = registry, type_, end

    def publish(self, message: dict[str, Any]) -> None:
        self._end.put(from_json(self._registry, self._type, message))

    def drop(self) -> None:
        self._end.close()


class Subscription(Record):
    """The messages of one subscription; `end` is set once it is declared."""

    end: RmwSubscription

    def __init__(self, registry: Registry, type_: str) -> None:
        super().__init__(lambda payload: to_json(registry, type_, payload))

    def drop(self) -> None:
        self.end.close()


class Node(Commands):
    """The node's commands."""

    def __init__(self, node: RmwNode) -> None:
        super().__init__()
        self._node, self._registry = node, Registry()

    def advertise(self, topic: str, type: str, **qos: Any) -> dict[str, Any]:
        name, type_hash = self._type(type)
        end = self._node.publisher(topic, name, type_hash, _qos(**qos))
        return self.add(Publisher(self._registry, name, end))

    def subscribe(self, topic: str, type: str, **qos: Any) -> dict[str, Any]:
        name, type_hash = self._type(type)
        heard = Subscription(self._registry, name)
        heard.end = self._node.subscription(topic, name, type_hash, _qos(**qos), heard.add)
        return self.add(heard)

    def publish(self, id: int, message: dict[str, Any], times: int = 1) -> dict[str, Any]:
        for _ in range(times):
            self.parts[id].publish(message)
        return {}

    def _type(self, type_: str) -> tuple[str, str]:
        name = ros2_name(type_)
        return name, self._registry.ros2(name).type_id


def _qos(*, latched: bool = False, depth: int = 10) -> Qos:
    return Qos(Reliability.RELIABLE, Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE, depth=depth)


def main() -> None:
    """Join the hub, and execute commands until standard input ends."""
    answers = only_answers()
    router, domain, name = sys.argv[1:]
    node = RmwNode(router, int(domain), name)
    serve(Node(node), answers)
    node.close()


if __name__ == "__main__":
    main()
