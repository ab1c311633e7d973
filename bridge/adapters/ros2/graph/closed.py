"""Endpoints on Cyclone DDS that have closed, although Fast DDS still lists them.

Cyclone DDS announces the end of an endpoint by its GUID in a parameter list, without a key hash. Fast DDS (2.14.5 and
3.2, ``MessageReceiver.cpp``) reads neither, as the list is longer than a key hash, and lists the endpoint until its
participant leaves. But a ROS program also announces which endpoints each of its nodes has. So an endpoint that has
belonged to a node, and no longer does, has closed. Older versions of rmw_cyclonedds_cpp do not announce that of
subscriptions (ros2/rmw_cyclonedds #594).
"""

from __future__ import annotations

import threading
from collections.abc import Collection

from bridge.adapters.ros2.graph import vendors
from bridge.adapters.ros2.graph.origins import PREFIX_BYTES


class ClosedEndpoints:
    """Detects closed endpoints by the nodes that endpoints belong to; thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._of_nodes: set[bytes] = set()

    def is_closed(self, gid: bytes, node: str) -> bool:
        """Return whether a listed endpoint has closed; ``node`` is the node that it belongs to now, "" for none."""
        if not vendors.is_cyclone(gid):
            return False
        with self._lock:
            if node:
                self._of_nodes.add(gid)
            return not node and gid in self._of_nodes

    def retain(self, participants: Collection[bytes]) -> None:
        """Forget the endpoints of all participants except those with these GUID prefixes."""
        with self._lock:
            self._of_nodes = {gid for gid in self._of_nodes if gid[:PREFIX_BYTES] in participants}
