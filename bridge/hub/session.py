"""Sessions and nodes on the hub, for workers, modules and tools of Midspan."""

from __future__ import annotations

import atexit
import itertools
import json
import logging
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from threading import RLock
from types import TracebackType
from typing import Any, Self, TypeVar

import zenoh

from bridge.clock import CLOCK_TOPIC, CLOCK_TYPE, RunClock
from bridge.concurrency import DelayedCalls, SerialExecutor
from bridge.hub.control import Control, Handler, WorkerAnswer, ask
from bridge.hub.daemons import DaemonIdentity
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
from bridge.hub.errors import HubClosedError, HubConfigError, HubError, zenoh_reason
from bridge.hub.graph import HubGraph
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
    wire_key,
)
from bridge.hub.lane.folder import possible
from bridge.hub.lane.lane import Lane
from bridge.hub.links import MEMBERS, Mesh
from bridge.hub.listeners import open_hub_session
from bridge.hub.rejoin import REJOIN
from bridge.hub.wire.keys import ANY_HASH, subscription_key, topic_key
from bridge.hub.wire.qos import Qos, Reliability
from bridge.hub.zenoh_config import MAX_PAYLOAD, make_config, session_tree, without_shared_memory
from bridge.status import LaneStatus

_log = logging.getLogger(__name__)

_NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}")
_NODE = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,254}")
_SERVICE_QOS = Qos(depth=10)  # rmw's, for servers and clients alike
_NAMESPACE = re.compile(r"/|(?:/[A-Za-z_][A-Za-z0-9_]*){1,32}")
_Endpoint = TypeVar("_Endpoint", HubPublisher, HubSubscription, HubServer, HubClient)


@dataclass(frozen=True, slots=True)
class HubSettings:
    """How a session joins the hub.

    Attributes:
        domain: ROS domain id, the first part of each key.
        router: zenoh endpoint of the router, None if ``zenoh`` has all endpoints.
        zenoh: zenoh configuration that overrides Midspan's, inline or as the path of a JSON5 or YAML file.
        shared_memory: whether large messages between sessions on one machine go through shared memory.
        node: node name in the hub's graph.
        namespace: the node's namespace.
        daemon: name of the daemon on the control plane.
        worker: name of the worker on the control plane.
        max_payload: maximum size of a message in bytes.
        max_tokens: maximum number of endpoints and nodes in the graph.
        lane: folder of the sockets for small messages to other sessions with the same folder; None: zenoh only.
        identity: the daemon to which the worker belongs, None for a program that does not belong to a daemon.
    """

    domain: int = 0
    router: str | None = "tcp/127.0.0.1:7447"
    zenoh: Mapping[str, Any] | str | Path | None = None
    shared_memory: bool = True
    node: str = "midspan"
    namespace: str = "/"
    daemon: str = "midspan"
    worker: str = "tool"
    max_payload: int = MAX_PAYLOAD
    max_tokens: int = 50_000
    lane: str | Path | None = None
    identity: DaemonIdentity | None = None

    def __post_init__(self) -> None:
        """Raise `HubConfigError` for names that a key cannot contain."""
        for name, value, form in (
            ("daemon", self.daemon, _NAME),
            ("worker", self.worker, _NAME),
            ("node", self.node, _NODE),
            ("namespace", self.namespace, _NAMESPACE),
        ):
            if not form.fullmatch(value):
                raise HubConfigError(f"hub {name} {value[:80]!r} is not a valid name: it must match {form.pattern}")


def _config(settings: HubSettings) -> zenoh.Config:
    # Even if this session's limit is lower, links accept MAX_PAYLOAD: this session counts the messages that it refuses;
    # a link would drop them silently.
    room = max(settings.max_payload, MAX_PAYLOAD)
    tree = session_tree(settings.router, shared_memory=settings.shared_memory, max_payload=room)
    return make_config(tree, settings.zenoh)


def _rules_messages(config: zenoh.Config) -> bool:
    """Return whether zenoh is configured to refuse or drop some messages, which is impossible on the lane."""
    tree = json.loads(str(config))
    ruled = tree.get("access_control") or {}
    return bool(ruled.get("enabled") or tree.get("downsampling") or tree.get("low_pass_filter"))


