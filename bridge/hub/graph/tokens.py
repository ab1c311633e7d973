"""Liveliness tokens, with which each participant on the hub announces itself.

A node's token is ``@ros2_lv/<domain>/<zid>/<node id>/<id>/NN/<enclave>/<namespace>/<node>``, an endpoint's token
has ``MP``, ``MS``, ``SS`` or ``SC`` instead of ``NN``, followed by ``/<name>/<type>/<hash>/<qos>`` (rmw_zenoh_cpp,
liveliness_utils.cpp). Later releases append parts: since rmw_zenoh_cpp 0.10.5 (Lyrical), ``/backends:cpu:`` for a
volatile endpoint whose type has buffers (`bridge.hub.wire.buffers`). Midspan ignores other parts, except that they are
included in the GID, which is the 128-bit XXH3 of the whole key, low half first.

Each of Midspan's workers also announces the foreign network that it bridges, its origin, with one token per session:
``@midspan/<domain>/origin/<zid>/<side>/<network>/<daemon>``, declared before any endpoint. An endpoint that is declared
while its session has an origin has the enclave ``/midspan``, so that a participant that sees the endpoint first knows
that an origin will follow. An active worker also announces the workers on its network, including itself, with one token
per worker: ``@midspan/<domain>/member/<zid>/<zid of the worker>``. These tokens show that two hubs share a network. For
each velocity topic to which its side's own nodes subscribe, it announces
``@midspan/<domain>/velocity/<zid>/<topic on the hub>/<type>``. A program with which a person drives announces
``@midspan/<domain>/driver/<zid>/<topic on the hub>/<person>`` meanwhile (`bridge.client.manual`). A worker that may
relay between nodes of the hub announces ``@midspan/<domain>/relay/<zid>/<time of its start>/<router>``, and a candidate
of the election for its direct links ``@midspan/<domain>/near/<zid>/<other zid>`` (`bridge.routing.relay.election`).
Before anything else, each Midspan session announces its protocol version:
``@midspan/<domain>/wire/<zid>/<version>/<Midspan's release>`` (`bridge.hub.wire.version`).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from urllib.parse import quote, unquote

import xxhash

from bridge import __version__
from bridge.hub.errors import HubWireError
from bridge.hub.wire.buffers import announces_backends
from bridge.hub.wire.keys import (
    ANY_HASH,
    check_topic,
    dds_type_name,
    demangle,
    hash_chunk,
    mangle,
    parse_hash_chunk,
    ros_type_name,
)
from bridge.hub.wire.qos import Qos, decode_qos, encode_qos
from bridge.hub.wire.version import WIRE


@dataclass(frozen=True, slots=True)
class Origin:
    """The foreign network that a worker's hub session bridges.

    A hub session without an origin token is a native participant on the hub (an rmw_zenoh node or a zenoh program).

    Attributes:
        side: ``ros1``, ``ros2``, ``yarp``, or a dialect of the zenoh adapter: ``zenoh_ros2dds``, ``zenoh_ros1``,
            ``zenoh_json``.
        network: identity of the network: the master's run id on ROS 1, the participant's marked GUID prefix (24 hex
            digits) on ROS 2, the dialect session's id on zenoh. The side's adapter compares it with its own network.
        daemon: identity of the daemon (its machine and name), for people.
    """

    side: str
    network: str
    daemon: str


ADMIN_SPACE = "@ros2_lv"
MIDSPAN_SPACE = "@midspan"
TAPS = "/_midspan/"
"""Prefix of hub topics on which an unbridged topic of a side is published on request; no side receives them."""

BRIDGE_ENCLAVE = "/midspan"
UNKNOWN_HASH = "RIHS01_" + "0" * 64
"""The hash in the token of a subscription that accepts any hash."""

_NODE = "NN"
_NODE_PARTS = 9
_ENDPOINT_PARTS = 13
_MAX_TOKEN = 4096


class EndpointKind(StrEnum):
    """The kinds of endpoints; the values are their names in status documents."""

    PUBLISHER = "publisher"
    SUBSCRIPTION = "subscription"
    SERVER = "server"
    CLIENT = "client"


_LETTERS = {
    EndpointKind.PUBLISHER: "MP",
    EndpointKind.SUBSCRIPTION: "MS",
    EndpointKind.SERVER: "SS",
    EndpointKind.CLIENT: "SC",
}
_KINDS = {letters: kind for kind, letters in _LETTERS.items()}


@dataclass(frozen=True, slots=True)
class NodeToken:
    """The liveliness token of a node, in rmw_zenoh's format."""

    domain: int
    zid: str
    node_id: str
    namespace: str
    node: str
    enclave: str = "/"


