"""Relays messages and calls between the hub's own nodes whose versions of a type differ.

rmw_zenoh's keys contain the type's hash, so that nodes of two releases may share a topic without exchanging messages.
For each publisher and server, one worker of Midspan is elected (`bridge.routing.relay.election`). It subscribes under
the publishers' hash, converts, and publishes under the subscriptions' hashes; it answers clients for which only servers
with other hashes exist. Only endpoints of the hub's own nodes are relayed, because Midspan's endpoints already have a
key for each version.

The relayed messages cannot loop, and no side receives them in addition to the originals: they have a separate encoding
(`bridge.hub.endpoints.variants.RELAYED`), and every subscription of Midspan ignores them.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import replace

from typing_extensions import override

from bridge.concurrency import SerialExecutor
from bridge.hub.endpoints.variants import Convert, OneVersion
from bridge.hub.node import Hub
from bridge.hub.session import HubSettings
from bridge.routing.check_loop import CheckLoop
from bridge.routing.gates import RelayGate
from bridge.routing.hold import Hold
from bridge.routing.peer_watch import LINKS_LAST
from bridge.routing.relay.election import RelayElection
from bridge.routing.relay.pairs import RelayKey, ServicePair, TopicPair, service_pairs, topic_pairs, topics_of
from bridge.routing.relay.report import relayed_rows
from bridge.routing.relay.service import RelayedService
from bridge.routing.relay.topic import RelayContext, RelayedTopic
from bridge.routing.rules import RuleSet
from bridge.routing.stall import StallDetector
from bridge.status import RelayStatus

_log = logging.getLogger(__name__)

NODE = "midspan_relay"


class _OwnVersionOnly(OneVersion):
    """Keeps the relay's subscriptions from having keys with other hashes."""

    @override
    def converter(self, type_name: str, source: str, target: str, part: str = "") -> Convert | None:
        return None


