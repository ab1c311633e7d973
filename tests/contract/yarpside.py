"""The contract suite's YARP side: a separate name server, and programs with ports named ``/topic@/node``."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from bridge.adapters.worker import NetworkBridge, make_edges
from bridge.config.model import Config
from bridge.messages.registry import Registry
from tests.contract.side import PEER_FOLDERS, Side
from tests.peers.hub.network import HubNetwork
from tests.peers.yarp.programs import Definitions, Names, YarpProgram
from tests.support.wait import until


class YarpBridge:
    """The YARP worker's network bridge, in this process."""

    def __init__(self, config: Config) -> None:
        registry = Registry(folders=list(config.types.folders))
        self._folder = tempfile.TemporaryDirectory()
        edges = make_edges("yarp", config, registry, Path(self._folder.name))
        self.bridge = NetworkBridge("yarp", edges["yarp"], config, registry, self._failed, diagnostics=False)
        until(lambda: self.bridge.health().state != "waiting", "the YARP network is joined", 20)

    def _failed(self, reason: str) -> None:
        raise AssertionError(reason)

    def reload(self, config: Config) -> None:
        self.bridge.reload(config)

    def stop(self) -> None:
        self.bridge.stop()
        self._folder.cleanup()

    def kill(self) -> None:
        self.stop()


class YarpSide(Side):
    """A YARP network."""

    name = "yarp"

    def __init__(self, _hubs: HubNetwork) -> None:
        super().__init__()
        self._names_server = Names()
        self._definitions = Definitions(PEER_FOLDERS)

    def peer(self) -> YarpProgram:
        peer = YarpProgram(self._names_server.client, f"/peer{next(self._names)}", self._definitions)
        self._open.append(peer)
        return peer

    def bridge(self, config: Config) -> YarpBridge:
        bridge = YarpBridge(config)
        self._open.append(bridge)
        return bridge

    def restart_network(self) -> None:
        self._names_server.stop()
        self._names_server.start()

    def config(self) -> dict[str, Any]:
        return {"yarp": {"nameserver": "site", "address": self._names_server.endpoint, "poll": 0.1}}

    def close(self) -> None:
        super().close()
        self._names_server.stop()
