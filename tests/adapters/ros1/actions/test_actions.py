"""Real actionlib servers offer actions on the hub, and have native clients, too."""

import signal
import struct

import pytest

from bridge.adapters.ros1.actions import states, wire
from bridge.adapters.ros1.actions.client import LOST
from bridge.adapters.ros1.actions.states import Ros1State
from bridge.adapters.ros1.actions.wire import ZERO
from bridge.messages.actions import CancelCode, GoalState
from tests.peers.ros1.adapter import edge_on
from tests.peers.ros1.hub_actions import PARTS, SECONDS, TYPES, HubClient, new_uuid, peer_on
from tests.peers.ros1.network import RosMaster, needs_ros1
from tests.support.wait import until

pytestmark = needs_ros1

MOVE_BASE = "move_base_msgs/action/MoveBase"


@pytest.fixture(scope="module")
def servers(master):
    """A program whose servers are named by each test."""
    with peer_on(master, "servers") as peer:
        yield peer


@pytest.fixture(scope="module")
def clients(master):
    """A program whose clients are named by each test."""
    with peer_on(master, "clients") as peer:
        yield peer


def test_an_actionlib_server_is_shown_as_a_ros_2_action(master, edge):
    with peer_on(master, "shown_server") as peer, peer_on(master, "shown_client") as client:
        peer.ask("server", name="/shown")
        client.ask("client", name="/shown")
        parts = {
            f"/shown/_action/{p}": ("server" if p in PARTS else "publisher", TYPES[p], p == "status") for p in TYPES
        }

        def shown() -> dict[str, tuple[str, str, bool]]:
            present = [e for e in edge.endpoints() if e["topic"].startswith("/shown/")]
            return {e["topic"]: (e["kind"], e["type"], e["latched"]) for e in present}

        # first as topics, which appear one by one, and then as an action once all topics exist
        until(lambda: shown() == parts, "the server is shown as an action", SECONDS)
    with peer_on(master, "alone_client") as client:
        client.ask("client", name="/alone")
        edge.endpoint(topic="/rosout", node="/alone_client", made_by="native")
        mine = lambda: [e for e in edge.endpoints() if e["topic"].startswith("/alone/")]  # noqa: E731
        until(lambda: not mine(), "a client's topics do not cross either", SECONDS)


def test_goals_end_in_the_state_that_the_server_reports(master, edge, servers):
    peer = servers
    server = peer.ask("server", name="/end")["id"]
    hub = HubClient(edge, "/end")
    ends = {10: GoalState.SUCCEEDED, 11: GoalState.ABORTED, 13: GoalState.CANCELED}
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
    call = hub.ask(goal)
    hub.until_state(goal, GoalState.EXECUTING)
    assert not hub.answered(call)
    seen = peer.ask("goals", id=server, count=5)["goals"]
    assert seen[-1] == [states.text_of(goal), 14]
    peer.ask("finish", id=server, goal=states.text_of(goal))
    assert hub.result(call) == (GoalState.SUCCEEDED, 14)
    assert hub.result(hub.ask(new_uuid()))[0] is GoalState.UNKNOWN
    hub.close()
    again = HubClient(edge, "/end")
    assert again.result(again.ask(goal)) == (GoalState.SUCCEEDED, 14), "results outlive their clients"
    again.close()
    until(lambda: "/end/goal" not in master.state()["publishers"], "the edge's topics are unregistered", SECONDS)


def test_the_hub_cancels_goals_of_a_ros1_server(master, edge, servers):
    peer = servers
    peer.ask("server", name="/cancel")
    hub = HubClient(edge, "/cancel")
    goals = []
    for number in (24, 34, 44):
        goal, sent = hub.send(number)
        assert hub.accepted(sent)
        goals.append(goal)
    requests = [hub.ask(g) for g in goals]
    assert hub.cancel(goals[0]) == (CancelCode.NONE, {goals[0]})
    assert hub.result(requests[0]) == (GoalState.CANCELED, 24)
    assert hub.cancel(goals[0])[0] is CancelCode.GOAL_TERMINATED
    assert hub.cancel(new_uuid())[0] is CancelCode.UNKNOWN_GOAL_ID
    assert not hub.answered(requests[1])
    assert hub.cancel() == (CancelCode.NONE, {goals[1], goals[2]})
    assert [hub.result(a)[0] for a in requests[1:]] == [GoalState.CANCELED] * 2
    stubborn, sent = hub.send(1_000_004)
    assert hub.accepted(sent)
    assert hub.cancel(stubborn) == (CancelCode.NONE, {stubborn}), (
        "the server's actionlib library accepts the request, whatever its callbacks do"
    )
    hub.until_state(stubborn, GoalState.CANCELING)
    hub.close()


