"""The first goal of a new actionlib client, and an immediate cancel request, with a real roscore and rospy."""

import contextlib
import socket
import struct
import threading
from xmlrpc.client import ServerProxy

import pytest

from bridge.adapters.ros1.actions import wire
from bridge.adapters.ros1.actions.states import Ros1State
from bridge.adapters.ros1.actions.wire import ZERO, GoalId
from bridge.messages.actions import GoalState
from tests.peers.ros1.adapter import edge_on
from tests.peers.ros1.hub_actions import SECONDS, HubServer, Served, peer_on
from tests.peers.ros1.network import RosMaster, needs_ros1
from tests.peers.ros1.servers import node, tcp_server, until_closed
from tests.support.wait import until

pytestmark = needs_ros1

MD5 = {
    "actionlib/TestActionGoal": "348369c5b403676156094e8c159720bf",
    "actionlib_msgs/GoalID": "302881f31927c1df708a2dbab0e80ee8",
}


def test_the_first_goal_of_a_new_client_is_not_delayed(tmp_path):
    """No delayed call of the edge is made, so the goal must be forwarded as soon as its message arrives."""
    with RosMaster() as master, edge_on(master, tmp_path) as edge, peer_on(master, "fresh") as peer:
        edge.ask("stop_timer")
        act = Served(edge, peer, "/fresh")
        act.send(5)
        ((goal, _),) = act.goals(1)
        act.hub.accept(0)
        act.hub.states({goal: GoalState.EXECUTING})
        act.until_state(5, "ACTIVE")


@pytest.mark.thorough
def test_an_immediate_cancel_request_never_overtakes_a_new_clients_first_goal(master, edge):
    for number in range(20):
        name = f"/behind{number}"
        with peer_on(master, f"behind{number}") as peer:
            act = Served(edge, peer, name)
            act.send(1)
            peer.ask("cancel", id=act.id, number=1)
            ((goal, _),) = act.goals(1)
            act.hub.accept(0)
            assert [wire.read_cancel_request(r) for r in act.hub.calls("cancel_goal")] == [(goal, ZERO)]
            act.hub.end(goal, GoalState.CANCELED, 0)
            assert act.done(1)["state"] in (Ros1State.PREEMPTED, Ros1State.RECALLED)
            act.hub.close()


class RawClient:
    """A hand-written actionlib client whose goal connection responds on the test's signal, so that its goal is late."""

    def __init__(self, stack, master, name, goal, cancel) -> None:
        self.answers = threading.Event()
        self.canceled = threading.Event()
        self._name = name
        ports = {
            "goal": stack.enter_context(tcp_server(lambda sock: self._serve(sock, "actionlib/TestActionGoal", goal))),
            "cancel": stack.enter_context(tcp_server(lambda sock: self._serve(sock, "actionlib_msgs/GoalID", cancel))),
        }
        uri = stack.enter_context(
            node(requestTopic=lambda _caller, topic, _how: [1, "", ["TCPROS", *ports[topic.rpartition("/")[2]]]])
        )
        for part, kind in (("goal", "actionlib/TestActionGoal"), ("cancel", "actionlib_msgs/GoalID")):
            with ServerProxy(master.uri) as proxy:
                proxy.registerPublisher(f"{name}_client", f"{name}/{part}", kind, uri)
        stack.callback(self.answers.set)

    def _serve(self, sock: socket.socket, kind: str, message: bytes) -> None:
        if kind.endswith("Goal"):
            self.answers.wait(SECONDS)
        fields = (f"type={kind}", f"md5sum={MD5[kind]}", "message_definition=", f"callerid={self._name}_client")
        header = b"".join(struct.pack("<I", len(f)) + f.encode() for f in fields)
        sock.sendall(struct.pack("<I", len(header)) + header + struct.pack("<I", len(message)) + message)
        if not kind.endswith("Goal"):
            self.canceled.set()
        until_closed(sock)


def test_a_goal_with_a_late_connection_precedes_its_cancel_request(master, edge):
    goal = wire.action_goal(GoalId(wire.RosTime(1, 0), "g"), struct.pack("<i", 7))
    with contextlib.ExitStack() as stack:
        hub = HubServer(edge, "/slow")
        until(
            lambda: "/midspan" in master.state()["subscribers"].get("/slow/cancel", []),
            "the action is offered",
            SECONDS,
        )
        client = RawClient(stack, master, "/slow", goal, wire.goal_id(GoalId(ZERO, "g")))
        assert client.canceled.wait(SECONDS)
        until(lambda: edge.ask("status")["held_cancels"] == 1, "the request is held for its goal", SECONDS)
        client.answers.set()
        ((uuid, _),) = [wire.read_with_uuid(r) for r in hub.calls("send_goal")]
        hub.accept(0)
        assert [wire.read_cancel_request(r) for r in hub.calls("cancel_goal")] == [(uuid, ZERO)]
        hub.close()
