"""Reports for a robot that starts to move while the gateway's process stalls, or while odometry arrives late.

Time is simulated. No status may claim that the robot stands while the planner may be executing a goal of the gateway.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import pytest

from bridge.messages.actions import names
from navigation.status import State
from tests.peers.navigation import world
from tests.peers.navigation.simulated_planner import SPEED
from tests.peers.navigation.world import World

STALL = 3.0
LATE_SEEDS = (225, 2064)
"""Seeds of `world.LATE` that once found a fault."""

CLAIMS = world.ENDED | {State.PREPARING, State.REACHED}
"""States in which clients do not expect the robot to move."""


@pytest.fixture(params=range(4))
def started(request: pytest.FixtureRequest) -> Iterator[World]:
    """A world whose planner is known, and whose base has odometry."""
    with world.simulated(request.param) as started:
        started.has_odometry = True
        run(started, 3.0)
        yield started


def run(started: World, seconds: float) -> None:
    started.clock.run_to(started.clock.now + seconds)


def state(started: World) -> State:
    assert started.gateway is not None
    return started.gateway.state().state


def test_no_status_claims_that_the_robot_stands_when_the_planner_receives_a_goal(started: World) -> None:
    part = names(started.action).send_goal
    serve, states = started.hub.servers[part], list[State]()

    def receive(*call: object) -> None:
        states.append(state(started))
        serve(*call)  # type: ignore[arg-type]

    started.hub.servers[part] = receive
    started.goal()
    assert states == [State.MOVING]


def test_the_robot_starts_while_the_gateway_does_not_read_that_its_goal_is_accepted(started: World) -> None:
    started.goal()
    started.loop.stall(STALL)
    run(started, 1.0)
    assert started.v == SPEED
    assert state(started) not in CLAIMS
    run(started, STALL)
    assert state(started) is State.MOVING


def test_the_robot_starts_again_while_the_gateway_does_not_notice_that_the_planner_is_back(started: World) -> None:
    started.bridge_base()
    started.goal()
    run(started, 1.5)
    for goal in started.goals.values():
        goal.until = math.inf
    started.kill_worker()
    run(started, 2.5)
    assert started.v == 0.0
    assert started.gateway is not None
    assert started.gateway.state().reason.endswith("waiting for it; the robot stands, and may move again")
    started.start_worker()
    started.loop.stall(STALL)
    run(started, STALL - 0.5)
    assert started.v == SPEED
    assert state(started) not in CLAIMS


def test_a_planner_gets_its_time_to_return_although_the_gateway_stalls(started: World) -> None:
    """The process stands still for longer than `patience`, for example after SIGSTOP."""
    started.goal()
    run(started, 1.5)
    for goal in started.goals.values():
        goal.until = math.inf
    started.kill_worker()
    run(started, 1.0)
    patience = started.section.patience
    started.loop.stall(patience + 1.0)
    run(started, patience + 1.5)
    started.start_worker()
    run(started, 4.0)
    (client_goal,) = started.client_goals
    assert client_goal.ends == []
    assert state(started) is State.MOVING
    assert len(started.goals) == 1, "the planner's goal continues"


@pytest.mark.parametrize("lag", [0.3, 0.45, 3.0])
def test_the_robot_starts_while_odometry_arrives_late(started: World, lag: float) -> None:
    started.lag = lag
    run(started, 1.0)
    started.goal()
    run(started, 0.5)
    assert started.v == SPEED
    assert state(started) is State.MOVING


@pytest.mark.parametrize("seed", LATE_SEEDS)
def test_reports_never_contradict_the_base_in_recorded_seeds(seed: int) -> None:
    assert world.run(seed, world.LATE).gateway is not None


def test_no_report_contradicts_the_base() -> None:
    assert all(world.run(seed, world.LATE).gateway is not None for seed in range(60))
