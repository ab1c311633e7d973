"""The state that a program's ports share: their name server, and the list of open ports, which the end closes.

Also Midspan's daemon, as a YARP program sees it: ports that a property at the name server marks.
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
    """The state behind `Network`'s static methods."""

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
        """Begin to use the network; the first user prepares it."""
        with self._lock:
            self._users += 1
            if self._users == 1:
                print_as_yarp()
                atexit.register(self.close_all)
                prepare()

    def fini(self) -> None:
        """Stop using it; the last one closes all ports that are open."""
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
        """A port is open: it will be closed at the latest with the network."""
        self._open.add(port)

    def closed(self, port: Closable) -> None:
        """A port was closed."""
        self._open.discard(port)

    @property
    def naming(self) -> Naming:
        """The name server's client, or in local mode a table of this process."""
        with self._lock:
            if self._local is not None:
                return self._local
            if self._client is None:
                self._client = NameClient()
            return self._client

    @property
    def unregistered(self) -> Naming:
        """Knows the same names, and registers none."""
        return Unregistered(self.naming)

    @property
    def client(self) -> NameClient | None:
        """The name server's client; None in local mode."""
        naming = self.naming
        return naming if isinstance(naming, NameClient) else None

    def listed(self, folder: str = "") -> list[PortContact]:
        """The registered ports, all or those below a name."""
        naming = self.naming
        return naming.list(folder) if isinstance(naming, (NameClient, LocalNaming)) else []

    def use(self, client: NameClient) -> None:
        """Use this name server from now on."""
        with self._lock:
            self._client = client

    def persistent(self, word: str, source: str, target: str, carrier: str = "") -> bool:
        """``subscribe`` or ``unsubscribe`` a connection that the name server keeps up."""
        client = self.client
        if client is None:
            log.error("there are no persistent connections in local mode: %s -> %s", source, target)
            return False
        return client.line([word, source, f"{carrier}:/{target}" if carrier else target]).startswith("[ok]")

    @property
    def is_local(self) -> bool:
        """Whether names live in this process only."""
        return self._local is not None

    def set_local(self, *, local: bool) -> None:
        """Keep names in this process, or at the name server."""
        with self._lock:
            self._local = (self._local or LocalNaming()) if local else None

    @property
    def profile(self) -> Profile:
        """The dialect towards peers that have not shown theirs: ``YARP_COMPAT_PROFILE``, ``yarp3`` unless set."""
        asked = os.environ.get("YARP_COMPAT_PROFILE", Profile.YARP3.value)
        try:
            return Profile(asked)
        except ValueError:
            log.warning("YARP_COMPAT_PROFILE=%s is neither yarp3 nor yarp4: yarp3 is used", asked)
            return Profile.YARP3


RUNTIME = Runtime()


_node_log = logging.getLogger("yarp.os.Node")

_FOLDER = "/midspan/daemon"  # below this name each daemon has the port that answers
_MARK = "midspan_owner"  # the property at the name server that tells them from others


def find_daemon() -> PortContact | None:
    """A port of a Midspan daemon on this network, or None."""
    return next((c for c in RUNTIME.listed(_FOLDER) if RUNTIME.naming.get_property(c.name, _MARK)), None)


def definition_from_daemon(type_name: str) -> str | None:
    """The full definition of a message type from a daemon; None where none answers, or it does not know the type."""
    if not RUNTIME.is_up:
        return None
    try:
        daemon = find_daemon()
        lines = [] if daemon is None else text_client.ask(daemon, ["definition", type_name])
    except NamingError as err:
        _node_log.warning("no daemon tells the definition of %s: %s", type_name, err)
        return None
    words = from_text(lines[0]) if lines else []
    return str(words[1]) if len(words) == 2 and words[0] == "ok" else None
