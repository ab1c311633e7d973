"""zenoh's threads: incoming messages never block calls on other threads."""

from __future__ import annotations

import subprocess
import sys

from tests.peers.hub.network import HubNetwork

PROGRAM = """
import sys, threading, time
from concurrent.futures import ThreadPoolExecutor
from bridge.hub.wire.qos import Durability, Qos
from bridge.hub.node import Hub
from bridge.hub.session import HubSettings

endpoint, HASH = sys.argv[1], "RIHS01_" + "ab" * 32
LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL)
one, two = (Hub.open(HubSettings(router=endpoint, node=name)) for name in ("one", "two"))
with one, two:
    busy, done = threading.Event(), threading.Event()

    def on_sample(sample):
        busy.set()
        sum(range(20_000))  # long enough for another thread to get the GIL

    subscription = one.subscription("/flood", "std_msgs/msg/Empty", HASH, Qos(), on_sample)
    publisher = two.publisher("/flood", "std_msgs/msg/Empty", HASH, Qos())
    known = [two.publisher("/map", "std_msgs/msg/Empty", HASH, LATCHED) for _ in range(5)]

    def flood():
        while not done.is_set():
            publisher.put(b"x")
            time.sleep(0.0002)

    def join():  # zenoh reports the known publishers on another of its threads
        while not done.is_set():
            one.subscription("/map", "std_msgs/msg/Empty", HASH, LATCHED, on_sample).close()
            time.sleep(0.002)

    pool = ThreadPoolExecutor(2)
    load = [pool.submit(work) for work in (flood, join)]
    assert busy.wait(20)
    worst = 0.0
    for number in range(200):
        latched = one.publisher(f"/map{number}", "std_msgs/msg/Empty", HASH, LATCHED)
        latched.put(b"y")
        begun = time.monotonic()
        latched.close()
        worst = max(worst, time.monotonic() - begun)
    done.set()
    for work in load:
        work.result()
print(worst)
"""


def test_latched_publishers_close_at_once_while_messages_come(network: HubNetwork) -> None:
    endpoint = str(network.settings("flood").router)
    ran = subprocess.run(
        [sys.executable, "-c", PROGRAM, endpoint], capture_output=True, text=True, timeout=100, check=True
    )
    assert float(ran.stdout) < 5.0  # zenoh would stop waiting only after 10 s
