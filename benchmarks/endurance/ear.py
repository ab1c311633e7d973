"""Counts received, lost, repeated and reordered messages by their tickets. Standard library only.

A ticket consists of the message's number modulo 2**16, and its time of sending: CLOCK_MONOTONIC in microseconds modulo
2**36, which is 19 hours. It is a number below 2**52, which a float64 and 16 hexadecimal digits represent exactly.
"""

from __future__ import annotations

import time
from typing import Any

_NUMBERS = 1 << 16
_MICROSECONDS = 1 << 36
_REMEMBERED = 4096
_MOST_AGES = 100_000


def ticket(number: int) -> int:
    """Return the ticket of a message that is sent now."""
    return (number % _NUMBERS) * _MICROSECONDS + time.monotonic_ns() // 1000 % _MICROSECONDS


class Ear:
    """The messages received from one publisher."""

    def __init__(self) -> None:
        self.count = self.lost = self.repeated = self.disordered = 0
        self.last: int | None = None
        self._missing: dict[int, None] = {}
        self._ages: list[int] = []

    def receive(self, value: int) -> None:
        """Count a message with this ticket."""
        now = time.monotonic_ns() // 1000
        number, sent = divmod(value, _MICROSECONDS)
        self.count += 1
        if len(self._ages) < _MOST_AGES:
            self._ages.append((now - sent) % _MICROSECONDS)
        step = 1 if self.last is None else (number - self.last) % _NUMBERS
        if 0 < step < _NUMBERS // 2:
            if step > 1 and self.last is not None:
                self._miss(self.last, step - 1)
            self.last = number
        elif number in self._missing:
            del self._missing[number]
            self.lost -= 1
            self.disordered += 1
        else:
            self.repeated += 1

    def _miss(self, last: int, count: int) -> None:
        self.lost += count
        for number in range(last + 1, last + 1 + min(count, _REMEMBERED)):
            self._missing[number % _NUMBERS] = None
        while len(self._missing) > _REMEMBERED:
            del self._missing[next(iter(self._missing))]

    def report(self) -> dict[str, Any]:
        """Return the counts so far, and the ages in milliseconds of the messages since the last report."""
        ages, self._ages = sorted(self._ages), []
        quantiles = (
            {n: ages[min(int(len(ages) * q), len(ages) - 1)] / 1000 for n, q in QUANTILES.items()} if ages else {}
        )
        return {
            "count": self.count,
            "lost": self.lost,
            "repeated": self.repeated,
            "disordered": self.disordered,
            "last": self.last,
            "ages": quantiles,
        }


QUANTILES = {"p50": 0.5, "p99": 0.99, "max": 1.0}


def behind(sent: int, last: int | None) -> int:
    """Return how many of ``sent`` messages, numbered from 0, come after ``last``, the last received number.

    Numbers are modulo 2**16. The result is 0 if no message was sent, or none was received.
    """
    return 0 if last is None or not sent else (sent - 1 - last) % _NUMBERS
