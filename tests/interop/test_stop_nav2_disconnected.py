"""Goals and stops while the ros2 worker is killed, checked against the base's own program."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import pytest

from tests.interop.test_stop_nav2 import assert_ends_once, assert_stops, drive_in, wait
from tests.peers.navigation.mix import Mix
from tests.peers.navigation.mix_clients import ROS1, SECONDS, YARP, ZENOH
from tests.peers.navigation.mix_faults import AWAY, STANDS_SECONDS, Watch, kill_workers
from tests.peers.navigation.mix_truth import UNTRUE_SECONDS
from tests.support.process import is_stopped
from tests.support.wait import until

PATIENT = {"navigation": {"patience": 30.0}}
MISSING = PATIENT | {"base_side": "ros1", "nav2": {"navigator": (), "controller": ("--tf-tolerance", "0.5")}}
"""The base is on ROS 1, so transforms reach Nav2 through the killed worker."""
TOLERANT = MISSING | {"nav2": {"navigator": ("--tf-tolerance", "0.5"), "controller": ("--tf-tolerance", "inf")}}
thorough = pytest.mark.thorough


@pytest.mark.parametrize(
    ("shared_mix", "client"),
    [
        pytest.param(MISSING, ZENOH, id="102, zenoh"),
        pytest.param(MISSING, ROS1, marks=thorough, id="102, ROS 1"),
        pytest.param(TOLERANT, YARP, marks=thorough, id="202, YARP"),
    ],
    indirect=["shared_mix"],
    scope="module",
)
def test_the_ros2_worker_is_killed_and_transforms_are_missing(mix: Mix, client: str) -> None:
    assert_continues(drive_in(mix, client))


@pytest.mark.parametrize("shared_mix", [pytest.param(PATIENT, id="patient")], indirect=True)
def test_the_gateway_is_stopped_before_it_learns_that_its_goal_is_accepted(mix: Mix) -> None:
    """Its last status does not claim that the robot stands, although the robot has not started yet."""
    client, pids = mix.clients[ZENOH], mix.processes()
    with ExitStack() as stopping:
        with stopped(pids["ros2"]):  # the goal waits there
            known = len(mix.statuses)
            client.goto(AWAY)
            until(lambda: len(mix.statuses) > known, "the goal has a status", SECONDS)
            watch = Watch(mix, ZENOH)
            stopping.enter_context(stopped(pids["gateway"]))
        # long enough for an untrue status; the daemon replaces a gateway that is stopped for 5 s
        until(lambda: mix.base.moved(watch.began, time.monotonic()) > 1.2 * UNTRUE_SECONDS, "the base moves", SECONDS)
    watch.until(lambda: client.progress() and mix.state() == "moving", "the gateway follows its goal")
    watch.close()
    client.cancel()
    watch.until(lambda: client.end() == "canceled" and not mix.base.moves, "its goal is canceled", STANDS_SECONDS)


@thorough
@pytest.mark.parametrize("shared_mix", [pytest.param(PATIENT, id="patient")], indirect=True)
def test_the_ros2_worker_is_killed(mix: Mix) -> None:
    assert_continues(drive_in(mix, YARP))


@contextmanager
def stopped(pid: int) -> Iterator[None]:
    """Stop a process for a while."""
    os.kill(pid, signal.SIGSTOP)
    try:
        until(lambda: is_stopped(pid), "the process is stopped")
        yield
    finally:
        os.kill(pid, signal.SIGCONT)


def assert_continues(watch: Watch) -> None:
    """Kill the ros2 worker; the client's goal continues after its restart."""
    client, mix = watch.mix.clients[watch.client], watch.mix
    os.kill(mix.pid("ros2"), signal.SIGKILL)
    watch.until(
        lambda: not watch.base.moves or time.monotonic() > watch.began + 3.0, "the base stands, or 3 s have passed"
    )
    progress = client.progress()
    watch.until(mix.back, "all workers are back")

    def drives() -> object:
        return client.progress() > progress and mix.driving() and watch.base.moves

    watch.until(lambda: client.end() or drives(), "the drive continues")
    assert client.end() == "", f"its goal ended: {client.end()} ({client.why()}); {watch}"
    wait(watch, time.monotonic() - watch.began + 1.5)
    # it stands for a moment if the controller was not scheduled for half a second
    watch.until(lambda: client.end() or watch.base.moves, "the base moves")
    assert client.end() == "", f"its goal ended: {client.end()} ({client.why()}); {watch}"
    watch.close()
    client.cancel()
    watch.until(lambda: client.end() == "canceled", "its goal is canceled", STANDS_SECONDS)
    assert_ends_once(watch)


@thorough
@pytest.mark.parametrize("shared_mix", [pytest.param(PATIENT, id="patient")], indirect=True)
def test_stop_after_the_ros2_worker_was_killed(mix: Mix) -> None:
    watch = drive_in(mix, ZENOH)
    kill_workers("ros2")(mix)
    wait(watch, 0.3)
    assert_stops(watch, YARP, ZENOH, through="ros2")
    assert_ends_once(watch)
