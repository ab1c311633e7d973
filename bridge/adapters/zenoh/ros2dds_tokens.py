"""Liveliness tokens of zenoh-plugin-ros2dds, by which its bridges announce topics, services and actions.

``@/<zid>/@ros2_lv`` means that a bridge is alive. ``@/<zid>/@ros2_lv/MP/<key>/<type>/<qos>`` is a topic that its ROS 2
nodes publish, ``MS`` a topic to which they subscribe; in key and type a slash is written ``§``. The QoS is ``<K if
keyed>:<reliability>:<durability>:<history>,<depth>[:<user data>]`` with DDS's numbers; an empty field is DDS's default,
and the user data is ROS 2's ``typehash=RIHS01_<hex>;`` (since Iron). ``SS/<key>/<type>`` is a service that its nodes
serve, ``SC`` a service that they call; neither has a hash. ``AS`` (served) and ``AC`` (called) are a whole action,
whose services and topics have no separate tokens. Source: zenoh-plugin-ros2dds, ``src/liveliness_mgt.rs``,
``ros2_utils.rs``, ``route_action_srv.rs`` and ``route_action_cli.rs``, of August 2026.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from bridge.hub.errors import HubWireError
from bridge.hub.wire.qos import Durability, History, Qos, Reliability
from bridge.messages.actions import split
from bridge.messages.definitions.parts import CANCEL_GOAL
from bridge.routing.edge import Kind

ALL = "@/*/@ros2_lv/**"
ACTION_PARTS = 5
"""Three services and two topics."""
_SLASH = "§"
_TOPICS = {"MP": Kind.PUBLISHER, "MS": Kind.SUBSCRIPTION}
_SERVICES = {"SS": Kind.SERVER, "SC": Kind.CLIENT}
_ACTIONS = {"AS": (Kind.SERVER, Kind.PUBLISHER), "AC": (Kind.CLIENT, Kind.SUBSCRIPTION)}
_LETTERS = {kind: letters for letters, kind in (_TOPICS | _SERVICES).items()}
_ACTION_LETTERS = {ends[0]: letters for letters, ends in _ACTIONS.items()}
_MIDDLES = {"M": "msg", "S": "srv", "A": "action"}
_MAX_TOKEN = 4096
_KEY = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_][A-Za-z0-9_]*)*")
_TYPE = re.compile(r"[A-Za-z]\w*/(msg|srv|action)/[A-Za-z]\w*", re.ASCII)
_HASH = re.compile(r"(?:^|;)typehash=(RIHS[0-9]{2}_[0-9a-f]{1,128})(?:;|$)")

# DDS's numbers (ddsi, dds_reliability_kind and so on)
_RELIABLE, _TRANSIENT_LOCAL, _KEEP_ALL = 1, 1, 1


_FEEDBACK = Qos(Reliability.RELIABLE, depth=10)
_STATUS = Qos(Reliability.RELIABLE, Durability.TRANSIENT_LOCAL, depth=1)


@dataclass(frozen=True, slots=True)
class Token:
    """A topic or service of a bridge; ``key`` is its zenoh key, ``type_hash`` is "" if not announced."""

    zid: str
    kind: Kind
    key: str
    type: str
    type_hash: str
    qos: Qos


def alive_key(zid: str) -> str:
    """Return the key of the token that shows that a bridge is alive."""
    return f"@/{zid}/@ros2_lv"


def token_key(token: Token) -> str:
    """Return the key of the token of a topic or a service."""
    head = f"{alive_key(token.zid)}/{_LETTERS[token.kind]}/{_escape(token.key)}/{_escape(token.type)}"
    return head if token.kind in _SERVICES.values() else f"{head}/{_qos_text(token.qos, token.type_hash)}"


def action_key(part: Token) -> str:
    """Return the key of an action's token, given the token of its send_goal or get_result service."""
    action, type_name = action_of(part.key), part.type.rpartition("_")[0]
    return f"{alive_key(part.zid)}/{_ACTION_LETTERS[part.kind]}/{_escape(action)}/{_escape(type_name)}"


def action_end(kind: Kind) -> Kind:
    """Return the end of an action that has parts of this kind: server or client."""
    return next(ends[0] for ends in _ACTIONS.values() if kind in ends)


def action_of(key: str) -> str:
    """Return the key of the action that a topic or service belongs to; "" if it belongs to none."""
    return split(key)[0]


