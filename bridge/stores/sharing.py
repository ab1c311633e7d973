"""Synchronizes a replica over the hub: sends local changes, merges remote ones, and aligns with replicas that join.

Below ``midspan/store/<domain>/``::

    <kind>/<name>               the values: puts and deletes, and queries; wildcards are allowed
    @sync/alive/<zid>/<daemon>  a liveliness token for each replica
    @sync/digest/<zid>          query: which versions differ from these digests
    @sync/fetch/<zid>/**        query for entries; each reply is under .../<kind>/<name>
    @sync/write/<zid>           query that writes (`bridge.client.store`), optionally only if the versions are as given

Wildcard subscriptions do not match a key that starts with ``@``. A machine that is not trusted can query values and
digests, but neither write nor reply (`bridge.hub.security.access`).
"""

from __future__ import annotations

import json
import logging
import threading
import time
from collections.abc import Iterable, Sequence
from dataclasses import astuple, replace
from typing import Any

from bridge.concurrency import SerialExecutor
from bridge.hub.endpoints.keyspace import KeyItem, KeyQuery, KeySpace
from bridge.hub.errors import HubError
from bridge.hub.wire.version import WIRE, refusal
from bridge.stores.entry import StoreEntry, StoreError, json_object
from bridge.stores.kinds import KINDS
from bridge.stores.replica import Body, Key, Replica
from bridge.stores.store import write_all
from bridge.stores.wire import BUCKETS, bucket, check_wire, digests, entry_of, item_of, key_of, stamp_of, version_of

_log = logging.getLogger(__name__)

PERIOD = 10.0  # seconds between regular comparisons with the other replicas
_RETRY_SECONDS = 1.0
_MOST_TRIES = 5
_MOST_WAITING = 1000  # queued samples and queries; the next comparison recovers further samples
_BATCH_KEYS, _BATCH_BYTES = 200, 64 << 20
_MOST_KEYS = 100_000
_MOST_WRITE = 1 << 20
_NOT_AN_OBJECT = "the query is not a JSON object"


