"""How entries travel on the hub: a value under ``<kind>/<name>`` with its time, and its version in the attachment.

The attachment is JSON, ``{"ns", "replica", "origin", "seen"}`` of `bridge.stores.entry`, and ``wire``, the version of
`bridge.hub.wire.version`, which the questions of `bridge.stores.sharing` and answers in JSON say, too. A value without
one comes from a program that knows zenoh alone: its time is zenoh's, and it counts as written by somebody who knew what
was there. zenoh's routers give a time to a put that has none, and none to a delete (measured with zenoh 1.10).
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from typing import Any

from bridge.hub.endpoints.keyspace import KeyItem
from bridge.hub.wire.version import WIRE, refusal
from bridge.stores.entry import LATEST, MOST_SEEN, ChangeStamp, StoreEntry, StoreError, Version, check_name, json_object
from bridge.stores.kinds import KINDS
from bridge.stores.replica import Key

BUCKETS = 64
_DIGEST = 8
_MOST_ATTACHED = 8192
_MOST_ORIGIN = 80
_REPLICA = re.compile(r"(?:[0-9a-f]{2}){1,16}")


def prefix(domain: int) -> str:
    """Where a deployment's store is."""
    return f"midspan/store/{domain}"


def item_of(entry: StoreEntry, under: str = "") -> KeyItem:
    """An entry as it travels, for some answers under a key of their own."""
    version = entry.version
    ns, replica = version.stamp.ns, version.stamp.replica
    about = {"ns": ns, "replica": replica, "origin": version.origin, "seen": dict(version.seen), "wire": WIRE}
    attached = json.dumps(about, separators=(",", ":")).encode()
    return KeyItem(f"{under}{entry.kind}/{entry.name}", entry.body, entry.encoding, ns, replica, attached)


def key_of(text: str) -> Key:
    """Kind and name of a key beneath the prefix; raises `StoreError` where there can be no such."""
    kind, slash, name = text.partition("/")
    if not slash or kind not in KINDS:
        raise StoreError(f"{text[:80]!r} is no key of the store: write <kind>/<name> with a kind of {', '.join(KINDS)}")
    return kind, check_name(name)


def entry_of(item: KeyItem, key: Key) -> StoreEntry:
    """The entry of a key that came from elsewhere, its value checked; raises `StoreError`."""
    kind, name = key
    version = version_of(item)
    if item.body is not None:
        KINDS[kind].decode(name, item.body)
    return StoreEntry(kind, name, item.body, "" if item.body is None else KINDS[kind].encoding, version)


def version_of(item: KeyItem) -> Version:
    """The version of an item; raises `StoreError`."""
    if item.attached:
        attached = item.attached if len(item.attached) <= _MOST_ATTACHED else b""
        about = json_object(attached, "its attachment is not Midspan's")
        check_wire(about)
        seen = about.get("seen")
        if not isinstance(seen, dict) or len(seen) > MOST_SEEN:
            raise StoreError("it does not say what its writer knew")
        stamp = stamp_of(about.get("ns"), about.get("replica"))
        seen_ns = {stamp_.replica: stamp_.ns for stamp_ in (stamp_of(ns, replica) for replica, ns in seen.items())}
        origin = about.get("origin")
        if not isinstance(origin, str) or not origin.isprintable() or not 0 < len(origin) <= _MOST_ORIGIN:
            raise StoreError("it does not say which daemon wrote it")
        return Version(stamp, origin, {**seen_ns, stamp.replica: stamp.ns})
    stamp = stamp_of(item.ns, item.writer)
    return Version(stamp, f"zenoh {stamp.replica[:8]}")


def check_wire(document: Mapping[str, Any]) -> None:
    """Raise `StoreError` where something was said in a version that cannot be understood."""
    if reason := refusal(document.get("wire")):
        raise StoreError(reason)


def stamp_of(ns: Any, replica: Any) -> ChangeStamp:
    """A stamp that was received; raises `StoreError`."""
    if isinstance(ns, bool) or not isinstance(ns, int) or not 0 < ns < LATEST:
        raise StoreError(f"its time cannot be: {ns!r:.60}")
    if not isinstance(replica, str) or not _REPLICA.fullmatch(replica):
        raise StoreError(f"{replica!r:.60} is no id of a replica")
    return ChangeStamp(ns, replica)


def digests(versions: Mapping[Key, tuple[ChangeStamp, int]]) -> list[str]:
    """A digest of the stamps in each of `BUCKETS` parts of the keys: equal where all of a part are the same."""
    buckets = [0] * BUCKETS
    for key, (stamp, _) in versions.items():
        text = f"{key[0]}/{key[1]}/{stamp.ns}/{stamp.replica}".encode()
        buckets[bucket(key)] ^= int.from_bytes(hashlib.blake2b(text, digest_size=_DIGEST).digest())
    return [f"{digest:016x}" for digest in buckets]


def bucket(key: Key) -> int:
    """Which part of the keys one is in."""
    return hashlib.blake2b("/".join(key).encode(), digest_size=1).digest()[0] % BUCKETS
