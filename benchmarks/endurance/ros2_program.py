"""An rclpy program that makes endpoints, sends, hears and counts.

One thread takes the messages of all subscriptions, woken by rcl's on-new-message callback (libc's ``eventfd_write``):
rclpy's executors would cost more with every subscription, and the program is not what is measured.
"""

from __future__ import annotations

import ctypes
import os
import select
import threading
from typing import Any

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile

from benchmarks.endurance.program import DEPTH, Close, Heard, Program
from benchmarks.latency.ros2_end import message_class

_set_callback = ctypes.CDLL("librcl.so").rcl_subscription_set_on_new_message_callback
_set_callback.argtypes = [ctypes.c_void_p] * 3
_write = ctypes.cast(ctypes.CDLL(None).eventfd_write, ctypes.c_void_p)


class Ros2Publisher:
    """A raw publisher."""

    def __init__(self, node: Any, topic: str, type_: str, *, latched: bool) -> None:
        self._node = node
        self._publisher = node.create_publisher(message_class(type_), topic, _qos(latched=latched))

    def put(self, payload: bytes) -> None:
        """Publish raw bytes."""
        self._publisher.publish(payload)

    def close(self) -> None:
        """Give it back."""
        self._node.destroy_publisher(self._publisher)


class Ros2Program(Program):
    """One rclpy node."""

    def __init__(self) -> None:
        super().__init__()
        rclpy.init()
        self._node = rclpy.create_node(f"program_{os.getpid()}", enable_rosout=False, start_parameter_services=False)
        self._poll = select.epoll()
        self._taking = threading.Lock()
        self._takers: dict[int, tuple[Any, Any, Heard]] = {}
        threading.Thread(target=self._spin, name="take", daemon=True).start()

    def publisher(self, topic: str, type_: str, *, latched: bool) -> Ros2Publisher:
        """As the base says."""
        return Ros2Publisher(self._node, topic, type_, latched=latched)

    def listen(self, topic: str, type_: str, *, latched: bool, heard: Heard) -> Close:
        """As the base says."""
        class_ = message_class(type_)
        subscription = self._node.create_subscription(
            class_, topic, lambda _payload: None, _qos(latched=latched), raw=True
        )
        handle = subscription.handle
        handle.__enter__()
        descriptor = os.eventfd(0, os.EFD_NONBLOCK)
        self._takers[descriptor] = (handle, class_, heard)
        self._poll.register(descriptor, select.EPOLLIN)
        _set_callback(handle.pointer, _write, descriptor)

        def close() -> None:
            _set_callback(handle.pointer, None, None)
            with self._taking:
                del self._takers[descriptor]
                self._poll.unregister(descriptor)
                os.close(descriptor)
            handle.__exit__(None, None, None)
            self._node.destroy_subscription(subscription)

        return close

    def close(self) -> None:
        """Leave at once; the taking thread holds the handles of an orderly shutdown."""
        for handle, _, _ in self._takers.values():
            _set_callback(handle.pointer, None, None)
            handle.__exit__(None, None, None)
        rclpy.shutdown()
        os._exit(0)

    def _spin(self) -> None:
        while True:
            for descriptor, _ in self._poll.poll():
                with self._taking:
                    if descriptor in self._takers:
                        os.eventfd_read(descriptor)
                        handle, class_, heard = self._takers[descriptor]
                        while (taken := handle.take_message(class_, True)) is not None:
                            heard(taken[0])


def _qos(*, latched: bool) -> Any:
    durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    return QoSProfile(depth=DEPTH, durability=durability)  # type: ignore[no-untyped-call]


if __name__ == "__main__":
    Ros2Program().run()
