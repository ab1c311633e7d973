"""Velocities as ``Twist`` or ``TwistStamped``: which type a side's own nodes subscribe to, and the conversions.

A route to the side exists only while the hub has a publisher, and it subscribes on the hub with or without a subscriber
on the side. So the hub's endpoints do not show which type a base expects, and each side announces that separately.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

from bridge.clock import RunClock
from bridge.hub.errors import HubWireError
from bridge.hub.wire.keys import check_topic
from bridge.messages.errors import ConversionError
from bridge.messages.transcode.conversion import Conversion
from bridge.messages.velocities import TWIST, TWIST_STAMPED, VELOCITIES
from bridge.routing.edge import Edge, Endpoint, Kind, MadeBy
from bridge.routing.gates import ExitGate, ros2_name
from bridge.routing.rules import RoutePolicy, RuleSet, glob_regex, rename_glob

Convert = Callable[[bytes], bytes]

_HEADER, _LITTLE_ENDIAN = 4, b"\0\1"
"""Size of CDR's encapsulation header in bytes, and its first bytes."""

_STAMP = struct.Struct("<iII")
"""Seconds and nanoseconds of the stamp, and the length of the frame's name including its NUL."""

_FRAME = b"base_link\0"
_VELOCITY = 48
"""Size of a velocity in bytes: six numbers of 8 bytes, aligned to 8 bytes."""


def subscribed_velocities(
    edge: Edge, endpoints: Sequence[Endpoint], gate: ExitGate, rules: RuleSet
) -> frozenset[tuple[str, str]]:
    """Return hub topic and type of each velocity topic that reaches a native subscription on the side.

    A topic is not recognized if a rule renames it by a regular expression, or drops what a wildcard matched.
    """
    return frozenset(
        (hub_topic, type_name)
        for side_topic, type_name in native_velocities(endpoints)
        for hub_topic in _hub_topics(edge, side_topic, rules)
        if _leads_to(edge, gate, hub_topic, type_name) == side_topic
    )


def native_velocities(endpoints: Sequence[Endpoint]) -> frozenset[tuple[str, str]]:
    """Return the side's velocity topics to which its own nodes subscribe, with their ROS 2 types."""
    native = (e for e in endpoints if e.kind is Kind.SUBSCRIPTION and e.made_by is MadeBy.NATIVE)
    velocities = ((e.topic, ros2_name("topic", e.type)) for e in native)
    return frozenset(velocity for velocity in velocities if velocity[1] in VELOCITIES)


def preferred_type(side_topic: str, side_type: str, native: Collection[tuple[str, str]]) -> str:
    """Return the velocity type to which the side's nodes subscribe instead of ``side_type``, "" if there is none.

    A side has one type per topic, so a route of this type would exclude the other. ROS 1's master would even report
    this type for the topic, and the type that the nodes use would no longer be known.
    """
    type_name = ros2_name("topic", side_type)
    if type_name not in VELOCITIES or (side_topic, type_name) in native:
        return ""
    return next((other for other in VELOCITIES if (side_topic, other) in native), "")


def _hub_topics(edge: Edge, side_topic: str, rules: RuleSet) -> Iterator[str]:
    """Yield the hub topics that may lead to a topic of the side: by its own name, or because a rule renames them."""
    renamed = (
        rename_glob(match, rule.topic)
        for rule in rules.section.rules
        if rule.topic and rule.rename and (match := glob_regex(rule.rename).fullmatch(side_topic))
    )
    for name in (edge.hub_name(side_topic), *renamed):
        with suppress(HubWireError):  # a wildcard that matched nothing leaves an empty part
            yield check_topic(name)


def _leads_to(edge: Edge, gate: ExitGate, hub_topic: str, type_name: str) -> str:
    """Return the side's topic on which messages from the hub's own programs arrive, "" if they are not bridged."""
    policy = gate.decide("topic", None, hub_topic, type_name)
    if _other_type(type_name, policy):
        return ""
    name = policy.name if policy.name != hub_topic else edge.side_name(hub_topic)
    return name if policy.allowed and not edge.why_not(name, type_name) else ""


def velocity_to_side(edge: Edge, type_name: str, type_hash: str, policy: RoutePolicy) -> Conversion:
    """Return the conversion of a hub type to the side, like `Edge.from_hub`, but with the rule's velocity type."""
    conversion, other = edge.from_hub(type_name, type_hash), _other_type(type_name, policy)
    if not other:
        return conversion
    onward = edge.from_hub(other, "")
    return Conversion(conversion.source, onward.target, _chain(_rewrite(other, edge.clock), onward.convert))


def velocity_to_hub(edge: Edge, endpoint: Endpoint, policy: RoutePolicy) -> Conversion:
    """Return the conversion of an endpoint's type to the hub, like `Edge.to_hub`, but with the rule's velocity type."""
    conversion = edge.to_hub(endpoint)
    other = _other_type(conversion.target.name, policy)
    if not other:
        return conversion
    target, convert = edge.from_hub(other, "").source, _rewrite(other, edge.clock)
    return replace(conversion, target=target, convert=_chain(conversion.convert, convert))


def _other_type(type_name: str, policy: RoutePolicy) -> str:
    """Return the type to which a rule converts velocities of this type, "" if it does not convert them."""
    if policy.stamped is None or type_name not in VELOCITIES:
        return ""
    wanted = TWIST_STAMPED if policy.stamped else TWIST
    return wanted if wanted != type_name else ""


def _chain(first: Convert | None, then: Convert | None) -> Convert | None:
    if first is None or then is None:
        return first or then
    return lambda payload: then(first(payload))


def _rewrite(type_name: str, clock: RunClock) -> Convert:
    """Return the function that converts a velocity (CDR) of the other type to the type ``type_name``."""
    return unstamped if type_name == TWIST else lambda cdr: with_stamp(cdr, clock)


def with_stamp(cdr: bytes, clock: RunClock) -> bytes:
    """Convert a ``Twist`` (CDR, little-endian) to a ``TwistStamped`` of now; raises `ConversionError`."""
    begin, stamp = _HEADER, clock.stamp()
    _check(cdr, begin)
    head = _STAMP.pack(stamp["sec"], stamp["nanosec"], len(_FRAME)) + _FRAME
    return cdr[:begin] + head + bytes(-len(head) % 8) + cdr[begin : begin + _VELOCITY]


def unstamped(cdr: bytes) -> bytes:
    """Convert a ``TwistStamped`` (CDR, little-endian) to a ``Twist``; raises `ConversionError`."""
    _check(cdr, _HEADER + _STAMP.size)
    length = _STAMP.unpack_from(cdr, _HEADER)[2]
    begin = _HEADER + (_STAMP.size + length + 7) // 8 * 8
    _check(cdr, begin)
    return cdr[:_HEADER] + cdr[begin : begin + _VELOCITY]


def _check(cdr: bytes, begin: int) -> None:
    """Raise `ConversionError` if a message has no velocity at this offset."""
    if cdr[:2] != _LITTLE_ENDIAN or len(cdr) < begin + _VELOCITY:
        raise ConversionError(f"not a velocity in little-endian CDR: {len(cdr)} bytes, beginning with {cdr[:4].hex()}")
