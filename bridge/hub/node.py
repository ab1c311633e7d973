"""Nodes on the hub with their endpoints, for workers, modules and tools of Midspan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from threading import RLock
from types import TracebackType
from typing import Any, Self, TypeVar

from bridge.clock import CLOCK_TOPIC, CLOCK_TYPE, RunClock
from bridge.concurrency import DelayedCalls, SerialExecutor
from bridge.hub.control import Control, Handler, WorkerAnswer
from bridge.hub.endpoints.calls import Call
from bridge.hub.endpoints.context import EndpointContext
from bridge.hub.endpoints.keyspace import KeySpace
from bridge.hub.endpoints.lane_subscription import LaneSubscription
from bridge.hub.endpoints.latched_subscription import LatchedHubSubscription
from bridge.hub.endpoints.publisher import HubPublisher
from bridge.hub.endpoints.relaying import RelayPublisher
from bridge.hub.endpoints.services import HubClient, HubServer
from bridge.hub.endpoints.sinks import PublisherOptions
from bridge.hub.endpoints.subscription import HubSample, HubSubscription, Refused
from bridge.hub.endpoints.variants import Convert, KeyVariants, TypeVersions
from bridge.hub.errors import HubClosedError
from bridge.hub.graph.tokens import (
    BRIDGE_ENCLAVE,
    EndpointKind,
    EndpointToken,
    NodeToken,
    Origin,
    OriginToken,
    endpoint_key,
    node_key,
    origin_key,
)
from bridge.hub.session import HubSession, HubSettings
from bridge.hub.wire.keys import ANY_HASH, subscription_key, topic_key
from bridge.hub.wire.qos import Qos, Reliability
from bridge.status import LaneStatus

_SERVICE_QOS = Qos(depth=10)  # rmw's, for servers and clients alike
_Endpoint = TypeVar("_Endpoint", HubPublisher, HubSubscription, HubServer, HubClient)


class Hub:
    """A node on the hub, in rmw_zenoh's format, with its own session (`open`) or a shared one (`on`).

    Safe to use from any thread.

    Attributes:
        max_payload: maximum size in bytes of a message in either direction.
        graph: all participants as the node's session sees them.
        mesh: the session's direct links to other programs on this machine.
    """

    def __init__(self, session: HubSession, settings: HubSettings) -> None:
        self.zid, self.graph, self.mesh = session.zid, session.graph, session.mesh
        self.domain = settings.domain
        self.max_payload = settings.max_payload
        self._joined, self._session = session, session.zenoh
        self._lock = RLock()
        self._closed = False
        self._endpoints: set[HubPublisher | HubSubscription | HubServer | HubClient] = set()
        self._own: set[bytes] = set()
        self._spaces: list[KeySpace] = []
        self._origin: tuple[Origin, Callable[[], None]] | None = None
        self._drivers: dict[str, Callable[[], None]] = {}  # by topic, the latest announcement
        self._node = NodeToken(settings.domain, self.zid, str(next(session.ids)), settings.namespace, settings.node)
        self._control = Control(self._session, settings.domain, settings.daemon, settings.worker, settings.identity)
        executor = SerialExecutor("hub-executor")
        self._context = EndpointContext(
            self._session, session.reach, self._own, self.graph, settings.max_payload, executor,
            SerialExecutor("hub-ends"), SerialExecutor("hub-asking"), DelayedCalls("hub-delays"),
            KeyVariants(self.graph, executor), self._remove, session.lane,
        )  # fmt: skip
        session.add(self)
        self._withdraw = self.graph.announce(node_key(self._node))

    @classmethod
    def open(cls, settings: HubSettings) -> Hub:
        """Open a session for one node; raises `HubError` if zenoh cannot open it."""
        session = HubSession.open(settings, shared=False)
        try:
            return cls(session, settings)
        except BaseException:
            session.close()
            raise

    @classmethod
    def on(cls, session: HubSession, node: str, worker: str) -> Hub:
        """Add a node to a shared session; ``worker`` is the node's name on the control plane.

        The nodes of the session receive each other's messages. Raises `HubClosedError` if the session is closed.
        """
        return cls(session, replace(session.settings, node=node, worker=worker))

    def set_origin(self, origin: Origin | None) -> None:
        """Announce the foreign network that this session bridges, before creating endpoints; None withdraws it."""
        with self._lock:
            self._check_open()
            before = self._origin
            if (before and before[0]) == origin:
                return
            if origin is None:
                self._origin = None
            else:
                self._origin = (origin, self.graph.announce(origin_key(OriginToken(self.domain, self.zid, origin))))
            if before is not None:
                before[1]()

    def announce_driver(self, topic: str, who: str) -> Callable[[], None]:
        """Announce that ``who`` drives manually, until the returned function is called or the node is closed."""
        with self._lock:
            self._check_open()
            self._drivers[topic] = self.graph.announce_driver(topic, who)
            return self._drivers[topic]

    @property
    def versions(self) -> TypeVersions:
        """The known versions of types, for peers with other releases; set them before creating endpoints."""
        return self._context.variants.versions

    @versions.setter
    def versions(self, versions: TypeVersions) -> None:
        self._context.variants.versions = versions

    def lane(self) -> LaneStatus:
        """Return the state of the local transport to this daemon's other workers; empty if the session has no lane."""
        return LaneStatus() if self._joined.lane is None else self._joined.lane.status()

    def linked(self) -> bool:
        """Whether the session has a link to any other session on the hub."""
        self._check_open()
        info = self._session.info
        return bool(info.routers_zid() or info.peers_zid())

    def router(self) -> str:
        """Return the id of the router to which this session is linked, "" if there is none."""
        self._check_open()
        return min(map(str, self._session.info.routers_zid()), default="")

    def neighbors(self) -> set[str]:
        """Return the sessions with a direct link to this session; they belong to programs on this machine."""
        self._check_open()
        return {str(zid) for zid in self._session.info.peers_zid()}

    def publisher(
        self,
        topic: str,
        type_name: str,
        type_hash: str,
        qos: Qos,
        *,
        priority: str = "stream",
        express: bool | None = None,
        queue: int | None = None,
    ) -> HubPublisher:
        """Create a publisher, which exists until it or the node is closed.

        The priority is ``command``, ``state`` or ``stream``. With ``express``, which is the default for commands only,
        each sample is sent in its own packet. Bursts of other samples are as fast in shared packets; some of them might
        be lost in separate packets on a busy machine. ``queue`` is the maximum number of messages that wait for a slow
        reader of the lane, by default 1 for commands and 1000 otherwise.
        """
        with self._lock:
            token = self._token(EndpointKind.PUBLISHER, topic, type_name, type_hash, qos)
            key = topic_key(self.domain, topic, type_name, type_hash)
            options = PublisherOptions(qos, priority, express, queue)
            return self._keep(HubPublisher(self._context, token, key, topic, qos, options))

    def subscription(
        self,
        topic: str,
        type_name: str,
        type_hash: str,
        qos: Qos,
        callback: Callable[[HubSample], None],
        refused: Refused | None = None,
        *,
        exact: bool = False,
        grouped: bool = False,
    ) -> HubSubscription:
        """Create a subscription, which exists until it or the node is closed; the type hash ``*`` stands for any hash.

        Unless it is ``exact``, it also receives the messages of other known versions of the type, converted. If it is
        ``grouped``, it receives only the messages of the CPU group (`bridge.hub.wire.buffers`). A latched
        subscription receives the cached samples of each latched publisher, existing or later. The node's own samples
        are not delivered. ``refused`` is called for each sample that is malformed, too large or cannot be converted.
        Both callbacks run on threads of zenoh, the lane or Midspan's executors, or on the publishing thread of another
        node of this session, so they may only append and wake.
        """
        with self._lock:
            token = self._token(EndpointKind.SUBSCRIPTION, topic, type_name, type_hash, qos)
            key = subscription_key(self.domain, topic, type_name, type_hash)
            if qos.latched:
                return self._keep(
                    LatchedHubSubscription(self._context, token, key, topic, qos, callback, refused, exact=exact)
                )
            lane = self._joined.lane
            if lane is None or grouped:
                return self._keep(
                    HubSubscription(self._context, token, key, topic, callback, refused, exact=exact, grouped=grouped)
                )
            return self._keep(
                LaneSubscription(self._context, lane, token, key, topic, qos, callback, refused, exact=exact)
            )

    def relay_publisher(
        self, topic: str, type_name: str, type_hash: str, qos: Qos, convert: Convert | None, *, priority: str
    ) -> RelayPublisher:
        """Create a publisher of other sessions' messages, which its owner closes; ``convert``: to this type hash."""
        with self._lock:
            self._check_open()
            key = topic_key(self.domain, topic, type_name, type_hash)
            return RelayPublisher(self._context, key, qos, PublisherOptions(qos, priority, None), convert)

    def server(self, name: str, type_name: str, type_hash: str, call: Call, *, hidden: bool = False) -> HubServer:
        """Serve a service; the server exists until it or the node is closed.

        ``call`` receives each request's CDR on zenoh's receiving thread, or on the thread of another node of this
        session that calls; it must start the call and return at once. The node's own calls are not delivered. The name
        of an action's service includes the ``/_action/`` part. A ``hidden`` server has no token, and accepts only calls
        under its type hash.
        """
        with self._lock:
            token = self._token(EndpointKind.SERVER, name, type_name, type_hash, _SERVICE_QOS)
            key = topic_key(self.domain, name, type_name, type_hash)
            return self._keep(HubServer(self._context, token, key, name, call, hidden=hidden))

    def client(self, name: str, type_name: str, type_hash: str, changed: Callable[[], None] | None = None) -> HubClient:
        """Create a client of a service; the client exists until it or the node is closed.

        ``changed`` is called on a thread of zenoh when the first server appears or the last one leaves, and may only
        wake other threads.
        """
        with self._lock:
            token = self._token(EndpointKind.CLIENT, name, type_name, type_hash, _SERVICE_QOS)
            key = topic_key(self.domain, name, type_name, type_hash)
            return self._keep(HubClient(self._context, token, key, name, changed))

    def keyspace(self, prefix: str) -> KeySpace:
        """Return access to plain zenoh keys below a prefix; it closes with the node at the latest."""
        with self._lock:
            self._check_open()
            space = KeySpace(self._session, prefix, self.max_payload)
            self._spaces.append(space)
            return space

    def serve(self, verb: str, handler: Handler) -> Callable[[], None]:
        """Serve a verb of the control plane for this daemon and worker, until the returned function is called."""
        with self._lock:
            self._check_open()
            return self._control.serve(verb, handler)

    def ask(
        self, verb: str, params: dict[str, Any], daemon: str = "*", worker: str = "*", timeout: float = 2.0
    ) -> list[WorkerAnswer]:
        """Query a verb of all workers, of one daemon's workers or of one worker; wait up to ``timeout`` seconds."""
        self._check_open()
        return self._joined.ask(verb, params, daemon, worker, timeout)

    def close(self) -> None:
        """Close the endpoints, tokens and threads of this node. Safe to call twice."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
        # the endpoints must leave the graph before the origin and the node do
        for endpoint in tuple(self._endpoints):
            endpoint.close()
        for space in self._spaces:
            space.close()
        self._context.variants.close()
        self._context.executor.close()
        self._context.ends.close()
        self._context.asking.close()
        self._context.delays.close(1.0)
        self._control.close()
        for withdraw in (*self._drivers.values(), self._withdraw):
            withdraw()
        self._joined.nodes.discard(self)
        if not self._joined.shared:
            self._joined.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def _check_open(self) -> None:
        if self._closed:
            raise HubClosedError("this node of the hub is closed")

    def _keep(self, endpoint: _Endpoint) -> _Endpoint:
        self._endpoints.add(endpoint)
        if not isinstance(endpoint, HubSubscription):
            self._own.add(endpoint.gid)
        return endpoint

    def _remove(self, endpoint: HubPublisher | HubSubscription | HubServer | HubClient) -> None:
        self._endpoints.discard(endpoint)
        if not isinstance(endpoint, HubSubscription):
            self._own.discard(endpoint.gid)

    def _token(self, kind: EndpointKind, topic: str, type_name: str, type_hash: str, qos: Qos) -> str:
        """Return the key of a new endpoint's token; raises `HubClosedError`."""
        self._check_open()
        owner = replace(self._node, enclave=BRIDGE_ENCLAVE if self._origin else "/")
        return endpoint_key(EndpointToken(owner, str(next(self._joined.ids)), kind, topic, type_name, type_hash, qos))


def follow_clock(clock: RunClock, hub: Hub) -> None:
    """Feed a simulated clock with the times that other nodes publish on ``/clock``; do nothing for the system clock."""
    if clock.simulated:
        qos = Qos(Reliability.BEST_EFFORT, depth=1)
        hub.subscription(CLOCK_TOPIC, CLOCK_TYPE, ANY_HASH, qos, lambda sample: clock.receive(sample.data()))