class StoreSync:
    """Synchronizes a replica from now on, and compares it with the others every ``period`` s; owns ``space``."""

    def __init__(self, replica: Replica, space: KeySpace, zid: str, period: float = PERIOD) -> None:
        self._replica, self._space, self._zid, self._period = replica, space, zid, period
        self._serving = SerialExecutor("store-serving")
        self._sending = SerialExecutor("store-sending")
        self._unsent: dict[Key, None] = {}
        self._waiting = 0
        self._others: dict[str, str] = {}
        self._strangers: set[str] = set()
        self._due: dict[str, int] = {}
        self.refused = 0
        self._wake = threading.Condition()
        self._closed = False
        self._aligning = threading.Thread(target=self._run, name="store-aligning", daemon=True)
        self._withdraw = replica.on_write(self._written)
        space.subscribe("*/*", self._on_item)
        space.serve("*/*", lambda question: self._on_query(question, self._answer_values), complete=True)
        for verb, answer in (
            (f"digest/{zid}", self._answer_digest),
            (f"fetch/{zid}/**", self._answer_fetch),
            (f"write/{zid}", self._answer_write),
        ):
            space.serve(f"@sync/{verb}", lambda question, answer=answer: self._on_query(question, answer))  # type: ignore[misc]
        space.announce(f"@sync/alive/{zid}/{replica.origin}")
        space.watch("@sync/alive/*/*", self._on_replica)
        self._aligning.start()

    def others(self) -> list[str]:
        """Return the daemons whose replicas are reachable now."""
        with self._wake:
            return sorted(self._others.values())

    def close(self) -> None:
        """Send pending changes, and leave the hub."""
        self._withdraw()
        self._sending.close()
        with self._wake:
            self._closed = True
            self._wake.notify()
        self._space.close()
        self._serving.close()
        self._aligning.join(2.0)

    # Local changes

    def _written(self, entries: Sequence[StoreEntry]) -> None:
        with self._wake:
            for entry in entries:
                if entry.key not in self._unsent:
                    self._unsent[entry.key] = None
                    self._sending.submit(self._send_one)

    def _send_one(self) -> None:
        with self._wake:
            key = next(iter(self._unsent))
            del self._unsent[key]
        entry = self._replica.entry(*key)
        if entry is not None:
            self._space.send(item_of(entry))

    # Changes of others

    def _on_item(self, item: KeyItem) -> None:
        with self._wake:
            full = self._waiting >= _MOST_WAITING
            self._waiting += not full
            if full:
                self._due.update(dict.fromkeys(self._others, 0))
                self._wake.notify()
        if not full:
            self._serving.submit(lambda: self._merge_queued(item))

    def _merge_queued(self, item: KeyItem) -> None:
        with self._wake:
            self._waiting -= 1
        self._merge(item, item.key)

    def _merge(self, item: KeyItem, text: str) -> None:
        try:
            key = key_of(text)
            if not item.attachment and not item.ns:
                item = replace(item, ns=time.time_ns(), writer=self._replica.id)
            if self._replica.stamp(key) != version_of(item).stamp:
                self._replica.merge(entry_of(item, key))
        except StoreError as err:
            with self._wake:
                self.refused += 1
            _log.warning("%s is not merged: %s", text[:300], err)

    # Queries of others

    def _on_query(self, question: KeyQuery, answer: Any) -> None:
        with self._wake:
            full = self._waiting >= _MOST_WAITING
            self._waiting += not full
        if full:
            question.fail("the store has too many concurrent queries; try again later")
            question.end()
        else:
            self._serving.submit(lambda: self._answer_waiting(question, answer))

    def _answer_waiting(self, question: KeyQuery, answer: Any) -> None:
        with self._wake:
            self._waiting -= 1
        try:
            answer(question)
        except StoreError as err:
            question.fail(str(err))
        finally:
            question.end()

    def _answer_values(self, question: KeyQuery) -> None:
        wanted = question.key
        keys = [wanted] if "*" not in wanted else ["/".join(key) for key in self._replica.versions()]
        for text in keys:
            if question.asks_for(text):
                entry = self._replica.entry(*key_of(text))
                if entry is not None and entry.body is not None:
                    question.reply(item_of(entry))

    def _answer_digest(self, question: KeyQuery) -> None:
        theirs = _texts(_request_of(question.body), "digests", BUCKETS)
        versions = self._replica.versions()
        ours = digests(versions)
        differ = {number for number in range(BUCKETS) if number >= len(theirs) or theirs[number] != ours[number]}
        entries = [
            [*key, stamp.ns, stamp.replica, size] for key, (stamp, size) in versions.items() if bucket(key) in differ
        ]
        question.reply(KeyItem(f"@sync/digest/{self._zid}", json.dumps({"wire": WIRE, "entries": entries}).encode()))

    def _answer_fetch(self, question: KeyQuery) -> None:
        for text in _texts(_request_of(question.body), "keys", _MOST_KEYS):
            entry = self._replica.entry(*key_of(text))
            if entry is not None:
                question.reply(item_of(entry, f"@sync/fetch/{self._zid}/"))

    def _answer_write(self, question: KeyQuery) -> None:
        end = question.body.find(b"\n", 0, _MOST_WRITE)
        head = _request_of(question.body[: max(end, 0)])
        writes, stamps = head.get("writes"), head.get("stamps", {})
        if not isinstance(writes, list) or not isinstance(stamps, dict):
            raise StoreError("the query has nothing to write")
        changes: dict[Key, Body | None] = {}
        start = end + 1
        for text, size in _sizes(writes):
            kind, name = key = key_of(text)
            if size is None:
                changes[key] = None
                continue
            body = question.body[start : start + size]
            start += size
            KINDS[kind].decode(name, body)
            changes[key] = body, KINDS[kind].encoding
        if start != len(question.body):
            raise StoreError("the values do not have the stated lengths")
        with self._replica.locked():
            versions = self._replica.versions() if stamps else {}
            now = {text: versions.get(key_of(text)) for text in stamps}
            stale = stamps != {text: known and list(astuple(known[0])) for text, known in now.items()}
            if not stale:
                write_all(self._replica, changes)
        question.reply(KeyItem(f"@sync/write/{self._zid}", b'{"stale": true}' if stale else b"{}"))

    # Alignment

    def _on_replica(self, token: str, joined: bool) -> None:
        zid, _, daemon = token.removeprefix("@sync/alive/").partition("/")
        if zid == self._zid:
            return
        with self._wake:
            if joined:
                self._others[zid] = daemon
                self._due[zid] = 0
                self._wake.notify()
            else:
                self._others.pop(zid, None)
                self._strangers.discard(zid)
                self._due.pop(zid, None)

    def _run(self) -> None:
        regular = time.monotonic() + self._period
        while True:
            with self._wake:
                pause = _RETRY_SECONDS if any(self._due.values()) else regular - time.monotonic()
                if not self._closed and 0 not in self._due.values():
                    self._wake.wait(max(pause, 0.01))
                if self._closed:
                    return
                if time.monotonic() >= regular:
                    regular = time.monotonic() + self._period
                    self._due = dict.fromkeys(self._others, 0) | self._due
                due, self._due = self._due, {}
            for zid, tries in due.items():
                self._align_with(zid, tries)

    def _align_with(self, zid: str, tries: int) -> None:
        try:
            aligned = self._align(zid)
        except (HubError, StoreError) as err:
            _log.debug("cannot compare with the store of session %s: %s", zid, err)
            aligned = False
        except Exception:
            _log.exception("cannot compare with the store of session %s", zid)
            aligned = True  # the next regular comparison may succeed
        if not aligned and tries < _MOST_TRIES:
            with self._wake:
                if zid in self._others:
                    self._due.setdefault(zid, tries + 1)

    def _align(self, zid: str) -> bool:
        """Merge the entries of which replica ``zid`` has a later version; return False if it does not answer."""
        question = json.dumps({"wire": WIRE, "digests": digests(self._replica.versions())}).encode()
        answers = self._space.ask(f"@sync/digest/{zid}", question)
        if not answers:
            return False
        under = f"@sync/fetch/{zid}/"
        reply = json_object(answers[0].body or b"", _NOT_AN_OBJECT)
        if reason := refusal(reply.get("wire")):
            self._refuse(zid, reason)
            return True
        for batch in self._batches(_entries(reply)):
            for item in self._space.ask(f"{under}**", json.dumps({"wire": WIRE, "keys": batch}).encode(), 30.0):
                if self._closed:
                    return True
                self._merge(item, item.key.removeprefix(under))
        return True

    def _refuse(self, zid: str, reason: str) -> None:
        """Log that a replica's version is incompatible, once for each replica."""
        with self._wake:
            new = zid in self._others and zid not in self._strangers
            if new:
                self._strangers.add(zid)
                self.refused += 1
        if new:
            _log.warning("the store of %s is not merged: %s", self._others.get(zid), reason)

    def _batches(self, theirs: Iterable[Sequence[Any]]) -> Iterable[list[str]]:
        """Yield the keys of which the other replica has a later version, in batches of bounded size."""
        ours = self._replica.versions()
        keys: list[str] = []
        size = 0
        for kind, name, ns, replica, length in theirs:
            try:
                text = "/".join(key_of(f"{kind}/{name}"))
                stamp = stamp_of(ns, replica)
            except StoreError as err:
                _log.debug("%s", err)
                continue
            if (kind, name) in ours and ours[kind, name][0] >= stamp:
                continue
            if keys and (len(keys) >= _BATCH_KEYS or size + length > _BATCH_BYTES):
                yield keys
                keys, size = [], 0
            keys.append(text)
            size += length
        if keys:
            yield keys


