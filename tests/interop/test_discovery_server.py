"""A real Fast DDS discovery server (``ROS_DISCOVERY_SERVER``), real ROS programs on both sides, and the real daemon."""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Callable, Iterator

import pytest

from tests.peers.daemon.deployment import Deployment
from tests.peers.peer import Peer
from tests.peers.ros2.network import SERVER, ros2_environment
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.wait import until

KIND = "std_msgs/String"


Server = Callable[[], Process]


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    """Return a function that starts a discovery server at the address that all programs of the test use."""
    port = free_port()
    monkeypatch.setenv("ROS_DISCOVERY_SERVER", f"127.0.0.1:{port}")
    command = [str(SERVER), "-i", "0", "-l", "127.0.0.1", "-p", str(port)]
    with contextlib.ExitStack() as stack:
        yield lambda: stack.enter_context(Process(command, ros2_environment()))


def test_programs_of_a_discovery_server_are_bridged(deployment: Deployment, server: Server) -> None:
    """This includes programs that start later, and programs that were bridged before the worker was killed."""
    server()
    deployment.start()
    ros1, ros2 = deployment.ros1(), deployment.ros2()
    ends = {
        ros2: (ros2.advertise("/to_ros1", KIND), ros1, ros1.subscribe("/to_ros1", KIND)),
        ros1: (ros1.advertise("/to_ros2", KIND), ros2, ros2.subscribe("/to_ros2", KIND)),
    }

    def crosses(word: str) -> None:
        def received() -> bool:
            for source, (publisher, _, _) in ends.items():
                source.publish(publisher, {"data": word})
            return all({"data": word} in sink.wait(number, 1, 0.2) for _, sink, number in ends.values())

        until(received, f"messages cross {word}", 40)

    crosses("at first")
    pid = deployment.answer("ros2")["pid"]
    os.kill(pid, signal.SIGKILL)
    until(lambda: deployment.worker("ros2").get("pid") not in (None, pid), "another worker runs", 40, every=0.1)
    crosses("after the kill")
    late = deployment.ros2("late")
    published, received = late.advertise("/late", KIND), ros1.subscribe("/late", KIND)

    def received_later() -> bool:
        late.publish(published, {"data": "late"})
        return bool(ros1.wait(received, 1, 0.2))

    until(received_later, "a program that starts later is bridged", 40)


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM])
def test_programs_are_bridged_after_a_restart_of_the_server(
    deployment: Deployment, server: Server, end: signal.Signals
) -> None:
    """Topics and services cross to and from programs that are older than the new server, and that start later."""
    first = server()
    deployment.start()
    ros1, older = deployment.ros1(), deployment.ros2("older")
    out, received = older.advertise("/from_older", KIND), ros1.subscribe("/from_older", KIND)

    def crosses(source: Peer, publisher: int, sink: Peer, subscription: int, word: str) -> None:
        def arrived() -> bool:
            source.publish(publisher, {"data": word})
            return {"data": word} in sink.wait(subscription, 1, 0.2)

        until(arrived, f"messages cross: {word}", 40)

    crosses(older, out, ros1, received, "before")
    pid = deployment.answer("ros2")["pid"]
    first.signal(end)
    first.popen.wait()
    server()
    crosses(older, out, ros1, received, "of an older program")
    later = deployment.ros2("later")
    crosses(
        later, later.advertise("/from_later", KIND), ros1, ros1.subscribe("/from_later", KIND), "of a later program"
    )
    back = ros1.advertise("/to_ros2", KIND)
    for program in (older, later):
        crosses(ros1, back, program, program.subscribe("/to_ros2", KIND), f"to {program}")
    later.ask("serve", service="/lamp", type="std_srvs/SetBool", reply={"success": True, "message": "lit"})
    deployment.until_route("ros1", "/lamp", "out", state="active")
    ros1.ask("await_service", service="/lamp", seconds=20)
    call = ros1.ask("call", service="/lamp", type="std_srvs/SetBool", request={"data": True})["id"]
    assert ros1.ask("result", id=call, seconds=20)["reply"]["message"] == "lit"
    assert deployment.answer("ros2")["pid"] == pid
