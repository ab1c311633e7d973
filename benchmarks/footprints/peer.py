"""A bare peer: an interpreter with one middleware's library and one subscriber, without Midspan.

Usage: ``python -m benchmarks.footprints.peer {ros1,ros2,zenoh}``, or ``router`` or ``hub`` with an endpoint, for a
session that is configured like the hub's. The peer reports when it is ready, and exits when its input ends.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
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


def _router(endpoint: str) -> object:
    import zenoh

    from bridge.hub.zenoh_config import MAX_PAYLOAD, make_config, router_tree

    return zenoh.open(make_config(router_tree([endpoint], max_payload=MAX_PAYLOAD), None))


def _hub(endpoint: str) -> object:
    import zenoh

    from bridge.hub.zenoh_config import MAX_PAYLOAD, make_config, session_tree

    return zenoh.open(make_config(session_tree(endpoint, shared_memory=True, max_payload=MAX_PAYLOAD), None))


def _ignore(_message: Any) -> None:
    """Do nothing, because nothing is sent."""


PEERS: dict[str, Callable[..., object]] = {
    "ros1": _ros1, "ros2": _ros2, "zenoh": _zenoh, "router": _router, "hub": _hub,
}  # fmt: skip


if __name__ == "__main__":
    kept = PEERS[sys.argv[1]](*sys.argv[2:])
    print(json.dumps({"event": "ready"}), flush=True)
    sys.stdin.read()
