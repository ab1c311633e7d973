"""The store's file: an SQLite database with one row for each key, including deleted ones.

Every transaction is on the disk before it is acknowledged: write-ahead log with ``synchronous = FULL``, which syncs the
log at each commit (https://www.sqlite.org/pragma.html#pragma_synchronous). So neither a killed process nor a power cut
loses an acknowledged transaction, and a transaction is applied completely or not at all. The file is locked while it is
open: a second process needs its own replica and file.
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from bridge.stores.entry import ChangeStamp, StoreEntry, StoreError, Version

_FORM = 1
_BUSY_SECONDS = 1.0
_SCHEMA = """
CREATE TABLE IF NOT EXISTS about (word TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS entries (
    kind TEXT NOT NULL, name TEXT NOT NULL, ns INTEGER NOT NULL, replica TEXT NOT NULL, origin TEXT NOT NULL,
    seen TEXT NOT NULL, encoding TEXT NOT NULL, body BLOB, PRIMARY KEY (kind, name)
);
"""


class EntryTable:
    """The rows of the file; only one thread at a time may use them.

    Creates a missing file. Raises `StoreError` if the file cannot be opened, is not a database, was written by a newer
    Midspan, or is in use by another process.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            self._base = sqlite3.connect(file, timeout=_BUSY_SECONDS, isolation_level=None, check_same_thread=False)
        except (OSError, sqlite3.Error) as err:
            raise StoreError(f"the store {file} cannot be opened: {err}") from None
        try:
            self._prepare()
        except sqlite3.DatabaseError as err:
            self._base.close()
            raise StoreError(self._trouble(err)) from None
        except BaseException:
            self._base.close()
            raise

    @property
    def replica(self) -> str:
        """This replica's id: 16 bytes in hexadecimal, fixed for the file's lifetime."""
        return str(self._base.execute("SELECT value FROM about WHERE word = 'replica'").fetchone()[0])

    def versions(self) -> Iterator[tuple[tuple[str, str], Version, int | None]]:
        """Yield all keys with their version and the size of their value, None if it is deleted."""
        rows = self._base.execute("SELECT kind, name, ns, replica, origin, seen, length(body) FROM entries")
        for kind, name, ns, replica, origin, seen, size in rows:
            yield (kind, name), Version(ChangeStamp(ns, replica), origin, json.loads(seen)), size

    def body(self, kind: str, name: str) -> tuple[bytes | None, str]:
        """Return a key's value and its encoding."""
        with self._store_errors():
            wanted = "SELECT body, encoding FROM entries WHERE kind = ? AND name = ?"
            row = self._base.execute(wanted, (kind, name)).fetchone()
        return (None, "") if row is None else (row[0], row[1])

    def write(self, entries: Sequence[StoreEntry], removed: Iterable[tuple[str, str]] = ()) -> None:
        """Write entries and delete the ``removed`` keys' rows, in one transaction that is durable when this returns."""
        with self._store_errors():
            self._base.execute("BEGIN IMMEDIATE")
            try:
                insert = "INSERT OR REPLACE INTO entries VALUES (?, ?, ?, ?, ?, ?, ?, ?)"
                self._base.executemany(insert, map(_row, entries))
                self._base.executemany("DELETE FROM entries WHERE kind = ? AND name = ?", removed)
                self._base.execute("COMMIT")
            except BaseException:
                if self._base.in_transaction:
                    self._base.execute("ROLLBACK")
                raise

    def close(self) -> None:
        self._base.close()

    def _prepare(self) -> None:
        base = self._base
        base.execute("PRAGMA locking_mode = EXCLUSIVE")
        base.execute("PRAGMA journal_mode = WAL")
        base.execute("PRAGMA synchronous = FULL")
        base.execute("PRAGMA journal_size_limit = 4194304")
        form = base.execute("PRAGMA user_version").fetchone()[0]
        if form > _FORM:
            msg = f"the store {self._file} was written by a newer Midspan (form {form}; this one reads {_FORM})"
            raise StoreError(msg)
        base.execute("BEGIN IMMEDIATE")
        for statement in _SCHEMA.split(";"):
            base.execute(statement)
        base.execute("INSERT OR IGNORE INTO about VALUES ('replica', ?)", (_new_replica(),))
        base.execute(f"PRAGMA user_version = {_FORM}")
        base.execute("COMMIT")

    @contextmanager
    def _store_errors(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as err:
            raise StoreError(self._trouble(err)) from None

    def _trouble(self, err: sqlite3.Error) -> str:
        if "locked" in str(err):
            return f"the store {self._file} is in use by another process"
        if isinstance(err, sqlite3.OperationalError):
            return f"the store {self._file}: {err}"
        return (
            f"the store {self._file} cannot be read: {err}; move it away, and this machine starts with the content"
            " of the other machines"
        )


def _row(entry: StoreEntry) -> tuple[object, ...]:
    version = entry.version
    seen = json.dumps(dict(version.seen), separators=(",", ":"))
    stamp = version.stamp
    return entry.kind, entry.name, stamp.ns, stamp.replica, version.origin, seen, entry.encoding, entry.body


def _new_replica() -> str:
    while True:
        name = os.urandom(16)
        if name[0] and name[-1]:  # zenoh strips zeros from the ends of an id
            return name.hex()
