"""A driving robot during faults, in the whole deployment: simulator, localizer, planner, gateway.

``benchmarks/nav_faults.py`` tests each fault in isolation, and further faults.
"""

from __future__ import annotations

import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bridge.messages.actions import GoalState
from tests.peers.navigation.chain import Chain
from tests.support.wait import until

VIEWS = Path(__file__).parents[2] / "configs" / "views"


def missing_topics(chain: Chain) -> set[str]:
    """Return the topics in the views of RViz and Foxglove that the deployment does not have."""
    graph = chain.client.node.hub.graph
    present = {end.topic for end in (*graph.publishers(), *graph.subscriptions())}
    texts = [file.read_text() for file in (VIEWS / "navigation.rviz", VIEWS / "navigation.foxglove.json")]
    named = {topic for text in texts for topic in re.findall(r'(?:Value: |")(/[a-z_0-9/]+)', text)}
    assert {"/map", "/scan", "/goal_pose"} < named
    return named - present


def stops_and_reports(chain: Chain, fault: str, word: str) -> None:
    """Make a sensor fail while driving: the wheels stop, the client gets the reason, then the robot continues."""
    since = time.monotonic()
    chain.fail(fault)
    chain.until_still(20)
    until(
        lambda: any(word in reason for _, reason in chain.statuses_since(since)),
        f"the client receives the reason: {word}",
        20,
    )
    chain.until_still(20)
    chain.mend(fault)
    chain.until_moving(30)


@pytest.mark.thorough
def test_faults_during_a_drive_stop_the_robot_and_are_reported(tmp_path: Path) -> None:
    with Chain(tmp_path) as chain:
        chain.start()
        request = chain.goto("kitchen")
        chain.until_moving()
        until(lambda: not missing_topics(chain), "all topics of the views in configs/ exist", 20)
        stops_and_reports(chain, "laser_silent", "laser is silent")
        stops_and_reports(chain, "encoders_silent", "odometry is stale")
        assert request.ended is None
        until(
            lambda: chain.statuses_since(request.began)[-1][0] == "moving",
            "the client is informed that the drive continues",
            20,
        )

        killed = chain.kill("robot_path_planner")
        chain.until_still(20)
        until(lambda: request.ended, "the client receives the end", 30)
        assert request.status is GoalState.ABORTED
        assert request.reason

        until(
            lambda: chain.status("gateway").get("pid", killed) != killed, "the modules are running again", 40, every=0.2
        )
        assert chain.truth
        assert chain.truth.still, "earlier commands are not executed"
        request = chain.goto("kitchen")
        chain.until_moving()
        command = [sys.executable, "-m", "bridge.cli.main", "halt", "--config", str(chain.file)]
        subprocess.run(command, check=True, capture_output=True, timeout=60)
        chain.until_still(20)
        until(lambda: request.ended, "the client receives the halt", 30)
        assert request.status is GoalState.CANCELED
