"""Velocities as ``Twist`` or ``TwistStamped``: which of them a side's own nodes subscribe to, and their conversion.

A route to the side exists only once the hub has a publisher, and it subscribes on the hub with or without a subscriber
on the side. So the hub's endpoints do not show what a base expects, and each side announces it separately.
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
"""Bytes of CDR's encapsulation header, and how it begins."""

_STAMP = struct.Struct("<iII")
"""Seconds and nanoseconds of the stamp, and the length of the frame's name with its zero."""

_FRAME = b"base_link\0"
_VELOCITY = 48
"""Bytes of a velocity: six numbers of 8 bytes, aligned to these."""


def subscribed_velocities(
    edge: Edge, endpoints: Sequence[Endpoint], gate: ExitGate, rules: RuleSet
) -> frozenset[tuple[str, str]]:
    """Return hub topic and type of each topic of velocities that reaches a native subscription on the side.

    A topic that a rule renames by a regular expression is not recognized, nor one that loses what a wildcard matched.
    """
    return frozenset(
        (hub_topic, type_name)
        for side_topic, type_name in native_velocities(endpoints)
        for hub_topic in _hub_topics(edge, side_topic, rules)
        if _leads_to(edge, gate, hub_topic, type_name) == side_topic
    )


def native_velocities(endpoints: Sequence[Endpoint]) -> frozenset[tuple[str, str]]:
    """Return the side's topics of velocities that its own nodes subscribe to, with their ROS 2 types."""
    native = (e for e in endpoints if e.kind is Kind.SUBSCRIPTION and e.made_by is MadeBy.NATIVE)
    velocities = ((e.topic, ros2_name("topic", e.type)) for e in native)
    return frozenset(velocity for velocity in velocities if velocity[1] in VELOCITIES)


def preferred(side_topic: str, side_type: str, native: Collection[tuple[str, str]]) -> str:
    """Return the type of velocities that the side's nodes subscribe to instead of this one, "" if they do not.

    A side has one type for each topic, so a route of this type would keep out the other one. ROS 1's master would even
    report this type for the topic, and the nodes' own one would no longer be known.
    """
    type_name = ros2_name("topic", side_type)
    if type_name not in VELOCITIES or (side_topic, type_name) in native:
        return ""
    return next((other for other in VELOCITIES if (side_topic, other) in native), "")


def _hub_topics(edge: Edge, side_topic: str, rules: RuleSet) -> Iterator[str]:
    """Yield the topics on the hub that may lead to a topic of the side: its own name, and those that rules rename."""
    renamed = (
        rename_glob(match, rule.topic)
        for rule in rules.section.rules
        if rule.topic and rule.rename and (match := glob_regex(rule.rename).fullmatch(side_topic))
    )
    for name in (edge.hub_name(side_topic), *renamed):
        with suppress(HubWireError):  # a wildcard that nothing fills leaves an empty part
            yield check_topic(name)


def _leads_to(edge: Edge, gate: ExitGate, hub_topic: str, type_name: str) -> str:
    """Return the side's topic on which messages of the hub's own programs arrive, "" if they do not cross."""
    policy = gate.decide("topic", None, hub_topic, type_name)
    if _other_type(type_name, policy):
        return ""
    name = policy.name if policy.name != hub_topic else edge.side_name(hub_topic)
    return name if policy.allowed and not edge.why_not(name, type_name) else ""


def velocity_to_side(edge: Edge, type_name: str, type_hash: str, policy: RoutePolicy) -> Conversion:
    """Return the conversion of a hub type to the side's, as `Edge.from_hub`, with the rule's form of velocities."""
    conversion, other = edge.from_hub(type_name, type_hash), _other_type(type_name, policy)
    if not other:
        return conversion
    onward = edge.from_hub(other, "")
    return Conversion(conversion.source, onward.target, _chain(_rewrite(other, edge.clock), onward.convert))


def velocity_to_hub(edge: Edge, endpoint: Endpoint, policy: RoutePolicy) -> Conversion:
    """Return the conversion of an endpoint's type to the hub, as `Edge.to_hub`, with the rule's form of velocities."""
    conversion = edge.to_hub(endpoint)
    other = _other_type(conversion.target.name, policy)
    if not other:
        return conversion
    target, convert = edge.from_hub(other, "").source, _rewrite(other, edge.clock)
    return replace(conversion, target=target, convert=_chain(conversion.convert, convert))


def _other_type(type_name: str, policy: RoutePolicy) -> str:
    """Return the type that a rule converts velocities of this type to, "" if it leaves them as they are."""
    if policy.stamped is None or type_name not in VELOCITIES:
        return ""
    wanted = TWIST_STAMPED if policy.stamped else TWIST
    return wanted if wanted != type_name else ""


def _chain(first: Convert | None, then: Convert | None) -> Convert | None:
    if first is None or then is None:
        return first or then
    return lambda payload: then(first(payload))


def _rewrite(type_name: str, clock: RunClock) -> Convert:
    """Return the function that converts a message (CDR) of the other type to this one."""
    return unstamped if type_name == TWIST else lambda cdr: with_stamp(cdr, clock)


def with_stamp(cdr: bytes, clock: RunClock) -> bytes:
    """Return a ``Twist`` (CDR, little-endian) as a ``TwistStamped`` of now; raises `ConversionError`."""
    begin, stamp = _HEADER, clock.stamp()
    _check(cdr, begin)
    head = _STAMP.pack(stamp["sec"], stamp["nanosec"], len(_FRAME)) + _FRAME
    return cdr[:begin] + head + bytes(-len(head) % 8) + cdr[begin : begin + _VELOCITY]


def unstamped(cdr: bytes) -> bytes:
    """Return a ``TwistStamped`` (CDR, little-endian) as a ``Twist``; raises `ConversionError`."""
    _check(cdr, _HEADER + _STAMP.size)
    length = _STAMP.unpack_from(cdr, _HEADER)[2]
    begin = _HEADER + (_STAMP.size + length + 7) // 8 * 8
    _check(cdr, begin)
    return cdr[:_HEADER] + cdr[begin : begin + _VELOCITY]


def _check(cdr: bytes, begin: int) -> None:
    """Reject a message without a velocity at this offset."""
    if cdr[:2] != _LITTLE_ENDIAN or len(cdr) < begin + _VELOCITY:
        raise ConversionError(f"not a velocity in little-endian CDR: {len(cdr)} bytes, beginning with {cdr[:4].hex()}")
