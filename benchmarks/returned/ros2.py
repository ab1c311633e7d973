"""The programs on ROS 2: a planner's stand-in that tells when its action server is there, and a bare client.

Usage: ``python -m benchmarks.returned.ros2 planner PROGRAM`` or ``... ros2 waiter``.
"""

import os
import runpy
import sys
from typing import Any

import rclpy
import rclpy.action

from benchmarks.returned.words import tell

_server: Any = vars(rclpy.action)["ActionServer"]
_make = _server.__init__


def _told(*args: Any, **more: Any) -> None:
    _make(*args, **more)
    tell("registered")


def _plan(program: str) -> None:
    _server.__init__ = _told
    sys.argv = [program, "1.0", "1.0"]
    runpy.run_path(program, run_name="__main__")


def _wait() -> None:
    """The floor: a client of the planner's own side."""
    from nav2_msgs.action import NavigateToPose

    rclpy.init()
    node = rclpy.create_node(f"waiter_{os.getpid()}")
    client: Any = vars(rclpy.action)["ActionClient"](node, NavigateToPose, "/navigate_to_pose")
    tell("waiting")
    client.wait_for_server()
    tell("found")
    sys.stdin.read()


if __name__ == "__main__":
    _plan(sys.argv[2]) if sys.argv[1] == "planner" else _wait()
