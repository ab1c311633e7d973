"""A port that answers an interface's calls, between ``with`` and its end: the counterpart of `ServiceClient`.

with ServiceServer("/planner/rpc", Navigation2DServer(Planner())): ...
"""

from __future__ import annotations

from typing import Any

from yarp_compat.dev.server import Server
from yarp_compat.dev.service import Service
from yarp_compat.naming.naming import Naming
from yarp_compat.ports.message import Message
from yarp_compat.pythonic import OpenPort
from yarp_compat.wire.generation import Generations


class ServiceServer(OpenPort):
    """Answers clients of every release of YARP, each on the thread of its connection.

    Args:
        name: the port's name.
        service: the implementation.
        generations: what peers are answered in; by default as they introduce themselves.
        naming: who knows the names; by default the name server of ``yarp.conf``.
        options: more arguments of `PortCore`.
    """

    def __init__(
        self,
        name: str,
        service: Service,
        *,
        generations: Generations | None = None,
        naming: Naming | None = None,
        **options: Any,
    ) -> None:
        self._server = Server(service, generations)
        options = {"is_output": False, "rpc": True, "on_event": self._server.on_event, **options}
        super().__init__(name, naming=naming, **options)

    def _take(self, message: Message) -> None:
        self._server(message)
