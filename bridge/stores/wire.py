"""How entries are sent on the hub: a value under ``<kind>/<name>`` with its time, and its version in the attachment.

The attachment is JSON, ``{"ns", "replica", "origin", "seen"}`` of `bridge.stores.entry` and ``wire``, the version of
`bridge.hub.wire.version`, which the queries and JSON replies of `bridge.stores.sharing` have too. A value without an
attachment comes from a plain zenoh program. Its time is zenoh's, and its writer counts as knowing the current version.
zenoh's routers add a time to a put without one, but not to a delete (measured with zenoh 1.10).
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
    """Return the key prefix of a deployment's store."""
    return f"midspan/store/{domain}"


def item_of(entry: StoreEntry, under: str = "") -> KeyItem:
    """Return an entry as it is sent, optionally with a key prefix."""
    version = entry.version
    ns, replica = version.stamp.ns, version.stamp.replica
    about = {"ns": ns, "replica": replica, "origin": version.origin, "seen": dict(version.seen), "wire": WIRE}
    attachment = json.dumps(about, separators=(",", ":")).encode()
    return KeyItem(f"{under}{entry.kind}/{entry.name}", entry.body, entry.encoding, ns, replica, attachment)


def key_of(text: str) -> Key:
    """Parse a key below the prefix into kind and name; raises `StoreError` if it is invalid."""
    kind, slash, name = text.partition("/")
    if not slash or kind not in KINDS:
        raise StoreError(
            f"{text[:80]!r} is not a key of the store: use <kind>/<name>, with a kind of {', '.join(KINDS)}"
        )
    return kind, check_name(name)


def entry_of(item: KeyItem, key: Key) -> StoreEntry:
    """Return the received entry of a key, with its value checked; raises `StoreError`."""
    kind, name = key
    version = version_of(item)
    if item.body is not None:
        KINDS[kind].decode(name, item.body)
    return StoreEntry(kind, name, item.body, "" if item.body is None else KINDS[kind].encoding, version)


def version_of(item: KeyItem) -> Version:
    """Return the version of an item; raises `StoreError`."""
    if item.attachment:
        attachment = item.attachment if len(item.attachment) <= _MOST_ATTACHED else b""
        about = json_object(attachment, "its attachment is not Midspan's")
        check_wire(about)
        seen = about.get("seen")
        if not isinstance(seen, dict) or len(seen) > MOST_SEEN:
            raise StoreError("it does not list the changes known to its writer")
        stamp = stamp_of(about.get("ns"), about.get("replica"))
        seen_ns = {stamp_.replica: stamp_.ns for stamp_ in (stamp_of(ns, replica) for replica, ns in seen.items())}
        origin = about.get("origin")
        if not isinstance(origin, str) or not origin.isprintable() or not 0 < len(origin) <= _MOST_ORIGIN:
            raise StoreError("it does not name the daemon that wrote it")
        return Version(stamp, origin, {**seen_ns, stamp.replica: stamp.ns})
    stamp = stamp_of(item.ns, item.writer)
    return Version(stamp, f"zenoh {stamp.replica[:8]}")


def check_wire(document: Mapping[str, Any]) -> None:
    """Raise `StoreError` if a document's version is incompatible."""
    if reason := refusal(document.get("wire")):
        raise StoreError(reason)


def stamp_of(ns: Any, replica: Any) -> ChangeStamp:
    """Return a received stamp; raises `StoreError` if it is invalid."""
    if isinstance(ns, bool) or not isinstance(ns, int) or not 0 < ns < LATEST:
        raise StoreError(f"invalid time: {ns!r:.60}")
    if not isinstance(replica, str) or not _REPLICA.fullmatch(replica):
        raise StoreError(f"{replica!r:.60} is not a replica id")
    return ChangeStamp(ns, replica)


def digests(versions: Mapping[Key, tuple[ChangeStamp, int]]) -> list[str]:
    """Divide the keys into `BUCKETS` parts, and return a digest of the stamps in each part, to compare replicas."""
    buckets = [0] * BUCKETS
    for key, (stamp, _) in versions.items():
        text = f"{key[0]}/{key[1]}/{stamp.ns}/{stamp.replica}".encode()
        buckets[bucket(key)] ^= int.from_bytes(hashlib.blake2b(text, digest_size=_DIGEST).digest())
    return [f"{digest:016x}" for digest in buckets]


def bucket(key: Key) -> int:
    """Return the index of a key's part among the `BUCKETS` parts."""
    return hashlib.blake2b("/".join(key).encode(), digest_size=1).digest()[0] % BUCKETS
