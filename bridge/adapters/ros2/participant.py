"""The worker's DDS participant and node, and factories for its endpoints.

rclpy's ``Node`` adds a parameter-event publisher and more to the graph and needs an executor; only the inner module is
used here, on which rclpy's classes are built (``rclpy.impl.implementation_singleton``, Jazzy).
"""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.qos import QoSProfile

from bridge.adapters.ros2 import security
from bridge.adapters.ros2.environment import FAST_DDS, RMW
from bridge.adapters.ros2.graph.marks import ENCLAVE, PRESENCE, Marks, NodeMarks, PresenceMarks
from bridge.adapters.ros2.refusals import Refusals
from bridge.adapters.ros2.releases import current
from bridge.adapters.ros2.rmw import RmwSubscription
from bridge.hub.wire.qos import Durability, History, Qos, Reliability

_rclpy: Any = rclpy_implementation

_DISCOVERY = "ros_discovery_info"
"""The DDS topic on which every ROS participant announces its nodes: its writers are the participants."""


class Participant:
    """A node without default endpoints; endpoints can be created and destroyed from any thread.

    Raises `RuntimeError` if rclpy uses a middleware other than ``rmw``, or does not join a secured domain.

    Attributes:
        marks: who created the endpoints on the network.
        resolve: returns a publisher's GUID for the GID in a message; None if they are the same.
    """

    rmw: ClassVar[str] = FAST_DDS
    marks: Marks
    resolve: Callable[[bytes], bytes] | None = None

    def __init__(self, name: str, domain: int) -> None:
        self._lock = threading.Lock()
        self._refusals = Refusals()
        self._context = Context()
        secured = security.is_enabled(os.environ)
        # a secured domain, which only a participant on Fast DDS joins, has its own enclaves
        arguments = [] if secured else ["--ros-args", "--enclave", ENCLAVE]
        self._context.init(args=arguments, initialize_logging=False, domain_id=domain)
        self._check_rmw()
        try:
            self._node = _rclpy.Node(name, "", self._context.handle, [], False, False, *current().node_arguments)
        except _rclpy.RCLError as err:
            if not secured:
                raise
            raise RuntimeError(security.rejection(os.environ, domain)) from err
        self.marks = PresenceMarks(self._announced) if secured else NodeMarks(self._enclaves)

    def _check_rmw(self) -> None:
        used = _rclpy.rclpy_get_rmw_implementation_identifier()
        if used != self.rmw:
            raise RuntimeError(f"rclpy uses {used}, although {RMW} is {os.environ.get(RMW)}; check the sourced ROS 2")

    def _enclaves(self) -> Mapping[str, set[str]]:
        """Return the enclaves of all nodes by full name."""
        enclaves: dict[str, set[str]] = {}
        for name, namespace, enclave in self._node.get_node_names_and_namespaces_with_enclaves():
            enclaves.setdefault(f"{namespace.rstrip('/')}/{name}", set()).add(enclave)
        return enclaves

    def _announced(self) -> list[bytes]:
        """Return the GUIDs of all writers of the presence topic."""
        return [bytes(info["endpoint_gid"]) for info in self.writers(PRESENCE)]

    @property
    def pointer(self) -> int:
        """The address of the ``rcl_node_t``."""
        return int(self._node.pointer)

    def topics(self) -> list[str]:
        """Return the names of all ROS topics on the graph."""
        return [name for name, _types in _rclpy.rclpy_get_topic_names_and_types(self._node, False)]

    def writers(self, topic: str, *, dds: bool = False) -> Sequence[Mapping[str, Any]]:
        """Return the publishers of a ROS topic, or the writers of a DDS topic, as rclpy's dictionaries."""
        infos: list[Mapping[str, Any]] = _rclpy.rclpy_get_publishers_info_by_topic(self._node, topic, dds)
        return infos

    def readers(self, topic: str, *, dds: bool = False) -> Sequence[Mapping[str, Any]]:
        """Return the subscriptions of a ROS topic, or the readers of a DDS topic, as rclpy's dictionaries."""
        infos: list[Mapping[str, Any]] = _rclpy.rclpy_get_subscriptions_info_by_topic(self._node, topic, dds)
        return infos

    def participants(self) -> list[bytes]:
        """Return the GID of one endpoint of each ROS participant, including this one."""
        return [bytes(info["endpoint_gid"]) for info in self.writers(_DISCOVERY, dds=True)]

    def make_node(self, name: str) -> Any:
        """Create another node of this participant, without default endpoints; ``name`` is fully qualified."""
        namespace, _, base = name.rpartition("/")
        with self._lock:
            return _rclpy.Node(base, namespace, self._context.handle, [], False, False, *current().node_arguments)

    def make_writer(self, message_class: Any, topic: str, qos: Qos) -> Any:
        """Create a DDS writer; its ``pointer`` is ``rcl_publisher_t *``."""
        with self._lock, self._refusals.explained("publisher", topic, message_class.type_name):
            return _rclpy.Publisher(self._node, message_class, topic, to_rclpy(qos))

    def make_reader(self, message_class: Any, topic: str, qos: Qos) -> Any:
        """Create a DDS reader; its ``pointer`` is ``rcl_subscription_t *``."""
        with self._lock, self._refusals.explained("subscription", topic, message_class.type_name):
            return _rclpy.Subscription(self._node, message_class, topic, to_rclpy(qos))

    def service_topics(self) -> list[tuple[str, str]]:
        """Return the name and the DDS request topic of each service on the graph."""
        raw = _rclpy.rclpy_get_topic_names_and_types(self._node, True)
        return [(service, topic) for topic, _types in raw if (service := service_of(topic))]

    def service_types(self) -> set[str]:
        """Return the types of all services on the graph."""
        raw = _rclpy.rclpy_get_topic_names_and_types(self._node, True)
        return {service_type(name) for topic, types in raw if service_of(topic) for name in types}

    def make_client(self, service_class: Any, service: str, qos: Qos) -> Any:
        """Create a client; its ``pointer`` is ``rcl_client_t *``."""
        with self._lock, self._refusals.explained("client", service, service_class.type_name):
            return _rclpy.Client(self._node, service_class, service, to_rclpy(qos))

    def make_raw_reader(self, support: int, dds_topic: str) -> RmwSubscription:
        """Create a reader of a service's requests or replies; ``support`` is the address of their type support."""
        with self._lock:
            return RmwSubscription(self.pointer, support, dds_topic, SERVICE.depth)

    def make_server(self, service_class: Any, service: str, qos: Qos) -> Any:
        """Create a server; its ``pointer`` is ``rcl_service_t *``."""
        with self._lock, self._refusals.explained("server", service, service_class.type_name):
            return _rclpy.Service(self._node, service_class, service, to_rclpy(qos))

    def make_guard_condition(self) -> Any:
        """Create a guard condition in this participant's context."""
        return _rclpy.GuardCondition(self._context.handle)

    def make_wait_set(self, guard_conditions: int, subscriptions: int = 0) -> Any:
        """Create a wait set with these capacities."""
        return _rclpy.WaitSet(subscriptions, guard_conditions, 0, 0, 0, 0, self._context.handle)

    def destroy(self, entity: Any) -> None:
        """Destroy an endpoint or a guard condition once it is no longer in use."""
        with self._lock:
            entity.destroy_when_not_in_use()

    def close(self) -> None:
        """Leave the network, and release the context."""
        self.destroy(self._node)
        self._context.try_shutdown()
        self._context.destroy()


