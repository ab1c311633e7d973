"""Takes raw ROS 2 messages at the same cost for one subscription as for many.

rcl's on-new-message callback is libc's ``eventfd_write``, which needs no lock of Python's; one thread waits for the
eventfds and takes the messages. rclpy's executors would cost more with every subscription.
"""

from __future__ import annotations

import ctypes
import importlib
import os
import select
import threading
from collections.abc import Callable
from typing import Any

import rclpy  # noqa: F401  loads librcl


def message_class(type_: str) -> Any:
    """Return the class of a type spelled ``package/msg/Name``."""
    package, _, name = type_.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


class Taker:
    """The thread, and its raw subscriptions."""

    def __init__(self) -> None:
        self._poll = select.epoll()
        self._taking = threading.Lock()
        self._open: dict[int, tuple[Any, Any, Callable[[bytes], None]]] = {}
        self._set_callback = ctypes.CDLL("librcl.so").rcl_subscription_set_on_new_message_callback
        self._set_callback.argtypes = [ctypes.c_void_p] * 3
        self._write = ctypes.cast(ctypes.CDLL(None).eventfd_write, ctypes.c_void_p)
        threading.Thread(target=self._run, name="take", daemon=True).start()

    def listen(
        self, node: Any, topic: str, type_: str, qos: Any, on_message: Callable[[bytes], None]
    ) -> Callable[[], None]:
        """Subscribe; return a function that closes the subscription."""
        class_ = message_class(type_)
        subscription = node.create_subscription(class_, topic, lambda _payload: None, qos, raw=True)
        handle = subscription.handle
        handle.__enter__()
        descriptor = os.eventfd(0, os.EFD_NONBLOCK)
        self._open[descriptor] = (handle, class_, on_message)
        self._poll.register(descriptor, select.EPOLLIN)
        if self._set_callback(handle.pointer, self._write, descriptor):
            msg = "rcl_subscription_set_on_new_message_callback failed"
            raise RuntimeError(msg)

        def close() -> None:
            self._set_callback(handle.pointer, None, None)
            with self._taking:
                del self._open[descriptor]
                self._poll.unregister(descriptor)
                os.close(descriptor)
            handle.__exit__(None, None, None)
            node.destroy_subscription(subscription)

        return close

    def abandon(self) -> None:
        """Stop receiving, without destroying the subscriptions, because the taking thread still uses them."""
        for handle, _, _ in self._open.values():
            self._set_callback(handle.pointer, None, None)
            handle.__exit__(None, None, None)

    def _run(self) -> None:
        while True:
            for descriptor, _ in self._poll.poll():
                with self._taking:
                    if descriptor in self._open:
                        os.eventfd_read(descriptor)
                        handle, class_, on_message = self._open[descriptor]
                        while (taken := handle.take_message(class_, True)) is not None:
                            on_message(taken[0])
