"""Publishers and subscribers that the hub's tests share."""

from __future__ import annotations

from threading import Lock
from typing import Any

from bridge.hub.endpoints.publisher import HubPublisher
from bridge.hub.endpoints.subscription import HubSample, HubSubscription
from bridge.hub.graph import HubEndpoint
from bridge.hub.graph.tokens import EndpointKind
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Durability, Qos, Reliability
from tests.support.wait import until

TYPE = "std_msgs/msg/String"
HASH = "RIHS01_" + "5e" * 32
STREAM = Qos(depth=10)
LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
BEST_EFFORT_LATCHED = Qos(Reliability.BEST_EFFORT, Durability.TRANSIENT_LOCAL, depth=1)


def endpoint(topic: str, gid: bytes, qos: Qos = STREAM) -> HubEndpoint:
    """Return a publisher as the graph reports it."""
    return HubEndpoint("1", "node", "/", EndpointKind.PUBLISHER, topic, TYPE, HASH, qos, gid, None, False, False)


class Subscriber:
    """Collects the messages of one subscription."""

    def __init__(self, hub: Hub, topic: str, qos: Qos = STREAM, type_hash: str = HASH) -> None:
        self.samples: list[HubSample] = []
        self._lock = Lock()
        self.subscription: HubSubscription = hub.subscription(topic, TYPE, type_hash, qos, self._add)

    def _add(self, sample: HubSample) -> None:
        with self._lock:
            self.samples.append(sample)

    def texts(self) -> list[str]:
        """Return the payloads so far, decoded."""
        with self._lock:
            return [sample.data().decode() for sample in self.samples]

    def expect(self, *texts: str, seconds: float = 40.0) -> None:
        """Wait until exactly these texts have arrived, in any order."""
        until(lambda: len(self.samples) >= len(texts), f"{texts} arrive", seconds)
        assert sorted(self.texts()) == sorted(texts), f"{self.texts()} arrived, not {texts}"


def advertise(hub: Hub, topic: str, qos: Qos = STREAM, *texts: str, **more: Any) -> HubPublisher:
    """Return a publisher that has published ``texts``."""
    publisher = hub.publisher(topic, TYPE, HASH, qos, **more)
    for text in texts:
        publisher.put(text.encode())
    return publisher


def see_each_other(*hubs: Hub) -> None:
    """Wait until each session discovers the node of every other session."""
    zids = {hub.zid for hub in hubs}
    for hub in hubs:
        until(lambda hub=hub: zids <= {node.zid for node in hub.graph.nodes()}, "all nodes are seen")


def matched(publisher: HubPublisher) -> None:
    """Wait until a publisher is matched."""
    until(publisher.matched, "the publisher is matched")
