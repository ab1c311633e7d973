"""Services between the ROS 1 edge and real rospy programs."""

from __future__ import annotations

import base64
import itertools
import signal
import socket
import struct
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

from tests.peers.ros1.adapter import AT_ONCE, edge_on
from tests.peers.ros1.network import RosMaster, needs_ros1
from tests.peers.ros1.servers import tcp_server, until_closed
from tests.support.process import Process
from tests.support.wait import until

pytestmark = needs_ros1

ROSOUT = "/usr/lib/rosout/rosout"
SET_BOOL = "std_srvs/SetBool"
SET_BOOL_MD5 = "09fb03525b03e7ea1fd3992bafd87e16"
ON = base64.b64encode(b"\1").decode()
SECONDS = 30.0


def reply(success: bool, message: str) -> str:
    """Return a std_srvs/SetBool response in the ROS 1 serialization, as base64."""
    return base64.b64encode(struct.pack("<BI", success, len(message.encode())) + message.encode()).decode()


def server_of(edge, name):
    """Wait until a server's type is known, and return its endpoint."""

    def known() -> Any:
        return next((e for e in edge.endpoints(kind="server", topic=name) if e["made_by"] != "unknown"), None)

    return until(known, f"the server of {name} is known", SECONDS)


def caller_of(edge, name, type_=SET_BOOL):
    server_of(edge, name)
    return edge.ask("caller", service=name, type=type_)["id"]


def call(edge, caller, number=0, request=ON):
    assert edge.ask("begin", id=caller, request=request, number=number)["seconds"] < AT_ONCE, (
        "beginning a call never blocks"
    )


def ends(edge, caller, count=1):
    return edge.ask("results", id=caller, count=count, seconds=SECONDS)["results"]


def requests_at(edge, served, count):
    def arrived() -> Any:
        result = edge.ask("calls", id=served)["requests"]
        return result if len(result) >= count else None

    return until(arrived, f"{count} calls have arrived", SECONDS)


def registered(master, name, node="/midspan"):
    until(lambda: master.state()["services"].get(name) == [node], f"{name} is registered", SECONDS)


def give_back(master, edge, served, name):
    edge.drop(served)
    until(lambda: "/midspan" not in master.state()["services"].get(name, []), f"{name} is unregistered", SECONDS)


# -- servers on ROS 1 --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def rosout(master):
    """A roscpp node with services: roscore's rosout, which also replaces the embedded master's rosout."""
    if not master.embedded:
        yield
        return
    with Process([ROSOUT, "__name:=rosout"], master.env):
        until(lambda: "/rosout/set_logger_level" in master.state()["services"], "rosout has registered", SECONDS)
        yield


@pytest.mark.usefixtures("rosout")
def test_servers_are_listed(master, edge):
    with master.peer("seen") as peer:
        service = peer.ask("serve", service="/seen/set", type=SET_BOOL)["id"]
        result = server_of(edge, "/seen/set")
        assert (result["type"], result["type_id"], result["node"]) == (SET_BOOL, SET_BOOL_MD5, "/seen")
        assert result["made_by"] == "native"
        assert server_of(edge, "/rosout/get_loggers")["type"] == "roscpp/GetLoggers"
        peer.drop(service)
        until(lambda: not edge.endpoints(topic="/seen/set"), "the service disappears with its server", SECONDS)


def test_each_call_gets_the_reply_or_the_error_of_the_rospy_server(master, edge):
    with master.peer("good") as peer:
        service = peer.ask("serve", service="/good/set", type=SET_BOOL, reply={"success": True, "message": "ön"})["id"]
        failing = {"service": "/good/fail", "type": SET_BOOL, "error": "no such motor"}
        peer.ask("serve", **failing)
        caller, failed = caller_of(edge, "/good/set"), caller_of(edge, "/good/fail")
        for number in range(20):
            call(edge, caller, number)
            assert ends(edge, caller, number + 1)[str(number)] == [reply(True, "ön")]
        assert peer.ask("requests", id=service, count=20)["requests"] == [{"data": True}] * 20
        for number in range(2):
            call(edge, failed, number)
            (end,) = ends(edge, failed, number + 1)[str(number)]
            assert end.startswith("error: ")
            assert "no such motor" in end


