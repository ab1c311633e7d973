"""A rospy program that creates endpoints, sends, receives and counts. Runs on the system's Python."""

from __future__ import annotations

import os

import rospy

from benchmarks.endurance.program import Close, OnMessage, Program
from benchmarks.latency.ros1_end import BUFFER, QUEUE, raw_class


class Ros1Publisher:
    """A raw publisher."""

    def __init__(self, topic: str, type_: str, *, latched: bool) -> None:
        self._class = raw_class(type_)
        self._publisher = rospy.Publisher(topic, self._class, queue_size=QUEUE, latch=latched, tcp_nodelay=True)

    def put(self, payload: bytes) -> None:
        """Publish raw bytes."""
        message = self._class()
        message._buff = payload
        self._publisher.publish(message)

    def close(self) -> None:
        self._publisher.unregister()


class Ros1Program(Program):
    """A program with one rospy node."""

    def __init__(self) -> None:
        super().__init__()
        rospy.init_node(f"program_{os.getpid()}", disable_signals=True, disable_rosout=True)

    def publisher(self, topic: str, type_: str, *, latched: bool) -> Ros1Publisher:
        return Ros1Publisher(topic, type_, latched=latched)

    def listen(self, topic: str, type_: str, *, latched: bool, on_message: OnMessage) -> Close:  # noqa: ARG002
        subscriber = rospy.Subscriber(
            topic, rospy.AnyMsg, lambda message: on_message(message._buff), buff_size=BUFFER, tcp_nodelay=True
        )
        unregister: Close = subscriber.unregister
        return unregister

    def close(self) -> None:
        rospy.signal_shutdown("done")


if __name__ == "__main__":
    Ros1Program().run()
