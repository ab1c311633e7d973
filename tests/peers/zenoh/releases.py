"""rmw_zenoh nodes of each ROS 2 release, written from the published sources without Midspan's own wire code.

Sources: rmw_zenoh_cpp 0.1.9 (Humble), 0.2.10 (Jazzy), 0.6.7 (Kilted) and 0.10.5 (Lyrical), in the repository
ros2-gbp/rmw_zenoh-release: ``liveliness_utils.cpp`` (tokens, keys and GIDs), ``attachment_helpers.cpp``,
``rmw_publisher_data.cpp``, ``rmw_subscription_data.cpp``, ``rmw_service_data.cpp``, ``rmw_client_data.cpp``.
"""

from __future__ import annotations

import itertools
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass
from queue import Queue
from threading import Lock
from typing import Any

import xxhash
import zenoh

from bridge.hub.wire.qos import Qos
from tests.peers.zenoh.rmw import declare_publisher, rmw_session, subscribe

NO_HASH = "TypeHashNotSupported"
CPU_GROUP = "_buf_cpu"
VOLATILE = Qos(depth=10)


@dataclass(frozen=True, slots=True)
class Release:
    """The differences between the releases' rmw_zenoh.

    Attributes:
        hashes: whether tokens and keys have the type's hash; otherwise they have `NO_HASH`.
        buffers: whether volatile endpoints with a variable-length array announce buffer backends in a 14th part.
    """

    name: str
    hashes: bool = True
    buffers: bool = False


HUMBLE = Release("humble", hashes=False)
JAZZY = Release("jazzy")
KILTED = Release("kilted")
LYRICAL = Release("lyrical", buffers=True)
RELEASES = (HUMBLE, JAZZY, KILTED, LYRICAL)


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic or service with its type; ``array`` is whether the type has a variable-length array of primitives."""

    name: str
    type_name: str
    type_hash: str
    qos: Qos = VOLATILE
    array: bool = False


def _dds(type_name: str) -> str:
    package, kind, name = type_name.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def _qos(qos: Qos) -> str:
    """Return the text of ``qos_to_keyexpr``, in which a policy equal to the default profile is empty."""
    numbers = int(qos.reliability), int(qos.durability), int(qos.history), qos.depth
    texts = ("" if number == usual else str(number) for number, usual in zip(numbers, (1, 2, 1, 42), strict=True))
    return "{}:{}:{},{}:,:,:,,".format(*texts)


def gid_of(token: str) -> bytes:
    """Return the GID of an entity: the XXH3-128 of its token, each half in the machine's byte order."""
    digest = xxhash.xxh3_128_intdigest(token.encode())
    return struct.pack("<QQ", digest % 2**64, digest >> 64)


def attachment(sequence: int, gid: bytes) -> bytes:
    """Return the attachment of a sample, a request or a reply."""
    return struct.pack("<qq", sequence, time.time_ns()) + b"\x10" + gid


class ReleaseNode:
    """A node of one release, with endpoints. Its session is a peer, connected to the hub's router."""

    def __init__(self, router: str, domain: int, name: str, release: Release) -> None:
        self.release, self._domain, self._name = release, domain, name
        self.session = rmw_session(router)
        self.zid = str(self.session.zid())
        self._ids = itertools.count(1)
        self._tokens = [self._declare(self._head("0", "NN"))]

    def _head(self, entity: str, kind: str) -> str:
        return f"@ros2_lv/{self._domain}/{self.zid}/0/{entity}/{kind}/%/%/{self._name}"

    def _declare(self, token: str) -> zenoh.LivelinessToken:
        return self.session.liveliness().declare_token(token)

    def _hash(self, topic: Topic) -> str:
        return topic.type_hash if self.release.hashes else NO_HASH

    def key(self, topic: Topic) -> str:
        """Return the key of a topic's samples or a service's calls."""
        return f"{self._domain}/{topic.name.strip('/')}/{_dds(topic.type_name)}/{self._hash(topic)}"

    def buffered(self, topic: Topic) -> bool:
        """Return whether an endpoint of a topic has the keys of buffers."""
        return self.release.buffers and topic.array and not topic.qos.latched

    def token(self, kind: str, topic: Topic) -> str:
        """Return the token of a new endpoint."""
        parts = topic.name.replace("/", "%"), _dds(topic.type_name), self._hash(topic), _qos(topic.qos)
        token = "/".join((self._head(str(next(self._ids)), kind), *parts))
        return f"{token}/backends:cpu:" if self.buffered(topic) else token

    def announce(self, token: str) -> zenoh.LivelinessToken:
        """Declare a token for the life of the node."""
        self._tokens.append(self._declare(token))
        return self._tokens[-1]

    def close(self) -> None:
        """Leave the network."""
        self.session.close()  # type: ignore[no-untyped-call]


