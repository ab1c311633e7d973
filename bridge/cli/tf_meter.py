"""How often a frame is told, and how old its transforms are when they come."""

from __future__ import annotations

from collections import deque
from typing import Self

_WINDOW = 1000
_RATE_SECONDS = 5.0


class Meter:
    """Counts one frame's transforms; the newest thousand of them make the figures.

    Attributes:
        count: all that came.
        arrived: the last one's time, monotonic seconds.
    """

    def __init__(self) -> None:
        self.count = 0
        self.arrived = 0.0
        self._arrivals: deque[float] = deque(maxlen=_WINDOW)
        self._delays: deque[int] = deque(maxlen=_WINDOW)

    def add(self, arrived: float, delay: int | None) -> None:
        """One came; ``delay`` is the ns from its stamp, None where it holds for all times."""
        self.count += 1
        self.arrived = arrived
        self._arrivals.append(arrived)
        if delay is not None:
            self._delays.append(delay)

    def rate(self, now: float) -> float:
        """Transforms a second over the last five seconds; 0 where fewer than two came."""
        recent = [at for at in self._arrivals if at >= now - _RATE_SECONDS]
        whole = recent[-1] - recent[0] if recent else 0.0
        return (len(recent) - 1) / whole if whole > 0 else 0.0

    @property
    def delay(self) -> float | None:
        """Mean of the seconds from the stamp to the arrival."""
        return sum(self._delays) / len(self._delays) / 1e9 if self._delays else None

    @property
    def longest(self) -> float | None:
        """The most of them."""
        return max(self._delays) / 1e9 if self._delays else None

    def copy(self) -> Self:
        """As it is now."""
        made = type(self)()
        made.count, made.arrived = self.count, self.arrived
        made._arrivals, made._delays = self._arrivals.copy(), self._delays.copy()
        return made