@dataclass(frozen=True, slots=True)
class EndpointToken:
    """The token of an endpoint; ``id`` is unique within the session, and ``type_hash`` may be `NO_HASH`."""

    owner: NodeToken
    id: str
    kind: EndpointKind
    topic: str
    type_name: str
    type_hash: str
    qos: Qos


@dataclass(frozen=True, slots=True)
class OriginToken:
    """The token of a session's origin."""

    domain: int
    zid: str
    origin: Origin


def node_key(token: NodeToken) -> str:
    """Return the key of a node's token."""
    return _token_prefix(token, token.node_id, _NODE)


def endpoint_key(token: EndpointToken) -> str:
    """Return the key of an endpoint's token."""
    any_hash = token.type_hash == ANY_HASH and token.kind is EndpointKind.SUBSCRIPTION
    type_hash = UNKNOWN_HASH if any_hash else hash_chunk(token.type_hash)
    return (
        f"{_token_prefix(token.owner, token.id, _LETTERS[token.kind])}/{mangle(check_topic(token.topic))}"
        f"/{dds_type_name(token.type_name)}/{type_hash}/{encode_qos(token.qos)}"
    )


def origin_key(token: OriginToken) -> str:
    """Return the key of an origin's token; its texts are percent-encoded."""
    parts = "/".join(_quote(part) for part in (token.origin.side, token.origin.network, token.origin.daemon))
    return f"{MIDSPAN_SPACE}/{token.domain}/origin/{token.zid}/{parts}"


def parse_token(key: str) -> NodeToken | EndpointToken:
    """Parse a token of the ROS 2 graph; raises `HubWireError`."""
    parts = _split(key, ADMIN_SPACE)
    if len(parts) < _NODE_PARTS:
        raise HubWireError(f"token has {len(parts)} parts instead of {_NODE_PARTS} or more")
    letters = parts[5]
    namespace, node = demangle(parts[7]), demangle(parts[8])
    owner = NodeToken(_domain(parts[1]), parts[2], parts[3], _absolute(namespace), node, _absolute(demangle(parts[6])))
    if letters == _NODE:
        return owner
    kind = _KINDS.get(letters)
    if kind is None:
        raise HubWireError(f"token of the unknown kind {letters[:20]!r}")
    if len(parts) < _ENDPOINT_PARTS:
        raise HubWireError(f"{kind}'s token has {len(parts)} parts instead of {_ENDPOINT_PARTS} or more")
    topic, type_hash = check_topic(_absolute(demangle(parts[9]))), parse_hash_chunk(parts[11])
    return EndpointToken(owner, parts[4], kind, topic, ros_type_name(parts[10]), type_hash, decode_qos(parts[12]))


def has_buffers(key: str) -> bool:
    """Return whether an endpoint's token, which `parse_token` accepts, announces buffer backends (Lyrical)."""
    return any(map(announces_backends, key.split("/")[_ENDPOINT_PARTS:]))


def qos_text(key: str) -> str:
    """Return the QoS part of an endpoint's token, which `parse_token` accepts."""
    return key.split("/", _ENDPOINT_PARTS)[_ENDPOINT_PARTS - 1]


def parse_origin(key: str) -> OriginToken:
    """Parse an origin's token; raises `HubWireError`."""
    parts = _split(key, MIDSPAN_SPACE)
    if len(parts) != 7 or parts[2] != "origin":
        raise HubWireError("not an origin token")
    side, network, daemon = (_unquote(part) for part in parts[4:])
    return OriginToken(_domain(parts[1]), parts[3], Origin(side, network, daemon))


def member_key(domain: int, zid: str, member: str) -> str:
    """Return the key of the token with which a session announces that ``member``'s worker is on the same network."""
    return f"{MIDSPAN_SPACE}/{domain}/member/{zid}/{_quote(member)}"


def parse_member(key: str) -> tuple[str, str]:
    """Parse a member's token: the announcing session, and the member's session; raises `HubWireError`."""
    parts = _split(key, MIDSPAN_SPACE)
    if len(parts) != 5 or parts[2] != "member":
        raise HubWireError("not a member token")
    return parts[3], _unquote(parts[4])


def velocity_key(domain: int, zid: str, topic: str, type_name: str) -> str:
    """Return the key of the token with which a session announces that its side subscribes to a velocity topic."""
    return f"{MIDSPAN_SPACE}/{domain}/velocity/{zid}/{_quote(topic)}/{_quote(type_name)}"


