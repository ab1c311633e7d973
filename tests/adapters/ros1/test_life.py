"""The edge joins, loses and leaves a master, with dead predecessors and with other Midspan daemons."""

import contextlib
import signal
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.peers.ros1.adapter import AT_ONCE, EdgeUnderTest, edge_on, text
from tests.peers.ros1.network import RosMaster, needs_ros1
from tests.support.wait import until

pytestmark = needs_ros1


def presence(master):
    entries = master.call("getParam", "/midspan/nodes") or {}
    return {entry["node"].strip("/"): entry for entry in entries.values()}


def test_the_network_is_identified_by_the_run_id(master, tmp_path):
    with edge_on(master, tmp_path) as edge:
        answer = edge.ask("network")
        assert answer["network"] == master.call("getParam", "/run_id")
        assert answer["own"]
        assert not answer["ros2"]
        entry = presence(master)["midspan"]
        assert (entry["daemon"], entry["node"], entry["pid"]) == ("robot", "/midspan", edge.pid)
        assert "/rosout" not in [t for t, nodes in master.state()["publishers"].items() if "/midspan" in nodes]


@pytest.mark.parametrize("clock", ["system", "sim"])
def test_a_clean_stop_leaves_nothing(master, tmp_path, clock):
    with master.peer("clean") as peer:
        peer.advertise("/clean/in", "std_msgs/String")
        before = (master.state(), master.call("getParam", "/"))
        with edge_on(master, tmp_path, clock=clock) as edge:
            edge.endpoint(topic="/clean/in", made_by="native")
            for n in range(20):
                edge.open("/clean/in", "std_msgs/String")
                edge.ask("advertise", topic=f"/clean/out{n}", type="std_msgs/String", latched=True)
            until(lambda: "/clean/out19" in master.state()["publishers"], "all topics are registered")
            assert (master.state(), master.call("getParam", "/")) != before
            assert edge.leave() < AT_ONCE, "Edge.stop returns within twice its limit"
            assert (master.state(), master.call("getParam", "/")) == before
            assert edge.ask("network")["network"] is None
            edge.ask("stop")


@pytest.mark.thorough
def test_registrations_of_a_killed_edge_are_removed(master, tmp_path):
    with master.peer("bystander") as peer:
        peer.advertise("/bystander", "std_msgs/String")
        before = (master.state(), master.parameters())
        edge = edge_on(master, tmp_path, node="first_name")
        edge.open("/bystander", "std_msgs/String")
        edge.ask("advertise", topic="/left", type="std_msgs/String")
        until(lambda: "/left" in master.state()["publishers"], "the publisher is registered")
        until(
            lambda: "/first_name" in master.state()["subscribers"].get("/bystander", []),
            "both endpoints are registered",
        )
        edge.signal(signal.SIGKILL)
        edge.stop()
        assert "/left" in master.state()["publishers"], "the master does not notice"
        other = edge_on(master, tmp_path / "not_mine", "another", node="third_name")
        with other:
            assert "/left" in master.state()["publishers"], "another daemon's leftovers stay"
            assert "first_name" in presence(master)
            until(lambda: not other.ask("status")["others"], "the dead edge does not count as present")
        with edge_on(master, tmp_path, node="second_name") as again:
            assert "/left" not in master.state()["publishers"]
            assert "/first_name" not in master.nodes()
            until(lambda: "second_name" in presence(master), "the new edge's entry exists")
            assert "first_name" not in presence(master)
            again.leave()
        assert (master.state(), master.parameters()) == before


def test_a_restarted_worker_takes_over_the_name_of_the_killed_one(master, tmp_path):
    edge = edge_on(master, tmp_path)
    edge.ask("advertise", topic="/same", type="std_msgs/String")
    until(lambda: "/same" in master.state()["publishers"], "the publisher is registered")
    edge.signal(signal.SIGKILL)
    edge.stop()
    with edge_on(master, tmp_path) as again:
        until(lambda: presence(master).get("midspan", {}).get("pid") == again.pid, "the entry belongs to the new edge")
        assert "/same" not in master.state()["publishers"]


def test_two_daemons_discover_each_other(master, tmp_path):
    with edge_on(master, tmp_path / "a", "first") as first, edge_on(master, tmp_path / "b", "se-cond") as second:
        # a killed edge of another test, which the master still lists, counts as present until it refuses a connection
        others = lambda edge: [(o["daemon"], o["node"]) for o in edge.ask("status")["others"]]  # noqa: E731
        until(lambda: others(first) == [("se-cond", "/midspan_se_cond")], "the first edge discovers the second")
        until(lambda: others(second) == [("first", "/midspan")], "the second edge discovers the first")
        assert not first.ask("status")["failures"], "the master did not shut down the first edge because of its name"
        second.ask("advertise", topic="/of/second", type="std_msgs/String")
        until(
            lambda: master.state()["publishers"].get("/of/second") == ["/midspan_se_cond"],
            "the second edge has another name",
        )
        second.signal(signal.SIGKILL)
        until(lambda: not first.ask("status")["others"], "a dead edge is not listed")


