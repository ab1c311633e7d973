"""One daemon's replica of the store, as bytes: local and remote changes, merged key by key."""

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
from bridge.module_keys import StoreContent
from bridge.stores.entry import LATEST, OLDEST, ChangeStamp, StoreEntry, StoreError, Version, conflict, follow
from bridge.stores.table import EntryTable

_log = logging.getLogger(__name__)

T = TypeVar("T")

_DAY_NS = 86_400 * 1_000_000_000
_MOST_CONFLICTS = 20  # conflicts listed in the status
Key = tuple[str, str]
Body = tuple[bytes, str]  # a value's bytes and their encoding


@dataclass(frozen=True, slots=True)
class StoreLimits:
    """Upper limits of a replica: values, their bytes, tombstones of deleted keys, and days that tombstones stay."""

    keys: int = 10_000
    size: int = 1 << 30
    deleted: int = 10_000
    deleted_days: float = 30.0


@dataclass(frozen=True, slots=True)
class Change:
    """A write or deletion of a key by the daemon ``origin``; ``here``: whether it was made through this replica."""

    kind: str
    name: str
    deleted: bool
    origin: str
    here: bool


OnChange = Callable[[Change], Any]
SendEntries = Callable[[Sequence[StoreEntry]], Any]


@dataclass(frozen=True, slots=True)
class _Row:
    version: Version
    size: int | None


