"""`ActionlibServer` is tested against a model of the hub's three services and two topics."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.adapters.ros1.actions import orphans, server, states, wire
from bridge.adapters.ros1.actions.orphans import OrphanedGoals
from bridge.adapters.ros1.actions.server import CANCEL_SECONDS, LIST_SECONDS, RESULT_SECONDS, ActionlibServer
from bridge.adapters.ros1.actions.states import Ros1State
from bridge.adapters.ros1.actions.wire import ZERO, GoalId, GoalInfo, RosTime
from bridge.hub.endpoints.calls import CallError
from bridge.messages.actions import CancelCode, GoalState

EMPTY = b"\0\0"
ANY = bytes(16)
ASKED, TAKEN = RosTime(50, 0), RosTime(60, 0)


class World:
    """Records the effects of an `ActionlibServer`, and provides its clock."""

    def __init__(self) -> None:
        self.lists, self.feedbacks, self.results, self.forgotten = [], [], [], []
        self.sent, self.asked, self.cancels = [], {}, []
        self.now, self.orphans = 100.0, OrphanedGoals()
        self.open()

    def open(self):
        """Open the server, which is another one each time the hub's server has returned."""
        self.server = ActionlibServer(
            "/act", self, lambda: self.now, lambda: RosTime.of(int(self.now * 1e9)), EMPTY, self.orphans
        )
        self.server.open()

    def publish(self, part, payload, source=""):
        assert not source or part == "result"
        getattr(self, part)(payload, *[source] if source else [])

    def call(self, part, request, done):
        getattr(self, part)(request, done)

    def status(self, payload):
        self.lists.append({s.goal.id: s for s in wire.read_statuses(payload)})

    def feedback(self, payload):
        self.feedbacks.append(wire.read_action_outcome(payload))

    def result(self, payload, goal):
        status, body = wire.read_action_outcome(payload)
        assert status.goal.id == goal
        self.results.append((goal, Ros1State(status.state), body, status.text))

    def drop_result(self, goal):
        self.forgotten.append(goal)

    def send_goal(self, request, done):
        self.sent.append((*wire.read_with_uuid(request), done))

    def get_result(self, request, done):
        self.asked[request] = done

    def cancel_goal(self, request, done):
        self.cancels.append((wire.read_cancel_request(request), done))

    # -- actions of both sides

    def goal(self, id_="g", stamp=ASKED, body=b"body"):
        before = len(self.sent)
        self.server.goal(GoalId(stamp, id_), body)
        return self.sent[-1][0] if len(self.sent) > before else None

    def answer(self, uuid, *, accepted=True):
        done = next(done for u, _, done in self.sent if u == uuid)
        done(wire.goal_response(RosTime(60, 0), accepted=accepted))

    def running(self, id_="g", stamp=ASKED):
        uuid = self.goal(id_, stamp)
        self.answer(uuid)
        self.report({uuid: GoalState.EXECUTING})
        return uuid

    def ends(self, uuid, state, body=b"result", text=""):
        self.asked[uuid](wire.result_response(state, body, text))

    def report(self, states, stamp=TAKEN):
        self.server.states([(GoalInfo(u, stamp), s) for u, s in states.items()])

    def state(self, id_="g"):
        return Ros1State(self.lists[-1][id_].state)

    def advance(self, seconds):
        self.now += seconds
        self.server.tick()


@pytest.fixture
def world():
    return World()


def test_a_server_publishes_its_status_list_at_once(world):
    assert world.lists == [{}]


def test_a_goal_runs_and_ends(world):
    uuid = world.goal()
    assert world.sent[0][1] == b"body"
    assert world.state() is Ros1State.PENDING
    world.answer(uuid)
    assert world.state() is Ros1State.PENDING
    world.report({uuid: GoalState.EXECUTING})
    assert world.state() is Ros1State.ACTIVE
    world.server.feedback(uuid, b"half")
    ((status, body),) = world.feedbacks
    assert (status.goal, status.state, body) == (GoalId(RosTime(50, 0), "g"), Ros1State.ACTIVE, b"half")
    world.ends(uuid, GoalState.SUCCEEDED)
    assert world.results == [("g", Ros1State.SUCCEEDED, b"result", "")]
    assert world.state() is Ros1State.SUCCEEDED


