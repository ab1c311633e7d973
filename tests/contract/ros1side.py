"""The ROS 1 side of the contract suite: real rospy programs on a real roscore, or on Midspan's own master."""

from __future__ import annotations

import os
from typing import Any, ClassVar

from bridge.adapters.ros1.environment import worker_environment
from bridge.config.model import Config
from bridge.messages.registry import Registry
from tests.contract.side import CUSTOM_TYPES, PEER_FOLDERS, Side, WorkerProcess
from tests.peers.hub.network import HubNetwork
from tests.peers.peer import Peer
from tests.peers.ros1.network import EMBEDDED, RosMaster


class Ros1Side(Side):
    """A roscore per test."""

    name = "ros1"
    has_services = True
    tells_empty_types = True
    embedded = EMBEDDED
    any_os: ClassVar[bool] = False

    def __init__(self, _hubs: HubNetwork) -> None:
        super().__init__()
        self._registry = Registry(folders=PEER_FOLDERS)
        self._master = RosMaster(embedded=self.embedded)
        self._master.start()

    def peer(self) -> Peer:
        peer = self._master.peer(f"peer{next(self._names)}")
        self._open.append(peer)
        for name in CUSTOM_TYPES:
            # genpy's definition of an empty message has no line break
            peer.ask("define", type=name, definition=self._registry.ros1(name).definition.rstrip("\n"))
        return peer

    def bridge(self, config: Config) -> WorkerProcess:
        worker = WorkerProcess("ros1", config, worker_environment(config, os.environ), any_os=self.any_os)
        self._open.append(worker)
        return worker

    def restart_network(self) -> None:
        self._master.stop()
        self._master.start()

    def config(self) -> dict[str, Any]:
        return {"ros1": {"master": self._master.uri, "poll": 0.1}}

    def close(self) -> None:
        super().close()
        self._master.close()


class EmbeddedMasterSide(Ros1Side):
    """An instance of Midspan's own master per test."""

    embedded = True


class Ros1AnyOsSide(Ros1Side):
    """The same with a worker that has nothing that Windows or macOS lacks: epoll, fork, AF_UNIX and SIGHUP."""

    any_os = True
