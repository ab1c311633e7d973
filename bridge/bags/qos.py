"""QoS profiles as rosbag2 writes them: YAML with policies as rmw's numbers (to version 8) or as names (from 9)."""

from __future__ import annotations

import logging
from enum import IntEnum
from typing import Any, TypeVar

from bridge.hub.wire.qos import Durability, History, Qos, Reliability

_log = logging.getLogger(__name__)

_LONGEST = 1 << 16
_DEPTH = 1_000_000
_UNSET = frozenset({0, 3, "system_default", "unknown"})
"""Values that leave a policy to the middleware, and rmw's UNKNOWN, which Fast DDS reports for each history."""

_MAX_UNKNOWN = 100
_unknown: set[tuple[str, str]] = set()
"""Unknown values that this process has reported, by policy; at most `_MAX_UNKNOWN`."""

_Policy = TypeVar("_Policy", bound=IntEnum)


def parse_qos(text: str) -> tuple[Qos, ...]:
    """Return the different profiles that a topic's publishers offered; none if the text is unreadable.

    A policy of BEST_AVAILABLE, which rosbag2 records on rmw_zenoh, is resolved as rmw does for a publisher. A value
    that rmw does not define becomes the default, with one warning for each value.
    """
    return tuple(dict.fromkeys(map(_qos, _profiles(text))))


def merged_qos(offered: tuple[Qos, ...]) -> Qos:
    """Return one profile for all publishers of a topic; without publishers, the default one.

    It is transient local if any offer is, best effort if all offers are, and has the greatest depth of all offers.
    """
    if not offered:
        return Qos()
    durable = any(qos.durability is Durability.TRANSIENT_LOCAL for qos in offered)
    lossy = all(qos.reliability is Reliability.BEST_EFFORT for qos in offered)
    every = any(qos.history is History.KEEP_ALL for qos in offered)
    return Qos(
        Reliability.BEST_EFFORT if lossy else Reliability.RELIABLE,
        Durability.TRANSIENT_LOCAL if durable else Durability.VOLATILE,
        History.KEEP_ALL if every else History.KEEP_LAST,
        max(qos.depth for qos in offered),
    )


def qos_yaml(offered: tuple[Qos, ...]) -> str:
    """Return QoS profiles as rosbag2 writes them from version 9 of its metadata: YAML with the names of policies."""
    return "\n".join(_profile(qos) for qos in offered)


def _profile(qos: Qos) -> str:
    return "\n".join(
        (
            f"- history: {qos.history.name.lower()}",
            f"  depth: {qos.depth}",
            f"  reliability: {qos.reliability.name.lower()}",
            f"  durability: {qos.durability.name.lower()}",
            f"  deadline: {_yaml_time(qos.deadline_ns)}",
            f"  lifespan: {_yaml_time(qos.lifespan_ns)}",
            "  liveliness: automatic",
            f"  liveliness_lease_duration: {_yaml_time(None)}",
            "  avoid_ros_namespace_conventions: false",
        )
    )


def _yaml_time(nanoseconds: int | None) -> str:
    return "{{sec: {}, nsec: {}}}".format(*rosbag2_time(nanoseconds))


def rosbag2_time(nanoseconds: int | None) -> tuple[int, int]:
    """Return a duration as seconds and nanoseconds; None means infinite."""
    return (9_223_372_036, 854_775_807) if nanoseconds is None else divmod(nanoseconds, 1_000_000_000)


def load_yaml(text: str) -> Any:
    """Parse a YAML document of plain values, with libyaml if it is installed; raises `yaml.YAMLError`."""
    import yaml

    return yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))  # noqa: S506 - both are safe


def _profiles(text: str) -> list[dict[str, Any]]:
    import yaml

    if not text or len(text) > _LONGEST:
        return []
    try:
        profiles = load_yaml(text)
    except (yaml.YAMLError, ValueError, RecursionError):
        return []
    return [profile for profile in profiles if isinstance(profile, dict)] if isinstance(profiles, list) else []


def _qos(profile: dict[str, Any]) -> Qos:
    depth = profile.get("depth")
    reliability = _policy(profile, "reliability", Reliability.RELIABLE)
    durability = _policy(profile, "durability", Durability.VOLATILE)
    return Qos(
        Reliability.RELIABLE if reliability is Reliability.BEST_AVAILABLE else reliability,
        Durability.TRANSIENT_LOCAL if durability is Durability.BEST_AVAILABLE else durability,
        _policy(profile, "history", History.KEEP_LAST),
        depth if isinstance(depth, int) and 0 < depth <= _DEPTH else 10,
        _nanoseconds(profile.get("deadline")),
        _nanoseconds(profile.get("lifespan")),
    )


def _nanoseconds(value: Any) -> int | None:
    """Return a finite duration; None for infinite, unspecified (0) and BEST_AVAILABLE (rmw/types.h)."""
    if not isinstance(value, dict):
        return None
    sec, nsec = value.get("sec"), value.get("nsec")
    if not isinstance(sec, int) or not isinstance(nsec, int) or not (0, 0) < (sec, nsec) < (rosbag2_time(None)[0], 0):
        return None
    return sec * 1_000_000_000 + nsec


def _policy(profile: dict[str, Any], name: str, default: _Policy) -> _Policy:
    value = profile.get(name)
    kind = type(default)
    if isinstance(value, str) and value.upper() in kind.__members__:
        return kind[value.upper()]
    if isinstance(value, int) and value in set(kind):
        return kind(value)
    if value is not None and not (isinstance(value, int | str) and value in _UNSET):
        # a list in YAML may contain itself a million times over
        text = repr(value)[:40] if isinstance(value, int | float | str) else f"of type {type(value).__name__}"
        _warn_of_unknown(name, text, default.name.lower())
    return default


def _warn_of_unknown(name: str, value: str, default: str) -> None:
    if (name, value) not in _unknown and len(_unknown) < _MAX_UNKNOWN:
        _unknown.add((name, value))
        _log.warning(
            "QoS of a recorded topic: %s policy %s is unknown, so rmw's default (%s) is used", name, value, default
        )
