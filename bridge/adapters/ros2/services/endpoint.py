"""The base of clients and servers: rclpy's object, and a watch on the peers' processes."""

from __future__ import annotations

import threading
from abc import abstractmethod
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

from typing_extensions import override

from bridge.adapters.ros2 import rcl
from bridge.adapters.ros2.graph.graph import Ros2Graph
from bridge.adapters.ros2.graph.heartbeats import Heartbeats
from bridge.adapters.ros2.graph.neighbors import ProcessWatch
from bridge.adapters.ros2.graph.origins import PREFIX_BYTES
from bridge.adapters.ros2.loop import EndpointReader, ReadLoop
from bridge.adapters.ros2.participant import Participant
from bridge.concurrency import DelayedCalls

_CHECK_SECONDS = 0.5
"""Seconds between two checks whether a peer's process has ended: DDS notices that only when its lease expires."""


@dataclass(frozen=True, slots=True)
class Ros2Context:
    """The shared state of the edge's endpoints."""

    participant: Participant
    loop: ReadLoop
    graph: Ros2Graph
    processes: ProcessWatch
    later: DelayedCalls
    heartbeats: Heartbeats


Closed = Callable[[Any], None]
"""Called with an endpoint that has closed."""


class ServiceEndpoint(EndpointReader):
    """A client or a server. While calls are pending it checks whether the peers' processes are alive."""

    def __init__(self, name: str, service_class: Any, handle: Any, context: Ros2Context) -> None:
        super().__init__(context.participant, handle)
        self.name, self.type_name = name, str(service_class.type_name)
        self._loop, self._graph = context.loop, context.graph
        self._later, self._processes = context.later, context.processes
        self._taker = rcl.CallTaker()
        self._lock = threading.Lock()
        self._checking = self._closed = False

    @override
    def destroy(self) -> None:
        self._taker.close()
        super().destroy()

    def _ended_among(self, gids: Collection[bytes]) -> set[bytes]:
        """Return the GUID prefixes of participants whose processes ran on this host and have ended."""
        return {prefix for prefix in {gid[:PREFIX_BYTES] for gid in gids} if self._processes.has_ended(prefix)}

    def _check_soon(self) -> None:
        """Schedule one call of `_check_processes`; the lock is held."""
        if not self._checking:
            self._checking = True
            self._later.after(_CHECK_SECONDS, self._check_processes)

    @abstractmethod
    def _check_processes(self) -> None:
        """Check whether processes have ended; resets ``_checking`` first."""
