"""Squares driven by the simulated R1 through BaseControl, commanded from each side: the accuracy of their corners.

Each leg ends according to the odometry that its side receives. The peers are the project's limits: 5 cm from the
commanded corners, and odometry within 1 % of the driven path. ``--scale 0.03`` adds an encoder error of 3 %.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

if not __package__:  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.rows import Row, add_json_option, report
from tests.interop.test_base import Robot, RosLike, YarpProgram, connected, moved
from tests.peers.daemon.deployment import Deployment
from tests.peers.navigation.square import Program, driven

ALLOWED, DRIFT = 0.05, 0.01


def measured(side: float, scale: float) -> Iterator[Row]:
    """Drive on all sides, and yield the rows."""
    with tempfile.TemporaryDirectory() as folder, Deployment(Path(folder)) as deployment:
        robot = Robot(deployment, encoders={"scale": [scale, scale]})
        yarp = deployment.keep(YarpProgram(robot.names))
        programs: dict[str, Callable[[], Program]] = {
            "rospy": lambda: RosLike(deployment.ros1()),
            "rclpy": lambda: RosLike(deployment.ros2()),
            "zenoh-ros2-sdk": lambda: RosLike(deployment.sdk()),
            "YARP": lambda: yarp,
        }
        for name, program in programs.items():
            print(f"{name} drives ...", file=sys.stderr)
            yield from square(robot, name, program(), side)


def square(robot: Robot, name: str, program: Program, side: float) -> Iterator[Row]:
    """Drive one square, and yield its rows."""
    connected(robot, program)
    start, odometry = robot.truth(), program.pose(robot.now)
    corners = ((side, 0.0), (side, side), (0.0, side), (0.0, 0.0))
    missed = drifted = turned = 0.0
    for corner, pose in zip(corners, driven(program, side, robot.step), strict=True):
        true, by_odometry = moved(start, robot.truth()), moved(odometry, pose)
        missed = max(missed, math.dist(true[:2], corner))
        drifted = max(drifted, math.dist(true[:2], by_odometry[:2]))
        turned = max(turned, abs(math.remainder(true.theta - by_odometry.theta, 2 * math.pi)))
    yield Row(f"{name}, {side:g} m: farthest from a corner", missed, ALLOWED, "m")
    yield Row(f"{name}, {side:g} m: odometry from truth, of the path", drifted / (4 * side), DRIFT, "share")
    yield Row(f"{name}, {side:g} m: odometry from truth, of the turns", turned / (2 * math.pi), DRIFT, "share")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--side", type=float, default=4.0, metavar="METERS")
    parser.add_argument("--scale", type=float, default=0.0, help="scale error of the encoders, as a fraction")
    add_json_option(parser)
    args = parser.parse_args()
    report(list(measured(args.side, args.scale)), args.json)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
