"""Every transition of the gateway's tables, and every report that is derived from them."""

from __future__ import annotations

import itertools
from dataclasses import replace
from enum import Enum
from typing import Any

import pytest

from bridge.state_machine import Machine
from navigation.gateway.machine import (
    DRIVE,
    PLANNER,
    SENDER,
    STOP,
    VELOCITY,
    DriveEvent,
    DriveState,
    PlannerEvent,
    PlannerState,
    SenderEvent,
    SenderState,
    StopEvent,
    StopState,
    VelocityEvent,
    VelocityState,
)
from navigation.gateway.motion import Base
from navigation.gateway.words import MAY_MOVE, Situation, derive, trouble
from navigation.status import Fault, PlannerStatus, State

TABLES: dict[type[Enum], tuple[Any, type[Enum], Enum]] = {
    PlannerState: (PLANNER, PlannerEvent, PlannerState.UNKNOWN),
    DriveState: (DRIVE, DriveEvent, DriveState.WAITING),
    StopState: (STOP, StopEvent, StopState.NONE),
    VelocityState: (VELOCITY, VelocityEvent, VelocityState.SILENT),
    SenderState: (SENDER, SenderEvent, SenderState.SILENT),
}
PAIRS = [(state, event) for states, (_table, events, _first) in TABLES.items() for state in states for event in events]


@pytest.mark.parametrize(("state", "event"), PAIRS, ids=lambda value: value.name.lower())
def test_each_event_leads_to_the_state_given_by_the_table(state: Enum, event: Enum) -> None:
    table = TABLES[type(state)][0]
    machine: Machine[Any, Any] = Machine(table, state)
    since = machine.since
    following = table[state].get(event, state)
    assert machine.on(event) == (following is not state)
    assert machine.state is following
    assert (machine.since == since) == (following is state)


@pytest.mark.parametrize("states", TABLES, ids=lambda states: states.__name__)
def test_each_state_is_reachable(states: type[Enum]) -> None:
    table, _events, first = TABLES[states]
    reached, pending = {first}, [first]
    while pending:
        following = set(table[pending.pop()].values()) - reached
        reached |= following
        pending.extend(following)
    assert reached == set(states)


def test_a_planner_is_never_idle_before_it_has_reported() -> None:
    """An empty container is not an answer: every transition to `IDLE` is caused by a list without goals."""
    paths = {(state, event) for state, row in PLANNER.items() for event, to in row.items() if to is PlannerState.IDLE}
    assert paths
    assert {event for _state, event in paths} == {PlannerEvent.NO_GOALS}
    assert {state for state, _event in paths} <= {
        PlannerState.UNREPORTED,
        PlannerState.IDLE,
        PlannerState.DRIVING,
    }


def test_a_stop_is_confirmed_by_both_the_planner_and_the_base() -> None:
    for state, row in STOP.items():
        for event, to in row.items():
            if to is StopState.CONFIRMED:
                assert (state, event) in {
                    (StopState.RESTING, StopEvent.RELEASED),
                    (StopState.SETTLING, StopEvent.STANDS),
                }


def test_a_sender_that_was_stopped_or_displaced_drives_only_after_a_pause() -> None:
    for state in (SenderState.STOPPED, SenderState.DISPLACED):
        following = {event: to for event, to in SENDER[state].items() if to is not SenderState.STOPPED}
        assert following == {SenderEvent.PAUSE: SenderState.SILENT, SenderEvent.END: SenderState.ENDED}


ENDED = frozenset((State.IDLE, State.REACHED, State.ABORTED, State.PAUSED))
SITUATIONS = [
    Situation("nav2", planner_state=planner, planner_age=9.0, base=base, goals=goals, doubtful=doubtful, motion=motion,
              foreign=foreign, drive=drive, stop=stop, stop_age=age, unreleased=True,
              odometry=base is not Base.UNKNOWN)
    for planner, base, goals, doubtful, motion, foreign, drive, stop, age in itertools.product(
        PlannerState,
        Base,
        (None, False, True),
        (False, True),
        ((), ("/follow_path",)),
        (None, PlannerStatus(State.MOVING, "a goal")),
        (None, *DriveState),
        StopState,
        (0.5, 5.0),
    )
]  # fmt: skip


