"""The gateway in its worker, with planners and clients on the same hub."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

from bridge.client.actions import SentGoal
from bridge.clock import SYSTEM
from bridge.hub.wire.qos import Durability, Qos
from bridge.modules.action_server import Goal
from navigation.gateway import gateway as gateway_module
from navigation.gateway import stop
from navigation.messages import NAVIGATE
from navigation.status import STATUS, PlannerStatus, State, status_message
from tests.peers.hub.modules import Place
from tests.peers.hub.node import HubNode
from tests.support.wait import until
from yarp_compat.naming import connections
from yarp_compat.naming.server import NameServer

LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
SECONDS = 20.0


@contextmanager
def patient() -> Iterator[None]:
    """Let the gateway wait longer for a confirmation before it reports that a stop or pause is not confirmed.

    For tests in which each stop is confirmed, which takes a stalled machine longer than `stop.ANSWER_SECONDS`.
    """
    with patch.object(gateway_module, "ANSWER_SECONDS", 15.0), patch.object(stop, "ANSWER_SECONDS", 15.0):
        yield


def pose(x: float, y: float = 0.0, yaw: float = 0.0, frame: str = "map") -> dict[str, Any]:
    orientation = {"z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
    return {"header": {"frame_id": frame}, "pose": {"position": {"x": x, "y": y}, "orientation": orientation}}


class Planner(HubNode):
    """A planner that executes one goal at a time; the test ends each goal.

    Attributes:
        admits: handles a new goal, and returns whether the planner accepts it; the usual planner at first.
        cancels: handles a cancel request, and returns whether the planner accepts it; `cancel` at first.
    """

    def __init__(self, settings: Any, name: str) -> None:
        super().__init__(settings)
        self.goals: list[Goal] = []
        self.rejects = 0
        self.admits: Callable[[Goal], bool] = self._accept
        self.cancels: Callable[[Goal], bool] = self.cancel
        self.server = self.on(
            lambda: self.node.action_server(
                f"/planner/{name}/navigate_to_pose",
                NAVIGATE,
                lambda goal: self.admits(goal),
                lambda goal: self.cancels(goal),
            )
        )
        self._status = self.node.publisher(f"/planner/{name}/status", STATUS, LATCHED)

    def _accept(self, goal: Goal) -> bool:
        if self.rejects:
            self.rejects -= 1
            return False
        for previous in self.goals:
            previous.canceled({"error_msg": "another goal replaced it"})
        self.goals.append(goal)
        goal.execute()
        return True

    def cancel(self, goal: Goal) -> bool:
        """Accept the request, and end the goal as canceled at once."""
        self.loop.post(lambda: goal.canceled({"error_msg": "canceled"}))
        return True

    def until(self, count: int) -> Goal:
        """Wait for the planner's ``count``-th goal (from 1), and return it."""
        until(lambda: len(self.goals) >= count, f"the planner has goal {count}", SECONDS)
        return self.goals[count - 1]

    def publish_status(self, goal: Goal, state: State, reason: str, code: int = 0) -> None:
        """Publish the planner's status for a goal."""
        pose = goal.goal["pose"]
        status = status_message(SYSTEM.stamp(), PlannerStatus(state, reason, code), goal_id=goal.id, goal=pose)
        self.on(lambda: self._status.publish(status))

    def reach(self, goal: Goal) -> None:
        self.on(goal.succeed)

    def give_up(self, goal: Goal, reason: str, code: int = 20006) -> None:
        self.on(lambda: goal.abort({"error_code": code, "error_msg": reason}))


class ClientGoal:
    """A goal of an action client, with its feedback and result."""

    def __init__(
        self,
        program: HubNode,
        message: Any,
        action: str = "/navigate_to_pose",
        tree: str = "",
        *,
        kind: str = NAVIGATE,
        field: str = "pose",
    ) -> None:
        self.feedback: list[dict[str, Any]] = []
        self.ended = False
        self.result: dict[str, Any] | None = None
        client = program.on(lambda: program.node.action_client(action, kind))
        until(lambda: client.ready, f"{action} is served", SECONDS)
        self._program = program
        goal = {field: message, "behavior_tree": tree}
        self.sent: SentGoal = program.on(lambda: client.send(goal, self._end, self.feedback.append))

    def _end(self, _goal: SentGoal, result: dict[str, Any] | None, _reason: str) -> None:
        self.result, self.ended = result, True

    def cancel(self) -> None:
        self._program.on(self.sent.cancel)

    def end(self) -> tuple[str, str]:
        """Wait for the result; return the final status and the error message."""
        until(lambda: self.ended, "the client's goal has ended", SECONDS)
        return self.sent.status.name, (self.result or {}).get("error_msg", "")


