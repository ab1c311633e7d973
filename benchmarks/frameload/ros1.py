"""The ROS 1 program of `benchmarks.frames_load`: ``ros1.py COUNT``, the number of frames per tick.

It runs on the system's Python.
"""

from __future__ import annotations

import struct
import sys
import threading
import time
from pathlib import Path
from typing import Any

import rospy
from geometry_msgs.msg import TransformStamped
from tf2_msgs.msg import TFMessage

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from benchmarks.frameload.tally import Tally, only_answers, serve

_HEAD = struct.Struct("<IIII")
_SIZE = struct.Struct("<I")
_POSE = struct.Struct("<7d")


def transforms(data: bytes) -> list[tuple[str, float]]:
    """Return the child frame and the x of the translation of each transform in a serialized ``TFMessage``."""
    at, result = _SIZE.size, []
    for _ in range(_SIZE.unpack_from(data)[0]):
        at += _HEAD.size + _HEAD.unpack_from(data, at)[3]
        start = at + _SIZE.size
        at = start + _SIZE.unpack_from(data, at)[0]
        result.append((data[start:at].decode(), _POSE.unpack_from(data, at)[0]))
        at += _POSE.size
    return result


class Program:
    """The program's commands."""

    def __init__(self, frames: int) -> None:
        self.tally = Tally(frames)
        self.static: Any = None

    def count(self) -> dict[str, Any]:
        """Subscribe to ``/tf``, and start counting its messages and complete ticks."""

        def on_message(message: Any) -> None:
            self.tally.see([round(x) for child, x in transforms(message._buff) if child.startswith("load")])

        rospy.Subscriber("/tf", rospy.AnyMsg, on_message, tcp_nodelay=True)
        return {}

    def mount(self, frames: list[str]) -> dict[str, Any]:
        """Publish static frames, latched."""
        self.static = rospy.Publisher("/tf_static", TFMessage, queue_size=1, latch=True)
        stamped = []
        for name in frames:
            transform = TransformStamped()
            transform.header.frame_id, transform.child_frame_id, transform.transform.rotation.w = "base", name, 1.0
            stamped.append(transform)
        self.static.publish(TFMessage(stamped))
        return {}

    def join(self, count: int, frames: list[str], seconds: float) -> dict[str, Any]:
        """Subscribe to ``/tf_static`` as a late joiner, ``count`` times.

        Each attempt ends when all frames have arrived, or after ``seconds``. Return the number of attempts in which all
        frames arrived, and the duration of the slowest attempt.
        """
        whole, slowest = 0, 0.0
        for _ in range(count):
            left, done = set(frames), threading.Event()

            def on_message(message: Any, left: set[str] = left, done: threading.Event = done) -> None:
                left.difference_update(child for child, _ in transforms(message._buff))
                if not left:
                    done.set()

            start = time.monotonic()
            subscriber = rospy.Subscriber("/tf_static", rospy.AnyMsg, on_message)
            whole += done.wait(seconds)
            slowest = max(slowest, time.monotonic() - start)
            subscriber.unregister()
        return {"whole": whole, "slowest": slowest}


def main() -> None:
    answers = only_answers()
    rospy.init_node("frames_load", disable_signals=True)
    program = Program(int(sys.argv[1]))
    serve(answers, {
        "count": program.count, "report": program.tally.report, "mount": program.mount, "join": program.join
    })  # fmt: skip
    rospy.signal_shutdown("done")


main()
