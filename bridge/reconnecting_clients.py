"""Stores the clients of a process's YARP RPC ports in a file, and reconnects them after the process was killed.

A YARP client connects once. If the process that it calls dies, its calls fail from then on, even if the port returns,
because YARP's clients do not reconnect by themselves (the name server restores only connections made with
``--persist``). A port of Midspan that returns therefore asks its clients to connect again, with the command that
``yarp connect`` sends.

The alternative, a port in a separate long-lived process, would add a hop to each call, and a crash of that process, the
end of the daemon or an update of Midspan would still disconnect the clients.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from pydantic import TypeAdapter

from bridge.state_file import keep
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.ports.inputs import Input
from yarp_compat.ports.naming import NamingError, PortError
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.contact import rooted

_log = logging.getLogger(__name__)

AGAIN = 1.0
"""Seconds between two requests to one client to connect."""

_PATIENCE = 60.0
"""Seconds after which a returned port stops asking a client to connect."""

_CONNECT_SECONDS = 2.0
_MOST = 1000
"""Maximum number of stored clients of one port, equal to its maximum number of inputs."""

_UNREACHABLE = ("text", "local", "http", "name_ser")
"""Carriers of people's tools and of the port's own process, which are not reconnected."""


class StoredClient(NamedTuple):
    """A client's port, as registered when it connected; a port at another address belongs to another program."""

    host: str
    port: int
    carrier: str


_Known = dict[str, dict[str, StoredClient]]
_FORM = TypeAdapter(_Known)


@dataclass(eq=False)
class _Watched:
    """An open port, the clients that it waits for, and the connections whose client is already known."""

    core: PortCore
    awaited: dict[str, float]
    seen: dict[str, Input] = field(default_factory=dict)


def clients_file(state: Path, owner: str) -> Path:
    """Return the file for the clients of a module's or worker's ports, in the state folder of this daemon's workers."""
    return state / "yarp_callers" / f"{owner}.json"


class ReconnectingClients:
    """The clients of one owner's ports, which are stored in a file that only this process uses.

    `update` and `unwatch` wait for the name server; only one thread at a time may call `update`.
    """

    def __init__(self, naming: NameClient, file: Path) -> None:
        self._naming, self._file = naming, file
        self._lock, self._storing = threading.Lock(), threading.Lock()
        self._watched: list[_Watched] = []
        self._due = 0.0
        self._known = self._stored = _read(file)

    def watch(self, core: PortCore) -> None:
        """Watch an open port, to store its clients and to reconnect stored clients."""
        end = time.monotonic() + _PATIENCE
        with self._lock:
            awaited = dict.fromkeys(self._known.get(core.name, {}), end)
            self._watched = [*self._watched, _Watched(core, awaited)]
            self._due = 0.0

    def unwatch(self, core: PortCore) -> None:
        """Stop watching a port before it is closed; its current clients, including new ones, remain stored."""
        for port in [port for port in self._watched if port.core is core]:
            with contextlib.suppress(NamingError):
                self._refresh(port)
            with self._lock:
                self._watched = [other for other in self._watched if other is not port]
        self._store()

    def update(self) -> bool:
        """Store new clients, remove disconnected ones, reconnect missing ones; return whether some are still missing.

        Call it after each change of connections, and again soon if it returned True.
        """
        try:
            for port in self._watched:
                self._refresh(port)
            self._store()
            now = time.monotonic()
            if now >= self._due:
                self._due = now + AGAIN
                for port in self._watched:
                    for name in list(port.awaited):
                        self._ask_back(port, name)
        except NamingError as err:
            _log.debug("cannot update the clients of ports: %s", err)
            return True
        return any(port.awaited for port in self._watched)

    def _refresh(self, port: _Watched) -> None:
        now = time.monotonic()
        with self._lock:
            if port not in self._watched:  # it was closed meanwhile, and therefore has no inputs
                return
            present = {i.route.source: i for i in port.core.connections.inputs if _can_return(i)}
            for name in [name for name, end in port.awaited.items() if name in present or now >= end]:
                port.awaited.pop(name, None)
                _log.info("%s: %s %s", port.core.name, name, "reconnected" if name in present else "did not reconnect")
            port.seen = {name: seen for name, seen in port.seen.items() if present.get(name) is seen}
            clients = self._known.get(port.core.name, {})
            clients = {n: client for n, client in clients.items() if n in present or n in port.awaited}
            self._set(port, clients)
        for name, connection in present.items():
            if name not in port.seen and len(clients) < _MOST:
                self._look_up(port, name, connection)

    def _look_up(self, port: _Watched, name: str, connection: Input) -> None:
        contact = self._naming.query(name)
        port.seen[name] = connection
        if contact is None:
            return
        with self._lock:
            if port in self._watched:
                client = StoredClient(contact.host, contact.port, connection.carrier.name)
                self._set(port, {**self._known.get(port.core.name, {}), name: client})

    def _set(self, port: _Watched, clients: dict[str, StoredClient]) -> None:
        others = {name: known for name, known in self._known.items() if name != port.core.name}
        self._known = {**others, port.core.name: clients} if clients else others

    def _ask_back(self, port: _Watched, name: str) -> None:
        client = self._known.get(port.core.name, {}).get(name)
        if client is None or port not in self._watched:
            port.awaited.pop(name, None)
            return
        contact = self._naming.query(name)
        if contact is None:  # the client may yet register again with a restarted name server
            return
        if (contact.host, contact.port) != client[:2]:
            port.awaited.pop(name, None)
            return
        try:
            # The client may still list the broken connection, because a C++ port detects that only when it writes.
            connections.connect(self._naming, name, port.core.name, client.carrier, timeout=_CONNECT_SECONDS)
        except PortError as err:
            _log.debug("%s: %s does not reconnect yet: %s", port.core.name, name, err)

    def _store(self) -> None:
        with self._storing:
            known = self._known
            if known != self._stored:
                self._stored = known
                text = _FORM.dump_json(known).decode()
                keep(self._file, text, "clients of its ports will not be reconnected if this process is killed")


def _can_return(connection: Input) -> bool:
    return rooted(connection.route.source) and connection.carrier.name not in _UNREACHABLE


def _read(file: Path) -> _Known:
    try:
        return _FORM.validate_json(file.read_bytes())
    except (OSError, ValueError):
        return {}
