"""The daemon exits while the robot drives: each client's goal ends once, and not before the base stands."""

from __future__ import annotations

import os
import re
import signal

import pytest
import yaml

from tests.peers.daemon.deployment import Deployment
from tests.peers.navigation.mix import MOVE_BASE, NAV2, Mix
from tests.peers.navigation.mix_clients import ROS1, ROS2, YARP, ZENOH, RosClient, ZenohClient
from tests.peers.navigation.mix_faults import STANDS_SECONDS, Watch, start_driving
from tests.support.ports import free_port
from tests.support.wait import until

STRICT = 0.01
"""Seconds of tolerance, because the processes record times after the event."""

CYCLE = 0.4
"""Seconds of the control cycle, in which the planner releases its goal and stops the robot."""

END_SECONDS = 30.0
thorough = pytest.mark.thorough


def assert_ends(mix: Mix, name: str, number: int) -> None:
    """Drive, stop the daemon with a signal, and check that the base stands and the client's goal ends once."""
    client = mix.clients[name]
    start_driving(mix, client)
    watch = Watch(mix, name)
    daemon = mix.deployment.daemon
    assert daemon is not None
    os.kill(daemon.pid, number)
    watch.until(lambda: not watch.base.moves, "the base stands although the daemon has exited", STANDS_SECONDS)
    if isinstance(client, RosClient | ZenohClient):
        watch.until(client.end, "the client's goal has an end", END_SECONDS)
        watch.until(
            lambda: mix.deployment.daemon is not None and mix.deployment.daemon.popen.poll() is not None,
            "the daemon has exited",
        )
        assert client.ends() == 1, f"the client's goal had {client.ends()} ends; {watch}"
        known = min(watch.base.stands_after(watch.began), mix.released(watch.began))
        early = known - client.ended_at()
        assert early < STRICT, f"the goal ended {early:.2f} s before its release or before the base stood; {watch}"
    watch.close()


@pytest.mark.parametrize(
    ("client", "number"),
    [
        (ROS2, signal.SIGKILL),
        (ROS2, signal.SIGTERM),
        pytest.param(YARP, signal.SIGKILL, marks=thorough),
        pytest.param(ZENOH, signal.SIGTERM, marks=thorough),
    ],
)
def test_a_stop_of_the_daemon_ends_a_goal_of_move_base(deployment: Deployment, client: str, number: int) -> None:
    assert_ends(Mix.over(deployment, MOVE_BASE, cycle=CYCLE), client, number)


@thorough
def test_a_reload_stops_the_modules_before_a_side_that_restarts(deployment: Deployment) -> None:
    """The side, which runs the name server, still carries the modules' last messages."""
    mix = Mix.over(deployment, MOVE_BASE, cycle=CYCLE)
    client = mix.clients[ROS2]
    assert isinstance(client, RosClient)
    start_driving(mix, client)
    watch = Watch(mix, ROS2)
    daemon = deployment.daemon
    assert daemon is not None
    ready = daemon.output().count("ready: ")
    config = yaml.safe_load(deployment.file.read_text())
    config["yarp"]["address"] = f"127.0.0.1:{free_port()}"
    deployment.file.write_text(yaml.safe_dump(config))
    deployment.hang_up()
    watch.until(lambda: not watch.base.moves, "the base stands although the gateway has stopped", STANDS_SECONDS)
    watch.until(client.end, "the client's goal has an end", END_SECONDS)
    assert client.ends() == 1, f"the client's goal had {client.ends()} ends; {watch}"
    until(lambda: daemon.output().count("ready: ") > ready, "the workers run again", 60)
    reloaded = daemon.output().rpartition("configuration reloaded")[2]
    steps = re.findall(r"stopping \w+|\w+ ended with exit code 0|\w+ started", reloaded)
    assert steps[:2] == ["stopping modules", "modules ended with exit code 0"]
    assert steps[2:4] == ["stopping yarp", "yarp ended with exit code 0"]
    assert steps[4:] == ["yarp started", "modules started"]
    assert "cannot unregister port" not in reloaded
    watch.close()


@thorough
@pytest.mark.parametrize(("client", "number"), [(ROS1, signal.SIGTERM), (ZENOH, signal.SIGKILL)])
def test_a_stop_of_the_daemon_ends_a_goal_of_nav2(deployment: Deployment, client: str, number: int) -> None:
    assert_ends(Mix.over(deployment, NAV2), client, number)


@pytest.mark.long
@pytest.mark.parametrize("client", [ROS2, ZENOH])
def test_every_goal_has_an_end(deployment: Deployment, client: str) -> None:
    """One client out of forty used to wait forever for the end of its goal."""
    assert_ends(Mix.over(deployment, MOVE_BASE, cycle=CYCLE), client, signal.SIGKILL)
