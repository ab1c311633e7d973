"""Many frames that one YARP client sets, and rospy, rclpy and a YARP client receive; and late joiners.

200 frames (``--frames``) are set in one call 100 times per second (``--rate``) for a minute (``--seconds``). The result
is the number of ticks for which each side received all frames, and the processor time of each worker. YARP's stream
sends the current frames 100 times per second, independently of the ticks, and may miss ticks; its result is therefore
the number of complete messages.

Then each side publishes 100 static frames, and programs of each side join late, one after the other (``--joiners``).
The result is how many of them receive all frames.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import psutil

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.rows import Row, add_json_option, report
from tests.peers.daemon.deployment import Deployment
from tests.peers.peer import Peer
from tests.peers.ros1.network import ROS1_PYTHON
from tests.peers.ros2.network import ros2_environment, ros2_python
from tests.support.ports import free_port
from tests.support.wait import until

PROGRAMS = Path(__file__).parent / "frameload"
SIDES = ("ros1", "ros2", "yarp")
STATIC = 100
PATIENCE = 20.0
_WARM = 10_000_000
"""Number of the first tick of the warm-up, which precedes the measurement."""


class Load:
    """The daemon and the programs.

    Args:
        deployment: the deployment, not started yet.
        frames: number of frames.
    """

    def __init__(self, deployment: Deployment, frames: int) -> None:
        self.deployment, self.frames, self.number = deployment, frames, free_port()
        deployment.start(
            yarp={"address": f"127.0.0.1:{self.number}", "nameserver": "embedded", "poll": 0.1},
            modules={"transform_server": {"enabled": True}},
        )
        until(
            lambda: "tf:o" in str(self._server()) and "waiting" not in str(self._server()),
            "the transform server runs",
            40,
            0.2,
        )
        self.setter = self._program("yarp")
        self.programs = {side: self._program(side) for side in SIDES}

    def _server(self) -> Any:
        return next(
            (status["ports"] for status in self.deployment.status() if status["worker"] == "transform_server"), None
        )

    def _program(self, side: str) -> Peer:
        python, env = {
            "ros1": (ROS1_PYTHON, self.deployment.master.env),
            "ros2": (ros2_python(), ros2_environment()),
            "yarp": (Path(sys.executable), {"PATH": "/usr/bin:/bin"}),
        }[side]
        peer: Peer = self.deployment.keep(
            Peer(PROGRAMS / f"{side}.py", python, env, str(self.frames), str(self.number))
        )
        return peer

    def workers(self) -> dict[str, psutil.Process]:
        """Return the daemon's processes by worker."""
        pids = {status["worker"]: status["pid"] for status in self.deployment.status()}
        return {name: psutil.Process(pid) for name, pid in sorted(pids.items())}

    def run(self, rate: float, seconds: float) -> list[Row]:
        """Set frames for a time, and return the rows."""
        for program in self.programs.values():
            program.ask("count")
        self._warm(rate)
        before = {side: program.ask("report") for side, program in self.programs.items()}
        processes = self.workers()
        spent = {name: sum(process.cpu_times()[:2]) for name, process in processes.items()}
        start = time.monotonic()
        ticks = round(rate * seconds)
        self.setter.ask("set", rate=rate, ticks=ticks, first=1)
        done = self.setter.ask("done", seconds=3 * seconds + 60)
        duration = time.monotonic() - start
        used = {name: sum(process.cpu_times()[:2]) - spent[name] for name, process in processes.items()}
        sent = done["sent"]
        rows = []
        for side in ("ros1", "ros2"):
            program = self.programs[side]
            seen = self._seen(program, before[side]["ticks"], sent)
            rows.append(
                Row(f"{self.frames} frames at {rate:g} Hz, {side}, ticks received of those set", seen, sent, "", "more")
            )
        report_ = self.programs["yarp"].ask("report")
        streamed, short = (report_[key] - before["yarp"][key] for key in ("messages", "short"))
        rows.append(Row("yarp stream, complete messages of all messages", streamed - short, streamed, "", "more"))
        rows.append(
            Row(
                "yarp stream, ticks received of those set", report_["ticks"] - before["yarp"]["ticks"], sent, "", "more"
            )
        )
        rows.append(Row("setTransforms, p50, compared with its period", done["ms"], 1000 / rate, "ms"))
        rows.append(Row("total time, compared with the nominal time", duration, seconds, "s"))
        rows += [Row(f"CPU of {name}, cores", used[name] / duration, 1.0, "cores") for name in processes]
        return rows

    def join(self, count: int) -> list[Row]:
        """Let programs of each side join late, and return the rows."""
        frames = {side: [f"{side}_{n}" for n in range(STATIC)] for side in SIDES}
        for side, program in self.programs.items():
            program.ask("mount", frames=frames[side])
        rows = []
        everything = [name for names in frames.values() for name in names]
        for program in self.programs.values():
            program.ask("join", count=1, frames=everything, seconds=2 * PATIENCE)
        for side, program in self.programs.items():
            joined = program.ask("join", count=count, frames=everything, seconds=PATIENCE)
            rows.append(
                Row(f"late joiners of {side} with all {len(everything)} frames", joined["whole"], count, "", "more")
            )
            rows.append(
                Row(f"slowest late joiner of {side}, compared with {PATIENCE:g} s", joined["slowest"], PATIENCE, "s")
            )
        return rows

    def _warm(self, rate: float) -> None:
        """Set frames until every program receives them."""

        def seen() -> bool:
            self.setter.ask("set", rate=rate, ticks=5, first=_WARM)
            self.setter.ask("done", seconds=60)
            return all(program.ask("report")["ticks"] for program in self.programs.values())

        until(seen, "all sides receive frames", 60, 0.2)
        time.sleep(1.0)  # wait until these frames expire in YARP, and messages in flight have arrived

    @staticmethod
    def _seen(program: Peer, before: int, sent: int) -> int:
        """Return the number of ticks that a program received, once all have arrived or after 5 s."""
        end = time.monotonic() + 5.0
        while True:
            seen = int(program.ask("report")["ticks"]) - before
            if seen >= sent or time.monotonic() > end:
                return seen
            time.sleep(0.1)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the benchmark, and print the rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--rate", type=float, default=100.0)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--joiners", type=int, default=50)
    add_json_option(parser)
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder, Deployment(Path(folder)) as deployment:
        load = Load(deployment, options.frames)
        rows = load.run(options.rate, options.seconds) + load.join(options.joiners)
    report(rows, options.json)


if __name__ == "__main__":
    main()