@dataclass(frozen=True, slots=True)
class Received:
    """A sample, parsed as `rmw_take` does."""

    payload: bytes
    sequence: int
    gid: bytes
    key: str


class ReleaseSubscription:
    """A subscription on the topic's key and, if the type has buffers, in the CPU group."""

    def __init__(self, node: ReleaseNode, topic: Topic) -> None:
        self.samples: list[Received] = []
        key = node.key(topic)
        self._ends = [subscribe(node.session, key, self._on_sample, topic.qos)]
        if node.buffered(topic):
            self._ends.append(subscribe(node.session, f"{key}/{CPU_GROUP}", self._on_sample, topic.qos))
        self._token = node.announce(node.token("MS", topic))

    def _on_sample(self, sample: zenoh.Sample) -> None:
        if sample.attachment is not None:
            sequence, _time, _size, gid = struct.unpack("<qqB16s", sample.attachment.to_bytes())
            self.samples.append(Received(sample.payload.to_bytes(), sequence, gid, str(sample.key_expr)))

    def texts(self) -> list[str]:
        """Return the payloads so far, decoded."""
        return [sample.payload.decode() for sample in self.samples]

    def close(self) -> None:
        """Withdraw the subscription."""
        self._token.undeclare()
        for end in self._ends:
            end.undeclare()


class ReleasePublisher:
    """A publisher. If the type has buffers, it publishes as Lyrical's ``PublisherData::publish`` does.

    It stores each subscription that it discovers, and never removes one. Subscriptions that announce only the CPU share
    a group key; each other subscription has the key ``<key>/_buf/<GID>``. Lyrical uses the topic's key only while more
    subscriptions match than were discovered, which never happens here. Each put on a key has a new number.
    """

    def __init__(self, node: ReleaseNode, topic: Topic) -> None:
        self._node, self._topic, self.key = node, topic, node.key(topic)
        self._ends: dict[str, Any] = {}
        self._lock = Lock()
        self._discovered: dict[bytes, str] = {}
        token = node.token("MP", topic)
        self.gid, self._sequence, self._token_key = gid_of(token), 0, token
        self._token = node.announce(token)
        self._declared(self.key)
        self._watch: Any = None
        if node.buffered(topic):
            self._declared(f"{self.key}/{CPU_GROUP}")
            handler = zenoh.handlers.Callback(self._on_token, indirect=False)
            self._watch = node.session.liveliness().declare_subscriber("@ros2_lv/**", handler, history=True)

    def _declared(self, key: str) -> Any:
        if key not in self._ends:
            self._ends[key] = declare_publisher(self._node.session, key, self._topic.qos)
        return self._ends[key]

    def _on_token(self, sample: zenoh.Sample) -> None:
        parts = str(sample.key_expr).split("/")
        wanted = ["MS", self._topic.name.replace("/", "%"), _dds(self._topic.type_name)]
        if len(parts) < 13 or [parts[5], *parts[9:11]] != wanted:
            return
        gid = gid_of("/".join(parts[:14]))  # computed from the parts that the release knows
        cpu = parts[13:14] == ["backends:cpu:"]
        if sample.kind == zenoh.SampleKind.PUT:
            with self._lock:
                self._discovered[gid] = f"{self.key}/{CPU_GROUP}" if cpu else f"{self.key}/_buf/{gid.hex()}"

    def discovered(self) -> list[str]:
        """Return the keys of the subscriptions that this publisher has discovered, only if the type has buffers."""
        with self._lock:
            return sorted(self._discovered.values())

    def put(self, payload: bytes) -> list[str]:
        """Publish one message, and return the keys that it was sent on."""
        keys = [self.key]
        if self._watch is not None:
            with self._lock:
                found = list(self._discovered.values())
            group = f"{self.key}/{CPU_GROUP}"
            keys = [group] * (group in found) + [key for key in found if key != group]
        for key in keys:
            self._sequence += 1
            self._declared(key).put(payload, attachment=attachment(self._sequence, self.gid))
        return keys

    def put_serialized(self, payload: bytes) -> None:
        """Publish as ``publish_serialized_message`` does, always on the topic's key."""
        self._sequence += 1
        self._declared(self.key).put(payload, attachment=attachment(self._sequence, self.gid))

    def vanish(self) -> None:
        """Withdraw only the token, as if a link were lost; see `appear`."""
        self._token.undeclare()

    def appear(self) -> None:
        """Declare the token again."""
        self._token = self._node.announce(self._token_key)

    def close(self) -> None:
        """Withdraw the publisher and its cached samples."""
        self._token.undeclare()
        if self._watch is not None:
            self._watch.undeclare()
        self._ends.clear()  # not `undeclare`, which may hold Python's lock for 10 s


