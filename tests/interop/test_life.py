"""The daemon's life cycle: reload, clean stop, and commands that a suspended worker must not replay."""

from __future__ import annotations

import os
import signal

import pytest

from tests.interop.test_topics import cross
from tests.peers.daemon.deployment import Deployment
from tests.support.lane import LANE
from tests.support.process import is_stopped
from tests.support.wait import until

STRING = "std_msgs/String"
TWIST = "geometry_msgs/Twist"


def test_a_reload_applies_a_valid_file_and_rejects_an_invalid_one(running: Deployment) -> None:
    ros1, ros2 = running.ros1(), running.ros2()
    subscription = ros2.subscribe("/kept", STRING)
    out = ros1.advertise("/kept", STRING)
    ros1.advertise("/closed", STRING)
    cross(ros1, out, ros2, subscription, {"data": "before"})
    running.until_route("ros1", "/closed", "in")
    pid = running.answer("ros1")["pid"]

    running.configure(routing={"rules": [{"topic": "/closed", "deny": True}]})
    running.hang_up()
    until(lambda: running.route("ros1", "/closed", "in") is None, "the denied route closes", 20, every=0.1)

    running.file.write_text("routing:\n  ruels: []\n")
    running.hang_up()
    assert running.daemon is not None
    daemon = running.daemon
    until(
        lambda: "rules" in daemon.output() and "midspan.yaml:2" in daemon.output(),
        "the error names the line and the fix",
        20,
    )
    ros1.publish(out, {"data": "after"})
    until(lambda: {"data": "after"} in ros2.wait(subscription, 1, 0.2), "the route carries messages")
    assert running.answer("ros1")["pid"] == pid
    assert running.route("ros1", "/closed", "in") is None


def test_a_clean_stop_leaves_nothing_on_the_master(running: Deployment) -> None:
    ros1, ros2 = running.ros1(), running.ros2()
    ros1.advertise("/mine", STRING, latched=True)
    ros2.advertise("/theirs", STRING, latched=True)
    running.until_route("ros2", "/mine", "out")
    running.until_route("ros1", "/theirs", "out")
    assert any("midspan" in node for node in running.master.nodes())
    assert running.stop_daemon() == 0
    assert not any("midspan" in node for node in running.master.nodes())
    assert not any("midspan" in name for name in running.master.parameters())


@pytest.mark.thorough
def test_commands_queued_for_a_suspended_worker_are_dropped(running: Deployment) -> None:
    ros1, ros2 = running.ros1(), running.ros2()
    subscription = ros1.subscribe("/cmd_vel", TWIST)
    out = ros2.advertise("/cmd_vel", TWIST, depth=100)
    cross(ros2, out, ros1, subscription, twist(0.1))
    if LANE:  # commands may wait in the socket of the suspended worker
        until(lambda: (running.route("ros1", "/cmd_vel", "out") or {}).get("way") == "lane", "commands use the lane")
    for side in ("ros2", "ros1"):
        pid = running.answer(side)["pid"]
        before = len(ros1.wait(subscription, 0, 0))
        os.kill(pid, signal.SIGSTOP)
        until(lambda pid=pid: is_stopped(pid), f"{side} is suspended")
        for _ in range(10):
            ros2.publish(out, twist(9.0))
        # by the time the worker resumes, the commands must be stale
        assert not [m for m in ros1.wait(subscription, 10_000, 1.5)[before:] if m["linear"]["x"] == 9.0], side
        os.kill(pid, signal.SIGCONT)

        def fresh(before: int = before) -> bool:
            ros2.publish(out, twist(0.2))
            return any(m["linear"]["x"] == 0.2 for m in ros1.wait(subscription, 0, 0)[before:])

        until(fresh, f"new commands cross after {side} resumes", 20)
        assert not [m for m in ros1.wait(subscription, 0, 0)[before:] if m["linear"]["x"] == 9.0], side


def twist(x: float) -> dict:
    """Return a Twist with this forward speed."""
    return {"linear": {"x": x, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}
