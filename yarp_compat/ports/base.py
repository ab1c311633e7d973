"""The base class of ports, the counters of ports and connections, and the list of this process's open ports."""

from __future__ import annotations

import logging
import os
import socket
import threading
import weakref
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

from yarp_compat.ports.loop import PortLoop
from yarp_compat.ports.message import MessagePeer, PortMessage
from yarp_compat.ports.naming import Naming
from yarp_compat.ports.text_client import ask_profile
from yarp_compat.wire.carriers import Opening
from yarp_compat.wire.contact import ConnectionRoute, PortContact
from yarp_compat.wire.errors import TooLargeError, WireError
from yarp_compat.wire.framing import Buffer, PortCommand
from yarp_compat.wire.profile import Profile

_log = logging.getLogger("yarp.ports")
_lock = threading.Lock()

OnMessage = Callable[[PortMessage], Any]


class OnLine(Protocol):
    """Answers a name server's command line from a peer's address."""

    def __call__(self, line: str, address: tuple[str, int], *, wait: bool) -> bytes | None:
        """Return the answer, or None if it takes time and the caller cannot ``wait``."""


@dataclass(slots=True)
class MessageCounters:
    """Counts of messages sent, received, and ``dropped`` by reason.

    The reasons: ``replaced`` (by a newer message), ``full`` (the oldest in a full strict queue), ``lost`` (the
    connection ended first), ``interrupted`` (the port was interrupted), ``malformed``, ``large`` (above the limit),
    ``no reader``, ``failed`` (the port's owner raised an error), ``no text`` (not a Bottle, for a text carrier),
    ``late`` (a command, while the reader has not acknowledged an earlier one), and for datagrams ``checksum`` and
    ``incomplete``.
    """

    received: int = 0
    sent: int = 0
    dropped: Counter[str] = field(default_factory=Counter)
    whole: Counter[str] | None = None  # the drops of all outputs of the port, closed ones included

    def drop(self, reason: str, count: int = 1) -> None:
        """Count messages that an output dropped."""
        if count:
            with _lock:  # all outputs of a port share `whole`
                self.dropped[reason] += count
                if self.whole is not None:
                    self.whole[reason] += count

    def refuse(self, error: WireError) -> None:
        """Count a malformed or too large message."""
        self.dropped["large" if isinstance(error, TooLargeError) else "malformed"] += 1


class PortBase(ABC):
    """The base class of a port, for its connections. `yarp_compat.ports.port.PortCore` explains the attributes."""

    name: str
    contact: PortContact
    naming: Naming
    rpc: bool
    limit: int
    profile: Profile
    replies: bool
    on_message: OnMessage | None
    on_line: OnLine | None
    counters: MessageCounters
    _loop: PortLoop | None
    _interrupted: bool

    def deliver(self, incoming: PortMessage) -> None:
        """Pass a message to the owner; raises `ConnectionAbortedError`, and sends no reply, if the port is closed."""
        self._check_open()
        counters = self.counters
        counters.received += 1
        if self.on_message is None:
            counters.dropped["no reader"] += 1
        elif self._interrupted:
            self._check_open()  # a port that begins to close in the meantime also interrupts itself
            counters.dropped["interrupted"] += 1
        else:
            try:
                self.on_message(incoming)
            except Exception:
                counters.dropped["failed"] += 1
                incoming.give_up()
                _log.exception("port %s: callback failed on a message from %s", self.name, incoming.peer.route.source)

    def _check_open(self) -> None:
        if self._loop is None:
            raise ConnectionAbortedError(f"port {self.name} is closed")

    def refused(self, route: ConnectionRoute, error: WireError) -> None:
        """Count and log a malformed or too large message, which ends the connection."""
        self.counters.refuse(error)
        _log.warning("port %s closes the connection from %s: %s", self.name, route.source, error)

    @abstractmethod
    def administer(self, payload: Buffer, peer: MessagePeer) -> bytes:
        """Execute an administrative command and return the answer's Bottle."""

    @abstractmethod
    def execute(self, word: PortCommand) -> tuple[str, ...]:
        """Execute a port command and return the answer's lines, for text carriers."""

    @abstractmethod
    def attach(self, sock: socket.socket, opened: Opening) -> None:
        """Add an input connection from a port of the same process."""

    @abstractmethod
    def ended(self, peer: MessagePeer, reversed_socket: socket.socket | None = None) -> None:
        """Remove an input connection; ``reversed_socket``: its socket, if the peer asked to reverse it."""

    @abstractmethod
    def abandon(self) -> None:
        """Close the sockets in a forked child process, without notifying peers or the name server."""


_ports: weakref.WeakSet[PortBase] = weakref.WeakSet()


def note_open(port: PortBase) -> None:
    """List a port that has opened."""
    with _lock:
        _ports.add(port)


def note_closed(port: PortBase) -> None:
    """Remove from the list a port that is closing."""
    with _lock:
        _ports.discard(port)


def port_of_process(contact: PortContact) -> PortBase | None:
    """Return the open port of this process with that name and number, if any."""
    with _lock:
        return next((p for p in _ports if (p.name, p.contact.port) == (contact.name, contact.port)), None)


def _forked() -> None:
    """Abandon all ports in a forked child process: the threads and connections belong to the parent."""
    global _lock, _ports
    _lock = threading.Lock()
    ports, _ports = list(_ports), weakref.WeakSet()
    for port in ports:
        port.abandon()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forked)


def dialect_of(naming: Naming, name: str) -> Profile | None:
    """Return the dialect of a port by its name; blocks like `ask_profile`."""
    try:
        contact = naming.query(name)
    except OSError:
        return None
    return dialect_at(contact) if contact is not None and contact.is_valid else None


def dialect_at(contact: PortContact) -> Profile | None:
    """Return the dialect of a port by its contact; blocks like `ask_profile`."""
    local = port_of_process(contact)
    return ask_profile(contact) if local is None else local.profile
