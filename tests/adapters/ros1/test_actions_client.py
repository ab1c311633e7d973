"""Our side as an actionlib client: pure, against a model of an actionlib server whose topics come in any order."""

import random
from uuid import UUID

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.adapters.ros1.actions import goal as shelf
from bridge.adapters.ros1.actions import ids, wire
from bridge.adapters.ros1.actions.client import CONNECT_SECONDS, RESULT_SECONDS, SHOWN_SECONDS, ActionClient
from bridge.adapters.ros1.actions.states import TO_ROS2, CancelCode, Ros1State, Ros2State
from bridge.adapters.ros1.actions.wire import ZERO, GoalId, GoalInfo, GoalStatus, Stamp
from bridge.hub.call import CallError

EMPTY = b"\0\0\0\0"
ANY = bytes(16)
AT = Stamp(5, 0)


class World:
    """What an `ActionClient` did, and a clock."""

    def __init__(self) -> None:
        self.goals, self.cancels, self.states, self.feedbacks = [], [], [], []
        self.now = 100.0
        self.client = ActionClient("/act", self, lambda: self.now, EMPTY)
        self.client.found()
        self.client.connected()

    def goal(self, payload):
        self.goals.append(wire.read_action_goal(payload))

    def cancel(self, payload):
        self.cancels.append(wire.read_goal_id(payload))

    def status(self, payload):
        self.states.append({info.uuid: Ros2State(state) for info, state in wire.read_goal_states(payload)})

    def feedback(self, payload):
        self.feedbacks.append(wire.read_with_uuid(payload))

    # -- calls of the hub

    def send(self, number, body=b"body"):
        answers = []
        self.client.send_goal(uuid(number) + body, answers.append)
        return answers

    def ask(self, number):
        answers = []
        self.client.get_result(uuid(number), answers.append)
        return answers

    def stop(self, number=None, stamp=ZERO):
        answers = []
        target = ANY if number is None else uuid(number)
        self.client.cancel(wire.cancel_request(GoalInfo(target, stamp)), answers.append)
        return answers

    # -- the server

    def says(self, *statuses: tuple):
        self.client.statuses([status(*s) for s in statuses])

    def ends(self, number, state, body=b"result", text=""):
        self.client.result(status(number, state, text=text), body)

    def passes(self, seconds):
        self.now += seconds
        self.client.tick()


def uuid(number):
    return UUID(int=number + 1).bytes


def name(number):
    return ids.text_of(uuid(number)) if isinstance(number, int) else number


def status(number, state, stamp=AT, text=""):
    return GoalStatus(GoalId(stamp, name(number)), state, text)


def accepted(answers):
    (reply,) = answers
    return wire.read_goal_response(reply)


def result(answers):
    (reply,) = answers
    number, body, _ = wire.read_result_response(reply)
    return Ros2State(number), body


def reason(answers):
    (reply,) = answers
    return wire.read_result_response(reply)[2]


def cancelled(answers):
    (reply,) = answers
    code, infos = wire.read_cancel_response(reply)
    return CancelCode(code), {UUID(bytes=i.uuid).int - 1 for i in infos}


@pytest.fixture
def world():
    return World()


def test_a_goal_goes_with_a_stamp_of_zero_and_a_name_of_its_own(world):
    world.send(1, b"one")
    world.send(2, b"two")
    assert world.goals == [(GoalId(ZERO, name(1)), b"one"), (GoalId(ZERO, name(2)), b"two")]
    assert name(1) != name(2)


@pytest.mark.parametrize("state", [Ros1State.PENDING, Ros1State.ACTIVE, Ros1State.PREEMPTING, Ros1State.SUCCEEDED])
def test_a_goal_is_accepted_with_the_servers_stamp_once_its_state_shows_that(world, state):
    answers = world.send(1)
    world.says()
    assert not answers
    world.says((1, state))
    assert answers == [wire.goal_response(Stamp(5, 0), accepted=True)]


@pytest.mark.parametrize("state", [Ros1State.REJECTED, Ros1State.RECALLED])
@pytest.mark.parametrize("by_result", [True, False])
def test_a_goal_that_the_server_refuses_is_rejected(world, state, by_result):
    answers = world.send(1)
    if by_result:
        world.ends(1, state)
    world.says((1, state))
    assert accepted(answers) is False
    assert result(world.ask(1)) == (Ros2State.UNKNOWN, EMPTY)
    assert all(uuid(1) not in states for states in world.states)


