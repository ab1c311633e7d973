"""A thousand topics cross within the daemon's own limits."""

from __future__ import annotations

import psutil
import pytest

from tests.peers.daemon.deployment import Deployment
from tests.support.wait import until

pytestmark = pytest.mark.thorough

STRING = "std_msgs/String"
COUNT = 1000


@pytest.mark.timeout(300)  # for the start and both waits on a busy machine
def test_a_thousand_latched_topics_are_bridged(running: Deployment) -> None:
    ros1, ros2 = running.ros1(), running.ros2()
    ids = [ros1.advertise(f"/many/t{number}", STRING, latched=True) for number in range(COUNT)]
    for number in ids:
        ros1.publish(number, {"data": f"message {number}"})

    def crossed(side: str) -> int:
        routes = running.worker(side).get("routes", [])  # a busy worker may not respond in time
        return sum(1 for r in routes if r["topic"].startswith("/many/") and r["messages"] >= 1)

    for side in ("ros1", "ros2"):
        until(lambda s=side: crossed(s) == COUNT, f"all {COUNT} cross the {side} worker", 90, every=1.0)
        process = psutil.Process(running.answer(side)["pid"])
        limit = process.rlimit(psutil.RLIMIT_NOFILE)[0]
        assert process.num_fds() < limit * 0.8, f"{side}: {process.num_fds()} of {limit} descriptors"
    subscription = ros2.subscribe(f"/many/t{COUNT - 1}", STRING, latched=True)
    assert ros2.wait(subscription, 1) == [{"data": f"message {COUNT}"}]
