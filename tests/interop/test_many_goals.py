"""A thousand concurrent goals through one bridge: each ends in the state that its server reports."""

from __future__ import annotations

from collections import Counter

import pytest

from tests.peers.daemon.calls_table import ABORTED, CANCELED, ROS1, ROS2, SUCCEEDED, Pair
from tests.peers.daemon.deployment import Deployment

pytestmark = pytest.mark.thorough

GOALS = 1000
SECONDS = 60.0
OUTCOMES = {"succeed": SUCCEEDED, "abort": ABORTED, "cancel": CANCELED, "reject": 0}


def test_a_thousand_concurrent_goals_end_as_their_servers_report(running: Deployment) -> None:
    peers = {ROS1: running.ros1(), ROS2: running.ros2()}
    for end in ("client", "server"):  # actionlib's default queues are 10 and 50
        peers[ROS1].ask("set_param", name=f"/actionlib_{end}_pub_queue_size", value=GOALS)
    for server, client in ((ROS1, ROS2), (ROS2, ROS1)):
        assert_all_end(Pair((server, peers[server]), (client, peers[client])))


def assert_all_end(pair: Pair) -> None:
    """Check that all goals end, and that all are executing before the first one ends."""
    acting = {o: pair.act(pair.name(o), held=True, outcome=o, depth=GOALS) for o in OUTCOMES}
    goals = {outcome: list[int]() for outcome in OUTCOMES}
    for _ in range(GOALS // len(OUTCOMES)):
        for outcome, sent in goals.items():
            sent.append(pair.send(pair.name(outcome), depth=GOALS))
    for outcome, sent in goals.items():
        for goal in sent:
            result = pair.goal_within(goal, SECONDS, accepted=outcome != "reject")
            assert result["ends"] == int(
                pair.sides[1] == ROS1 and outcome == "reject"
            )  # in actionlib, a rejection is a final state
    for goal in goals["cancel"]:
        pair.client.ask("cancel", id=goal)
    for outcome in ("succeed", "abort"):
        pair.server.ask("release", id=acting[outcome])
    for outcome, status in OUTCOMES.items():
        ends = Counter(pair.goal_within(goal, SECONDS, status=status)["ends"] for goal in goals[outcome])
        rejected = outcome == "reject" and pair.sides[1] == ROS2
        assert ends == {0 if rejected else 1: GOALS // len(OUTCOMES)}
