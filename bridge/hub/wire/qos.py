"""Quality of service of an endpoint, and its text in rmw_zenoh's liveliness tokens.

The enumerations carry rmw's own numbers (rmw/types.h). The text is
``<reliability>:<durability>:<history>,<depth>:<deadline s>,<ns>:<lifespan s>,<ns>:<liveliness>,<s>,<ns>``;
a field equal to rmw_zenoh's default profile is left empty.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import TypeVar

from bridge.hub.errors import HubWireError

DEFAULT_DEPTH = 42
"""History depth of rmw_zenoh's default profile (rmw_zenoh_cpp, qos.cpp)."""

_NS = 1_000_000_000
_INFINITE = (9_223_372_036, 854_775_807)
_MAX_DEPTH = 2**31 - 1
_Policy = TypeVar("_Policy", bound=IntEnum)


class Reliability(IntEnum):
    """Whether samples are sent again when lost."""

    RELIABLE = 1
    BEST_EFFORT = 2


class Durability(IntEnum):
    """Whether a late joiner is given past samples."""

    TRANSIENT_LOCAL = 1
    VOLATILE = 2


class History(IntEnum):
    """Which samples are kept."""

    KEEP_LAST = 1
    KEEP_ALL = 2


@dataclass(frozen=True, slots=True)
class Qos:
    """Quality of service of one endpoint; deadlines and lifespans are in nanoseconds, None is infinite."""

    reliability: Reliability = Reliability.RELIABLE
    durability: Durability = Durability.VOLATILE
    history: History = History.KEEP_LAST
    depth: int = 10
    deadline_ns: int | None = None
    lifespan_ns: int | None = None

    @property
    def latched(self) -> bool:
        """Whether late joiners get past samples (ROS 1 calls it latching)."""
        return self.durability is Durability.TRANSIENT_LOCAL


LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
"""What ROS 1 calls latched: late joiners get the last sample."""


def encode_qos(qos: Qos) -> str:
    """The text of a quality of service in a liveliness token."""
    reliability = "" if qos.reliability is Reliability.RELIABLE else str(int(qos.reliability))
    durability = "" if qos.durability is Durability.VOLATILE else str(int(qos.durability))
    history = "" if qos.history is History.KEEP_LAST else str(int(qos.history))
    depth = "" if qos.depth == DEFAULT_DEPTH else str(qos.depth)
    times = f"{_encode_time(qos.deadline_ns)}:{_encode_time(qos.lifespan_ns)}"
    return f"{reliability}:{durability}:{history},{depth}:{times}:,,"


def decode_qos(text: str) -> Qos:
    """Read the text of a token; raises `HubWireError`.

    Where rmw would ask the middleware (``0``, system default) rmw_zenoh's default is taken. A deadline or lifespan of
    zero is rmw's word for unspecified, thus infinite. The liveliness policy is checked and not kept: a token's own
    life shows it.
    """
    fields = text.split(":")
    if len(fields) != 6:
        raise HubWireError(f"quality of service {text[:80]!r} has {len(fields)} fields instead of 6")
    history, depth = _numbers(fields[2], 2)
    deadline = _numbers(fields[3], 2)
    lifespan = _numbers(fields[4], 2)
    _numbers(fields[5], 3)
    if depth is not None and depth > _MAX_DEPTH:
        raise HubWireError(f"history depth {depth} is out of range")
    return Qos(
        _policy(Reliability, _numbers(fields[0], 1)[0], Reliability.RELIABLE),
        _policy(Durability, _numbers(fields[1], 1)[0], Durability.VOLATILE),
        _policy(History, history, History.KEEP_LAST),
        DEFAULT_DEPTH if depth is None else depth,
        _decode_time(*deadline),
        _decode_time(*lifespan),
    )


def _encode_time(time_ns: int | None) -> str:
    if time_ns is None:
        return ","
    parts = divmod(time_ns, _NS)
    return ",".join("" if part == default else str(part) for part, default in zip(parts, _INFINITE, strict=True))


def _decode_time(seconds: int | None, nanoseconds: int | None) -> int | None:
    pair = (_INFINITE[0] if seconds is None else seconds, _INFINITE[1] if nanoseconds is None else nanoseconds)
    time_ns = pair[0] * _NS + pair[1]
    return time_ns if 0 < time_ns < _INFINITE[0] * _NS else None


def _numbers(field: str, count: int) -> list[int | None]:
    parts = field.split(",")
    if len(parts) != count or any(
        part and not (part.isascii() and part.isdigit() and len(part) < 20) for part in parts
    ):
        raise HubWireError(f"quality of service has {field[:80]!r} where {count} numbers belong")
    return [int(part) if part else None for part in parts]


def _policy(kind: type[_Policy], value: int | None, default: _Policy) -> _Policy:
    if not value:
        return default
    try:
        return kind(value)
    except ValueError:
        raise HubWireError(
            f"quality of service names {kind.__name__.lower()} policy {value}, which is unknown"
        ) from None
