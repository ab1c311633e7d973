"""The base of clients and servers: their DDS endpoints, and a watch on the peers' processes."""

from __future__ import annotations

import threading
from abc import abstractmethod
from collections.abc import Collection
from typing import Any

from typing_extensions import override

from bridge.adapters.ros2 import rcl
from bridge.adapters.ros2.context import Ros2Context
from bridge.adapters.ros2.graph.origins import PREFIX_BYTES
from bridge.adapters.ros2.loop import EndpointReader
from bridge.adapters.ros2.services.port import ServicePort

_CHECK_SECONDS = 0.5
"""Seconds between two checks whether a peer's process has ended: DDS notices that only when its lease expires."""


class ServiceEndpoint(EndpointReader):
    """A client or a server. While calls are pending it checks whether the peers' processes are alive."""

    def __init__(self, name: str, service_class: Any, port: ServicePort, context: Ros2Context) -> None:
        super().__init__(context.participant, port.handle)
        self._service_port = port
        self.name, self.type_name = name, str(service_class.type_name)
        self._loop, self._graph = context.loop, context.graph
        self._later, self._processes = context.later, context.processes
        self._lock = threading.Lock()
        self._checking = self._closed = False

    @override
    def wake(self, waker: rcl.Waker | None) -> None:
        self._service_port.wake(waker)

    @override
    def destroy(self) -> None:
        self._service_port.close()
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
