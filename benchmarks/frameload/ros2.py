"""The ROS 2 program of `benchmarks.frames_load`: ``ros2.py COUNT``, the number of frames per tick."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from pathlib import Path
from typing import Any

import rclpy
import rclpy.executors
import rclpy.utilities
from geometry_msgs.msg import TransformStamped
from rclpy.qos import DurabilityPolicy, QoSProfile
from tf2_msgs.msg import TFMessage

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from benchmarks.frameload.tally import Tally, only_answers, serve
from bridge.tf.stamped import read


def qos(depth: int, *, latched: bool = False) -> QoSProfile:
    """Return a reliable profile, latched or not."""
    durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    return QoSProfile(depth=depth, durability=durability)  # type: ignore[no-untyped-call]


class Program:
    """The program's commands."""

    def __init__(self, frames: int) -> None:
        self.tally = Tally(frames)
        self.node = rclpy.create_node("frames_load")
        self.static: Any = None
        self.spinning: threading.Thread | None = None

    def count(self) -> dict[str, Any]:
        """Subscribe to ``/tf``, and start counting its messages and complete ticks."""

        def on_message(data: bytes) -> None:
            transforms = read(bytes(data))
            self.tally.see(
                [
                    round(transform.translation[0])
                    for transform in transforms
                    if transform.child_frame_id.startswith("load")
                ]
            )

        self.node.create_subscription(TFMessage, "/tf", on_message, qos(1000), raw=True)
        self.spinning = threading.Thread(target=self._spin, daemon=True)
        self.spinning.start()
        return {}

    def _spin(self) -> None:
        with contextlib.suppress(rclpy.executors.ExternalShutdownException):
            rclpy.spin(self.node)

    def mount(self, frames: list[str]) -> dict[str, Any]:
        """Publish static frames, latched."""
        self.static = self.node.create_publisher(TFMessage, "/tf_static", qos(1, latched=True))
        message = TFMessage()
        for name in frames:
            transform = TransformStamped()
            transform.header.frame_id, transform.child_frame_id = "base", name
            message.transforms.append(transform)
        self.static.publish(message)
        return {}

    def join(self, count: int, frames: list[str], seconds: float) -> dict[str, Any]:
        """Subscribe to ``/tf_static`` as a late joiner, ``count`` times, each with a new node.

        Each attempt ends when all frames have arrived, or after ``seconds``. Return the number of attempts in which all
        frames arrived, and the duration of the slowest attempt.
        """
        whole, slowest = 0, 0.0
        for number in range(count):
            left = set(frames)

            def on_message(data: bytes, left: set[str] = left) -> None:
                left.difference_update(transform.child_frame_id for transform in read(bytes(data)))

            start = time.monotonic()
            node = rclpy.create_node(f"late_{number}")
            executor = rclpy.executors.SingleThreadedExecutor()
            executor.add_node(node)
            node.create_subscription(TFMessage, "/tf_static", on_message, qos(100, latched=True), raw=True)
            while left and time.monotonic() - start < seconds:
                executor.spin_once(timeout_sec=0.1)
            whole += not left
            slowest = max(slowest, time.monotonic() - start)
            executor.shutdown()
            node.destroy_node()  # type: ignore[no-untyped-call]
        return {"whole": whole, "slowest": slowest}


def main() -> None:
    answers = only_answers()
    rclpy.init()
    program = Program(int(sys.argv[1]))
    serve(answers, {
        "count": program.count, "report": program.tally.report, "mount": program.mount, "join": program.join
    })  # fmt: skip
    rclpy.utilities.try_shutdown()
    if program.spinning is not None:
        program.spinning.join()


main()
