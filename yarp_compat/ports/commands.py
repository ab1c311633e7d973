"""Velocity commands to a port's readers: none arrives late because it waited for a reader or for the network.

While a reader's computer cannot be reached, the system keeps what was sent, and delivers it when the network is back.
So a command is dropped while the reader has not acknowledged an earlier one in time, and a stop follows those that were
sent before. A command never waits for a busy reader; a stop may, because no later command need follow it.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field

from yarp_compat.in_flight import InFlight
from yarp_compat.ports.connections import AnyOutput
from yarp_compat.ports.outgoing import Content
from yarp_compat.ports.output import Output
from yarp_compat.ports.port import PortCore


@dataclass(slots=True, eq=False)
class _Reader:
    """What one reader was sent last, and the stop that follows if that is late; None if it was a stop."""

    output: AnyOutput
    in_flight: InFlight = field(default_factory=InFlight)
    sent_at: float = 0.0
    stop: Content | None = None

    def is_late(self, lifespan: float) -> bool:
        """Whether a command is unacknowledged for longer than its lifespan."""
        output = self.output
        if output.busy:
            return time.monotonic() - self.sent_at > lifespan
        return isinstance(output, Output) and self.in_flight.is_late(output.acknowledged, lifespan)

    def note_sent(self, stop: Content | None, *, is_stop: bool) -> None:
        self.stop, self.sent_at = stop, time.monotonic()
        if isinstance(self.output, Output) and not is_stop:
            self.in_flight.sent(self.output.sent_bytes)


class CommandWriter:
    """Writes commands to the readers of a port; thread-safe.

    Args:
        core: the port.
        lifespan: time in seconds for which a command may be unacknowledged.
    """

    def __init__(self, core: PortCore, lifespan: float) -> None:
        self._core, self._lifespan = core, lifespan
        self._readers: dict[AnyOutput, _Reader] = {}
        self._lock = threading.Lock()
        self._next_check = 0.0

    def write(self, command: Content, stop: Content | None, envelope: str = "") -> int:
        """Send a command to the readers that can receive it now; return how many accepted it.

        ``stop``: the content that stops the robot, None if there is none for this type; ``command`` itself, if it is
        one. Raises like `PortCore.write`.
        """
        is_stop = stop is command
        with self._lock:
            outputs = self._core.connections.outputs
            self._readers = {output: self._readers.get(output) or _Reader(output) for output in outputs}
            admitted = {output for output in outputs if is_stop or self._admits(self._readers[output])}
            if not admitted:
                return 0
            accepted = self._core.write(command, envelope, strict=False, chosen=admitted.__contains__)
            for output in admitted:
                self._readers[output].note_sent(None if is_stop else stop, is_stop=is_stop)
            if stop is not None and not is_stop and time.monotonic() >= self._next_check:
                self._check_later()
            return accepted

    def _admits(self, reader: _Reader) -> bool:
        if reader.is_late(self._lifespan):
            self._stop(reader)
        elif not reader.output.busy:
            return True
        reader.output.counters.drop("late")
        return False

    def _stop(self, reader: _Reader) -> None:
        """Let a stop follow late commands, once."""
        stop, reader.stop = reader.stop, None
        if stop is not None:
            self._core.write(stop, strict=False, chosen=lambda output: output is reader.output)

    def _check(self) -> None:
        """Send a stop after the late commands of a silent commander; on the thread that all ports share."""
        with self._lock:
            waiting = False
            for reader in self._readers.values():
                if reader.output.closed or reader.stop is None:
                    continue
                if reader.is_late(self._lifespan):
                    self._stop(reader)
                elif reader.output.busy or reader.in_flight:
                    waiting = True
            if waiting:
                self._check_later()

    def _check_later(self) -> None:
        self._next_check = time.monotonic() + self._lifespan
        self._core.call_later(self._lifespan, self._check)
