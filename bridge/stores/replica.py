"""One daemon's copy of the store, as bytes: what is written here or comes from others, merged key by key."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from bridge.concurrency import SerialExecutor
from bridge.stores.entry import LATEST, OLDEST, ChangeStamp, StoreEntry, StoreError, Version, conflict, follow
from bridge.stores.table import EntryTable

_log = logging.getLogger(__name__)

T = TypeVar("T")

_DAY_NS = 86_400 * 1_000_000_000
_MOST_CONFLICTS = 20  # conflicts that the status names
Key = tuple[str, str]
Body = tuple[bytes, str]  # a value's bytes and their encoding


@dataclass(frozen=True, slots=True)
class StoreLimits:
    """What a replica holds at most: values, their bytes, deleted keys, and days for which it remembers these."""

    keys: int = 10_000
    size: int = 1 << 30
    deleted: int = 10_000
    deleted_days: float = 30.0


@dataclass(frozen=True, slots=True)
class Change:
    """A key was written or deleted by the daemon ``origin``; ``here``: at this replica."""

    kind: str
    name: str
    deleted: bool
    origin: str
    here: bool


OnChange = Callable[[Change], Any]
SendEntries = Callable[[Sequence[StoreEntry]], Any]


@dataclass(frozen=True, slots=True)
class _Known:
    version: Version
    size: int | None


class Replica:
    """See the module. Safe to use from any thread; raises `StoreError` where the file cannot be used."""

    def __init__(self, file: Path, origin: str, limits: StoreLimits | None = None) -> None:
        self.origin, self.limits = origin, limits or StoreLimits()
        self._lost: deque[str] = deque(maxlen=_MOST_CONFLICTS)
        self.conflict_count = 0
        self._table = EntryTable(file)
        self.id = self._table.replica
        self._known: dict[Key, _Known] = {key: _Known(version, size) for key, version, size in self._table.versions()}
        self._size = sum(known.size or 0 for known in self._known.values())
        self._live = sum(known.size is not None for known in self._known.values())
        self._lock = threading.RLock()
        self._last = 0
        self._watches: list[tuple[frozenset[str], OnChange]] = []
        self._senders: list[SendEntries] = []
        self._events = SerialExecutor("store-events")
        self._closed = False

    def get(self, kind: str, name: str) -> Body | None:
        """A key's value, None where it has none."""
        with self._lock:
            self._check_open()
            known = self._known.get((kind, name))
            if known is None or known.size is None:
                return None
            body, encoding = self._table.body(kind, name)
        return None if body is None else (body, encoding)

    def entry(self, kind: str, name: str) -> StoreEntry | None:
        """A key with its version, None where it was never there; deleted ones have no body."""
        with self._lock:
            self._check_open()
            known = self._known.get((kind, name))
            if known is None:
                return None
            body, encoding = self._table.body(kind, name)
            return StoreEntry(kind, name, body, encoding, known.version)

    def names(self, kind: str) -> list[str]:
        """The names of a kind's values, sorted."""
        with self._lock:
            return sorted(
                name for (other, name), known in self._known.items() if other == kind and known.size is not None
            )

    def stamp(self, key: Key) -> ChangeStamp | None:
        """When a key was written or deleted last, as far as this is remembered."""
        with self._lock:
            known = self._known.get(key)
            return None if known is None else known.version.stamp

    def has(self, kind: str, name: str) -> bool:
        """Whether a key has a value."""
        with self._lock:
            known = self._known.get((kind, name))
            return known is not None and known.size is not None

    def still(self) -> threading.RLock:
        """A lock: while it is held nothing is written by others."""
        return self._lock

    def remembers(self, kind: str, name: str) -> bool:
        """Whether the key has a value, or had one that was deleted."""
        with self._lock:
            return (kind, name) in self._known

    def versions(self) -> Mapping[Key, tuple[ChangeStamp, int]]:
        """Every key's stamp and its value's size; deleted ones too, as long as they are remembered."""
        oldest = self._oldest()
        with self._lock:
            return {
                key: (known.version.stamp, known.size or 0)
                for key, known in self._known.items()
                if known.size is not None or known.version.stamp.ns > oldest
            }

    def write(self, changes: Mapping[Key, Body | None], *, oldest: bool = False) -> list[StoreEntry]:
        """Write values, or delete them (None), in one transaction; on the disk when this returns.

        With ``oldest`` they are older than anything that was ever written, and hold only where nothing is. Raises
        `StoreError` where the store is full, or the file cannot be written; then nothing has changed.
        """
        with self._lock:
            self._check_open()
            entries = [self._stamped(key, body, oldest=oldest) for key, body in changes.items()]
            self._apply(entries, here=True)
            for send in self._senders:
                send(entries)
        return entries

    def merge(self, entry: StoreEntry) -> bool:
        """Take an entry of another replica; whether it holds now. Raises `StoreError` where it cannot be written."""
        with self._lock:
            self._check_open()
            known = self._known.get(entry.key)
            if not entry.version.seen:  # of a program that knows zenoh alone: it changes what it finds
                before = None if known is None else known.version
                version = follow(before, entry.version.stamp, entry.version.origin)
                entry = replace(entry, version=version)
            if known is not None:
                if known.version.stamp == entry.version.stamp:
                    return False
                self._compare(entry)
                if known.version.stamp > entry.version.stamp:
                    return False
            elif entry.body is None and entry.version.stamp.ns <= self._oldest():
                return False
            self._apply([entry], here=False)
        return True

    def watch(self, on_change: OnChange, kinds: Iterable[str] = ()) -> Callable[[], None]:
        """Call back for every change of some kinds (none: of all) until the returned function is called.

        It is called on the replica's own thread, for one change after the other, and is to return soon.
        """
        return self._joined(self._watches, (frozenset(kinds), on_change))

    def on_write(self, send: SendEntries) -> Callable[[], None]:
        """Have what is written here sent, on the writer's thread, until the returned function is called."""
        return self._joined(self._senders, send)

    def _joined(self, callbacks: list[T], callback: T) -> Callable[[], None]:
        with self._lock:
            callbacks.append(callback)

        def close() -> None:
            with self._lock:
                if callback in callbacks:
                    callbacks.remove(callback)

        return close

    def status(self) -> dict[str, Any]:
        """How many keys of each kind, and what was lost to others, for the status document.

        ``changed`` is the stamp of the newest change, by whichever replica: seconds since 1970.
        """
        with self._lock:
            live = [kind for (kind, _), known in self._known.items() if known.size is not None]
            return {
                "keys": {kind: live.count(kind) for kind in sorted(set(live))},
                "deleted": len(self._known) - len(live),
                "bytes": self._size,
                "limits": {"keys": self.limits.keys, "bytes": self.limits.size},
                "changed": max((known.version.stamp.ns for known in self._known.values()), default=0) / 1e9,
                "conflicts": self.conflict_count,
                "lost": list(self._lost),
            }

    def close(self) -> None:
        """Close the file; changes that wait to be heard are heard before. Safe to call twice."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            self._table.close()
        self._events.close()

    def _stamped(self, key: Key, body: Body | None, *, oldest: bool) -> StoreEntry:
        before = self._known.get(key)
        now = self._last = max(time.time_ns(), self._last + 1)
        if oldest:
            now = OLDEST
        # a key from a machine whose clock is ahead is changed all the same, and other keys keep our time
        above = 0 if before is None else before.version.stamp.ns + 1
        if above >= LATEST:
            msg = f"{key[0]} {key[1]!r} was written with a time that cannot be followed; delete it at its origin"
            raise StoreError(msg)
        version = follow(None if before is None else before.version, ChangeStamp(max(now, above), self.id), self.origin)
        data, encoding = (None, "") if body is None else body
        return StoreEntry(*key, data, encoding, version)

    def _apply(self, entries: Sequence[StoreEntry], *, here: bool) -> None:
        size, live = self._size, self._live
        for entry in entries:
            before = self._known.get(entry.key)
            before_size = None if before is None else before.size
            size += (0 if entry.body is None else len(entry.body)) - (before_size or 0)
            live += (entry.body is not None) - (before_size is not None)
        self._check_room(size, live)
        expired = self._forgettable(entries)
        self._table.write(entries, expired)
        self._size, self._live = size, live
        for entry in entries:
            self._known[entry.key] = _Known(entry.version, None if entry.body is None else len(entry.body))
        for key in expired:
            del self._known[key]
        for entry in entries:
            self._notify(Change(entry.kind, entry.name, entry.body is None, entry.version.origin, here))

    def _check_room(self, size: int, live: int) -> None:
        if live > max(self.limits.keys, self._live):
            msg = f"the store has {self._live} values, and may have {self.limits.keys} (store.keys)"
        elif size > max(self.limits.size, self._size):
            msg = f"the store has {self._size >> 20} MB, and may have {self.limits.size >> 20} MB (store.megabytes)"
        else:
            return
        raise StoreError(msg)

    def _forgettable(self, entries: Sequence[StoreEntry]) -> list[Key]:
        """Deleted keys that are remembered no longer: too old, or too many."""
        coming = sum(entry.body is None for entry in entries)
        if not coming:
            return []
        written = {entry.key for entry in entries}
        dead = sorted(
            (known.version.stamp.ns, key)
            for key, known in self._known.items()
            if known.size is None and key not in written
        )
        oldest, many = self._oldest(), len(dead) + coming - self.limits.deleted
        return [key for number, (ns, key) in enumerate(dead) if ns <= oldest or number < many]

    def _oldest(self) -> int:
        return time.time_ns() - int(self.limits.deleted_days * _DAY_NS)

    def _compare(self, entry: StoreEntry) -> None:
        ours = self.entry(*entry.key)
        conflict_ = None if ours is None else conflict(ours, entry)
        if conflict_ is not None:
            self.conflict_count += 1
            self._lost.append(str(conflict_))
            _log.warning("%s", conflict_)

    def _notify(self, change: Change) -> None:
        for kinds, on_change in tuple(self._watches):
            if not kinds or change.kind in kinds:
                self._events.submit(lambda on_change=on_change: on_change(change))  # type: ignore[misc]

    def _check_open(self) -> None:
        if self._closed:
            raise StoreError("the store is closed")
