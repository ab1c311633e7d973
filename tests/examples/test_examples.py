"""Each example, run from the command line with one deployment."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.peers.daemon.deployment import Deployment
from tests.peers.daemon.examples import EXAMPLES, PLACES, Examples, run
from tests.peers.ros1.network import needs_ros1
from tests.support.wait import until

pytestmark = needs_ros1

RUNS = {
    "status.py",
    "goto_pose.py",
    "goto_location_yarp.py",
    "goto_location_ros1.py",
    "goto_location_rospy.py",
    "goto_location_rclpy.py",
    "goto_location_zenoh.py",
    "patrol.py",
    "follow_path.py",
}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Examples]:
    with Deployment(Path(tmp_path_factory.mktemp("examples"))) as deployment:
        examples = Examples(deployment)
        yield examples
        examples.stop()


def test_every_example_has_a_test() -> None:
    assert {file.name for file in EXAMPLES.glob("*.py")} == RUNS


def test_status_prints_the_places(place: Examples) -> None:
    code, lines = run(place.start("yarp", "status.py"))
    assert (code, lines[-1]) == (0, f"places: {' '.join(sorted(PLACES))}")


@pytest.mark.parametrize("side", ["yarp", "rospy", "ros1", "rclpy", "zenoh"])
def test_a_client_goes_to_a_location(place: Examples, side: str) -> None:
    arguments = (f"tcp/127.0.0.1:{place.deployment.port}",) if side == "zenoh" else ()

    def shows_the_drive() -> bool:
        """Drive; return whether the client printed the drive, for the second of which it may have stood still."""
        for name in ("hall", "kitchen"):  # the robot may be in the hall already, so the second goal always moves it
            code, lines = run(place.start(side, f"goto_location_{side}.py", name, *arguments))
            assert code == 0, lines
            assert "reached" in lines[-1]
            assert place.robot_x() == pytest.approx(PLACES[name], abs=0.3)
        return any(line.startswith(("at ", "navigation_status_moving: at", "moving")) for line in lines)

    until(shows_the_drive, "the client prints the robot's position")
    code, lines = run(place.start(side, f"goto_location_{side}.py", "nowhere", *arguments))
    assert code == 1, lines
    assert "nowhere" in lines[-1]


def test_a_client_goes_to_a_pose(place: Examples) -> None:
    assert run(place.start("yarp", "goto_pose.py", "flat", "1.5", "0", "0")) == (0, ["navigation_status_goal_reached"])
    assert place.robot_x() == pytest.approx(1.5, abs=0.3)


def test_patrol_skips_unknown_places(place: Examples) -> None:
    code, lines = run(place.start("yarp", "patrol.py", "kitchen", "nowhere", "bedroom", "--rounds", "2"))
    assert code == 0
    assert len(lines) == 6
    reached = "navigation_status_goal_reached"
    assert lines[3:] == [
        f"round 2, kitchen: {reached}", "round 2, nowhere: unknown place, or the goal was rejected",
        f"round 2, bedroom: {reached}",
    ]  # fmt: skip


def test_a_client_follows_a_path(place: Examples) -> None:
    code, lines = run(place.start("yarp", "follow_path.py", "tour", "kitchen", "hall"))
    assert (code, lines) == (0, ["tour: 2 places, 2.0 m", "navigation_status_goal_reached"])
    assert place.robot_x() == pytest.approx(PLACES["hall"], abs=0.3)