@pytest.mark.usefixtures("rosout")
def test_a_roscpp_server_responds_to_each_call(edge):
    # not its get_loggers: Debian 12's rosout crashes at the first such call, whichever client makes it
    caller = caller_of(edge, "/rosout/set_logger_level", "roscpp/SetLoggerLevel")
    request = b"".join(struct.pack("<I", len(name)) + name for name in (b"ros.rosout", b"info"))
    for number in range(3):
        call(edge, caller, number, base64.b64encode(request).decode())
        assert ends(edge, caller, number + 1)[str(number)] == [""]


def test_a_slow_call_does_not_delay_others(master, edge):
    with master.peer("slow") as peer:
        service = peer.ask("serve", service="/slow", type=SET_BOOL, held=True)["id"]
        quick = peer.ask("serve", service="/quick", type=SET_BOOL)["id"]
        caller, other = caller_of(edge, "/slow"), caller_of(edge, "/quick")
        for number in range(20):
            call(edge, caller, number)
        assert len(peer.ask("requests", id=service, count=20, seconds=SECONDS)["requests"]) == 20, (
            "all calls have reached the server"
        )
        call(edge, other)
        assert ends(edge, other) == {"0": [reply(False, "")]}
        assert peer.ask("requests", id=quick)["requests"] == [{"data": True}]
        assert ends(edge, caller, 0) == {}
        peer.ask("release", id=service)
        assert list(ends(edge, caller, 20).values()) == [[reply(False, "")]] * 20


def test_calls_fail_when_their_server_is_killed_and_reach_its_successor(master, edge):
    with master.peer("killed") as peer:
        service = peer.ask("serve", service="/killed", type=SET_BOOL, held=True)["id"]
        caller = caller_of(edge, "/killed")
        for number in range(5):
            call(edge, caller, number)
        peer.ask("requests", id=service, count=5, seconds=SECONDS)
        peer.signal(signal.SIGKILL)
        for end in ends(edge, caller, 5).values():
            assert end == ["error: the server /killed closed the connection before it answered"]
    until(lambda: edge.endpoints(topic="/killed", made_by="unknown"), "the dead server is listed as unknown", SECONDS)
    numbers = itertools.count(5)

    def refused() -> bool:
        number = next(numbers)
        call(edge, caller, number)
        return ends(edge, caller, number + 1)[str(number)] == ["error: /killed has no server on ROS 1 now"]

    until(refused, "the caller learns of it just after the graph shows it", SECONDS)
    with master.peer("killed") as peer:
        peer.ask("serve", service="/killed", type=SET_BOOL, reply={"message": "again"})
        server_of(edge, "/killed")

        def answered() -> bool:
            number = int(time.monotonic() * 1e6)
            call(edge, caller, number)
            until(lambda: str(number) in ends(edge, caller, 0), "the call has ended", SECONDS)
            return ends(edge, caller, 0)[str(number)] == [reply(False, "again")]

        until(answered, "the same caller reaches the new server", SECONDS)


def test_the_exit_of_a_server_is_noticed_without_calls(master, edge):
    with master.peer("mortal") as peer:
        peer.ask("serve", service="/mortal", type=SET_BOOL)
        caller_of(edge, "/mortal")
        peer.signal(signal.SIGKILL)
        until(lambda: edge.endpoints(topic="/mortal", made_by="unknown"), "the server is listed as unknown", SECONDS)
    reported = "/mortal: its server /mortal does not announce its type: cannot connect"
    until(lambda: any(w.startswith(reported) for w in edge.ask("status")["warnings"]), "a warning is reported", SECONDS)


def test_an_abandoned_call_delivers_no_result(master, edge):
    with master.peer("patient") as peer:
        service = peer.ask("serve", service="/patient", type=SET_BOOL, held=True)["id"]
        caller = caller_of(edge, "/patient")
        call(edge, caller)
        peer.ask("requests", id=service)
        edge.ask("abandon", id=caller)
        call(edge, caller, 1)
        peer.ask("requests", id=service, count=2)
        peer.ask("release", id=service)
        assert ends(edge, caller) == {"1": [reply(False, "")]}


# -- the edge's servers, and clients on ROS 1 --------------------------------------------------------------------------


