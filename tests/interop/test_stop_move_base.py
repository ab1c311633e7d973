"""Stops, pauses and goals while the path to ROS 1's move_base fails, checked against the base's own program."""

from __future__ import annotations

import time
from dataclasses import replace

import pytest

from tests.peers.navigation.mix import MOVE_BASE, OWN, Mix
from tests.peers.navigation.mix_clients import COMMAND, ROS1, ROS2, SECONDS, YARP, ZENOH, RosClient, ZenohClient
from tests.peers.navigation.mix_faults import (
    AWAY,
    FAULTS,
    STANDS_SECONDS,
    UNCONFIRMED,
    Watch,
    attempt,
    kill_workers,
    start_driving,
)
from tests.support.wait import until

GATEWAY = (YARP, ROS2, ZENOH)
"""Clients whose goals the gateway executes. They reach the gateway's services even if ROS 1 is unreachable."""

pytestmark = pytest.mark.parametrize(
    "shared_mix", [pytest.param({"planner": MOVE_BASE}, id="move_base")], indirect=True
)
thorough = pytest.mark.thorough


def drive(mix: Mix, client: str) -> Watch:
    """Let a client drive with move_base."""
    start_driving(mix, mix.clients[client])
    return Watch(mix, client, own=(MOVE_BASE, client) in OWN)


def wait_until_stands(watch: Watch, what: str = "the base stands") -> None:
    """Wait until the base stands."""
    watch.until(lambda: not watch.base.moves, what, STANDS_SECONDS)


def wait(watch: Watch, seconds: float) -> None:
    """Keep polling until this many seconds after the fault."""
    watch.until(lambda: time.monotonic() > watch.began + seconds, "the fault lasts for a while")


def cancel(watch: Watch) -> None:
    """Cancel the client's goal as usual; the goal ends once."""
    client = watch.mix.clients[watch.client]
    client.cancel()
    watch.until(lambda: client.end() == "canceled", "the client's goal is canceled", STANDS_SECONDS)
    wait_until_stands(watch)
    assert_ends_once(watch)


def assert_ends_once(watch: Watch) -> None:
    client = watch.mix.clients[watch.client]
    if isinstance(client, RosClient | ZenohClient):
        assert client.ends() == 1, f"the client's goal had {client.ends()} ends; {watch}"


def assert_refused_or_stands(watch: Watch) -> None:
    """Check that each answered stop is either confirmed or reported as unconfirmed."""
    for name, (_, answer) in watch.answers.items():
        assert not answer or answer == "not ok" or UNCONFIRMED in answer, f"{name} received {answer!r}; {watch}"


@thorough
@pytest.mark.parametrize("client", [ROS1, YARP, ROS2])
def test_stop_while_the_master_is_dead(mix: Mix, client: str) -> None:
    watch = drive(mix, client)
    watch.mix.kill_master()
    wait(watch, 1.0)
    watch.ask("stop", [*GATEWAY, COMMAND])
    assert_refused_or_stands(watch)
    wait_until_stands(watch, "the stop reaches move_base over the remaining connections")
    watch.until(
        lambda: watch.mix.state() in ("idle", "aborted"), "the status reports the end without a master", STANDS_SECONDS
    )
    watch.close()
    watch.ask("stop", [*GATEWAY, COMMAND])
    assert not any(answer for _, answer in watch.answers.values()), f"the base stands, and a stop failed; {watch}"
    if not watch.own:
        assert_ends_once(watch)


@thorough
def test_halt_while_the_master_is_dead(mix: Mix) -> None:
    watch = drive(mix, ROS1)
    watch.mix.kill_master()
    wait(watch, 0.5)
    halted = watch.mix.callers[COMMAND].ask("halt")
    watch.until(halted, "halt returns")
    watch.answers = {COMMAND: halted() or (0.0, "")}
    wait_until_stands(watch)
    watch.close()


@thorough
@pytest.mark.parametrize("client", [ROS1, ROS2])
def test_a_goal_is_followed_while_the_master_is_dead(mix: Mix, client: str) -> None:
    mix.clients[client].goto(6.0)
    until(lambda: mix.base.moves and mix.state() == "moving", "the base moves", SECONDS)
    watch = Watch(mix, client, own=client == ROS1)
    mix.kill_master()
    watch.until(lambda: mix.state() == "goal_reached", "the status shows that the goal is reached", STANDS_SECONDS)
    watch.until(lambda: mix.clients[client].end() == "succeeded", "the client's goal is reached", STANDS_SECONDS)
    watch.close()