def test_a_cancel_request_by_time_cancels_the_goals_accepted_until_then(master, edge, servers):
    peer = servers
    peer.ask("server", name="/before")
    hub = HubClient(edge, "/before")
    old, sent = hub.send(24)
    stamp = wire.RosTime(*struct.unpack("<II", hub.reply(sent)[1:]))
    assert stamp > ZERO
    new, sent = hub.send(34)
    assert hub.accepted(sent)
    hub.until_state(new, GoalState.EXECUTING)  # the server may list it as pending before
    assert hub.cancel(stamp=stamp) == (CancelCode.NONE, {old})
    hub.until_state(old, GoalState.CANCELED)
    assert hub.states()[new] is GoalState.EXECUTING
    later, sent = hub.send(44)
    assert hub.accepted(sent), "the edge's goals have stamp zero, so a cancel request by time does not match them"
    hub.until_state(later, GoalState.EXECUTING)
    hub.close()


def test_a_new_goal_preempts_the_old_one_of_a_simple_server(master, edge, servers):
    peer = servers
    server = peer.ask("server", name="/simple", simple=True)["id"]
    hub = HubClient(edge, "/simple")
    first, sent = hub.send(1)
    assert hub.accepted(sent)
    call = hub.ask(first)
    hub.until_state(first, GoalState.EXECUTING)
    second, sent = hub.send(2)
    assert hub.accepted(sent)
    assert hub.result(call)[0] is GoalState.CANCELED
    hub.until_state(second, GoalState.EXECUTING)
    peer.ask("finish", id=server)
    assert hub.result(hub.ask(second))[0] is GoalState.SUCCEEDED
    hub.close()


def test_goals_of_native_clients_are_listed_followed_and_canceled(master, edge, servers, clients):
    server, peer = servers, clients
    server.ask("server", name="/other")
    client = peer.ask("client", name="/other")["id"]
    assert peer.ask("wait_for_server", id=client)["there"]
    hub = HubClient(edge, "/other")
    hub.until_connected()  # a result that is published earlier is lost
    peer.ask("send", id=client, numbers=[54])
    (outcome,) = peer.ask("outcomes", id=client, numbers=[54], state="ACTIVE")["outcomes"]
    goal = states.uuid_of("/other", outcome["id"])
    hub.until_state(goal, GoalState.EXECUTING)
    call = hub.ask(goal)
    assert hub.cancel(goal) == (CancelCode.NONE, {goal})
    assert hub.result(call) == (GoalState.CANCELED, 54)
    (outcome,) = peer.ask("outcomes", id=client, numbers=[54])["outcomes"]
    assert (outcome["state"], outcome["done"]) == (Ros1State.PREEMPTED, 1)
    hub.close()


@pytest.mark.parametrize("how", ["killed", "restarted", "stopped"])
def test_goals_of_a_server_that_leaves_are_unknown(master, edge, how):
    """The server has not reported the goals' ends, so the bridge does not report them, either."""
    name = f"/{how}"
    with peer_on(master, f"{how}_server") as peer:
        server = peer.ask("server", name=name)["id"]
        hub = HubClient(edge, name)
        goal, sent = hub.send(14)
        assert hub.accepted(sent)
        call = hub.ask(goal)
        hub.until_state(goal, GoalState.EXECUTING)
        if how == "stopped":
            peer.ask("stop_server", id=server)
        else:
            peer.signal(signal.SIGKILL)
        if how == "restarted":
            with peer_on(master, f"{how}_server") as other:
                other.ask("server", name=name)
                assert LOST in hub.reply(call)

                def taken() -> bytes | None:
                    new, sent = hub.send(10)
                    return new if hub.accepted(sent) else None

                new = until(taken, "the new server accepts goals", SECONDS)
                assert hub.result(hub.ask(new)) == (GoalState.SUCCEEDED, 10)
                assert LOST in hub.reply(hub.ask(goal))
                until(lambda: goal not in hub.states(), "the new server does not list the old goal", SECONDS)
        else:
            assert LOST in hub.reply(call)
            assert hub.accepted(hub.send(10)[1]) is False
            assert hub.states()[goal] is GoalState.EXECUTING, "no other list is published"
        hub.close()


