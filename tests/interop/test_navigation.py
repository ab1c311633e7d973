"""A robot on its way while something fails, over the whole deployment: simulator, localiser, planner, gateway.

Each fault by itself, and more of them: ``benchmarks/nav_faults.py``.
"""

from __future__ import annotations

import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bridge.messages.actions import GoalState
from tests.support.chain import Chain
from tests.support.wait import until

VIEWS = Path(__file__).parents[2] / "configs" / "views"


def missing_topics(chain: Chain) -> set[str]:
    """What the views of rviz and Foxglove show or say, and nobody of the deployment says or hears."""
    graph = chain.client.node.hub.graph
    there = {end.topic for end in (*graph.publishers(), *graph.subscriptions())}
    texts = [file.read_text() for file in (VIEWS / "navigation.rviz", VIEWS / "navigation.foxglove.json")]
    named = {topic for text in texts for topic in re.findall(r'(?:Value: |")(/[a-z_0-9/]+)', text)}
    assert {"/map", "/scan", "/goal_pose"} < named
    return named - there


def stands_and_says(chain: Chain, fault: str, word: str) -> None:
    """Have a sensor fail on the way: the wheels stand, the client hears why; and then the robot drives on."""
    since = time.monotonic()
    chain.fail(fault)
    chain.until_still(20)
    until(lambda: any(word in why for _, why in chain.statuses_since(since)), f"the client hears of the {word}", 20)
    chain.until_still(20)
    chain.mend(fault)
    chain.until_moving(30)


@pytest.mark.thorough
def test_faults_on_the_way(tmp_path: Path) -> None:
    with Chain(tmp_path) as chain:
        chain.start()
        asked = chain.goto("kitchen")
        chain.until_moving()
        until(lambda: not missing_topics(chain), "all that the views in configs/ name is there", 20)
        stands_and_says(chain, "laser_silent", "laser is silent")
        stands_and_says(chain, "encoders_silent", "odometry is stale")
        assert asked.ended is None
        until(lambda: chain.statuses_since(asked.began)[-1][0] == "moving", "the client hears that it goes on", 20)

        killed = chain.kill("robot_path_planner")
        chain.until_still(20)
        until(lambda: asked.ended, "the client hears of the end", 30)
        assert asked.status is GoalState.ABORTED
        assert asked.reason

        until(lambda: chain.status("gateway").get("pid", killed) != killed, "the modules run again", 40, every=0.2)
        assert chain.truth
        assert chain.truth.still, "nothing that was commanded before is obeyed"
        asked = chain.goto("kitchen")
        chain.until_moving()
        command = [sys.executable, "-m", "bridge.cli.main", "halt", "--config", str(chain.file)]
        subprocess.run(command, check=True, capture_output=True, timeout=60)
        chain.until_still(20)
        until(lambda: asked.ended, "the client hears of the halt", 30)
        assert asked.status is GoalState.CANCELED
