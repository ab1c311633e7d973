"""The part of a TCPROS connection that the slave API reports (https://wiki.ros.org/ROS/Slave_API)."""

from __future__ import annotations

import itertools
import socket
from typing import Any, ClassVar

from bridge.adapters.ros1.connection_loop import PolledConnection

_numbers = itertools.count(1)


class TopicConnection(PolledConnection):
    """A connection of one topic.

    Attributes:
        id: the connection's number within this process.
        peer: the node of a subscriber, or the XML-RPC address of a publisher.
        bytes: number of bytes of messages that Python has read or sent, including their length fields.
        messages: number of these messages.
        dropped: number of messages that were not delivered.
        done: whether the connection has ended.
    """

    direction: ClassVar[str]
    """``i`` for a connection to a publisher, ``o`` for one to a subscriber."""

    transport: ClassVar[str] = "TCPROS"

    def __init__(self, sock: socket.socket, peer: str) -> None:
        self.id, self.peer = next(_numbers), peer
        self.bytes = self.messages = self.dropped = 0
        self.done = False
        self._far, self._near = sock.getpeername(), sock.getsockname()
        super().__init__(sock)

    def counts(self) -> tuple[int, int]:
        """Return the numbers of bytes and messages so far, including those in C."""
        return self.bytes, self.messages

    @property
    def host(self) -> str:
        """The peer's address and port."""
        return f"[{self._far[0]}]:{self._far[1]}" if ":" in self._far[0] else f"{self._far[0]}:{self._far[1]}"

    def bus_info(self, topic: str) -> list[Any]:
        """Return an entry of ``getBusInfo``; its text has the form that ``rosnode info`` parses."""
        peer = f"[{self._far[0]}:{self._far[1]} on socket {self.fileno()}]"
        text = f"{self.transport} connection on port {self._near[1]} to {peer}"
        return [self.id, self.peer, self.direction, self.transport, topic, not self.done, text]
