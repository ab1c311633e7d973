"""Results of goals that were sent to an actionlib server."""

import pytest

from bridge.adapters.ros1.actions import goal as goal_module
from bridge.adapters.ros1.actions import states
from bridge.adapters.ros1.actions.client import RESULT_SECONDS
from bridge.adapters.ros1.actions.states import Ros1State
from bridge.adapters.ros1.actions.wire import RosTime
from bridge.messages.actions import GoalState
from tests.peers.ros1.client_world import EMPTY, World, accepted, lost, reason, result, status, uuid


@pytest.fixture
def world():
    return World()


@pytest.mark.parametrize("by_result", [True, False])
@pytest.mark.parametrize(
    ("state", "why"), [(Ros1State.ABORTED, "no way"), (Ros1State.PREEMPTED, "no way"), (Ros1State.SUCCEEDED, "")]
)
def test_the_servers_status_text_is_returned_with_the_result(world, state, why, by_result):
    """The text is returned even if the result was lost. A reached goal has no error text."""
    world.send(1)
    before = world.ask(1)
    if by_result:
        world.ends(1, state, text="no way")
    else:
        world.client.statuses([status(1, state, text="no way")])
        world.advance(RESULT_SECONDS + 0.1)
    assert [reason(before), reason(world.ask(1))] == [why, why]


def test_lost_goals_have_a_reason(world):
    removed, forgotten = world.send(1), world.send(2)
    world.report((1, Ros1State.ACTIVE), (2, Ros1State.ACTIVE))
    world.report((1, Ros1State.ACTIVE))
    world.client.lost("its action server /move_base left")
    assert accepted(removed)
    assert accepted(forgotten)
    assert lost(world.ask(1)) == "lost sight of the goal: its action server /move_base left"
    assert lost(world.ask(2)) == "lost sight of the goal: the server no longer lists it"


def test_a_result_before_any_status_accepts_and_ends_the_goal(world):
    answers, request = world.send(1), world.ask(1)
    world.ends(1, Ros1State.SUCCEEDED, b"done")
    assert accepted(answers)
    assert result(request) == (GoalState.SUCCEEDED, b"done")


def test_feedback_accepts_the_goal_and_is_forwarded(world):
    answers = world.send(1)
    world.client.feedback(status(1, Ros1State.ACTIVE), b"half")
    assert accepted(answers)
    assert world.feedbacks == [(uuid(1), b"half")]
    world.ends(1, Ros1State.SUCCEEDED)
    world.client.feedback(status(1, Ros1State.ACTIVE), b"overtaken")
    assert world.feedbacks[1:] == [(uuid(1), b"overtaken")]
    assert world.states[-1] == {uuid(1): GoalState.SUCCEEDED}


def test_the_missing_result_of_a_goal_does_not_end_a_new_goal_with_its_id(world):
    native = states.uuid_of("/act", "/rviz-1")
    world.report(("/rviz-1", Ros1State.SUCCEEDED))
    first, second = [], []
    world.client.get_result(native, first.append)
    world.report(("/rviz-1", Ros1State.ACTIVE, RosTime(9, 0)))
    assert result(first) == (GoalState.SUCCEEDED, EMPTY)
    world.client.get_result(native, second.append)
    world.advance(RESULT_SECONDS + 0.1)
    world.report(("/rviz-1", Ros1State.PREEMPTING, RosTime(9, 0)))
    assert world.states[-1] == {native: GoalState.CANCELING}
    world.client.lost("its server left")
    assert lost(second) == "lost sight of the goal: its server left"


def test_a_result_is_returned_to_all_earlier_and_later_callers(world):
    world.send(1)
    before = [world.ask(1), world.ask(1)]
    world.report((1, Ros1State.ACTIVE))
    world.ends(1, Ros1State.PREEMPTED, b"half way")
    world.advance(3000.0)
    for answers in [*before, world.ask(1)]:
        assert result(answers) == (GoalState.CANCELED, b"half way")


def test_results_are_stored_for_an_hour_and_within_limits(world, monkeypatch):
    world.send(1)
    world.ends(1, Ros1State.SUCCEEDED)
    world.advance(goal_module.KEEP_SECONDS - 1.0)
    assert result(world.ask(1))[0] is GoalState.SUCCEEDED
    world.advance(2.0)
    assert result(world.ask(1))[0] is GoalState.UNKNOWN
    monkeypatch.setattr(goal_module, "MAX_ENDED", 5)
    for number in range(10, 20):
        world.send(number)
        world.ends(number, Ros1State.SUCCEEDED)
    world.advance(0.1)
    assert world.client.kept == 5
    assert result(world.ask(19))[0] is GoalState.SUCCEEDED
    monkeypatch.setattr(goal_module, "MAX_ENDED_BYTES", 1000)
    world.send(30)
    world.ends(30, Ros1State.SUCCEEDED, bytes(999))
    world.send(31)
    world.ends(31, Ros1State.SUCCEEDED, bytes(900))
    world.advance(0.1)
    assert world.client.kept == 1


def test_a_lost_result_is_empty_and_has_the_state_of_the_list(world):
    world.send(1)
    call = world.ask(1)
    world.report((1, Ros1State.SUCCEEDED))
    world.advance(RESULT_SECONDS - 0.1)
    assert not call
    world.advance(0.2)
    assert result(call) == (GoalState.SUCCEEDED, EMPTY)
    world.ends(1, Ros1State.SUCCEEDED, b"late")
    assert result(world.ask(1)) == (GoalState.SUCCEEDED, EMPTY), "the empty result was already delivered"


def test_a_late_result_counts_if_it_was_not_requested_before(world):
    world.send(1)
    world.report((1, Ros1State.SUCCEEDED))
    world.advance(RESULT_SECONDS + 0.1)
    world.ends(1, Ros1State.SUCCEEDED, b"late")
    assert result(world.ask(1)) == (GoalState.SUCCEEDED, b"late")
    world.ends(1, Ros1State.ABORTED, b"again")
    assert result(world.ask(1)) == (GoalState.SUCCEEDED, b"late")


def test_the_first_result_counts(world):
    world.send(1)
    world.ends(1, Ros1State.SUCCEEDED, b"first")
    world.ends(1, Ros1State.ABORTED, b"second")
    assert result(world.ask(1)) == (GoalState.SUCCEEDED, b"first")
