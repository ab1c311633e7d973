"""The status topic of goals that were sent to an actionlib server, and events in any order."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.adapters.ros1.actions.client import RESULT_SECONDS, SHOWN_SECONDS
from bridge.adapters.ros1.actions.states import TO_ROS2, Ros1State
from bridge.messages.actions import GoalState
from tests.peers.ros1.client_world import (
    EMPTY,
    World,
    accepted,
    result,
    status,
    uuid,
)


@pytest.fixture
def world():
    return World()


def test_a_goal_never_steps_back(world):
    world.send(1)
    for state, seen in (
        (Ros1State.ACTIVE, GoalState.EXECUTING),
        (Ros1State.PENDING, GoalState.EXECUTING),
        (Ros1State.PREEMPTING, GoalState.CANCELING),
        (Ros1State.ACTIVE, GoalState.CANCELING),
    ):
        world.report((1, state))
        assert world.states[-1] == {uuid(1): seen}


def test_ended_goals_leave_the_status_topic(world):
    world.send(1), world.send(2)
    world.report((1, Ros1State.ACTIVE), (2, Ros1State.ACTIVE))
    world.ends(1, Ros1State.SUCCEEDED)
    assert world.states[-1][uuid(1)] is GoalState.SUCCEEDED
    world.advance(SHOWN_SECONDS + 1)
    world.ends(2, Ros1State.SUCCEEDED)
    assert uuid(1) not in world.states[-1]


def test_an_unchanged_list_is_published_while_the_server_publishes_it(world):
    """The list shows clients that the server is alive. move_base publishes its list five times per second."""
    world.send(0)
    world.report((0, Ros1State.ACTIVE))
    reported = len(world.states)
    for _ in range(25):
        world.advance(0.2)
        world.report((0, Ros1State.ACTIVE))
    assert len(world.states) == reported + 5
    world.advance(10.0)  # the server hangs, so nothing is published
    assert len(world.states) == reported + 5
    world.ends(0, Ros1State.SUCCEEDED)
    reported = len(world.states)
    world.advance(5.0)
    world.report((0, Ros1State.SUCCEEDED))
    assert len(world.states) == reported


def test_many_goals_do_not_flood_the_status_topic(world):
    for number in range(500):
        world.send(number)
        world.report(*((n, Ros1State.ACTIVE) for n in range(number + 1)))
    world.advance(0.1)
    assert len(world.states) < 100
    assert len(world.states[-1]) == 500


ENDS = [Ros1State.SUCCEEDED, Ros1State.ABORTED, Ros1State.PREEMPTED, Ros1State.REJECTED, Ros1State.RECALLED]


@settings(max_examples=150)
@given(st.integers(0, 1 << 64), st.integers(1, 12), st.floats(0, 1))
def test_every_goal_ends_in_the_state_that_its_server_reported(seed: int, count: int, loss: float):
    """The server passes through its states; status lists, feedback and results arrive late, each topic in order."""
    rng, world = random.Random(seed), World()
    answers = {n: world.send(n) for n in range(count)}
    call = {n: world.ask(n) for n in range(count)}
    state = dict.fromkeys(range(count), Ros1State.PENDING)
    lost, lists, results, feedbacks = set(), [], [], []
    steps = [n for n in range(count) for _ in range(3)]
    rng.shuffle(steps)
    for n in steps:
        if not state[n].ended:
            state[n] = _next(rng, state[n])
            if state[n].ended:
                if rng.random() < loss * 0.5:
                    lost.add(n)
                else:
                    results.append((status(n, state[n]), bytes([n])))
            elif state[n] is Ros1State.ACTIVE:
                feedbacks.append((status(n, state[n]), b"f"))
        lists.append([status(m, s) for m, s in state.items()])
    for n in range(count):
        if not state[n].ended:
            state[n] = Ros1State.SUCCEEDED if state[n] is Ros1State.ACTIVE else Ros1State.PREEMPTED
            results.append((status(n, state[n]), bytes([n])))
    lists.append([status(m, s) for m, s in state.items()])
    while lists or results or feedbacks:
        queue, take = rng.choice([
            p for p in (
                (lists, lambda message: world.client.statuses(message)),
                (results, lambda message: world.client.result(*message)),
                (feedbacks, lambda message: world.client.feedback(*message)),
            ) if p[0]
        ])  # fmt: skip
        take(queue.pop(0))
        world.advance(rng.random() * 0.02)
    world.advance(RESULT_SECONDS + 1)
    for n in range(count):
        refused = accepted(answers[n]) is False
        reported, body = result(call[n])
        if refused:
            assert state[n] in (Ros1State.REJECTED, Ros1State.RECALLED)
            assert reported is GoalState.UNKNOWN
        else:
            assert reported is TO_ROS2[state[n]]
            assert body == (EMPTY if n in lost else bytes([n]))
    assert len(world.feedbacks) <= sum(1 for _ in steps)


def _next(rng, state) -> Ros1State:
    follows = {
        Ros1State.PENDING: [Ros1State.ACTIVE, Ros1State.ACTIVE, Ros1State.REJECTED, Ros1State.RECALLING],
        Ros1State.RECALLING: [Ros1State.RECALLED, Ros1State.PREEMPTING],
        Ros1State.ACTIVE: [Ros1State.SUCCEEDED, Ros1State.ABORTED, Ros1State.PREEMPTING],
        Ros1State.PREEMPTING: [Ros1State.PREEMPTED, Ros1State.SUCCEEDED, Ros1State.ABORTED],
    }
    return rng.choice(follows[state])
