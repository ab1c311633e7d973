"""The status documents of workers, hosted modules and the daemon.

A worker responds to the verb ``status`` of the control plane with a `WorkerStatus`, the router with a `RouterStatus`, a
module with a `ModuleStatus`. A side responds to ``connections`` with a list of `ConnectionStatus`. The daemon sends a
`DaemonStatus` on its socket. As JSON, a status has the keys that were set (`Part.document`).

Documents may come from workers of any release. So `read_status` and `read_daemon_status` keep unknown keys, use
defaults for missing keys, and omit values of the wrong type, which they list in ``error``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, InstanceOf, ValidationError
from pydantic_core import core_schema
from typing_extensions import override

_LEAST, _MOST = -(2**63), 2**63 - 1


class _NumberSchema:
    """Accept an integer or a finite number, without converting one to the other."""

    @classmethod
    def __get_pydantic_core_schema__(cls, _source: Any, _handler: Any) -> core_schema.CoreSchema:
        integer = core_schema.int_schema(strict=True, ge=_LEAST, le=_MOST)
        number = core_schema.float_schema(strict=True, allow_inf_nan=False)
        text = "Input should be a finite number"
        return core_schema.union_schema(
            [integer, number], mode="left_to_right", custom_error_type="number", custom_error_message=text
        )


Text = InstanceOf[str]
"""A string, which need not be valid Unicode: names in ROS 1 and errors of the system can contain any bytes."""

Int = Annotated[int, Field(ge=_LEAST, le=_MOST)]
Number = Annotated[float, _NumberSchema]

INVALID = "invalid status document"
"""Beginning of the error of a document that has values of the wrong type."""

_SHOWN = 3
_HINT = "it may be of another release of Midspan"


class Part(BaseModel):
    """A JSON object with typed fields; other keys are preserved unchanged."""

    model_config = ConfigDict(strict=True, frozen=True, extra="allow")

    if TYPE_CHECKING:  # a Part accepts any keys, its subclasses only their fields

        def __init__(self, **keys: Any) -> None: ...

    def document(self) -> dict[str, Any]:
        """Return the keys and values that were set, for JSON."""
        return {name: _plain(value) for name, value in self if name in self.model_fields_set}

    def other(self, kind: type[AnyPart]) -> AnyPart:
        """Parse the keys that have no field in this type as another type; omit values of the wrong type."""
        return _read(kind, self.model_extra or {})[0]


AnyPart = TypeVar("AnyPart", bound=Part)


class Histogram(Part):
    """Counts in the buckets of a histogram, and the sum of all values in seconds."""

    buckets: list[Int] = []
    seconds: Number = 0.0


class RouteStatus(Part):
    """A topic or service that is bridged in one ``direction``: ``in`` to the hub, ``out`` from it.

    Attributes:
        action: the action to which it belongs, "" if none.
        rate: messages or calls per second.
        age: seconds since the last message.
        latency_ms: quantiles (``p50``, ``p99``) of the latencies of the last messages, in ms.
        carry: time that messages spend in the bridge, only in the direction to the hub.
        way: transport on the hub (``lane``, ``zenoh`` or ``both``); None for services. ``why``: why zenoh is used.
            ``ways``: number of messages by transport.
    """

    kind: Text = ""
    action: Text = ""
    direction: Text = ""
    topic: Text = ""
    hub_topic: Text = ""
    type: Text = ""
    side_type: Text = ""
    state: Text = ""
    sources: Int = 0
    messages: Int | None = None
    bytes: Int | None = None
    rate: Number | None = None
    age: Number | None = None
    latency_ms: dict[Text, Number] = {}
    latency: Histogram = Histogram()
    carry: Histogram = Histogram()
    drops: dict[Text, Int] = {}
    error: Text = ""
    calls: Int | None = None
    replies: Int | None = None
    errors: Int | None = None
    abandoned: Int | None = None
    pending: Int | None = None
    priority: Text = ""
    qos: Text = ""
    way: Text | None = None
    why: Text | None = None
    ways: dict[Text, Int] = {}


class RefusedRoute(Part):
    """A topic or service that the rules allow, but that cannot be bridged."""

    kind: Text = ""
    direction: Text = ""
    topic: Text = ""
    hub_topic: Text = ""
    type: Text = ""
    reason: Text = ""
    cure: Text = ""


class PeerStatus(Part):
    """A YARP port that is connected to a port of Midspan."""

    port: Text = ""
    carrier: Text = ""
    profile: Text = ""
    profile_why: Text = ""
    generation: Text = ""
    generation_why: Text = ""
    generation_cure: Text = ""


class PortStatus(Part):
    """A YARP port of Midspan; ``direction`` is ``out``, ``in`` or ``rpc``."""

    port: Text = ""
    direction: Text = ""
    topic: Text = ""
    type: Text = ""
    carries: Text = ""
    replies: Text = ""
    profile: Text = ""
    peers: list[PeerStatus] = []


class ConnectionStatus(Part):
    """A connection of Midspan's ROS 1 node to another node.

    Attributes:
        node: the other node's name, or its XML-RPC address if the master does not list it.
        host: host and port of the other end of the connection.
        direction: ``in`` from a publisher, ``out`` to a subscriber.
        bytes: total size of all messages so far.
        dropped: number of messages that the subscriber missed, or that were too large to receive.
    """

    topic: Text = ""
    node: Text = ""
    host: Text = ""
    direction: Text = ""
    transport: Text = ""
    bytes: Int = 0
    messages: Int = 0
    dropped: Int = 0


class Lease(Part):
    """The right to bridge messages between a network and the hub."""

    active: bool | None = None
    changes: Int | None = None
    members: Int | None = None


class LaneStatus(Part):
    """The local transport to the daemon's other workers.

    Attributes:
        why: the reason if it is not in use.
        writers: number of workers from which it receives. ``readers``: number of workers that receive from it.
        dropped: number of messages that readers missed.
    """

    why: Text = ""
    writers: Int = 0
    readers: Int = 0
    dropped: Int = 0


class CycloneNodes(Part):
    """ROS 2 nodes on Cyclone DDS, and on other DDS implementations.

    Attributes:
        nodes: the nodes on Cyclone DDS.
        both: the services and actions that have servers both on Cyclone DDS and on another DDS.
        mixed: the services and actions with a client on Cyclone DDS and a server elsewhere, or vice versa; with nodes.
        foreign: if the worker itself is on Cyclone DDS, the nodes on another DDS that have a service or action.
        uncallable: these nodes' services and actions, except those of every node; the worker cannot call them.
    """

    nodes: list[Text] = []
    both: list[Text] = []
    mixed: list[Text] = []
    foreign: list[Text] = []
    uncallable: list[Text] = []


class Middleware(Part):
    """Programs on a ROS 2 network that use the same DDS and may belong to the same releases.

    Attributes:
        name: the DDS implementation, with its version if it announces one.
        release: the releases as text, "" if unknown. ``ros``: whether they are ROS 2 programs.
        hashes: whether they announce the hashes of their types.
        nodes: some of their nodes, sorted. ``count``: the number of their participants.
    """

    name: Text = ""
    release: Text = ""
    ros: bool = True
    hashes: bool = True
    nodes: list[Text] = []
    count: Int = 0

    @override
    def __str__(self) -> str:
        kind = (self.release or "unknown release") if self.ros else "not a ROS 2 program"
        return f"{self.name or 'unknown DDS'} ({kind})"


class StatusDocument(Part):
    """The common part of the status of all workers and modules.

    Attributes:
        side: the side of a worker; for a worker without a side, the worker's name.
        text: details of the state, for people.
        error: why the document is missing or incomplete, or why the worker does not work.
        uptime: time since the start, in seconds. ``cpu`` is in cores, ``rss`` in bytes.
        metrics: additional metrics for Prometheus; see `bridge.metrics.collector`.
        restarts: number of restarts according to the daemon. ``loops``: whether the worker crashes repeatedly.
        ended: how the process before the last restart ended, according to the daemon.
    """

    daemon: Text = ""
    worker: Text = ""
    side: Text | None = None
    pid: Int = 0
    zid: Text = ""
    state: Text = ""
    text: Text = ""
    error: Text = ""
    uptime: Number | None = None
    cpu: Number | None = None
    rss: Int | None = None
    routes: list[RouteStatus] = []
    ports: list[PortStatus] = []
    warnings: list[Text] = []
    metrics: dict[Text, Number] = {}
    restarts: Int | None = None
    ended: Text = ""
    loops: bool = False

    @property
    def hub_sessions(self) -> frozenset[str]:
        """The ids of the worker's sessions on the hub."""
        return frozenset({self.zid} if self.zid else ())


