"""The hub's end of a ROS 1 edge's actions, as raw bytes; actionlib's end is a real program."""

import base64
import struct
import uuid
from pathlib import Path

from bridge.adapters.ros1.actions import wire
from bridge.adapters.ros1.actions.discovery import FROM_SERVER
from bridge.adapters.ros1.actions.wire import ZERO, GoalInfo
from bridge.messages.actions import CancelCode, GoalState
from tests.peers.peer import Peer
from tests.peers.ros1.network import ROS1_PYTHON
from tests.support.wait import until

SECONDS = 30.0
PEER = Path(__file__).with_name("action_peer.py")
ANY = bytes(16)
PARTS = ("send_goal", "get_result", "cancel_goal")
TYPES = {
    "send_goal": "actionlib/action/Test_SendGoal", "get_result": "actionlib/action/Test_GetResult",
    "cancel_goal": "action_msgs/srv/CancelGoal", "feedback": "actionlib/action/Test_FeedbackMessage",
    "status": "action_msgs/GoalStatusArray",
}  # fmt: skip


def peer_on(master, name):
    """Start a program with actionlib servers and clients."""
    return Peer(PEER, ROS1_PYTHON, master.env, name)


def encoded(data):
    return base64.b64encode(data).decode()


def body(number):
    return struct.pack("<i", number)


def new_uuid():
    return uuid.uuid4().bytes


class HubClient:
    """A hub client of an actionlib server, as the engine would create it."""

    def __init__(self, edge, name, action="actionlib/action/Test") -> None:
        self.edge, self.name, self.number = edge, name, 0
        for part in PARTS:
            until(lambda part=part: edge.endpoints(topic=f"{name}/_action/{part}", made_by="native"), part, SECONDS)
        more = {"md5": "x"}
        types = {p: t.replace("actionlib/action/Test", action) for p, t in TYPES.items()}
        self.callers = {p: edge.ask("caller", service=self.part(p), type=types[p], **more)["id"] for p in PARTS}
        self.topics = {t: edge.open(self.part(t), types[t], **more) for t in ("feedback", "status")}

    def part(self, part):
        return f"{self.name}/_action/{part}"

    def until_connected(self):
        """Wait until the edge receives all topics of the server; a list of goals may arrive earlier than that."""
        wanted = {f"{self.name}/{part}" for part in FROM_SERVER}
        until(lambda: wanted <= set(self.edge.ask("connections")["in"]), "the server's topics are connected", SECONDS)

    def begin(self, part, request):
        self.number += 1
        self.edge.ask("begin", id=self.callers[part], request=encoded(request), number=self.number)
        return part, self.number

    def reply(self, call, seconds=SECONDS):
        """Return the only reply to a call, decoded from base64; an error stays text."""
        part, number = call

        def arrived() -> list | None:
            return self.edge.ask("results", id=self.callers[part], count=0, seconds=0)["results"].get(str(number))

        (answer,) = until(arrived, f"a reply to {part}", seconds)
        return answer if answer.startswith("error") else base64.b64decode(answer)

    def replies(self, part, count):
        """Return the replies to the calls so far, in the order of the calls."""
        result = self.edge.ask("results", id=self.callers[part], count=count, seconds=120)["results"]
        assert len(result) == count
        assert all(len(answers) == 1 for answers in result.values())
        return [base64.b64decode(result[n][0]) for n in sorted(result, key=int)]

    def answered(self, call):
        part, number = call
        return str(number) in self.edge.ask("results", id=self.callers[part], count=0, seconds=0)["results"]

    def send(self, number, goal=None):
        goal = goal or new_uuid()
        return goal, self.begin("send_goal", goal + body(number))

    def accepted(self, call):
        return wire.read_goal_response(self.reply(call))

    def ask(self, goal):
        return self.begin("get_result", goal)

    def result(self, call):
        state, data, _ = wire.read_result_response(self.reply(call))
        return GoalState(state), struct.unpack("<i", data)[0]

    def cancel(self, goal=ANY, stamp=ZERO):
        code, infos = wire.read_cancel_response(
            self.reply(self.begin("cancel_goal", wire.cancel_request(GoalInfo(goal, stamp))))
        )
        return CancelCode(code), {i.uuid for i in infos}

    def feedback(self, goal, count=1):
        def arrived() -> list | None:
            messages = [
                wire.read_with_uuid(base64.b64decode(p)) for p, _ in self.edge.received(self.topics["feedback"], 0, 0)
            ]
            result = [struct.unpack("<i", data)[0] for u, data in messages if u == goal]
            return result if len(result) >= count else None

        return until(arrived, "feedback", SECONDS)

    def states(self):
        """Return the goal states in the status topic, by UUID."""
        messages = self.edge.received(self.topics["status"], 0, 0)
        if not messages:
            return {}
        return {i.uuid: GoalState(s) for i, s in wire.read_goal_states(base64.b64decode(messages[-1][0]))}

    def until_state(self, goal, state):
        until(lambda: self.states().get(goal) is state, f"the goal is {state.name}", SECONDS)

    def close(self):
        for caller in self.callers.values():
            self.edge.ask("close_caller", id=caller)
        for topic in self.topics.values():
            self.edge.drop(topic)


