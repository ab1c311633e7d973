"""`ActionlibClient` is tested against a model of an actionlib server whose topics arrive in any order."""

import pytest

from bridge.adapters.ros1.actions import goal as goal_module
from bridge.adapters.ros1.actions import states, wire
from bridge.adapters.ros1.actions.client import CONNECT_SECONDS
from bridge.adapters.ros1.actions.discovery import GOAL
from bridge.adapters.ros1.actions.states import Ros1State
from bridge.adapters.ros1.actions.wire import ZERO, GoalId, GoalInfo, RosTime
from bridge.hub.endpoints.calls import CallError
from bridge.messages.actions import CancelCode, GoalState
from tests.peers.ros1.client_world import (
    ANY,
    EMPTY,
    World,
    accepted,
    canceled,
    lost,
    name,
    result,
    status,
    uuid,
)

GONE = "lost sight of the goal: the server is gone"


@pytest.fixture
def world():
    return World()


def test_a_goal_is_sent_with_stamp_zero_and_a_unique_id(world):
    world.send(1, b"one")
    world.send(2, b"two")
    assert world.goals == [(GoalId(ZERO, name(1)), b"one"), (GoalId(ZERO, name(2)), b"two")]
    assert name(1) != name(2)


@pytest.mark.parametrize("state", [Ros1State.PENDING, Ros1State.ACTIVE, Ros1State.PREEMPTING, Ros1State.SUCCEEDED])
def test_a_goal_is_accepted_with_the_servers_stamp_once_its_state_is_reported(world, state):
    answers = world.send(1)
    world.report()
    assert not answers
    world.report((1, state))
    assert answers == [wire.goal_response(RosTime(5, 0), accepted=True)]


@pytest.mark.parametrize("state", [Ros1State.REJECTED, Ros1State.RECALLED])
@pytest.mark.parametrize("by_result", [True, False])
def test_a_goal_that_the_server_rejects_is_rejected(world, state, by_result):
    answers = world.send(1)
    if by_result:
        world.ends(1, state)
    world.report((1, state))
    assert accepted(answers) is False
    assert result(world.ask(1)) == (GoalState.UNKNOWN, EMPTY)
    assert all(uuid(1) not in states for states in world.states)


def test_a_goal_that_is_rejected_after_it_was_pending_is_aborted(world):
    answers, request = world.send(1), world.ask(1)
    world.report((1, Ros1State.PENDING))
    world.ends(1, Ros1State.REJECTED, b"why")
    assert accepted(answers)
    assert result(request) == (GoalState.ABORTED, b"why")


def test_a_uuid_is_valid_for_one_goal(world):
    world.send(1)
    assert accepted(world.send(1)) is False
    assert len(world.goals) == 1
    answers = []
    world.client.send_goal(ANY, answers.append)
    assert accepted(answers) is False


def test_too_many_goals_are_rejected(world, monkeypatch):
    monkeypatch.setattr(goal_module, "MAX_OPEN", 3)
    for number in range(3):
        assert not world.send(number)
    assert accepted(world.send(3)) is False


def test_malformed_calls_end_with_an_error(world):
    for call in (world.client.send_goal, world.client.get_result, world.client.cancel):
        answers = []
        call(b"short", answers.append)
        assert isinstance(answers[0], CallError)


def test_a_new_goal_preempts_the_old_one(world):
    first, second = world.send(1), world.send(2)
    call = world.ask(1)
    world.report((1, Ros1State.ACTIVE), (2, Ros1State.PENDING))
    world.ends(1, Ros1State.PREEMPTED, text="another goal was received")
    world.report((1, Ros1State.PREEMPTED), (2, Ros1State.ACTIVE))
    assert accepted(first)
    assert accepted(second)
    assert result(call)[0] is GoalState.CANCELED
    assert world.states[-1] == {uuid(1): GoalState.CANCELED, uuid(2): GoalState.EXECUTING}


def test_goals_of_a_lost_server_are_unknown_once_and_no_state_is_published(world):
    waiting, running, over = world.send(1), world.send(2), world.send(3)
    world.report((2, Ros1State.ACTIVE), (3, Ros1State.SUCCEEDED))
    requests = [world.ask(n) for n in (1, 2, 3)]
    stop, states_before = world.stop(2), list(world.states)
    world.client.lost("the server is gone")
    (error,) = waiting
    assert (str(error), accepted(running), accepted(over)) == (GONE, True, True)
    assert [lost(a) for a in requests[:2]] == [GONE, GONE]
    assert result(requests[2]) == (GoalState.SUCCEEDED, EMPTY)
    assert canceled(stop) == (CancelCode.REJECTED, set()), "the request can no longer be confirmed"
    assert accepted(world.send(4)) is False, "no goal is held for an unreachable server"
    world.advance(10.0)
    assert world.states == states_before, (
        "the goal may still be executing, so neither its end nor a list without it is published"
    )
    assert lost(world.ask(2)) == GONE
    world.client.discovered()
    world.client.connected()
    assert not world.send(5)
    assert len(world.goals) == 4


def test_goals_that_were_never_sent_to_a_lost_server_are_rejected(world):
    world.client.disconnected()
    answers = world.send(1)
    world.client.lost("the server is gone")
    assert accepted(answers) is False


