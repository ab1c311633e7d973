"""The ROS 2 programs: a planner's stand-in that reports when its action server exists, and a bare client.

Usage: ``python -m benchmarks.returned.ros2 planner PROGRAM`` or ``... ros2 waiter``.
"""

import os
import runpy
import sys
from typing import Any

import rclpy
import rclpy.action

from benchmarks.returned.words import report

_server: Any = vars(rclpy.action)["ActionServer"]
_make = _server.__init__


def _create_and_report(*args: Any, **more: Any) -> None:
    _make(*args, **more)
    report("registered")


def _plan(program: str) -> None:
    _server.__init__ = _create_and_report
    sys.argv = [program, "1.0", "1.0"]
    runpy.run_path(program, run_name="__main__")


def _wait() -> None:
    """Measure the floor: a client on the planner's own side."""
    from nav2_msgs.action import NavigateToPose

    rclpy.init()
    node = rclpy.create_node(f"waiter_{os.getpid()}")
    client: Any = vars(rclpy.action)["ActionClient"](node, NavigateToPose, "/navigate_to_pose")
    report("waiting")
    client.wait_for_server()
    report("found")
    sys.stdin.read()


if __name__ == "__main__":
    _plan(sys.argv[2]) if sys.argv[1] == "planner" else _wait()