class Rig(Place):
    """The modules worker, a name server, a client and planners; ``planner`` is robot_goto until a test changes it."""

    def __init__(self, folder: Path, **navigation: Any) -> None:
        super().__init__(folder)
        self.yarp = NameServer(port=self.port, gc_seconds=0)
        self.yarp.open()
        self.section = {"planner": "robot_goto", "patience": 60.0, **navigation}
        self.worker.start(self.configured())
        self.client = HubNode(self.hubs.settings("client"))
        self.planners: dict[str, Planner] = {}
        self.statuses: list[dict[str, Any]] = []
        self.client.node.subscription("/navigation/status", STATUS, self.statuses.append, LATCHED)
        self.planner = self.have("robot_goto")
        until(lambda: connections.exists(self.names, "/navigationServer/rpc"), "the ports are registered", 30)
        until(lambda: connections.exists(self.names, "/navigation2D_nws_yarp/rpc"), "the ports are registered", 30)

    def configured(self, **changed: Any) -> Any:
        self.section = {**self.section, **changed}
        return self.config(navigation=self.section)

    def have(self, name: str, settings: Any = None) -> Planner:
        """Start a planner; if it is the gateway's planner, wait until the gateway can reach it."""
        self.planners[name] = planner = Planner(settings or self.hubs.settings(name), name)
        until(lambda: self.gateway.planner != name or self.gateway.link.reachable, f"{name} is reachable", SECONDS)
        return planner

    @property
    def module(self) -> Any:
        """Return the gateway module; its worker runs in this process."""
        return self.worker.running("gateway").module

    @property
    def gateway(self) -> Any:
        return self.module.gateway

    def state(self, state: State, reason: str = "") -> dict[str, Any]:
        """Wait until the newest status has this state and its reason contains ``reason``; return the status."""

        def matching() -> dict[str, Any] | None:
            last = self.statuses[-1] if self.statuses else None
            return last if last and last["state"] == state.value and reason in last["reason"] else None

        try:
            status: dict[str, Any] = until(matching, f"the state {state.value} {reason}", SECONDS)
        except AssertionError as err:
            err.add_note(f"the last statuses: {self.statuses[-3:]}")
            raise
        return status

    def status_since(self, begin: int, state: State, reason: str) -> dict[str, Any]:
        """Wait for a status with this state and reason that only lasts for a moment, and return it.

        Unlike `state`, this finds a status that another one has replaced; ``begin`` is the index of the first one.
        """

        def matching() -> dict[str, Any] | None:
            statuses = self.statuses[begin:]
            return next((s for s in statuses if s["state"] == state.value and reason in s["reason"]), None)

        status: dict[str, Any] = until(matching, f"a status {state.value} {reason}", SECONDS)
        return status

    def ask(self, service: str, **request: Any) -> dict[str, Any]:
        """Call one of the gateway's services."""
        kind = {"choose_planner": "midspan_msgs/Named", "go_to": "midspan_msgs/Named",
                "get_location": "midspan_msgs/GetLocation"}.get(service, "std_srvs/Trigger")  # fmt: skip
        reply: dict[str, Any] = self.far.call(f"/navigation/{service}", kind, **request).result(SECONDS)["reply"]
        return reply

    def fresh(self) -> None:
        """Stop the robot and clear all goals."""
        until(lambda: self.ask("stop") and not self.gateway.driving, "no goal is active", SECONDS)
        # without this wait, a test could match a status of the previous test; the state may change while waiting
        current = lambda: self.gateway.state().state.value  # noqa: E731
        until(lambda: self.statuses and self.statuses[-1]["state"] == current(), "the client has the status", SECONDS)
        for planner in self.planners.values():
            planner.goals.clear()

    def close(self) -> None:
        for program in (self.client, *self.planners.values()):
            program.close()
        super().close()
        self.yarp.close()