def test_a_goal_that_is_refused_after_it_was_pending_is_aborted(world):
    answers, asked = world.send(1), world.ask(1)
    world.says((1, Ros1State.PENDING))
    world.ends(1, Ros1State.REJECTED, b"why")
    assert accepted(answers)
    assert result(asked) == (Ros2State.ABORTED, b"why")


@pytest.mark.parametrize("by_result", [True, False])
@pytest.mark.parametrize(
    ("state", "why"), [(Ros1State.ABORTED, "no way"), (Ros1State.PREEMPTED, "no way"), (Ros1State.SUCCEEDED, "")]
)
def test_what_the_server_says_of_a_goals_end_goes_with_its_result(world, state, why, by_result):
    """Also where the result was lost; of one that was reached there is no error to tell of."""
    world.send(1)
    before = world.ask(1)
    if by_result:
        world.ends(1, state, text="no way")
    else:
        world.client.statuses([status(1, state, text="no way")])
        world.passes(RESULT_SECONDS + 0.1)
    assert [reason(before), reason(world.ask(1))] == [why, why]


def test_goals_that_this_bridge_aborts_say_why(world):
    gone, forgotten = world.send(1), world.send(2)
    world.says((1, Ros1State.ACTIVE), (2, Ros1State.ACTIVE))
    world.says((1, Ros1State.ACTIVE))
    world.client.lost("its action server /move_base is gone")
    assert accepted(gone)
    assert accepted(forgotten)
    assert reason(world.ask(1)) == "its action server /move_base is gone"
    assert reason(world.ask(2)) == "the server does not know it any more"


def test_a_result_that_comes_before_any_status_accepts_and_ends(world):
    answers, asked = world.send(1), world.ask(1)
    world.ends(1, Ros1State.SUCCEEDED, b"done")
    assert accepted(answers)
    assert result(asked) == (Ros2State.SUCCEEDED, b"done")


def test_a_feedback_accepts_and_is_passed_on(world):
    answers = world.send(1)
    world.client.feedback(status(1, Ros1State.ACTIVE), b"half")
    assert accepted(answers)
    assert world.feedbacks == [(uuid(1), b"half")]
    world.ends(1, Ros1State.SUCCEEDED)
    world.client.feedback(status(1, Ros1State.ACTIVE), b"overtaken")
    assert world.feedbacks[1:] == [(uuid(1), b"overtaken")]
    assert world.states[-1] == {uuid(1): Ros2State.SUCCEEDED}


def test_a_result_is_given_to_all_who_ask_before_and_after(world):
    world.send(1)
    before = [world.ask(1), world.ask(1)]
    world.says((1, Ros1State.ACTIVE))
    world.ends(1, Ros1State.PREEMPTED, b"half way")
    world.passes(3000.0)
    for answers in [*before, world.ask(1)]:
        assert result(answers) == (Ros2State.CANCELED, b"half way")


def test_results_are_kept_for_an_hour_and_within_bounds(world, monkeypatch):
    world.send(1)
    world.ends(1, Ros1State.SUCCEEDED)
    world.passes(shelf.KEEP_SECONDS - 1.0)
    assert result(world.ask(1))[0] is Ros2State.SUCCEEDED
    world.passes(2.0)
    assert result(world.ask(1))[0] is Ros2State.UNKNOWN
    monkeypatch.setattr(shelf, "MAX_ENDED", 5)
    for number in range(10, 20):
        world.send(number)
        world.ends(number, Ros1State.SUCCEEDED)
    world.passes(0.1)
    assert world.client.kept == 5
    assert result(world.ask(19))[0] is Ros2State.SUCCEEDED
    monkeypatch.setattr(shelf, "MAX_ENDED_BYTES", 1000)
    world.send(30)
    world.ends(30, Ros1State.SUCCEEDED, bytes(999))
    world.send(31)
    world.ends(31, Ros1State.SUCCEEDED, bytes(900))
    world.passes(0.1)
    assert world.client.kept == 1


