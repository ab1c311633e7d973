"""What the bridge's own ports are called."""

from __future__ import annotations

from dataclasses import dataclass

PRESENCE = "/midspan/daemon/"
"""Where every worker on a YARP network has a port by which the others know it."""

OWNER = "midspan_owner"
"""The property at the name server that every port of Midspan's has: the id of the worker that opened it."""

DAEMON = "midspan"
"""The property that names the daemon: on its port of presence, and on ports of topics that it carries."""


@dataclass(frozen=True, slots=True)
class PortNames:
    """The scheme of the configuration; ``{topic}`` stands for the topic's name.

    Attributes:
        daemon: the daemon's name, for ports whose name another daemon has.
    """

    output_scheme: str
    input_scheme: str
    rpc_scheme: str
    daemon: str

    def may_be(self, name: str) -> bool:
        """Whether the bridge might have called a port so."""
        return any(
            name.startswith(scheme.partition("{topic}")[0]) and name.endswith(scheme.partition("{topic}")[2])
            for scheme in (self.output_scheme, self.input_scheme, self.rpc_scheme)
        )

    def spare(self, name: str) -> str:
        """Another name for a port, where a daemon on another hub has a port of the same topic."""
        for scheme in (self.output_scheme, self.input_scheme, self.rpc_scheme):
            before, _, behind = scheme.partition("{topic}")
            if name.startswith(before) and name.endswith(behind):
                return f"{before}/{self.daemon}{name[len(before) :]}"
        return name

    def output(self, topic: str) -> str:
        """The port that writes a topic's messages."""
        return self.output_scheme.replace("{topic}", topic)

    def input(self, topic: str) -> str:
        """The port by which anybody writes to a topic."""
        return self.input_scheme.replace("{topic}", topic)

    def rpc(self, service: str) -> str:
        """The port that serves a service."""
        return self.rpc_scheme.replace("{topic}", service)

    def output_to(self, topic: str, port: str) -> str:
        """The port that writes a topic's messages to one port of a rule, in a content of its own."""
        return self.output(f"{topic}/to{port}")

    def input_from(self, topic: str, port: str) -> str:
        """The port that hears one port of a rule."""
        return self.input(f"{topic}/from{port}")

    def output_to_nodes(self, topic: str) -> str:
        """The port for subscribers that were opened as ``/topic@/node``."""
        return self.output(f"{topic}/nodes")

    def input_from_nodes(self, topic: str) -> str:
        """The port that hears publishers that were opened as ``/topic@/node``."""
        return self.input(f"{topic}/nodes")
