"""The edge's graph while its master is unreachable, and when another master lists less."""

from dataclasses import replace

import pytest

from bridge.adapters.ros1.graph.standing import Connections, StandingGraph
from bridge.adapters.ros1.graph.state import MasterState, Registration

STATUS = Registration("/move_base", "/move_base/status", "http://a:1/")
SCAN = Registration("/laser", "/scan", "http://b:1/")
GOAL = Registration("/move_base", "/move_base/goal", "http://a:1/")
CLEAR = Registration("/move_base", "/move_base/clear_costmaps", "rosrpc://a:2")
TYPES = {"/move_base/status": "actionlib_msgs/GoalStatusArray", "/scan": "sensor_msgs/LaserScan"}

FULL = MasterState(
    "one#1", "one", frozenset({STATUS, SCAN}), frozenset({GOAL}), frozenset({CLEAR}), TYPES,
    {"/move_base": "http://a:1/", "/laser": "http://b:1/"}, {"node": {"pid": 1}},
)  # fmt: skip
EMPTY = MasterState("two#2", "two", types={"/move_base/status": "*"})


class Side:
    """A graph, and its existing connections."""

    def __init__(self) -> None:
        self.graph = StandingGraph(lambda: Connections(*map(frozenset, (self.publishers, self.received, self.servers))))
        self.publishers, self.received, self.servers = {STATUS, SCAN}, {("/move_base", "/move_base/goal")}, {CLEAR}
        self.graph.update(FULL)

    def cut(self) -> None:
        self.publishers, self.received, self.servers = set(), set(), set()


@pytest.fixture
def side():
    return Side()


def test_the_masters_list_is_unchanged(side):
    assert side.graph.state is FULL
    side.cut()
    assert side.graph.update(FULL) is FULL
    assert not side.graph.unlisted


def test_without_a_master_the_last_state_stays_while_any_connection_proves_it(side):
    assert side.graph.update(None) is FULL
    assert side.graph.unlisted
    side.publishers, side.servers = set(), set()
    assert side.graph.update(None) is FULL, "the server is connected to the edge's goal topic"
    side.received = {("/other", "/move_base/goal")}
    assert side.graph.update(None) is None
    assert not side.graph.unlisted
    assert side.graph.update(None) is None


def test_without_any_master_the_graph_is_unknown():
    assert StandingGraph(lambda: Connections(frozenset({STATUS}), frozenset(), frozenset())).update(None) is None


@pytest.mark.parametrize("away", [True, False])
def test_unlisted_registrations_outlive_a_restart_of_the_master(side, away):
    if away:
        side.graph.update(None)
    state = side.graph.update(EMPTY)
    assert (state.run, state.network, state.presence) == ("two#2", "two", {})
    assert (state.publishers, state.subscribers, state.servers) == ({STATUS, SCAN}, {GOAL}, {CLEAR})
    assert state.types == TYPES, "the edge's own subscription is registered as any type"
    assert state.uris == FULL.uris
    assert side.graph.update(EMPTY) is state, "the state has not changed"
    side.publishers, side.servers = {STATUS}, set()
    state = side.graph.update(EMPTY)
    assert (state.publishers, state.subscribers, state.servers) == ({STATUS}, {GOAL}, frozenset())
    side.cut()
    assert side.graph.update(EMPTY) is EMPTY
    assert not side.graph.unlisted
    side.publishers = {STATUS}
    assert side.graph.update(EMPTY) is EMPTY, "the registration did not exist before"


def test_a_node_that_registers_again_is_listed_once(side):
    side.graph.update(EMPTY)
    again = replace(
        EMPTY, publishers=frozenset({STATUS}), subscribers=frozenset({GOAL}), uris={"/move_base": STATUS.uri}
    )
    state = side.graph.update(again)
    assert (state.publishers, state.subscribers) == ({STATUS, SCAN}, {GOAL})


def test_a_node_is_removed_if_another_node_takes_its_name(side):
    """The master has requested the older node's shutdown, but a node that hangs does not react."""
    new = STATUS._replace(uri="http://c:1/")
    state = replace(FULL, publishers=frozenset({new}), subscribers=frozenset(), uris={"/move_base": new.uri})
    state = side.graph.update(state)
    assert state.publishers == {new, SCAN}
    assert (state.subscribers, state.servers) == (frozenset(), FULL.servers)


def test_a_registration_that_a_running_master_lost_stays_except_a_service(side):
    """A server that unregisters may leave its connections open, so only services are removed."""
    state = replace(FULL, publishers=frozenset({SCAN}), servers=frozenset())
    state = side.graph.update(state)
    assert (state.publishers, state.servers) == (FULL.publishers, frozenset())
    side.publishers = {SCAN}
    assert side.graph.update(state) is state
