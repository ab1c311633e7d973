"""What becomes of a goal whose server, client, bridge worker or ROS master is killed in its middle.

Real actionlib and rclpy programs on both ends, through the whole daemon, each way; each danger so many times (default
10). A goal is well where its client is told one end, and no second one, and nobody on its side is told two. Where the
client itself is killed, the end must be told to those who look on. Printed: how often that was so, in which states the
goals ended, and the seconds from the kill to the end; the rows hold how often.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import statistics
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.rows import Row, add_json_option, report
from tests.interop.calls_table import ROS1, ROS2, SUCCEEDED, Pair
from tests.interop.deployment import Deployment
from tests.support.peer import Peer
from tests.support.wait import until

SECONDS = 60.0
SETTLE = 1.5
"""Seconds after the end in which a second one would come: status lists and results are sent within one."""
TERMINAL = {ROS1: (2, 3, 4, 5, 8, 9), ROS2: (4, 5, 6)}
STATES = {0: "none", 4: "SUCCEEDED", 5: "CANCELED", 6: "ABORTED"}
KEYS = {ROS1: "ros1", ROS2: "ros2"}


@dataclass(frozen=True, slots=True)
class End:
    """How one goal ended.

    Attributes:
        status: its state, as ROS 2 numbers them; 0 where none was told.
        told: how often an end was told, to the client or to those who look on.
        seconds: from the kill to the end.
    """

    status: int
    reports: int
    seconds: float

    @property
    def good(self) -> bool:
        """One end, and no second one."""
        return self.reports == 1 and self.status != 0


class Scene:
    """A daemon between real programs, which are started again as they die.

    Args:
        deployment: a daemon that runs.
    """

    def __init__(self, deployment: Deployment) -> None:
        self.deployment = deployment
        self._peers: dict[str, Peer] = {}
        self._goals = 0

    def peer(self, side: str, role: str) -> Peer:
        """A program of a side, started where it does not run."""
        name = f"{KEYS[side]}_{role}"
        peer = self._peers.get(name)
        if peer is None or peer.popen.poll() is not None:
            self._goals += 1
            start = self.deployment.ros1 if side == ROS1 else self.deployment.ros2
            peer = self._peers[name] = start(f"{name}_{self._goals}")
        return peer

    def goal(self, server: str, client: str) -> Goal:
        """Begin a goal."""
        self._goals += 1
        return Goal(self, server, client, self._goals)

    def describe(self, action: str) -> str:
        """What the workers say of an action, and who is on the side of each."""
        lines = [f"{line['direction']} {line['topic']}: {line['why']}" for line in self.deployment.explain(action)]
        for status in self.deployment.status():
            lines.append(f"{status['side']}: {status['state']}, {status.get('network')}, {status.get('warnings')}")
            lines += [str(route) for route in status["routes"] if route["action"] == action]
        return "\n".join(lines)

    def kill_worker(self, worker: str) -> None:
        """SIGKILL a worker; returns when the next one runs."""
        old = self.deployment.worker(worker)["pid"]
        os.kill(old, signal.SIGKILL)

        def runs() -> bool:
            status = self.deployment.worker(worker)
            return status.get("state") == "running" and status["pid"] != old

        until(runs, f"the next worker of {worker} runs", SECONDS, every=0.1)

    def kill_master(self) -> None:
        """SIGKILL roscore."""
        self.deployment.master.kill()

    def start_master(self) -> None:
        """Start roscore again; returns when the bridge has joined it."""
        self.deployment.master.start()
        network = self.deployment.master.call("getParam", "/run_id")
        joined = lambda: self.deployment.worker("ros1").get("network") == network  # noqa: E731
        until(joined, "the new ROS 1 network is joined", SECONDS, every=0.1)

    def forget_ros1(self) -> None:
        """End the ROS 1 programs, of which a new master knows nothing."""
        for name in [n for n in self._peers if n.startswith("ros1")]:
            self._peers.pop(name).stop(0)


class Goal:
    """A goal that is being worked on, and what is told of it."""

    def __init__(self, scene: Scene, server: str, client: str, number: int) -> None:
        self.scene, self.sides = scene, (server, client)
        self.server, self.client = scene.peer(server, "server"), scene.peer(client, "client")
        pair = Pair((server, self.server), (client, self.client))
        name = f"/danger_{number}/go"
        self.acting = pair.act(name, held=True)
        try:
            self.id = pair.send(name)
        except AssertionError as err:
            raise AssertionError(f"{err}\n{scene.describe(name)}") from None
        pair.goal(self.id, accepted=True, feedback=1)
        self._look_on(name)
        self.killed_at = time.monotonic()

    def _look_on(self, name: str) -> None:
        self._looker = self.scene.peer(self.sides[1], "looker")
        if self.sides[1] == ROS1:
            self._heard = self._looker.subscribe(f"{name}/status", "actionlib_msgs/GoalStatusArray")
        else:
            self._heard = self._looker.subscribe(f"{name}/_action/status", "action_msgs/GoalStatusArray", latched=True)
        until(lambda: self._states(), "the goal is in the status list", SECONDS)

    def _states(self) -> dict[str, list[int]]:
        """The states of every goal that the side was told, in order, none twice in a row."""
        seen: dict[str, list[int]] = defaultdict(list)
        for message in self._looker.wait(self._heard, 0, 0.0):
            for status in message["status_list"]:
                goal = status["goal_id"]["id"] if self.sides[1] == ROS1 else str(status["goal_info"]["goal_id"]["uuid"])
                if seen[goal][-1:] != [status["status"]]:
                    seen[goal].append(status["status"])
        return seen

    def reported_ends(self) -> int:
        """How many ends those who look on were told, of the goal of which they were told most."""
        terminal = TERMINAL[self.sides[1]]
        return max((sum(s in terminal for s in states) for states in self._states().values()), default=0)

    def kill(self, role: str) -> None:
        """SIGKILL the server or the client."""
        (self.server if role == "server" else self.client).stop(0)

    def release(self) -> None:
        """Have the server end it."""
        self.server.ask("release", id=self.acting)

    def ask_again(self) -> None:
        """Have the client ask for the result until it is told: a request to a server that is being found is lost."""

        def has_ended() -> bool:
            self.client.ask("ask_result", id=self.id)
            return bool(self.client.ask("goal", id=self.id, until={"ends": 1}, seconds=1.0)["ends"])

        with contextlib.suppress(AssertionError):  # `end` tells that there was none
            until(has_ended, "a result", SECONDS)

    def end(self) -> End:
        """Wait for the end that the client is told, and for a second one that must not come."""
        state = self.client.ask("goal", id=self.id, until={"ends": 1}, seconds=SECONDS)
        took = time.monotonic() - self.killed_at
        time.sleep(SETTLE)
        state = self.client.ask("goal", id=self.id, until={}, seconds=0)
        return End(state["status"], max(state["ends"], self.reported_ends()), took)

    def end_for_others(self) -> End:
        """The same, as those who look on are told it."""
        try:
            until(self.reported_ends, "an end", SECONDS, every=0.1)
        except AssertionError:
            return End(0, 0, SECONDS)
        took = time.monotonic() - self.killed_at
        time.sleep(SETTLE)
        last = {state for states in self._states().values() for state in states[-1:]}
        done = 3 if self.sides[1] == ROS1 else SUCCEEDED
        return End(SUCCEEDED if last == {done} else 6, self.reported_ends(), took)


# -- the dangers -------------------------------------------------------------------------------------------------------


def server_killed(scene: Scene, server: str, client: str) -> End:
    """The server dies: the goal is ABORTED."""
    goal = scene.goal(server, client)
    goal.kill("server")
    return goal.end()


def client_killed(scene: Scene, server: str, client: str) -> End:
    """The client dies: the goal goes on, and its end is told to who else is there."""
    goal = scene.goal(server, client)
    goal.kill("client")
    goal.release()
    return goal.end_for_others()


def worker_killed(worker: str, scene: Scene, server: str, client: str) -> End:
    """A worker dies. A client on ROS 2 whose own worker died asks again, as it has to where a server was restarted."""
    goal = scene.goal(server, client)
    scene.kill_worker(worker)
    if (worker, client) == ("ros2", ROS2):
        goal.release()
        goal.ask_again()
    return goal.end()


def master_killed(scene: Scene, server: str, client: str) -> End:
    """The ROS master dies and comes back, and then the server ends the goal: its end is told, if none was before."""
    goal = scene.goal(server, client)
    scene.kill_master()
    scene.start_master()
    goal.release()
    end = goal.end()
    scene.forget_ros1()
    return end


Happen = Callable[[Scene, str, str], End]
DANGERS: dict[str, Happen] = {
    "server killed": server_killed,
    "client killed": client_killed,
    "ros1 worker killed": partial(worker_killed, "ros1"),
    "ros2 worker killed": partial(worker_killed, "ros2"),
    "master killed": master_killed,
}
WAYS = {"ROS 2 client, ROS 1 server": (ROS1, ROS2), "ROS 1 client, ROS 2 server": (ROS2, ROS1)}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; returns 1 where a goal had no end, or two."""
    args = _parser().parse_args(arguments)
    ends: dict[tuple[str, str], list[End]] = defaultdict(list)
    with tempfile.TemporaryDirectory() as folder, Deployment(Path(folder)) as deployment:
        deployment.start()
        scene = Scene(deployment)
        for number in range(args.times):
            for danger in args.dangers or DANGERS:
                for direction, sides in WAYS.items():
                    end = DANGERS[danger](scene, *sides)
                    ends[danger, direction].append(end)
                    print(f"{number + 1}/{args.times} {danger}, {direction}: {_text(end)}", flush=True)
    print()
    for (danger, direction), goal_ends in ends.items():
        states = ", ".join(f"{n} {state}" for state, n in Counter(STATES[e.status] for e in goal_ends).items())
        took = [end.seconds for end in goal_ends]
        print(f"{danger}, {direction}: {states}; {statistics.median(took):.2f} / {max(took):.2f} s (p50 / max)")
    rows = [Row(f"{d}, {w}, one end", sum(e.good for e in es), len(es), "times", "more") for (d, w), es in ends.items()]
    print()
    report(rows, args.json)
    return int(any(not end.good for goal_ends in ends.values() for end in goal_ends))


def _text(end: End) -> str:
    return f"{STATES[end.status]}, reported {end.reports} times, {end.seconds:.2f} s"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dangers", nargs="+", choices=list(DANGERS), help="default all")
    parser.add_argument("--times", type=int, default=10, metavar="N", help="how often each (default 10)")
    add_json_option(parser)
    return parser


if __name__ == "__main__":
    sys.exit(main())
