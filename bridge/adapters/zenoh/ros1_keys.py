"""Keys of zenoh-plugin-ros1, of topics and of services.

A topic's samples travel on ``<type in hex>/<md5>/<bridge namespace>/<topic>``, the payload is the ROS 1 message as it
is on TCPROS, without an attachment. The bridge namespace is ``*`` by default. A service is a queryable on the same kind
of key, with the service's type and md5; a bridge whose server failed replies with the error's text instead of a
response. Bridges tell each other what they have on
``ros1_discovery_info/<discovery namespace>/{pub|sub|srv|cl}/<type in hex>/<md5>/<bridge namespace>/<topic>``, the
discovery namespace being ``*``. Read in zenoh-plugin-ros1, ``topic_utilities.rs``, ``discovery.rs`` and
``abstract_bridge.rs``, of May 2025; free_fleet's clients use the same data keys (its ``utils.py``).
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from bridge.adapters.base import Kind
from bridge.hub.errors import WireError
from bridge.messages.names import is_ros1_name

_SPACE = "ros1_discovery_info"
_CLASSES = {Kind.PUBLISHER: "pub", Kind.SUBSCRIPTION: "sub", Kind.SERVER: "srv", Kind.CLIENT: "cl"}
_KINDS = {name: kind for kind, name in _CLASSES.items()}
_MD5 = re.compile(r"[0-9a-f]{32}|\*")
_MAX_KEY = 4096


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic or a service as a bridge tells it: absolute name, ROS 1 type, md5 (``*`` for any)."""

    name: str
    type: str
    md5: str


def data_key(topic: Topic, namespace: str) -> str:
    """The key of a topic's samples, or of a service's calls."""
    return f"{topic.type.encode().hex()}/{topic.md5}/{namespace}/{topic.name.strip('/')}"


def discovery_key(kind: Kind, topic: Topic, namespace: str) -> str:
    """The key on which a topic or a service is told."""
    return f"{_SPACE}/*/{_CLASSES[kind]}/{data_key(topic, namespace)}"


def all_discovery(namespace: str) -> str:
    """What is told by bridges of a namespace."""
    return f"{_SPACE}/*/*/*/*/{namespace}/*/**"


def parse(key: str) -> tuple[Kind, Topic]:
    """Read a discovery key.

    Raises:
        WireError: it is none, or has no type, md5 or topic.
    """
    parts = key.split("/", 6)
    if len(key) > _MAX_KEY or len(parts) != 7 or parts[0] != _SPACE or not all(parts):
        msg = "no discovery key of the ros1 plugin"
        raise WireError(msg)
    kind = _KINDS.get(parts[2])
    try:
        type_name = bytes.fromhex(parts[3]).decode("ascii")
    except (ValueError, UnicodeDecodeError):
        type_name = ""
    if kind is None or not is_ros1_name(type_name):
        msg = f"class {parts[2][:20]!r}, type {parts[3][:80]!r}: no ROS 1 topic or service"
        raise WireError(msg)
    if not _MD5.fullmatch(parts[4]):
        msg = f"md5 {parts[4][:80]!r} is none"
        raise WireError(msg)
    if any(char in parts[6] for char in "*$?#@"):
        msg = f"{parts[6][:80]!r} is no topic"
        raise WireError(msg)
    return kind, Topic("/" + parts[6], type_name, parts[4])