def test_a_lost_result_is_empty_and_has_the_state_of_the_list(world):
    world.send(1)
    asked = world.ask(1)
    world.says((1, Ros1State.SUCCEEDED))
    world.passes(RESULT_SECONDS - 0.1)
    assert not asked
    world.passes(0.2)
    assert result(asked) == (Ros2State.SUCCEEDED, EMPTY)
    world.ends(1, Ros1State.SUCCEEDED, b"late")
    assert result(world.ask(1)) == (Ros2State.SUCCEEDED, EMPTY), "it has been told otherwise"


def test_a_late_result_counts_where_nobody_has_asked(world):
    world.send(1)
    world.says((1, Ros1State.SUCCEEDED))
    world.passes(RESULT_SECONDS + 0.1)
    world.ends(1, Ros1State.SUCCEEDED, b"late")
    assert result(world.ask(1)) == (Ros2State.SUCCEEDED, b"late")
    world.ends(1, Ros1State.ABORTED, b"again")
    assert result(world.ask(1)) == (Ros2State.SUCCEEDED, b"late")


def test_the_first_result_counts(world):
    world.send(1)
    world.ends(1, Ros1State.SUCCEEDED, b"first")
    world.ends(1, Ros1State.ABORTED, b"second")
    assert result(world.ask(1)) == (Ros2State.SUCCEEDED, b"first")


def test_a_goal_never_goes_back(world):
    world.send(1)
    for state, seen in (
        (Ros1State.ACTIVE, Ros2State.EXECUTING),
        (Ros1State.PENDING, Ros2State.EXECUTING),
        (Ros1State.PREEMPTING, Ros2State.CANCELING),
        (Ros1State.ACTIVE, Ros2State.CANCELING),
    ):
        world.says((1, state))
        assert world.states[-1] == {uuid(1): seen}


def test_a_uuid_is_good_for_one_goal(world):
    world.send(1)
    assert accepted(world.send(1)) is False
    assert len(world.goals) == 1
    answers = []
    world.client.send_goal(ANY, answers.append)
    assert accepted(answers) is False


def test_too_many_goals_are_rejected(world, monkeypatch):
    monkeypatch.setattr(shelf, "MAX_OPEN", 3)
    for number in range(3):
        assert not world.send(number)
    assert accepted(world.send(3)) is False


def test_malformed_calls_get_an_error(world):
    for call in (world.client.send_goal, world.client.get_result, world.client.cancel):
        answers = []
        call(b"short", answers.append)
        assert isinstance(answers[0], CallError)


def test_cancel_one(world):
    world.send(1), world.send(2)
    world.says((1, Ros1State.ACTIVE), (2, Ros1State.ACTIVE))
    answers = world.stop(1)
    assert world.cancels == [GoalId(ZERO, name(1))]
    world.says((1, Ros1State.ACTIVE), (2, Ros1State.ACTIVE))
    assert not answers
    world.says((1, Ros1State.PREEMPTING), (2, Ros1State.ACTIVE))
    assert cancelled(answers) == (CancelCode.NONE, {1})


def test_cancel_what_has_just_ended(world):
    world.send(1)
    world.says((1, Ros1State.ACTIVE))
    answers = world.stop(1)
    world.ends(1, Ros1State.SUCCEEDED)
    assert cancelled(answers) == (CancelCode.GOAL_TERMINATED, set())
    assert cancelled(world.stop(1)) == (CancelCode.GOAL_TERMINATED, set())
    assert cancelled(world.stop(7)) == (CancelCode.UNKNOWN_GOAL_ID, set())


def test_cancel_all(world):
    for number in range(4):
        world.send(number)
    world.says((0, Ros1State.PENDING), (1, Ros1State.ACTIVE), (2, Ros1State.ACTIVE))
    world.ends(2, Ros1State.SUCCEEDED)
    answers = world.stop()
    assert world.cancels == [GoalId(ZERO, "")]
    world.says((0, Ros1State.RECALLING), (1, Ros1State.PREEMPTED), (3, Ros1State.RECALLED))
    assert cancelled(answers) == (CancelCode.NONE, {0, 1})
    assert cancelled(World().stop()) == (CancelCode.NONE, set())


