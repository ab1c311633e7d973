"""RobotGoto's commands to the base: zero is repeated at the end, then nothing is published."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from unittest.mock import MagicMock

import pytest

from bridge.client.velocity import STOP_SECONDS
from navigation.robot_goto import ports
from navigation.robot_goto.ports import GotoTopics
from navigation.robot_goto.steering import STILL, DriveCommand

PERIOD = 0.05
ZEROS = round(STOP_SECONDS / PERIOD)


def opened(drivers: dict[str, str]) -> GotoTopics:
    """Return the topics on a hub where these persons drive manually."""
    host = MagicMock()
    host.node.hub.graph.drivers.return_value = drivers
    return GotoTopics(host, "map", "/cmd_vel", "", PERIOD)


@pytest.mark.parametrize(
    ("drivers", "zeros"), [({}, ZEROS), ({"1": "anna"}, 1)], ids=["nobody drives", "a person drives manually"]
)
@pytest.mark.parametrize(
    "stop", [lambda _topics: None, GotoTopics.stop_base], ids=["the goal is reached", "the goal is canceled"]
)
def test_zero_is_repeated_at_the_end_of_a_goal(
    monkeypatch: pytest.MonkeyPatch, stop: Callable[[GotoTopics], None], drivers: dict[str, str], zeros: int
) -> None:
    velocities: Any = MagicMock()
    monkeypatch.setattr(ports, "velocity_publisher", lambda *_: velocities)
    topics = opened(drivers)
    topics.command(STILL, silent=True)
    velocities.publish.assert_not_called()
    topics.command(DriveCommand(0.3), silent=False)
    stop(topics)
    velocities.reset_mock()
    for _ in range(3 * ZEROS):
        topics.command(STILL, silent=True)
    assert [call.args for call in velocities.publish.call_args_list] == [(0.0, 0.0, 0.0)] * zeros
