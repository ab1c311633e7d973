"""A robot that drives to a goal of the gateway, and a planner that can disappear."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from navigation.status import State
from tests.peers.hub.calls import Calling
from tests.peers.navigation.gateway import SECONDS, ClientGoal, Rig, pose
from tests.peers.navigation.odometry import Odometry
from tests.peers.zenoh.rmw_action_server import RmwActionServer
from tests.support.wait import until

MAY_MOVE = "the robot may still be moving"
SPEED = 0.3


class Scene:
    """The gateway with a planner on the hub, and the base's odometry.

    Attributes:
        planner: the planner's action server, as a bridge worker would announce it.
        base: the base's odometry; `Odometry.speed` sets the base's speed.
    """

    def __init__(self, rig: Rig, planner: RmwActionServer, base: Odometry) -> None:
        self.rig, self.planner, self.base = rig, planner, base
        self._first = len(rig.statuses)

    def goal(self, count: int = 1) -> bytes:
        """Return the ID of goal number ``count`` once the planner executes it and the gateway waits for its result."""
        until(lambda: len(self.planner.goals) >= count, f"the planner has goal {count}", SECONDS)
        goal = self.planner.goals[count - 1]
        until(lambda: self.planner.waits(goal), "the gateway waits for the goal's result", SECONDS)
        return goal

    def drive(self, x: float = 5.0, **more: Any) -> ClientGoal:
        """Send a goal as a client, and return it once the robot drives."""
        count = len(self.planner.goals)
        client_goal = ClientGoal(self.rig.client, pose(x, **more))
        self.goal(count + 1)
        self.rig.state(State.MOVING)
        return client_goal

    def moves(self) -> None:
        """Make the base move, and wait until the gateway's odometry shows it."""
        self.base.speed = SPEED
        until(lambda: self.rig.gateway.motion.is_standing() is False, "odometry shows that the base moves", SECONDS)

    def stands(self) -> None:
        """Make the base stand, and wait until the gateway's odometry shows it."""
        self.base.speed = 0.0
        until(lambda: self.rig.gateway.motion.is_standing() is True, "odometry shows that the base stands", SECONDS)

    def begin(self, service: str) -> Calling:
        """Call a service of the gateway without waiting for its reply."""
        return self.rig.far.call(f"/navigation/{service}", "std_srvs/Trigger")

    def restart(self) -> int:
        """Restart the gateway, as if the modules' worker had been killed.

        Return how many statuses the old gateway published.
        """
        return _restart(self.rig)

    def reported(self, client_goal: ClientGoal) -> dict[str, Any]:
        """Return the first status published for a client's goal."""

        def find() -> dict[str, Any] | None:
            matching = (status for status in self.rig.statuses if bytes(status["goal_id"]) == client_goal.sent.id)
            return next(matching, None)

        status: dict[str, Any] = until(find, "the goal has a status", SECONDS)
        return status

    def states(self, begin: int = 0) -> set[str]:
        """Return the states published since the status with index ``begin``."""
        return {status["state"] for status in self.rig.statuses[begin:]}

    def check(self) -> None:
        """Check that no published reason contains "may still be moving" or "is not available" twice."""
        for status in self.rig.statuses[self._first :]:
            assert status["reason"].count("may still be moving") <= 1, status
            assert status["reason"].count("is not available") <= 1, status


@contextmanager
def scene(rig: Rig, planner: str, *, lists: bool) -> Iterator[Scene]:
    """Set up a scene with a moving base; with ``lists``, the planner publishes its goal list from the start."""
    action = f"/planner/{planner}/navigate_to_pose"
    server = RmwActionServer(rig.hubs.endpoint, rig.hubs.domain, planner, action, lists=lists)
    try:
        with Odometry(rig.far) as base:
            driving = Scene(rig, server, base)
            until(lambda: rig.gateway.link.reachable, "the planner is reachable", SECONDS)
            driving.moves()
            yield driving
            driving.check()
            base.speed, base.silent = 0.0, False
            server.cancels = True
            server.cancel()
            until(lambda: rig.ask("stop") and not rig.gateway.driving, "no goal is active", SECONDS)
    finally:
        server.close()
        _restart(rig)


def _restart(rig: Rig) -> int:
    running = rig.worker.running("gateway")
    running.stop()
    published = len(rig.statuses)
    running.start()
    return published