class HubServer:
    """A hub server, as the engine would offer it to the edge."""

    def __init__(self, edge, name) -> None:
        self.edge, self.name = edge, name
        self.services = {
            p: edge.ask("serve", service=f"{name}/_action/{p}", type=TYPES[p], md5="x")["id"] for p in PARTS
        }
        self.topics = {
            t: edge.ask("advertise", topic=f"{name}/_action/{t}", type=TYPES[t], md5="x", latched=t == "status")["id"]
            for t in ("feedback", "status")
        }

    def calls(self, part, count=1):
        def arrived() -> list | None:
            result = self.edge.ask("calls", id=self.services[part])["requests"]
            return [base64.b64decode(r) for r in result] if len(result) >= count else None

        return until(arrived, f"{count} calls of {part}", SECONDS)

    def answer(self, part, number, reply=b"", error=""):
        self.calls(part, number + 1)
        self.edge.ask("answer", id=self.services[part], number=number, reply=encoded(reply), error=error)

    def accept(self, number, accepted=True):
        self.answer("send_goal", number, wire.goal_response(wire.RosTime(7, 0), accepted=accepted))

    def result_call(self, goal):
        """Return the number of a goal's get_result call."""
        return until(lambda: [i for i, g in enumerate(self.calls("get_result")) if g == goal], "get_result", SECONDS)[0]

    def end(self, goal, state, number):
        self.answer("get_result", self.result_call(goal), wire.result_response(state, body(number)))

    def publish(self, part, payload):
        self.edge.ask("send", id=self.topics[part], payload=encoded(payload))

    def states(self, states):
        self.publish("status", wire.goal_states([(GoalInfo(u, wire.RosTime(7, 0)), s) for u, s in states.items()]))

    def close(self):
        for handle in (*self.services.values(), *self.topics.values()):
            self.edge.drop(handle)


class Served:
    """A `HubServer`, and a real actionlib client that uses it."""

    def __init__(self, edge, peer, name) -> None:
        self.hub, self.peer = HubServer(edge, name), peer
        self.id = peer.ask("client", name=name)["id"]
        assert peer.ask("wait_for_server", id=self.id, seconds=SECONDS)["there"]

    def send(self, *numbers: int):
        self.peer.ask("send", id=self.id, numbers=list(numbers))

    def goals(self, count):
        return [wire.read_with_uuid(r) for r in self.hub.calls("send_goal", count)]

    def until_state(self, number, state):
        (outcome,) = self.peer.ask("outcomes", id=self.id, numbers=[number], state=state, seconds=SECONDS)["outcomes"]
        assert state in outcome["states"]
        return outcome

    def done(self, number):
        outcome = self.until_state(number, "DONE")
        assert outcome["done"] == 1
        return outcome