def test_no_report_claims_a_standing_robot_while_its_base_moves() -> None:
    """With a goal that may be executing, a moving base is always reported as moving."""
    checked = 0
    for now in SITUATIONS:
        planner_moves = now.motion or now.doubtful or now.foreign or not now.planner_state.reported
        absent = now.planner_state is PlannerState.ABSENT and not (now.doubtful or now.motion or now.foreign)
        resting = now.stop is StopState.RESTING  # the stop order has its own evidence that the base stands
        if now.base is not Base.MOVING or absent or resting or now.drive in (DriveState.PAUSED, DriveState.ENDED):
            continue
        if now.drive is None and not planner_moves and not now.stop.open:
            continue
        checked += 1
        status = derive(now)
        assert status.state not in ENDED | {State.PREPARING}, (now, status)
    assert checked > 1000


def test_no_end_is_reported_while_the_goal_is_not_released() -> None:
    for now in SITUATIONS:
        if now.drive in (DriveState.PAUSING, DriveState.STOPPING, DriveState.LOST, DriveState.JUDGING):
            assert derive(now).state not in ENDED, now


def test_a_drive_is_prepared_only_while_nothing_may_execute_a_goal() -> None:
    """The base may move before its odometry arrives."""
    prepared = [now for now in SITUATIONS if derive(now).state is State.PREPARING]
    assert not prepared, "none of their goals is released"
    released = [replace(now, unreleased=False) for now in SITUATIONS]
    prepared = [now for now in released if derive(now).state is State.PREPARING]
    assert {now.drive for now in prepared} == {DriveState.WAITING, DriveState.LOST}
    assert {(now.base is Base.MOVING, now.goals is True, now.motion) for now in prepared} == {(False, False, ())}


def test_a_goal_that_waits_for_a_planner_that_has_not_reported_does_not_show_a_robot_that_stands() -> None:
    """A client of the planner itself may drive the robot before its first goal list arrives."""
    waiting = Situation("nav2", PlannerState.UNKNOWN, drive=DriveState.WAITING)
    assert derive(waiting) == derive(replace(waiting, drive=None))
    assert derive(waiting).state is State.THINKING
    assert derive(replace(waiting, base=Base.STANDING)).state is State.PREPARING
    assert derive(replace(waiting, base=Base.MOVING)).state is State.MOVING
    assert derive(replace(waiting, planner_state=PlannerState.ABSENT)).state is State.PREPARING


def test_a_base_that_moves_is_not_reported_as_prepared_although_its_planner_prepares() -> None:
    """RobotGoto backs off before it drives to its goal."""
    reported = PlannerStatus(State.PREPARING, "waiting for a map", Fault.NO_MAP)
    now = Situation("robot_goto", PlannerState.DRIVING, drive=DriveState.DRIVING, reported=reported)
    assert derive(replace(now, base=Base.STANDING)) == reported
    assert derive(replace(now, base=Base.MOVING)) == reported._replace(state=State.MOVING)


def test_an_unknown_planner_is_not_idle() -> None:
    for planner in (PlannerState.UNKNOWN, PlannerState.UNREPORTED):
        moving = derive(Situation("nav2", planner, base=Base.MOVING))
        assert (moving.state, moving.fault) == (State.MOVING, Fault.MAY_MOVE)
        assert "it is not known whether nav2 has a goal" in moving.reason
        assert derive(Situation("nav2", planner, base=Base.UNKNOWN)).state is State.THINKING
        assert derive(Situation("nav2", planner, base=Base.STANDING)).state is State.IDLE


def test_goals_of_several_poses_are_unknown_until_their_list_arrives() -> None:
    """After a restart of the gateway, the planner may still be executing such a goal."""
    moving = derive(Situation("nav2", PlannerState.IDLE, 9.0, base=Base.MOVING, unlisted=True))
    assert (moving.state, moving.fault) == (State.MOVING, Fault.MAY_MOVE)
    assert derive(Situation("nav2", PlannerState.IDLE, 9.0, base=Base.UNKNOWN, unlisted=True)).state is State.THINKING
    assert derive(Situation("nav2", PlannerState.IDLE, 9.0, base=Base.STANDING, unlisted=True)).state is State.IDLE


def test_a_stop_is_ok_only_if_it_is_confirmed() -> None:
    for now in SITUATIONS:
        ok = not trouble(now)
        assert ok == (now.stop in (StopState.NONE, StopState.CONFIRMED, StopState.RESTING)), now
        assert ok or MAY_MOVE in trouble(now)


def test_no_reason_repeats_itself() -> None:
    for now in SITUATIONS:
        for sentence in (derive(now).reason, trouble(now)):
            assert sentence.count("may still be moving") <= 1, sentence