def test_records_of_one_edge_reach_the_others(tmp_path):
    with (
        RosMaster() as master,  # the others' lists killed edges, which are counted until they refuse a connection
        edge_on(master, tmp_path / "a", "first") as first,
        edge_on(master, tmp_path / "b", "second") as second,
    ):
        second.ask("announce", record="before it came")
        third = edge_on(master, tmp_path / "c", "third")
        with third:
            until(lambda: third.ask("sightings")["settled"], "the third edge has read the master with its own entry")
            # earlier edges are known by then, and their records arrive over connections that are being opened
            assert len(third.ask("sightings")["records"]) == 2
            until(lambda: "before it came" in third.ask("sightings")["records"], "the last record arrives")
            third.ask("announce", record="from the third")
            until(lambda: "from the third" in first.ask("sightings")["records"], "the first edge receives the record")
            first.signal(signal.SIGSTOP)
            for number in range(3):
                second.ask("announce", record=f"record {number}")
            until(lambda: "record 2" in third.ask("sightings")["records"], "a suspended edge does not delay others")
            first.signal(signal.SIGCONT)
            until(
                lambda: "record 2" in first.ask("sightings")["records"],
                "the suspended edge receives the newest record when it resumes",
            )
            third.signal(signal.SIGKILL)
            until(lambda: len(first.ask("sightings")["records"]) == 1, "a crash is noticed by the broken connection")


@pytest.mark.thorough
def test_two_edges_that_start_at_once_take_different_names(master, tmp_path):
    with ThreadPoolExecutor() as pool:
        edges = list(pool.map(lambda n: edge_on(master, tmp_path / n, n), ("one", "two", "three")))
    with contextlib.ExitStack() as stack:
        for edge in edges:
            stack.enter_context(edge)
        for edge in edges:
            until(lambda edge=edge: len(edge.ask("status")["others"]) == 2, "each edge has discovered both others")
            assert not edge.ask("status")["failures"]
        entries = (master.call("getParam", "/midspan/nodes") or {}).values()
        assert len({e["node"] for e in entries if e["daemon"] in ("one", "two", "three")}) == 3


def test_a_shutdown_request_ends_the_edge_with_a_failure(master, tmp_path):
    with edge_on(master, tmp_path) as edge:
        edge.ask("advertise", topic="/asked", type="std_msgs/String")
        until(lambda: "/asked" in master.state()["publishers"], "the publisher is registered")
        with master.peer("midspan") as peer:  # the master shuts down the older node of a name
            reason = until(lambda: edge.ask("status")["failures"], "the edge reports the shutdown request")
            edge.ask("advertise", topic="/asked/too", type="std_msgs/String")
            out = peer.advertise("/asked/peer", "std_msgs/String")
            until(lambda: "/asked/peer" in master.state()["publishers"], "the other node is alive")
            peer.publish(out, {"data": "alive"})
            assert not {"/asked", "/asked/too"} & set(master.state()["publishers"]), (
                "the two do not compete for the name"
            )
        assert "same name" in reason[0] or "took the name" in reason[0]


@pytest.mark.thorough
def test_a_master_that_starts_later_is_joined(tmp_path):
    master = RosMaster()
    try:
        with EdgeUnderTest(master.uri, tmp_path) as edge:
            assert edge.ask("start")["seconds"] < AT_ONCE, "start returns at once"
            publisher = edge.ask("advertise", topic="/early", type="std_msgs/String", latched=True)["id"]
            edge.send(publisher, "early")
            until(lambda: edge.ask("status")["warnings"], "the missing master is reported")
            assert "no ROS 1 master" in edge.ask("status")["warnings"][0]
            assert edge.ask("network")["network"] is None
            master.start()
            edge.joined(master.call("getParam", "/run_id"))
            with master.peer("late") as peer:
                assert [m["data"] for m in peer.wait(peer.subscribe("/early", "std_msgs/String"), 1)] == ["early"]
    finally:
        master.close()


def test_a_restarted_master_is_joined_again(tmp_path, record_property):
    with RosMaster(command=True) as master, edge_on(master, tmp_path) as edge:
        publisher = edge.ask("advertise", topic="/out", type="std_msgs/String", latched=True)["id"]
        edge.send(publisher, "kept")
        inbox = edge.open("/in", "std_msgs/String")
        first = edge.joined()
        master.stop()
        until(lambda: edge.ask("network")["network"] is None, "the loss is noticed")
        assert edge.endpoints() == []
        assert not edge.ask("network")["own"]
        master.start()
        begin = time.monotonic()
        second = edge.joined(master.call("getParam", "/run_id"))
        until(lambda: "/midspan" in master.state()["publishers"].get("/out", []), "the publisher is registered again")
        until(
            lambda: "/midspan" in master.state()["subscribers"].get("/in", []), "the subscription is registered again"
        )
        until(lambda: "midspan" in presence(master), "the presence is registered again")
        record_property("seconds_to_rejoin", time.monotonic() - begin)
        assert first != second
        with master.peer("after") as peer:
            assert [m["data"] for m in peer.wait(peer.subscribe("/out", "std_msgs/String"), 1)] == ["kept"]
            out = peer.advertise("/in", "std_msgs/String", latched=True)
            peer.publish(out, {"data": "after"})
            assert [text(p) for p, _ in edge.received(inbox, 1)] == ["after"]


def test_the_edge_stops_quickly_while_the_master_is_unreachable(tmp_path):
    with RosMaster() as master, edge_on(master, tmp_path) as edge:
        edge.ask("advertise", topic="/out", type="std_msgs/String")
        master.signal(signal.SIGSTOP)
        try:
            assert edge.ask("stop")["seconds"] < AT_ONCE, "Edge.stop returns within twice its limit"
        finally:
            master.signal(signal.SIGCONT)
