"""Our one DDS participant and node, and the endpoints that are made on it.

rclpy's own ``Node`` puts a parameter-event publisher and more on the graph and needs an executor; only its inner
module is used here, the one that rclpy's classes stand on (``rclpy.impl.implementation_singleton``, Jazzy).
"""

from __future__ import annotations

import contextlib
import re
import threading
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rclpy.context import Context
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.qos import QoSProfile

from bridge.hub.wire.qos import Durability, History, Qos, Reliability
from bridge.messages.errors import MessageTypeError

_rclpy: Any = rclpy_implementation

_DISCOVERY = "ros_discovery_info"
"""The DDS topic on which every ROS participant tells its nodes: its writers are the participants."""


@contextlib.contextmanager
def _explained(topic: str, message_class: Any) -> Iterator[None]:
    """Name what was refused: rcl's error mentions types and allocators only."""
    try:
        yield
    except (_rclpy.RCLError, ValueError) as err:
        raise MessageTypeError(
            f"ROS 2 does not take {topic} as {message_class.type_name}: {err}",
            "rename it by a rule, if it does not come right by itself in a moment",
        ) from err


class Participant:
    """A node with nothing of its own on the graph; making and destroying endpoints is safe from any thread."""

    def __init__(self, name: str, domain: int) -> None:
        self._lock = threading.Lock()
        self._context = Context()
        self._context.init(args=[], initialize_logging=False, domain_id=domain)
        self._node = _rclpy.Node(name, "", self._context.handle, [], False, False)

    @property
    def pointer(self) -> int:
        """``rcl_node_t *``."""
        return int(self._node.pointer)

    def topics(self) -> list[str]:
        """Names of all ROS topics on the graph."""
        return [name for name, _types in _rclpy.rclpy_get_topic_names_and_types(self._node, False)]

    def writers(self, topic: str, *, dds: bool = False) -> Sequence[Mapping[str, Any]]:
        """The publishers of a ROS topic, or the writers of a DDS topic, in rclpy's words."""
        found: list[Mapping[str, Any]] = _rclpy.rclpy_get_publishers_info_by_topic(self._node, topic, dds)
        return found

    def readers(self, topic: str, *, dds: bool = False) -> Sequence[Mapping[str, Any]]:
        """The subscriptions of a ROS topic, or the readers of a DDS topic, in rclpy's words."""
        found: list[Mapping[str, Any]] = _rclpy.rclpy_get_subscriptions_info_by_topic(self._node, topic, dds)
        return found

    def participants(self) -> list[bytes]:
        """GIDs of one endpoint of each ROS participant, ours included."""
        return [bytes(info["endpoint_gid"]) for info in self.writers(_DISCOVERY, dds=True)]

    def make_node(self, name: str) -> Any:
        """Another node of this participant, with nothing of its own; ``name`` is the full one."""
        namespace, _, base = name.rpartition("/")
        with self._lock:
            return _rclpy.Node(base, namespace, self._context.handle, [], False, False)

    def make_writer(self, message_class: Any, topic: str, qos: Qos) -> Any:
        """A DDS writer; it has ``pointer``, ``rcl_publisher_t *``."""
        with self._lock, _explained(topic, message_class):
            return _rclpy.Publisher(self._node, message_class, topic, to_rclpy(qos))

    def make_reader(self, message_class: Any, topic: str, qos: Qos) -> Any:
        """A DDS reader; it has ``pointer``, ``rcl_subscription_t *``."""
        with self._lock, _explained(topic, message_class):
            return _rclpy.Subscription(self._node, message_class, topic, to_rclpy(qos))

    def service_topics(self) -> list[tuple[str, str]]:
        """All services on the graph: each one's name and its requests' DDS topic."""
        raw = _rclpy.rclpy_get_topic_names_and_types(self._node, True)
        return [(service, topic) for topic, _types in raw if (service := service_of(topic))]

    def make_client(self, service_class: Any, service: str, qos: Qos) -> Any:
        """A client; it has ``pointer``, ``rcl_client_t *``."""
        with self._lock, _explained(service, service_class):
            return _rclpy.Client(self._node, service_class, service, to_rclpy(qos))

    def make_server(self, service_class: Any, service: str, qos: Qos) -> Any:
        """A server; it has ``pointer``, ``rcl_service_t *``."""
        with self._lock, _explained(service, service_class):
            return _rclpy.Service(self._node, service_class, service, to_rclpy(qos))

    def make_guard_condition(self) -> Any:
        """A guard condition of ours."""
        return _rclpy.GuardCondition(self._context.handle)

    def make_wait_set(self, guard_conditions: int, subscriptions: int = 0, clients: int = 0, services: int = 0) -> Any:
        """A wait set with room for so many."""
        return _rclpy.WaitSet(subscriptions, guard_conditions, 0, clients, services, 0, self._context.handle)

    def destroy(self, entity: Any) -> None:
        """Give an endpoint or a guard condition back."""
        with self._lock:
            entity.destroy_when_not_in_use()

    def close(self) -> None:
        """Leave the network."""
        self.destroy(self._node)
        self._context.try_shutdown()
        self._context.destroy()


