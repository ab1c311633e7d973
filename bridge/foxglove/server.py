"""The SDK's server: where it listens, its channels, what it says to all clients.

The protocol is ``foxglove.sdk.v1`` (https://github.com/foxglove/foxglove-sdk). What the SDK 0.30 does by itself, from
its sources and as measured: each client has a queue of `BACKLOG` messages, whose oldest are dropped where it is slow,
and one of as many announcements and replies, whose overflow cuts it; so does a frame of its own of more than 16 MiB.
"""

from __future__ import annotations

import secrets
import sys
from typing import Any

import foxglove
from foxglove.channels import SceneUpdateChannel
from foxglove.websocket import Capability, ServerListener, StatusLevel

BACKLOG = 256
"""Messages, or announcements, that wait for a client."""


class FoxgloveServer:
    """Serves from its making on, on an address of loopback that nobody is told. Raises `RuntimeError`.

    Attributes:
        inner: that address and port.
    """

    def __init__(self, name: str, listener: ServerListener, capabilities: list[Capability]) -> None:
        self._context = foxglove.Context()
        host = _hidden_address()
        try:
            self._server = foxglove.start_server(
                name=name, host=host, port=0, context=self._context, server_listener=listener,
                capabilities=capabilities, supported_encodings=["cdr", "json"], message_backlog_size=BACKLOG,
            )  # fmt: skip
        except Exception as err:  # the SDK's own kinds, which it does not name
            raise RuntimeError(f"the Foxglove SDK cannot listen on {host}: {err}") from None
        self.inner = host, self._server.port

    def channel(self, topic: str, type_name: str, definition: str, metadata: dict[str, str]) -> Any:
        """Announce a topic of CDR; the channel has ``id()``, ``log(payload, time_ns)`` and ``close()``.

        The SDK's own class `foxglove.Channel` would keep each channel for ever, also those of topics that are gone.
        """
        schema = foxglove.Schema(name=type_name, encoding="ros2msg", data=definition.encode())
        return self._context._create_channel(topic, message_encoding="cdr", schema=schema, metadata=metadata)

    def scene(self, topic: str) -> SceneUpdateChannel:
        """Announce a scene."""
        return SceneUpdateChannel(topic, context=self._context)

    def offer_services(self, services: list[foxglove.Service]) -> None:
        """Announce services."""
        self._server.add_services(services)

    def withdraw_services(self, names: list[str]) -> None:
        """Take services back."""
        self._server.remove_services(names)

    def warn(self, text: str, name: str) -> None:
        """Tell all clients something that is so until `forget`."""
        self._server.publish_status(text, StatusLevel.Warning, name)

    def clear_warning(self, name: str) -> None:
        """Take back what was told."""
        self._server.remove_status([name])

    def close(self) -> None:
        """Cut all clients. Safe to call twice."""
        self._server.stop()


def _hidden_address() -> str:
    """One that a page which tries all ports of 127.0.0.1 does not find; systems other than Linux have no others."""
    if sys.platform != "linux":
        return "127.0.0.1"
    return f"127.{secrets.randbelow(254) + 1}.{secrets.randbelow(254) + 1}.{secrets.randbelow(254) + 1}"
