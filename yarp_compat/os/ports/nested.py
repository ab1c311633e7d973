"""YARP's names for ROS topics and services: ``/topic+@/node``.

The grammar is that of yarp::os::NestedContact (YARP 3.5, src/libYARP_os/src/yarp/os/NestedContact.cpp): the topic and
its role precede ``@``, the node follows it, and ``~type`` at the end gives the type.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

PUBLISHER = "+"
SUBSCRIBER = "-"
CLIENT = "+1"
SERVER = "-1"

LATCHED = "latched"
"""Name of the property that marks publishers that send late joiners their last message: on the port, and at the name
server."""

_ROLES = (CLIENT, SERVER, PUBLISHER, SUBSCRIBER)


@dataclass(frozen=True)
class NestedName:
    """The parts of a name."""

    topic: str  # the topic's or service's name, ``/chatter``; empty for an ordinary port name
    node: str  # the node's name; empty for the active node (``/chatter@``)
    role: str = ""  # `PUBLISHER`, `SUBSCRIBER`, `CLIENT`, `SERVER`, or empty: the port's mode decides
    type: str = ""  # the type after ``~``, ``std_msgs/String``; may be empty

    @classmethod
    def parse(cls, name: str) -> NestedName:
        """Split a port's name; an ordinary name becomes a node without a topic."""
        name, _, type_name = name.partition("~")
        topic, at, node = name.partition("@")
        if not at:
            return cls("", name, "", type_name)
        role = next((role for role in _ROLES if topic.endswith(role)), "")
        return cls(topic.removesuffix(role), node, role, type_name)

    @property
    def is_nested(self) -> bool:
        """Whether this is the name of a topic or service of a node."""
        return bool(self.topic)

    @property
    def is_topic(self) -> bool:
        """Whether this is one end of a topic."""
        return self.is_nested and self.role in (PUBLISHER, SUBSCRIBER)

    @property
    def port(self) -> str:
        """The registered name of the port: ``/chatter+@/node``."""
        return f"{self.topic}{self.role}@{self.node}" if self.is_nested else self.node

    def with_role(self, role: str) -> NestedName:
        """Return the name with this role, unless it has one."""
        return self if self.role else replace(self, role=role)

    def with_node(self, node: str) -> NestedName:
        """Return the name with this node, unless it has one."""
        return self if self.node else replace(self, node=node)