def test_an_action_that_is_opened_again_accepts_goals(edge, servers):
    """Earlier goals keep the caller alive. It accepts goals again as soon as a part is open."""
    servers.ask("server", name="/again")
    for number in range(10):
        hub = HubClient(edge, "/again")
        goal, sent = hub.send(10)
        assert hub.accepted(sent), f"{number}: {edge.output()[-3000:]}"
        assert hub.result(hub.ask(goal)) == (GoalState.SUCCEEDED, 10), f"{number}: {edge.output()[-3000:]}"
        hub.close()


def test_a_server_that_notices_the_end_of_its_connection_late_receives_goals(edge, servers):
    """While a callback keeps rospy from reading the end of a connection, it ignores the publisher's return."""
    server = servers.ask("server", name="/late")["id"]
    hub = HubClient(edge, "/late")
    servers.ask("stall", id=server)
    goal, sent = hub.send(10)
    assert hub.accepted(sent)
    assert hub.result(hub.ask(goal)) == (GoalState.SUCCEEDED, 10)
    before = servers.ask("attempts", topic="/late/goal")["count"]
    hub.close()
    again = HubClient(edge, "/late")
    until(lambda: servers.ask("attempts", topic="/late/goal")["count"] > before, "the publisher is ignored", SECONDS)
    servers.ask("resume", id=server)
    goal, sent = again.send(10)
    assert again.accepted(sent), edge.output()[-3000:]
    assert again.result(again.ask(goal)) == (GoalState.SUCCEEDED, 10)
    again.close()


def test_a_returning_server_is_discovered_by_its_connection(tmp_path):
    """Only the server's connection to the edge's topics reveals it, because the master is not polled."""
    with RosMaster() as master, edge_on(master, tmp_path) as edge:
        with peer_on(master, "returns") as peer:
            peer.ask("server", name="/returns")
            hub = HubClient(edge, "/returns")
            peer.signal(signal.SIGKILL)
        topic = "/returns/_action/send_goal"
        until(lambda: not edge.endpoints(topic=topic, made_by="native"), "the server's exit is noticed", SECONDS)
        known = {e["id"] for e in edge.endpoints(topic=topic)}  # the master still lists the killed server
        hub.close()
        edge.ask("set_period", every=3600.0)
        with peer_on(master, "returns") as peer:
            peer.ask("server", name="/returns")
            until(lambda: {e["id"] for e in edge.endpoints(topic=topic)} - known, "the server is discovered", SECONDS)
            edge.ask("set_period", every=0.1)  # a probe or connection that fails is repeated when the master is read
            again = HubClient(edge, "/returns")
            goal, sent = again.send(10)
            assert again.accepted(sent), edge.output()[-3000:]
            assert again.result(again.ask(goal)) == (GoalState.SUCCEEDED, 10)
            again.close()


