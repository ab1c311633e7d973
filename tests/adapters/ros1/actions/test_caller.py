"""The parts of an actionlib server's action: goals that wait for transforms, or that a lost connection swallowed."""

from types import SimpleNamespace

import pytest

from bridge.adapters.ros1.actions import wire
from bridge.adapters.ros1.actions.caller import ActionCaller
from bridge.adapters.ros1.actions.cancels import ANY
from bridge.adapters.ros1.actions.discovery import CANCEL, FEEDBACK, GOAL, RESULT, STATUS
from bridge.adapters.ros1.actions.wire import ZERO, GoalInfo, RosTime
from bridge.messages.actions import CANCEL_GOAL, SEND_GOAL
from bridge.messages.definitions.schema import World
from bridge.messages.definitions.text import closure, parse_full
from tests.peers.ros1.client_world import name, uuid

BODY = b"body"


class Caller:
    """An action whose server is connected; ``trouble`` is what the check of a goal's frames returns."""

    def __init__(self) -> None:
        self.trouble, self.sent, self.reports = None, [], []
        self.subscribers = {"/server": 1}  # with the numbers of the connections, here the same for both topics
        definitions = parse_full("int32 number", "test_msgs/Result", World.ROS1)
        schema = closure(definitions["test_msgs/Result"], definitions)
        links = {part: f"link {part}" for part in (STATUS, FEEDBACK, RESULT)}
        self.server = SimpleNamespace(node="/server", uri="http://server", link=links.get)

        def publish(topic, _type, _qos) -> SimpleNamespace:
            def send(payload, _source) -> None:
                self.sent.append((topic, payload))

            return SimpleNamespace(send=send, subscribers=self.subscribers, close=lambda: None)

        def subscribe(_topic, _type, _deliver, _suffix) -> SimpleNamespace:
            return SimpleNamespace(connected=set(links.values()), close=lambda: None)

        guard = SimpleNamespace(
            check=lambda _schema, body: (body, self.trouble), open=lambda _: None, close=lambda _: None,
            report=lambda *report: self.reports.append(report),
        )  # fmt: skip
        types = SimpleNamespace(
            goal=None, cancel=None, status=None, feedback=None, result=None, goal_body=schema, result_body=schema
        )
        self.action = ActionCaller(
            "/act", types, SimpleNamespace(publish=publish, subscribe=subscribe), guard, lambda _: True
        )
        self._parts = {part: self.action.caller(part) for part in (SEND_GOAL, CANCEL_GOAL)}
        self.poll()

    def poll(self):
        self.action.poll([self.server])

    def connect(self, number):
        """Have the server connected by another connection, or not at all."""
        self.subscribers.clear()
        if number:
            self.subscribers["/server"] = number
        self.poll()

    def call(self, part, request):
        answers = []
        self._parts[part].call(request, answers.append)
        return answers

    @property
    def goals(self):
        return [wire.read_action_goal(payload)[0].id for topic, payload in self.sent if topic == f"/act/{GOAL}"]


@pytest.mark.parametrize("everything", [False, True])
def test_a_cancel_request_rejects_a_goal_that_waits_for_transforms(everything):
    caller = Caller()
    first, second = (caller.call(SEND_GOAL, uuid(number) + BODY) for number in (1, 2))
    canceled = caller.call(CANCEL_GOAL, wire.cancel_request(GoalInfo(ANY if everything else uuid(1), ZERO)))
    assert canceled
    assert [wire.read_goal_response(answer) for answer in first] == [False]
    assert len(second) == (1 if everything else 0)
    caller.trouble = ""
    caller.poll()
    assert len(caller.goals) == (0 if everything else 1)
    assert len(caller.reports) == (2 if everything else 1)


def test_a_cancel_request_by_time_does_not_include_a_goal_that_waits_for_transforms():
    caller = Caller()
    caller.call(SEND_GOAL, uuid(1) + BODY)
    caller.call(CANCEL_GOAL, wire.cancel_request(GoalInfo(ANY, RosTime(5, 0))))
    caller.trouble = ""
    caller.poll()
    assert len(caller.goals) == 1


@pytest.mark.parametrize("noticed", [True, False])
def test_a_goal_and_its_cancel_request_are_sent_again_to_a_server_that_has_reconnected(noticed):
    """The first messages may have been sent on a connection that had just ended, or on none."""
    caller = Caller()
    caller.trouble = ""
    assert not caller.call(SEND_GOAL, uuid(1) + BODY)
    assert not caller.call(CANCEL_GOAL, wire.cancel_request(GoalInfo(ANY, ZERO)))
    caller.poll()
    assert (len(caller.goals), len(caller.sent)) == (1, 2)
    if noticed:
        caller.connect(0)
    caller.connect(2)
    assert caller.goals == [name(1), name(1)]
    assert [wire.read_goal_id(payload).id for topic, payload in caller.sent if topic == f"/act/{CANCEL}"] == [
        "",
        name(1),
    ]
    caller.poll()
    assert len(caller.sent) == 4
