"""``midspan map explore`` as a whole: the command, and a daemon with simulator, Mapper2D, planner and driver.

Everything runs in lock-step, so that a busy machine only takes longer.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from bridge.client.services import ServiceClient
from tests.peers.daemon.midspan import MidspanDaemon
from tests.peers.daemon.routers import end_router
from tests.peers.hub.node import HubNode
from tests.support.wait import until

pytestmark = pytest.mark.thorough

WALLS = [
    [[0, 0], [5, 0], [5, 3], [0, 3], [0, 0]],
    [[2.4, 1.2], [2.4, 3]],
    [[3.6, 0], [3.6, 1.8]],
]
"""A floor of 15 square meters, whose walls form an S."""

MODULES = ("base_control", "robot_goto", "robot_path_planner", "mapper2d")
STEP = 0.1
SECONDS = 60.0


class Floor:
    """The daemon on a floor, and the program that advances the time."""

    def __init__(self, folder: Path) -> None:
        plan = folder / "floor.yaml"
        plan.write_text(yaml.safe_dump({"walls": WALLS, "start": [1.0, 1.0, 0.0]}))
        self.midspan = MidspanDaemon(folder, "explorer")
        modules: dict[str, Any] = {name: {"enabled": True} for name in MODULES}
        modules["mapper2d"]["topic"] = "/map"
        self.midspan.configure(
            **{side: {"enabled": False} for side in ("ros1", "ros2", "yarp")},
            clock={"source": "sim"},
            sim={
                "enabled": True,
                "plan": str(plan),
                "drive": "wheels",
                "speed": "step",
                "laser": {"noise": 0.005},
                "encoders": {"scale": [0.006, -0.004], "noise": 0.01},
            },
            navigation={"planner": "robot_path_planner", "map": "/map"},
            modules=modules,
        )
        self.midspan.run()
        self.node = HubNode(self.midspan.settings("stepper"))
        self._client: ServiceClient = self.node.on(lambda: self.node.node.client("/sim/step", "midspan_msgs/srv/Step"))
        until(lambda: self._client.ready, "the simulator is on the hub", SECONDS)
        # the clock and its acknowledgements are lost until the modules and the simulator know each other
        until(lambda: self._reply(patience=1.0)["success"], "the modules follow the steps", SECONDS)

    def step(self) -> None:
        """Advance the time by one step, and wait until all modules have finished it."""
        reply = self._reply(SECONDS)
        assert reply["success"], reply

    def _reply(self, patience: float) -> Any:
        """Return the reply to a step, for whose end the simulator waits at most this many seconds."""
        answered, replies = threading.Event(), list[Any]()
        request = {"seconds": STEP, "wait_for": list(MODULES), "patience": patience}

        def on_reply(reply: Any) -> None:
            replies.append(reply)
            answered.set()

        self.node.on(lambda: self._client.call(request, on_reply))
        assert answered.wait(2 * SECONDS)
        return replies[0]

    def close(self) -> None:
        self.node.close()
        self.midspan.stop_daemon()
        end_router(self.midspan.folder / "state")


@pytest.fixture
def floor(tmp_path: Path) -> Iterator[Floor]:
    started = Floor(tmp_path)
    yield started
    started.close()


def test_an_unknown_floor_is_explored_until_it_is_complete(floor: Floor) -> None:
    floor.step()
    with floor.midspan.midspan("map", "explore", "--json") as verb:
        while verb.popen.poll() is None:
            floor.step()
        lines = [json.loads(line) for line in verb.output().splitlines() if line.startswith("{")]
        assert verb.popen.returncode == 0, verb.output()
    *goals, end = lines
    assert (end["status"], end["reached"]) == ("complete", end["goals"])
    assert len(goals) == end["goals"] >= 2, "a single view cannot show the whole floor"
    assert 12.0 < end["area"] < 15.0, "the area counts only free cells within the walls"
    daemon = floor.midspan.daemon
    assert daemon is not None
    assert "TF_REPEATED_DATA" not in daemon.output()