class RelayedStatus(Part):
    """A topic or service that a worker relays between the hub's own nodes (`bridge.routing.relay`).

    Attributes:
        kind: ``topic`` or ``service``.
        hash: the hash in the key of the publishers or clients, "" for none (Humble). ``others``: those of the
            subscriptions, or of the servers.
        senders: nodes of the publishers or clients. ``receivers``: nodes of the subscriptions or servers.
        messages: number of relayed messages or calls.
        losses: which fields are left out or changed.
    """

    kind: Text = "topic"
    topic: Text = ""
    type: Text = ""
    hash: Text = ""
    others: list[Text] = []
    senders: list[Text] = []
    receivers: list[Text] = []
    messages: Int = 0
    drops: dict[Text, Int] = {}
    error: Text = ""
    losses: Text = ""


class RelayStatus(Part):
    """What a worker relays between the hub's own nodes; ``zid`` is the session that it uses for that, "" if none."""

    zid: Text = ""
    names: list[RelayedStatus] = []


class WorkerStatus(StatusDocument):
    """The status of a worker; most fields apply only to the workers of sides.

    Attributes:
        network: the network that the side has joined, None while it is unavailable.
        standby: the daemons that bridge this network instead. ``waiting``: why nothing is bridged yet.
    """

    network: Text | None = None
    standby: Text = ""
    waiting: Text = ""
    lease: Lease = Lease()
    refused: list[RefusedRoute] = []
    cyclone: CycloneNodes | None = None
    middlewares: list[Middleware] = []
    lane: LaneStatus = LaneStatus()
    relay: RelayStatus = RelayStatus()

    @property
    @override
    def hub_sessions(self) -> frozenset[str]:
        return super().hub_sessions | ({self.relay.zid} if self.relay.zid else set())


