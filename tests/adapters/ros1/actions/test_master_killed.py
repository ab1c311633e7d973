"""A real roscore is killed while an actionlib server on rospy executes goals."""

import base64
import signal
import time
from typing import Any
from xmlrpc.client import ServerProxy

import pytest

from bridge.adapters.ros1.actions import states, wire
from bridge.adapters.ros1.actions.states import Ros1State
from bridge.messages.actions import CancelCode, GoalState
from tests.peers.ros1.adapter import edge_on, string, text
from tests.peers.ros1.hub_actions import SECONDS, HubClient, Served, peer_on
from tests.peers.ros1.network import RosMaster, needs_ros1
from tests.support.wait import until

pytestmark = needs_ros1

LOST = "lost sight of the goal: its action server /driver left"


class Drive:
    """An actionlib server that executes a goal of the hub and a goal of a native client."""

    def __init__(self, master, edge, server, client) -> None:
        self.master, self.edge, self.server, self.client = master, edge, server, client
        self.action = server.ask("server", name="/drive")["id"]
        self.id = client.ask("client", name="/drive")["id"]
        assert client.ask("wait_for_server", id=self.id)["there"]
        self.hub = HubClient(edge, "/drive")
        self.goal, sent = self.hub.send(14)
        assert self.hub.accepted(sent)
        self.asked = self.hub.ask(self.goal)
        client.ask("send", id=self.id, numbers=[24])
        (outcome,) = client.ask("outcomes", id=self.id, numbers=[24], state="ACTIVE")["outcomes"]
        self.native = states.uuid_of("/drive", outcome["id"])
        self.drives()

    def drives(self):
        for goal in (self.goal, self.native):
            self.hub.until_state(goal, GoalState.EXECUTING)

    def lists(self):
        return len(self.edge.received(self.hub.topics["status"], 0, 0))

    def goes_on(self):
        """Check that the list, with both goals, is still being published."""
        before = self.lists()
        until(lambda: self.lists() >= before + 2, "the list is still published", SECONDS)
        self.drives()
        assert not self.hub.answered(self.asked)

    def ends(self):
        """Check that a stop reaches the server, and that both goals end as reported by the server."""
        assert self.hub.cancel(self.native) == (CancelCode.NONE, {self.native})
        (outcome,) = self.client.ask("outcomes", id=self.id, numbers=[24])["outcomes"]
        assert (outcome["state"], outcome["done"]) == (Ros1State.PREEMPTED, 1)
        self.server.ask("finish", id=self.action, goal=states.text_of(self.goal))
        assert self.hub.result(self.asked) == (GoalState.SUCCEEDED, 14)
        self.hub.until_state(self.native, GoalState.CANCELED)


@pytest.fixture
def master():
    with RosMaster() as master:
        yield master


@pytest.fixture
def drive(master, tmp_path):
    with (
        edge_on(master, tmp_path) as edge,
        peer_on(master, "driver") as server,
        peer_on(master, "native_client") as client,
    ):
        yield Drive(master, edge, server, client)


def shown(edge):
    return sorted((e["id"], e["kind"]) for e in edge.endpoints(made_by="native") if "/drive/" in e["topic"])


def test_goals_continue_without_a_master_and_can_be_canceled(drive):
    edge, network, before = drive.edge, drive.edge.joined(), shown(drive.edge)
    drive.master.kill()
    until(lambda: "no ROS 1 master" in str(edge.ask("status")["warnings"]), "the loss is noticed", SECONDS)
    drive.goes_on()
    assert edge.ask("network")["network"] == network
    assert shown(edge) == before
    drive.ends()


def test_another_master_without_the_server_ends_no_goals(drive):
    edge, before = drive.edge, shown(drive.edge)
    drive.master.kill()
    drive.master.start(forget=True)
    edge.joined(drive.master.call("getParam", "/run_id"))
    listed = drive.master.state
    until(
        lambda: listed()["publishers"].get("/drive/goal") == ["/midspan"],
        "the edge's endpoint is registered again",
        SECONDS,
    )
    assert "/driver" not in drive.master.nodes()
    drive.goes_on()
    assert shown(edge) == before
    goal, sent = drive.hub.send(10)
    assert drive.hub.accepted(sent), "new goals are executed, too"
    assert drive.hub.feedback(goal) == [10], "each message arrives once"
    drive.ends()


def test_a_lost_registration_ends_no_goals(drive):
    proxy: Any
    with ServerProxy(drive.master.uri) as proxy:
        _, _, uri = proxy.lookupNode("/test", "/driver")
        for part in ("status", "feedback", "result"):
            assert proxy.unregisterPublisher("/driver", f"/drive/{part}", uri)[2] == 1
        for part in ("goal", "cancel"):
            assert proxy.unregisterSubscriber("/driver", f"/drive/{part}", uri)[2] == 1
    drive.goes_on()
    drive.ends()


@pytest.mark.parametrize("away", [True, False], ids=["no master", "another master"])
def test_a_server_that_is_killed_later_is_lost(drive, away):
    edge = drive.edge
    drive.master.kill()
    until(lambda: "no ROS 1 master" in str(edge.ask("status")["warnings"]), "the loss is noticed", SECONDS)
    if not away:
        drive.master.start(forget=True)
        edge.joined(drive.master.call("getParam", "/run_id"))
    drive.goes_on()
    lists = drive.hub.states()
    drive.server.signal(signal.SIGKILL)
    assert LOST in drive.hub.reply(drive.asked)
    until(lambda: not shown(edge), "the server leaves the graph", SECONDS)
    assert drive.hub.states() == lists, "the list does not contain the goals' ends"
    if away:
        drive.client.signal(signal.SIGKILL)
        until(lambda: edge.ask("network")["network"] is None, "the network has left", SECONDS)
        assert edge.endpoints() == []


