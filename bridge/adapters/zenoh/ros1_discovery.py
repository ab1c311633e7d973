"""Keys of zenoh-plugin-ros1, and the beacons with which its bridges announce their topics and services.

A topic's samples are published on ``<type in hex>/<md5>/<bridge namespace>/<topic>``; the payload is the ROS 1 message
as sent over TCPROS, without an attachment. The bridge namespace is ``*`` by default. A service is a queryable on the
same kind of key, with the service's type and md5; a bridge whose server failed replies with the error's text instead
of a response. Bridges announce their endpoints on ``ros1_discovery_info/<discovery namespace>/{pub|sub|srv|cl}/<type
in hex>/<md5>/<bridge namespace>/<topic>``, where the discovery namespace is ``*``. Source: zenoh-plugin-ros1,
``topic_utilities.rs``, ``discovery.rs`` and ``abstract_bridge.rs``, of May 2025; free_fleet's clients use the same data
keys (its ``utils.py``).

The beacons work like ALOHA. A bridge that has a topic puts an empty sample on the topic's discovery key each second;
after three seconds without a beacon the topic counts as withdrawn. A bridge that receives another bridge's beacon on
the same key may stop its own beacons, and resumes them after a second without any (``aloha_declaration.rs``,
``aloha_subscription.rs``). A native bridge that stopped because of Midspan would appear to be offline, so Midspan's
beacons always yield. A bridge that receives Midspan's beacon first may still stop; therefore all Midspan sessions that
announce a key leave, together, enough time between their beacons for the bridge to resume.
"""

from __future__ import annotations

import logging
import re
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import zenoh

from bridge.adapters.zenoh.neighbors import is_marked, sender
from bridge.hub.errors import HubWireError
from bridge.hub.zenoh_compat import source_infos, subscribe, undeclare
from bridge.messages.definitions.names import is_ros1_name
from bridge.routing.edge import Kind

_SPACE = "ros1_discovery_info"
_CLASSES = {Kind.PUBLISHER: "pub", Kind.SUBSCRIPTION: "sub", Kind.SERVER: "srv", Kind.CLIENT: "cl"}
_KINDS = {name: kind for kind, name in _CLASSES.items()}
_MD5 = re.compile(r"[0-9a-f]{32}|\*")
_MAX_KEY = 4096


@dataclass(frozen=True, slots=True)
class AnnouncedTopic:
    """A topic or a service as a bridge announces it: absolute name, ROS 1 type, md5 (``*`` for any)."""

    name: str
    type: str
    md5: str


def data_key(topic: AnnouncedTopic, namespace: str) -> str:
    """Return the key of a topic's samples, or of a service's calls."""
    return f"{topic.type.encode().hex()}/{topic.md5}/{namespace}/{topic.name.strip('/')}"


def discovery_key(kind: Kind, topic: AnnouncedTopic, namespace: str) -> str:
    """Return the key on which a topic or a service is announced."""
    return f"{_SPACE}/*/{_CLASSES[kind]}/{data_key(topic, namespace)}"


def all_discovery(namespace: str) -> str:
    """Return the expression for all discovery keys of bridges in a namespace."""
    return f"{_SPACE}/*/*/*/*/{namespace}/*/**"


def parse(key: str) -> tuple[Kind, AnnouncedTopic]:
    """Read a discovery key; raises `HubWireError` if it is invalid, or has no type, md5 or topic."""
    parts = key.split("/", 6)
    if len(key) > _MAX_KEY or len(parts) != 7 or parts[0] != _SPACE or not all(parts):
        raise HubWireError("not a discovery key of the ros1 plugin")
    kind = _KINDS.get(parts[2])
    try:
        type_name = bytes.fromhex(parts[3]).decode("ascii")
    except (ValueError, UnicodeDecodeError):
        type_name = ""
    if kind is None or not is_ros1_name(type_name):
        raise HubWireError(f"class {parts[2][:20]!r}, type {parts[3][:80]!r}: not a ROS 1 topic or service")
    if not _MD5.fullmatch(parts[4]):
        raise HubWireError(f"md5 {parts[4][:80]!r} is not an md5 sum")
    if any(char in parts[6] for char in "*$?#@"):
        raise HubWireError(f"{parts[6][:80]!r} is not a topic name")
    return kind, AnnouncedTopic("/" + parts[6], type_name, parts[4])


_log = logging.getLogger(__name__)

PERIOD = 1.0
"""Seconds between the beacons of a native bridge."""

_PAUSE = 2.25
"""Periods between Midspan's beacons. A bridge that stopped needs one period without beacons, and up to one more until
it resumes. The interval is longer than both together, and still shorter than the plugin's limit of three periods."""

_LOST = 4
"""Periods without a beacon after which a topic is dropped: one more than the plugin's limit, because two beacons may
have collided."""

_TOO_SOON = 0.5
"""A second beacon on the same key within this many periods comes from another bridge."""

_FORGOTTEN = 60
"""Periods without a beacon after which a bridge counts as new. A bridge may pause for a long time while another bridge
sends beacons."""

_MAX_TOPICS = 20_000
_MAX_BRIDGES = 100


