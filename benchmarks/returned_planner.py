"""The time until a killed and restarted planner is discovered through the daemon, compared with a bare client.

The planner is the tests' stand-in for move_base (rospy) or Nav2 (rclpy), killed with SIGKILL: its registrations at the
ROS 1 master stay until it is restarted. The seconds count from the moment at which the new action server is registered
(its five topics at the master) until a client on the hub discovers it, by the same check as the gateway. The floor is
the time from the same moment until a bare client on the planner's own side discovers it; this client was already
waiting. The planner is restarted at once or after a time (`--away`). The death of a ROS 2 program is detected after 20
s, Fast DDS's lease, so a planner that is restarted at once is back before its death is detected.

The last rows are the processor time of the side's worker, in percent of a core, while the planner is away; their "peer"
is the worker's processor time while the planner is available and idle.
"""

from __future__ import annotations

import argparse
import os
import signal
import statistics
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import psutil
from typing_extensions import override

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.processes import Processes
from benchmarks.rows import Row, add_json_option, report
from bridge.clock import SYSTEM
from bridge.daemon.query import ask_daemon
from bridge.hub.node import Hub
from bridge.hub.session import HubSettings
from bridge.messages.registry import Registry
from bridge.modules.host import ModuleNode
from bridge.modules.loop import EventLoop

_PEERS = Path(__file__).parents[1] / "tests" / "peers"
_TYPE = "nav2_msgs/action/NavigateToPose"  # on the hub, also of move_base
_POLL_SECONDS = 0.002
_IDLE_SECONDS = 10.0  # duration of a measurement of the load
_STEADY_SECONDS = 3.0  # a planner that stays available for so long after the registration was never lost


@dataclass(frozen=True, slots=True)
class Side:
    """One side's planner: the side's key (also its worker's name), a name for display, its action, the stand-in.

    ``aways``: seconds until it is restarted.
    """

    key: str
    name: str
    action: str
    program: str
    aways: tuple[float, ...]


SIDES = (
    Side("ros1", "move_base on ROS 1", "/move_base", "ros1/move_base.py", (0.0, 5.0)),
    Side("ros2", "Nav2 on ROS 2", "/navigate_to_pose", "ros2/nav2.py", (0.0, 25.0)),
)


@dataclass(slots=True)
class Times:
    """Seconds from the registration until the hub's client, and the bare client, discovered the planner."""

    ours: list[float] = field(default_factory=list)
    bare: list[float] = field(default_factory=list)


class Watcher:
    """A client on the hub, which continuously checks whether the planner is available.

    Attributes:
        ready: whether the planner is available.
        since: when ``ready`` last changed (monotonic).
    """

    def __init__(self, node: ModuleNode, action: str) -> None:
        self._client = node.action_client(action, _TYPE)
        self.ready, self.since = False, time.monotonic()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._stopping.set()
        self._thread.join()
        self._client.close()

    def _run(self) -> None:
        while not self._stopping.wait(_POLL_SECONDS):
            ready = self._client.ready
            if ready != self.ready:
                self.since, self.ready = time.monotonic(), ready


