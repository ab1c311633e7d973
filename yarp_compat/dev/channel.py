"""A client's way to its server: over an RPC port's one output."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from yarp_compat.wire.generation import Generation
from yarp_compat.wire.message import Buffer
from yarp_compat.wire.profile import Profile


class Requester(Protocol):
    """A port that asks: `yarp_compat.ports.port.PortCore`."""

    @property
    def answers_in(self) -> Profile | None:
        """The dialect of the port that answers, where that is known."""

    def request(
        self, payload: bytes, envelope: str = "", *, timeout: float | None, parse: Callable[[Buffer], int]
    ) -> bytes:
        """Send a request and return the reply, which ends where ``parse`` says."""


class PortChannel:
    """Sends an interface's requests through a port.

    Args:
        port: connected to the server's port, by a binary carrier.
        generation: what the server is taken for until its port or its replies tell.
        timeout: seconds to wait for a reply; None: for ever.
    """

    def __init__(
        self, port: Requester, generation: Generation = Generation.YARP_3_12, timeout: float | None = None
    ) -> None:
        self._generation = generation
        self._has_told = False
        self._port = port
        self._timeout = timeout

    @property
    def generation(self) -> Generation:
        """The server's, as far as it is known; its replies set it."""
        profile = self._port.answers_in
        if not self._has_told and profile is not None and profile is not self._generation.profile:
            self._generation = Generation.newest(profile)
        return self._generation

    @generation.setter
    def generation(self, generation: Generation) -> None:
        self._generation, self._has_told = generation, True

    def request(self, payload: bytes, parse: Callable[[Buffer], int]) -> Buffer:
        """Send a request and return the reply.

        Raises:
            TimeoutError: none came in time.
            ConnectionError: there is no server.
        """
        return self._port.request(payload, timeout=self._timeout, parse=parse)
