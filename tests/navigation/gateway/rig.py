"""The gateway in its worker, planners and clients on its hub."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bridge.clock import SYSTEM
from bridge.hub.session import Hub
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.registry import Registry
from bridge.modules.action_server import Goal
from bridge.modules.clients import SentGoal
from bridge.modules.host import ModuleNode
from bridge.modules.loop import EventLoop
from navigation.messages import NAVIGATE
from navigation.status import STATUS, PlannerStatus, State, status_message
from tests.modules.place import Place
from tests.support.wait import until
from yarp_compat.naming import connections
from yarp_compat.naming.server import NameServer

LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
REGISTRY = Registry()
SECONDS = 20.0


def pose(x: float, y: float = 0.0, yaw: float = 0.0, frame: str = "map") -> dict[str, Any]:
    turn = {"z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
    return {"header": {"frame_id": frame}, "pose": {"position": {"x": x, "y": y}, "orientation": turn}}


class Program:
    """A program with a node on the hub."""

    def __init__(self, settings: Any) -> None:
        self.loop = EventLoop(settings.node)
        self.node = ModuleNode(Hub.open(settings), REGISTRY, self.loop, SYSTEM)
        self.loop.start()

    def on(self, action: Callable[[], Any]) -> Any:
        return self.loop.call(action, 20.0)

    def close(self) -> None:
        self.node.close()
        self.loop.close()
        self.node.hub.close()


class Planner(Program):
    """A planner of the kind that drives to one goal at a time; the test says how each ends.

    Attributes:
        cancels: what it does where a goal is to be cancelled, and whether it says that it will; `cancel` at first.
    """

    def __init__(self, settings: Any, name: str) -> None:
        super().__init__(settings)
        self.goals: list[Goal] = []
        self.rejects = 0
        self.cancels: Callable[[Goal], bool] = self.cancel
        self.server = self.on(
            lambda: self.node.action_server(
                f"/planner/{name}/navigate_to_pose", NAVIGATE, self._take, lambda goal: self.cancels(goal)
            )
        )
        self._told = self.node.publisher(f"/planner/{name}/status", STATUS, LATCHED)

    def _take(self, goal: Goal) -> bool:
        if self.rejects:
            self.rejects -= 1
            return False
        for before in self.goals:
            before.canceled({"error_msg": "another goal took its place"})
        self.goals.append(goal)
        goal.execute()
        return True

    def cancel(self, goal: Goal) -> bool:
        """Let go of it at once."""
        self.loop.post(lambda: goal.canceled({"error_msg": "canceled"}))
        return True

    def until(self, count: int) -> Goal:
        """The goal that came as the so manieth."""
        until(lambda: len(self.goals) >= count, f"goal {count} is at the planner", SECONDS)
        return self.goals[count - 1]

    def tell(self, goal: Goal, state: State, why: str, code: int = 0) -> None:
        told = status_message(SYSTEM.stamp(), PlannerStatus(state, why, code), goal_id=goal.id, goal=goal.goal["pose"])
        self.on(lambda: self._told.publish(told))

    def reach(self, goal: Goal) -> None:
        self.on(goal.succeed)

    def give_up(self, goal: Goal, why: str, code: int = 9006) -> None:
        self.on(lambda: goal.abort({"error_code": code, "error_msg": why}))


class Asked:
    """A goal of a client of an action, and what it heard."""

    def __init__(
        self, program: Program, message: dict[str, Any], action: str = "/navigate_to_pose", tree: str = ""
    ) -> None:
        self.feedback: list[dict[str, Any]] = []
        self.ended = False
        self.result: dict[str, Any] | None = None
        client = program.on(lambda: program.node.action_client(action, NAVIGATE))
        until(lambda: client.ready, f"{action} is served", SECONDS)
        self._program = program
        goal = {"pose": message, "behavior_tree": tree}
        self.sent: SentGoal = program.on(lambda: client.send(goal, self._end, self.feedback.append))

    def _end(self, _goal: SentGoal, result: dict[str, Any] | None, _why: str) -> None:
        self.result, self.ended = result, True

    def cancel(self) -> None:
        self._program.on(self.sent.cancel)

    def end(self) -> tuple[str, str]:
        """How it ended, and why."""
        until(lambda: self.ended, "the client's goal ended", SECONDS)
        return self.sent.status.name, (self.result or {}).get("error_msg", "")


class Rig(Place):
    """All of it; ``planner`` is the one that the configuration names."""

    def __init__(self, folder: Path, **navigation: Any) -> None:
        super().__init__(folder)
        self.yarp = NameServer(port=self.port, gc_seconds=0)
        self.yarp.open()
        self.section = {"planner": "robot_goto", "patience": 60.0, **navigation}
        self.worker.start(self.configured())
        self.client = Program(self.hubs.settings("client"))
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
        """Start a planner, and wait until the gateway finds it where it is the chosen one."""
        self.planners[name] = made = Planner(settings or self.hubs.settings(name), name)
        until(lambda: self.gateway.planner != name or self.gateway.link.reachable, f"{name} is found", SECONDS)
        return made

    @property
    def module(self) -> Any:
        """The module itself: the worker is in this process."""
        return self.worker.running("gateway").module

    @property
    def gateway(self) -> Any:
        return self.module.gateway

    def state(self, state: State, why: str = "") -> dict[str, Any]:
        """The newest status, once it is this one."""

        def there() -> dict[str, Any] | None:
            last = self.statuses[-1] if self.statuses else None
            return last if last and last["state"] == state.value and why in last["reason"] else None

        try:
            found: dict[str, Any] = until(there, f"the state {state.value} {why}", SECONDS)
        except AssertionError as err:
            err.add_note(f"the last ones: {self.statuses[-3:]}")
            raise
        return found

    def ask(self, service: str, **request: Any) -> dict[str, Any]:
        """Call one of the gateway's services."""
        kind = {"choose_planner": "midspan_msgs/Named", "go_to": "midspan_msgs/Named",
                "get_location": "midspan_msgs/GetLocation"}.get(service, "std_srvs/Trigger")  # fmt: skip
        reply: dict[str, Any] = self.far.call(f"/navigation/{service}", kind, **request).result(SECONDS)["reply"]
        return reply

    def fresh(self) -> None:
        """No goals anywhere."""
        until(lambda: self.ask("stop") and not self.gateway.driving, "nothing drives", SECONDS)
        now = self.gateway.state()[0].value  # else the last test's status might be taken for this one's
        until(lambda: self.statuses and self.statuses[-1]["state"] == now, "the client knows", SECONDS)
        for planner in self.planners.values():
            planner.goals.clear()

    def close(self) -> None:
        for program in (self.client, *self.planners.values()):
            program.close()
        super().close()
        self.yarp.close()
