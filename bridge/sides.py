"""The sides that Midspan joins, each told by one `Side`; whatever lists sides reads them here.

A side of one's own is a package with a `Side` in it, named by an entry point of the group ``midspan.sides`` or by
``$MIDSPAN_SIDES`` (``package.module:NAME,...``); see docs/develop/add_a_side.md.
"""

from __future__ import annotations

import functools
import importlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Any

GROUP = "midspan.sides"
VARIABLE = "MIDSPAN_SIDES"

Private = tuple[tuple[str, str], ...]
"""Regular expressions of names that are private to a side, each with the reason, for people."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Side:
    """A side: what the daemon, the configuration, the routing, the command line and the doctor know of it.

    What is written ``package.module:name`` is imported where it is used, so that no process loads another side's code.

    Attributes:
        name: of its worker, its section in the configuration, and ``Edge.side``.
        label: what people call it.
        edges: ``package.module:name`` of what makes its edge, called with the configuration, the registry of types and
            the state folder; where it has `networks`, of what makes a dictionary of edges by name.
        section: ``package.module:name`` of its section's model; "" for the sides whose section `Config` has.
        environment: module with ``available(config)``, ``worker_environment(config, environ)`` and, where switching it
            on depends on more than its key ``enabled``, ``enabled(config)``; "" where it needs nothing.
        loading: what its worker does while the edge is imported, for people.
        private_topics: topics that never cross, since they mean something on their side alone.
        private_services: the same, by the services' ROS 2 types.
        node_parameters: whether its nodes have parameters of their own, as ROS 2's do.
        checks: ``package.module:name`` of the doctor's checks.
        networks: the networks that it joins, where these are several of different kinds.
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
        loading="importing rospy",
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


def imported(place: str) -> Any:
    """What ``package.module:name`` names."""
    module, _, name = place.partition(":")
    return getattr(importlib.import_module(module), name)


@functools.cache
def own_sides() -> tuple[Side, ...]:
    """The sides that do not come with Midspan.

    Raises `RuntimeError`: one cannot be imported, is no `Side`, or has the name of another one.
    """
    places = [point.value for point in entry_points(group=GROUP)]
    places += [place.strip() for place in os.environ.get(VARIABLE, "").split(",") if place.strip()]
    found: dict[str, Side] = {}
    for place in dict.fromkeys(places):
        try:
            side = imported(place)
        except (ImportError, AttributeError, ValueError) as err:
            msg = f"the side {place} cannot be imported: {err}"
            raise RuntimeError(msg) from err
        if not isinstance(side, Side) or not side.section or not side.edges:
            msg = f"the side {place} is no bridge.sides.Side with 'section' and 'edges'"
            raise RuntimeError(msg)
        if side.name in found or side.name in {each.name for each in BUILT_IN}:
            msg = f"the side {place}: there is already a side named {side.name}"
            raise RuntimeError(msg)
        found[side.name] = side
    return tuple(found.values())


def all_sides() -> tuple[Side, ...]:
    """All sides, in the order in which their workers start."""
    return (*BUILT_IN, *own_sides())


@functools.cache
def all_networks() -> dict[str, Side]:
    """All names that an edge or a rule may give a side, the networks of a side with several after all sides."""
    sides = all_sides()
    inner: Iterator[Side] = (network for side in sides for network in side.networks)
    return {side.name: side for side in (*sides, *inner)}


def label(name: str) -> str:
    """What people call a side, "" where the name is no side's."""
    side = all_networks().get(name)
    return "" if side is None else side.label
