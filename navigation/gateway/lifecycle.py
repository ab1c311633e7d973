"""The states of a planner's lifecycle nodes, such as Nav2's, from their services ``get_state``."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from bridge.client.services import ServiceClient
from bridge.config.rules import GET_STATE
from bridge.hub.endpoints.calls import Abandon, CallError
from bridge.modules.host import Host
from navigation.lifecycle import ACTIVE, SILENT

POLL_SECONDS, ACTIVE_POLL_SECONDS = 1.0, 3.0
"""Time between two requests to a node: until all are active, and after that."""

ANSWER_SECONDS = 10.0
"""A node that has not answered a request for this time is reported as silent."""

_MOST_LETTERS = 40


class _Node:
    """One node that serves its state; at most one request is pending."""

    def __init__(self, client: ServiceClient) -> None:
        self.client = client
        self.state = ""  # "" until it has answered
        self.asked_at = 0.0  # monotonic
        self.abandon: Abandon | None = None


class LifecycleNodes:
    """Polls the nodes that are on the hub. Used only on the module's thread.

    Args:
        names: the nodes that may be on the hub.
        changed: called if the states have changed.
    """

    def __init__(self, host: Host, names: Sequence[str], changed: Callable[[], None]) -> None:
        self._host, self._names, self._changed = host, names, changed
        self._nodes: dict[str, _Node] = {}
        self._due = 0.0

    @property
    def inactive(self) -> dict[str, str]:
        """The states of the nodes that are not active, by name; `SILENT` after `ANSWER_SECONDS` without an answer."""
        nodes = self._nodes.copy()  # other threads read the states
        return {name: node.state for name, node in nodes.items() if node.state not in ("", ACTIVE)}

    def refresh(self) -> None:
        """Request the states that are due; called about ten times a second."""
        now = time.monotonic()
        if now < self._due:
            return
        before, graph = self.inactive, self._host.node.hub.graph
        for name in self._names:
            service = f"{name}/get_state"
            if not graph.servers(service):
                self._drop(name)
                continue
            if name not in self._nodes:
                self._nodes[name] = _Node(self._host.node.client(service, GET_STATE))
            self._ask(self._nodes[name], now)
        self._due = now + (ACTIVE_POLL_SECONDS if self._all_active else POLL_SECONDS)
        self._report(before)

    @property
    def _all_active(self) -> bool:
        return all(node.state == ACTIVE for node in self._nodes.values())

    def _ask(self, node: _Node, now: float) -> None:
        if node.abandon is not None:
            if now < node.asked_at + ANSWER_SECONDS:
                return
            node.abandon()
            node.state = SILENT
        if node.client.ready:
            node.asked_at = now
            node.abandon = node.client.call({}, partial(self._on_reply, node))

    def _on_reply(self, node: _Node, reply: dict[str, Any] | CallError) -> None:
        before, node.abandon = self.inactive, None
        if isinstance(reply, CallError):
            return  # its server has left, or the next request shows why
        node.state = str(reply["current_state"]["label"])[:_MOST_LETTERS]
        self._report(before)

    def _report(self, before: dict[str, str]) -> None:
        if self.inactive != before:
            self._changed()

    def _drop(self, name: str) -> None:
        node = self._nodes.pop(name, None)
        if node is not None:
            if node.abandon is not None:
                node.abandon()
            self._host.node.release(node.client)

    def close(self) -> None:
        for name in list(self._nodes):
            self._drop(name)