def parse_velocity(key: str) -> tuple[str, str, str]:
    """Parse a velocity's token: the announcing session, the topic and its type; raises `HubWireError`."""
    parts = _split(key, MIDSPAN_SPACE)
    if len(parts) != 6 or parts[2] != "velocity":
        raise HubWireError("not a velocity token")
    topic, type_name = check_topic(_unquote(parts[4])), _unquote(parts[5])
    dds_type_name(type_name)  # raises HubWireError for an invalid name
    return parts[3], topic, type_name


def driver_key(domain: int, zid: str, topic: str, who: str) -> str:
    """Return the key of the token with which a session announces that ``who`` drives manually on a velocity topic."""
    return f"{MIDSPAN_SPACE}/{domain}/driver/{zid}/{_quote(topic)}/{_quote(who)}"


def parse_driver(key: str) -> tuple[str, str, str]:
    """Parse a manual driver's token: the session, the velocity topic and who drives; raises `HubWireError`."""
    parts = _split(key, MIDSPAN_SPACE)
    if len(parts) != 6 or parts[2] != "driver":
        raise HubWireError("not a driver token")
    return parts[3], check_topic(_unquote(parts[4])), _unquote(parts[5])


def relay_key(domain: int, zid: str, since: int, router: str) -> str:
    """Return the key of a relay's token: its session, the time of its start (wall clock, ns), and its router."""
    return f"{MIDSPAN_SPACE}/{domain}/relay/{zid}/{since}/{_quote(router)}"


def parse_relay(key: str) -> tuple[str, int, str]:
    """Parse a relay's token: the session, the time of its start, and its router; raises `HubWireError`."""
    parts = _split(key, MIDSPAN_SPACE)
    if len(parts) < 6 or parts[2] != "relay" or not (parts[4].isascii() and parts[4].isdigit()):
        raise HubWireError("not a relay token")
    return parts[3], int(parts[4][:20]), _unquote(parts[5])


def near_key(domain: int, zid: str, session: str) -> str:
    """Return the key of the token with which a session announces that it has a direct link to another one."""
    return f"{MIDSPAN_SPACE}/{domain}/near/{zid}/{_quote(session)}"


def parse_near(key: str) -> tuple[str, str]:
    """Parse the token of a direct link: the announcing session, and the other one; raises `HubWireError`."""
    parts = _split(key, MIDSPAN_SPACE)
    if len(parts) != 5 or parts[2] != "near":
        raise HubWireError("not a token of a direct link")
    return parts[3], _unquote(parts[4])


def wire_key(domain: int, zid: str) -> str:
    """Return the key of the token with which a session announces its protocol version."""
    return f"{MIDSPAN_SPACE}/{domain}/wire/{zid}/{WIRE}/{_quote(__version__)}"


def parse_wire(key: str) -> tuple[str, str, str]:
    """Parse a version's token: session, version and release, ignoring later additions; raises `HubWireError`."""
    parts = _split(key, MIDSPAN_SPACE)
    if len(parts) < 6 or parts[2] != "wire":
        raise HubWireError("not a version token")
    return parts[3], parts[4], _unquote(parts[5])


def gid_of(key: str) -> bytes:
    """Return the GID (16 bytes) of the endpoint whose token has this key."""
    value = xxhash.xxh3_128_intdigest(key.encode())
    return (value & (2**64 - 1)).to_bytes(8, "little") + (value >> 64).to_bytes(8, "little")


def _token_prefix(owner: NodeToken, entity: str, letters: str) -> str:
    return (
        f"{ADMIN_SPACE}/{owner.domain}/{owner.zid}/{owner.node_id}/{entity}/{letters}"
        f"/{mangle(owner.enclave)}/{mangle(owner.namespace)}/{mangle(owner.node)}"
    )


def _split(key: str, space: str) -> list[str]:
    parts = key.split("/", 16)
    if len(key) > _MAX_TOKEN or parts[0] != space or not all(parts) or "*" in key:
        raise HubWireError("token is too long, has empty parts or wildcards, or is in another space")
    return parts


def _domain(part: str) -> int:
    if not (part.isascii() and part.isdigit() and len(part) < 6):
        raise HubWireError(f"domain {part[:20]!r} is not a number")
    return int(part)


def _absolute(name: str) -> str:
    """Normalize a name: foreign tokens may lack the leading slash, or have one at the end."""
    return "/" + name.strip("/")


def _quote(word: str) -> str:
    return quote(word, safe="") or "%"


def _unquote(part: str) -> str:
    return "" if part == "%" else unquote(part)