# -- quality of service ------------------------------------------------------------------------------------------------
# DDS announces no history, so the depth of a remote writer is unknown (Fast DDS reports history ``UNKNOWN``, depth 0).
# Midspan's enumerations have rmw's numbers, like rclpy's inner module.

UNKNOWN_DEPTH = 10
"""Assumed depth of a volatile remote endpoint; for a latched endpoint 1 is assumed, its last message."""

_MANUAL_BY_TOPIC = 3
"""rmw's number of the liveliness policy (rmw/types.h)."""

_LONGEST_NS = 2**62
"""Longer durations count as infinite; for infinity DDS reports the largest number, far above any finite duration."""


def from_rclpy(profile: Mapping[str, Any]) -> Qos:
    """Return a remote endpoint's QoS from discovery."""
    latched = int(profile["durability"]) == Durability.TRANSIENT_LOCAL
    return Qos(
        Reliability.BEST_EFFORT if int(profile["reliability"]) == Reliability.BEST_EFFORT else Reliability.RELIABLE,
        Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE,
        History.KEEP_ALL if int(profile["history"]) == History.KEEP_ALL else History.KEEP_LAST,
        int(profile["depth"]) or (1 if latched else UNKNOWN_DEPTH),
        _finite(profile["deadline"].nanoseconds),
        _finite(profile["lifespan"].nanoseconds),
        _finite(profile["liveliness_lease_duration"].nanoseconds),
        int(profile["liveliness"]) == _MANUAL_BY_TOPIC,
    )