# -- quality of service ------------------------------------------------------------------------------------------------
# DDS announces no history, so the depth of a remote writer is unknown (Fast DDS reports history ``UNKNOWN``, depth 0).
# Our enumerations carry rmw's numbers, as rclpy's inner module does.

UNKNOWN_DEPTH = 10
"""Depth taken for a volatile remote endpoint; a latched one counts as 1, its last message."""

_LONGEST_NS = 2**62
"""DDS's infinite durations come as the largest number; no finite one comes near."""


def from_rclpy(profile: Mapping[str, Any]) -> Qos:
    """A remote endpoint's QoS from discovery."""
    latched = int(profile["durability"]) == Durability.TRANSIENT_LOCAL
    return Qos(
        Reliability.BEST_EFFORT if int(profile["reliability"]) == Reliability.BEST_EFFORT else Reliability.RELIABLE,
        Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE,
        History.KEEP_ALL if int(profile["history"]) == History.KEEP_ALL else History.KEEP_LAST,
        int(profile["depth"]) or (1 if latched else UNKNOWN_DEPTH),
        _finite(profile["deadline"].nanoseconds),
        _finite(profile["lifespan"].nanoseconds),
    )


def _finite(nanoseconds: int) -> int | None:
    return nanoseconds if 0 < nanoseconds < _LONGEST_NS else None


def to_rclpy(qos: Qos) -> Any:
    """The inner profile of an endpoint of our own: always a bounded history, never a deadline that misses a peer."""
    profile: Any = QoSProfile
    return profile(
        reliability=int(qos.reliability),
        durability=int(qos.durability),
        history=int(History.KEEP_LAST),
        depth=max(1, qos.depth),
    ).get_c_qos_profile()


def mismatch(offered: Qos, requested: Qos) -> str:
    """Why a reader and a writer do not match, "" where they do (DDS 1.4, section 2.2.3, request against offer)."""
    reasons = []
    if offered.reliability is Reliability.BEST_EFFORT and requested.reliability is Reliability.RELIABLE:
        reasons.append("best effort is offered, reliable is asked for")
    if offered.durability is Durability.VOLATILE and requested.durability is Durability.TRANSIENT_LOCAL:
        reasons.append("volatile is offered, transient local is asked for")
    if requested.deadline_ns is not None and (offered.deadline_ns or _LONGEST_NS) > requested.deadline_ns:
        reasons.append("a longer deadline is offered than is asked for")
    return " and ".join(reasons)


SERVICE = Qos(depth=20_000)
"""Of our clients and servers: a peer sees ROS 2's own profile for services, and we have room for more calls than
may be under way. It costs no memory before it is used."""


# -- names of services in DDS ------------------------------------------------------------------------------------------
# From rmw_dds_common and rmw_fastrtps (Jazzy): ``/add`` of ``example/srv/Add`` has the topics ``rq/addRequest`` and
# ``rr/addReply`` with the types ``example::srv::dds_::Add_Request_`` and ``example::srv::dds_::Add_Response_``.

_REQUEST = re.compile(r"^rq(/.+)Request$")
_TYPE = re.compile(r"^(\w+)::(srv|action)::dds_::(\w+)_Request_$")


def request_topic(service: str) -> str:
    """The topic that servers read and clients write."""
    return f"rq{service}Request"


def reply_topic(service: str) -> str:
    """The topic that servers write and clients read."""
    return f"rr{service}Reply"


def service_of(topic: str) -> str:
    """The service of a request topic, "" for any other topic."""
    match = _REQUEST.match(topic)
    return match[1] if match else ""


def service_type(dds_type: str) -> str:
    """``package/srv/Name`` of a request's type in DDS; any other type unchanged."""
    match = _TYPE.match(dds_type)
    return f"{match[1]}/{match[2]}/{match[3]}" if match else dds_type