def test_feedback_shows_that_a_goal_executes(world):
    uuid = world.goal()
    world.answer(uuid)
    world.server.feedback(uuid, b"half")
    assert world.state() is Ros1State.ACTIVE
    world.server.feedback(ANY, b"of nobody")
    assert len(world.feedbacks) == 1


@pytest.mark.parametrize(
    ("state", "seen"),
    [
        (GoalState.SUCCEEDED, Ros1State.SUCCEEDED), (GoalState.ABORTED, Ros1State.ABORTED),
        (GoalState.CANCELED, Ros1State.PREEMPTED), (GoalState.UNKNOWN, Ros1State.ABORTED),
    ],
)  # fmt: skip
def test_final_states_become_those_of_actionlib(world, state, seen):
    world.ends(world.running(), state)
    assert [r[:2] for r in world.results] == [("g", seen)]


def test_the_servers_text_is_the_status_text(world):
    world.ends(world.running("a"), GoalState.ABORTED, text="no valid path")
    world.ends(world.running("b"), GoalState.UNKNOWN, text="whatever")
    unknown = "the action server no longer knows the goal"
    assert [(i, text) for i, _, _, text in world.results] == [("a", "no valid path"), ("b", unknown)]
    assert world.lists[-1]["a"].text == "no valid path"


def test_a_goal_that_is_canceled_before_it_executes_is_recalled(world):
    uuid = world.goal()
    world.answer(uuid)
    world.server.cancel(GoalId(ZERO, "g"))
    assert world.state() is Ros1State.RECALLING
    world.ends(uuid, GoalState.CANCELED)
    assert world.results[0][1] is Ros1State.RECALLED


def test_a_rejected_goal_gets_a_result_with_the_reason(world):
    uuid = world.goal()
    world.answer(uuid, accepted=False)
    assert world.results == [("g", Ros1State.REJECTED, EMPTY, "the action server rejected the goal")]
    assert not world.asked


def test_errors_of_the_calls_abort_the_goal(world):
    world.goal("a")
    world.sent[0][2](CallError("no server"))
    world.goal("b")
    world.sent[1][2](b"nonsense")
    c = world.running("c")
    world.asked[c](CallError("the server left before it answered"))
    d = world.running("d")
    world.asked[d](b"")
    assert [(i, s) for i, s, _, _ in world.results] == [(i, Ros1State.ABORTED) for i in "abcd"]
    assert world.results[0][3] == "no server"
    assert world.results[2][3] == "the server left before it answered"
    assert all(body == EMPTY for _, _, body, _ in world.results)


def test_missing_ids_and_stamps_are_generated(world):
    world.goal("", ZERO)
    world.goal("", ZERO)
    first, second = world.lists[-1].values()
    assert first.goal.id != second.goal.id
    assert first.goal.id.startswith("/act-1-100.")
    assert first.goal.stamp == RosTime(100, 0)


def test_a_goal_with_a_listed_id_is_ignored(world):
    world.goal()
    assert world.goal() is None
    assert len(world.lists[-1]) == 1


def test_a_goal_with_the_id_of_a_canceling_goal_is_ignored(world):
    uuid = world.goal()
    world.server.cancel(GoalId(ZERO, "g"))
    assert world.goal() is None
    assert world.results == []
    world.answer(uuid)
    world.ends(uuid, GoalState.CANCELED)
    assert world.results == [("g", Ros1State.RECALLED, b"result", "")]


def test_an_id_that_is_reused_later_is_a_new_goal(world):
    first = world.running()
    world.ends(first, GoalState.SUCCEEDED)
    world.advance(LIST_SECONDS + 0.1)
    assert world.goal() not in (None, first)


def test_cancel_by_id_affects_only_that_goal(world):
    a, _ = world.running("a"), world.running("b")
    world.server.cancel(GoalId(ZERO, "a"))
    assert [c for c, _ in world.cancels] == [GoalInfo(a, ZERO)]
    assert (world.state("a"), world.state("b")) == (Ros1State.PREEMPTING, Ros1State.ACTIVE)
    world.server.cancel(GoalId(ZERO, "a"))
    assert len(world.cancels) == 1, "the goal is already canceling"


