"""Publishers and subscriptions declared on zenoh exactly as rmw_zenoh declares them, without rmw_zenoh.

Since 0.2.2 rmw_zenoh_cpp declares every subscription as zenoh-ext's advanced subscriber and every publisher as its
advanced publisher. The options depend on the QoS: `rmw_subscription_data.cpp` and `rmw_publisher_data.cpp` of
rmw_zenoh_cpp, branch jazzy. An advanced subscriber drops a sample whose source number is not above that source's last
number; a plain subscriber delivers it.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import secrets
import time
from collections.abc import Callable
from typing import Any

import zenoh
from zenoh import ext

from bridge.hub.graph.tokens import EndpointKind, EndpointToken, NodeToken, endpoint_key, gid_of, node_key
from bridge.hub.wire.keys import GID_SIZE, pack_attachment, topic_key
from bridge.hub.wire.qos import History, Qos, Reliability
from tests.support.wait import until

HEARTBEAT = 0.5
"""Seconds; `SAMPLE_MISS_DETECTION_HEARTBEAT_PERIOD` of rmw_zenoh_cpp."""

CONFIG: dict[str, Any] = {
    "mode": "peer",
    "listen": {"endpoints": ["tcp/127.0.0.1:0"]},
    "scouting": {
        "multicast": {"enabled": False},
        "gossip": {
            "enabled": True,
            "target": {"router": ["router", "peer"], "peer": ["router"]},
            "autoconnect": {"router": [], "peer": ["router", "peer"]},
            "autoconnect_strategy": {"peer": {"to_router": "always", "to_peer": "greater-zid"}},
        },
    },
    "timestamping": {"enabled": {"router": True, "peer": True, "client": True}, "drop_future_timestamp": False},
    "queries_default_timeout": 600_000,
    "transport": {"link": {"tx": {"lease": 60_000, "keep_alive": 2}}, "shared_memory": {"enabled": False}},
}
"""The relevant part of rmw_zenoh_cpp's `DEFAULT_RMW_ZENOH_SESSION_CONFIG.json5`, with loopback instead of localhost."""


def rmw_session(router: str, mode: str = "peer") -> zenoh.Session:
    """Open the zenoh session of an rmw_zenoh context.

    As a peer, rmw_zenoh's default, the session connects to the router and directly to other peers; as a client, it
    reaches them only through the router.
    """
    listen = {} if mode == "client" else CONFIG["listen"]
    tree = {**CONFIG, "mode": mode, "listen": listen, "connect": {"endpoints": [router]}}
    return zenoh.open(zenoh.Config.from_json5(json.dumps(tree)))


def subscribe(
    session: zenoh.Session,
    key: str,
    callback: Callable[[zenoh.Sample], None],
    qos: Qos,
    *,
    ignore_local: bool = False,
) -> Any:
    """Declare a subscription with the options of `SubscriptionData::init`.

    ``ignore_local`` is rmw's option ``ignore_local_publications``. One option is missing in zenoh's Python wheel:
    rmw_zenoh's queries for cached samples never expire; here they expire after the session's 10 minutes.
    """
    handler = zenoh.handlers.Callback(callback, indirect=False)
    origin = zenoh.Locality.REMOTE if ignore_local else zenoh.Locality.ANY
    if not qos.latched:
        return ext.declare_advanced_subscriber(session, key, handler, allowed_origin=origin)
    reliable = qos.reliability is Reliability.RELIABLE
    return ext.declare_advanced_subscriber(
        session,
        key,
        handler,
        allowed_origin=origin,
        history=ext.HistoryConfig(detect_late_publishers=True, max_samples=qos.depth),
        recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True) if reliable else None,
        subscriber_detection=True,
    )


def declare_publisher(session: zenoh.Session, key: str, qos: Qos) -> Any:
    """Declare a publisher with the options of `PublisherData::make`."""
    reliable = qos.reliability is Reliability.RELIABLE
    blocks = reliable and qos.history is History.KEEP_ALL
    latched: dict[str, Any] = {}
    if qos.latched:
        latched["publisher_detection"] = True
        latched["cache"] = ext.CacheConfig(max_samples=qos.depth)
        if reliable:
            latched["sample_miss_detection"] = ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=HEARTBEAT)
    return ext.declare_advanced_publisher(
        session,
        key,
        congestion_control=zenoh.CongestionControl.BLOCK if blocks else zenoh.CongestionControl.DROP,
        reliability=zenoh.Reliability.RELIABLE if reliable else zenoh.Reliability.BEST_EFFORT,
        **latched,
    )


class _Announced:
    """An endpoint with a liveliness token."""

    def __init__(self, session: zenoh.Session) -> None:
        self._liveliness = session.liveliness()
        self._tokens: list[zenoh.LivelinessToken] = []

    def announce(self, token: str) -> None:
        """Declare the endpoint's token, as rmw_zenoh does once the endpoint is declared."""
        self._tokens.append(self._liveliness.declare_token(token))

    def close(self) -> None:
        """Withdraw the token."""
        for token in self._tokens:
            token.undeclare()


