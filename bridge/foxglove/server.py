"""The SDK's server: its address, its channels, and warnings to all clients.

The protocol is ``foxglove.sdk.v1`` (https://github.com/foxglove/foxglove-sdk). Behavior of the SDK 0.30, from its
sources and measurements: each client has a queue of `BACKLOG` messages, whose oldest are dropped if the client is slow,
and an equally long queue of announcements and replies. A client whose second queue overflows, or that sends a frame
larger than 16 MiB, is disconnected.
"""

from __future__ import annotations

import secrets
import sys
from typing import Any

import foxglove
from foxglove.channels import SceneUpdateChannel
from foxglove.websocket import Capability, ServerListener, StatusLevel

BACKLOG = 256
"""Maximum number of messages, and of announcements, that are queued for a client."""


class FoxgloveServer:
    """Serves on an unpublished loopback address, from its construction on. Raises `RuntimeError` if it cannot listen.

    Attributes:
        inner: the loopback address, and the port.
    """

    def __init__(self, name: str, listener: ServerListener, capabilities: list[Capability]) -> None:
        self._context = foxglove.Context()
        host = _hidden_address()
        try:
            self._server = foxglove.start_server(
                name=name, host=host, port=0, context=self._context, server_listener=listener,
                capabilities=capabilities, supported_encodings=["cdr", "json"], message_backlog_size=BACKLOG,
            )  # fmt: skip
        except Exception as err:  # the SDK does not document its exceptions
            raise RuntimeError(f"the Foxglove SDK cannot listen on {host}: {err}") from None
        self.inner = host, self._server.port

    def channel(self, topic: str, type_name: str, definition: str, metadata: dict[str, str]) -> Any:
        """Announce a topic of CDR messages; the channel has ``id()``, ``log(payload, time_ns)`` and ``close()``.

        The SDK's class `foxglove.Channel` would keep every channel forever, even if its topic no longer exists.
        """
        schema = foxglove.Schema(name=type_name, encoding="ros2msg", data=definition.encode())
        return self._context._create_channel(topic, message_encoding="cdr", schema=schema, metadata=metadata)

    def scene(self, topic: str) -> SceneUpdateChannel:
        """Announce a channel for scene updates."""
        return SceneUpdateChannel(topic, context=self._context)

    def offer_services(self, services: list[foxglove.Service]) -> None:
        """Announce services to all clients."""
        self._server.add_services(services)

    def withdraw_services(self, names: list[str]) -> None:
        """Remove services, by name, from the list that clients see."""
        self._server.remove_services(names)

    def warn(self, text: str, name: str) -> None:
        """Show a warning in all clients until `clear_warning`."""
        self._server.publish_status(text, StatusLevel.Warning, name)

    def clear_warning(self, name: str) -> None:
        """Remove the warning of this name from all clients."""
        self._server.remove_status([name])

    def close(self) -> None:
        """Disconnect all clients. Safe to call twice."""
        self._server.stop()


def _hidden_address() -> str:
    """Return a loopback address that no page finds by scanning 127.0.0.1 (only on Linux, which has all 127.0.0.0/8)."""
    if sys.platform != "linux":
        return "127.0.0.1"
    return f"127.{secrets.randbelow(254) + 1}.{secrets.randbelow(254) + 1}.{secrets.randbelow(254) + 1}"
