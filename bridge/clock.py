"""The time scale of a process, which is the system clock or a simulation's ``/clock``, and jumps of either."""

from __future__ import annotations

import logging
import struct
import threading
import time
from collections import deque
from collections.abc import Callable

_log = logging.getLogger(__name__)
_TIME = struct.Struct("<iI")
_HEADER = 4
_SECOND = 1_000_000_000

CLOCK_TYPE = "rosgraph_msgs/msg/Clock"
CLOCK_TOPIC = "/clock"
DONE_TOPIC = "/sim/acknowledge"
"""Topic on which nodes that run on a simulation's clock acknowledge a time, so that the simulation can continue."""

DONE_TYPE = "std_msgs/msg/Header"

SILENCE_SECONDS = 5.0
"""Seconds without a message on ``/clock`` after which a simulated clock is reported as a problem."""

MOST_BACK, BACK_SECONDS = 5, 5.0
"""More steps back than this within these seconds mean that several programs publish ``/clock``."""

STEP_NS = 100_000_000
"""A change of the system clock is a jump if it exceeds the possible slewing by more than this, in ns.

ntpd steps the clock for offsets of 128 ms or more, systemd-timesyncd for 400 ms or more. A step that is too small to be
a jump delays transforms by less than this.
"""

SLEW = 0.11
"""The maximum rate at which slewing changes the system clock, in seconds per second.

Linux allows 10 % (ADJ_TICK) plus 500 ppm (ADJ_FREQUENCY); chrony by default uses up to 8.3 % (maxslewrate).
"""

POLL_SECONDS = 0.2

_READ_NS = 1_000_000
_READS = 5

Jumped = Callable[[], None]
"""Called after a jump, to discard what depends on time."""


def steady_ns() -> int:
    """Return ns on a clock that is never set; if possible, it also runs while the machine is suspended."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic_ns()


def steady() -> float:
    """Return `steady_ns` in seconds."""
    return steady_ns() / 1e9


def is_jump(change: int, passed: int, error: int = 0) -> bool:
    """Return whether a clock was set, given the ``change`` of its offset from a steady one in ``passed``; all in ns."""
    return abs(change) > STEP_NS + error + round(SLEW * passed)


def _wall_ns() -> int:
    return time.time_ns()


class SystemClock:
    """The system clock, with notifications when NTP or a user sets it. Safe to use from any thread.

    While there are listeners, a thread compares the clock with a monotonic clock. Slewing is not a jump.

    Args:
        wall: returns the time in ns, by default of this machine's clock.
        steady: returns the time in ns of a clock that is never set.
        poll: seconds between two comparisons; with 0 no thread is started, and the owner calls `check`.
    """

    def __init__(
        self, wall: Callable[[], int] | None = None, steady: Callable[[], int] = steady_ns, poll: float = POLL_SECONDS
    ) -> None:
        self._wall, self._steady, self._poll = wall or _wall_ns, steady, poll
        self._lock = threading.Lock()
        self._listeners: list[Jumped] = []
        self._wake: threading.Event | None = None
        self._last, self._offset, self._error = self.read()

    def now_ns(self) -> int:
        """Return nanoseconds since 1970."""
        return self._wall()

    def on_jump(self, jumped: Jumped) -> Callable[[], None]:
        """Call ``jumped`` after each jump, on a thread of this clock, until the returned function is called."""
        with self._lock:
            if not self._listeners:
                self._last, self._offset, self._error = self.read()
                if self._poll:
                    wake = self._wake = threading.Event()
                    threading.Thread(target=self._run, args=(wake,), name="midspan-clock", daemon=True).start()
            self._listeners.append(jumped)
        return lambda: self._withdraw(jumped)

    def check(self) -> int:
        """Compare the clocks; if the system clock has jumped since the last call, notify the listeners.

        Return the jump in ns, 0 if there was none.
        """
        now, offset, error = self.read()
        with self._lock:
            jump, passed = offset - self._offset, max(now - self._last, 0)
            jumped = is_jump(jump, passed, error + self._error)
            self._last, self._offset, self._error = now, offset, error
            listeners = tuple(self._listeners)
        if not jumped:
            return 0
        direction = "back" if jump < 0 else "forward"
        _log.warning("the system clock was set %s by %.3f s: discarding transforms", direction, abs(jump) / _SECOND)
        _notify(listeners)
        return jump

    def read(self) -> tuple[int, int, int]:
        """Return the monotonic time, the system clock's offset from it, and the maximum error of the offset, in ns."""
        best = (0, 0, -1)
        for _ in range(_READS):
            before = self._steady()
            wall = self._wall()
            error = self._steady() - before
            if best[2] < 0 or error < best[2]:
                best = (before, wall - before, error)
            if error < _READ_NS:
                break
        return best

    def _run(self, wake: threading.Event) -> None:
        while not wake.wait(self._poll):
            self.check()

    def _withdraw(self, jumped: Jumped) -> None:
        with self._lock:
            _discard(self._listeners, jumped)
            if not self._listeners and self._wake is not None:
                self._wake.set()
                self._wake = None


SYSTEM_CLOCK = SystemClock()
"""The clock of this machine, which the whole process shares."""


