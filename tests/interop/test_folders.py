"""Real programs use a package of ``types.folders`` whose files are each written in the syntax of one ROS version.

Each program has the package in its own ROS version's syntax, independently of Midspan's registry: genpy generates the
classes of ROS 1, rosidl builds the package of ROS 2.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from bridge.interfaces.builder import build
from bridge.interfaces.cache import environment
from tests.interop.test_topics import cross
from tests.peers.daemon.deployment import Deployment
from tests.peers.peer import Peer
from tests.peers.ros2.network import ROS2_PEER, ros2_environment, ros2_python

FOLDER = {
    "msg/Inner.msg": "Header header\nint32 x\n",  # ROS 1 syntax
    "msg/Note.msg": "builtin_interfaces/Duration length\nstring<=8 name\nbool LOUD=true\n",  # ROS 2 syntax
    "msg/Outer.msg": "Inner[] items\nNote[2] notes\nbool done\n",  # syntax of both versions
    "srv/Ask.srv": "Outer wanted\n------\nNote[] notes\nInner last\n",
    "action/Go.action": "Inner start\n--- # result\nNote[] notes\n---\nOuter at\n",
}
ROS2_FILES = {
    "msg/Inner.msg": "std_msgs/Header header\nint32 x\n",
    "msg/Note.msg": FOLDER["msg/Note.msg"],
    "msg/Outer.msg": FOLDER["msg/Outer.msg"],
    "srv/Ask.srv": "Outer wanted\n---\nNote[] notes\nInner last\n",
    "action/Go.action": "Inner start\n---\nNote[] notes\n---\nOuter at\n",
}
INNER = "Header header\nint32 x\n"
NOTE = "duration length\nstring name\nbool LOUD=1\n"
OUTER = FOLDER["msg/Outer.msg"]
NESTED = {
    "mixed_msgs/Inner": INNER,
    "std_msgs/Header": "uint32 seq\ntime stamp\nstring frame_id\n",
    "mixed_msgs/Note": NOTE,
}
ID = {"actionlib_msgs/GoalID": "time stamp\nstring id\n"}
STATES = [
    "PENDING",
    "ACTIVE",
    "PREEMPTED",
    "SUCCEEDED",
    "ABORTED",
    "REJECTED",
    "PREEMPTING",
    "RECALLING",
    "RECALLED",
    "LOST",
]
STATUS = {
    "actionlib_msgs/GoalStatus": "GoalID goal_id\nuint8 status\n"
    + "".join(f"uint8 {name}={number}\n" for number, name in enumerate(STATES))
    + "string text\n",
    "mixed_msgs/GoGoal": "Inner start\n",
    "mixed_msgs/GoResult": "Note[] notes\n",
    "mixed_msgs/GoFeedback": "Outer at\n",
    "mixed_msgs/Outer": OUTER,
    "mixed_msgs/GoActionGoal": "Header header\nactionlib_msgs/GoalID goal_id\nGoGoal goal\n",
    "mixed_msgs/GoActionResult": "Header header\nactionlib_msgs/GoalStatus status\nGoResult result\n",
    "mixed_msgs/GoActionFeedback": "Header header\nactionlib_msgs/GoalStatus status\nGoFeedback feedback\n",
}
ACTION = "GoActionGoal action_goal\nGoActionResult action_result\nGoActionFeedback action_feedback\n"

Sides = dict[str, tuple[Peer, "Messages"]]


def full(own: str, nested: dict[str, str]) -> str:
    """Return a full definition, as in connection headers."""
    return own + "".join(f"{'=' * 80}\nMSG: {name}\n{text}" for name, text in nested.items())


class Messages:
    """The same messages, spelled as in either ROS version."""

    def __init__(self, *, ros1: bool) -> None:
        self._sec, self._nanosec = ("secs", "nsecs") if ros1 else ("sec", "nanosec")

    def note(self, name: str) -> dict[str, Any]:
        return {"length": {self._sec: -3, self._nanosec: 5}, "name": name}

    def inner(self, x: int) -> dict[str, Any]:
        return {"header": {"stamp": {self._sec: 7, self._nanosec: 9}, "frame_id": "map"}, "x": x}

    def outer(self) -> dict[str, Any]:
        return {"items": [self.inner(1), self.inner(2)], "notes": [self.note("a"), self.note("b")], "done": True}


def plain(message: Any) -> Any:
    """Return a message without the sequence number, because only ROS 1 has one in headers."""
    if isinstance(message, dict):
        return {key: plain(value) for key, value in message.items() if key != "seq"}
    return [plain(value) for value in message] if isinstance(message, list) else message


@pytest.fixture(scope="module")
def sides(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sides]:
    """The daemon, and a program of each ROS version that spells the messages its own way."""
    folder = tmp_path_factory.mktemp("folders")
    for path, text in FOLDER.items():
        file = folder / "types" / "mixed_msgs" / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    with Deployment(folder) as deployment:
        deployment.start(types={"folders": [str(folder / "types")]})
        env = {**ros2_environment(), **environment([build({"mixed_msgs": ROS2_FILES})])}
        ros2 = deployment.keep(Peer(ROS2_PEER, ros2_python(), env, "program2"))
        ros1 = deployment.ros1("program1")
        ros1.ask("define", type="mixed_msgs/Outer", definition=full(OUTER, NESTED))
        request = full("Outer wanted\n", {"mixed_msgs/Outer": OUTER, **NESTED})
        response = full("Note[] notes\nInner last\n", NESTED)
        ros1.ask("define", type="mixed_msgs/Ask", definition=f"{request}---\n{response}")
        ros1.ask("define", type="mixed_msgs/GoAction", definition=full(ACTION, {**NESTED, **ID, **STATUS}))
        yield {"ros1": (ros1, Messages(ros1=True)), "ros2": (ros2, Messages(ros1=False))}


WAYS = [("ros1", "ros2"), ("ros2", "ros1")]


@pytest.mark.parametrize(("from_", "to"), WAYS)
def test_topics_with_types_of_the_folder_are_bridged(sides: Sides, from_: str, to: str) -> None:
    (sender, sent), (receiver, expected) = sides[from_], sides[to]
    arrived = receiver.subscribe(f"/outer_to_{to}", "mixed_msgs/Outer")
    out = sender.advertise(f"/outer_to_{to}", "mixed_msgs/Outer")
    assert plain(cross(sender, out, receiver, arrived, sent.outer())) == expected.outer()


@pytest.mark.parametrize(("from_", "to"), WAYS)
def test_services_with_types_of_the_folder_are_bridged(sides: Sides, from_: str, to: str) -> None:
    (client, request), (server, replied) = sides[from_], sides[to]
    service = f"/ask_{to}"
    reply = {"notes": [replied.note("c")], "last": replied.inner(3)}
    served = server.ask("serve", service=service, type="mixed_msgs/Ask", reply=reply)["id"]
    if from_ == "ros1":
        client.ask("await_service", service=service, seconds=30.0)
    call = client.ask("call", service=service, type="mixed_msgs/Ask", request={"wanted": request.outer()}, seconds=30.0)
    result = client.ask("result", id=call["id"], seconds=30.0)
    assert plain(result["reply"]) == {"notes": [request.note("c")], "last": request.inner(3)}, result
    assert plain(server.ask("requests", id=served)["requests"]) == [{"wanted": replied.outer()}]


@pytest.mark.parametrize(("from_", "to"), WAYS)
def test_actions_with_types_of_the_folder_are_bridged(sides: Sides, from_: str, to: str) -> None:
    (client, request), (server, replied) = sides[from_], sides[to]
    action, kind = f"/go_{to}", "mixed_msgs/Go"
    acting = server.ask(
        "act",
        action=action,
        type=kind,
        feedback=[{"at": replied.outer()}],
        result={"notes": [replied.note("d")]},
        held=True,
    )["id"]
    goal = client.ask("send_goal", action=action, type=kind, goal={"start": request.inner(4)}, seconds=30.0)["id"]
    state = client.ask("goal", id=goal, until={"accepted": True, "feedback": 1}, seconds=30.0)
    assert plain(state["feedback"]) == [{"at": request.outer()}], state
    server.ask("release", id=acting)
    state = client.ask("goal", id=goal, until={"status": 4}, seconds=30.0)
    assert plain(state["result"]) == {"notes": [request.note("d")]}, state
    assert plain(server.ask("goals", id=acting)["goals"]) == [{"start": replied.inner(4)}]
