"""Local navigators: a YARP server of INavigation2D, and an action whose server is restarted."""

# ruff: noqa: N802 - YARP's names

from __future__ import annotations

import contextlib
import math
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from bridge.modules.action_server import Goal
from navigation.constraints import Constraints
from navigation.messages import NAVIGATE
from navigation.pose import Pose
from navigation.robot_path_planner import navigators
from navigation.robot_path_planner.navigators import ActionNavigator, YarpNavigator
from navigation.status import State
from tests.peers.hub.network import HubNetwork
from tests.peers.hub.node import HubNode
from tests.support.ports import free_port
from tests.support.wait import until
from yarp_compat.dev.inavigation2d import Navigation2DServer
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.returnvalue import CallFailed, ReturnCode
from yarp_compat.dev.server import Server
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.naming.server import NameServer
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.generation import Generation, Generations


class Goto:
    """A robotGoto whose state the test sets."""

    def __init__(self) -> None:
        self.state, self.refuses, self.late = "idle", False, False
        self.polls = 0
        self.goals: list[Map2DLocation] = []
        self.answers = threading.Event()
        self.answers.set()

    def gotoTargetByAbsoluteLocation(self, loc: Map2DLocation) -> None:
        self.answers.wait(20)
        if self.refuses:
            raise CallFailed(ReturnCode.METHOD_FAILED, "no")
        self.goals.append(loc)
        if not self.late:
            self.state = "moving"

    def stopNavigation(self) -> None:
        self.state = "idle"

    def getNavigationStatus(self) -> str:
        self.polls += 1
        return self.state


class Network:
    """A name server, and a port with a robotGoto."""

    def __init__(self) -> None:
        port = free_port()
        self.server = NameServer(port=port, gc_seconds=0)
        self.server.open()
        self.names = NameClient(Address("127.0.0.1", port), namespace="/root")
        self.goto = Goto()
        self.port = self.open_port()
        self.navigator = YarpNavigator("/robotGoto", lambda: "floor", self.names)

    def open_port(self) -> PortCore:
        answers = Server(Navigation2DServer(self.goto), Generations(Generation.YARP_4))
        port = PortCore("/robotGoto/rpc", on_message=answers, on_event=answers.on_event, naming=self.names,
                        is_output=False, rpc=True)  # fmt: skip
        port.open()
        return port

    def until_becomes(self, state: State) -> None:
        until(lambda: self.navigator.state is state, f"the navigator is {state}", 20)

    def close(self) -> None:
        self.navigator.close()
        self.port.close()
        self.server.close()


@pytest.fixture
def network() -> Iterator[Network]:
    with contextlib.closing(Network()) as network:
        yield network


def test_goals_are_sent_and_their_ends_are_received(network: Network) -> None:
    network.until_becomes(State.IDLE)
    network.goto.answers.clear()
    network.navigator.send(Pose(1.0, 2.0, math.pi / 2), Constraints(heading=False, through=True))
    assert network.navigator.state is State.PREPARING
    network.goto.answers.set()
    network.until_becomes(State.MOVING)
    network.goto.state = "waiting_obstacle"
    network.until_becomes(State.WAITING)
    network.goto.state = "goal_reached"
    network.until_becomes(State.REACHED)
    network.goto.state = "idle"  # as robotGoto does some time after it has arrived
    network.goto.answers.clear()
    network.navigator.send(Pose(3.0, 4.0, math.pi / 2), Constraints())
    assert network.navigator.state is State.PREPARING
    network.goto.answers.set()
    network.until_becomes(State.MOVING)
    first, second = network.goto.goals
    assert (first.map_id, first.x, first.y) == ("floor", 1.0, 2.0)
    assert math.isnan(first.theta), "the heading does not matter"
    assert second.theta == pytest.approx(90.0)
    network.navigator.cancel()
    until(lambda: network.goto.state == "idle", "the robot stops", 20)
    network.goto.refuses = True
    network.navigator.send(Pose(1.0, 2.0, 0.0), Constraints())
    network.until_becomes(State.FAILING)
    polls = network.goto.polls
    until(lambda: network.goto.polls > polls + 2, "the navigator polls the server", 20)
    assert (network.navigator.state, "refused" in network.navigator.reason) == (State.FAILING, True)


