"""One thread that takes the messages of all subscriptions, and all requests and replies.

rcl counts new messages in an eventfd for each, from the middleware's thread and without Python; the thread here
sleeps in epoll. So a message costs the same beside one subscription as beside five hundred, where a wait set and
rclpy's executors look at every one for each message.
"""

from __future__ import annotations

import logging
import os
import select
import threading
from collections import deque
from typing import Any, ClassVar, Protocol

from bridge.adapters.ros2 import rcl

TAKES_PER_TURN = 32
"""Messages taken of one subscription before the others get their turn."""

_log = logging.getLogger(__name__)


class Reader(Protocol):
    """What the loop serves: a subscription, a client or a server.

    Attributes:
        kind: as rclpy's wait sets name it: ``subscription``, ``client`` or ``service``.
    """

    kind: ClassVar[str] = "subscription"

    @property
    def handle(self) -> Any:
        """Rclpy's inner object."""

    @property
    def pointer(self) -> int:
        """``rcl_subscription_t *``, or of its kind."""

    def wake(self, descriptor: int | None) -> None:
        """Have each new message counted in an eventfd; None ends it."""

    def drain(self, taker: rcl.Taker, limit: int) -> bool:
        """Take and deliver up to ``limit`` messages; whether there may be more."""

    def destroy(self) -> None:
        """Give the reader back to the middleware; nothing refers to it any more."""


class Loop(Protocol):
    """What serves the readers."""

    def start(self) -> None:
        """Start the thread."""

    def add(self, reader: Reader) -> None:
        """Serve a reader from now on, what it already holds included."""

    def remove(self, reader: Reader) -> None:
        """Stop serving a reader and destroy it, on the loop's thread and soon."""

    def stop(self) -> None:
        """End the thread and destroy all readers."""


class TakeLoop(Loop):
    """The thread, and the readers that it serves."""

    def __init__(self) -> None:
        self._epoll = select.epoll()
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._epoll.register(self._wake, select.EPOLLIN)
        self._readers: dict[int, Reader] = {}
        self._leaving: deque[Reader] = deque()
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name="midspan-ros2-take", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def add(self, reader: Reader) -> None:
        """Serve a reader from now on, what it already holds included."""
        descriptor = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._readers[descriptor] = reader
        self._epoll.register(descriptor, select.EPOLLIN)
        reader.wake(descriptor)

    def remove(self, reader: Reader) -> None:
        """Stop serving a reader and destroy it, on the loop's thread and soon."""
        self._leaving.append(reader)
        os.eventfd_write(self._wake, 1)

    def stop(self) -> None:
        """End the thread and destroy all readers."""
        self._stopping = True
        os.eventfd_write(self._wake, 1)
        if self._thread.is_alive():
            self._thread.join()
        for reader in list(self._readers.values()):
            self._drop(reader)
        self._epoll.close()
        os.close(self._wake)

    def _run(self) -> None:
        taker = rcl.Taker()
        try:
            while not self._stopping:
                for descriptor, _ in self._epoll.poll():
                    if descriptor == self._wake:
                        os.eventfd_read(descriptor)
                        while self._leaving:
                            self._drop(self._leaving.popleft())
                    else:
                        self._serve(descriptor, taker)
        finally:
            taker.close()

    def _serve(self, descriptor: int, taker: rcl.Taker) -> None:
        reader = self._readers.get(descriptor)
        if reader is None:
            return
        try:
            count = os.eventfd_read(descriptor)
        except BlockingIOError:
            return
        # As many as were told, and not until there is none: a take in vain costs as much as one that brings a message.
        limit = min(count, TAKES_PER_TURN)
        try:
            reader.drain(taker, limit)
        except Exception:
            _log.exception("taking messages failed")
        if count > limit:
            os.eventfd_write(descriptor, count - limit)

    def _drop(self, reader: Reader) -> None:
        for descriptor, known in list(self._readers.items()):
            if known is reader:
                reader.wake(None)
                del self._readers[descriptor]
                self._epoll.unregister(descriptor)
                os.close(descriptor)
                break
        reader.destroy()
