"""Which worker relays for which session."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Any, cast

import pytest

from bridge.routing.relay import election
from bridge.routing.relay.election import RelayElection
from tests.peers.hub.network import HubNetwork
from tests.peers.zenoh.releases import HUMBLE, JAZZY, ReleaseNode
from tests.routing.relay.conftest import Relay
from tests.routing.relay.test_topics import CHATTER, connect, put_texts, texts
from tests.support.wait import until

SESSION = "a node's session"


class Graph:
    """The announcements of all workers; the workers are numbered in the order of their starts."""

    def __init__(self) -> None:
        self.starts: dict[str, tuple[int, str]] = {}
        self.links: set[tuple[str, str]] = set()

    def relays(self) -> dict[str, tuple[int, str]]:
        return dict(self.starts)

    def near(self) -> frozenset[tuple[str, str]]:
        return frozenset(self.links)

    def origins(self) -> dict[str, Any]:
        return {}

    members = origins


class Worker:
    """A worker's hub node, as the election sees it."""

    def __init__(self, graph: Graph, zid: str, router: str) -> None:
        self.zid, self._shared, self._router = zid, graph, router
        self.linked_to: set[str] = set()
        self.graph: Any = self
        self.relays, self.near, self.origins, self.members = graph.relays, graph.near, graph.origins, graph.members
        self.election = RelayElection(cast("Any", self))
        self.election._since = len(graph.starts)
        self.election._settled = True
        self.election.poll()

    def router(self) -> str:
        return self._router

    def linked(self) -> bool:
        return True

    def neighbors(self) -> set[str]:
        return self.linked_to

    def announce_relay(self, since: int, router: str) -> Callable[[], None]:
        self._shared.starts[self.zid] = since, router
        return lambda: self._shared.starts.pop(self.zid, None) and None

    def announce_near(self, session: str) -> Callable[[], None]:
        self._shared.links.add((self.zid, session))
        return lambda: self._shared.links.discard((self.zid, session))


def elected(workers: Sequence[Worker]) -> list[str]:
    for worker in workers:
        worker.election.elect([SESSION])
    return [worker.zid for worker in workers if worker.election.elect([SESSION])]


def test_the_first_worker_of_one_machine_relays_at_once() -> None:
    graph = Graph()
    workers = [Worker(graph, zid, "router") for zid in "cab"]
    assert elected(workers) == ["c"]
    workers.pop(0).election.stop()
    assert elected(workers) == ["a"]


def test_the_machine_of_a_session_relays_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(election, "GRACE", 0.0)
    graph = Graph()
    workers = [Worker(graph, *names) for names in (("a", "one"), ("b", "two"), ("c", "two"))]
    for worker in workers[1:]:
        worker.linked_to = {SESSION}
    assert elected(workers) == ["b"]
    assert graph.links == {("b", SESSION)}
    workers.pop(1).election.stop()
    assert elected(workers) == ["c"]


def test_the_first_worker_relays_later_for_sessions_without_a_candidate_nearby(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(election, "GRACE", 100.0)  # no matter how slow the machine is
    graph = Graph()
    workers = [Worker(graph, *names) for names in (("a", "one"), ("b", "two"))]
    assert elected(workers) == []
    assert workers[0].election.poll()
    monkeypatch.setattr(election, "GRACE", 0.0)
    assert elected(workers) == ["a"]


def test_a_worker_that_does_not_know_the_hub_yet_relays_nothing() -> None:
    worker = Worker(Graph(), "a", "router")
    worker.election._settled = False
    assert elected([worker]) == []
    assert not worker.election.is_candidate


def test_nodes_of_one_of_two_machines_are_relayed_there() -> None:
    with ExitStack() as stack:
        first = stack.enter_context(HubNetwork(7))
        second = stack.enter_context(HubNetwork(7, router_zenoh={"connect": {"endpoints": [first.endpoint]}}))
        workers = [Relay(first, "first", []), Relay(second, "second", [])]
        nodes = [ReleaseNode(second.endpoint, 7, release.name, release) for release in (HUMBLE, JAZZY)]
        for close in (*(worker.close for worker in workers), *(node.close for node in nodes)):
            stack.callback(close)
        until(lambda: all(len(w.hub.graph.relays()) == 2 for w in workers), "the workers see each other")
        publisher, subscription = CHATTER.publisher(nodes[0]), CHATTER.subscription(nodes[1])
        connect(publisher, subscription)
        values = put_texts(publisher)
        until(lambda: values[-1] in texts(subscription), "all messages arrive")
        assert texts(subscription) == values
        assert [len(worker.relay.topics()) for worker in workers] == [0, 1]


def test_a_candidate_takes_a_session_over_only_after_the_other_one_has_stopped() -> None:
    """The first worker relays for a session of another machine, until that machine gets a worker."""
    graph = Graph()
    far = Worker(graph, "a", "one")
    assert elected([far]) == ["a"]
    near = Worker(graph, "b", "two")
    near.linked_to = {SESSION}
    assert not near.election.elect([SESSION])
    assert graph.links == {("b", SESSION)}
    assert not far.election.elect([SESSION]), "it has seen the link"
    assert near.election.poll()
    near.election._won[SESSION] -= election.GRACE
    assert near.election.elect([SESSION])
    new = "a new session"
    near.linked_to = {SESSION, new}
    assert new in near.election.elect([SESSION, new]), "nobody can relay for it yet"


def test_a_session_whose_relay_left_is_taken_over_at_once() -> None:
    graph = Graph()
    far, near = Worker(graph, "a", "one"), Worker(graph, "b", "two")
    near.linked_to = {SESSION}
    near.election.elect([SESSION])
    near.election._won[SESSION] -= election.GRACE
    for worker in (far, near):
        worker.election._seen[SESSION] = -election.GRACE
    assert elected([far, near]) == ["b"]
    graph.starts["c"] = 5, "three"  # a third machine
    near.election.stop()
    assert far.election.elect([SESSION])


def test_a_worker_that_hung_joins_again_as_the_last_one(monkeypatch: pytest.MonkeyPatch) -> None:
    graph = Graph()
    first = Worker(graph, "a", "router")
    first.election.rejoin()
    assert elected([first]) == ["a"], "no other worker can have taken over"
    second = Worker(graph, "b", "router")
    monkeypatch.setattr("bridge.routing.relay.election.time.time_ns", lambda: 7)
    first.election.rejoin()
    assert elected([first]) == []
    assert elected([second]) == ["b"]


def test_a_worker_may_leave_while_another_one_elects(monkeypatch: pytest.MonkeyPatch) -> None:
    """A thread of zenoh removes the worker from the graph between two reads."""
    graph = Graph()
    first, second = Worker(graph, "a", "one"), Worker(graph, "b", "two")

    def leave() -> set[str]:
        first.election.stop()
        return set()

    monkeypatch.setattr(second, "neighbors", leave)
    assert not second.election.elect([SESSION]), "the other worker was there at its start"
    assert second.election.elect([SESSION])
