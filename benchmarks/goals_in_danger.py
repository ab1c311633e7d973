"""The outcome of goals whose server, client, bridge worker or ROS master is killed meanwhile.

Real actionlib and rclpy programs on both ends send goals through the whole daemon, in both directions; each fault is
repeated (by default, 10 times). A goal is good if its client receives its end exactly once, and no other subscriber on
its side receives it twice. If the client itself is killed, the other subscribers must receive the end. The results are
the number of good goals, their final states, and the seconds from the kill to the end; the rows contain the numbers.
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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.rows import Row, add_json_option, report
from bridge.status import WorkerStatus
from tests.peers.daemon.calls_table import ROS1, ROS2, SUCCEEDED, Pair
from tests.peers.daemon.deployment import Deployment
from tests.peers.peer import Peer
from tests.support.wait import until

SECONDS = 60.0  # time-out of each wait
SETTLE = 1.5
"""Seconds to wait for a second end; status lists and results are sent within one second."""
TERMINAL = {ROS1: (2, 3, 4, 5, 8, 9), ROS2: (4, 5, 6)}  # final states, in the numbers of each side
STATES = {0: "none", 4: "SUCCEEDED", 5: "CANCELED", 6: "ABORTED"}
KEYS = {ROS1: "ros1", ROS2: "ros2"}


@dataclass(frozen=True, slots=True)
class End:
    """The end of a goal.

    Attributes:
        status: its state in ROS 2's numbers; 0 if none was reported.
        reports: number of reported ends, to the client or to other subscribers.
        seconds: time from the kill to the end.
    """

    status: int
    reports: int
    seconds: float

    @property
    def good(self) -> bool:
        """Whether exactly one end was reported."""
        return self.reports == 1 and self.status != 0


class Scene:
    """A daemon between real programs, which are restarted when they die.

    Args:
        deployment: a running daemon.
    """

    def __init__(self, deployment: Deployment) -> None:
        self.deployment = deployment
        self._peers: dict[str, Peer] = {}
        self._goals = 0

    def peer(self, side: str, role: str) -> Peer:
        """Return a program of a side, and start it if it does not run."""
        name = f"{KEYS[side]}_{role}"
        peer = self._peers.get(name)
        if peer is None or peer.popen.poll() is not None:
            self._goals += 1
            start = self.deployment.ros1 if side == ROS1 else self.deployment.ros2
            peer = self._peers[name] = start(f"{name}_{self._goals}")
        return peer

    def goal(self, server: str, client: str) -> Goal:
        """Start a goal."""
        self._goals += 1
        return Goal(self, server, client, self._goals)

    def describe(self, action: str) -> str:
        """Describe an action's routes, and the programs on each side, for a failure."""
        lines = [f"{line['direction']} {line['topic']}: {line['why']}" for line in self.deployment.explain(action)]
        for status in map(_typed, self.deployment.status()):
            lines.append(f"{status.side}: {status.state}, {status.network}, {status.warnings}")
            lines += [str(route) for route in status.routes if route.action == action]
        return "\n".join(lines)

    def kill_worker(self, worker: str) -> None:
        """Send SIGKILL to a worker, and wait until its successor runs."""
        old = _typed(self.deployment.worker(worker)).pid
        os.kill(old, signal.SIGKILL)

        def runs() -> bool:
            status = _typed(self.deployment.worker(worker))
            return status.state == "running" and status.pid != old

        until(runs, f"the next worker of {worker} runs", SECONDS, every=0.1)

    def kill_master(self) -> None:
        """Send SIGKILL to roscore."""
        self.deployment.master.kill()

    def start_master(self) -> None:
        """Restart roscore, and wait until the bridge has joined it."""
        self.deployment.master.start()
        network = self.deployment.master.call("getParam", "/run_id")
        joined = lambda: _typed(self.deployment.worker("ros1")).network == network  # noqa: E731
        until(joined, "the new ROS 1 network is joined", SECONDS, every=0.1)

    def forget_ros1(self) -> None:
        """Stop the ROS 1 programs, which are not registered at a new master."""
        for name in [n for n in self._peers if n.startswith("ros1")]:
            self._peers.pop(name).stop(0)


def _typed(document: Mapping[str, Any]) -> WorkerStatus:
    return WorkerStatus.model_validate(document)


