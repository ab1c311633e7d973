"""Stops after a Nav2 server crashed, and stops of another client's path, checked against the base's own program."""

from __future__ import annotations

import time

import pytest

from tests.peers.daemon.deployment import Deployment
from tests.peers.navigation.gateway import pose
from tests.peers.navigation.mix import NAV2, OWN, Mix
from tests.peers.navigation.mix_clients import ROS1, ROS2, SECONDS, YARP, ZENOH, RosClient, ZenohClient
from tests.peers.navigation.mix_faults import AWAY, STANDS_SECONDS, UNCONFIRMED, Watch, start_driving
from tests.support.wait import until

ALL = (YARP, ROS1, ROS2, ZENOH)
PATIENCE = 10.0
NO_NAVIGATOR = 20011
"""The error code in the status while the planner is unreachable."""

PATH = {"path": {"header": {"frame_id": "map"}, "poses": [pose(AWAY)]}}
thorough = pytest.mark.thorough


def drive(deployment: Deployment, client: str, **options: object) -> Watch:
    """Let a client drive with Nav2."""
    return drive_in(Mix.over(deployment, NAV2, **options), client)


def drive_in(mix: Mix, client: str) -> Watch:
    """Let a client drive with Nav2 in this mix."""
    start_driving(mix, mix.clients[client])
    return Watch(mix, client, own=(NAV2, client) in OWN)


def wait(watch: Watch, seconds: float) -> None:
    """Keep polling until this many seconds after the fault."""
    watch.until(lambda: time.monotonic() > watch.began + seconds, "the fault lasts for a while")


def assert_stops(watch: Watch, *callers: str) -> None:
    """Let clients request a stop, which must reach whatever moves the base."""
    watch.ask("stop", callers or ALL)
    for name, (_, answer) in watch.answers.items():
        assert not answer or answer == "not ok" or UNCONFIRMED in answer, f"{name} received {answer!r}; {watch}"
    watch.until(lambda: not watch.base.moves, "the base stands", STANDS_SECONDS)
    wait(watch, time.monotonic() - watch.began + 1.0)
    watch.until(lambda: watch.mix.state() in ("idle", "aborted"), "the status shows no goal", STANDS_SECONDS)
    watch.close()


def assert_ends_once(watch: Watch) -> None:
    client = watch.mix.clients[watch.client]
    if isinstance(client, RosClient | ZenohClient):
        assert client.ends() == 1, f"the client's goal had {client.ends()} ends; {watch}"


def assert_path_stops(mix: Mix) -> None:
    """Send a path to controller_server, and stop it through the gateway."""
    client = mix.clients[ROS2]
    assert isinstance(client, RosClient)
    client.send("/follow_path", "nav2_msgs/FollowPath", PATH)
    assert_goal_stops(mix, client)


def assert_goal_stops(mix: Mix, client: RosClient) -> None:
    """Stop the base through the gateway while a client's goal moves it; that goal is canceled."""
    until(lambda: mix.base.moves, "the base moves", SECONDS)
    until(lambda: mix.state() == "moving", "the status is moving", STANDS_SECONDS)
    watch = Watch(mix, "")
    wait(watch, 0.5)
    assert_stops(watch)
    assert client.seen() == "canceled", client.seen()


@thorough
def test_stop_of_a_path_of_another_client_without_odometry(deployment: Deployment) -> None:
    assert_path_stops(Mix.over(deployment, NAV2, base=("--no-odometry",)))


@thorough
@pytest.mark.parametrize("server", ["bt_navigator", "controller_server"])
def test_stop_after_a_server_was_killed(deployment: Deployment, server: str) -> None:
    watch = drive(deployment, ZENOH)
    watch.mix.planner.kill(server)
    wait(watch, 0.5)
    assert_stops(watch)


@thorough
def test_bt_navigator_is_not_restarted(deployment: Deployment) -> None:
    watch = drive(deployment, ZENOH, navigation={"patience": PATIENCE})
    watch.mix.planner.kill("bt_navigator")
    client = watch.mix.clients[ZENOH]
    watch.until(client.end, "the client's goal ends after the gateway's patience")
    assert client.ended_at() - watch.began > PATIENCE - 1.0, watch
    watch.close()
    assert_stops(watch)
