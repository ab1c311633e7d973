"""Allocates port numbers (if possible always the same for a name), port names and multicast addresses.

Numbers range from 2 to 9999 above the name server's own; only after the last one are freed numbers reused for other
names, as in yarpserver 3.12 (``AllocatorOnTriples.cpp``). Unlike in yarpserver, numbers that a port registered
explicitly are skipped, and if no number is left, a registration is refused instead of ending the server.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from typing import Any

FIRST_OFFSET = 2
LAST_OFFSET = 9999
_MAX_NAMES = 100_000
_MAX_GROUPS = 254 * 254


def numbers_outside(base: int) -> range:
    """Return the port numbers above the range of a name server at ``base``, or below it if there are too few.

    A yarpserver that lost its state allocates its numbers from the first on without testing them. If an open port
    still uses such a number, the program that gets it fails ("address conflict"), every time, because names keep
    their numbers.
    """
    size = LAST_OFFSET + 1
    return range(base + size, base + 2 * size) if base + 2 * size <= 0x10000 else range(base - size, base)


class Allocator:
    """Allocates numbers (above ``base``, the name server's own), names and multicast addresses, and stores them."""

    def __init__(self, base: int) -> None:
        self._first = base + FIRST_OFFSET
        self._last = min(base + LAST_OFFSET, 0xFFFF)
        self._next = self._first
        self._owner: dict[int, str] = {}
        self._number: dict[str, int] = {}
        self._used: set[int] = set()
        self._names = _Pool(_MAX_NAMES)
        self._groups = _Pool(_MAX_GROUPS)

    def number(self, name: str, taken: Container[int] = ()) -> int | None:
        """Allocate a number for a name, preferably its former one, that is not ``taken``; None if all are in use."""
        number = self._number.get(name)
        if number is None or number in taken:
            number = self._fresh(taken)
        if number is None:
            return None
        former = self._owner.get(number)
        if former is not None:
            del self._number[former]
        stale = self._number.get(name)
        if stale is not None:
            del self._owner[stale]
        self._owner[number], self._number[name] = name, number
        self._used.add(number)
        return number

    def _fresh(self, taken: Container[int]) -> int | None:
        while self._next <= self._last:
            number = self._next
            self._next += 1
            if number not in taken:
                return number
        freed = (n for n in range(self._first, self._last + 1) if n not in self._used and n not in taken)
        return next(freed, None)

    def name(self) -> str | None:
        """Allocate a name for an anonymous port: ``/tmp/port/1`` etc.; None if too many are in use."""
        index = self._names.acquire()
        return None if index is None else f"/tmp/port/{index}"  # noqa: S108 - a port's name

    def group(self) -> str | None:
        """Allocate a multicast address: ``224.1.1.3`` etc.; None if all are in use."""
        index = self._groups.acquire()
        if index is None:
            return None
        return f"224.1.{(index + 1) // 255 + 1}.{(index + 1) % 255 + 1}"

    def free(self, name: str, host: str, number: int) -> None:
        """Free the name, number and address of a port."""
        if self._owner.get(number) == name:
            self._used.discard(number)
        stem, _, index = name.rpartition("/")
        if stem == "/tmp/port" and index.isdecimal():  # noqa: S108 - a port's name
            self._names.release(int(index))
        parts = host.split(".")
        if parts[:2] == ["224", "1"] and len(parts) == 4 and all(p.isdecimal() for p in parts):
            self._groups.release((int(parts[2]) - 1) * 255 + int(parts[3]) - 2)

    def state(self) -> dict[str, Any]:
        """Return the state, in types that JSON supports."""
        return {
            "next": self._next,
            "numbers": dict(self._number),
            "used": sorted(self._used),
            "names": self._names.state(),
            "groups": self._groups.state(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore the valid numbers of what `state` returned; raises `KeyError`, `TypeError` or `ValueError`."""
        numbers = {str(name): int(n) for name, n in state["numbers"].items() if self._first <= int(n) <= self._last}
        self._owner = {number: name for name, number in numbers.items()}
        self._number = {name: number for number, name in self._owner.items()}
        self._used = {int(n) for n in state["used"]} & self._owner.keys()
        self._next = max([int(state["next"]), self._first, *(n + 1 for n in self._used)])
        self._names.restore(state["names"])
        self._groups.restore(state["groups"])


class _Pool:
    """A pool of indices from 1 up, which reuses freed indices first."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._next = 1
        self._free: set[int] = set()

    def acquire(self) -> int | None:
        if self._free:
            index = min(self._free)
            self._free.discard(index)
            return index
        if self._next > self._limit:
            return None
        self._next += 1
        return self._next - 1

    def release(self, index: int) -> None:
        if 0 < index < self._next:
            self._free.add(index)

    def state(self) -> list[Any]:
        return [self._next, sorted(self._free)]

    def restore(self, state: Any) -> None:
        self._next = min(max(1, int(state[0])), self._limit + 1)
        self._free = {int(i) for i in state[1] if 0 < int(i) < self._next}
