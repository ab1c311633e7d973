"""This node's registrations: the calls that make the master's state match them, or prompt subscribers."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from bridge.adapters.ros1.graph.presence import NodeEntry, others
from bridge.adapters.ros1.graph.prompts import Prompts
from bridge.adapters.ros1.graph.state import MasterState, Registration
from bridge.adapters.ros1.node.node import Ros1Node
from bridge.adapters.ros1_peers import Call

_log = logging.getLogger(__name__)

_BATCH = 200


class _Own(NamedTuple):
    """This node's topics in one state of the master, and the subscribers of other nodes, except Midspan's."""

    state: MasterState
    published: frozenset[str]
    subscribed: frozenset[str]
    subscribers: frozenset[Registration]

    @classmethod
    def of(cls, state: MasterState, entry: NodeEntry) -> _Own:
        own = (entry.node, entry.uri)
        published, subscribed = (
            frozenset(r.topic for r in end if (r.node, r.uri) == own) for end in (state.publishers, state.subscribers)
        )
        # Midspan's nodes do not connect to each other's topics; an unknown address cannot be called
        passed = {"", entry.uri, *(other.uri for other in others(state, entry))}
        subscribers = frozenset(s for s in state.subscribers if s.topic in published and s.uri not in passed)
        return cls(state, published, subscribed, subscribers)


class NodeRegistrations:
    """The registrations of one node. Used on one thread.

    Args:
        is_dead: returns whether a service's server is known to be dead, so that Midspan may register the service.
        prompts: selects the topics that are registered again for subscribers that did not connect.
    """

    def __init__(self, node: Ros1Node, is_dead: Callable[[Registration], bool], prompts: Prompts) -> None:
        self._node, self._is_dead, self._prompts = node, is_dead, prompts
        self._own: _Own | None = None
        self._refused: set[str] = set()
        self._ended_topics: set[str] = set()

    def corrections(self, state: MasterState, entry: NodeEntry) -> list[Call]:
        """Return the calls that correct this node's registrations; ``entry`` is its entry on the master."""
        name, uri = self._node.name, self._node.uri
        self._ended_topics |= self._node.take_removed()
        published, subscribed = self._node.publications(), self._node.subscriptions()
        if self._own is None or self._own.state is not state:
            self._own = _Own.of(state, entry)
        _, has_published, has_subscribed, subscribers = self._own
        # A publication that ended and was created again between two reads is unregistered and registered: a rospy
        # subscriber whose connection broke reconnects only when the master reports a publisher that was not listed.
        standing = has_published & published.keys() - self._ended_topics
        missing = self._node.unconnected(frozenset(s for s in subscribers if s.topic in standing))
        prompted = self._prompts.topics(missing, time.monotonic())
        calls: list[Call] = [
            *(("unregisterPublisher", (name, t, uri)) for t in has_published - standing),
            *(("unregisterSubscriber", (name, t, uri)) for t in has_subscribed - subscribed.keys()),
            *(("registerPublisher", (name, t, published[t], uri)) for t in (published.keys() - standing) | prompted),
            *(("registerSubscriber", (name, t, subscribed[t], uri)) for t in subscribed.keys() - has_subscribed),
            *self._service_calls(state),
        ]
        self._refused &= {_what(call) for call in calls}
        return calls

    def on_replies(self, calls: Sequence[Call], values: Sequence[object]) -> None:
        """Report the calls that the master rejects, each once."""
        for call, value in zip(calls, values, strict=True):
            action = _what(call)
            if value is None and action not in self._refused:
                _log.warning("the master rejects %s", action)
                self._refused.add(action)
            elif value is not None:
                self._refused.discard(action)

    def clear_ended(self) -> None:
        """Clear the record of ended publications, after all calls of `corrections` were made."""
        self._ended_topics.clear()

    def _service_calls(self, state: MasterState) -> list[Call]:
        """Return the calls for services; a master has one server per name, which the last to register replaces."""
        name, uri, wanted = self._node.name, self._node.uri, self._node.services()
        has = {link.topic: link.uri for link in state.servers if link.node == name}
        taken = {link.topic for link in state.servers if link.node != name and not self._is_dead(link)}
        return [
            *(("unregisterService", (name, s, a)) for s, a in has.items() if a and wanted.get(s) != a),
            *(("registerService", (name, s, a, uri)) for s, a in wanted.items() if has.get(s) != a and s not in taken),
        ]


def _what(call: Call) -> str:
    method, params = call
    return f"{method} {params[1]}"


def batches(calls: Sequence[Call]) -> Iterator[Sequence[Call]]:
    """Yield the calls in parts that fit one request to the master."""
    for at in range(0, len(calls), _BATCH):
        yield calls[at : at + _BATCH]