class _Beacon:
    def __init__(self, session: zenoh.Session, key: str) -> None:
        self.users = 0
        self.due = 0.0
        self._publisher = session.declare_publisher(
            key, reliability=zenoh.Reliability.BEST_EFFORT, priority=zenoh.Priority.BACKGROUND,
            congestion_control=zenoh.CongestionControl.DROP, allowed_destination=zenoh.Locality.REMOTE,
        )  # fmt: skip
        self._infos = source_infos(self._publisher)

    def send(self, now: float) -> None:
        self.postpone(now)
        self._publisher.put(b"", source_info=next(self._infos))

    def postpone(self, now: float) -> None:
        """Postpone the next beacon, because this or another Midspan session has just sent one on the key."""
        self.due = now + _PAUSE * PERIOD

    def close(self) -> None:
        undeclare(self._publisher)


class Aloha:
    """Receives the beacons of native bridges and sends Midspan's own beacons; thread-safe.

    ``changed`` is called when a topic appears or disappears. ``on_new_bridge`` is called when a bridge starts
    announcing a subscription, with the topic and whether this bridge is the first.
    """

    def __init__(
        self, session: zenoh.Session, namespace: str, changed: Callable[[], None],
        on_new_bridge: Callable[[str, bool], None],
    ) -> None:  # fmt: skip
        self._session, self._namespace = session, namespace
        self._changed, self._on_new_bridge = changed, on_new_bridge
        self._lock = threading.Lock()
        self._last_beacons: dict[tuple[Kind, AnnouncedTopic], float] = {}
        self._bridges: dict[tuple[Kind, AnnouncedTopic], dict[str, float]] = {}
        self._own: dict[tuple[Kind, AnnouncedTopic], _Beacon] = {}
        self._ticked = time.monotonic()
        self._refused = 0
        self._subscriber = subscribe(session, all_discovery(namespace), self._on_beacon)

    def topics(self) -> list[tuple[Kind, AnnouncedTopic]]:
        """Return the topics and services that native bridges currently announce."""
        with self._lock:
            return list(self._last_beacons)

    def announce(self, kind: Kind, topic: AnnouncedTopic) -> Callable[[], None]:
        """Announce a topic of Midspan until the returned function is called."""
        with self._lock:
            beacon = self._own.get((kind, topic))
            if beacon is None:
                beacon = _Beacon(self._session, discovery_key(kind, topic, self._namespace))
                self._own[kind, topic] = beacon
            beacon.users += 1
            if (kind, topic) not in self._last_beacons and beacon.due == 0.0:
                beacon.send(time.monotonic())

        def withdraw() -> None:
            with self._lock:
                beacon.users -= 1
                if beacon.users == 0:
                    self._own.pop((kind, topic)).close()

        return withdraw

    def tick(self, now: float) -> None:
        """Send due beacons, and drop topics without beacons; time while this process is suspended does not count."""
        with self._lock:
            suspended, self._ticked = now - self._ticked, now
            if suspended > PERIOD:
                self._last_beacons = {entry: min(last + suspended, now) for entry, last in self._last_beacons.items()}
            lost = [entry for entry, last in self._last_beacons.items() if now - last > _LOST * PERIOD]
            for entry in lost:
                del self._last_beacons[entry]
                self._bridges.pop(entry, None)
            for entry, beacon in self._own.items():
                if now >= beacon.due and entry not in self._last_beacons:
                    beacon.send(now)
        if lost:
            self._changed()

    def warnings(self) -> list[str]:
        """Return a warning with the number of invalid beacons, if there are any."""
        return [f"{self._refused} beacons of ros1 bridges are ignored: see the log"] if self._refused else []

    def close(self) -> None:
        undeclare(self._subscriber)
        with self._lock:
            beacons, self._own = list(self._own.values()), {}
        for beacon in beacons:
            beacon.close()

    def _on_beacon(self, sample: zenoh.Sample) -> None:
        if sample.kind != zenoh.SampleKind.PUT:
            return
        key = str(sample.key_expr)
        try:
            entry = parse(key)
        except HubWireError as err:
            level = logging.DEBUG if self._refused else logging.WARNING
            self._refused += 1
            _log.log(level, "beacon ignored, %s: %.200s", err, key)
            return
        now = time.monotonic()
        if is_marked(sender(sample)):
            with self._lock:
                if entry in self._own:
                    self._own[entry].postpone(now)
            return
        with self._lock:
            before = self._last_beacons.get(entry)
            if before is None and len(self._last_beacons) >= _MAX_TOPICS:
                return
            self._last_beacons[entry] = now
            new = entry[0] is Kind.SUBSCRIPTION and self._is_new(entry, sender(sample), before, now)
        if before is None:
            self._changed()
        if new:
            self._on_new_bridge(entry[1].name, before is None)

    def _is_new(self, entry: tuple[Kind, AnnouncedTopic], bridge: str, before: float | None, now: float) -> bool:
        """Return whether a beacon comes from a new bridge.

        A time stamp that the bridge set identifies the bridge. Without time stamps, two beacons in quick succession
        come from two bridges.
        """
        bridges = self._bridges.setdefault(entry, {})
        last = bridges.get(bridge, 0.0)
        bridges[bridge] = now
        if len(bridges) > _MAX_BRIDGES:
            del bridges[next(iter(bridges))]
        return before is None or now - last > _FORGOTTEN * PERIOD or now - before < _TOO_SOON * PERIOD
