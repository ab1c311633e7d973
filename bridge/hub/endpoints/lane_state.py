"""The state of a subscription that switches between lane and zenoh: its lanes, and its subscriber on zenoh."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from dataclasses import dataclass
from enum import Enum, auto
from functools import partial
from threading import Lock

import zenoh

from bridge.hub.endpoints.context import EndpointContext
from bridge.hub.lane.inlet import Inlet
from bridge.hub.zenoh_compat import subscribe, undeclare

QUIET_SECONDS = 1.0
"""Maximum seconds to wait for a message over zenoh before leaving a lane, because its publishers may be quiet."""

CAUGHT_SECONDS = 10.0
"""Seconds from a mark until a lane is used even if its session does not respond over zenoh."""

_SPARED_MARKS = 64


@dataclass(slots=True)
class Joined:
    """A publisher that sends all messages after ``mark`` on a lane."""

    inlet: Inlet
    mark: int
    since: float
    caught_up: bool = False


class LeavingStep(Enum):
    """The steps of leaving a lane, in order."""

    DECLARED = auto()
    """The subscriber on zenoh is declared, but the other session may not know it yet."""
    KNOWN = auto()
    """The other session knows the subscriber, and its messages arrive over both transports."""
    FENCED = auto()
    """A fence was sent."""
    ENDED = auto()
    """The fence has returned, so the lane has delivered everything."""


@dataclass(slots=True)
class Leaving:
    """The current step of leaving a lane, and when it began (monotonic seconds)."""

    step: LeavingStep = LeavingStep.DECLARED
    since: float = 0.0


class Lanes:
    """The lanes of one subscription, whose lock guards them. Only the lane's thread adds to ``inlets``.

    Attributes:
        inlets: the lanes, each with the time when it was last joined (monotonic seconds).
        joined: the publishers that send on a lane, by GID.
        leaving: the lanes that are being left.
        received: sessions whose messages have arrived over zenoh while a lane was being left.
    """

    def __init__(self) -> None:
        self.inlets: dict[Inlet, float] = {}
        self.joined: dict[bytes, Joined] = {}
        self.leaving: dict[Inlet, Leaving] = {}
        self.received: set[str] = set()

    def mark(self, inlet: Inlet, gid: bytes, sequence: int) -> None:
        """Note that a publisher sends all messages after a number on a lane; a repeated mark changes nothing."""
        joined = self.joined.get(gid)
        if joined is None or joined.inlet is not inlet:
            self.joined[gid] = Joined(inlet, sequence, time.monotonic())

    def leave(self, inlet: Inlet) -> LeavingStep:
        """Start leaving a lane; return the current step, which is `ENDED` for a lane whose connection has ended."""
        return self.leaving.setdefault(inlet, Leaving()).step if inlet in self.inlets else LeavingStep.ENDED

    def on_subscriber_known(self, inlet: Inlet, now: float) -> None:
        """Note that a lane's session knows the subscriber on zenoh, and begin to wait for a message over zenoh."""
        if inlet in self.leaving:
            self.leaving[inlet] = Leaving(LeavingStep.KNOWN, now)
            self.received.discard(inlet.zid)

    def start_fence(self, inlet: Inlet, now: float) -> bool:
        """Return whether to send a fence now, because a message arrived over zenoh, or none did for `QUIET_SECONDS`."""
        leaving = self.leaving.get(inlet)
        if leaving is None or leaving.step is not LeavingStep.KNOWN:
            return False
        due = inlet.zid in self.received or now - leaving.since > QUIET_SECONDS
        if due:
            self.leaving[inlet] = Leaving(LeavingStep.FENCED, now)
        return due

    def on_fence(self, inlet: Inlet) -> None:
        """Note that the fence has returned; a fence from an earlier attempt to leave the lane is ignored."""
        leaving = self.leaving.get(inlet)
        if leaving is not None and leaving.step is LeavingStep.FENCED:
            leaving.step = LeavingStep.ENDED

    def drop(self, inlet: Inlet) -> None:
        """Remove a lane that has ended, with its publishers."""
        self.inlets.pop(inlet, None)
        self.leaving.pop(inlet, None)
        self.joined = {gid: joined for gid, joined in self.joined.items() if joined.inlet is not inlet}

    def prune(self, present: Collection[bytes]) -> None:
        """Drop the marks of publishers that are not in ``present``, if there are many marks."""
        if len(self.joined) > 2 * len(present) + _SPARED_MARKS:
            self.joined = {gid: joined for gid, joined in self.joined.items() if gid in present}

    def is_leaving(self, gid: bytes) -> bool:
        """Return whether the lane of a publisher is being left."""
        joined = self.joined.get(gid)
        return joined is not None and joined.inlet in self.leaving

    def has_caught_up(self, gid: bytes, last: int | None, now: float, passed: Callable[[str, float], bool]) -> bool:
        """Return whether all messages that a publisher sent only on zenoh have arrived; ``last``: last received number.

        ``passed`` returns whether a session has replied to a query that was sent after a given time. In that case its
        earlier messages, which zenoh delivers before the reply, have arrived or were dropped.
        """
        joined = self.joined.get(gid)
        if joined is None:
            return False
        joined.caught_up = (
            joined.caught_up
            or (last or 0) >= joined.mark
            or passed(joined.inlet.zid, joined.since)
            or now - joined.since > CAUGHT_SECONDS
        )
        return joined.caught_up


class ZenohSubscriber:
    """A subscriber on zenoh that receives from all sessions, or only from other nodes of its own session, if any.

    ``_switching`` serializes the changes. ``lock``, the subscription's lock, guards ``everywhere``. A thread that holds
    ``_switching`` may acquire ``lock``, but not the reverse.

    Attributes:
        everywhere: whether messages of other sessions may arrive.
        declared: time of the last declaration everywhere (monotonic seconds).
    """

    def __init__(
        self, context: EndpointContext, key: str, callback: Callable[[zenoh.Sample], None], lock: Lock
    ) -> None:
        self._declare = partial(subscribe, context.session, key, callback)
        self._reach = context.reach
        self._lock = lock
        self._switching = Lock()
        self._closed = False
        self.everywhere = True
        self.declared = time.monotonic()
        self._subscriber = self._declare(self._reach)

    def listen(self, *, everywhere: bool) -> None:
        """Receive from all sessions, or only from other nodes of this session, if any."""
        with self._switching:
            if self._closed or everywhere == self.everywhere:
                return
            before = self._subscriber
            if everywhere:
                with self._lock:
                    self.everywhere = True
                self._subscriber = self._declare(self._reach)
                self.declared = time.monotonic()
            elif self._reach == zenoh.Locality.ANY:
                self._subscriber = self._declare(zenoh.Locality.SESSION_LOCAL)
            if not (everywhere and self._reach != zenoh.Locality.ANY):
                undeclare(before)
            if not everywhere:
                with self._lock:
                    self.everywhere = False

    def close(self) -> None:
        with self._switching:
            self._closed = True
            undeclare(self._subscriber)
