"""The clock on which a module's timers run: the system's clock, or the clock of a simulation on the hub."""

from __future__ import annotations

import threading
import time
from typing import Any, ClassVar

import pytest

from bridge.clock import RunClock
from bridge.modules.host import Host
from bridge.modules.module import Module
from tests.modules.test_worker import Place, place  # noqa: F401 - a fixture
from tests.support.wait import until

CLOCK = "rosgraph_msgs/Clock"


class Ticking(Module):
    """A module that counts the seconds of its clock."""

    name = "ticking"
    seen: ClassVar[list[str]] = []
    host: ClassVar[Host]

    def start(self, host: Host, section: Any) -> None:  # noqa: ARG002
        type(self).host = host
        self.seen.clear()
        host.every(1.0, lambda: self.seen.append(str(host.clock.now_ns() // 1_000_000_000)))
        host.on_jump(lambda: self.seen.append("back"))


def config(place: Place, source: str) -> Any:  # noqa: F811
    module = {"name": "ticking", "factory": "tests.modules.test_clock:Ticking"}
    return place.config(module, clock={"source": source})


def test_timers_and_stamps_follow_the_simulation(place: Place) -> None:  # noqa: F811
    place.worker.start(config(place, "sim"))
    out = place.far.advertise("/clock", CLOCK)
    done = place.far.subscribe("/sim/acknowledge", "std_msgs/Header")

    def publish_clock(seconds: float) -> None:
        sec, nanosec = divmod(round(seconds * 1e9), 1_000_000_000)
        place.far.publish(out, {"clock": {"sec": sec, "nanosec": nanosec}})

    until(
        lambda: (publish_clock(10.5), place.worker.health(), Ticking.host.clock.now_ns() > 0)[2],
        "the clock is received",
    )
    for second in (11, 12, 13):
        for tenth in range(6, 16):
            publish_clock(second - 1 + tenth / 10)
        until(lambda s=second: Ticking.seen[-1:] == [str(s)], "the module has counted a second")
    assert Ticking.seen == ["11", "12", "13"]
    until(lambda: place.far.wait(done, 1)[-1]["stamp"]["sec"] == 13, "the module has acknowledged the time")
    assert place.far.wait(done, 1)[-1]["frame_id"] == "ticking"
    # with a simulation's clock, jobs run on the module's thread, so that the simulation waits for slow jobs
    jobs: list[threading.Thread] = []
    host = Ticking.host
    host.loop.call(lambda: host.background.submit(lambda: threading.current_thread, jobs.append))
    assert jobs == [host.loop.call(threading.current_thread)]
    publish_clock(2.0)
    until(lambda: "back" in Ticking.seen, "the jump is reported")
    publish_clock(3.0)
    until(lambda: Ticking.seen[-1:] == ["3"], "the clock continues")


def test_the_systems_clock_needs_no_simulation(place: Place) -> None:  # noqa: F811
    earliest = int(time.time())
    place.worker.start(config(place, "system"))
    until(lambda: Ticking.seen, "the module has counted a second")
    assert earliest <= int(Ticking.seen[0]) <= time.time()


def test_clock_reports_only_backward_jumps(caplog: pytest.LogCaptureFixture) -> None:
    clock, jumps = RunClock(simulated=True), threading.Semaphore(0)
    withdraw = clock.on_jump(jumps.release)
    assert clock.now_ns() == 0
    for seconds in (5, 5, 100):
        clock.receive(bytes([0, 1, 0, 0]) + seconds.to_bytes(4, "little") + bytes(4))
    assert not jumps.acquire(blocking=False)
    clock.receive(bytes([0, 1, 0, 0]) + bytes(8))
    assert jumps.acquire(blocking=False)
    assert "set back" in caplog.text
    withdraw()
    clock.receive(bytes(3))  # not a time
    assert clock.stamp() == {"sec": 0, "nanosec": 0}
    system = RunClock()
    system.receive(bytes([0, 1, 0, 0]) + bytes(8))
    earliest = time.time_ns()
    assert earliest <= system.now_ns() <= time.time_ns()
