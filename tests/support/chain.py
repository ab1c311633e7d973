"""The whole way from a goal to the wheels: `midspan run` with simulator, base control, localizer, planner and gateway.

One machine, Midspan alone. Who asks is a program of its own on the hub; where the robot truly is says the simulator.
"""

from __future__ import annotations

import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import yaml

from bridge.clock import SYSTEM
from bridge.hub.endpoints.calls import CallError
from bridge.hub.session import Hub, HubSettings
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.actions import GoalState
from bridge.messages.registry import Registry
from bridge.modules.host import ModuleNode
from bridge.modules.loop import EventLoop
from sim import export
from sim.plan import load_plan
from tests.support.forks import DAEMON
from tests.support.missing import COMPILER, DART, need
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.wait import until

MODULES = ("base_control", "map2d_server", "localization_server", "robot_goto", "robot_path_planner")
NAVIGATE, STATUS = "nav2_msgs/action/NavigateToPose", "midspan_msgs/msg/NavigationStatus"
_KEPT = Qos(durability=Durability.TRANSIENT_LOCAL, depth=10)
_STILL = 0.01
"""m/s and rad/s below which wheels stand still."""


@dataclass
class Truth:
    """Where the robot truly is: seconds of the simulation (of the machine at speed 1), meters, rad, m/s, rad/s."""

    time: float
    x: float
    y: float
    theta: float
    speed: float
    turning: float

    @property
    def still(self) -> bool:
        """Whether it stands."""
        return self.speed < _STILL and abs(self.turning) < _STILL


@dataclass
class Asked:
    """A goal that the client sent, and what it heard of it."""

    began: float = field(default_factory=time.monotonic)
    accepted: bool | None = None
    feedback: list[dict[str, Any]] = field(default_factory=list)
    status: GoalState | None = None
    reason: str = ""
    code: int = 0
    ended: float | None = None
    sent: Any = None


class Client:
    """A program on the hub that gives goals and listens."""

    def __init__(self, settings: HubSettings) -> None:
        self._loop = EventLoop("client")
        self.hub = Hub.open(settings)
        self.node = ModuleNode(self.hub, Registry(), self._loop, SYSTEM)
        self._loop.start()
        self._action = self.node.action_client("/navigate_to_pose", NAVIGATE)
        self._services: dict[str, Any] = {}

    def goto(self, x: float, y: float, degrees: float, *, seconds: float = 30.0) -> Asked:
        """Send a goal, once there is somebody to send it to."""
        until(lambda: self._action.ready, "the gateway is there", seconds)
        half = math.radians(degrees) / 2
        turn = {"x": 0.0, "y": 0.0, "z": math.sin(half), "w": math.cos(half)}
        pose = {"position": {"x": x, "y": y, "z": 0.0}, "orientation": turn}
        asked = Asked()

        def ended(sent: Any, result: Mapping[str, Any] | None, why: str) -> None:
            asked.ended = time.monotonic()
            asked.reason = str((result or {}).get("error_msg", "")) or why
            asked.code = int((result or {}).get("error_code", 0))
            asked.status = sent.status

        def send() -> None:
            goal = {"pose": {"header": {"frame_id": "map"}, "pose": pose}}
            asked.sent = self._action.send(goal, ended, asked.feedback.append)

        self._loop.call(send)
        return asked

    def cancel(self, asked: Asked) -> None:
        """Cancel a goal."""
        self._loop.call(asked.sent.cancel)

    def call(self, name: str, kind: str, /, *, patience: float = 20.0, **request: Any) -> dict[str, Any]:
        """Call a service."""
        client = self._services.get(name)
        if client is None:
            client = self._services[name] = self._loop.call(lambda: self.node.client(name, kind))
        until(lambda: client.ready, f"{name} is there", 40)
        done, found = threading.Event(), []

        def replied(reply: dict[str, Any] | CallError) -> None:
            found.append(reply)
            done.set()

        self._loop.call(lambda: client.call(request, replied))
        assert done.wait(patience), f"{name} has not answered"
        reply = found[0]
        assert not isinstance(reply, CallError), f"{name}: {reply}"
        return reply

    def stop(self) -> None:
        """Leave the hub."""
        self.node.close()
        self._loop.close()
        self.hub.close()


