"""The whole chain from a goal to the wheels: `midspan run` with simulator, controllers, planner and gateway.

Everything is part of Midspan, on one machine. The client is a separate program on the hub. The simulator publishes the
true pose.
"""

from __future__ import annotations

import math
import os
import signal
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from bridge.hub.endpoints.calls import CallError
from bridge.hub.session import HubSettings
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.actions import GoalState
from sim import export
from sim.plan import load_plan
from tests.peers.daemon.midspan import MidspanDaemon
from tests.peers.hub.node import HubNode
from tests.peers.navigation.gateway import pose
from tests.support.missing import COMPILER, DART, need
from tests.support.ports import free_port
from tests.support.process import DAEMON_SECONDS
from tests.support.wait import until

MODULES = ("base_control", "map2d_server", "localization_server", "robot_goto", "robot_path_planner")
NAVIGATE, STATUS = "nav2_msgs/action/NavigateToPose", "midspan_msgs/msg/NavigationStatus"
_KEPT = Qos(durability=Durability.TRANSIENT_LOCAL, depth=10)
_STILL = 0.01
"""m/s and rad/s below which the robot counts as standing."""


@dataclass
class Truth:
    """The robot's true state: seconds of the simulation (or of the machine, at speed 1), meters, rad, m/s, rad/s."""

    time: float
    x: float
    y: float
    theta: float
    speed: float
    turning: float

    @property
    def still(self) -> bool:
        """Return whether the robot stands."""
        return self.speed < _STILL and abs(self.turning) < _STILL


@dataclass
class SentGoal:
    """A goal of the client, with its feedback and result."""

    began: float = field(default_factory=time.monotonic)
    accepted: bool | None = None
    feedback: list[dict[str, Any]] = field(default_factory=list)
    status: GoalState | None = None
    reason: str = ""
    code: int = 0
    ended: float | None = None
    sent: Any = None


class Client(HubNode):
    """A program on the hub that sends goals and calls services."""

    def __init__(self, settings: HubSettings) -> None:
        super().__init__(settings)
        self._action = self.node.action_client("/navigate_to_pose", NAVIGATE)
        self._services: dict[str, Any] = {}

    def goto(self, x: float, y: float, degrees: float, *, seconds: float = 30.0) -> SentGoal:
        """Send a goal once the action is available."""
        until(lambda: self._action.ready, "the gateway serves the action", seconds)
        sent_goal = SentGoal()

        def ended(sent: Any, result: Mapping[str, Any] | None, reason: str) -> None:
            ended_at = time.monotonic()
            sent_goal.reason = str((result or {}).get("error_msg", "")) or reason
            sent_goal.code = int((result or {}).get("error_code", 0))
            sent_goal.status = sent.status
            sent_goal.ended = ended_at  # last, because tests wait for it on another thread

        def send() -> None:
            goal = {"pose": pose(x, y, math.radians(degrees))}
            sent_goal.sent = self._action.send(goal, ended, sent_goal.feedback.append)

        self.loop.call(send)
        return sent_goal

    def cancel(self, sent_goal: SentGoal) -> None:
        """Cancel a goal."""
        self.loop.call(sent_goal.sent.cancel)

    def call(self, name: str, kind: str, /, *, patience: float = 20.0, **request: Any) -> dict[str, Any]:
        """Call a service."""
        client = self._services.get(name)
        if client is None:
            client = self._services[name] = self.loop.call(lambda: self.node.client(name, kind))
        until(lambda: client.ready, f"{name} is served", 40)
        done, replies = threading.Event(), []

        def replied(reply: dict[str, Any] | CallError) -> None:
            replies.append(reply)
            done.set()

        self.loop.call(lambda: client.call(request, replied))
        assert done.wait(patience), f"no reply from {name}"
        reply = replies[0]
        assert not isinstance(reply, CallError), f"{name}: {reply}"
        return reply


