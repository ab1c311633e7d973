"""``/clock`` as a session hears it on the hub."""

from __future__ import annotations

from bridge.clock import CLOCK_TOPIC, CLOCK_TYPE, RunClock
from bridge.hub.keyexpr import ANY_HASH
from bridge.hub.qos import Qos, Reliability
from bridge.hub.session import Hub


def follow(clock: RunClock, hub: Hub) -> None:
    """Have a simulated clock hear what other sessions publish on ``/clock``; nothing for the system's clock."""
    if clock.simulated:
        qos = Qos(Reliability.BEST_EFFORT, depth=1)
        hub.subscription(CLOCK_TOPIC, CLOCK_TYPE, ANY_HASH, qos, lambda sample: clock.hear(sample.data()))
