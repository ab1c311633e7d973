"""Actions of the ROS 1 edge with real actionlib servers and clients; the hub's part is played by bytes."""

import base64
import signal
import struct
import uuid
from pathlib import Path

import pytest

from bridge.adapters.ros1.actions import ids, wire
from bridge.adapters.ros1.actions.states import CancelCode, Ros1State, Ros2State
from bridge.adapters.ros1.actions.wire import ZERO, GoalInfo
from tests.adapters.ros1.parts import edge_on
from tests.support.peer import Peer
from tests.support.ros1 import ROS1_PYTHON, RosMaster, needs_ros1
from tests.support.wait import until

pytestmark = [pytest.mark.real, needs_ros1]

SECONDS = 30.0
PEER = Path(__file__).with_name("action_peer.py")
ANY = bytes(16)
PARTS = ("send_goal", "get_result", "cancel_goal")
MOVE_BASE = "move_base_msgs/action/MoveBase"
TYPES = {
    "send_goal": "actionlib/action/Test_SendGoal", "get_result": "actionlib/action/Test_GetResult",
    "cancel_goal": "action_msgs/srv/CancelGoal", "feedback": "actionlib/action/Test_FeedbackMessage",
    "status": "action_msgs/GoalStatusArray",
}  # fmt: skip


@pytest.fixture(scope="module")
def edge(master, tmp_path_factory):
    with edge_on(master, tmp_path_factory.mktemp("state")) as edge:
        yield edge


def peer_on(master, name):
    return Peer(PEER, ROS1_PYTHON, master.env, name)


@pytest.fixture(scope="module")
def servers(master):
    """A program whose servers have a name for each test."""
    with peer_on(master, "servers") as peer:
        yield peer


@pytest.fixture(scope="module")
def clients(master):
    """A program whose clients have a name for each test."""
    with peer_on(master, "clients") as peer:
        yield peer


def encoded(data):
    return base64.b64encode(data).decode()


def body(number):
    return struct.pack("<i", number)


def new_uuid():
    return uuid.uuid4().bytes


class HubClient:
    """A client on the hub of an actionlib server, as the engine makes one for it."""

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

    def begin(self, part, request):
        self.number += 1
        self.edge.ask("begin", id=self.callers[part], request=encoded(request), number=self.number)
        return part, self.number

    def reply(self, call, seconds=SECONDS):
        """The one answer of a call, decoded from base64; an error stays text."""
        part, number = call

        def there() -> list | None:
            return self.edge.ask("results", id=self.callers[part], count=0, seconds=0)["results"].get(str(number))

        (answer,) = until(there, f"an answer to {part}", seconds)
        return answer if answer.startswith("error") else base64.b64decode(answer)

    def replies(self, part, count):
        """The one answer of each call so far, in the order of the calls."""
        found = self.edge.ask("results", id=self.callers[part], count=count, seconds=120)["results"]
        assert len(found) == count
        assert all(len(answers) == 1 for answers in found.values())
        return [base64.b64decode(found[n][0]) for n in sorted(found, key=int)]

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
        return Ros2State(state), struct.unpack("<i", data)[0]

    def cancel(self, goal=ANY, stamp=ZERO):
        code, infos = wire.read_cancel_response(
            self.reply(self.begin("cancel_goal", wire.cancel_request(GoalInfo(goal, stamp))))
        )
        return CancelCode(code), {i.uuid for i in infos}

    def feedback(self, goal, count=1):
        def there() -> list | None:
            messages = [
                wire.read_with_uuid(base64.b64decode(p)) for p, _ in self.edge.received(self.topics["feedback"], 0, 0)
            ]
            found = [struct.unpack("<i", data)[0] for u, data in messages if u == goal]
            return found if len(found) >= count else None

        return until(there, "feedback", SECONDS)

    def states(self):
        """What the status topic says now, by UUID."""
        messages = self.edge.received(self.topics["status"], 0, 0)
        if not messages:
            return {}
        return {i.uuid: Ros2State(s) for i, s in wire.read_goal_states(base64.b64decode(messages[-1][0]))}

    def until_state(self, goal, state):
        until(lambda: self.states().get(goal) is state, f"the goal is {state.name}", SECONDS)

    def close(self):
        for caller in self.callers.values():
            self.edge.ask("close_caller", id=caller)
        for topic in self.topics.values():
            self.edge.drop(topic)


