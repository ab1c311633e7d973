"""The connections of one port: which exist, how they come and go, and the events that tell the port's owner."""

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
    """A connection came (``up``) or went; two inputs of one name differ in their ``address``, where they come from."""

    route: ConnectionRoute
    incoming: bool
    up: bool
    address: tuple[str, int] = field(default=("", 0), compare=False)


_log = logging.getLogger("yarp.ports")

MOST_INPUTS = 1000
"""Input connections of one port. When there are more, the oldest that never sent a message goes, else the new one."""
MOST_OUTPUTS = 1000  # output connections of one port; no more are made

_UNTOLD = ("admin", "null")
"""Names of tools that only ask something, or check whether a port exists; they cause no events."""

OnEvent = Callable[[ConnectionEvent], None]
AnyOutput = Output | DatagramOutput


class Connections:
    """A port's inputs and outputs. Lists are replaced, not changed, so readers need no lock."""

    def __init__(self, on_event: OnEvent | None) -> None:
        self.on_event = on_event
        self.inputs: list[Input] = []
        self.leaving: list[Input] = []
        """Inputs that are out of the list and have not ended yet: what came of them is still taken."""
        self.outputs: list[AnyOutput] = []
        self.lost: Counter[str] = Counter()
        """Messages that outputs dropped, by reason; those of outputs that have ended too."""
        self._lock = threading.Lock()
        self._closed = True

    def open(self) -> None:
        """Take connections from now on."""
        self._closed = False

    def close(self) -> None:
        """Take no more."""
        with self._lock:
            self._closed = True

    def add_input(self, connection: Input) -> bool:
        """Take an input, in place of a former one from the same port; False where there is no room."""
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
                    _log.warning("%s has %d inputs; one more is refused", connection.route.target, MOST_INPUTS)
                    return False
            self.inputs = [*self.inputs, connection]
        for one in former:
            one.retire()
            self.remove_input(one)
        if silent is not None:
            silent.close()
            self.remove_input(silent)
        self._tell(connection.route, incoming=True, up=True, address=connection.address)
        return True

    def remove_input(self, connection: MessagePeer) -> None:
        """An input is listed no longer, and ends soon."""
        with self._lock:
            found = [i for i in self.inputs if i is connection]
            if not found:
                return
            self.inputs = [i for i in self.inputs if i is not connection]
            self.leaving = [*self.leaving, *found]
        self._tell(connection.route, incoming=True, up=False, address=connection.address)

    def ended(self, connection: MessagePeer) -> None:
        """An input is over."""
        self.remove_input(connection)
        with self._lock:
            self.leaving = [i for i in self.leaving if i is not connection]

    def add_output(self, output: AnyOutput) -> bool:
        """Take an output; False where the port is closed, or has too many."""
        with self._lock:
            if self._closed or len(self.outputs) >= MOST_OUTPUTS:
                return False
            self.outputs = [*self.outputs, output]
        self._tell(output.route, incoming=False, up=True)
        return True

    def remove_output(self, output: AnyOutput) -> bool:
        """An output is over; whether that is news."""
        with self._lock:
            if output not in self.outputs:
                return False
            self.outputs = [o for o in self.outputs if o is not output]
        self._tell(output.route, incoming=False, up=False)
        return True

    def _tell(self, route: ConnectionRoute, *, incoming: bool, up: bool, address: tuple[str, int] = ("", 0)) -> None:
        if self.on_event is not None and route.source not in _UNTOLD:
            try:
                self.on_event(ConnectionEvent(route, incoming, up, address))
            except Exception:
                _log.exception("the owner of a port failed to take an event of %s -> %s", route.source, route.target)