def test_rospy_clients_receive_replies_and_errors(master, edge):
    served = edge.ask("serve", service="/ours/set", type=SET_BOOL)["id"]
    registered(master, "/ours/set")
    with master.peer("client") as peer:
        peer.ask("await_service", service="/ours/set", seconds=SECONDS)
        for number in range(6):
            call = peer.ask("call", service="/ours/set", type=SET_BOOL, request={"data": True}, persistent=number > 2)
            assert requests_at(edge, served, number + 1)[number] == ON
            if number % 3 == 1:
                edge.ask("answer", id=served, number=number, error="the hub refuses: nö")
                end = peer.ask("result", id=call["id"])
                assert end["reply"] is None
                assert "responded with an error: b'the hub refuses: n" in end["error"]
            else:
                edge.ask("answer", id=served, number=number, reply=reply(True, f"{number}"))
                end = peer.ask("result", id=call["id"])
                assert (end["reply"], end["error"]) == ({"success": True, "message": f"{number}"}, "")
        wrong = peer.ask("call", service="/ours/set", type="std_srvs/Empty")["id"]
        assert (
            "md5 sums differ: /client requests d41d8cd98f00b204e9800998ecf8427e"
            in peer.ask("result", id=wrong)["error"]
        )
    give_back(master, edge, served, "/ours/set")