def zid_of(key: str) -> str:
    """Return the id of the bridge that declared a token."""
    return key.split("/", 2)[1]


def parse(key: str) -> tuple[Token, ...]:
    """Return the endpoints in a token: one, an action's five, or none for a bridge; raises `HubWireError`."""
    parts = key.split("/", 7)
    if len(key) > _MAX_TOKEN or parts[0] != "@" or len(parts) < 3 or parts[2] != "@ros2_lv":
        raise HubWireError("not a token of the ros2dds plugin")
    if len(parts) == 3:
        return ()
    letters = parts[3]
    if letters not in (_TOPICS | _SERVICES | _ACTIONS) or len(parts) != (7 if letters in _TOPICS else 6):
        raise HubWireError(f"token of kind {letters[:20]!r} with {len(parts)} parts")
    zid, name, type_name = parts[1], _unescape(parts[4]), _unescape(parts[5])
    if not _KEY.fullmatch(name):
        raise HubWireError(f"{name[:80]!r} is not a ROS 2 name")
    match = _TYPE.fullmatch(type_name)
    if match is None or match.group(1) != _MIDDLES[letters[0]]:
        raise HubWireError(f"{type_name[:80]!r} is not a ROS 2 {_MIDDLES[letters[0]]} type")
    if letters in _ACTIONS:
        return _endpoints(zid, *_ACTIONS[letters], name, type_name)
    if letters in _SERVICES:
        return (Token(zid, _SERVICES[letters], name, type_name, "", Qos()),)
    qos, type_hash = _read_qos(parts[6], _TOPICS[letters])
    return (Token(zid, _TOPICS[letters], name, type_name, type_hash, qos),)


def _endpoints(zid: str, service: Kind, topic: Kind, name: str, type_name: str) -> tuple[Token, ...]:
    """Return the services and topics of an action, with the plugin's QoS."""
    return tuple(
        Token(zid, kind, f"{name}/_action/{part}", of_type, "", qos)
        for kind, part, of_type, qos in (
            (service, "send_goal", f"{type_name}_SendGoal", Qos()),
            (service, "cancel_goal", CANCEL_GOAL, Qos()),
            (service, "get_result", f"{type_name}_GetResult", Qos()),
            (topic, "feedback", f"{type_name}_FeedbackMessage", _FEEDBACK),
            (topic, "status", "action_msgs/msg/GoalStatusArray", _STATUS),
        )
    )


def _escape(name: str) -> str:
    return name.replace("/", _SLASH)


def _unescape(chunk: str) -> str:
    return chunk.replace(_SLASH, "/")


def _qos_text(qos: Qos, type_hash: str) -> str:
    reliability = int(qos.reliability is Reliability.RELIABLE)
    durability = int(qos.latched)
    history = int(qos.history is History.KEEP_ALL)
    user_data = f":typehash={type_hash};" if type_hash else ""
    return f":{reliability}:{durability}:{history},{qos.depth}{user_data}"


def _read_qos(text: str, kind: Kind) -> tuple[Qos, str]:
    fields = text.split(":", 4)
    if len(fields) < 4:
        raise HubWireError(f"QoS {text[:80]!r} has {len(fields)} fields instead of 4 or 5")
    history, comma, depth = fields[3].partition(",")
    if fields[3] and not comma:
        raise HubWireError(f"history {fields[3][:40]!r} is not of the form kind,depth")
    # DDS's defaults: a writer is reliable, a reader is not
    reliable = _number(fields[1], int(kind is Kind.PUBLISHER)) == _RELIABLE
    latched = _number(fields[2], 0) >= _TRANSIENT_LOCAL
    qos = Qos(
        Reliability.RELIABLE if reliable else Reliability.BEST_EFFORT,
        Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE,
        History.KEEP_ALL if _number(history, 0) == _KEEP_ALL else History.KEEP_LAST,
        max(_number(depth, 1), 1),
    )
    match = _HASH.search(fields[4]) if len(fields) > 4 else None
    return qos, match.group(1) if match else ""


def _number(text: str, default: int) -> int:
    if not text:
        return default
    try:
        value = int(text)
    except ValueError:
        value = -2
    if not (-1 <= value < 2**31) or len(text) > 11:
        raise HubWireError(f"QoS has {text[:40]!r} instead of a number")
    return value
