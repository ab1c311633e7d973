"""The lists of one port's connections, and the events for its owner when they change."""

from __future__ import annotations

import logging
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from yarp_compat.ports.datagrams import DatagramOutput
from yarp_compat.ports.inputs import Input
from yarp_compat.ports.message import MessagePeer
from yarp_compat.ports.output import Output
from yarp_compat.wire.contact import ConnectionRoute, rooted


@dataclass(frozen=True, slots=True)
class ConnectionEvent:
    """A connection opened (``up``) or closed; the peer's ``address`` distinguishes inputs with the same name."""

    route: ConnectionRoute
    incoming: bool
    up: bool
    address: tuple[str, int] = field(default=("", 0), compare=False)


_log = logging.getLogger("yarp.ports")

MOST_INPUTS = 1000
"""Maximum input connections of one port. A further one closes the oldest without a message, or is refused."""
MOST_OUTPUTS = 1000  # maximum output connections of one port

_QUERY_TOOLS = ("admin", "null")
"""Sender names of tools that only query a port or check that it exists; they cause no events."""

OnEvent = Callable[[ConnectionEvent], None]
AnyOutput = Output | DatagramOutput


class Connections:
    """A port's inputs and outputs. Lists are replaced, never modified, so readers need no lock."""

    def __init__(self, on_event: OnEvent | None) -> None:
        self.on_event = on_event
        self.inputs: list[Input] = []
        self.leaving: list[Input] = []
        """Inputs that have left the list and not ended yet: messages already received are still delivered."""
        self.outputs: list[AnyOutput] = []
        self.lost: Counter[str] = Counter()
        """Messages that outputs dropped, by reason; closed outputs included."""
        self._lock = threading.Lock()
        self._closed = True

    def open(self) -> None:
        """Accept connections from now on."""
        self._closed = False

    def close(self) -> None:
        with self._lock:
            self._closed = True

    def add_input(self, connection: Input) -> bool:
        """Add an input, which replaces one from the same port; return False if the port is closed or full."""
        former: list[Input] = []
        silent: Input | None = None
        with self._lock:
            if self._closed:
                return False
            if rooted(connection.route.source):
                former = [i for i in self.inputs if i.route.source == connection.route.source]
            if len(self.inputs) - len(former) >= MOST_INPUTS:
                silent = next((i for i in self.inputs if not i.counters.received), None)
                if silent is None:
                    _log.warning("%s refuses a connection: it has %d inputs", connection.route.target, MOST_INPUTS)
                    return False
            self.inputs = [*self.inputs, connection]
        for replaced in former:
            replaced.retire()
            self.remove_input(replaced)
        if silent is not None:
            silent.close()
            self.remove_input(silent)
        self._notify(connection.route, incoming=True, up=True, address=connection.address)
        return True

    def remove_input(self, connection: MessagePeer) -> None:
        """Remove from the list an input that is about to end."""
        with self._lock:
            removed = [i for i in self.inputs if i is connection]
            if not removed:
                return
            # in this order, so that a port that closes finds the connection in at least one of the lists
            self.leaving = [*self.leaving, *removed]
            self.inputs = [i for i in self.inputs if i is not connection]
        self._notify(connection.route, incoming=True, up=False, address=connection.address)

    def ended(self, connection: MessagePeer) -> None:
        """Remove an input that has ended."""
        self.remove_input(connection)
        with self._lock:
            self.leaving = [i for i in self.leaving if i is not connection]

    def add_output(self, output: AnyOutput) -> bool:
        """Add an output; return False if the port is closed or has too many outputs."""
        with self._lock:
            if self._closed or len(self.outputs) >= MOST_OUTPUTS:
                return False
            self.outputs = [*self.outputs, output]
        self._notify(output.route, incoming=False, up=True)
        return True

    def remove_output(self, output: AnyOutput) -> bool:
        """Remove an output; return whether it was listed."""
        with self._lock:
            if output not in self.outputs:
                return False
            self.outputs = [o for o in self.outputs if o is not output]
        self._notify(output.route, incoming=False, up=False)
        return True

    def _notify(self, route: ConnectionRoute, *, incoming: bool, up: bool, address: tuple[str, int] = ("", 0)) -> None:
        if self.on_event is not None and route.source not in _QUERY_TOOLS:
            try:
                self.on_event(ConnectionEvent(route, incoming, up, address))
            except Exception:
                _log.exception("the event callback of a port failed for %s -> %s", route.source, route.target)
