"""Liveliness tokens of zenoh-plugin-ros2dds, by which bridges of its kind tell each other their topics.

``@/<zid>/@ros2_lv`` says that a bridge lives. ``@/<zid>/@ros2_lv/MP/<key>/<type>/<qos>`` is a topic that its ROS 2
nodes publish, ``MS`` one that they subscribe to; in key and type a slash is written ``§``. The QoS is ``<K where
keyed>:<reliability>:<durability>:<history>,<depth>[:<user data>]`` with DDS's numbers, an empty field is DDS's
default, and the user data is ROS 2's own ``typehash=RIHS01_<hex>;`` (since Iron). Read in zenoh-plugin-ros2dds,
``src/liveliness_mgt.rs``, of August 2026.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from bridge.adapters.base import Kind
from bridge.hub.errors import WireError
from bridge.hub.qos import Durability, History, Qos, Reliability

ALL = "@/*/@ros2_lv/**"
_SLASH = "§"
_LETTERS = {Kind.PUBLISHER: "MP", Kind.SUBSCRIPTION: "MS"}
_KINDS = {letters: kind for kind, letters in _LETTERS.items()}
_OTHER = frozenset({"SS", "SC", "AS", "AC"})
_MAX_TOKEN = 4096
_KEY = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_][A-Za-z0-9_]*)*")
_TYPE = re.compile(r"[A-Za-z]\w*/msg/[A-Za-z]\w*", re.ASCII)
_HASH = re.compile(r"(?:^|;)typehash=(RIHS[0-9]{2}_[0-9a-f]{1,128})(?:;|$)")

# DDS's numbers (ddsi, dds_reliability_kind and so on)
_RELIABLE, _TRANSIENT_LOCAL, _KEEP_ALL = 1, 1, 1


@dataclass(frozen=True, slots=True)
class Token:
    """A topic of a bridge; ``key`` is the zenoh key of its samples, ``type_hash`` "" where it is not told."""

    zid: str
    kind: Kind
    key: str
    type: str
    type_hash: str
    qos: Qos


def alive_key(zid: str) -> str:
    """The token of a living bridge."""
    return f"@/{zid}/@ros2_lv"


def token_key(token: Token) -> str:
    """The key of a topic's token."""
    head = f"{alive_key(token.zid)}/{_LETTERS[token.kind]}"
    return f"{head}/{_escape(token.key)}/{_escape(token.type)}/{_qos_text(token.qos, token.type_hash)}"


def zid_of(key: str) -> str:
    """The bridge that a token is of."""
    return key.split("/", 2)[1]


def parse(key: str) -> Token | None:
    """Read a token; None for one that is not about a topic (services, actions, the bridge itself).

    Raises:
        WireError: it is none of the plugin's, or its key or type is no name of ROS 2.
    """
    parts = key.split("/", 7)
    if len(key) > _MAX_TOKEN or parts[0] != "@" or len(parts) < 3 or parts[2] != "@ros2_lv":
        msg = "no token of the ros2dds plugin"
        raise WireError(msg)
    if len(parts) == 3 or parts[3] in _OTHER:
        return None
    kind = _KINDS.get(parts[3])
    if kind is None or len(parts) != 7:
        msg = f"token of {len(parts)} parts of the kind {parts[3][:20]!r}"
        raise WireError(msg)
    topic, type_name = _unescape(parts[4]), _unescape(parts[5])
    if not _KEY.fullmatch(topic):
        msg = f"{topic[:80]!r} is no ROS 2 name"
        raise WireError(msg)
    if not _TYPE.fullmatch(type_name):
        msg = f"{type_name[:80]!r} is no ROS 2 message type"
        raise WireError(msg)
    qos, type_hash = _read_qos(parts[6], kind)
    return Token(parts[1], kind, topic, type_name, type_hash, qos)


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
        msg = f"quality of service {text[:80]!r} has {len(fields)} fields instead of 4 or 5"
        raise WireError(msg)
    history, comma, depth = fields[3].partition(",")
    if fields[3] and not comma:
        msg = f"history {fields[3][:40]!r} is not of the form kind,depth"
        raise WireError(msg)
    # DDS's defaults: a writer is reliable, a reader is not
    reliable = _number(fields[1], int(kind is Kind.PUBLISHER)) == _RELIABLE
    latched = _number(fields[2], 0) >= _TRANSIENT_LOCAL
    qos = Qos(
        Reliability.RELIABLE if reliable else Reliability.BEST_EFFORT,
        Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE,
        History.KEEP_ALL if _number(history, 0) == _KEEP_ALL else History.KEEP_LAST,
        max(_number(depth, 1), 1),
    )
    found = _HASH.search(fields[4]) if len(fields) > 4 else None
    return qos, found.group(1) if found else ""


def _number(text: str, default: int) -> int:
    if not text:
        return default
    try:
        value = int(text)
    except ValueError:
        value = -2
    if not (-1 <= value < 2**31) or len(text) > 11:
        msg = f"quality of service has {text[:40]!r} where a number belongs"
        raise WireError(msg)
    return value