def test_an_actionlib_server_is_shown_as_a_ros_2_action(master, edge):
    with peer_on(master, "shown_server") as peer, peer_on(master, "shown_client") as client:
        peer.ask("server", name="/shown")
        client.ask("client", name="/shown")
        until(lambda: len(edge.endpoints(node="/shown_server", made_by="native")) >= 5, "five parts", SECONDS)
        found = {
            e["topic"]: (e["kind"], e["type"], e["latched"])
            for e in edge.endpoints()
            if e["topic"].startswith("/shown/")
        }
        assert found == {
            f"/shown/_action/{p}": ("server" if p in PARTS else "publisher", TYPES[p], p == "status") for p in TYPES
        }
    with peer_on(master, "alone_client") as client:
        client.ask("client", name="/alone")
        edge.endpoint(topic="/rosout", node="/alone_client", made_by="native")
        assert not [e for e in edge.endpoints() if e["topic"].startswith("/alone/")], (
            "neither do a client's topics cross"
        )


def test_goals_end_in_the_state_that_the_server_gives(master, edge, servers):
    peer = servers
    server = peer.ask("server", name="/end")["id"]
    hub = HubClient(edge, "/end")
    ends = {10: Ros2State.SUCCEEDED, 11: Ros2State.ABORTED, 13: Ros2State.CANCELED}
    for number, state in ends.items():
        goal, sent = hub.send(number)
        assert hub.accepted(sent)
        assert hub.result(hub.ask(goal)) == (state, number)
        assert hub.result(hub.ask(goal)) == (state, number)
        assert hub.feedback(goal) == [number]
        hub.until_state(goal, state)
    _, sent = hub.send(12)
    assert hub.accepted(sent) is False
    goal, sent = hub.send(14)
    assert hub.accepted(sent)
    asked = hub.ask(goal)
    hub.until_state(goal, Ros2State.EXECUTING)
    assert not hub.answered(asked)
    seen = peer.ask("goals", id=server, count=5)["goals"]
    assert seen[-1] == [ids.text_of(goal), 14]
    peer.ask("finish", id=server, goal=ids.text_of(goal))
    assert hub.result(asked) == (Ros2State.SUCCEEDED, 14)
    assert hub.result(hub.ask(new_uuid()))[0] is Ros2State.UNKNOWN
    hub.close()
    again = HubClient(edge, "/end")
    assert again.result(again.ask(goal)) == (Ros2State.SUCCEEDED, 14), "results outlast the callers"
    again.close()
    until(lambda: "/end/goal" not in master.state()["publishers"], "our topics are given back", SECONDS)


def test_cancel(master, edge, servers):
    peer = servers
    peer.ask("server", name="/cancel")
    hub = HubClient(edge, "/cancel")
    goals = []
    for number in (24, 34, 44):
        goal, sent = hub.send(number)
        assert hub.accepted(sent)
        goals.append(goal)
    asked = [hub.ask(g) for g in goals]
    assert hub.cancel(goals[0]) == (CancelCode.NONE, {goals[0]})
    assert hub.result(asked[0]) == (Ros2State.CANCELED, 24)
    assert hub.cancel(goals[0])[0] is CancelCode.GOAL_TERMINATED
    assert hub.cancel(new_uuid())[0] is CancelCode.UNKNOWN_GOAL_ID
    assert not hub.answered(asked[1])
    assert hub.cancel() == (CancelCode.NONE, {goals[1], goals[2]})
    assert [hub.result(a)[0] for a in asked[1:]] == [Ros2State.CANCELED] * 2
    stubborn, sent = hub.send(1_000_004)
    assert hub.accepted(sent)
    assert hub.cancel(stubborn) == (CancelCode.NONE, {stubborn}), "the server's library says so, not its user"
    hub.until_state(stubborn, Ros2State.CANCELING)
    hub.close()


