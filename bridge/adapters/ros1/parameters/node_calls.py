"""Calls of a ROS 2 node's parameter services, and warnings about a node that does not reply or is not the only one."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Mapping
from typing import Any

from bridge.adapters.ros1.parameters.store import ParameterContext, codecs
from bridge.config.sections.routing import ParameterRule
from bridge.hub.endpoints.calls import Abandon, CallError, nothing
from bridge.messages.errors import ConversionError

_log = logging.getLogger(__name__)

_USED = ("list_parameters", "get_parameters", "get_parameter_types", "describe_parameters", "set_parameters")

ANSWER_SECONDS = 5.0
"""Seconds after which a call without a reply is reported."""

REPEAT_SECONDS = 30.0
"""Seconds after which a call without a reply is abandoned, because the reply may be lost."""

NAMESAKE_SECONDS = 30.0
"""Seconds after which nodes of one name are reported: a killed node may be listed beside its successor for a while."""


class NodeCalls:
    """The services of one node, called one at a time on the parameters' thread.

    Args:
        wake: called on any thread when the node's services appear or disappear.
        failed: called on the parameters' thread with the reason for which a call failed.

    Attributes:
        silence: a warning about a late reply, or "".
    """

    def __init__(
        self, rule: ParameterRule, context: ParameterContext, wake: Callable[[], None], failed: Callable[[str], None]
    ) -> None:
        self._rule = rule
        self._hub, self._submit, self._wake, self._failed = context.hub, context.submit, wake, failed
        self._codecs = {service: codec for service, codec in codecs(context.registry).items() if service in _USED}
        self._clients: dict[str, Any] = {}
        self._number = 0  # of the last call; replies to earlier ones are ignored
        self._abandon: Abandon = nothing
        self._asked = math.inf  # when the call under way began, in monotonic seconds
        self.silence = ""

    @property
    def present(self) -> bool:
        """Whether all used services of the node are on the hub."""
        return bool(self._clients) and all(client.ready for client in self._clients.values())

    @property
    def busy(self) -> bool:
        """Whether a call is under way."""
        return self._asked < math.inf

    def open(self) -> None:
        """Create the clients, unless they exist."""
        if not self._clients:
            for service, codec in self._codecs.items():
                name = f"{self._rule.node}/{service}"
                self._clients[service] = self._hub.client(name, codec.type.name, codec.type.type_id, self._wake)

    def call(self, service: str, request: Mapping[str, Any], then: Callable[[dict[str, Any]], None]) -> None:
        """Call a service; ``then`` receives the response on the parameters' thread, and may make the next call."""
        client, codec = self._clients[service], self._codecs[service]
        self._number = number = self._number + 1
        self._asked = time.monotonic()

        def respond(result: bytes | CallError) -> None:
            self._submit(lambda: accept(result), None)

        def accept(result: bytes | CallError) -> None:
            if self._number != number:
                return  # abandoned meanwhile
            self._asked = math.inf
            silence, self.silence = self.silence, ""
            if isinstance(result, CallError):
                self._failed(str(result))
                return
            if silence:
                _log.info("parameters in %s are shared again: %s replies", self._rule.ros1, self._rule.node)
            try:
                then(codec.response_value(result))
            except ConversionError as err:
                self._failed(str(err))

        self._abandon = client.call(codec.request(request), respond)

    def check_reply(self) -> None:
        """Report a call whose reply is late, and at last abandon it."""
        passed = time.monotonic() - self._asked
        if passed > ANSWER_SECONDS and not self.silence:
            self.silence = (
                f"not shared at present: {self._rule.node} has not replied for {ANSWER_SECONDS:g} s;"
                " if it hangs or spins no executor, restart it"
            )
            _log.warning("parameters in %s are %s", self._rule.ros1, self.silence)
        if passed > REPEAT_SECONDS:
            self._end_call()

    def reset(self) -> None:
        """Abandon the call under way, if any, and its warning."""
        self._end_call()
        self.silence = ""

    def close(self) -> None:
        """Close the clients. Safe to call twice."""
        clients, self._clients = self._clients, {}
        self.reset()
        for client in clients.values():
            client.close()

    def _end_call(self) -> None:
        self._number += 1
        self._asked = math.inf
        self._abandon()
        self._abandon = nothing


class NodeNamesakes:
    """Native nodes of the hub with the name of a rule's node; the ROS 2 side reports those on DDS.

    Attributes:
        text: a warning, or "".
    """

    def __init__(self, rule: ParameterRule, context: ParameterContext) -> None:
        self._rule, self._hub = rule, context.hub
        self._due = math.inf  # the time in monotonic seconds at which they are reported
        self.text = ""

    def check(self) -> None:
        """Report nodes that have had one name for `NAMESAKE_SECONDS`."""
        servers = self._hub.graph.servers(f"{self._rule.node}/list_parameters")
        count = sum(server.origin is None and not server.pending for server in servers)
        if count < 2:
            self.reset()
            return
        now = time.monotonic()
        self._due = min(self._due, now + NAMESAKE_SECONDS)
        if now < self._due:
            return
        found = f"{count} nodes on the hub are named {self._rule.node}"
        if not self.text:
            _log.warning("parameters in %s: %s", self._rule.ros1, found)
        self.text = (
            f"{found}, and any of them replies; rename or stop all but one (ros2 run ... --ros-args -r __node:=NAME)"
        )

    def reset(self) -> None:
        """Remove the warning."""
        self.text, self._due = "", math.inf
