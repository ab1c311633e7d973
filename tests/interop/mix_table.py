"""Clients of every side over planners of every side, by one daemon's gateway, with real middlewares on both ends.

``python -m tests.interop.mix_table [--json FILE]`` (`make mix`) prints the table; the test beside it does the same. The
planner is changed by the configuration while the daemon runs. "ours" is Midspan's RobotPathPlanner over its RobotGoto;
their robot has no body, so that it is quick. move_base and Nav2 are stand-ins.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from bridge.hub.wire.qos import LATCHED
from bridge.messages.actions import STATUSES, GoalState, names
from bridge.modules.endpoints import Subscription
from navigation.status import STATUS
from tests.interop import mix_faults
from tests.interop.deployment import Deployment
from tests.interop.mix_clients import SECONDS, Client, RosClient, YarpClient, ZenohClient
from tests.interop.mix_faults import FAULTS, Base, Watch
from tests.navigation.gateway.rig import Program, pose
from tests.support.point_robot import PointRobot
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.ros1 import ROS1_PYTHON
from tests.support.ros2 import SHORT_LEASE, ros2_environment, ros2_python
from tests.support.wait import until
from yarp_compat.dev.client import ServiceClient
from yarp_compat.dev.inavigation2d import INavigation2DMsgs
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address

SPEED, PATIENCE = 2.0, 0.5
"""Of the stand-ins: m/s, and seconds until a goal that cannot be reached is given up."""

NEAR, FAR, NOWHERE = 1.0, 40.0, 999.0
"""Goals, metres along x: one that is soon reached, one that is not, and one that cannot be."""

QUICK = {
    "max_lin_speed": SPEED,
    "max_lin_acc": 20.0,
    "lin_speed_gain": 3.0,
    "max_ang_speed": 360.0,
    "max_ang_acc": 7200.0,
    "ang_speed_gain": 4.0,
    "reaction": 0.1,
}
"""Of RobotGoto, whose robot has no weight."""

PARTS = ("goto", "feedback", "pause", "resume", "cancel", "abort")
YARP, ROS1, ROS2, ZENOH = "YARP INavigation2D", "ROS 1 actionlib", "ROS 2 action", "zenoh (hub) action"
OURS, MOVE_BASE, NAV2 = "ours (RobotPathPlanner)", "move_base (actionlib server)", "Nav2 (ROS 2 action server)"
WHY = {OURS: "is off the map", MOVE_BASE: "Failed to find a valid plan.", NAV2: "no valid path to the goal"}
"""What each says of a goal that cannot be reached."""

IDS = {OURS: "robot_path_planner", MOVE_BASE: "move_base", NAV2: "nav2"}
OWN = {(MOVE_BASE, ROS1), (NAV2, ROS2)}
"""Clients that speak to the planner itself: the gateway has no door there, and pauses nothing of theirs."""

ONE_EACH = {"planner dies": (YARP,), "planner hangs": (ROS2,), "ros1 worker dies": (ZENOH,), "modules die": (YARP,)}
"""Clients that the test tries each fault with; ``make mix`` tries all."""


@dataclass(frozen=True)
class Cell:
    """One part of what a client does, over one planner: ``yes``, ``own`` (the planner's own door), or what failed."""

    planner: str
    client: str
    part: str
    seen: str
    seconds: float
    """What it took; of a fault, how long at most the robot was said to stand while it moved."""
    note: str = ""
    """What the client saw of a fault."""

    @property
    def good(self) -> bool:
        """Whether it is as it should be."""
        own = (self.planner, self.client) in OWN and self.part in ("pause", "resume", *FAULTS)
        return self.seen == ("own" if own else "yes")


class Mix:
    """One daemon with a gateway, a client on each side, and one planner after the other."""

    def __init__(self, deployment: Deployment) -> None:
        self.deployment = deployment
        self._names = Address("127.0.0.1", free_port())
        self.planner: Any = None
        self._base: Base | None = None
        self._pids: dict[str, int] = {}
        self._list: Subscription | None = None
        self.listed: dict[bytes, GoalState] = {}
        self.statuses: list[dict[str, Any]] = []
        deployment.start(**self._sections(OURS))
        self._hub = Program(deployment.settings("mix"))
        deployment.keep(_Closing(self._hub))
        self._hub.node.subscription("/navigation/status", STATUS, self.statuses.append, LATCHED)
        self.clients = self._clients()

    def _sections(self, planner: str) -> dict[str, Any]:
        place = f"{self._names.host}:{self._names.port}"
        return {
            "yarp": {"nameserver": "embedded", "address": place, "poll": 0.1},
            "navigation": {"planner": IDS[planner], "patience": 60.0, "map": "/map"},
            "store": {"enabled": True},
            "modules": {
                "robot_path_planner": {"enabled": planner == OURS, "scan": ""},
                "robot_goto": {"enabled": planner == OURS, **QUICK},
            },
        }

    def _clients(self) -> dict[str, Client]:
        names = NameClient(self._names, namespace="/root")
        ros1, ros2 = self.deployment.ros1("client1"), self.deployment.ros2("client2")
        until(lambda: connections.exists(names, "/navigationServer/rpc"), "the YARP door is open", SECONDS)
        remotes = [
            ServiceClient(INavigation2DMsgs, "/navigationServer/rpc", naming=names, timeout=SECONDS) for _ in range(2)
        ]
        for remote in remotes:
            self.deployment.keep(_Closing(remote.open()))
        return {
            YARP: YarpClient(*(remote.remote for remote in remotes)),
            ROS1: RosClient(ros1, "/move_base", "move_base_msgs/MoveBase", "target_pose"),
            ROS2: RosClient(ros2, "/navigate_to_pose", "nav2_msgs/NavigateToPose", "pose"),
            ZENOH: ZenohClient(self._hub, self.deployment.zenoh()),
        }

    # -- planners ------------------------------------------------------------------------------------------------------

    def start(self, planner: str) -> None:
        """Start a planner's program, and have the gateway take it: by the configuration, without a restart."""
        speed, patience = str(SPEED), str(PATIENCE)
        support = Path(__file__).parents[1] / "support"
        if planner == OURS:
            self.planner = PointRobot(self.deployment.settings("robot"), (60.0, 6.0))
        elif planner == MOVE_BASE:
            if self._base is None:
                self._base = self.deployment.keep(Base(self.deployment.master.env))
            program = support / "ros1_move_base.py"
            self.planner = Process([ROS1_PYTHON, program, speed, patience, "there"], self.deployment.master.env)
        else:
            env = {**ros2_environment(), **SHORT_LEASE}
            self.planner = Process([ros2_python(), support / "ros2_nav2.py", speed, patience], env)
        self.deployment.keep(self.planner)

    def choose(self, planner: str) -> None:
        """Have the gateway take a planner, by the configuration, without a restart."""
        self.deployment.configure(**self._sections(planner))
        self.deployment.hang_up()
        self._follow(IDS[planner])
        until(lambda: self._chosen(planner), f"{planner} is the planner", SECONDS, 0.1)

    def _chosen(self, planner: str) -> bool:
        found = {one.get("worker"): one for one in self.deployment.status()}
        asked = ["gateway", *([IDS[planner], "robot_goto"] if planner == OURS else [])]  # ours needs its map
        running = all(found.get(one, {}).get("state") == "running" for one in asked)
        return running and found["gateway"]["planner"] == IDS[planner]

    def end(self) -> None:
        """Have the planner's program end in good order: a name that ROS's master still has is another's."""
        self.planner.stop()
        if self._base is not None:
            self._base.stop()

    def restart(self) -> None:
        """Start move_base again; ROS's master has the dead one still, so only its own word tells that it is up."""
        self.start(MOVE_BASE)
        until(lambda: "ready" in self.planner.output(), "move_base is up again", SECONDS)

    @property
    def base(self) -> Base:
        """Of move_base's robot."""
        assert self._base is not None
        return self._base

    def pid(self, worker: str) -> int:
        """The process of a worker; it is to be killed, and `back` waits for all that there are now."""
        self._pids = self._processes()
        return self._pids[worker]

    def _processes(self) -> dict[str, int]:
        return {str(one.get("worker")): int(one["pid"]) for one in self.deployment.status() if "pid" in one}

    def back(self) -> bool:
        """Whether all workers are there, and the gateway has its planner."""
        return self._chosen(MOVE_BASE) and self._processes().keys() >= self._pids.keys()

    def _follow(self, planner: str) -> None:
        if self._list is not None:
            self._hub.on(lambda: self._hub.node.release(self._list))  # type: ignore[arg-type]
        self.listed = {}
        topic = names(f"/planner/{planner}/navigate_to_pose").status
        self._list = self._hub.on(lambda: self._hub.node.subscription(topic, STATUSES, self._hear, LATCHED))

    def _hear(self, message: dict[str, Any]) -> None:
        self.listed = {
            bytes(one["goal_info"]["goal_id"]["uuid"]): GoalState(one["status"]) for one in message["status_list"]
        }

    def driving(self) -> set[bytes]:
        """The goals that the planner has."""
        return {goal for goal, status in list(self.listed.items()) if not status.ended}

    def state(self) -> str:
        """What the gateway says."""
        return str(self.statuses[-1]["state"]) if self.statuses else ""

    def said(self) -> tuple[str, str]:
        """The same, and its reason."""
        last = self.statuses[-1] if self.statuses else {"state": "", "reason": ""}
        return str(last["state"]), str(last["reason"])

    # -- what is tried -------------------------------------------------------------------------------------------------

    def cells(self, planner: str, name: str) -> Iterator[Cell]:
        """All parts, by one client."""
        client = self.clients[name]
        own = (planner, name) in OWN
        tries: dict[str, Callable[[], str]] = {
            "goto": lambda: self._goto(client),
            "feedback": lambda: self._feedback(client),
            "pause": lambda: self._pause(client, own=own),
            "resume": lambda: self._resume(client, own=own),
            "cancel": lambda: self._cancel(client),
            "abort": lambda: self._abort(client, WHY[planner], own=own),
        }
        for part in PARTS:
            yield _tried(planner, name, part, tries[part])

    def faults(self, planner: str) -> Iterator[Cell]:
        """Who is killed in the middle of a goal, and what the others see of it."""
        tries: dict[str, list[tuple[str, str, Callable[[str, Client], str]]]] = {
            OURS: [
                ("a goal on /move_base_simple/goal", ROS1, partial(self._publish, "/move_base_simple/goal")),
                ("a goal on /goal_pose", ROS2, partial(self._publish, "/goal_pose")),
            ],
            MOVE_BASE: [
                ("a frame that nobody knows", ROS2, self._unknown_frame),
                ("the planner's own goal, stopped by YARP", ROS1, self._stop_direct),
                ("planner killed, and back", ROS2, self._kill_planner),
            ],
            NAV2: [("client killed", ROS1, self._kill_client)],
        }
        for part, name, attempt in tries.get(planner, []):
            yield _tried(planner, name, part, partial(attempt, planner, self.clients[name]))

    def failures(self, *, every: bool) -> Iterator[Cell]:
        """What fails on the way to move_base, for every client, or for one each."""
        for part, fault in FAULTS.items():
            for name in self.clients if every else ONE_EACH[part]:
                own, watches = (MOVE_BASE, name) in OWN, list[Watch]()
                attempt = partial(mix_faults.attempt, self, fault, self.clients[name], watches, own=own)
                cell = _tried(MOVE_BASE, name, part, attempt)
                yield from (replace(cell, note=str(one), seconds=round(one.untrue, 2)) for one in watches)
                if not watches:
                    yield cell

    def _publish(self, topic: str, _planner: str, client: Client) -> str:
        assert isinstance(client, RosClient)
        out = client.peer.advertise(topic, "geometry_msgs/PoseStamped")

        def moves() -> bool:
            client.peer.publish(out, pose(FAR))
            return self.state() == "moving"

        until(moves, "it moves", SECONDS, 0.2)
        client.peer.drop(out)

        def stands() -> bool:
            with contextlib.suppress(AssertionError):  # no "ok" if a goal arrives after the stop
                self.clients[YARP].cancel()
            return not self.driving() and self.state() == "idle"

        until(stands, "it was stopped", SECONDS, 0.3)  # the newest of the goals may still be on its way
        return "yes"

    def _unknown_frame(self, _planner: str, client: Client) -> str:
        assert isinstance(client, RosClient)
        client.goto(NEAR, frame="nowhere")  # move_base itself would follow it for ever
        self._ends(client, "aborted", "aborted")
        return "yes"

    def _stop_direct(self, _planner: str, client: Client) -> str:
        client.goto(FAR)
        until(lambda: self.state() == "moving", "everybody sees that it moves", SECONDS)
        self.clients[YARP].cancel()
        self._ends(client, "canceled", "idle")
        return "yes"

    def _kill_planner(self, planner: str, client: Client) -> str:
        client.goto(FAR)
        until(lambda: client.progress(), "progress is heard", SECONDS)
        self.planner.stop(0)
        until(lambda: "not available; waiting for it" in self.said()[1], "everybody hears why", SECONDS)
        assert self.state() in ("moving", "preparing_before_move"), self.state()  # no end: it goes on by itself
        assert client.end() == "", f"the client's goal ended: {client.end()}"
        self.start(planner)
        heard = client.progress()
        until(lambda: client.progress() > heard, "it goes on", SECONDS)
        return self._cancel(client)

    def _kill_client(self, _planner: str, client: Client) -> str:
        client.goto(FAR)
        until(lambda: client.progress(), "progress is heard", SECONDS)
        until(self.driving, "the planner tells of the goal", SECONDS)
        assert isinstance(client, RosClient)
        client.peer.stop(0)
        other = self.clients[YARP]
        assert self.driving(), "the goal goes on, as without a bridge"
        other.cancel()
        self._ends(other, "canceled", "idle")
        return "yes"

    def _goto(self, client: Client) -> str:
        client.goto(NEAR)
        self._ends(client, "succeeded", "goal_reached")
        return "yes"

    def _feedback(self, client: Client) -> str:
        client.goto(FAR)
        until(lambda: client.progress() >= 3, "progress is heard", SECONDS)
        until(lambda: self.state() == "moving", "everybody sees that it moves", SECONDS)
        return "yes"

    def _pause(self, client: Client, *, own: bool) -> str:
        if own:
            assert not client.ask("pause"), "a goal of the planner's own client was paused"
            return "own"
        assert client.ask("pause"), "the pause was refused"
        until(lambda: not self.driving() and self.state() == "paused", "it stands", SECONDS)
        assert client.end() == "", f"the client's goal ended in the pause: {client.end()}"
        return "yes"

    def _resume(self, client: Client, *, own: bool) -> str:
        if own:
            assert not client.ask("resume"), "what was never paused was resumed"
            return "own"
        before, heard = set(self.listed), client.progress()
        assert client.ask("resume"), "it was refused to go on"
        until(lambda: self.driving() - before, "it has a new goal", SECONDS)
        until(lambda: client.progress() > heard, "there is progress again", SECONDS)
        return "yes"

    def _cancel(self, client: Client) -> str:
        client.cancel()
        self._ends(client, "canceled", "idle")
        return "yes"

    def _abort(self, client: Client, reason: str, *, own: bool) -> str:
        client.goto(NOWHERE)
        self._ends(client, "aborted", "aborted")
        heard, said = client.why(), self.statuses[-1]["reason"]
        assert heard is None or reason in heard, f"the client heard {heard!r}, not {reason!r}"
        assert own or reason in said, f"/navigation/status said {said!r}, not {reason!r}"
        return "yes"

    def _ends(self, client: Client, end: str, state: str) -> None:
        until(client.end, "the client hears of its goal's end", SECONDS)
        assert client.end() == end, f"{client.end()}, not {end}: {self.statuses[-1]['reason']}"
        until(lambda: not self.driving(), "the planner has no goal", SECONDS)
        until(lambda: self.state() == state, f"everybody sees {state}", SECONDS)


def _tried(planner: str, client: str, part: str, attempt: Callable[[], str]) -> Cell:
    began = time.monotonic()
    try:
        seen = attempt()
    except AssertionError as err:
        seen = f"failed: {err}"
    return Cell(planner, client, part, seen, round(time.monotonic() - began, 2))


class _Closing:
    """Something with `close`, as `Deployment.keep` wants it."""

    def __init__(self, thing: Any) -> None:
        self._thing = thing

    def stop(self) -> None:
        self._thing.close()


def table(deployment: Deployment, *, every: bool = False) -> Iterator[Cell]:
    """Start the daemon, and try every client over every planner; with ``every``, also with every fault."""
    mix = Mix(deployment)
    for planner in IDS:
        mix.start(planner)
        mix.choose(planner)
        for client in mix.clients:
            yield from mix.cells(planner, client)
        yield from mix.faults(planner)
        if planner == MOVE_BASE:
            yield from mix.failures(every=every)
        mix.end()


def text(cells: list[Cell]) -> str:
    """The table: a line for each client over each planner."""
    lines: list[tuple[str, ...]] = [("planner", "client", *PARTS, *FAULTS)]
    for planner in IDS:
        for client in (YARP, ROS1, ROS2, ZENOH):
            seen = {cell.part: cell for cell in cells if (cell.planner, cell.client) == (planner, client)}
            marks = [_mark(seen[part]) if part in seen else "?" for part in PARTS]
            marks += [_mark(seen[part]) if part in seen else "-" for part in FAULTS]
            lines.append((planner, client, *marks))
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    rows = ["  ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)).rstrip() for line in lines]
    rows += [f"{c.part} ({c.planner}; {c.client}): {_mark(c)}" for c in cells if c.part not in (*PARTS, *FAULTS)]
    rows += [f"{c.part} ({c.client}): {c.note}" for c in cells if c.note]
    failed = [f"{c.planner}, {c.client}, {c.part}: {c.seen}" for c in cells if not c.good]
    own = (
        "own: the client speaks to the planner itself, whose protocol has no pause; -: not tried\n"
        "seconds of what dies or hangs: how long at most the robot was said to stand while it moved"
    )
    return "\n".join([*rows, own, *failed])


def _mark(cell: Cell) -> str:
    mark = cell.seen if cell.good else "FAILED"
    return f"{mark} {cell.seconds:.1f} s" if mark == "yes" else mark


def main() -> int:
    """Print the table; 1 where something is not as it should be."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the table to this file")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, Deployment(Path(folder)) as deployment:
        cells = list(table(deployment, every=True))
    print(text(cells))
    if args.json:
        args.json.write_text(json.dumps([{**asdict(one), "good": one.good} for one in cells], indent=2) + "\n")
    return int(not all(one.good for one in cells))


if __name__ == "__main__":
    sys.exit(main())
