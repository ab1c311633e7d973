"""The Midspan workers on one YARP network, and the records that they exchange.

Each worker has a port ``/midspan/daemon/<id>`` and connects it to the ports of all others. The connections of a dead
worker close; a stalled worker's connections stay open. The same port answers commands of YARP programs, such as
``definition std_msgs/String``.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Mapping

from bridge.adapters.yarp.graph import YarpContext
from bridge.adapters.yarp.network import DAEMON, OWNER, PRESENCE
from bridge.concurrency import Backoff
from bridge.messages.errors import MessageTypeError
from bridge.routing.edge import Sighting
from yarp_compat.naming import connections
from yarp_compat.ports.connections import ConnectionEvent
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.contact import PortContact
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.values import Vocab

_MAX_RECORD = 1 << 20
_QUERY_SECONDS = 1.0
_ALIVE_SECONDS = 0.9
"""Another worker counts as alive for this many seconds after its last record; less than `election.SILENCE`."""

_STALLED_SECONDS = 0.6
"""A longer pause between two records of this worker means that it did not run, and has not read the others' records.

Records are sent every 0.2 s, or every 0.4 s if no other worker is known.
"""

_RETRY = 2.0
_LONGEST_RETRY = 16.0
"""Maximum pause in seconds between attempts to connect to an unreachable worker, as dead workers stay registered."""


class WorkerPresence:
    """This worker's port, and the other workers' last records; ``changed`` is called when they change."""

    def __init__(self, context: YarpContext, changed: Callable[[], None]) -> None:
        self._context, self._naming, self._changed = context, context.naming, changed
        self._lock = threading.Lock()
        self._seen: dict[str, Sighting] = {}
        self._tried: dict[str, tuple[PortContact, Backoff, float]] = {}
        self._listed_since = 0.0
        self._announced = self._resumed = time.monotonic()
        self._closed = False
        self._core = PortCore(
            PRESENCE + context.owner, naming=context.naming, on_message=self._on_message, on_event=self._on_event,
            host=context.ip,
        )  # fmt: skip

    @property
    def name(self) -> str:
        """The name of this worker's port."""
        return self._core.name

    @property
    def is_open(self) -> bool:
        """Whether this worker is on the network."""
        return self._core.is_open

    def open(self) -> None:
        """Join the network; raises `NamingError` or `OSError`."""
        if self._closed:
            return
        self._core.open()
        if self._closed:  # `close` was called meanwhile, before it could close the port
            self._core.close()
            return
        self.mark()

    def mark(self) -> None:
        """Mark the port as Midspan's at the name server."""
        self._naming.set_property(self._core.name, OWNER, self._context.owner)
        self._naming.set_property(self._core.name, DAEMON, self._context.daemon)

    def connect(self, contacts: Mapping[str, PortContact], started: float) -> None:
        """Connect to the other workers in the name server's list, which was requested at ``started``."""
        others = {name: c for name, c in contacts.items() if name.startswith(PRESENCE) and name != self._core.name}
        out = {route.target for route in self._core.outputs()}
        now = time.monotonic()
        for name, contact in others.items():
            known, pauses, again = self._tried.get(name, (None, None, 0.0))
            if name in out or (known == contact and now < again):
                continue
            if pauses is None or known != contact:
                pauses = Backoff(_RETRY, _LONGEST_RETRY)
            self._tried[name] = contact, pauses, now + pauses.pause(0.0)
            # The query is shorter than an attempt to connect, because a machine that left blocks this thread meanwhile.
            if connections.responds(contact, timeout=_QUERY_SECONDS) and self._core.add_output(name)[0]:
                self._record(name, None)
        for name in self._tried.keys() - others.keys():  # in place, because connection threads remove items, too
            self._tried.pop(name, None)
        with self._lock:
            self._listed_since = max(self._listed_since, started)

    def announce(self, record: bytes) -> None:
        """Send a record to all other workers; never blocks."""
        now = time.monotonic()
        if now - self._announced > _STALLED_SECONDS:
            self._resumed = now
        self._announced = now
        if self._core.is_open:
            self._core.write(lambda profile: encode([record], profile))

    def sightings(self) -> list[Sighting]:
        """Return the other workers on the network."""
        with self._lock:
            return list(self._seen.values())

    def is_alive(self, owner: str) -> bool:
        """Return whether a worker is on the network and not stalled.

        If this process itself was suspended a moment ago, it may have yet to read the others' records; all workers then
        count as alive.
        """
        with self._lock:
            seen = self._seen.get(PRESENCE + owner)
        if seen is None or seen.record is None:
            return False
        now = time.monotonic()
        stalled = now - self._announced > _STALLED_SECONDS or now - self._resumed < _ALIVE_SECONDS
        return stalled or now - seen.received < _ALIVE_SECONDS

    def settled(self, since: float) -> bool:
        """Return whether all workers that were present at ``since`` are known."""
        with self._lock:
            return self._listed_since >= since

    def close(self) -> None:
        """Leave the network permanently."""
        self._closed = True
        self._core.close()

    def _on_event(self, event: ConnectionEvent) -> None:
        other = event.route.source if event.incoming else event.route.target
        if not other.startswith(PRESENCE):
            return
        if event.up:
            self._record(other, None)
            if event.incoming:
                self._tried.pop(other, None)
            self._context.changed()  # to connect in the other direction, too
            return
        linked = {r.source for r in self._core.inputs()} | {r.target for r in self._core.outputs()}
        self._tried.pop(other, None)
        with self._lock:
            removed = other not in linked and self._seen.pop(other, None) is not None
        if removed:
            self._changed()

    def _on_message(self, message: PortMessage) -> None:
        source = message.peer.route.source
        if message.wants_reply:
            with contextlib.suppress(WireError):
                message.reply(encode(self._answer(message), message.peer.profile or Profile.YARP3))
            return
        try:
            values = decode(message.payload, message.peer.profile)
        except WireError:
            return
        match values:
            case [bytes(record)] if source.startswith(PRESENCE) and len(record) <= _MAX_RECORD:
                self._record(source, record)

    def _record(self, name: str, record: bytes | None) -> None:
        with self._lock:
            known = self._seen.get(name)
            if known is not None and record is None:
                return
            self._seen[name] = Sighting(name, record, time.monotonic())
        self._changed()

    def _answer(self, message: PortMessage) -> list[object]:
        """Return the answer to a YARP program."""
        request = decode(message.payload, message.peer.profile)
        match request:
            case ["definition", str(name)]:
                try:
                    return [Vocab("ok"), self._context.registry.ros1(name).definition]
                except MessageTypeError as err:
                    return [Vocab("fail"), str(err)]
            case ["help"]:
                return [Vocab("many"), "definition PACKAGE/NAME  # text of a ROS message type and of all nested types"]
        return [Vocab("fail"), "send help for the list of commands"]