class Bench(Processes):
    """One side's planner, with the daemon and a client on the hub."""

    def __init__(self, side: Side) -> None:
        # the daemon polls with its default settings
        super().__init__({"log": {"level": "warning"}})
        self.side = side
        self._loop: EventLoop | None = None
        try:
            self.start_master()
            self.start_daemon()
            self._open_hub()
            self.start_planner()
            self.until(lambda: self.watcher.ready, "the planner is discovered")
        except BaseException:
            self.close()
            raise

    def _open_hub(self) -> None:
        hub = self.place.config.hub
        settings = HubSettings(domain=hub.domain, router=hub.listen, node="client", daemon="client", worker="client")
        self.until(lambda: self._worker(), "the side's worker runs")
        self._hub, self._loop = Hub.open(settings), EventLoop("client")
        self._node = ModuleNode(self._hub, Registry(), self._loop, SYSTEM)
        self._loop.start()
        self.watcher = Watcher(self._node, self.side.action)

    def start_planner(self) -> float:
        """Start the planner, and return the moment at which it was registered."""
        program = str(_PEERS / self.side.program)
        self.launch(
            "planner", f"benchmarks.returned.{self.side.key}", "planner", program, system=self.side.key == "ros1"
        )
        return float(self.wait_for("planner", "registered")["at"])

    def kill_planner(self) -> None:
        """Send SIGKILL to the planner."""
        os.kill(self._children["planner"].pid, signal.SIGKILL)
        self.stop("planner")

    def round(self, away: float, times: Times) -> None:
        """Kill the planner, and restart it after some seconds."""
        killed = time.monotonic()
        self.kill_planner()
        self.launch("waiter", f"benchmarks.returned.{self.side.key}", "waiter", system=self.side.key == "ros1")
        self.wait_for("waiter", "waiting")
        time.sleep(max(0.0, killed + away - time.monotonic()))
        registered = self.start_planner()

        def recovered() -> bool:
            """Return whether the planner was discovered again, or was never lost."""
            known = self.watcher.since > killed or time.monotonic() > registered + _STEADY_SECONDS
            return self.watcher.ready and known

        self.until(recovered, "the hub's client discovers the planner again")
        times.ours.append(max(0.0, self.watcher.since - registered))
        times.bare.append(float(self.wait_for("waiter", "found")["at"]) - registered)
        self.stop("waiter")

    def load(self) -> float:
        """Measure the load of the side's worker for a while, in percent of a core."""
        process = psutil.Process(self._worker())
        before, began = process.cpu_times(), time.monotonic()
        time.sleep(_IDLE_SECONDS)
        after, seconds = process.cpu_times(), time.monotonic() - began
        return 100.0 * (after.user + after.system - before.user - before.system) / seconds

    def _worker(self) -> int:
        status = ask_daemon(self.place.config)
        running = [] if status is None else [w for w in status.workers if w.phase == "running"]
        return next((worker.pid for worker in running if worker.worker == self.side.key), 0)

    @override
    def close(self) -> None:
        """Stop all processes, and close the hub session."""
        if self._loop is not None:
            self.watcher.close()
            self._node.close()
            self._loop.close()
            self._hub.close()
        if "planner" in self._children:
            self.kill_planner()
        super().close()


def measure(side: Side, aways: Sequence[float], rounds: int) -> list[Row]:
    """Measure one side, and return the rows."""
    rows = []
    with Bench(side) as bench:
        for away in aways:
            times = Times()
            for number in range(rounds):
                bench.round(away, times)
                last = f"{times.ours[-1]:.3f} s, bare {times.bare[-1]:.3f} s"
                print(f"{side.name}, away for {away:g} s, {number + 1}/{rounds}: {last}", flush=True)
            name = f"{side.name}, killed, back after {away:g} s, discovered"
            for statistic, of in (("p50", statistics.median), ("max", max)):
                rows.append(Row(f"{name}, {statistic}", of(times.ours), of(times.bare), "s"))
        idle_load = bench.load()
        bench.kill_planner()
        bench.until(lambda: not bench.watcher.ready, "the planner's death is detected")
        rows.append(Row(f"{side.name}, its worker's load while it is away", bench.load(), idle_load, "%"))
    return rows


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--sides", nargs="+", choices=[side.key for side in SIDES], help="sides to measure (default all)"
    )
    parser.add_argument(
        "--away", nargs="+", type=float, metavar="S", help="seconds until the restart (default 0 and 5; ROS 2: 25)"
    )
    parser.add_argument("--rounds", type=int, default=5, metavar="N", help="rounds of each (default 5)")
    add_json_option(parser)
    args = parser.parse_args(arguments)
    rows = []
    for side in SIDES:
        if args.sides is None or side.key in args.sides:
            rows += measure(side, args.away or side.aways, args.rounds)
    print()
    report(rows, args.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