class RunClock:
    """The time of a run: the system clock, or the last time on ``/clock``. Safe to use from any thread.

    Args:
        simulated: whether the time is that of ``/clock``, whose messages the hub or a side delivers (`receive`).
        system: the clock of a run that is not simulated.

    Attributes:
        source: whether this process itself publishes ``/clock``, and therefore receives none.
    """

    def __init__(self, *, simulated: bool = False, system: SystemClock | None = None) -> None:
        self.simulated, self.source = simulated, False
        self._system = system or SYSTEM_CLOCK
        self._now = 0
        self._lock = threading.Lock()
        self._listeners: list[Jumped] = []
        self._withdrawals: list[Callable[[], None]] = []
        self._on_time: list[Callable[[int], None]] = []
        self._after: list[Callable[[int], None]] = []
        self._arrived = time.monotonic()
        self._running = False
        self._backs: deque[float] = deque(maxlen=MOST_BACK)  # the monotonic times of the last steps back
        self._several_until = 0.0

    def now_ns(self) -> int:
        """Return ns since 1970, or the time of the simulation in ns; 0 before the first message."""
        return self._now if self.simulated else self._system.now_ns()

    def elapsed_ns(self) -> int:
        """Return the simulation's time, or that of a clock that is never set, in ns, for ages and timeouts."""
        return self._now if self.simulated else time.monotonic_ns()

    def stamp(self) -> dict[str, int]:
        """Return the time as ``builtin_interfaces/msg/Time``."""
        seconds, nanoseconds = divmod(self.now_ns(), _SECOND)
        return {"sec": seconds, "nanosec": nanoseconds}

    def trouble(self) -> str:
        """Return why simulated time stands still or is set back all the time; "" if not, or without simulated time."""
        now = time.monotonic()
        if now < self._several_until:
            return (
                f"{CLOCK_TOPIC} is set back all the time (clock.source: sim): several programs publish it; stop all but"
                " one"
            )
        if not self.simulated or self.source or now - self._arrived <= SILENCE_SECONDS:
            return ""
        if self._running:
            return (
                f"{CLOCK_TOPIC} is silent (clock.source: sim): simulated time stands still at"
                f" {self._now / _SECOND:.3f} s; resume or restart the simulation"
            )
        return (
            f"no message on {CLOCK_TOPIC} (clock.source: sim): stamps stay 0, and programs on simulated time wait in"
            " sleep; start the simulation or 'midspan play --clock', or set clock.source: system"
        )

    def receive(self, cdr: bytes) -> None:
        """Accept a message on ``/clock``, as CDR with its encapsulation header."""
        if not self.simulated or len(cdr) < _HEADER + _TIME.size:
            return
        seconds, nanoseconds = _TIME.unpack_from(cdr, _HEADER)
        now = seconds * _SECOND + nanoseconds
        self._arrived, self._running = time.monotonic(), True
        with self._lock:
            back, self._now = now < self._now, now
            listeners = tuple(self._listeners) if back else ()
            followers = (*self._on_time, *self._after)
        if back:
            self._log_back(now)
        _notify(listeners)
        for follower in followers:
            follower(now)

    def _log_back(self, now: int) -> None:
        """Log a step back to a simulated time, or only once that there are too many of them."""
        at = self._arrived
        several = len(self._backs) == MOST_BACK and at - self._backs[0] < BACK_SECONDS
        self._backs.append(at)
        known = at < self._several_until
        if several:
            self._several_until = at + BACK_SECONDS
        if not several:
            _log.warning("%s was set back to %.3f s", CLOCK_TOPIC, now / _SECOND)
        elif not known:
            _log.warning("%s", self.trouble())

    def on_jump(self, jumped: Jumped) -> Callable[[], None]:
        """Call ``jumped`` after each jump, until the returned function or `close` is called.

        The system clock can jump back or forward. On ``/clock`` only a step back is a jump, because a simulation may
        make forward steps of any length; ``jumped`` then runs on the thread that receives the time.
        """
        if not self.simulated:
            withdraw = self._system.on_jump(jumped)
            self._withdrawals.append(withdraw)
            return withdraw
        self._listeners.append(jumped)
        return lambda: _discard(self._listeners, jumped)

    def on_time(self, follower: Callable[[int], None], *, last: bool = False) -> Callable[[], None]:
        """Call ``follower`` with each time of a simulation in ns, until the returned function is called.

        ``last``: call it after all others.
        """
        among = self._after if last else self._on_time
        among.append(follower)
        return lambda: _discard(among, follower)

    def close(self) -> None:
        """Stop the notifications of jumps. Safe to call twice."""
        self._listeners.clear()
        while self._withdrawals:
            self._withdrawals.pop()()


SYSTEM = RunClock()
"""The system clock."""


def _notify(listeners: tuple[Jumped, ...]) -> None:
    """Notify every listener, even if one of them raises an exception."""
    for jumped in listeners:
        try:
            jumped()
        except Exception:
            _log.exception("a jump of the clock was not handled")


def _discard(callbacks: list[Callable[..., None]], callback: Callable[..., None]) -> None:
    if callback in callbacks:
        callbacks.remove(callback)
