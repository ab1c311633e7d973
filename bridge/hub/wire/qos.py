"""The quality of service of an endpoint, and its text form in rmw_zenoh's liveliness tokens.

The enumerations have rmw's numbers (rmw/types.h). The text is
``<reliability>:<durability>:<history>,<depth>:<deadline s>,<ns>:<lifespan s>,<ns>:<liveliness>,<s>,<ns>``;
a field equal to rmw_zenoh's default profile is left empty.
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple, TypeVar

from bridge.hub.errors import HubWireError

DEFAULT_DEPTH = 42
"""History depth of rmw_zenoh's default profile (rmw_zenoh_cpp, qos.cpp)."""

_NS = 1_000_000_000
_INFINITE = (9_223_372_036, 854_775_807)
BEST_AVAILABLE_NS = _INFINITE[0] * _NS + _INFINITE[1] - 1
"""The deadline that means BEST_AVAILABLE (rmw/types.h, ``RMW_QOS_DEADLINE_BEST_AVAILABLE``)."""

_LIVELINESS = frozenset({1, 2, 3, 5})
"""rmw's liveliness policies: automatic, manual by node, manual by topic, best available."""

_MAX_DEPTH = 2**31 - 1
_Policy = TypeVar("_Policy", bound=IntEnum)


class Reliability(IntEnum):
    """Whether lost samples are sent again."""

    RELIABLE = 1
    BEST_EFFORT = 2
    BEST_AVAILABLE = 4
    """Occurs only in announcements; the graph resolves it (`bridge.hub.graph.best_available`)."""


class Durability(IntEnum):
    """Whether late joiners receive past samples."""

    TRANSIENT_LOCAL = 1
    VOLATILE = 2
    BEST_AVAILABLE = 4
    """Occurs only in announcements, like `Reliability.BEST_AVAILABLE`."""


class History(IntEnum):
    """Which samples are stored."""

    KEEP_LAST = 1
    KEEP_ALL = 2


@dataclass(frozen=True, slots=True)
class Qos:
    """The quality of service of one endpoint; deadlines, lifespans and leases are in nanoseconds, None for infinite.

    ``lease_ns`` and ``manual`` (by topic) are the liveliness on DDS; the hub does not store it, see `decode_qos`.
    """

    reliability: Reliability = Reliability.RELIABLE
    durability: Durability = Durability.VOLATILE
    history: History = History.KEEP_LAST
    depth: int = 10
    deadline_ns: int | None = None
    lifespan_ns: int | None = None
    lease_ns: int | None = None
    manual: bool = False

    @property
    def latched(self) -> bool:
        """Whether late joiners receive past samples (in ROS 1: latching)."""
        return self.durability is Durability.TRANSIENT_LOCAL

    @property
    def best_available(self) -> bool:
        """Whether a policy is open, so that it has to be resolved against the matching endpoints."""
        return (
            self.reliability is Reliability.BEST_AVAILABLE
            or self.durability is Durability.BEST_AVAILABLE
            or self.deadline_ns == BEST_AVAILABLE_NS
        )


LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
"""The QoS that ROS 1 calls latched: late joiners receive the last sample."""


def encode_qos(qos: Qos) -> str:
    """Return the text form of a quality of service in a liveliness token."""
    reliability = "" if qos.reliability is Reliability.RELIABLE else str(int(qos.reliability))
    durability = "" if qos.durability is Durability.VOLATILE else str(int(qos.durability))
    history = "" if qos.history is History.KEEP_LAST else str(int(qos.history))
    depth = "" if qos.depth == DEFAULT_DEPTH else str(qos.depth)
    times = f"{_encode_time(qos.deadline_ns)}:{_encode_time(qos.lifespan_ns)}"
    return f"{reliability}:{durability}:{history},{depth}:{times}:,,"


def decode_qos(text: str) -> Qos:
    """Parse the QoS text of a token; raises `HubWireError` if it is malformed.

    A policy that rmw leaves to the middleware (0, system default) or does not define (`unknown_policies`) becomes
    rmw_zenoh's default. A deadline or lifespan of zero is unspecified in rmw, and therefore infinite. The liveliness
    policy is not stored, because the token's existence shows liveliness.
    """
    fields = _fields(text)
    depth = fields.history[1]
    if depth is not None and depth > _MAX_DEPTH:
        raise HubWireError(f"history depth {depth} is out of range")
    deadline = _decode_time(*fields.deadline)
    lifespan = _decode_time(*fields.lifespan)
    return Qos(
        _policy(Reliability, fields.reliability, Reliability.RELIABLE),
        _policy(Durability, fields.durability, Durability.VOLATILE),
        _policy(History, fields.history[0], History.KEEP_LAST),
        DEFAULT_DEPTH if depth is None else depth,
        deadline,
        None if lifespan == BEST_AVAILABLE_NS else lifespan,
    )


def unknown_policies(text: str) -> list[str]:
    """Describe the policies in the QoS text of a token that rmw does not define; raises `HubWireError` if malformed."""
    fields = _fields(text)
    policies: tuple[tuple[str, int | None, Container[int], str], ...] = (
        ("reliability", fields.reliability, set(Reliability), "reliable"),
        ("durability", fields.durability, set(Durability), "volatile"),
        ("history", fields.history[0], set(History), "keep last"),
        ("liveliness", fields.liveliness[0], _LIVELINESS, "automatic"),
    )
    return [
        f"{name} policy {value} is unknown, so rmw's default ({default}) is used"
        for name, value, known, default in policies
        if value and value not in known
    ]


class _Fields(NamedTuple):
    """The numbers in the QoS text of a token; None for an empty field."""

    reliability: int | None
    durability: int | None
    history: list[int | None]
    deadline: list[int | None]
    lifespan: list[int | None]
    liveliness: list[int | None]


def _fields(text: str) -> _Fields:
    fields = text.split(":")
    if len(fields) != 6:
        raise HubWireError(f"quality of service {text[:80]!r} has {len(fields)} fields instead of 6")
    reliability, durability, *others = (_numbers(*field) for field in zip(fields, (1, 1, 2, 2, 2, 3), strict=True))
    return _Fields(reliability[0], durability[0], *others)


def _encode_time(time_ns: int | None) -> str:
    if time_ns is None:
        return ","
    parts = divmod(time_ns, _NS)
    return ",".join("" if part == default else str(part) for part, default in zip(parts, _INFINITE, strict=True))


def _decode_time(seconds: int | None, nanoseconds: int | None) -> int | None:
    pair = (_INFINITE[0] if seconds is None else seconds, _INFINITE[1] if nanoseconds is None else nanoseconds)
    time_ns = pair[0] * _NS + pair[1]
    return time_ns if 0 < time_ns < _INFINITE[0] * _NS or time_ns == BEST_AVAILABLE_NS else None


def _numbers(field: str, count: int) -> list[int | None]:
    parts = field.split(",")
    if len(parts) != count or any(
        part and not (part.isascii() and part.isdigit() and len(part) <= 20) for part in parts
    ):
        raise HubWireError(f"quality of service has {field[:80]!r} where {count} numbers belong")
    return [int(part) if part else None for part in parts]


def _policy(kind: type[_Policy], value: int | None, default: _Policy) -> _Policy:
    return kind(value) if value in set(kind) else default