def test_cancel_all_is_one_call_and_includes_pending_goals(world):
    world.running("a")
    late = world.goal("late")
    world.server.cancel(GoalId(ZERO, ""))
    assert [c for c, _ in world.cancels] == [GoalInfo(ANY, ZERO)]
    assert (world.state("a"), world.state("late")) == (Ros1State.PREEMPTING, Ros1State.RECALLING)
    world.answer(late)
    assert [c for c, _ in world.cancels][1:] == [GoalInfo(late, ZERO)]
    assert world.goal("next") is not None


def test_cancel_before_a_time_also_applies_to_later_goals(world):
    a = world.running("a", RosTime(10, 0))
    world.running("b", RosTime(20, 0))
    world.server.cancel(GoalId(RosTime(15, 0), ""))
    assert [c for c, _ in world.cancels] == [GoalInfo(a, ZERO)]
    assert (world.state("a"), world.state("b")) == (Ros1State.PREEMPTING, Ros1State.ACTIVE)
    assert world.goal("old", RosTime(15, 0)) is None
    assert world.results[-1][:2] == ("old", Ros1State.RECALLED)
    assert "stamp" in world.results[-1][3]
    assert world.goal("new", RosTime(15, 1)) is not None
    assert world.goal("unstamped", ZERO) is not None


def test_a_cancel_request_may_arrive_before_its_goal(world):
    world.server.cancel(GoalId(ZERO, "later"))
    assert world.state("later") is Ros1State.RECALLING
    assert world.goal("later") is None
    assert world.results == [("later", Ros1State.RECALLED, EMPTY, "")]
    world.server.cancel(GoalId(ZERO, "never"))
    world.advance(LIST_SECONDS + 0.1)
    assert world.lists[-1] == {}
    assert world.goal("never") is not None


def test_a_goal_that_cannot_be_canceled_continues(world, caplog):
    uuid = world.running()
    world.server.cancel(GoalId(ZERO, "g"))
    world.cancels[0][1](wire.cancel_response(CancelCode.REJECTED, ()))
    assert "rejected" in caplog.text
    world.advance(5.0)
    assert len(world.cancels) == 1, "only a client repeats a rejected request"
    world.server.cancel(GoalId(ZERO, "g"))
    assert [c for c, _ in world.cancels] == 2 * [GoalInfo(uuid, ZERO)], "the server may accept it by now"
    world.cancels[1][1](wire.cancel_response(CancelCode.NONE, [GoalInfo(uuid, TAKEN)]))
    world.server.cancel(GoalId(ZERO, "g"))
    assert len(world.cancels) == 2, "the goal is already canceling"
    world.ends(uuid, GoalState.SUCCEEDED)
    assert world.results[0][1] is Ros1State.SUCCEEDED


@pytest.mark.parametrize("id_", ["g", ""])
def test_a_cancel_request_that_does_not_reach_the_server_is_repeated(world, caplog, id_):
    uuid = world.running()
    world.server.cancel(GoalId(ZERO, id_))
    for count in (1, 2):
        world.cancels[-1][1](CallError("the bridge was suspended"))
        assert len(world.cancels) == count
        world.advance(1.1)
        assert world.cancels[-1][0] == GoalInfo(uuid, ZERO)
        assert len(world.cancels) == count + 1
    assert caplog.text.count("had no effect") == 1
    world.cancels[-1][1](CallError("the bridge was suspended"))
    world.ends(uuid, GoalState.SUCCEEDED)
    world.advance(2.0)
    assert len(world.cancels) == 3, "the goal has ended"


def test_a_nonempty_list_is_published_at_five_hertz(world):
    before = len(world.lists)
    for _ in range(20):
        world.advance(0.1)
    assert len(world.lists) == before
    uuid = world.running()
    before = len(world.lists)
    for _ in range(50):
        world.advance(0.1)
    assert 20 <= len(world.lists) - before <= 30
    world.ends(uuid, GoalState.SUCCEEDED)
    world.advance(LIST_SECONDS - 0.5)
    assert world.state() is Ros1State.SUCCEEDED
    world.advance(1.0)
    assert world.lists[-1] == {}