class ReleaseServer:
    """A server with a complete queryable; a reply repeats its request's number and GID."""

    def __init__(self, node: ReleaseNode, service: Topic, answer: Callable[[bytes], bytes]) -> None:
        self.requests: list[bytes] = []
        self._key, self._answer = node.key(service), answer
        handler = zenoh.handlers.Callback(self._on_query, indirect=False)
        self._end = node.session.declare_queryable(self._key, handler, complete=True)
        self._token = node.announce(node.token("SS", service))

    def _on_query(self, query: zenoh.Query) -> None:
        if query.attachment is None or query.payload is None:  # rmw_zenoh logs an error
            return
        self.requests.append(query.payload.to_bytes())
        sequence, _time, _size, gid = struct.unpack("<qqB16s", query.attachment.to_bytes())
        with query:
            query.reply(self._key, self._answer(self.requests[-1]), attachment=attachment(sequence, gid))

    def close(self) -> None:
        """Withdraw the server."""
        self._token.undeclare()
        self._end.undeclare()


class ReleaseClient:
    """A client that queries all complete queryables of its key; a query without a reply is lost."""

    def __init__(self, node: ReleaseNode, service: Topic) -> None:
        self._node, self._key = node, node.key(service)
        token = node.token("SC", service)
        self.gid, self._sequence, self._token_key = gid_of(token), 0, token
        self._token = node.announce(token)

    def call(self, request: bytes, seconds: float = 30.0) -> list[bytes]:
        """Return all replies, once the query has ended."""
        self._sequence += 1
        replies: list[bytes] = []
        ended: Queue[None] = Queue()

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None and reply.ok.attachment is not None:
                sequence, _time, _size, gid = struct.unpack("<qqB16s", reply.ok.attachment.to_bytes())
                if (sequence, gid) == (self._sequence, self.gid):
                    replies.append(reply.ok.payload.to_bytes())

        self._node.session.get(
            self._key,
            zenoh.handlers.Callback(on_reply, lambda: ended.put(None), indirect=False),
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            payload=request,
            attachment=attachment(self._sequence, self.gid),
        )
        ended.get(timeout=seconds)
        return replies

    def close(self) -> None:
        """Withdraw the client."""
        self._token.undeclare()


Nodes = Callable[[Release], ReleaseNode]
"""Opens a node of a release."""
