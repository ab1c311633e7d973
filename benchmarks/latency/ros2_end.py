"""An end on ROS 2: rclpy, raw bytes both ways, and a loop that costs the same for one subscription as for many.

The loop: rcl's on-new-message callback is libc's ``eventfd_write``, which needs no lock of Python's; one thread waits
for the eventfds and takes what is there.
"""

from __future__ import annotations

import ctypes
import importlib
import os
import select
import threading
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.qos import QoSProfile

from benchmarks.latency.end import End

DEPTH = 20


class Ros2End(End):
    """One rclpy node."""

    def __init__(self) -> None:
        super().__init__()
        rclpy.init()
        self._node = rclpy.create_node(f"end_{os.getpid()}", enable_rosout=False, start_parameter_services=False)
        self._poll = select.epoll()
        self._by_descriptor: dict[int, tuple[Any, Any, Callable[[bytes], None]]] = {}
        self._set_callback = ctypes.CDLL("librcl.so").rcl_subscription_set_on_new_message_callback
        self._set_callback.argtypes = [ctypes.c_void_p] * 3
        self._write = ctypes.cast(ctypes.CDLL(None).eventfd_write, ctypes.c_void_p)
        threading.Thread(target=self._spin, name="take", daemon=True).start()

    def publisher(self, topic: str, type_: str) -> tuple[Callable[[bytes], None], Callable[[], bool]]:
        """As the base says."""
        publisher = self._node.create_publisher(message_class(type_), topic, _qos())
        return publisher.publish, lambda: publisher.get_subscription_count() > 0

    def listen(self, topic: str, type_: str, heard: Callable[[bytes], None]) -> None:
        """As the base says."""
        class_ = message_class(type_)
        subscription = self._node.create_subscription(class_, topic, lambda _payload: None, _qos(), raw=True)
        handle = subscription.handle
        handle.__enter__()
        descriptor = os.eventfd(0, os.EFD_NONBLOCK)
        self._by_descriptor[descriptor] = (handle, class_, heard)
        self._poll.register(descriptor, select.EPOLLIN)
        if self._set_callback(handle.pointer, self._write, descriptor):
            msg = "rcl_subscription_set_on_new_message_callback failed"
            raise RuntimeError(msg)

    def close(self) -> None:
        """Leave at once; the taking thread holds the handles of an orderly shutdown."""
        for handle, _, _ in self._by_descriptor.values():
            self._set_callback(handle.pointer, None, None)
            handle.__exit__(None, None, None)
        rclpy.shutdown()
        os._exit(0)

    def _spin(self) -> None:
        while True:
            for descriptor, _ in self._poll.poll():
                os.eventfd_read(descriptor)
                handle, class_, heard = self._by_descriptor[descriptor]
                while (taken := handle.take_message(class_, True)) is not None:
                    heard(taken[0])


def _qos() -> Any:
    return QoSProfile(depth=DEPTH)  # type: ignore[no-untyped-call]


def message_class(type_: str) -> Any:
    """The class of a type spelled ``package/msg/Name``."""
    package, _, name = type_.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


if __name__ == "__main__":
    Ros2End().run()
