"""A running map server on its own hub, with YARP clients, hub participants in place of ROS nodes, and the store."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bridge.stores.kinds import KINDS
from bridge.stores.store import Store
from tests.peers.hub.modules import Place
from tests.support.wait import until
from yarp_compat.dev.map2d_client import Map2DClient
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.naming import connections
from yarp_compat.naming.server import NameServer

GRID = "nav_msgs/OccupancyGrid"
MINE = {"enabled": True, "take": [{"topic": "/map", "name": "taken", "period": 0.0}], "clicked_point": "point"}


class Served(Place):
    """A running map server, and a YARP client of the server."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.yarp = NameServer(port=self.port, gc_seconds=0)
        self.yarp.open()
        self.worker.start(self.config(modules={"map2d_server": MINE}))
        until(lambda: connections.exists(self.names, "/mapServer/rpc"), "the ports are registered", 30)
        until(lambda: connections.exists(self.names, "/map2D_server/command"), "all ports are registered", 30)

    @property
    def store(self) -> Store:
        """The module's store; the module runs in this process."""
        return self.worker.store

    def fresh(self) -> None:
        """Empty the store, and wait until other programs no longer see a map or a mask of the module."""
        for kind in KINDS.values():
            self.store.clear(kind)
        until(lambda: not (self.status("map2d_server") or {"current": "?"})["current"], "no map is current", 20)
        until(lambda: not self._published(), "no map is published", 20)

    def _published(self) -> list[str]:
        """Return the topics of maps and masks that the module publishes, as another session sees them."""
        zid = self.worker.running("map2d_server").host.node.hub.zid
        ends = self.far.hub.graph.endpoints()
        topics = [end.topic for end in ends if end.zid == zid and end.kind == "publisher"]
        return [topic for topic in topics if topic == "/map" or topic.startswith("/maps") or "_filter_" in topic]

    def client(self, port: str = "/map2D_nws_yarp/rpc") -> Map2DClient:
        return Map2DClient(port, naming=self.names, timeout=20)

    def latest(self, topic: str, type_: str) -> Any:
        """Subscribe to a latched topic; return a function that returns the newest message."""
        subscription = self.far.subscribe(topic, type_, latched=True, depth=1)

        def newest() -> dict[str, Any] | None:
            return next(reversed(self.far.wait(subscription, 0, 0)), None)

        return newest

    def close(self) -> None:
        super().close()
        self.yarp.close()


def six_flags(name: str = "office", seed: int = 1) -> MapGrid2D:
    flags = np.random.default_rng(seed).integers(0, 6, (12, 17), np.uint8)
    return MapGrid2D.of(flags, name=name, resolution=0.5, origin=(-1.0, -2.0, 0.0))
