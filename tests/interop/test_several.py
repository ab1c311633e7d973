"""Several real daemons on the same networks: one is active, no message arrives twice, and another takes over."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.peers.daemon.several import Daemon, Flow, Several, flows, pour, quiet, ring, triangle
from tests.support.processor_share import ProcessorShare
from tests.support.wait import until

pytestmark = [pytest.mark.thorough, pytest.mark.alone]

TAKEOVER_SECONDS = 2.0
COUNT = 1000
RATE = 1000.0


@pytest.fixture
def several(tmp_path: Path) -> Iterator[Several]:
    """Daemons and networks that the test creates."""
    with Several(tmp_path) as several:
        yield several


def active(daemons: list[Daemon], side: str) -> list[str]:
    """Return the daemons that are active on a side, once any is; a busy worker may not report its status in time."""

    def running() -> list[str]:
        return [d.name for d in daemons if d.process is not None and d.status(side).get("state") == "running"]

    return until(running, f"a daemon is active on {side}")


@pytest.mark.parametrize(("joined", "node"), [(True, "midspan"), (False, "other_name")], ids=["joined", "apart"])
def test_nothing_arrives_twice_in_a_triangle(several: Several, joined: bool, node: str) -> None:
    _, networks = triangle(several, joined=joined, node=node)
    assert_each_arrives_once(flows(several, networks), COUNT, RATE / 2)


def assert_each_arrives_once(made: list[Flow], count: int, rate: float) -> None:
    """Publish on all flows at once, and check that each number reaches each sink exactly once."""
    pour(made, count, rate)
    for flow in made:
        tallies = flow.tallies()
        assert all(t["distinct"] >= count for t in tallies), tallies
        assert not flow.duplicates(), tallies


@pytest.mark.parametrize(("joined", "node"), [(True, "midspan"), (False, "other_name")], ids=["joined", "apart"])
def test_nothing_arrives_twice_in_a_ring_and_either_daemon_takes_over(
    several: Several, joined: bool, node: str
) -> None:
    daemons, networks = ring(several, joined=joined, node=node)
    created = flows(several, networks)
    assert_each_arrives_once(created, COUNT, RATE)
    for side in ("ros1", "ros2"):
        (name,) = active(daemons, side)
        (other,) = (d for d in daemons if d.name != name)
        until(lambda: other.status(side).get("standby") == name, f"{other.name} stands by")  # noqa: B023
        text = other.explain(side, "/from_0")
        assert not joined or any(line["decision"] == "standby" and name in line["reason"] for line in text), text
    state = several.program(networks[0])
    latched = state.advertise("/state", "std_msgs/String", latched=True)
    state.publish(latched, {"data": "kept"})
    for flow in created:
        flow.start(100_000, 200)
    (name,) = set(active(daemons, "ros2"))
    (killed,) = (d for d in daemons if d.name == name)
    share = ProcessorShare()
    at = killed.kill()
    took = [flow.silence(at, 2.5) for flow in created]
    print(f"taken over after {took}")
    assert max(took) <= TAKEOVER_SECONDS / share.least()
    late = several.program(networks[1])
    subscription = late.subscribe("/state", "std_msgs/String", latched=True, depth=10)
    assert [m["data"] for m in late.wait(subscription, 1, 10)] == ["kept"]
    several.start(killed)
    until(lambda: killed.status("ros2").get("standby"), "the restarted daemon is on standby", 30, every=0.2)
    for flow in created:
        flow.end(now=True)
    quiet(created)
    assert not [f.duplicates() for f in created if f.duplicates()]


def test_another_daemon_takes_over_from_a_killed_or_suspended_worker(several: Several) -> None:
    daemons, networks = ring(several, joined=True)
    created = flows(several, networks)
    for flow in created:
        flow.start(100_000, 200)
    (name,) = active(daemons, "ros2")
    (hit,) = (d for d in daemons if d.name == name)
    share, at = ProcessorShare(), time.monotonic()
    os.kill(int(hit.status("ros2")["pid"]), signal.SIGKILL)
    took = [flow.silence(at, 2.5) for flow in created]
    print(f"taken over after {took}")
    assert max(took) <= TAKEOVER_SECONDS / share.least()
    until(lambda: hit.status("ros2").get("standby"), "the restarted worker is on standby", 30, every=0.2)
    (name,) = set(active(daemons, "ros2"))
    (stopped,) = (d for d in daemons if d.name == name)
    at = stopped.signal(signal.SIGSTOP)
    took = [flow.silence(at, 2.5) for flow in created]
    print(f"taken over after {took}")
    stopped.signal(signal.SIGCONT)
    until(
        lambda: stopped.status("ros2").get("state") in ("standby", "running"),
        "the suspended daemon resumes",
        30,
        every=0.2,
    )
    for flow in created:
        flow.end(now=True)
    quiet(created)
    assert not [f.duplicates() for f in created if f.duplicates()]
