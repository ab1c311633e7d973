"""A ROS 1 program: standard rospy. Usage: ``python -m benchmarks.losses.ros1_program NAME [silent]``."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import rosgraph
import rospy
from geometry_msgs.msg import Twist, Vector3
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from benchmarks.losses.program import MEGABYTE, Program

QUEUE = 100
KINDS = {"stream": Vector3, "cmd_vel": Twist, "large": String}


class Ros1Program(Program):
    """A program with one rospy node."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        rospy.init_node(name, disable_signals=True, disable_rosout=True)
        self._publishers: dict[str, Any] = {}

    def open(self) -> None:
        for kind, type_ in KINDS.items():
            topic = f"/{self.name}/{kind}"
            self._publishers[kind] = rospy.Publisher(topic, type_, queue_size=QUEUE, tcp_nodelay=True)
        self._publishers["state"] = rospy.Publisher("/state", String, queue_size=QUEUE, latch=True)
        rospy.Subscriber("/state", String, lambda m: self.record_line(m.data))

    def publish(self, kind: str, sent: float, number: int) -> None:
        if kind == "stream":
            message: Any = Vector3(sent, number, 0.0)
        elif kind == "cmd_vel":
            message = Twist(linear=Vector3(sent, number, 0.0))
        elif kind == "large":
            message = String(MEGABYTE)
        else:
            message = Clock(rospy.Time.from_sec(sent))
            if "clock" not in self._publishers:
                self._publishers["clock"] = rospy.Publisher("/clock", Clock, queue_size=QUEUE)
        self._publishers[kind].publish(message)

    def publish_state(self, line: str) -> None:
        self._publishers["state"].publish(String(line))

    def listen(self, source: str) -> None:
        more = {"tcp_nodelay": True, "queue_size": QUEUE, "buff_size": 1 << 22}
        if source == "clock":
            rospy.Subscriber("/clock", Clock, lambda m: self.record_message("/clock", m.clock.to_sec(), 0.0), **more)
            return
        for kind, type_ in KINDS.items():
            rospy.Subscriber(f"/{source}/{kind}", type_, self.recorder(source, kind), **more)

    def late(self, take: Callable[[str], None]) -> Callable[[], None]:
        # call this only in a program without another subscription to /state, because rospy would reuse that one's
        # connections, on which latched messages do not arrive again
        subscriber = rospy.Subscriber("/state", String, lambda m: take(m.data))
        return lambda: subscriber.unregister()

    def nodes(self) -> list[str]:
        return sorted({n for kind in rosgraph.Master(rospy.get_name()).getSystemState() for _, ns in kind for n in ns})

    def close(self) -> None:
        rospy.signal_shutdown("done")


if __name__ == "__main__":
    Ros1Program(sys.argv[1]).run(silent="silent" in sys.argv)
