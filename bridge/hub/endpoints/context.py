"""The objects and settings that the endpoints of one node share."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

import zenoh

from bridge.concurrency import DelayedCalls, SerialExecutor
from bridge.hub.endpoints.variants import KeyVariants
from bridge.hub.graph import HubGraph
from bridge.hub.lane.lane import Lane


@dataclass(frozen=True, slots=True)
class EndpointContext:
    """The objects and settings that the endpoints of one node share.

    Attributes:
        reach: which endpoints are reached: those of other sessions, or also those of a shared session's other nodes.
        own: GIDs of the node's endpoints, whose messages its subscriptions and servers ignore; the set changes.
        limit: maximum size of a message in bytes.
        executor: runs calls that may wait for zenoh.
        ends: handles the ends of queries; see `bridge.hub.zenoh_compat`.
        asking: runs queries for the samples that latched publishers cache.
        delays: makes delayed calls, for example for the heartbeats of latched publishers.
        variants: assigns additional keys to the endpoints.
        closed: called with each endpoint that has closed.
        lane: the transport to this daemon's other workers; None if the session has no lane.
    """

    session: zenoh.Session
    reach: zenoh.Locality
    own: Collection[bytes]
    graph: HubGraph
    limit: int
    executor: SerialExecutor
    ends: SerialExecutor
    asking: SerialExecutor
    delays: DelayedCalls
    variants: KeyVariants
    closed: Callable[[Any], None]
    lane: Lane | None = None