def test_a_result_that_was_lost_has_the_state_of_the_list(master, edge, servers, clients):
    """The goal ended while no subscription of the edge was connected, and results are not latched."""
    peer, native = servers, clients
    # the server lists an ended goal for 5 s by default, in which the edge may not have read the list yet
    master.call("setParam", "/lost/status_list_timeout", 60.0)
    server = peer.ask("server", name="/lost")["id"]
    client = native.ask("client", name="/lost")["id"]
    assert native.ask("wait_for_server", id=client)["there"]
    until(lambda: edge.endpoints(topic="/lost/_action/get_result", made_by="native"), "the server is probed", SECONDS)
    until(lambda: not edge.ask("held", topic="/lost/result")["count"], "no probe would receive the result", SECONDS)
    goal = new_uuid()
    native.ask("raw_goal", id=client, number=14, goal=states.text_of(goal))
    peer.ask("goals", id=server)
    peer.ask("finish", id=server, goal=states.text_of(goal), outcome="abort")
    hub = HubClient(edge, "/lost")
    hub.until_state(goal, GoalState.ABORTED)
    assert hub.result(hub.ask(goal)) == (GoalState.ABORTED, 0)
    hub.close()


def move_base_goal(frame):
    """Return a MoveBaseGoal, which consists of a PoseStamped."""
    text = frame.encode()
    return struct.pack("<IIII", 0, 0, 0, len(text)) + text + struct.pack("<7d", 0, 0, 0, 0, 0, 0, 1)


def test_goals_in_unknown_frames_are_rejected(master, edge, servers):
    peer = servers
    with master.peer("frames_tf") as tf:
        server = peer.ask("server", name="/frames", type="move_base_msgs/MoveBase")["id"]
        static = tf.advertise("/robot/tf_static", "tf2_msgs/TFMessage", latched=True)
        tf.publish(static, {"transforms": [{"header": {"frame_id": "map"}, "child_frame_id": "/odom"}]})
        hub = HubClient(edge, "/frames", MOVE_BASE)

        def accepted(frame: str) -> bool:
            return hub.accepted(hub.begin("send_goal", new_uuid() + move_base_goal(frame)))

        # until a transform is received, all frames are unknown
        until(lambda: not accepted("mpa"), "the transforms are received")
        for frame, good in (("map", True), ("/map", True), ("odom", True), ("mpa", False), ("", False)):
            assert accepted(frame) is good, frame
        wanted = ["map", "map", "odom"]

        def seen() -> list[str]:
            goals = peer.ask("goals", id=server, count=3)["goals"]
            frames = [goal[1]["target_pose"]["header"]["frame_id"] for goal in goals]
            return [frame for frame in frames if frame != "mpa"]

        until(lambda: seen() == wanted, "the server has the valid goals")
        warnings = [w for w in edge.ask("status")["warnings"] if w.startswith("/frames")]
        assert "'mpa' of target_pose.header.frame_id" in warnings[0]
        assert hub.reply(hub.begin("send_goal", new_uuid() + b"short")).startswith("error: ")
        hub.close()


@pytest.mark.thorough
def test_hundreds_of_concurrent_goals_end_as_their_server_reports(master, edge, servers):
    """Some goals are rejected, some end at once, and all others are held until all have been accepted."""
    count = 400  # actionlib publishes the whole list for each change, so the time grows with the square
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
    remaining = [n for n in numbers if n not in refused]
    hub.number = 0
    for number in remaining:
        hub.ask(goals[number])
    peer.ask("finish_all", id=server)
    ended = [wire.read_result_response(reply) for reply in hub.replies("get_result", len(remaining))]
    wanted = [{0: 4, 1: 6, 3: 5}.get(n % 10) or (4, 6, 5)[n // 100 % 3] for n in remaining]
    assert [GoalState(state) for state, _, _ in ended] == [GoalState(w) for w in wanted]
    hub.close()


def test_goals_of_a_killed_worker_are_followed_by_the_next_one(tmp_path):
    with RosMaster() as master, peer_on(master, "kept_server") as peer:
        server = peer.ask("server", name="/kept")["id"]
        with edge_on(master, tmp_path) as first:
            hub = HubClient(first, "/kept")
            goal, sent = hub.send(14)
            assert hub.accepted(sent)
            first.signal(signal.SIGKILL)
        with edge_on(master, tmp_path) as second:
            hub = HubClient(second, "/kept")
            hub.until_state(goal, GoalState.EXECUTING)
            hub.until_connected()  # a result that is published earlier is lost
            call = hub.ask(goal)
            peer.ask("finish", id=server, goal=states.text_of(goal))
            assert hub.result(call) == (GoalState.SUCCEEDED, 14)
