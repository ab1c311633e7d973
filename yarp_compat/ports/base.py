"""A port as its parts see it, the counters of ports and connections, and the open ports of this process."""

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
from typing import Any

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
OnLine = Callable[[str, tuple[str, int]], bytes]


@dataclass(slots=True)
class MessageCounters:
    """Messages, by one direction each; ``dropped`` by reason.

    The reasons: ``replaced`` (a newer message took its place), ``full`` (the oldest of a strict queue that was full),
    ``lost`` (the connection ended first), ``interrupted`` (the port was), ``malformed``, ``large`` (above the limit),
    ``no reader``, ``failed`` (the port's owner raised an error), ``no text`` (no Bottle, for a reader of text), and for
    datagrams ``checksum`` and ``incomplete``.
    """

    received: int = 0
    sent: int = 0
    dropped: Counter[str] = field(default_factory=Counter)
    whole: Counter[str] | None = None  # the drops of all outputs of the port, those that have ended too

    def drop(self, reason: str, count: int = 1) -> None:
        """Count messages that an output lost."""
        if count:
            with _lock:  # the outputs of a port share what is counted of them all
                self.dropped[reason] += count
                if self.whole is not None:
                    self.whole[reason] += count

    def refuse(self, error: WireError) -> None:
        """Count what came and is no message that is taken."""
        self.dropped["large" if isinstance(error, TooLargeError) else "malformed"] += 1


class PortBase(ABC):
    """A port as its parts see it. The whole is `yarp_compat.ports.port.PortCore`, which explains the attributes."""

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
        """Give a message to the owner; raises `ConnectionAbortedError` where the port closes: nobody is answered."""
        if self._loop is None:
            raise ConnectionAbortedError(f"port {self.name} is closed")
        counters = self.counters
        counters.received += 1
        if self.on_message is None:
            counters.dropped["no reader"] += 1
        elif self._interrupted:
            counters.dropped["interrupted"] += 1
        else:
            try:
                self.on_message(incoming)
            except Exception:
                counters.dropped["failed"] += 1
                incoming.give_up()
                _log.exception("port %s: its owner failed on a message from %s", self.name, incoming.peer.route.source)

    def refused(self, route: ConnectionRoute, error: WireError) -> None:
        """A connection said something that is no message, or announced one that is too large."""
        self.counters.refuse(error)
        _log.warning("port %s ends the connection from %s: %s", self.name, route.source, error)

    @abstractmethod
    def administer(self, payload: Buffer, peer: MessagePeer) -> bytes:
        """Obey an administrative command; returns the answer's Bottle."""

    @abstractmethod
    def obey(self, word: PortCommand) -> tuple[str, ...]:
        """Obey a port command; returns the lines that text carriers answer."""

    @abstractmethod
    def attach(self, sock: socket.socket, opened: Opening) -> None:
        """Take a connection from a port of the same process."""

    @abstractmethod
    def ended(self, peer: MessagePeer, turned: socket.socket | None = None) -> None:
        """An input connection is over; ``turned`` is its socket where it asked to be an output."""

    @abstractmethod
    def abandon(self) -> None:
        """In a child process of fork: let go of the sockets, and say nothing to anybody."""


_ports: weakref.WeakSet[PortBase] = weakref.WeakSet()


def note_open(port: PortBase) -> None:
    """A port opened."""
    with _lock:
        _ports.add(port)


def note_closed(port: PortBase) -> None:
    """A port closed."""
    with _lock:
        _ports.discard(port)


def port_of_process(contact: PortContact) -> PortBase | None:
    """The port of this process at that name and number, if there is one."""
    with _lock:
        return next((p for p in _ports if (p.name, p.contact.port) == (contact.name, contact.port)), None)


def _forked() -> None:
    """In a child process of fork: the threads are gone, and the connections belong to the parent."""
    global _lock, _ports
    _lock = threading.Lock()
    ports, _ports = list(_ports), weakref.WeakSet()
    for port in ports:
        port.abandon()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forked)


def dialect_of(naming: Naming, name: str) -> Profile | None:
    """The dialect of the port of a name; takes a while, see `ask_profile`."""
    try:
        contact = naming.query(name)
    except OSError:
        return None
    return dialect_at(contact) if contact is not None and contact.is_valid else None


def dialect_at(contact: PortContact) -> Profile | None:
    """The same of the port at a place."""
    there = port_of_process(contact)
    return ask_profile(contact) if there is None else there.profile