class RmwSubscription(_Announced):
    """Collects the payloads that one rmw_zenoh subscription would deliver.

    Attributes:
        missed: messages that zenoh counts as lost, from gaps between source numbers.
    """

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        qos: Qos,
        received: Callable[[bytes], None] = lambda _payload: None,
        *,
        ignore_local: bool = False,
    ) -> None:
        super().__init__(session)
        self.payloads: list[bytes] = []
        self.missed = 0
        self._received = received
        self._end = subscribe(session, key, self._add, qos, ignore_local=ignore_local)
        self._misses = self._end.sample_miss_listener(self._miss)

    def _miss(self, miss: ext.Miss) -> None:
        self.missed += miss.nb

    def _add(self, sample: zenoh.Sample) -> None:
        if sample.attachment is not None:  # rmw_zenoh drops samples without an attachment
            payload = sample.payload.to_bytes()
            self.payloads.append(payload)
            self._received(payload)

    def texts(self) -> list[str]:
        """Return the payloads so far, decoded."""
        return [payload.decode() for payload in self.payloads]

    def expect(self, *texts: str, seconds: float = 40.0) -> None:
        """Wait until exactly these messages have arrived, in this order."""
        with contextlib.suppress(AssertionError):
            until(lambda: len(self.payloads) >= len(texts), "all messages arrive", seconds)
        assert self.texts() == list(texts), f"{self.texts()} arrived, not {list(texts)}"

    def close(self) -> None:
        """Withdraw the subscription."""
        super().close()
        self._misses.undeclare()
        self._end.undeclare()


class RmwPublisher(_Announced):
    """Publishes with rmw_zenoh's attachment: sequence number, time and GID.

    Args:
        gid: the publisher's GID, by default a random one.
        first: the first sequence number; rmw_zenoh starts with 1.
    """

    def __init__(self, session: zenoh.Session, key: str, qos: Qos, gid: bytes = b"", *, first: int = 1) -> None:
        super().__init__(session)
        self._end = declare_publisher(session, key, qos)
        # the wheel's AdvancedPublisher has no matching status
        self._matching = session.declare_publisher(key)
        self._gid, self._sequence = gid or secrets.token_bytes(GID_SIZE), first

    def put(self, payload: bytes) -> None:
        """Publish one message."""
        self._end.put(payload, attachment=pack_attachment(self._sequence, time.time_ns(), self._gid))
        self._sequence += 1

    def matched(self) -> bool:
        """Return whether the key has a subscription."""
        status: Any = self._matching.matching_status  # an object, although the wheel's stubs promise a bool
        return bool(status.matching)

    def until_matched(self) -> None:
        """Wait for a subscription."""
        until(self.matched, "the publisher is matched")

    def close(self) -> None:
        """Withdraw the publisher and the samples that it caches."""
        super().close()
        self._matching.undeclare()
        # Not `undeclare`, which may hold Python's lock for 10 s; dropping the last reference releases it.
        del self._end


class RmwNode:
    """An rmw_zenoh node: a session, the node's liveliness token, and endpoints with their tokens."""

    def __init__(self, router: str, domain: int, name: str) -> None:
        self._session = rmw_session(router)
        self.zid = str(self._session.zid())
        self._token = NodeToken(domain, self.zid, "0", "/", name)
        self._ids = itertools.count(1)
        self._node = self._session.liveliness().declare_token(node_key(self._token))

    def publisher(self, topic: str, type_name: str, type_hash: str, qos: Qos) -> RmwPublisher:
        """Declare a publisher and announce it."""
        key = topic_key(self._token.domain, topic, type_name, type_hash)
        token = self._endpoint(EndpointKind.PUBLISHER, topic, type_name, type_hash, qos)
        publisher = RmwPublisher(self._session, key, qos, gid_of(token))
        publisher.announce(token)
        return publisher

    def subscription(
        self, topic: str, type_name: str, type_hash: str, qos: Qos, received: Callable[[bytes], None]
    ) -> RmwSubscription:
        """Declare a subscription that ignores this node's own messages, and announce it."""
        key = topic_key(self._token.domain, topic, type_name, type_hash)
        subscription = RmwSubscription(self._session, key, qos, received, ignore_local=True)
        subscription.announce(self._endpoint(EndpointKind.SUBSCRIPTION, topic, type_name, type_hash, qos))
        return subscription

    def _endpoint(self, kind: EndpointKind, topic: str, type_name: str, type_hash: str, qos: Qos) -> str:
        return endpoint_key(EndpointToken(self._token, str(next(self._ids)), kind, topic, type_name, type_hash, qos))

    def close(self) -> None:
        """Leave the hub."""
        self._session.close()
