"""The ROS 1 side of the contract suite on a machine without rospy: Midspan's own master, and programs on its own node.

Both ends are Midspan's, so this side only replaces `tests.contract.ros1side` on systems whose archive has no rospy.
"""

from __future__ import annotations

import itertools
import threading
from typing import Any

from bridge.adapters.ros1.master.embedded import EmbeddedMaster
from bridge.adapters.ros1.program import Ros1Program
from bridge.adapters.ros1.topics.publication import Publication
from bridge.adapters.ros1_peers import ask
from bridge.messages.registry import Registry
from tests.contract.ros1side import Ros1Side
from tests.contract.side import PEER_FOLDERS, Side
from tests.peers.hub.network import HubNetwork
from tests.support.ports import free_port


class PlainPeer:
    """A program on Midspan's own ROS 1 node; see ``tests.peers.peer``."""

    def __init__(self, program: Ros1Program, master: str) -> None:
        self._program, self._master = program, master
        self._publications: dict[int, tuple[Publication, str, bool]] = {}
        self._received: dict[int, list[dict[str, Any]]] = {}
        self._topics: dict[int, str] = {}
        self._numbers = itertools.count(1)
        self._changed = threading.Condition()

    def advertise(self, topic: str, type_: str, *, latched: bool = False, **_: Any) -> int:
        number = next(self._numbers)
        publication = self._program.publish(topic, self._program.registry.ros1(type_), latched=latched)
        self._publications[number] = publication, type_, latched
        self._topics[number] = topic
        return number

    def subscribe(self, topic: str, type_: str, **_: Any) -> int:
        number = next(self._numbers)
        received = self._received[number] = []
        self._topics[number] = topic

        def deliver(payload: bytes, _uri: str) -> None:
            with self._changed:
                received.append(dict(self._program.decode(type_, payload)))
                self._changed.notify_all()

        self._program.subscribe(topic, self._program.registry.ros1(type_), deliver)
        return number

    def publish(self, endpoint: int, message: dict[str, Any]) -> None:
        publication, type_, latched = self._publications[endpoint]
        publication.send(self._program.encode(type_, message), "peer", 1000 if not latched else 1, retain=latched)

    def wait(self, endpoint: int, count: int, seconds: float = 10.0) -> list[dict[str, Any]]:
        with self._changed:
            self._changed.wait_for(lambda: len(self._received[endpoint]) >= count, seconds)
            return list(self._received[endpoint])

    def drop(self, endpoint: int) -> None:
        topic = self._topics.pop(endpoint)
        if endpoint in self._publications:
            publication, _, latched = self._publications.pop(endpoint)
            self._program.unpublish(publication, latched=latched)
        else:
            self._program.unsubscribe(topic)

    def graph(self) -> dict[str, Any]:
        publishers, subscribers, _ = ask(self._master, 5.0, "getSystemState", "/graph")
        types: dict[str, list[str]] = {}
        for topic, name in ask(self._master, 5.0, "getTopicTypes", "/graph"):
            types.setdefault(topic, []).append(name)
        return {"topics": types, "publishers": dict(publishers), "subscriptions": dict(subscribers)}

    def ask(self, do: str, **_: Any) -> dict[str, Any]:
        raise NotImplementedError(do)

    def stop(self, seconds: float = 6.0) -> int:
        self._program.close()
        return int(seconds * 0)


class PlainSide(Ros1Side):
    """An instance of Midspan's own master per test, in this process."""

    has_services = False

    def __init__(self, _hubs: HubNetwork) -> None:
        Side.__init__(self)
        self._registry = Registry(folders=PEER_FOLDERS)
        self._port = free_port()
        self._uri = f"http://127.0.0.1:{self._port}/"
        self._own = self._started()

    def _started(self) -> EmbeddedMaster:
        master = EmbeddedMaster("127.0.0.1", self._port)
        master.start()
        return master

    def peer(self) -> PlainPeer:  # type: ignore[override]
        program = Ros1Program(f"peer{next(self._names)}", self._registry, master=self._uri)
        peer = PlainPeer(program, self._uri)
        self._open.append(peer)
        return peer

    def restart_network(self) -> None:
        self._own.close()
        self._own = self._started()

    def config(self) -> dict[str, Any]:
        return {"ros1": {"master": self._uri, "poll": 0.1}}

    def close(self) -> None:
        Side.close(self)
        self._own.close()