def test_results_are_sent_to_subscribers_that_connect_soon_after(world, monkeypatch):
    world.ends(world.running(), GoalState.SUCCEEDED)
    world.advance(RESULT_SECONDS - 1)
    assert world.forgotten == []
    world.advance(2.0)
    assert world.forgotten == ["g"]
    monkeypatch.setattr(server, "MAX_RESULT_BYTES", 1000)
    world.ends(world.running("big"), GoalState.SUCCEEDED, bytes(700))
    world.ends(world.running("bigger"), GoalState.SUCCEEDED, bytes(700))
    assert world.forgotten == ["g", "big"]


def test_too_many_goals_are_rejected(world, monkeypatch):
    monkeypatch.setattr(server, "MAX_GOALS", 2)
    assert world.goal("a")
    assert world.goal("b")
    assert world.goal("c") is None
    assert world.results == [("c", Ros1State.REJECTED, EMPTY, "too many goals")]
    world.server.cancel(GoalId(ZERO, "unknown"))
    assert set(world.lists[-1]) == {"a", "b"}


def test_all_goals_end_once_when_the_server_leaves(world):
    a, b = world.running("a"), world.goal("b")
    world.ends(a, GoalState.SUCCEEDED)
    c = world.running("c")
    world.report({c: GoalState.EXECUTING, bytes(range(16)): GoalState.EXECUTING})
    world.server.close("the action server left")
    assert [(i, s) for i, s, _, _ in world.results] == [
        ("a", Ros1State.SUCCEEDED), ("b", Ros1State.ABORTED), ("c", Ros1State.ABORTED)
    ]  # fmt: skip
    assert world.state("c") is Ros1State.ABORTED
    world.answer(b)
    world.ends(c, GoalState.SUCCEEDED)
    assert world.goal("d") is None
    assert len(world.results) == 3


def test_goals_of_the_hub_appear_and_can_be_canceled(world):
    other = bytes(range(16))
    world.report({other: GoalState.EXECUTING}, RosTime(70, 0))
    id_ = states.text_of(other)
    assert world.lists[-1][id_].goal.stamp == RosTime(70, 0)
    assert world.state(id_) is Ros1State.ACTIVE
    world.server.cancel(GoalId(ZERO, id_))
    assert [c for c, _ in world.cancels] == [GoalInfo(other, ZERO)]
    world.report({other: GoalState.CANCELING})
    assert world.state(id_) is Ros1State.PREEMPTING
    world.report({other: GoalState.CANCELED})
    assert world.state(id_) is Ros1State.PREEMPTED
    assert world.results == []
    world.advance(LIST_SECONDS + 0.1)
    world.report({other: GoalState.CANCELED})
    assert world.lists[-1] == {}
    world.report({other: GoalState.EXECUTING})
    world.report({})
    assert world.state(id_) is Ros1State.ABORTED


def test_another_client_cancels_a_goal(world):
    uuid = world.running()
    world.report({uuid: GoalState.CANCELING})
    assert world.state() is Ros1State.PREEMPTING
    world.report({uuid: GoalState.CANCELED})
    assert world.results == []
    world.ends(uuid, GoalState.CANCELED, b"stopped")
    assert world.results == [("g", Ros1State.PREEMPTED, b"stopped", "")]


def test_many_goals_do_not_flood_the_status_topic(world):
    for number in range(500):
        world.goal(str(number))
    world.advance(0.1)
    assert len(world.lists) < 100
    assert len(world.lists[-1]) == 500


ORDER = {Ros1State.PENDING: 0, Ros1State.ACTIVE: 1, Ros1State.RECALLING: 1, Ros1State.PREEMPTING: 2}