def test_cancel_before_a_time(master, edge, servers):
    peer = servers
    peer.ask("server", name="/before")
    hub = HubClient(edge, "/before")
    old, sent = hub.send(24)
    stamp = wire.Stamp(*struct.unpack("<II", hub.reply(sent)[1:]))
    assert stamp > ZERO
    new, sent = hub.send(34)
    assert hub.accepted(sent)
    assert hub.cancel(stamp=stamp) == (CancelCode.NONE, {old})
    hub.until_state(old, Ros2State.CANCELED)
    assert hub.states()[new] is Ros2State.EXECUTING
    later, sent = hub.send(44)
    assert hub.accepted(sent), "our goals have no stamp that a cancel request could be after"
    hub.until_state(later, Ros2State.EXECUTING)
    hub.close()


def test_a_new_goal_pre_empts_and_a_simple_server_tells(master, edge, servers):
    peer = servers
    server = peer.ask("server", name="/simple", simple=True)["id"]
    hub = HubClient(edge, "/simple")
    first, sent = hub.send(1)
    assert hub.accepted(sent)
    asked = hub.ask(first)
    hub.until_state(first, Ros2State.EXECUTING)
    second, sent = hub.send(2)
    assert hub.accepted(sent)
    assert hub.result(asked)[0] is Ros2State.CANCELED
    hub.until_state(second, Ros2State.EXECUTING)
    peer.ask("finish", id=server)
    assert hub.result(hub.ask(second))[0] is Ros2State.SUCCEEDED
    hub.close()


def test_goals_of_native_clients_are_seen_followed_and_cancelled(master, edge, servers, clients):
    server, peer = servers, clients
    server.ask("server", name="/other")
    client = peer.ask("client", name="/other")["id"]
    assert peer.ask("wait_for_server", id=client)["there"]
    hub = HubClient(edge, "/other")
    peer.ask("send", id=client, numbers=[54])
    (outcome,) = peer.ask("outcomes", id=client, numbers=[54], state="ACTIVE")["outcomes"]
    goal = ids.uuid_of("/other", outcome["id"])
    hub.until_state(goal, Ros2State.EXECUTING)
    asked = hub.ask(goal)
    assert hub.cancel(goal) == (CancelCode.NONE, {goal})
    assert hub.result(asked) == (Ros2State.CANCELED, 54)
    (outcome,) = peer.ask("outcomes", id=client, numbers=[54])["outcomes"]
    assert (outcome["state"], outcome["done"]) == (Ros1State.PREEMPTED, 1)
    hub.close()


@pytest.mark.parametrize("how", ["killed", "restarted", "stopped"])
def test_a_server_that_goes_ends_its_goals(master, edge, how):
    name = f"/{how}"
    with peer_on(master, f"{how}_server") as peer:
        server = peer.ask("server", name=name)["id"]
        hub = HubClient(edge, name)
        goal, sent = hub.send(14)
        assert hub.accepted(sent)
        asked = hub.ask(goal)
        hub.until_state(goal, Ros2State.EXECUTING)
        if how == "stopped":
            peer.ask("stop_server", id=server)
        else:
            peer.signal(signal.SIGKILL)
        if how == "restarted":
            with peer_on(master, f"{how}_server") as other:
                other.ask("server", name=name)
                assert hub.result(asked) == (Ros2State.ABORTED, 0)

                def taken() -> bytes | None:
                    new, sent = hub.send(10)
                    return new if hub.accepted(sent) else None

                new = until(taken, "the new server takes goals", SECONDS)
                assert hub.result(hub.ask(new)) == (Ros2State.SUCCEEDED, 10)
                assert hub.result(hub.ask(goal)) == (Ros2State.ABORTED, 0)
        else:
            assert hub.result(asked) == (Ros2State.ABORTED, 0)
            assert hub.accepted(hub.send(10)[1]) is False
        hub.until_state(goal, Ros2State.ABORTED)
        hub.close()


