"""The contract suite's zenoh dialects: bridges like zenoh's plugins; see `tests.peers.zenoh.programs`.

The adapter runs in the test's process, because it needs no middleware but zenoh.
"""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path
from typing import Any

import pytest

from bridge.adapters.worker import NetworkBridge, make_edges
from bridge.adapters.zenoh import edge, ros1_discovery
from bridge.config.model import Config
from bridge.messages.registry import Registry
from tests.contract.side import PEER_FOLDERS, Side
from tests.peers.hub.network import HubNetwork
from tests.peers.zenoh.programs import Ros1Bridge, Ros2ddsBridge, Router, service_texts
from tests.support.rosbags_messages import Messages
from tests.support.wait import until

PERIOD = 0.25
"""Seconds between beacons of the ros1 dialect, for all bridges. The plugin's 1 s would make the suite slow."""


@functools.cache
def messages(*, ros1: bool) -> Messages:
    """Return the types of all bridges of a dialect, which take 50 ms to read."""
    return Messages(ros1=ros1, folders=PEER_FOLDERS, texts=service_texts())


class ZenohBridge:
    """The zenoh worker's bridges, in this process."""

    def __init__(self, config: Config) -> None:
        registry = Registry(folders=list(config.types.folders))
        self._folder = tempfile.TemporaryDirectory()
        edges = self.edges = make_edges("zenoh", config, registry, Path(self._folder.name))
        self.bridges = [
            NetworkBridge(name, edge, config, registry, self._failed, diagnostics=False) for name, edge in edges.items()
        ]
        until(lambda: not any(c.health().state == "waiting" for c in self.bridges), "the dialects are joined", 20)

    def _failed(self, reason: str) -> None:
        raise AssertionError(reason)

    def reload(self, config: Config) -> None:
        for bridge in self.bridges:
            bridge.reload(config)

    def stop(self) -> None:
        for bridge in self.bridges:
            bridge.stop()
        self._folder.cleanup()

    def kill(self) -> None:
        self.stop()


class ZenohSide(Side):
    """A zenoh network with its own router, separate from the hub's."""

    lists_subscribers = False

    def __init__(self, _hubs: HubNetwork) -> None:
        super().__init__()
        self._router = Router()
        self._patch = pytest.MonkeyPatch()
        self._patch.setattr(edge, "LINK_SECONDS", 0.1)
        self._patch.setattr(edge, "TICK", 0.05)

    def bridge(self, config: Config) -> ZenohBridge:
        bridge = ZenohBridge(config)
        self._open.append(bridge)
        return bridge

    def restart_network(self) -> None:
        self._router.stop()
        self._router.start()

    def dialect(self) -> dict[str, Any]:
        """The dialect's entry in the configuration."""
        raise NotImplementedError

    def config(self) -> dict[str, Any]:
        return {"zenoh": {"router": self._router.endpoint, "dialects": [self.dialect()]}}

    def close(self) -> None:
        super().close()
        self._router.stop()
        self._patch.undo()


class Ros2ddsSide(ZenohSide):
    """Bridges of the ros2dds dialect."""

    name = "zenoh_ros2dds"
    has_services = True
    tells_errors = False

    def peer(self) -> Ros2ddsBridge:
        peer = Ros2ddsBridge(self._router.endpoint, messages(ros1=False))
        self._open.append(peer)
        return peer

    def dialect(self) -> dict[str, Any]:
        return {"dialect": "ros2dds"}


class Ros1KeysSide(ZenohSide):
    """Bridges of the ros1 dialect, which does not announce latching."""

    name = "zenoh_ros1"
    tells_latching = False
    has_services = True
    tells_empty_types = True

    def __init__(self, hubs: HubNetwork) -> None:
        super().__init__(hubs)
        self._patch.setattr(ros1_discovery, "PERIOD", PERIOD)

    def peer(self) -> Ros1Bridge:
        peer = Ros1Bridge(self._router.endpoint, messages(ros1=True), period=PERIOD)
        self._open.append(peer)
        return peer

    def dialect(self) -> dict[str, Any]:
        return {"dialect": "ros1", "latched": ["/octomap_binary", "/*/tf_static"]}