class Chain:
    """The deployment, and a client that watches.

    Args:
        folder: for its files.
        speed: of the simulation.
        sim: more of the section ``sim``.
        sections: others of the configuration.
    """

    def __init__(
        self, folder: Path, *, speed: float = 1.0, sim: Mapping[str, Any] | None = None, **sections: Any
    ) -> None:
        for reason in (DART, COMPILER):
            need(reason)
        self.folder, self.port = folder, free_port()
        self.file, self.log = folder / "midspan.yaml", folder / "log"
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
            "name": "chain",
            "state": str(folder / "state"),
            "hub": {"listen": f"tcp/127.0.0.1:{self.port}"},
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
        self.daemon: Process | None = None
        self._clients: list[Client] = []
        self.truth: Truth | None = None
        self.heard: list[tuple[float, str, str]] = []

    def start(self) -> None:
        """Start the daemon, and hear what it says."""
        self.write()
        command = [sys.executable, "-m", "bridge.cli.main", "run", "--config", self.file]
        self.daemon = Process(command, imports=DAEMON)
        self.client = self.join("client")
        self.listen(self.client, self.client)

    def listen(self, client: Client, watcher: Client) -> None:
        """Hear what the client is told, and where the robot truly is from whoever watches it."""
        watcher.node.subscription("/ground_truth", "nav_msgs/msg/Odometry", self._true, Qos(depth=1))
        client.node.subscription("/navigation/status", STATUS, self._told, _KEPT)

    def output(self) -> str:
        """The last of the log."""
        return self.daemon.output()[-8000:] if self.daemon else ""

    def write(self) -> None:
        """Write the configuration."""
        self.file.write_text(yaml.safe_dump(self.config))

    def join(self, name: str, router: str = "") -> Client:
        """A client on the hub, as soon as that is there; with a router's endpoint over that alone."""
        zenoh = {"mode": "client"} if router else None
        router = router or f"tcp/127.0.0.1:{self.port}"
        settings = HubSettings(router=router, zenoh=zenoh, node=name, daemon="far", worker=name, shared_memory=False)
        made: Client = until(lambda: _opened(settings), "the hub is there", 40, every=0.2)
        self._clients.append(made)
        return made

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

    def _told(self, message: dict[str, Any]) -> None:
        self.heard.append((time.monotonic(), message["state"], message["reason"]))

    # what is done to it

    def goto(self, name: str, **more: Any) -> Asked:
        """Have it drive to a place of the plan."""
        return self.client.goto(*self.places[name], **more)

    def off(self, name: str) -> float:
        """Meters from the robot to a place."""
        truth = self.truth
        return math.inf if truth is None else math.dist((truth.x, truth.y), self.places[name][:2])

    def fail(self, name: str) -> None:
        """Have a sensor fail."""
        assert self.client.call("/sim/fail", "midspan_msgs/srv/Named", name=name)["success"]

    def mend(self, name: str) -> None:
        """Have it work again."""
        assert self.client.call("/sim/mend", "midspan_msgs/srv/Named", name=name)["success"]

    def teleport(self, x: float, y: float, degrees: float) -> None:
        """Stand the robot elsewhere."""
        pose = {"x": x, "y": y, "theta": math.radians(degrees)}
        reply = self.client.call("/sim/teleport", "midspan_msgs/srv/Teleport", pose=pose)
        assert reply["success"], reply

    def kill(self, worker: str) -> int:
        """End a worker's process as if it crashed; its process id."""
        pid = int(self.status(worker)["pid"])
        os.kill(pid, signal.SIGKILL)
        return pid

    # what is seen of it

    def status(self, name: str) -> dict[str, Any]:
        """What a module or worker tells of itself; nothing where it does not answer."""
        answers = self.client.hub.ask("status", {}, worker=name, timeout=2.0)
        return next((a.value for a in answers if isinstance(a.value, dict)), {})

    def until(self, condition: Callable[[], Any], what: str, seconds: float = 30.0) -> float:
        """Wait for something; the seconds that it took."""
        began = time.monotonic()
        until(condition, what, seconds, every=0.01)
        return time.monotonic() - began

    def until_moving(self, seconds: float = 40.0) -> float:
        """Until it drives."""
        return self.until(lambda: self.truth is not None and self.truth.speed > 0.1, "the robot drives", seconds)

    def until_still(self, seconds: float = 20.0) -> float:
        """Until the wheels stand."""
        return self.until(lambda: self.truth is not None and self.truth.still, "the robot stands", seconds)

    def said(self, since: float) -> list[tuple[str, str]]:
        """States and reasons that the client heard since a time (monotonic)."""
        return [(state, why) for at, state, why in self.heard if at >= since]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        for client in self._clients:
            client.stop()
        if self.daemon is not None:
            if kind is not None:
                print(self.daemon.output()[-12000:])
            self.daemon.stop()


def _opened(settings: HubSettings) -> Client | None:
    try:
        return Client(settings)
    except Exception:
        return None
