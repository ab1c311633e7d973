"""What a program's ports share: the name server they use, and the list of them, so that the end closes what is open."""

from __future__ import annotations

import atexit
import logging
import os
import threading
import weakref
from typing import Protocol

from yarp_compat.naming.client import NameClient
from yarp_compat.naming.naming import Naming
from yarp_compat.os.log import print_as_yarp
from yarp_compat.os.time import use_the_asked_clock, useSystemClock
from yarp_compat.ports.naming import LocalNaming, Unregistered
from yarp_compat.wire.contact import Contact
from yarp_compat.wire.profile import Profile

log = logging.getLogger("yarp.os.Network")


class Closable(Protocol):
    """Something to close at the end."""

    def close(self) -> None:
        """Close it."""


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

    def init(self) -> None:
        """Begin to use the network."""
        with self._lock:
            self._users += 1
            if self._users == 1:
                print_as_yarp()
                atexit.register(self.close_all)
                use_the_asked_clock()

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
        """Who knows the names: the name server, or in local mode a table of this process."""
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

    def listed(self, folder: str = "") -> list[Contact]:
        """The registered ports, all or those below a name."""
        naming = self.naming
        return naming.list(folder) if isinstance(naming, (NameClient, LocalNaming)) else []

    def use(self, client: NameClient) -> None:
        """Use this name server from now on."""
        with self._lock:
            self._client = client

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
