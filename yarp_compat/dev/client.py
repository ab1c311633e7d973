"""A client of an interface: a port of its own that is connected to a server's, and again where the server was away."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, Self, TypeVar

from yarp_compat.dev.channel import PortChannel
from yarp_compat.dev.service import Service
from yarp_compat.naming.errors import PortError
from yarp_compat.naming.naming import Naming
from yarp_compat.pythonic import Client
from yarp_compat.wire.generation import Generation
from yarp_compat.wire.message import Buffer

S = TypeVar("S", bound=Service)

PATIENCE = 10.0
"""Seconds to wait for a reply by default."""


class ServiceClient(Client, Generic[S]):
    """Calls a server's methods: ``client.remote.get_map_names_RPC()``.

    Args:
        interface: what the server offers.
        server: its port; ``fast_tcp://map2D_nws_yarp/rpc`` says the carrier too.
        name: the own port's name; empty lets the name server choose one.
        timeout: seconds to wait for a reply; None: for ever.
        naming: who knows the names; by default the name server of ``yarp.conf``.
    """

    def __init__(
        self,
        interface: type[S],
        server: str,
        name: str = "",
        *,
        timeout: float | None = PATIENCE,
        naming: Naming | None = None,
    ) -> None:
        super().__init__(server, name, naming=naming)
        self._channel = _Lasting(self, timeout)
        self.remote = interface(self._channel)

    @property
    def generation(self) -> Generation:
        """The server's release, as far as it is known."""
        return self._channel.generation

    def open(self) -> Self:
        """Open the port, connect it, and introduce it: so YARP 4's servers want it.

        Raises:
            NamingError: there is no name server.
            PortError: there is no such server.
        """
        super().open()
        try:
            self.remote.introduce()
        except BaseException:
            self.close()
            raise
        return self


class _Lasting(PortChannel):
    """A channel that connects again before a call; a call that was under way is never made twice."""

    def __init__(self, client: Client, timeout: float | None) -> None:
        super().__init__(client.core, timeout=timeout)
        self._client = client

    def request(self, payload: bytes, parse: Callable[[Buffer], int]) -> Buffer:
        core = self._client.core
        if core.is_open and not core.connections.outputs:
            try:
                self._client.connect(self._client.server)
            except PortError as error:
                raise ConnectionRefusedError(str(error)) from error
        return super().request(payload, parse)