class Goal:
    """An active goal, and its reported states."""

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
        self._observe(name)
        self.killed_at = time.monotonic()

    def _observe(self, name: str) -> None:
        self._observer = self.scene.peer(self.sides[1], "looker")
        if self.sides[1] == ROS1:
            self._status = self._observer.subscribe(f"{name}/status", "actionlib_msgs/GoalStatusArray")
        else:
            self._status = self._observer.subscribe(
                f"{name}/_action/status", "action_msgs/GoalStatusArray", latched=True
            )
        until(lambda: self._states(), "the goal is in the status list", SECONDS)

    def _states(self) -> dict[str, list[int]]:
        """Return the reported states of every goal on the side, in order, without repetitions."""
        seen: dict[str, list[int]] = defaultdict(list)
        for message in self._observer.wait(self._status, 0, 0.0):
            for status in message["status_list"]:
                goal = status["goal_id"]["id"] if self.sides[1] == ROS1 else str(status["goal_info"]["goal_id"]["uuid"])
                if seen[goal][-1:] != [status["status"]]:
                    seen[goal].append(status["status"])
        return seen

    def reported_ends(self) -> int:
        """Return how often other subscribers received a goal's end, for the goal with the most ends."""
        terminal = TERMINAL[self.sides[1]]
        return max((sum(s in terminal for s in states) for states in self._states().values()), default=0)

    def kill(self, role: str) -> None:
        """Send SIGKILL to the server or the client."""
        (self.server if role == "server" else self.client).stop(0)

    def release(self) -> None:
        """Let the server end the goal."""
        self.server.ask("release", id=self.acting)

    def ask_again(self) -> None:
        """Let the client request the result until it arrives; requests are lost until the server is discovered."""

        def has_ended() -> bool:
            self.client.ask("ask_result", id=self.id)
            return bool(self.client.ask("goal", id=self.id, until={"ends": 1}, seconds=1.0)["ends"])

        with contextlib.suppress(AssertionError):  # `end` reports that there was no result
            until(has_ended, "the client has a result", SECONDS)

    def end(self) -> End:
        """Wait until the client receives the end, and then for a second end, which must not arrive."""
        state = self.client.ask("goal", id=self.id, until={"ends": 1}, seconds=SECONDS)
        seconds = time.monotonic() - self.killed_at
        time.sleep(SETTLE)
        state = self.client.ask("goal", id=self.id, until={}, seconds=0)
        return End(state["status"], max(state["ends"], self.reported_ends()), seconds)

    def end_for_others(self) -> End:
        """Wait until other subscribers receive the end."""
        try:
            until(self.reported_ends, "an end is reported to other subscribers", SECONDS, every=0.1)
        except AssertionError:
            return End(0, 0, SECONDS)
        seconds = time.monotonic() - self.killed_at
        time.sleep(SETTLE)
        last = {state for states in self._states().values() for state in states[-1:]}
        done = 3 if self.sides[1] == ROS1 else SUCCEEDED
        return End(SUCCEEDED if last == {done} else 6, self.reported_ends(), seconds)


# -- the dangers -------------------------------------------------------------------------------------------------------


def server_killed(scene: Scene, server: str, client: str) -> End:
    """Kill the server; the goal must end ABORTED."""
    goal = scene.goal(server, client)
    goal.kill("server")
    return goal.end()


def client_killed(scene: Scene, server: str, client: str) -> End:
    """Kill the client; the goal must continue, and other subscribers receive its end."""
    goal = scene.goal(server, client)
    goal.kill("client")
    goal.release()
    return goal.end_for_others()


def worker_killed(worker: str, scene: Scene, server: str, client: str) -> End:
    """Kill a worker. A ROS 2 client whose worker died requests the result again, as after a restart of a server."""
    goal = scene.goal(server, client)
    scene.kill_worker(worker)
    if (worker, client) == ("ros2", ROS2):
        goal.release()
        goal.ask_again()
    return goal.end()


def master_killed(scene: Scene, server: str, client: str) -> End:
    """Restart the ROS master, then let the server end the goal; the end must be reported, before or now."""
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
    """Run the benchmark; return 1 if a goal had no end, or more than one."""
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
        durations = [end.seconds for end in goal_ends]
        print(
            f"{danger}, {direction}: {states}; {statistics.median(durations):.2f} / {max(durations):.2f} s (p50 / max)"
        )
    rows = [Row(f"{d}, {w}, one end", sum(e.good for e in es), len(es), "times", "more") for (d, w), es in ends.items()]
    print()
    report(rows, args.json)
    return int(any(not end.good for goal_ends in ends.values() for end in goal_ends))


def _text(end: End) -> str:
    return f"{STATES[end.status]}, reported {end.reports} times, {end.seconds:.2f} s"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dangers", nargs="+", choices=list(DANGERS), help="dangers to cause (default all)")
    parser.add_argument("--times", type=int, default=10, metavar="N", help="repetitions of each danger (default 10)")
    add_json_option(parser)
    return parser


if __name__ == "__main__":
    sys.exit(main())