def test_a_result_that_was_lost_has_the_state_of_the_list(master, edge, servers, clients):
    """The goal ended while nobody of ours listened: results are not latched."""
    peer, native = servers, clients
    server = peer.ask("server", name="/lost")["id"]
    client = native.ask("client", name="/lost")["id"]
    assert native.ask("wait_for_server", id=client)["there"]
    goal = new_uuid()
    native.ask("raw_goal", id=client, number=14, goal=ids.text_of(goal))
    peer.ask("goals", id=server)
    peer.ask("finish", id=server, goal=ids.text_of(goal), outcome="abort")
    hub = HubClient(edge, "/lost")
    hub.until_state(goal, Ros2State.ABORTED)
    assert hub.result(hub.ask(goal)) == (Ros2State.ABORTED, 0)
    hub.close()


def test_master_dies_in_a_goal(tmp_path):
    with RosMaster() as master, edge_on(master, tmp_path) as edge, peer_on(master, "master_server") as peer:
        server = peer.ask("server", name="/orphan")["id"]
        hub = HubClient(edge, "/orphan")
        goal, sent = hub.send(14)
        assert hub.accepted(sent)
        asked = hub.ask(goal)
        hub.until_state(goal, Ros2State.EXECUTING)
        master.stop()
        assert hub.result(asked) == (Ros2State.ABORTED, 0)
        hub.close()
        assert peer.ask("goals", id=server)["goals"] == [[ids.text_of(goal), 14]]


def move_base_goal(frame):
    """A MoveBaseGoal: its PoseStamped alone."""
    text = frame.encode()
    return struct.pack("<IIII", 0, 0, 0, len(text)) + text + struct.pack("<7d", 0, 0, 0, 0, 0, 0, 1)


def test_goals_in_frames_that_are_not_there_are_rejected(master, edge, servers):
    peer = servers
    with master.peer("frames_tf") as tf:
        server = peer.ask("server", name="/frames", type="move_base_msgs/MoveBase")["id"]
        static = tf.advertise("/robot/tf_static", "tf2_msgs/TFMessage", latched=True)
        tf.publish(static, {"transforms": [{"header": {"frame_id": "map"}, "child_frame_id": "/odom"}]})
        hub = HubClient(edge, "/frames", MOVE_BASE)

        def accepted(frame: str) -> bool:
            return hub.accepted(hub.begin("send_goal", new_uuid() + move_base_goal(frame)))

        # as long as no transform has come, nobody knows which frames there are
        until(lambda: not accepted("mpa"), "the transforms are heard")
        for frame, good in (("map", True), ("/map", True), ("odom", True), ("mpa", False), ("", False)):
            assert accepted(frame) is good, frame
        wanted = ["map", "map", "odom"]

        def seen() -> list[str]:
            goals = peer.ask("goals", id=server, count=3)["goals"]
            frames = [goal[1]["target_pose"]["header"]["frame_id"] for goal in goals]
            return [frame for frame in frames if frame != "mpa"]

        until(lambda: seen() == wanted, "the server has the good goals")
        warnings = [w for w in edge.ask("status")["warnings"] if w.startswith("/frames")]
        assert "'mpa' of target_pose.header.frame_id" in warnings[0]
        assert hub.reply(hub.begin("send_goal", new_uuid() + b"short")).startswith("error: ")
        hub.close()