def test_a_goal_of_a_ros_1_client_at_a_hub_server_continues_and_is_canceled(master, tmp_path):
    with edge_on(master, tmp_path) as edge, peer_on(master, "client") as client:
        act = Served(edge, client, "/served")
        act.send(1)
        ((goal, _),) = act.goals(1)
        act.hub.accept(0)
        act.hub.states({goal: GoalState.EXECUTING})
        act.until_state(1, "ACTIVE")
        master.kill()
        until(lambda: "no ROS 1 master" in str(edge.ask("status")["warnings"]), "the loss is noticed", SECONDS)
        client.ask("cancel", id=act.id, number=1)
        assert [wire.read_cancel_request(r) for r in act.hub.calls("cancel_goal")] == [(goal, wire.ZERO)]
        act.hub.end(goal, GoalState.CANCELED, 0)
        assert act.done(1)["state"] == Ros1State.PREEMPTED
        act.send(2)
        assert len(act.goals(2)) == 2, "new goals arrive, too"


def test_commands_of_a_node_continue_without_a_master(master, tmp_path):
    with edge_on(master, tmp_path) as edge, master.peer("base_driver") as peer:
        out = peer.advertise("/cmd", "std_msgs/String")
        endpoint = edge.endpoint(topic="/cmd", made_by="native")
        inbox = edge.open("/cmd", "std_msgs/String")
        mirror = edge.ask("advertise", topic="/back", type="std_msgs/String")["id"]
        back = peer.subscribe("/back", "std_msgs/String")
        edge.until_connected(mirror)
        sent = 0

        def numbers() -> list[str]:
            return [text(p) for p, _ in edge.received(inbox, 0, 0) if text(p) != "probe"]

        def goes_on(count: int) -> None:
            nonlocal sent
            for _ in range(count):
                sent += 1
                peer.publish(out, {"data": str(sent)})
            until(lambda: len(numbers()) >= sent, "all messages arrive", SECONDS)
            assert numbers() == [str(n + 1) for n in range(sent)], "each message arrives once, in order"
            edge.ask("send", id=mirror, payload=string(f"back {sent}"))
            until(
                lambda: peer.wait(back, 1)[-1]["data"] == f"back {sent}",
                "the last message arrives in the other direction",
                SECONDS,
            )

        # the publisher also counts the probe's connection, which may be closed by now
        until(lambda: "/cmd" in edge.ask("connections")["in"], "the publisher is connected", SECONDS)
        # rospy publishes to a connection only some moments after it has sent the header
        until(lambda: peer.publish(out, {"data": "probe"}) or edge.received(inbox, 1, 0.2), "a probe arrives", SECONDS)
        goes_on(3)
        master.kill()
        until(lambda: "no ROS 1 master" in str(edge.ask("status")["warnings"]), "the loss is noticed", SECONDS)
        goes_on(3)
        assert edge.endpoints(topic="/cmd") == [endpoint]
        master.start()
        edge.joined(master.call("getParam", "/run_id"))
        goes_on(3)
        assert edge.endpoints(topic="/cmd") == [endpoint]
        peer.signal(signal.SIGKILL)
        until(lambda: not edge.endpoints(topic="/cmd", made_by="native"), "the publisher's exit is noticed", SECONDS)


def test_a_publisher_that_unregisters_leaves_at_once(master, tmp_path):
    """The publisher's connection ends, and nothing else proves its presence; the master keeps running."""
    with edge_on(master, tmp_path) as edge, master.peer("leaves") as peer:
        out = peer.advertise("/left", "std_msgs/String")
        edge.endpoint(topic="/left", made_by="native")
        edge.open("/left", "std_msgs/String")
        until(lambda: "/left" in edge.ask("connections")["in"], "the publisher is connected", SECONDS)
        begin = time.monotonic()
        peer.drop(out)
        until(lambda: not edge.endpoints(topic="/left"), "the publisher leaves the graph", SECONDS)
        assert time.monotonic() - begin < SECONDS / 2


def test_services_of_a_node_continue_without_a_master_and_with_another(master, tmp_path):
    with edge_on(master, tmp_path) as edge, master.peer("serves") as peer:
        peer.ask("serve", service="/serve", type="std_srvs/SetBool", reply={"success": True})
        endpoint = edge.endpoint(topic="/serve", made_by="native")
        caller = edge.ask("caller", service="/serve", type="std_srvs/SetBool")["id"]

        def answers(number: int) -> bool:
            edge.ask("begin", id=caller, request=base64.b64encode(b"\1").decode(), number=number)
            (answer,) = until(
                lambda: edge.ask("results", id=caller, count=0, seconds=0)["results"].get(str(number)),
                "the call ends",
                SECONDS,
            )
            return base64.b64decode(answer)[:1] == b"\1"

        assert answers(1)
        master.kill()
        until(lambda: "no ROS 1 master" in str(edge.ask("status")["warnings"]), "the loss is noticed", SECONDS)
        assert edge.endpoints(topic="/serve") == [endpoint]
        assert answers(2)
        master.start()
        edge.joined(master.call("getParam", "/run_id"))
        assert edge.endpoints(topic="/serve") == [endpoint]
        assert answers(3)
        peer.signal(signal.SIGKILL)
        until(lambda: not edge.endpoints(topic="/serve", made_by="native"), "the server's exit is noticed", SECONDS)
