"""Odometry of wheels on a busy machine: the velocities that BaseControl publishes, compared with the true ones.

The whole deployment (`midspan run`) with ``sim.drive: wheels`` and BaseControl. A client commands arcs of at most
0.30 m/s and 0.4 rad/s, with stops between them, while ``--busy`` processes take the cores: the simulator then catches
up on its ticks in bursts. The peer is the simulator's ``/ground_truth``, matched by stamp.

    python benchmarks/odometry.py [--seconds 30] [--busy 4] [--json FILE]
"""

from __future__ import annotations

import argparse
import itertools
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.rows import Row, add_json_option, report
from bridge.hub.wire.qos import Qos
from tests.peers.navigation.chain import Chain
from tests.support.wait import until

LINEAR, ANGULAR = 0.30, 0.4
"""The fastest commands, m/s and rad/s."""

_TOLERATED = 1.1  # a message is within the commanded speed if it is at most this many times as fast
_ROCKING = 0.05  # m/s by which the body of the base moves on its wheels as it starts and brakes
_COMMANDS = ((LINEAR, 0.0), (0.0, 0.0), (0.0, ANGULAR), (-LINEAR, 0.0), (0.0, 0.0), (0.2, -ANGULAR))
_COMMAND_SECONDS = 3.0
_KEPT = Qos(depth=1000)


class Motion(NamedTuple):
    """One message: stamp in seconds, speed in m/s, and angular velocity in rad/s."""

    stamp: float
    linear: float
    angular: float


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0, help="seconds of driving (default 30)")
    parser.add_argument("--busy", type=int, default=4, help="busy processes (default 4)")
    add_json_option(parser)
    args = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="midspan-odometry-") as folder:
        odometry, truth = driven(Path(folder), args.seconds, args.busy)
    report(rows(odometry, truth, f", {args.busy} busy processes"), args.json)
    return 0


def driven(folder: Path, seconds: float, busy: int) -> tuple[list[Motion], list[Motion]]:
    """Drive with a number of busy processes, and return the odometry and the ground truth."""
    idle = {"enabled": False}
    modules = dict.fromkeys(("map2d_server", "localization_server", "robot_goto", "robot_path_planner"), idle)
    chain = Chain(folder, sim={"plan": "hall"}, modules=modules, navigation={})
    load: list[subprocess.Popen[bytes]] = []
    odometry: list[Motion] = []
    truth: list[Motion] = []
    with chain:
        chain.start()
        node = chain.client.node
        node.subscription("/odom", "nav_msgs/msg/Odometry", lambda message: odometry.append(motion(message)), _KEPT)
        node.subscription(
            "/ground_truth", "nav_msgs/msg/Odometry", lambda message: truth.append(motion(message)), _KEPT
        )
        out = node.publisher("/cmd_vel", "geometry_msgs/msg/Twist", Qos(depth=1), priority="command")
        until(lambda: odometry and truth, "odometry and ground truth arrive", 40)
        try:
            load += [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(busy)]
            began = time.monotonic()
            while (passed := time.monotonic() - began) < seconds:
                x, turn = _COMMANDS[int(passed / _COMMAND_SECONDS) % len(_COMMANDS)]
                out.publish({"linear": {"x": x}, "angular": {"z": turn}})
                time.sleep(0.05)
        finally:
            for process in load:
                process.kill()
                process.wait()
        return list(odometry), list(truth)


def motion(message: dict[str, Any]) -> Motion:
    """Read the stamp and the velocities of a `nav_msgs/Odometry`."""
    stamp, twist = message["header"]["stamp"], message["twist"]["twist"]
    linear = math.hypot(twist["linear"]["x"], twist["linear"]["y"])
    return Motion(stamp["sec"] + stamp["nanosec"] / 1e9, linear, abs(twist["angular"]["z"]))


def rows(odometry: Sequence[Motion], truth: Sequence[Motion], case: str) -> list[Row]:
    """Compare the velocities of a drive with the true ones."""
    true = {sample.stamp: sample for sample in truth}
    pairs = [(sample, true[sample.stamp]) for sample in odometry if sample.stamp in true]
    standing = [sample for sample, real in pairs if real.linear < 1e-4 and real.angular < 1e-4]
    steps = [after.stamp - before.stamp for before, after in itertools.pairwise(odometry)]
    zero = 100.0 * sum(sample.linear == sample.angular == 0.0 for sample in standing) / max(1, len(standing))
    error = max(abs(sample.linear - real.linear) for sample, real in pairs)
    return [
        Row(f"messages within {_TOLERATED * LINEAR:g} m/s{case}", within(odometry), within(truth), "%", "more"),
        Row(f"fastest{case}", max(m.linear for m in odometry), max(m.linear for m in truth), "m/s"),
        Row(f"fastest turn{case}", max(m.angular for m in odometry), max(m.angular for m in truth), "rad/s"),
        Row(f"largest error{case}", error, _ROCKING, "m/s"),
        Row(f"zero while the base stands{case}", zero, 100.0, "%", "more"),
        Row(f"shortest step of stamps{case}", 1e3 * min(steps), 10.0, "ms", "more"),
        Row(f"longest step of stamps{case}", 1e3 * max(steps), 10.0, "ms"),
    ]


def within(motions: Sequence[Motion]) -> float:
    """Return the percentage of messages within the commanded speed and its tolerance."""
    return 100.0 * sum(sample.linear <= _TOLERATED * LINEAR for sample in motions) / len(motions)


if __name__ == "__main__":
    sys.exit(main())
