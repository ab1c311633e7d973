"""A goal continues after Nav2's bt_navigator was killed and restarted."""

from __future__ import annotations

import pytest

from tests.interop.test_stop_nav2 import NO_NAVIGATOR, PATIENCE, assert_ends_once, drive_in, wait
from tests.peers.navigation.mix import Mix
from tests.peers.navigation.mix_clients import ROS1, YARP, ZENOH
from tests.peers.navigation.mix_faults import STANDS_SECONDS

SHORT_LEASE = {"navigation": {"patience": 2 * PATIENCE}}
"""This patience gives the new navigator 13 s to start, which is enough on a busy machine too."""

DEFAULT_LEASE = SHORT_LEASE | {"nav2": {"lease": {}}}
thorough = pytest.mark.thorough


@pytest.mark.parametrize("client", [ZENOH, *(pytest.param(name, marks=thorough) for name in (YARP, ROS1))])
@pytest.mark.parametrize(
    "shared_mix",
    [pytest.param(DEFAULT_LEASE, id="default"), pytest.param(SHORT_LEASE, id="short", marks=thorough)],
    indirect=True,
)
def test_bt_navigator_is_killed_and_restarted(mix: Mix, client: str) -> None:
    watch = drive_in(mix, client)
    mix.planner.kill("bt_navigator")
    gateway = mix.clients[client]
    watch.until(lambda: mix.statuses[-1][1]["error_code"] == NO_NAVIGATOR, "the planner is unreachable", STANDS_SECONDS)
    assert mix.state() == "moving", watch
    wait(watch, PATIENCE - 3.0)
    assert gateway.end() == "", f"the client's goal ended; {watch}"
    assert mix.state() == "moving", watch
    mix.restart_navigator()
    progress = gateway.progress()
    watch.until(lambda: gateway.progress() > progress and mix.driving(), "the client's goal continues")
    watch.close()
    gateway.cancel()
    watch.until(lambda: gateway.end() == "canceled", "the client's goal is canceled", STANDS_SECONDS)
    assert_ends_once(watch)