class Chain(MidspanDaemon):
    """The deployment, and a client that records the navigation status and the true pose.

    Args:
        folder: for the deployment's files.
        speed: of the simulation, relative to real time.
        sim: further keys of the section ``sim``.
        sections: further sections of the configuration.
    """

    def __init__(
        self, folder: Path, *, speed: float = 1.0, sim: Mapping[str, Any] | None = None, **sections: Any
    ) -> None:
        for reason in (DART, COMPILER):
            need(reason)
        super().__init__(folder, "chain")
        self.plan = load_plan((sim or {}).get("plan", "apartment"), 0.05)
        floor = self.plan.floors[self.plan.first]
        self.places = floor.places
        export.save(self.plan, folder / "maps")
        simulated = speed != 1.0
        modules: dict[str, Any] = {name: {"enabled": True} for name in MODULES}
        modules["localization_server"]["initial_pose"] = list(floor.start)
        modules["robot_goto"]["max_waiting_time"] = modules["robot_path_planner"]["max_waiting_time"] = 8.0
        for name, more in sections.pop("modules", {}).items():
            modules[name] = {**modules.get(name, {}), **more}
        self.names = free_port()
        self.config: dict[str, Any] = {
            "hub": {"listen": self.endpoint},
            "ros1": {"enabled": False},
            "ros2": {"enabled": False},
            "yarp": {
                "address": f"127.0.0.1:{self.names}",
                "namespace": "/chain",
                "nameserver": "embedded",
                "ip": "127.0.0.1",
            },
            "sim": {"enabled": True, "plan": "apartment", "drive": "wheels", "speed": speed, **(sim or {})},
            "store": {
                "maps": str(folder / "maps" / "maps_collection.ini"),
                "locations": str(folder / "maps" / "locations.ini"),
            },
            "clock": {"source": "sim" if simulated else "system"},
            "navigation": {"planner": "robot_path_planner"},
            **sections,
            "modules": modules,
        }
        self._clients: list[Client] = []
        self.truth: Truth | None = None
        self.statuses: list[tuple[float, str, str]] = []

    def start(self) -> None:
        """Start the daemon, and a client that records the navigation status and the true pose."""
        self.write()
        self.run()
        self.client = self.join("client")
        self.listen(self.client, self.client)

    def listen(self, client: Client, watcher: Client) -> None:
        """Record the status that the client receives, and the true pose that the watcher receives."""
        watcher.node.subscription("/ground_truth", "nav_msgs/msg/Odometry", self._true, Qos(depth=1))
        client.node.subscription("/navigation/status", STATUS, self._on_status, _KEPT)

    def output(self) -> str:
        """Return the end of the daemon's log."""
        return self.daemon.output()[-8000:] if self.daemon else ""

    def write(self) -> None:
        """Write the configuration."""
        self.configure(**self.config)

    def join(self, name: str, router: str = "") -> Client:
        """Return a client on the hub once it runs; with a router's endpoint, the client uses only that router."""
        zenoh = {"mode": "client"} if router else None
        router = router or self.endpoint
        settings = HubSettings(router=router, zenoh=zenoh, node=name, daemon="far", worker=name, shared_memory=False)
        client: Client = until(lambda: _opened(settings), "the hub runs", 40, every=0.2)
        self._clients.append(client)
        return client

    def _true(self, message: dict[str, Any]) -> None:
        pose, twist, stamp = message["pose"]["pose"], message["twist"]["twist"], message["header"]["stamp"]
        turn = pose["orientation"]
        self.truth = Truth(
            stamp["sec"] + stamp["nanosec"] / 1e9,
            pose["position"]["x"],
            pose["position"]["y"],
            2.0 * math.atan2(turn["z"], turn["w"]),
            math.hypot(twist["linear"]["x"], twist["linear"]["y"]),
            twist["angular"]["z"],
        )

    def _on_status(self, message: dict[str, Any]) -> None:
        self.statuses.append((time.monotonic(), message["state"], message["reason"]))

    # -- actions

    def goto(self, name: str, **more: Any) -> SentGoal:
        """Send the robot to a place of the floor plan."""
        return self.client.goto(*self.places[name], **more)

    def distance_to(self, name: str) -> float:
        """Return the robot's distance to a place, in meters."""
        truth = self.truth
        return math.inf if truth is None else math.dist((truth.x, truth.y), self.places[name][:2])

    def fail(self, name: str) -> None:
        """Inject a sensor fault."""
        assert self.client.call("/sim/fail", "midspan_msgs/srv/Named", name=name)["success"]

    def mend(self, name: str) -> None:
        """Remove a sensor fault."""
        assert self.client.call("/sim/mend", "midspan_msgs/srv/Named", name=name)["success"]

    def teleport(self, x: float, y: float, degrees: float) -> None:
        """Move the robot to a pose."""
        pose = {"x": x, "y": y, "theta": math.radians(degrees)}
        reply = self.client.call("/sim/teleport", "midspan_msgs/srv/Teleport", pose=pose)
        assert reply["success"], reply

    def kill(self, worker: str) -> int:
        """Kill a worker's process, and return its process id."""
        pid = int(until(lambda: self.status(worker).get("pid"), f"{worker} reports its process id"))
        os.kill(pid, signal.SIGKILL)
        return pid

    # -- observations

    def status(self, name: str) -> dict[str, Any]:
        """Return the status of a module or worker, or an empty one if it does not reply."""
        answers = self.client.hub.ask("status", {}, worker=name, timeout=2.0)
        return next((a.value for a in answers if isinstance(a.value, dict)), {})

    def until(self, condition: Callable[[], Any], what: str, seconds: float = 30.0) -> float:
        """Wait for a condition, and return how many seconds that took."""
        began = time.monotonic()
        until(condition, what, seconds, every=0.01)
        return time.monotonic() - began

    def until_moving(self, seconds: float = 40.0) -> float:
        """Wait until the robot drives."""
        return self.until(lambda: self.truth is not None and self.truth.speed > 0.1, "the robot drives", seconds)

    def until_still(self, seconds: float = 20.0) -> float:
        """Wait until the robot stands."""
        return self.until(lambda: self.truth is not None and self.truth.still, "the robot stands", seconds)

    def statuses_since(self, since: float) -> list[tuple[str, str]]:
        """Return the states and reasons that the client has received since a time (monotonic)."""
        return [(state, reason) for received_at, state, reason in self.statuses if received_at >= since]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        for client in self._clients:
            client.stop()
        if self.daemon is not None:
            if kind is not None:
                print(self.daemon.output()[-12000:])
            self.daemon.stop(DAEMON_SECONDS)


def _opened(settings: HubSettings) -> Client | None:
    try:
        return Client(settings)
    except Exception:
        return None
