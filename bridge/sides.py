"""The sides that Midspan joins, each described by one `Side`.

To add a side, write a package with a `Side`, and register it as `bridge.registration` describes; see
docs/develop/add_a_side.md.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass

from bridge.registration import registered

Private = tuple[tuple[str, str], ...]
"""Regular expressions for names that are private to a side, each with the reason, for people."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Side:
    """Describes a side to the daemon, the configuration, the routing, the command line and the doctor.

    Names like ``package.module:name`` are imported only when used, so that no process loads another side's code.

    Attributes:
        name: name of its worker and of its section in the configuration, and the value of ``Edge.side``.
        label: its name for people.
        edges: ``package.module:name`` of the factory of its edge, called with the configuration, the registry of types
            and the state folder; with `networks` it returns a dictionary of edges by name.
        section: ``package.module:name`` of its section's model; "" for the sides whose section is part of `Config`.
        environment: module with ``available(config)`` and ``worker_environment(config, environ)``; also with
            ``enabled(config)`` if more than the key ``enabled`` decides that. "" if the side needs no module.
        loading: description of the worker's step while it imports the edge, for people.
        private_topics: topics that are not bridged by default, because they have a meaning only on their side.
        private_services: the same for services, by their ROS 2 types.
        node_parameters: whether each of its nodes has its own parameters, as in ROS 2.
        checks: ``package.module:name`` of the doctor's checks.
        networks: the kinds of networks that it joins, if there are several.
    """

    name: str
    label: str
    edges: str = ""
    section: str = ""
    environment: str = ""
    loading: str = ""
    private_topics: Private = ()
    private_services: Private = ()
    node_parameters: bool = False
    checks: str = ""
    networks: tuple[Side, ...] = ()


_ROS1_TOPICS: Private = (
    (r"/rosout(_agg)?", "ROS 1's own log"),
    (r"/statistics", "ROS 1's connection statistics"),
    (r".*/parameter_(descriptions|updates)", "dynamic_reconfigure's own"),
    (r".*/bond", "bond, a node's private life sign"),
)
_ROS2_TOPICS: Private = (
    (r"/rosout", "ROS 2's own log"),
    (r"/parameter_events", "ROS 2's parameter events"),
    (r"/ros_discovery_info", "ROS 2's discovery"),
    (r".*/transition_event", "a lifecycle node's own"),
    (r".*/_service_event", "service introspection"),
    (r".*/bond", "bond, a node's private life sign"),
)
_ROS1_SERVICES: Private = (
    (r"roscpp/srv/\w+", "a node's own loggers"),
    (r"dynamic_reconfigure/srv/\w+", "dynamic_reconfigure's own"),
    (r"nodelet/srv/\w+", "a nodelet manager's own"),
)
_ROS2_SERVICES: Private = (
    (r"rcl_interfaces/srv/\w+", "a node's own parameters and loggers"),
    (r"type_description_interfaces/srv/\w+", "a node's own type descriptions"),
    (r"lifecycle_msgs/srv/\w+", "a lifecycle node's own"),
    (r"composition_interfaces/srv/\w+", "a component container's own"),
)

BUILT_IN = (
    Side(
        name="ros1",
        label="ROS 1",
        edges="bridge.adapters.ros1.edge:Ros1Edge",
        environment="bridge.adapters.ros1.environment",
        private_topics=_ROS1_TOPICS,
        private_services=_ROS1_SERVICES,
        checks="bridge.doctor.checks.ros1:CHECKS",
    ),
    Side(
        name="ros2",
        label="ROS 2",
        edges="bridge.adapters.ros2.edge:Ros2Edge",
        environment="bridge.adapters.ros2.environment",
        loading="importing rclpy",
        private_topics=_ROS2_TOPICS,
        private_services=_ROS2_SERVICES,
        node_parameters=True,
        checks="bridge.doctor.checks.ros2:CHECKS",
    ),
    Side(
        name="yarp",
        label="YARP",
        edges="bridge.adapters.yarp.edge:YarpEdge",
        environment="bridge.adapters.yarp.environment",
        checks="bridge.doctor.checks.yarp:CHECKS",
    ),
    Side(
        name="zenoh",
        label="zenoh",
        edges="bridge.adapters.zenoh.dialects:make_edges",
        environment="bridge.adapters.zenoh.environment",
        private_topics=_ROS2_TOPICS,
        private_services=_ROS2_SERVICES,
        networks=(
            Side(
                name="zenoh_ros2dds",
                label="ros2dds keys",
                private_topics=_ROS2_TOPICS,
                private_services=_ROS2_SERVICES,
                node_parameters=True,
            ),
            Side(
                name="zenoh_ros1",
                label="ros1 keys",
                private_topics=_ROS1_TOPICS,
                private_services=_ROS1_SERVICES,
            ),
            Side(name="zenoh_json", label="JSON keys"),
        ),
    ),
)


@functools.cache
def own_sides() -> tuple[Side, ...]:
    """Return the sides that do not ship with Midspan.

    Raises `RuntimeError` if a side cannot be imported, is incomplete, or has the same name as another.
    """
    sides = registered(Side, "side", (side.name for side in BUILT_IN))
    for side in sides:
        if not side.section or not side.edges:
            raise RuntimeError(f"the side {side.name} needs 'section' and 'edges'")
    return sides


def all_sides() -> tuple[Side, ...]:
    """Return all sides, in the order in which their workers start."""
    return (*BUILT_IN, *own_sides())


@functools.cache
def all_networks() -> dict[str, Side]:
    """Return the sides by all names that edges and rules may use; the networks of sides come last."""
    sides = all_sides()
    inner: Iterator[Side] = (network for side in sides for network in side.networks)
    return {side.name: side for side in (*sides, *inner)}


def label(name: str) -> str:
    """Return a side's name for people, "" for an unknown name."""
    side = all_networks().get(name)
    return "" if side is None else side.label
