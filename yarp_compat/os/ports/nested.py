"""YARP's names for ROS topics and services: ``/topic+@/node``.

The grammar is that of yarp::os::NestedContact (YARP 3.5, src/libYARP_os/src/yarp/os/NestedContact.cpp): what stands
before ``@`` is the topic and its role, what stands behind it is the node, and ``~type`` at the end says the type.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

PUBLISHER = "+"
SUBSCRIBER = "-"
CLIENT = "+1"
SERVER = "-1"

LATCHED = "latched"
"""The property of a publisher's port, its own or at the name server: whoever connects gets its last message."""

_ROLES = (CLIENT, SERVER, PUBLISHER, SUBSCRIBER)


@dataclass(frozen=True)
class NestedName:
    """One name in its parts."""

    topic: str  # the topic's or service's name, ``/chatter``; empty for an ordinary port name
    node: str  # the node's name; empty where the name leaves it to the active node (``/chatter@``)
    role: str = ""  # `PUBLISHER`, `SUBSCRIBER`, `CLIENT`, `SERVER`, or empty where the port's own mode decides
    type: str = ""  # the type behind ``~``, ``std_msgs/String``; may be empty

    @classmethod
    def parse(cls, name: str) -> NestedName:
        """Take a port's name apart; an ordinary name becomes a node without a topic."""
        name, _, type_name = name.partition("~")
        topic, at, node = name.partition("@")
        if not at:
            return cls("", name, "", type_name)
        role = next((role for role in _ROLES if topic.endswith(role)), "")
        return cls(topic.removesuffix(role), node, role, type_name)

    @property
    def is_nested(self) -> bool:
        """Whether this names a topic or service of a node."""
        return bool(self.topic)

    @property
    def is_topic(self) -> bool:
        """Whether this is one end of a topic."""
        return self.is_nested and self.role in (PUBLISHER, SUBSCRIBER)

    @property
    def port(self) -> str:
        """The name under which the port is registered: ``/chatter+@/node``."""
        return f"{self.topic}{self.role}@{self.node}" if self.is_nested else self.node

    def with_role(self, role: str) -> NestedName:
        """The same name with this role, if it had none."""
        return self if self.role else replace(self, role=role)

    def with_node(self, node: str) -> NestedName:
        """The same name under this node, if it had none."""
        return self if self.node else replace(self, node=node)