class EndpointStatus(Part):
    """An endpoint of ``hub.open``; see `bridge.hub.security.endpoints.EndpointStatus`."""

    way: Text = ""
    endpoint: Text = ""
    state: Text = ""
    reason: Text = ""
    cure: Text = ""
    machine: Text = ""
    since: Number | None = None


class MachineStatus(Part):
    """A machine that is connected to the router; ``name`` is the name in its certificate."""

    name: Text = ""
    zid: Text = ""
    address: Text = ""
    trusted: bool = False


class RouterStatus(WorkerStatus):
    """The status of the hub's router.

    Attributes:
        sessions: number of the sessions at the router. ``members``: their ids.
        door: id of the session for other machines, "" if there is none.
        commands: the types that only trusted machines may publish, each with the last parts of topic names.
    """

    listen: Text = ""
    sessions: Int | None = None
    members: list[Text] = []
    door: Text = ""
    machines: list[MachineStatus] = []
    endpoints: list[EndpointStatus] = []
    refused_connections: Int | None = None
    commands: dict[Text, list[Text]] = {}


class ModuleStatus(StatusDocument):
    """The status of a hosted module; keys without a field are the module's own."""

    module: bool = True


class WorkerReport(Part):
    """A worker according to its daemon.

    Attributes:
        phase: a value of `bridge.daemon.query.Phase`, which began ``since`` seconds ago.
        text: the current step or state.
        still: seconds for which a starting or running worker has neither made progress nor computed.
        beat: seconds since the last heartbeat of its process, None before the first.
        ended: how the process that crashed last ended.
    """

    worker: Text = ""
    phase: Text = ""
    text: Text = ""
    since: Number | None = None
    still: Number = 0.0
    beat: Number | None = None
    pid: Int = 0
    restarts: Int = 0
    ended: Text = ""