def _finite(nanoseconds: int) -> int | None:
    return nanoseconds if 0 < nanoseconds < _LONGEST_NS else None


def to_rclpy(qos: Qos) -> Any:
    """Return the inner profile for an endpoint of Midspan: a bounded history, and no deadline that prevents a match."""
    profile: Any = QoSProfile
    lifespan = {} if qos.lifespan_ns is None else {"lifespan": Duration(nanoseconds=qos.lifespan_ns)}
    return profile(
        reliability=int(qos.reliability),
        durability=int(qos.durability),
        history=int(History.KEEP_LAST),
        depth=max(1, qos.depth),
        **lifespan,
    ).get_c_qos_profile()


def mismatch(offered: Qos, requested: Qos) -> str:
    """Return why a reader and a writer do not match, "" if they do (DDS 1.4, section 2.2.3, request against offer)."""
    reasons = []
    if offered.reliability is Reliability.BEST_EFFORT and requested.reliability is Reliability.RELIABLE:
        reasons.append("best effort is offered, reliable is requested")
    if offered.durability is Durability.VOLATILE and requested.durability is Durability.TRANSIENT_LOCAL:
        reasons.append("volatile is offered, transient local is requested")
    if requested.deadline_ns is not None and (offered.deadline_ns or _LONGEST_NS) > requested.deadline_ns:
        reasons.append("the offered deadline is longer than the requested one")
    if requested.manual and not offered.manual:
        reasons.append("automatic liveliness is offered, manual by topic is requested")
    if requested.lease_ns is not None and (offered.lease_ns or _LONGEST_NS) > requested.lease_ns:
        reasons.append("the offered lease of the liveliness is longer than the requested one")
    return " and ".join(reasons)


SERVICE = Qos(depth=20_000)
"""QoS of Midspan's clients and servers: peers see ROS 2's profile for services, and the depth exceeds the number of
concurrent calls. It costs no memory before it is used."""


# -- names of services in DDS ------------------------------------------------------------------------------------------
# From rmw_dds_common and rmw_fastrtps (Jazzy): ``/add`` of ``example/srv/Add`` has the topics ``rq/addRequest`` and
# ``rr/addReply`` with the types ``example::srv::dds_::Add_Request_`` and ``example::srv::dds_::Add_Response_``.

_REQUEST = re.compile(r"^rq(/.+)Request$")
_TYPE = re.compile(r"^(\w+)::(srv|action)::dds_::(\w+)_Request_$")


def request_topic(service: str) -> str:
    """Return the DDS topic that servers read and clients write."""
    return f"rq{service}Request"


def reply_topic(service: str) -> str:
    """Return the DDS topic that servers write and clients read."""
    return f"rr{service}Reply"


def service_of(topic: str) -> str:
    """Return the service of a request topic, "" for any other topic."""
    match = _REQUEST.match(topic)
    return match[1] if match else ""


def service_type(dds_type: str) -> str:
    """Return ``package/srv/Name`` for a request's DDS type; any other type unchanged."""
    match = _TYPE.match(dds_type)
    return f"{match[1]}/{match[2]}/{match[3]}" if match else dds_type
