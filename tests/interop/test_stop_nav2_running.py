"""Stops while Nav2's servers keep running: bt_navigator aborts, or another client moves the base.

The tests share a daemon and Nav2 with the default options. The tests of `tests.interop.test_stop_nav2` start their own
daemon on the same ROS domain, where a second daemon would be on standby.
"""

from __future__ import annotations

import pytest

from tests.interop.test_stop_nav2 import (
    ALL,
    assert_ends_once,
    assert_goal_stops,
    assert_path_stops,
    assert_stops,
    drive_in,
    wait,
)
from tests.peers.navigation.mix import Mix
from tests.peers.navigation.mix_clients import COMMAND, ROS2, SECONDS, ZENOH, RosClient
from tests.peers.navigation.mix_faults import AWAY, STANDS_SECONDS, start_driving
from tests.support.wait import until

BACKUP = "nav2_msgs/BackUp", {"target": {"x": -AWAY}, "speed": -0.5}
BEHAVIORS = {
    "/spin": ("nav2_msgs/Spin", {"target_yaw": 1.0}),
    "/drive_on_heading": ("nav2_msgs/DriveOnHeading", {"target": {"x": AWAY}, "speed": 0.5}),
    "/assisted_teleop": ("nav2_msgs/AssistedTeleop", {"time_allowance": {"sec": 60}}),
}
thorough = pytest.mark.thorough


@thorough
@pytest.mark.parametrize("client", ALL)
def test_stop_after_bt_navigator_aborted(mix: Mix, client: str) -> None:
    watch = drive_in(mix, client)
    watch.mix.planner.give_up()
    wait(watch, 0.5)
    assert_stops(watch, *ALL, COMMAND)
    assert_ends_once(watch)
    start_driving(watch.mix, watch.mix.clients[client])  # the same start as without a fault
    watch.mix.clients[client].cancel()
    until(lambda: not watch.base.moves, "the base stands", STANDS_SECONDS)


def test_no_end_is_reported_while_the_base_moves_after_bt_navigator_aborted(mix: Mix) -> None:
    """No client requests a stop; the gateway may stop the controller by itself."""
    watch = drive_in(mix, ZENOH)
    watch.mix.planner.give_up()
    wait(watch, 4.0)
    watch.close()
    assert_stops(watch)


def test_stop_of_a_path_of_another_client(mix: Mix) -> None:
    assert_path_stops(mix)


@pytest.mark.parametrize("action", ["/backup", *(pytest.param(name, marks=thorough) for name in BEHAVIORS)])
def test_stop_of_a_behavior_of_another_client(mix: Mix, action: str) -> None:
    client = mix.clients[ROS2]
    assert isinstance(client, RosClient)
    client.send(action, *BEHAVIORS.get(action, BACKUP))
    if action == "/assisted_teleop":
        out = client.peer.advertise("/cmd_vel_teleop", "geometry_msgs/Twist")

        def teleoperated() -> bool:
            client.peer.publish(out, {"linear": {"x": 0.5}})
            return mix.base.moves

        until(teleoperated, "the base moves", SECONDS, 0.2)
    assert_goal_stops(mix, client)
