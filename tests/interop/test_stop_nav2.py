"""Stops of Nav2 after one of its servers crashed or gave up, and of goals that another client sent to a server.

They are checked against the base's own program. The tests share a daemon and Nav2.
"""

from __future__ import annotations

import time

import pytest

from tests.peers.navigation.gateway import pose
from tests.peers.navigation.mix import NAV2, OWN, Mix
from tests.peers.navigation.mix_clients import COMMAND, ROS1, ROS2, SECONDS, YARP, ZENOH, RosClient, ZenohClient
from tests.peers.navigation.mix_faults import AWAY, STANDS_SECONDS, UNCONFIRMED, Watch, start_driving
from tests.support.wait import until

ALL = (YARP, ROS1, ROS2, ZENOH)
PATIENCE = 20.0
"""Seconds that the gateway waits for an unreachable planner: enough for a restart of bt_navigator on a busy machine."""

KILLED_SECONDS = 7.0
"""Seconds until a killed bt_navigator is restarted."""

NO_NAVIGATOR = 20011
"""The error code in the status while the planner is unreachable."""

PATH = {"path": {"header": {"frame_id": "map"}, "poses": [pose(AWAY)]}}
BACKUP = "nav2_msgs/BackUp", {"target": {"x": -AWAY}, "speed": -0.5}
BEHAVIORS = {
    "/spin": ("nav2_msgs/Spin", {"target_yaw": 1.0}),
    "/assisted_teleop": ("nav2_msgs/AssistedTeleop", {"time_allowance": {"sec": 60}}),
}
NO_ODOMETRY = {"base": ("--no-odometry",)}
SHORT_LEASE = {"navigation": {"patience": PATIENCE}}
DEFAULT_LEASE = SHORT_LEASE | {"nav2": {"lease": {}}}
with_odometry = pytest.mark.parametrize("shared_mix", [pytest.param(SHORT_LEASE, id="odometry")], indirect=True)
thorough = pytest.mark.thorough


def drive_in(mix: Mix, client: str) -> Watch:
    """Let a client drive with Nav2 in this mix."""
    start_driving(mix, mix.clients[client])
    return Watch(mix, client, own=(NAV2, client) in OWN)


def wait(watch: Watch, seconds: float) -> None:
    """Keep polling until this many seconds after the fault."""
    watch.until(lambda: time.monotonic() > watch.began + seconds, "the fault lasts for a while")


def assert_stops(watch: Watch, *callers: str, through: str = "") -> None:
    """Let clients request a stop, which must reach whatever moves the base; ``through``: a worker that restarts."""
    watch.ask("stop", callers or ALL)
    for name, (_, answer) in watch.answers.items():
        assert not answer or answer == "not ok" or UNCONFIRMED in answer, f"{name} received {answer!r}; {watch}"
    if through:  # on a busy machine, a restart takes longer than a stop
        watch.until(lambda: watch.mix.runs(through), f"{through} has restarted")
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
@pytest.mark.parametrize("shared_mix", [pytest.param(NO_ODOMETRY, id="no odometry")], indirect=True)
def test_stop_of_a_path_of_another_client_without_odometry(mix: Mix) -> None:
    assert_path_stops(mix)


@thorough
@with_odometry
@pytest.mark.parametrize("server", ["bt_navigator", "controller_server"])
def test_stop_after_a_server_was_killed(mix: Mix, server: str) -> None:
    watch = drive_in(mix, ZENOH)
    mix.planner.kill(server)
    wait(watch, 0.5)
    assert_stops(watch)


@pytest.mark.parametrize(
    ("shared_mix", "client"),
    [
        pytest.param(DEFAULT_LEASE, ZENOH, id="default lease, zenoh"),
        pytest.param(DEFAULT_LEASE, YARP, marks=thorough, id="default lease, YARP"),
        pytest.param(SHORT_LEASE, ROS1, marks=thorough, id="short lease, ROS 1"),
    ],
    indirect=["shared_mix"],
    scope="module",
)
def test_a_goal_continues_after_bt_navigator_was_killed_and_restarted(mix: Mix, client: str) -> None:
    watch = drive_in(mix, client)
    mix.planner.kill("bt_navigator")
    gateway = mix.clients[client]
    watch.until(lambda: mix.statuses[-1][1]["error_code"] == NO_NAVIGATOR, "the planner is unreachable", STANDS_SECONDS)
    assert mix.state() == "moving", watch
    wait(watch, KILLED_SECONDS)
    assert gateway.end() == "", f"the client's goal ended; {watch}"
    assert mix.state() == "moving", watch
    mix.restart_navigator()
    progress = gateway.progress()
    watch.until(lambda: gateway.progress() > progress and mix.driving(), "the client's goal continues")
    watch.close()
    gateway.cancel()
    watch.until(lambda: gateway.end() == "canceled", "the client's goal is canceled", STANDS_SECONDS)
    assert_ends_once(watch)


@thorough
@with_odometry
def test_bt_navigator_is_not_restarted(mix: Mix) -> None:
    watch = drive_in(mix, ZENOH)
    mix.planner.kill("bt_navigator")
    client = mix.clients[ZENOH]
    watch.until(client.end, "the client's goal ends after the gateway's patience")
    assert client.ended_at() - watch.began > PATIENCE - 1.0, watch
    watch.close()
    assert_stops(watch)


@thorough
@with_odometry
@pytest.mark.parametrize("client", [YARP, ROS2])
def test_stop_after_bt_navigator_aborted(mix: Mix, client: str) -> None:
    watch = drive_in(mix, client)
    watch.mix.planner.give_up()
    wait(watch, 0.5)
    assert_stops(watch, *ALL, COMMAND)
    assert_ends_once(watch)
    start_driving(watch.mix, watch.mix.clients[client])  # the same start as without a fault
    watch.mix.clients[client].cancel()
    until(lambda: not watch.base.moves, "the base stands", STANDS_SECONDS)


@with_odometry
def test_no_end_is_reported_while_the_base_moves_after_bt_navigator_aborted(mix: Mix) -> None:
    """No client requests a stop; the gateway may stop the controller by itself."""
    watch = drive_in(mix, ZENOH)
    watch.mix.planner.give_up()
    wait(watch, 4.0)
    watch.close()
    assert_stops(watch)


@with_odometry
def test_stop_of_a_path_of_another_client(mix: Mix) -> None:
    assert_path_stops(mix)


@with_odometry
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
