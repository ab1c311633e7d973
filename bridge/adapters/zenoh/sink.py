"""Putting samples on a key of a foreign dialect, each with our mark."""

from __future__ import annotations

import contextlib

import zenoh

from bridge.hub.qos import Qos

_NUMBERS = 0xFFFFFFFF


def is_command(qos: Qos) -> bool:
    """Whether only the newest message counts: volatile with depth 1, as the engine asks for commands."""
    return qos.depth == 1 and not qos.latched


def priority(qos: Qos) -> zenoh.Priority:
    """The priority in zenoh of what has this QoS: commands before state before streams."""
    if is_command(qos):
        return zenoh.Priority.INTERACTIVE_HIGH
    return zenoh.Priority.DATA_HIGH if qos.latched else zenoh.Priority.DATA


class PlainSink:
    """Puts on a key; each sample carries our session's marked id. Also for the other dialects.

    Commands (volatile, depth 1) go before all else.
    """

    def __init__(self, session: zenoh.Session, key: str, qos: Qos, encoding: zenoh.Encoding | None = None) -> None:
        self._encoding = encoding
        self.publisher = session.declare_publisher(
            key,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=priority(qos),
            express=is_command(qos),
            allowed_destination=zenoh.Locality.REMOTE,
        )
        self._id = self.publisher.id
        self._number = 0

    def put(self, payload: bytes) -> None:
        """Publish; one thread at a time."""
        self._number += 1
        info = zenoh.SourceInfo(self._id, self._number & _NUMBERS)
        with contextlib.suppress(zenoh.ZError):  # the session is being closed
            self.publisher.put(payload, source_info=info, encoding=self._encoding)

    def close(self) -> None:
        """Give the publisher back."""
        with contextlib.suppress(zenoh.ZError):
            self.publisher.undeclare()  # type: ignore[no-untyped-call]
