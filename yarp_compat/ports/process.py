"""The open ports of this process, which can be connected to each other by the carrier ``local``."""

from __future__ import annotations

import os
import threading
import weakref
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from yarp_compat.ports.port import PortCore
    from yarp_compat.wire.contact import Contact

_lock = threading.Lock()
_ports: weakref.WeakSet[PortCore] = weakref.WeakSet()


def add(port: PortCore) -> None:
    """A port opened."""
    with _lock:
        _ports.add(port)


def remove(port: PortCore) -> None:
    """A port closed."""
    with _lock:
        _ports.discard(port)


def find(contact: Contact) -> PortCore | None:
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
