"""A bare peer: an interpreter with one middleware's library and one subscriber, and nothing of Midspan.

Usage: ``python -m benchmarks.footprints.peer {ros1,ros2,zenoh}``. It tells that it is ready, and ends with its input.
"""

from __future__ import annotations

import json
import sys
from typing import Any


def _ros1() -> object:
    import rospy

    rospy.init_node("bare", anonymous=True, disable_signals=True)
    return rospy.Subscriber("/bare", rospy.AnyMsg, _ignore)


def _ros2() -> object:
    import rclpy
    from std_msgs.msg import String

    rclpy.init()
    node = rclpy.create_node("bare")
    node.create_subscription(String, "/bare", _ignore, 10)
    return node


def _zenoh() -> object:
    import zenoh

    session = zenoh.open(zenoh.Config.from_json5("{scouting: {multicast: {enabled: false}}}"))
    return session, session.declare_subscriber("bare", _ignore)


def _ignore(_message: Any) -> None:
    """Nothing is sent."""


if __name__ == "__main__":
    kept = {"ros1": _ros1, "ros2": _ros2, "zenoh": _zenoh}[sys.argv[1]]()
    print(json.dumps({"event": "ready"}), flush=True)
    sys.stdin.read()
