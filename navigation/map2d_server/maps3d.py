"""The store's 3D maps on latched topics, each an octomap or a cloud, with services for octomaps.

Below each octomap's topic are services with the names of `octomap_server`, so that `octomap_saver` can save the map if
it is started in that namespace.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bridge.hub.endpoints.calls import CallError
from bridge.hub.wire.qos import LATCHED
from bridge.messages.yarp.codec import Missing
from bridge.messages.yarp.contents import KINDS
from bridge.modules.endpoints import ModulePublisher
from bridge.modules.host import ModuleNode
from bridge.modules.services import Answer, ModuleServer
from bridge.stores.kinds import MAP3D
from bridge.stores.store import Store
from navigation.map2d_server.publishers import Head, Keys, topic_of
from navigation.messages import Message
from yarp_compat.octomap import Octomap
from yarp_compat.wire.elements import ElementReader
from yarp_compat.wire.profile import Profile

OCTOMAP, CLOUD = "octomap_msgs/msg/Octomap", "sensor_msgs/msg/PointCloud2"
GET = "octomap_msgs/srv/GetOctomap"


def octomap_message(octomap: Octomap, header: Message) -> Message:
    """Return an ``octomap_msgs/msg/Octomap``."""
    return {
        "header": header, "binary": octomap.binary, "id": octomap.id, "resolution": octomap.resolution,
        "data": np.frombuffer(octomap.data, np.int8),
    }  # fmt: skip


class Maps3D:
    """Publishes every 3D map on ``/maps3d/<name>``; an octomap also has two ``GetOctomap`` services below its topic."""

    def __init__(self, node: ModuleNode, store: Store, head: Head) -> None:
        self._node, self._store, self._head = node, store, head
        self._ends: dict[str, tuple[str, ModulePublisher]] = {}
        self._servers: dict[str, list[ModuleServer]] = {}

    def update(self, changed: Keys) -> None:
        """Publish the changed maps; close the topics of maps that were deleted, or have another form."""
        for kind, name in sorted(changed):
            if kind == MAP3D.name:
                self._show(name)

    @property
    def topics(self) -> dict[str, str]:
        """The topic of each map."""
        return {name: end.topic for name, (_, end) in self._ends.copy().items()}  # another thread reads the topics

    def _show(self, name: str) -> None:
        value = self._store.get(MAP3D, name)
        wanted = "" if value is None else OCTOMAP if isinstance(value, Octomap) else CLOUD
        if name in self._ends and self._ends[name][0] != wanted:
            for end in (self._ends.pop(name)[1], *self._servers.pop(name, ())):
                self._node.release(end)
        if value is None:
            return
        if name not in self._ends:
            topic = topic_of(name, set(self.topics.values()), under="/maps3d")
            self._ends[name] = wanted, self._node.publisher(topic, wanted, LATCHED, priority="state")
            if wanted == OCTOMAP:
                self._servers[name] = [self._server(name, f"{topic}/octomap_{form}") for form in ("binary", "full")]
        if isinstance(value, Octomap):
            self._ends[name][1].publish(octomap_message(value, self._head.header()))
            return
        source = ElementReader(value.to_bytes(Profile.YARP3), Profile.YARP3)
        self._ends[name][1].publish(KINDS[wanted].to_ros(source, self._head.now_ns(), Missing(self._head.frame)))

    def _server(self, name: str, service: str) -> ModuleServer:
        def serve(_request: dict[str, Any], answer: Answer) -> None:
            octomap, binary = self._store.get(MAP3D, name), service.endswith("binary")
            if not isinstance(octomap, Octomap):
                answer(CallError(f"{service}: the octomap {name!r} was deleted"))
                return
            converted = octomap if octomap.binary == binary else Octomap.of(octomap.tree(), binary=binary)
            answer({"map": octomap_message(converted, self._head.header())})

        return self._node.server(service, GET, serve)
