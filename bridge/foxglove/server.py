"""The SDK's server: where it listens, its channels, what it says to all clients.

The protocol is ``foxglove.sdk.v1`` (https://github.com/foxglove/foxglove-sdk). What the SDK 0.30 does by itself, from
its sources and as measured: each client has a queue of `BACKLOG` messages, whose oldest are dropped where it is slow,
and one of as many announcements and replies, whose overflow cuts it; so does a frame of its own of more than 16 MiB.
"""

from __future__ import annotations

import logging
from typing import Any

import foxglove
from foxglove.websocket import Capability, ServerListener

from bridge.config.sections.web import split

_log = logging.getLogger("midspan.foxglove")

BACKLOG = 256
"""Messages, or announcements, that wait for a client."""


class FoxgloveServer:
    """Serves from its making on. Raises `RuntimeError` where it cannot listen."""

    def __init__(self, name: str, listen: str, listener: ServerListener, capabilities: list[Capability]) -> None:
        self._context = foxglove.Context()
        host, port = split(listen)
        try:
            self._server = foxglove.start_server(
                name=name, host=host, port=port, context=self._context, server_listener=listener,
                capabilities=capabilities, supported_encodings=["cdr", "json"], message_backlog_size=BACKLOG,
            )  # fmt: skip
        except Exception as err:  # the SDK's own kinds, which it does not name
            raise RuntimeError(f"the Foxglove server cannot listen on {listen}: {err}; set foxglove.listen") from None
        self.address = f"ws://{f'[{host}]' if ':' in host else host}:{self._server.port}"
        self.port = self._server.port

    def channel(self, topic: str, type_name: str, definition: str, metadata: dict[str, str]) -> Any:
        """Announce a topic of CDR; the channel has ``id()``, ``log(payload, time_ns)`` and ``close()``.

        The SDK's own class `foxglove.Channel` would keep each channel for ever, also those of topics that are gone.
        """
        schema = foxglove.Schema(name=type_name, encoding="ros2msg", data=definition.encode())
        return self._context._create_channel(topic, message_encoding="cdr", schema=schema, metadata=metadata)

    def close(self) -> None:
        """Cut all clients. Safe to call twice."""
        self._server.stop()