def test_rosservice_describes_and_calls_a_service_of_the_hub(master, edge):
    served = edge.ask("serve", service="/tool/set", type=SET_BOOL)["id"]
    registered(master, "/tool/set")

    def tool(*args: str) -> subprocess.Popen[str]:
        command = ["/usr/bin/rosservice", *args]
        if not Path(command[0]).exists():
            command = ["/usr/bin/python3", "-c", "import rosservice; rosservice.rosservicemain()", *args]
        return subprocess.Popen(command, env=master.env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    with tool("info", "/tool/set") as info, tool("call", "/tool/set", "data: true") as request:
        requests_at(edge, served, 1)
        edge.ask("answer", id=served, reply=reply(True, "from the hub"))
        assert "Node: /midspan" in (reported := info.communicate(timeout=SECONDS)[0]), reported
        assert f"Type: {SET_BOOL}" in reported
        assert 'message: "from the hub"' in (reported := request.communicate(timeout=SECONDS)[0]), reported
    give_back(master, edge, served, "/tool/set")


def test_many_clients_with_calls_of_any_length_get_their_replies(master, edge):
    served = edge.ask("serve", service="/many", type=SET_BOOL)["id"]
    registered(master, "/many")
    with master.peer("many_a") as first, master.peer("many_b") as second:
        requests = [
            (peer, peer.ask("call", service="/many", type=SET_BOOL)["id"])
            for _ in range(25)
            for peer in (first, second)
        ]
        requests_at(edge, served, 50)
        edge.ask("answer", id=served, number=49, reply=reply(True, ""))
        done = until(
            lambda: [i for p, i in requests if p.ask("result", id=i, seconds=0)["done"]], "one call has ended", SECONDS
        )
        assert len(done) == 1
        for number in range(49):
            edge.ask("answer", id=served, number=number, reply=reply(True, ""))
        assert all(p.ask("result", id=i, seconds=SECONDS)["reply"]["success"] for p, i in requests)
    give_back(master, edge, served, "/many")


@pytest.mark.thorough
def test_the_calls_of_a_killed_client_are_abandoned(master, edge):
    served = edge.ask("serve", service="/left", type=SET_BOOL)["id"]
    registered(master, "/left")
    with master.peer("leaver") as peer:
        for number in range(4):
            peer.ask("call", service="/left", type=SET_BOOL, persistent=number == 3)
        requests_at(edge, served, 4)
        peer.signal(signal.SIGKILL)
        until(
            lambda: edge.ask("calls", id=served)["abandoned"] == [0, 1, 2, 3],
            "the killed client's calls are abandoned",
            SECONDS,
        )
    for number in range(4):
        edge.ask("answer", id=served, number=number, reply=reply(True, "late"))
    with master.peer("next") as peer:
        call = peer.ask("call", service="/left", type=SET_BOOL)["id"]
        requests_at(edge, served, 5)
        edge.ask("answer", id=served, number=4, reply=reply(True, "in time"))
        assert peer.ask("result", id=call)["reply"]["message"] == "in time"
    give_back(master, edge, served, "/left")


# -- the master --------------------------------------------------------------------------------------------------------


def test_a_native_server_keeps_its_name(master, edge):
    with master.peer("owner") as peer:
        native = peer.ask("serve", service="/owned", type=SET_BOOL)["id"]
        server_of(edge, "/owned")
        served = edge.ask("serve", service="/owned", type=SET_BOOL)["id"]
        warning = "/owned: /owner serves it on ROS 1 itself, so the hub's service is not offered there"
        until(lambda: warning in edge.ask("status")["warnings"], "a warning is reported", SECONDS)
        peer.drop(native)
        registered(master, "/owned")
        peer.ask("serve", service="/owned", type=SET_BOOL)
        registered(master, "/owned", "/owner")
        until(lambda: warning in edge.ask("status")["warnings"], "a warning is reported", SECONDS)
        peer.signal(signal.SIGKILL)
    registered(master, "/owned")
    give_back(master, edge, served, "/owned")


def test_servers_of_another_midspan_are_marked(master, edge, tmp_path):
    served = edge.ask("serve", service="/marked", type=SET_BOOL)["id"]
    registered(master, "/marked")
    with edge_on(master, tmp_path, "other") as other:
        assert server_of(other, "/marked")["made_by"] == "midspan"
        caller = other.ask("caller", service="/marked", type=SET_BOOL)["id"]
        call(other, caller)
        assert ends(other, caller) == {"0": ["error: /marked has no server on ROS 1 now"]}
    assert edge.endpoints(topic="/marked") == [], "the edge's own servers are not listed"
    give_back(master, edge, served, "/marked")


@pytest.mark.thorough
def test_services_are_registered_again_with_a_restarted_master(tmp_path):
    with RosMaster() as master, edge_on(master, tmp_path) as edge:
        served = edge.ask("serve", service="/again", type=SET_BOOL)["id"]
        registered(master, "/again")
        master.stop()
        until(lambda: edge.ask("network")["network"] is None, "the loss is noticed", SECONDS)
        master.start()
        registered(master, "/again")
        with master.peer("after") as peer:
            call = peer.ask("call", service="/again", type=SET_BOOL)["id"]
            requests_at(edge, served, 1)
            edge.ask("answer", id=served, reply=reply(True, "after"))
            assert peer.ask("result", id=call)["reply"]["message"] == "after"


def test_a_clean_stop_ends_calls_and_leaves_nothing(master, tmp_path):
    with master.peer("stays") as peer:
        peer.ask("serve", service="/stays", type=SET_BOOL, held=True)
        before = master.state()
        with edge_on(master, tmp_path, "stopping", node="stopping") as edge:
            served = edge.ask("serve", service="/stopped", type=SET_BOOL)["id"]
            registered(master, "/stopped", "/stopping")
            request = peer.ask("call", service="/stopped", type=SET_BOOL)["id"]
            requests_at(edge, served, 1)
            caller = caller_of(edge, "/stays")
            call(edge, caller)
            assert edge.leave() < AT_ONCE, "Edge.stop returns within twice its limit"
            assert "/stopped is no longer served" in peer.ask("result", id=request)["error"]
            assert edge.ask("calls", id=served)["abandoned"] == [0]
            assert ends(edge, caller) == {"0": ["error: /stays is no longer bridged"]}
            assert master.state() == before
            until(lambda: edge.ask("status")["threads"] < 10, "the threads end", SECONDS)


def test_services_of_a_killed_edge_are_removed(master, tmp_path):
    before = master.state()
    edge = edge_on(master, tmp_path, "mine", node="mine_a")
    edge.ask("serve", service="/left/behind", type=SET_BOOL)
    registered(master, "/left/behind", "/mine_a")
    edge.signal(signal.SIGKILL)
    edge.stop()
    assert "/left/behind" in master.state()["services"], "the master does not notice"
    with edge_on(master, tmp_path, "mine", node="mine_b") as again:
        assert "/left/behind" not in master.state()["services"]
        again.leave()
    assert master.state() == before


def test_servers_that_misbehave_are_reported_and_delay_no_others(master, edge):
    def silent(sock) -> None:
        until_closed(sock)

    with tcp_server(silent) as (host, port), socket.socket() as deaf:
        deaf.bind(("127.0.0.1", 0))  # the port is reserved, but nothing listens on it
        dead = deaf.getsockname()[1]
        for name, address in (("/odd/silent", f"rosrpc://{host}:{port}"), ("/odd/dead", f"rosrpc://127.0.0.1:{dead}")):
            master.call("registerService", name, address, "http://127.0.0.1:1/")
        with master.peer("beside") as peer:
            peer.ask("serve", service="/beside", type=SET_BOOL)
            server_of(edge, "/beside")

            def reported() -> set[str]:
                return {w.split(":")[0] for w in edge.ask("status")["warnings"]}

            until(lambda: {"/odd/silent", "/odd/dead"} <= reported(), "the problems are reported", SECONDS)
            assert {e["made_by"] for e in edge.endpoints(node="/test")} == {"unknown"}
        for name, address in (("/odd/silent", f"rosrpc://{host}:{port}"), ("/odd/dead", f"rosrpc://127.0.0.1:{dead}")):
            master.call("unregisterService", name, address)