class HubSession:
    """A zenoh session on the hub, with its graph and its links, for one or several nodes of a process (`Hub.on`).

    Opening does not wait for the router: the session joins as soon as the router answers, also after a lost connection.
    Only in zenoh's client mode must the router be running at the start.

    Attributes:
        zenoh: the zenoh session.
        zid: id of the zenoh session.
        settings: the settings with which it joined the hub.
        shared: whether it may have several nodes; otherwise it closes with its only node.
        reach: which sessions its nodes' endpoints reach: only others, or also this one.
        graph: all participants as this session sees them.
        mesh: its direct links to other programs on this machine.
        lane: the local transport for small messages to this daemon's other workers, None without one.
        ids: source of the numbers of its nodes and their endpoints, assigned as in rmw_zenoh.
        nodes: the open nodes.
    """

    def __init__(self, session: zenoh.Session, settings: HubSettings, *, shared: bool = False) -> None:
        self.zenoh, self.settings, self.shared = session, settings, shared
        self.zid = str(session.zid())
        self.reach = zenoh.Locality.ANY if shared else zenoh.Locality.REMOTE
        self.ids = itertools.count()
        self.nodes: set[Hub] = set()
        self._lock = RLock()
        self._closed = False
        self.graph = HubGraph(session, settings.domain, settings.max_tokens)
        self.graph.announce(wire_key(settings.domain, self.zid))
        self.lane: Lane | None = None
        if settings.lane is not None and possible():
            self.lane = Lane(Path(settings.lane), self.zid, session, settings.domain, self.graph.renew)
            self.graph.watch(self.lane.graph_changed)
        self.mesh = Mesh(
            session, lambda: without_shared_memory(_config(settings)), self._members, self._peers, self._rejoin
        )
        # a process that exits with an open session hangs in zenoh's threads
        atexit.register(self.close)

    @classmethod
    def open(cls, settings: HubSettings, *, shared: bool) -> HubSession:
        """Open a session; raises `HubError` if zenoh cannot open it."""
        config = _config(settings)
        if settings.lane is not None and _rules_messages(config):
            _log.info("no lane: zenoh's configuration restricts messages")
            settings = replace(settings, lane=None)
        try:
            session = open_hub_session(config)
        except zenoh.ZError as err:
            raise HubError(f"cannot join the hub: {zenoh_reason(err)}") from None
        try:
            return cls(session, settings, shared=shared)
        except BaseException:
            session.close()  # type: ignore[no-untyped-call]
            raise

    def add(self, node: Hub) -> None:
        """Add a node; raises `HubClosedError` if the session is closed."""
        with self._lock:
            if self._closed:
                raise HubClosedError("the hub session is closed")
            self.nodes.add(node)

    def ask(self, verb: str, params: dict[str, Any], daemon: str, worker: str, timeout: float) -> list[WorkerAnswer]:
        """Query a verb of the control plane; see `Hub.ask`."""
        return ask(self.zenoh, self.settings.domain, verb, params, daemon, worker, timeout)

    def close(self) -> None:
        """Close the session and its nodes. Safe to call twice."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
        atexit.unregister(self.close)
        for node in tuple(self.nodes):
            node.close()
        if self.lane is not None:
            self.lane.close()
        self.mesh.close()
        self.graph.close()
        self.zenoh.close()  # type: ignore[no-untyped-call]

    def _members(self) -> set[str] | None:
        """Return the sessions that are linked to this session's routers, None if no router answers."""
        return self._at_routers("members")

    def _peers(self) -> set[str] | None:
        """Return which of the sessions of `_members` are peers."""
        return self._at_routers("peers")

    def _rejoin(self, zids: Collection[str]) -> None:
        """Have sessions join their router again."""
        self.ask(REJOIN, {"sessions": sorted(zids)}, "*", "router", 1.0)

    def _at_routers(self, kind: str) -> set[str] | None:
        routers = {str(zid) for zid in self.zenoh.info.routers_zid()}
        answers = self.ask(MEMBERS, {}, "*", "router", 1.0) if routers else []
        values = [a.value for a in answers if isinstance(a.value, dict) and a.value.get("zid") in routers]
        known = [value[kind] for value in values if isinstance(value.get(kind), list)]
        return {str(zid) for members in known for zid in members} if known else None


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
