"""An environment without ROS for `ActionlibClient`, and parsers of its responses."""

from uuid import UUID

from bridge.adapters.ros1.actions import states, wire
from bridge.adapters.ros1.actions.client import ActionlibClient
from bridge.adapters.ros1.actions.wire import ZERO, GoalId, GoalInfo, GoalStatus, RosTime
from bridge.hub.endpoints.calls import CallError
from bridge.messages.actions import CancelCode, GoalState

EMPTY = b"\0\0\0\0"
ANY = bytes(16)
AT = RosTime(5, 0)


class World:
    """Records the effects of an `ActionlibClient`, and provides its clock."""

    def __init__(self) -> None:
        self.goals, self.cancels, self.states, self.feedbacks = [], [], [], []
        self.now = 100.0
        self.client = ActionlibClient("/act", self, lambda: self.now, EMPTY)
        self.client.discovered()
        self.client.connected()

    def publish(self, part, payload):
        getattr(self, part)(payload)

    deliver = publish

    def goal(self, payload):
        self.goals.append(wire.read_action_goal(payload))

    def cancel(self, payload):
        self.cancels.append(wire.read_goal_id(payload))

    def status(self, payload):
        self.states.append({info.uuid: GoalState(state) for info, state in wire.read_goal_states(payload)})

    def feedback(self, payload):
        self.feedbacks.append(wire.read_with_uuid(payload))

    # -- calls from the hub

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

    def report(self, *statuses: tuple):
        self.client.statuses([status(*s) for s in statuses])

    def ends(self, number, state, body=b"result", text=""):
        self.client.result(status(number, state, text=text), body)

    def advance(self, seconds):
        self.now += seconds
        self.client.tick()


def uuid(number):
    return UUID(int=number + 1).bytes


def name(number):
    return states.text_of(uuid(number)) if isinstance(number, int) else number


def status(number, state, stamp=AT, text=""):
    return GoalStatus(GoalId(stamp, name(number)), state, text)


def accepted(answers):
    (reply,) = answers
    return wire.read_goal_response(reply)


def result(answers):
    (reply,) = answers
    number, body, _ = wire.read_result_response(reply)
    return GoalState(number), body


def reason(answers):
    (reply,) = answers
    return wire.read_result_response(reply)[2]


def lost(answers):
    """Return the error of a get_result call whose goal was lost."""
    (reply,) = answers
    assert isinstance(reply, CallError), reply
    return str(reply)


def canceled(answers):
    (reply,) = answers
    code, infos = wire.read_cancel_response(reply)
    return CancelCode(code), {UUID(bytes=i.uuid).int - 1 for i in infos}
