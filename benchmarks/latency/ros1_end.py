"""A ROS 1 end: standard rospy, with raw bytes in both directions."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from typing import Any

import rospy

from benchmarks.latency.end import End

QUEUE = 100
BUFFER = 16 << 20
"""Bytes that a subscriber reads at once; rospy's default of 64 kB is slower for large messages."""


class Ros1End(End):
    """A program with one rospy node."""

    def __init__(self) -> None:
        super().__init__()
        rospy.init_node(f"end_{os.getpid()}", disable_signals=True, disable_rosout=True)

    def publisher(self, topic: str, type_: str) -> tuple[Callable[[bytes], None], Callable[[], bool]]:
        raw = raw_class(type_)
        publisher = rospy.Publisher(topic, raw, queue_size=QUEUE, tcp_nodelay=True)

        def publish(payload: bytes) -> None:
            message = raw()
            message._buff = payload
            publisher.publish(message)

        return publish, lambda: publisher.get_num_connections() > 0

    def listen(self, topic: str, type_: str, on_message: Callable[[bytes], None]) -> None:  # noqa: ARG002
        rospy.Subscriber(
            topic, rospy.AnyMsg, lambda message: on_message(message._buff), buff_size=BUFFER, tcp_nodelay=True
        )

    def close(self) -> None:
        rospy.signal_shutdown("done")


def raw_class(type_: str) -> Any:
    """Return a rospy class for raw bytes that announces a type."""
    package, _, name = type_.split("/")
    real = getattr(importlib.import_module(f"{package}.msg"), name)
    fields = ("_type", "_md5sum", "_full_text")
    return type(
        "Raw",
        (rospy.AnyMsg,),
        {"_has_header": False, "_slot_types": ["uint8[]"], "__slots__": ["_buff"]}
        | {f: getattr(real, f) for f in fields},
    )


if __name__ == "__main__":
    Ros1End().run()
