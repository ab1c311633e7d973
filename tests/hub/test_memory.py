"""Shared memory, and what a session leaves behind when it ends."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from bridge.hub.node import Hub
from bridge.hub.wire.qos import Qos
from tests.peers.hub.endpoints import LATCHED, STREAM, Subscriber, advertise, matched, see_each_other
from tests.peers.hub.network import ROOT, HubNetwork
from tests.support.wait import until

pytestmark = pytest.mark.thorough

PROGRAM = """
import sys
from bridge.hub.node import Hub
from bridge.hub.session import HubSettings
from bridge.hub.wire.qos import Qos
hub = Hub.open(HubSettings(router=sys.argv[1], node="leaves"))
hub.subscription("/x", "a/msg/B", "*", Qos(), print)
hub.serve("verb", lambda params: 1)
"""


@pytest.mark.parametrize(("first", "second"), [(True, True), (True, False), (False, False)])
def test_large_messages_arrive_with_and_without_shared_memory(first: bool, second: bool):
    with (
        HubNetwork() as network,
        Hub.open(network.settings("a", shared_memory=first)) as a,
        Hub.open(network.settings("b", shared_memory=second)) as b,
    ):
        see_each_other(a, b)
        subscriber = Subscriber(b, "/image", STREAM)
        publisher = advertise(a, "/image", STREAM)
        matched(publisher)
        # the subscriber keeps the messages, which together exceed the pool's size, so the last ones use the network
        for number in range(10):
            payload = bytes([number]) * 6_000_000
            seen = len(subscriber.samples)
            arrived = lambda: any(s.data() == payload for s in subscriber.samples[seen:])  # noqa: B023, E731
            until(lambda: publisher.put(payload) or arrived(), "a message arrives", every=0.2)  # noqa: B023
        assert {sample.data() for sample in subscriber.samples} == {bytes([n]) * 6_000_000 for n in range(10)}


def segments(pid: int) -> set[Path]:
    """Return the files of shared memory that a process has mapped."""
    lines = Path(f"/proc/{pid}/maps").read_text(encoding="utf-8").splitlines()
    return {Path(line.split()[-1]) for line in lines if "/dev/shm/" in line}


def send_big(network: HubNetwork, number: signal.Signals) -> set[Path]:
    """Send a large message from one process to another, end the sender with a signal, and return its segments."""
    with network.hub_peer("listener") as listener, network.hub_peer("sender") as sender:
        subscription_id = listener.ask("subscription", topic="/image")["id"]
        publisher = sender.ask("publisher", topic="/image", latched=False)["id"]

        def arrived() -> bool:
            sender.ask("put", id=publisher, text="x" * 1_000_000)
            return bool(listener.ask("wait", id=subscription_id, count=1, seconds=0.2)["texts"])

        until(arrived, "a message arrives")
        used = segments(sender.pid)
        assert 1 << 20 < max(segment.stat().st_size for segment in used) <= 16 << 20
        sender.signal(number)
        sender.popen.wait(40)
    return used


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks into /proc and /dev/shm")
def test_no_pool_is_left_of_a_killed_session():
    """The next process that uses zenoh's shared memory removes what a killed process left."""
    with HubNetwork() as network:
        killed = send_big(network, signal.SIGKILL)
        send_big(network, signal.SIGKILL)
        assert [segment for segment in killed if segment.exists()] == []


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks into /proc and /dev/shm")
def test_a_small_map_takes_neither_a_pool_nor_book_keeping():
    """Zenoh would lock the whole pool into the memory of both processes, and its metadata takes 11 MB of each."""
    with HubNetwork() as network, network.hub_peer("listener") as listener, network.hub_peer("sender") as sender:
        subscription_id = listener.ask("subscription", topic="/map")["id"]
        publisher = sender.ask("publisher", topic="/map", latched=False)["id"]

        def arrived() -> bool:
            sender.ask("put", id=publisher, text="x" * 60_000)
            return bool(listener.ask("wait", id=subscription_id, count=1, seconds=0.2)["texts"])

        until(arrived, "a message arrives")
        assert max((segment.stat().st_size for segment in segments(sender.pid)), default=0) < 1 << 20


def test_program_that_does_not_close_its_session_exits():
    """Without a cleanup at exit, zenoh's threads would keep the interpreter running forever."""
    with HubNetwork() as network:
        env = {"PYTHONPATH": str(ROOT), "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}
        command = [sys.executable, "-c", PROGRAM, network.endpoint]
        ended = subprocess.run(command, env=env, capture_output=True, text=True, timeout=100)
    assert ended.returncode == 0, ended.stderr


@pytest.mark.parametrize("qos", [STREAM, LATCHED])
def test_subscription_forgets_closed_publishers(qos: Qos):
    with HubNetwork() as network, Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        see_each_other(a, b)
        subscriber = Subscriber(b, "/busy", qos)
        stays = advertise(a, "/busy", qos)
        matched(stays)
        for number in range(400):
            publisher = advertise(a, "/busy", qos, str(number))
            until(lambda n=number: len(subscriber.samples) > n, "a message arrives")
            publisher.close()
        assert len(subscriber.subscription.sources) < 200
        stays.put(b"still")
        until(lambda: subscriber.texts()[-1] == "still", "the remaining publisher is received")
        assert subscriber.subscription.lost == 0
