"""The body of a simulated robot base, without middleware; the programs `base.py` connect it to ROS 1 or ROS 2.

It prints ``moves`` and ``stands``, each with ``time.monotonic()`` and x, whenever the base starts or stops moving.
Tests compare reported states and replies with this output. Runs on the system's Python without Midspan.
"""
# ruff: noqa: ANN204  # it runs without Midspan

import argparse
import math
import threading
import time

PERIOD = 0.05
WATCHDOG = 0.5
"""Default seconds without a command after which the base brakes, like the driver of a real base."""
TURN_RAMP = 4.0
"""Angular acceleration, in rad/s², of a base with a ramp of 1 m/s²."""


class Body:
    """A base that moves in any direction.

    Args:
        ramp: acceleration in m/s²; if infinite, each command applies at once.
        watchdog: seconds without a command after which the base brakes.
    """

    def __init__(self, ramp, watchdog):
        self.x = self.y = self.yaw = 0.0
        self.wanted = self.velocity = (0.0, 0.0, 0.0)
        self.ramp, self.watchdog, self.commanded, self.moves = ramp, watchdog, 0.0, False
        self.lock = threading.Lock()

    def command(self, x, y, turn):
        """Accept a velocity in m/s, m/s and rad/s."""
        with self.lock:
            self.wanted, self.commanded = (x, y, turn), time.monotonic()
            if self.ramp == math.inf:
                self.velocity = self.wanted
            self.report()

    def step(self):
        """Advance by a period, and return x, y and yaw."""
        with self.lock:
            if time.monotonic() > self.commanded + self.watchdog:
                self.wanted = (0.0, 0.0, 0.0)
            steps = (self.ramp * PERIOD, self.ramp * PERIOD, self.ramp * TURN_RAMP * PERIOD)
            self.velocity = tuple(
                now + min(max(wanted - now, -step), step)
                for now, wanted, step in zip(self.velocity, self.wanted, steps)  # noqa: B905  # the system's Python
            )
            self.report()
            x, y, turn = self.velocity
            self.x += PERIOD * (x * math.cos(self.yaw) - y * math.sin(self.yaw))
            self.y += PERIOD * (x * math.sin(self.yaw) + y * math.cos(self.yaw))
            self.yaw = math.remainder(self.yaw + PERIOD * turn, math.tau)
            return self.x, self.y, self.yaw

    def report(self):
        moves = any(self.velocity)
        if moves != self.moves:
            self.moves = moves
            print("moves" if moves else "stands", time.monotonic(), round(self.x, 3), flush=True)

    def frames(self, x, y, yaw, odometry):
        """Return the base's transforms as parent, child, x, y and yaw; without ``odometry``, only its pose in map."""
        if not odometry:
            return [("map", "base_link", x, y, yaw)]
        return [("map", "odom", 0.0, 0.0, 0.0), ("odom", "base_link", x, y, yaw)]


def arguments():
    """Return the options of both programs: ``ramp``, ``watchdog`` and ``odometry``."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--ramp", type=float, default=math.inf)
    parser.add_argument("--watchdog", type=float, default=WATCHDOG)
    parser.add_argument("--no-odometry", dest="odometry", action="store_false")
    return parser.parse_known_args()[0]