@pytest.mark.parametrize("asks", [YARP, pytest.param(COMMAND, marks=thorough), pytest.param(ZENOH, marks=thorough)])
def test_pause_after_the_ros1_worker_was_killed(mix: Mix, asks: str) -> None:
    watch = drive(mix, YARP if asks == COMMAND else asks)
    kill_workers("ros1")(watch.mix)
    wait(watch, 0.3)
    watch.ask("pause", [asks])
    assert_refused_or_stands(watch)
    # on a busy machine, a restart takes longer than a pause
    watch.until(lambda: watch.mix.runs("ros1"), "ros1 has restarted")
    wait_until_stands(watch, "the pause is pending until it reaches move_base")
    watch.until(lambda: watch.mix.state() == "paused", "the navigation is paused", STANDS_SECONDS)
    watch.until(watch.mix.back, "all workers are back")
    assert not watch.base.moves, f"the pause is still pending; {watch}"
    watch.close()
    watch.ask("resume", [asks])
    watch.until(lambda: watch.base.moves, "the base keeps driving", STANDS_SECONDS)
    cancel(watch)


@pytest.mark.parametrize("client", [ZENOH, pytest.param(ROS2, marks=thorough)])
def test_the_ros1_worker_is_killed_as_the_robot_starts(mix: Mix, client: str) -> None:
    """Odometry that ended before the robot moved does not prove that the robot stands."""
    start_driving(mix, mix.clients[client], progress=1)
    watch = Watch(mix, client)
    kill_workers("ros1")(mix)
    wait(watch, 1.5)
    watch.close()
    watch.until(mix.back, "all workers are back")
    cancel(watch)


@thorough
@pytest.mark.parametrize("fault", ["planner hangs", "ros1 worker dies", "modules die", "ros1 and modules die"])
def test_stop_of_the_planners_own_goal(mix: Mix, fault: str) -> None:
    assert attempt(mix, replace(FAULTS[fault], stopped=True), ROS1, [], own=True) == "own"


@thorough
@pytest.mark.parametrize("client", [YARP, ROS1])
def test_stop_after_ros1_and_modules_were_killed(mix: Mix, client: str) -> None:
    """Excludes clients of the gateway's action: their goals end with its server, even if the robot drives on."""
    watch = drive(mix, client)
    kill_workers("ros1", "gateway")(watch.mix)
    end = time.monotonic() + 40.0
    while time.monotonic() < end:
        watch.ask("stop", GATEWAY, lost=True)  # calls fail at once while the gateway is missing
        if any(not answer for _, answer in watch.answers.values()):
            break
    assert any(not answer for _, answer in watch.answers.values()), f"no stop was confirmed; {watch}"
    watch.until(watch.mix.back, "all workers are back")
    watch.until(lambda: watch.mix.state() in ("idle", "aborted"), "the status shows no goal")
    watch.close()
    if not watch.own:
        assert_ends_once(watch)


@pytest.mark.parametrize("other", [YARP, pytest.param(ZENOH, marks=thorough)])
def test_new_goal_after_the_ros1_worker_was_killed(mix: Mix, other: str) -> None:
    watch = drive(mix, ROS2)
    first = watch.mix.clients[ROS2]
    assert isinstance(first, RosClient)
    watch.client = ""  # the first goal is canceled for the new one, and the robot may keep driving meanwhile
    kill_workers("ros1")(watch.mix)
    wait(watch, 0.3)
    watch.mix.clients[other].goto(AWAY / 2)
    watch.client = other
    watch.until(lambda: first.end() == "canceled", "the new goal replaces the first one")
    watch.until(watch.mix.back, "all workers are back")
    progress = watch.mix.clients[other].progress()
    watch.until(lambda: watch.mix.clients[other].progress() > progress and watch.base.moves, "the new goal is executed")
    watch.close()
    cancel(watch)
    assert first.ends() == 1, f"the first goal had {first.ends()} ends"