class DaemonStatus(Part):
    """The status of the daemon.

    Attributes:
        uptime: time since the start, in seconds.
        config: path of the configuration file, None if the daemon was started without one and searches for it.
        refused: why the last reload was refused, or "".
        status: the state of all workers in one line.
        error: which values could not be read.
    """

    daemon: Text = ""
    pid: Int = 0
    uptime: Number | None = None
    config: Text | None = None
    refused: Text = ""
    status: Text = ""
    workers: list[WorkerReport] = []
    error: Text = ""


def refused_routes(document: StatusDocument) -> list[RefusedRoute]:
    """Return the routes that a worker refused; in a module's status the key ``refused`` has another meaning."""
    return document.refused if isinstance(document, WorkerStatus) else []


def routers_of(documents: Iterable[StatusDocument]) -> list[RouterStatus]:
    """Return the documents of routers."""
    return [document for document in documents if isinstance(document, RouterStatus)]


def read_status(value: object, daemon: str, worker: str, error: str = "") -> StatusDocument:
    """Parse a worker's answer; ``error`` is the reason if it did not answer with a status document.

    In that case the ``state`` of the returned document is ``failed``.
    """
    if error or not isinstance(value, Mapping):
        error = error or "the answer is not a status document"
        return WorkerStatus(daemon=daemon, worker=worker, side=worker, state="failed", error=error)
    kind: type[StatusDocument] = WorkerStatus
    if value.get("module") is True:
        kind = ModuleStatus
    elif worker == "router" or value.get("side") == "router":
        kind = RouterStatus
    document, trouble = _read(kind, {**value, "daemon": daemon, "worker": worker})
    if not trouble:
        return document
    errors = filter(None, (document.error, f"{INVALID}: {trouble}"))
    return document.model_copy(update={"error": "; ".join(errors)})


def read_connections(value: object) -> list[ConnectionStatus]:
    """Parse a worker's answer to ``connections``."""
    entries = value if isinstance(value, list) else []
    return [_read(ConnectionStatus, entry)[0] for entry in entries if isinstance(entry, Mapping)]


def read_daemon_status(value: Mapping[str, Any]) -> DaemonStatus:
    """Parse the JSON of the daemon's status."""
    status, trouble = _read(DaemonStatus, value)
    return status.model_copy(update={"error": f"invalid report: {trouble}"}) if trouble else status


def _read(kind: type[AnyPart], value: Mapping[str, Any]) -> tuple[AnyPart, str]:
    """Parse a JSON object; return it, and a text that names the omitted invalid values. Null is like a missing key."""
    try:
        return kind.model_validate(value), ""
    except ValidationError as err:
        problems = err.errors(include_url=False, include_context=False)
    valid = kind.model_validate(_without(value, [problem["loc"] for problem in problems]))
    wrong = [problem for problem in problems if problem["input"] is not None]
    lines = [f"{'.'.join(map(str, problem['loc']))}: {problem['msg']}" for problem in wrong]
    more = [f"{len(lines) - _SHOWN} more"] if len(lines) > _SHOWN else []
    return valid, "; ".join([", ".join([*lines[:_SHOWN], *more]), _HINT]) if lines else ""


def _without(value: Any, paths: Sequence[tuple[int | str, ...]]) -> Any:
    """Return a copy of a JSON value without the values at some paths."""
    deeper: dict[int | str, list[tuple[int | str, ...]]] = {}
    for first, *rest in paths:
        deeper.setdefault(first, []).append(tuple(rest))
    items = value.items() if isinstance(value, Mapping) else enumerate(value)
    valid = {
        key: _without(item, deeper[key]) if key in deeper else item
        for key, item in items
        if () not in deeper.get(key, ())
    }
    return valid if isinstance(value, Mapping) else list(valid.values())


def _plain(value: Any) -> Any:
    if isinstance(value, Part):
        return value.document()
    if isinstance(value, list) and value and isinstance(value[0], Part):
        return [part.document() for part in value]
    return value
