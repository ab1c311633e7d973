"""The store's maps in three dimensions, latched: an octomap or a cloud each."""

from __future__ import annotations

from bridge.hub.wire.qos import LATCHED
from bridge.messages.yarp.codec import Missing
from bridge.messages.yarp.contents import KINDS
from bridge.modules.endpoints import ModulePublisher
from bridge.modules.host import ModuleNode
from bridge.stores.kinds import MAP3D
from bridge.stores.store import Store
from navigation.map2d_server.publishers import Head, Keys, topic_of
from yarp_compat.octomap import Octomap
from yarp_compat.wire.elements import ElementReader
from yarp_compat.wire.profile import Profile

OCTOMAP, CLOUD = "octomap_msgs/msg/Octomap", "sensor_msgs/msg/PointCloud2"


class Maps3D:
    """Every map in three dimensions on ``/maps3d/<name>``."""

    def __init__(self, node: ModuleNode, store: Store, head: Head) -> None:
        self._node, self._store, self._head = node, store, head
        self._ends: dict[str, tuple[str, ModulePublisher]] = {}

    def update(self, changed: Keys) -> None:
        """Publish the maps that changed; the topics of those that are gone, or are of another form now, go."""
        for kind, name in sorted(changed):
            if kind == MAP3D.name:
                self._show(name)

    @property
    def topics(self) -> dict[str, str]:
        """Each map's topic."""
        return {name: end.topic for name, (_, end) in self._ends.items()}

    def _show(self, name: str) -> None:
        found = self._store.get(MAP3D, name)
        wanted = "" if found is None else OCTOMAP if isinstance(found, Octomap) else CLOUD
        if name in self._ends and self._ends[name][0] != wanted:
            self._node.release(self._ends.pop(name)[1])
        if found is None:
            return
        if name not in self._ends:
            topic = topic_of(name, set(self.topics.values()), under="/maps3d")
            self._ends[name] = wanted, self._node.publisher(topic, wanted, LATCHED, priority="state")
        source = ElementReader(found.to_bytes(Profile.YARP3), Profile.YARP3)
        self._ends[name][1].publish(KINDS[wanted].to_ros(source, self._head.now_ns(), Missing(self._head.frame)))