def test_cancel_before_a_time(world):
    for number in (1, 2, 3):
        world.send(number)
    world.says(*((n, Ros1State.ACTIVE, Stamp(n, 0)) for n in (1, 2, 3)))
    answers = world.stop(stamp=Stamp(2, 0))
    assert world.cancels == [GoalId(Stamp(2, 0), "")]
    world.says(*((n, Ros1State.PREEMPTING if n < 3 else Ros1State.ACTIVE, Stamp(n, 0)) for n in (1, 2, 3)))
    assert cancelled(answers) == (CancelCode.NONE, {1, 2})
    both = world.stop(3, Stamp(1, 0))
    world.says((3, Ros1State.PREEMPTING))
    assert cancelled(both)[1] >= {3}


def test_a_cancel_request_waits_for_the_connections_and_not_for_ever(world):
    world.send(1)
    world.says((1, Ros1State.ACTIVE))
    world.client.disconnected()
    early = world.stop(1)
    assert (early, world.cancels) == ([], [])
    world.client.connected()
    assert world.cancels == [GoalId(ZERO, name(1))]
    world.client.disconnected()
    late = world.stop()
    world.passes(CONNECT_SECONDS + 0.1)
    assert cancelled(late) == (CancelCode.REJECTED, set())
    last = world.stop()
    world.client.lost("the server is gone")
    assert cancelled(last) == (CancelCode.REJECTED, set())
    assert cancelled(early) == (CancelCode.GOAL_TERMINATED, set())
    assert cancelled(world.stop()) == (CancelCode.REJECTED, set()), "none is kept for a server that is away"
    assert len(world.cancels) == 1


def test_a_new_goal_pre_empts_the_old_one(world):
    first, second = world.send(1), world.send(2)
    asked = world.ask(1)
    world.says((1, Ros1State.ACTIVE), (2, Ros1State.PENDING))
    world.ends(1, Ros1State.PREEMPTED, text="another goal was received")
    world.says((1, Ros1State.PREEMPTED), (2, Ros1State.ACTIVE))
    assert accepted(first)
    assert accepted(second)
    assert result(asked)[0] is Ros2State.CANCELED
    assert world.states[-1] == {uuid(1): Ros2State.CANCELED, uuid(2): Ros2State.EXECUTING}


def test_a_server_that_dies_ends_all_goals_once(world):
    waiting, running, over = world.send(1), world.send(2), world.send(3)
    world.says((2, Ros1State.ACTIVE), (3, Ros1State.SUCCEEDED))
    asked = [world.ask(n) for n in (1, 2, 3)]
    stop = world.stop(2)
    world.client.lost("the server is gone")
    assert (accepted(waiting), accepted(running), accepted(over)) == (False, True, True)
    assert [result(a) for a in asked] == [
        (Ros2State.UNKNOWN, EMPTY), (Ros2State.ABORTED, EMPTY), (Ros2State.SUCCEEDED, EMPTY)
    ]  # fmt: skip
    assert cancelled(stop) == (CancelCode.GOAL_TERMINATED, set())
    assert accepted(world.send(4)) is False, "none is kept for a server that is away"
    world.ends(2, Ros1State.SUCCEEDED, b"late")
    world.says((2, Ros1State.SUCCEEDED))
    world.passes(10.0)
    assert result(world.ask(2)) == (Ros2State.ABORTED, EMPTY)
    world.client.found()
    world.client.connected()
    assert not world.send(5)
    assert len(world.goals) == 4


def test_a_server_that_forgot_a_goal_ends_it(world):
    world.send(1), world.send(2)
    asked = world.ask(1)
    world.says((1, Ros1State.ACTIVE))
    world.says()
    assert result(asked) == (Ros2State.ABORTED, EMPTY)
    world.passes(5.0)
    assert not world.ask(2), "it was never in the list: it may not have arrived yet"


def test_goals_wait_for_the_connections_and_not_for_ever(world):
    world.client.disconnected()
    answers = world.send(1)
    late = []
    abandon = world.client.send_goal(uuid(2) + b"left", late.append)
    abandon()
    world.client.connected()
    assert world.goals == [(GoalId(ZERO, name(1)), b"body")]
    world.client.disconnected()
    waiting = world.send(3)
    world.passes(CONNECT_SECONDS + 0.1)
    assert accepted(waiting) is False
    world.client.connected()
    assert len(world.goals) == 1
    assert (answers, late) == ([], [])


