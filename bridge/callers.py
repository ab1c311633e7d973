"""Who calls the YARP RPC ports of a process, kept in a file: when the process was killed, they are connected again.

A YARP client connects once. When the process that it calls dies, its calls fail from then on, although the port comes
back: no client of YARP's connects again by itself (a name server does that, for what was connected with ``--persist``).
So a port of ours that comes back asks its callers to connect to it, by the command that ``yarp connect`` sends.

That was chosen over a port held by a process that lives on: no call takes a hop more, and the death of that process
too, of the daemon, or an update of Midspan, cuts nobody off for good.
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
"""Seconds between two times that a caller is asked to connect."""

_PATIENCE = 60.0
"""Seconds for which a port that came back asks a caller that does not connect."""

_CONNECT_SECONDS = 2.0
_MOST = 1000
"""Callers of one port that are kept; as many inputs a port has."""

_UNREACHABLE = ("text", "local", "http", "name_ser")
"""Carriers of people and of the port's own process, by which nobody is asked back."""


class Caller(NamedTuple):
    """A port that calls, as it was registered when it connected: at another address it is another program's."""

    host: str
    port: int
    carrier: str


_Known = dict[str, dict[str, Caller]]
_FORM = TypeAdapter(_Known)


@dataclass(eq=False)
class _Watched:
    """A port that is open, with the connections that were looked up and the callers that it waits for."""

    core: PortCore
    awaited: dict[str, float]
    seen: dict[str, Input] = field(default_factory=dict)


def callers_file(state: Path, owner: str) -> Path:
    """Where the callers of a module's or worker's ports are kept, in the state folder of this daemon's workers."""
    return state / "yarp_callers" / f"{owner}.json"


class Callers:
    """The callers of one owner's ports, kept in a file of this process alone.

    `turn` and `leave` wait for the name server; one thread at a time may call `turn`.
    """

    def __init__(self, naming: NameClient, file: Path) -> None:
        self._naming, self._file = naming, file
        self._lock, self._keeping = threading.Lock(), threading.Lock()
        self._watched: list[_Watched] = []
        self._due = 0.0
        self._known = self._kept = _read(file)

    def watch(self, core: PortCore) -> None:
        """A port is open: remember who calls it, and ask back who did."""
        end = time.monotonic() + _PATIENCE
        with self._lock:
            awaited = dict.fromkeys(self._known.get(core.name, {}), end)
            self._watched = [*self._watched, _Watched(core, awaited)]
            self._due = 0.0

    def leave(self, core: PortCore) -> None:
        """A port is about to be closed: who calls it now is asked when it comes back. Looks up who has just come."""
        for port in [port for port in self._watched if port.core is core]:
            with contextlib.suppress(NamingError):
                self._look(port)
            with self._lock:
                self._watched = [other for other in self._watched if other is not port]
        self._keep()

    def turn(self) -> bool:
        """Remember who came and forget who left, and ask back those that are missing; whether some still are.

        To be called when a connection came or went, and soon again where it returned True.
        """
        try:
            for port in self._watched:
                self._look(port)
            self._keep()
            now = time.monotonic()
            if now >= self._due:
                self._due = now + AGAIN
                for port in self._watched:
                    for name in list(port.awaited):
                        self._ask_back(port, name)
        except NamingError as err:
            _log.debug("callers of ports: %s", err)
            return True
        return any(port.awaited for port in self._watched)

    def _look(self, port: _Watched) -> None:
        now = time.monotonic()
        with self._lock:
            if port not in self._watched:  # it is closed by now, and has no inputs because of that
                return
            present = {i.route.source: i for i in port.core.connections.inputs if _can_return(i)}
            for name in [name for name, end in port.awaited.items() if name in present or now >= end]:
                port.awaited.pop(name, None)
                _log.info(
                    "%s: %s %s", port.core.name, name, "calls again" if name in present else "did not connect again"
                )
            port.seen = {name: seen for name, seen in port.seen.items() if present.get(name) is seen}
            callers = self._known.get(port.core.name, {})
            callers = {n: caller for n, caller in callers.items() if n in present or n in port.awaited}
            self._set(port, callers)
        for name, connection in present.items():
            if name not in port.seen and len(callers) < _MOST:
                self._look_up(port, name, connection)

    def _look_up(self, port: _Watched, name: str, connection: Input) -> None:
        contact = self._naming.query(name)
        port.seen[name] = connection
        if contact is None:
            return
        with self._lock:
            if port in self._watched:
                caller = Caller(contact.host, contact.port, connection.carrier.name)
                self._set(port, {**self._known.get(port.core.name, {}), name: caller})

    def _set(self, port: _Watched, callers: dict[str, Caller]) -> None:
        others = {name: known for name, known in self._known.items() if name != port.core.name}
        self._known = {**others, port.core.name: callers} if callers else others

    def _ask_back(self, port: _Watched, name: str) -> None:
        caller = self._known.get(port.core.name, {}).get(name)
        if caller is None or port not in self._watched:
            port.awaited.pop(name, None)
            return
        found = self._naming.query(name)
        if found is None:  # a name server that forgot it may be told again
            return
        if (found.host, found.port) != caller[:2]:
            port.awaited.pop(name, None)
            return
        try:
            # It may list the connection that ended: a C++ port sees that only when it writes. This takes its place.
            connections.connect(self._naming, name, port.core.name, caller.carrier, timeout=_CONNECT_SECONDS)
        except PortError as err:
            _log.debug("%s: %s does not connect again yet: %s", port.core.name, name, err)

    def _keep(self) -> None:
        with self._keeping:
            known = self._known
            if known != self._kept:
                self._kept = known
                text = _FORM.dump_json(known).decode()
                keep(self._file, text, "who calls its ports is not connected again when this process was killed")


def _can_return(connection: Input) -> bool:
    return rooted(connection.route.source) and connection.carrier.name not in _UNREACHABLE


def _read(file: Path) -> _Known:
    try:
        return _FORM.validate_json(file.read_bytes())
    except (OSError, ValueError):
        return {}
