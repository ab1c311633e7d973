"""The ROS 1 programs: a planner's stand-in that reports when its action server is registered, and a bare client.

Runs on the system's Python. Usage: ``python -m benchmarks.returned.ros1 planner PROGRAM`` or ``... ros1 waiter``.
"""

import os
import runpy
import sys
from typing import Any

import actionlib

from benchmarks.returned.words import report

_start = actionlib.ActionServer.start


def _start_and_report(server: Any) -> None:
    _start(server)  # `_start` returns once all five topics are registered at the master
    report("registered")


def _plan(program: str) -> None:
    actionlib.ActionServer.start = _start_and_report
    sys.argv = [program, "1.0", "1.0"]
    runpy.run_path(program, run_name="__main__")


def _wait() -> None:
    """Measure the floor: a client on the planner's own side."""
    import rospy
    from move_base_msgs.msg import MoveBaseAction

    rospy.init_node(f"waiter_{os.getpid()}", disable_signals=True, disable_rosout=True)
    client = actionlib.SimpleActionClient("/move_base", MoveBaseAction)
    report("waiting")
    client.wait_for_server()
    report("found")
    sys.stdin.read()


if __name__ == "__main__":
    _plan(sys.argv[2]) if sys.argv[1] == "planner" else _wait()