def test_a_thousand_goals_at_once_end_as_their_server_says(master, edge, servers):
    """Refused, ended at once, and all others held until every one of them has been accepted."""
    count = 1000
    numbers = [100 * n + (n % 5 if n % 2 else 4) for n in range(count)]
    peer = servers
    server = peer.ask("server", name="/many")["id"]
    hub = HubClient(edge, "/many")
    goals = {n: new_uuid() for n in numbers}
    for number, goal in goals.items():
        hub.send(number, goal)
    replies = hub.replies("send_goal", count)
    refused = {n for n, reply in zip(numbers, replies, strict=True) if not wire.read_goal_response(reply)}
    assert refused == {n for n in numbers if n % 10 == 2}
    rest = [n for n in numbers if n not in refused]
    hub.number = 0
    for number in rest:
        hub.ask(goals[number])
    peer.ask("finish_all", id=server)
    ended = [wire.read_result_response(reply) for reply in hub.replies("get_result", len(rest))]
    wanted = [{0: 4, 1: 6, 3: 5}.get(n % 10) or (4, 6, 5)[n // 100 % 3] for n in rest]
    assert [Ros2State(state) for state, _, _ in ended] == [Ros2State(w) for w in wanted]
    hub.close()


# -- actions of the hub for ROS 1 clients ------------------------------------------------------------------------------


class HubServer:
    """A server on the hub, as the engine offers it to the edge."""

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
        def there() -> list | None:
            found = self.edge.ask("calls", id=self.services[part])["requests"]
            return [base64.b64decode(r) for r in found] if len(found) >= count else None

        return until(there, f"{count} calls of {part}", SECONDS)

    def answer(self, part, number, reply=b"", error=""):
        self.calls(part, number + 1)
        self.edge.ask("answer", id=self.services[part], number=number, reply=encoded(reply), error=error)

    def accept(self, number, accepted=True):
        self.answer("send_goal", number, wire.goal_response(wire.Stamp(7, 0), accepted=accepted))

    def asked(self, goal):
        """The number of the get_result call of a goal."""
        return until(lambda: [i for i, g in enumerate(self.calls("get_result")) if g == goal], "get_result", SECONDS)[0]

    def end(self, goal, state, number):
        self.answer("get_result", self.asked(goal), wire.result_response(state, body(number)))

    def tell(self, part, payload):
        self.edge.ask("send", id=self.topics[part], payload=encoded(payload))

    def states(self, states):
        self.tell("status", wire.goal_states([(GoalInfo(u, wire.Stamp(7, 0)), s) for u, s in states.items()]))

    def close(self):
        for handle in (*self.services.values(), *self.topics.values()):
            self.edge.drop(handle)


class Served:
    """A HubServer and a real actionlib client of it."""

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


def test_a_client_runs_a_goal_of_the_hub(master, edge, clients):
    peer = clients
    act = Served(edge, peer, "/run")
    act.send(5)
    ((goal, data),) = act.goals(1)
    assert data == body(5)
    act.hub.accept(0)
    act.until_state(5, "PENDING")
    act.hub.states({goal: Ros2State.EXECUTING})
    act.until_state(5, "ACTIVE")
    act.hub.tell("feedback", goal + body(50))
    until(
        lambda: peer.ask("outcomes", id=act.id, numbers=[5], seconds=0)["outcomes"][0]["feedback"] == [50],
        "feedback",
        SECONDS,
    )
    act.hub.end(goal, Ros2State.SUCCEEDED, 500)
    outcome = act.done(5)
    assert (outcome["state"], outcome["result"]) == (Ros1State.SUCCEEDED, 500)
    act.hub.close()
    until(lambda: "/run/status" not in master.state()["publishers"], "our topics are given back", SECONDS)


def test_ends_of_goals_of_the_hub(master, edge, clients):
    ends = {
        1: (Ros2State.SUCCEEDED, Ros1State.SUCCEEDED), 2: (Ros2State.ABORTED, Ros1State.ABORTED),
        3: (Ros2State.CANCELED, Ros1State.PREEMPTED), 4: (Ros2State.UNKNOWN, Ros1State.ABORTED),
    }  # fmt: skip
    peer = clients
    act = Served(edge, peer, "/ends")
    act.send(1, 2, 3, 4, 5, 6)
    goals = {struct.unpack("<i", data)[0]: (at, goal) for at, (goal, data) in enumerate(act.goals(6))}
    for number in ends:
        act.hub.accept(goals[number][0])
    act.hub.accept(goals[5][0], accepted=False)
    act.hub.answer("send_goal", goals[6][0], error="no server")
    act.hub.states({goals[n][1]: Ros2State.EXECUTING for n in ends})
    for number, (state, seen) in ends.items():
        act.hub.end(goals[number][1], state, number * 10)
        outcome = act.done(number)
        assert (outcome["state"], outcome["result"]) == (seen, number * 10)
    assert act.done(5)["state"] == Ros1State.REJECTED
    assert (act.done(6)["state"], act.done(6)["text"]) == (Ros1State.ABORTED, "no server")
    act.hub.close()


def test_cancel_from_ros_1(master, edge, clients):
    peer = clients
    act = Served(edge, peer, "/stop")
    act.send(1, 2)
    goals = {struct.unpack("<i", data)[0]: goal for goal, data in act.goals(2)}
    for at in (0, 1):
        act.hub.accept(at)
    act.hub.states(dict.fromkeys(goals.values(), Ros2State.EXECUTING))
    for number in goals:
        act.until_state(number, "ACTIVE")
    peer.ask("cancel", id=act.id, number=1)
    assert [wire.read_cancel_request(r) for r in act.hub.calls("cancel_goal")] == [(goals[1], ZERO)]
    act.until_state(1, "PREEMPTING")
    act.hub.end(goals[1], Ros2State.CANCELED, 0)
    assert act.done(1)["state"] == Ros1State.PREEMPTED
    peer.ask("cancel", id=act.id)
    assert wire.read_cancel_request(act.hub.calls("cancel_goal", 2)[1]) == (ANY, ZERO)
    act.until_state(2, "PREEMPTING")
    act.hub.end(goals[2], Ros2State.SUCCEEDED, 0)
    assert act.done(2)["state"] == Ros1State.SUCCEEDED
    peer.ask("cancel_id", id=act.id, goal="later")
    until(lambda: ["later", Ros1State.RECALLING, ""] in peer.ask("status", id=act.id)["goals"], "it waits", SECONDS)
    peer.ask("raw_goal", id=act.id, goal="later", number=3, stamp=[1, 0])
    until(lambda: ["later", Ros1State.RECALLED, ""] in peer.ask("status", id=act.id)["goals"], "recalled", SECONDS)
    assert len(act.goals(2)) == 2, "that goal never reached the hub"
    peer.ask("raw_goal", id=act.id, number=4)
    assert act.goals(3)[2][1] == body(4)
    until(
        lambda: any(g[0].startswith("/stop-1-") for g in peer.ask("status", id=act.id)["goals"]),
        "it has got an id",
        SECONDS,
    )
    act.hub.close()


def test_a_thousand_goals_of_ros_1_at_once_end_as_the_hub_says(master, edge, clients):
    """All are accepted, refused or fail before the first one ends."""
    count = 1000
    hub = HubServer(edge, "/crowd")
    flood = clients.ask("flood", name="/crowd", count=count)["id"]
    goals = [wire.read_with_uuid(request) for request in hub.calls("send_goal", count)]
    numbers = [struct.unpack("<i", data)[0] for _, data in goals]
    assert numbers == list(range(count))
    ends = (Ros2State.SUCCEEDED, Ros2State.ABORTED, Ros2State.CANCELED)
    seen = {Ros2State.SUCCEEDED: Ros1State.SUCCEEDED, Ros2State.ABORTED: Ros1State.ABORTED}
    wanted = {}
    for number in numbers:
        more = {"id": hub.services["send_goal"], "number": number}
        if number % 10 == 1:
            edge.ask("answer", error="no server", **more)
            wanted[number] = [Ros1State.ABORTED, 0]
        else:
            edge.ask("answer", reply=encoded(wire.goal_response(ZERO, accepted=number % 10 != 2)), **more)
            wanted[number] = [Ros1State.REJECTED, 0]
    at = {goal: index for index, goal in enumerate(hub.calls("get_result", count * 8 // 10))}
    for (goal, _), number in zip(goals, numbers, strict=True):
        if number % 10 not in (1, 2):
            state = ends[number % 3]
            reply = encoded(wire.result_response(state, body(number)))
            edge.ask("answer", id=hub.services["get_result"], number=at[goal], reply=reply)
            wanted[number] = [seen.get(state, Ros1State.RECALLED), number]
    results = clients.ask("results", id=flood, count=count)["results"]
    assert results == {f"g{number}": [end] for number, end in wanted.items()}
    hub.close()


def test_a_hub_server_that_goes_ends_its_goals(master, edge, clients):
    peer = clients
    act = Served(edge, peer, "/gone")
    act.send(1)
    act.hub.accept(0)
    ((goal, _),) = act.goals(1)
    act.hub.asked(goal)
    act.hub.states({goal: Ros2State.EXECUTING})
    act.until_state(1, "ACTIVE")
    abandoned = act.hub.services["get_result"]
    act.hub.close()
    outcome = act.done(1)
    assert (outcome["state"], outcome["text"]) == (Ros1State.ABORTED, "the action server is gone")
    assert edge.ask("calls", id=abandoned)["abandoned"] == [0]
    again = HubServer(edge, "/gone")
    assert peer.ask("wait_for_server", id=act.id, seconds=SECONDS)["there"]

    def sent() -> list:
        peer.ask("send", id=act.id, numbers=[2])
        return again.edge.ask("calls", id=again.services["send_goal"])["requests"]

    until(sent, "the client is connected again", SECONDS, 0.3)
    again.close()


def test_a_dead_worker_leaves_no_client_waiting(tmp_path):
    with RosMaster() as master, peer_on(master, "left_client") as peer:
        with edge_on(master, tmp_path) as first:
            act = Served(first, peer, "/left")
            act.send(1)
            ((goal, _),) = act.goals(1)
            act.hub.accept(0)
            act.hub.states({goal: Ros2State.EXECUTING})
            act.until_state(1, "ACTIVE")
            first.signal(signal.SIGKILL)
        with edge_on(master, tmp_path) as second:
            HubServer(second, "/left")
            outcome = act.done(1)
            assert outcome["state"] == Ros1State.LOST


def test_a_dead_worker_leaves_goals_that_the_next_one_follows(tmp_path):
    with RosMaster() as master, peer_on(master, "kept_server") as peer:
        server = peer.ask("server", name="/kept")["id"]
        with edge_on(master, tmp_path) as first:
            hub = HubClient(first, "/kept")
            goal, sent = hub.send(14)
            assert hub.accepted(sent)
            first.signal(signal.SIGKILL)
        with edge_on(master, tmp_path) as second:
            hub = HubClient(second, "/kept")
            hub.until_state(goal, Ros2State.EXECUTING)
            asked = hub.ask(goal)
            peer.ask("finish", id=server, goal=ids.text_of(goal))
            assert hub.result(asked) == (Ros2State.SUCCEEDED, 14)


def test_a_native_server_keeps_its_name(master, edge):
    with peer_on(master, "rival_client") as client, peer_on(master, "rival_server") as peer:
        act = Served(edge, client, "/rival")
        server = peer.ask("server", name="/rival")["id"]
        why = "/rival: /rival_server serves this action on ROS 1 itself, so the hub's is not offered there"
        until(lambda: why in edge.ask("status")["warnings"], "a person is told", SECONDS)
        until(lambda: master.state()["publishers"]["/rival/status"] == ["/rival_server"], "ours gives way", SECONDS)
        peer.ask("stop_server", id=server)
        until(lambda: master.state()["publishers"].get("/rival/status") == ["/midspan"], "ours is back", SECONDS)
        act.hub.close()
