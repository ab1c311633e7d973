"""The ROS 2 graph as our participant sees it, followed by a thread.

The middleware's graph guard condition wakes the thread; it then looks at the whole graph, which costs about 20 ms for
500 topics with two endpoints each, and rests ten times as long as it looked.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy

from bridge.adapters.base import Endpoint, Kind, MadeBy
from bridge.adapters.ros2 import rcl
from bridge.adapters.ros2.mark import PREFIX_BYTES, is_marked
from bridge.adapters.ros2.qos import from_rclpy

_UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"
"""rmw's name for the node of an endpoint whose participant has not told its nodes yet (or is no ROS node's)."""

_DISCOVERY = "ros_discovery_info"
"""The DDS topic on which every ROS participant tells its nodes: its writers are the participants."""

_SETTLE = 0.02
_POLL = 5.0
_REST = 10

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The graph at one moment, without our own endpoints.

    Attributes:
        endpoints: publishers and subscriptions of ROS topics, hidden ones left out.
        publishers: the publishers by topic and GID.
        participants: GUID prefixes of all ROS participants but ours.
    """

    endpoints: tuple[Endpoint, ...] = ()
    publishers: Mapping[str, Mapping[bytes, Endpoint]] = field(default_factory=dict)
    participants: frozenset[bytes] = frozenset()


class Graph:
    """Follows the graph; `snapshot` is the latest look."""

    def __init__(self, node: Any, own_prefix: bytes, changed: Callable[[Snapshot], None]) -> None:
        self._node, self._own, self._changed = node, own_prefix, changed
        self.snapshot = Snapshot()
        self._guard: Any = node.create_guard_condition(_nothing)
        self._graph_guard = rcl.graph_guard_condition(node.handle.pointer)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="midspan-ros2-graph", daemon=True)

    def start(self) -> None:
        """Look once, then follow."""
        self.snapshot = self.look()
        self._thread.start()

    def stop(self) -> None:
        """End the thread."""
        self._stopping.set()
        self._guard.trigger()
        if self._thread.is_alive():
            self._thread.join()

    def publishers(self, topic: str) -> Mapping[bytes, Endpoint]:
        """A topic's publishers by GID, as last seen."""
        return self.snapshot.publishers.get(topic, {})

    def find(self, topic: str, gid: bytes) -> Endpoint | None:
        """One publisher, looked up anew where the last look does not know it."""
        found = self.publishers(topic).get(gid)
        if found is None:
            found = next((e for g, e in self._endpoints_of(topic, Kind.PUBLISHER) if g == gid), None)
        return found

    def look(self) -> Snapshot:
        """The whole graph now."""
        endpoints: list[Endpoint] = []
        publishers: dict[str, dict[bytes, Endpoint]] = {}
        for topic, _types in self._node.get_topic_names_and_types():
            if is_hidden(topic):
                continue
            found = self._endpoints_of(topic, Kind.PUBLISHER)
            if found:
                publishers[topic] = dict(found)
            endpoints += [e for _, e in found]
            endpoints += [e for _, e in self._endpoints_of(topic, Kind.SUBSCRIPTION)]
        prefixes = {
            bytes(info.endpoint_gid)[:PREFIX_BYTES]
            for info in self._node.get_publishers_info_by_topic(_DISCOVERY, no_mangle=True)
        }
        return Snapshot(tuple(endpoints), publishers, frozenset(prefixes - {self._own}))

    def _endpoints_of(self, topic: str, kind: Kind) -> list[tuple[bytes, Endpoint]]:
        if kind is Kind.PUBLISHER:
            infos = self._node.get_publishers_info_by_topic(topic)
        else:
            infos = self._node.get_subscriptions_info_by_topic(topic)
        found = []
        for info in infos:
            gid = bytes(info.endpoint_gid)
            if gid[:PREFIX_BYTES] != self._own:
                found.append((gid, _endpoint(topic, kind, gid, info)))
        return found

    def _run(self) -> None:
        wait_set = _rclpy.WaitSet(0, 2, 0, 0, 0, 0, self._node.context.handle)
        with self._node.handle, self._guard.handle, wait_set:
            while not self._stopping.is_set():
                started = time.monotonic()
                try:
                    self._update()
                except Exception:
                    _log.exception("looking at the ROS 2 graph failed")
                self._stopping.wait(max(_SETTLE, _REST * (time.monotonic() - started)))
                if self._stopping.is_set():
                    break
                wait_set.clear_entities()
                wait_set.add_guard_condition(self._guard.handle)
                rcl.wait_set_add_guard_condition(wait_set.pointer, self._graph_guard)
                wait_set.wait(int(_POLL * 1e9))
                self._stopping.wait(_SETTLE)

    def _update(self) -> None:
        snapshot = self.look()
        if snapshot != self.snapshot:
            self.snapshot = snapshot
            self._changed(snapshot)

    def close(self) -> None:
        """Give the guard condition back; the thread has ended."""
        with contextlib.suppress(Exception):
            self._node.destroy_guard_condition(self._guard)


def is_hidden(topic: str) -> bool:
    """Whether a name has a part that begins with an underscore: hidden by ROS 2's rule, actions' topics among them."""
    return "/_" in topic


def _endpoint(topic: str, kind: Kind, gid: bytes, info: Any) -> Endpoint:
    name = str(info.node_name)
    announced = str(info.topic_type_hash)
    return Endpoint(
        id=gid.hex(),
        kind=kind,
        topic=topic,
        type=str(info.topic_type),
        qos=from_rclpy(info.qos_profile),
        made_by=MadeBy.MIDSPAN if is_marked(gid) else MadeBy.NATIVE,
        node="" if name == _UNKNOWN_NODE else f"{str(info.node_namespace).rstrip('/')}/{name}",
        type_id=announced if announced.startswith("RIHS01_") else "",
    )


def _nothing() -> None:
    """The guard condition's callback, which no executor calls."""