class Replica:
    """A replica of the store. Safe to use from any thread; raises `StoreError` if the file cannot be used."""

    def __init__(self, file: Path, origin: str, limits: StoreLimits | None = None) -> None:
        self.file, self.origin, self.limits = file, origin, limits or StoreLimits()
        self._lost: deque[str] = deque(maxlen=_MOST_CONFLICTS)
        self.conflict_count = 0
        self._table = EntryTable(file)
        self.id = self._table.replica
        self._rows: dict[Key, _Row] = {key: _Row(version, size) for key, version, size in self._table.versions()}
        self._size = sum(row.size or 0 for row in self._rows.values())
        self._live = sum(row.size is not None for row in self._rows.values())
        self._lock = threading.RLock()
        self._last = 0
        self._watches: list[tuple[frozenset[str], OnChange]] = []
        self._senders: list[SendEntries] = []
        self._events = SerialExecutor("store-events")
        self._closed = False

    def get(self, kind: str, name: str) -> Body | None:
        """Return a key's value, None if the key has none."""
        with self._lock:
            self._check_open()
            row = self._rows.get((kind, name))
            if row is None or row.size is None:
                return None
            body, encoding = self._table.body(kind, name)
        return None if body is None else (body, encoding)

    def entry(self, kind: str, name: str) -> StoreEntry | None:
        """Return a key with its version, None if it never existed; a deleted key has no body."""
        with self._lock:
            self._check_open()
            row = self._rows.get((kind, name))
            if row is None:
                return None
            body, encoding = self._table.body(kind, name)
            return StoreEntry(kind, name, body, encoding, row.version)

    def names(self, kind: str) -> list[str]:
        """Return the names of a kind's values, sorted."""
        with self._lock:
            return sorted(name for (other, name), row in self._rows.items() if other == kind and row.size is not None)

    def stamp(self, key: Key) -> ChangeStamp | None:
        """Return when a key was last written or deleted, None if that is not known."""
        with self._lock:
            row = self._rows.get(key)
            return None if row is None else row.version.stamp

    def has(self, kind: str, name: str) -> bool:
        """Return whether a key has a value."""
        with self._lock:
            row = self._rows.get((kind, name))
            return row is not None and row.size is not None

    def locked(self) -> threading.RLock:
        """Return a lock that blocks other threads' reads and writes while it is held."""
        return self._lock

    def remembers(self, kind: str, name: str) -> bool:
        """Return whether the key has a value or a tombstone."""
        with self._lock:
            return (kind, name) in self._rows

    def versions(self) -> Mapping[Key, tuple[ChangeStamp, int]]:
        """Return each key's stamp and the size of its value, including tombstones that are not expired."""
        oldest = self._oldest()
        with self._lock:
            return {
                key: (row.version.stamp, row.size or 0)
                for key, row in self._rows.items()
                if row.size is not None or row.version.stamp.ns > oldest
            }

    def write(self, changes: Mapping[Key, Body | None], *, oldest: bool = False) -> list[StoreEntry]:
        """Write values, or delete them (None), in one transaction; it is on the disk when this returns.

        With ``oldest``, the values count as older than any other value, so that keys with a value or a tombstone keep
        it; these keys are not returned. Raises `StoreError` if the store is full or the file cannot be written; then
        nothing has changed.
        """
        with self._lock:
            self._check_open()
            entries = [
                self._new_entry(key, body, oldest=oldest)
                for key, body in changes.items()
                if not (oldest and key in self._rows)
            ]
            self._apply(entries, here=True)
            for send in self._senders:
                send(entries)
        return entries

    def merge(self, entry: StoreEntry) -> bool:
        """Merge another replica's entry; return whether it is now current; raises `StoreError` if writing fails."""
        with self._lock:
            self._check_open()
            row = self._rows.get(entry.key)
            # an entry of a plain zenoh program has no version, and counts as a change of the current version
            if not entry.version.seen:
                before = None if row is None else row.version
                version = follow(before, entry.version.stamp, entry.version.origin)
                entry = replace(entry, version=version)
            if row is not None:
                if row.version.stamp == entry.version.stamp:
                    return False
                self._compare(entry)
                if row.version.stamp > entry.version.stamp:
                    return False
            elif entry.body is None and entry.version.stamp.ns <= self._oldest():
                return False
            self._apply([entry], here=False)
        return True

    def watch(self, on_change: OnChange, kinds: Iterable[str] = ()) -> Callable[[], None]:
        """Call back for every change of some kinds (all if empty) until the returned function is called.

        Callbacks run one after the other on the replica's own thread, and must not block.
        """
        return self._add_callback(self._watches, (frozenset(kinds), on_change))

    def on_write(self, send: SendEntries) -> Callable[[], None]:
        """Pass local changes to ``send``, on the writer's thread, until the returned function is called."""
        return self._add_callback(self._senders, send)

    def _add_callback(self, callbacks: list[T], callback: T) -> Callable[[], None]:
        with self._lock:
            callbacks.append(callback)

        def close() -> None:
            with self._lock:
                if callback in callbacks:
                    callbacks.remove(callback)

        return close

    def status(self) -> StoreContent:
        """Return the number of keys of each kind, and the conflicts, for the status document."""
        with self._lock:
            live = [kind for (kind, _), row in self._rows.items() if row.size is not None]
            return StoreContent(
                keys={kind: live.count(kind) for kind in sorted(set(live))},
                deleted=len(self._rows) - len(live),
                bytes=self._size,
                limits={"keys": self.limits.keys, "bytes": self.limits.size},
                changed=max((row.version.stamp.ns for row in self._rows.values()), default=0) / 1e9,
                conflicts=self.conflict_count,
                lost=list(self._lost),
            )

    def close(self) -> None:
        """Close the file, then call back for pending changes. Safe to call twice.

        A callback that reads the store then fails, because the store is closed.
        """
        with self._lock:
            if self._closed:
                return
            self._closed = True
            self._table.close()
        self._events.close()

    def _new_entry(self, key: Key, body: Body | None, *, oldest: bool) -> StoreEntry:
        before = self._rows.get(key)
        now = self._last = max(time.time_ns(), self._last + 1)
        if oldest:
            now = OLDEST
        # if the key's last writer had a clock ahead of ours, stamp this change after its change; else with our time
        above = 0 if before is None else before.version.stamp.ns + 1
        if above >= LATEST:
            msg = f"{key[0]} {key[1]!r} has the latest possible time stamp; delete it at its origin"
            raise StoreError(msg)
        version = follow(None if before is None else before.version, ChangeStamp(max(now, above), self.id), self.origin)
        data, encoding = (None, "") if body is None else body
        return StoreEntry(*key, data, encoding, version)

    def _apply(self, entries: Sequence[StoreEntry], *, here: bool) -> None:
        size, live = self._size, self._live
        for entry in entries:
            before = self._rows.get(entry.key)
            before_size = None if before is None else before.size
            size += (0 if entry.body is None else len(entry.body)) - (before_size or 0)
            live += (entry.body is not None) - (before_size is not None)
        self._check_room(size, live)
        expired = self._tombstones_to_drop(entries)
        self._table.write(entries, expired)
        self._size, self._live = size, live
        for entry in entries:
            self._rows[entry.key] = _Row(entry.version, None if entry.body is None else len(entry.body))
        for key in expired:
            del self._rows[key]
        for entry in entries:
            self._notify(Change(entry.kind, entry.name, entry.body is None, entry.version.origin, here))

    def _check_room(self, size: int, live: int) -> None:
        if live > max(self.limits.keys, self._live):
            msg = f"the store has {self._live} values; the limit is {self.limits.keys} (store.keys)"
        elif size > max(self.limits.size, self._size):
            msg = f"the store has {self._size >> 20} MB; the limit is {self.limits.size >> 20} MB (store.megabytes)"
        else:
            return
        raise StoreError(msg)

    def _tombstones_to_drop(self, entries: Sequence[StoreEntry]) -> list[Key]:
        """Return the tombstones that have expired, and the oldest ones above the limit once ``entries`` are written."""
        coming = sum(entry.body is None for entry in entries)
        if not coming:
            return []
        written = {entry.key for entry in entries}
        dead = sorted(
            (row.version.stamp.ns, key) for key, row in self._rows.items() if row.size is None and key not in written
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
