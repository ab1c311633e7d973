"""The state that a program's ports share: their name server, and the list of open ports to close at exit.

This module also finds Midspan daemons, whose ports have a property at the name server.
"""

from __future__ import annotations

import atexit
import logging
import os
import threading
import weakref
from collections.abc import Callable

from yarp_compat.naming.client import NameClient
from yarp_compat.os.log import print_as_yarp
from yarp_compat.os.time import useSystemClock
from yarp_compat.ports import text_client
from yarp_compat.ports.naming import LocalNaming, Naming, NamingError, Unregistered
from yarp_compat.ports.sockets import Closable
from yarp_compat.wire.contact import PortContact
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.text import from_text

log = logging.getLogger("yarp.os.Network")


class Runtime:
    """The state of `Network`'s static methods."""

    def __init__(self) -> None:
        self._users = 0
        self._local: LocalNaming | None = None
        self._client: NameClient | None = None
        self._open: weakref.WeakSet[Closable] = weakref.WeakSet()
        self._lock = threading.RLock()

    @property
    def is_up(self) -> bool:
        """Whether `init` was called more often than `fini`."""
        return self._users > 0

    def init(self, prepare: Callable[[], None]) -> None:
        """Start using the network; the first call also calls ``prepare``."""
        with self._lock:
            self._users += 1
            if self._users == 1:
                print_as_yarp()
                atexit.register(self.close_all)
                prepare()

    def fini(self) -> None:
        """Stop using the network; the last call closes all open ports."""
        with self._lock:
            self._users = max(0, self._users - 1)
            if self._users:
                return
            atexit.unregister(self.close_all)
        useSystemClock()
        self.close_all()
        self._client = None

    def close_all(self) -> None:
        """Close all open ports."""
        for port in list(self._open):
            port.close()

    def opened(self, port: Closable) -> None:
        """Add an open port, which is closed with the network at the latest."""
        self._open.add(port)

    def closed(self, port: Closable) -> None:
        """Remove a closed port."""
        self._open.discard(port)

    @property
    def naming(self) -> Naming:
        """The name server's client, or in local mode a registry in this process."""
        with self._lock:
            if self._local is not None:
                return self._local
            if self._client is None:
                self._client = NameClient()
            return self._client

    @property
    def unregistered(self) -> Naming:
        """A client that finds the same names, but registers none."""
        return Unregistered(self.naming)

    @property
    def client(self) -> NameClient | None:
        """The name server's client; None in local mode."""
        naming = self.naming
        return naming if isinstance(naming, NameClient) else None

    def listed(self, folder: str = "") -> list[PortContact]:
        """Return the registered ports, or those below a name."""
        naming = self.naming
        return naming.list(folder) if isinstance(naming, (NameClient, LocalNaming)) else []

    def use(self, client: NameClient) -> None:
        """Use this name server from now on."""
        with self._lock:
            self._client = client

    def persistent(self, verb: str, source: str, target: str, carrier: str = "") -> bool:
        """Send the name server ``subscribe`` or ``unsubscribe`` for a connection; return whether it accepts."""
        client = self.client
        if client is None:
            log.error("persistent connections are not available in local mode: %s -> %s", source, target)
            return False
        return client.line([verb, source, f"{carrier}:/{target}" if carrier else target]).startswith("[ok]")

    @property
    def is_local(self) -> bool:
        """Whether names are registered only in this process."""
        return self._local is not None

    def set_local(self, *, local: bool) -> None:
        """Register names only in this process, or at the name server."""
        with self._lock:
            self._local = (self._local or LocalNaming()) if local else None

    @property
    def profile(self) -> Profile:
        """The dialect for peers whose dialect is unknown: ``YARP_COMPAT_PROFILE``, by default ``yarp3``."""
        name = os.environ.get("YARP_COMPAT_PROFILE", Profile.YARP3.value)
        try:
            return Profile(name)
        except ValueError:
            log.warning("YARP_COMPAT_PROFILE=%s is neither yarp3 nor yarp4: using yarp3", name)
            return Profile.YARP3


RUNTIME = Runtime()


_node_log = logging.getLogger("yarp.os.Node")

_FOLDER = "/midspan/daemon"  # each daemon has a port for requests below this name
_MARK = "midspan_owner"  # the property at the name server that identifies these ports


def find_daemon() -> PortContact | None:
    """Return a port of a Midspan daemon on this network, or None."""
    return next((c for c in RUNTIME.listed(_FOLDER) if RUNTIME.naming.get_property(c.name, _MARK)), None)


def definition_from_daemon(type_name: str) -> str | None:
    """Return the full definition of a message type from a daemon; None without an answer, or if the type is unknown."""
    if not RUNTIME.is_up:
        return None
    try:
        daemon = find_daemon()
        lines = [] if daemon is None else text_client.ask(daemon, ["definition", type_name])
    except NamingError as err:
        _node_log.warning("cannot get the definition of %s from a daemon: %s", type_name, err)
        return None
    reply = from_text(lines[0]) if lines else []
    return str(reply[1]) if len(reply) == 2 and reply[0] == "ok" else None