def test_closing_cancels_what_callers_sent_and_ends_it(world):
    world.send(1)
    asked, native = world.ask(1), ids.uuid_of("/act", "/rviz-1")
    world.says((1, Ros1State.ACTIVE), ("/rviz-1", Ros1State.ACTIVE))
    world.client.close("the bridge stops")
    assert world.cancels == [GoalId(ZERO, name(1))]
    assert result(asked) == (Ros2State.ABORTED, EMPTY)
    assert world.states[-1] == {uuid(1): Ros2State.ABORTED, native: Ros2State.ABORTED}


def test_goals_of_native_clients_appear_and_can_be_followed_and_cancelled(world):
    native = ids.uuid_of("/act", "/rviz-1")
    world.says(("/rviz-1", Ros1State.ACTIVE))
    assert world.states[-1] == {native: Ros2State.EXECUTING}
    asked, answers = [], []
    world.client.get_result(native, asked.append)
    world.client.cancel(wire.cancel_request(GoalInfo(native, ZERO)), answers.append)
    assert world.cancels == [GoalId(ZERO, "/rviz-1")]
    world.client.result(status("/rviz-1", Ros1State.PREEMPTED), b"stopped")
    assert result(asked) == (Ros2State.CANCELED, b"stopped")
    assert wire.read_cancel_response(answers[0])[1] == [GoalInfo(native, Stamp(5, 0))]
    world.says(("/rviz-1", Ros1State.ACTIVE))
    assert world.states[-1] == {native: Ros2State.CANCELED}, "an old list that comes late"
    world.says(("/rviz-1", Ros1State.ACTIVE, Stamp(9, 0)))
    assert world.states[-1] == {native: Ros2State.EXECUTING}, "a client that uses the id again"


def test_a_goal_of_a_dead_worker_is_taken_up_by_its_id_alone(world):
    world.says((1, Ros1State.ACTIVE))
    asked = world.ask(1)
    world.ends(1, Ros1State.SUCCEEDED, b"there")
    assert result(asked) == (Ros2State.SUCCEEDED, b"there")
    assert accepted(world.send(1)) is False


def test_ended_goals_leave_the_status_topic(world):
    world.send(1), world.send(2)
    world.says((1, Ros1State.ACTIVE), (2, Ros1State.ACTIVE))
    world.ends(1, Ros1State.SUCCEEDED)
    assert world.states[-1][uuid(1)] is Ros2State.SUCCEEDED
    world.passes(SHOWN_SECONDS + 1)
    world.ends(2, Ros1State.SUCCEEDED)
    assert uuid(1) not in world.states[-1]


def test_many_goals_do_not_flood_the_status_topic(world):
    for number in range(500):
        world.send(number)
        world.says(*((n, Ros1State.ACTIVE) for n in range(number + 1)))
    world.passes(0.1)
    assert len(world.states) < 100
    assert len(world.states[-1]) == 500


# -- any order ---------------------------------------------------------------------------------------------------------

ENDS = [Ros1State.SUCCEEDED, Ros1State.ABORTED, Ros1State.PREEMPTED, Ros1State.REJECTED, Ros1State.RECALLED]


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 1 << 64), st.integers(1, 12), st.floats(0, 1))
def test_every_goal_ends_in_the_state_that_its_server_gave(seed: int, count: int, loss: float):
    """The server goes through its states; status lists, feedback and results come late, each in its own order."""
    rng, world = random.Random(seed), World()
    answers = {n: world.send(n) for n in range(count)}
    asked = {n: world.ask(n) for n in range(count)}
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
                (lists, lambda found: world.client.statuses(found)),
                (results, lambda found: world.client.result(*found)),
                (feedbacks, lambda found: world.client.feedback(*found)),
            ) if p[0]
        ])  # fmt: skip
        take(queue.pop(0))
        world.passes(rng.random() * 0.02)
    world.passes(RESULT_SECONDS + 1)
    for n in range(count):
        refused = accepted(answers[n]) is False
        found, body = result(asked[n])
        if refused:
            assert state[n] in (Ros1State.REJECTED, Ros1State.RECALLED)
            assert found is Ros2State.UNKNOWN
        else:
            assert found is TO_ROS2[state[n]]
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
