"""Cancel requests are sent to an actionlib server."""

import pytest

from bridge.adapters.ros1.actions.cancels import CROSSING_SECONDS
from bridge.adapters.ros1.actions.client import CONNECT_SECONDS
from bridge.adapters.ros1.actions.discovery import CANCEL
from bridge.adapters.ros1.actions.states import Ros1State
from bridge.adapters.ros1.actions.wire import ZERO, GoalId, RosTime
from bridge.messages.actions import CancelCode
from tests.peers.ros1.client_world import World, canceled, name


@pytest.fixture
def world():
    return World()


def test_a_cancel_request_for_one_goal_is_answered_once_the_goal_is_preempting(world):
    world.send(1), world.send(2)
    world.report((1, Ros1State.ACTIVE), (2, Ros1State.ACTIVE))
    answers = world.stop(1)
    assert world.cancels == [GoalId(ZERO, name(1))]
    world.report((1, Ros1State.ACTIVE), (2, Ros1State.ACTIVE))
    assert not answers
    world.report((1, Ros1State.PREEMPTING), (2, Ros1State.ACTIVE))
    assert canceled(answers) == (CancelCode.NONE, {1})


def test_cancel_a_goal_that_has_just_ended(world):
    world.send(1)
    world.report((1, Ros1State.ACTIVE))
    answers = world.stop(1)
    world.ends(1, Ros1State.SUCCEEDED)
    assert canceled(answers) == (CancelCode.GOAL_TERMINATED, set())
    assert canceled(world.stop(1)) == (CancelCode.GOAL_TERMINATED, set())
    assert canceled(world.stop(7)) == (CancelCode.UNKNOWN_GOAL_ID, set())


def test_a_cancel_request_for_all_goals_names_all_active_ones_in_its_reply(world):
    for number in range(4):
        world.send(number)
    world.report((0, Ros1State.PENDING), (1, Ros1State.ACTIVE), (2, Ros1State.ACTIVE))
    world.ends(2, Ros1State.SUCCEEDED)
    answers = world.stop()
    assert world.cancels == [GoalId(ZERO, "")]
    world.report((0, Ros1State.RECALLING), (1, Ros1State.PREEMPTED), (3, Ros1State.RECALLED))
    assert canceled(answers) == (CancelCode.NONE, {0, 1})
    assert canceled(World().stop()) == (CancelCode.NONE, set())


def test_a_cancel_request_by_time_names_the_goals_up_to_that_time(world):
    for number in (1, 2, 3):
        world.send(number)
    world.report(*((n, Ros1State.ACTIVE, RosTime(n, 0)) for n in (1, 2, 3)))
    answers = world.stop(stamp=RosTime(2, 0))
    assert world.cancels == [GoalId(RosTime(2, 0), "")]
    world.report(*((n, Ros1State.PREEMPTING if n < 3 else Ros1State.ACTIVE, RosTime(n, 0)) for n in (1, 2, 3)))
    assert canceled(answers) == (CancelCode.NONE, {1, 2})
    both = world.stop(3, RosTime(1, 0))
    world.report((3, Ros1State.PREEMPTING))
    assert canceled(both)[1] >= {3}


def test_a_cancel_request_waits_for_the_connections_but_not_forever(world):
    world.send(1)
    world.report((1, Ros1State.ACTIVE))
    world.client.disconnected()
    early = world.stop(1)
    assert (early, world.cancels) == ([], [])
    world.client.connected()
    assert world.cancels == [GoalId(ZERO, name(1))]
    world.client.disconnected()
    late = world.stop()
    world.advance(CONNECT_SECONDS + 0.1)
    assert canceled(late) == (CancelCode.REJECTED, set())
    last = world.stop()
    world.client.lost("the server is gone")
    assert canceled(last) == (CancelCode.REJECTED, set())
    assert canceled(early) == (CancelCode.REJECTED, set()), "the server has not confirmed the request"
    assert canceled(world.stop()) == (CancelCode.REJECTED, set()), "no request is held for an unreachable server"
    assert len(world.cancels) == 1


def test_a_request_for_one_goal_is_sent_once_the_server_reports_the_goal(world):
    """Goal and request use two connections, so otherwise the request could arrive first."""
    world.send(1)
    answers = world.stop(1)
    assert world.cancels == []
    world.report((1, Ros1State.PENDING))
    assert world.cancels == [GoalId(ZERO, name(1))]
    world.report((1, Ros1State.RECALLED))
    assert canceled(answers) == (CancelCode.NONE, {1})


def test_a_request_is_sent_after_a_while_if_the_server_reports_nothing(world):
    world.send(1)
    world.stop(1)
    world.advance(CROSSING_SECONDS / 2)
    assert world.cancels == []
    world.advance(CROSSING_SECONDS / 2)
    assert world.cancels == [GoalId(ZERO, name(1))]


def test_a_request_is_not_sent_for_a_goal_that_has_ended(world):
    world.send(1)
    answers = world.stop(1)
    world.ends(1, Ros1State.SUCCEEDED)
    world.advance(0.1)
    assert world.cancels == []
    assert canceled(answers) == (CancelCode.GOAL_TERMINATED, set())


def test_cancel_all_is_sent_at_once_and_repeated_for_a_goal_that_it_overtook(world):
    world.send(1)
    answers = world.stop()
    assert world.cancels == [GoalId(ZERO, "")]
    world.report((1, Ros1State.ACTIVE))
    assert world.cancels == [GoalId(ZERO, ""), GoalId(ZERO, name(1))]
    world.report((1, Ros1State.PREEMPTING))
    assert canceled(answers) == (CancelCode.NONE, {1})


def test_requests_that_may_be_lost_with_their_connection_are_sent_again_for_unaffected_goals(world):
    for number in (1, 2, 3):
        world.send(number)
    world.report(*((n, Ros1State.ACTIVE) for n in (1, 2, 3)))
    every, single = world.stop(), world.stop(1)
    world.report((1, Ros1State.ACTIVE), (2, Ros1State.PREEMPTING), (3, Ros1State.ACTIVE))
    world.client.reconnected(CANCEL)
    assert world.cancels[2:] == [GoalId(ZERO, name(1)), GoalId(ZERO, name(3))]
    assert (every, single) == ([], [])
    world.report(*((n, Ros1State.PREEMPTING) for n in (1, 2, 3)))
    assert canceled(every) == (CancelCode.NONE, {1, 2, 3})
    world.client.reconnected(CANCEL)
    assert len(world.cancels) == 4


def test_a_stop_needs_only_the_cancel_topic(world):
    world.send(1)
    world.report((1, Ros1State.ACTIVE))
    world.client.disconnected()
    world.client.reach(reachable=True)
    world.stop(1)
    assert world.cancels == [GoalId(ZERO, name(1))]
