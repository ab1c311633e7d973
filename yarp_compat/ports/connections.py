"""The connections of one port: which there are, and how they come and go."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from yarp_compat.ports.datagrams import DatagramOutput
from yarp_compat.ports.events import ConnectionEvent
from yarp_compat.ports.inputs import Input
from yarp_compat.ports.output import Output
from yarp_compat.wire.contact import Route, rooted

_log = logging.getLogger("yarp.ports")

MOST_INPUTS = 1000
"""Input connections of one port. When there are more, the oldest that never sent a message goes, else the new one."""
MOST_OUTPUTS = 1000
"""Output connections of one port; no more are made."""

_UNTOLD = ("admin", "null")
"""What tools call themselves that only ask something, or look whether a port is there; no events are told of them."""

OnEvent = Callable[[ConnectionEvent], None]
AnyOutput = Output | DatagramOutput


class Connections:
    """A port's inputs and outputs. Lists are replaced, not changed: whoever has one may go through it without a lock.

    Args:
        on_event: told when a connection comes or goes.
    """

    def __init__(self, on_event: OnEvent | None) -> None:
        self.on_event = on_event
        self.inputs: list[Input] = []
        self.leaving: list[Input] = []
        """Inputs that are out of the list and have not ended yet: what came of them is still taken."""
        self.outputs: list[AnyOutput] = []
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
        """Take an input, in the place of a former one from the same port; False where there is no room."""
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
        self._tell(connection.route, incoming=True, up=True)
        return True

    def remove_input(self, connection: Input) -> None:
        """An input is listed no longer, and ends soon."""
        with self._lock:
            if connection not in self.inputs:
                return
            self.inputs = [i for i in self.inputs if i is not connection]
            self.leaving = [*self.leaving, connection]
        self._tell(connection.route, incoming=True, up=False)

    def ended(self, connection: Input) -> None:
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

    def remove_output(self, output: AnyOutput) -> None:
        """An output is over."""
        with self._lock:
            if output not in self.outputs:
                return
            self.outputs = [o for o in self.outputs if o is not output]
        self._tell(output.route, incoming=False, up=False)

    def _tell(self, route: Route, *, incoming: bool, up: bool) -> None:
        if self.on_event is not None and route.source not in _UNTOLD:
            try:
                self.on_event(ConnectionEvent(route, incoming, up))
            except Exception:
                _log.exception("the owner of a port failed to take an event of %s -> %s", route.source, route.target)
