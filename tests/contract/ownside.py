"""The contract suite's custom side: the example of docs/develop/add_a_side.md, in a real worker process."""

from __future__ import annotations

import itertools
import json
import os
import socket
import sys
import threading
from pathlib import Path
from typing import Any

from bridge.config.model import Config
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry
from tests.contract.hubside import ros2_name
from tests.contract.side import PEER_FOLDERS, Side, WorkerProcess
from tests.peers.hub.network import HubNetwork

PACKAGE = Path(__file__).parents[2] / "examples" / "own_side"
sys.path.append(str(PACKAGE))

from datagrams.network import End, Node  # noqa: E402


def free_group() -> str:
    """Return a multicast group that no other test uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        return f"239.255.42.1:{free.getsockname()[1]}"


class OwnPeer:
    """A native program on the network."""

    def __init__(self, group: str, registry: Registry, name: str) -> None:
        self._node, self._registry = Node(group, "127.0.0.1", name), registry
        self._ends: dict[int, End] = {}
        self._received: dict[int, list[dict[str, Any]]] = {}
        self._numbers = itertools.count(1)
        self._changed = threading.Condition()

    def advertise(self, topic: str, type_: str, *, latched: bool = False, **_: Any) -> int:
        number = next(self._numbers)
        self._ends[number] = self._node.open("pub", topic, ros2_name(type_), latched=latched)
        return number

    def subscribe(self, topic: str, type_: str, *, latched: bool = False, **_: Any) -> int:
        number, name = next(self._numbers), ros2_name(type_)
        received = self._received[number] = []

        def take(message: bytes, _publisher: str) -> None:
            with self._changed:
                received.append(self._whole(name, json.loads(message)))
                self._changed.notify_all()

        self._ends[number] = self._node.open("sub", topic, name, latched=latched, take=take)
        return number

    def publish(self, endpoint: int, message: dict[str, Any]) -> None:
        end = self._ends[endpoint]
        self._node.publish(end, json.dumps(self._whole(end.type, message)).encode())

    def _whole(self, name: str, message: dict[str, Any]) -> dict[str, Any]:
        """Return a message with all its fields, and octets as lists, as the suite expects."""
        return to_json(self._registry, name, from_json(self._registry, name, message))

    def wait(self, endpoint: int, count: int, seconds: float = 10.0) -> list[dict[str, Any]]:
        with self._changed:
            self._changed.wait_for(lambda: len(self._received[endpoint]) >= count, seconds)
            return list(self._received[endpoint])

    def drop(self, endpoint: int) -> None:
        self._node.close_end(self._ends.pop(endpoint))

    def graph(self) -> dict[str, Any]:
        result: dict[str, dict[str, list[str]]] = {"pub": {}, "sub": {}}
        for program in list(self._node.programs.values()):
            for end in program.ends.values():
                result[end.kind].setdefault(end.topic, []).append(program.node)
        return {"publishers": result["pub"], "subscriptions": result["sub"]}

    def ask(self, do: str, **params: Any) -> dict[str, Any]:
        raise NotImplementedError

    def stop(self, seconds: float = 6.0) -> int:
        self._node.close()
        return int(seconds * 0)


class OwnWorker(WorkerProcess):
    """The side's worker; this process's `Config` has no section for it."""

    def __init__(self, config: Config, section: dict[str, Any]) -> None:
        self._section = section
        env = {**os.environ, "PYTHONPATH": str(PACKAGE), "MIDSPAN_SIDES": "datagrams:SIDE"}
        super().__init__("datagrams", config, env, edge="datagrams.edge")

    def _send(self, line: dict[str, Any]) -> None:
        super()._send({"config": {**line["config"], "datagrams": self._section}} if "config" in line else line)


class OwnSide(Side):
    """A network of datagrams. Like DDS, it has no central process that could crash."""

    name = "datagrams"
    lists_subscribers = False

    def __init__(self, _hubs: HubNetwork) -> None:
        super().__init__()
        self._group = free_group()
        self._registry = Registry(folders=PEER_FOLDERS)

    def peer(self) -> OwnPeer:
        peer = OwnPeer(self._group, self._registry, f"/peer{next(self._names)}")
        self._open.append(peer)
        return peer

    def bridge(self, config: Config) -> OwnWorker:
        worker = OwnWorker(config, {"group": self._group})
        self._open.append(worker)
        return worker

    def restart_network(self) -> None:
        pass

    def config(self) -> dict[str, Any]:
        return {}
