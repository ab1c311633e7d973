"""The order of one client's goals and cancel requests, with a simulated clock."""

import pytest

from bridge.adapters.ros1.actions import cancel_order
from bridge.adapters.ros1.actions.cancel_order import CROSSING_SECONDS, LONGEST_SECONDS, CancelOrder
from bridge.adapters.ros1.actions.wire import ZERO, GoalId, RosTime

ME, OTHER = ("/me", "http://a:1/"), ("/other", "http://a:2/")
ALL = GoalId(ZERO, "")


class World:
    """Records the order of goals and cancel requests at the server, and which clients have unread goals."""

    def __init__(self) -> None:
        self.now, self.passed, self.known = 100.0, [], set()
        self.unread, self.listed = set(), set()
        self.order = CancelOrder(self, self.is_unread, lambda: self.now)

    def is_unread(self, client, *, listed):
        return client in self.unread or (listed and client in self.listed)

    def goal(self, goal, _body):
        listed = goal.id or "made up"
        self.passed.append(f"goal {listed}")
        self.known.add(listed)
        return listed

    def cancel(self, request):
        self.passed.append(f"cancel {request.id}" if request.stamp == ZERO else f"before {request.stamp.secs}")

    def knows(self, goal):
        return goal in self.known

    def send(self, goal, client=ME):
        self.order.goal(GoalId(ZERO, goal), b"", client)

    def stop(self, request, client=ME):
        self.order.cancel(request, client, unread=client in self.unread)

    def advance(self, seconds):
        self.now += seconds
        self.order.release()


@pytest.fixture
def world():
    return World()


def test_goals_and_cancel_requests_in_order_are_forwarded_at_once(world):
    world.send("a")
    world.stop(GoalId(ZERO, "a"))
    world.stop(ALL)
    world.stop(GoalId(RosTime(5, 0), ""))
    assert world.passed == ["goal a", "cancel a", "cancel ", "before 5"]


def test_a_cancel_request_that_arrives_first_is_forwarded_after_its_goal(world):
    world.stop(GoalId(ZERO, "a"))
    world.advance(CROSSING_SECONDS / 2)
    assert world.passed == []
    world.send("b")
    world.send("a")
    assert world.passed == ["goal b", "goal a", "cancel a"]
    world.advance(LONGEST_SECONDS)
    assert world.passed == ["goal b", "goal a", "cancel a"], "the request is forwarded once"


def test_a_request_whose_goal_never_arrives_is_forwarded_to_the_server(world):
    world.stop(GoalId(ZERO, "a"))
    world.advance(CROSSING_SECONDS)
    assert world.passed == ["cancel a"]
    world.send("a")
    assert world.passed == ["cancel a", "goal a"], "the server decides from then on"


@pytest.mark.parametrize("why", ["unread", "listed"])
def test_a_request_is_held_while_its_clients_goals_are_unread(world, why):
    getattr(world, why).add(ME)
    world.stop(GoalId(ZERO, "a"))
    for _ in range(10):
        world.advance(CROSSING_SECONDS)
    assert world.passed == []
    getattr(world, why).clear()
    world.advance(CROSSING_SECONDS / 2)
    assert world.passed == []
    world.send("a")
    assert world.passed == ["goal a", "cancel a"]


def test_a_request_is_not_held_forever_for_an_unresponsive_client(world):
    world.listed.add(ME)
    world.stop(GoalId(ZERO, "a"))
    world.advance(LONGEST_SECONDS - 0.1)
    assert world.passed == []
    world.advance(CROSSING_SECONDS)
    assert world.passed == ["cancel a"]


def test_cancel_all_is_forwarded_at_once_and_repeated_for_goals_that_it_overtook(world):
    world.unread.add(ME)
    world.stop(ALL)
    assert world.passed == ["cancel "]
    world.send("late")
    world.send("of another", OTHER)
    world.send("")
    assert world.passed[1:] == ["goal late", "cancel late", "goal of another", "goal made up", "cancel made up"]
    world.unread.clear()
    world.advance(0.1)
    world.send("later")
    assert world.passed[-1] == "goal later"


def test_a_goal_after_cancel_all_runs_if_none_was_unread_when_the_request_arrived(world):
    """A client cancels all goals of the server, and then connects to send its first goal."""
    world.listed.add(ME)
    world.stop(ALL)
    world.unread.add(ME)
    world.send("first")
    assert world.passed == ["cancel ", "goal first"]


def test_a_goal_that_is_unread_when_cancel_all_arrives_is_canceled_even_if_it_was_sent_later(world):
    """Neither message shows which was sent first. With an actionlib server, either may be handled first."""
    world.unread.add(ME)
    world.stop(ALL)
    world.send("earlier or later")
    world.unread.clear()
    world.advance(0.1)
    world.send("next")
    assert world.passed == ["cancel ", "goal earlier or later", "cancel earlier or later", "goal next"]


def test_a_stamp_in_addition_to_an_id_is_forwarded_at_once(world):
    world.stop(GoalId(RosTime(7, 0), "a"))
    assert world.passed == ["before 7"]
    world.send("a")
    assert world.passed == ["before 7", "goal a", "cancel a"]


def test_the_oldest_held_requests_are_released_beyond_the_limit(world, monkeypatch):
    monkeypatch.setattr(cancel_order, "MAX_HELD", 2)
    for goal in "abc":
        world.stop(GoalId(ZERO, goal))
    assert world.passed == ["cancel a"]
