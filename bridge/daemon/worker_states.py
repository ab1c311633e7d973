"""States, events and transitions of a worker's process in the daemon, as a table; ARCHITECTURE.md shows it."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum

from bridge.state_machine import Machine, Table


class Phase(Enum):
    """The state of a worker's process; the values also appear in the daemon's status document."""

    OFF = "off"  #: disabled by the configuration, or stopped
    UNAVAILABLE = "not available"  #: this machine lacks something that it requires
    QUEUED = "queued"  #: other workers start first
    STARTING = "starting"  #: its process has not sent a heartbeat yet
    UP = "running"  #: its process sends heartbeats
    PAUSED = "restarting"  #: it starts after a pause: it crashed, or another process blocks it
    FAILED = "cannot work"  #: it starts after a longer pause
    STOPPING = "stopping"  #: its process has been asked to stop


IDLE = frozenset((Phase.OFF, Phase.UNAVAILABLE, Phase.QUEUED, Phase.PAUSED, Phase.FAILED))
"""States without a process; in all others the daemon is connected to one."""


class WorkerEvent(Enum):
    """The events that change `Phase`."""

    DISABLE = "the configuration disables it, or the daemon stops"
    MISS = "this machine lacks something that it requires"
    QUEUE = "other workers start first"
    BLOCK = "an earlier process holds its lock, or its service does not run"
    CANNOT_WORK = "it cannot be started, or reports that it cannot work on this machine"
    START = "its process starts, or is adopted"
    HEARTBEAT = "its process sends a heartbeat"
    STOP = "the daemon asks its process to stop"
    EXIT = "its process exits after the request"
    CRASH = "its process exits without a request"
    RELEASE = "the daemon disconnects, and its process continues"


_RUNNING = frozenset((Phase.STARTING, Phase.UP))

TRANSITIONS: Mapping[WorkerEvent, tuple[frozenset[Phase], Phase]] = {
    WorkerEvent.DISABLE: (IDLE, Phase.OFF),
    WorkerEvent.MISS: (IDLE, Phase.UNAVAILABLE),
    WorkerEvent.QUEUE: (IDLE, Phase.QUEUED),
    WorkerEvent.BLOCK: (IDLE, Phase.PAUSED),
    WorkerEvent.CANNOT_WORK: (IDLE | _RUNNING, Phase.FAILED),
    WorkerEvent.START: (IDLE, Phase.STARTING),
    WorkerEvent.HEARTBEAT: (_RUNNING, Phase.UP),
    WorkerEvent.STOP: (_RUNNING, Phase.STOPPING),
    WorkerEvent.EXIT: (frozenset((Phase.STOPPING,)), Phase.OFF),
    WorkerEvent.CRASH: (_RUNNING, Phase.PAUSED),
    WorkerEvent.RELEASE: (frozenset(Phase), Phase.OFF),
}
"""For each event the states in which it may occur, and the state that follows."""

WORKER: Table[Phase, WorkerEvent] = {
    state: {event: following for event, (states, following) in TRANSITIONS.items() if state in states}
    for state in Phase
}


class WorkerState(Machine[Phase, WorkerEvent]):
    """The state of one worker's process.

    Attributes:
        text: the current step, the health, or the reason for the state.
    """

    def __init__(self) -> None:
        super().__init__(WORKER, Phase.OFF)
        self.text = ""

    def accepts(self, event: WorkerEvent) -> bool:
        """Whether the event may occur in the current state."""
        return event in WORKER[self.state]

    def enter(self, event: WorkerEvent, text: str = "") -> bool:
        """Handle an event, with its text; return False, without an effect, if it may not occur in this state."""
        if not self.accepts(event):
            return False
        self.on(event)
        self.text = text
        return True