def _texts(document: dict[str, Any], key: str, most: int) -> list[str]:
    value = document.get(key, [])
    if not isinstance(value, list) or len(value) > most or not all(isinstance(text, str) for text in value):
        raise StoreError(f"{key} is not a list of up to {most} texts")
    return value


def _sizes(writes: Iterable[Any]) -> Iterable[tuple[str, int | None]]:
    for write in writes:
        key, size = (write.get("key"), write.get("size")) if isinstance(write, dict) else (None, None)
        whole = size is None or (isinstance(size, int) and not isinstance(size, bool) and size > 0)
        if not isinstance(key, str) or not whole:
            raise StoreError(f"{write!r:.80} cannot be written")
        yield key, size


def _request_of(body: bytes) -> dict[str, Any]:
    """Parse a query's body; raises `StoreError` if it is invalid or has an incompatible version."""
    request = json_object(body, _NOT_AN_OBJECT)
    check_wire(request)
    return request


def _entries(reply: dict[str, Any]) -> list[Sequence[Any]]:
    entries = reply.get("entries")
    if not isinstance(entries, list) or len(entries) > _MOST_KEYS:
        raise StoreError("the other store's reply is invalid")
    return [entry for entry in entries if isinstance(entry, list) and len(entry) == 5 and isinstance(entry[4], int)]
