"""Stops while the robot brakes; the reference is the base's own program."""

from __future__ import annotations

import pytest

from tests.interop.test_stop_move_base import assert_refused_or_stands, cancel, wait_until_stands
from tests.interop.test_stop_nav2 import assert_ends_once, assert_stops, drive_in, wait
from tests.peers.navigation.mix import MOVE_BASE, Mix
from tests.peers.navigation.mix_clients import ROS1, ROS2, YARP, ZENOH
from tests.peers.navigation.mix_faults import STANDS_SECONDS, Watch, start_driving

CONTROLLER = {"nav2": {"controller": ("--braking", "1.0")}}
BASE = {"base": ("--ramp", "2.0")}
MOVE_BASES = BASE | {"planner": MOVE_BASE}
NO_ODOMETRY = CONTROLLER | {"base": ("--no-odometry",)}
thorough = pytest.mark.thorough


@pytest.mark.parametrize(
    ("shared_mix", "client"),
    [
        pytest.param(CONTROLLER, YARP, id="the controller brakes, YARP"),
        pytest.param(CONTROLLER, ROS2, id="the controller brakes, ROS 2", marks=thorough),
        pytest.param(BASE, ROS2, id="the base brakes, ROS 2", marks=thorough),
        pytest.param(NO_ODOMETRY, YARP, id="without odometry, YARP", marks=thorough),
    ],
    indirect=["shared_mix"],
    scope="module",
)
def test_stop_while_it_brakes(mix: Mix, client: str) -> None:
    """bt_navigator reports its goal's end 50 ms after the cancel request, even if the robot still moves."""
    watch = drive_in(mix, client)
    wait(watch, 1.5)  # until the robot is at full speed
    watch.allowance = 1.5
    assert_stops(watch)
    assert mix.clients[client].end() == "canceled", mix.clients[client].end()
    assert_ends_once(watch)


@thorough
@pytest.mark.parametrize("shared_mix", [pytest.param(CONTROLLER, id="the controller brakes")], indirect=True)
def test_pause_while_the_controller_brakes(mix: Mix) -> None:
    watch = drive_in(mix, YARP)
    watch.allowance = 1.5
    watch.ask("pause", [YARP])
    watch.until(lambda: not watch.base.moves, "the base stands", STANDS_SECONDS)
    watch.until(lambda: watch.mix.state() == "paused", "the navigation is paused", STANDS_SECONDS)
    watch.close()
    cancel(watch)


def drive_with_move_base(mix: Mix, client: str) -> Watch:
    """Let a client drive at full speed with move_base."""
    start_driving(mix, mix.clients[client])
    watch = Watch(mix, client)
    wait(watch, 1.5)
    return watch


@pytest.mark.parametrize("shared_mix", [pytest.param(MOVE_BASES, id="move_base")], indirect=True)
@pytest.mark.parametrize("client", [YARP, pytest.param(ROS2, marks=thorough)])
def test_stop_of_move_base_while_the_base_brakes(mix: Mix, client: str) -> None:
    watch = drive_with_move_base(mix, client)
    watch.ask("stop", [YARP, ROS2, ZENOH, ROS1])
    assert_refused_or_stands(watch)
    wait_until_stands(watch)
    watch.allowance = 1.5  # the base brakes for a second, and the planner may report its goal's end earlier
    watch.close()


@thorough
@pytest.mark.parametrize("shared_mix", [pytest.param(MOVE_BASES, id="move_base")], indirect=True)
def test_pause_of_move_base_while_the_base_brakes(mix: Mix) -> None:
    watch = drive_with_move_base(mix, ROS2)
    watch.ask("pause", [ROS2])
    assert_refused_or_stands(watch)
    wait_until_stands(watch)
    watch.until(lambda: watch.mix.state() == "paused", "the navigation is paused", STANDS_SECONDS)
    watch.close()
    cancel(watch)