@settings(max_examples=150)
@given(st.integers(0, 1 << 64), st.integers(1, 10))
def test_every_goal_ends_once_in_the_state_that_its_server_reported(seed: int, count: int):
    rng, world = random.Random(seed), World()
    uuids = {str(n): world.goal(str(n), RosTime(n + 1, 0)) for n in range(count)}
    hub = dict.fromkeys(uuids.values(), None)
    wanted = {}
    while len(wanted) < count:
        name = rng.choice([n for n in uuids if n not in wanted])
        uuid = uuids[name]
        match hub[uuid], rng.randrange(5):
            case None, 0:
                world.answer(uuid, accepted=False)
                wanted[name] = {Ros1State.REJECTED}
            case None, 1:
                hub[uuid] = GoalState.ACCEPTED
                world.answer(uuid)
            case GoalState.ACCEPTED | GoalState.EXECUTING, 2:
                hub[uuid] = GoalState.EXECUTING
            case ((GoalState.ACCEPTED | GoalState.EXECUTING), 3):
                hub[uuid] = GoalState.CANCELING
            case GoalState() as state, 4 if state is not GoalState.ACCEPTED:
                ends = [GoalState.SUCCEEDED, GoalState.ABORTED]
                end = GoalState.CANCELED if state is GoalState.CANCELING else rng.choice(ends)
                world.ends(uuid, end, name.encode())
                hub[uuid] = end
                wanted[name] = {
                    GoalState.SUCCEEDED: {Ros1State.SUCCEEDED}, GoalState.ABORTED: {Ros1State.ABORTED},
                    GoalState.CANCELED: {Ros1State.PREEMPTED, Ros1State.RECALLED},
                }[end]  # fmt: skip
            case _:
                world.server.cancel(GoalId(ZERO, rng.choice([*(uuids.keys() - wanted), "other"])))
        if rng.random() < 0.5:
            world.report({u: s for u, s in hub.items() if s is not None})
        world.advance(rng.random() * 0.3)
    assert sorted(r[0] for r in world.results) == sorted(uuids)
    assert all(state in wanted[name] for name, state, _, _ in world.results)
    for id_ in uuids:
        seen = [Ros1State(result[id_].state) for result in world.lists if id_ in result]
        ranks = [9 if s.ended else ORDER[s] for s in seen]
        assert ranks == sorted(ranks), seen


def test_setting_the_clock_back_forgets_cancel_requests_by_time(world):
    world.server.cancel(GoalId(RosTime(3600, 0), ""))
    assert world.goal("before", RosTime(15, 0)) is None
    world.server.forget_time()
    assert world.goal("after", RosTime(15, 0)) is not None


def test_a_goal_that_continued_without_its_client_is_canceled_when_the_server_returns(world):
    """Its client was told that it is aborted, so no one else would stop the robot."""
    known, starting = world.running("known"), world.goal("starting")
    of_hub = bytes(range(16))
    world.report({known: GoalState.EXECUTING, of_hub: GoalState.EXECUTING})
    world.server.close("the action server left")
    assert [state for _, state, _, _ in world.results] == [Ros1State.ABORTED] * 2
    world.advance(60.0)
    assert world.cancels == []
    world.open()
    running = {known: GoalState.EXECUTING, of_hub: GoalState.EXECUTING, starting: GoalState.ACCEPTED}
    world.report(running)
    assert [info.uuid for info, _ in world.cancels] == [known, starting]
    world.report(running)
    assert len(world.cancels) == 2
    world.cancels[0][1](CallError("the server left before it answered"))
    world.advance(CANCEL_SECONDS)
    assert [info.uuid for info, _ in world.cancels[2:]] == [known, starting]
    world.report(running | {known: GoalState.CANCELING, starting: GoalState.CANCELED})
    world.advance(CANCEL_SECONDS)
    assert len(world.cancels) == 4


def test_a_goal_whose_result_cannot_be_requested_is_canceled(world):
    """The server may be present all the time, for example if this worker was suspended for a moment."""
    goal = world.running()
    world.asked[goal](CallError("the bridge was suspended; call again later"))
    assert world.results[-1][1] is Ros1State.ABORTED
    world.advance(0.1)
    assert [info for info, _ in world.cancels] == [GoalInfo(goal, ZERO)]
    world.report({goal: GoalState.CANCELED})
    world.advance(CANCEL_SECONDS)
    assert len(world.cancels) == 1


def test_the_oldest_orphaned_goals_are_dropped(monkeypatch):
    monkeypatch.setattr(orphans, "_MOST", 2)
    goals = OrphanedGoals()
    for goal in (b"1", b"2", b"3"):
        goals.add(goal)
    assert goals.among([b"1", b"2", b"3", b"4"]) == [b"2", b"3"]