def test_a_goal_that_is_reported_again_is_followed_to_its_end(world):
    native = states.uuid_of("/act", "/rviz-1")
    world.send(1)
    world.report((1, Ros1State.ACTIVE), ("/rviz-1", Ros1State.ACTIVE))
    world.client.lost("the server is gone")
    world.client.discovered()
    world.client.connected()
    assert canceled(world.stop(1)) == (CancelCode.UNKNOWN_GOAL_ID, set())
    assert world.cancels == [GoalId(ZERO, name(1))], "a stop is sent nevertheless"
    world.report((1, Ros1State.ACTIVE), ("/rviz-1", Ros1State.ACTIVE))
    assert world.states[-1] == {uuid(1): GoalState.EXECUTING, native: GoalState.EXECUTING}
    call = world.ask(1)
    world.stop(1)
    assert world.cancels == [GoalId(ZERO, name(1))] * 2
    world.ends(1, Ros1State.PREEMPTED, b"stopped")
    assert result(call) == (GoalState.CANCELED, b"stopped")
    world.client.close("the bridge stops")
    assert len(world.cancels) == 2, "goals of others are never canceled by the bridge"


def test_the_first_list_of_a_server_is_published_even_if_it_is_empty(world):
    """The empty list proves that the server has no goals, which was unknown before."""
    world.report()
    assert world.states == [{}]
    world.report()
    assert world.states == [{}]
    world.client.lost("the server is gone")
    world.client.discovered()
    assert world.states == [{}]
    world.report()
    assert world.states == [{}, {}]


def test_a_goal_that_its_server_no_longer_lists_is_unknown(world):
    world.send(1), world.send(2)
    call = world.ask(1)
    world.report((1, Ros1State.ACTIVE))
    world.report()
    assert lost(call) == "lost sight of the goal: the server no longer lists it"
    assert world.states[-1] == {}, "the server's list shows that the server has no such goal"
    world.advance(5.0)
    assert not world.ask(2), "the goal was never in the list, so it may not have arrived yet"


def test_goals_wait_for_the_connections_but_not_forever(world):
    world.client.disconnected()
    answers = world.send(1)
    late = []
    abandon = world.client.send_goal(uuid(2) + b"left", late.append)
    abandon()
    world.client.connected()
    assert world.goals == [(GoalId(ZERO, name(1)), b"body")]
    world.client.disconnected()
    waiting = world.send(3)
    world.advance(CONNECT_SECONDS + 0.1)
    assert accepted(waiting) is False
    world.client.connected()
    assert len(world.goals) == 1
    assert accepted(answers) is False, "it is unknown whether the goal has arrived"
    assert late == []


def test_a_goal_that_may_be_lost_with_its_connection_is_sent_again(world):
    world.send(1)
    left = world.client.send_goal(uuid(2) + b"left", [].append)
    world.send(3)
    world.report((3, Ros1State.ACTIVE))
    left()
    world.client.reconnected(GOAL)
    assert [goal.id for goal, _ in world.goals] == [name(n) for n in (1, 2, 3, 1)]
    assert world.goals[0] == world.goals[3]


def test_a_rejected_goal_that_arrives_nevertheless_is_canceled(world):
    answers = world.send(1)
    world.client.disconnected()
    world.client.reach(reachable=True)
    world.advance(CONNECT_SECONDS + 0.1)
    assert accepted(answers) is False
    assert world.cancels == [GoalId(ZERO, name(1))], "it may have arrived already"
    world.client.connected()
    world.report((1, Ros1State.ACTIVE))
    assert world.cancels == [GoalId(ZERO, name(1))] * 2
    world.report((1, Ros1State.PREEMPTING))
    assert len(world.cancels) == 2


def test_closing_cancels_and_ends_the_goals_of_the_hub(world):
    world.send(1)
    request, native = world.ask(1), states.uuid_of("/act", "/rviz-1")
    world.report((1, Ros1State.ACTIVE), ("/rviz-1", Ros1State.ACTIVE))
    world.client.close("the bridge stops")
    assert world.cancels == [GoalId(ZERO, name(1))]
    assert lost(request) == "lost sight of the goal: the bridge stops"
    assert world.states[-1] == {uuid(1): GoalState.EXECUTING, native: GoalState.EXECUTING}


def test_closing_cancels_goals_while_another_connection_to_the_server_is_missing(world):
    """For example the connection to the status topic, which the server has just closed and will accept again."""
    world.send(1)
    world.report((1, Ros1State.ACTIVE))
    world.client.disconnected()
    world.client.reach(reachable=True)
    world.client.close("the bridge stops")
    assert world.cancels == [GoalId(ZERO, name(1))]


def test_goals_of_native_clients_appear_and_can_be_followed_and_canceled(world):
    native = states.uuid_of("/act", "/rviz-1")
    world.report(("/rviz-1", Ros1State.ACTIVE))
    assert world.states[-1] == {native: GoalState.EXECUTING}
    request, answers = [], []
    world.client.get_result(native, request.append)
    world.client.cancel(wire.cancel_request(GoalInfo(native, ZERO)), answers.append)
    assert world.cancels == [GoalId(ZERO, "/rviz-1")]
    world.client.result(status("/rviz-1", Ros1State.PREEMPTED), b"stopped")
    assert result(request) == (GoalState.CANCELED, b"stopped")
    assert wire.read_cancel_response(answers[0])[1] == [GoalInfo(native, RosTime(5, 0))]
    world.report(("/rviz-1", Ros1State.ACTIVE))
    assert world.states[-1] == {native: GoalState.CANCELED}, "an old list may arrive late"
    world.report(("/rviz-1", Ros1State.ACTIVE, RosTime(9, 0)))
    assert world.states[-1] == {native: GoalState.EXECUTING}, "a client may reuse the id"


def test_a_goal_of_a_killed_worker_is_recognized_by_its_id(world):
    world.report((1, Ros1State.ACTIVE))
    call = world.ask(1)
    world.ends(1, Ros1State.SUCCEEDED, b"there")
    assert result(call) == (GoalState.SUCCEEDED, b"there")
    assert accepted(world.send(1)) is False
