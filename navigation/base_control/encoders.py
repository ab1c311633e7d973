"""Encoder readings: their times, and the wheels' rotation and velocities."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from operator import mul
from typing import NamedTuple

PATIENCE = 0.2  # seconds without a newer stamp after which the driver's clock counts as set back or stopped
_JUMP = 0.5  # seconds by which stamps may run ahead of arrivals; more is a step of the driver's clock


class ReadingTime(NamedTuple):
    """When the encoders were read."""

    stamp_ns: int  #: for messages: of the driver's clock, or of this program's clock if the driver has none
    seconds: float  #: always increasing, even across a step of the driver's clock


class ReadingTimes:
    """Assigns times to readings whose stamps may jitter, repeat, go back, jump or be missing.

    Args:
        simulated: whether a simulation sets the time of stamps and arrivals. Its stamps may run far ahead of arrivals,
            since one step of the simulation advances its time at once; that is not a step of the driver's clock.
    """

    def __init__(self, *, simulated: bool = False) -> None:
        self._jump = math.inf if simulated else _JUMP
        self._last: ReadingTime | None = None
        self._arrival = 0.0
        self._stamp_ns = 0  # the stamp of the last reading, accepted or not
        self._stopped = False  # whether the driver's clock has stopped

    def add(self, stamp_ns: int, arrival: float, now_ns: int) -> ReadingTime | None:
        """Return the time of a reading, or None if it is not newer than the previous reading.

        ``arrival`` is in seconds of a clock that is never set; ``now_ns`` is the time that replaces a missing stamp.
        """
        repeated, self._stamp_ns = stamp_ns == self._stamp_ns, stamp_ns
        last, waited = self._last, arrival - self._arrival
        if last is None:
            return self._accept(stamp_ns or now_ns, arrival, 0.0)
        self._stopped = repeated and (self._stopped or waited >= PATIENCE)
        if not stamp_ns or self._stopped:
            stamp_ns = now_ns
        elif stamp_ns <= last.stamp_ns and waited < PATIENCE:
            return None
        step = (stamp_ns - last.stamp_ns) / 1e9
        return self._accept(stamp_ns, arrival, step if 0.0 < step <= waited + self._jump else max(waited, 0.0))

    def _accept(self, stamp_ns: int, arrival: float, step: float) -> ReadingTime:
        before = stamp_ns / 1e9 if self._last is None else self._last.seconds
        self._last, self._arrival = ReadingTime(stamp_ns, before + step), arrival
        return self._last


_SLACK = 0.05  # seconds by which the time between two readings may be wrong
_CERTAIN = 0.5  # rad; a smaller change always counts as a motion, since a base may be pushed fast
_WRAP = 2.0 * math.pi


def rotation_between(before: float, after: float, seconds: float, fastest: float) -> float:
    """Return the angle, rad, by which a wheel turned between two readings of its encoder.

    If no wheel can make the change in that time, at ``fastest`` rad/s, an encoder that counts within one turn may have
    wrapped. If a wrap does not explain the change either, the encoder has restarted at another angle, and the wheel
    counts as not turned.
    """
    change = after - before
    possible = fastest * (seconds + _SLACK)
    if abs(change) <= max(_CERTAIN, possible):
        return change
    wrapped = math.remainder(change, _WRAP)
    return wrapped if abs(change) <= _WRAP and abs(wrapped) <= possible else 0.0


WINDOW = 0.25  # seconds over which a velocity is the slope of the angles
_SHORTEST = WINDOW / 2.0
"""Seconds that readings must span for a slope. Over a shorter time, jitter could cause any velocity, so the slope is
reduced."""

_SAMPLES = 20
_STANDING = 0.1  # seconds without a change of any angle after which the wheels count as stopped
_STILL_ANGLE, _STILL_RATE = 1e-10, 5e-10  # rad and rad/s that are rounding errors of a simulation, not motion


class WheelRates:
    """The velocities of wheels, rad/s: reported by their encoders, else computed from their angles over a `WINDOW`.

    A computed velocity is the slope of a least-squares fit, which averages the jitter of stamps: computed from two
    readings with stamps close together, it would be many times too high. The velocity of stopped wheels is exactly
    zero, after `_STANDING` seconds at the latest.
    """

    def __init__(self, wheels: int) -> None:
        self._zero = [0.0] * wheels
        self._reports = False  # whether an encoder has reported a velocity other than 0
        self.clear()

    def clear(self) -> None:
        self._window: deque[tuple[float, Sequence[float]]] = deque()
        self._changed: tuple[float, Sequence[float]] | None = None

    def add(self, time: float, angles: Sequence[float], reported: Sequence[float] | None = None) -> list[float]:
        """Return the velocities at a reading; ``time`` (seconds) must be later than that of the last reading.

        Encoders that have reported only 0 so far may not measure velocities at all, so the angles are used instead.
        """
        self._store(time, angles)
        usable = reported is not None and len(reported) == len(self._zero) and all(map(math.isfinite, reported))
        self._reports = self._reports or (usable and any(reported or ()))
        if self._is_standing(time, angles):
            return list(self._zero)
        rates = list(reported) if usable and self._reports and reported is not None else self._slopes()
        return [0.0 if abs(rate) < _STILL_RATE else rate for rate in rates]

    def _is_standing(self, time: float, angles: Sequence[float]) -> bool:
        changed = self._changed
        if changed is None or any(abs(a - b) > _STILL_ANGLE for a, b in zip(angles, changed[1], strict=True)):
            self._changed = changed = time, angles
        return time - changed[0] >= _STANDING

    def _store(self, time: float, angles: Sequence[float]) -> None:
        """Store a reading. Of readings that are close together only the newest is stored, which limits their number."""
        window = self._window
        if len(window) > 1 and time - window[-2][0] < WINDOW / _SAMPLES:
            window.pop()
        window.append((time, angles))
        while len(window) > 2 and time - window[0][0] > WINDOW and time - window[1][0] >= _SHORTEST:
            window.popleft()

    def _slopes(self) -> list[float]:
        """Return the slopes of the angles over the window, by least squares."""
        count = len(self._window)
        if count < 2:
            return list(self._zero)
        newest, oldest = self._window[-1][0], self._window[0][0]
        times = [time - newest for time, _ in self._window]
        mean = sum(times) / count
        deviations = [time - mean for time in times]
        share = min(1.0, (newest - oldest) / _SHORTEST) / sum(map(mul, deviations, deviations))
        columns = zip(*(angles for _, angles in self._window), strict=True)
        return [share * sum(map(mul, deviations, column)) for column in columns]
