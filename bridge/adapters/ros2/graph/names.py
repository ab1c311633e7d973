"""Detects nodes of one name, which ROS 2 allows although their services and parameters then have the same names."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable

from bridge.concurrency import DelayedCalls
from bridge.routing.edge import Endpoint, Kind, MadeBy

_log = logging.getLogger(__name__)

PERIOD = 5.0
"""Seconds between two checks."""

LEASE_SECONDS = 30.0
"""Seconds after which nodes of one name are reported; DDS lists a killed node beside its successor for its lease, which
is 20 s by default in Fast DDS."""


class NamesakeWatch:
    """Checks whether native nodes have the same name, as far as they serve the same services.

    Attributes:
        texts: a warning for each name that several nodes have had for longer than a lease.
    """

    def __init__(self, endpoints: Callable[[], Iterable[Endpoint]], later: DelayedCalls) -> None:
        self._endpoints = endpoints
        self._since: dict[str, float] = {}
        self.texts: list[str] = []
        later.every(PERIOD, self.check)

    def check(self) -> None:
        """Compare the names now, and log new warnings."""
        now, shared = time.monotonic(), _shared_names(self._endpoints())
        self._since = {node: self._since.get(node, now) for node in shared}
        texts = [
            f"{count} ROS 2 nodes are named {node}: a call, for example of {service}, is answered by any of them;"
            " rename or stop all but one (ros2 run ... --ros-args -r __node:=NAME)"
            for node, (count, service) in shared.items()
            if now - self._since[node] >= LEASE_SECONDS
        ]
        for text in texts:
            if text not in self.texts:
                _log.warning("%s", text)
        self.texts = texts


def _shared_names(endpoints: Iterable[Endpoint]) -> dict[str, tuple[int, str]]:
    """Return the number of native nodes with one name and a service that all of them serve, by the name."""
    servers: dict[tuple[str, str], set[str]] = {}
    for endpoint in endpoints:
        if endpoint.kind is Kind.SERVER and endpoint.made_by is MadeBy.NATIVE and endpoint.node:
            servers.setdefault((endpoint.node, endpoint.topic), set()).add(endpoint.id)
    shared: dict[str, tuple[int, str]] = {}
    for (node, service), ids in sorted(servers.items()):
        if len(ids) > shared.get(node, (1, ""))[0]:
            shared[node] = len(ids), service
    return shared
