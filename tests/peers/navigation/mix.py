"""One daemon with a gateway, a client on each side, and several planners in turn, with real middlewares on both ends.

The configuration changes the planner while the daemon runs. "ours" is Midspan's RobotPathPlanner with RobotGoto, and a
robot without mass, so that the tests are fast. move_base and Nav2 are stand-ins that drive a base on their side.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from typing import Any, Self

from bridge.hub.wire.qos import LATCHED
from bridge.messages.actions import STATUSES, GoalState, names
from bridge.modules.endpoints import Subscription
from navigation.messages import stamp_ns
from navigation.status import STATUS
from tests.peers.daemon.deployment import Deployment
from tests.peers.hub.node import HubNode
from tests.peers.navigation.mix_clients import (
    COMMAND,
    ROS1,
    ROS2,
    SECONDS,
    YARP,
    ZENOH,
    Caller,
    Client,
    CommandLine,
    RosClient,
    YarpClient,
    ZenohClient,
)
from tests.peers.navigation.mix_truth import PEERS, Base, Nav2, released
from tests.peers.ros1.network import ROS1_PYTHON
from tests.peers.ros2.network import SHORT_LEASE
from tests.peers.sim.point_robot import PointRobot
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.wait import until
from yarp_compat.dev.client import ServiceClient
from yarp_compat.dev.inavigation2d import INavigation2DMsgs
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address

SPEED, PATIENCE = 2.0, 0.5
"""Of the stand-ins: speed in m/s, and seconds until an unreachable goal is aborted."""

MOST_KILLS = 4
"""Kills of one worker after which a test starts a new daemon: the pause before a restart, first 0.2 s, doubles."""

QUICK = {
    "max_lin_speed": SPEED,
    "max_lin_acc": 20.0,
    "lin_speed_gain": 3.0,
    "max_ang_speed": 360.0,
    "max_ang_acc": 7200.0,
    "ang_speed_gain": 4.0,
    "reaction": 0.1,
}
"""Settings of RobotGoto, whose robot has no mass."""

OURS, MOVE_BASE, NAV2 = "ours (RobotPathPlanner)", "move_base (actionlib server)", "Nav2 (ROS 2 action server)"
IDS = {OURS: "robot_path_planner", MOVE_BASE: "move_base", NAV2: "nav2"}
OWN = {(MOVE_BASE, ROS1), (NAV2, ROS2)}
"""Clients that use the planner directly: on their side, the gateway serves no action and does not pause goals."""


class Mix:
    """The daemon, its clients and the planner.

    Args:
        deployment: starts the daemon.
        planner: the first planner.
        navigation: further keys of the section ``navigation``.
        base: options of the base's program.
        base_side: the base's side, if it is not the planner's.
        cycle: seconds between two control cycles of move_base.
        nav2: arguments of `Nav2`.
    """

    def __init__(
        self,
        deployment: Deployment,
        planner: str = OURS,
        *,
        navigation: dict[str, Any] | None = None,
        base: Sequence[str] = (),
        base_side: str = "",
        cycle: float = 0.1,
        nav2: dict[str, Any] | None = None,
    ) -> None:
        self.deployment = deployment
        self._names = Address("127.0.0.1", free_port())
        self._navigation = {"patience": 60.0, **(navigation or {})}
        self._base_options, self._base_side, self._cycle = base, base_side, cycle
        self._nav2_options = {"lease": SHORT_LEASE, **(nav2 or {})}
        self.planner: Any = None
        self.kind = planner
        self._bases: dict[str, Base] = {}
        self._pids: dict[str, int] = {}
        self._kills: Counter[str] = Counter()
        self.masterless = False
        self._list: Subscription | None = None
        self.listed: dict[bytes, GoalState] = {}
        self.statuses: list[tuple[float, dict[str, Any]]] = []
        deployment.start(**self._sections(planner))
        self._hub = HubNode(deployment.settings("mix"))
        deployment.keep(Closing(self._hub))
        self._hub.node.subscription("/navigation/status", STATUS, self._on_status, LATCHED)
        self.clients = self._clients()
        self.callers: dict[str, Caller] = {**self.clients, COMMAND: CommandLine(deployment)}
        """The clients that can request a stop, by name."""

    @classmethod
    def over(cls, deployment: Deployment, planner: str, **options: Any) -> Self:
        """Return a mix with one planner, once the gateway can reach the planner."""
        mix = cls(deployment, planner, **options)
        mix.start(planner)
        mix.choose(planner)
        return mix

    def _sections(self, planner: str) -> dict[str, Any]:
        place = f"{self._names.host}:{self._names.port}"
        return {
            "yarp": {"nameserver": "embedded", "address": place, "poll": 0.3},
            "navigation": {"planner": IDS[planner], "map": "/map", **self._navigation},
            "store": {"enabled": True},
            "modules": {
                "robot_path_planner": {"enabled": planner == OURS, "scan": ""},
                "robot_goto": {"enabled": planner == OURS, **QUICK},
            },
        }

    def _clients(self) -> dict[str, Client]:
        ros1, ros2 = self.deployment.ros1("client1"), self.deployment.ros2("client2")
        return {
            YARP: YarpClient(self._remote(), self._remote()),
            ROS1: RosClient(ros1, "/move_base", "move_base_msgs/MoveBase", "target_pose"),
            ROS2: RosClient(ros2, "/navigate_to_pose", "nav2_msgs/NavigateToPose", "pose"),
            ZENOH: ZenohClient(self._hub, self.deployment.zenoh()),
        }

    def _remote(self) -> INavigation2DMsgs:
        port, naming = "/navigationServer/rpc", NameClient(self._names, namespace="/root")
        until(lambda: connections.exists(naming, port), f"{port} is open", SECONDS)
        client = ServiceClient(INavigation2DMsgs, port, naming=naming, timeout=SECONDS)
        self.deployment.keep(Closing(client.open()))
        return client.remote

    # -- planners ------------------------------------------------------------------------------------------------------

    def start(self, planner: str) -> None:
        """Start a planner's programs, and the base that it drives."""
        speed, patience = str(SPEED), str(PATIENCE)
        if planner == OURS:
            self.planner = PointRobot(self.deployment.settings("robot"), (60.0, 6.0))
        elif planner == MOVE_BASE:
            self._have_base(planner)
            program = PEERS / "ros1" / "move_base.py"
            arguments = [speed, patience, "there", str(self._cycle)]
            self.planner = Process([ROS1_PYTHON, program, *arguments], self.deployment.master.env)
        else:
            self._have_base(planner)
            self.planner = Nav2(SPEED, PATIENCE, **self._nav2_options)
            until(self.planner.ready, "Nav2 is up", SECONDS)
        self.deployment.keep(self.planner)

    def _have_base(self, planner: str) -> None:
        if planner in self._bases:
            return
        env, options = self.deployment.master.env, self._base_options
        side = self._base_side or ("ros1" if planner == MOVE_BASE else "ros2")
        base = Base.ros1(env, *options) if side == "ros1" else Base.ros2(*options)
        self._bases[planner] = self.deployment.keep(base)

    def choose(self, planner: str) -> None:
        """Select the gateway's planner in the configuration, without a restart."""
        self.kind = planner
        self.deployment.configure(**self._sections(planner))
        self.deployment.hang_up()
        self._follow(IDS[planner])
        until(lambda: self._chosen(planner), f"{planner} is the planner", SECONDS, 0.2)

    def _chosen(self, planner: str) -> bool:
        workers = {worker.get("worker"): worker for worker in self.deployment.status()}
        requests = ["gateway", *([IDS[planner], "robot_goto"] if planner == OURS else [])]  # our planner needs its map
        running = all(workers.get(name, {}).get("state") == "running" for name in requests)
        return running and workers["gateway"]["planner"] == IDS[planner]

    def end(self) -> None:
        """Stop the planner's programs cleanly, because the ROS master would keep the names of killed programs."""
        self.planner.stop()
        if self.kind in self._bases:
            self._bases.pop(self.kind).stop()

    def recover(self) -> None:
        """Restart the planner without goals after a failed fault test."""
        if self.masterless:
            self.restart_ros1()
            return
        self.planner.stop(0)
        self.start(self.kind)

    def kill_master(self) -> None:
        """Kill roscore."""
        self.deployment.master.kill()
        self.masterless = True

    def restart(self) -> None:
        """Restart move_base; as the ROS master still lists the dead node, only the new one's output shows it is up."""
        self.start(MOVE_BASE)
        until(lambda: "ready" in self.planner.output(), "move_base is up again", SECONDS)

    def restart_navigator(self) -> None:
        """Restart bt_navigator. A ROS 2 action server publishes no status list before its first goal."""
        self.planner.start("bt_navigator")
        until(self.planner.ready, "bt_navigator is up again", SECONDS)
        self.listed = {}

    def repair(self) -> None:
        """Restart roscore if a test has killed it, and wait until all workers are back."""
        if self.masterless:
            self.restart_ros1()
        until(self.back, "all workers are back", SECONDS, every=0.1)

    def restart_ros1(self) -> None:
        """Restart roscore and all nodes, because rospy registers a node only once."""
        self.deployment.master.start()
        self.masterless = False
        self.planner.stop(0)
        self._bases.pop(MOVE_BASE).stop(0)
        client = self.clients[ROS1]
        assert isinstance(client, RosClient)
        client.peer.stop(0)
        self.restart()
        client.peer = self.deployment.ros1("client1")

    def released(self, since: float) -> float:
        """Return when the planner first released a goal after ``since`` (monotonic); infinity if it has not."""
        planner = self.planner.servers["bt_navigator"] if self.kind == NAV2 else self.planner
        return released(planner.output(), since)

    @property
    def base(self) -> Base:
        """Return the base on the planner's side."""
        return self._bases[self.kind]

    # -- the daemon ----------------------------------------------------------------------------------------------------

    def pid(self, worker: str) -> int:
        """Return the process ID of a worker that will be killed; `back` waits for all workers that are running now."""
        self._pids |= self.processes()
        self._kills[worker] += 1
        return self._pids[worker]

    @property
    def worn(self) -> bool:
        """Return whether kills would influence further drives.

        A client may still wait for a reply of the killed gateway, or know only the killed server of Nav2. Each kill of
        another worker doubles the pause before its next start.
        """
        kills = max(self._kills.values(), default=0)
        return bool(self._kills["gateway"]) or kills >= MOST_KILLS or (self.kind == NAV2 and self.planner.killed)

    def processes(self) -> dict[str, int]:
        """Return the process ID of each running worker."""
        return {str(worker.get("worker")): int(worker["pid"]) for worker in self.deployment.status() if "pid" in worker}

    def runs(self, worker: str) -> bool:
        """Return whether a worker is running and has joined its network."""
        return any(
            status.get("worker") == worker and status["state"] == "running" for status in self.deployment.status()
        )

    def back(self) -> bool:
        """Return whether all workers are running and the gateway can reach its planner."""
        return self._chosen(self.kind) and self.processes().keys() >= self._pids.keys()

    def _follow(self, planner: str) -> None:
        if self._list is not None:
            self._hub.on(lambda: self._hub.node.release(self._list))  # type: ignore[arg-type]
        self.listed = {}
        topic = names(f"/planner/{planner}/navigate_to_pose").status
        self._list = self._hub.on(lambda: self._hub.node.subscription(topic, STATUSES, self._on_list, LATCHED))

    def _on_list(self, message: dict[str, Any]) -> None:
        self.listed = {
            bytes(goal["goal_info"]["goal_id"]["uuid"]): GoalState(goal["status"]) for goal in message["status_list"]
        }

    def _on_status(self, message: dict[str, Any]) -> None:
        """Record a status with the time of its stamp, because this process may be starved, and receive it late."""
        late = time.time() - stamp_ns(message["header"]) / 1e9
        self.statuses.append((time.monotonic() - max(0.0, late), message))

    def driving(self) -> set[bytes]:
        """Return the goals that the planner is executing."""
        return {goal for goal, status in list(self.listed.items()) if not status.ended}

    def state(self) -> str:
        """Return the gateway's state."""
        return self.status()[0]

    def status(self) -> tuple[str, str]:
        """Return the gateway's state and its reason."""
        last = self.statuses[-1][1] if self.statuses else {"state": "", "reason": ""}
        return str(last["state"]), str(last["reason"])


class Closing:
    """An object with `close`, adapted to `Deployment.keep`."""

    def __init__(self, thing: Any) -> None:
        self._thing = thing

    def stop(self) -> None:
        """Close the object."""
        self._thing.close()
