"""The cost of driving: RobotGoto's control step and the localizer's update, as shares of their periods.

The simulated R1 drives through the apartment in lock-step, so that both process realistic data. The peer's column has
the period. RobotGoto's step runs every 10 ms, as upstream, and it receives scans at 10 Hz. The localizer's update
(1,000 particles, 360 beams) runs at most once per scan, every 100 ms. Everything runs on one thread, and durations are
wall-clock time.

    python benchmarks/control.py [--json FILE] [--seconds 60]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

if not __package__:  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.localizer import Tour, simulated
from benchmarks.rows import Row, add_json_option, report
from navigation.localization_server.localizer import Localizer
from navigation.localization_server.section import LocalizerSection
from navigation.pose import Pose
from navigation.robot_goto.driver import Driver
from navigation.scan import scan_points

STEP, TURN = 10.0, 100.0
"""Periods of RobotGoto's step and of the laser, ms."""

_SHARES = (50, 99, 100)


class Clock:
    """Measures the duration of calls.

    Attributes:
        milliseconds: duration of each call.
    """

    def __init__(self) -> None:
        self.milliseconds: list[float] = []

    def __call__(self, call: Callable[[], Any]) -> Any:
        """Make a call, and record its duration."""
        begun = time.perf_counter()
        result = call()
        self.milliseconds.append((time.perf_counter() - begun) * 1e3)
        return result

    def rows(self, case: str, period: float) -> Iterator[Row]:
        """Yield the percentiles, compared with a period."""
        for share in _SHARES:
            yield Row(f"{case}, {share} %", float(np.percentile(self.milliseconds, share)), period, "ms")


def measure(seconds: float) -> list[Row]:
    """Drive, and measure the calls."""
    tour = Tour(simulated("apartment", 0), 0)
    simulation = tour.there
    # one update per scan, so that the update itself is measured
    localizer = Localizer(tour.grid, LocalizerSection(update_min_d=1e-9, update_min_a=1e-9))
    localizer.initial(Pose(*simulation.base.pose()))
    driver = Driver()
    steps, scans, updates = Clock(), Clock(), Clock()
    last = -1
    for tick in range(round(seconds * 100)):
        if tick % 10 == 0:
            tour.steer()
        simulation.tick()
        odometry = Pose(*simulation.estimate.pose, stamp_ns=simulation.time_ns)
        localizer.odometry(odometry)
        if simulation.scan.time_ns != last:
            last = simulation.scan.time_ns
            scans(lambda: driver.scan(simulation.scan, odometry))  # noqa: B023 - called at once
            points = scan_points(simulation.scan)
            before = localizer.updates
            updates(lambda: localizer.scan(last, points))  # noqa: B023 - called at once
            if localizer.updates == before:
                updates.milliseconds.pop()
        pose = localizer.pose
        assert pose is not None
        if tour.ahead and driver.status.state.ended:
            driver.goal(Pose(*tour.ahead[-1], 0.0))
        steps(lambda: driver.step(simulation.time_ns / 1e9, pose, odometry))  # noqa: B023 - called at once
    return [
        *steps.rows("RobotGoto: a step", STEP),
        *scans.rows("RobotGoto: a scan", TURN),
        *updates.rows("localizer: an update", TURN),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_json_option(parser)
    parser.add_argument("--seconds", type=float, default=60.0, help="simulated seconds of the drive (default 60)")
    options = parser.parse_args()
    report(measure(options.seconds), options.json)


if __name__ == "__main__":
    main()
