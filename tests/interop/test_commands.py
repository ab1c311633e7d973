"""Velocity commands between real ROS 1 and ROS 2 programs are never delivered to programs that join later."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import pytest

from tests.peers.daemon.deployment import Deployment
from tests.support.wait import until

CMD_VEL, TWIST = "/cmd_vel", "geometry_msgs/Twist"
PROBE = 0.125
RULE = {"topic": CMD_VEL, "qos": {"durability": "transient_local"}}


def speeds(program: Any, subscription: int, seconds: float = 0.5) -> list[float]:
    """Return the forward velocities that a subscription has received, once there is one or the time is over."""
    return [message["linear"]["x"] for message in program.wait(subscription, 1, seconds)]


@pytest.mark.parametrize(("sender", "receiver"), [("ros2", "ros1"), ("ros1", "ros2")])
def test_a_late_program_receives_no_old_command(deployment: Deployment, sender: str, receiver: str) -> None:
    """A latching sender, a rule with ``durability``, and a transient-local subscription make no difference."""
    deployment.start(routing={"rules": [RULE]})
    programs: dict[str, Callable[[], Any]] = {"ros1": deployment.ros1, "ros2": deployment.ros2}

    def drives(base: Any, subscription: int, speed: float) -> Callable[[], bool]:
        """Return a function that publishes a program's velocity and returns whether a base has received it.

        Once probes arrive, it publishes the velocity so seldom that no other one is on its way when the base has it.
        """
        program, again = programs[sender](), -math.inf
        out = program.advertise(CMD_VEL, TWIST, latched=True, depth=1)

        def driven() -> bool:
            nonlocal again
            if PROBE not in speeds(base, subscription, 0.1):
                program.publish(out, {"linear": {"x": PROBE}})
            elif time.monotonic() > again:
                again = time.monotonic() + 5.0
                program.publish(out, {"linear": {"x": speed}})
            return speed in speeds(base, subscription, 0.1)

        return driven

    base, late = programs[receiver](), programs[receiver]()
    until(drives(base, base.subscribe(CMD_VEL, TWIST), 0.25), "the base receives the command")
    live, retained = (late.subscribe(CMD_VEL, TWIST, latched=latched, depth=10) for latched in (False, True))
    # another program, whose command would not replace the old one in a cache
    until(drives(late, live, 0.5), "the late program receives the next command")
    assert 0.25 not in speeds(late, live)
    assert 0.25 not in speeds(late, retained)