class HubRelay:
    """Relays topics and services while this worker is the hub's relay; its thread follows the graph.

    Its node has a separate session on the hub, which it opens when it first has something to relay.

    Args:
        hub: the worker's node on the hub.
        settings: the settings of that node.
        rules: the rules of the configuration.
        stall_detector: detects that this process was suspended.
        hold: the velocities that may not pass now.
        failed: called with the reason if the thread fails.
    """

    def __init__(
        self, hub: Hub, settings: HubSettings, rules: RuleSet, stall_detector: StallDetector, hold: Hold,
        failed: Callable[[str], None],
    ) -> None:  # fmt: skip
        self._hub, self._rules, self._stall_detector, self._hold = hub, rules, stall_detector, hold
        self._settings = replace(settings, node=NODE, worker=NODE, lane=None)
        self._election = RelayElection(hub)
        self._node: Hub | None = None
        self._topics: dict[RelayKey, RelayedTopic] = {}
        self._services: dict[RelayKey, RelayedService] = {}
        self._failures: dict[RelayKey, str] = {}
        self._trouble = ""
        self._stalls = 0
        self._loop = CheckLoop("relay", self._check, failed, self._tick)
        self._closing = SerialExecutor("midspan-relay-closing")
        self._closers: list[Callable[[], None]] = []

    def start(self) -> None:
        """Join the election, and start following the graph."""
        self._closers = [self._hub.graph.watch(self._loop.wake), self._election.stop]
        self._loop.start()

    def reload(self, rules: RuleSet) -> None:
        """Apply new rules."""
        self._rules = rules
        self._loop.wake()

    def alive(self) -> str:
        """Return a text if a check takes long, else ""; raises `TimeoutError` if it hangs."""
        return self._loop.alive()

    def stop(self) -> None:
        """Stop relaying, and leave the election."""
        self._loop.stop()
        self._close_all()  # before another worker is elected
        for closer in self._closers:
            closer()
        self._closers = []
        self._closing.close()
        if self._node is not None:
            self._node.close()

    def topics(self) -> dict[RelayKey, RelayedTopic]:
        """Return the topics that this worker relays now."""
        return dict(self._topics)

    def services(self) -> dict[RelayKey, RelayedService]:
        """Return the services that this worker relays now, without those that wait for a server."""
        return {key: relayed for key, relayed in self._services.copy().items() if relayed.pair.servers}

    def status(self) -> RelayStatus:
        """Return what this worker relays, for the status document."""
        node, rows = self._node, relayed_rows(self.topics().values(), self.services().values(), self._hub.versions)
        return RelayStatus(zid="" if node is None else node.zid, names=rows)

    def _tick(self) -> None:
        if self._stalls != self._stall_detector.stalls:
            self._stalls = self._stall_detector.stalls
            if self._stall_detector.last_stall > LINKS_LAST:
                self._election.rejoin()
                self._loop.wake()
        if self._election.poll():
            self._loop.wake()
        for topic in self.topics().values():
            topic.counters.tick()

    def _check(self) -> bool:
        """Follow the graph; return whether that failed and has to be tried again. A failure must not end the side."""
        try:
            failed = self._follow()
        except Exception as err:
            if self._trouble != str(err):
                _log.exception("the relay cannot follow the hub's graph")
            self._trouble = str(err)
            return True
        self._trouble = ""
        return failed

    def _follow(self) -> bool:
        """Compare the wanted relays with the existing ones; return whether any failed and has to be tried again."""
        graph, versions = self._hub.graph, self._hub.versions
        endpoints = graph.endpoints() if self._election.is_candidate else []
        midspan, gate = graph.midspan(), RelayGate(self._rules, endpoints)
        topics, services = topic_pairs(endpoints, midspan, versions), service_pairs(endpoints, midspan, versions)
        sessions = {end.zid for pair in topics.values() for end in pair.publishers}
        elected = self._election.elect(sessions | {pair.servers[0].zid for pair in services.values() if pair.servers})
        # services first, because clients do not repeat their calls
        chosen = {key: pair for key, pair in services.items() if not pair.servers or pair.servers[0].zid in elected}
        failed = self._follow_services(chosen, gate)
        return self._follow_topics(topics_of(topics, elected), gate) or failed

    def _follow_topics(self, pairs: Mapping[RelayKey, TopicPair], gate: RelayGate) -> bool:
        """Update the relayed topics; return whether any failed."""
        policies = {key: gate.decide("topic", key.topic, key.type_name) for key in pairs}
        wanted = {key: policy for key, policy in policies.items() if policy.allowed}
        for key in [key for key, relayed in self._topics.items() if wanted.get(key) != relayed.policy]:
            self._topics.pop(key).close()

        def update(key: RelayKey) -> None:
            if key not in self._topics:
                self._topics[key] = RelayedTopic(key, wanted[key], pairs[key], self._context())
            self._topics[key].update(pairs[key])

        succeeded = [self._attempt(key, update) for key in wanted]
        return not all(succeeded)

    def _follow_services(self, pairs: Mapping[RelayKey, ServicePair], gate: RelayGate) -> bool:
        """Update the relayed services; return whether any failed."""
        wanted = {key: pair for key, pair in pairs.items() if gate.decide("service", key.topic, key.type_name).allowed}
        for key, before in tuple(self._services.items()):
            if key not in wanted or not before.fits(wanted[key]):
                self._services.pop(key).close()

        def update(key: RelayKey) -> None:
            if key not in self._services:
                self._services[key] = RelayedService(key, wanted[key], self._context())
            self._services[key].update(wanted[key])

        succeeded = [self._attempt(key, update) for key in wanted]
        return not all(succeeded)

    def _attempt(self, key: RelayKey, update: Callable[[RelayKey], None]) -> bool:
        """Update one relay, and return whether that succeeded; a failure affects no other relay, and no route."""
        try:
            update(key)
        except Exception as err:
            if self._failures.get(key) != str(err):
                _log.exception("%s is not relayed between versions of %s", key.topic, key.type_name)
            self._failures[key] = str(err)
            return False
        self._failures.pop(key, None)
        return True

    def _context(self) -> RelayContext:
        if self._node is None:
            self._node = Hub.open(self._settings)
            self._node.versions = _OwnVersionOnly()
        detector, wake, closing = self._stall_detector, self._loop.wake, self._closing
        return RelayContext(self._node, self._hub.versions, detector, self._hold, wake, closing)

    def _close_all(self) -> None:
        while self._topics:
            self._topics.popitem()[1].close()
        while self._services:
            self._services.popitem()[1].close()