@pytest.mark.parametrize("before", ["goal_reached", "idle", "aborted"])
def test_the_previous_goals_end_does_not_count_for_the_next(
    network: Network, monkeypatch: pytest.MonkeyPatch, before: str
) -> None:
    """After accepting a goal, a server may still report the end of the previous one for a moment."""
    monkeypatch.setattr(navigators, "GRACE", 60.0)
    network.until_becomes(State.IDLE)
    goto = network.goto
    goto.state, goto.late = before, True
    network.until_becomes(State(before))
    network.navigator.send(Pose(1.0, 2.0, 0.0), Constraints())
    until(lambda: len(goto.goals) == 1, "the goal is accepted", 20)
    polls = goto.polls
    until(lambda: goto.polls > polls + 2, "the navigator polls the server", 20)
    assert network.navigator.state is State.PREPARING
    goto.state = "moving"
    network.until_becomes(State.MOVING)
    goto.state = before
    network.until_becomes(State(before))


def test_the_status_of_a_server_that_never_moves_counts_after_the_grace_period(
    network: Network, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(navigators, "GRACE", 0.05)
    network.until_becomes(State.IDLE)
    network.goto.late, network.goto.state = True, "goal_reached"
    network.navigator.send(Pose(1.0, 2.0, 0.0), Constraints())
    network.until_becomes(State.REACHED)


def test_a_goal_sent_to_an_unreachable_server_is_dropped(network: Network) -> None:
    network.until_becomes(State.IDLE)
    network.port.close()
    network.until_becomes(State.ERROR)
    network.navigator.send(Pose(1.0, 2.0, 0.0), Constraints())
    until(lambda: network.navigator._sent == network.navigator._number, "the goal is not sent later", 20)
    network.port = network.open_port()
    until(lambda: network.navigator.state is not State.ERROR, "the server is reachable again", 20)


def test_an_unreachable_server_is_reported_and_reconnected(network: Network) -> None:
    network.until_becomes(State.IDLE)
    network.port.close()
    network.until_becomes(State.ERROR)
    assert "/robotGoto/rpc" in network.navigator.reason
    network.port = network.open_port()
    network.until_becomes(State.IDLE)


def test_a_brake_stops_only_the_goal_it_was_made_for(network: Network) -> None:
    network.until_becomes(State.IDLE)
    network.navigator.send(Pose(1.0, 2.0, 0.0), Constraints())
    late = network.navigator.brake()
    network.navigator.send(Pose(3.0, 4.0, 0.0), Constraints())
    late()
    network.until_becomes(State.MOVING)
    assert network.goto.goals[-1].x == 3.0
    network.navigator.brake()()
    until(lambda: network.goto.state == "idle", "the robot stops", 20)


def test_a_stop_is_sent_again_until_the_server_receives_it(network: Network) -> None:
    network.until_becomes(State.IDLE)
    network.navigator.send(Pose(1.0, 2.0, 0.0), Constraints())
    network.until_becomes(State.MOVING)
    with network.navigator._lock:
        network.port.close()
        network.navigator.cancel()
    network.until_becomes(State.ERROR)
    assert network.goto.state == "moving", "the stop was not received"
    network.port = network.open_port()
    until(lambda: network.goto.state == "idle", "the robot stops", 20)


def test_a_goal_whose_server_is_away_is_canceled_when_the_server_is_back() -> None:
    """As if the worker of the navigator's side were restarted: the navigator itself drives on."""
    action, goals, canceled = "/navigate_to_pose", list[Goal](), list[bytes]()

    def accept(goal: Goal) -> bool:
        goal.execute()
        goals.append(goal)
        return True

    with HubNetwork() as hubs, HubNode(hubs.settings("planner")) as planner:
        host: Any = planner
        navigator: ActionNavigator = planner.on(lambda: ActionNavigator(host, action, "map"))
        with HubNode(hubs.settings("worker")) as worker:
            worker.on(lambda: worker.node.action_server(action, NAVIGATE, accept))
            until(lambda: navigator.state is State.IDLE, "the navigator is available", 20)
            planner.on(lambda: navigator.send(Pose(1.0, 2.0, 0.0), Constraints()))
            until(lambda: goals, "the robot drives", 20)
        until(lambda: navigator._lost and navigator.state is State.ERROR, "the navigator is unavailable", 20)
        planner.on(navigator.cancel)
        with HubNode(hubs.settings("worker")) as worker:
            worker.on(lambda: worker.node.action_server(action, NAVIGATE, accept, brake=canceled.append))
            until(lambda: goals[0].id in canceled, "the goal is canceled", 20)
